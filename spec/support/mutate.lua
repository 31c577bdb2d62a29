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
  { "negated", function(add, entry) -- when the chart is rehearsed
    if entry.tr.guard then add(function(own) own.tr.negated = true end) end
  end },
}

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
  return all
end

--- Negates the guards of a rehearsal that are to be.
function mutate.negate(run)
  for _, entry in ipairs(run.puppet.transitions) do
    if entry.tr.negated then
      local guard = entry.tr.guard
      entry.tr.guard = function(...) return not guard(...) end
    end
  end
end

return mutate
