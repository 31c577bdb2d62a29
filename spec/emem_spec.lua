-- Event memory.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_emem = require "rfsm_emem"

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

  it("counts objects by identity", function()
    local fsm, event = started(), {}
    helper.post_and_run(fsm, event, {}, event)
    assert.equal(2, fsm.c.a.emem[event])
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
    assert.matches("emem_spec.lua:%d+: rfsm_emem.emem_reset: state with an event "
      .. "memory expected, got nil", text)
  end)
end)
