rockspec_format = "3.0"
package = "rfsm"
version = "scm-1"
source = { url = "git+https://example.org/rfsm.git" }
description = {
  summary = "Statecharts for coordination, in pure Lua",
  detailed = "A faithful reimplementation of rFSM: hierarchical state machines written"
    .. " as plain Lua tables, checked before they move anything.",
  license = "BSD-3-Clause",
  homepage = "https://example.org/rfsm",
  labels = { "fsm", "statechart", "robotics" },
}
dependencies = { "lua >= 5.1, < 5.6" }
test_dependencies = { "busted >= 2.0" }
test = { type = "busted" }
build = {
  type = "builtin",
  modules = {
    ["rfsm"] = "rfsm.lua",
    ["rfsm2dot"] = "rfsm2dot.lua",
    ["rfsm2json"] = "rfsm2json.lua",
    ["rfsm2mermaid"] = "rfsm2mermaid.lua",
    ["rfsm2plantuml"] = "rfsm2plantuml.lua",
    ["rfsm_await"] = "rfsm_await.lua",
    ["rfsm_checkevents"] = "rfsm_checkevents.lua",
    ["rfsm_checks"] = "rfsm_checks.lua",
    ["rfsm_diagram"] = "rfsm_diagram.lua",
    ["rfsm_emem"] = "rfsm_emem.lua",
    ["rfsm_export"] = "rfsm_export.lua",
    ["rfsm_ext"] = "rfsm_ext.lua",
    ["rfsm_marsh"] = "rfsm_marsh.lua",
    ["rfsm_preview"] = "rfsm_preview.lua",
    ["rfsm_proto"] = "rfsm_proto.lua",
    ["rfsm_rtt"] = "rfsm_rtt.lua",
    ["rfsm_seqand"] = "rfsm_seqand.lua",
    ["rfsm_sim"] = "rfsm_sim.lua",
    ["rfsm_timeevent"] = "rfsm_timeevent.lua",
    ["rfsmpp"] = "rfsmpp.lua",
    ["rfsm.await"] = "rfsm/await.lua",
    ["rfsm.checkevents"] = "rfsm/checkevents.lua",
    ["rfsm.dot"] = "rfsm/dot.lua",
    ["rfsm.emem"] = "rfsm/emem.lua",
    ["rfsm.ext"] = "rfsm/ext.lua",
    ["rfsm.marsh"] = "rfsm/marsh.lua",
    ["rfsm.mermaid"] = "rfsm/mermaid.lua",
    ["rfsm.plantuml"] = "rfsm/plantuml.lua",
    ["rfsm.pp"] = "rfsm/pp.lua",
    ["rfsm.preview"] = "rfsm/preview.lua",
    ["rfsm.proto"] = "rfsm/proto.lua",
    ["rfsm.rfsm2json"] = "rfsm/rfsm2json.lua",
    ["rfsm.rtt"] = "rfsm/rtt.lua",
    ["rfsm.seqand"] = "rfsm/seqand.lua",
    ["rfsm.timeevent"] = "rfsm/timeevent.lua",
  },
  install = {
    bin = {
      ["rfsm-check"] = "tools/rfsm-check",
      ["rfsm-sim"] = "tools/rfsm-sim",
      ["rfsm-viz"] = "tools/rfsm-viz",
      ["rfsm2json"] = "tools/rfsm2json",
      ["rfsm2plantuml"] = "tools/rfsm2plantuml",
    },
  },
}
