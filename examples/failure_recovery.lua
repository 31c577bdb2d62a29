-- A total failure and its recovery: the entry of `working` fails. The error is
-- reported, the machine stays consistent, and goes to `safe` until it is repaired.
--
--   (initial) --> +- robot ------------------------------------------+
--                 | (initial) --> working --e_fault--> safe           |
--                 |                  ^                  |             |
--                 |                  +-----e_repaired---+             |
--                 +------|--------------------------------------------+
--                        +--e_emergency--> dead      whatever is active in robot
--
-- In rfsm-sim:  run()  motor.is_broken = false  ser("e_repaired")  ser("e_emergency")

-- luacheck: globals motor

local rfsm = require "rfsm"

motor = { is_broken = true } -- global, for you to repair

local function says(text) return function() print(text) end end

local function start_motor()
  if motor.is_broken then error("motor does not turn", 0) end
  print("motor turns")
end

-- The entry itself may fail; what follows from that is said here, not there.
local function start_or_tell(fsm)
  local ok, problem = pcall(start_motor)
  if ok then return end
  rfsm.send_events(fsm, "e_fault")
  error(problem, 0) -- reported as the failure of this entry
end

local robot = rfsm.state {
  working = rfsm.state { entry = start_or_tell, exit = says("motor off") },
  safe = rfsm.state { entry = says("brakes on"), exit = says("brakes off") },

  rfsm.trans { src = "initial", tgt = "working" },
  rfsm.trans { src = "working", tgt = "safe", events = { "e_fault" } },
  rfsm.trans { src = "safe", tgt = "working", events = { "e_repaired" } },
}

return rfsm.state {
  err = function(_, ...) print("failure: ", ...) end,

  robot = robot,
  dead = rfsm.state { entry = says("power cut"), final = true },

  rfsm.trans { src = "initial", tgt = "robot" },
  rfsm.trans { src = "robot", tgt = "dead", events = { "e_emergency" } },
}
