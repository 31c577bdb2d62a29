--- Graph: reachability and cycles in the steps of a walk.
--
-- @module rfsm.checks.graph
-- @license BSD-3-Clause

local ipairs, table = ipairs, table
local abs, min = math.abs, math.min

local graph = {}

--- Call `f(tgt, is_internal, position)` for each step from a configuration.
---@param walk rfsm_checks.Walk
---@param number integer
---@param f fun(tgt: integer, is_internal: boolean, position: integer)
function graph.each_step(walk, number, f)
  for i = walk.first[number] or 1, (walk.first[number + 1] or 1) - 1 do
    local step = walk.steps[i]
    if step < 0 then f(-step, true, i) else f(step, false, i) end
  end
end

-- Lists for each configuration those from which a step leads there.
local function reverse(walk, is_internal, is_sure)
  local lists = {}
  for from = 1, walk.expanded do
    graph.each_step(walk, from, function(tgt, is_own, at)
      if (is_own or not is_internal) and not (is_sure and walk.unsure[at]) then
        lists[tgt] = lists[tgt] or {}
        lists[tgt][#lists[tgt] + 1] = from
      end
    end)
  end
  return lists
end

-- Adds predecessors to a set while there are some for which `joins(from, tgt)` is true.
-- Returns the set.
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
---@param goals table<integer, boolean>
---@param is_internal boolean? by steps without events from outside
---@param is_sure boolean? by steps that can be taken whatever the clocks show
---@return table<integer, boolean> set
function graph.can_reach(walk, goals, is_internal, is_sure)
  local set = {}
  for number = 1, #walk.keys do set[number] = goals[number] end
  return spread(walk, set, reverse(walk, is_internal, is_sure),
    function() return true end)
end

-- Does each group of deadlines that can be first have a step into a set?
local function leads_surely(walk, number, set)
  local ways, is_counted = 0, {}
  graph.each_step(walk, number, function(tgt, _, at)
    local group = walk.unsure[at]
    if group and set[tgt] and not is_counted[group] then
      is_counted[group], ways = true, ways + 1
    end
    if group and ways == group.ways then is_counted.all = true end
  end)
  return is_counted.all
end

--- Return the set of configurations from which one of `goals` can be reached, whatever
--- their clocks show.
---@param walk rfsm_checks.Walk
---@param goals table<integer, boolean>
---@return table<integer, boolean> set
function graph.can_surely_reach(walk, goals)
  local set, has_grown = goals, true
  while has_grown do
    set, has_grown = graph.can_reach(walk, set, false, true), false
    for number = 1, walk.expanded do
      if not set[number] and leads_surely(walk, number, set) then
        set[number], has_grown = true, true
      end
    end
  end
  return set
end

-- Counts the steps without events from outside, but not those of a doo that goes on.
local function count_internal(walk, number)
  local count = 0
  graph.each_step(walk, number, function(tgt, is_own)
    if is_own and (tgt ~= number or walk:is_driven(number)) then count = count + 1 end
  end)
  return count
end

--- Return the set of configurations from which steps without events from outside always
--- lead to one of `goals`. Each doo is taken to end some time.
---@param goals table<integer, boolean>
---@return table<integer, boolean> set
function graph.must_reach(walk, goals)
  local set, left = {}, {}
  for number = 1, #walk.keys do -- an unknown step is no fault
    set[number] = goals[number] or number > walk.expanded
  end
  return spread(walk, set, reverse(walk, true), function(from, tgt)
    left[from] = left[from] or count_internal(walk, from)
    if from ~= tgt then left[from] = left[from] - 1 end
    return left[from] == 0
  end)
end

-- Begins a visit of Tarjan's search for strongly connected components.
local function new_visit(walk, search, number)
  search.count = search.count + 1
  search.order[number], search.low[number] = search.count, search.count
  search.open[#search.open + 1], search.is_open[number] = number, true
  return { number = number, at = walk.first[number] or 1,
    last = (walk.first[number + 1] or 1) - 1 }
end

-- Takes the component of a configuration from the open configurations.
local function take_component(search, root)
  local component = {}
  repeat
    local number = table.remove(search.open)
    search.is_open[number] = false
    component[#component + 1] = number
  until number == root
  table.sort(component)
  search.components[#search.components + 1] = component
end

-- Goes on with the visit on top of the stack: deeper, or back.
local function visit_next(walk, search, visits)
  local visit, low = visits[#visits], search.low
  if visit.at <= visit.last then
    local tgt = abs(walk.steps[visit.at])
    visit.at = visit.at + 1
    if search.set and not search.set[tgt] then
      return
    elseif not search.order[tgt] then
      visits[#visits + 1] = new_visit(walk, search, tgt)
    elseif search.is_open[tgt] then
      low[visit.number] = min(low[visit.number], search.order[tgt])
    end
    return
  end
  visits[#visits] = nil
  local above = visits[#visits]
  if above then low[above.number] = min(low[above.number], low[visit.number]) end
  if low[visit.number] == search.order[visit.number] then
    take_component(search, visit.number)
  end
end

local function leads_out(walk, component)
  local is_in, leaves = {}, false
  for _, number in ipairs(component) do is_in[number] = true end
  for _, number in ipairs(component) do
    graph.each_step(walk, number, function(tgt) leaves = leaves or not is_in[tgt] end)
  end
  return leaves
end

--- List the sets of configurations that lead to each other, each sorted, in the order
--- of their first ones.
---@param walk rfsm_checks.Walk
---@param set? table<integer, boolean> look at these alone
---@return integer[][] components
function graph.components_in(walk, set)
  local search = { count = 0, order = {}, low = {}, open = {}, is_open = {},
    components = {}, set = set }
  for number = 1, set and walk.expanded or 1 do
    if not (search.order[number] or set and not set[number]) then
      local visits = { new_visit(walk, search, number) }
      while visits[1] do visit_next(walk, search, visits) end
    end
  end
  table.sort(search.components, function(a, b) return a[1] < b[1] end)
  return search.components
end

--- List the sets of configurations that lead to each other.
---@return integer[][] bottoms those that lead nowhere else, each sorted
---@return integer[][] others
function graph.components(walk)
  local bottoms, others = {}, {}
  for _, component in ipairs(graph.components_in(walk)) do
    local list = leads_out(walk, component) and others or bottoms
    list[#list + 1] = component
  end
  return bottoms, others
end

return graph
