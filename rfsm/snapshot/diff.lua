--- Compare two versions of a chart: what the new one means for machines of the old one.
--
-- For each leaf of the old chart and of its regions, a machine is put into the leaf,
-- saved, and restored with the new chart. All kept fields have a value: their first
-- value, or `true`. All other regions are in their first leaf. The root of the new
-- chart may have the options `rename` and `migrate`, as in `rfsm.redis`.
--
-- @module rfsm.snapshot.diff
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local shape = require "rfsm.snapshot.shape"
local migrate = require "rfsm.snapshot.migrate"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"

local error, ipairs, rawget = error, ipairs, rawget
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local diff = {}

--- The end of a report: a list of all that is not compared.
diff.PREMISES = "not looked at: values of fields (migrate had the first ones, or true),"
  .. "\n  what save returns, targets that programs set, events in queues,"
  .. "\n  states of several regions at once"

local function new_machine(model)
  local fsm, text = calls.init_apart(model)
  return fsm or error(text, 0)
end

local function fill(fsm)
  local own = shape.of(fsm)
  for i, keeper in ipairs(own.chart.keepers) do
    local state = own.states[i]
    for _, name in ipairs(keeper.names) do
      if state[name] == nil then state[name] = true end
    end
  end
end

-- Puts a machine into a leaf, and the regions in that leaf into their first leaves.
local function enter(machine, leaf)
  rfsm.place(machine, leaf, "done", {})
  for _, region in ipairs(rfsm.regions(leaf)) do
    enter(region, rfsm.elements(region, rfsm.is_leaf)[1])
  end
end

-- Puts a machine or region into a leaf, and the machines around it into the states in
-- which it runs.
local function enter_at(places, at, leaf)
  for _, outer in ipairs(places) do
    if outer.machine == at.owner then enter_at(places, outer, at.state) end
  end
  enter(at.machine, leaf)
end

-- Returns the timers of a leaf and the states around it.
local function timers_of(fsm, leaf)
  local list = {}
  for _, tr in ipairs(shape.of(fsm).transitions) do
    for _, event in ipairs(location.is_inside(leaf, tr.src) and tr.events or {}) do
      local name = rfsm.text_of(event)
      if match.maker_of(name) == "timer" then list[#list + 1] = name end
    end
  end
  return list
end

-- Notes each timer of `list` that is not in `others`.
local function note_timers(notes, list, others, text)
  for _, name in ipairs(list) do
    if not match.has(others, name) then notes[#notes + 1] = "timer " .. name .. text end
  end
end

-- Notes each event that may be kept in a leaf, and that nothing in the new chart takes.
local function note_deferred(notes, leaf, fsm)
  local state = leaf
  while rfsm.is_state(state) do
    for _, event in ipairs(shape.samples(state)) do
      if not shape.wants(fsm, event) then
        notes[#notes + 1] = ("a kept %s is reported and lost: no transition takes it")
          :format(rfsm.event_text(event))
      end
    end
    state = not rfsm.is_root(state) and state._parent
  end
end

--- The result for machines of the old chart that are in one leaf.
---@class rfsm.snapshot.Fate
---@field leaf string location in the old chart
---@field to string|false location in the new chart; false: the machine is not moved
---@field notes string[] changed timers, or why the machine is not moved

local function reasons(problem, list, what)
  if what == migrate.FOREIGN then
    return { "the root of the new chart has neither 'rename' nor 'migrate'" }
  end
  local notes = { what or problem:match("[^\n]+") }
  for i, text in ipairs(list or {}) do notes[i + 1] = text end
  return notes
end

-- Returns the place of the machine or region that had a prefix in the old chart. If the
-- new chart has no such region, returns the place of the outermost machine.
local function place_from(fsm, prefix, rename)
  prefix = migrate.renamed(prefix, rename or {})
  local places = shape.of(fsm).places
  for _, at in ipairs(places) do
    if at.prefix == prefix then return at end
  end
  return places[1]
end

-- Returns the fate of the machines that are in a leaf of the machine or region `at`.
local function fate_of(places, at, leaf, model, options)
  enter_at(places, at, leaf)
  local fsm, problem, list, what = snapshot.restore(model,
    snapshot.take(places[1].machine), options)
  local fate = { leaf = location.path(leaf, at.prefix), to = false, notes = {} }
  if not fsm then
    fate.notes = reasons(problem, list, what)
    return fate
  end
  local new = place_from(fsm, at.prefix, options.rename)
  local to = new.machine._act_leaf
  fate.to = to and location.path(to, new.prefix) or "no state"
  if to then
    local old_timers, timers = timers_of(at.machine, leaf), timers_of(new.machine, to)
    note_timers(fate.notes, old_timers, timers, " is dropped")
    note_timers(fate.notes, timers, old_timers, " begins, with its whole time")
    note_deferred(fate.notes, leaf, fsm)
  end
  return fate
end

--- Compare two versions of a chart. Both are models, whose callbacks should print
--- nothing. The root of the new version may have `rename` and `migrate`.
-- @raise if one of them is no valid chart
---@return string[] difference lines; none if structure and kept fields are equal
---@return rfsm.snapshot.Fate[] fates one for each leaf of the old chart and its regions
function diff.compare(old, new)
  local before, after = new_machine(old), new_machine(new)
  local options = { rename = after.rename, migrate = after.migrate }
  local was, is = shape.structure(before), shape.structure(after)
  if concat(was, "\n") == concat(is, "\n") then return {}, {} end
  local places, fates = shape.of(before).places, {}
  for _, at in ipairs(places) do fill(at.machine) end
  for _, at in ipairs(places) do
    for _, leaf in ipairs(rfsm.elements(at.machine, rfsm.is_leaf)) do
      fates[#fates + 1] = fate_of(places, at, leaf, new, options)
    end
  end
  return migrate.difference(was, is), fates
end

local function outcome_of(fate)
  local outcome = fate.to and "moves to " .. fate.to
    or "stays a machine of the old version"
  return concat({ outcome, unpack(fate.notes) }, "\n  ")
end

-- The beginning of a line about one state, two, or more that stand side by side.
local PLACES = { "in %s: ", "in %s and %s: " }
local MANY = "in %s to %s (%d states): "

--- Return a report as text, and whether all machines move to the new chart. States that
--- follow each other and have the same fate have one line.
function diff.report(difference, fates)
  if not difference[1] then
    return "the charts have the same structure and keep the same: nothing moves\n", true
  end
  local lines, is_safe, first, last, count = {}, true, nil, nil, 0
  for _, line in ipairs(difference) do lines[#lines + 1] = line end
  for _, fate in ipairs(fates) do
    local outcome = outcome_of(fate)
    is_safe, count = is_safe and fate.to ~= false, count + 1
    if outcome ~= last then
      first, last, count = fate.leaf, outcome, 1
      lines[#lines + 1] = ""
    end
    lines[#lines] = (PLACES[count] or MANY):format(first, fate.leaf, count) .. outcome
  end
  lines[#lines + 1] = diff.PREMISES
  return concat(lines, "\n") .. "\n", is_safe
end

return diff
