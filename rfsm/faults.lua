--- Faults: an event that comes when a callback fails.
--
-- Once this module is loaded, `e_fault` in a transition from a state is the event that
-- a callback of this state, of a state in it, or of a transition from these has failed.
-- The event has data, see `rfsm.faults.Fault`. Machines that do not name it are as
-- before.
--
-- @module rfsm.faults
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, rawget = ipairs, rawget
local tostring, type = tostring, type

--- The event of a fault.
---@class rfsm.faults.Fault
---@field name string "e_fault@F": F is the FQN of the state whose transition names it
---@field callback "entry"|"exit"|"doo"|"guard"|"effect"
---@field element string what has failed: the FQN of a state, or a transition as text
---@field region? string the name of the region that has the element: "root.arms.left"
---@field message string
---@field traceback? string if there is the library `debug`

local function name_of(state) return "e_fault@" .. state._fqn end

-- Is a fault of an element current in a machine, or waiting?
local function is_known(fsm, element, region)
  for _, list in ipairs { fsm._curq, fsm._intq } do
    for _, event in ipairs(list) do
      local name = rfsm.name_with_data(event)
      if name and name:find("^e_fault@") and event.element == element
        and event.region == region then
        return true
      end
    end
  end
  return false
end

-- Lists the active states that name `e_fault`, from a node outwards.
local function naming(node)
  local states = {}
  while true do
    local is_active = node._mode and node._mode ~= "inactive"
    if is_active and node._names_fault then states[#states + 1] = node end
    if node._parent == node then return states end
    node = node._parent
  end
end

-- Returns where a region runs, at any depth in a machine.
local function place_of(fsm, region)
  for _, at in ipairs(rfsm.machines(fsm)) do
    if at.machine == region then return at end
  end
end

local function traceback(owner)
  local debug = rawget(_G, "debug")
  local thread = rawget(owner, "_doo_co")
  if type(debug) ~= "table" or not debug.traceback then return nil end
  -- where there are no coroutines, the doo is a function
  return type(thread) == "thread" and debug.traceback(thread) or debug.traceback("", 3)
end

local function send(fsm, failing, states, owner, callback, failure)
  local element = owner._fqn or tostring(owner)
  local region = failing ~= fsm and place_of(fsm, failing).prefix or nil
  if not states[1] or is_known(fsm, element, region) then return end
  local trace, message, queue = traceback(owner), rfsm.event_text(failure, true), {}
  for i, event in ipairs(fsm._intq) do queue[i] = event end
  local count = #queue
  for i, state in ipairs(states) do
    queue[count + i] = { name = name_of(state), callback = callback, element = element,
      region = region, message = message, traceback = trace }
  end
  fsm._intq = queue -- all at once: after an interrupt none or all of them are known
  -- a printer may send events, which follow them
  for i = 1, #states do rfsm.report(fsm, "dbg", "RAISED", queue[count + i]) end
end

-- The watch hook: sends the events of a callback that has failed in this machine or in
-- one inside it, unless an active state there, or nearer to it, names them.
local function note_failure(fsm, failing, owner, callback, failure, f)
  if callback == "guard" and f == nil then return end -- a guard hook
  local machine, node = failing, rfsm.is_trans(owner) and owner.src or owner
  while machine ~= fsm do
    if naming(node)[1] then return end
    local around = rfsm.parent(machine)
    machine, node = around, place_of(around, machine).state
  end
  return send(fsm, failing, naming(node), owner, callback, failure)
end

-- Has a transition from a state take the event of its source: `e_fault`, also by
-- `rfsm.named` or with the FQN of the source.
local function expand(fsm, tr, i, event)
  local is_own = event == "e_fault" or event == name_of(tr.src)
  if not (is_own and rfsm.is_state(tr.src)) then
    return rfsm.warn(fsm, "init", ("%s: '%s' never fires here, %s"):format(
      rfsm.location_of(tr, "events"), event, is_own and ("'%s' is no state"):format(
      tr.src._fqn) or "did you mean 'e_fault'?"))
  end
  tr.events[i], tr.src._names_fault = rfsm.named(name_of(tr.src)), true
  if fsm._has_faults then return end
  fsm._has_faults = true
  rfsm.watch_hook_add(fsm, "failed_inside", rfsm.repeatable(note_failure))
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  for _, tr in ipairs(rfsm.elements(merged or fsm, rfsm.is_trans)) do
    for i, event in ipairs(tr.events) do
      if rfsm.event_name(event) == "e_fault" then event = "e_fault" end
      if type(event) == "string" and event:find("^e_fault%f[^%w_]") then
        expand(fsm, tr, i, event)
      end
    end
  end
end

rfsm.makers[#rfsm.makers + 1] = function(event)
  local fqn = event:match("^e_fault@(root.*)$")
  if fqn then return "fault", fqn end
end

return {}
