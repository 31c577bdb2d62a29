-- An error that no function of the user raised, such as Control-C in a terminal, may
-- end `run` anywhere. Here it does so at every third VM instruction in turn, or at each
-- if EVERY=1. After it the machine must be whole, and go on.

local rfsm = require "rfsm"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local INTERRUPT = "interrupted!"
local EVERY = tonumber(os.getenv("EVERY")) or 3

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

-- Runs f(fsm) and raises INTERRUPT at VM instruction `at`; returns false when f was
-- through before.
local function interrupt(at, f, fsm)
  local is_hit = false
  pcall(function()
    debug.sethook(function()
      debug.sethook()
      is_hit = true
      error(INTERRUPT, 0)
    end, "", at)
    f(fsm)
    debug.sethook()
  end)
  return is_hit
end

-- What is wrong with the machine between two steps; nil when nothing is.
local function defect(fsm)
  local active = {}
  for _, fqn in ipairs(rfsm.get_active_conf(fsm)) do active[fqn] = true end
  local leaf = rfsm.get_actleaf_fqn(fsm)
  if leaf and not active[leaf] then return "the active leaf is no active state" end
  if not leaf and next(active) then return "active without an active leaf" end
  local found = nil
  rfsm.mapfsm(function(s)
    if (rfsm.get_sta_mode(s) ~= "inactive") ~= (active[s._fqn] or false) then
      found = s._fqn .. " is " .. rfsm.get_sta_mode(s)
    end
  end, fsm, rfsm.is_state)
  return found
end

local function send_and_run(fsm)
  rfsm.send_events(fsm, "e_k")
  rfsm.run(fsm)
end

-- The way back is one segment: it is taken without a path.
local function send_and_go_back(fsm)
  send_and_run(fsm)
  rfsm.send_events(fsm, "e_straight")
  rfsm.run(fsm)
end

local function with_interpreter(f)
  local jit = rawget(_G, "jit")
  if not jit then return f() end
  jit.off()
  jit.flush()
  local ok, problem = pcall(f)
  jit.on()
  if not ok then error(problem, 0) end
end

-- Interrupts `advance` everywhere and lets the machine go on.
local function check_everywhere(programs, advance, prepare)
  local at = 1 - EVERY
  repeat
    at = at + EVERY
    local fsm = new_machine(programs)
    if prepare then prepare(fsm) end
    local is_hit = interrupt(at, advance, fsm)
    assert.is_nil(defect(fsm), ("at instruction %d"):format(at))
    send_and_run(fsm)
    assert.is_nil(defect(fsm), ("later, at instruction %d"):format(at))
    assert.is_string(rfsm.get_actleaf_fqn(fsm))
  until not is_hit
  return at
end

describe("an interrupt of run", function()
  for _, programs in ipairs({ false, true }) do
    local with = programs and "with programs" or "without programs"

    it("leaves the machine whole, at the first entry, " .. with, function()
      with_interpreter(function()
        assert.is_true(check_everywhere(programs, rfsm.run) > 100)
      end)
    end)

    it("leaves the machine whole, on a path over a connector, " .. with, function()
      with_interpreter(function()
        assert.is_true(check_everywhere(programs, send_and_run, rfsm.run) > 100)
      end)
    end)

    it("leaves the machine whole where it has a step hook, " .. with, function()
      with_interpreter(function()
        assert.is_true(check_everywhere(programs, send_and_go_back, function(fsm)
          fsm.pre_step_hook = function() end
          rfsm.run(fsm)
        end) > 100)
      end)
    end)

    it("leaves the machine whole, out of a composite, " .. with, function()
      with_interpreter(function()
        assert.is_true(check_everywhere(programs, function(fsm)
          rfsm.send_events(fsm, "e_back")
          rfsm.run(fsm)
        end, function(fsm)
          rfsm.run(fsm)
          send_and_run(fsm)
        end) > 100)
      end)
    end)
  end
end)
