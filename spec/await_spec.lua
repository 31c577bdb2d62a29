-- Await: transitions that wait for several events.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"
require "rfsm.await"

local state, trans = rfsm.state, rfsm.trans
local chart, started, said = helper.chart, helper.started, helper.said

local XY = { "await(e_x, e_y)" }

local function check(fsm, story) assert.equal(story, helper.story(fsm, story)) end

describe("await", function()
  local function is_z(event) return event == "e_z" end
  -- A circumstance, the events from a to b, moves and leaves, more members.
  for _, case in ipairs {
    { "is enabled when all were received, over several steps", XY,
      "e_x=a e_z=a e_y=b" },
    { "is enabled when all come in one step", { "await(e_x, e_y, e_z)" },
      "e_z,e_x,e_y=b" },
    { "takes the events in any order", { "await(e_x,e_y)" }, "e_y=a e_x=b" },
    { "does not take one event for two", XY, "e_x=a e_x=a e_x=a" },
    { "of one event is that event", { "await(e_x)" }, "e_x=b" },
    { "may be the only event, as a string", XY[1], "e_x=a e_y=b" },
    { "leaves alternatives in the same list alone", { XY[1], "e_z" }, "e_z=b" },
    { "leaves predicates in the same list alone", { XY[1], is_z }, "e_x=a e_z=b" },
    { "takes e_done for that of its source", { "await(e_done, e_x)" }, "e_x=b" },
    { "waits for an e_done that comes last", { "await(e_done, e_x)" }, "e_x=a =b",
      { a = state { doo = function()
        rfsm.yield(true)
        rfsm.yield(true)
      end } } },
    { "forgets when the source is left", XY, "e_x=a e_skip=b e_back=a e_y=a e_x=b",
      { [4] = trans { src = "a", tgt = "b", events = { "e_skip" } } } },
    { "does not count what came before the source was entered", XY,
      "e_x=a e_y=b e_x=b e_back=a e_y=a e_x=b" },
    { "of a composite goes on across inner transitions", XY, "e_x=q e_y=b",
      { a = state { p = state {}, q = state {}, trans { src = "initial", tgt = "p" },
        trans { src = "p", tgt = "q", events = { "e_x" } } } } },
  } do
    it(case[1], function() check(started(chart(case[2], case[4])), case[3]) end)
  end

  for _, text in ipairs {
    "await('e_x', 'e_y')", 'await("e_x","e_y")', "await( e_x , 'e_y' )",
  } do
    it("bears the name of its source, written " .. text, function()
      local model = chart { text }
      local fsm = started(model)
      assert.same({ "await(e_x, e_y)@root.a" }, fsm[2].events)
      assert.same({ text }, model[2].events)
      check(fsm, "e_y=a e_x=b")
    end)
  end

  it("stays enabled while a guard inhibits, and does not fire without an event",
    function()
      local model, is_open = chart(XY), false
      model[2].guard = function() return is_open end
      local fsm = started(model)
      check(fsm, "e_x=a e_y=a")
      is_open = true
      check(fsm, "=a e_z=b")
    end)

  it("at two transitions of a state is one; dbg is told when it is complete", function()
    local model, taken = chart(XY), nil
    model[4] = trans { src = "a", tgt = "b", events = XY, pn = 1,
      effect = function(_, _, _, events) taken = events end }
    local fsm = started(model)
    local records = said(fsm, "dbg", "AWAIT")
    check(fsm, "e_x=a e_y=b")
    assert.same({ "e_y", "await(e_x, e_y)@root.a" }, taken)
    assert.same({ "AWAIT await(e_x, e_y)@root.a" }, records)
  end)

  it("forgets at reset", function()
    local fsm = started(chart(XY))
    check(fsm, "e_x=a")
    rfsm.reset(fsm)
    check(fsm, "=a e_y=a e_x=b")
  end)

  it("may be merged into a live machine", function()
    local fsm = started(chart { "e_z" })
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "b", events = XY })
    check(fsm, "e_x=a e_y=b")
  end)
end)

describe("an await that is wrong", function()
  for _, text in ipairs {
    "await()", "await(e_x,)", "await(e_x", "await(await(e_x), e_y)",
    "await(e_x; e_y)", "await(e_x | e_y)",
  } do
    it("is a problem of the model: " .. text, function()
      local _, _, problems = rfsm.init(chart({ text }, { err = false }))
      assert.equal(1, #problems)
      assert.equal("root.trans[2].events[1] (a -> b): await: a list of events "
        .. "expected, got '" .. text .. "' (await(e_a, e_b) would be right)",
        helper.without_file(problems[1]))
    end)
  end

  local function first_warning(model)
    local warnings = said(model, "warn")
    rfsm.init(model)
    return helper.without_file(warnings[1])
  end

  it("at a connector brings a warning", function()
    assert.equal("WARNING: root.trans[1].events (initial -> a): 'await(e_x, e_y)' "
      .. "never fires here, 'root.initial' is no state", first_warning(chart({ "e_x" },
      { trans { src = "initial", tgt = "a", events = { "e_init_fsm", XY[1] } } })))
  end)

  it("with the e_done of a composite brings a warning", function()
    assert.equal("WARNING: root.trans[2].events (a -> b): 'e_done' never fires here, "
      .. "'root.a' is no leaf, and has no final leaf", first_warning(chart(
      { "await(e_x, e_done)" },
      { a = state { p = state {}, trans { src = "initial", tgt = "p" } } })))
  end)
end)

-- whichever of the two modules is loaded first
describe("with time events", function()
  local timeevent = require "rfsm_timeevent"

  for _, text in ipairs { "await(e_x, e_after(5))", "await('e_x', 'e_after(5)')" } do
    it("await waits for them, too: " .. text, function()
      local now = 0
      timeevent.set_gettime_hook(function() return now, 0 end)
      local fsm = started(chart { text })
      assert.same({ "await(e_x, e_after(5)@root.a)@root.a" }, fsm[2].events)
      check(fsm, "e_x=a")
      now = 6
      check(fsm, "=b")
    end)
  end
end)

describe("in a state whose name has a comma, quote or parenthesis", function()
  local timeevent = require "rfsm_timeevent"

  for _, name in ipairs { "x,y", "x'y", "f(x)", "x), await(y", "x" } do
    it("await waits for time events and e_done@ of it: " .. name, function()
      local now = 0
      timeevent.set_gettime_hook(function() return now, 0 end)
      local model = chart({ "e_z" }, { [name] = state {}, xx = state {} })
      model[1] = trans { src = "initial", tgt = name }
      model[4] = trans { src = name, tgt = "b",
        events = { ("await(e_x, e_after(5), e_done@root.xx, 'e_done@root.%s')"):format(
          name) } }
      local fsm = started(model)
      assert.same({ ("await(e_x, e_after(5)@root.%s, e_done@root.xx, e_done@root.%s)"
        .. "@root.%s"):format(name, name, name) }, fsm[4].events)
      now = 6
      helper.post_and_run(fsm, "e_x")
      assert.equal("root.b", helper.leaf_after(fsm, "e_done@root.xx"))
    end)
  end

  it("an await that has been expanded stays as it is", function()
    local fsm = started(chart({ "e_x" }, { ["f(x)"] = state {} }))
    assert.is_true((rfsm.fsm_merge(fsm, fsm, trans { src = "f(x)", tgt = "b",
      events = { "await(e_x, e_y)@root.f(x)" } })))
    assert.same({ "await(e_x, e_y)@root.f(x)" }, fsm[4].events)
  end)
end)

it("awaits agree with counting, on random charts", function()
  assert.is_nil(share.problem(require "spec.support.claims.await", 40))
end)

describe("a snapshot", function()
  local snapshot = require "rfsm.snapshot"

  it("has the events that were received, and no others", function()
    local fsm = started(chart(XY))
    check(fsm, "e_x=a")
    local snap = snapshot.take(fsm)
    assert.same({ ["await(e_x, e_y)@root.a"] = { e_x = true } }, snap.ext.await)
    check(assert(snapshot.restore(chart(XY), snap)), "e_z=a e_y=b")
    local other = started(chart(XY))
    check(other, "e_y=a")
    assert(snapshot.put(other, snap))
    check(other, "e_x=a e_y=b")
    assert.is_nil((snapshot.take(started(chart(XY))).ext or {}).await)
    snap.ext.await["await(e_x, e_y)@root.a"] = 5
    local _, problem = snapshot.restore(chart(XY), snap)
    assert.is_truthy(problem:find("set of events expected", 1, true), problem)
  end)
end)

it("a machine without await has nothing of this extension", function()
  local fsm = helper.init(chart { "e_x" })
  assert.same({}, { fsm._awaits, fsm.a._await })
end)
