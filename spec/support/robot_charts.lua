-- Forty charts in the style of those in real robots: ten kinds in four sizes each.

local rfsm = require "rfsm"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

-- Adds transitions from a text: "idle -e_go-> drive; drive -e_stop-> idle".
local function linked(model, text)
  for src, events, tgt in text:gmatch("([%w_.]+) %-([%w_, ]*)%-?> ([%w_.]+)") do
    local list = {}
    for event in events:gmatch("[%w_]+") do list[#list + 1] = event end
    model[#model + 1] = trans { src = src, tgt = tgt, events = list }
  end
  return model
end

local function states(text)
  local model = state { info = false, warn = false }
  for name in text:gmatch("[%w_]+") do model[name] = state { entry = print } end
  return model
end

-- Adds a chain of states in front of a state, each with a way to `fault`.
local function chain(model, names, count, last, fault)
  local before = "initial"
  for i = 1, count do
    local name = names[i]
    model[name] = state { entry = print, exit = i % 2 == 0 and print or nil }
    linked(model, ("%s -%s-> %s"):format(before, before ~= "initial" and "e_done" or "",
      name))
    if fault then linked(model, ("%s -e_fault-> %s"):format(name, fault)) end
    before = name
  end
  return linked(model, ("%s -%s-> %s"):format(before, before ~= "initial" and "e_done"
    or "", last))
end

local STEPS = { "boot", "selftest", "calibrate", "home", "load_map", "localise", "arm" }

local kinds = {}

-- A mobile base: start, then modes around an idle state, and a fault.
function kinds.base(size)
  local model = states "idle drive fault"
  chain(model, STEPS, size + 1, "idle", "fault")
  linked(model, "idle -e_goal-> drive; drive -e_reached, e_cancel-> idle; "
    .. "drive -e_fault-> fault; fault -e_reset-> boot")
  for i = 1, size do
    model["mode" .. i] = state { entry = print }
    linked(model, ("idle -e_mode%d-> mode%d; mode%d -e_back-> idle; "
      .. "mode%d -e_fault-> fault"):format(i, i, i, i))
  end
  return model
end

-- An arm that picks and places: the work is a composite with a way out of each state.
function kinds.arm(size)
  local model = states "standby error"
  model.work = chain(states "place", { "approach", "grasp", "lift", "carry", "align" },
    size + 1, "place")
  linked(model.work, "place -e_next-> approach; grasp -e_slipped-> approach")
  return linked(model, "initial -> standby; standby -e_start-> work; "
    .. "work -e_stop-> standby; work -e_error-> error; error -e_clear-> standby; "
    .. ".work.grasp -e_lost-> error")
end

-- A drone: flight is nested in flight, and each depth has a way to land.
function kinds.drone(size)
  local inner = linked(states "hover follow search",
    "initial -> hover; hover -e_target-> follow; follow -e_lost-> search; "
    .. "search -e_target-> follow; search -e_timeout-> hover")
  for i = 1, size do
    local outer = states "climb descend"
    outer.level = inner
    inner = linked(outer, "initial -> climb; climb -e_height-> level; "
      .. ("level -e_down%d-> descend; descend -e_up%d-> level"):format(i, i))
  end
  local model = states "ground landing"
  model.flight = inner
  return linked(model, "initial -> ground; ground -e_arm-> flight; "
    .. "flight -e_battery, e_land-> landing; landing -e_touch-> ground; "
    .. "landing -e_abort-> flight")
end

-- A tool with many programs around a hub, and an alarm.
function kinds.tool(size)
  local model = linked(states "ready alarm", "initial -> ready; alarm -e_ack-> ready")
  for i = 1, 2 * size + 1 do
    model["program" .. i] = state { entry = print }
    linked(model, ("ready -e_p%d-> program%d; program%d -e_end-> ready; "
      .. "program%d -e_alarm-> alarm"):format(i, i, i, i))
  end
  return model
end

-- A lift: floors in a row, up and down.
function kinds.lift(size)
  local model = linked(states "floor1 stuck", "initial -> floor1")
  for i = 2, size + 3 do
    model["floor" .. i] = state { entry = print }
    linked(model, ("floor%d -e_up-> floor%d; floor%d -e_down-> floor%d; "
      .. "floor%d -e_stuck-> stuck"):format(i - 1, i, i, i - 1, i))
  end
  return linked(model, "stuck -e_free-> floor1")
end

-- A controller with a connector that chooses, and loops.
function kinds.controller(size)
  local model = linked(states "wait hold", "initial -> wait; wait -e_ping-> wait; "
    .. "hold -e_ping-> hold; hold -e_free-> wait")
  model.choose = conn {}
  linked(model, "wait -e_job-> choose; choose -> hold")
  for i = 1, size + 1 do
    model["job" .. i] = state { entry = print }
    linked(model, ("choose -> job%d; job%d -e_done-> wait; job%d -e_hold-> hold; "
      .. "job%d -e_again-> job%d"):format(i, i, i, i, i))
  end
  return model
end

-- A patrol: a ring of places with work at each.
function kinds.patrol(size)
  local model = states "dock"
  for i = 1, size + 2 do
    model["place" .. i] = chain(states "scan", { "go", "turn" }, i % 2 + 1, "scan")
    linked(model, ("%s -e_next-> place%d; place%d -e_low-> dock"):format(
      i > 1 and "place" .. i - 1 or "dock", i, i))
  end
  return linked(model, ("initial -> dock; place%d -e_next-> place1"):format(size + 2))
end

-- Two arms side by side, with the machine around them.
function kinds.arms(size)
  local model = states "off pause"
  local function arm(count)
    return linked(chain(states "done", STEPS, count, "done"), "done -e_again-> boot")
  end
  model.arms = rfsm.seqand { left = arm(size), right = arm(size + 1) }
  return linked(model, "initial -> off; off -e_on-> arms; arms -e_pause-> pause; "
    .. "pause -e_on-> arms; arms -e_off-> off")
end

-- A protocol: states that nearly all lead to each other.
function kinds.protocol(size)
  local model, count = linked(states "closed", "initial -> closed"), size + 3
  for i = 1, count do
    model["phase" .. i] = state { entry = print }
    linked(model, ("%s -e_open-> phase%d; phase%d -e_close-> closed"):format(
      i > 1 and "phase" .. i - 1 or "closed", i, i))
    linked(model, ("phase%d -e_x%d-> phase%d"):format(i, i, i * i % count + 1))
  end
  return model
end

-- A machine with recovery at two depths, entered and left across the frames.
function kinds.recovery(size)
  local model = states "safe"
  model.run = states "slow"
  model.run.task = chain(states "finish", { "plan", "move", "check", "adjust", "weld" },
    size + 1, "finish")
  linked(model.run, "initial -> task; task -e_slow-> slow; slow -e_fast-> task; "
    .. "slow -e_check-> .task.plan")
  return linked(model, "initial -> run; run -e_stop-> safe; safe -e_go-> run; "
    .. "safe -e_resume-> .run.task.move; .run.task.plan -e_bad-> safe; "
    .. ".run.slow -e_bad-> safe")
end

local robots = {}

for _, name in ipairs { "base", "arm", "drone", "tool", "lift", "controller", "patrol",
  "arms", "protocol", "recovery" } do
  for size = 1, 4 do
    robots[#robots + 1] = { name = name .. " " .. size, kind = name, size = size }
  end
end

--- Return the model of one of the charts.
function robots.model(robot) return kinds[robot.kind](robot.size) end

return robots
