--- Coverage: the states, transitions and guard outcomes that runs have seen.
--
-- @module rfsm.observe.coverage
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local opts = require "rfsm.shared.options"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"

local error, ipairs = error, ipairs
local setmetatable, type = setmetatable, type
local concat = table.concat

local coverage = {}

--- Counts of a run; `tostring` of it is a report.
---@class rfsm_checks.Coverage
---@field states table<string, integer> by path
---@field transitions table<string, integer> by path, such as "root.trans[2]"
---@field guards table<string, table<"true"|"false"|"failed", integer>>
local Coverage = {}
Coverage.__index = Coverage

local OUTCOMES = { "true", "false" }

-- Count .............................................................................

local function count_state(own, fsm, state, path)
  own.states[path] = own.states[path] or 0
  rfsm.entry_hook_add(fsm, state, function()
    own.states[path] = own.states[path] + 1
  end)
end

-- A call counts as failed until it returns: an error is not caught here.
local function counting_guard(guard, counts)
  return function(tr, events)
    counts.failed = counts.failed + 1
    local answer = guard(tr, events)
    counts.failed = counts.failed - 1
    local outcome = answer ~= false and "true" or "false"
    counts[outcome] = counts[outcome] + 1
    return answer
  end
end

local function count_transition(own, tr, path)
  local effect = tr.effect
  own.transitions[path] = own.transitions[path] or 0
  tr.effect = function(...)
    own.transitions[path] = own.transitions[path] + 1
    if effect then return effect(...) end
  end
  if not tr.guard then return end
  own.guards[path] = own.guards[path] or { ["true"] = 0, ["false"] = 0, failed = 0 }
  tr.guard = counting_guard(tr.guard, own.guards[path])
end

local function count_machine(own, fsm, prefix)
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    count_state(own, fsm, state, location.path(state, prefix))
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    count_transition(own, tr, location.path(tr, prefix))
  end
end

-- Report ............................................................................

-- Appends a line for each count of 0; returns a text such as "states 3 of 4".
local function add_missing(lines, kind, counts)
  local keys, seen = rfsm.sorted_keys(counts), 0
  for _, key in ipairs(keys) do
    if counts[key] > 0 then seen = seen + 1 end
    if counts[key] == 0 then lines[#lines + 1] = "never: " .. kind .. " " .. key end
  end
  return ("%ss %d of %d"):format(kind, seen, #keys)
end

function Coverage:__tostring()
  local lines, outcomes = { "" }, {}
  for path, counts in order.each(self.guards) do -- any order: each stands alone
    for _, outcome in ipairs(OUTCOMES) do
      outcomes[path .. " " .. outcome] = counts[outcome]
    end
  end
  lines[1] = concat({
    add_missing(lines, "state", self.states),
    add_missing(lines, "transition", self.transitions),
    add_missing(lines, "guard outcome", outcomes),
  }, ", ")
  return concat(lines, "\n")
end

--- Return the record as JSON, for other runs and for pictures.
function Coverage:json()
  local dkjson, problem = opts.find_package("dkjson")
  if not dkjson then error("rfsm_checks.coverage: " .. problem, 2) end
  return dkjson.encode({ states = self.states, transitions = self.transitions,
    guards = self.guards }, { indent = true, keyorder = rfsm.sorted_keys(self.states) })
end

-- Public functions ..................................................................

-- Returns a copy of the counts of an earlier run.
local function copy_of(counts)
  local copy = {}
  for key, value in order.each(counts) do -- any order: a copy
    copy[key] = type(value) == "table" and copy_of(value) or value
  end
  return copy
end

--- Record the states, transitions and guard outcomes that a machine sees from now on.
--
-- The record counts as the machine runs. With `earlier`, a record of another run, such
-- as one read from JSON, it begins with those counts.
--
---@param fsm rfsm.Machine
---@param earlier? table
---@return rfsm_checks.Coverage record
function coverage.coverage(fsm, earlier)
  rfsm.check_machine(fsm, "rfsm_checks.coverage")
  if earlier == nil then earlier = { states = {}, transitions = {}, guards = {} } end
  local own = setmetatable({}, Coverage)
  for _, field in ipairs { "states", "transitions", "guards" } do
    local counts = type(earlier) == "table" and earlier[field]
    if type(counts) ~= "table" then
      error("rfsm_checks.coverage: a record of an earlier run expected, got "
        .. type(earlier), 2)
    end
    own[field] = copy_of(counts)
  end
  for _, entry in ipairs(rfsm.machines(fsm)) do
    count_machine(own, entry.machine, entry.prefix)
  end
  return own
end

return coverage
