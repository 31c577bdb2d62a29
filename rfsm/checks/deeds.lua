--- Deeds: what stands for callbacks in a puppet. They set flags and send events.
--
-- @module rfsm.checks.deeds
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"

local error, ipairs, pairs = error, ipairs, pairs
local sort = table.sort

local deeds = {}

-- Returns what stands for a callback: sets flags, sends events; false if it has nothing
-- to do.
local function new_deed(self, name)
  local flags, events = self.flags_of[name], self.sends[name]
  if not (flags or events) then return false end
  return function(fsm)
    for _, flag in ipairs(flags or {}) do self.flags[flag.number] = flag.value end
    for _, event in ipairs(events or {}) do rfsm.send_events(fsm, event) end
  end
end

--- Note that a callback exists; return what stands for it, false for nothing.
---@param self rfsm_checks.Puppet
---@param what "entry"|"exit"|"effect"
---@param path string
---@return function|false
function deeds.new(self, what, path)
  local name = what .. " " .. path
  self.deeds[#self.deeds + 1] = name
  return new_deed(self, name)
end

--- Turn { motor = { on = { "entry root.a" }, off = { ... } } } into what is to be done
--- by name, with a number for each flag.
---@param self rfsm_checks.Puppet
---@param flags table
function deeds.read_flags(self, flags)
  local names = {}
  for name in pairs(flags) do names[#names + 1] = name end -- any order: sorted
  sort(names)
  for number, name in ipairs(names) do
    self.flag_numbers[name], self.flags[number] = number, false
    for _, value in ipairs { true, false } do
      for _, what in ipairs(flags[name][value and "on" or "off"] or {}) do
        local list = self.flags_of[what] or {}
        list[#list + 1] = { number = number, value = value }
        self.flags_of[what] = list
      end
    end
  end
  self.has_flags = names[1] ~= nil
end

--- Raise an error if a callback that is named does not exist.
---@param self rfsm_checks.Puppet
---@param named table<string, any>
---@param field string
function deeds.check(self, named, field)
  local exists, wrong = {}, nil
  for _, name in ipairs(self.deeds) do exists[name] = true end
  for name in pairs(named) do -- any order: the least counts
    if not exists[name] and (not wrong or name < wrong) then wrong = name end
  end
  if not wrong then return end
  error(("%s: no callback '%s'%s"):format(field, wrong,
    advice.nearest_name(wrong, self.deeds)), 0)
end

return deeds
