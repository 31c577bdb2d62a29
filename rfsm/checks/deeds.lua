--- Deeds: what stands for callbacks in a puppet. They set flags and send events.
--
-- A deed is named by its callback: "entry root.a", "effect root.trans[2]".
--
-- @module rfsm.checks.deeds
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"

local error, ipairs, table = error, ipairs, table

local deeds = {}

-- Calls a callback once; returns the events that it sends to its machine.
local function dry_run(fsm, callback, obj, what)
  local sent, first = {}, #fsm._intq + 1
  calls.try(callback, fsm, obj, what, {})
  for i = first, #fsm._intq do sent[#sent + 1] = fsm._intq[i] end
  for i = #fsm._intq, first, -1 do fsm._intq[i] = nil end
  return sent
end

--- Note that a callback may exist; return what stands for it.
---@param self rfsm_checks.Puppet
---@param what "entry"|"exit"|"effect"
---@param path string
---@param fsm rfsm.Machine
---@param obj rfsm.State|rfsm.Transition
---@param callback function|nil
---@return function? deed nil if it has nothing to do
function deeds.new(self, what, path, fsm, obj, callback)
  local name = what .. " " .. path
  self.deeds[name] = true
  local flags, events = self.flags_of[name] or {}, self.sends[name] or {}
  if self.is_dry_run and callback and not self.sends[name] then
    events = dry_run(fsm, callback, obj, what)
  end
  if not flags[1] and events[1] == nil then return nil end
  return function(own)
    for _, flag in ipairs(flags) do self.flags[flag.number] = flag.value end
    for i = 1, #events do rfsm.send_events(own, events[i]) end
  end
end

-- Has the deeds that are named set a flag.
local function set_flag(self, names, number, value)
  for _, name in ipairs(names or {}) do
    self.flags_of[name] = self.flags_of[name] or {}
    table.insert(self.flags_of[name], { number = number, value = value })
  end
end

--- Turn { motor = { on = { "entry root.a" }, off = { ... } } } into what is to be done
--- by name, with a number for each flag.
function deeds.read_flags(self, flags)
  for number, name in ipairs(rfsm.sorted_keys(flags)) do
    self.flag_numbers[name], self.flags[number] = number, "-"
    set_flag(self, flags[name].on, number, "+")
    set_flag(self, flags[name].off, number, "-")
  end
end

--- Raise an error if a callback that is named does not exist.
---@param self rfsm_checks.Puppet
---@param named table<string, any>
---@param field string
function deeds.check(self, named, field)
  for _, name in ipairs(rfsm.sorted_keys(named)) do
    if not self.deeds[name] then
      error(("%s: no callback '%s'%s"):format(field, rfsm.text_of(name),
        advice.nearest_name(rfsm.text_of(name), rfsm.sorted_keys(self.deeds))), 0)
    end
  end
end

return deeds
