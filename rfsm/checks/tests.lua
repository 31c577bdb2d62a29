--- Tests: runs that together take every transition of a chart that can be taken.
--
-- The steps come from an exploration. From where a run stands it goes on to the nearest
-- transition that is still to be taken; a new run begins if that is nearer.
--
-- @module rfsm.checks.tests
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local explore = require "rfsm.checks.explore"
local puppet = require "rfsm.checks.puppet"
local rehearsal = require "rfsm.checks.rehearsal"

local error, ipairs, pairs, rawget = error, ipairs, pairs, rawget
local tonumber, type = tonumber, type
local ceil, max = math.ceil, math.max
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local tests = {}

--- Runs of a chart.
---@class rfsm_checks.Tests
---@field runs { steps: rfsm_checks.TestStep[] }[]
---@field steps integer of all runs
---@field least integer no tests can do with fewer steps
---@field taken integer how many transitions they take
---@field transitions integer of the chart

--- A step: what the rehearsal is told, and what it returns.
---@class rfsm_checks.TestStep
---@field what table see `Rehearsal:step`
---@field result string

-- Steps of the exploration ..........................................................

-- A step with an event that is no text cannot be written.
local function is_plain(events)
  for i = 1, #events do
    local kind = type(events[i].event)
    if kind ~= "string" and kind ~= "number" and kind ~= "boolean"
      or events[i].part.owner then
      return false
    end
  end
  return true
end

-- Notes every step that leads on, once for each target and what it takes.
local function watch_steps(walk)
  local edges, is_noted = {}, {}
  function walk.look(_, from, tgt, events, label)
    local taken = { unpack(walk.puppet.taken) }
    local key = from .. " " .. tgt .. " " .. concat(taken, ",")
    if is_noted[key] or not is_plain(events) or tgt == from and not taken[1] then
      return
    end
    is_noted[key] = true
    edges[from] = edges[from] or {}
    edges[from][#edges[from] + 1] = { from = from, tgt = tgt, taken = taken,
      label = label() }
  end
  walk.edges = edges
end

-- Runs ..............................................................................

local function is_wanted(edge, left)
  for _, number in ipairs(edge.taken) do
    if left[number] then return true end
  end
  return false
end

-- Returns the steps that lead to the last one.
local function way_to(edge, came)
  local way = { edge }
  while came[way[1].from] do table.insert(way, 1, came[way[1].from]) end
  return way
end

-- Returns the shortest list of steps from a configuration whose last one is wanted.
local function find_way(walk, start, left)
  local came, pending = { [start] = false }, { start }
  for _, number in ipairs(pending) do -- which gets longer
    for _, edge in ipairs(walk.edges[number] or {}) do
      if is_wanted(edge, left) then return way_to(edge, came) end
      if came[edge.tgt] == nil then
        came[edge.tgt], pending[#pending + 1] = edge, edge.tgt
      end
    end
  end
end

local LONG = 12 -- steps after which a run is rather ended

-- Returns runs, lists of steps, that take all there is in `left`.
local function plan(walk, left)
  local runs, run, at = {}, nil, 1
  while true do
    local way = run and find_way(walk, at, left)
    local fresh = (not way or #run + #way > LONG) and find_way(walk, 1, left)
    if not (way or fresh) then return runs end
    if not way or fresh and #fresh <= #way then
      run, way = {}, fresh
      runs[#runs + 1] = run
    end
    for _, edge in ipairs(way) do
      run[#run + 1] = edge
      for _, number in ipairs(edge.taken) do left[number] = nil end
    end
    at = way[#way].tgt
  end
end

-- Steps for the rehearsal ...........................................................

-- "e_after(3)@root.a" becomes 3, to be waited for.
local function seconds_of(event)
  return type(event) == "string" and tonumber(event:match("^e_after%(([%d.]+)%)@"))
end

local MARGIN = 0.001 -- a timer fires when its time is over

-- Returns what to tell the rehearsal for a step, and what should come of it.
local function told_of(walk, edge, waits)
  local step = walk:rerun(edge.from, edge.label)
  local what, events = rehearsal.what_of(step), {}
  for i = #what, 1, -1 do events[i], what[i] = what[i], nil end
  for _, event in ipairs(events) do
    local seconds = waits and seconds_of(event)
    if seconds then
      what.after = seconds + MARGIN
    else
      what[#what + 1] = event
    end
  end
  return what, puppet.outcome(step.taken, step.leaf)
end

-- Rehearses a run as planned; with `waits` timers fire because time goes by. Returns
-- its steps, nil if something else happens.
local function rehearse(walk, model, run, waits)
  local steps, own = {}, rehearsal.rehearsal(model)
  for i, edge in ipairs(run) do
    local what, outcome = told_of(walk, edge, waits)
    steps[i] = { what = what, result = own:step(what) }
    if steps[i].result ~= outcome then return nil end
  end
  return steps
end

-- Public functions ..................................................................

--- Plan runs that take every transition of a model that can be taken.
---@param model rfsm.State
---@param options? rfsm_checks.Options
---@return rfsm_checks.Tests
function tests.plan(model, options)
  local walk = explore.walk(model, options or {}, watch_steps)
  local left, most, result = {}, 1, { runs = {}, steps = 0, least = 0, taken = 0,
    transitions = #walk.puppet.transitions }
  for _, list in pairs(walk.edges) do -- any order: a set, and the greatest
    for _, edge in ipairs(list) do
      most = max(most, #edge.taken)
      for _, number in ipairs(edge.taken) do left[number] = true end
    end
  end
  for _ in pairs(left) do result.taken = result.taken + 1 end -- any order: counted
  result.least = ceil(result.taken / most)
  for i, run in ipairs(plan(walk, left)) do
    local steps = rehearse(walk, model, run, true) or rehearse(walk, model, run, false)
    if not steps then error("rfsm bug: a planned run cannot be rehearsed") end
    result.runs[i] = { steps = steps }
    result.steps = result.steps + #steps
  end
  return result
end

-- Text ..............................................................................

local function quoted(value)
  return type(value) == "string" and ("%q"):format(value) or rfsm.text_of(value)
end

local function step_text(what)
  local parts, guards, ends = {}, {}, {}
  local function add(field, items)
    if items[1] then
      parts[#parts + 1] = field .. " = { " .. concat(items, ", ") .. " }"
    end
  end
  for i = 1, #what do parts[i] = quoted(what[i]) end
  if what.after then parts[#parts + 1] = "after = " .. rfsm.text_of(what.after) end
  for i, path in ipairs(rfsm.sorted_keys(what.guards)) do
    guards[i] = ("[%q] = false"):format(path)
  end
  add("guards", guards)
  for i, path in ipairs(what.ends) do ends[i] = quoted(path) end
  add("ends", ends)
  return parts[1] and "run:step { " .. concat(parts, ", ") .. " }" or "run:step()"
end

local HEAD = [[
-- Runs of %s that take %d of its %d transitions: %d steps,
-- where at least %d are needed. Made by rfsm check --tests; yours from now on.
--
-- Callbacks of the chart do not run. Guards answer true and doos go on, unless a step
-- says otherwise; `after` lets that many seconds go by.

%slocal rehearsal = require("rfsm_checks").rehearsal

describe(%q, function()
]]

-- The longest piece of a line that may stand before it is broken.
local WIDTH = 88

local function add_step(lines, step)
  local call, result = step_text(step.what), quoted(step.result)
  local line = ("    assert.equal(%s, %s)"):format(result, call)
  if #line > WIDTH then
    line = ("    assert.equal(%s,\n      %s)"):format(result, call)
  end
  lines[#lines + 1] = line
end

-- A run is named by where it leads, as far as a line has room.
local function name_of(run)
  local names, last = {}, nil
  for _, step in ipairs(run.steps) do
    local leaf = step.result:match("%-> (.*)$"):gsub("^root%.", "")
    if leaf ~= last then names[#names + 1] = leaf end
    last = leaf
  end
  local text = concat(names, ", ")
  while #text > WIDTH - 30 and names[3] do
    table.remove(names, #names - 1)
    text = concat(names, ", ", 1, #names - 1) .. " ... " .. names[#names]
  end
  return "goes to " .. text
end

--- Write the runs of a chart as a spec for busted.
---@param file string of the chart, as the spec is to load it
---@param model rfsm.State
---@param options? rfsm_checks.Options
---@return string text
---@return rfsm_checks.Tests
function tests.busted(file, model, options)
  local result = tests.plan(model, options)
  local modules = rawget(_G, "package").loaded.rfsm_timeevent
    and 'require "rfsm_timeevent"\n' or ""
  local blocks = {}
  for i, run in ipairs(result.runs) do
    local lines = { ("  it(%q, function()"):format(name_of(run)),
      ("    local run = rehearsal(%q)"):format(file) }
    for _, step in ipairs(run.steps) do add_step(lines, step) end
    blocks[i] = concat(lines, "\n") .. "\n  end)\n"
  end
  return HEAD:format(file, result.taken, result.transitions, result.steps,
    result.least, modules, file) .. concat(blocks, "\n") .. "end)\n", result
end

return tests
