--- Functions that send events to ports of Orocos RTT. rfsm.rtt loads this file when it
-- is used.
--
-- @submodule rfsm.rtt
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local held_port = require "rfsm.rtt.port"

local error, select, tostring, type = error, select, tostring, type

local rfsm_rtt = {}

-- Returns the problem if a port of type `kind` cannot take an event; nil if it can.
local function event_problem(kind, event)
  if event == nil or not kind then return nil end
  local wanted, actual = held_port.LUA_TYPES[kind], type(event)
  if actual == wanted or kind == "bool" and actual == "number" then return nil end
  actual = held_port.has_method(event, "getType") and event:getType()
  if actual == kind then return nil end
  return (wanted or "Variable of type " .. kind) .. " expected, "
    .. (actual and "got a Variable of type " .. tostring(actual) or rfsm.got(event))
end

--- Make a function that writes each of its arguments to an output port.
--
-- With `fsm`, the function also sends the arguments to this machine. It skips nil. If
-- the port cannot take one of the events, it raises an error and writes none.
--
-- @usage
--    local raise_event = rfsm_rtt.gen_raise_event(port)
--    raise_event("e_grasped", "e_ready")
--
-- @raise when the port is no output port, or `fsm` no machine
---@param port any output port
---@param fsm? rfsm.Machine
---@return fun(...: any) raise_event
---@nodiscard
function rfsm_rtt.gen_raise_event(port, fsm)
  local problem = held_port.problem(port, "write")
  if problem then error("rfsm.rtt.gen_raise_event: " .. problem, 2) end
  if fsm ~= nil then rfsm.check_machine(fsm, "rfsm.rtt.gen_raise_event") end
  local kind, write = held_port.info_of(port).type, held_port.new_writer(port)
  return function(...)
    local n = select("#", ...)
    for i = 1, n do
      local obstacle = event_problem(kind, (select(i, ...)))
      if obstacle then
        error(("rfsm.rtt.raise_event: event %d: %s"):format(i, obstacle), 2)
      end
    end
    for i = 1, n do
      local event = select(i, ...)
      if event ~= nil then
        write(event)
        if fsm then rfsm.send_events(fsm, event) end
      end
    end
  end
end

return rfsm_rtt
