rockspec_format = "3.0"
package = "rfsm"
version = "dev-1"
source = { url = "." } -- tools/rockspec.lua sets it, and the version, for a release
description = {
  summary = "Statecharts for coordination, in pure Lua",
  detailed = "A reimplementation of rFSM: hierarchical state machines, written as plain"
    .. " Lua tables and checked before they run.",
  license = "BSD-3-Clause",
  labels = { "fsm", "statechart", "robotics" },
}
dependencies = { "lua >= 5.1, < 5.6", "argparse >= 0.6" }
test_dependencies = { "busted >= 2.0" }
test = { type = "busted" }
build = {
  type = "builtin",
  modules = {
    ["rfsm"] = "rfsm.lua",
    ["rfsm_checks"] = "rfsm_checks.lua",
    ["rfsm_seqand"] = "rfsm_seqand.lua",
    ["rfsm_timeevent"] = "rfsm_timeevent.lua",
    ["rfsmpp"] = "rfsmpp.lua",
    ["rfsm.advice"] = "rfsm/advice.lua",
    ["rfsm.await"] = "rfsm/await.lua",
    ["rfsm.chart"] = "rfsm/chart.lua",
    ["rfsm.checks.place"] = "rfsm/checks/place.lua",
    ["rfsm.checks.why"] = "rfsm/checks/why.lua",
    ["rfsm.cli"] = "rfsm/cli.lua",
    ["rfsm.clock"] = "rfsm/clock.lua",
    ["rfsm.diagram"] = "rfsm/diagram.lua",
    ["rfsm.dot"] = "rfsm/dot.lua",
    ["rfsm.emem"] = "rfsm/emem.lua",
    ["rfsm.json"] = "rfsm/json.lua",
    ["rfsm.marsh"] = "rfsm/marsh.lua",
    ["rfsm.mermaid"] = "rfsm/mermaid.lua",
    ["rfsm.monitor"] = "rfsm/monitor.lua",
    ["rfsm.plain"] = "rfsm/plain.lua",
    ["rfsm.plantuml"] = "rfsm/plantuml.lua",
    ["rfsm.preview"] = "rfsm/preview.lua",
    ["rfsm.proto"] = "rfsm/proto.lua",
    ["rfsm.record"] = "rfsm/record.lua",
    ["rfsm.rtt"] = "rfsm/rtt.lua",
    ["rfsm.rtt_launch"] = "rfsm/rtt_launch.lua",
    ["rfsm.sim"] = "rfsm/sim.lua",
    ["rfsm.snapshot"] = "rfsm/snapshot.lua",
    ["rfsm.straight"] = "rfsm/straight.lua",
    -- older names
    ["rfsm2dot"] = "compat/rfsm2dot.lua",
    ["rfsm2json"] = "compat/rfsm2json.lua",
    ["rfsm2mermaid"] = "compat/rfsm2mermaid.lua",
    ["rfsm2plantuml"] = "compat/rfsm2plantuml.lua",
    ["rfsm_await"] = "compat/rfsm_await.lua",
    ["rfsm_checkevents"] = "compat/rfsm_checkevents.lua",
    ["rfsm_emem"] = "compat/rfsm_emem.lua",
    ["rfsm_ext"] = "compat/rfsm_ext.lua",
    ["rfsm_marsh"] = "compat/rfsm_marsh.lua",
    ["rfsm_preview"] = "compat/rfsm_preview.lua",
    ["rfsm_proto"] = "compat/rfsm_proto.lua",
    ["rfsm_record"] = "compat/rfsm_record.lua",
    ["rfsm_rtt"] = "compat/rfsm_rtt.lua",
    ["rfsm_snapshot"] = "compat/rfsm_snapshot.lua",
    ["rfsm.checkevents"] = "compat/rfsm/checkevents.lua",
    ["rfsm.checks"] = "compat/rfsm/checks.lua",
    ["rfsm.ext"] = "compat/rfsm/ext.lua",
    ["rfsm.pp"] = "compat/rfsm/pp.lua",
    ["rfsm.rfsm"] = "compat/rfsm/rfsm.lua",
    ["rfsm.rfsm2json"] = "compat/rfsm/rfsm2json.lua",
    ["rfsm.seqand"] = "compat/rfsm/seqand.lua",
    ["rfsm.timeevent"] = "compat/rfsm/timeevent.lua",
  },
  install = {
    bin = {
      ["rfsm"] = "tools/rfsm",
      ["rfsm-check"] = "tools/rfsm-check",
      ["rfsm-sim"] = "tools/rfsm-sim",
      ["rfsm-viz"] = "tools/rfsm-viz",
      ["rfsm2json"] = "tools/rfsm2json",
      ["rfsm2plantuml"] = "tools/rfsm2plantuml",
    },
  },
}
