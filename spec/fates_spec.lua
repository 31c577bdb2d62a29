-- What became of an event, and who has used it: fate hooks, and the tools that show it.

local LocalView = require "rfsm.web.local_view"
local checks = require "rfsm_checks"
local coverage = require "rfsm.observe.coverage"
local helper = require "spec.helper"
local rfsm = require "rfsm"
require "rfsm.await"
require "rfsm.defer"

local state, trans, conn, named = rfsm.state, rfsm.trans, rfsm.conn, rfsm.named
local send = helper.post_and_run

-- Returns a machine, and a list with a line for each fate.
local function followed(model)
  local fsm, lines = helper.init(state(model)), {}
  for _, at in ipairs(rfsm.machines(fsm)) do
    rfsm.fate_hook_add(at.machine, function(_, event, fate, who)
      local by = who.transition and who.transition.src._fqn
        or who.state and who.state._fqn
      lines[#lines + 1] = at.prefix .. " " .. rfsm.event_text(event, true) .. " "
        .. fate .. (by and " " .. by or "") .. (who.word and " " .. who.word or "")
        .. (who.region and " region" or "")
    end)
  end
  rfsm.run(fsm)
  return fsm, lines
end

-- warming -e_warm-> ready -e_job, e_print{..}-> busy; e_job is deferred
local function printer()
  return { info = false, warn = false,
    warming = state { defer = { "e_job", named "e_print" } }, ready = state {},
    busy = state {},
    trans { src = "initial", tgt = "warming" },
    trans { src = "warming", tgt = "ready", events = { "e_warm" } },
    trans { src = "ready", tgt = "busy", events = { "e_job", named "e_print" } },
    trans { src = "busy", tgt = "ready", events = { "e_ok" } } }
end

-- a -e_go-> par, which has a region x -e_in-> y
local function parallel(region)
  return { info = false, warn = false, a = state {},
    par = rfsm.seqand { idle_doo = "auto", r = state(region or { info = false,
      warn = false, x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = { "e_in" } } }) },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "par", events = { "e_go" } } }
end

describe("a fate hook", function()
  it("is told who has taken, kept and discarded an event, once for each", function()
    local fsm, lines = followed(printer())
    send(fsm, "e_job", { name = "e_print", n = 1 }, "e_x")
    send(fsm, "e_warm")
    assert.same({ "root e_job kept root.warming defers",
      "root e_print{n=1} kept root.warming defers", "root e_x discarded",
      "root e_warm taken root.warming", "root e_job taken root.ready",
      "root e_print{n=1} discarded" }, lines)
  end)

  it("is told of the transition of a path over connectors", function()
    local fsm, lines = followed { info = false, warn = false, a = state {},
      b = state {},
      k = conn {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e_1" } },
      trans { src = "k", tgt = "b", events = { "e_2" } } }
    send(fsm, "e_2", "e_1", "e_3")
    assert.same({ "root e_2 taken root.k", "root e_1 taken root.a",
      "root e_3 discarded" }, lines)
  end)

  it("is told of an event that a transition without events takes", function()
    local fsm, lines = followed { info = false, warn = false, a = state {},
      b = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b",
        guard = function(_, events) return events[1] == "e_x" end } }
    send(fsm, "e_x")
    assert.same({ "root e_x taken root.a" }, lines)
  end)

  it("is told of an event that an await notes for the first time", function()
    local fsm, lines = followed { info = false, warn = false, a = state {},
      b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "await(e_1, e_2)" } } }
    send(fsm, "e_1")
    send(fsm, "e_1")
    send(fsm, "e_2")
    assert.same({ "root e_1 kept root.a awaits", "root e_1 discarded",
      "root e_2 kept root.a awaits" }, lines)
  end)

  it("is told of an event that a region uses, and of one that none uses", function()
    local fsm, lines = followed(parallel())
    send(fsm, "e_go")
    send(fsm, "e_in")
    send(fsm, "e_no")
    assert.same({ "root e_go taken root.a", "root.par.r e_in taken root.x",
      "root e_in forwarded root.par region", "root e_no discarded" }, lines)
  end)

  it("is told by a region of what the region keeps", function()
    local model = printer()
    local fsm, lines = followed(parallel(model))
    send(fsm, "e_go")
    send(fsm, "e_job")
    assert.same({ "root e_go taken root.a",
      "root.par.r e_job kept root.warming defers",
      "root e_job forwarded root.par region" }, lines)
  end)

  it("is told of each of two events that are the same, if one is taken a step",
    function()
      local fsm, lines = followed(parallel { info = false, warn = false, read = "one",
        x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_in" } } })
      send(fsm, "e_go")
      rfsm.send_events(fsm, "e_in")
      rfsm.step(fsm)
      send(fsm, "e_in")
      assert.same({ "root e_go taken root.a", "root.par.r e_in taken root.x",
        "root e_in forwarded root.par region", "root e_in discarded" }, lines)
    end)

  it("is told of the second of two that are the same, in regions of regions", function()
    local inner = state { x = state {}, trans { src = "initial", tgt = "x" } }
    local fsm, lines = followed { info = false, warn = false, read = "one",
      par = rfsm.seqand { step = 2,
        a = state { p = rfsm.seqand { s = inner },
          trans { src = "initial", tgt = "p" } },
        b = state { y = state {}, trans { src = "initial", tgt = "y" },
          trans { src = "y", tgt = "y", events = { "e_go" } } } },
      trans { src = "initial", tgt = "par" } }
    send(fsm, "e_go", "e_go")
    table.sort(lines)
    assert.same({ "root e_go forwarded root.par region",
      "root e_go forwarded root.par region", "root.par.b e_go taken root.y",
      "root.par.b e_go taken root.y" }, lines)
  end)

  it("is told what the machine keeps, whatever a region does with it", function()
    local model = parallel()
    model.par.defer = { "e_in", "e_no" }
    local fsm, lines = followed(model)
    send(fsm, "e_go")
    send(fsm, "e_in", "e_no")
    assert.same({ "root e_go taken root.a", "root e_in kept root.par defers",
      "root e_no kept root.par defers", "root.par.r e_in taken root.x" }, lines)
  end)

  it("is told of nothing that the machine makes, also if a region loses it", function()
    local model = parallel()
    model[3] = trans { src = "par", tgt = "a", events = { "e_out" } }
    local fsm, lines = followed(model)
    rfsm.send_events(fsm, "e_done@root.a", "e_go")
    rfsm.step(fsm)
    send(fsm, "e_out")
    assert.same({ "root e_go taken root.a", "root e_out taken root.par" }, lines)
  end)

  it("leaves nothing behind when it is removed", function()
    local fsm = helper.init(state(parallel()))
    local before = { fsm._path_hooks, fsm._fates, #(fsm._post_hooks or {}) }
    local function hook() end
    rfsm.fate_hook_add(fsm, hook)
    assert.is_true(rfsm.fate_hook_rm(fsm, hook))
    assert.same(before, { fsm._path_hooks, fsm._fates, #(fsm._post_hooks or {}) })
  end)

  it("is told as long as another one is there, of whichever kind", function()
    local function fate(fsm, f, word)
      rfsm["fate_hook_" .. word](fsm, f)
    end
    local function watch(fsm, f, word)
      rfsm["watch_hook_" .. word](fsm, "discarded", f)
    end
    for _, kinds in ipairs { { fate, fate }, { fate, watch }, { watch, fate } } do
      local told, fsm = 0, helper.init(state(parallel()))
      local function other() end
      local function hook(_, event) told = told + (event == "e_unknown" and 1 or 0) end
      rfsm.run(fsm)
      kinds[1](fsm, hook, "add")
      kinds[2](fsm, other, "add")
      kinds[2](fsm, other, "rm")
      send(fsm, "e_unknown")
      assert.equal(1, told)
      kinds[1](fsm, hook, "rm")
      assert.is_nil(fsm._fates)
    end
  end)
end)

describe("why", function()
  it("names the state that would keep an event", function()
    local fsm = followed(printer())
    local result, text = checks.why(fsm, "e_job", { name = "e_print", n = 1 })
    assert.same({ "e_job (root.warming defers it)",
      "e_print{n=1} (root.warming defers it)" }, result.kept)
    assert.matches("  kept: e_job (root.warming defers it), e_print{n=1} (root.warming "
      .. "defers it)\n", text, 1, true)
    assert.same({}, checks.why(fsm, "e_warm").kept)
  end)

  it("knows the event that completes an await", function()
    local fsm = followed { info = false, warn = false, a = state {},
      b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "await(e_1, e_2)" } } }
    assert.same({ false, { "e_1 (root.a awaits it)" } },
      { checks.why(fsm, "e_1").fires, checks.why(fsm, "e_1").kept })
    send(fsm, "e_1")
    assert.equal("root.trans[2] (a -> b)", checks.why(fsm, "e_2").fires)
    assert.same({ "await(e_1, e_2)@root.a", "e_2", any = false },
      (checks.enabled(fsm)))
  end)

  it("calls a guard with the event that counts", function()
    local fsm = followed { info = false, warn = false, a = state {},
      b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { named "e_r" },
        guard = function(_, _, event) return event.celsius < 20 end } }
    local events = { "e_x", { name = "e_r", celsius = 19 } }
    assert.equal("root.trans[2] (a -> b)", checks.why(fsm, events[1], events[2]).fires)
  end)
end)

it("a guard whose outcomes are counted gets the event that counts", function()
  local fsm = helper.init(state { info = false, warn = false, a = state {},
    b = state {}, trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b",
      events = { named "e_r" },
      guard = function(_, _, event) return event.celsius < 20 end } })
  coverage.coverage(fsm)
  rfsm.run(fsm)
  send(fsm, { name = "e_r", celsius = 19 })
  assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
end)

it("the page shows what is kept, and what is discarded", function()
  local fsm = helper.init(state(printer()))
  local view = LocalView.new(fsm, function() return 0 end)
  view:observe(true)
  rfsm.run(fsm)
  send(fsm, "e_job", "e_x")
  view:settle()
  local lines = {}
  for i, entry in ipairs(view:state().log) do
    lines[i] = entry.kind .. ": " .. entry.text .. " "
      .. table.concat(entry.events or {}, ", ")
  end
  assert.same({ "step: root.initial \226\134\146 root.warming e_init_fsm",
    "note: kept: e_job (root.warming defers it) e_job", "lost: discarded e_x" },
    lines)
  assert.same({ { "e_job" }, {} }, { view:now().waiting, view:now().queue })
end)

it("the fates of random runs, also interrupted ones, are those of the definition",
  function()
    local claim = require "spec.support.claims.fates"
    assert.is_nil(require("spec.support.share").problem(claim, 300, true))
  end)
