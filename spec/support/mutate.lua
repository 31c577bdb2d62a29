-- Mutants of a chart: one thing in it is wrong.

local rfsm = require "rfsm"

local mutate = {}

-- Lists the transitions of a model with their composites and keys.
local function transitions_of(model)
  local list = {}
  rfsm.mapfsm(function(tr, parent, key)
    list[#list + 1] = { tr = tr, parent = parent, key = key }
  end, model, rfsm.is_trans)
  return list
end

-- A state beside a transition that is not its target; nil if there is none.
local function other_target(entry)
  local names = {}
  rfsm.mapfsm(function(_, _, name)
    if name ~= entry.tr.tgt then names[#names + 1] = name end
  end, entry.parent, rfsm.is_state, 1)
  return names[1]
end

-- Each calls `add(change)` for each mutant of transition i of a list; `change` gets
-- the same of another copy of the model.
local KINDS = {
  { "removed", function(add)
    add(function(own) own.parent[own.key] = nil end)
  end },
  { "retargeted", function(add, entry)
    local name = other_target(entry)
    if not name or type(entry.tr.tgt) ~= "string" then return end
    add(function(own) own.tr.tgt = name end)
  end },
  { "renamed", function(add, entry)
    local events = type(entry.tr.events) == "table" and entry.tr.events or {}
    for i = 1, #events do
      local copy = {}
      for n, event in ipairs(events) do copy[n] = n == i and "e_renamed" or event end
      add(function(own) own.tr.events = copy end)
    end
  end },
  { "swapped", function(add, entry, i, list)
    for j = i + 1, #list do
      local tr, other = entry.tr, list[j].tr
      if tr.src == other.src and entry.parent == list[j].parent
        and (tr.pn or 0) ~= (other.pn or 0) then
        add(function(own, all)
          own.tr.pn, all[j].tr.pn = all[j].tr.pn or 0, own.tr.pn or 0
        end)
      end
    end
  end },
  { "internal", function(add, entry)
    if entry.tr.src ~= "initial" then add(function(own) own.tr.tgt = "internal" end) end
  end },
  { "guarded", function(add, entry)
    if entry.tr.guard then return end
    add(function(own) own.tr.guard = function() return true end end)
  end },
  { "event added", function(add, entry, _, list)
    for _, other in ipairs(list) do
      local event = type(other.tr.events) == "table" and other.tr.events[1]
      local events = type(entry.tr.events) == "table" and entry.tr.events or {}
      if event and event ~= events[1] and event ~= events[2] then
        local more = { event }
        for n, own in ipairs(events) do more[n + 1] = own end
        return add(function(own) own.tr.events = more end)
      end
    end
  end },
  { "event removed", function(add, entry)
    local events = type(entry.tr.events) == "table" and entry.tr.events or {}
    for i = 1, #events do
      local rest = {}
      for n, event in ipairs(events) do
        if n ~= i then rest[#rest + 1] = event end
      end
      add(function(own) own.tr.events = rest end)
    end
  end },
  { "pn changed", function(add, entry)
    for _, pn in ipairs { -10, 10 } do
      add(function(own) own.tr.pn = (entry.tr.pn or 0) + pn end)
    end
  end },
  { "time changed", function(add, entry)
    local old_events = type(entry.tr.events) == "table" and entry.tr.events or {}
    for i, event in ipairs(old_events) do
      local other = type(event) == "string" and event:gsub("^(e_after%()([%d.]+)",
        function(head, seconds) return head .. tonumber(seconds) * 2 + 1 end)
      if other and other ~= event then
        add(function(own)
          local events = {}
          for n, old in ipairs(own.tr.events) do events[n] = n == i and other or old end
          own.tr.events = events
        end)
      end
    end
  end },
  { "negated", function(add, entry) -- when the chart is rehearsed
    if entry.tr.guard then add(function(own) own.tr.negated = true end) end
  end },
}

-- Lists the leaves of a model with their paths.
local function leaves_of(model)
  local list = {}
  rfsm.mapfsm(function(state) list[#list + 1] = state end, model, rfsm.is_leaf)
  return list
end

local function add_doo_mutants(all, load)
  for i, leaf in ipairs(leaves_of(load())) do
    if not leaf.substates then
      local kind = leaf.doo and "doo removed" or "doo added"
      local function doo() rfsm.yield(true) end
      all[#all + 1] = { kind = kind, at = i, model = function()
        local model = load()
        leaves_of(model)[i].doo = not leaf.doo and doo or nil
        return model
      end }
    end
  end
end

--- Lists the mutants of a chart: `kind`, `model()` makes it. `load` returns the chart.
function mutate.all(load)
  local all, list = {}, transitions_of(load())
  for _, kind in ipairs(KINDS) do
    for i, entry in ipairs(list) do
      kind[2](function(change)
        all[#all + 1] = { kind = kind[1], at = i, model = function()
          local model = load()
          local own = transitions_of(model)
          change(own[i], own)
          return model
        end }
      end, entry, i, list)
    end
  end
  add_doo_mutants(all, load)
  return all
end

--- Moves the transitions of each composite, so that those of one source keep their
--- order.
function mutate.reorder(model)
  local by_parent, is_listed = {}, {}
  for _, entry in ipairs(transitions_of(model)) do
    by_parent[entry.parent] = by_parent[entry.parent] or {}
    if type(entry.key) == "number" and not is_listed[entry.tr] then -- mounted once
      is_listed[entry.tr] = true
      table.insert(by_parent[entry.parent], entry)
    end
  end
  for parent, list in pairs(by_parent) do -- any order: each stands alone
    local keys = {}
    for i, entry in ipairs(list) do keys[i], entry.rank = entry.key, i end
    table.sort(list, function(a, b)
      local first, second = tostring(a.tr.src), tostring(b.tr.src)
      if first ~= second then return first > second end
      return a.rank < b.rank
    end)
    for i, entry in ipairs(list) do parent[keys[i]] = entry.tr end
  end
  return model
end

--- Negates the guards of a rehearsal that are to be.
function mutate.negate(run)
  for _, entry in ipairs(run.subject.transitions) do
    if entry.tr.negated then
      local guard = entry.tr.guard
      entry.tr.guard = function(...) return not guard(...) end
    end
  end
end

return mutate
