-- Runs a chart of charts.lua on the core or on the oracle; both leave the same trace, a
-- flat list of texts.

local charts = require "spec.support.charts"
local interrupts = require "spec.support.interrupts"
local reference = require "spec.support.reference"
local rfsm = require "rfsm"

local runs = {}

local function text_of(value)
  if type(value) ~= "table" or getmetatable(value) then return tostring(value) end
  if value.element then -- a fault
    return ("%s %s %s %s: %s"):format(value.name, value.callback, value.element,
      tostring(value.region), value.message)
  end
  local texts = {}
  for i, item in ipairs(value) do texts[i] = text_of(item) end
  return "[" .. table.concat(texts, ", ") .. "]"
end

local function note(world, ...)
  local texts = { ... }
  for i = 1, #texts do texts[i] = text_of(texts[i]) end
  world.trace[#world.trace + 1] = table.concat(texts, " ")
end

-- What a call of a program may do; world.reset and others are the engine's.
local ACTIONS = {
  ["raise"] = function(_, _, problem) error(problem, 0) end,
  ["return"] = function(_, _, value) return value end,
  reset = function(world) world.reset() end,
  trace = function(world, _, on) world.switch_trace(on) end,
  send = function(world, _, ...) world.send(...) end,
  retarget = function(world, _, n, m) world.retarget(n, m) end,
  replace = function(world, _, n)
    if world.ids[1] then world.replace(world.ids[n % #world.ids + 1]) end
  end,
  append = function(_, list, event) list[#list + 1] = event end,
  clear = function(_, list)
    for i = #list, 1, -1 do list[i] = nil end
  end,
}

-- Does what the chart says for this call of program `id`.
local function perform(world, action, list)
  if not action then return nil end
  return ACTIONS[action[1]](world, list, action[2], action[3])
end

local function act(world, id, list)
  local actions = world.chart.programs[id]
  local count = world.counts[id] or 0
  world.counts[id] = count + 1
  return perform(world, actions[count % #actions + 1], list)
end

local function run_doo(world, fqn)
  for i, cycle in ipairs(world.chart.programs["doo " .. fqn]) do
    note(world, "doo", fqn, i)
    perform(world, cycle.action)
    if cycle.is_return then return cycle.idle end
    coroutine.yield(cycle.idle)
  end
end

-- The programs that a tool may replace, but those of a sequential AND state.
local function replaceable(chart)
  local ids = {}
  local function add(id) if chart.programs[id] then ids[#ids + 1] = id end end
  for _, fqn in ipairs(chart.names) do
    local node = not (chart.regions and chart.regions[fqn]) and chart.nodes[fqn] or {}
    if node.entry then add("entry " .. fqn) end
    if node.exit then add("exit " .. fqn) end
  end
  for _, tr in ipairs(chart.transitions) do
    if tr.guard then add("guard " .. tr.index) end
    if tr.effect then add("effect " .. tr.index) end
  end
  return ids
end

local function copy_of(t)
  local copy = {}
  for key, value in pairs(t) do copy[key] = value end -- any order: a copy
  return copy
end

-- A copy of the chart, for what a run changes.
local function own_chart(chart)
  local own = copy_of(chart)
  own.names, own.nodes = copy_of(chart.names), copy_of(chart.nodes)
  own.transitions = {}
  for i, tr in ipairs(chart.transitions) do own.transitions[i] = copy_of(tr) end
  return own
end

-- world.versions[id] says how often a program was replaced; each version notes its own.
-- world.regions has the worlds of the regions of a state, by its F: they have the trace
-- and the clock of the outer one.
local function new_world(chart, outer)
  chart = own_chart(chart)
  chart.given_read = chart.read
  if outer and chart.read == nil then chart.read = outer.chart.read end
  local world = {
    chart = chart, trace = outer and outer.trace or {}, counts = {}, versions = {},
    ids = replaceable(chart), clock = outer and outer.clock or { now = 0 },
    regions = {} }
  function world.wait(seconds) world.clock.now = world.clock.now + seconds end
  for fqn, regions in pairs(chart.regions or {}) do -- any order: each stands alone
    world.regions[fqn] = { step = regions.step }
    for i, own in ipairs(regions) do world.regions[fqn][i] = new_world(own, world) end
  end
  return world
end

local function version_of(world, id)
  return world.versions and world.versions[id] or 0
end

-- Picks a transition and the node that it is to lead to, by two numbers.
local function pick_target(world, n, m)
  local chart, targets = world.chart, {}
  for _, fqn in ipairs(chart.names) do
    if charts.entrance(chart, fqn) then targets[#targets + 1] = fqn end
  end
  local tr = chart.transitions[n % #chart.transitions + 1]
  local tgt = charts.entrance(chart, targets[m % #targets + 1])
  note(world, "retarget", tr.index, tgt)
  return tr, tgt
end

-- Notes the modes that a program sees.
local function note_modes(world)
  local texts = {}
  for _, fqn in ipairs(world.chart.names) do
    local mode = world.mode_of(fqn)
    if mode ~= "inactive" then texts[#texts + 1] = fqn .. "(" .. mode .. ")" end
  end
  note(world, " ", table.concat(texts, " "))
end

-- The modes of all states, active or not.
local function modes_of(chart, mode_of)
  local modes = {}
  for _, fqn in ipairs(chart.names) do
    if chart.nodes[fqn].kind == "state" then
      modes[#modes + 1] = fqn .. "=" .. mode_of(fqn)
    end
  end
  return modes
end

-- Is this the call that is to be left out?
local function is_muted(world)
  if not world.calls then return false end
  world.calls = world.calls + 1
  return world.calls == world.muted
end

local OF_CALLBACKS = { ENTRY = true, EXIT = true, EFFECT = true }

-- A printer or hook of the world, nil when the chart has none.
local function outside(world, id, list_at)
  if not world.chart.programs[id] then return nil end
  return function(...)
    if id == "err" and OF_CALLBACKS[(...)] and is_muted(world) then return end
    local list = list_at and select(list_at, ...)
    if list_at then note(world, id, list) else note(world, id, ...) end
    return act(world, id, list)
  end
end

-- What dbg is at first; programs may switch it.
local function first_dbg(world)
  return world.chart.traced ~= false and outside(world, "dbg")
end

-- An interrupt may repeat events of an iteration, which are a set.
local function set_of(events)
  local set, has = {}, {}
  for _, event in ipairs(events) do
    if not has[event] then set[#set + 1] = event end
    has[event] = true
  end
  return set
end

-- The core --------------------------------------------------------------------

local function leaf_name(fsm) return fsm._act_leaf and fsm._act_leaf._fqn or false end

-- Program `id`: the function `f`, or where the chart says so a table that calls it.
local function program(world, id, f)
  if not (world.chart.callables and world.chart.callables[id]) then return f end
  return setmetatable({}, { __call = function(_, ...) return f(...) end })
end

local function program_of(world, what, fqn)
  local id = what .. " " .. fqn
  local version = version_of(world, id)
  return program(world, id, function(fsm, state, kind, event)
    if is_muted(world) then return end
    note(world, kind, state._fqn, "leaf", leaf_name(fsm), version, "on", event)
    note_modes(world)
    return act(world, id)
  end)
end

local function guard_of(world, index)
  local id = "guard " .. index
  local version = version_of(world, id)
  return program(world, id, function(_, events, event)
    note(world, "guard", index, events, version, "on", event)
    return act(world, id)
  end)
end

local function effect_of(world, index)
  local id = "effect " .. index
  local version = version_of(world, id)
  return program(world, id, function(_, _, kind, events, event)
    if is_muted(world) then return end
    note(world, kind, index, world.calls and set_of(events) or events, version, "on",
      event)
    note_modes(world)
    act(world, id)
  end)
end

local function model_transition(world, tr)
  return rfsm.trans {
    src = tr.src_ref, tgt = tr.tgt_ref, pn = tr.pn, events = tr.events_ref,
    always = tr.always,
    guard = tr.guard and guard_of(world, tr.index) or nil,
    effect = tr.effect and effect_of(world, tr.index) or nil,
  }
end

local model_of

local function model_node(world, fqn, node)
  if node.kind == "connector" then return rfsm.conn {} end
  local regions = world.regions[fqn] or {}
  local fields = {
    entry = node.entry and program_of(world, "entry", fqn) or nil,
    exit = node.exit and program_of(world, "exit", fqn) or nil,
    doo = node.doo and function() return run_doo(world, fqn) end or nil,
    history = node.history, final = node.final, defer = node.defer,
    step = regions.step,
  }
  if not regions[1] then return rfsm.state(fields) end
  fields.doo = nil
  for i, region in ipairs(regions) do fields[i] = model_of(region) end
  return rfsm.seqand(fields)
end

-- The chart as a model for rfsm.init, which warns of nothing then.
function model_of(world)
  local root = charts.assemble(world.chart, function(fqn, node)
    return model_node(world, fqn, node)
  end, function(tr) return model_transition(world, tr) end)
  root.info, root.err, root.warn = false, outside(world, "err"), false
  root.read = world.chart.given_read
  root.dbg = first_dbg(world) or false
  root.gettime = function() return world.clock.now, 0 end
  root.getevents = outside(world, "getevents")
  root.pre_step_hook = outside(world, "pre_hook", 2)
  root.post_step_hook = outside(world, "post_hook", 2)
  local idle_hook = outside(world, "idle_hook")
  root.idle_hook = idle_hook and function() return idle_hook() end
  return root
end

local function core_active(fsm)
  local list = rfsm.get_active_conf(fsm)
  local state = fsm
  for i = 1, #list do
    list[i] = list[i] .. "(" .. rfsm.get_sta_mode(state) .. ")"
    state = rfsm.actchild_get(state)
  end
  return list
end

local function node_of(fsm, fqn)
  local node = fsm
  for name in fqn:sub(6):gmatch("[^.]+") do node = node[name] end
  return node
end

-- The events that wait; those of an iteration that a hook ended come first.
local function waiting_in(fsm)
  local events = {}
  for _, event in ipairs(fsm._curq) do events[#events + 1] = event end
  for _, event in ipairs(fsm._intq) do events[#events + 1] = event end
  return events
end

local function core_modes(world, fsm)
  return modes_of(world.chart, function(fqn)
    return rfsm.get_sta_mode(node_of(fsm, fqn))
  end)
end

-- Replaces program `id` of the machine, which has the next version.
local function replace(world, fsm, id)
  local what, owner = id:match("^(%l+) (.+)$")
  world.versions[id] = version_of(world, id) + 1
  local index = tonumber(owner)
  if not index then
    node_of(fsm, owner)[what] = program_of(world, what, owner)
    return
  end
  for _, tr in ipairs(world.chart.transitions) do
    if tr.index == index then
      local make = what == "guard" and guard_of or effect_of
      node_of(fsm, tr.owner)[tr.key][what] = make(world, index)
    end
  end
end

local function merge_into_core(world, fsm, merge)
  local node, warn = merge.node, fsm.warn
  fsm.warn = false -- of a leaf that nothing leaves yet
  assert(rfsm.fsm_merge(fsm, node_of(fsm, node.parent),
    model_node(world, merge.fqn, node), node.id))
  for _, tr in ipairs(merge.transitions) do
    local owner, model = node_of(fsm, tr.owner), model_transition(world, tr)
    assert(rfsm.fsm_merge(fsm, owner, model, tr.key))
  end
  fsm.warn = warn
  return node_of(fsm, merge.fqn)
end

-- node.hooks says how many hooks extensions have hung on entry and exit of a state.
local function add_state_hooks(world, fsm)
  for _, fqn in ipairs(world.chart.names) do
    for i = 1, world.chart.nodes[fqn].hooks or 0 do
      for _, what in ipairs({ "entry_hook", "exit_hook" }) do
        rfsm[what .. "_add"](fsm, node_of(fsm, fqn), function(machine, state, event)
          if is_muted(world) then return end
          note(world, what, i, state._fqn, "leaf", leaf_name(machine), "on", event)
          act(world, ("%s %d %s"):format(what, i, fqn))
        end)
      end
    end
  end
end

-- A merged leaf and its transitions are part of the chart from now on.
local function add_merged(world, merge)
  local chart = world.chart
  chart.names[#chart.names + 1], chart.nodes[merge.fqn] = merge.fqn, merge.node
  for _, tr in ipairs(merge.transitions) do
    chart.transitions[#chart.transitions + 1] = copy_of(tr)
  end
end

-- The oracle ------------------------------------------------------------------

-- tostring of a transition, as the contract has it.
local function transition_text(tr)
  local parts = { "src='" .. tr.src .. "'", "tgt='" .. tr.tgt .. "'" }
  if tr.pn then parts[#parts + 1] = ("pn=%d"):format(tr.pn) end
  if tr.events[1] ~= nil then
    local events = text_of(tr.events):sub(2, -2)
    parts[#parts + 1] = "events='" .. events .. "'"
  end
  return "T={ " .. table.concat(parts, ", ") .. " }"
end

local function oracle_state_calls(world, calls)
  for _, what in ipairs({ "entry", "exit" }) do
    calls[what] = function(fqn, leaf, event)
      note(world, what, fqn, "leaf", leaf, version_of(world, what .. " " .. fqn), "on",
        event)
      note_modes(world)
      return act(world, what .. " " .. fqn)
    end
    local hook = what .. "_hook"
    calls[hook] = function(fqn, i, leaf, event)
      note(world, hook, i, fqn, "leaf", leaf, "on", event)
      act(world, ("%s %d %s"):format(hook, i, fqn))
    end
  end
  return calls
end

local function oracle_calls(world)
  return oracle_state_calls(world, {
    text = transition_text,
    doo = function(fqn) return run_doo(world, fqn) end,
    guard = function(tr, events, event)
      note(world, "guard", tr.index, events, version_of(world, "guard " .. tr.index),
        "on", event)
      return act(world, "guard " .. tr.index)
    end,
    effect = function(tr, events, event)
      note(world, "effect", tr.index, events, version_of(world, "effect " .. tr.index),
        "on", event)
      note_modes(world)
      act(world, "effect " .. tr.index)
    end,
    err = outside(world, "err"), warn = outside(world, "warn"),
    dbg = first_dbg(world), getevents = outside(world, "getevents"),
    pre_hook = outside(world, "pre_hook", 1),
    post_hook = outside(world, "post_hook", 1),
    idle_hook = outside(world, "idle_hook"),
  })
end

-- Both ------------------------------------------------------------------------

-- Runs the operations; after each one the trace has its result and what can be seen.
-- `between(engine, world)` is called before each one.
local function drive(world, engine, between)
  for _, op in ipairs(world.chart.ops) do
    if between then between(engine, world) end
    local results = { pcall(engine[op[1]], op[2], op[3], op[4]) }
    note(world, "=", op[1], results[1] and "ok" or "raised", results[2])
    note(world, "active", engine.active(), "queue", engine.queue())
  end
  return world.trace
end

-- The printer without the warnings of rfsm.checkevents and rfsm.defer, whose job they
-- are: everything else has to be as it is without these modules.
local function but_undeclared(warn)
  if not warn then return nil end
  return function(text, ...)
    if tostring(text):find("^WARNING: undeclared event ") then return end
    if tostring(text):find("%.defer: '.*' is ") then return end
    return warn(text, ...)
  end
end

-- Has the programs of a world act on a machine, which may be a copy of one.
local function join_core(world, fsm, is_copy)
  local chart, nodes = world.chart, {}
  if not is_copy then
    fsm.warn = but_undeclared(outside(world, "warn"))
    add_state_hooks(world, fsm)
  end
  world.send = function(...) rfsm.send_events(fsm, ...) end
  world.reset = function() rfsm.reset(fsm) end
  world.replace = function(id) replace(world, fsm, id) end
  world.switch_trace = function(on)
    world.is_changed = true
    fsm.dbg = on and outside(world, "dbg")
  end
  for _, fqn in ipairs(chart.names) do nodes[fqn] = node_of(fsm, fqn) end
  world.mode_of = function(fqn) return rfsm.get_sta_mode(nodes[fqn]) end
  world.retarget = function(n, m)
    if not world.chart.transitions[1] then return end
    local tr, tgt = pick_target(world, n, m)
    node_of(fsm, tr.owner)[tr.key].tgt = nodes[tgt]
  end
  for fqn, regions in pairs(world.regions) do -- any order: each stands alone
    for i, region in ipairs(regions) do
      join_core(region, nodes[fqn].substates[i], is_copy)
    end
  end
  return nodes
end

-- A machine of the model, and what it does; nil and the problems when init refuses it.
local function core_engine(world, model)
  local chart = world.chart
  local twin = chart.has_twin and rfsm.init(model)
  local fsm, _, problems = rfsm.init(model)
  if not fsm then return nil, problems end
  local nodes = join_core(world, fsm)
  if (chart.seed or 1) % 5 == 0 then rfsm.prepare(fsm) end -- merges may come later
  local engine = {
    fsm = fsm, twin = twin, wait = world.wait,
    send = function(...) world.send(...) end, reset = function() world.reset() end,
    merge = function(n)
      local merge = chart.merges[n]
      nodes[merge.fqn] = merge_into_core(world, fsm, merge)
      add_merged(world, merge)
      world.is_changed = true
    end,
    step = function(n) return rfsm.step(fsm, n) end,
    run = function() return rfsm.run(fsm) end,
    active = function() return core_active(fsm) end,
    queue = function() return waiting_in(fsm) end,
    modes = function() return core_modes(world, fsm) end,
  }
  -- Another machine takes the place: a copy of all tables, or one of the same model.
  function engine.replace_by(other, is_copy)
    engine.fsm, fsm = other, other
    nodes = join_core(world, other, is_copy)
  end
  return engine
end

--- The trace of the core; nil and the problems when init refuses the chart.
-- `between(engine, world)` is called before each operation.
function runs.on_core(chart, between)
  local world = new_world(chart)
  local model = model_of(world)
  local engine, problems = core_engine(world, model)
  if not engine then return nil, problems end
  return drive(world, engine, between)
end

-- The oracle of a world, its field `machine`, with those of its regions.
local function new_oracle(world, extend)
  local calls = oracle_calls(world)
  local machine = reference.new(world.chart, calls)
  world.machine = machine
  world.send = function(...) reference.send(machine, ...) end
  world.reset = function() reference.reset(machine) end
  world.replace = function(id) world.versions[id] = version_of(world, id) + 1 end
  world.switch_trace = function(on) calls.dbg = on and outside(world, "dbg") end
  world.mode_of = function(fqn) return machine.mode[fqn] or "inactive" end
  world.retarget = function(n, m)
    if not world.chart.transitions[1] then return end
    reference.retarget(pick_target(world, n, m))
  end
  for _, regions in pairs(world.regions) do -- any order: each stands alone
    for _, region in ipairs(regions) do new_oracle(region, extend) end
  end
  if extend then extend(calls, world.chart, world) end
  return machine
end

--- The trace of the oracle. `extend(calls, chart, world)` may add the model of an
--- extension.
function runs.on_oracle(chart, extend)
  local world = new_world(chart)
  local machine = new_oracle(world, extend)
  return drive(world, {
    send = world.send, reset = world.reset, wait = world.wait,
    merge = function(n)
      add_merged(world, chart.merges[n])
      machine.mode[chart.merges[n].fqn], machine.look = "inactive", 1
    end,
    step = function(n) return reference.step(machine, n) end,
    run = function() return reference.step(machine, 1e9) end,
    active = function() return reference.active(machine) end,
    queue = function() return machine.queue end,
    modes = function()
      return modes_of(chart, function(fqn) return machine.mode[fqn] end)
    end,
  })
end

-- Returns the number of the first line in which two lists differ; nil if none does.
local function first_difference(expected, actual)
  for i = 1, math.max(#expected, #actual) do
    if expected[i] ~= actual[i] then return i end
  end
end

--- The first line in which both differ; nil when they agree.
function runs.compare(chart, extend, between)
  local expected = runs.on_oracle(chart, extend)
  local actual, problems = runs.on_core(chart, between)
  if not actual then
    return 0, expected, { [0] = "init: " .. table.concat(problems, "; ") }
  end
  local at = first_difference(expected, actual)
  if at then return at, expected, actual end
end

-- Interrupts ------------------------------------------------------------------

-- What is wrong with a machine between two steps; nil when nothing is.
local function defect(world, fsm)
  local is_active, leaf = {}, rfsm.get_actleaf_fqn(fsm)
  local line = rfsm.get_active_conf(fsm)
  for _, fqn in ipairs(line) do is_active[fqn] = true end
  if leaf and line[#line] ~= leaf then return "the leaf is not the innermost state" end
  if not leaf and #line > 1 then return "states are active without a leaf" end
  for _, fqn in ipairs(world.chart.names) do
    if (world.mode_of(fqn) ~= "inactive") ~= (is_active[fqn] or false) then
      return fqn .. " is " .. world.mode_of(fqn)
    end
  end
end

-- The next of a row of random numbers.
local function after(random) return random * 16807 % 2147483647 end

-- More than any of these steps needs.
local MANY = 1e6

--- Runs the chart on the core and interrupts each operation, in callbacks too. Each
-- time the machine must go on, and at the end another one of its model must agree with
-- the oracle. Returns a text: what went wrong; nil when nothing did.
function runs.interrupt(chart)
  local world = new_world(chart)
  local model = model_of(world)
  local random, engine = chart.seed, core_engine(world, model)
  local fsm = engine.fsm
  local raise, value = interrupts.raise_anywhere, interrupts.VALUES[1]
  for i, op in ipairs(chart.ops) do
    random = after(random)
    local at = random % 3000 + 1
    raise(at, value, engine[op[1]], op[2], op[3], op[4])
    local is_hit, _, _, failure = raise(MANY, value, engine.step, 1)
    local where = ("operation %d, instruction %d: "):format(i, at)
    if is_hit then return where .. "the next step does not end" end
    if tostring(failure):find("rfsm.lua:", 1, true) then return where .. failure end
    local wrong = fsm._phase == "idle" and defect(world, fsm)
    if wrong then return where .. wrong end
  end
  world.trace, world.counts, world.versions = {}, {}, {}
  world.chart = own_chart(chart)
  local expected = runs.on_oracle(chart)
  local actual = drive(world, core_engine(world, model))
  local line = first_difference(expected, actual)
  return line and ("the next machine, line %d: oracle '%s', core '%s'"):format(line,
    tostring(expected[line]), tostring(actual[line]))
end

-- A chart whose trace does not tell how often a step was begun: guards do nothing but
-- answer, always the same; hooks do nothing; no getevents, no doos.
local function without_repetition(chart)
  local own = own_chart(chart)
  own.programs, own.traced = copy_of(chart.programs), false
  for id, actions in pairs(chart.programs) do -- any order: each stands alone
    local first = actions[1]
    if id:find("^guard ") then
      own.programs[id] = { type(first) == "table" and first[1] == "return" and first }
    elseif id == "idle_hook" or id == "getevents" or id == "dbg" then
      own.programs[id] = nil
    elseif id == "pre_hook" or id == "post_hook" then
      own.programs[id] = { false }
    end
  end
  for fqn, node in pairs(own.nodes) do -- any order: each stands alone
    own.nodes[fqn] = copy_of(node)
    own.nodes[fqn].doo = nil
  end
  return own
end

-- Steps a machine until it is idle; false if that takes too long.
local function settle(fsm)
  for _ = 1, 60 do
    local ok, idle = pcall(rfsm.step, fsm) -- a printer may fail
    if ok and idle then return true end
    if fsm._outcome == "refused" then return true end -- it cannot be entered
  end
  return false
end

-- What may come again: guards, warnings, an iteration without events.
local REPEATED = { "^guard", "^err GUARD", "^warn", "cannot enter", "^p%l+_hook" }

local function may_repeat(line)
  for _, pattern in ipairs(REPEATED) do
    if line:find(pattern) then return true end
  end
  return false
end

-- Appends what an operation has called.
local function append_calls(calls, trace)
  for _, line in ipairs(trace) do
    if not may_repeat(line) then calls[#calls + 1] = line end
  end
end

-- What each operation calls, in one list; nil if the machine is never idle, or if
-- `disturb(i, fsm)`, which is called before its steps, returns what is wrong. The call
-- number `muted`, if there is one, is left out.
local function calls_of(chart, disturb, muted)
  local world = new_world(chart)
  world.calls, world.muted = 0, muted
  local model, calls = model_of(world), {}
  local engine = core_engine(world, model)
  for i, op in ipairs(engine and chart.ops or {}) do
    world.trace = {}
    if op[1] == "send" then engine.send(op[2], op[3], op[4]) end
    local wrong = disturb and disturb(i, engine.fsm)
    if wrong then return nil, ("operation %d: %s"):format(i, wrong) end
    if not settle(engine.fsm) then return nil end
    append_calls(calls, world.trace)
    calls[#calls + 1] = "active " .. text_of(engine.active())
  end
  return calls
end

local CALLBACKS = { entry = true, exit = true, effect = true, entry_hook = true,
  exit_hook = true }

-- The number of the call that a line is about.
local function call_number(lines, last)
  local count = 0
  for i = 1, last do
    local what, of = lines[i]:match("^([%l_]+) (%S+)")
    if CALLBACKS[what] or what == "err" and OF_CALLBACKS[of] then count = count + 1 end
  end
  return count
end

--- Interrupts the engine in one operation. What is called from then on must be what is
-- called without an interrupt, or if one call is left out. Returns a text: what went
-- wrong; nil when nothing did.
function runs.interrupt_once(chart)
  chart = without_repetition(chart)
  local random = chart.seed
  local expected = calls_of(chart)
  if not expected or not chart.ops[1] then return nil end
  for _ = 1, 20 do
    random = after(random)
    local op, at = random % #chart.ops + 1, math.floor(random / 64) % 700 + 1
    local value = interrupts.VALUES[random % 3 + 1]
    local actual, wrong = calls_of(chart, function(i, fsm)
      if i ~= op then return end
      local _, is_raised, ok, failure = interrupts.raise(at, value, rfsm.step, fsm)
      if is_raised and (ok or not rawequal(failure, value)) then
        return "the interrupt did not reach the caller, but " .. tostring(failure)
      end
    end)
    local where = ("operation %d, instruction %d: "):format(op, at)
    if not actual then return where .. (wrong or "the machine is never idle") end
    local first = first_difference(expected, actual)
    local without = first
      and calls_of(chart, nil, call_number(expected, first)) or expected
    local line = first_difference(without, actual)
    if line then
      return ("%sline %d: expected '%s', got '%s'"):format(where, line,
        tostring(without[line]), tostring(actual[line]))
    end
  end
end

return runs
