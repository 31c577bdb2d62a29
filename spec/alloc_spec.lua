-- In steady state an event costs no garbage. With the JIT off and on: its traces would
-- count, and allocations that it sinks would not.

local measure = require "bench.measure"
local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"
local workloads = require "bench.workloads"

local jit = rawget(_G, "jit")

-- The least of three: LuaJIT may still be compiling something.
local function bytes_grown(subject)
  subject(25000) -- W7: each of its machines has been in each of its states
  local least = math.huge
  for _ = 1, 3 do least = math.min(least, measure.bytes_grown(subject, 1000)) end
  return least
end

local function with_jit(mode, f)
  if not jit then return f() end
  jit[mode]()
  jit.flush()
  local result = f()
  jit.on()
  return result
end

-- The module, but guards and effects promise not to keep the list of events. The hooks
-- of extensions, which another spec may have loaded, are left out.
local borrowing = setmetatable({
  state = function(t)
    t.emem, t.checkevents = false, false
    return rfsm.state(t)
  end,
  trans = function(t)
    if t.guard then rfsm.borrows(t.guard) end
    if t.effect then rfsm.borrows(t.effect) end
    return rfsm.trans(t)
  end,
}, { __index = rfsm })

local FREE_OF_GARBAGE = {
  W1 = true, W1r = true, W2 = true, W3 = true, W4 = true, W5 = true, W7 = true,
}

describe("an event", function()
  for _, workload in ipairs(workloads) do
    if FREE_OF_GARBAGE[workload.name] then
      for _, mode in ipairs(jit and { "off", "on" } or { "on" }) do
        it(("costs no garbage on %s, JIT %s #alloc"):format(workload.name, mode),
          function()
            local grown = with_jit(mode, function()
              return bytes_grown((workload.make(borrowing, 100)))
            end)
            assert.is_true(grown < 1000, grown .. " bytes in 1,000 events")
          end)
      end
    end
  end
end)

-- A machine that goes round a and b.
local function circle(fields)
  local model = rfsm.state {
    warn = false, info = false, emem = false, checkevents = false,
    a = rfsm.state {}, b = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "b", events = { "e_next" } },
    rfsm.trans { src = "b", tgt = "a", events = { "e_next" } },
  }
  for name, value in pairs(fields) do model[name] = value end -- any order: a set
  local fsm = assert(rfsm.init(model))
  rfsm.run(fsm)
  return measure.stepping(rfsm, fsm, "e_next")
end

local EXTENSIONS = { ["rfsm.emem"] = "emem", ["rfsm.checkevents"] = "checkevents" }

-- What a step hook costs is the core's.
local function nothing() end

describe("a list of events", function()
  local function kept_by(fields, hook)
    return bytes_grown(circle { [fields] = hook })
  end

  it("is a new one for an iteration whose hook may have kept it #alloc", function()
    local function measured() return kept_by("pre_step_hook", nothing) end
    local grown = with_jit("off", measured)
    assert.is_true(grown > 20000)
  end)

  for _, slot in ipairs { "pre_step_hook", "post_step_hook" } do
    it(("is used again if the %s borrows it #alloc"):format(slot), function()
      local hook = rfsm.borrows(function() end)
      local grown = with_jit("off", function() return kept_by(slot, hook) end)
      assert.is_true(grown < 1000, grown .. " bytes in 1,000 events")
    end)
  end

  it("is not asked of what cannot be called", function()
    assert.has_error(function() rfsm.borrows(5) end,
      "rfsm.borrows: function expected, got number 5")
  end)
end)

describe("an event with", function()
  for module, field in pairs(EXTENSIONS) do -- any order: each stands alone
    for _, mode in ipairs(jit and { "off", "on" } or { "on" }) do
      it(("%s costs no more garbage than one with a hook that does nothing, JIT %s "
        .. "#alloc"):format(module, mode), function()
        require(module)
        local hooked = with_jit(mode, function()
          return bytes_grown(circle { pre_step_hook = nothing })
        end)
        local grown = with_jit(mode, function()
          return bytes_grown(circle { [field] = true })
        end)
        assert.is_true(grown < hooked + 1000, grown .. " bytes in 1,000 events, "
          .. hooked .. " with a hook")
      end)
    end
  end
end)

describe("a timer", function()
  -- Garbage of 1,000 events in a ring whose states have a timer: it fires each time, or
  -- another event comes first.
  local function grown_with(event, fires)
    local now = 0
    local model = { warn = false, info = false, emem = false, checkevents = false,
      gettime = function() return now, 0 end, a = rfsm.state {}, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { event, "e" } },
      rfsm.trans { src = "b", tgt = "a", events = { event, "e" } } }
    local fsm = assert(rfsm.init(rfsm.state(model)))
    rfsm.run(fsm)
    return with_jit("off", function()
      return bytes_grown(function(n)
        for _ = 1, n do
          now = fires and now + 2 or now
          if not fires then rfsm.send_events(fsm, "e") end
          rfsm.run(fsm)
        end
      end)
    end)
  end

  local function one() return 1 end

  it("leaves one list when it fires #alloc", function()
    local grown = grown_with("e_after(1)", true)
    assert.is_true(grown > 0 and grown < 100 * 1000, grown .. " bytes")
  end)

  it("leaves nothing when it is armed, a function one list #alloc", function()
    local grown = grown_with("e_after(1)", false)
    assert.is_true(grown < 5000, grown .. " bytes")
    grown = grown_with(timeevent.e_after(one), false)
    assert.is_true(grown < 100 * 1000, grown .. " bytes")
  end)
end)

-- Who gets the list of events may keep it: it is not used again then.
describe("the list of events", function()
  local KEEPERS = {
    pre_step_hook = function(fsm, keep) fsm.pre_step_hook = keep end,
    post_step_hook = function(fsm, keep) fsm.post_step_hook = keep end,
    pre_step_hook_add = rfsm.pre_step_hook_add,
    post_step_hook_add = rfsm.post_step_hook_add,
    guard = function(fsm, keep)
      for i = 2, 3 do fsm[i].guard = keep end
    end,
    effect = function(fsm, keep)
      for i = 2, 3 do
        fsm[i].effect = function(_, tr, _, events) keep(tr, events) end
      end
    end,
  }
  for _, name in ipairs(rfsm.sorted_keys(KEEPERS)) do
    it("may be kept by " .. name, function()
      local fsm = assert(rfsm.init(rfsm.state {
        warn = false, info = false, a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_b" } },
        rfsm.trans { src = "b", tgt = "a", events = { "e_a" } },
      }))
      rfsm.run(fsm)
      local kept, sent = {}, {}
      KEEPERS[name](fsm, function(_, events) kept[#kept + 1] = events end)
      for i = 1, 20 do
        sent[i] = i % 2 == 1 and "e_b" or "e_a"
        rfsm.send_events(fsm, sent[i])
        rfsm.step(fsm)
      end
      for i, events in ipairs(kept) do kept[i] = events[#events] end
      assert.same(sent, kept)
    end)
  end
end)
