-- Event memory.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_emem = require "rfsm.emem"

local state, trans = rfsm.state, rfsm.trans

-- (initial) -> c[ (initial) -> a --e_next--> b ] --e_out--> out --e_in--> c
local function chart()
  return state {
    warn = false, info = false,
    c = state {
      a = state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_next" } },
    },
    out = state {},
    trans { src = "initial", tgt = "c" },
    trans { src = "c", tgt = "out", events = { "e_out" } },
    trans { src = "out", tgt = "c", events = { "e_in" } },
  }
end

local function started(model)
  local fsm = helper.init(model or chart())
  rfsm.run(fsm)
  return fsm
end

describe("emem", function()
  it("is there in each machine initialised after the module was loaded", function()
    assert.same({}, helper.init(state { emem = nil }).emem)
    assert.same({}, helper.init(chart()).c.b.emem)
  end)

  it("counts the events while a state is active", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_x", "e_x", "e_y")
    helper.post_and_run(fsm, "e_x")
    assert.equal(3, fsm.c.a.emem.e_x)
    assert.equal(1, fsm.c.a.emem.e_y)
  end)

  it("counts for all active states, the root included", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_x")
    assert.equal("1 1 1", fsm.emem.e_x .. " " .. fsm.c.emem.e_x .. " "
      .. fsm.c.a.emem.e_x)
  end)

  it("counts nothing for a state that is not active", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_x")
    assert.is_nil(fsm.c.b.emem.e_x)
  end)

  it("has counted before guards are asked", function()
    local model, seen = chart(), nil
    model.c[2].guard = function(tr)
      seen = tr.src.emem.e_next
      return seen >= 2
    end
    local fsm = started(model)
    helper.post_and_run(fsm, "e_next")
    assert.equal("root.c.a", rfsm.get_actleaf_fqn(fsm))
    helper.post_and_run(fsm, "e_next")
    assert.equal("root.c.b", rfsm.get_actleaf_fqn(fsm))
    assert.equal(2, seen)
  end)

  it("does not count the events that make the state be entered", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_next", "e_x")
    assert.is_nil(fsm.c.b.emem.e_x)
  end)

  it("is set to 0 on exit, in the same table", function()
    local fsm = started()
    local emem = fsm.c.a.emem
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_next")
    assert.equal(emem, fsm.c.a.emem)
    assert.equal(0, emem.e_x)
  end)

  it("of a composite goes on across inner transitions", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_next")
    helper.post_and_run(fsm, "e_x")
    assert.equal(2, fsm.c.emem.e_x)
  end)

  it("can be read by the user's exit", function()
    local model, seen = chart(), nil
    model.c.a.exit = function(_, self) seen = self.emem.e_x end
    local fsm = started(model)
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_next")
    assert.equal(1, seen)
  end)

  it("counts all events of an iteration", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_1", "e_2", "e_3", "e_2", "e_3", "e_3", "e_4")
    local emem = fsm.c.a.emem
    assert.equal("1 2 3 1", emem.e_1 .. " " .. emem.e_2 .. " " .. emem.e_3 .. " "
      .. emem.e_4)
  end)

  it("counts objects by identity", function()
    local fsm, event = started(), {}
    helper.post_and_run(fsm, event, {}, event)
    assert.equal(2, fsm.c.a.emem[event])
  end)

  it("forgets an event with its object", function()
    local fsm = started()
    helper.post_and_run(fsm, {})
    helper.post_and_run(fsm) -- the events table of that iteration goes, too
    collectgarbage()
    local objects = 0
    for key in pairs(fsm.c.a.emem) do
      if type(key) == "table" then objects = objects + 1 end
    end
    assert.equal(0, objects)
  end)

  it("bears an event that is NaN", function()
    local fsm = started()
    helper.post_and_run(fsm, 0 / 0, "e_x")
    assert.equal(1, fsm.c.a.emem.e_x)
  end)

  it("counts what a step hook of the user adds", function()
    local model, is_added = chart(), false
    model.pre_step_hook = function(_, events)
      if is_added then return end
      if #events == 0 then
        is_added = true
        events[1] = "e_added"
      end
    end
    assert.equal(1, started(model).c.a.emem.e_added)
  end)

  it("is set to 0 by reset", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_x")
    rfsm.reset(fsm)
    assert.equal("0 0 0", fsm.emem.e_x .. " " .. fsm.c.emem.e_x .. " "
      .. fsm.c.a.emem.e_x)
  end)

  it("is there for a state that was merged", function()
    local fsm = started()
    rfsm.fsm_merge(fsm, fsm, state {}, "new")
    rfsm.fsm_merge(fsm, fsm, trans { src = "c", tgt = "new", events = { "e_new" } })
    helper.post_and_run(fsm, "e_new")
    helper.post_and_run(fsm, "e_x")
    assert.equal(1, fsm.new.emem.e_x)
  end)

  it("is left out of a state that says false", function()
    local model = chart()
    model.c.a.emem = false
    local fsm = started(model)
    helper.post_and_run(fsm, "e_x")
    assert.is_false(fsm.c.a.emem)
    assert.equal(1, fsm.c.emem.e_x)
  end)

  it("hangs no hook on a state that says false", function()
    local model, is_hooked = chart(), false
    rfsm.mapfsm(function(part) part.emem = false end, model, rfsm.is_state)
    model.emem = nil
    local add = rfsm.exit_hook_add
    rfsm.exit_hook_add = function(fsm, part, f) -- luacheck: ignore 122
      is_hooked = is_hooked or part ~= fsm
      return add(fsm, part, f)
    end
    local fsm = helper.init(model)
    rfsm.exit_hook_add = add -- luacheck: ignore 122
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_x")
    assert.is_false(is_hooked)
    assert.equal(1, fsm.emem.e_x)
  end)

  it("is left out of a machine whose root says false", function()
    local model = chart()
    model.emem = false
    assert.is_nil(started(model).c.emem)
  end)
end)

local function wait()
  while true do rfsm.yield(true) end
end

-- The chart, with a way back from b, and no e_done from the two.
local function circle()
  local model = chart()
  model.c.a.doo, model.c.b.doo = wait, wait
  model.c[3] = trans { src = "b", tgt = "a", events = { "e_next" } }
  return model
end

-- A machine in state a, its counts there, and a function that has a left.
local function counting()
  local fsm = started(circle())
  helper.post_and_run(fsm, "e_x")
  return fsm, fsm.c.a.emem, function() helper.post_and_run(fsm, "e_next") end
end

describe("what a user writes into emem", function()
  it("is counted on, and set to 0 on exit", function()
    local fsm, emem, leave = counting()
    emem.e_x, emem.e_mine, emem[1] = 5, "mine", 7
    helper.post_and_run(fsm, "e_x")
    assert.same({ e_x = 6, e_mine = "mine", [1] = 7 }, emem)
    leave()
    assert.same({ e_x = 0, e_mine = 0, [1] = 0, e_next = 0 }, emem)
  end)

  it("is set to 0 also where it was the first", function()
    local fsm = started(circle())
    local emem = fsm.c.a.emem
    emem[fsm] = 1
    helper.post_and_run(fsm, "e_next")
    assert.same({ [fsm] = 0, e_next = 0 }, emem)
  end)

  it("does not come back when he takes it out", function()
    local fsm, emem, leave = counting()
    emem.e_x = nil
    leave()
    assert.same({ e_next = 0 }, emem)
    helper.post_and_run(fsm, "e_next")
    helper.post_and_run(fsm, "e_x")
    assert.equal(1, emem.e_x)
    leave()
    assert.equal(0, emem.e_x)
  end)

  it("may be a table of his own", function()
    local fsm, _, leave = counting()
    local own = { e_x = 3 }
    fsm.c.a.emem = own
    helper.post_and_run(fsm, "e_x", "e_y")
    assert.same({ e_x = 4, e_y = 1 }, own)
    leave()
    assert.same({ e_x = 0, e_y = 0, e_next = 0 }, own)
  end)

  it("may be a table of his own in a state that said false", function()
    local model = circle()
    model.c.emem = false
    local fsm = started(model)
    fsm.c.emem = {}
    helper.post_and_run(fsm, "e_x")
    assert.same({ e_x = 1 }, fsm.c.emem)
    rfsm.reset(fsm)
    assert.same({ e_x = 0 }, fsm.c.emem)
  end)

  it("may be nothing: the state counts no longer", function()
    local fsm, emem, leave = counting()
    fsm.c.a.emem = false
    helper.post_and_run(fsm, "e_x")
    leave()
    assert.same({ e_x = 1 }, emem)
  end)

  it("may be a metatable, for a 0 in place of nil", function()
    local fsm, emem, leave = counting()
    setmetatable(emem, { __index = function() return 0 end })
    helper.post_and_run(fsm, "e_y")
    assert.equal("1 0", emem.e_y .. " " .. emem.e_none)
    leave()
    assert.equal("0 0", rawget(emem, "e_y") .. " " .. rawget(emem, "e_next"))
  end)
end)

describe("the list of what is counted", function()
  it("does not grow when counts are taken out again and again", function()
    local fsm, emem = counting()
    for _ = 1, 100 do
      emem.e_x, emem.e_y = nil, nil
      helper.post_and_run(fsm, "e_x", "e_y")
    end
    assert.is_true(#getmetatable(emem) < 10)
  end)
end)

-- The same with `pairs`: what emem is to be after a random life.
local EVENTS = { "e_x", "e_y", "e_z", 1, true, {}, {} }

local function note_events(expected, events)
  for i = 1, #events do expected[events[i]] = (expected[events[i]] or 0) + 1 end
end

local function forget(expected)
  for event in pairs(expected) do expected[event] = 0 end -- any order: all of them
end

local ACTIONS = {
  function(fsm, expected, event)
    helper.post_and_run(fsm, event)
    note_events(expected, { event })
  end,
  function(fsm, expected, event)
    local events = { event, "e_y", event, EVENTS[1] }
    helper.post_and_run(fsm, event, "e_y", event, EVENTS[1])
    note_events(expected, events)
  end,
  function(fsm, expected, event) fsm.c.a.emem[event], expected[event] = 3, 3 end,
  function(fsm, expected, event) fsm.c.a.emem[event], expected[event] = nil, nil end,
  function(fsm, expected)
    rfsm_emem.emem_reset(fsm.c.a)
    forget(expected)
  end,
  function(fsm, expected)
    helper.post_and_run(fsm, "e_next")
    helper.post_and_run(fsm, "e_next")
    note_events(expected, { "e_next" })
    forget(expected)
  end,
}

describe("counts", function()
  local seed = tonumber(os.getenv("SEED")) or 1
  it(("are those of a table without a list, SEED=%d"):format(seed), function()
    local fsm, expected, random = started(circle()), {}, seed
    local function next_random(n)
      random = (random * 16807) % 2147483647
      return random % n + 1
    end
    for i = 1, 2000 do
      local action = next_random(#ACTIONS)
      ACTIONS[action](fsm, expected, EVENTS[next_random(#EVENTS)])
      assert.same(expected, fsm.c.a.emem, ("after %d actions"):format(i))
    end
  end)
end)

describe("emem_reset", function()
  it("sets the counts of a state to 0", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_x")
    rfsm_emem.emem_reset(fsm.c.a)
    assert.equal(0, fsm.c.a.emem.e_x)
  end)

  it("leaves other states alone", function()
    local fsm = started()
    helper.post_and_run(fsm, "e_x")
    rfsm_emem.emem_reset(fsm.c.a)
    assert.equal(1, fsm.c.emem.e_x)
  end)

  it("blames the caller for anything else", function()
    local _, text = pcall(function() rfsm_emem.emem_reset(nil) end)
    assert.matches("emem_spec.lua:%d+: rfsm.emem.emem_reset: state with an event "
      .. "memory expected, got nil", text)
  end)
end)
