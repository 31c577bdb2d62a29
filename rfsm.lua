--- Statecharts in pure Lua: load, check, compile and run a model.
--
-- A model is a tree of plain tables, marked by `rfsm.state`, `rfsm.trans` and
-- `rfsm.conn`. `rfsm.init` checks it, reports every mistake with its place, and makes
-- an independent machine of it; `rfsm.step` and `rfsm.run` advance the machine, and
-- `rfsm.send_events` feeds it. The caller drives: nothing here waits by itself.
--
-- The file reads in the order the data flows: model elements, load, check, clone,
-- resolve, compile, machine, run, public functions. "F" is a fully qualified name
-- ("root.a.b"), an "iteration" one turn of the loop inside `step`.
--
-- @module rfsm
-- @license BSD-3-Clause

local error, getmetatable, ipairs, loadfile = error, getmetatable, ipairs, loadfile
local pairs, pcall, rawget, rawset = pairs, pcall, rawget, rawset
local require, select, setmetatable, tostring = require, select, setmetatable, tostring
local type = type
local floor, huge, min = math.floor, math.huge, math.min
local find = string.find
local concat, sort = table.concat, table.sort
local create, resume, status = coroutine.create, coroutine.resume, coroutine.status
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")

local rfsm = { _VERSION = "rfsm 1.0.0", yield = coroutine.yield }

-- Model elements: constructors, predicates, order -----------------------------

--- A state as the user writes it.
--
-- Every key not named here is the user's data. Only a leaf state can have a doo, a
-- coroutine; a true value that it yields means that it is idle.
--
---@class rfsm.State
---@field entry? fun(fsm: rfsm.Machine, state: rfsm.State, what: "entry")
---@field exit? fun(fsm: rfsm.Machine, state: rfsm.State, what: "exit")
---@field doo? fun(fsm: rfsm.Machine, state: rfsm.State, what: "doo"): boolean?
local State = {
  -- what one in a plan is until it is entered, searched, given data
  _is_leaf = true, _data = false, _meta = false, _done_event = false,
  _entry_hooks = false, _exit_hooks = false, _sources = false, _by_event = false,
  _by_any = false,
}
State.__index = State

--- An edge from one state or connector to another.
---@class rfsm.Transition
---@field src string|rfsm.State|rfsm.Connector source; a node after init
---@field tgt string|rfsm.State|rfsm.Connector target; a node after init
---@field events? any[]|string any one of them triggers; none: any event does
---@field guard? fun(tr: rfsm.Transition, events: any[]): boolean? false inhibits
---@field effect? fun(fsm: rfsm.Machine, tr: rfsm.Transition, what: string, list: any[])
---@field pn? number priority among the transitions of a node, larger first (0)
local Transition = { _data = false, _meta = false }
Transition.__index = Transition

--- A point where transitions meet; never active.
---@class rfsm.Connector
local Connector = { _data = false, _meta = false, _by_event = false, _by_any = false }
Connector.__index = Connector

--- A model made ready to run by `rfsm.init`; the root state of its own tree.
---@class rfsm.Machine : rfsm.State
---@field getevents fun(): any[]? asked for new events in each iteration
---@field dbg fun(id: string, ...) trace records
---@field info fun(...)
---@field warn fun(...)
---@field err fun(...)
---@field idle_hook? fun(fsm: rfsm.Machine) called instead of returning when idle
---@field pre_step_hook? fun(fsm: rfsm.Machine, events: any[])
---@field post_step_hook? fun(fsm: rfsm.Machine, events: any[])
---@field _act_leaf rfsm.State|false the innermost active state
---@field _intq any[] events that wait for the next iteration
---@field _curq any[] events of the running iteration
local Machine = {}

-- The other elements of a machine; all four are defined in the section Machine.
local LiveState, LiveTransition, LiveConnector = {}, {}, {}

local KIND = {
  [State] = "state", [Machine] = "state", [LiveState] = "state",
  [Transition] = "transition", [LiveTransition] = "transition",
  [Connector] = "connector", [LiveConnector] = "connector",
}

local LIVE = {
  [Machine] = true, [LiveState] = true, [LiveTransition] = true,
  [LiveConnector] = true,
}

local function kind_of(value) return KIND[getmetatable(value)] end

-- Is `value` a machine or part of one?
local function is_live(value) return LIVE[getmetatable(value)] == true end

-- Is it a state of that machine?
local function is_state_of(fsm, value)
  return is_live(value) and KIND[getmetatable(value)] == "state" and value._fsm == fsm
end

-- Gives `class` its constructor, callable as X{...}, X:new{...} and instance:new{...}.
local function define(class, name)
  local function mark(t, level)
    if type(t) ~= "table" then
      error("rfsm." .. name .. ": table expected, got " .. type(t), level + 1)
    end
    return is_live(t) and t or setmetatable(t, class)
  end
  function class.new(_, t) return (mark(t, 2)) end
  function class.type() return KIND[class] end
  return setmetatable(class, { __call = function(_, t) return (mark(t, 2)) end })
end

--- Mark a table as a state.
--
-- `sista`, `csta`, `simple_state` and `composite_state` are the same function.
--
-- @usage
--    local on = rfsm.state { entry = function() lamp(true) end }
--
---@param t table fields, substates by name, transitions at 1, 2, ...
---@return rfsm.State state the same table
---@overload fun(t: table): rfsm.State
rfsm.state = define(State, "state")
rfsm.sista, rfsm.csta = rfsm.state, rfsm.state
rfsm.simple_state, rfsm.composite_state = rfsm.state, rfsm.state

--- Mark a table as a transition; `transition` is the same function.
---@param t table
---@return rfsm.Transition transition the same table
---@overload fun(t: table): rfsm.Transition
rfsm.trans = define(Transition, "trans")
rfsm.transition = rfsm.trans

--- Mark a table as a connector; `connector` is the same function.
---@param t table
---@return rfsm.Connector connector the same table
---@overload fun(t: table): rfsm.Connector
rfsm.conn = define(Connector, "conn")
rfsm.connector = rfsm.conn

--- Is `key` one of the engine's own (a leading underscore)?
---@param key any
---@return boolean
function rfsm.is_meta(key) return type(key) == "string" and key:sub(1, 1) == "_" end

--- Is `value` a state?
---@param value any
---@return boolean
function rfsm.is_state(value) return KIND[getmetatable(value)] == "state" end

--- Is `value` a transition?
---@param value any
---@return boolean
function rfsm.is_trans(value) return KIND[getmetatable(value)] == "transition" end

--- Is `value` a connector?
---@param value any
---@return boolean
function rfsm.is_conn(value) return KIND[getmetatable(value)] == "connector" end

--- Is `value` a state, a transition or a connector?
---@param value any
---@return boolean
function rfsm.is_fsmobj(value) return kind_of(value) ~= nil end

--- Is `value` a state or a connector?
---@param value any
---@return boolean
function rfsm.is_node(value)
  local kind = KIND[getmetatable(value)]
  return kind == "state" or kind == "connector"
end

local is_meta, is_node, is_state = rfsm.is_meta, rfsm.is_node, rfsm.is_state
local is_trans, is_conn = rfsm.is_trans, rfsm.is_conn

-- Where the members of a state are listed: for one of a machine in its definition.
local function members_of(state) return is_live(state) and state._def or state end

-- Any order will do: one node decides.
local function has_nodes(state)
  for key, value in pairs(members_of(state)) do
    if is_node(value) and not is_meta(key) then return true end
  end
  return false
end

--- Is `value` a state with states or connectors in it?
---@param value any
---@return boolean
function rfsm.is_composite(value) return is_state(value) and has_nodes(value) end

--- Is `value` a state without states or connectors in it?
---@param value any
---@return boolean
function rfsm.is_leaf(value) return is_state(value) and not has_nodes(value) end

--- Is `value` the root of a machine?
---@param value any
---@return boolean
function rfsm.is_root(value)
  return getmetatable(value) == Machine
end

--- Is `value` a machine, the result of `rfsm.init`?
---@param value any
---@return boolean
function rfsm.is_initialized_root(value)
  return rfsm.is_root(value) and rawget(value, "_initialized") == true
end

--- Is `value` a state or connector other than the root of a machine?
---@param value any
---@return boolean
function rfsm.is_nr_node(value) return is_node(value) and not rfsm.is_root(value) end

--- Tell the kind of a model element in one or two letters.
---@param value any
---@return "CS"|"LS"|"TR"|"c"|nil letters composite, leaf, transition, connector
function rfsm.fsmobj_tochar(value)
  if is_state(value) then return has_nodes(value) and "CS" or "LS" end
  return is_trans(value) and "TR" or is_conn(value) and "c" or nil
end

-- Returns `value` as text: numbers alike on every Lua, and no error for any value.
local function text_of(value)
  if type(value) == "number" then return ("%.14g"):format(value) end
  local ok, text = pcall(tostring, value)
  return ok and type(text) == "string" and text or type(value)
end

local function list_text(values)
  local texts = {}
  for i = 1, #values do texts[i] = text_of(values[i]) end
  return concat(texts, ", ")
end

local function end_text(node)
  if is_node(node) then return node._fqn or kind_of(node) end
  return text_of(node)
end

-- T={ src='a', tgt='b', pn=3, events='x, y' }, with F after init.
function Transition.__tostring(tr)
  local parts = {
    "src='" .. end_text(tr.src) .. "'", "tgt='" .. end_text(tr.tgt) .. "'",
  }
  local pn, events = tr.pn, tr.events
  if pn ~= nil then parts[#parts + 1] = "pn=" .. text_of(pn) end
  if type(events) == "string" then events = { events } end
  if type(events) == "table" and events[1] ~= nil then
    parts[#parts + 1] = "events='" .. list_text(events) .. "'"
  end
  return "T={ " .. concat(parts, ", ") .. " }"
end

local function reversed(list)
  local n, other = #list, {}
  for i = 1, n do other[i] = list[n + 1 - i] end
  return other
end

-- Numbers before strings, each ascending: array part first, then names sorted.
local function key_before(a, b)
  local a_type, b_type = type(a), type(b)
  if a_type ~= b_type then return a_type == "number" end
  return a < b
end

-- Returns the keys under which `t` holds what `pred` accepts, in `key_before` order.
local function sorted_keys(t, pred)
  local keys, n = {}, 0
  for key, value in pairs(t) do
    local key_type = type(key)
    if (key_type == "number" or key_type == "string") and not is_meta(key)
      and pred(value) then
      n = n + 1
      keys[n] = key
    end
  end
  sort(keys, key_before)
  return keys, n
end

local function copy_list(list)
  local copy = {}
  for i = 1, #list do copy[i] = list[i] end
  return copy
end

local function is_same_list(list, other)
  if not other or #list ~= #other then return false end
  for i = 1, #list do
    if list[i] ~= other[i] then return false end
  end
  return true
end

local function append(list, more)
  for i = 1, #more do list[#list + 1] = more[i] end
end

-- Load ------------------------------------------------------------------------

--- Load a model from a file that returns it.
--
-- @usage
--    local fsm = rfsm.init(rfsm.load("examples/hello_world.lua"))
--
-- @raise when there is no file name, the file cannot be read or fails, or it returns
-- no state
---@param file string
---@return rfsm.State model
---@nodiscard
function rfsm.load(file)
  if type(file) ~= "string" then
    error("rfsm.load: file name expected, got " .. type(file), 2)
  end
  local chunk, problem = loadfile(file)
  if not chunk then error("rfsm.load: " .. problem, 0) end
  local model = chunk(file)
  if not is_state(model) then
    error("rfsm.load: no valid rfsm in file '" .. file .. "' found.", 0)
  end
  return model
end

--- Load a model from a text that returns it.
-- @raise when the text does not compile or fails, or it returns no state
---@param text string Lua source
---@param chunkname? string its name in error messages
---@return rfsm.State model
---@nodiscard
function rfsm.load_str(text, chunkname)
  if type(text) ~= "string" then
    error("rfsm.load_str: string expected, got " .. type(text), 2)
  end
  local chunk, problem = loadstring(text, chunkname)
  if not chunk then error("rfsm.load_str: failed to load chunk: " .. problem, 0) end
  local model = chunk()
  if not is_state(model) then
    local name = chunkname or "string"
    error("rfsm.load_str: no valid rfsm in '" .. name .. "' found.", 0)
  end
  return model
end

-- Check: every mistake in the model, each with its place ----------------------
--
-- A check appends to the `problems` (they fail `init`) or `warnings` of the build and
-- never raises. They come in the order of the walk; `init` sorts them by place.

--- What one `init` or `fsm_merge` works on.
---@class rfsm.Build
---@field root rfsm.State the root of the plan
---@field problems { place: string, text: string }[]
---@field warnings { place: string, text: string }[]
---@field created rfsm.Connector[] `initial` connectors that nobody declared
---@field transitions rfsm.Transition[] those of the plan, the new ones at the end
---@field completions table<rfsm.Transition, true> the new ones with `e_done`
---@field nodes (rfsm.State|rfsm.Connector)[] those of the plan, parents before children
---@field sources table what nodes and transitions were made of, see `is_current`
---@field with_tables table[] the new ones with plain tables of the user
---@field mounts table model node -> its last clone
---@field earlier table clone -> the one before it of the same model node

local function add(list, place, text, ...)
  if select("#", ...) > 0 then text = text:format(...) end
  list[#list + 1] = { place = place, text = text }
end

-- Describes a value that is not what was expected.
local function got(value)
  local kind = kind_of(value) or type(value)
  if kind == "string" then return "got string '" .. value .. "'" end
  if kind == "number" then return "got number " .. text_of(value) end
  return "got " .. kind
end

local function is_callable(value)
  if type(value) == "function" then return true end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") ~= nil
end

local suggestion, misspelt_field

do
  -- How many letters to insert, drop or replace to make `b` of `a`.
  local function edit_distance(a, b)
    local row = {}
    for j = 0, #b do row[j] = j end
    for i = 1, #a do
      local diagonal = row[0]
      row[0] = i
      for j = 1, #b do
        local cost = a:byte(i) == b:byte(j) and diagonal or diagonal + 1
        diagonal = row[j]
        row[j] = min(cost, diagonal + 1, row[j - 1] + 1)
      end
    end
    return row[#b]
  end

  -- What other libraries call the fields.
  local ALIAS = {
    enter = "entry", on_entry = "entry", onentry = "entry", on_enter = "entry",
    on_exit = "exit", onexit = "exit", leave = "exit", ["do"] = "doo", during = "doo",
    activity = "doo", condition = "guard", cond = "guard", action = "effect",
    from = "src", source = "src", to = "tgt", target = "tgt", priority = "pn",
  }

  -- Are the two the same but for their case, one letter too many or too few, or two in
  -- reverse? One in place of another makes too many words of their own: exit, edit.
  local function is_near(a, b)
    a, b = a:lower(), b:lower()
    if #a ~= #b then return edit_distance(a, b) == 1 end
    for i = 1, #a - 1 do
      local first, second = a:sub(i, i), a:sub(i + 1, i + 1)
      if a:sub(1, i - 1) .. second .. first .. a:sub(i + 2) == b then return true end
    end
    return a == b
  end

  -- Returns which of `fields` somebody may have meant who wrote `key`.
  function misspelt_field(key, fields)
    for i = 1, #fields do
      if ALIAS[key] == fields[i] or is_near(key, fields[i]) then return fields[i] end
    end
  end

  -- Returns the nearest of `names`; nil when none is near.
  local function find_nearest(name, names)
    local nearest, least = nil, min(#name, floor(#name / 3) + 2)
    for i = 1, #names do
      local candidate = names[i]
      if type(candidate) == "string" then
        local distance = edit_distance(name:lower(), candidate:lower())
        if distance < least then nearest, least = candidate, distance end
      end
    end
    return nearest
  end

  -- What to say after an unknown name: the nearest right one, or all if they are few.
  -- `initial` is right where it does not exist yet.
  function suggestion(name, names)
    local nearest = find_nearest(name, names) or find_nearest(name, { "initial" })
    if nearest then return " (did you mean '" .. nearest .. "'?)" end
    if #names == 0 or #names > 6 then return "" end
    local verb = #names == 1 and "is" or "are"
    return " (there " .. verb .. " '" .. concat(names, "', '") .. "')"
  end
end

-- The F of a node; of a transition where it stands: F.trans[2], or F.key if it has a
-- name.
local function place_of(owner)
  if is_node(owner) then return owner._fqn end
  local key = owner._id
  if type(key) == "number" then
    return owner._parent._fqn .. ".trans[" .. text_of(key) .. "]"
  end
  return owner._parent._fqn .. "." .. key
end

-- `model` is what `owner` is made of; one of an instance has false for what is absent.
local function check_callable(build, owner, model, field)
  local value = rawget(model, field)
  if value == nil or type(value) == "function" then return end
  if value == false and rawget(model, "_parent") then return end
  if not is_callable(value) and not is_node(value) then
    add(build.problems, place_of(owner) .. "." .. field, "function expected, "
      .. got(value))
  end
end

local RESERVED = { entry = "state", exit = "state", doo = "state" }
local ROOT_FIELDS = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook" }
local PRINTERS = { "dbg", "info", "warn", "err" }
for i = 1, 4 do RESERVED[ROOT_FIELDS[i]], RESERVED[PRINTERS[i]] = "root", "root" end

-- A name like most, about which there is no more to say.
local function is_usual_name(key)
  return type(key) == "string" and find(key, "^[^_.\\][^.\\]*$") ~= nil
    and not RESERVED[key] and key ~= "initial"
end

-- A node needs a name that a reference can spell and that is no field of its parent.
local function check_name(build, parent, key, kind)
  local place = parent._fqn
  if type(key) ~= "string" then
    return add(build.problems, place .. ".trans[" .. text_of(key) .. "]",
      "a %s needs a name (name = ...)", kind)
  end
  if key == "" or key:find("[.\\]") or is_meta(key) then
    add(build.problems, place .. "." .. key,
      "the name of a %s must not be empty, contain '.' or '\\' or start with '_'", kind)
  end
  local owner = RESERVED[key]
  if owner == "state" or owner == "root" and parent == build.root then
    add(build.problems, place .. "." .. key,
      "a %s cannot have this name, it is a field of every %s", kind, owner)
  end
  if key == "initial" and kind ~= "connector" then
    add(build.problems, place .. ".initial", "connector expected, got %s", kind)
  end
end

-- Returns the events of a transition as a list of its own: a list of anything but NaN
-- without holes, or one string.
local function clone_events(build, tr, events)
  if events == nil then return nil end
  if type(events) == "string" then events = { events } end
  if type(events) ~= "table" or getmetatable(events) ~= nil then
    return add(build.problems, place_of(tr) .. ".events",
      "list of events or a string expected, " .. got(events))
  end
  local list, count = { events[1] }, 0
  for _ in pairs(events) do count = count + 1 end -- any order: only counted
  for i = 1, count do
    local event = events[i]
    if event == nil then
      return add(build.problems, place_of(tr) .. ".events",
        "list of events expected, got a table with holes or keys")
    elseif event ~= event then
      add(build.problems, place_of(tr) .. ".events[" .. i .. "]",
        "an event cannot be NaN")
    elseif event == "e_done" then
      build.completions[tr] = true
    end
    list[i] = event
  end
  return list
end

local function check_pn(build, tr, pn)
  if type(pn) ~= "number" or pn ~= pn then
    add(build.problems, place_of(tr) .. ".pn", "number expected, " .. got(pn))
  end
end

local PROGRAM_FIELDS = {
  state = { "entry", "exit", "doo" }, transition = { "guard", "effect" },
}

-- Warns of a field that looks like one of the library's in other words.
local function warn_of_field(build, owner, model, key, value)
  local kind = kind_of(owner)
  local meant = is_callable(value) and PROGRAM_FIELDS[kind]
    and misspelt_field(key, PROGRAM_FIELDS[kind])
  if kind == "transition" and key == "event" then meant = "events" end
  if meant and rawget(model, meant) == nil then
    add(build.warnings, place_of(owner), "a %s has no field '%s' (did you mean '%s'?)",
      kind, key, meant)
  end
end

-- Warns of a plain table that looks like a state or transition somebody forgot to mark.
local function check_plain_table(build, place, t)
  if rawget(t, "src") ~= nil and rawget(t, "tgt") ~= nil then
    add(build.warnings, place, "a plain table with 'src' and 'tgt' is ignored (did you "
      .. "mean rfsm.trans{...}?)")
    return
  end
  for _, value in pairs(t) do -- any order: one element decides
    if is_node(value) or is_trans(value) then
      add(build.warnings, place, "a plain table that contains a %s is ignored (did you "
        .. "mean rfsm.state{...}?)", kind_of(value))
      return
    end
  end
end

local function check_composite(build, composite)
  if rawget(composite, "doo") then
    add(build.problems, composite._fqn .. ".doo", "only a leaf state can have a doo")
  end
end

local function check_root(build, root, model)
  for i = 1, 4 do
    check_callable(build, root, model, ROOT_FIELDS[i])
    local name, printer = PRINTERS[i], model[PRINTERS[i]]
    if printer ~= nil and type(printer) ~= "boolean" and not is_callable(printer) then
      add(build.problems, "root." .. name, "function, true or false expected, "
        .. got(printer))
    end
  end
  if not root._is_leaf and rawget(root, "initial") == nil then
    add(build.problems, "root", "the root needs an initial transition "
      .. "(rfsm.trans{ src='initial', tgt=... })")
  end
end

-- Clone: the definitions of a plan, one for each position of a node ------------
--
-- Functions, events and the user's data are those of the model; a machine gets copies
-- of plain tables when it is made.

local add_node, clone_below, clone_node, clone_transition, model_of

do
  -- Remembers what a node was made of, so that the model can stand for it in src, tgt.
  function add_node(build, model, node)
    local n = #build.nodes + 1
    node._index = n
    build.nodes[n], build.sources.nodes[n] = node, model
    local earlier = build.mounts[model]
    if earlier then build.earlier[node] = earlier end
    build.mounts[model] = node
  end

  -- The model behind `value`: a machine stands for what it was made of, a part of one
  -- for its definition.
  function model_of(value)
    if not is_live(value) then return value end
    return getmetatable(value) == Machine and value._model or value._def
  end

  -- The user's data under `key` goes to each machine; a plain table is copied at once.
  local function add_datum(build, def, key, value)
    local data = def._data
    if data then data[#data + 1] = key else def._data = { key } end
    if is_meta(key) then -- apart from what the engine keeps there
      def._meta = def._meta or {}
      def._meta[key] = value
    else
      def[key] = value
    end
    if type(value) == "table" and getmetatable(value) == nil then
      build.with_tables[#build.with_tables + 1] = def
    end
  end

  -- The fields of the engine, in whatever a machine consists of.
  local ENGINE = {}
  for name in ("_act_leaf _actchild _curq _def _doo_co _fqn _fsm _id _initialized "
    .. "_intq _mode _otrs _parent"):gmatch("%S+") do
    ENGINE[name] = true
  end

  -- Is `key` of `model` a mark of the engine? All are, in a definition.
  local function is_mark(model, key)
    return is_meta(key) and (ENGINE[key] or rawget(model, "_index") ~= nil)
  end

  -- Takes over a field of a transition other than src, tgt and events.
  local function clone_field(build, tr, model, key, value)
    if key == "guard" or key == "effect" then
      tr[key] = value
      check_callable(build, tr, model, key)
    elseif key == "pn" then
      tr.pn = value
      check_pn(build, tr, value)
    elseif not is_mark(model, key) then
      add_datum(build, tr, key, value)
      if type(key) == "string" then warn_of_field(build, tr, model, key, value) end
    end
  end

  function clone_transition(build, model, parent, key)
    model = model_of(model)
    local n, src, tgt, tr = #build.transitions + 1, model.src, model.tgt
    if model.events == nil then
      tr = { _id = key, _parent = parent, _index = n, src = src, tgt = tgt }
    else -- all at once, so that the table need not grow
      tr = {
        _id = key, _parent = parent, _index = n, src = src, tgt = tgt, events = false,
      }
    end
    setmetatable(tr, Transition)
    if type(key) ~= "number" and type(key) ~= "string" then
      tr._id = text_of(key)
      add(build.problems, place_of(tr),
        "the key of a transition is a position or a name")
    elseif is_meta(key) or RESERVED[key] == "state" then
      add(build.problems, place_of(tr), RESERVED[key]
        and "a transition cannot have this name, it is a field of every state"
        or "the name of a transition must not start with '_'")
    end
    tr.events = clone_events(build, tr, model.events)
    local count = 0
    for k, v in pairs(model) do -- any order: each field stands alone
      count = count + 1
      if k ~= "src" and k ~= "tgt" and k ~= "events" then
        clone_field(build, tr, model, k, v)
      end
    end
    build.transitions[n] = tr
    local sources = build.sources
    sources.transitions[n], sources.fields[n] = model, count
    sources.src[n], sources.tgt[n] = src, tgt
    return tr
  end

  -- True when `model` is already open above `parent`: the walk would never end.
  local function is_mounted_above(build, model, parent)
    local mount = build.mounts[model]
    while mount do
      local state = parent
      while state ~= mount and state._parent ~= state do state = state._parent end
      if state == mount then return true end
      mount = build.earlier[mount]
    end
    return false
  end

  -- Makes the bare node; `clone_members` fills in its members when its turn comes.
  function clone_node(build, kind, value, parent, key)
    local model, is_usual = model_of(value), is_usual_name(key)
    local fqn = parent._fqn .. "." .. (is_usual and key or text_of(key))
    if not is_usual then check_name(build, parent, key, kind) end
    if is_mounted_above(build, model, parent) then
      return add(build.problems, fqn, "a state cannot contain itself")
    end
    local node = setmetatable({ _id = key, _fqn = fqn, _parent = parent, _index = 0 },
      kind == "state" and State or Connector)
    add_node(build, model, node)
    return node
  end

  -- Takes over a member that is no element of the model: a program or the user's data.
  local function clone_datum(build, def, model, key, value)
    if is_mark(model, key) then return end
    if RESERVED[key] == "state" and is_state(def) then
      def[key] = value
      check_callable(build, def, model, key)
    else
      add_datum(build, def, key, value)
      if type(key) == "string" then warn_of_field(build, def, model, key, value) end
    end
    if type(value) == "table" and getmetatable(value) == nil then
      check_plain_table(build, def._fqn .. "." .. text_of(key), value)
    end
  end

  local function clone_connector(build, connector, model)
    local from_plan, count = rawget(model, "_fqn") ~= nil, 0
    for key, value in pairs(model) do -- any order: each member stands alone
      local kind = kind_of(value)
      count = count + 1
      if from_plan and is_meta(key) then kind = nil end
      if kind then
        add(build.warnings, connector._fqn, "a connector holds no %s, '%s' is ignored",
          kind, text_of(key))
      else
        clone_datum(build, connector, model, key, value)
      end
    end
    build.sources.members[connector._index] = count
  end

  local function clone_members(build, state, model)
    local from_plan, count = rawget(model, "_fqn") ~= nil, 0
    local has_transition, is_composite = false, false
    for key, value in pairs(model) do -- any order: what depends on it is sorted later
      count = count + 1
      local value_type = type(value)
      local kind = value_type == "table" and KIND[getmetatable(value)]
      if from_plan and is_meta(key) then kind = false end
      if value_type == "function" and RESERVED[key] == "state" then
        state[key] = value
      elseif kind == "transition" then
        local tr = clone_transition(build, value, state, key)
        has_transition = true
        if not is_meta(key) then state[key] = tr end
      elseif kind then
        state[key], is_composite = clone_node(build, kind, value, state, key), true
      else
        clone_datum(build, state, model, key, value)
      end
    end
    build.sources.members[state._index] = count
    if is_composite then
      state._is_leaf = false
      check_composite(build, state)
    elseif has_transition then
      add(build.warnings, state._fqn, "a transition inside a leaf state")
    end
  end

  -- Clones what hangs below the nodes from `first` on; the list grows as it is walked.
  function clone_below(build, first)
    local nodes, models, i = build.nodes, build.sources.nodes, first
    while nodes[i] do
      local clone = KIND[getmetatable(nodes[i])] == "state" and clone_members
        or clone_connector
      clone(build, nodes[i], models[i])
      i = i + 1
    end
  end
end

-- Resolve: names become nodes, `e_done` gets the name of its source -----------

local function root_of(node)
  while node._parent ~= node do node = node._parent end
  return node
end

local resolve_end

do
  -- Splits "a.b" into { "a", "b" }; an empty part stays, and leads nowhere.
  local function split(path)
    local parts = {}
    for part in (path .. "."):gmatch("([^.]*)%.") do parts[#parts + 1] = part end
    return parts
  end

  -- Walks from `node` down the names of `parts`; nil and a reason when one fails.
  local function find_below(node, parts)
    for i = 1, #parts do
      local name = parts[i]
      local child = not is_meta(name) and rawget(node, name) or nil
      if not is_node(child) then
        if child ~= nil then
          local kind = kind_of(child) or type(child)
          return nil, ("'%s.%s' is no state or connector but a %s%s"):format(node._fqn,
            name, kind, kind == "table" and " (did you mean rfsm.state{...}?)" or "")
        end
        return nil, ("no state or connector is named '%s' in '%s'"):format(name,
          node._fqn) .. suggestion(name, (sorted_keys(node, is_node)))
      end
      node = child
    end
    return node
  end

  -- Names without a dot are looked for in one composite only: tells where else there is
  -- such a node.
  local function elsewhere(build, composite, name)
    local names = {}
    for _, node in ipairs(build.nodes) do
      if node._id == name and composite[name] == nil then
        names[#names + 1] = node._fqn
      end
    end
    sort(names)
    return names[1]
  end

  -- A name without a dot: in the composite of the transition, or the root itself.
  local function find_local(build, composite, name)
    local node, reason = find_below(composite, { name })
    if node then return node end
    if name == "root" then return build.root end
    local other = elsewhere(build, composite, name)
    if not other then return nil, reason end
    return nil, ("no state or connector is named '%s' in '%s' (did you mean '%s'?)")
      :format(name, composite._fqn, other)
  end

  -- A path from the root; `root.` in front is optional, and a state may be named so.
  local function find_absolute(root, path)
    local parts = split(path)
    if parts[1] ~= "root" then return find_below(root, parts) end
    local node, reason = find_below(root, split(path:sub(6)))
    if node then return node end
    return (find_below(root, parts)), reason
  end

  -- Returns the node that a name in a transition of `composite` refers to:
  -- (a) ".a.b" or "..a.b" from the composite, (b) "a" in it, (c) others from the root.
  local function find_named(build, composite, name)
    local relative = name:match("^%.%.?([^.].*)$")
    if relative then return find_below(composite, split(relative)) end
    if not name:find(".", 1, true) then return find_local(build, composite, name) end
    return find_absolute(build.root, name)
  end

  -- How many ancestors `node` shares with `composite`.
  local function shared_depth(composite, node)
    local above, depth = {}, 0
    while composite._parent ~= composite do
      above[composite] = true
      composite = composite._parent
    end
    while node._parent ~= node do
      if above[node] then depth = depth + 1 end
      node = node._parent
    end
    return depth
  end

  -- A node table of the model may be mounted more than once: the nearest clone counts.
  local function find_mounted(build, composite, model)
    local def = is_live(model) and model._def -- merged, it may name a live node
    if def and root_of(def) == build.root then return def end
    local mount = build.mounts[model_of(model)]
    if not mount then return nil, "the table given is no part of this model" end
    local nearest, most, is_tie = nil, -1, false
    while mount do
      local depth = shared_depth(composite, mount)
      if depth > most then
        nearest, most, is_tie = mount, depth, false
      elseif depth == most then
        is_tie = true
      end
      mount = build.earlier[mount]
    end
    if is_tie then
      return nil, "the table given stands in several places, use a name"
    end
    return nearest
  end

  -- Somebody may have written `from` or `to`.
  local function alias_used(tr, field)
    local data = tr._data or {}
    for i = 1, #data do
      if type(data[i]) == "string" and misspelt_field(data[i], { field }) then
        return (" (there is '%s', did you mean '%s'?)"):format(data[i], field)
      end
    end
    return ""
  end

  -- Returns the node that src or tgt of a transition means; nil and a reason when none.
  local function find_end(build, tr, field)
    local ref = tr[field]
    local node, reason
    if type(ref) == "string" then
      node, reason = find_named(build, tr._parent, ref)
      if not node and field == "tgt" and ref == "internal" then
        reason = "internal transitions are not supported"
      end
      reason = reason and ("%s '%s': %s"):format(field, ref, reason)
    elseif is_node(ref) then
      node, reason = find_mounted(build, tr._parent, ref)
      reason = reason and field .. ": " .. reason
    elseif ref == nil then
      reason = field .. " is missing, the name of a state or connector expected"
        .. alias_used(tr, field)
    else
      reason = field .. ": name of a state or connector expected, " .. got(ref)
    end
    return node, reason
  end

  -- Resolves src or tgt of `tr`; returns nil when a problem was reported. Mostly it is
  -- the name of a sibling.
  function resolve_end(build, tr, field)
    local ref = tr[field]
    local sibling = tr._parent[ref]
    if is_node(sibling) and sibling._id == ref then return sibling end
    local node, reason = find_end(build, tr, field)
    if not node then add(build.problems, place_of(tr), reason) end
    return node
  end
end

-- The node where a transition to `node` ends: a composite is entered at its `initial`.
local function find_entrance(build, tr, node)
  if is_conn(node) then return node end
  local initial = rawget(node, "initial")
  if is_conn(initial) then return initial end
  if node ~= build.root then -- of the root that is a problem of its own
    add(build.problems, place_of(tr), "tgt '%s': the composite has no initial "
      .. "transition (rfsm.trans{ src='initial', tgt=... })", node._fqn)
  end
end

-- An undeclared `initial` comes into being where a transition starts from it.
local function create_initial(build, tr)
  if tr.src ~= "initial" then return end
  local composite = tr._parent
  if rawget(composite, "initial") ~= nil then return end
  local n = #build.nodes + 1
  local connector = setmetatable({
    _id = "initial", _fqn = composite._fqn .. ".initial", _parent = composite,
    _index = n,
  }, Connector)
  composite.initial, composite._is_leaf = connector, false
  build.nodes[n], build.sources.nodes[n] = connector, false
  build.created[#build.created + 1] = connector
end

local function expand_e_done(build, tr)
  local events, src = tr.events, tr.src
  for i = 1, #events do
    if events[i] == "e_done" then
      events[i] = "e_done@" .. src._fqn
      if not src._is_leaf then
        add(build.warnings, place_of(tr),
          "'e_done' never fires here, '%s' is no leaf state", src._fqn)
      end
    end
  end
end

local function resolve_transition(build, tr)
  local src, tgt = resolve_end(build, tr, "src"), resolve_end(build, tr, "tgt")
  if tgt and not tgt._is_leaf then tgt = find_entrance(build, tr, tgt) end
  if not (src and tgt) then return end
  tr.src, tr.tgt = src, tgt
  if build.completions[tr] then expand_e_done(build, tr) end
end

-- Resolves the transitions from number `first` on.
local function resolve(build, first)
  local transitions = build.transitions
  for i = first, #transitions do create_initial(build, transitions[i]) end
  for i = first, #transitions do resolve_transition(build, transitions[i]) end
end

-- Compile: the structure becomes lists and indexes -----------------------------
--
-- At init that is only which transitions leave a node. The rest is made when a node is
-- searched, a transition taken, a state entered for the first time, so that what never
-- runs takes neither time nor memory.

local compile, compile_node, compile_path, make_ready

do
  local function depth_of(node)
    local depth = 0
    while node._parent ~= node do
      node, depth = node._parent, depth + 1
    end
    return depth
  end

  -- The order in which the transitions of a node are tried: larger pn first, then the
  -- one declared further out, then position in its table, then name.
  local function tried_before(a, b)
    local a_pn, b_pn = a.pn or 0, b.pn or 0
    if a_pn ~= b_pn then return a_pn > b_pn end
    local a_parent, b_parent = a._parent, b._parent
    if a_parent ~= b_parent then
      local a_depth, b_depth = depth_of(a_parent), depth_of(b_parent)
      if a_depth ~= b_depth then return a_depth < b_depth end
      return a_parent._fqn < b_parent._fqn
    end
    return key_before(a._id, b._id)
  end

  -- The nearest common proper ancestor of both ends: what it contains is left and
  -- entered, itself it stays active. The root stays active also under a transition of
  -- its own.
  local function find_lca(src, tgt)
    local a, b = src._parent, tgt._parent
    if a == b then return a end
    local a_depth, b_depth = depth_of(a), depth_of(b)
    while a ~= b do
      if a_depth >= b_depth then
        a, a_depth = a._parent, a_depth - 1
      else
        b, b_depth = b._parent, b_depth - 1
      end
    end
    return a
  end

  -- The states between `lca` and `tgt`, outermost first, with `tgt` if it is a state.
  local function entries_of(lca, tgt)
    local upwards, n = {}, 0
    local state = is_state(tgt) and tgt or tgt._parent
    while state ~= lca do
      n = n + 1
      upwards[n], state = state, state._parent
    end
    return reversed(upwards)
  end

  local function has_predicate(events)
    for i = 1, #events do
      if type(events[i]) == "function" then return true end
    end
    return false
  end

  -- The fields that a run reads, all at once: LuaJIT likes that.
  local function compile_transition(tr)
    local events = tr.events
    tr.guard, tr.effect, tr._pn = tr.guard or false, tr.effect or false, tr.pn or 0
    tr._to_connector = is_conn(tr.tgt)
    tr._is_open_to_all = events == nil or #events == 0
    tr._has_predicate = not tr._is_open_to_all and has_predicate(events)
    tr._is_simple = not tr._has_predicate and not tr._to_connector
    tr._is_quick = tr._is_simple and not tr.guard
    tr._lca, tr._entries = tr._lca or false, tr._entries or false -- it may be under way
    tr._run = Transition._run
  end

  -- Adds `tr` to the list of each event that may trigger it.
  local function add_to_index(by_event, by_any, tr)
    if tr._is_open_to_all or tr._has_predicate then
      for _, list in pairs(by_event) do list[#list + 1] = tr end -- any order: each once
      by_any[#by_any + 1] = tr
      return
    end
    for i = 1, #tr.events do
      local list = by_event[tr.events[i]]
      if list[#list] ~= tr then list[#list + 1] = tr end
    end
  end

  -- Indexes the outgoing transitions of `node`: `_by_event[event]` holds the candidates
  -- in the order in which they are tried, `_by_any` those for an event without a list.
  function compile_node(plan, node)
    local otrs, by_event, by_any = node._otrs, {}, {}
    for rank = 1, #otrs do
      local tr = otrs[rank]
      compile_transition(tr)
      tr._rank = rank
      for i = 1, tr.events and #tr.events or 0 do
        by_event[tr.events[i]], plan.events[tr.events[i]] = {}, true
      end
    end
    for rank = 1, #otrs do add_to_index(by_event, by_any, otrs[rank]) end
    node._by_event, node._by_any = by_event, by_any[1] and by_any or false
  end

  local RUN_FIELDS = {
    "entry", "exit", "doo", "_entry_hooks", "_exit_hooks", "_is_leaf", "_choices",
    "_ignored", "_by_event", "_by_any",
    "_sources", -- the last one: it tells that the others are there
  }

  -- Gives a state that is going to be active all that a run reads, false where there is
  -- nothing.
  function make_ready(state)
    if rawget(state, "_sources") ~= nil then return end
    state._done_event = state._is_leaf and "e_done@" .. state._fqn
    for i = 1, #RUN_FIELDS do
      local field = RUN_FIELDS[i]
      state[field] = state[field] or false
    end
  end

  -- Lists what `tr` enters, when it is first taken; `_entries` tells that it is done.
  function compile_path(tr)
    local lca = find_lca(tr.src, tr.tgt)
    local entries = entries_of(lca, tr.tgt)
    for i = 1, #entries do make_ready(entries[i]) end
    tr._lca = lca
    tr._entries = entries
  end

  -- Undoes all of this: the structure or a program has changed.
  local function forget(nodes)
    for i = 1, #nodes do
      local node = nodes[i]
      node._otrs, node._by_event, node._by_any = nil, nil, nil
      node._sources, node._choices, node._ignored = nil, nil, nil
    end
  end

  -- Gives each node the list of the transitions that leave it, in order.
  function compile(plan)
    local transitions, several = plan.transitions, {}
    if plan.events then forget(plan.nodes) end
    for i = 1, #transitions do
      local tr = transitions[i]
      local src = tr.src
      local otrs = src._otrs
      if not otrs then
        src._otrs = { tr }
      else
        if not otrs[2] then several[#several + 1] = otrs end
        otrs[#otrs + 1] = tr
      end
    end
    for i = 1, #several do sort(several[i], tried_before) end
    plan.events, plan.is_stale = {}, false
  end
end

-- Machine: an instance of a plan ----------------------------------------------
--
-- A machine and its nodes and transitions hold only the user's data. All else they
-- read from their definition in the plan, `_def`; all machines of the model share it
-- until one of them gets another program or event, which has a plan of its own from
-- then on. Mode, active child and coroutine of a state follow from where the machine
-- stands:
--
--   _leaf     the active leaf; false: there is none, and _open is the innermost active
--             composite, false before the first entry
--   _is_done  the active leaf has done its work
--   _doo      the coroutine of its doo
--   _at       false: no iteration is under way. true: one is, and all of the above
--             holds. Else a note of the program of a transition that runs: -i for the
--             exit of node i, i for the entry of node i, i + 0.5 for the effect while
--             node i stays active; i + 0.25 between two exits
--
-- In the engine `state`, `leaf`, `tr` are definitions. What a user's function gets is
-- the machine's own, in fsm._nodes and fsm._transitions at the same index.

-- The plans of models, kept by their machines; the latest one in any case, for programs
-- that drop each machine before they make the next.
local plans, latest = setmetatable({}, { __mode = "kv" }), { plan = false }

-- The machines there are: one look tells for any value at all whether it is one.
local machines = setmetatable({}, { __mode = "k" })

local function silent() end

local function no_events() end

-- What the fields of a machine are while they are off, and the flag to set with them:
-- see Run.
local FLAG_OF = {
  dbg = "_is_traced", getevents = "_is_fed", pre_step_hook = "_is_hooked",
  post_step_hook = "_is_hooked",
}
local OFF = {
  dbg = silent, getevents = no_events, pre_step_hook = false, post_step_hook = false,
}

local function set_flag(fsm, flag)
  fsm[flag], fsm._is_plain, fsm._is_unsettled = true, false, true
end

-- Returns the innermost active state, and whether it is being left.
local function innermost_of(fsm)
  local at = fsm._at
  if type(at) == "boolean" then return fsm._leaf or fsm._open, false end
  return fsm._plan.nodes[floor(at < 0 and -at or at)], at < 0
end

-- The rest of a transition that is under way goes in detail, where each program is
-- looked up and traced: while the field is gone, the next note in it ends the call.
local function go_in_detail(fsm)
  local at = fsm._at
  set_flag(fsm, "_is_traced")
  fsm._was_at = at
  if type(at) == "number" then rawset(fsm, "_at", nil) end
end

-- What such a call ends with.
local IN_DETAIL = {}

-- Returns the machine's own node or transition.
local function live_of(fsm, def)
  local is_transition = getmetatable(def) == Transition
  return (is_transition and fsm._transitions or fsm._nodes)[def._index]
end

local own_plan, set_mode

do
  local PROGRAMS = { entry = true, exit = true, doo = true }

  -- What is read from the definition, and what is worked out.
  local STATE_FIELDS = { entry = true, exit = true, doo = true, _fqn = true, _id = true,
    new = true, type = true }
  local CONNECTOR_FIELDS = { _fqn = true, _id = true, new = true, type = true }
  local TRANSITION_FIELDS = { guard = true, effect = true, pn = true, _id = true,
    new = true, type = true }
  local STATE, CONNECTOR, TRANSITION, ROOT = {}, {}, {}, {}

  function STATE._parent(fsm, def) return fsm._nodes[def._parent._index] end

  -- Nil as long as preproc functions may change it. A list is made once, until the plan
  -- is compiled anew and has other lists.
  function STATE._otrs(fsm, def)
    if fsm._plan.is_stale and machines[fsm] then compile(fsm._plan) end
    if not def._otrs or not machines[fsm] then return nil end
    fsm._otrs_of = fsm._otrs_of or setmetatable({}, { __mode = "k" })
    local otrs = fsm._otrs_of[def._otrs]
    if otrs then return otrs end
    otrs = {}
    for i = 1, #def._otrs do otrs[i] = live_of(fsm, def._otrs[i]) end
    fsm._otrs_of[def._otrs] = otrs
    return otrs
  end

  function STATE._mode(fsm, def)
    local state, is_leaving = innermost_of(fsm)
    if not state then return "inactive" end
    if state == def then
      if is_leaving then return "inactive" end
      return fsm._is_done and state == fsm._leaf and type(fsm._at) == "boolean"
        and "done" or "active"
    end
    while state._parent ~= state do
      state = state._parent
      if state == def then return "active" end
    end
    return "inactive"
  end

  function STATE._actchild(fsm, def)
    local state = innermost_of(fsm)
    while state and state._parent ~= state do
      if state._parent == def then return fsm._nodes[state._index] end
      state = state._parent
    end
    return false
  end

  function ROOT._act_leaf(fsm)
    local at, leaf = fsm._at, fsm._leaf
    if not leaf or at ~= -leaf._index and type(at) ~= "boolean" then return false end
    return fsm._nodes[leaf._index]
  end

  function STATE._doo_co(fsm, def)
    return fsm._leaf == def and ROOT._act_leaf(fsm) and fsm._doo
  end

  CONNECTOR._parent, CONNECTOR._otrs = STATE._parent, STATE._otrs
  TRANSITION._parent = STATE._parent
  function TRANSITION.src(fsm, def) return fsm._nodes[def.src._index] end
  function TRANSITION.tgt(fsm, def) return fsm._nodes[def.tgt._index] end

  -- A list of its own each time; one that a preproc function gets is noted, because it
  -- may be changed: see `note_events`.
  function TRANSITION.events(fsm, def)
    if not def.events then return nil end
    local events = copy_list(def.events)
    if fsm._is_preparing then rawset(fsm._transitions[def._index], "events", events) end
    return events
  end

  for field, read in pairs(STATE) do ROOT[field] = read end -- any order: each alone

  -- Returns the node or transition that the state contains under `key`.
  local function read_member(state, key)
    local member = rawget(state._def, key)
    if not kind_of(member) or is_meta(key) then return nil end
    return live_of(state._fsm, member)
  end

  local function reader(readers, fields)
    return function(element, key)
      local read = readers[key]
      if read then return read(element._fsm, element._def) end
      return fields[key] and element._def[key] or nil
    end
  end

  LiveConnector.__index = reader(CONNECTOR, CONNECTOR_FIELDS)
  LiveTransition.__index = reader(TRANSITION, TRANSITION_FIELDS)
  LiveTransition.__tostring = Transition.__tostring
  local read_state, read_root = reader(STATE, STATE_FIELDS), reader(ROOT, STATE_FIELDS)

  function LiveState.__index(state, key)
    return read_member(state, key) or read_state(state, key)
  end

  function Machine.__index(fsm, key)
    local off = OFF[key]
    if off ~= nil then return off end
    if key == "_at" then return fsm._was_at end
    return read_member(fsm, key) or read_root(fsm, key)
  end

  -- Fields of a definition that compiling made, or that are the plan's own.
  local COMPILED = {
    _otrs = true, _by_event = true, _by_any = true, _sources = true, _choices = true,
    _ignored = true, _lca = true, _entries = true, _run = true, _runs = true,
    _plan = true,
  }

  local function copy_def(def, copies)
    local copy = copies[def]
    for key, value in pairs(def) do -- any order: each field stands alone
      if not COMPILED[key] then copy[key] = copies[value] or value end
    end
    return setmetatable(copy, getmetatable(def))
  end

  local function copy_defs(defs, copies)
    local list = {}
    for i = 1, #defs do list[i] = copy_def(defs[i], copies) end
    return list
  end

  local function copy_plan(plan)
    local copies = {}
    for i = 1, #plan.nodes do copies[plan.nodes[i]] = {} end
    for i = 1, #plan.transitions do copies[plan.transitions[i]] = {} end
    local copy = {
      model = plan.model, nodes = copy_defs(plan.nodes, copies),
      transitions = copy_defs(plan.transitions, copies),
      warnings = plan.warnings, created = plan.created, events = false, is_own = true,
    }
    copy.root = copy.nodes[1]
    copy.root._plan = copy
    return copy
  end

  local function use_plan(fsm, plan)
    fsm._plan = plan
    for i, def in ipairs(plan.nodes) do
      local node = rawget(fsm._nodes, i)
      if node then node._def = def end
    end
    for i, def in ipairs(plan.transitions) do
      local tr = rawget(fsm._transitions, i)
      if tr then tr._def = def end
    end
    fsm._leaf = fsm._leaf and plan.nodes[fsm._leaf._index]
    fsm._open = fsm._open and plan.nodes[fsm._open._index]
  end

  -- Gives the machine a plan that it shares with no other.
  function own_plan(fsm)
    local plan = fsm._plan
    if plan.is_own then return plan end
    if plan.users == 1 then -- there has never been another
      plan.is_own, plan.sources, plans[plan.model] = true, false, nil
      if latest.plan == plan then latest.plan = false end
      return plan
    end
    local copy = copy_plan(plan)
    use_plan(fsm, copy)
    if machines[fsm] then compile(copy) end
    return copy
  end

  -- Blames who assigns to a field of a live machine what cannot be called.
  local function check_new(key, value, expected)
    if not value or is_callable(value) or value == true and key == "dbg" then return end
    error(("%s: %s expected, %s"):format(key, expected, got(value)), 3)
  end

  -- A field of a definition is replaced: what was compiled is made anew before the next
  -- iteration.
  local function change(element, key, value)
    local fsm = element._fsm
    own_plan(fsm).is_stale = true
    if value == nil then value = false end
    element._def[key] = value
    go_in_detail(fsm)
  end

  function LiveState.__newindex(state, key, value)
    if PROGRAMS[key] then
      check_new(key, value, "function")
      return change(state, key, value)
    end
    if key == "_mode" then return set_mode(state, value) end
    if not STATE[key] then rawset(state, key, value) end
  end

  function LiveConnector.__newindex(connector, key, value)
    if not CONNECTOR[key] then rawset(connector, key, value) end
  end

  -- How fields of a transition are set.
  local SET = {}

  function SET.guard(tr, key, value)
    check_new(key, value, "function")
    change(tr, key, value)
  end

  SET.effect = SET.guard

  function SET.pn(tr, key, value)
    if value ~= nil and (type(value) ~= "number" or value ~= value) then
      error("pn: number expected, " .. got(value), 3)
    end
    change(tr, key, value)
    tr._def.pn = value
  end

  function SET.tgt(tr, key, value)
    if not (is_live(value) and is_node(value) and value._fsm == tr._fsm) then
      error(key .. ": node of the fsm expected, " .. got(value), 3)
    end
    own_plan(tr._fsm)
    tr._def._lca, tr._def._entries = false, false
    change(tr, key, key == "tgt" and rawget(value._def, "initial") or value._def)
  end

  SET.src = SET.tgt

  -- The list is noted while preproc functions are at work, and counts at once later.
  function SET.events(tr, key, value)
    local events = type(value) == "string" and { value } or value or {}
    if type(events) ~= "table" then
      error("events: list of events or a string expected, " .. got(value), 3)
    end
    if tr._fsm._is_preparing then
      rawset(tr, key, events)
    else
      change(tr, key, copy_list(events))
    end
  end

  function LiveTransition.__newindex(tr, key, value)
    local set = SET[key] or rawset
    set(tr, key, value)
  end

  function Machine.__newindex(fsm, key, value)
    if key == "_at" then
      rawset(fsm, "_at", fsm._was_at)
      error(IN_DETAIL, 0)
    elseif PROGRAMS[key] then
      check_new(key, value, "function")
      return change(fsm, key, value)
    elseif key == "_mode" then
      return set_mode(fsm, value)
    elseif key == "_act_leaf" and is_live(value) and value._fsm == fsm then
      return set_mode(value, "active")
    end
    if ROOT[key] then return end
    if FLAG_OF[key] then
      check_new(key, value, key == "dbg" and "function, true or false" or "function")
      set_flag(fsm, FLAG_OF[key])
    end
    rawset(fsm, key, value)
    if key == "dbg" then go_in_detail(fsm) end
  end

  -- Moves the machine to where `state` has that mode; no program runs.
  function set_mode(state, mode)
    local fsm, def = state._fsm, state._def
    if mode == "inactive" then
      if state._mode == "inactive" then return end
      fsm._leaf, fsm._doo = false, false
      fsm._open = def._parent ~= def and def._parent
    elseif def._is_leaf then
      if fsm._leaf ~= def then fsm._doo = false end
      make_ready(def)
      fsm._leaf, fsm._open, fsm._is_done = def, false, mode == "done"
    elseif state._mode == "inactive" then
      fsm._leaf, fsm._open, fsm._doo = false, def, false
    end
  end
end

local clone_data

do
  -- Returns what stands for `value` in the copy; a plain table is filled in later.
  local function copy_of(copies, value, pending)
    if type(value) ~= "table" or getmetatable(value) ~= nil then return value end
    local copy = copies[value]
    if not copy then
      copy = {}
      copies[value] = copy
      pending[#pending + 1] = value
    end
    return copy
  end

  -- Copies a plain table; a list of pending tables instead of recursion bears any
  -- depth.
  function clone_data(copies, value)
    if type(value) ~= "table" then return value end
    local pending = {}
    local copy = copy_of(copies, value, pending)
    while pending[1] do
      local source = pending[#pending]
      pending[#pending] = nil
      local target = copies[source]
      for k, v in pairs(source) do -- any order: each pair stands alone
        target[copy_of(copies, k, pending)] = copy_of(copies, v, pending)
      end
    end
    return copy
  end
end

-- The nodes and transitions of a machine come into being when they are first asked for.

-- Gives `element` the user's data in its definition.
local function hand_out(fsm, element, def)
  local data = def._data
  for i = 1, data and #data or 0 do
    local key = data[i]
    if not is_meta(key) then
      rawset(element, key, clone_data(fsm._copies, def[key]))
    elseif rawget(element, key) == nil then
      rawset(element, key, clone_data(fsm._copies, def._meta[key]))
    end
  end
end

local function make_element(fsm, def, class)
  local element = setmetatable({ _def = def, _fsm = fsm }, class)
  hand_out(fsm, element, def)
  return element
end

-- The metatables of the lists; the machine itself is its node 1, and transition 0.
local NODES, TRANSITIONS = {}, {}

function NODES.__index(nodes, i)
  local fsm = nodes[1]
  local def = fsm._plan.nodes[i]
  if not def then return nil end
  local class = getmetatable(def) == State and LiveState or LiveConnector
  local node = make_element(fsm, def, class)
  nodes[i] = node
  return node
end

function TRANSITIONS.__index(transitions, i)
  local fsm = transitions[0]
  local def = fsm._plan.transitions[i]
  if not def then return nil end
  local tr = make_element(fsm, def, LiveTransition)
  transitions[i] = tr
  return tr
end

-- Makes those elements that copy tables of the model, which may change later.
local function copy_tables(fsm, with_tables)
  fsm._copies = {}
  for i = 1, #with_tables do
    local def = with_tables[i]
    if def == fsm._def then hand_out(fsm, fsm, def) else live_of(fsm, def) end
  end
  fsm._copies = false
end

-- Run: collect events, choose, take, doo --------------------------------------
--
-- What holds here: between two iterations exactly one leaf is active, or none before
-- the first entry. Tools replace functions on a live machine: the next use sees the new
-- one. No error of a user's function passes through: those of states and transitions go
-- to `err`, those of printers, hooks and getevents are kept and raised when the
-- iteration is over.
--
-- What makes it fast: flags stand for all that is rarely there, so that a step asks for
-- one of them and not for every hook and printer.
--
--   _is_traced     dbg is on, or a program was replaced: transitions run in full detail
--   _is_fed        there is a getevents
--   _is_hooked     there is a pre or a post step hook
--   _is_plain      none of these
--   _is_unsettled  the iteration has more to do at its end: see `settle`
--
-- The fields behind the first three are absent from the machine while they are off (OFF
-- has what they read as then), so that setting one of them passes through
-- Machine.__newindex. They may be set too long, never too short.

-- Nothing stands behind the flag any more.
local function clear_flag(fsm, flag)
  for field, its_flag in pairs(FLAG_OF) do -- any order: each stands alone
    if its_flag == flag then rawset(fsm, field, nil) end
  end
  fsm[flag] = false
  fsm._is_plain = not (fsm._is_traced or fsm._is_fed or fsm._is_hooked)
end

-- Prints any values, tab separated: to stderr where there is one, or with the `print`
-- of the moment.
local function print_line(stream, ...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = text_of((select(i, ...))) end
  local line, io = concat(texts, "\t"), rawget(_G, "io")
  if stream and io and io[stream] then
    io[stream]:write(line, "\n")
  else
    rawget(_G, "print")(line)
  end
end

local function to_stdout(...) print_line(nil, ...) end

local function to_stderr(...) print_line("stderr", ...) end

local DEFAULT_PRINTER = {
  dbg = silent, info = to_stdout, warn = to_stderr, err = to_stderr,
}

-- Returns the function that a printer field means: true prints, false is silent.
local function printer_of(fsm, name)
  local printer = fsm[name]
  if printer == nil then return DEFAULT_PRINTER[name] end
  return printer == true and to_stdout or printer or silent
end

-- Keeps the first error of the surroundings until the iteration is over.
local function keep_failure(fsm, failure)
  if fsm._has_failure then return end
  fsm._has_failure, fsm._failure, fsm._is_unsettled = true, failure, true
end

local function raise_failure(fsm)
  if not fsm._has_failure then return end
  local failure = fsm._failure
  fsm._has_failure, fsm._failure = false, nil
  error(failure, 0)
end

local function report(fsm, name, ...)
  local printer = printer_of(fsm, name)
  if not is_callable(printer) then
    return keep_failure(fsm, ("rfsm: %s: function, true or false expected, %s"):format(
      name, got(printer)))
  end
  local ok, failure = pcall(printer, ...)
  if not ok then keep_failure(fsm, failure) end
end

-- A program of a state or transition failed.
local function report_program(fsm, id, program, owner, failure)
  report(fsm, "err", id, "error executing " .. program .. " of " .. owner .. ": ",
    failure)
end

local function trace(fsm, ...)
  if fsm.dbg then report(fsm, "dbg", ...) end
end

-- Adds an event to the queue.
local function post(fsm, event)
  local queue = fsm._intq
  queue[#queue + 1] = event
  if fsm._is_traced then trace(fsm, "RAISED", event) end
end

local function post_all(fsm, ...)
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    if event ~= nil then post(fsm, event) end
  end
end

local NONE = {}

-- Returns the list that getevents returns; an empty one when it fails.
local function ask_getevents(fsm)
  local getevents = fsm.getevents
  if not getevents or getevents == no_events then return NONE end
  local ok, events = pcall(getevents)
  if not is_callable(getevents) then
    keep_failure(fsm, "rfsm.step: getevents: function expected, " .. got(getevents))
  elseif not ok then
    keep_failure(fsm, events)
  elseif type(events) == "table" then
    return events
  elseif events ~= nil then
    keep_failure(fsm, "rfsm.step: getevents: list of events expected, " .. got(events))
  end
  return NONE
end

-- Puts what getevents returns into the queue.
local function poll(fsm)
  local events = ask_getevents(fsm)
  for i = 1, #events do
    if events[i] ~= nil then post(fsm, events[i]) end
  end
end

-- Appends what getevents returns to the events of the iteration.
local function collect(fsm, list)
  local events, n = ask_getevents(fsm), #list
  for i = 1, #events do
    local event = events[i]
    if event ~= nil then
      n = n + 1
      list[n] = event
      if fsm._is_traced then trace(fsm, "RAISED", event) end
    end
  end
end

-- Hooks: a list in which OWN stands for the model's own hook, the field `slot`.
local OWN = {}
local OWN_ONLY = { OWN }

-- The events table was handed to a function that may have kept it.
local function keep_events(fsm) fsm._is_kept, fsm._is_unsettled = true, true end

-- How many parameters a function has, a great many where it is not known: one that has
-- none for the events table cannot keep it. It is noted, and says something about the
-- function alone.
local parameters_of

do
  local getinfo = rawget(_G, "debug") and rawget(_G, "debug").getinfo
  local dump = rawget(string, "dump")

  -- Lua 5.1 does not tell, but the binary form of a function does: in the header of 12
  -- bytes the sizes of int and size_t are at 8 and 9, a 1 at 7 is for little endian;
  -- then come the name of the source with its length, two ints, the number of upvalues,
  -- that of parameters, and a byte that is not 0 for a vararg function.
  local function read_dump(f)
    local ok, code = pcall(dump, f)
    if not ok or code:sub(1, 5) ~= "\27Lua\81" or code:byte(7) ~= 1 then return end
    local at, length = 13, 0
    for i = code:byte(9) - 1, 0, -1 do length = length * 256 + code:byte(at + i) end
    at = at + code:byte(9) + length + 2 * code:byte(8) + 1
    return code:byte(at), code:byte(at + 1) ~= 0
  end

  local function count_parameters(f)
    if type(f) ~= "function" then return huge end
    local info = getinfo and getinfo(f, "u") or {}
    local count, is_vararg = info.nparams, info.isvararg
    if not count then count, is_vararg = read_dump(f) end
    return is_vararg and huge or count or huge
  end

  parameters_of = setmetatable({}, { __mode = "k", __index = function(notes, f)
    notes[f] = count_parameters(f)
    return notes[f]
  end })
end

local function not_a_hook(slot, hook)
  return ("rfsm.step: %s: function expected, %s"):format(slot, got(hook))
end

local function run_hooks(fsm, hooks, slot, events)
  for i = 1, #hooks do
    local hook = hooks[i]
    if hook == OWN then hook = rawget(fsm, slot) end
    if hook then
      if parameters_of[hook] > 1 then keep_events(fsm) end
      local ok, failure = pcall(hook, fsm, events)
      if not ok and not is_callable(hook) then failure = not_a_hook(slot, hook) end
      if not ok then keep_failure(fsm, failure) end
    end
  end
end

-- What an extension wants done when a state is entered or left.
local function run_state_hooks(fsm, node, hooks)
  for i = 1, #hooks do
    local ok, failure = pcall(hooks[i], fsm, node)
    if not ok then keep_failure(fsm, failure) end
  end
end

-- Compiles what has changed. Has dbg been switched off? Then its flag goes, too.
local function check_traced(fsm)
  if fsm._plan.is_stale then compile(fsm._plan) end
  if not fsm.dbg or fsm.dbg == silent then clear_flag(fsm, "_is_traced") end
end

-- Choose: which transition do the events enable? .................................

local choose, choose_from, find_from_node, trace_search

do
  -- Is one of `events` in tr.events, or accepted by a predicate there?
  local function matches_predicate(tr, events)
    for i = 1, #tr.events do
      local wanted = tr.events[i]
      for j = 1, #events do
        local event = events[j]
        if wanted == event then return true end
        if type(wanted) == "function" then
          local ok, answer = pcall(wanted, event)
          if ok and answer then return true end
        end
      end
    end
    return false
  end

  local function matches(tr, events)
    if tr._has_predicate then return matches_predicate(tr, events) end
    local wanted = tr.events
    for i = 1, #wanted do
      for j = 1, #events do
        if wanted[i] == events[j] then return true end
      end
    end
    return false
  end

  -- The guard of `tr` said no, or failed, which does not enable either.
  local function refuse(fsm, tr, ok, failure)
    if not ok then report_program(fsm, "GUARD", "guard", tostring(tr), failure) end
    return false
  end

  local evaluate_connector

  -- Returns the guard as it is now: an earlier one may have replaced it.
  local function trace_checking(fsm, tr)
    if fsm.dbg ~= silent then trace(fsm, "CHECKING", tostring(tr)) end
    return fsm._transitions[tr._index].guard or silent
  end

  local function may_pass(fsm, tr, guard, events)
    local ok, answer = pcall(guard, fsm._transitions[tr._index], events)
    return ok and answer ~= false or refuse(fsm, tr, ok, answer)
  end

  -- Is the segment `tr` enabled, and all behind it up to a leaf? Its events match.
  -- `depth` counts the connectors on the way to it, if there are any.
  local function is_enabled(fsm, tr, events, depth)
    local guard = tr.guard
    if fsm._is_traced then guard = trace_checking(fsm, tr) end
    if guard and not may_pass(fsm, tr, guard, events) then return false end
    return not tr._to_connector or evaluate_connector(fsm, tr.tgt, events, depth)
  end

  local function warn_of_conflict(fsm, connector, ways)
    report(fsm, "warn", "conflicting transitions from src " .. connector._fqn .. " to")
    for i = 1, #ways do report(fsm, "warn", "\t" .. ways[i].tgt._fqn) end
  end

  local function add_conflict(conflict, way, tr)
    conflict = conflict or { way }
    conflict[#conflict + 1] = tr
    return conflict
  end

  -- Chooses the way out of a connector: the first of `otrs` that is enabled. Further
  -- ones of the same priority are asked only to warn of a conflict.
  local function choose_way(fsm, connector, otrs, events, depth)
    local way, conflict = false, nil
    for i = 1, #otrs do
      local tr = otrs[i]
      if way and tr._pn ~= way._pn then break end
      if (tr._is_open_to_all or matches(tr, events))
        and is_enabled(fsm, tr, events, depth) then
        if way then conflict = add_conflict(conflict, way, tr) end
        way = way or tr
      end
    end
    if conflict then warn_of_conflict(fsm, connector, conflict) end
    return way
  end

  -- So many connectors wait for each other on one stack; LuaJIT's has room for 1,500.
  local MAX_DEPTH = 500

  -- The same on a stack of its own. A guard that yields there does not enable.
  local function choose_way_aside(fsm, connector, otrs, events)
    local co = create(choose_way)
    local ok, way = resume(co, fsm, connector, otrs, events, 1)
    if not ok then error(way, 0) end
    return status(co) == "dead" and way
  end

  -- Returns the way out of a connector, or false; it is chosen once a search. While it
  -- is being evaluated it counts as closed, so that cycles end.
  function evaluate_connector(fsm, connector, events, depth)
    local searched, ways, otrs = fsm._searched, fsm._ways, connector._otrs
    if searched[connector] == fsm._search then return ways[connector] end
    searched[connector], ways[connector] = fsm._search, false
    if not otrs then return false end
    if not connector._by_event then compile_node(fsm._plan, connector) end
    if not depth or depth < MAX_DEPTH then
      ways[connector] = choose_way(fsm, connector, otrs, events, (depth or 0) + 1)
    else
      ways[connector] = choose_way_aside(fsm, connector, otrs, events)
    end
    return ways[connector]
  end

  -- Collects in fsm._lists the distinct candidate lists of `node` for `events`.
  local function find_lists(fsm, node, events)
    local by_event, by_any, lists = node._by_event, node._by_any, fsm._lists
    local count = 0
    for i = 1, #events do
      local list = by_event[events[i]] or by_any
      if list then
        local is_known = false
        for j = 1, count do is_known = is_known or lists[j] == list end
        if not is_known then
          count = count + 1
          lists[count] = list
        end
      end
    end
    return count
  end

  -- Returns the first of the candidates in `lists` that is tried after `rank`.
  local function next_candidate(lists, count, rank)
    local nearest = nil
    for i = 1, count do
      local list = lists[i]
      for j = 1, #list do
        local tr = list[j]
        if tr._rank > rank then
          if not nearest or tr._rank < nearest._rank then nearest = tr end
          break
        end
      end
    end
    return nearest
  end

  -- May `tr`, whose list an event led to, be taken?
  local function is_candidate_enabled(fsm, tr, events)
    return (not tr._has_predicate or matches_predicate(tr, events))
      and is_enabled(fsm, tr, events)
  end

  -- Returns the first enabled transition of a candidate list, from number `i` on.
  local function find_in_list(fsm, list, events, i)
    local tr = list[i]
    if not tr or is_candidate_enabled(fsm, tr, events) then return tr end
    return find_in_list(fsm, list, events, i + 1)
  end

  -- Returns the first transition from `node` that is enabled, or nil; events may lead
  -- to several lists.
  function find_from_node(fsm, node, events)
    if not node._otrs then return nil end
    if not node._by_event then compile_node(fsm._plan, node) end
    local count = find_lists(fsm, node, events)
    if count == 1 then return find_in_list(fsm, fsm._lists[1], events, 1) end
    local tr = next_candidate(fsm._lists, count, 0)
    while tr do
      if is_candidate_enabled(fsm, tr, events) then return tr end
      tr = next_candidate(fsm._lists, count, tr._rank)
    end
  end

  -- The states from the root to `leaf` that have transitions of their own.
  local function sources_of(leaf)
    local upwards, n, state = {}, 0, leaf
    while true do
      if state._otrs then
        n = n + 1
        upwards[n] = state
      end
      if state._parent == state then break end
      state = state._parent
    end
    local sources = {}
    for i = 1, n do
      local source = upwards[n + 1 - i]
      if not source._by_event then compile_node(state._plan, source) end
      sources[i] = source
    end
    leaf._sources = sources
    return sources
  end

  function trace_search(fsm, events)
    trace(fsm, "TRANSITION", "events: " .. list_text(events))
  end

  -- From the root down to the active leaf, node by node; an outer transition wins.
  local function find_transition(fsm, leaf, events)
    fsm._search = fsm._search + 1
    if fsm.dbg ~= silent then trace_search(fsm, events) end
    local sources = leaf._sources or sources_of(leaf)
    for i = 1, #sources do
      local tr = find_from_node(fsm, sources[i], events)
      if tr then return tr end
    end
  end

  -- leaf._choices[event] holds what the event leads to while the leaf is active, noted
  -- when it first came: false for nothing, a transition that stands alone and goes
  -- straight to a leaf, or a list of candidates, those of all sources. Only events that
  -- the machine knows are noted; all others have one answer, at [OTHER].
  local OTHER, NO_CHOICES = {}, {}
  State._choices, State._ignored = NO_CHOICES, OTHER

  local function candidates_of(sources, event)
    local candidates, is_shared = false, true
    for i = 1, #sources do
      local list = sources[i]._by_event[event] or sources[i]._by_any
      if list and not candidates then
        candidates = list
      elseif list then
        candidates = is_shared and copy_list(candidates) or candidates
        is_shared = false
        append(candidates, list)
      end
    end
    return candidates
  end

  -- Search, straight: a list of candidates becomes a function that asks one guard after
  -- the other, as is_candidate_enabled and choose_way would, without a loop or a call
  -- of its own. In its text t, g, i stand for a transition, its guard, its number; c, w
  -- and x for a connector, the way out of it, those in conflict. The text is compiled
  -- once for each shape, and holds no name of the model.
  local straight_search

  do
    local HEAD = [[
local pcall, silent, may_pass, refuse, trace_checking, matches, add_conflict,
  warn_of_conflict%s = ...
return function(fsm, events)
  local transitions, ways = fsm._transitions, fsm._ways
]]

    -- So many values in one function (Lua 5.1 allows 60 upvalues), so many connectors
    -- behind each other.
    local MAX_VALUES, MAX_NESTED = 50, 12

    local function write(text, line, ...)
      text.lines[#text.lines + 1] = line:format(...)
    end

    local function bind(text, name, value)
      local n = #text.names + 1
      text.names[n], text.values[n] = ", " .. name, value
    end

    local write_connector

    -- What follows when transition number n is enabled: the search ends, or at a
    -- connector (a level above 0) the way is noted.
    local function write_found(text, n, level)
      if level == 0 then return write(text, "return t%d", n) end
      write(text, "if w%d then x%d = add_conflict(x%d, w%d, t%d) else w%d = t%d end",
        level, level, level, level, n, level, n)
    end

    -- `first` is the first transition of the connector: further ones of its priority
    -- are asked only to warn of a conflict, others when there is no way yet.
    local function write_transition(text, tr, level, first)
      local n = text.count + 1
      text.count = n
      bind(text, "t" .. n, tr)
      local condition = "true"
      if first and tr._pn ~= first._pn then
        condition = ("(not w%d or w%d._pn == t%d._pn)"):format(level, level, n)
      end
      if not tr._is_open_to_all and (first or tr._has_predicate) then
        condition = ("%s and matches(t%d, events)"):format(condition, n)
      end
      write(text, "if %s then", condition)
      write(text, "local guard = %s", tr.guard and "g" .. n or "silent")
      write(text, "if fsm._is_traced then guard = trace_checking(fsm, t%d) end", n)
      if not tr.guard then
        write(text, "if guard == silent or may_pass(fsm, t%d, guard, events) then", n)
      else
        bind(text, "g" .. n, tr.guard)
        bind(text, "i" .. n, tr._index)
        write(text, "local ok, answer = pcall(guard, transitions[i%d], events)", n)
        write(text, "if not ok then refuse(fsm, t%d, ok, answer)", n)
        write(text, "elseif answer ~= false then")
      end
      if tr._to_connector then
        write_connector(text, tr.tgt, level + 1)
        write(text, "if w%d then", level + 1)
      end
      write_found(text, n, level)
      write(text, tr._to_connector and "end end end" or "end end")
    end

    -- The way out of a connector, in w<level>. One that is reached a second time, which
    -- is to be evaluated only once, is not for straight text.
    function write_connector(text, connector, level)
      if text[connector] or level > MAX_NESTED or #text.values > MAX_VALUES then
        text.is_too_much = true
        return
      end
      local otrs, c = connector._otrs or NONE, text.count + 1
      if otrs[1] and not connector._by_event then
        compile_node(text.plan, connector)
      end
      text[connector], text.count = true, c
      bind(text, "c" .. c, connector)
      write(text, "local w%d, x%d = false, nil", level, level)
      for i = 1, #otrs do write_transition(text, otrs[i], level, otrs[1]) end
      write(text, "if x%d then warn_of_conflict(fsm, c%d, x%d) end", level, c, level)
      write(text, "ways[c%d] = w%d", c, level)
    end

    local makers = {}

    local function make(text)
      local source = HEAD:format(concat(text.names)) .. concat(text.lines, "\n")
        .. "\nend\n"
      local maker = makers[source] or loadstring(source, "=rfsm search")
      makers[source] = maker
      return maker(pcall, silent, may_pass, refuse, trace_checking, matches,
        add_conflict, warn_of_conflict, unpack(text.values))
    end

    -- Returns a function that returns the first of `candidates` that is enabled, or
    -- nothing.
    function straight_search(plan, candidates)
      local text = {
        plan = plan, lines = {}, names = {}, values = {}, count = 0,
      }
      for i = 1, loadstring and #candidates or 0 do
        write_transition(text, candidates[i], 0)
        if #text.values > MAX_VALUES or text.is_too_much then break end
      end
      if loadstring and not text.is_too_much and #text.values <= MAX_VALUES then
        return make(text)
      end
      return function(fsm, events)
        fsm._search = fsm._search + 1
        return find_in_list(fsm, candidates, events, 1)
      end
    end
  end

  local function choice_of(plan, leaf, event)
    local candidates = candidates_of(leaf._sources or sources_of(leaf), event)
    if not candidates then return false end
    if not candidates[2] and candidates[1]._is_simple then return candidates[1] end
    candidates._search = candidates._search or straight_search(plan, candidates)
    return candidates
  end

  -- leaf._ignored is its e_done if that leads nowhere, as it mostly does.
  local function start_choices(plan, leaf)
    local done_event = leaf._done_event
    local choice = choice_of(plan, leaf, done_event)
    leaf._choices = { [done_event] = choice }
    leaf._ignored = not choice and done_event or OTHER
  end

  local function find_choice(fsm, leaf, event)
    if leaf._choices == NO_CHOICES then start_choices(fsm._plan, leaf) end
    local choices = leaf._choices
    if choices[event] ~= nil then return choices[event] end
    local key = event
    if not fsm._plan.events[event] then key = OTHER end
    if choices[key] == nil then choices[key] = choice_of(fsm._plan, leaf, key) end
    return choices[key]
  end

  -- Returns the first candidate that is enabled, or nothing.
  function choose_from(fsm, choice, events)
    if choice._is_quick then return choice end
    if choice._search then return choice._search(fsm, events) end
    return is_enabled(fsm, choice, events) and choice
  end

  -- Returns what several events lead to.
  local function choose_among(fsm, leaf, events)
    local choice = false
    for i = 1, #events do
      local found = find_choice(fsm, leaf, events[i])
      if found and found ~= choice then
        if choice then return find_transition(fsm, leaf, events) end
        choice = found
      end
    end
    return choice and choose_from(fsm, choice, events)
  end

  -- Returns the transition to take, or nothing.
  function choose(fsm, leaf, events)
    if fsm._is_traced then
      return events[1] ~= nil and find_transition(fsm, leaf, events)
    end
    local at = 1
    if events[1] == leaf._ignored then at = 2 end
    local event = events[at]
    if event == nil then return nil end
    if events[at + 1] ~= nil then return choose_among(fsm, leaf, events) end
    local choice = leaf._choices[event]
    if choice == nil then choice = find_choice(fsm, leaf, event) end
    return choice and choose_from(fsm, choice, events)
  end
end

-- Take: exit, effect, entry, in full detail ......................................

-- Notes in fsm._at, in detail, where that is not to end the protected call: before a
-- program and after it, since it may have asked for that.
local function note(fsm, at) rawset(fsm, "_at", at) end

-- What follows when exit and hooks of `state` have run.
local function finish_hooked_exit(fsm, state)
  if state._is_leaf then fsm._doo = false end
  note(fsm, state._parent._index + 0.25)
  if fsm.dbg ~= silent then trace(fsm, "STATE_EXIT", state._fqn) end
end

-- What follows when the exit of `state` has run.
local function finish_exit(fsm, state)
  local node = fsm._nodes[state._index]
  local hooks = node._def._exit_hooks
  if hooks then run_state_hooks(fsm, node, hooks) end
  finish_hooked_exit(fsm, state)
end

-- A leaf has done its work.
local function complete(fsm, leaf)
  fsm._is_done = true
  post(fsm, leaf._done_event)
end

-- What follows when the entry of `state` has run.
local function finish_entry(fsm, state)
  note(fsm, state._index)
  if state._is_leaf then
    local leaf = fsm._plan.nodes[state._index] -- of a plan that may be new
    make_ready(leaf)
    fsm._leaf, fsm._is_done = leaf, false
    note(fsm, true)
    if not leaf.doo then complete(fsm, leaf) end
  end
  if fsm.dbg ~= silent then trace(fsm, "STATE_ENTER", state._fqn) end
end

-- What follows when the effect of `tr` has run, or there is none.
local function finish_effect(fsm, tr)
  note(fsm, tr._lca._index + 0.5)
  if fsm.dbg == silent then return end
  trace(fsm, "EFFECT", tostring(tr))
  trace(fsm, "TRANS_ENTER", tostring(tr))
end

-- Exits from `state` up to the lca of `tr`. The machine may have got a plan of its own
-- in the meantime: only positions in it tell.
local function exit_up(fsm, tr, state)
  while state._index ~= tr._lca._index do
    local node = fsm._nodes[state._index]
    local exit = node.exit
    note(fsm, -state._index)
    if exit then exit(fsm, node, "exit") end
    finish_exit(fsm, state)
    state = state._parent
  end
end

-- Enters the states of `tr`, beginning with number `first`, whose hooks may have run.
local function enter_down(fsm, tr, first, is_hooked)
  local entries = tr._entries
  for i = first, #entries do
    local state = entries[i]
    local node = fsm._nodes[state._index]
    local hooks = not (is_hooked and i == first) and node._def._entry_hooks
    note(fsm, state._index)
    if hooks then run_state_hooks(fsm, node, hooks) end
    local entry = node.entry
    if entry then entry(fsm, node, "entry") end
    finish_entry(fsm, state)
  end
end

-- (a) Exits from `state` on, (b) the effect, (c) the entries from number `first` on; 0
-- stands for all of it, 1 for all of (c). It runs in a protected call, and fsm._at says
-- what is running. What follows a program (the functions finish_*) does not raise.
local function run_segment(fsm, tr, events, state, first)
  if first == 0 then
    exit_up(fsm, tr, state)
    local own = fsm._transitions[tr._index]
    local effect = own.effect
    note(fsm, tr._lca._index + 0.5)
    if effect then
      keep_events(fsm)
      effect(fsm, own, "effect", events)
    end
    finish_effect(fsm, tr)
    first = 1
  end
  enter_down(fsm, tr, first)
end

-- Which of the entries of `tr` is `state`?
local function number_of(tr, state)
  local entries = tr._entries
  for i = 1, #entries do
    if entries[i]._index == state._index then return i end
  end
end

-- Where segment `tr` starts, the innermost active state: nothing is left when a hook
-- has made the leaf inactive.
local function start_of(fsm, tr)
  return is_conn(tr.src) and tr.src._parent or fsm._leaf or tr._lca
end

-- Where the exits of a segment go on, or begin, after an interrupt.
local function innermost_in(fsm, tr)
  if fsm._at ~= true then return (innermost_of(fsm)) end
  if not tr._entries then compile_path(tr) end
  return start_of(fsm, tr)
end

-- A program of the segment failed: reports it, finishes what it belongs to, and returns
-- where to go on. So it is when the rest is to go in detail, but nothing failed. Where
-- no program was running it was an interrupt, which is for the caller.
local function recover(fsm, tr, failure)
  local at, state = fsm._at, innermost_of(fsm)
  local phase, has_failed = type(at) == "number" and at % 1, failure ~= IN_DETAIL
  note(fsm, at)
  if phase == 0.5 then
    if has_failed then
      report_program(fsm, "EFFECT", "effect", tostring(tr), failure)
    end
    finish_effect(fsm, tr)
    return nil, 1
  elseif phase == 0 and at < 0 then
    if has_failed then report_program(fsm, "EXIT", "exit", state._fqn, failure) end
    finish_exit(fsm, state)
    return state._parent, 0
  elseif phase == 0 then
    if has_failed then report_program(fsm, "ENTRY", "entry", state._fqn, failure) end
    finish_entry(fsm, state)
    return nil, number_of(tr, state) + 1
  end
  keep_failure(fsm, failure)
  return innermost_in(fsm, tr), 0
end

-- One segment in detail. Returns whether the rest of the path is to go so, too.
local function run_in_detail(fsm, tr, events)
  if not tr._entries then compile_path(tr) end
  if fsm.dbg ~= silent then trace(fsm, "TRANS_EXIT", tostring(tr)) end
  run_segment(fsm, tr, events, start_of(fsm, tr), 0)
  return fsm._is_traced
end

local function run_path_in_detail(fsm, tr, events)
  fsm._segment = tr
  note(fsm, true)
  run_in_detail(fsm, tr, events)
  if not tr._to_connector then return end
  return run_path_in_detail(fsm, fsm._ways[tr.tgt], events)
end

-- Runs segment `tr` and those that the search chose after it. It calls itself where a
-- loop would keep LuaJIT from making one trace of a step.
local function run_path(fsm, tr, events)
  fsm._segment, fsm._at = tr, true
  local is_in_detail = tr._run(fsm, tr, events)
  if not tr._to_connector then return end
  local way = fsm._ways[tr.tgt]
  if is_in_detail then return run_path_in_detail(fsm, way, events) end
  return run_path(fsm, way, events)
end

-- Goes on in the segment whose program failed, then with those after it.
local function resume_path(fsm, tr, events, state, first)
  run_segment(fsm, tr, events, state, first)
  local run_rest = fsm._is_traced and run_path_in_detail or run_path
  if tr._to_connector then run_rest(fsm, fsm._ways[tr.tgt], events) end
end

-- Recovers from the failure in segment `tr`, until the path is at its end.
local function recover_path(fsm, tr, events, failure)
  local ok, at
  keep_events(fsm)
  fsm._segment = tr
  repeat
    if fsm._segment == tr and fsm._at == at then error(failure, 0) end -- no progress
    tr, at = fsm._segment, fsm._at
    local state, first = recover(fsm, tr, failure)
    ok, failure = pcall(resume_path, fsm, tr, events, state, first)
  until ok
end

-- Returns the segments from `tr` to a leaf, as the search chose them.
local function path_from(fsm, tr)
  local path = { tr }
  while tr._to_connector do
    tr = fsm._ways[tr.tgt]
    path[#path + 1] = tr
  end
  return path
end

local function trace_path(fsm, tr)
  if fsm.dbg == silent then return end
  local path, names = path_from(fsm, tr), { tr.src._fqn }
  for i = 1, #path do names[i + 1] = path[i].tgt._fqn end
  trace(fsm, "EXEC_PATH", concat(names, " -> "))
end

-- Runs the path that starts with `tr`. One protected call will do if nothing fails.
local function run_protected(fsm, tr, events)
  fsm._segment = tr
  local run = fsm._is_traced and run_path_in_detail or run_path
  local ok, failure = pcall(run, fsm, tr, events)
  if not ok then recover_path(fsm, fsm._segment, events, failure) end
  note(fsm, true)
end

-- Takes the path from the active leaf.
local function take_path(fsm, tr, events)
  if fsm._is_traced then trace_path(fsm, tr) end
  run_protected(fsm, tr, events)
end

-- Runs a program outside of a transition.
local function run_alone(fsm, at, program, node, what)
  note(fsm, at)
  local ok, failure = pcall(program or silent, fsm, node, what)
  if not ok then
    report_program(fsm, what:upper(), what, node._fqn, failure)
  end
end

-- Exits one state outside of a transition.
local function exit_one(fsm, state)
  local node = fsm._nodes[state._index]
  run_alone(fsm, -state._index, node.exit, node, "exit")
  finish_exit(fsm, state)
end

-- Enters the root.
local function enter_root(fsm)
  local root = fsm._def
  fsm._open = false
  note(fsm, root._index)
  if root._entry_hooks then run_state_hooks(fsm, fsm, root._entry_hooks) end
  run_alone(fsm, root._index, fsm.entry, fsm, "entry")
  finish_entry(fsm, root)
end

-- First entry: the root, then the path from its `initial`; false when none is enabled.
local function enter_machine(fsm, events)
  local root = fsm._def
  if root._is_leaf then
    enter_root(fsm)
    return true
  end
  fsm._search = fsm._search + 1
  if fsm.dbg ~= silent then trace_search(fsm, events) end
  local tr = find_from_node(fsm, root.initial, events)
  if not tr then return false end
  trace_path(fsm, tr)
  enter_root(fsm)
  run_protected(fsm, tr, events)
  return true
end

-- Take, straight: the same as run_in_detail while nothing is traced ...............
--
-- A segment becomes a function without a loop, made when it is first taken: one call
-- after the other, each with a note in fsm._at, and nothing for a state without
-- programs. Its text depends on the kinds of the steps alone and is compiled once for
-- each list of them; programs and positions are upvalues. That programs may be replaced
-- at any time costs nothing here: the functions are made anew then, and for the segment
-- that is under way `go_in_detail` removes fsm._at, so that the next note ends the
-- protected call, and `recover` goes on in detail.

do
  -- The text of each kind of step; $n counts them.
  local TEXT = {
    head = [[
local stop, run_state_hooks, exit_hooked, enter_hooked, leaf, done_event%s = ...
return function(fsm, tr, events)
  local nodes = fsm._nodes
]],
    exit = [[
  fsm._at = -i$n
  f$n(fsm, nodes[i$n], "exit")
]],
    exit_hooks = [[
  fsm._at = -i$n
  run_state_hooks(fsm, nodes[i$n], f$n)
  if fsm._is_traced then return exit_hooked(fsm, tr, events, i$n) end
]],
    drop_doo = [[
  fsm._doo = false
]],
    note = [[
  fsm._at = i$n
]],
    effect = [[
  f$n(fsm, fsm._transitions[i$n], "effect", events)
]],
    entry = [[
  fsm._at = i$n
  f$n(fsm, nodes[i$n], "entry")
]],
    entry_hooks = [[
  fsm._at = i$n
  run_state_hooks(fsm, nodes[i$n], f$n)
  if fsm._is_traced then return enter_hooked(fsm, tr, i$n) end
]],
    check = [[
  if fsm._is_traced then stop() end
]],
    enter_leaf = [[
  fsm._leaf = leaf
  fsm._is_done = false
]],
    complete_leaf = [[
  local queue = fsm._intq
  fsm._leaf = leaf
  fsm._is_done = true
  queue[#queue + 1] = done_event
]],
    keep = [[
  fsm._is_kept = true
  fsm._is_unsettled = true
]],
    tail = [[
end
]],
  }

  -- So many programs in one function: Lua 5.1 allows 60 upvalues.
  local MAX_CALLS = 20

  -- The functions that texts are compiled to.
  local makers = {}

  -- `steps` are { kind, program, index }, ...
  local function make_text(steps)
    local texts, names = { "" }, {}
    for n = 1, #steps do
      if steps[n].index then names[#names + 1] = (", f%d, i%d"):format(n, n) end
      texts[n + 1] = TEXT[steps[n].kind]:gsub("%$n", n)
    end
    texts[1] = TEXT.head:format(concat(names))
    texts[#texts + 1] = TEXT.tail
    return concat(texts)
  end

  local function stop() error(IN_DETAIL, 0) end

  -- A hook has changed what comes after it, so that goes in detail. Returns true: the
  -- segment is at its end, and the rest of the path is to go so, too.
  local function exit_hooked(fsm, tr, events, index)
    local state = fsm._plan.nodes[index]
    finish_hooked_exit(fsm, state)
    run_segment(fsm, tr, events, state._parent, 0)
    return true
  end

  local function enter_hooked(fsm, tr, index)
    enter_down(fsm, tr, number_of(tr, fsm._plan.nodes[index]), true)
    return true
  end

  local function make_piece(steps, leaf)
    local text = make_text(steps)
    local maker = makers[text] or loadstring(text, "=rfsm segment")
    makers[text] = maker
    local bound, n = {}, 0
    for i = 1, #steps do
      if steps[i].index then
        bound[n + 1], bound[n + 2] = steps[i].program, steps[i].index
        n = n + 2
      end
    end
    return maker(stop, run_state_hooks, exit_hooked, enter_hooked, leaf,
      leaf and leaf._done_event, unpack(bound, 1, n))
  end

  local function chain(first, second)
    return function(fsm, tr, events)
      return first(fsm, tr, events) or second(fsm, tr, events)
    end
  end

  local function add_step(steps, kind, program, index)
    if program == false or program == nil then return end
    steps[#steps + 1] = { kind = kind, program = program, index = index }
  end

  local function add_exits(steps, tr, innermost)
    local state = innermost
    while state._index ~= tr._lca._index do
      add_step(steps, "exit", state.exit, state._index)
      add_step(steps, "exit_hooks", state._exit_hooks, state._index)
      local may_have_doo = state._is_leaf
        and (state.doo or root_of(state)._plan.is_own)
      add_step(steps, "drop_doo", may_have_doo)
      state = state._parent
    end
  end

  local function add_entries(steps, tr)
    local entries = tr._entries
    for i = 1, #entries do
      local state = entries[i]
      add_step(steps, "entry_hooks", state._entry_hooks, state._index)
      add_step(steps, "entry", state.entry, state._index)
    end
  end

  -- The steps of the segment `tr` from the `innermost` active state.
  local function steps_of(tr, innermost)
    local steps, leaf = {}, tr._entries[1] and not tr._to_connector and tr.tgt
    add_exits(steps, tr, innermost)
    add_step(steps, "keep", tr.effect and parameters_of[tr.effect] > 3)
    add_step(steps, "note", tr.effect, tr._lca._index + 0.5)
    add_step(steps, "effect", tr.effect, tr._index)
    add_entries(steps, tr)
    if steps[1] then steps[#steps + 1] = { kind = "check" } end
    if leaf then
      steps[#steps + 1] = { kind = leaf.doo and "enter_leaf" or "complete_leaf" }
    end
    return steps, leaf
  end

  local function slice(list, first, last)
    local part = {}
    for i = first, min(last, #list) do part[#part + 1] = list[i] end
    return part
  end

  -- Returns the function for the segment `tr` from the `innermost` active state; where
  -- Lua comes without its compiler that is run_in_detail.
  local function straight_segment(tr, innermost)
    if not loadstring then return run_in_detail end
    local steps, leaf = steps_of(tr, innermost)
    local run, piece
    for i = 1, #steps, MAX_CALLS do
      piece = make_piece(slice(steps, i, i + MAX_CALLS - 1), leaf)
      run = run and chain(run, piece) or piece
    end
    return run or silent
  end

  -- A segment that starts at a composite: what it exits depends on the leaf.
  local function run_from_composite(fsm, tr, events)
    local leaf = fsm._leaf
    local run = tr._runs[leaf]
    if not run then
      run = straight_segment(tr, leaf)
      tr._runs[leaf] = run
    end
    return run(fsm, tr, events)
  end

  -- Until the first time.
  function Transition._run(fsm, tr, events)
    local src = tr.src
    if not tr._entries then compile_path(tr) end
    if is_conn(src) then
      tr._run = straight_segment(tr, src._parent)
    elseif src._is_leaf then
      tr._run = straight_segment(tr, src)
    else
      tr._run, tr._runs = run_from_composite, {}
    end
    return tr._run(fsm, tr, events)
  end
end

-- Doo ............................................................................

local run_doo

do
  -- What a doo's coroutine returns at its end, before what the doo returned.
  local ENDED = {}

  local function doo_body(doo, fsm, node) return ENDED, doo(fsm, node, "doo") end

  local function trace_doo(fsm, leaf, outcome)
    if fsm.dbg ~= silent then trace(fsm, "DOO", leaf._fqn, outcome) end
  end

  local function fail_doo(fsm, leaf, failure)
    fsm._doo, fsm._is_done = false, true
    report(fsm, "err", "DOO", "doo program of state '" .. leaf._fqn .. "' failed: ",
      failure)
    trace_doo(fsm, leaf, "failed")
    return true
  end

  -- What follows a cycle of the doo; true when it is idle or done.
  local function finish_cycle(fsm, leaf, ok, idle)
    if not ok then return fail_doo(fsm, leaf, idle) end
    if idle ~= ENDED then
      if fsm._is_traced then trace_doo(fsm, leaf, idle and "idle" or "active") end
      return idle and true or false
    end
    fsm._doo = false
    complete(fsm, leaf)
    trace_doo(fsm, leaf, "done")
    return true
  end

  -- The first cycle: a coroutine is made.
  local function start_doo(fsm, leaf)
    local doo = fsm._nodes[leaf._index].doo
    if not doo then
      complete(fsm, leaf)
      return true
    end
    local co = create(doo_body)
    fsm._doo = co
    return finish_cycle(fsm, leaf, resume(co, doo, fsm, fsm._nodes[leaf._index]))
  end

  -- One cycle of the active leaf's doo; true when it is idle or done.
  function run_doo(fsm, leaf)
    if fsm._is_done then return true end
    local co = fsm._doo
    if not co then return start_doo(fsm, leaf) end
    local ok, idle = resume(co, fsm, fsm._nodes[leaf._index], "doo")
    if not ok or idle == ENDED or fsm._is_traced then
      return finish_cycle(fsm, leaf, ok, idle)
    end
    return idle and true or false
  end
end

-- Iterate ........................................................................

local function reset_now(fsm)
  fsm._leaf, fsm._open, fsm._is_done, fsm._doo = false, false, false, false
  fsm._reset_wanted, fsm._intq = false, { "e_init_fsm" }
  run_hooks(fsm, fsm._reset_hooks, nil, nil)
end

local iterate, iterate_long

do
  -- No way in: the queue becomes again what it was, and what came meanwhile follows.
  local function refuse_entry(fsm, collected, events)
    append(collected, fsm._intq)
    fsm._intq, fsm._curq, fsm._at = collected, {}, false
    report(fsm, "err", "ERROR: cannot enter: no enabled path from 'root.initial' on "
      .. "events: " .. list_text(events))
    if fsm._reset_wanted then reset_now(fsm) end
    raise_failure(fsm)
  end

  -- Empties an events table.
  local function empty(events)
    if events[3] ~= nil then
      for i = #events, 3, -1 do events[i] = nil end
    end
    if events[2] ~= nil then events[2] = nil end
    if events[1] ~= nil then events[1] = nil end
  end

  -- The end of an iteration. The events table is emptied and will be the next queue;
  -- one that a hook or an effect has seen, and may have kept, is left to it.
  local function settle(fsm, events)
    if not fsm._is_unsettled and not fsm._is_hooked then
      empty(events)
      fsm._at = false
      return
    end
    if fsm._reset_wanted then reset_now(fsm) end
    if fsm._is_hooked then run_hooks(fsm, fsm._post_hooks, "post_step_hook", events) end
    if fsm._is_kept then
      fsm._curq, fsm._is_kept = {}, false
    else
      empty(events)
    end
    fsm._is_unsettled, fsm._at = false, false
    raise_failure(fsm)
  end

  -- The first iteration: nil when there is no way in, else true: it counts.
  local function iterate_first(fsm, events)
    if fsm._is_fed then collect(fsm, events) end
    local collected = copy_list(events)
    if fsm._is_hooked then run_hooks(fsm, fsm._pre_hooks, "pre_step_hook", events) end
    if not enter_machine(fsm, events) then
      return refuse_entry(fsm, collected, events)
    end
    settle(fsm, events)
    return true, false
  end

  -- Collects what getevents returns, and lets the pre step hooks change the events. A
  -- flag behind which nothing is left goes.
  local function gather(fsm, events)
    if fsm._is_fed then
      collect(fsm, events)
      local getevents = fsm.getevents
      if not getevents or getevents == no_events then clear_flag(fsm, "_is_fed") end
    end
    if not fsm._is_hooked then return end
    run_hooks(fsm, fsm._pre_hooks, "pre_step_hook", events)
    if fsm._pre_hooks == OWN_ONLY and fsm._post_hooks == OWN_ONLY
      and not fsm.pre_step_hook and not fsm.post_step_hook then
      clear_flag(fsm, "_is_hooked")
    end
  end

  -- An iteration without a transition: a doo cycle. Returns whether it is idle.
  local function iterate_idly(fsm, leaf, is_eventless)
    local idle = run_doo(fsm, leaf)
    if idle and is_eventless and fsm._is_fed then poll(fsm) end
    return idle
  end

  local function hibernate(fsm)
    trace(fsm, "HIBERNATING", fsm._leaf and fsm._leaf._fqn)
    raise_failure(fsm)
  end

  -- What ends an iteration in which nothing was enabled: a doo cycle when there was no
  -- event, or the iteration before did not count. Returns what `iterate` returns.
  local function iterate_free(fsm, leaf, events, after_free)
    local is_eventless, idle = events[1] == nil, false
    local counted = is_eventless or after_free
    if counted then idle = iterate_idly(fsm, leaf, is_eventless) end
    settle(fsm, events)
    return counted, idle and fsm._intq[1] == nil and fsm._leaf ~= false
  end

  -- The same for a plain machine without events: there is nothing to collect or empty.
  local function iterate_doo(fsm, leaf)
    fsm._at = true
    local idle = run_doo(fsm, leaf)
    if fsm._is_unsettled then
      if idle and fsm._is_fed then poll(fsm) end
      settle(fsm, fsm._curq)
    else
      fsm._at = false
    end
    if not idle then return true, false end
    return true, fsm._intq[1] == nil and fsm._leaf ~= false
  end

  -- One iteration, whatever the machine is like. Returns nil when there is no way in;
  -- else whether it counts as a step, and if its doo cycle was idle. `after_free`: the
  -- iteration before did not count.
  local function iterate_fully(fsm, after_free)
    if fsm._is_traced then check_traced(fsm) end
    local leaf, events = fsm._leaf, fsm._intq
    fsm._intq, fsm._curq, fsm._at = fsm._curq, events, true
    if not leaf then return iterate_first(fsm, events) end
    if fsm._is_fed or fsm._is_hooked then
      gather(fsm, events)
      leaf = fsm._leaf or leaf -- of a plan that may be new
    end
    local tr = choose(fsm, leaf, events)
    if not tr then return iterate_free(fsm, leaf, events, after_free) end
    take_path(fsm, tr, events)
    settle(fsm, events)
    return true, false
  end

  -- One iteration of a plain machine when no event, or more than one, leads somewhere.
  -- An e_done that nothing waits for makes no difference: without another event there
  -- is a doo cycle in any case, now or in the next iteration.
  local function iterate_slowly(fsm, leaf, events, after_free)
    local event = events[1]
    if event == leaf._ignored and events[2] == nil then events[1], event = nil, nil end
    if event ~= nil then return iterate_fully(fsm, after_free) end
    if fsm._is_done then return true, true end
    return iterate_doo(fsm, leaf)
  end

  -- One iteration: as iterate_fully says; in one go where the machine is plain and one
  -- event, apart from an e_done that nothing waits for, leads somewhere.
  function iterate(fsm, after_free)
    local leaf, events = fsm._leaf, fsm._intq
    if not fsm._is_plain or not leaf then return iterate_fully(fsm, after_free) end
    local at = 1
    if events[1] == leaf._ignored then at = 2 end
    local choice = leaf._choices[events[at]]
    if not choice or events[at + 1] ~= nil then
      return iterate_slowly(fsm, leaf, events, after_free)
    end
    fsm._intq, fsm._curq, fsm._at = fsm._curq, events, true
    local tr = choice
    if not choice._is_quick then
      tr = choose_from(fsm, choice, events)
      if not tr then return iterate_free(fsm, leaf, events, after_free) end
      if tr._to_connector or fsm._is_traced then
        take_path(fsm, tr, events)
        settle(fsm, events)
        return true, false
      end
    end
    local ok, failure = pcall(tr._run, fsm, tr, events)
    if not ok then recover_path(fsm, tr, events, failure) end
    if fsm._is_unsettled then
      fsm._at = true
      settle(fsm, events)
    else
      events[at] = nil
      events[1] = nil
      fsm._at = false
    end
    return true, false
  end

  -- Iterates until `left` iterations were counted or the machine is idle; returns
  -- whether it is. nil says that its idle_hook is to be called, and then `left` of them
  -- remain.
  local function iterate_on(fsm, left, after_free)
    while true do
      local counted, idle = iterate(fsm, after_free)
      if counted == nil then return false end
      if counted then
        left = left - 1
        if left < 1 then return idle end
      end
      if idle then
        if fsm._is_traced then hibernate(fsm) end
        if fsm.idle_hook then return nil, left end
        return true
      end
      after_free = not counted
    end
  end

  -- Something that is no user's function ended an iteration half-way, such as Control-C
  -- in a terminal: makes the machine fit for the next one.
  local function mend(fsm)
    local is_lost = fsm._at ~= true or not fsm._leaf
    fsm._curq, fsm._is_kept, fsm._is_unsettled = {}, false, fsm._has_failure
    fsm._at = false
    if fsm._reset_wanted or is_lost then reset_now(fsm) end
  end

  -- Iterates as iterate_on does, in a protected call, because this may take long. The
  -- idle_hook is called outside of it, where it may yield on Lua 5.1 as well.
  function iterate_long(fsm, left, after_free)
    while true do
      local ok, idle, rest = pcall(iterate_on, fsm, left, after_free)
      if not ok then
        if fsm._at then mend(fsm) end
        error(idle, 0)
      end
      if idle ~= nil then return idle end
      if not is_callable(fsm.idle_hook) then
        error("rfsm.step: idle_hook: function expected, " .. got(fsm.idle_hook), 0)
      end
      fsm.idle_hook(fsm)
      left, after_free = rest, false
    end
  end
end

-- Public functions ------------------------------------------------------------

-- Blames the caller of the public function for something that is no machine.
local function check_machine(fsm, name, level)
  if type(fsm) == "table" and rawget(fsm, "_initialized") then return end
  local hint = is_state(fsm) and " (rfsm.init makes one of a state)" or ""
  error("rfsm." .. name .. ": initialised fsm expected, " .. got(fsm) .. hint,
    level or 3)
end

local function check_function(f, name, level)
  if is_callable(f) then return end
  error("rfsm." .. name .. ": function expected, " .. got(f), level or 3)
end

-- Digits padded, so that trans[10] comes after trans[2].
local function natural(text)
  return (text:gsub("%d+", function(n) return ("0"):rep(12 - #n) .. n end))
end

-- Sorts texts so that numbers in them count as numbers.
local function sort_naturally(texts)
  if texts[2] == nil then return texts end
  local keys = {}
  for i = 1, #texts do keys[texts[i]] = natural(texts[i]) end
  sort(texts, function(a, b) return keys[a] < keys[b] end)
  return texts
end

-- Turns { place, text } into lines, sorted by place.
local function lines_of(list)
  local lines = {}
  for i = 1, #list do lines[i] = list[i].place .. ": " .. list[i].text end
  return sort_naturally(lines)
end

local function summary(name, problems)
  return ("%s: the model has %d problem%s\n  %s"):format(name, #problems,
    #problems == 1 and "" or "s", concat(problems, "\n  "))
end

-- `plan` is what there is already; a new one has nothing.
local function new_build(plan)
  return {
    root = plan.root, problems = {}, warnings = {}, created = {}, completions = {},
    transitions = plan.transitions, nodes = plan.nodes, mounts = {}, earlier = {},
    with_tables = {},
    sources = {
      nodes = {}, members = {}, transitions = {}, fields = {}, src = {}, tgt = {},
    },
  }
end

-- Check, clone, resolve: all that can be said of a model without running anything.
local function build_plan(model)
  local root = setmetatable({ _id = "root", _fqn = "root" }, State)
  root._parent = root
  local build = new_build { root = root, nodes = {}, transitions = {} }
  add_node(build, model, root)
  clone_below(build, 1)
  resolve(build, 1)
  check_root(build, root, model)
  return build
end

-- What machines of a model share.
---@class rfsm.Plan
---@field model rfsm.State what it was made of
---@field root rfsm.State
---@field nodes (rfsm.State|rfsm.Connector)[] the root first
---@field transitions rfsm.Transition[]
---@field events table<any, true>|false those that transitions name; false: not compiled
---@field is_own boolean one machine has it for itself
---@field is_stale? boolean something has changed that was compiled
---@field users integer how many machines were made of it
local function new_plan(build, model)
  local plan = {
    model = model, root = build.root, nodes = build.nodes,
    transitions = build.transitions, warnings = build.warnings,
    created = build.created, with_tables = build.with_tables, sources = build.sources,
    events = false, is_own = false, users = 0,
  }
  append(plan.with_tables, { build.root }) -- whose data a machine has from the start
  plan.root._plan = plan
  if not build.problems[1] then plans[model], latest.plan = plan, plan end
  return plan
end

local is_current

do
  -- Is `value` in the model still what `member` was made of?
  local function is_same_member(sources, value, member)
    if type(value) ~= "table" then return value == member end
    local kind = KIND[getmetatable(value)]
    if not kind then return value == member end
    if kind_of(member) ~= kind then return false end
    local list = kind == "transition" and sources.transitions or sources.nodes
    return list[member._index] == model_of(value)
  end

  local function is_same_node(sources, model, node)
    local count = 0
    for key, value in pairs(model) do -- any order: all must be the same
      count = count + 1
      local members = is_meta(key) and (node._meta or NONE) or node
      if not is_same_member(sources, value, members[key]) then return false end
    end
    return count == sources.members[node._index]
  end

  local function is_same_event(tr, event, compiled)
    return event == compiled
      or event == "e_done" and compiled == "e_done@" .. tr.src._fqn
  end

  local function are_same_events(tr, events)
    local compiled = tr.events
    if type(events) ~= "table" then
      return compiled and #compiled == 1 and is_same_event(tr, events, compiled[1])
    end
    local count = 0
    for _ in pairs(events) do count = count + 1 end -- any order: only counted
    if not compiled or count ~= #compiled then return false end
    for i = 1, count do
      if not is_same_event(tr, events[i], compiled[i]) then return false end
    end
    return true
  end

  local function is_same_transition(sources, model, tr)
    local i, count = tr._index, 0
    if model.src ~= sources.src[i] or model.tgt ~= sources.tgt[i] then return false end
    for key, value in pairs(model) do -- any order: all must be the same
      count = count + 1
      if key == "events" then
        if not are_same_events(tr, value) then return false end
      elseif key ~= "src" and key ~= "tgt" then
        local fields = is_meta(key) and (tr._meta or NONE) or tr
        if fields[key] ~= value then return false end
      end
    end
    return count == sources.fields[i]
  end

  -- Is the model still what the plan was made of?
  function is_current(plan)
    local sources = plan.sources
    for i, node in ipairs(plan.nodes) do
      local model = sources.nodes[i]
      if model and not is_same_node(sources, model, node) then return false end
    end
    for i, tr in ipairs(plan.transitions) do
      local model = sources.transitions[i]
      if not is_same_transition(sources, model, tr) then return false end
    end
    return true
  end
end

-- Returns the plan of a model, and the problems of a model that can have none.
local function plan_of(model)
  model = model_of(model)
  local plan = plans[model]
  if plan and is_current(plan) then return plan, {} end
  local build = build_plan(model)
  return new_plan(build, model), build.problems
end

-- A machine with all that a run needs, inactive.
local function new_machine(plan)
  local fsm = {
    -- fields of the model that may be absent
    idle_hook = false,
    -- where it stands
    _leaf = false, _open = false, _is_done = false, _doo = false, _at = false,
    -- the run
    _intq = { "e_init_fsm" }, _curq = {},
    _is_traced = false, _is_fed = false, _is_hooked = false, _is_plain = true,
    _is_unsettled = false, _is_kept = false, _reset_wanted = false,
    _has_failure = false, _segment = false,
    _pre_hooks = OWN_ONLY, _post_hooks = OWN_ONLY, _reset_hooks = {},
    _was_at = false, _search = 0, _searched = {}, _ways = {}, _lists = {},
    -- the structure
    _initialized = false, _is_preparing = false, _model = plan.model, _plan = plan,
    _otrs_of = false, _def = plan.root, _fsm = false, _nodes = false,
    _transitions = false,
    _copies = false,
  }
  fsm._fsm, plan.users = fsm, plan.users + 1
  fsm._nodes = setmetatable({ fsm }, NODES)
  fsm._transitions = setmetatable({ [0] = fsm }, TRANSITIONS)
  copy_tables(fsm, plan.with_tables)
  return setmetatable(fsm, Machine)
end

-- Printers become functions, also the wrong ones, which are reported.
local function prepare_printers(fsm)
  for i = 1, 4 do
    local name = PRINTERS[i]
    local printer = printer_of(fsm, name)
    rawset(fsm, name, is_callable(printer) and printer or DEFAULT_PRINTER[name])
  end
end

-- From now on it is noticed when one of the fields is set that flags stand for.
local function watch_fields(fsm)
  for field in pairs(FLAG_OF) do -- any order: each stands alone
    local value = rawget(fsm, field)
    rawset(fsm, field, nil)
    if value and value ~= OFF[field] then fsm[field] = value end
  end
end

-- The conditions under which a composite can be left without a way in.
local function check_initial(warnings, connector)
  local otrs = connector._otrs
  if not otrs or not is_conn(connector) then return end
  for i = 1, #otrs do
    local events = otrs[i].events
    if not otrs[i].guard and (events == nil or #events == 0) then return end
  end
  add(warnings, connector._fqn, "each transition from here has events or a "
    .. "guard, '%s' cannot be entered while none of them is enabled",
    connector._parent._fqn)
end

-- Warns of what was found, and of the `initial` connectors from node `first` on.
local function warn_after_compile(fsm, warnings, first)
  local nodes, all = fsm._plan.nodes, copy_list(warnings)
  for i = first, #nodes do
    if nodes[i]._id == "initial" then check_initial(all, nodes[i]) end
  end
  local lines = lines_of(all)
  for i = 1, #lines do report(fsm, "warn", "WARNING: " .. lines[i]) end
end

local function tell_created(fsm, created)
  local names = {}
  if fsm.info == silent then return end
  for i, connector in ipairs(created) do names[i] = connector._fqn end
  for _, name in ipairs(sort_naturally(names)) do
    report(fsm, "info", "INFO: created undeclared connector " .. name)
  end
end

-- Warns of the nodes, from number `first` on, that nothing leaves.
local function warn_of_dead_ends(fsm, first)
  local nodes, dead = fsm._plan.nodes, {}
  for i = first, #nodes do
    local node = nodes[i]
    if node ~= fsm._def and not node._otrs then dead[#dead + 1] = node._fqn end
  end
  if not dead[1] then return true end
  for _, name in ipairs(sort_naturally(dead)) do
    report(fsm, "warn", "WARNING: no outgoing transitions from node '" .. name .. "'")
  end
  return false
end

--- Functions `f(fsm[, merged])` that `rfsm.init` calls for each machine.
--
-- They run after names are resolved and before events are indexed, and may change
-- events, guards, entries. `rfsm.fsm_merge` calls them again with what it added. A list
-- of texts "place: what is wrong" that one returns counts among the model's problems.
--
---@type (fun(fsm: rfsm.Machine, merged?: table): string[]?)[]
rfsm.preproc = {}

-- A preproc function may have changed events in place or set others.
local function note_events(fsm)
  for i = 1, #fsm._plan.transitions do
    local tr = rawget(fsm._transitions, i)
    local events = tr and rawget(tr, "events")
    if type(events) == "string" then events = { events } end
    if events and not is_same_list(events, tr._def.events) then
      own_plan(fsm)
      tr._def.events = events
    end
    if tr then rawset(tr, "events", nil) end
  end
end

-- Runs the preproc functions; returns the problems they found.
local function preprocess(fsm, merged)
  local problems = {}
  fsm._is_preparing = true
  for i = 1, #rfsm.preproc do
    local found = rfsm.preproc[i](fsm, merged)
    for j = 1, type(found) == "table" and #found or 0 do
      problems[#problems + 1] = found[j]
    end
  end
  fsm._is_preparing = false
  if rfsm.preproc[1] then note_events(fsm) end
  return sort_naturally(problems)
end

-- Compiles, and says what deserves a word of the nodes from number `first` on.
local function finish(fsm, warnings, first)
  local plan = fsm._plan
  if plan.is_own or not plan.events then compile(plan) end
  if fsm.warn == silent then return end
  warn_after_compile(fsm, warnings, first)
  warn_of_dead_ends(fsm, first)
end

--- Check a model and make a machine of it.
--
-- The model is not touched and may be used again. All its problems are handed to `err`
-- in one text, sorted by place.
--
-- @raise when `model` is no state
---@param model rfsm.State a root state, or a machine for a fresh one of the same model
---@return rfsm.Machine|false fsm false when the model has problems
---@return string[]? problems each "place: what is wrong"
---@nodiscard
function rfsm.init(model)
  if not is_state(model) then
    error("invalid fsm model passed to rfsm.init: state expected, " .. got(model), 2)
  end
  local plan, found = plan_of(model)
  local fsm = new_machine(plan)
  prepare_printers(fsm)
  local problems = lines_of(found)
  if not problems[1] then
    fsm._initialized = true
    watch_fields(fsm)
    tell_created(fsm, plan.created)
    problems = preprocess(fsm)
  end
  if problems[1] then
    fsm._initialized = false
    report(fsm, "err", summary("rfsm.init", problems))
    raise_failure(fsm)
    return false, problems
  end
  finish(fsm, plan.warnings, 1)
  machines[fsm] = true
  raise_failure(fsm)
  return fsm
end

--- Check a model without making a machine of it.
---@param model rfsm.State
---@return boolean is_valid
---@return string[] problems each "place: what is wrong"
---@return string[] warnings
function rfsm.verify_early(model)
  if not is_state(model) then
    error("rfsm.verify_early: state expected, " .. got(model), 2)
  end
  local build = build_plan(model_of(model))
  return not build.problems[1], lines_of(build.problems), lines_of(build.warnings)
end

--- Warn of each state or connector that nothing leaves.
---@param fsm rfsm.Machine
---@return boolean is_clean true when there is none
function rfsm.check_no_otrs(fsm)
  check_machine(fsm, "check_no_otrs")
  return warn_of_dead_ends(fsm, 1)
end

--- Send events to a machine; they wait in the queue until the next iteration, in order.
--
-- @usage
--    rfsm.send_events(fsm, "e_start", "e_ready")
--
---@param fsm rfsm.Machine
---@param event? any anything; nil is skipped
---@param ... any more of them
function rfsm.send_events(fsm, event, ...)
  if not machines[fsm] then check_machine(fsm, "send_events") end
  if not fsm._is_traced and event ~= nil then
    local queue = fsm._intq
    queue[#queue + 1] = event
    if select("#", ...) > 0 then post_all(fsm, ...) end
    return
  end
  post_all(fsm, event, ...)
  if not fsm._at then raise_failure(fsm) end
end

--- Advance a machine by at most `n` transitions or doo cycles.
--
-- Returns earlier when it is idle. Errors of states and transitions go to `err`; an
-- error of a printer, a step hook or getevents is raised when the iteration is over.
--
---@param fsm rfsm.Machine
---@param n? number at least 1, default 1
---@return boolean idle true when there is nothing left to do
function rfsm.step(fsm, n)
  if not machines[fsm] then check_machine(fsm, "step") end
  if fsm._at then
    error("rfsm.step: the machine is in the middle of a step", 2)
  end
  if n ~= nil then
    if type(n) ~= "number" then
      error("rfsm.step: number of steps expected, " .. got(n), 2)
    end
    return iterate_long(fsm, n > 1 and n or 1, false) -- NaN: 1
  end
  local counted, idle = iterate(fsm, false)
  if counted then return idle end -- without a loop: LuaJIT makes one trace of it
  return counted == false and iterate_long(fsm, 1, true)
end

--- Advance a machine until no event waits and no doo is busy.
---@param fsm rfsm.Machine
---@return boolean idle false when the machine could not be entered
function rfsm.run(fsm)
  if not machines[fsm] then check_machine(fsm, "run") end
  if fsm._at then
    error("rfsm.run: the machine is in the middle of a step", 2)
  end
  return iterate_long(fsm, huge, false)
end

--- Make a machine as it was after `init`: inactive, no exit is called.
--
-- Called by one of the machine's own functions it takes effect when the iteration ends.
--
---@param fsm rfsm.Machine
function rfsm.reset(fsm)
  check_machine(fsm, "reset")
  if fsm._at then
    fsm._reset_wanted, fsm._is_unsettled = true, true
    return
  end
  reset_now(fsm)
  raise_failure(fsm)
end

--- Move what getevents returns to the queue.
---@param fsm rfsm.Machine
---@return integer waiting length of the queue
function rfsm.check_events(fsm)
  check_machine(fsm, "check_events")
  poll(fsm)
  if not fsm._at then raise_failure(fsm) end
  return #fsm._intq
end

--- Return the name of the active leaf.
---@param fsm rfsm.Machine
---@return string|false fqn false when no leaf is active
function rfsm.get_actleaf_fqn(fsm)
  check_machine(fsm, "get_actleaf_fqn")
  local leaf = fsm._act_leaf
  return leaf and leaf._fqn
end

--- Return the names of the active states, from the root to the leaf.
---@param fsm rfsm.Machine
---@return string[] configuration empty when the machine is inactive
function rfsm.get_active_conf(fsm)
  check_machine(fsm, "get_active_conf")
  local names, n = {}, 0
  local state, is_leaving = innermost_of(fsm)
  if is_leaving and state._parent == state then return {} end
  while state do
    n = n + 1
    names[n] = state._fqn
    state = state._parent ~= state and state._parent
  end
  return reversed(names)
end

--- Return the mode of a state.
---@param state rfsm.State
---@return "active"|"inactive"|"done" mode
function rfsm.get_sta_mode(state)
  return is_live(state) and state._mode or "inactive"
end

--- Set the mode of a state, for tools.
--
-- The machine stands then where the state has that mode; no program runs.
--
---@param state rfsm.State a state of a machine
---@param mode "active"|"inactive"|"done"
function rfsm.set_sta_mode(state, mode)
  if not is_live(state) or not is_state(state) then
    error("rfsm.set_sta_mode: state of a fsm expected, " .. got(state), 2)
  end
  if mode ~= "active" and mode ~= "inactive" and mode ~= "done" then
    error("rfsm.set_sta_mode: 'active', 'done' or 'inactive' expected, " .. got(mode),
      2)
  end
  set_mode(state, mode)
end

--- Return the active child of a composite.
---@param state rfsm.State
---@return rfsm.State|false child
function rfsm.actchild_get(state)
  return is_live(state) and state._actchild or false
end

--- Call `f(obj, parent, name)` for each element below `fsm` that `pred` accepts.
--
-- Parents before children; the array part first, then names sorted.
--
---@param f fun(obj: table, parent: rfsm.State, name: string|integer): any
---@param fsm rfsm.State a machine or a model
---@param pred? fun(obj: any): boolean default is_fsmobj
---@param depth? integer how many levels, default all
---@return any[] results what f returned, in order, without nils
function rfsm.mapfsm(f, fsm, pred, depth)
  check_function(f, "mapfsm")
  if not is_state(fsm) then error("rfsm.mapfsm: state expected, " .. got(fsm), 2) end
  pred = pred or rfsm.is_fsmobj
  local results = {}
  local function map_members(state, levels)
    if levels < 1 then return end
    local keys, n = sorted_keys(members_of(state), rfsm.is_fsmobj)
    for i = 1, n do
      local obj = state[keys[i]]
      if pred(obj) then results[#results + 1] = f(obj, state, keys[i]) end
      if is_state(obj) then map_members(obj, levels - 1) end
    end
  end
  map_members(fsm, depth or huge)
  return results
end

-- Returns the states from `inner` up to its ancestor `outer`; nil when that is none.
local function line_up(inner, outer)
  local line = { inner }
  while inner ~= outer do
    if inner._parent == inner then return nil end
    inner = inner._parent
    line[#line + 1] = inner
  end
  return line
end

--- Call `f(fsm, state)` for each state on the line between two, both included.
-- @raise when neither is an ancestor of the other
---@param fsm rfsm.Machine
---@param f fun(fsm: rfsm.Machine, state: rfsm.State)
---@param from rfsm.State where to begin
---@param to rfsm.State an ancestor or descendant of `from`
function rfsm.map_from_to(fsm, f, from, to)
  check_machine(fsm, "map_from_to")
  check_function(f, "map_from_to")
  if not (is_node(from) and is_node(to)) then
    error("rfsm.map_from_to: two states expected, " .. got(from) .. " and "
      .. got(to), 2)
  end
  local line, is_reversed = line_up(from, to), false
  if not line then line, is_reversed = line_up(to, from), true end
  if not line then
    error(("rfsm.map_from_to: '%s' and '%s' are not on one line"):format(from._fqn,
      to._fqn), 2)
  end
  for i = 1, #line do f(fsm, line[is_reversed and #line + 1 - i or i]) end
end

do
  -- A guard or effect may ask what events would enable while a search or a path goes
  -- on: takes away what that has noted in the machine, and begins a search.
  local function set_search_aside(fsm)
    local notes = {
      search = fsm._search, lists = fsm._lists, ways = fsm._ways,
      searched = fsm._searched,
    }
    fsm._search, fsm._lists, fsm._ways, fsm._searched = fsm._search + 1, {}, {}, {}
    return notes
  end

  local function restore_search(fsm, notes)
    fsm._search, fsm._lists = notes.search, notes.lists
    fsm._ways, fsm._searched = notes.ways, notes.searched
  end

  --- Find the path that events would enable from one node, for tools; nothing is taken.
  ---@param fsm rfsm.Machine
  ---@param node rfsm.State|rfsm.Connector
  ---@param events any[]
  ---@return rfsm.Transition[]|false path its segments in order
  function rfsm.node_find_enabled(fsm, node, events)
    check_machine(fsm, "node_find_enabled")
    if not (is_live(node) and is_node(node) and node._fsm == fsm) then
      error("rfsm.node_find_enabled: node of the fsm expected, " .. got(node), 2)
    end
    if type(events) ~= "table" then
      error("rfsm.node_find_enabled: list of events expected, " .. got(events), 2)
    end
    if fsm._plan.is_stale then compile(fsm._plan) end
    local notes = set_search_aside(fsm)
    local tr = find_from_node(fsm, node._def, events)
    local path = tr and path_from(fsm, tr)
    for i = 1, path and #path or 0 do path[i] = live_of(fsm, path[i]) end
    restore_search(fsm, notes)
    if not fsm._at then raise_failure(fsm) end
    return path or false
  end
end

--- Exit a state and the active states below it, the innermost first.
---@param fsm rfsm.Machine
---@param state rfsm.State
function rfsm.exit_state(fsm, state)
  check_machine(fsm, "exit_state")
  if not is_state_of(fsm, state) then
    error("rfsm.exit_state: state of the fsm expected, " .. got(state), 2)
  end
  if state._mode == "inactive" then return end
  local at, def, inner = fsm._at, state._def, innermost_of(fsm)
  while inner._index ~= def._index do
    exit_one(fsm, inner)
    inner = inner._parent
  end
  exit_one(fsm, def)
  def = state._def -- of a plan that may be new
  fsm._leaf, fsm._open = false, def._parent ~= def and def._parent
  rawset(fsm, "_at", at)
  if not fsm._at then raise_failure(fsm) end
end

-- Hooks: lists that are replaced, never changed: a run over one is not disturbed.

do
  local function hook_add(fsm, field, hook, place)
    local hooks = copy_list(fsm[field])
    if place == "before" then
      for i = #hooks, 1, -1 do hooks[i + 1] = hooks[i] end
      hooks[1] = hook
    else
      hooks[#hooks + 1] = hook
    end
    fsm[field] = hooks
    if field ~= "_reset_hooks" then set_flag(fsm, "_is_hooked") end
  end

  local function hook_rm(fsm, field, slot, hook)
    local hooks, is_found = {}, false
    for _, other in ipairs(fsm[field]) do
      if other == hook and not is_found then
        is_found = true
      else
        hooks[#hooks + 1] = other
      end
    end
    if is_found then
      fsm[field] = slot and #hooks == 1 and hooks[1] == OWN and OWN_ONLY or hooks
    elseif slot and hook ~= nil and fsm[slot] == hook then
      fsm[slot], is_found = false, true
    end
    return is_found
  end

  local function add_listed(fsm, name, field, hook, place)
    check_machine(fsm, name, 4)
    check_function(hook, name, 4)
    if place ~= nil and place ~= "before" and place ~= "after" then
      error("rfsm." .. name .. ": 'before' or 'after' expected, " .. got(place), 3)
    end
    hook_add(fsm, field, hook, place)
  end

  local function add_state_hook(fsm, name, field, state, hook)
    if not is_state_of(fsm, state) then
      error("rfsm." .. name .. ": state of the fsm expected, " .. got(state), 3)
    end
    if not is_callable(hook) then
      error("rfsm." .. name .. ": function expected, " .. got(hook), 3)
    end
    own_plan(fsm).is_stale = true
    local hooks = state._def[field] and copy_list(state._def[field]) or {}
    hooks[#hooks + 1] = hook
    state._def[field] = hooks
    go_in_detail(fsm)
  end

  --- Have `hook(fsm, state)` called each time `state` is entered, before its entry.
  --
  -- For extensions: unlike a wrapped entry it stays when a tool replaces `state.entry`.
  -- Its error is raised when the iteration is over.
  --
  ---@param fsm rfsm.Machine
  ---@param state rfsm.State
  ---@param hook fun(fsm: rfsm.Machine, state: rfsm.State)
  function rfsm.entry_hook_add(fsm, state, hook)
    check_machine(fsm, "entry_hook_add")
    add_state_hook(fsm, "entry_hook_add", "_entry_hooks", state, hook)
  end

  --- Have `hook(fsm, state)` called each time `state` is left, after its exit.
  ---@param fsm rfsm.Machine
  ---@param state rfsm.State
  ---@param hook fun(fsm: rfsm.Machine, state: rfsm.State)
  function rfsm.exit_hook_add(fsm, state, hook)
    check_machine(fsm, "exit_hook_add")
    add_state_hook(fsm, "exit_hook_add", "_exit_hooks", state, hook)
  end

  --- Have `hook(fsm, events)` called in each iteration before anything is chosen.
  --
  -- It may change the list of events. The machine's own `pre_step_hook` is among the
  -- hooks, and stays replaceable.
  --
  ---@param fsm rfsm.Machine
  ---@param hook fun(fsm: rfsm.Machine, events: any[])
  ---@param place? "before"|"after" the hooks that are there; default "after"
  function rfsm.pre_step_hook_add(fsm, hook, place)
    add_listed(fsm, "pre_step_hook_add", "_pre_hooks", hook, place)
  end

  --- Take a pre step hook away.
  ---@param fsm rfsm.Machine
  ---@param hook function
  ---@return boolean was_there
  function rfsm.pre_step_hook_rm(fsm, hook)
    check_machine(fsm, "pre_step_hook_rm")
    return hook_rm(fsm, "_pre_hooks", "pre_step_hook", hook)
  end

  --- Have `hook(fsm, events)` called at the end of each iteration.
  ---@param fsm rfsm.Machine
  ---@param hook fun(fsm: rfsm.Machine, events: any[])
  ---@param place? "before"|"after" the hooks that are there; default "after"
  function rfsm.post_step_hook_add(fsm, hook, place)
    add_listed(fsm, "post_step_hook_add", "_post_hooks", hook, place)
  end

  --- Take a post step hook away.
  ---@param fsm rfsm.Machine
  ---@param hook function
  ---@return boolean was_there
  function rfsm.post_step_hook_rm(fsm, hook)
    check_machine(fsm, "post_step_hook_rm")
    return hook_rm(fsm, "_post_hooks", "post_step_hook", hook)
  end

  --- Have `hook(fsm)` called when the machine is reset: for what an extension keeps.
  ---@param fsm rfsm.Machine
  ---@param hook fun(fsm: rfsm.Machine)
  ---@param place? "before"|"after" the hooks that are there; default "after"
  function rfsm.reset_hook_add(fsm, hook, place)
    add_listed(fsm, "reset_hook_add", "_reset_hooks", hook, place)
  end

  --- Take a reset hook away.
  ---@param fsm rfsm.Machine
  ---@param hook function
  ---@return boolean was_there
  function rfsm.reset_hook_rm(fsm, hook)
    check_machine(fsm, "reset_hook_rm")
    return hook_rm(fsm, "_reset_hooks", nil, hook)
  end
end

-- Merge: a new element of a live machine --------------------------------------

do
  -- Is a leaf being left, or not entered yet? It may be any that is to be entered.
  local function is_in_transition(fsm)
    return fsm._at and not (fsm._at == true and fsm._leaf)
  end

  -- Has `parent` a member under that key? A program is one.
  local function is_taken(parent, id)
    return id ~= nil and (rawget(parent, id) or rawget(parent._def, id)) ~= nil
  end

  local function name_obstacle(parent, kind, id)
    if id == nil and kind ~= "transition" then
      return "a " .. kind .. " needs a name"
    elseif id ~= id then
      return "a name expected, got NaN"
    elseif is_taken(parent, id) then
      return ("'%s' has a member '%s' already"):format(parent._fqn, text_of(id))
    end
  end

  -- Is `state` the state `other`, or inside of it?
  local function is_inside(state, other)
    while state ~= other and state._parent ~= state do state = state._parent end
    return state == other
  end

  -- Why `obj` cannot become a member of `parent`; nil when it can.
  local function merge_obstacle(fsm, parent, obj, id)
    if not is_state_of(fsm, parent) then
      return "parent: a state of the fsm expected, " .. got(parent)
    end
    local kind = kind_of(obj)
    if not kind then return "state, transition or connector expected, " .. got(obj) end
    local obstacle = name_obstacle(parent, kind, id)
    if obstacle then return obstacle end
    if is_live(obj) and is_inside(parent, obj) then
      return ("'%s' cannot contain itself"):format(obj._fqn)
    end
    if kind == "transition" or not parent._def._is_leaf then return nil end
    if parent._mode ~= "inactive" then
      return ("'%s' is an active leaf state"):format(parent._fqn)
    elseif is_in_transition(fsm) then
      return ("'%s' is a leaf state, while a transition is taken"):format(parent._fqn)
    end
  end

  -- Clones `obj` into its place in the plan, the state `parent`.
  local function attach(build, parent, obj, id)
    if is_trans(obj) then
      if parent._is_leaf then
        add(build.warnings, parent._fqn, "a transition inside a leaf state")
      end
      parent[id] = clone_transition(build, obj, parent, id)
      return
    end
    if parent._is_leaf and parent.doo then
      add(build.problems, parent._fqn .. ".doo", "only a leaf state can have a doo")
    end
    local first = #build.nodes + 1
    parent[id] = clone_node(build, kind_of(obj), obj, parent, id)
    parent._is_leaf = false
    clone_below(build, first)
  end

  -- Transitions to a leaf that has become a composite end at its `initial` now.
  local function find_new_entrances(build, parent)
    local entrances = {}
    for _, tr in ipairs(build.transitions) do
      if tr.tgt == parent then entrances[tr] = find_entrance(build, tr, parent) end
    end
    return entrances
  end

  -- Forgets what stands in the list of the plan, and in that of the machine, from
  -- number `first` on.
  local function truncate(defs, own, first)
    for i = #defs, first, -1 do defs[i], own[i] = nil, nil end
  end

  -- Takes out again what stands in plan and machine from the given numbers on.
  local function undo_merge(fsm, build, parent, id, first_node, first_transition)
    parent._def[id] = nil
    for _, connector in ipairs(build.created) do connector._parent.initial = nil end
    parent._def._is_leaf = not has_nodes(parent._def)
    truncate(build.nodes, fsm._nodes, first_node)
    truncate(build.transitions, fsm._transitions, first_transition)
  end

  --- Add a state, connector or transition to a live machine.
  --
  -- From the next iteration on the machine behaves as if it had been there at `init`.
  -- Nothing changes when it cannot be added.
  --
  ---@param fsm rfsm.Machine
  ---@param parent rfsm.State the state of the machine that gets it
  ---@param obj rfsm.State|rfsm.Connector|rfsm.Transition it is cloned, as `init` does
  ---@param id? string name, which only a transition may lack
  ---@return boolean is_merged
  ---@return string? reason why not
  function rfsm.fsm_merge(fsm, parent, obj, id)
    check_machine(fsm, "fsm_merge")
    local obstacle = merge_obstacle(fsm, parent, obj, id)
    if obstacle then return false, "rfsm.fsm_merge: " .. obstacle end
    if id == nil then id = #parent._def + 1 end
    local plan = own_plan(fsm)
    go_in_detail(fsm)
    local first_node, first_transition = #plan.nodes + 1, #plan.transitions + 1
    local build = new_build(plan)
    attach(build, parent._def, obj, id)
    resolve(build, first_transition)
    local entrances = find_new_entrances(build, parent._def)
    local problems = lines_of(build.problems)
    if not problems[1] then
      copy_tables(fsm, build.with_tables)
      problems = preprocess(fsm, parent[id])
    end
    if problems[1] then
      undo_merge(fsm, build, parent, id, first_node, first_transition)
      return false, summary("rfsm.fsm_merge", problems)
    end
    for tr, entrance in pairs(entrances) do -- any order: each once
      tr.tgt, tr._lca, tr._entries = entrance, false, false
    end
    tell_created(fsm, build.created)
    finish(fsm, build.warnings, first_node)
    if not fsm._at then raise_failure(fsm) end
    return true
  end
end

-- Names -----------------------------------------------------------------------

-- Fields that are modules of their own, loaded on first use. Loading them changes no
-- machine.
local FIELDS = { seqand = "rfsm_seqand", pp = "rfsmpp" }

local function load_field(_, name)
  local module = FIELDS[name] and require and require(FIELDS[name])
  if module then rawset(rfsm, name, module) end
  return module
end

setmetatable(rfsm, { __index = load_field })

-- Finds the older names of modules. They are files in compat/ beside this file, in a
-- checkout; an installation has them beside the modules.
local function find_old_name(name)
  if not find(name, "^rfsm") then return nil end
  local file = "compat/" .. name:gsub("%.", "/") .. ".lua"
  for folder in rawget(_G, "package").path:gmatch("([^;]*)%?%.lua") do
    local chunk = loadfile(folder .. file)
    if chunk then return chunk, folder .. file end
  end
end

-- Makes this core and the older names known to `require`.
local function register(package)
  local searchers = package.searchers or package.loaders
  if searchers and loadfile and not searchers.rfsm then
    searchers.rfsm = find_old_name -- marks the list: one searcher is enough
    searchers[#searchers + 1] = find_old_name
  end
  if package.loaded and not package.loaded.rfsm then package.loaded.rfsm = rfsm end
end

register(rawget(_G, "package") or {}) -- a sandbox may have none
if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm", rfsm) end

return rfsm
