--- Rewind: snapshots of a machine are noted during its run, and it can return to them.
--
-- A *place* is the machine as it was between two advances. Returning to a place
-- calls no callback and no guard. Data outside of `keep` is not restored, and a doo
-- begins anew. If the places take too many bytes, the oldest ones are forgotten.
--
-- @module rfsm.observe.rewind
-- @license BSD-3-Clause

local names = require "rfsm.observe.names"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"

local select, setmetatable, type = select, setmetatable, type
local huge = math.huge
local concat = table.concat

local rewind = {}

-- The options, each with a description, a test and the default.
local OPTIONS = {
  about = { "function", rfsm.is_callable, function() end },
  bytes = { "number of bytes", opts.is_whole(0, huge), 32 * 1024 * 1024 },
  prepare = { "function", rfsm.is_callable, function() end },
}

--- A machine as it was between two advances.
---@class rfsm.observe.Place
---@field snap? rfsm.snapshot.Snapshot nil if the machine could not be saved
---@field problem? string why there is no snapshot
---@field about any the result of the option `about`
---@field size integer about how many bytes the place takes

--- The places of a machine, by their numbers. Place 0 is the first one.
---@class rfsm.observe.Rewind
---@field fsm rfsm.Machine
---@field settings table
---@field first integer number of the oldest place that is kept
---@field at integer number of the present place
---@field last integer number of the last place; greater than `at` after a return
---@field size integer bytes that all places take
---@field [integer] rfsm.observe.Place the places; the present place only after `note`
local Rewind = {}
Rewind.__index = Rewind

-- Returns about how many bytes a value takes.
local function size_of(value)
  if type(value) == "string" then return 24 + #value end
  if type(value) ~= "table" then return 0 end
  local size = 56
  for key, inner in order.each(value) do -- any order: a sum
    size = size + 40 + size_of(key) + size_of(inner)
  end
  return size
end

local function forget(self, number)
  self.size = self.size - (self[number] and self[number].size or 0)
  self[number] = nil
end

--- Note the present place in the list and return it. If `go` has led to this place, it
-- is in the list already. A step that was interrupted is finished first.
---@param snap? rfsm.snapshot.Snapshot of the machine as it is, if there is one already
---@return rfsm.observe.Place
function Rewind:note(snap)
  local at = self.at
  if at < self.last and self[at] then return self[at] end
  rfsm.check_between_steps(self.fsm, "rfsm.observe.rewind.note")
  local problem
  if not snap then snap, problem = snapshot.try_take(self.fsm) end
  local about = self.settings.about(snap)
  forget(self, at)
  self[at] = { snap = snap, problem = problem, about = about,
    size = 100 + size_of(snap) + size_of(about) }
  self.size = self.size + self[at].size
  return self[at]
end

--- Note the present place, before the machine is advanced. If `go` has led back to it,
-- the later places are forgotten.
---@param snap? rfsm.snapshot.Snapshot as for `note`
---@return integer number of the next place
function Rewind:leave(snap)
  for number = self.at, self.last do forget(self, number) end
  self.last = self.at
  self:note(snap)
  while self.size > self.settings.bytes and self.first < self.at do
    forget(self, self.first)
    self.first = self.first + 1
  end
  self.at, self.last = self.at + 1, self.at + 1
  return self.at
end

--- Put the machine into a place.
---@param number integer
---@return rfsm.observe.Place|false place false if it is absent or has no snapshot
---@return string? problem
function Rewind:go(number)
  self:note()
  local place = type(number) == "number" and self[number]
  if not place or place.problem then
    return false, place and place.problem or "there is no such place"
  end
  local ok, problem, difference = false, self.settings.prepare(place.about), nil
  if not problem then ok, problem, difference = snapshot.put(self.fsm, place.snap) end
  if ok then
    self.at = number
    return place
  end
  self.settings.prepare(self[self.at].about)
  return false, difference and "the machine has changed, " .. concat(difference, ", ")
    or problem
end

--- Put a machine of a changed chart into the state of a snapshot of the older chart.
-- Data that do not fit any more are left out. Return the problem if the active leaf of
-- the snapshot is gone.
---@param fsm rfsm.Machine
---@param snap rfsm.snapshot.Snapshot its data may be removed by this call
---@return string? problem
function rewind.carry_over(fsm, snap)
  local options = { migrate = function() return snap end }
  local is_put, problem = snapshot.put(fsm, snap, options)
  local _, by_name = names.nodes(fsm)
  if is_put or not (snap.leaf and by_name[snap.leaf]) then return problem end
  snap.data, snap.saved, snap.ext = nil, nil, nil -- they may name states that are gone
  return (select(2, snapshot.put(fsm, snap, options)))
end

--- Options of `rewind.new`: how places are kept.
---@class rfsm.observe.RewindOptions
---@field bytes? integer limit of all places (32 MiB); the present one is always kept
---@field about? fun(snap: rfsm.snapshot.Snapshot?): any called for each place; its
-- result is kept with the place
---@field prepare? fun(about: any): string? called with the result of `about` before
-- `go` puts the machine into the place, for example to set a clock; returns a problem
-- if the machine must stay where it is, and is called again for the present place then

--- Begin to note the places of a machine.
--
-- @usage
--    local way = rewind.new(fsm)
--    way:leave()
--    rfsm.run(fsm)
--    way:go(0)
--
---@param fsm rfsm.Machine
---@param options? rfsm.observe.RewindOptions
---@return rfsm.observe.Rewind
---@nodiscard
function rewind.new(fsm, options)
  rfsm.check_machine(fsm, "rfsm.observe.rewind.new")
  local settings = opts.take("rfsm.observe.rewind.new", OPTIONS, options)
  return setmetatable({ fsm = fsm, settings = settings, first = 0, at = 0, last = 0,
    size = 0 }, Rewind)
end

return rewind
