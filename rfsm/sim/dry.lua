--- Dry: a machine without the functions of its chart.
--
-- @module rfsm.sim.dry
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs = ipairs

local dry = {}

local ROOT_FIELDS = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook" }

-- The doo in place of another: it goes on until its state is left.
local function idle()
  while true do rfsm.yield(true) end
end

local function let_pass() return true end

local function put(saved, obj, field, value)
  if not obj[field] then return end
  saved[#saved + 1] = { obj = obj, field = field, value = obj[field] }
  obj[field] = value
end

-- Those of a sequential AND state run its regions; the user's own are kept elsewhere.
local function take_functions(saved, fsm)
  for _, field in ipairs(ROOT_FIELDS) do put(saved, fsm, field, nil) end
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    local owner = state._regions or state
    put(saved, owner, "entry", nil)
    put(saved, owner, "exit", nil)
    if owner == state then put(saved, state, "doo", idle) end
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    put(saved, tr, "guard", let_pass)
    put(saved, tr, "effect", nil)
  end
end

--- Take the functions of a chart away.
---@param fsm rfsm.Machine
---@return table[] saved for `give_back`
function dry.take(fsm)
  local saved = {}
  for _, place in ipairs(rfsm.machines(fsm)) do take_functions(saved, place.machine) end
  return saved
end

--- Give the functions back.
---@param saved table[]
function dry.give_back(saved)
  for i = #saved, 1, -1 do saved[i].obj[saved[i].field] = saved[i].value end
end

return dry
