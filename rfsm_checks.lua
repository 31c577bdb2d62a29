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

local error, ipairs, pairs, pcall, print = error, ipairs, pairs, pcall, print
local rawget, rawset, select, tostring, type = rawget, rawset, select, tostring, type
local sort = table.sort
local is_conn, is_leaf, is_state, is_trans = rfsm.is_conn, rfsm.is_leaf, rfsm.is_state,
  rfsm.is_trans

local rfsm_checks = {}

local function itself(obj) return obj end

local function all(fsm, pred) return rfsm.mapfsm(itself, fsm, pred) end

-- Watch: events that nobody declared -------------------------------------------

--- What the transitions of a machine declare.
---@class rfsm_checks.Known
---@field events table<any, boolean> the events that are declared
---@field predicates function[] functions in events

-- Adds the names in "await(e_a, e_b@F)@F", which are events, too.
local function add_awaited(events, text)
  local inside = text:match("^await%s*%((.*)%)")
  if not inside then return end
  for name in (inside .. ","):gmatch("%s*([^,]-)%s*,") do events[name] = true end
end

local function add_events(known, tr)
  local events = type(tr.events) == "table" and tr.events or {}
  for i = 1, #events do
    local event = events[i]
    known.events[event] = true
    if type(event) == "function" then
      known.predicates[#known.predicates + 1] = event
    elseif type(event) == "string" then
      add_awaited(known.events, event)
    end
  end
end

-- Collects what the transitions name, and what the engine itself sends.
local function known_of(fsm)
  local known = { events = { e_init_fsm = true }, predicates = {} }
  for _, tr in ipairs(all(fsm, is_trans)) do add_events(known, tr) end
  for _, leaf in ipairs(all(fsm, is_leaf)) do
    known.events["e_done@" .. leaf._fqn] = true
  end
  if is_leaf(fsm) then known.events["e_done@root"] = true end
  return known
end

local function is_known(known, event)
  if known.events[event] then return true end
  for i = 1, #known.predicates do
    local ok, answer = pcall(known.predicates[i], event)
    if ok and answer then return true end
  end
  return false
end

local function text_of(value)
  if type(value) == "number" then return ("%.14g"):format(value) end
  local ok, text = pcall(tostring, value)
  return ok and type(text) == "string" and text or type(value)
end

local function learn(fsm, own)
  own.known = known_of(fsm)
  own.events = own.known.events
end

local function warn_of_unknown(fsm, own, event)
  local printer = fsm.warn == true and print or fsm.warn
  if not printer then return end
  if not own.known then learn(fsm, own) end
  if is_known(own.known, event) then return end
  printer("WARNING: undeclared event " .. text_of(event) .. " received")
end

-- This runs in every iteration: one look for an event that is declared.
local function check_events(fsm)
  local events, known = fsm._curq, fsm._checks.events
  for i = 1, #events do
    if not known[events[i]] then warn_of_unknown(fsm, fsm._checks, events[i]) end
  end
end

-- What is declared is collected when the first event comes, not before: other
-- extensions may add events.
local function forget_known(own) own.known, own.events = false, {} end

local function watch(fsm)
  if fsm._checks then return end
  fsm._checks = {}
  forget_known(fsm._checks)
  rfsm.pre_step_hook_add(fsm, check_events)
end

local watches_all = false

-- The field `checkevents` in the root decides for one machine.
local function is_wanted(fsm)
  return fsm.checkevents == true or watches_all and fsm.checkevents ~= false
end

-- What is merged may declare more events.
rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if not merged and is_wanted(fsm) then watch(fsm) end
  if merged and fsm._checks then forget_known(fsm._checks) end
end

-- Reach: which nodes can become active, or be passed ----------------------------

-- Marks a node that a transition leads to, and the states around it, which are entered.
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
    local otrs = node._otrs
    for i = 1, otrs and #otrs or 0 do mark(reached, pending, otrs[i].tgt) end
  end
  return reached
end

local function add(findings, place, text)
  findings[#findings + 1] = place .. ": " .. text
end

local function place_of(tr)
  local key = type(tr._id) == "number" and ("trans[%d]"):format(tr._id) or tr._id
  return tr._parent._fqn .. "." .. key
end

local function has_way_out(fsm, state)
  while true do
    if state._otrs and state._otrs[1] then return true end
    if state == fsm then return false end
    state = state._parent
  end
end

-- Finds nodes that nothing leads to, and those that nothing leads away from.
local function check_nodes(fsm, reached, findings)
  for _, node in ipairs(all(fsm, rfsm.is_node)) do
    if not reached[node] then
      if reached[node._parent] then -- of those inside, it goes without saying
        add(findings, node._fqn, "unreachable, no path of transitions leads here")
      end
    elseif is_conn(node) and not (node._otrs and node._otrs[1]) then
      add(findings, node._fqn, "no way out of this connector, so that no transition to "
        .. "it is ever taken")
    elseif is_leaf(node) and not has_way_out(fsm, node) then
      add(findings, node._fqn, "no exit, neither this state nor one around it is ever "
        .. "left")
    end
  end
end

-- Shadows: transitions that another one always beats ---------------------------

local is_open

-- Does some way lead on from this connector, whatever the events and the world?
local function has_open_way(connector, seen)
  if seen[connector] then return false end
  seen[connector] = true
  local otrs = connector._otrs
  for i = 1, otrs and #otrs or 0 do
    if not (otrs[i].events and otrs[i].events[1]) and is_open(otrs[i], seen) then
      return true
    end
  end
  return false
end

-- Is `tr` always enabled, once its events match?
function is_open(tr, seen)
  if tr.guard then return false end
  return not is_conn(tr.tgt) or has_open_way(tr.tgt, seen)
end

-- Does each of the events of `tr` enable `other`?
local function covers(other, tr)
  if not (other.events and other.events[1]) then return true end
  if not (tr.events and tr.events[1]) then return false end
  local covered = {}
  for i = 1, #other.events do covered[other.events[i]] = true end
  for i = 1, #tr.events do
    local event = tr.events[i]
    if type(event) == "function" or not covered[event] then return false end
  end
  return true
end

-- Returns what is tried before `tr` at its source and always taken instead.
local function find_shadow_at(node, tr)
  local otrs = node._otrs
  for i = 1, otrs and #otrs or 0 do
    if otrs[i] == tr then return nil end
    if covers(otrs[i], tr) and is_open(otrs[i], {}) then return otrs[i] end
  end
end

local function find_shadow(fsm, tr)
  local node = tr.src
  local shadow = find_shadow_at(node, tr)
  while not shadow and is_state(node) and node ~= fsm do
    node = node._parent
    shadow = find_shadow_at(node, tr)
  end
  return shadow
end

-- Names each e_done@F that no leaf sends.
local function check_e_done(tr, leaves, findings)
  for i = 1, tr.events and #tr.events or 0 do
    local event = tr.events[i]
    local fqn = type(event) == "string" and event:match("^e_done@(.*)$")
    if fqn and not leaves[fqn] then
      add(findings, place_of(tr), "event '" .. event .. "' never comes, '" .. fqn
        .. "' is no leaf state of this machine")
    end
  end
end

local function check_transitions(fsm, reached, findings)
  local leaves = { root = is_leaf(fsm) or nil }
  for _, leaf in ipairs(all(fsm, is_leaf)) do leaves[leaf._fqn] = true end
  for _, tr in ipairs(all(fsm, is_trans)) do
    local shadow = reached[tr.src] and find_shadow(fsm, tr)
    if shadow then
      add(findings, place_of(tr), "never taken, " .. place_of(shadow)
        .. " always comes first")
    end
    check_e_done(tr, leaves, findings)
  end
end

-- Public functions ------------------------------------------------------------

local PRINTERS = { "dbg", "info", "warn", "err" }

-- Makes a machine that prints nothing. It is made of the model itself, whose root its
-- transitions may name, and which may be a part of a machine.
local function init_quietly(model)
  local own = {}
  for i, name in ipairs(PRINTERS) do
    own[i] = model[name]
    if not rfsm.is_fsmobj(own[i]) then model[name] = false end -- else it is reported
  end
  local ok, fsm, problems = pcall(rfsm.init, model)
  for i, name in ipairs(PRINTERS) do model[name] = own[i] end
  if not ok then error(fsm, 0) end
  return fsm, problems
end

-- Digits padded, so that trans[10] comes after trans[2].
local function natural(text)
  return (text:gsub("%d+", function(n) return ("0"):rep(12 - #n) .. n end))
end

local function sort_naturally(lines)
  sort(lines, function(a, b) return natural(a) < natural(b) end)
  return lines
end

--- Find what is wrong, dead or suspicious in a model.
--
-- States and connectors that nothing leads to, or that nothing leads away from;
-- transitions that another one always beats; an `e_done@F` that nobody sends. For a
-- model that is not valid, its problems. A final state is a finding, too: it is for you
-- to say whether it is meant.
--
-- @raise when `model` is no state
---@param model rfsm.State a model, or a machine
---@return string[] findings each "place: what"; in a fixed order
---@nodiscard
function rfsm_checks.check(model)
  if not is_state(model) then
    error("rfsm_checks.check: state expected, got " .. type(model), 2)
  end
  local fsm, problems = model, nil
  if not rfsm.is_initialized_root(model) then fsm, problems = init_quietly(model) end
  if not fsm then return problems end
  local findings, reached = {}, find_reached(fsm)
  check_nodes(fsm, reached, findings)
  check_transitions(fsm, reached, findings)
  return sort_naturally(findings)
end

-- Returns a finding in the words of `init`, which reports the same `e_done`.
local function as_init_warns(finding)
  return (finding:gsub("^(.-): event 'e_done@(.-)' never comes.*",
    "%1: 'e_done' never fires here, '%2' is no leaf state"))
end

-- Appends the findings about a machine, except those that `init` has reported.
local function add_findings_once(warnings, fsm, prefix)
  local is_reported = {}
  for _, warning in ipairs(warnings) do is_reported[warning] = true end
  for _, finding in ipairs(rfsm_checks.check(fsm)) do
    if not is_reported[prefix .. as_init_warns(finding)] then
      warnings[#warnings + 1] = prefix .. finding
    end
  end
end

local function names_of_machines(machines)
  local names = {}
  for name, machine in pairs(machines) do -- any order: sorted below
    if rfsm.is_initialized_root(machine) then names[#names + 1] = name end
  end
  sort(names)
  return names
end

-- Appends the warnings about a machine and about the machines inside its states.
local function add_warnings(warnings, fsm, prefix)
  add_findings_once(warnings, fsm, prefix)
  for _, state in ipairs(all(fsm, is_leaf)) do
    local machines = type(state.substates) == "table" and state.substates or {}
    for _, name in ipairs(names_of_machines(machines)) do
      local location = prefix .. state._fqn .. "." .. name .. ": "
      for _, warning in ipairs(select(3, rfsm.verify_early(machines[name]))) do
        warnings[#warnings + 1] = location .. warning
      end
      add_warnings(warnings, machines[name], location)
    end
  end
end

-- Returns a printer for `warn`. The static checks report a state without a way out, and
-- they know whether it matters.
local function collector(warnings)
  return function(text)
    text = text_of(text):gsub("^WARNING: ", "")
    if text:find("^no outgoing transitions from node") then return end
    warnings[#warnings + 1] = text
  end
end

--- Find all problems of a model, and everything dead or suspicious in it.
--
-- Unlike `check`, this includes the warnings of `rfsm.init`, and the machines inside
-- sequential AND states. A model with problems cannot become a machine.
--
---@param model rfsm.State its printers are replaced
---@return string[] problems each "location: text"
---@return string[] warnings likewise
---@nodiscard
function rfsm_checks.review(model)
  local is_valid, problems, early_warnings = rfsm.verify_early(model)
  if not is_valid then return problems, early_warnings end
  local warnings = {}
  model.dbg, model.err, model.info = false, false, false
  model.warn = collector(warnings)
  local fsm, found = rfsm.init(model)
  if not fsm then return found, warnings end
  add_warnings(warnings, fsm, "")
  return {}, sort_naturally(warnings)
end

--- Have a machine warn of each event that it receives and no transition names.
---@param fsm rfsm.Machine
function rfsm_checks.watch(fsm)
  if not rfsm.is_initialized_root(fsm) then
    error("rfsm_checks.watch: initialised fsm expected, got " .. type(fsm), 2)
  end
  watch(fsm)
end

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
