--- Snapshots: save a machine between two steps as a plain table, and restore it.
--
-- A snapshot holds the active leaf of the machine, its queue, the fields that states
-- list in `keep`, the results of their `save` functions, and the data of extensions. It
-- consists of texts, numbers, booleans and tables, which encoders of JSON, MessagePack
-- and other formats accept.
--
-- The file reads in this order: take snapshots, put them back, public functions.
-- `rfsm.snapshot.shape` describes charts, `rfsm.snapshot.migrate` adapts a snapshot of
-- another chart.
--
-- @module rfsm.snapshot
-- @license BSD-3-Clause

local try = require("rfsm.shared.calls").try
local shape = require "rfsm.snapshot.shape"
local match = require "rfsm.shared.match"
local migrate = require "rfsm.snapshot.migrate"
local order = require "rfsm.shared.order"
local opts = require "rfsm.shared.options"
local encoding = require "rfsm.snapshot.encoding"
local exact_json = require "rfsm.shared.exact_json"
local rfsm = require "rfsm"

local each, error, ipairs, pcall = order.each, error, ipairs, pcall
local rawequal, rawget, rawset, type = rawequal, rawget, rawset, type
local concat, sort, min = table.concat, table.sort, math.min
local fail, pack = encoding.fail, encoding.pack
local copy_of, location_of = encoding.copy_of, encoding.location_of
local reason = encoding.reason
local text_of, unpack = rfsm.text_of, encoding.unpack

local snapshot = { VERSION = migrate.VERSION }

--- A machine between two steps. An absent field is empty or false.
---@class rfsm.snapshot.Snapshot
---@field version integer version of the format: 2
---@field chart string fingerprint of the chart: its structure, and the data it keeps
---@field leaf? string FQN of the active leaf; absent: the machine was not entered
---@field done? true the leaf is done
---@field queue? any[] waiting events; absent: none, or `e_init_fsm` if the machine
-- was not entered
---@field unread? integer with `read = "one"`: getevents is asked again after so many
-- events less one
---@field data? table<string, table> the fields that `keep` names, by FQN of the state
---@field saved? table<string, any> what `save` returned, by FQN of the state
---@field targets? any[] three values for each transition whose target was changed: FQN
-- of its composite, its position or name in this composite, FQN of the new target
---@field ext? table<string, any> data of extensions, by their names
---@field regions? table<string, table> a snapshot of each region, by location
---@field structure? string[] a line for each element of the chart

-- Take -------------------------------------------------------------------------

local NONE = {}

local function check_event(event, path)
  if encoding.is_event(event) then return end
  fail("%s: an event that is a %s cannot be saved, only text, number, boolean, or "
    .. "a plain table with a text 'name'", location_of(path, 1), type(event))
end

local function pack_queue(queue, path)
  local list = {}
  path.owner = (path.prefix == "root" and "" or path.prefix .. " ") .. "queue"
  for i = 1, #queue do
    path[1] = i
    check_event(queue[i], path)
    list[i] = pack(queue[i], path, 1)
  end
  return list
end

-- Returns the fields that a state keeps as plain data; nil if all of them are nil.
local function pack_fields(state, keeper, path)
  local names, fields = keeper.sorted, nil
  path.owner, path.keeper = false, keeper
  for i = 1, #names do
    local name = names[i]
    local value = state[name]
    if value == nil and keeper.first[name] ~= nil then value = encoding.NIL end
    path[1] = name
    value = pack(value, path, 1)
    if value ~= nil then
      fields = fields or {}
      fields[name] = value
    end
  end
  if not fields or type(fields.n) ~= "number" then return fields end
  local list = { "%t" } -- dkjson would take the number for the length of a list
  for i = 1, #names do
    local n, value = #list, fields[names[i]]
    if value ~= nil then list[n + 1], list[n + 2] = names[i], value end
  end
  return list
end

local function take_data(fsm, own, snap, path)
  local keepers = own.chart.keepers
  for i = 1, #keepers do
    local keeper = keepers[i]
    local state, fqn = own.states[i], keeper.fqn
    local fields = pack_fields(state, keeper, path)
    if fields then
      snap.data = snap.data or {}
      snap.data[fqn] = fields
    end
    if keeper.has_load then
      path.owner = "save of " .. path.prefix .. fqn:sub(5)
      local value = encoding.try(path.owner, state.save, fsm, state)
      if value ~= nil then
        snap.saved = snap.saved or {}
        snap.saved[fqn] = pack(value, path, 0)
      end
    end
  end
end

local function check_target(own, tr)
  local tgt = tr.tgt
  local node = rfsm.is_node(tgt) and own.nodes[tgt._fqn or false]
  if node and rawequal(node, tgt) then return end
  fail("%s: tgt: state or connector of the machine expected, %s", rfsm.location_of(tr),
    rfsm.got(tgt))
end

-- Appends the target of a transition to a list (nil: none yet) if it was changed.
-- Returns the list.
local function add_target(own, i, list)
  local tr = own.transitions[i]
  if tr.tgt == own.targets[i] then return list end
  check_target(own, tr)
  list = list or {}
  local n = #list
  list[n + 1], list[n + 2], list[n + 3] = tr._parent._fqn, tr._id, tr.tgt._fqn
  return list
end

local function take_targets(own, snap)
  local first, transitions, noted, list = own.targets, own.transitions, own.noted, nil
  if noted then
    if noted[2] then sort(noted) end
    for i = 1, #noted do
      if noted[i] ~= noted[i - 1] then list = add_target(own, noted[i], list) end
    end
  else
    for i = 1, #transitions do
      if transitions[i].tgt ~= first[i] then list = add_target(own, i, list) end
    end
  end
  snap.targets = list
end

-- Raises an error if extensions keep an event that another machine would not know.
local function check_waiting(fsm, path)
  path.owner = path.prefix .. " waiting"
  for i, event in ipairs(rfsm.waiting(fsm)) do
    path[1] = i
    check_event(event, path)
  end
end

local function take_extensions(fsm, snap, path, is_exact)
  local hooks = rfsm.snapshot_hooks(fsm)
  for i = 1, #hooks do
    local hook = hooks[i]
    local value = hook.save(fsm, is_exact)
    if value ~= nil then
      path.owner = path.prefix .. " " .. hook.name
      if type(value) ~= "table" then
        fail("%s: table expected, %s", path.owner, rfsm.got(value))
      end
      snap.ext = snap.ext or {}
      snap.ext[hook.name] = pack(value, path, 0)
    end
  end
  if snap.ext then check_waiting(fsm, path) end
end

-- Adds the queue to a snapshot, except the default queue: an empty one, or `e_init_fsm`
-- alone if the machine was not entered.
local function take_queue(fsm, snap, path)
  local queue = fsm._intq
  local is_default = queue[1] == nil
  if not snap.leaf then is_default = queue[1] == "e_init_fsm" and queue[2] == nil end
  if not is_default then snap.queue = pack_queue(queue, path) end
  if fsm._unread > 1 then snap.unread = fsm._unread end
end

-- Returns the table `path` of a machine, in which `pack` notes where it is in the data.
-- Each machine has one such table, which is reused.
local function path_of(own, prefix)
  local path = own.path
  path.prefix, path.seen, path.is_by_value = prefix, false, false
  return path
end

-- Returns a snapshot of one machine or region, without its regions. An exact one goes
-- on as the machine does; after another one, kept events are looked at again.
local function take_part(fsm, own, prefix, version, is_exact)
  local leaf, path = fsm._act_leaf, path_of(own, prefix)
  local part = { version = version, chart = own.chart.name,
    leaf = leaf and leaf._fqn or nil, done = leaf and leaf._mode == "done" or nil,
    data = nil, ext = nil } -- with the nils, Lua allocates six fields at once
  if not leaf and fsm._mode ~= "inactive" then
    fail("no leaf of the machine is active, but '%s' is", prefix)
  end
  take_data(fsm, own, part, path)
  take_targets(own, part)
  path.seen, path.is_by_value = false, true -- events may stand in several places
  take_extensions(fsm, part, path, is_exact)
  take_queue(fsm, part, path)
  return part
end

local function is_blank(part)
  return not (part.leaf or part.data or part.saved or part.targets or part.ext
    or part.queue)
end

local function take(fsm, is_exact)
  local own = shape.of(fsm)
  local snap = take_part(fsm, own, "root", migrate.VERSION, is_exact)
  local places = own.places
  for i = 2, #places do
    local region = places[i].machine
    local part = take_part(region, shape.of(region), places[i].prefix, nil, is_exact)
    if not is_blank(part) then
      snap.regions = snap.regions or {}
      snap.regions[places[i].prefix] = part
    end
  end
  return snap
end

-- Put: checks everything before anything is changed ---------------------------------

local function find_leaf(fsm, own, fqn)
  if fqn == nil then return false end
  if own.chart.leaves[fqn] then return own.nodes[fqn] end
  fail(shape.find_state(fsm, fqn) and "leaf: '%s' is a composite"
    or "leaf: no state is '%s'", fqn)
end

-- Sets how many events come before getevents is asked again. A migration may have taken
-- events out of the queue.
local function set_unread(fsm, unread) fsm._unread = min(unread, #fsm._intq + 1) end

local function unpack_queue(part)
  if not part.queue then return part.leaf and {} or { "e_init_fsm" } end
  local queue, count = {}, 0
  for _ in each(part.queue) do count = count + 1 end -- any order: they are counted
  for i = 1, count do
    local event = unpack(part.queue[i], 2)
    if not encoding.is_event(event) then
      fail("queue[%d]: event expected, got %s", i, type(event))
    end
    queue[i] = event
  end
  return queue
end

-- Returns a value of the snapshot unpacked: a table, or nil for null. Anything else is
-- an error, which names `field` and `name`.
local function unpack_table(field, name, value)
  local t = unpack(value, 2)
  if t == nil or type(t) == "table" then return t end
  fail("%s: table expected for '%s', got %s", field, text_of(name), type(t))
end

-- Returns a table of unpacked fields for each state, by FQN. A field that the `keep` of
-- its state does not name is an error.
local function unpack_data(own, packed)
  local data, keepers = {}, own.chart.keeper
  for fqn, fields in each(packed) do -- any order: each stands alone
    local keeper = keepers[fqn]
    data[fqn] = unpack_table("data", fqn, fields) or NONE
    for name in each(data[fqn]) do -- any order: each stands alone
      if not (keeper and keeper.kept[name]) then
        fail("data: no state '%s' keeps a field '%s'", text_of(fqn), text_of(name))
      end
    end
  end
  return data
end

local function unpack_saved(fsm, packed)
  local saved = {}
  for fqn, value in each(packed) do -- any order: each stands alone
    local state = shape.find_state(fsm, fqn)
    if not state or type(state.load) ~= "function" then
      fail("saved: no state '%s' has a function 'load'", text_of(fqn))
    end
    saved[fqn] = { value = unpack(value, 2) }
  end
  return saved
end

-- Returns the data of extensions, by their names. A snapshot of another chart may have
-- data of an extension that the machine lacks.
local function unpack_extensions(fsm, packed, is_migrated)
  local values, hooks = {}, rfsm.snapshot_hooks(fsm)
  for name, value in each(packed) do -- any order: each stands alone
    local is_known = is_migrated
    for i = 1, #hooks do is_known = is_known or hooks[i].name == name end
    if not is_known then
      fail("ext: no extension of the machine is named '%s'", text_of(name))
    end
    values[name] = unpack_table("ext", name, value)
  end
  return values
end

-- Returns the new targets of those transitions whose target was changed.
local function unpack_targets(fsm, list)
  local targets = {}
  for i = 1, #list, 3 do
    local tr, node, id = shape.target_at(fsm, list, i)
    if not tr then
      fail("targets: a transition and a node expected, got '%s' in '%s', '%s'",
        text_of(id), text_of(list[i]), text_of(list[i + 2]))
    end
    targets[tr] = node
  end
  return targets
end

local function set_targets(own, targets)
  local first, transitions, noted = own.targets, own.transitions, own.noted
  if noted then
    for i = #noted, 1, -1 do
      own.forget(noted[i])
      noted[i] = nil
    end
  else
    for i = 1, #transitions do
      if transitions[i].tgt ~= first[i] then transitions[i].tgt = first[i] end
    end
  end
  if not targets then return end
  for tr, node in each(targets) do tr.tgt = node end -- any order
end

-- Gives a state its fields. `read` is nil, or `unpack` if they are packed values.
local function set_fields(state, keeper, fields, read)
  local names, first = keeper.sorted, keeper.first
  for i = 1, #names do
    local name = names[i]
    local value = fields[name]
    if read then value = read(value, 3) end
    if value == nil then value = copy_of(first[name]) end
    if rawequal(value, encoding.NIL) then value = nil end
    state[name] = value
  end
end

-- Gives the states of a machine their data in a snapshot. A kept field for which there
-- is no value in the snapshot gets the value that it has in the chart.
local function set_data(part)
  local own, keepers = part.own, part.own.chart.keepers
  for i = 1, #keepers do
    local keeper = keepers[i]
    local state, value = own.states[i], (part.saved or NONE)[keeper.fqn]
    set_fields(state, keeper, part.data[keeper.fqn] or NONE)
    if keeper.has_load and (value or not part.how.has_changed) then
      encoding.try("load of " .. keeper.fqn, state.load, part.fsm, state,
        value and value.value)
    end
  end
end

--- The content of a snapshot for one machine or region, after all checks.
---@class rfsm.snapshot.Part
---@field fsm rfsm.Machine
---@field own rfsm.snapshot.Own
---@field leaf rfsm.State|false
---@field mode string
---@field queue any[]
---@field unread? integer
---@field data table<string, table> values of kept fields, by FQN of the state
---@field values table<string, table> data of extensions, by name
---@field how table argument for the hooks of extensions: what has changed in the chart
---@field is_waiting boolean has the snapshot a queue?
---@field is_own boolean is the snapshot of this chart, under its present name?
---@field saved? table<string, { value: any }> results of `save`, by FQN
---@field targets? table<rfsm.Transition, table>

local function new_part(fsm, snap, how)
  local own = shape.of(fsm)
  local part = { fsm = fsm, own = own, leaf = find_leaf(fsm, own, snap.leaf),
    mode = snap.done == true and "done" or "active", queue = unpack_queue(snap),
    data = snap.data and unpack_data(own, snap.data) or NONE,
    values = snap.ext and unpack_extensions(fsm, snap.ext, how.is_migrated) or NONE,
    how = how, is_waiting = snap.queue ~= nil, unread = snap.unread,
    is_own = snap.chart == nil or snap.chart == own.chart.name }
  if snap.saved then part.saved = unpack_saved(fsm, snap.saved) end
  if snap.targets then part.targets = unpack_targets(fsm, snap.targets) end
  return part
end

local function is_never_new() return false end

-- The argument `how` for hooks of extensions if the chart has not changed.
local UNCHANGED = { entries = false, has_changed = false, is_migrated = false,
  is_new = is_never_new }

-- Checks a snapshot; returns a list of parts: of the machine and of each region. The
-- field `how` of a part shows the hooks of extensions what has changed.
local function new_parts(fsm, snap, options)
  local parts, how = {}, UNCHANGED
  local moved, changes, is_new = migrate.to(fsm, snap, options)
  for i, at in ipairs(shape.of(fsm).places) do
    local prefix = at.prefix
    if changes or options.entries then
      local change = changes and changes[prefix]
      how = { entries = options.entries, has_changed = change ~= nil,
        is_migrated = change == "structure", is_new = is_new and function(event)
          return is_new(prefix, event)
        end or is_never_new }
    end
    parts[i] = new_part(at.machine, migrate.part_of(moved, prefix), how)
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

-- Loads the data of one machine. `load` functions of charts and extensions may fail.
local function load_part(part)
  set_data(part)
  local hooks = rfsm.snapshot_hooks(part.fsm)
  for i = 1, #hooks do
    hooks[i].load(part.fsm, part.values[hooks[i].name], part.how)
  end
end

-- Reports each event that waits in a machine of another chart, or is kept there by an
-- extension, and that nothing takes any more.
local function report_unwanted(fsm, part)
  for _, event in ipairs(match.joined(part.queue, rfsm.waiting(part.fsm))) do
    if not match.maker_of(event) and not shape.wants(fsm, event) then
      rfsm.report(fsm, "err", ("rfsm.snapshot: the event '%s' waits, but no "
        .. "transition of the chart takes it"):format(rfsm.event_text(event)))
    end
  end
end

local function set_parts(parts)
  for i, part in ipairs(parts) do
    if i == 1 or part.leaf or part.is_waiting then -- the first one resets the regions
      rfsm.place(part.fsm, part.leaf, part.mode, part.queue)
      if part.unread then set_unread(part.fsm, part.unread) end
    end
    set_targets(part.own, part.targets)
  end
  for _, part in ipairs(parts) do load_part(part) end
end

local function can_fail(part)
  return part.own.chart.has_load or rfsm.snapshot_hooks(part.fsm)[1]
end

-- Is `put_directly` possible? The snapshot must be of this chart, without `saved` and
-- regions, and the chart must have no `load` and no regions.
local function is_usual(own, snap)
  local chart = own.chart
  return chart.leaves[snap.leaf] and snap.chart == chart.name
    and snap.version == migrate.VERSION
    and not (snap.saved or snap.regions or chart.has_load or chart.has_regions)
end

-- Returns the packed values of the fields of a state, as a table.
local function fields_of(packed)
  if not packed or packed[1] ~= "%t" then return packed or NONE end
  local fields = {}
  for i = 2, #packed, 2 do fields[packed[i]] = packed[i + 1] end
  return fields
end

-- Puts the leaf, the queue and the targets of a snapshot into a machine.
local function put_place(fsm, own, snap)
  local targets = snap.targets and unpack_targets(fsm, snap.targets)
  rfsm.place(fsm, own.nodes[snap.leaf], snap.done and "done" or "active",
    snap.queue and unpack_queue(snap) or {})
  if snap.unread then set_unread(fsm, snap.unread) end
  set_targets(own, targets)
end

-- Puts a trusted snapshot without the checks and tables of `put`, if `is_usual` accepts
-- it; else changes nothing and returns false. This is for speed: a host may put one
-- snapshot after another into a machine.
local function put_directly(fsm, snap)
  local own, data, ext = shape.of(fsm), snap.data or NONE, snap.ext or NONE
  if not is_usual(own, snap) then return false end
  local keepers, hooks = own.chart.keepers, rfsm.snapshot_hooks(fsm)
  put_place(fsm, own, snap)
  for i = 1, #keepers do
    set_fields(own.states[i], keepers[i], fields_of(data[keepers[i].fqn]), unpack)
  end
  for i = 1, #hooks do
    local hook, data_of = hooks[i], ext[hooks[i].name]
    hook.load(fsm, data_of and unpack_table("ext", hook.name, data_of), UNCHANGED)
  end
  return true
end

-- Puts a snapshot into a machine. If a `load` fails, the former configuration is put
-- back; if it cannot be saved, or with `may_reset`, the machine is reset instead.
local function put(fsm, snap, options, may_reset)
  local parts, has_before, before = new_parts(fsm, snap, options), false, nil
  if not (may_reset or options.trusted) and order.any(parts, can_fail) then
    has_before, before = pcall(take, fsm)
  end
  local ok, failure = pcall(set_parts, parts)
  if not ok then
    rfsm.reset(fsm)
    if has_before then pcall(set_parts, new_parts(fsm, before, NONE)) end
    error(failure, 0)
  end
  for _, part in ipairs(parts) do
    if not part.is_own then report_unwanted(fsm, part) end
  end
  for _, part in ipairs(options.entries and parts or NONE) do
    if part.leaf then rfsm.map_from_to(part.fsm, run_entry, part.fsm, part.leaf) end
  end
end

local is_boolean, is_table = opts.is_a "boolean", opts.is_a "table"

local function is_renaming(x)
  if not is_table(x) then return false end
  for old, new in each(x) do -- any order: all are checked
    if type(old) ~= "string" or type(new) ~= "string" then return false end
  end
  return true
end

local OPTIONS = {
  entries = { "boolean", is_boolean },
  migrate = { "function", rfsm.is_callable },
  old = { "model or list of lines", is_table },
  rename = { "table of old and new FQN", is_renaming },
  trusted = { "boolean", is_boolean },
}

local OPTIONS_OF_TAKE = { structure = { "boolean", is_boolean } }

-- Returns the options of a public function, unchecked if the snapshot is trusted. A
-- number counts as no options: in put(fsm, decode(text)), a decoder may return it, too.
local function read_options(options, where, known)
  if type(options) == "table" and options.trusted then return options end
  if options == nil or type(options) == "number" then return NONE end
  local settings, problem = opts.read(known or OPTIONS, options)
  if not settings then error(where .. ": " .. problem, 3) end
  return options
end

-- Public functions ------------------------------------------------------------

--- Return a machine as a plain table.
--
-- @usage
--    local text = snapshot.encode(snapshot.take(fsm))
--
-- @raise if a step is under way, or something cannot be saved
---@param fsm rfsm.Machine
---@param options? { structure: boolean? } true: add the field `structure`, with which
--- `restore` can list the differences from another chart
---@return rfsm.snapshot.Snapshot snap
---@nodiscard
function snapshot.take(fsm, options)
  rfsm.check_between_steps(fsm, "rfsm.snapshot.take")
  local settings = options ~= nil
    and read_options(options, "rfsm.snapshot.take", OPTIONS_OF_TAKE) or NONE
  local ok, snap = try(take, fsm)
  if not ok then error("rfsm.snapshot.take: " .. reason(snap), 2) end
  if settings.structure then snap.structure = shape.lines_of(fsm) end
  return snap
end

--- Return a machine as a plain table, which goes on as the machine does; nil and the
-- reason if it cannot be saved.
-- Observers may call this at the beginning of an iteration, too; then the events of the
-- iteration are not in the queue.
-- @raise if a debug hook raises an error
---@param fsm rfsm.Machine
---@return rfsm.snapshot.Snapshot?
---@return string? problem
function snapshot.try_take(fsm) return encoding.attempt(take, fsm, true) end

--- Return a snapshot as JSON. The text is the same on every Lua.
---@param snap rfsm.snapshot.Snapshot
---@return string text for any decoder of JSON
---@nodiscard
function snapshot.encode(snap) return exact_json.encode(snap) end

--- The options of `put` and `restore`.
---@class rfsm.snapshot.Options
---@field entries? boolean run the entries of the active states, the outermost first
---@field rename? table<string, string> new FQNs of moved states, by their old FQNs
---@field migrate? fun(snap: table, list: string[]): table|false? adapts a snapshot of
-- another chart or returns a new one; false refuses it. `list` has the differences
---@field old? rfsm.State|string[] the chart of the snapshot, or its structure
---@field trusted? boolean the caller promises that the snapshot is as `take` made it.
--- This makes `put` faster. A wrong snapshot may then reset or partly change a machine.

local function try_put(fsm, snap, options, may_reset)
  local ok, failure = true, false
  if options.trusted then
    ok, failure = try(put_directly, fsm, snap)
  end
  if not ok then rfsm.reset(fsm) end
  if ok and not failure then ok, failure = try(put, fsm, snap, options, may_reset) end
  if ok then return true end
  local more = type(failure) == "table" and failure or NONE
  return false, "rfsm.snapshot: " .. reason(failure), more.difference, more.what
end

--- Move a machine to a snapshot; no callback of the chart runs.
--
-- A wrong snapshot changes nothing. If a `load` fails, the machine gets its former
-- configuration and data back; it is reset if these could not be saved.
--
---@param fsm rfsm.Machine
---@param snap rfsm.snapshot.Snapshot
---@param options? rfsm.snapshot.Options
---@return boolean ok
---@return string? problem
---@return string[]? difference if the snapshot is of another chart
---@return string? what the problem without the difference
function snapshot.put(fsm, snap, options)
  rfsm.check_between_steps(fsm, "rfsm.snapshot.put")
  return try_put(fsm, snap, read_options(options, "rfsm.snapshot.put"), false)
end

--- Make a machine from a snapshot; no callback of the chart runs.
--
-- @usage
--    local fsm = assert(snapshot.restore(rfsm.load("lamp.lua"), json.decode(text)))
--
-- @raise if `model` is no state
---@param model rfsm.State
---@param snap rfsm.snapshot.Snapshot
---@param options? rfsm.snapshot.Options
---@return rfsm.Machine? fsm false if the snapshot or the model is wrong
---@return string? problem
---@return string[]? difference if the snapshot is of another chart
---@return string? what the problem without the difference
---@nodiscard
function snapshot.restore(model, snap, options)
  if not rfsm.is_state(model) then
    error("rfsm.snapshot.restore: state expected, got " .. type(model), 2)
  end
  options = read_options(options, "rfsm.snapshot.restore")
  local fsm, _, problems = rfsm.init(model)
  if not fsm then
    return false, "rfsm.snapshot: the model is wrong:\n  " .. concat(problems, "\n  ")
  end
  local ok, problem, list, what = try_put(fsm, snap, options, true)
  if ok then return fsm end
  return false, problem, list, what
end

local function in_files() return opts.need("rfsm.snapshot", "rfsm.snapshot.file") end

--- Save a machine in a file, which then has a check sum. It is written beside the old
-- one, and replaces it.
-- @raise as `take`
---@param fsm rfsm.Machine
---@param file string
---@return boolean ok
---@return string? problem the file cannot be written; it is as it was
function snapshot.save(fsm, file)
  rfsm.check_between_steps(fsm, "rfsm.snapshot.save")
  opts.check_file("rfsm.snapshot.save", file)
  local ok, snap = try(take, fsm)
  if not ok then error("rfsm.snapshot.save: " .. reason(snap), 2) end
  local is_written, problem = in_files().write(file, snap)
  return is_written, problem and "rfsm.snapshot: " .. problem
end

--- Make a machine from a file of `save`, or of `encode`. Needs the package dkjson.
-- @raise if `model` is no state
---@param model rfsm.State
---@param file string
---@param options? rfsm.snapshot.Options
---@return rfsm.Machine? fsm false if the file is damaged, or as for `restore`
---@return string? problem
---@return string[]? difference if the snapshot is of another chart
---@nodiscard
function snapshot.load(model, file, options)
  if not rfsm.is_state(model) then
    error("rfsm.snapshot.load: state expected, got " .. type(model), 2)
  end
  opts.check_file("rfsm.snapshot.load", file)
  local snap, problem = in_files().read(file)
  if not snap then return false, "rfsm.snapshot: " .. problem end
  snap.fleet = nil -- of which machine in a fleet it is
  local fsm, reason_of, list = snapshot.restore(model, snap, options)
  if fsm then return fsm end
  return false, reason_of:gsub("^rfsm.snapshot: ", "%0" .. file:gsub("%%", "%%%%")
    .. ": ", 1) .. "", list
end

--- Return, even during a step, the part of a snapshot that callbacks may change.
-- @raise if something cannot be saved
---@param fsm rfsm.Machine
---@return { data: table?, saved: table?, targets: any[]? } kept
---@nodiscard
function snapshot.take_data(fsm)
  local kept, own = {}, shape.of(fsm)
  take_data(fsm, own, kept, path_of(own, "root"))
  take_targets(own, kept)
  return kept
end

--- Give a machine the data that `take_data` has returned.
-- @raise if the data is of another chart
---@param fsm rfsm.Machine
---@param kept { data: table?, saved: table?, targets: any[]? }
function snapshot.put_data(fsm, kept)
  local part = new_part(fsm, kept, UNCHANGED)
  set_targets(part.own, part.targets)
  set_data(part)
end

--- Return the structure of a chart as lines, for the option `old` of `restore`.
---@param chart rfsm.State|string[] a model, a machine, or its structure
---@return string[] lines
---@nodiscard
function snapshot.structure(chart)
  return shape.structure(chart)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_snapshot", snapshot) end

return snapshot
