--- Dry: a machine without the functions of its chart.
--
-- @module rfsm.shared.dry
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local swap = require "rfsm.shared.swap"

local ipairs, rawget = ipairs, rawget

local ROOT_FIELDS = { "idle_hook", "pre_step_hook", "post_step_hook" }
local STATE_FIELDS, TRANSITION_FIELDS = { "entry", "exit" }, { "effect", "likely" }

local function take_away(swaps, obj, fields)
  for _, field in ipairs(fields) do
    if rawget(obj, field) then swap.put(swaps, obj, field, nil) end
  end
end

--- Take the functions of a machine away, except guards, doos and getevents.
---@param swaps table[] as of `rfsm.shared.swap`, which gives them back
---@param fsm rfsm.Machine
---@return rfsm.State[] doers the states that have a doo of the chart
return function(swaps, fsm)
  local doers = {}
  take_away(swaps, fsm, ROOT_FIELDS)
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    local regions = rawget(state, "_regions")
    -- those of a sequential AND state run its regions; the user's own are kept there
    take_away(swaps, regions or state, STATE_FIELDS)
    if state.doo and not regions then doers[#doers + 1] = state end
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    take_away(swaps, tr, TRANSITION_FIELDS)
  end
  return doers
end
