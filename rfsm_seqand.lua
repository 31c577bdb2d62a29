--- Sequential AND states: machines that run side by side inside one state.
--
-- The table that `rfsm.seqand` returns is a leaf state for the machine around it. While
-- it is active its doo advances the machines in it, its *subs*, one after the other,
-- and each event of the machine around goes to all of them, except those that make it
-- leave.
--
-- Each instance of a model has subs of its own, in the field `substates` of the state.
--
-- @module rfsm_seqand
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, ipairs, pairs = error, getmetatable, ipairs, pairs
local pcall, rawget, rawset, setmetatable = pcall, rawget, rawset, setmetatable
local tostring, type = tostring, type
local concat, sort = table.concat, table.sort
local is_machine, is_state = rfsm.is_initialized_root, rfsm.is_state
local step, run = rfsm.step, rfsm.run

-- Model: what the constructor takes, and its mistakes ---------------------------

--- Fields of a sequential AND state; each state or machine at another name is a sub.
---@class rfsm_seqand.Fields
---@field order? string[] names of the subs to advance first; others follow by name
---@field step? number how many steps a sub advances in each cycle (1)
---@field run? boolean run each sub instead
---@field idle_doo? boolean|"auto" what the doo yields: idle (true); "auto": if all are
---@field seqanddbg? boolean|fun(text: string) tell `info` (or it) of each advance
---@field entry? function called before the subs are entered
---@field exit? function called after the subs were left

-- The subs of a state by name: as given, in a model; machines, in an instance. The core
-- shares what has a metatable, so that it takes none of them for a substate.
local Substates = {}

local function has_subs(state)
  return getmetatable(state.substates) == Substates
end

local function sorted_names(subs)
  local names = {}
  for name in pairs(subs) do names[#names + 1] = name end -- any order: sorted below
  sort(names)
  return names
end

local function got(value)
  if is_state(value) then return "got state" end
  if type(value) == "string" then return "got string '" .. value .. "'" end
  return "got " .. type(value)
end

local function add(problems, field, text)
  problems[#problems + 1] = { field = field, text = text }
end

local function check_order(state, problems)
  local order, seen = state.order, {}
  if order == nil then return end
  if type(order) ~= "table" or is_state(order) then
    return add(problems, "order", "list of names expected, " .. got(order))
  end
  for i = 1, #order do
    local name, field = order[i], "order[" .. i .. "]"
    if type(name) ~= "string" or state.substates[name] == nil then
      local names = concat(sorted_names(state.substates), "', '")
      add(problems, field, "name of a sub machine expected, " .. got(name)
        .. " (there are " .. (names == "" and "none" or "'" .. names .. "'") .. ")")
    elseif seen[name] then
      add(problems, field, "'" .. name .. "' stands there twice")
    end
    seen[name or false] = true
  end
end

local function check_idle(state, field, problems)
  local idle = state[field]
  if idle == nil or type(idle) == "boolean" or idle == "auto" then return end
  add(problems, field, "true, false or 'auto' expected, " .. got(idle))
end

local function check_advance(state, problems)
  local steps, is_run = state.step, state.run
  if steps ~= nil and (type(steps) ~= "number" or steps ~= steps) then
    add(problems, "step", "number of steps expected, " .. got(steps))
  end
  if is_run ~= nil and type(is_run) ~= "boolean" then
    add(problems, "run", "boolean expected, " .. got(is_run))
  end
  if steps ~= nil and is_run == true then
    add(problems, "step", "either a number of steps or run = true, not both")
  end
end

-- Returns what is wrong with the fields of a sequential AND state.
local function problems_of(state)
  local problems = {}
  check_order(state, problems)
  check_advance(state, problems)
  check_idle(state, "idle_doo", problems)
  check_idle(state, "idle.doo", problems)
  return problems
end

-- Run: entry, doo and exit of the state, events --------------------------------

--- What a state needs to run its subs, in its field `_seqand`.
---@class rfsm_seqand.Crew
---@field names string[] in the order in which they are advanced
---@field subs rfsm.Machine[] likewise
---@field is_entering boolean entered in this iteration: its events are not for the subs
---@field is_forwarded boolean the doo has handed on the events of this iteration
---@field has_failure boolean a hook, printer or getevents of a sub raised
---@field failure any what it raised

local function keep_failure(crew, failure)
  if crew.has_failure then return end
  crew.has_failure, crew.failure = true, failure
end

local function tell(fsm, state, name, sub)
  local level = state.seqanddbg or state.andseqdbg
  local printer = level == true and fsm.info or level
  if not printer then return end
  printer(("SEQAND %s: %s advanced to %s"):format(state._fqn, name,
    tostring(rfsm.get_actleaf_fqn(sub))))
end

-- Calls f(sub, ...); what it raises is raised again when the iteration is over.
local function try(crew, f, sub, ...)
  local ok, result = pcall(f, sub, ...)
  if ok then return result end
  keep_failure(crew, result)
  return false
end

-- Advances one sub; returns whether it is idle then.
local function advance_sub(fsm, state, i)
  local crew = state._seqand
  local sub = crew.subs[i]
  local idle = try(crew, state.run and run or step, sub, state.step)
  local ok, failure = pcall(tell, fsm, state, crew.names[i], sub)
  if not ok then keep_failure(crew, failure) end
  return idle
end

local function forward(crew, events)
  local subs = crew.subs
  for i = 1, #subs do
    for j = 1, #events do try(crew, rfsm.send_events, subs[i], events[j]) end
  end
end

-- What the doo yields when all subs were advanced.
local function idle_flag(state, all_idle)
  local flag = state.idle_doo
  if flag == nil then flag = state["idle.doo"] end
  if flag == "auto" then return all_idle end
  return flag == nil or flag
end

-- The doo: it runs only in iterations that take no transition, so that their events
-- are for the subs.
local function advance_all(fsm, state)
  local crew = state._seqand
  while true do
    forward(crew, fsm._curq)
    crew.is_forwarded = true
    local all_idle = true
    for i = 1, #crew.subs do
      if not advance_sub(fsm, state, i) then all_idle = false end
    end
    rfsm.yield(idle_flag(state, all_idle))
  end
end

-- The entry: the user's own, then one step of each sub.
local function enter_all(fsm, state, what)
  local program, ok, failure = state.seqand_entry, true, nil
  if program then ok, failure = pcall(program, fsm, state, what) end
  local crew = state._seqand
  for i = 1, #crew.subs do try(crew, step, crew.subs[i]) end
  if not ok then error(failure, 0) end
end

local function leave_and_reset(sub)
  local ok, failure = pcall(rfsm.exit_state, sub, sub)
  rfsm.reset(sub)
  if not ok then error(failure, 0) end
end

local function leave_subs(crew)
  for i = 1, #crew.subs do try(crew, leave_and_reset, crew.subs[i]) end
end

-- The exit: the subs are left and reset, then the user's own.
local function leave_all(fsm, state, what)
  leave_subs(state._seqand)
  local program = state.seqand_exit
  if program then program(fsm, state, what) end
end

local function note_entry(_, state) state._seqand.is_entering = true end

-- Subs are left also when a tool has replaced the exit of the state.
local function note_exit(_, state) leave_subs(state._seqand) end

-- Ends an iteration: the events that made no state leave go to the subs of the active
-- one, unless its doo has handed them on.
local function end_iteration(fsm)
  local state, events = fsm._act_leaf, fsm._curq
  local crew = state and state._seqand
  if crew then
    if not crew.is_entering and not crew.is_forwarded then forward(crew, events) end
    crew.is_entering, crew.is_forwarded = false, false
  end
  local crews = fsm._seqands
  for i = 1, #crews do
    if crews[i].has_failure then
      local failure = crews[i].failure
      crews[i].has_failure, crews[i].failure = false, nil
      error(failure, 0)
    end
  end
end

local function reset(fsm)
  local crews = fsm._seqands
  for i = 1, #crews do
    crews[i].is_entering, crews[i].is_forwarded = false, false
    for _, sub in ipairs(crews[i].subs) do try(crews[i], rfsm.reset, sub) end
  end
end

-- Prepare: each instance gets subs of its own ----------------------------------

-- What tools set on a live machine, and what a machine given as a sub hands on.
local HANDED_ON = {
  "dbg", "info", "warn", "err", "getevents", "idle_hook", "pre_step_hook",
  "post_step_hook",
}

-- Returns a fresh machine for a sub; false and its problems when it is not valid.
local function new_sub(given)
  local sub, problems = rfsm.init(given)
  if sub and is_machine(given) then
    for i = 1, #HANDED_ON do sub[HANDED_ON[i]] = given[HANDED_ON[i]] end
  end
  return sub, problems
end

local opening = {} -- Substates whose machines are being made, to find circles

-- Makes the subs of `state`; appends to `problems` what is wrong with them.
local function new_subs(state, problems)
  local given, subs = state.substates, setmetatable({}, Substates)
  opening[given] = true
  local ok, failure = pcall(function()
    for _, name in ipairs(sorted_names(given)) do
      local sub, found = new_sub(given[name])
      subs[name] = sub
      for _, text in ipairs(found or {}) do
        problems[#problems + 1] = state._fqn .. "." .. name .. ": " .. text
      end
    end
  end)
  opening[given] = nil
  if not ok then error(failure, 0) end
  return subs
end

-- The names of `order`, then the others sorted.
local function sequence_of(state)
  local names, is_named = {}, {}
  for i, name in ipairs(state.order or {}) do
    names[i], is_named[name] = name, true
  end
  for _, name in ipairs(sorted_names(state.substates)) do
    if not is_named[name] then names[#names + 1] = name end
  end
  return names
end

local function new_crew(state)
  local names, subs = sequence_of(state), {}
  for i = 1, #names do subs[i] = state.substates[names[i]] end
  return {
    names = names, subs = subs, is_entering = false, is_forwarded = false,
    has_failure = false, failure = nil,
  }
end

local function add_crew(fsm, crew)
  if not fsm._seqands then
    fsm._seqands = {}
    rfsm.post_step_hook_add(fsm, end_iteration, "before")
    rfsm.reset_hook_add(fsm, reset)
  end
  fsm._seqands[#fsm._seqands + 1] = crew
end

-- Programs that were set on the model after it was made become the user's own.
local function wrap_programs(state)
  if state.entry ~= enter_all then
    state.seqand_entry, state.entry = state.entry, enter_all
  end
  if state.exit ~= leave_all then
    state.seqand_exit, state.exit = state.exit, leave_all
  end
end

local function prepare_state(fsm, state, problems)
  if opening[state.substates] then
    problems[#problems + 1] = state._fqn .. ": a sequential AND state cannot contain "
      .. "itself"
    return
  end
  local before = #problems
  for _, problem in ipairs(problems_of(state)) do
    problems[#problems + 1] = state._fqn .. "." .. problem.field .. ": " .. problem.text
  end
  state.substates = new_subs(state, problems)
  if #problems > before then return end
  wrap_programs(state)
  state._seqand = new_crew(state)
  add_crew(fsm, state._seqand)
  rfsm.entry_hook_add(fsm, state, note_entry)
  rfsm.exit_hook_add(fsm, state, note_exit)
end

local function prepare(fsm, merged)
  local obj, problems = merged or fsm, {}
  if not is_state(obj) then return end
  if has_subs(obj) then prepare_state(fsm, obj, problems) end
  rfsm.mapfsm(function(state)
    if has_subs(state) then prepare_state(fsm, state, problems) end
  end, obj, is_state)
  return problems
end

rfsm.preproc[#rfsm.preproc + 1] = prepare

-- Public: the module is the constructor ----------------------------------------

local RESERVED = {
  order = true, step = true, run = true, idle_doo = true, ["idle.doo"] = true,
  entry = true, exit = true, andseqdbg = true, seqanddbg = true,
}

-- Why the constructor cannot take a member; nil when it can.
local function obstacle(key, value)
  if key == "doo" or key == "substates" then
    return key .. ": is the state's own, and cannot be set"
  elseif rfsm.is_conn(value) or is_state(value) and RESERVED[key] then
    return tostring(key) .. ": cannot be a "
      .. (is_state(value) and "state" or "connector")
  elseif is_state(value) and type(key) ~= "string" then
    return "a sub machine needs a name (name = ...)"
  end
end

-- Returns the state; nil and what is wrong with the fields.
local function new_state(fields)
  if type(fields) ~= "table" then return nil, "table expected, got " .. type(fields) end
  local state, subs, first = {}, setmetatable({}, Substates), nil
  for key, value in pairs(fields) do -- any order: the least text counts
    local text = obstacle(key, value)
    if text and (not first or text < first) then first = text end
    if is_state(value) then subs[key] = value else state[key] = value end
  end
  if first then return nil, first end
  state.substates = subs
  state.seqand_entry, state.seqand_exit = state.entry, state.exit
  state.entry, state.doo, state.exit = enter_all, advance_all, leave_all
  local problem = problems_of(state)[1]
  if problem then return nil, problem.field .. ": " .. problem.text end
  return rfsm.state(state)
end

local function construct(_, fields)
  local state, text = new_state(fields)
  if not state then error("rfsm.seqand: " .. text, 2) end
  return state
end

local rfsm_seqand = setmetatable({}, { __call = construct })

--- Make a sequential AND state; `rfsm.seqand { ... }` is the same.
--
-- @usage
--    par = rfsm.seqand { left = rfsm.load("arm.lua"), right = rfsm.load("arm.lua") }
--
-- @function new
-- @raise when a field is wrong
---@param fields rfsm_seqand.Fields
---@return rfsm.State state a leaf state, to be mounted any number of times
rfsm_seqand.new = construct

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_seqand", rfsm_seqand) end

return rfsm_seqand
