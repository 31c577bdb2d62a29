--- Graph: questions to the steps of a walk.
--
-- @module rfsm.checks.graph
-- @license BSD-3-Clause

local ipairs, table = ipairs, table

local graph = {}

--- Call `f(tgt, is_internal)` for each step from a configuration.
---@param walk rfsm_checks.Walk
---@param number integer
---@param f fun(tgt: integer, is_internal: boolean)
function graph.each_step(walk, number, f)
  for i = walk.first[number] or 1, (walk.first[number + 1] or 1) - 1 do
    local step = walk.steps[i]
    if step < 0 then f(-step, true) else f(step, false) end
  end
end

-- Lists for each configuration those from which a step leads there.
local function reverse(walk, is_internal)
  local lists = {}
  for from = 1, walk.expanded do
    graph.each_step(walk, from, function(tgt, is_own)
      if is_own or not is_internal then
        lists[tgt] = lists[tgt] or {}
        lists[tgt][#lists[tgt] + 1] = from
      end
    end)
  end
  return lists
end

-- Adds to a set, again and again, those from which a step leads into it and for which
-- `joins(from, tgt)` is true. Returns the set.
local function spread(walk, set, lists, joins)
  local pending = {}
  for number = 1, #walk.keys do
    if set[number] then pending[#pending + 1] = number end
  end
  while pending[1] do
    local number = table.remove(pending)
    for _, from in ipairs(lists[number] or {}) do
      if not set[from] and joins(from, number) then
        set[from], pending[#pending + 1] = true, from
      end
    end
  end
  return set
end

--- Return the set of configurations from which one of `goals` can be reached.
---@param walk rfsm_checks.Walk
---@param goals table<integer, boolean>
---@param is_internal boolean? by steps without events from outside
---@return table<integer, boolean> set
function graph.can_reach(walk, goals, is_internal)
  local set = {}
  for number = 1, #walk.keys do set[number] = goals[number] end
  return spread(walk, set, reverse(walk, is_internal), function() return true end)
end

-- Counts the steps without events from outside; a doo that goes on is none.
local function count_internal(walk, number)
  local count = 0
  graph.each_step(walk, number, function(tgt, is_own)
    if is_own and (tgt ~= number or walk:is_driven(number)) then count = count + 1 end
  end)
  return count
end

--- Return the set of configurations from which steps without events from outside always
--- lead to one of `goals`. A doo that does not end is left out: it ends some time.
---@param walk rfsm_checks.Walk
---@param goals table<integer, boolean>
---@return table<integer, boolean> set
function graph.must_reach(walk, goals)
  local set, left = {}, {}
  for number = 1, #walk.keys do -- what is not known is no fault
    set[number] = goals[number] or number > walk.expanded
  end
  return spread(walk, set, reverse(walk, true), function(from, tgt)
    left[from] = left[from] or count_internal(walk, from)
    if from ~= tgt then left[from] = left[from] - 1 end
    return left[from] == 0
  end)
end

return graph
