--- Checks: events that nobody declared, and what is dead or suspicious in a model.
--
-- `rfsm_checks.check` looks at the structure of a model. `rfsm_checks.watch` lets a
-- machine warn of each event that none of its transitions names. So does
-- `checkevents = true` in the root of a model. `rfsm_checks.watch_all` does it for all
-- machines initialised afterwards, and so does `require "rfsm.checkevents"`.
--
-- @module rfsm_checks
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, ipairs, pairs, pcall = error, ipairs, pairs, pcall
local rawget, rawset, require, select = rawget, rawset, require, select
local setmetatable, type = setmetatable, type
local sort = table.sort
local is_conn, is_leaf, is_state = rfsm.is_conn, rfsm.is_leaf, rfsm.is_state
local elements, location_of, text_of = rfsm.elements, rfsm.location_of, rfsm.text_of

local rfsm_checks = {}

-- Watch: events that nobody declared -------------------------------------------

--- The events that a machine knows, in its field `_checks`.
---@class rfsm_checks.Known
---@field events table<any, boolean> empty until the first event comes
---@field predicates function[]|false functions in events; false: nothing collected yet

-- Adds the names in "await(e_a, e_b@F)@F", which are events, too.
local function add_awaited(events, text)
  local inside = text:match("^await%s*%((.*)%)") or ""
  for name in (inside .. ","):gmatch("%s*([^,]-)%s*,") do events[name] = true end
end

local function add_events(known, tr)
  for i = 1, tr.events and #tr.events or 0 do
    local event = tr.events[i]
    known.events[event] = true
    if type(event) == "function" then
      known.predicates[#known.predicates + 1] = event
    elseif type(event) == "string" then
      add_awaited(known.events, event)
    end
  end
end

-- Collects the events of the transitions, and those of the engine itself.
local function collect_known(fsm, known)
  known.events, known.predicates = { e_init_fsm = true }, {}
  for _, tr in ipairs(elements(fsm, rfsm.is_trans)) do add_events(known, tr) end
  for _, leaf in ipairs(elements(fsm, is_leaf)) do
    known.events["e_done@" .. leaf._fqn] = true
  end
end

local function is_known(known, event)
  if known.events[event] then return true end
  for i = 1, #known.predicates do
    local ok, answer = pcall(known.predicates[i], event)
    if ok and answer then return true end
  end
  return false
end

local function check_event(fsm, event)
  if not fsm._checks.predicates then collect_known(fsm, fsm._checks) end
  if is_known(fsm._checks, event) then return end
  rfsm.report(fsm, "warn",
    "WARNING: undeclared event " .. text_of(event) .. " received")
end

-- This runs in every iteration: one look for an event that is declared.
local function check_events(fsm)
  local events, known = fsm._curq, fsm._checks.events
  for i = 1, #events do
    if not known[events[i]] then check_event(fsm, events[i]) end
  end
end

-- Nothing is collected before the first event comes: other extensions may add events.
local function watch(fsm)
  if not fsm._checks then rfsm.pre_step_hook_add(fsm, check_events) end
  fsm._checks = { events = {}, predicates = false }
end

local watches_all = false

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  local is_wanted = fsm.checkevents == true or watches_all and fsm.checkevents ~= false
  if fsm._checks or is_wanted and not merged then watch(fsm) end
end

-- Reach: which nodes can become active, or be passed ----------------------------

-- Marks a node that a transition leads to, and the composites that it is in.
local function mark(reached, pending, node)
  while not reached[node] do
    reached[node] = true
    pending[#pending + 1] = node
    node = node._parent
  end
end

-- Returns the set of nodes that some path of transitions leads to.
local function find_reached(fsm)
  local reached, pending = {}, {}
  mark(reached, pending, fsm)
  if fsm.initial then mark(reached, pending, fsm.initial) end
  while pending[1] do
    local node = pending[#pending]
    pending[#pending] = nil
    for _, tr in ipairs(node._otrs) do mark(reached, pending, tr.tgt) end
  end
  return reached
end

local function add(findings, obj, text)
  findings[#findings + 1] = location_of(obj) .. ": " .. text
end

local function has_way_out(fsm, state)
  while not state._otrs[1] do
    if state == fsm then return false end
    state = state._parent
  end
  return true
end

-- Finds nodes that nothing leads to, and those that nothing leads away from, but not
-- in an unreachable composite.
local function check_node(fsm, node, reached, findings)
  if not reached[node] then
    if reached[node._parent] then
      add(findings, node, "unreachable, no path of transitions leads here")
    end
  elseif is_conn(node) and not node._otrs[1] then
    add(findings, node, "no way out of this connector, so that no transition to it is "
      .. "ever taken")
  elseif node ~= fsm and is_leaf(node) and not node.final
    and not has_way_out(fsm, node) then
    add(findings, node, "no exit, neither this state nor one around it is ever left")
  end
end

-- Shadows: transitions that another one always beats ---------------------------

local is_always_enabled

-- Does some path lead on from this connector, whatever the events and guards?
local function has_path(connector, seen)
  if seen[connector] then return false end
  seen[connector] = true
  for _, tr in ipairs(connector._otrs) do
    if not (tr.events and tr.events[1]) and is_always_enabled(tr, seen) then
      return true
    end
  end
  return false
end

-- Is `tr` always enabled, once its events match?
function is_always_enabled(tr, seen)
  if tr.guard then return false end
  return not is_conn(tr.tgt) or has_path(tr.tgt, seen)
end

-- Does each of the events of `tr` enable `other`?
local function covers(other, tr)
  if not (other.events and other.events[1]) then return true end
  if not (tr.events and tr.events[1]) then return false end
  local covered = {}
  for _, event in ipairs(other.events) do covered[event] = true end
  for _, event in ipairs(tr.events) do
    if type(event) == "function" or not covered[event] then return false end
  end
  return true
end

-- Returns a transition that is tried before `tr`, from its source or a composite that
-- the source is in, and always taken instead.
local function find_shadow(fsm, tr)
  local node = tr.src
  while true do
    for _, other in ipairs(node._otrs) do
      if other == tr then break end
      if covers(other, tr) and is_always_enabled(other, {}) then return other end
    end
    if is_conn(node) or node == fsm then return nil end
    node = node._parent
  end
end

local function check_transition(fsm, tr, reached, findings)
  local shadow = reached[tr.src] and find_shadow(fsm, tr)
  if shadow then
    add(findings, tr, "never taken, " .. location_of(shadow) .. " always comes first")
  end
end

-- Names each e_done@F that no leaf sends. That of the source itself is left out if
-- `init` has warned of it.
local function check_e_done(tr, leaves, is_warned, findings)
  for _, event in ipairs(tr.events or {}) do
    local fqn = type(event) == "string" and event:match("^e_done@(.*)$")
    if fqn and not leaves[fqn] and not (is_warned and fqn == tr.src._fqn) then
      add(findings, tr, "event '" .. event .. "' never comes, '" .. fqn .. "' is no "
        .. "leaf state of this machine")
    end
  end
end

-- Returns the findings about a machine, in the order of the tree.
local function findings_of(fsm, is_warned)
  local findings, reached, leaves = {}, find_reached(fsm), {}
  for _, leaf in ipairs(elements(fsm, is_leaf)) do leaves[leaf._fqn] = true end
  for _, obj in ipairs(elements(fsm)) do
    if rfsm.is_trans(obj) then
      check_transition(fsm, obj, reached, findings)
      check_e_done(obj, leaves, is_warned, findings)
    else
      check_node(fsm, obj, reached, findings)
    end
  end
  return findings
end

-- Public functions ------------------------------------------------------------

local PRINTERS = { "dbg", "info", "warn", "err" }

-- Makes a machine that prints nothing but its warnings, with `warn`. It is made of the
-- model itself, because transitions may name its root.
local function init_with(model, warn)
  local own = {}
  for _, name in ipairs(PRINTERS) do
    own[name] = model[name]
    if not rfsm.is_fsmobj(own[name]) then model[name] = name == "warn" and warn end
  end
  local ok, fsm, problems = pcall(rfsm.init, model)
  for _, name in ipairs(PRINTERS) do model[name] = own[name] end
  if not ok then error(fsm, 0) end
  return fsm, problems
end

--- Find what is wrong, dead or suspicious in a model.
--
-- States and connectors that nothing leads to, or that nothing leads away from;
-- transitions that another one always beats; an `e_done@F` that nobody sends. For a
-- model that is not valid, its problems. A leaf that nothing leaves is no finding if it
-- is declared `final = true`.
--
-- @raise if `model` is no state
---@param model rfsm.State a model, or a machine
---@return string[] findings each "file:line: place: text"; in a fixed order
---@nodiscard
function rfsm_checks.check(model)
  if not is_state(model) then
    error("rfsm_checks.check: state expected, got " .. type(model), 2)
  end
  if rfsm.is_initialized_root(model) then return findings_of(model, false) end
  local fsm, problems = init_with(model, false)
  return problems or findings_of(fsm, false)
end

local function name_before(a, b) return text_of(a) < text_of(b) end

local function names_of_machines(machines)
  local names = {}
  for name, machine in pairs(machines) do -- any order: sorted
    if rfsm.is_initialized_root(machine) then names[#names + 1] = name end
  end
  sort(names, name_before)
  return names
end

-- Appends texts about a machine that is part of the model at `location`.
local function append(list, texts, location)
  for _, text in ipairs(texts) do
    local file, rest = text:match("^(.-:%d+: )(root.*)$")
    list[#list + 1] = (file or "") .. location .. (rest or text)
  end
end

-- Appends the findings about a machine, and all about the machines inside its states.
local function add_warnings(warnings, fsm, location)
  append(warnings, findings_of(fsm, true), location)
  for _, state in ipairs(elements(fsm, is_leaf)) do
    local machines = type(state.substates) == "table" and state.substates or {}
    for _, name in ipairs(names_of_machines(machines)) do
      local inner = location .. state._fqn .. "." .. text_of(name) .. ": "
      append(warnings, select(3, rfsm.verify_early(machines[name])), inner)
      add_warnings(warnings, machines[name], inner)
    end
  end
end

--- Find all problems of a model, and everything dead or suspicious in it.
--
-- Unlike `check`, this includes the warnings of `rfsm.init`, and the machines inside
-- sequential AND states. A model with problems cannot become a machine.
--
---@param model rfsm.State
---@return string[] problems each "file:line: place: text"
---@return string[] warnings likewise
---@nodiscard
function rfsm_checks.review(model)
  local is_valid, problems, early_warnings = rfsm.verify_early(model)
  if not is_valid then return problems, early_warnings end
  local warnings = {}
  local fsm, found = init_with(model, function(text)
    text = text_of(text):gsub("^WARNING: ", "")
    if text:find("^no outgoing transitions from node") then return end -- a finding
    warnings[#warnings + 1] = text
  end)
  if not fsm then return found, warnings end
  add_warnings(warnings, fsm, "")
  return {}, warnings
end

--- Have a machine warn of each event that it receives and no transition names.
---@param fsm rfsm.Machine
function rfsm_checks.watch(fsm)
  rfsm.check_machine(fsm, "rfsm_checks.watch")
  watch(fsm)
end

-- Functions in files of their own, which are loaded when they are first asked for.
local ELSEWHERE = { why = "rfsm.checks.why", enabled = "rfsm.checks.why" }

setmetatable(rfsm_checks, { __index = function(_, name)
  if not ELSEWHERE[name] then return nil end
  rfsm_checks[name] = require(ELSEWHERE[name])[name]
  return rfsm_checks[name]
end })

local function set_global(name)
  if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, name, rfsm_checks) end
end

--- Let all machines initialised from now on warn of undeclared events.
--
-- `checkevents = false` in the root of a model excludes its machines. Requiring
-- `rfsm.checkevents` or `rfsm_checkevents` calls this function.
--
---@return table rfsm_checks this module, which is what these names give
function rfsm_checks.watch_all()
  watches_all = true
  set_global("rfsm_checkevents")
  return rfsm_checks
end

set_global("rfsm_checks")

return rfsm_checks
