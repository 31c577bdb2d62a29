-- A deployer brings up the components of a robot. Any of its programs may fail, and no
-- state says so: a failure is the event e_fault, which leads to one place.
--
--   (initial) --> +- deploying ---------------------------------------+
--                 | (initial) --> loading --e_done--> configuring      |
--                 |                                       | e_done     |
--                 |               running <--e_done-- starting         |
--                 +------|--------------------------------------------+
--                        +--e_fault, e_stop--> stopping --e_done--> down --e_up-->
--                                                                  deploying
--
-- In rfsm-sim:  run()  robot.broken = "arm"  ser("e_stop")  ser("e_up")

-- luacheck: globals robot

local rfsm = require "rfsm"
require "rfsm.faults"

local COMPONENTS = { "arm", "camera" }

---@type { broken: string|false }
robot = { broken = false } -- global, for you to break

local function call(component, operation)
  if operation == "start" and robot.broken == component then
    error(component .. ": no answer to " .. operation, 0)
  end
  print(component .. " " .. operation)
end

local function each(operation)
  return function()
    for _, component in ipairs(COMPONENTS) do call(component, operation) end
  end
end

local function tell(_, _, _, _, event)
  print(type(event) == "table" and event.element .. ": " .. event.message or event)
end

return rfsm.state { err = false, info = false,
  deploying = rfsm.state {
    loading = rfsm.state { entry = each "load" },
    configuring = rfsm.state { entry = each "configure" },
    starting = rfsm.state { entry = each "start" },
    running = rfsm.state {},

    rfsm.trans { src = "initial", tgt = "loading" },
    rfsm.trans { src = "loading", tgt = "configuring", events = { "e_done" } },
    rfsm.trans { src = "configuring", tgt = "starting", events = { "e_done" } },
    rfsm.trans { src = "starting", tgt = "running", events = { "e_done" } },
  },
  stopping = rfsm.state { entry = each "stop" },
  down = rfsm.state {},

  rfsm.trans { src = "initial", tgt = "deploying" },
  rfsm.trans { src = "deploying", tgt = "stopping", events = { "e_fault", "e_stop" },
    effect = tell },
  rfsm.trans { src = "stopping", tgt = "down", events = { "e_done" } },
  rfsm.trans { src = "down", tgt = "deploying", events = { "e_up" } },
}
