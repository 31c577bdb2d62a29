-- A snapshot that goes through a random change of its chart keeps what both charts
-- have, gets first values for the rest, and is refused with the list of what would be
-- lost. `diff` has told before whether machines in its state move.
--
-- The expectation comes from descriptions of the charts, not from the library.

local clock = { now = 100 }

local diff = require "rfsm.snapshot.diff"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"
require "rfsm.seqand"

-- Descriptions ----------------------------------------------------------------------

local FIELDS = { "u", "v", "w" }

local function new_fields(random)
  local fields = {}
  for _, name in ipairs(FIELDS) do
    if random:chance(40) then fields[name] = random:below(9) end
  end
  return fields
end

-- A region has the states x and y, fields in its root, and is in x.
local function new_regions(random)
  local regions = {}
  for _, name in ipairs { "left", "right" } do
    if random:chance(60) then regions[name] = new_fields(random) end
  end
  return next(regions) and regions or { left = new_fields(random) }
end

-- States that follow each other on e_next. A state has a name, fields, a timer and may
-- have regions.
local function new_description(random)
  local chart = { fields = new_fields(random) }
  for i = 1, 2 + random:below(3) do
    chart[i] = { name = "s" .. i, fields = new_fields(random),
      timer = random:chance(50) and 10 + random:below(5) or nil,
      regions = random:chance(40) and new_regions(random) or nil }
  end
  return chart
end

local function names_of(fields)
  local names = {}
  for _, name in ipairs(FIELDS) do
    if fields[name] then names[#names + 1] = name end
  end
  return names
end

local function with_fields(t, fields)
  t.keep = names_of(fields)
  for name, value in pairs(fields) do t[name] = value end -- any order: a copy
  return t
end

local function new_region(fields)
  return rfsm.state(with_fields({ info = false, warn = false, emem = false,
    x = rfsm.state {}, y = rfsm.state {}, rfsm.trans { src = "initial", tgt = "x" },
    rfsm.trans { src = "x", tgt = "y", events = { "e_y" } } }, fields))
end

local function new_state(described)
  local fields = with_fields({}, described.fields)
  if not described.regions then return rfsm.state(fields) end
  for name, region in pairs(described.regions) do -- any order: a set
    fields[name] = new_region(region)
  end
  return rfsm.seqand(fields)
end

local function build(chart)
  local model = with_fields({ info = false, warn = false, emem = false,
    rfsm.trans { src = "initial", tgt = chart[1].name } }, chart.fields)
  for i, described in ipairs(chart) do
    local to = chart[i % #chart + 1].name
    model[described.name] = new_state(described)
    model[#model + 1] = rfsm.trans { src = described.name, tgt = to,
      events = { "e_next" } }
    if described.timer then
      model[#model + 1] = rfsm.trans { src = described.name, tgt = to,
        events = { ("e_after(%d)"):format(described.timer) } }
    end
  end
  return rfsm.state(model)
end

local function copy(value)
  if type(value) ~= "table" then return value end
  local t = {}
  for key, inner in pairs(value) do t[key] = copy(inner) end -- any order: a copy
  return t
end

local function same(a, b)
  if type(a) ~= "table" or type(b) ~= "table" then return a == b end
  for key, value in pairs(a) do -- any order: all of them
    if not same(value, b[key]) then return false end
  end
  for key in pairs(b) do -- any order: all of them
    if a[key] == nil then return false end
  end
  return true
end

-- Changes: each notes what it is ----------------------------------------------------

local function change_fields(random, fields)
  local name = random:pick(FIELDS)
  fields[name] = not fields[name] and random:below(9) + 20 or nil
end

local CHANGES = {
  function(random, chart) change_fields(random, chart.fields) end,
  function(random, chart) change_fields(random, random:pick(chart).fields) end,
  function(random, chart)
    local state = random:pick(chart)
    local name, regions = random:pick { "left", "right" }, state.regions
    if not regions then return end
    if regions[name] and not regions[name == "left" and "right" or "left"] then
      return change_fields(random, regions[name])
    end
    regions[name] = not regions[name] and new_fields(random) or nil
  end,
  function(random, chart)
    local state = random:pick(chart)
    state.timer = random:chance(70) and 20 + random:below(5) or nil
  end,
  function(random, chart)
    local state = random:pick(chart)
    state.was = state.was or state.name
    state.name = state.was .. "renamed" .. random:below(99)
  end,
  function(random, chart)
    chart[#chart + 1] = { name = "added" .. #chart, fields = new_fields(random),
      is_added = true }
  end,
}

-- What is expected ------------------------------------------------------------------

local function old_of(chart, state)
  for _, other in ipairs(chart) do
    if not state.is_added and other.name == (state.was or state.name) then
      return other
    end
  end
end

-- Is the structure another one, fields and regions apart?
local function is_restructured(old, new)
  if #old ~= #new then return true end
  for i, state in ipairs(new) do
    if state.name ~= old[i].name or state.timer ~= old[i].timer then return true end
  end
  return false
end

local function note_lost(lost, old, new, where)
  for name in pairs(old) do -- any order: sorted below
    if not (new and new[name]) then
      lost[#lost + 1] = ("field %s of %s"):format(name, where)
    end
  end
end

-- What would be lost by way of `rename`. A region is held if it keeps fields, or runs.
local function list_lost(old, new, leaf)
  local lost = {}
  note_lost(lost, old.fields, new.fields, "root")
  for _, state in ipairs(new) do
    local before, where = old_of(old, state), "root." .. state.name
    if before then note_lost(lost, before.fields, state.fields, where) end
    for name, fields in pairs(before and before.regions or {}) do -- any order
      local is_held = next(fields) ~= nil or before.name == leaf
      if state.regions and state.regions[name] then
        note_lost(lost, fields, state.regions[name], where .. "." .. name)
      elseif is_held then
        lost[#lost + 1] = "region " .. where .. "." .. name
      end
    end
  end
  table.sort(lost)
  return lost
end

local function value_of(name, first) return name .. "=" .. first end

-- Sets all fields of a machine to values that follow from their first ones.
local function set_all(fsm, chart)
  local function set(owner, fields)
    for name, first in pairs(fields) do owner[name] = value_of(name, first) end
  end
  set(fsm, chart.fields)
  for _, state in ipairs(chart) do
    set(fsm[state.name], state.fields)
    for name, fields in pairs(state.regions or {}) do -- any order: each stands alone
      set(fsm[state.name].substates[name], fields)
    end
  end
end

-- Returns the first field that is not as it should be.
local function wrong_field(owner, new, old, where)
  for _, name in ipairs(FIELDS) do
    local expected = new[name]
    if expected and old and old[name] then expected = value_of(name, old[name]) end
    if owner[name] ~= expected then
      return ("%s.%s is %s, not %s"):format(where, name, tostring(owner[name]),
        tostring(expected))
    end
  end
end

local function wrong_state(fsm, state, before, leaf)
  local problem = wrong_field(fsm[state.name], state.fields, before and before.fields,
    state.name)
  for name, fields in pairs(state.regions or {}) do -- any order: any one is wrong
    local was = before and before.regions and before.regions[name]
    local region = fsm[state.name].substates[name]
    problem = problem or wrong_field(region, fields, was, state.name .. "." .. name)
    local is_in = was and before.name == leaf and "root.x" or false
    if rfsm.get_actleaf_fqn(region) ~= is_in then
      problem = problem or state.name .. "." .. name .. " is in another state"
    end
  end
  return problem
end

-- Returns what is wrong with a machine that has moved.
local function find_wrong(fsm, old, new, leaf, passed)
  local problem = wrong_field(fsm, new.fields, old.fields, "root")
  for _, state in ipairs(new) do
    local before = old_of(old, state)
    problem = problem or wrong_state(fsm, state, before, leaf)
    if before and before.name == leaf then
      if rfsm.get_actleaf_fqn(fsm) ~= "root." .. state.name then
        return "it is in " .. tostring(rfsm.get_actleaf_fqn(fsm))
      end
      local left = state.timer
      if left and left == before.timer then left = left - passed end
      local deadline = timeevent.next_deadline(fsm)
      if (deadline and math.floor(deadline + 0.5)) ~= left then
        problem = problem or ("timer: %s left, not %s"):format(tostring(deadline),
          tostring(left))
      end
    end
  end
  return problem
end

-- One case --------------------------------------------------------------------------

local function rename_of(new)
  local rename = nil
  for _, state in ipairs(new) do
    if state.was then
      rename = rename or {}
      rename["root." .. state.was] = "root." .. state.name
    end
  end
  return rename
end

local function without(lost)
  return function(snap)
    local unpack = require("rfsm.snapshot.encoding").unpack
    for _, text in ipairs(lost) do
      local name, fqn = text:match("^field (%w+) of (.*)$")
      local region = text:match("^region (.*)$") or fqn
      local part = snap.regions and snap.regions[region]
      if not fqn then
        snap.regions[region] = nil
      else
        local data, at = (part or snap).data, part and "root" or fqn
        data[at] = unpack(data[at], 1)
        data[at][name] = nil
      end
    end
    return snap
  end
end

-- Returns a snapshot of a machine of a chart somewhere on its way, its leaf, and how
-- long it is there.
local function take_somewhere(random, chart)
  local fsm, passed = assert(rfsm.init(build(chart))), random:below(9)
  clock.now = 100
  rfsm.run(fsm)
  for _ = 1, random:below(6) do
    rfsm.send_events(fsm, "e_next")
    rfsm.run(fsm)
  end
  set_all(fsm, chart)
  clock.now = clock.now + passed
  return snapshot.take(fsm), fsm._act_leaf._id, passed
end

-- Has a chart that would lose something refuse a snapshot; returns the machine that it
-- becomes when that is taken away.
local function move_with_losses(new, snap, options, lost)
  local moved, _, list = snapshot.restore(build(new), snap, options)
  table.sort(list or {})
  if moved or table.concat(list, "; ") ~= table.concat(lost, "; ") then
    return false, "lost: " .. table.concat(lost, "; ") .. "; reported: "
      .. table.concat(list or {}, "; ")
  end
  options.migrate = without(lost)
  return snapshot.restore(build(new), snap, options)
end

local function move_without(new, snap, options)
  return snapshot.restore(build(new), snap, options)
end

-- Returns what is wrong with the fate of machines in a leaf. They move if nothing is
-- lost; those in the other states of a region do so, too.
local function wrong_fate(old, new, leaf, is_lost, rename)
  local model = build(new)
  model.rename, model.migrate = rename, function() end
  local _, fates = diff.compare(build(old), model)
  for _, fate in ipairs(fates) do
    local at = fate.leaf:match("^root%.(%w+)")
    if at == leaf and (fate.to == false) ~= is_lost then
      return fate.leaf .. " was told to " .. (fate.to and "move" or "stay")
    end
  end
end

local function run_case(random)
  local old = new_description(random)
  local snap, leaf, passed = take_somewhere(random, old)
  local new = copy(old)
  for _ = 1, random:below(3) do random:pick(CHANGES)(random, new) end
  local lost, options = list_lost(old, new, leaf), { rename = rename_of(new) }
  if is_restructured(old, new) then
    local plain, problem = snapshot.restore(build(new), snap)
    if plain or not problem:find("of another chart", 1, true) then
      return "another structure was accepted"
    end
    if not options.rename then options.migrate = function() end end
  end
  local wrong = wrong_fate(old, new, leaf, lost[1] ~= nil, options.rename)
  if wrong then return wrong end
  local before, move = copy(snap), lost[1] and move_with_losses or move_without
  local moved, text = move(new, snap, options, lost)
  if not moved then return text end
  if not same(before, snap) then return "the snapshot of the caller was changed" end
  return find_wrong(moved, old, new, leaf, passed)
end

return { name = "snapshots through changes of a chart", run = function(n, seed)
  timeevent.set_gettime_hook(function() return clock.now, 0 end)
  local problem = nil
  for i = 1, n do
    local wrong = run_case(new_random(seed * 7919 + i))
    if wrong then
      problem = ("seed %d, case %d: %s"):format(seed, i, wrong)
      break
    end
  end
  timeevent.set_gettime_hook(nil)
  return n, problem
end }
