--- Coverage: the states, transitions and guard outcomes that runs have seen.
--
-- @module rfsm.observe.coverage
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local exact_json = require "rfsm.shared.exact_json"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"
local stream = require "rfsm.observe.stream"

local error, ipairs = error, ipairs
local setmetatable, type = setmetatable, type
local concat = table.concat

local coverage = {}

--- The counts of a run, by the paths of elements. `tostring(record)` is a report.
---@class rfsm_checks.Coverage
---@field states table<string, integer> how often a state was entered, by its path
---@field transitions table<string, integer> how often a transition was taken, by its
-- path: "root.trans[2]"
---@field guards table<string, table<"true"|"false"|"failed", integer>> how often the
-- guard of a transition had an outcome, by the path of the transition
local Coverage = {}
Coverage.__index = Coverage

local OUTCOMES = { "true", "false" }

-- Count .............................................................................

local function add(t, key) t[key] = t[key] + 1 end

-- Adds counts of 0 for those states, transitions and guards of a machine that have no
-- counts yet.
local function add_elements(own, paths, at)
  for _, element in ipairs(rfsm.elements(at.machine)) do
    local path, is_trans = location.path(element, at.prefix), rfsm.is_trans(element)
    local counts = is_trans and own.transitions or own.states
    if is_trans or rfsm.is_state(element) then counts[path] = counts[path] or 0 end
    if is_trans and element.guard then
      own.guards[path] = own.guards[path] or { ["true"] = 0, ["false"] = 0, failed = 0 }
    end
    paths[element] = path
  end
end

-- Returns a listener for `rfsm.observe.stream` that counts in `own`.
local function new_counter(own, fsm)
  local counter, paths = {}, {}
  function counter.merged()
    for _, at in ipairs(rfsm.machines(fsm)) do add_elements(own, paths, at) end
  end
  counter.merged()
  function counter.entered(_, state) add(own.states, paths[state]) end
  function counter.taken(_, path)
    for _, tr in ipairs(path) do add(own.transitions, paths[tr]) end
  end
  -- Counts the call as failed until it returns, since an error is not caught here; then
  -- counts its answer instead.
  function counter.guard(_, tr, guard, events, event)
    local counts = own.guards[paths[tr]]
    counts.failed = counts.failed + 1
    local answer = guard(tr, events, event)
    counts.failed = counts.failed - 1
    add(counts, answer ~= false and "true" or "false")
    return answer
  end
  return counter
end

-- Report ............................................................................

-- Appends a line for each element with a count of 0; returns a text: "states 3 of 4".
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
  for path, counts in order.each(self.guards) do -- any order: sorted when reported
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
  return exact_json.encode { states = self.states, transitions = self.transitions,
    guards = self.guards }
end

-- Public functions ..................................................................

local function copy_of(counts)
  local copy = {}
  for key, value in order.each(counts) do -- any order: a copy
    copy[key] = type(value) == "table" and copy_of(value) or value
  end
  return copy
end

--- Record the states, transitions and guard outcomes that a machine sees from now on.
--
-- The counts grow while the machine runs. They begin with those of `earlier`, the
-- record of another run, which may have been read from JSON.
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
  stream.follow(fsm, new_counter(own, fsm))
  return own
end

return coverage
