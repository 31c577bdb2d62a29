-- Random runs for snapshots and recordings: the same seed gives the same chart and the
-- same operations on every Lua. What callbacks do depends only on data that the chart
-- keeps, and on what comes from outside.
--
-- As a program it reads lines of JSON { seed, at, snapshot, digest } on stdin, restores
-- each snapshot, does the rest of the run, and compares the digest of its trace:
--
--    LUA spec/support/kept.lua < FILE

package.path = "./?.lua;" .. package.path

local rfsm = require "rfsm"
local timeevent = require "rfsm_timeevent"
require "rfsm.await"
require "rfsm.defer"
require "rfsm.emem"
require "rfsm.faults"
require "rfsm.history"
local monitor = require "rfsm.monitor"
local new_random = require "spec.support.random"
local snapshot = require "rfsm.snapshot"

local floor = math.floor
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local kept = {}

-- The trace and the clock, of the machine that runs -----------------------------

local trace, now, coming = {}, 0, {} -- now: quarters of a second

-- Returns an event with its data as a text, which has no address; others as they are.
function kept.shown(value)
  if type(value) ~= "table" or not value.name then return rfsm.text_of(value) end
  local n = value.n or value.message
  return value.name .. "/" .. rfsm.text_of(type(n) == "table" and n.x .. n[1] or n)
end

local function note(...)
  local texts = { ... }
  for i = 1, select("#", ...) do texts[i] = kept.shown(texts[i]) end
  trace[#trace + 1] = table.concat(texts, " ")
end

local function gettime() return 1000 + floor(now / 4), now % 4 * 250000000 end

timeevent.set_gettime_hook(gettime)

-- Charts ------------------------------------------------------------------------

local EVENTS = { "e1", "e2", "e3", 7, 2.5, true, "e_x@y" }
local MORE_EVENTS = { { name = "e_n", n = 1 }, { name = "e_n", n = { 2, x = "y" } },
  unpack(EVENTS) }

-- What have charts and runs besides what a seed always gave? nil: nothing; "some":
-- events with data, deferral, faults, e_every, times of states, final leaves; "all":
-- `read = "one"` and `always`, too.
local more = nil

local function pick_event(random)
  return random:pick(more and MORE_EVENTS or EVENTS)
end

-- Returns what a transition or a list of deferred events accepts of them.
local function accepted(event)
  return type(event) == "table" and rfsm.named(event.name) or event
end

-- How often something has happened, in data that the root keeps.
local function bump(fsm, id)
  fsm.counts[id], fsm.counts.all = (fsm.counts[id] or 0) + 1, (fsm.counts.all or 0) + 1
  return fsm.counts[id]
end

local ACTIONS = {
  send = function(fsm, action) rfsm.send_events(fsm, action[2], action[3]) end,
  raise = function() error("on purpose", 0) end,
  reset = function(fsm) rfsm.reset(fsm) end,
  list = function(fsm, action)
    fsm.list[#fsm.list + 1] = { [action[2]] = action[3] / 7, x = { action[3] } }
  end,
  retarget = function(fsm, action)
    local transitions = rfsm.elements(fsm, rfsm.is_trans)
    local states = rfsm.elements(fsm, rfsm.is_leaf)
    local tr = transitions[action[2] % #transitions + 1]
    if tr.tgt ~= tr.src then tr.tgt = states[action[3] % #states + 1] end
  end,
}

local function new_actions(random)
  local actions, a, b = {}, pick_event(random), pick_event(random)
  local all = {
    { "send", a, b }, { "send", a, b }, { "send", "e_own" }, { "raise" },
    { "list", random:below(9), random:below(100) }, { "list", "n", random:below(9) },
    { "retarget", random:below(99), random:below(99) }, { "reset" },
  }
  for i = 1, random:below(4) do actions[i] = all[random:below(24)] or false end
  return actions
end

local function do_next(fsm, id, actions, event)
  local action = actions[(bump(fsm, id) - 1) % #actions + 1]
  note(id, action and action[1], event)
  if action then ACTIONS[action[1]](fsm, action) end
end

local function new_callback(random, id)
  local actions = new_actions(random)
  return function(fsm, _, what, ...)
    do_next(fsm, id, actions, (select(what == "effect" and 2 or 1, ...)))
  end
end

local function new_guard(random, id)
  local n, of_memory = random:below(3) + 1, random:chance(30)
  return function(tr)
    local fsm, emem = tr._fsm, tr.src.emem
    if of_memory then return not (emem and (emem.e1 or 0) % n == 1) end
    note("guard", id)
    if fsm.counts[id] == 3 then error("guard on purpose", 0) end
    return (fsm.counts.all or 0) % n ~= 0
  end
end

-- A doo that may be begun anew at each yield.
local function new_doo(random, id)
  local actions, cycles = new_actions(random), random:below(5)
  local idle, ends = random:chance(50), random:chance(60)
  return function(fsm)
    while not (ends and (fsm.counts[id] or 0) % cycles == cycles - 1) do
      do_next(fsm, id, actions)
      rfsm.yield(idle)
    end
    bump(fsm, id)
  end
end

local new_machine

local function new_monitor(random, id)
  local n = random:below(4) + 1
  return monitor.gen_monitor_state { montab = {
    e3 = function(fsm) return bump(fsm, id) % n == 0 end,
  } }
end

local function new_seqand(random, id, depth)
  local fields = { idle_doo = random:pick { true, false, "auto" },
    step = random:chance(40) and random:below(4) or nil }
  fields.x = new_machine(random, id .. "x", depth + 1)
  if random:chance(50) then fields.y = new_machine(random, id .. "y", depth + 1) end
  return rfsm.seqand(fields)
end

local new_state

local function random_event(random)
  local kind = random:below(more and 14 or 10)
  if kind == 10 then return ("e_every(%d.75)"):format(random:below(3)) end
  if kind == 11 then return "e_fault" end
  if kind == 1 then return ("e_after(%d.25)"):format(random:below(4) - 1) end
  if kind == 2 then return ("e_at(%d.5)"):format(1000 + random:below(9)) end
  if kind == 3 then return ("await(e1, %s)"):format(random:pick { "e2", "e_own" }) end
  if kind == 4 then return "e_done" end
  if kind == 5 then return "e_own" end
  return accepted(pick_event(random))
end

-- Returns the events of a transition; nil and true if it needs none.
local function some_events(random)
  if more == "all" and random:chance(5) then return nil, true end
  local events = { random_event(random) }
  if random:chance(40) then events[2] = random_event(random) end
  return events
end

local function add_transitions(random, state, names, id)
  for i = 1, #names + random:below(3) do
    local src, tgt = random:pick(names), random:pick(names)
    if src ~= "k" and random:chance(8) then tgt = "internal" end
    local events, always = some_events(random)
    state[#state + 1] = rfsm.trans { src = src, tgt = tgt, events = events,
      always = src ~= "k" and always or nil,
      pn = random:chance(20) and random:below(3) or nil,
      guard = random:chance(35) and new_guard(random, id .. "g" .. i) or nil,
      effect = random:chance(40) and new_callback(random, id .. "t" .. i) or nil,
    }
  end
end

local function fill_composite(random, state, id, depth, level)
  local names = {}
  for i = 1, random:below(2) + 1 do
    names[i] = ("abc"):sub(i, i)
    state[names[i]] = new_state(random, id .. names[i], depth, level + 1)
  end
  state[1] = rfsm.trans { src = "initial", tgt = names[1] }
  if random:chance(30) then
    state.k = rfsm.conn {}
    state[2] = rfsm.trans { src = "k", tgt = random:pick(names), pn = 1,
      events = random:chance(50) and { "e1", "e2" } or nil }
    state[3] = rfsm.trans { src = "k", tgt = random:pick(names) }
    names[#names + 1] = "k"
  end
  add_transitions(random, state, names, id)
  state.history = level > 0 and (id:find("a", 1, true) and "deep" or "shallow")
  return state
end

-- Gives a state what only some have.
local function add_fields(random, state)
  if random:chance(20) then state.keep, state.n = { "n" }, random:below(9) end
  if not more then return end
  if random:chance(20) then state.timed = true end
  if random:chance(20) then
    state.defer = { accepted(pick_event(random)), "e_own", max = random:below(3) + 1 }
  end
end

local function fill_leaf(random, state, id)
  if random:chance(30) then state.doo = new_doo(random, id .. "!") end
  if more and random:chance(20) then state.final = true end
  return state
end

function new_state(random, id, depth, level)
  if depth == 0 and random:chance(12) then return new_seqand(random, id, depth) end
  if random:chance(5) then return new_monitor(random, id) end
  local state = rfsm.state {
    entry = random:chance(60) and new_callback(random, id .. "+") or nil,
    exit = random:chance(50) and new_callback(random, id .. "-") or nil,
  }
  add_fields(random, state)
  if level < 3 and random:chance(30) then
    return fill_composite(random, state, id, depth, level)
  end
  return fill_leaf(random, state, id)
end

-- The root says nothing, and counts what its callbacks do.
function new_machine(random, id, depth)
  local root = rfsm.state { info = false, warn = false,
    err = function(...) note(...) end, keep = { "counts", "list" }, counts = {},
    list = {}, read = more == "all" and random:chance(30) and "one" or nil }
  return fill_composite(random, root, id, depth, 0)
end

--- Returns the model of a seed; `has` is "some" or "all" for more, see above.
function kept.model(seed, has)
  more = has
  return new_machine(new_random(seed * 7919), "", 0)
end

-- Runs --------------------------------------------------------------------------

--- Returns the operations of a seed.
function kept.operations(seed, has)
  more = has
  local random, list = new_random((seed + 1000003) * 7919), {}
  for i = 1, 8 + random:below(12) do
    local kind = random:below(10)
    list[i] = kind < 4 and { "send", pick_event(random), pick_event(random) }
      or kind < 6 and { "wait", random:below(8) } or kind == 6 and { "step", 12 }
      or kind == 7 and random:chance(30) and { "reset" } or { "step", random:below(3) }
  end
  return list
end

local SHOWN = { STATE_ENTER = true, STATE_EXIT = true, EFFECT = true, EXEC_PATH = true,
  TIMEEVENT = true, AWAIT = true }

-- Has a machine note what happens.
local function dress(fsm)
  fsm.dbg = function(id, ...)
    if SHOWN[id] or id == "RAISED" then note(id, ...) end
  end
  fsm.getevents = function()
    local events = coming
    coming = {}
    return events
  end
end

local OPERATIONS = {
  send = function(fsm, op) rfsm.send_events(fsm, op[2], op[3]) end,
  wait = function(_, op) now = now + op[2] end,
  step = function(fsm, op) note("idle", rfsm.step(fsm, op[2])) end,
  reset = function(fsm) rfsm.reset(fsm) end,
}

local function note_machine(fsm)
  local texts = rfsm.get_active_conf(fsm)
  for i, event in ipairs(fsm._intq) do texts[#texts + 1] = i .. kept.shown(event) end
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    if state.timed then -- an interrupt may come before its time is noted
      local _, time = pcall(timeevent.time_in, state)
      texts[#texts + 1] = state._fqn .. rfsm.text_of(time)
    end
  end
  texts[#texts + 1] = fsm._act_leaf and fsm._act_leaf._mode or "out"
  note(table.concat(texts, ","))
end

local function plainly(f, ...) return f(...) end

-- Does operations number `first` to `last`; the clock shows what those before set.
-- `call(f, ...)` calls f(...) for each.
local function run(fsm, operations, first, last, call)
  now = 0
  timeevent.set_gettime_hook(gettime)
  for i = 1, last do
    local op = operations[i]
    coming = i % 4 == 0 and { "e2", 7 } or {}
    if i >= first then
      (call or plainly)(OPERATIONS[op[1]], fsm, op)
      note_machine(fsm)
    elseif op[1] == "wait" then
      now = now + op[2]
    end
  end
end

--- Makes a machine, does operations up to number `at`, and takes a snapshot: returns
-- it, and the trace of the rest of the run.
function kept.begin(seed, at)
  local fsm = assert(rfsm.init(kept.model(seed, "all")))
  local operations = kept.operations(seed, "all")
  dress(fsm)
  trace = {}
  run(fsm, operations, 1, at)
  local snap = snapshot.take(fsm)
  trace = {}
  run(fsm, operations, at + 1, #operations)
  return snap, trace
end

--- Restores a snapshot, or puts it into a machine; returns the trace of the rest of the
-- run, and a snapshot that was taken before it.
function kept.go_on(seed, at, snap, fsm)
  local operations = kept.operations(seed, "all")
  trace = {}
  run(nil, operations, at + 1, at) -- sets the clock
  local ok, problem
  if fsm then
    ok, problem = snapshot.put(fsm, snap)
  else
    ok, problem = snapshot.restore(kept.model(seed, "all"), snap)
    fsm = ok
  end
  if not ok then return { problem } end
  local again = snapshot.take(fsm)
  if trace[1] then trace[1] = "restore ran: " .. trace[1] end
  dress(fsm)
  run(fsm, operations, at + 1, #operations)
  return trace, again
end

--- Returns a list, and a function that has a machine note there which way it goes.
function kept.watcher()
  local lines = {}
  return lines, function(fsm)
    fsm.dbg = function(id, ...)
      if not SHOWN[id] then return end
      note(id, ...)
      -- a callback may change a target: then the transition has another text
      lines[#lines + 1] = id == "EFFECT" and id or trace[#trace]
    end
  end
end

--- Does a whole run; returns the machine. `watch(fsm)` is called before it, and each
--- operation by `call(f, ...)` if that is given.
function kept.run(seed, watch, call, has)
  local fsm = assert(rfsm.init(kept.model(seed, has)))
  local operations = kept.operations(seed, has)
  trace = {}
  dress(fsm)
  watch(fsm)
  run(fsm, operations, 1, #operations, call)
  return fsm
end

--- How many operations a seed has.
function kept.length(seed) return #kept.operations(seed) end

--- Digests a trace: few digits, the same on every Lua.
function kept.digest(lines)
  local text, hash = table.concat(lines), 7
  for i = 1, #text do hash = (hash * 257 + text:byte(i)) % 17592186044399 end
  return ("%d %.0f"):format(#lines, hash)
end

local function check_lines()
  local decode, count = require("dkjson").decode, 0
  for line in io.lines() do
    local case = decode(line)
    local digest = kept.digest(kept.go_on(case.seed, case.at, case.snapshot))
    if digest ~= case.digest then
      print(("seed %d at %d: another trace"):format(case.seed, case.at))
      print(table.concat(kept.go_on(case.seed, case.at, case.snapshot), "\n"))
      os.exit(1)
    end
    count = count + 1
  end
  print(count .. " passed")
end

if arg and arg[0] and arg[0]:find("kept%.lua$") then check_lines() end

return kept
