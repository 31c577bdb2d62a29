-- Await: transitions that wait for several events.

local helper = require "spec.helper"
local rfsm = require "rfsm"
require "rfsm.await"

local state, trans = rfsm.state, rfsm.trans

-- (initial) -> a --events--> b --e_back--> a
local function chart(events)
  return state {
    warn = false, info = false, a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = events },
    trans { src = "b", tgt = "a", events = { "e_back" } },
  }
end

local function started(model)
  local fsm = helper.init(model)
  rfsm.run(fsm)
  return fsm
end

-- Where the machine is after each of the events in turn.
local function path_of(fsm, ...)
  local names = {}
  for i, event in ipairs { ... } do
    helper.post_and_run(fsm, event)
    names[i] = fsm._act_leaf._id
  end
  return table.concat(names, " ")
end

describe("await", function()
  for _, text in ipairs {
    "await('e_x', 'e_y')", 'await("e_x","e_y")', "await( e_x , 'e_y' )",
  } do
    it("may be written " .. text, function()
      local fsm = started(chart { text })
      assert.same({ "await(e_x, e_y)@root.a" }, fsm[2].events)
      assert.equal("a b", path_of(fsm, "e_y", "e_x"))
    end)
  end

  it("is enabled when all were received, over several steps", function()
    assert.equal("a a b", path_of(started(chart { "await(e_x, e_y)" }), "e_x", "e_z",
      "e_y"))
  end)

  it("is enabled when all come in one step", function()
    local fsm = started(chart { "await(e_x, e_y, e_z)" })
    helper.post_and_run(fsm, "e_z", "e_x", "e_y")
    assert.equal("b", fsm._act_leaf._id)
  end)

  it("takes the events in any order", function()
    assert.equal("a b", path_of(started(chart { "await(e_x,e_y)" }), "e_y", "e_x"))
  end)

  it("does not take one event for two", function()
    assert.equal("a a a", path_of(started(chart { "await(e_x, e_y)" }), "e_x", "e_x",
      "e_x"))
  end)

  it("of one event is that event", function()
    assert.equal("b", path_of(started(chart { "await(e_x)" }), "e_x"))
  end)

  it("may be the only event, as a string", function()
    assert.equal("a b", path_of(started(chart("await(e_x, e_y)")), "e_x", "e_y"))
  end)

  it("bears the name of its source", function()
    assert.same({ "await(e_x, e_y)@root.a" },
      started(chart { "await( e_x,e_y )" })[2].events)
  end)

  it("leaves alternatives in the same list alone", function()
    assert.equal("b", path_of(started(chart { "await(e_x, e_y)", "e_z" }), "e_z"))
  end)

  it("leaves predicates in the same list alone", function()
    local function is_z(event) return event == "e_z" end
    assert.equal("a b", path_of(started(chart { "await(e_x, e_y)", is_z }), "e_x",
      "e_z"))
  end)

  it("takes e_done for that of its source", function()
    local model = chart { "await(e_done, e_x)" }
    assert.equal("b", path_of(started(model), "e_x"))
  end)

  it("waits for an e_done that comes last", function()
    local model = chart { "await(e_done, e_x)" }
    model.a.doo = function()
      rfsm.yield(true)
      rfsm.yield(true)
    end
    local fsm = started(model)
    helper.post_and_run(fsm, "e_x")
    assert.equal("a", fsm._act_leaf._id)
    rfsm.run(fsm)
    rfsm.run(fsm)
    assert.equal("b", fsm._act_leaf._id)
  end)

  it("forgets when the source is left", function()
    local model = chart { "await(e_x, e_y)" }
    model[4] = trans { src = "a", tgt = "b", events = { "e_skip" } }
    assert.equal("a b a a b", path_of(started(model), "e_x", "e_skip", "e_back", "e_y",
      "e_x"))
  end)

  it("does not count what came before the source was entered", function()
    assert.equal("a b b a a b", path_of(started(chart { "await(e_x, e_y)" }), "e_x",
      "e_y", "e_x", "e_back", "e_y", "e_x"))
  end)

  it("stays enabled while a guard inhibits", function()
    local model, is_open = chart { "await(e_x, e_y)" }, false
    model[2].guard = function() return is_open end
    local fsm = started(model)
    assert.equal("a a", path_of(fsm, "e_x", "e_y"))
    is_open = true
    assert.equal("b", path_of(fsm, "e_z"))
  end)

  it("does not fire without an event", function()
    local model, is_open = chart { "await(e_x, e_y)" }, false
    model[2].guard = function() return is_open end
    local fsm = started(model)
    helper.post_and_run(fsm, "e_x", "e_y")
    is_open = true
    rfsm.run(fsm)
    assert.equal("a", fsm._act_leaf._id)
  end)

  it("of a composite goes on across inner transitions", function()
    local model = chart { "await(e_x, e_y)" }
    model.a = state {
      p = state {}, q = state {}, trans { src = "initial", tgt = "p" },
      trans { src = "p", tgt = "q", events = { "e_x" } },
    }
    assert.equal("q b", path_of(started(model), "e_x", "e_y"))
  end)

  it("at two transitions of a state is one", function()
    local model, taken = chart { "await(e_x, e_y)" }, nil
    model[4] = trans { src = "a", tgt = "b", events = { "await(e_x, e_y)" }, pn = 1,
      effect = function(_, _, _, events) taken = events end }
    path_of(started(model), "e_x", "e_y")
    assert.same({ "e_y", "await(e_x, e_y)@root.a" }, taken)
  end)

  it("tells dbg when it is complete", function()
    local fsm, records = started(chart { "await(e_x, e_y)" }), {}
    fsm.dbg = function(id, text)
      if id == "AWAIT" then records[#records + 1] = text end
    end
    path_of(fsm, "e_x", "e_y")
    assert.same({ "await(e_x, e_y)@root.a" }, records)
  end)

  it("forgets at reset", function()
    local fsm = started(chart { "await(e_x, e_y)" })
    path_of(fsm, "e_x")
    rfsm.reset(fsm)
    rfsm.run(fsm)
    assert.equal("a b", path_of(fsm, "e_y", "e_x"))
  end)

  it("may be merged into a live machine", function()
    local fsm = started(chart { "e_z" })
    rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "b",
      events = { "await(e_x, e_y)" } })
    assert.equal("a b", path_of(fsm, "e_x", "e_y"))
  end)

  it("leaves the model as it is", function()
    local model = chart { "await(e_x, e_y)" }
    started(model)
    assert.same({ "await(e_x, e_y)" }, model[2].events)
  end)
end)

describe("an await that is wrong", function()
  local WRONG = { "await()", "await(e_x,)", "await(e_x", "await(await(e_x), e_y)" }
  for _, text in ipairs(WRONG) do
    it("is a problem of the model: " .. text, function()
      local model = chart { text }
      model.err = false
      local _, problems = rfsm.init(model)
      assert.equal(1, #problems)
      assert.equal("root.trans[2].events[1] (a -> b): await: a list of events "
        .. "expected, got '" .. text .. "' (await(e_a, e_b) would be right)",
        helper.without_file(problems[1]))
    end)
  end

  local function first_warning(model)
    local said = {}
    model.warn = function(text) said[#said + 1] = text end
    rfsm.init(model)
    return helper.without_file(said[1])
  end

  it("at a connector brings a warning", function()
    local model = chart { "e_x" }
    model[1].events = { "e_init_fsm", "await(e_x, e_y)" }
    assert.equal("WARNING: root.trans[1].events (initial -> a): 'await(e_x, e_y)' "
      .. "never fires here, 'root.initial' is no state", first_warning(model))
  end)

  it("with the e_done of a composite brings a warning", function()
    local model = chart { "await(e_x, e_done)" }
    model.a = state { p = state {}, trans { src = "initial", tgt = "p" } }
    assert.equal("WARNING: root.trans[2].events (a -> b): 'e_done' never fires here, "
      .. "'root.a' is no leaf state", first_warning(model))
  end)
end)

describe("with time events", function()
  -- whichever of the two modules is loaded first
  local timeevent = require "rfsm_timeevent"

  for _, text in ipairs { "await(e_x, e_after(5))", "await('e_x', 'e_after(5)')" } do
    it("await waits for them, too: " .. text, function()
      local now = 0
      timeevent.set_gettime_hook(function() return now, 0 end)
      local fsm = started(chart { text })
      assert.same({ "await(e_x, e_after(5)@root.a)@root.a" }, fsm[2].events)
      helper.post_and_run(fsm, "e_x")
      assert.equal("a", fsm._act_leaf._id)
      now = 6
      rfsm.run(fsm)
      assert.equal("b", fsm._act_leaf._id)
    end)
  end
end)

describe("a machine without await", function()
  it("has nothing of this extension", function()
    local fsm = helper.init(chart { "e_x" })
    assert.is_nil(fsm._has_await)
    assert.is_nil(fsm.a._await)
  end)
end)
