-- An error that no function of the user raised, such as Control-C in a terminal, may
-- strike anywhere. Here it does so at every 37th VM instruction in turn (the share of
-- this Lua), or at each if EVERY=1. It reaches the caller as itself; after that the
-- machine goes on, and ends where it would have ended.

local rfsm = require "rfsm"
local share = require "spec.support.share"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local INTERRUPT = "interrupted!"
local EVERY, FIRST = share.every(tonumber(os.getenv("EVERY")) or 37)
local LIMIT = 1e6 -- instructions: more than any of these runs needs

-- a.b.c --e_k--> k --> d.e (doo: one cycle, then done) --e_back--> a,
-- d --e_straight--> a.b.c
local function new_machine(programs)
  local function program() return programs and function() end or nil end
  local function busy(fields)
    fields.entry, fields.exit = program(), program()
    return state(fields)
  end
  return assert(rfsm.init(state {
    info = false, warn = false, err = function() end,
    a = busy {
      b = busy {
        c = busy {}, trans { src = "initial", tgt = "c" },
      },
      trans { src = "initial", tgt = "b" },
    },
    d = busy {
      e = busy { doo = function() rfsm.yield(true) end },
      trans { src = "initial", tgt = "e" },
    },
    k = conn {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a.b.c", tgt = "k", events = "e_k", effect = program() },
    trans { src = "k", tgt = "d", guard = program(), effect = program() },
    trans { src = "d", tgt = "a", events = "e_back" },
    trans { src = "d", tgt = "root.a.b.c", events = "e_straight" },
  }))
end

-- An interrupt while rfsm/fast.lua is being loaded would leave it at that.
local warm = new_machine()
for _ = 1, 10 do
  rfsm.send_events(warm, "e_k", "e_back")
  rfsm.run(warm)
end
assert(package.loaded["rfsm.fast"])

-- Runs f(fsm) and raises INTERRUPT after `at` VM instructions; returns false when f was
-- through before, else what reached the caller.
local function interrupt(at, f, fsm)
  local is_hit = false
  local _, failure = pcall(function()
    debug.sethook(function()
      debug.sethook()
      is_hit = true
      error(INTERRUPT, 0)
    end, "", at)
    f(fsm)
    debug.sethook()
  end)
  return is_hit and tostring(failure)
end

-- Runs f(fsm), which must end by itself.
local function within_limit(f, fsm)
  local failure = interrupt(LIMIT, f, fsm)
  assert(not failure, "it does not end")
end

-- What is wrong with the machine between two steps; nil when nothing is.
local function defect(fsm)
  local active, found = {}, nil
  for _, fqn in ipairs(rfsm.get_active_conf(fsm)) do active[fqn] = true end
  local leaf = rfsm.get_actleaf_fqn(fsm)
  if not leaf or not active[leaf] then return "the active leaf is no active state" end
  rfsm.mapfsm(function(s)
    if (rfsm.get_sta_mode(s) ~= "inactive") ~= (active[s._fqn] or false) then
      found = s._fqn .. " is " .. rfsm.get_sta_mode(s)
    end
  end, fsm, rfsm.is_state)
  return found
end

local function sending(event, advance)
  return function(fsm)
    rfsm.send_events(fsm, event)
    advance(fsm)
  end
end

local function twice(fsm) rfsm.step(fsm, 2) end

local function with_hook(fsm)
  fsm.pre_step_hook = function() end
  rfsm.run(fsm)
end

local function with_state_hook(fsm)
  rfsm.entry_hook_add(fsm, fsm.d, function() end)
  rfsm.run(fsm)
end

local function traced(fsm)
  fsm.dbg = function() end
  rfsm.run(fsm)
end

local function in_d(fsm)
  rfsm.run(fsm)
  rfsm.send_events(fsm, "e_k")
  rfsm.run(fsm)
end

local function nothing() end

local CASES = {
  { "at the first entry", nothing, rfsm.run },
  { "of a bare step at the first entry", nothing, rfsm.step },
  { "on a path over a connector", rfsm.run, rfsm.run, "e_k", "root.d.e" },
  { "of a bare step", rfsm.run, rfsm.step, "e_k", "root.d.e" },
  { "of two steps", rfsm.run, twice, "e_k", "root.d.e" },
  { "where there is a step hook", with_hook, rfsm.run, "e_k", "root.d.e" },
  { "where there is a state hook", with_state_hook, rfsm.run, "e_k", "root.d.e" },
  { "of a traced run", traced, rfsm.run, "e_k", "root.d.e" },
  { "out of a composite", in_d, rfsm.run, "e_back" },
  { "of one segment", in_d, rfsm.step, "e_straight" },
  { "in a doo", in_d, rfsm.step },
}

-- Interrupts the case everywhere and lets the machine go on.
local function check_everywhere(case, programs)
  local prepare, advance, event, leaf = case[2], case[3], case[4], case[5]
  local at, failure = FIRST - EVERY, false
  if event then advance = sending(event, advance) end
  while failure ~= nil do
    at = at + EVERY
    local fsm = new_machine(programs)
    prepare(fsm)
    failure = interrupt(at, advance, fsm) or nil
    local where = ("at instruction %d"):format(at)
    if failure then assert.equal(INTERRUPT, failure, where) end
    local is_between = event and not rfsm.get_actleaf_fqn(fsm)
    if is_between then assert(fsm._phase ~= "idle", where) end
    within_limit(rfsm.run, fsm)
    assert.is_nil(defect(fsm), where)
    if leaf and rfsm.get_actleaf_fqn(fsm) ~= leaf then -- it was not even sent
      within_limit(sending(event, rfsm.run), fsm)
    end
    if leaf then assert.equal(leaf, rfsm.get_actleaf_fqn(fsm), where) end
  end
end

local function with_interpreter(f, ...)
  local jit = rawget(_G, "jit")
  if not jit then return f(...) end
  jit.off()
  jit.flush()
  local ok, problem = pcall(f, ...)
  jit.on()
  if not ok then error(problem, 0) end
end

describe("an interrupt", function()
  for _, case in ipairs(CASES) do
    it("leaves a machine that goes on, " .. case[1], function()
      for _, programs in ipairs({ false, true }) do
        with_interpreter(check_everywhere, case, programs)
      end
    end)
  end

  it("of an entry that never ends reaches the caller", function()
    local fsm = assert(rfsm.init(state {
      info = false, warn = false, a = state {}, b = state { entry = function()
        while true do nothing() end
      end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = "e" },
    }))
    rfsm.run(fsm)
    with_interpreter(function()
      assert.equal(INTERRUPT, interrupt(50000, sending("e", rfsm.run), fsm))
    end)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)
