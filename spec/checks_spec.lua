-- Static checks, and the check for undeclared events.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local timeevent = require "rfsm_timeevent"
require "rfsm.await"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

-- (initial) -> a --e_x--> b --e_x--> a, with more members
local function chart(members)
  local model = {
    warn = false, info = false, a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_x" } },
    trans { src = "b", tgt = "a", events = { "e_x" } },
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return state(model)
end

-- A machine and the list of what it warns of, once it runs.
local function watched(model)
  local fsm, warnings = helper.init(model), {}
  fsm.warn = function(text) warnings[#warnings + 1] = text end
  rfsm_checks.watch(fsm)
  rfsm.run(fsm)
  return fsm, warnings
end

describe("watch", function()
  it("warns of an event that no transition names", function()
    local fsm, warnings = watched(chart())
    helper.post_and_run(fsm, "e_y", "e_x", 7)
    assert.same({
      "WARNING: undeclared event e_y received", "WARNING: undeclared event 7 received",
    }, warnings)
  end)

  it("is asked for by the model, too", function()
    local fsm, warnings = helper.init(chart { checkevents = true }), {}
    fsm.warn = function(text) warnings[#warnings + 1] = text end
    helper.post_and_run(fsm, "e_y")
    assert.same({ "WARNING: undeclared event e_y received" }, warnings)
  end)

  it("is silent while warn is off", function()
    local fsm, warnings = watched(chart())
    local warn = fsm.warn
    fsm.warn = false
    helper.post_and_run(fsm, "e_y")
    fsm.warn = warn
    helper.post_and_run(fsm, "e_z")
    assert.same({ "WARNING: undeclared event e_z received" }, warnings)
  end)

  it("knows what the engine sends", function()
    local fsm, warnings = watched(chart())
    helper.post_and_run(fsm, "e_x")
    assert.same({}, warnings)
  end)

  it("knows e_done of a root that is a leaf", function()
    local _, warnings = watched(state { warn = false })
    assert.same({}, warnings)
  end)

  it("knows what a predicate accepts", function()
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { function(event) return event == "e_p" end } } })
    helper.post_and_run(fsm, "e_q", "e_p")
    assert.same({ "WARNING: undeclared event e_q received" }, warnings)
  end)

  it("takes a predicate that fails for one that does not accept", function()
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { function() error("no") end } } })
    helper.post_and_run(fsm, "e_q")
    assert.same({ "WARNING: undeclared event e_q received" }, warnings)
  end)

  it("knows objects by identity", function()
    local event = {}
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { event } } })
    helper.post_and_run(fsm, event)
    assert.same({}, warnings)
  end)

  it("knows time events", function()
    local now = 0
    timeevent.set_gettime_hook(function() return now, 0 end)
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { "e_after(1)" } } })
    now = 2
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({}, warnings)
  end)

  it("knows awaited events", function()
    local fsm, warnings = watched(chart { [4] = trans { src = "a", tgt = "b",
      events = { "await(e_p, e_q)" } } })
    helper.post_and_run(fsm, "e_p")
    helper.post_and_run(fsm, "e_q")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({}, warnings)
  end)

  it("knows what is merged later", function()
    local fsm, warnings = watched(chart())
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "b", events = { "e_new" } })
    helper.post_and_run(fsm, "e_new")
    assert.same({}, warnings)
  end)

  it("uses the printer of the moment", function()
    local fsm, later = watched(chart()), {}
    fsm.warn = function(text) later[#later + 1] = text end
    helper.post_and_run(fsm, "e_y")
    assert.same({ "WARNING: undeclared event e_y received" }, later)
  end)

  it("is silent when warn is false", function()
    local fsm = watched(chart())
    fsm.warn = false
    assert.has_no_error(function() helper.post_and_run(fsm, "e_y") end)
  end)

  it("called twice warns once", function()
    local fsm, warnings = watched(chart())
    rfsm_checks.watch(fsm)
    helper.post_and_run(fsm, "e_y")
    assert.equal(1, #warnings)
  end)

  it("blames the caller for what is no machine", function()
    local _, text = pcall(function() rfsm_checks.watch(chart()) end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks.watch: initialised fsm expected, "
      .. "got table", text)
  end)
end)

describe("check", function()
  local function findings_of(members) return rfsm_checks.check(chart(members)) end

  it("finds nothing in a sound model", function()
    assert.same({}, findings_of())
  end)

  it("takes a machine, too", function()
    local fsm = helper.init(chart { c = state {} })
    assert.same(findings_of { c = state {} }, rfsm_checks.check(fsm))
  end)

  it("prints nothing and leaves the model as it is", function()
    local said = {}
    local model = chart { c = state {} }
    local function say(...) said[#said + 1] = ... end
    model.warn, model.info, model.err = say, say, say
    assert.equal(1, #rfsm_checks.check(model))
    assert.same({}, said)
    assert.equal(say, model.warn)
    assert.is_nil(rawget(model, "dbg"))
  end)

  it("leaves the model as it is when it cannot be initialised", function()
    local model = chart()
    local function fail() error("no machine today", 0) end
    rfsm.preproc[#rfsm.preproc + 1] = fail
    local ok, text = pcall(rfsm_checks.check, model)
    table.remove(rfsm.preproc)
    assert.is_false(ok)
    assert.equal("no machine today", text)
    assert.is_false(model.warn)
    assert.is_nil(rawget(model, "dbg"))
  end)

  it("knows a model by which its transitions call the root", function()
    local model = chart()
    model[4] = trans { src = "b", tgt = model, events = { "e_again" } }
    assert.same({}, rfsm_checks.check(model))
  end)

  it("tells of a state that is called like a printer", function()
    assert.matches("^spec/checks_spec.lua:%d+: root%.info: ", findings_of { info = state {} }[1])
  end)

  it("takes a part of a machine, too", function()
    local part = chart { c = state {} }
    local fsm = helper.init(state { p = part, trans { src = "initial", tgt = "p" } })
    assert.same(findings_of { c = state {} }, rfsm_checks.check(fsm.p))
  end)

  it("returns the problems of a model that is not valid", function()
    assert.matches("^spec/checks_spec.lua:%d+: root.trans%[4%]: src is missing, the name "
      .. "of a state or connector expected$", findings_of { [4] = trans { tgt = "a" } }[1])
  end)

  it("finds a state that nothing leads to, and not what is in it", function()
    assert.same({ "root.c: unreachable, no path of transitions leads here" },
      findings_of { c = state { x = state {}, trans { src = "initial", tgt = "x" } } })
  end)

  it("finds a state that only unreachable ones lead to", function()
    assert.same({
      "root.c: unreachable, no path of transitions leads here",
      "root.d: unreachable, no path of transitions leads here",
    }, findings_of {
      c = state {}, d = state {}, trans { src = "initial", tgt = "a" },
      [4] = trans { src = "c", tgt = "d", events = { "e_x" } },
      [5] = trans { src = "d", tgt = "c", events = { "e_x" } },
    })
  end)

  it("follows paths through connectors", function()
    assert.same({}, findings_of {
      k = conn {}, c = state {},
      [4] = trans { src = "a", tgt = "k", events = { "e_k" } },
      [5] = trans { src = "k", tgt = "c" },
      [6] = trans { src = "c", tgt = "a", events = { "e_x" } },
    })
  end)

  it("finds a connector that leads nowhere", function()
    assert.same({ "root.k: no way out of this connector, so that no transition to it "
      .. "is ever taken" }, findings_of {
        k = conn {}, [4] = trans { src = "a", tgt = "k", events = { "e_k" } },
      })
  end)

  it("finds a state without an exit", function()
    assert.same({
      "root.c: no exit, neither this state nor one around it is ever left",
    }, findings_of {
      c = state {}, [4] = trans { src = "a", tgt = "c", events = { "e_c" } },
    })
  end)

  it("counts the exits of the states around", function()
    assert.same({}, findings_of {
      c = state { x = state {}, trans { src = "initial", tgt = "x" } },
      [4] = trans { src = "a", tgt = "c", events = { "e_c" } },
      [5] = trans { src = "c", tgt = "a", events = { "e_x" } },
    })
  end)

  -- c[ (initial) -> x --e_x--> y --e_y--> x ] with transitions around it
  local function in_composite(outer)
    return findings_of {
      c = state {
        x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_x" } },
        trans { src = "y", tgt = "x", events = { "e_y" } },
      },
      [4] = trans { src = "a", tgt = "c", events = { "e_c" } },
      [5] = trans(outer),
    }
  end
  local SHADOWED = { "root.c.trans[2]: never taken, root.trans[5] always comes first" }

  it("finds a transition that an outer one always beats", function()
    assert.same(SHADOWED, in_composite { src = "c", tgt = "a", events = { "e_x" } })
  end)

  it("finds one that a transition on any event beats", function()
    assert.same({
      "root.c.trans[2]: never taken, root.trans[5] always comes first",
      "root.c.trans[3]: never taken, root.trans[5] always comes first",
    }, in_composite { src = "c", tgt = "a" })
  end)

  it("lets a guard make the difference", function()
    assert.same({}, in_composite { src = "c", tgt = "a", events = { "e_x" },
      guard = function() end })
  end)

  it("lets another event make the difference", function()
    assert.same({}, in_composite { src = "c", tgt = "a", events = { "e_z" } })
  end)

  it("finds one that a sibling of larger pn always beats", function()
    assert.same({ "root.trans[2]: never taken, root.trans[4] always comes first" },
      findings_of { [4] = trans { src = "a", tgt = "b", events = { "e_x" }, pn = 1 } })
  end)

  it("does not take one through a connector that may be closed for a shadow", function()
    assert.same({}, findings_of {
      k = conn {}, [4] = trans { src = "a", tgt = "k", events = { "e_x" }, pn = 1 },
      [5] = trans { src = "k", tgt = "b", guard = function() end },
    })
  end)

  it("takes one through a connector that is open for a shadow", function()
    assert.same({ "root.trans[2]: never taken, root.trans[4] always comes first" },
      findings_of {
        k = conn {}, [4] = trans { src = "a", tgt = "k", events = { "e_x" }, pn = 1 },
        [5] = trans { src = "k", tgt = "b" },
      })
  end)

  it("finds an e_done@F that never comes", function()
    assert.same({ "root.trans[4]: event 'e_done@root.z' never comes, 'root.z' is no "
      .. "leaf state of this machine" }, findings_of {
        [4] = trans { src = "a", tgt = "b", events = { "e_done@root.z" } },
      })
  end)

  it("sorts what it finds", function()
    local members = {}
    for i = 1, 12 do members["c" .. i] = state {} end
    local places = {}
    for i, text in ipairs(findings_of(members)) do
      places[i] = text:match("^[^:]*")
    end
    assert.equal("root.c1 root.c2 root.c3 root.c4 root.c5 root.c6 root.c7 root.c8 "
      .. "root.c9 root.c10 root.c11 root.c12", table.concat(places, " "))
  end)

  it("blames the caller for what is no state", function()
    local _, text = pcall(function() return (rfsm_checks.check {}) end)
    assert.matches("checks_spec.lua:%d+: rfsm_checks.check: state expected, got table",
      text)
  end)
end)

describe("rfsm.checkevents", function()
  it("watches each machine that is initialised afterwards, and none before", function()
    local warnings, before = {}, helper.init(chart())
    require "rfsm.checkevents"
    local model = chart()
    model.warn = function(text) warnings[#warnings + 1] = text end
    local after = helper.init(model)
    helper.post_and_run(before, "e_y")
    helper.post_and_run(after, "e_y")
    assert.same({ "WARNING: undeclared event e_y received" }, warnings)
  end)
end)
