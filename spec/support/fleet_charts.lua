-- Random charts of fleets: timers in states, around them and in regions, events with
-- data, effects that emit, send or reset. The module runs in servers, too.

local new_random = require "spec.support.random"
local rfsm = require "rfsm"
require "rfsm_seqand"
require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans

local charts = {}

-- Returns the machine around a region.
local function outermost(fsm)
  while fsm._owner do fsm = fsm._owner end
  return fsm
end

-- Returns an effect that writes a letter into the log, which the chart keeps, and at
-- times sends an event, or resets the machine.
local function new_effect(random, letter)
  local does = random:below(12)
  return function(fsm, _, _, events)
    local outer, by = outermost(fsm), ""
    for _, event in ipairs(events) do
      if type(event) == "table" then by = by .. event.by end
    end
    outer.log = outer.log .. letter .. by
    outer.count = outer.count + 1
    if does == 1 and outer.count % 4 == 1 then rfsm.send_events(fsm, "e_b") end
    if does == 2 and outer.count % 3 == 0 then rfsm.reset(outer) end
    if does == 3 then outer.emit("did", { by = letter }) end
  end
end

local function new_events(random)
  local list = {}
  for _, event in ipairs { "e_a", "e_b", rfsm.named "e_c" } do
    if random:chance(40) then list[#list + 1] = event end
  end
  if random:chance(50) or not list[1] then
    list[#list + 1] = ("e_after(%g)"):format(random:below(12) / 4)
  end
  return list
end

-- Adds states, in a row or nested, and transitions between them to a composite.
local function add_states(random, model, prefix, depth)
  local count = 1 + random:below(3)
  for i = 1, count do
    local name = "s" .. i
    if depth > 0 and random:chance(40) then
      model[name] = state(add_states(random, {}, prefix .. i, depth - 1))
    else
      model[name] = state {}
    end
  end
  model[1] = trans { src = "initial", tgt = "s1" }
  for i = 1, count + random:below(2) do
    local letter = prefix .. ("abcdefgh"):sub(i, i)
    model[i + 1] = trans { src = "s" .. (i - 1) % count + 1,
      tgt = random:chance(20) and "internal" or "s" .. random:below(count),
      events = new_events(random), effect = new_effect(random, letter),
      guard = random:chance(20) and function(tr)
        return outermost(tr._fsm).count % 2 == 0
      end or nil }
  end
  return model
end

--- Returns the chart of a seed; `extend(model)` may add to it.
function charts.new(seed, extend)
  local random = new_random(seed * 7 + 1)
  local model = add_states(random, {}, "", 2)
  if random:chance(30) then
    model.s1 = rfsm.seqand { step = 20,
      x = state(add_states(random, {}, "x", 1)),
      y = state(add_states(random, {}, "y", 0)) }
  end
  model[#model + 1] = trans { src = "s1", tgt = "s1", events = { "e_a", "e_b",
    rfsm.named "e_c" }, guard = function() return false end } -- all are known
  model.keep, model.log, model.count, model.emem = { "log", "count" }, "", 0, false
  model.info, model.warn, model.err = false, false, false
  if extend then extend(model) end
  return state(model)
end

--- Lists the leaves of a chart.
function charts.leaves(seed)
  local names = {}
  for i, leaf in ipairs(rfsm.elements(rfsm.init(charts.new(seed)), rfsm.is_leaf)) do
    names[i] = leaf._fqn
  end
  return names
end

return charts
