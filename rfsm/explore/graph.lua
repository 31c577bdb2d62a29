--- Graph: which configurations of a walk can be reached from others, and its cycles.
--
-- An *internal* step needs no event from outside.
--
-- @module rfsm.explore.graph
-- @license BSD-3-Clause

local ipairs = ipairs
local abs, min = math.abs, math.min
local insert, remove, sort = table.insert, table.remove, table.sort

local graph = {}

--- Call `f(tgt, is_internal, position)` for each step from a configuration. `position`
--- is the place of the step in `walk.steps`.
---@param walk rfsm_checks.Walk
---@param number integer number of the configuration
---@param f fun(tgt: integer, is_internal: boolean, position: integer)
function graph.each_step(walk, number, f)
  for i = walk.first[number] or 1, (walk.first[number + 1] or 1) - 1 do
    local step = walk.steps[i]
    if step < 0 then f(-step, true, i) else f(step, false, i) end
  end
end

-- Calls f(from, tgt) for each step; if `is_internal`, for internal steps only.
local function each_edge(walk, is_internal, f)
  for from = 1, walk.expanded do
    for at = walk.first[from], walk.first[from + 1] - 1 do
      local step = walk.steps[at]
      if step < 0 or not is_internal then f(from, abs(step)) end
    end
  end
end

-- Returns a list of the sources of all steps: first of the steps to configuration 1,
-- then of those to 2, and so on. The sources of the steps to configuration n begin
-- behind position before[n] of the list.
local function reverse(walk, is_internal)
  local list, before, count = {}, { 0 }, #walk.keys
  for number = 1, count do before[number + 1] = 0 end
  each_edge(walk, is_internal, function(_, tgt)
    before[tgt], list[#list + 1] = before[tgt] + 1, 0
  end)
  for number = 2, count + 1 do before[number] = before[number] + before[number - 1] end
  each_edge(walk, is_internal, function(from, tgt)
    list[before[tgt]], before[tgt] = from, before[tgt] - 1
  end)
  return list, before
end

-- Returns a set that begins with the goals and grows. For each step that leads into the
-- set, joins(from, tgt, set) decides whether the configuration `from` is added.
local function spread(walk, goals, is_internal, joins)
  local set, pending, list, before = {}, {}, reverse(walk, is_internal)
  for number = 1, #walk.keys do
    set[number] = goals[number]
    if set[number] then pending[#pending + 1] = number end
  end
  while pending[1] do
    local number = remove(pending)
    for at = before[number] + 1, before[number + 1] do
      local from = list[at]
      if not set[from] and joins(from, number, set) then
        set[from], pending[#pending + 1] = true, from
      end
    end
  end
  return set
end

--- Return the set of configurations from which one of `goals` can be reached.
---@param walk rfsm_checks.Walk
---@param goals table<integer, boolean>
---@param is_internal boolean? use only steps that need no event from outside
---@param within? table<integer, boolean> use only these configurations on the way
---@return table<integer, boolean> set
function graph.can_reach(walk, goals, is_internal, within)
  return spread(walk, goals, is_internal, function(from)
    return not within or within[from]
  end)
end

-- Does a step lead into the set, whatever the clocks of the configuration show? It does
-- if a step into the set depends on no deadline, or if each group of deadlines that may
-- be over first has a step into the set.
local function leads_surely(walk, number, set)
  local ways, is_counted, is_sure = 0, {}, false
  graph.each_step(walk, number, function(tgt, _, at)
    local group = walk.unsure[at]
    if set[tgt] and not group then
      is_sure = true
    elseif set[tgt] and not is_counted[group] then
      is_counted[group], ways = true, ways + 1
      is_sure = is_sure or ways == walk.ways[number]
    end
  end)
  return is_sure
end

--- Return the set of configurations from which one of `goals` can be reached, whatever
--- the clocks of the configurations show.
---@param walk rfsm_checks.Walk
---@param goals table<integer, boolean>
---@return table<integer, boolean> set
function graph.can_surely_reach(walk, goals)
  return spread(walk, goals, false, function(from, _, set)
    return leads_surely(walk, from, set)
  end)
end

-- Counts the steps that need no event from outside. A step in which a doo goes on and
-- nothing changes is not among the steps of a walk.
local function count_internal(walk, number)
  local count = 0
  graph.each_step(walk, number, function(_, is_internal)
    if is_internal then count = count + 1 end
  end)
  return count
end

--- Return the set of configurations from which the machine always comes to one of
--- `goals` without events from outside. Each doo is assumed to end at some time.
---@param walk rfsm_checks.Walk
---@param goals table<integer, boolean>
---@return table<integer, boolean> set
function graph.must_reach(walk, goals)
  local ends, left = {}, {}
  for number = 1, #walk.keys do -- a step not tried may lead to a goal
    ends[number] = goals[number] or number > walk.expanded or walk.cut[number]
  end
  return spread(walk, ends, true, function(from, tgt)
    left[from] = left[from] or count_internal(walk, from)
    if from ~= tgt then left[from] = left[from] - 1 end
    return left[from] == 0
  end)
end

-- Begins a visit in Tarjan's search for strongly connected components. The stack
-- `visits` has the configurations being visited, `at` the position of their next steps.
local function visit(walk, search, number)
  local depth = #search.visits + 1
  search.count = search.count + 1
  search.order[number], search.low[number] = search.count, search.count
  search.open[#search.open + 1] = number
  search.visits[depth], search.at[depth] = number, walk.first[number] or 1
end

-- Takes configurations from the stack `open`, down to `root`, and makes a component.
local function take_component(search, root)
  local component, index = {}, #search.components + 1
  repeat
    local number = remove(search.open)
    search.index_of[number] = index
    component[#component + 1] = number
  until number == root
  sort(component)
  search.components[index] = component
end

-- Follows the next step of the visit on top of the stack, or ends the visit.
local function visit_next(walk, search)
  local low, order, depth = search.low, search.order, #search.visits
  local number, at = search.visits[depth], search.at[depth]
  if at < (walk.first[number + 1] or 1) then
    local step, tgt = walk.steps[at], abs(walk.steps[at])
    search.at[depth] = at + 1
    if search.set and not search.set[tgt] or search.is_internal and step > 0 then
      return
    elseif not order[tgt] then
      visit(walk, search, tgt)
    elseif not search.index_of[tgt] then
      low[number] = min(low[number], order[tgt])
    end
    return
  end
  search.visits[depth], search.at[depth] = nil, nil
  local above = search.visits[depth - 1]
  if above then low[above] = min(low[above], low[number]) end
  if low[number] == order[number] then take_component(search, number) end
end

--- Return the shortest way from a configuration to a wanted edge, as a list of edges.
---@param edges table<integer, table[]> configuration -> its edges { from, tgt }
---@param start integer
---@param is_wanted fun(edge: table): boolean
---@return table[]? way its last edge is the wanted one; nil if there is no such way
function graph.find_way(edges, start, is_wanted)
  local came, list = { [start] = false }, { start }
  for _, number in ipairs(list) do -- the loop appends to the list
    for _, edge in ipairs(edges[number] or {}) do
      if is_wanted(edge) then
        local way = { edge }
        while came[way[1].from] do insert(way, 1, came[way[1].from]) end
        return way
      end
      if came[edge.tgt] == nil then
        came[edge.tgt], list[#list + 1] = edge, edge.tgt
      end
    end
  end
end

-- Does a step lead from this component to another component?
local function leads_out(walk, component, index_of)
  local own, is_left = index_of[component[1]], false
  for _, number in ipairs(component) do
    graph.each_step(walk, number, function(tgt)
      is_left = is_left or index_of[tgt] ~= own
    end)
  end
  return is_left
end

--- List the strongly connected components: sets of configurations that can all reach
--- each other. Each set is sorted, and the sets are sorted by their first items.
---@param walk rfsm_checks.Walk
---@param set? table<integer, boolean> consider only these configurations
---@param is_internal? boolean consider only steps that need no event from outside
---@return integer[][] components
---@return table<integer, integer> index_of configuration -> a number of its component,
-- which is not its position in the list
function graph.components_in(walk, set, is_internal)
  local search = { count = 0, order = {}, low = {}, open = {}, visits = {}, at = {},
    components = {}, index_of = {}, set = set, is_internal = is_internal }
  for number = 1, set and walk.expanded or 1 do
    if not (search.order[number] or set and not set[number]) then
      visit(walk, search, number)
      while search.visits[1] do visit_next(walk, search) end
    end
  end
  sort(search.components, function(a, b) return a[1] < b[1] end)
  return search.components, search.index_of
end

--- List the strongly connected components, each sorted, in two lists.
---@return integer[][] bottoms components from which no step leads to another component
---@return integer[][] others the other components
function graph.components(walk)
  local bottoms, others = {}, {}
  local components, index_of = graph.components_in(walk)
  for _, component in ipairs(components) do
    local list = leads_out(walk, component, index_of) and others or bottoms
    list[#list + 1] = component
  end
  return bottoms, others
end

return graph
