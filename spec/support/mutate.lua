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

-- Names of the states beside a transition, but for its target.
local function other_targets(entry)
  local names = {}
  rfsm.mapfsm(function(_, _, name)
    if name ~= entry.tr.tgt then names[#names + 1] = name end
  end, entry.parent, rfsm.is_state, 1)
  return names
end

local KINDS = {}

function KINDS.removed(list)
  local mutants = {}
  for i in ipairs(list) do
    mutants[i] = { at = i, change = function(entry)
      entry.parent[entry.key] = nil
    end }
  end
  return mutants
end

function KINDS.retargeted(list)
  local mutants = {}
  for i, entry in ipairs(list) do
    local name = other_targets(entry)[1]
    if name and type(entry.tr.tgt) == "string" then
      mutants[#mutants + 1] = { at = i, change = function(own) own.tr.tgt = name end }
    end
  end
  return mutants
end

function KINDS.renamed(list)
  local mutants = {}
  for i, entry in ipairs(list) do
    local events = entry.tr.events
    for j = 1, type(events) == "table" and #events or 0 do
      mutants[#mutants + 1] = { at = i, change = function(own)
        local copy = {}
        for n, event in ipairs(own.tr.events) do copy[n] = event end
        copy[j] = "e_renamed"
        own.tr.events = copy
      end }
    end
  end
  return mutants
end

function KINDS.swapped(list)
  local mutants = {}
  for i, entry in ipairs(list) do
    for j = i + 1, #list do
      local tr, other = entry.tr, list[j].tr
      if tr.src == other.src and entry.parent == list[j].parent
        and (tr.pn or 0) ~= (other.pn or 0) then
        mutants[#mutants + 1] = { at = i, change = function(own, all)
          own.tr.pn, all[j].tr.pn = all[j].tr.pn or 0, own.tr.pn or 0
        end }
      end
    end
  end
  return mutants
end

-- A guard is negated when the chart is rehearsed.
function KINDS.negated(list)
  local mutants = {}
  for i, entry in ipairs(list) do
    if entry.tr.guard then
      mutants[#mutants + 1] = { at = i, change = function(own)
        own.tr.negated = true
      end }
    end
  end
  return mutants
end

local ORDER = { "removed", "retargeted", "renamed", "swapped", "negated" }

--- Lists the mutants of a chart: `kind`, `model()` makes it. `load` returns the chart.
function mutate.all(load)
  local all, list = {}, transitions_of(load())
  for _, kind in ipairs(ORDER) do
    for _, mutant in ipairs(KINDS[kind](list)) do
      all[#all + 1] = { kind = kind, at = mutant.at, model = function()
        local model = load()
        local own = transitions_of(model)
        mutant.change(own[mutant.at], own)
        return model
      end }
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
