-- Random charts, as plain data: the same seed gives the same chart on every Lua.
--
-- A chart is
--   names        F of all nodes, parents before children
--   nodes        F -> { kind = "state"|"connector", parent, id, is_leaf, entry, ... }
--   transitions  { src, tgt (F), src_ref, tgt_ref (as written), owner, key, pn, guard,
--                  effect, events (expanded), events_ref (as written), index,
--                  is_internal, was_internal (at first) }
--   merges       { fqn, node, transitions }: a leaf that may be merged, and what leads
--                  to it and away from it
--   programs     id of a callback -> the actions of its 1st, 2nd, ... call (then again
--                from the first): false or { "send"|"raise"|"reset"|"trace"..., value }
--   ops          what the run does: { "send", ... } { "step", n } { "run" } { "reset" }
--                { "merge", n }
--   traced       false: dbg is off at first; programs may switch it

local new_random = require "spec.support.random"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local charts = {}

-- Events that are no strings: compared by identity, and never copied.
local Object = { __tostring = function(self) return self.name end }
local OBJECT = setmetatable({ name = "OBJECT" }, Object)

-- These say that they equal each other, to whoever asks; nobody may.
local Liar = { __tostring = Object.__tostring, __eq = function() return true end }
local LIAR, OTHER_LIAR = setmetatable({ name = "LIAR" }, Liar),
  setmetatable({ name = "OTHER_LIAR" }, Liar)
local EVENTS = { "e1", "e2", "e3", "e4", 7, false, OBJECT, LIAR, OTHER_LIAR }

charts.OBJECTS = { OBJECT, LIAR, OTHER_LIAR }

-- Matches itself, and each event with a 2 in it; fails for numbers and for faults.
local function predicate(event)
  if event == 7 or type(event) == "table" and event.element then error("no text") end
  return tostring(event):find("2", 1, true) ~= nil
end

-- Nodes -----------------------------------------------------------------------

local function add_node(chart, parent, id, kind)
  local fqn = parent and parent .. "." .. id or id
  chart.names[#chart.names + 1] = fqn
  local is_leaf = kind == "state"
  chart.nodes[fqn] = { kind = kind, parent = parent, id = id, is_leaf = is_leaf }
  if parent then chart.nodes[parent].is_leaf = false end
  return fqn
end

local function add_children(chart, random, parent, depth)
  for i = 1, random:below(3) + (depth == 1 and 1 or 0) do
    if #chart.names >= 16 then return end
    local is_connector = (i > 1 or depth > 1) and random:chance(25)
    local fqn = add_node(chart, parent, ("abcd"):sub(i, i),
      is_connector and "connector" or "state")
    if not is_connector and depth < 5 and random:chance(35) then
      add_children(chart, random, fqn, depth + 1)
    end
  end
end

-- Gives composites their `initial`; the root always has one.
local function add_initials(chart, random)
  for i = 1, #chart.names do
    local fqn = chart.names[i]
    local node = chart.nodes[fqn]
    if node.kind == "state" and not node.is_leaf
      and (fqn == "root" or random:chance(85)) then
      local initial = add_node(chart, fqn, "initial", "connector")
      chart.nodes[initial].is_declared = random:chance(40)
    end
  end
end

-- References ------------------------------------------------------------------

local function is_below(fqn, owner) return fqn:sub(1, #owner + 1) == owner .. "." end

-- One of the ways to write F in a transition of `owner`.
local function reference_to(random, owner, fqn)
  if is_below(fqn, owner) then
    local path = fqn:sub(#owner + 2)
    if not path:find(".", 1, true) and random:chance(70) then return path end
    if random:chance(70) then return (random:chance(80) and "." or "..") .. path end
  end
  local short = fqn:sub(6)
  if short:find(".", 1, true) and random:chance(50) then return short end
  return fqn
end

--- Where a transition to F ends, nil when it may not end there.
function charts.entrance(chart, fqn)
  local node = chart.nodes[fqn]
  if node.kind == "connector" or node.is_leaf then return fqn end
  return chart.nodes[fqn .. ".initial"] and fqn .. ".initial" or nil
end

local entrance = charts.entrance

-- Transitions -----------------------------------------------------------------

local function random_events(chart, random, is_quiet)
  if random:chance(is_quiet and 85 or 10) then return nil end
  local events = {}
  for i = 1, random:below(3) do events[i] = random:pick(EVENTS) end
  if random:chance(5) then events = {} end
  if chart.is_tame then return (#events > 0 or is_quiet) and events or { "e1" } end
  if random:chance(15) then events[#events + 1] = "e_done" end
  if random:chance(7) then events[#events + 1] = predicate end
  return events
end

local function expand(events, src)
  local expanded = {}
  for i, event in ipairs(events or {}) do
    expanded[i] = event == "e_done" and "e_done@" .. src or event
  end
  return expanded
end

local function next_key(chart, random, owner)
  if random:chance(15) then return "t" .. #chart.transitions + 1 end
  local position = 1
  for _, tr in ipairs(chart.transitions) do
    if tr.owner == owner and type(tr.key) == "number" then position = position + 1 end
  end
  return position
end

local function add_transition(chart, random, owner, src, tgt, src_ref)
  local is_quiet = chart.nodes[src].kind == "connector"
  local events = random_events(chart, random, is_quiet)
  if chart.is_tame and not is_quiet and not events then events = { "e2" } end
  local tr = {
    owner = owner, key = next_key(chart, random, owner), src = src,
    tgt = entrance(chart, tgt), src_ref = src_ref or reference_to(random, owner, src),
    tgt_ref = reference_to(random, owner, tgt), events_ref = events,
    events = expand(events, src), pn = random:chance(30) and random:below(3) - 1 or nil,
    guard = random:chance(30), effect = random:chance(40),
    index = #chart.transitions + 1,
  }
  if chart.nodes[src].kind == "state" and random:chance(8) then
    tr.is_internal, tr.was_internal, tr.tgt, tr.tgt_ref = true, true, src, "internal"
  end
  chart.transitions[tr.index] = tr
end

local function random_target(chart, random)
  for _ = 1, 20 do
    local fqn = random:pick(chart.names)
    if entrance(chart, fqn) then return fqn end
  end
  return "root"
end

-- A composite in which the transition may stand: an ancestor of src, often the nearest.
local function random_owner(chart, random, src)
  local owner = chart.nodes[src].parent or "root"
  while owner ~= "root" and random:chance(30) do owner = chart.nodes[owner].parent end
  return owner
end

local function children_of(chart, parent)
  local list = {}
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.parent == parent and node.id ~= "initial" and entrance(chart, fqn) then
      list[#list + 1] = fqn
    end
  end
  return list
end

local function add_initial_transitions(chart, random)
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.id == "initial" then
      local inside = children_of(chart, node.parent)
      for _ = 1, random:chance(25) and 2 or 1 do
        local tgt = inside[1] and random:chance(90) and random:pick(inside)
          or random_target(chart, random)
        add_transition(chart, random, node.parent, fqn, tgt, "initial")
      end
    end
  end
end

local function add_transitions(chart, random)
  add_initial_transitions(chart, random)
  for _ = 1, 2 + random:below(2 * #chart.names) do
    local src = random:pick(chart.names)
    local node = chart.nodes[src]
    if node.id ~= "initial" and (src ~= "root" or random:chance(30)) then
      local siblings = children_of(chart, node.parent or "root")
      local tgt = siblings[1] and random:chance(50) and random:pick(siblings)
        or random_target(chart, random)
      add_transition(chart, random, random_owner(chart, random, src), src, tgt)
    end
  end
end

-- Programs --------------------------------------------------------------------

local function random_action(chart, random)
  if random:chance(70) then return false end
  if random:chance(25) then return { "raise", "failed on purpose" } end
  if chart.is_tame then return false end
  if random:chance(8) then return { "reset" } end
  if random:chance(12) then return { "trace", random:chance(60) } end
  if random:chance(12) then return { "replace", random:below(100) } end
  if random:chance(12) then
    return { "retarget", random:below(100), random:below(100) }
  end
  local second = random:chance(30) and random:pick(EVENTS) or nil
  return { "send", random:pick(EVENTS), second }
end

local function add_program(chart, random, id)
  local actions = {}
  for i = 1, random:below(3) do actions[i] = random_action(chart, random) end
  chart.programs[id] = actions
end

local function add_guard(chart, random, id)
  local actions = {}
  for i = 1, random:below(3) do
    actions[i] = random:chance(40) and { "return", false }
      or random:chance(20) and { "return", true } or random_action(chart, random)
  end
  chart.programs[id] = actions
end

-- What a doo does before each yield; the last one may return instead.
local function add_doo(chart, random, id)
  local cycles = {}
  for i = 1, random:below(4) do
    cycles[i] = { action = random_action(chart, random), idle = random:chance(40) }
  end
  cycles[#cycles].is_return = random:chance(50)
  chart.programs[id] = cycles
end

local function add_getevents(chart, random)
  if chart.is_tame or not random:chance(40) then return end
  local actions = {}
  for i = 1, random:below(5) do
    actions[i] = random:chance(60) and false
      or random:chance(10) and { "raise", "getevents failed" }
      or { "return", { random:pick(EVENTS), random:chance(40) and "e1" or nil } }
  end
  chart.programs.getevents = actions
end

local function add_hook(chart, random, id)
  if not random:chance(25) then return end
  local actions = {}
  for i = 1, random:below(4) do
    actions[i] = random:chance(50) and false
      or random:chance(15) and { "raise", id .. " failed" }
      or random:chance(30) and { "clear" } or { "append", random:pick(EVENTS) }
  end
  if chart.is_tame then actions = { false } end
  chart.programs[id] = actions
end

local function add_printer(chart, random, id)
  chart.programs[id] = { false }
  if random:chance(8) then
    chart.programs[id] = { false, false, { "raise", id .. " failed" } }
  end
end

local function add_state_programs(chart, random)
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.kind == "state" then
      node.entry, node.exit = random:chance(70), random:chance(70)
      node.doo = node.is_leaf and random:chance(35)
      if node.entry then add_program(chart, random, "entry " .. fqn) end
      if node.exit then add_program(chart, random, "exit " .. fqn) end
      if node.doo then add_doo(chart, random, "doo " .. fqn) end
      if random:chance(10) then
        node.hooks = 1
        add_program(chart, random, "entry_hook 1 " .. fqn)
        add_program(chart, random, "exit_hook 1 " .. fqn)
      end
    end
  end
end

local function add_programs(chart, random)
  add_state_programs(chart, random)
  for i, tr in ipairs(chart.transitions) do
    if tr.guard then add_guard(chart, random, "guard " .. i) end
    if tr.effect then add_program(chart, random, "effect " .. i) end
  end
  add_getevents(chart, random)
  add_hook(chart, random, "pre_hook")
  add_hook(chart, random, "post_hook")
  add_printer(chart, random, "err")
  add_printer(chart, random, "warn")
  add_printer(chart, random, "dbg")
  if not chart.is_tame and random:chance(10) then
    add_program(chart, random, "idle_hook")
  end
end

-- Merges ----------------------------------------------------------------------

local function composites_of(chart)
  local list = {}
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.kind == "state" and not node.is_leaf then list[#list + 1] = fqn end
  end
  return list
end

-- A leaf with a transition that leads to it and one that leads away, by full names.
local function add_merge(chart, random, n)
  local parent = random:pick(composites_of(chart))
  local fqn, id = parent .. ".new" .. n, "new" .. n
  local node = { kind = "state", parent = parent, id = id, is_leaf = true,
    entry = random:chance(50) }
  local function transition(src, tgt, key)
    local events = { random:pick(EVENTS), random:chance(30) and "e_done" or nil }
    local is_leaf = src == fqn or chart.nodes[src].is_leaf
    if not is_leaf and random:chance(50) then events[2] = nil end
    return {
      owner = "root", key = id .. key, src = src, tgt = tgt, src_ref = src,
      tgt_ref = tgt, events_ref = events, events = expand(events, src),
      guard = false, effect = false,
      pn = random:chance(30) and random:below(3) - 1 or nil,
      index = 1000 + 2 * n + (key == "in" and 0 or 1),
    }
  end
  local src, tgt = random:pick(chart.names), random_target(chart, random)
  chart.merges[n] = { fqn = fqn, node = node, transitions = {
    transition(src, fqn, "in"), transition(fqn, entrance(chart, tgt) or fqn, "out"),
  } }
  if node.entry then add_program(chart, random, "entry " .. fqn) end
end

-- Operations ------------------------------------------------------------------

local function random_op(chart, random)
  if random:chance(45) then
    local op = { "send" }
    for i = 1, random:below(3) do op[i + 1] = random:pick(EVENTS) end
    return op
  end
  if random:chance(6) then return { "reset" } end
  if chart.is_tame and random:chance(50) then return { "run" } end
  return { "step", random:chance(60) and 1 or random:below(12) }
end

-- Makes some leaves final; composites with one may be done.
local function add_finals(chart, random)
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.is_leaf and node.kind == "state" then
      node.final = random:chance(25) or nil
    end
  end
end

-- Has some transitions from states need no event. A tame chart becomes idle.
local function add_always(chart, random)
  for _, tr in ipairs(chart.is_tame and {} or chart.transitions) do
    local is_any = chart.nodes[tr.src].kind == "state" and #tr.events == 0
    tr.always = is_any and random:chance(50) or nil
  end
end

--- The chart of `seed`.
function charts.generate(seed)
  local random = new_random(seed)
  local chart = { seed = seed, names = {}, nodes = {}, transitions = {}, programs = {},
    merges = {} }
  chart.is_tame, chart.traced = random:chance(20), random:chance(33)
  chart.has_twin = random:chance(30)
  chart.read = new_random(seed + 13):pick { false, false, "one", "all" } or nil
  add_node(chart, nil, "root", "state")
  if random:chance(98) then add_children(chart, random, "root", 1) end
  if not chart.nodes.root.is_leaf then
    add_initials(chart, random)
    add_transitions(chart, random)
  end
  add_programs(chart, random)
  add_finals(chart, new_random(seed + 14))
  add_always(chart, new_random(seed + 15))
  chart.ops = { { "step", 1 } }
  for i = 2, 4 + random:below(16) do chart.ops[i] = random_op(chart, random) end
  local may_merge = not (chart.nodes.root.is_leaf or chart.is_tame) -- which may `run`
  local merges = may_merge and random:chance(30) and random:below(2)
  for n = 1, merges or 0 do
    add_merge(chart, random, n)
    table.insert(chart.ops, random:below(#chart.ops), { "merge", n })
  end
  return chart
end

-- Histories --------------------------------------------------------------------

-- Could 'shallow' be wrong, because a composite in this one has no initial?
local function has_closed_child(chart, composite)
  for fqn, node in pairs(chart.nodes) do -- any order: one is enough
    if node.parent == composite and not entrance(chart, fqn) then return true end
  end
  return false
end

--- Gives composites a history, for rfsm.history, and makes some leaves final.
function charts.add_histories(chart)
  local random = new_random(chart.seed + 11)
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.kind == "state" and node.is_leaf then
      node.final = random:chance(15) or node.final
    elseif node.kind == "state" and random:chance(70) then
      node.history = (random:chance(40) or has_closed_child(chart, fqn)) and "deep"
        or "shallow"
    end
  end
end

-- Deferral ---------------------------------------------------------------------

--- Gives a chart random lists of deferred events, some with a predicate. With a list of
--- events and a number only those are deferred, at most so many at once.
function charts.add_deferrals(chart, events, max)
  local random = new_random(chart.seed + 12)
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.kind == "state" and random:chance(40) then
      local pool = events or EVENTS
      node.defer = { random:pick(pool), random:pick(pool), max = max }
      if not events and random:chance(10) then node.defer[1] = predicate end
    end
  end
end

-- Faults -----------------------------------------------------------------------

-- Has a list of transitions name e_fault now and then.
local function name_faults(chart, random, list)
  for _, tr in ipairs(list) do
    local node = chart.nodes[tr.src]
    if node and node.kind == "state" and tr.events[1] ~= nil and random:chance(30) then
      tr.events_ref = { "e_fault", unpack(tr.events_ref) }
      tr.events = { "e_fault@" .. tr.src, unpack(tr.events) }
    end
  end
end

--- Has some transitions name e_fault, for rfsm.faults. A tame chart becomes idle.
function charts.add_faults(chart)
  if chart.is_tame then return end
  local random = new_random(chart.seed + 16)
  name_faults(chart, random, chart.transitions)
  for _, merge in ipairs(chart.merges) do
    name_faults(chart, random, merge.transitions)
  end
end

--- The root of a model, of what the functions return: new_node(fqn, node),
-- new_transition(tr, i).
function charts.assemble(chart, new_node, new_transition)
  local models = {}
  for _, fqn in ipairs(chart.names) do
    local node = chart.nodes[fqn]
    if node.id ~= "initial" or node.is_declared then
      models[fqn] = new_node(fqn, node)
      if node.parent then models[node.parent][node.id] = models[fqn] end
    end
  end
  for i, tr in ipairs(chart.transitions) do
    models[tr.owner][tr.key] = new_transition(tr, i)
  end
  return models.root
end

return charts
