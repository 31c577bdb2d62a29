--- Sequential AND states: machines that run side by side inside one state.
--
-- The table that `rfsm.seqand` returns is a leaf state of the parent machine. While it
-- is active its doo advances the machines in it, its *regions*, one after the other.
-- The events of each iteration of the parent machine go to all regions, unless the
-- state was left in that iteration.
--
-- Each instance of a model has its own regions, in the field `substates` of the state.
-- If a machine is given as a region, the first instance uses that machine itself.
--
-- @module rfsm_seqand
-- @license BSD-3-Clause

local home = tostring((...)):match("^(.+[./])rfsm_seqand$") -- "libs."
if home then require(home .. "rfsm") return require "rfsm_seqand" end -- one copy

local rfsm = require "rfsm"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local pcall, rawget, rawset, setmetatable = pcall, rawget, rawset, setmetatable
local type = type
local concat = table.concat
local got, is_state, text_of = rfsm.got, rfsm.is_state, rfsm.text_of
local step, run = rfsm.step, rfsm.run

-- Model: the fields that the constructor takes -----------------------------------

--- Fields of a sequential AND state. Each state or machine among the fields is a
-- region, whether its key is a name or a position.
---@class rfsm_seqand.Fields
---@field order? any[] names of the regions to advance first; others follow by name
---@field step? number how many steps a region advances in each cycle (1)
---@field run? boolean advance a region by `rfsm.run` instead of single steps
---@field idle_doo? boolean|"auto" the value that the doo yields (true); "auto": true if
-- all regions are idle
---@field seqanddbg? boolean|fun(text: string) print the order once, then each advance
---@field entry? function called before the regions are entered
---@field exit? function called after the regions were left
---@field [any] any a region, or data of the user

-- The metatable of `substates`, a table of the regions by name: models in a model,
-- machines in an instance. The core does not look into a table with a metatable, so
-- regions do not become children of the state.
local Substates = { rfsm_copy = rfsm }

-- The `substates` of states that contain transitions, for a warning: transitions belong
-- into a region.
local has_transitions = setmetatable({}, { __mode = "k" })

local function has_regions(state)
  return is_state(state) and getmetatable(state.substates) == Substates
end

-- Returns a list of names as a text, "a, b"; each name is in `quote`.
local function list_text(names, quote)
  local texts = {}
  for i, name in ipairs(names) do texts[i] = quote .. text_of(name) .. quote end
  return concat(texts, ", ")
end

local function check_order(order, regions)
  if order == nil then return nil end
  if type(order) ~= "table" or is_state(order) then
    return "order", "list of names expected, " .. got(order)
  end
  for i, name in ipairs(order) do
    if regions[name] == nil then
      local names = list_text(rfsm.sorted_keys(regions), "'")
      return "order[" .. i .. "]", "name of a region expected, " .. got(name)
        .. " (there are " .. (names ~= "" and names or "none") .. ")"
    end
  end
end

local function check_advance(state)
  local steps, is_run = state.step, state.run
  if steps ~= nil and (type(steps) ~= "number" or steps ~= steps) then
    return "step", "number of steps expected, " .. got(steps)
  elseif is_run ~= nil and type(is_run) ~= "boolean" then
    return "run", "boolean expected, " .. got(is_run)
  elseif steps ~= nil and is_run then
    return "step", "either a number of steps or run = true, not both"
  end
  for _, field in ipairs { "idle_doo", "idle.doo" } do
    local idle = state[field]
    if idle ~= nil and type(idle) ~= "boolean" and idle ~= "auto" then
      return field, "true, false or 'auto' expected, " .. got(idle)
    end
  end
end

-- Run: entry, doo and exit of the state, events ----------------------------------

--- The field `_regions` of a state: its regions in the order in which they are stepped.
---@class rfsm_seqand.Regions
---@field names any[] the names of the regions, in the order of this list
---@field entry? function the entry that the user gave
---@field exit? function the exit that the user gave
---@field is_shown boolean the order of the regions has been printed
---@field turn integer|false the iteration whose events the regions have got last
---@field is_restored boolean the entry is called again, because a snapshot was restored

--- Send the events of an iteration to a region, for extensions.
--
-- After an interrupt this may be called again in the same iteration: then the region
-- gets only the events that it has not got yet.
--
---@param fsm rfsm.Machine the parent machine
---@param region rfsm.Machine
---@param events any[]
function rfsm.forward(fsm, region, events)
  local queue, had = region._intq, region._got
  if had.turn ~= fsm._turn then
    had.count = 0
    had.turn = fsm._turn
  elseif #queue > had.length and rawequal(queue[#queue], events[had.count + 1]) then
    had.count = had.count + 1
  end
  for i = had.count + 1, #events do
    had.length = #queue
    if fsm._fates then fsm._fates:forward(region, events[i], i) end
    rfsm.send_events(region, events[i])
    had.count = i
  end
end

-- Calls f(...) and returns the result. An error is raised later, after the
-- iteration of the parent machine.
local function try(fsm, f, ...)
  local ok, result = pcall(f, ...)
  if ok then return result end
  rfsm.keep_failure(fsm, result)
  fsm._cuts = fsm._cuts + 1 -- an interrupt before the region's step cuts this one short
  return false
end

-- The function that the core puts into machines as `info` if the model switches it off;
-- made when it is first needed.
local silent

local function print_line(fsm, state, printer, text)
  text = "SEQAND " .. state._fqn .. ": " .. text
  if printer ~= true then return try(fsm, printer, text) end
  silent = silent or rfsm.init(rfsm.state { info = false, warn = false }).info
  if fsm.info and fsm.info ~= silent then return rfsm.report(fsm, "info", text) end
  rawget(_G, "print")(text)
end

-- Advances region number i by the steps that the fields `step` and `run` demand.
local function advance(fsm, state, i)
  local regions, printer = state._regions, state.seqanddbg or state.andseqdbg
  if printer and not regions.is_shown then
    regions.is_shown = true
    print_line(fsm, state, printer, "order " .. list_text(regions.names, ""))
  end
  local idle = try(fsm, state.run and run or step, regions[i], state.step)
  if printer then
    print_line(fsm, state, printer, text_of(regions.names[i]) .. " advanced to "
      .. text_of(rfsm.get_actleaf_fqn(regions[i])))
  end
  return idle
end

-- Forwards the events of an iteration, once. Only an interrupt ends this with an error.
local function forward(fsm, regions)
  if regions.turn == fsm._turn then return end
  for i = 1, #regions do rfsm.forward(fsm, regions[i], fsm._curq) end
  regions.turn = fsm._turn
end

-- Returns the value that the doo yields when all regions were advanced.
local function idle_flag(state, are_all_idle)
  local flag = state.idle_doo
  if flag == nil then flag = state["idle.doo"] end
  if flag == "auto" then return are_all_idle end
  return flag == nil or flag
end

-- Has each region come to a final leaf in its root that is done? Then the state is done
-- if a transition waits for that.
local function is_joined(state)
  local regions = state._regions
  for i = 1, #regions do
    local leaf = regions[i]._actchild
    if not leaf or leaf._mode ~= "done" or leaf.final ~= true then return false end
  end
  return regions[1] ~= nil and rfsm.names_done(state)
end

-- Advances all regions, and ends the doo when they are joined. Returns what the doo
-- yields.
local function advance_all(fsm, state)
  local regions, are_all_idle = state._regions, true
  forward(fsm, regions)
  for i = 1, #regions do are_all_idle = advance(fsm, state, i) and are_all_idle end
  if not is_joined(state) then return idle_flag(state, are_all_idle) end
  rfsm.end_doo(fsm, state)
  return true
end

-- The doo. It runs only in iterations that take no transition, and the events of such
-- an iteration go to the regions. It never returns, since copies of a machine share its
-- coroutine: `yield` returns the machine that goes on. After an interrupt it is begun
-- anew.
local run_regions = rfsm.repeatable(function(fsm, state)
  while true do fsm, state = rfsm.yield(try(fsm, advance_all, fsm, state)) end
end)

-- The entry calls the user's entry, then advances each region as the doo does.
local function enter_all(fsm, state, what, event)
  local regions, ok, failure = state._regions, true, nil
  if regions.entry then ok, failure = pcall(regions.entry, fsm, state, what, event) end
  for i = 1, regions.is_restored and 0 or #regions do advance(fsm, state, i) end
  regions.is_restored = false
  if not ok then error(failure, 0) end
end

local function leave_and_reset(region)
  local ok, failure = pcall(rfsm.exit_state, region, region)
  rfsm.reset(region)
  if not ok then error(failure, 0) end
end

-- The exit leaves and resets the regions, then calls the user's exit.
local function leave_all(fsm, state, what, event)
  local regions = state._regions
  for i = 1, #regions do try(fsm, leave_and_reset, regions[i]) end
  if regions.exit then regions.exit(fsm, state, what, event) end
end

local function is_new(region)
  return region._mode == "inactive" and region._intq[1] == "e_init_fsm"
    and region._intq[2] == nil
end

-- The exit hook leaves regions that the exit of the state has not left, since a tool
-- has replaced it, or an interrupt has cut it short.
local function leave_others(fsm, state)
  for _, region in ipairs(state._regions) do
    if not is_new(region) then try(fsm, leave_and_reset, region) end
  end
end

-- The doo waits while each iteration takes a transition. Regions for which more events
-- than this have come meanwhile do not wait.
local MOST = 64

-- The post step hook forwards the events of the iteration to the regions of the state
-- that is active now, unless its doo has done so or is over.
local function end_iteration(fsm)
  local leaf = fsm._act_leaf
  local regions = leaf and leaf._mode ~= "done" and leaf._regions
  if not regions or regions.turn == fsm._turn then return end
  forward(fsm, regions)
  if regions[1] and #regions[1]._intq > MOST then try(fsm, advance_all, fsm, leaf) end
end

local function reset(fsm)
  for _, state in ipairs(fsm._seqands) do
    local regions = state._regions
    for i = 1, #regions do try(fsm, rfsm.reset, regions[i]) end
  end
end

-- Saves nothing, since the snapshot of a machine contains its regions already.
local function save() return nil end

-- Notes the state whose entry is called again after a restore: that call shall not
-- advance the regions.
local function load(fsm, _, how)
  for _, state in ipairs(fsm._seqands) do
    state._regions.is_restored = how.entries and state == fsm._act_leaf or false
  end
end

-- Prepare: each instance gets its regions ----------------------------------------

-- Fields that tools set on a machine. If a fresh machine takes its place, it gets them.
local HANDED_ON = {
  "dbg", "info", "warn", "err", "getevents", "idle_hook", "pre_step_hook",
  "post_step_hook", "gettime",
}

local PRINTERS = { "info", "warn", "err" }

local is_apart = false -- true while `init_apart` makes a machine for a tool

-- Returns the table from which a region gets those of `PRINTERS` that its model lacks.
local function owner_of_printers(fsm, given)
  if is_apart then return { info = false, warn = false, err = false } end
  return rfsm.is_initialized_root(given) and given or fsm
end

-- The err of a region while it is made: the parent machine tells its problems.
local function untold() end

-- Gives a region, and the regions in it, an err.
local function tell_to(region, err)
  if region.err == untold then region.err = err end
  for _, state in ipairs(region._seqands or {}) do
    for _, inner in ipairs(state._regions) do tell_to(inner, err) end
  end
end

-- Returns a fresh machine for a region; false and its problems if it is not valid. If
-- the model lacks `info`, `warn` or `err`, it gets them only while the machine is made.
local function fresh_region(fsm, given)
  local is_machine, lacking = rfsm.is_initialized_root(given), {}
  local model, owner = rfsm.model_of(given), owner_of_printers(fsm, given)
  for _, name in ipairs(PRINTERS) do
    if rawget(model, name) == nil then
      model[name] = name == "err" and untold or rawget(owner, name)
      lacking[#lacking + 1] = name
    end
  end
  local ok, region, _, problems = pcall(rfsm.init, given)
  for _, name in ipairs(lacking) do model[name] = nil end
  if not ok then error(region, 0) end
  if region then tell_to(region, rawget(owner, "err")) end
  if region and is_machine then
    for _, field in ipairs(HANDED_ON) do region[field] = rawget(given, field) end
  end
  return region, problems
end

-- Returns the machine for a region: the given one if it is a machine without a parent
-- machine, else a fresh one.
local function new_region(fsm, given, name)
  local region, problems = given, nil
  if is_apart or not rfsm.is_initialized_root(given)
    or rfsm.is_initialized_root(rfsm.parent(given)) then
    region, problems = fresh_region(fsm, given)
  end
  if region then rfsm.set_parent(region, fsm, name) end
  if region and fsm._emit then rfsm.set_emit(region, fsm._emit) end -- merged in later
  return region, problems
end

local in_progress = {} -- set of `substates` being made, to find a state in itself

-- Makes the machines for the regions of `state`, and appends their problems. Returns
-- the new `substates`.
local function new_substates(fsm, state, problems)
  local given, substates = state.substates, setmetatable({}, Substates)
  if in_progress[given] then
    problems[#problems + 1] = rfsm.location_of(state) .. ": a sequential AND state "
      .. "cannot contain itself"
    return substates
  end
  in_progress[given] = true
  local ok, failure = pcall(function()
    for _, name in ipairs(rfsm.sorted_keys(given)) do
      local region, found = new_region(fsm, given[name], name)
      substates[name] = region
      for _, text in ipairs(found or {}) do
        local file, rest = text:match("^(.-:%d+: )(root.*)$")
        problems[#problems + 1] = (file or "") .. state._fqn .. "." .. text_of(name)
          .. ": " .. (rest or text)
      end
    end
  end)
  in_progress[given] = nil
  if not ok then error(failure, 0) end
  return substates
end

-- Returns the list of the regions: those in `order` first, then the others.
local function new_regions(state)
  local names, is_named, regions = {}, {}, {}
  local function add(list)
    for _, name in ipairs(list) do
      if not is_named[name] then names[#names + 1] = name end
      is_named[name] = true
    end
  end
  add(state.order or {})
  add(rfsm.sorted_keys(state.substates))
  for i = 1, #names do regions[i] = state.substates[names[i]] end
  regions.names, regions.is_shown = names, false
  regions.turn, regions.is_restored = false, false
  return regions
end

-- Warns of a transition that waits for e_done if the regions are never joined.
local function warn_of_e_done(fsm, state)
  local can_be_done, name = rfsm.can_be_done(state)
  if can_be_done or not rfsm.names_done(state) then return end
  rfsm.report(fsm, "warn", ("WARNING: %s: 'e_done' never fires here, no leaf right in "
    .. "the region '%s' is final (final = true)"):format(rfsm.location_of(state),
    text_of(name)))
end

local function prepare_state(fsm, state, problems)
  local count = #problems
  if has_transitions[state.substates] then
    rfsm.warn(fsm, "misplaced", rfsm.location_of(state)
      .. ": a transition in a sequential AND state, it belongs into a region (none "
      .. "leads from one region to another)")
  end
  state.substates = new_substates(fsm, state, problems)
  if #problems > count then return end
  local regions = new_regions(state)
  regions.entry, regions.exit = state.entry, state.exit
  state._regions, state.entry, state.exit = regions, enter_all, leave_all
  rfsm.exit_hook_add(fsm, state, rfsm.repeatable(leave_others))
  warn_of_e_done(fsm, state)
  if fsm._seqands then
    fsm._seqands[#fsm._seqands + 1] = state
    return
  end
  fsm._seqands = { state } -- the states with regions
  rfsm.post_step_hook_add(fsm, rfsm.repeatable(end_iteration), "before")
  rfsm.reset_hook_add(fsm, reset)
  rfsm.snapshot_hook_add(fsm, "seqand", save, load)
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  local problems = {}
  for _, state in ipairs(rfsm.elements(merged or fsm, has_regions)) do
    prepare_state(fsm, state, problems)
  end
  return problems
end

-- Public: the module is the constructor -------------------------------------------

local RESERVED = {
  order = true, step = true, run = true, idle_doo = true, ["idle.doo"] = true,
  entry = true, exit = true, andseqdbg = true, seqanddbg = true,
}

local function obstacle(key, value)
  if key == "doo" or key == "substates" then
    return key .. ": is the state's own, and cannot be set"
  elseif rfsm.is_conn(value) or is_state(value) and RESERVED[key] then
    return text_of(key) .. ": cannot be a "
      .. (is_state(value) and "state" or "connector")
  elseif type(key) == "number" and not rfsm.kind_of(value) then
    return "[" .. text_of(key) .. "]: state expected, " .. got(value)
  end
end

-- Returns a state with the given fields; if a field is wrong, nil and the problem.
local function new_state(fields)
  if type(fields) ~= "table" or rawequal(fields, rfsm) or rfsm.kind_of(fields) then
    return nil, "table expected, " .. got(fields)
  end
  local state, regions = {}, setmetatable({}, Substates)
  for _, key in ipairs(rfsm.sorted_keys(fields)) do
    local value = fields[key]
    local text = obstacle(key, value)
    if text then return nil, text end
    if rfsm.is_trans(value) then
      has_transitions[regions] = true
    elseif is_state(value) then
      regions[key] = value
    else
      state[key] = value
    end
  end
  local field, text = check_order(state.order, regions)
  if not field then field, text = check_advance(state) end
  if field then return nil, field .. ": " .. text end
  state.substates, state.doo = regions, run_regions
  return rfsm.state(state)
end

local rfsm_seqand = {}

--- Make a sequential AND state; `rfsm.seqand { ... }` is the same.
--
-- @usage
--    par = rfsm.seqand { left = rfsm.load("arm.lua"), right = rfsm.load("arm.lua") }
--
-- @function new
-- @raise if a field is wrong
---@param fields rfsm_seqand.Fields
---@param more? rfsm_seqand.Fields the fields, if it is called with a colon
---@return rfsm.State state a leaf state, to be mounted any number of times
function rfsm_seqand.new(fields, more)
  if fields == rfsm_seqand then fields = more end -- called as rfsm.seqand:new(fields)
  local state, text = new_state(fields)
  if not state then error("rfsm.seqand: " .. text, 2) end
  rfsm.note_location(state, 2)
  return state
end

--- Make a machine for a tool; its regions are fresh machines.
--
-- Machines that a model gives as regions stay unused, so a tool can check a model
-- before the program makes its machine.
--
---@param model rfsm.State
---@return rfsm.Machine? fsm the results are those of `rfsm.init`
---@return string? text
---@return string[]? problems
function rfsm_seqand.init_apart(model)
  local was_apart = is_apart
  is_apart = true
  local ok, fsm, text, problems = pcall(rfsm.init, model)
  is_apart = was_apart
  if not ok then error(fsm, 0) end
  return fsm, text, problems
end

setmetatable(rfsm_seqand, { __call = rfsm_seqand.new })

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_seqand", rfsm_seqand) end

return rfsm_seqand
