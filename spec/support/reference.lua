-- The oracle: section 2 of the contract, as plainly as it can be written.
--
-- It works on an abstract chart (see charts.lua), shares no code with the core, keeps
-- no index and compiles nothing. It is slow and meant to be read; the core must not be
-- distinguishable from it. A machine is a table:
--
--   chart     nodes by F, transitions in a list (declaration data only)
--   calls     what the chart's programs do: calls.entry(F), calls.guard(tr, events) ...
--             calls.entered(F) and calls.was_reset() are for the models of extensions
--   mode      F -> "active" | "done" | "inactive"
--   leaf      F of the active leaf, or nil
--   queue     events that wait
--
-- A program that fails raises; the oracle reports it to calls.err, as the core does.

local reference = {}

-- Structure: parents, ancestors, order of transitions -------------------------

-- All ancestors of F, nearest first.
local function ancestors(machine, fqn)
  local list = {}
  local parent = machine.chart.nodes[fqn].parent
  while parent do
    list[#list + 1] = parent
    parent = machine.chart.nodes[parent].parent
  end
  return list
end

local function is_in(list, value)
  for _, other in ipairs(list) do
    if other == value then return true end
  end
  return false
end

-- The nearest ancestor that both ends have; the root for what starts at the root.
local function common_ancestor(machine, tr)
  if tr.src == "root" then return "root" end
  local of_tgt = ancestors(machine, tr.tgt)
  for _, fqn in ipairs(ancestors(machine, tr.src)) do
    if is_in(of_tgt, fqn) then return fqn end
  end
end

-- Higher pn first, then declared further out, then position, then key.
local function comes_before(machine, a, b)
  if (a.pn or 0) ~= (b.pn or 0) then return (a.pn or 0) > (b.pn or 0) end
  if a.owner ~= b.owner then
    local depth_a, depth_b = #ancestors(machine, a.owner), #ancestors(machine, b.owner)
    if depth_a ~= depth_b then return depth_a < depth_b end
    return a.owner < b.owner
  end
  if type(a.key) ~= type(b.key) then return type(a.key) == "number" end
  return a.key < b.key
end

-- The transitions that start at F, in the order in which they are tried.
local function outgoing(machine, fqn)
  local list = {}
  for _, tr in ipairs(machine.chart.transitions) do
    if tr.src == fqn then list[#list + 1] = tr end
  end
  table.sort(list, function(a, b) return a ~= b and comes_before(machine, a, b) end)
  return list
end

-- Printers --------------------------------------------------------------------

-- A printer that raises: the first such error waits for the end of the iteration.
local function protected(machine, f, ...)
  local ok, result = pcall(f, ...)
  if ok then return result end
  if not machine.failed then machine.failed, machine.failure = true, result end
end

local function dbg(machine, ...)
  if machine.calls.dbg then protected(machine, machine.calls.dbg, ...) end
end

local function program_failed(machine, id, what, owner, problem)
  protected(machine, machine.calls.err, id,
    "error executing " .. what .. " of " .. owner .. ": ", problem)
end

local function raise(machine, event)
  dbg(machine, "RAISED", event)
  machine.queue[#machine.queue + 1] = event
end

local function text_of(values)
  local texts = {}
  for i, value in ipairs(values) do texts[i] = tostring(value) end
  return table.concat(texts, ", ")
end

-- Which transition ------------------------------------------------------------

-- An event is wanted as itself, or because a predicate says so (not if it fails).
local function is_wanted(wanted, event)
  if rawequal(wanted, event) then return true end
  if type(wanted) ~= "function" then return false end
  local ran, answer = pcall(wanted, event)
  return ran and not not answer
end

-- Events are a set: it is enough that one of them is wanted.
local function matches(tr, events)
  if not tr.events or #tr.events == 0 then return true end
  for _, wanted in ipairs(tr.events) do
    for _, event in ipairs(events) do
      if is_wanted(wanted, event) then return true end
    end
  end
  return false
end

local function guard_allows(machine, tr, events)
  if not tr.guard then return true end
  local ok, answer = pcall(machine.calls.guard, tr, events)
  if ok then return answer ~= false end
  program_failed(machine, "GUARD", "guard", machine.calls.text(tr), answer)
  return false
end

local find_path

-- A path through `tr`: the segment, then what follows behind a connector. nil: closed.
-- A segment keeps the target that `tr` has now.
local function path_through(machine, tr, events, seen)
  if not matches(tr, events) then return nil end
  if not guard_allows(machine, tr, events) then return nil end
  local first = {
    tr = tr, src = tr.src, tgt = tr.tgt, pn = tr.pn, is_internal = tr.is_internal,
  }
  if machine.chart.nodes[tr.tgt].kind == "state" then return { first } end
  local rest = find_path(machine, tr.tgt, events, seen)
  if not rest then return nil end
  local path = { first }
  for _, segment in ipairs(rest) do path[#path + 1] = segment end
  return path
end

-- Each connector is evaluated once a step, and is closed while that goes on. Two open
-- ways of the same priority are a conflict: a warning, and the first is taken.
function find_path(machine, connector, events, seen)
  if seen[connector] ~= nil then return seen[connector] end
  seen[connector] = false
  local open = {}
  for _, tr in ipairs(outgoing(machine, connector)) do
    if open[1] and (tr.pn or 0) ~= (open[1][1].pn or 0) then break end
    open[#open + 1] = path_through(machine, tr, events, seen)
  end
  if open[2] then
    protected(machine, machine.calls.warn,
      "conflicting transitions from src " .. connector .. " to")
    for _, path in ipairs(open) do
      protected(machine, machine.calls.warn, "\t" .. path[1].tgt)
    end
  end
  seen[connector] = open[1] or false
  return seen[connector]
end

-- The first open path from a node.
local function find_from(machine, fqn, events, seen)
  for _, tr in ipairs(outgoing(machine, fqn)) do
    local path = path_through(machine, tr, events, seen)
    if path then return path end
  end
end

-- States from the root down; the first open path wins, without a look at others. A
-- search is traced if dbg is on when it begins.
local function find_enabled(machine, states, events)
  local seen, is_traced = {}, machine.calls.dbg and true
  local function record(...)
    if is_traced then dbg(machine, ...) end
  end
  record("TRANSITION", "searching transitions for events: " .. text_of(events))
  for depth, fqn in ipairs(states) do
    record("CHECKING", "depth:", depth - 1, "for transitions from " .. fqn)
    local path = find_from(machine, fqn, events, seen)
    if path then return path end
  end
  record("TRANSITION", "no enabled paths found")
end

-- The active states, from the root to the leaf.
local function configuration(machine)
  if not machine.leaf then return {} end
  local list = { machine.leaf }
  for _, fqn in ipairs(ancestors(machine, machine.leaf)) do
    table.insert(list, 1, fqn)
  end
  return list
end

-- Deferral (rfsm.defer) -------------------------------------------------------

-- The machine makes some events itself.
local function is_deferred(machine, event)
  local text = tostring(event)
  if text == "e_init_fsm" or text:find("^e_%a+.*@root") then return false end
  for _, fqn in ipairs(configuration(machine)) do
    local list = machine.chart.nodes[fqn].defer
    if list and matches({ events = list }, { event }) then return true end
  end
  return false
end

-- Before a path is taken, whose first transition may take some; or when none is.
local function defer(machine, events, tr)
  for _, event in ipairs(events) do
    if #machine.deferred < 64 and not (tr and matches(tr, { event }))
      and is_deferred(machine, event) then
      machine.deferred[#machine.deferred + 1] = event
      dbg(machine, "DEFERRED", event)
    end
  end
end

local put_back

local function recall(machine, events)
  for i, event in ipairs(machine.deferred) do
    if not is_deferred(machine, event) then
      put_back(machine, events)
      dbg(machine, "RECALLED", event)
      return { table.remove(machine.deferred, i) }
    end
  end
  return events
end

-- One transition --------------------------------------------------------------

-- Calls entry or exit of F, if it has one, with the active leaf that it must see.
local function run_program(machine, id, what, fqn)
  if not machine.chart.nodes[fqn][what] then return end
  local ok, problem = pcall(machine.calls[what], fqn, machine.leaf or false)
  if not ok then program_failed(machine, id, what, fqn, problem) end
end

-- What extensions have hung on F: calls.entry_hook or calls.exit_hook(F, 1), (F, 2) ...
local function run_state_hooks(machine, what, fqn)
  for i = 1, machine.chart.nodes[fqn].hooks or 0 do
    protected(machine, machine.calls[what], fqn, i, machine.leaf or false)
  end
end

local function exit(machine, fqn)
  machine.mode[fqn] = "inactive"
  run_program(machine, "EXIT", "exit", fqn)
  run_state_hooks(machine, "exit_hook", fqn)
  machine.coroutine[fqn] = nil
  if machine.leaf == fqn then machine.leaf = nil end
  dbg(machine, "STATE_EXIT", fqn)
end

local function done(machine, fqn)
  machine.mode[fqn] = "done"
  raise(machine, "e_done@" .. fqn)
end

local function enter(machine, fqn)
  machine.mode[fqn] = "active"
  if machine.calls.entered then machine.calls.entered(fqn) end
  run_state_hooks(machine, "entry_hook", fqn)
  run_program(machine, "ENTRY", "entry", fqn)
  local node = machine.chart.nodes[fqn]
  if node.is_leaf then
    machine.leaf = fqn
    if not node.doo then done(machine, fqn) end
  end
  dbg(machine, "STATE_ENTER", fqn)
end

-- The outermost state that holds the source but not all of what stays active.
local function outermost_left(machine, tr, top)
  local fqn = tr.src
  while machine.chart.nodes[fqn].parent and machine.chart.nodes[fqn].parent ~= top do
    fqn = machine.chart.nodes[fqn].parent
  end
  return fqn
end

local function run_effect(machine, tr, events)
  dbg(machine, "EFFECT", machine.calls.text(tr))
  if not tr.effect then return end
  local ok, problem = pcall(machine.calls.effect, tr, events)
  if ok then return end
  program_failed(machine, "EFFECT", "effect", machine.calls.text(tr), problem)
end

-- Exits from `innermost` up to the common ancestor, effect, entries down to the target.
-- An internal transition is its effect alone.
local function take_segment(machine, segment, innermost, events)
  local tgt = segment.tgt
  if segment.is_internal then return run_effect(machine, segment.tr, events) end
  local top = common_ancestor(machine, segment)
  dbg(machine, "TRANS_EXIT", "exiting all up to (including):",
    outermost_left(machine, segment, top), ", lca:", top)
  local fqn = innermost
  while fqn ~= top do
    exit(machine, fqn)
    fqn = machine.chart.nodes[fqn].parent
  end
  run_effect(machine, segment.tr, events)
  local below, upwards = {}, { tgt }
  for _, state in ipairs(ancestors(machine, tgt)) do upwards[#upwards + 1] = state end
  for _, node in ipairs(upwards) do
    if is_in(ancestors(machine, node), top) then below[#below + 1] = node end
  end
  dbg(machine, "TRANS_ENTER", "lca: " .. top, "down_path: ", table.concat(below, " > "))
  for i = #below, 1, -1 do
    if machine.chart.nodes[below[i]].kind == "state" then enter(machine, below[i]) end
  end
end

local function kind_text(machine, fqn)
  local node = machine.chart.nodes[fqn]
  return node.kind == "connector" and "[c]" or node.is_leaf and "[LS]" or "[CS]"
end

local function trace_path(machine, path)
  local names = { path[1].src .. kind_text(machine, path[1].src) }
  for i, segment in ipairs(path) do
    names[i + 1] = segment.tgt .. kind_text(machine, segment.tgt)
  end
  dbg(machine, "EXEC_PATH", table.concat(names, "->"))
end

-- The first segment starts at the leaf, each further one in the connector's parent.
local function take_path(machine, path, events)
  for i, segment in ipairs(path) do
    local innermost = i == 1 and machine.leaf or machine.chart.nodes[segment.src].parent
    take_segment(machine, segment, innermost, events)
  end
end

local function take(machine, events)
  local path = find_enabled(machine, configuration(machine), events)
  if not path then return false end
  if not matches(path[1].tr, {}) then defer(machine, events, path[1].tr) end
  trace_path(machine, path)
  take_path(machine, path, events)
  return true
end

-- Root's entry, then the path from root.initial.
-- Events that no transition of the first path names are lost, but not without a word.
local function warn_of_lost(machine, path, events)
  local lost = {}
  for _, event in ipairs(events) do
    local is_named = rawequal(event, "e_init_fsm")
    for _, segment in ipairs(path) do
      local wanted = segment.tr.events
      is_named = is_named or wanted and #wanted > 0 and matches(segment.tr, { event })
    end
    if not is_named then lost[#lost + 1] = event end
  end
  if #lost == 0 then return end
  protected(machine, machine.calls.warn, "WARNING: sent before the machine was "
    .. "entered, which consumes them: " .. text_of(lost))
end

local function first_entry(machine, events)
  if machine.chart.nodes.root.is_leaf then
    warn_of_lost(machine, {}, events)
    enter(machine, "root")
    return true
  end
  local path = find_from(machine, "root.initial", events, {})
  if not path then return false end
  warn_of_lost(machine, path, events)
  enter(machine, "root")
  trace_path(machine, path)
  take_path(machine, path, events)
  return true
end

-- Doo -------------------------------------------------------------------------

local function doo_failed(machine, fqn, problem)
  machine.mode[fqn] = "done"
  machine.coroutine[fqn] = nil
  protected(machine, machine.calls.err, "DOO",
    "doo program of state '" .. fqn .. "' failed: ", problem)
  return true
end

-- One doo cycle of the active leaf; is it idle or done?
local function doo_cycle(machine)
  local fqn = machine.leaf
  if machine.mode[fqn] == "done" then return true end
  local co = machine.coroutine[fqn]
  if not co then
    dbg(machine, "DOO", "created coroutine for " .. fqn .. " doo")
    co = coroutine.create(function(...) return machine.calls.doo(...) end)
    machine.coroutine[fqn] = co
  end
  local ok, idle = coroutine.resume(co, fqn)
  if not ok then return doo_failed(machine, fqn, idle) end
  if coroutine.status(co) == "dead" then
    machine.coroutine[fqn] = nil
    done(machine, fqn)
    dbg(machine, "DOO", "removing completed coroutine of " .. fqn .. " doo")
    return true
  end
  return not not idle
end

-- Step ------------------------------------------------------------------------

local function reset_now(machine)
  for fqn in pairs(machine.chart.nodes) do machine.mode[fqn] = "inactive" end -- a set
  machine.coroutine = {}
  machine.leaf, machine.reset_wanted = nil, false
  machine.queue, machine.deferred = { "e_init_fsm" }, {}
  if machine.calls.was_reset then machine.calls.was_reset() end
end

-- Appends what getevents returns to `list`. An error of it reaches the caller at once.
local function ask_getevents(machine, list)
  for _, event in ipairs(machine.calls.getevents and machine.calls.getevents() or {}) do
    list[#list + 1] = event
  end
end

-- Appends the time events that come now, as a model of timers says.
local function add_timers(machine, events)
  for _, event in ipairs(machine.calls.timers and machine.calls.timers() or {}) do
    events[#events + 1] = event
    dbg(machine, "TIMEEVENT", event)
  end
end

-- Calls a hook, whose error reaches the caller at once as well.
local function run_hook(machine, name, events)
  if machine.calls[name] then machine.calls[name](events) end
end

-- The events of an iteration that did not take place come first in the queue again.
function put_back(machine, events)
  for _, event in ipairs(machine.queue) do events[#events + 1] = event end
  machine.queue = events
end

local function refuse(machine, events)
  local text = text_of(events)
  put_back(machine, events)
  protected(machine, machine.calls.err, "ERROR: cannot enter: no enabled path from "
    .. "'root.initial' on events: " .. text)
  if machine.reset_wanted then reset_now(machine) end
end

-- The events of an iteration: the queue, what getevents returns, what the hook makes of
-- them. Nothing is lost when one of these fails.
local function gather(machine)
  if machine.reset_wanted then reset_now(machine) end
  local events = machine.queue
  machine.queue = {}
  local ok, failure = pcall(function()
    ask_getevents(machine, events)
    add_timers(machine, events)
    events = recall(machine, events)
    run_hook(machine, "pre_hook", events)
  end)
  if ok then return events end
  put_back(machine, events)
  error(failure, 0)
end

-- One iteration. Returns "refused", or "free" / "counted" and whether it is idle.
local function iterate(machine, after_free)
  local events = gather(machine)
  local result, idle, is_taken = "counted", false, true
  if not machine.leaf then
    if not first_entry(machine, events) then
      refuse(machine, events)
      return "refused", false
    end
  elseif #events == 0 then
    idle = doo_cycle(machine)
    if idle then ask_getevents(machine, machine.queue) end
  elseif not take(machine, events) then
    is_taken = false
    if after_free then idle = doo_cycle(machine) else result = "free" end
  end
  if machine.reset_wanted then
    reset_now(machine)
    idle = false
  end
  if not is_taken then defer(machine, events) end
  run_hook(machine, "post_hook", events)
  return result, idle and #machine.queue == 0
end

-- What printers raised reaches the caller when all is consistent.
local function raise_failure(machine)
  if not machine.failed then return end
  local failure = machine.failure
  machine.failed, machine.failure = false, nil
  error(failure, 0)
end

--- Step at most n counted iterations; returns idle.
function reference.step(machine, n)
  local left, after_free = math.max(1, math.floor(n or 1)), false
  while true do
    machine.stepping = true
    local ok, result, idle = pcall(iterate, machine, after_free)
    machine.stepping = false
    if not ok then error(result, 0) end
    raise_failure(machine)
    if result == "refused" then return false end
    if result == "counted" then left = left - 1 end
    if left == 0 then return idle end
    after_free = result == "free"
    if idle then
      if not machine.calls.idle_hook then
        dbg(machine, "HIBERNATING",
          "no events, no idle_hook, no doos or doo idle, halting engines")
        raise_failure(machine)
        return true
      end
      machine.calls.idle_hook()
    end
  end
end

--- Send events; nil is no event.
function reference.send(machine, ...)
  dbg(machine, "RAISED", ...)
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    if event ~= nil then machine.queue[#machine.queue + 1] = event end
  end
end

--- Back to the start; from inside a callback when the iteration is over.
function reference.reset(machine)
  if machine.stepping then
    machine.reset_wanted = true
  else
    reset_now(machine)
    machine.failed, machine.failure = false, nil
  end
end

--- Leave all active states, and go back to the start.
function reference.leave(machine)
  local list = configuration(machine)
  for i = #list, 1, -1 do exit(machine, list[i]) end
  reference.reset(machine)
end

--- Keep the first error for the end of the iteration.
reference.protected = protected

--- Change the target of a transition, which counts from the next search on.
function reference.retarget(tr, tgt)
  tr.is_internal, tr.tgt = tr.was_internal and tgt == tr.src, tgt
end

--- The active states from root to leaf, each with its mode.
function reference.active(machine)
  local list = configuration(machine)
  for i, fqn in ipairs(list) do list[i] = fqn .. "(" .. machine.mode[fqn] .. ")" end
  return list
end

--- A machine of an abstract chart; `calls` run its programs.
function reference.new(chart, calls)
  local machine = { chart = chart, calls = calls, mode = {} }
  reset_now(machine)
  return machine
end

return reference
