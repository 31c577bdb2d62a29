--- Snapshots: a machine between two steps as a plain table, and back.
--
-- A snapshot holds where the machine stands, its queue, the data that the chart names
-- (`keep`, or `save` and `load`, in a state), and what extensions keep. It consists of
-- texts, numbers, booleans and tables that any encoder takes: JSON, MessagePack.
--
-- The file reads in this order: take, put, public functions. `rfsm.snapshot.chart` has
-- what is known of a chart, `rfsm.snapshot.move` the way from another one.
--
-- @module rfsm.snapshot
-- @license BSD-3-Clause

local try = require("rfsm.shared.calls").try
local charts = require "rfsm.snapshot.chart"
local move = require "rfsm.snapshot.move"
local plain = require "rfsm.snapshot.plain"
local rfsm = require "rfsm"

local error, ipairs, next, pairs, pcall = error, ipairs, next, pairs, pcall
local rawequal, rawget, rawset, type = rawequal, rawget, rawset, type
local concat = table.concat
local fail, is_scalar, pack = plain.fail, plain.is_scalar, plain.pack
local copy_of, place_of, reason = plain.copy_of, plain.place_of, plain.reason
local text_of, unpack = rfsm.text_of, plain.unpack

local jit = rawget(_G, "jit")
if jit then jit.off(true, true) end -- see rfsm/snapshot/plain.lua

local snapshot = { VERSION = move.VERSION }

--- A machine between two steps. What is absent is empty.
---@class rfsm.snapshot.Snapshot
---@field version integer of the format, 2
---@field chart string fingerprint of the structure of the chart, and of what it keeps
---@field leaf? string FQN of the active leaf; absent: the machine was not entered
---@field done? true the leaf is done
---@field queue? any[] events that wait; absent: none, `e_init_fsm` if there is no leaf
---@field data? table<string, table> what `keep` names, by FQN of the state
---@field saved? table<string, any> what `save` returned, by FQN of the state
---@field targets? any[] targets that were changed: FQN of the composite in which the
-- transition stands, its position or name there, FQN of the target, and so on
---@field ext? table<string, any> what extensions keep, by their names
---@field regions? table<string, table> likewise of the machines in states, by location
---@field structure? string[] a line for each element of the chart

-- Take -------------------------------------------------------------------------

local NONE = {}

local function pack_queue(queue, path)
  local list = {}
  path.owner = (path.prefix == "root" and "" or path.prefix .. " ") .. "queue"
  for i = 1, #queue do
    path[1] = i
    if not is_scalar(queue[i]) then
      fail("%s: an event that is a %s cannot be saved, only text, number or boolean",
        place_of(path, 1), type(queue[i]))
    end
    list[i] = pack(queue[i], path, 1)
  end
  return list
end

-- Returns the fields that a state keeps; nil if they are all nil as at first.
local function pack_fields(state, keeper, path)
  local fields = nil
  for _, name in ipairs(keeper.names) do
    local value = state[name]
    if value == nil and keeper.first[name] ~= nil then value = plain.NIL end
    if value ~= nil then
      fields = fields or {}
      fields[name] = value
    end
  end
  if not fields then return nil end
  path.owner = path.prefix .. keeper.fqn:sub(5)
  fields = pack(fields, path, 0)
  return next(fields) ~= nil and fields or nil -- all of them null
end

-- Notes the data of the states that keep some.
local function take_data(fsm, snap, path)
  local data, saved, nodes = {}, {}, charts.nodes(fsm)
  for _, keeper in ipairs(charts.of(fsm).keepers) do
    local state, fqn = nodes[keeper.index], keeper.fqn
    data[fqn] = pack_fields(state, keeper, path)
    if keeper.has_load then
      path.owner = "save of " .. path.prefix .. fqn:sub(5)
      local value = plain.try(path.owner, state.save, fsm, state)
      if value ~= nil then saved[fqn] = pack(value, path, 0) end
    end
  end
  if next(data) ~= nil then snap.data = data end
  if next(saved) ~= nil then snap.saved = saved end
end

-- Notes the targets that programs have set.
local function take_targets(fsm, snap)
  local first, nodes = charts.of(fsm).targets, charts.nodes(fsm)
  local list = nil
  for i, tr in ipairs(charts.transitions(fsm)) do
    if tr.tgt ~= nodes[first[i]] then
      list = list or {}
      local n = #list
      list[n + 1], list[n + 2], list[n + 3] = tr._parent._fqn, tr._id, tr.tgt._fqn
    end
  end
  snap.targets = list
end

local function take_extensions(fsm, snap, path)
  for _, hook in ipairs(charts.hooks(fsm)) do
    local value = hook.save(fsm)
    path.owner = path.prefix .. " " .. hook.name
    if value ~= nil then
      snap.ext = snap.ext or {}
      snap.ext[hook.name] = pack(value, path, 0)
    end
  end
end

-- The queue, unless it is that of a machine in which nothing has happened.
local function take_queue(fsm, snap, path)
  local queue = fsm._intq
  local is_default = queue[1] == nil
  if not snap.leaf then is_default = queue[1] == "e_init_fsm" and queue[2] == nil end
  if not is_default then snap.queue = pack_queue(queue, path) end
end

-- Returns what a snapshot holds of a machine or region; `base` tables are around data.
local function take_part(fsm, prefix, base)
  local leaf = fsm._act_leaf
  local path = { owner = "", prefix = prefix, base = base, seen = {} }
  local part = { chart = charts.of(fsm).name }
  if leaf then
    part.leaf, part.done = leaf._fqn, leaf._mode == "done" or nil
  elseif fsm._mode ~= "inactive" then
    fail("no leaf of the machine is active, but '%s' is", prefix)
  end
  take_data(fsm, part, path)
  take_targets(fsm, part)
  take_extensions(fsm, part, path)
  take_queue(fsm, part, path)
  return part
end

local function is_blank(part)
  return not (part.leaf or part.data or part.saved or part.targets or part.ext
    or part.queue)
end

-- Around data in Redis stand the value of the key, the snapshot, the data and its
-- state; in a region its snapshot and the table of regions, too.
local BASE, REGION_BASE = 4, 6

local function take(fsm)
  local snap = take_part(fsm, "root", BASE)
  snap.version = move.VERSION
  for _, at in ipairs(charts.regions(fsm) or NONE) do
    local part = take_part(at.machine, at.prefix, REGION_BASE)
    if not is_blank(part) then
      snap.regions = snap.regions or {}
      snap.regions[at.prefix] = part
    end
  end
  return snap
end

-- Put: checks everything before anything is changed ---------------------------------

local function find_state(fsm, fqn) return charts.find_state(fsm, fqn) end

local function find_leaf(fsm, fqn)
  local leaf = fqn and find_state(fsm, fqn)
  if fqn and not leaf then fail("leaf: no state is '%s'", fqn) end
  if leaf and not rfsm.is_leaf(leaf) then fail("leaf: '%s' is a composite", fqn) end
  return leaf or false
end

local function unpack_queue(part)
  if not part.queue then return part.leaf and {} or { "e_init_fsm" } end
  local queue, count = {}, 0
  for _ in pairs(part.queue) do count = count + 1 end -- any order: a number
  for i = 1, count do
    local event = unpack(part.queue[i], 2)
    if not is_scalar(event) or event ~= event then
      fail("queue[%d]: event expected, got %s", i, type(event))
    end
    queue[i] = event
  end
  return queue
end

-- Returns a table of a field of the snapshot.
local function unpack_table(field, name, value)
  local t = unpack(value, 2)
  if type(t) == "table" then return t end
  fail("%s: table expected for '%s', got %s", field, text_of(name), type(t))
end

-- Returns the fields of each state, checked: only what `keep` names may be set.
local function unpack_data(fsm, part)
  local data, keepers = {}, charts.of(fsm).keeper
  for fqn, fields in pairs(part.data or NONE) do -- any order: each stands alone
    data[fqn] = unpack_table("data", fqn, fields)
    for name in pairs(data[fqn]) do -- any order: each stands alone
      if not (keepers[fqn] and keepers[fqn].kept[name]) then
        fail("data: no state '%s' keeps a field '%s'", text_of(fqn), text_of(name))
      end
    end
  end
  return data
end

local function unpack_saved(fsm, part)
  local saved = {}
  for fqn, value in pairs(part.saved or NONE) do -- any order: each stands alone
    local state = find_state(fsm, fqn)
    if not state or type(state.load) ~= "function" then
      fail("saved: no state '%s' has a function 'load'", text_of(fqn))
    end
    saved[fqn] = { value = unpack(value, 2) }
  end
  return saved
end

-- Returns what extensions kept, by their names. What those keep that follow the chart
-- may be without a place there if the snapshot is of another one.
local function unpack_extensions(fsm, part, is_migrated)
  local values, is_known = {}, {}
  for _, hook in ipairs(charts.hooks(fsm)) do is_known[hook.name] = true end
  for name, value in pairs(part.ext or NONE) do -- any order: each stands alone
    if not (is_known[name] or is_migrated) then
      fail("ext: no extension of the machine is named '%s'", text_of(name))
    end
    values[name] = unpack_table("ext", name, value)
  end
  return values
end

-- Returns the nodes that are targets, by transition.
local function unpack_targets(fsm, part)
  local targets, list = {}, part.targets or NONE
  for i = 1, #list, 3 do
    local state, node = find_state(fsm, list[i]), charts.find_node(fsm, list[i + 2])
    local id = unpack(list[i + 1], 2)
    local tr = state and is_scalar(id) and rawget(state, id)
    if not (rfsm.is_trans(tr) and node) then
      fail("targets: a transition and a node expected, got '%s' in '%s', '%s'",
        text_of(id), text_of(list[i]), text_of(list[i + 2]))
    end
    targets[tr] = node
  end
  return targets
end

local function set_targets(fsm, targets)
  local first, nodes = charts.of(fsm).targets, charts.nodes(fsm)
  for i, tr in ipairs(charts.transitions(fsm)) do
    local node = nodes[first[i]]
    if tr.tgt ~= node then tr.tgt = node end
  end
  for tr, node in pairs(targets) do tr.tgt = node end -- any order
end

local function set_fields(state, keeper, fields)
  for _, name in ipairs(keeper.names) do
    local value = fields[name]
    if value == nil then value = copy_of(keeper.first[name]) end
    if rawequal(value, plain.NIL) then value = nil end
    state[name] = value
  end
end

-- Gives states what they kept, and the rest its first values.
local function set_data(fsm, data, saved, is_migrated)
  local nodes = charts.nodes(fsm)
  for _, keeper in ipairs(charts.of(fsm).keepers) do
    local state, value = nodes[keeper.index], saved[keeper.fqn]
    set_fields(state, keeper, data[keeper.fqn] or NONE)
    if keeper.has_load and (value or not is_migrated) then
      plain.try("load of " .. keeper.fqn, state.load, fsm, state, value and value.value)
    end
  end
end

--- What is to be put into a machine or region, all of it checked.
---@class rfsm.snapshot.Part
---@field fsm rfsm.Machine
---@field leaf rfsm.State|false
---@field mode string
---@field queue any[]
---@field data table<string, table> by FQN
---@field saved table<string, table> by FQN
---@field targets table<rfsm.Transition, table>
---@field values table<string, table> of extensions
---@field how table for the hooks of extensions
---@field is_migrated boolean the chart is another one than that of the snapshot

-- Returns the part for a machine. Timers follow the chart if its structure has changed.
local function new_part(fsm, snap, how, change)
  return { fsm = fsm, leaf = find_leaf(fsm, snap.leaf),
    mode = snap.done == true and "done" or "active", queue = unpack_queue(snap),
    data = unpack_data(fsm, snap), saved = unpack_saved(fsm, snap),
    targets = unpack_targets(fsm, snap),
    values = unpack_extensions(fsm, snap, change == "structure"), how = how,
    is_migrated = change ~= nil }
end

-- Returns the parts for a machine and its regions.
local function new_parts(fsm, snap, options)
  local parts, is_known = {}, {}
  local moved, changes, is_new = move.to(fsm, move.check_shape(snap), options)
  move.each_part(fsm, moved, function(machine, inner, prefix, i)
    local change = changes and changes[prefix]
    is_known[prefix] = true
    parts[i] = new_part(machine, inner, { entries = options.entries,
      is_migrated = change == "structure",
      is_new = function(event) return is_new ~= nil and is_new(prefix, event) end },
      change)
  end)
  for prefix in pairs(moved.regions or NONE) do -- any order: each stands alone
    if not is_known[prefix] then fail("no region is '%s'", text_of(prefix)) end
  end
  return parts
end

local function run_entry(fsm, state)
  if not state.entry then return end
  local ok, failure = pcall(state.entry, fsm, state, "entry")
  if not ok then
    rfsm.report(fsm, "err", "ENTRY", "error executing entry of " .. state._fqn .. ": ",
      failure)
  end
end

-- Functions of the chart and of extensions may fail from here on.
local function load_part(part)
  local fsm = part.fsm
  set_data(fsm, part.data, part.saved, part.is_migrated)
  for _, hook in ipairs(charts.hooks(fsm)) do
    hook.load(fsm, part.values[hook.name], part.how)
  end
end

local function set_parts(parts)
  for _, part in ipairs(parts) do
    rfsm.place(part.fsm, part.leaf, part.mode, part.queue)
    set_targets(part.fsm, part.targets)
  end
  for _, part in ipairs(parts) do load_part(part) end
end

-- May loading into a machine or its regions fail?
local function can_fail(parts)
  for _, part in ipairs(parts) do
    if charts.of(part.fsm).has_load or charts.hooks(part.fsm)[1] then return true end
  end
  return false
end

-- Has a machine stand where the snapshot says. If a load fails it stands again where it
-- stood, unless it `is_new`.
local function put(fsm, snap, options, is_new)
  local parts, has_before, before = new_parts(fsm, snap, options), false, nil
  if not is_new and can_fail(parts) then has_before, before = pcall(take, fsm) end
  local ok, failure = pcall(set_parts, parts)
  if not ok then
    rfsm.reset(fsm)
    if has_before then pcall(set_parts, new_parts(fsm, before, NONE)) end
    error(failure, 0)
  end
  for _, part in ipairs(options.entries and parts or NONE) do
    if part.leaf then rfsm.map_from_to(part.fsm, run_entry, part.fsm, part.leaf) end
  end
end

-- Public functions ------------------------------------------------------------

--- Return a machine as a plain table.
--
-- @usage
--    local text = json.encode(snapshot.take(fsm))
--
-- @raise if a step is under way, or something cannot be saved
---@param fsm rfsm.Machine
---@param options? { structure: boolean? } add the lines of the chart, for `restore`
---@return rfsm.snapshot.Snapshot snap
---@nodiscard
function snapshot.take(fsm, options)
  rfsm.check_between_steps(fsm, "rfsm.snapshot.take")
  local ok, snap = try(take, fsm)
  if not ok then error("rfsm.snapshot.take: " .. reason(snap), 2) end
  if options and options.structure then snap.structure = charts.of(fsm).all end
  return snap
end

--- How a snapshot becomes a machine.
---@class rfsm.snapshot.Options
---@field entries? boolean run the entries of the active states, the outermost first
---@field rename? table<string, string> new FQN of states that moved, by the old one
---@field migrate? fun(snap: table, list: string[]): table|false? false refuses
---@field old? rfsm.State|string[] the chart of the snapshot, or its structure

local function try_put(fsm, snap, options, is_new)
  if type(options) ~= "table" then options = {} end -- dkjson.decode returns a position
  local ok, failure = try(put, fsm, snap, options, is_new)
  if ok then return true end
  return false, "rfsm.snapshot: " .. reason(failure),
    type(failure) == "table" and failure.difference or nil
end

--- Have a machine stand where a snapshot says; no callback runs.
--
-- A snapshot that is wrong changes nothing. If a `load` fails after others have run,
-- they get what they had; a machine that could not be saved is reset then.
--
---@param fsm rfsm.Machine
---@param snap rfsm.snapshot.Snapshot
---@param options? rfsm.snapshot.Options
---@return boolean ok
---@return string? problem
---@return string[]? difference if the snapshot is of another chart
function snapshot.put(fsm, snap, options)
  rfsm.check_between_steps(fsm, "rfsm.snapshot.put")
  return try_put(fsm, snap, options, false)
end

--- Make a machine that stands where a snapshot says; no callback has run.
--
-- @usage
--    local fsm = assert(snapshot.restore(rfsm.load("lamp.lua"), json.decode(text)))
--
-- @raise if `model` is no state
---@param model rfsm.State
---@param snap rfsm.snapshot.Snapshot
---@param options? rfsm.snapshot.Options
---@return rfsm.Machine|false fsm false if the snapshot or the model is wrong
---@return string? problem
---@return string[]? difference if the snapshot is of another chart
---@nodiscard
function snapshot.restore(model, snap, options)
  if not rfsm.is_state(model) then
    error("rfsm.snapshot.restore: state expected, got " .. type(model), 2)
  end
  local fsm, _, problems = rfsm.init(model)
  if not fsm then
    return false, "rfsm.snapshot: the model is wrong:\n  " .. concat(problems, "\n  ")
  end
  local ok, problem, list = try_put(fsm, snap, options, true)
  if ok then return fsm end
  return false, problem, list
end

--- Return what callbacks may have changed, as a snapshot holds it; also within a step.
-- @raise if something cannot be saved
---@param fsm rfsm.Machine
---@return { data: table?, saved: table?, targets: any[]? } kept
---@nodiscard
function snapshot.take_data(fsm)
  local kept = {}
  take_data(fsm, kept, { owner = "", prefix = "root", base = BASE, seen = {} })
  take_targets(fsm, kept)
  return kept
end

--- Give that to a machine.
-- @raise if it is none of its chart
---@param fsm rfsm.Machine
---@param kept { data: table?, saved: table?, targets: any[]? }
function snapshot.put_data(fsm, kept)
  set_targets(fsm, unpack_targets(fsm, kept))
  set_data(fsm, unpack_data(fsm, kept), unpack_saved(fsm, kept), false)
end

--- Return the structure of a chart as lines, for `restore` of its snapshots elsewhere.
---@param chart rfsm.State|string[] a model, a machine, or such lines
---@return string[] lines
---@nodiscard
function snapshot.structure(chart)
  return charts.structure(chart)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_snapshot", snapshot) end

return snapshot
