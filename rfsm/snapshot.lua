--- Snapshots: a machine between two steps as a plain table, and back.
--
-- A snapshot holds where the machine stands, its queue, the data that the chart names
-- (`keep`, or `save` and `load`, in a state), and what extensions keep. It consists of
-- texts, numbers, booleans and tables that any encoder takes: JSON, MessagePack.
--
-- The file reads in this order: the chart, take, another chart, put, public
-- functions.
--
-- @module rfsm.snapshot
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local plain = require "rfsm.snapshot.plain"

local error, ipairs, next, pairs, pcall = error, ipairs, next, pairs, pcall
local rawget, rawset, setmetatable, type = rawget, rawset, setmetatable, type
local floor = math.floor
local concat = table.concat
local fail, is_scalar, pack = plain.fail, plain.is_scalar, plain.pack
local place_of, reason, unpack = plain.place_of, plain.reason, plain.unpack
local text_of = rfsm.text_of

local jit = rawget(_G, "jit")
if jit then jit.off(true, true) end -- see rfsm/snapshot/plain.lua

local snapshot = { VERSION = 1 }

--- A machine between two steps. What is absent is empty.
---@class rfsm.snapshot.Snapshot
---@field version integer of the format, 1
---@field chart string fingerprint of the structure of the chart
---@field leaf? string FQN of the active leaf; absent: the machine was not entered
---@field done? true the leaf is done
---@field queue? any[] events that wait; absent: none, `e_init_fsm` if there is no leaf
---@field data? table<string, table> what `keep` names, by FQN of the state
---@field saved? table<string, any> what `save` returned, by FQN of the state
---@field targets? any[] targets that were changed: FQN of the composite in which the
-- transition stands, its position or name there, FQN of the target, and so on
---@field ext? table<string, any> what extensions keep, by their names
---@field structure? string[] a line for each element of the chart

-- The chart: its structure as lines, and the states that keep something ----------

--- What is known of the structure that machines share.
---@class rfsm.snapshot.Chart
---@field lines string[] a line for each element, in the order of `rfsm.elements`
---@field fingerprint string
---@field keepers string[] FQN of the states that keep something
---@field kept table<string, table<string, true>> the fields that each keeps
---@field has_load boolean one of them has a function that may fail
---@field index table<string, integer> numbers of the nodes, by FQN
---@field targets integer[] the number of the target of each transition

local function event_text(event)
  return is_scalar(event) and text_of(event) or "a " .. type(event)
end

-- Returns the definition of an element, not the target that a program may have set.
local function line_of(obj)
  if rfsm.is_conn(obj) then return "connector " .. obj._fqn end
  if rfsm.is_state(obj) then return "state " .. obj._fqn end
  local texts = {}
  for i, event in ipairs(obj.events) do texts[i] = event_text(event) end
  return ("%s -> %s%s%s"):format(obj.src._fqn,
    obj._is_internal and "internal" or obj["_%def"].tgt.fqn,
    texts[1] and " on " .. concat(texts, ", ") or "",
    obj.pn and " pn " .. text_of(obj.pn) or "")
end

-- Digests lines in numbers below 2^44, which doubles can multiply.
local function fingerprint_of(lines)
  local hash = 7
  for _, line in ipairs(lines) do
    for i = 1, #line do hash = (hash * 257 + line:byte(i)) % 17592186044399 end
    hash = (hash * 257 + 10) % 17592186044399
  end
  return ("%05x%06x"):format(floor(hash / 16777216), hash % 16777216)
end

local RESERVED = {
  entry = true, exit = true, doo = true, keep = true, save = true, load = true,
  getevents = true, dbg = true, info = true, warn = true, err = true, idle_hook = true,
  pre_step_hook = true, post_step_hook = true,
}

-- Returns the set of names in the `keep` of a state.
local function kept_names(state)
  local names, kept = state.keep or {}, {}
  if type(names) ~= "table" then
    fail("%s: list of names expected, got %s", rfsm.location_of(state, "keep"),
      type(names))
  end
  for i, name in ipairs(names) do
    if type(name) ~= "string" or rfsm.is_meta(name) or RESERVED[name]
      or rfsm.is_fsmobj(state[name]) then
      fail("%s: name of a field with data expected, got %s",
        rfsm.location_of(state, "keep[" .. i .. "]"),
        type(name) == "string" and "'" .. name .. "'" or type(name))
    end
    kept[name] = true
  end
  return kept
end

-- Does a state keep something: by `keep`, if that is no substate, or functions?
local function is_keeper(state)
  local saves, loads = type(state.save) == "function", type(state.load) == "function"
  if saves ~= loads then
    fail("%s: 'save' and 'load' expected, got only one of them",
      rfsm.location_of(state))
  end
  return saves or state.keep ~= nil and not rfsm.is_node(state.keep)
end

-- What is known of plans, as long as they are in use; structures by fingerprint, as
-- long as a plan is.
local charts = setmetatable({}, { __mode = "k" })
local structures = setmetatable({}, { __mode = "v" })

local function chart_of(fsm)
  local chart = charts[fsm._plan]
  if chart then return chart end
  chart = { lines = {}, fingerprint = false, keepers = {}, kept = {}, has_load = false,
    index = {}, targets = {} }
  for i, def in ipairs(fsm._plan.nodes) do chart.index[def.fqn] = i end
  for i, def in ipairs(fsm._plan.transitions) do chart.targets[i] = def.tgt.index end
  for i, obj in ipairs(rfsm.elements(fsm)) do
    chart.lines[i] = line_of(obj)
    if rfsm.is_state(obj) and is_keeper(obj) then
      chart.keepers[#chart.keepers + 1] = obj._fqn
      chart.kept[obj._fqn] = kept_names(obj)
      chart.has_load = chart.has_load or type(obj.load) == "function"
    end
  end
  chart.fingerprint = fingerprint_of(chart.lines)
  charts[fsm._plan], structures[chart.fingerprint] = chart, chart.lines
  return chart
end

-- Returns the node that an FQN names; nil if there is none.
local function find_node(fsm, fqn)
  local index = chart_of(fsm).index[fqn]
  return index and fsm._nodes[index]
end

local function find_state(fsm, fqn)
  local node = find_node(fsm, fqn)
  return node and node._mode and node or nil
end

-- Take -------------------------------------------------------------------------

local function pack_queue(queue, path)
  local list = {}
  path.owner = "queue"
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

-- Returns the fields of a state that its `keep` names; nil if they are all nil.
local function pack_fields(state, path)
  local fields = nil
  path.owner = state._fqn
  for _, name in ipairs(state.keep or {}) do
    if state[name] ~= nil then
      fields = fields or {}
      fields[name] = state[name]
    end
  end
  return fields and pack(fields, path, 0)
end

-- Notes the data of the states that keep some.
local function take_data(fsm, snap, path)
  local data, saved = {}, {}
  for _, fqn in ipairs(chart_of(fsm).keepers) do
    local state = find_state(fsm, fqn)
    data[fqn] = pack_fields(state, path)
    if type(state.save) == "function" then
      local value = plain.try("save of " .. fqn, state.save, fsm, state)
      path.owner = "save of " .. fqn
      if value ~= nil then saved[fqn] = pack(value, path, 0) end
    end
  end
  if next(data) ~= nil then snap.data = data end
  if next(saved) ~= nil then snap.saved = saved end
end

-- Notes the targets that programs have set.
local function take_targets(fsm, snap)
  local first, nodes, transitions = chart_of(fsm).targets, fsm._nodes, fsm._transitions
  local list = nil
  for i = 1, #transitions do
    local tr = transitions[i]
    if tr.tgt ~= nodes[first[i]] then
      list = list or {}
      local n = #list
      list[n + 1], list[n + 2], list[n + 3] = tr._parent._fqn, tr._id, tr.tgt._fqn
    end
  end
  snap.targets = list
end

local take

local function take_extensions(fsm, snap, path)
  local hooks = fsm._snapshot_hooks
  local how = hooks and { take = function(region)
    local inner = take(region, path.base + 5)
    if inner then path.packed[inner] = true end
    return inner
  end }
  for _, hook in ipairs(hooks or {}) do
    local value = hook.save(fsm, how)
    path.owner = hook.name
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

-- Returns the snapshot of a machine inside `base` tables; nil for one inside of another
-- that is as after init.
function take(fsm, base)
  local leaf, chart = fsm._act_leaf, chart_of(fsm)
  local path = { owner = "", base = base, seen = {}, packed = {} }
  local snap = { version = snapshot.VERSION, chart = chart.fingerprint }
  if leaf then
    snap.leaf, snap.done = leaf._fqn, leaf._mode == "done" or nil
  elseif fsm._mode ~= "inactive" then
    fail("no leaf of the machine is active, but 'root' is")
  end
  take_data(fsm, snap, path)
  take_targets(fsm, snap)
  take_extensions(fsm, snap, path)
  take_queue(fsm, snap, path)
  local is_blank = not (leaf or snap.data or snap.saved or snap.targets or snap.ext
    or snap.queue)
  return not (base > 1 and is_blank) and snap or nil
end

-- Another chart: what differs, and how a snapshot moves ----------------------------

-- Lists what differs between the structures of two charts.
local function difference(old, new)
  local counts, list = {}, {}
  for _, line in ipairs(old) do counts[line] = (counts[line] or 0) + 1 end
  for _, line in ipairs(new) do
    counts[line] = (counts[line] or 0) - 1
    if counts[line] < 0 then list[#list + 1] = "new: " .. line end
  end
  for _, line in ipairs(old) do
    if counts[line] > 0 then
      list[#list + 1] = "gone: " .. line
      counts[line] = counts[line] - 1
    end
  end
  if not list[1] then list[1] = "the order of the transitions" end
  return list
end

-- Lists what a snapshot names and the chart lacks.
local function missing(fsm, snap)
  local names, list = { [snap.leaf or "root"] = true }, {}
  for i, name in ipairs(snap.targets or {}) do
    if i % 3 ~= 2 and type(name) == "string" then names[name] = true end
  end
  for _, field in ipairs { "data", "saved" } do
    for fqn in pairs(snap[field] or {}) do names[fqn] = true end -- any order: a set
  end
  for _, name in ipairs(rfsm.sorted_keys(names)) do
    if type(name) == "string" and not find_node(fsm, name) then
      list[#list + 1] = "gone: state " .. name
    end
  end
  list[#list + 1] = "the snapshot holds no structure: that is all that is known"
  return list
end

-- Returns the new name for the FQN of a state that has moved, or of one in it; also in
-- an event such as e_done@root.a.
local function renamed_text(text, rename)
  local event, fqn = text:match("^(.*@)(root.*)$")
  local head, tail = fqn or text, ""
  while head do
    if rename[head] then return (event or "") .. rename[head] .. tail end
    local above, name = head:match("^(.*)(%.[^.]*)$")
    head, tail = above, (name or "") .. tail
  end
  return text
end

-- Returns a copy in which texts are changed, so many tables deep: keys and values.
local function renamed(value, rename, depth)
  if depth == 0 then return value end
  if type(value) == "string" then return renamed_text(value, rename) end
  if type(value) ~= "table" then return value end
  local copy = {}
  for key, inner in pairs(value) do -- any order: each stands alone
    copy[renamed(key, rename, 1)] = renamed(inner, rename, depth - 1)
  end
  return copy
end

-- How deep names of states stand in the fields of a snapshot.
local NAMED = { leaf = 1, queue = 2, targets = 2, ext = 20, data = 1, saved = 1 }

local function rename_states(snap, rename)
  local copy = {}
  for field, value in pairs(snap) do -- any order: each stands alone
    copy[field] = renamed(value, rename, NAMED[field] or 0)
  end
  return copy
end

local check_shape

-- Returns the snapshot for a machine of another chart; raises the list of what differs
-- if there is no way to it.
local function move(fsm, chart, snap, options)
  local old = options.old and snapshot.structure(options.old) or snap.structure
    or structures[snap.chart]
  local list = old and difference(old, chart.lines) or missing(fsm, snap)
  local function refuse(text)
    error({ text = text .. ":\n  " .. concat(list, "\n  "), difference = list }, 0)
  end
  if not (options.rename or options.migrate) then
    refuse("the snapshot is of another chart")
  end
  if options.rename then snap = rename_states(snap, options.rename) end
  if options.migrate then
    local moved = options.migrate(snap, list)
    if moved == false then refuse("migrate refused the snapshot of another chart") end
    snap = moved or snap
    check_shape(snap)
  end
  return snap
end

-- Put: checks everything before anything is changed ---------------------------------

local FIELDS = {
  version = "number", chart = "string", leaf = "string", done = "boolean",
  queue = "table", data = "table", saved = "table", targets = "table", ext = "table",
  structure = "table",
}

-- Raises what is wrong with the fields of a snapshot.
function check_shape(snap)
  if type(snap) ~= "table" then fail("snapshot expected, got %s", type(snap)) end
  if snap.version ~= snapshot.VERSION then
    fail("snapshot of format %d expected, got %s", snapshot.VERSION,
      snap.version == nil and "none" or "format " .. text_of(snap.version))
  end
  if not snap.chart then fail("chart: string expected, got nil") end
  local wrong = {}
  for field, value in pairs(snap) do -- any order: the least one is named
    if type(value) ~= FIELDS[field] then wrong[field] = true end
  end
  local field = next(wrong) ~= nil and rfsm.sorted_keys(wrong)[1]
  if field and not FIELDS[field] then
    fail("no snapshot has a field '%s'", text_of(field))
  elseif field then
    fail("%s: %s expected, got %s", field, FIELDS[field], type(snap[field]))
  end
end

local function find_leaf(fsm, fqn)
  local leaf = fqn and find_state(fsm, fqn)
  if fqn and not leaf then fail("leaf: no state is '%s'", fqn) end
  if leaf and not rfsm.is_leaf(leaf) then fail("leaf: '%s' is a composite", fqn) end
  return leaf or false
end

local function unpack_queue(snap)
  if not snap.queue then return snap.leaf and {} or { "e_init_fsm" } end
  local queue, count = {}, 0
  for _ in pairs(snap.queue) do count = count + 1 end -- any order: a number
  for i = 1, count do
    local event = unpack(snap.queue[i], 2)
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
local function unpack_data(fsm, snap)
  local data, kept = {}, chart_of(fsm).kept
  for fqn, fields in pairs(snap.data or {}) do -- any order: each stands alone
    data[fqn] = unpack_table("data", fqn, fields)
    for name in pairs(data[fqn]) do -- any order: each stands alone
      if not (kept[fqn] and kept[fqn][name]) then
        fail("data: no state '%s' keeps a field '%s'", text_of(fqn), text_of(name))
      end
    end
  end
  return data
end

local function unpack_saved(fsm, snap)
  local saved = {}
  for fqn, value in pairs(snap.saved or {}) do -- any order: each stands alone
    local state = find_state(fsm, fqn)
    if not state or type(state.load) ~= "function" then
      fail("saved: no state '%s' has a function 'load'", text_of(fqn))
    end
    saved[fqn] = { value = unpack(value, 2) }
  end
  return saved
end

-- Returns what extensions kept, by their names, all of them known to the machine.
local function unpack_extensions(fsm, snap)
  local values, is_known = {}, {}
  for _, hook in ipairs(fsm._snapshot_hooks or {}) do is_known[hook.name] = true end
  for name, value in pairs(snap.ext or {}) do -- any order: each stands alone
    if not is_known[name] then
      fail("ext: no extension of the machine is named '%s'", text_of(name))
    end
    values[name] = unpack_table("ext", name, value)
  end
  return values
end

-- Returns the nodes that are targets, by transition.
local function unpack_targets(fsm, snap)
  local targets, list = {}, snap.targets or {}
  for i = 1, #list, 3 do
    local state, node = find_state(fsm, list[i]), find_node(fsm, list[i + 2])
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
  local first, nodes, transitions = chart_of(fsm).targets, fsm._nodes, fsm._transitions
  for i = 1, #transitions do
    local tr, node = transitions[i], nodes[first[i]]
    if tr.tgt ~= node then tr.tgt = node end
  end
  for tr, node in pairs(targets) do tr.tgt = node end -- any order
end

local function set_data(fsm, data, saved, is_migrated)
  for _, fqn in ipairs(chart_of(fsm).keepers) do
    local state, fields, value = find_state(fsm, fqn), data[fqn] or {}, saved[fqn]
    for _, name in ipairs(state.keep or {}) do
      if fields[name] ~= nil or not is_migrated then state[name] = fields[name] end
    end
    if type(state.load) == "function" and (value or not is_migrated) then
      plain.try("load of " .. fqn, state.load, fsm, state, value and value.value)
    end
  end
end

local function run_entry(fsm, state)
  if not state.entry then return end
  local ok, failure = pcall(state.entry, fsm, state, "entry")
  if not ok then
    rfsm.report(fsm, "err", "ENTRY", "error executing entry of " .. state._fqn .. ": ",
      failure)
  end
end

local put

-- Has a machine stand where the snapshot says. If a load fails it stands again where it
-- stood, unless it `is_new`.
function put(fsm, snap, options, is_new)
  check_shape(snap)
  local chart, how = chart_of(fsm), { entries = options.entries }
  local is_migrated = snap.chart ~= chart.fingerprint
  if is_migrated then snap = move(fsm, chart, snap, options) end
  local leaf, queue = find_leaf(fsm, snap.leaf), unpack_queue(snap)
  local data, saved = unpack_data(fsm, snap), unpack_saved(fsm, snap)
  local targets, values = unpack_targets(fsm, snap), unpack_extensions(fsm, snap)
  function how.put(region, inner)
    put(region, inner or { version = snapshot.VERSION,
      chart = chart_of(region).fingerprint }, options, true)
  end
  local can_fail, before = not is_new and (chart.has_load or fsm._snapshot_hooks), nil
  if can_fail then can_fail, before = pcall(take, fsm, 1) end
  rfsm.place(fsm, leaf, snap.done and "done" or "active", queue)
  set_targets(fsm, targets)
  local ok, failure = pcall(function()
    set_data(fsm, data, saved, is_migrated)
    for _, hook in ipairs(fsm._snapshot_hooks or {}) do
      hook.load(fsm, values[hook.name], how)
    end
  end)
  if not ok then
    rfsm.reset(fsm)
    if can_fail then pcall(put, fsm, before, {}, true) end
    error(failure, 0)
  end
  if options.entries and leaf then rfsm.map_from_to(fsm, run_entry, fsm, leaf) end
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
  local ok, snap = plain.pcall(take, fsm, 1)
  if not ok then error("rfsm.snapshot.take: " .. reason(snap), 2) end
  if options and options.structure then snap.structure = chart_of(fsm).lines end
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
  local ok, failure = plain.pcall(put, fsm, snap, options, is_new)
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

--- List a machine and those in its states: those that its snapshot holds.
---@param fsm rfsm.Machine
---@return rfsm.Machine[] machines
---@nodiscard
function snapshot.machines(fsm)
  local list = { fsm }
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    for _, region in ipairs(state._regions or {}) do
      for _, inner in ipairs(snapshot.machines(region)) do list[#list + 1] = inner end
    end
  end
  return list
end

--- Return what callbacks may have changed, as a snapshot holds it; also within a step.
-- @raise if something cannot be saved
---@param fsm rfsm.Machine
---@return { data: table?, saved: table?, targets: any[]? } kept
---@nodiscard
function snapshot.take_data(fsm)
  local kept = {}
  take_data(fsm, kept, { owner = "", base = 1, seen = {}, packed = {} })
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
  if not rfsm.is_state(chart) then return chart end
  local init = rfsm.seqand and rfsm.seqand.init_apart or rfsm.init
  local fsm = rfsm.is_initialized_root(chart) and chart or init(chart)
  return fsm and chart_of(fsm).lines or {}
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_snapshot", snapshot) end

return snapshot
