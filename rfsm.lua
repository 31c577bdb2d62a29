--- Statecharts in pure Lua: load, check, compile and run a model.
--
-- A model is a tree of plain tables, marked by `rfsm.state`, `rfsm.trans` and
-- `rfsm.conn`. `rfsm.init` checks it, reports every mistake with its location, and
-- makes an independent machine of it. `rfsm.send_events` sends events to the machine.
-- The machine advances only in calls of `rfsm.step` and `rfsm.run`; no call waits.
--
-- The file reads in the order the data flows: model elements, load, check, clone,
-- resolve, compile, machine, report, run, build, use, merge, names. An FQN is a fully
-- qualified name ("root.a.b"). An iteration is one turn of the loop inside `step`. The
-- file is complete: rfsm/fast.lua only makes machines faster.
--
-- @module rfsm
-- @license BSD-3-Clause

local error, getmetatable, ipairs = error, getmetatable, ipairs
local next, pairs = next, pairs
local pcall, rawequal, rawget, rawset, select = pcall, rawequal, rawget, rawset, select
local setmetatable, tostring, type = setmetatable, tostring, type
local concat, insert = table.concat, table.insert
local remove, sort = table.remove, table.sort
local huge = 1 / 0

-- Returns a global, or a field of a global table; nil if a sandbox does not have it.
local function find_global(name, field)
  local value = rawget(_G, name)
  if not field then return value end
  return type(value) == "table" and rawget(value, field) or nil
end

local coroutine, loadfile = find_global "coroutine", find_global "loadfile"
local loadstring = find_global "loadstring" or find_global "load"

local getinfo = find_global("debug", "getinfo")
local _, require = pcall(function() return require end) -- a bundler may replace it

-- LuaJIT 2.1.0-beta3 sometimes skips keys in a traversal that it has compiled.
-- Functions with such a traversal are given to `interpret`, and are never compiled.
local interpret = find_global("jit", "off") or function() end

---@class rfsm
---@field seqand fun(t: table): rfsm.State
---@field pp table the module rfsmpp
local rfsm = { _VERSION = "rfsm 1.0.0" }

-- Model elements: constructors, predicates, order -----------------------------

local State, Transition = { rfsm = "state" }, { rfsm = "transition" }
local Connector = { rfsm = "connector" }
local CLASSES = { state = State, transition = Transition, connector = Connector }

local Machine = { rfsm = "state", __eq = rawequal, rfsm_copy = rfsm }

--- Return the kind of a model element, or nil for any other value, for extensions.
--
-- A table of another library is an element, too, if its metatable has a true field
-- `rfsm` and its method `type` returns a kind.
--
---@param value any
---@return "state"|"transition"|"connector"|nil kind
function rfsm.kind_of(value)
  local class = getmetatable(value)
  local mark = type(class) == "table" and rawget(class, "rfsm")
  if not mark then return nil end
  if CLASSES[mark] then return mark end
  local ok, kind = pcall(function() return value:type() end)
  return ok and CLASSES[kind] and kind or nil
end

local kind_of = rfsm.kind_of

-- Where the tables of a model were made: table -> "file:line".
local made_at = setmetatable({}, { __mode = "k" })

local define

do
  local this_file = getinfo and getinfo(1, "S").short_src
  local knows_tail_calls = getinfo ~= nil and pcall(getinfo, 1, "t")

  -- Records the line that called the constructor at stack level `level`. After a tail
  -- call nothing is recorded, because the stack frame of the caller is gone.
  local function note_caller(t, level)
    if not getinfo then return end
    if knows_tail_calls and getinfo(level, "t").istailcall then return end
    local caller = getinfo(level + 1, "Sl")
    if caller and caller.currentline > 0 and caller.short_src ~= this_file then
      local file = caller.source:match("^@(.*)") or caller.short_src -- at most 60 bytes
      made_at[t] = ("%s:%d"):format(file, caller.currentline)
    end
  end

  --- Record where an element was made, for constructors in extensions.
  ---@param t table the element
  ---@param level integer stack level, as for `error`: 2 is the constructor's caller
  function rfsm.note_location(t, level)
    made_at[t] = nil
    note_caller(t, level + 1)
  end

  -- Returns a metatable for elements that inherit from `base`, a state or transition.
  local function heir_class(base)
    local class = getmetatable(base)
    return {
      rfsm = class.rfsm, type = class.type, new = class.new, __index = base,
      __tostring = class.__tostring,
    }
  end

  -- Makes a class its own constructor: X{...} or X:new{...} marks a table as an element
  -- of class X. An element made by base:new{...} inherits from the element `base`.
  function define(class, name)
    local function mark(base, t, level)
      if type(t) ~= "table" then
        error("rfsm." .. name .. ": table expected, got " .. type(t), level + 1)
      end
      if rawget(t, "_parent") ~= nil and kind_of(t) then return t end -- in a machine
      note_caller(t, level + 1)
      return setmetatable(t, base == class and class or heir_class(base))
    end
    class.__index = class
    function class.new(base, t) return (mark(base, t, 2)) end
    function class.type() return class.rfsm end
    return setmetatable(class, {
      __call = function(_, t) return (mark(class, t, 2)) end,
    })
  end
end

--- Mark a table as a state.
--
-- `sista`, `csta`, `simple_state` and `composite_state` are the same function.
-- `base:new{...}` makes a state that inherits callbacks and data from the state `base`.
--
-- @usage
--    local on = rfsm.state { entry = function() lamp(true) end }
--
---@type rfsm.StateConstructor
rfsm.state = define(State, "state")
rfsm.sista, rfsm.csta = rfsm.state, rfsm.state
rfsm.simple_state, rfsm.composite_state = rfsm.state, rfsm.state

--- Mark a table as a transition; `transition` is the same function.
---@type rfsm.TransitionConstructor
rfsm.trans = define(Transition, "trans")
rfsm.transition = rfsm.trans

--- Mark a table as a connector; `connector` is the same function.
---@type rfsm.ConnectorConstructor
rfsm.conn = define(Connector, "conn")
rfsm.connector = rfsm.conn

--- Suspend a doo until the next doo cycle; pass `true` if the doo is idle.
---@type fun(idle?: boolean): rfsm.Machine, rfsm.State, "doo"
rfsm.yield = find_global("coroutine", "yield")

--- Is `key` reserved for the engine: a text that begins with an underscore?
---@param key any
---@return boolean
function rfsm.is_meta(key) return type(key) == "string" and key:byte() == 95 end

--- Is `value` a state?
---@param value any
---@return boolean
function rfsm.is_state(value) return kind_of(value) == "state" end

--- Is `value` a transition?
---@param value any
---@return boolean
function rfsm.is_trans(value) return kind_of(value) == "transition" end

--- Is `value` a connector?
---@param value any
---@return boolean
function rfsm.is_conn(value) return kind_of(value) == "connector" end

--- Is `value` a state, a transition or a connector?
---@param value any
---@return boolean
function rfsm.is_fsmobj(value) return kind_of(value) ~= nil end

--- Is `value` a state or a connector?
---@param value any
---@return boolean
function rfsm.is_node(value)
  local kind = kind_of(value)
  return kind == "state" or kind == "connector"
end

local is_meta, is_node, is_state = rfsm.is_meta, rfsm.is_node, rfsm.is_state

local function has_nodes(state)
  for key, value in pairs(state) do -- any order: one node is enough
    if not is_meta(key) and is_node(value) then return true end
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
function rfsm.is_root(value) return rawequal(getmetatable(value), Machine) end

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

--- Return the kind of a model element in one or two letters.
---@param value any
---@return "CS"|"LS"|"TR"|"c"|nil letters composite, leaf, transition, connector
function rfsm.fsmobj_tochar(value)
  local kind = kind_of(value)
  if kind == "state" then return has_nodes(value) and "CS" or "LS" end
  return kind == "transition" and "TR" or kind == "connector" and "c" or nil
end

--- Can `value` be called?
---@param value any
---@return boolean
function rfsm.is_callable(value)
  if type(value) == "function" then return true end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") ~= nil
end

-- A host may have set a locale: then `format`, `tonumber` and `..` have its decimal
-- point, and `<` compares texts in the order of its dictionaries.

--- Return a number as text, with a point in every locale.
---@param number number
---@param format? string of a number without other text ("%.14g")
---@return string
function rfsm.number_text(number, format)
  return ((format or "%.14g"):format(number):gsub("[^%d%l+-]+", "."))
end

--- Return the number that a text with a point means in every locale; nil if it is none.
---@param text any
---@return number?
function rfsm.number_of(text)
  if type(text) ~= "string" then return type(text) == "number" and text or nil end
  if text:find("[^%w%s.+-]") then return nil end
  local point = ("%.1f"):format(0.5):sub(2, -2)
  return find_global "tonumber"((text:gsub("%.", point)))
end

--- Does a text come before another one? Bytes decide, in every locale.
---@param a string
---@param b string
---@return boolean
function rfsm.text_before(a, b)
  local small, capital = "a", "B"
  if capital < small then return a < b end -- as bytes
  for i = 1, #a do
    local byte, other = a:byte(i), b:byte(i)
    if byte ~= other then return other ~= nil and byte < other end
  end
  return #a < #b
end

local text_before = rfsm.text_before

--- Return any value as text; never raise an error. Numbers look the same on every Lua.
---@param value any
---@return string
function rfsm.text_of(value)
  local kind = type(value)
  if kind == "string" then return value end
  if kind == "number" then return rfsm.number_text(value) end
  local ok, text = pcall(tostring, value)
  return ok and type(text) == "string" and text or kind
end

local is_callable, text_of = rfsm.is_callable, rfsm.text_of

-- The predicates that `rfsm.named` has made: predicate -> name, and name -> predicate.
local event_names = setmetatable({}, { __mode = "k" })
local predicates = setmetatable({}, { __mode = "v" })

--- Return a predicate for `events` that accepts tables whose field `name` is `name`.
--
-- Such events carry data: `rfsm.send_events(fsm, { name = "e_paid", amount = 12 })`.
-- Equal names give the same predicate; `rfsm.event_name` returns a predicate's name.
--
---@param name string
---@return fun(event: any): boolean predicate
function rfsm.named(name)
  if type(name) ~= "string" then
    error("rfsm.named: name of an event expected, got " .. type(name), 2)
  end
  local predicate = predicates[name]
  if not predicate then
    predicate = function(event)
      return type(event) == "table" and rawequal(rawget(event, "name"), name)
    end
    predicates[name], event_names[predicate] = predicate, name
  end
  return predicate
end

--- Return the name that a predicate of `rfsm.named` accepts, nil for any other value.
---@param predicate any
---@return string? name
function rfsm.event_name(predicate) return event_names[predicate] end

--- Return an event or predicate of a transition as text: its name if it has one.
---@param event any
---@return string
function rfsm.event_text(event)
  local has_name = type(event) == "table" and not getmetatable(event)
  return event_names[event] or text_of(has_name and event.name or event)
end

local function list_text(events)
  local texts = {}
  for i = 1, #events do texts[i] = rfsm.event_text(events[i]) end
  return concat(texts, ", ")
end

local function end_text(node)
  local kind = kind_of(node)
  return kind and kind ~= "transition" and (node._fqn or kind) or text_of(node)
end

-- Example: state root.a (active)
function State.__tostring(state)
  local fqn, mode = state._fqn, state._mode
  return "state" .. (fqn and " " .. fqn or "") .. (mode and " (" .. mode .. ")" or "")
end

function Connector.__tostring(connector)
  return "connector" .. (connector._fqn and " " .. connector._fqn or "")
end

function Machine.__tostring(fsm)
  return "machine, active: " .. (fsm._act_leaf and fsm._act_leaf._fqn or "<none>")
end

-- Example: T={ src='a', tgt='b', pn=3, events='x, y' }. After init the ends are FQNs.
function Transition.__tostring(tr)
  local text = "T={ src='" .. end_text(tr.src) .. "', tgt='" .. end_text(tr.tgt) .. "'"
  local events = type(tr.events) == "string" and { tr.events } or tr.events
  if tr.pn then text = text .. ", pn=" .. text_of(tr.pn) end
  if type(events) == "table" and events[1] ~= nil then
    text = text .. ", events='" .. list_text(events) .. "'"
  end
  return text .. " }"
end

-- Orders keys: numbers ascending, then all others by their text.
local function key_before(a, b)
  local kind, other = type(a), type(b)
  if kind == "number" and other == "number" then return a < b end
  if kind == "number" or other == "number" then return kind == "number" end
  return text_before(text_of(a), text_of(b))
end

--- Return the keys of a table, numbers ascending, then others by text, for extensions.
---@param t table
---@param pred? fun(value: any, key: any): boolean true for the keys to return
---@return any[] keys
function rfsm.sorted_keys(t, pred)
  local keys = {}
  for key, value in next, t do -- any order: sorted
    if not pred or pred(value, key) then keys[#keys + 1] = key end
  end
  sort(keys, key_before)
  return keys
end

local sorted_keys = rfsm.sorted_keys
interpret(sorted_keys)
interpret(has_nodes)

local NONE = {}

local function append(list, more)
  for i = 1, #more do list[#list + 1] = more[i] end
  return list
end

-- Load ------------------------------------------------------------------------

local run_chunk

do
  -- Returns the hint for the result of a chart that is no state. The metatable of a
  -- system has one of its own.
  local function chart_hint(model)
    if model == nil then return " (a chart ends with: return rfsm.state{...})" end
    if type(model) ~= "table" then return "" end
    local class = getmetatable(model)
    return type(class) == "table" and rawget(class, "rfsm_hint")
      or " (did you mean: return rfsm.state{...}?)"
  end

  -- Runs the chunk of a chart and returns its root state. After a tail call, as in
  -- `return rfsm.state{...}`, the line of the root is not known: line 1 is recorded.
  function run_chunk(chunk, file, where, accepts)
    local model = chunk(file)
    if accepts and accepts(model) then return model end
    if is_state(model) then
      made_at[model] = made_at[model] or file and file .. ":1"
      return model
    end
    error(where .. " found." .. chart_hint(model), 0)
  end
end

--- Load a model from a file that returns it.
--
-- @usage
--    local fsm = rfsm.init(rfsm.load("examples/hello_world.lua"))
--
-- @raise when `file` is no text, or the file cannot be read, fails or returns no state
---@param file string
---@param accepts? fun(value: any): boolean true for allowed results that are no states
---@return rfsm.Model model
---@nodiscard
function rfsm.load(file, accepts)
  if type(file) ~= "string" then
    error("rfsm.load: file name expected, got " .. type(file), 2)
  end
  if not loadfile then error("rfsm.load: there is no loadfile here", 2) end
  local chunk, problem = loadfile(file)
  if not chunk then
    local hint = loadfile(file .. ".lua") and (" (did you mean '%s.lua'?)"):format(file)
    error("rfsm.load: " .. problem .. (hint or ""), 0)
  end
  return run_chunk(chunk, file, "rfsm.load: no valid rfsm in file '" .. file .. "'",
    accepts)
end

--- Load a model from a Lua source text that returns it.
-- @raise when the text does not compile, fails or returns no state
---@param text string Lua source
---@param chunkname? string name of the text in error messages
---@return rfsm.Model model
---@nodiscard
function rfsm.load_str(text, chunkname)
  if type(text) ~= "string" then
    error("rfsm.load_str: string expected, got " .. type(text), 2)
  end
  local chunk, problem = loadstring(text, chunkname)
  if not chunk then error("rfsm.load_str: failed to load chunk: " .. problem, 0) end
  return run_chunk(chunk, nil, "rfsm.load_str: no valid rfsm in '"
    .. (chunkname or "string") .. "'")
end

-- Check: every mistake in the model, each with its location --------------------
--
-- A check never raises an error. It appends to one of two lists of the `rfsm.Build`:
-- `problems`, which make `init` fail, or `warnings`. `init` sorts both by location.

-- Returns a module; nil if it is not installed.
local function find_module(name)
  if type(require) ~= "function" then return nil end
  local ok, module = pcall(require, name)
  if ok then return module end
  if not text_of(module):find("module '" .. name .. "' not found", 1, true) then
    error(module, 0)
  end
end

local advice

-- Returns the hint of rfsm/advice.lua on a topic, or "" if this file is missing.
local function advise(topic, ...)
  if advice == nil then advice = find_module("rfsm.advice") or false end
  if not advice then return "" end
  return advice[topic](...)
end

--- The working data with which one call of `init` or `fsm_merge` makes a plan.
---@class rfsm.Build
---@field plan rfsm.Plan the result: the structure of the machine
---@field problems { file?: string, line: string }[]
---@field warnings { file?: string, line: string }[]
---@field created { line: string }[] a message for each `initial` that was created
---@field mounts table<table, rfsm.Def[]> node of the model -> its definitions
---@field fsm rfsm.Machine? the machine that `fsm_merge` extends; nil in `init`

--- The definition of a node or transition: all that is known before a machine runs.
--
-- All machines of a model share the definition. An element of a machine is a table with
-- the data of this machine, such as the mode of a state, and inherits from `proto`.
--
---@class rfsm.Def
---@field kind "state"|"transition"|"connector"
---@field index integer its position among the nodes or transitions of the plan
---@field id string|integer the name, or the position of a transition without a name
---@field parent rfsm.Def the state that contains it; for the root, the root itself
---@field model table the element of the model from which it was made
---@field data any[] callbacks and the user's data: key, value, key, value ...
---@field proto table the metatable of its elements in all machines
---@field fqn string the fully qualified name (nodes only)
---@field is_leaf boolean true for a state that contains no nodes
---@field otrs rfsm.Def[] the outgoing transitions, in search order (nodes only)
---@field src rfsm.Def the source; only transitions have `src`, `tgt`, `events`, `pn`

-- Returns the name of an element for messages: an FQN, or root.trans[2] (a -> b). If
-- `field` is given, the name includes it: root.trans[2].events (a -> b).
local function name_of(def, field)
  local suffix, key = field and "." .. field or "", text_of(def.id)
  if def.kind ~= "transition" then return def.fqn .. suffix end
  if type(def.id) == "number" then key = "trans[" .. key .. "]" end
  local name, model = def.parent.fqn .. "." .. key .. suffix, def.model
  if type(model.src) ~= "string" or type(model.tgt) ~= "string" then return name end
  return ("%s (%s -> %s)"):format(name, model.src, model.tgt)
end

local function add(list, def, field, text, ...)
  if select("#", ...) > 0 then text = text:format(...) end
  list[#list + 1] = {
    file = made_at[def.model], line = name_of(def, field) .. ": " .. text,
  }
end

local CALLBACKS = {
  state = { entry = true, exit = true, doo = true }, connector = {},
  transition = { guard = true, effect = true },
}

-- Adds the warning of rfsm/advice.lua on a topic, if the file has one. The caller has
-- found something suspicious already, so most charts do not load the file.
local function add_advice(list, topic, def, ...)
  local text, field = advise(topic, def, ...)
  if text ~= "" then add(list, def, field, text) end
end

--- Describe an unexpected value: "got string 'led'", "got state", for extensions.
---@param value any
---@return string text
function rfsm.got(value)
  local kind = kind_of(value) or type(value)
  if kind == "string" then return "got string '" .. value .. "'" end
  if kind == "number" then return "got number " .. text_of(value) end
  return "got " .. kind
end

local got = rfsm.got

local HOOKS = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook", "gettime" }
local PRINTERS = { "dbg", "info", "warn", "err" }

local function check_callable(build, def, field, value)
  if value and not is_callable(value) then
    add(build.problems, def, field, "function expected, " .. got(value))
  end
end

-- Clone: a definition for each position of a node -------------------------------

--- Does a value belong to another copy of this library? For extensions: the metatable
--- of their objects has the field `rfsm_copy`, which is this module.
---@param value any
---@return boolean
function rfsm.is_foreign(value)
  local class = type(value) == "table" and getmetatable(value)
  local copy = type(class) == "table" and rawget(class, "rfsm_copy")
  return type(copy) == "table" and not rawequal(copy, rfsm)
end

--- Return the model of a machine, or of an element of a machine, for extensions.
---@param value any
---@return any model or `value` itself, if it is not a part of a machine
function rfsm.model_of(value)
  local class = getmetatable(value)
  if rawequal(class, Machine) then return rfsm.structure_of(value).model end
  local def = type(class) == "table" and rawget(class, "_%def")
  return def and def.model or value
end

--- Return the FQN of a transition's target in the model, for extensions.
---@param tr rfsm.Transition a transition of a machine
---@return string fqn "internal" for an internal transition
function rfsm.target_of(tr)
  local def = tr["_%def"]
  return def.is_internal and "internal" or def.tgt.fqn
end

local model_of = rfsm.model_of

local FOREIGN = "it belongs to another copy of rfsm (give the model, not the machine)"

-- Is `value` a node of the machine, and of the given kind? Without `kind`, of any kind.
local function is_node_of(fsm, value, kind)
  local value_kind = kind_of(value)
  local def = value_kind and value["_%def"]
  return type(def) == "table" and (not kind or value_kind == kind)
    and rawequal(fsm._nodes[def.index], value)
end

-- Adds `def` to the definitions of its model, because a model may be used repeatedly.
local function note_mount(build, def)
  local mounts = build.mounts[def.model] or {}
  mounts[#mounts + 1], build.mounts[def.model] = def, mounts
end

local clone_below, new_node, new_transition

do
  local ROOT_FIELDS = {}
  for _, name in ipairs(PRINTERS) do ROOT_FIELDS[name] = true end
  for _, name in ipairs(HOOKS) do ROOT_FIELDS[name] = true end

  -- Public fields of the engine. If a model has a field with such a name, the field is
  -- not copied, because it is not the user's data.
  local API_FIELDS = {}
  for name in ("act_leaf actchild curq doo_co fqn fsm id initialized intq mode otrs "
    .. "parent"):gmatch("%S+") do
    API_FIELDS["_" .. name] = true
  end

  -- Checks the name of a node: a path can contain it, and it is no field of the parent.
  local function check_name(build, def)
    local name, parent = def.id, def.parent
    if type(name) ~= "string" then
      add(build.problems, def, nil, "a %s needs a name (name = ...)", def.kind)
    elseif name == "" or name:find("[.\\]") or is_meta(name) then
      add(build.problems, def, nil, "the name of a %s must not be empty, contain '.' "
        .. "or '\\' or start with '_'", def.kind)
    elseif CALLBACKS.state[name] or parent.parent == parent and ROOT_FIELDS[name] then
      add(build.problems, def, nil, "a %s cannot have this name, it is a field of "
        .. "every " .. (CALLBACKS.state[name] and "state" or "root"), def.kind)
    elseif name == "initial" and def.kind ~= "connector" then
      add(build.problems, def, nil, "connector expected, got %s", def.kind)
    end
  end

  -- Returns the events of a transition as a new list, or false if it has none. A model
  -- has one string, or a list without holes. Any value except NaN may be an event.
  local function check_events(build, def, events)
    if not events then return false end
    if type(events) == "string" then events = { events } end
    if type(events) ~= "table" or getmetatable(events) ~= nil then
      add(build.problems, def, "events", "list of events or a string expected, "
        .. got(events))
      return false
    end
    local list, count = {}, 0
    for _ in pairs(events) do count = count + 1 end -- any order: only counted
    for i = 1, count do
      local event = events[i]
      if event == nil then
        add(build.problems, def, "events", "list of events expected, got a table with "
          .. "holes or keys" .. advise("list", events))
        return false
      elseif event ~= event then
        add(build.problems, def, ("events[%d]"):format(i), "an event cannot be NaN")
      end
      list[i] = event
    end
    if count == 0 then
      add(build.warnings, def, "events", "an empty list, any event triggers it (is a "
        .. "name in it nil? if any event is meant, leave it out)")
    end
    return count > 0 and list
  end

  -- Returns the fields of a model element. An element made by base:new{...} inherits
  -- callbacks and data from `base`, but no nodes and no transitions.
  local function fields_of(model)
    local class = getmetatable(model)
    local base = class.__index
    if CLASSES[class.rfsm] and base == class or not kind_of(base) then return model end
    local fields = {}
    for key, value in pairs(fields_of(base)) do -- any order: independent entries
      if not kind_of(value) then fields[key] = value end
    end
    for key, value in pairs(model) do fields[key] = value end -- any order: a copy
    return fields
  end

  local function new_def(list, kind, model, parent, key)
    local def = {
      kind = kind, index = #list + 1, id = key, parent = parent, model = model,
      data = NONE, proto = false,
    }
    list[def.index] = def
    return def
  end

  local function add_member(parent, key, def)
    if parent.members == NONE then parent.members = {} end
    parent.members[key] = def
  end

  -- Makes the definition of a node. `clone_below` adds its fields and members later.
  function new_node(build, kind, model, parent, key)
    local def = new_def(build.plan.nodes, kind, model_of(model), parent or false, key)
    def.fqn = parent and parent.fqn .. "." .. text_of(key) or key
    def.depth = parent and parent.depth + 1 or 0
    def.parent = parent or def
    def.is_leaf, def.otrs, def.members = kind == "state", NONE, NONE
    note_mount(build, def)
    if parent then
      add_member(parent, key, def)
      parent.is_leaf = false
      check_name(build, def)
    end
    return def
  end

  -- Is the model of `def` also the model of an ancestor? Then cloning would never end.
  local function is_inside_itself(def)
    local above = def
    while above.parent ~= above do
      above = above.parent
      if above.model == def.model then return true end
    end
    return false
  end

  local function add_datum(def, key, value)
    if def.data == NONE then def.data = {} end
    append(def.data, { key, value })
  end

  local function check_datum(build, def, key, value)
    if def.kind == "transition" or type(value) == "table" or is_callable(value) then
      add_advice(build.warnings, "datum", def, key, value)
    end
  end

  -- Copies a field that is no node and no transition: a callback or the user's data.
  local function clone_field(build, def, key, value)
    if CALLBACKS[def.kind][key] then
      check_callable(build, def, key, value)
      if value then
        add_datum(def, key, value)
        if key == "doo" or key == "guard" then def[key] = value end
      elseif key == "guard" then
        add(build.warnings, def, nil, "its guard is false and counts as absent, it was "
          .. "made while the chart was loaded")
      end
    elseif key == "initial" and def.kind == "state" then
      add(build.problems, def, key, "connector expected, %s "
        .. "(rfsm.trans{ src='initial', tgt=... })", got(value))
    elseif not API_FIELDS[key] then
      add_datum(def, key, value)
      if def.parent ~= def or not ROOT_FIELDS[key] then
        check_datum(build, def, key, value)
      end
    end
  end

  local OWN_FIELDS = { src = true, tgt = true, events = true, pn = true }

  function new_transition(build, model, parent, key)
    model = model_of(model)
    local def = new_def(build.plan.transitions, "transition", model, parent, key)
    if type(key) ~= "number" and type(key) ~= "string" then
      add(build.problems, def, nil, "the key of a transition is a position or a name")
    elseif is_meta(key) then
      add(build.problems, def, nil, "the name of a transition must not start with '_'")
    elseif CALLBACKS.state[key] then
      add(build.problems, def, nil, "a transition cannot have this name, it is a field "
        .. "of every state")
    end
    for field, value in pairs(fields_of(model)) do -- any order: independent entries
      if not OWN_FIELDS[field] then clone_field(build, def, field, value) end
    end
    def.src, def.tgt, def.pn = model.src, model.tgt, model.pn or nil
    def.events = check_events(build, def, model.events)
    if def.pn and (type(def.pn) ~= "number" or def.pn ~= def.pn) then
      add(build.problems, def, "pn", "number expected, " .. got(def.pn))
      def.pn = nil
    end
    add_member(parent, key, def)
  end

  local function clone_node(build, def)
    local has_transition = false
    for key, value in pairs(fields_of(def.model)) do -- any order: sorted later
      local kind = kind_of(value)
      if not kind then
        clone_field(build, def, key, value)
      elseif rfsm.is_foreign(value) then
        add(build.problems, def, text_of(key), FOREIGN)
      elseif def.kind == "connector" then
        add(build.warnings, def, nil, "a connector holds no %s, '%s' is ignored", kind,
          text_of(key))
      elseif kind == "transition" then
        new_transition(build, value, def, key)
        has_transition = true
      else
        new_node(build, kind, value, def, key)
      end
    end
    if def.is_leaf and has_transition then
      add(build.warnings, def, nil, "a transition inside a leaf state%s",
        advise("plain_states", def.model))
    elseif def.doo and not def.is_leaf then
      add(build.problems, def, "doo", "only a leaf state can have a doo")
    end
  end

  for _, f in ipairs({ check_events, clone_node, fields_of, new_transition }) do
    interpret(f)
  end

  -- Adds fields and members to the nodes from number `first` on. New nodes are appended
  -- to the list of nodes, so that the loop reaches them, too.
  function clone_below(build, first)
    local nodes, i = build.plan.nodes, first
    while nodes[i] do
      if is_inside_itself(nodes[i]) then
        add(build.problems, nodes[i], nil, "a state cannot contain itself")
      else
        clone_node(build, nodes[i])
      end
      i = i + 1
    end
  end
end

-- Resolve: names become nodes, `e_done` gets the name of its source -------------

local find_entrance, resolve

-- Returns the innermost node that contains both nodes or is one of them.
local function find_lca(a, b)
  while a ~= b do
    if a.depth >= b.depth then a = a.parent else b = b.parent end
  end
  return a
end

do
  -- Returns the node at the path "a.b" below `def`. If there is no such node, returns
  -- nil and the reason, which may suggest a node from the list `all`.
  local function find_below(def, path, all)
    for name in (path .. "."):gmatch("([^.]*)%.") do
      local child = def.members[name]
      if not child or child.kind == "transition" then
        local value = def.model[name]
        if value ~= nil and not is_meta(name) then
          local kind = kind_of(value) or type(value)
          return nil, ("'%s.%s' is no state or connector but a %s%s"):format(def.fqn,
            name, kind, kind == "table" and " (did you mean rfsm.state{...}?)" or "")
        end
        return nil, ("no state or connector is named '%s' in '%s'%s"):format(name,
          def.fqn, advise("nearest_node", name, def, all, path))
      end
      def = child
    end
    return def
  end

  -- Returns the node that a name in a transition of `composite` refers to:
  -- (a) ".a.b" or "..a.b" is a path below the composite;
  -- (b) "a" is a member of the composite; "root" is the root, unless the composite has
  --     a member of this name;
  -- (c) "a.b" or "root.a.b" is a path below the root; "root.a" may also lead to the
  --     member "a" of a member "root", if the root has no member "a".
  local function find_named(build, composite, name)
    local all, relative = build.plan.nodes, name:match("^%.%.?([^.].*)$")
    local root = all[1]
    if relative then return find_below(composite, relative, all) end
    if not name:find(".", 1, true) then
      local def, reason = find_below(composite, name, all)
      if name == "root" then return def or root end
      return def, reason
    end
    if name:sub(1, 5) ~= "root." then return find_below(root, name, all) end
    local def, reason = find_below(root, name:sub(6), all)
    return def or root.members.root and find_below(root, name, all), reason
  end

  -- Returns the node for `ref`, which is a table of the model and not a name. If the
  -- model uses this table in several places, returns the node nearest to `composite`.
  local function find_mounted(build, composite, ref)
    local nearest, most, is_tie = nil, -1, false
    if build.fsm and is_node_of(build.fsm, ref) then
      return build.plan.nodes[ref["_%def"].index]
    end
    for _, mount in ipairs(build.mounts[model_of(ref)] or {}) do
      local depth = find_lca(composite, mount).depth
      if depth >= most then nearest, most, is_tie = mount, depth, depth == most end
    end
    if is_tie then
      return nil, "the table given stands in several places, use a name"
    end
    return nearest, not nearest and "the table given is no part of this model" or nil
  end

  -- Returns the node to which `src` or `tgt` refers, or nil and a reason.
  local function find_end(build, def, field)
    local ref = def[field]
    if type(ref) == "string" then
      local node, reason = find_named(build, def.parent, ref)
      return node, reason and ("%s '%s': %s"):format(field, ref, reason)
    elseif is_node(ref) then
      local node, reason = find_mounted(build, def.parent, ref)
      return node, reason and field .. ": " .. reason
    elseif ref == nil then
      return nil, field .. " is missing, the name of a state or connector expected"
        .. advise("other_word", def.model, field)
    end
    return nil, field .. ": name of a state or connector expected, " .. got(ref)
  end

  -- Makes the connector `initial` if a transition starts from it and none is declared.
  local function create_initial(build, def)
    local composite = def.parent
    if def.src ~= "initial" or composite.members.initial or composite.is_leaf then
      return
    end
    local connector = new_node(build, "connector", Connector {}, composite, "initial")
    made_at[connector.model] = made_at[def.model]
    build.created[#build.created + 1] = {
      line = "created undeclared connector " .. connector.fqn,
    }
  end

  -- Returns the node where a transition to `node` ends: for a composite, its `initial`.
  -- If the composite has no `initial`, adds a problem and returns nil.
  function find_entrance(build, def, node)
    if node.kind == "connector" or node.is_leaf then return node end
    local initial = node.members.initial
    if initial and initial.kind == "connector" then return initial end
    if node.parent == node then return nil end -- `check_root` reports it
    add(build.problems, def, nil, "tgt '%s': the composite has no initial transition "
      .. "(rfsm.trans{ src='initial', tgt=... })%s", node.fqn,
      advise("regions", node.model))
  end

  local function resolve_e_done(build, def)
    local events, src = def.events or {}, def.src
    for i = 1, #events do
      if events[i] == "e_done" then
        events[i] = "e_done@" .. src.fqn
        if not src.is_leaf then
          add(build.warnings, def, nil,
            "'e_done' never fires here, '%s' is no leaf state", src.fqn)
        end
      end
    end
  end

  -- Returns the target of a transition from `src`, or nil and a reason. For an internal
  -- transition returns `src`, nil and true.
  local function find_target(build, def, src)
    if def.tgt ~= "internal" or def.parent.members.internal then
      return find_end(build, def, "tgt")
    elseif src and src.kind == "connector" then
      return nil, "tgt 'internal': only a state has internal transitions"
    end
    return src, nil, true
  end

  -- Resolves the ends of a transition. Returns false if one of them is not found.
  local function resolve_transition(build, def)
    local src, src_reason = find_end(build, def, "src")
    if src and src.kind == "connector" then src.is_left = true end
    local tgt, tgt_reason, is_internal = find_target(build, def, src)
    if not def.parent.is_leaf then -- a leaf got a warning already
      if src_reason then add(build.problems, def, nil, src_reason) end
      if tgt_reason then add(build.problems, def, nil, tgt_reason) end
    end
    tgt = is_internal and src or tgt and find_entrance(build, def, tgt)
    if not (src and tgt) then return false end
    def.src, def.tgt, def.is_internal = src, tgt, is_internal
    resolve_e_done(build, def)
    return true
  end

  -- Resolves the transitions from number `first` on. Transitions with a wrong reference
  -- are dropped: inside a leaf they give only a warning, and `init` may succeed.
  function resolve(build, first)
    local transitions, kept = build.plan.transitions, first - 1
    for i = first, #transitions do create_initial(build, transitions[i]) end
    for i = first, #transitions do
      local def = transitions[i]
      transitions[i] = nil
      if resolve_transition(build, def) then
        kept = kept + 1
        transitions[kept], def.index = def, kept
      end
    end
  end
end

-- Compile: the structure becomes lists, shared by all machines of the model ------
--
-- At init only the outgoing transitions of each node are listed. Candidates and paths
-- are listed when they are first needed, so that unused parts take neither time nor
-- memory. Callbacks are not compiled: each is read when it is called.

--- The structure that machines of a model share.
---@class rfsm.Plan
---@field model rfsm.State the model from which it was made
---@field nodes rfsm.Def[] parents before children, the root first
---@field transitions rfsm.Def[]
---@field trail table|false all values in the model; false if one machine owns the plan
---@field variant rfsm.Plan|false the latest copy with changes by preproc functions
---@field order rfsm.Def[]? all definitions in the order of `mapfsm`, made on demand

local compile, compile_transition, line_to

do
  -- Is transition `a` of a node tried before `b`? Larger pn first; then the transition
  -- whose parent is less deep; then by FQN of the parent; then by position or name.
  local function tried_before(a, b)
    local a_pn, b_pn = a.pn or 0, b.pn or 0
    if a_pn ~= b_pn then return a_pn > b_pn end
    if a.parent.depth ~= b.parent.depth then return a.parent.depth < b.parent.depth end
    if a.parent ~= b.parent then return text_before(a.parent.fqn, b.parent.fqn) end
    return key_before(a.id, b.id)
  end

  -- Metatables for the `proto` of a definition, by kind. They add methods of the class.
  -- `tr.events` is a new list at each access, because machines share the definition's.
  local INHERITED = {
    state = { __index = State }, connector = { __index = Connector }, transition = {},
  }

  function INHERITED.transition.__index(proto, key)
    if key == "events" then return append({}, proto["_%def"].events or NONE) end
    if key == "_id" then return proto["_%def"].id end
    return Transition[key]
  end

  -- Makes the proto of a definition, the metatable from which its elements inherit.
  local function make_proto(def)
    local proto = def.proto or {
      ["_%def"] = def, rfsm = def.kind, __tostring = CLASSES[def.kind].__tostring,
      __eq = rawequal, -- so that the `__eq` of another value is never called
      __index = false,
    }
    if def.kind == "transition" then
      proto.pn, proto.guard, proto.effect = def.pn, false, false
    else
      proto._id, proto._fqn = def.id, def.fqn
    end
    proto.__index = proto
    def.proto = setmetatable(proto, INHERITED[def.kind])
    if def.is_leaf then
      def.done_event, def.choices = "e_done@" .. def.fqn, NONE
    end
  end

  -- Gives each node the list of its outgoing transitions, in search order, and gives
  -- each definition its proto. Returns the plan.
  function compile(plan)
    local nodes, transitions = plan.nodes, plan.transitions
    for i = 1, #nodes do
      nodes[i].otrs = NONE
      make_proto(nodes[i])
    end
    for i = 1, #transitions do
      local def, src = transitions[i], transitions[i].src
      if src.otrs == NONE then src.otrs = {} end
      src.otrs[#src.otrs + 1] = def
      for j = 1, def.events and #def.events or 0 do
        def.is_asked = def.is_asked or type(def.events[j]) == "function"
      end
      make_proto(def)
    end
    for i = 1, #nodes do
      if nodes[i].otrs[2] then sort(nodes[i].otrs, tried_before) end
    end
    nodes[1].plan = plan
    -- The path of the first entry begins here, and for a root without states ends here.
    nodes[1].entrance = { from = nodes[1], segments = NONE, entered = nodes[1] }
    return plan
  end

  -- Completes the definition of a transition on the first call, and returns it.
  -- `entries` are the states that are entered, outermost first. `lca` is the innermost
  -- state that contains both ends and stays active.
  function compile_transition(def)
    if def.connector ~= nil then return def end
    local tgt, entries = def.tgt, {}
    local lca = find_lca(def.src.parent, tgt.parent)
    local state = tgt.kind == "state" and tgt or tgt.parent
    if def.is_internal then lca, state = tgt, tgt end
    for i = state.depth - lca.depth, 1, -1 do
      entries[i], state = state, state.parent
    end
    def.lca, def.entries = lca, entries
    def.connector = tgt.kind == "connector" and tgt -- set last: it marks completion
    return def
  end

  -- Lists the states from the root to `leaf`.
  function line_to(leaf)
    local line, def = {}, leaf
    for i = leaf.depth + 1, 1, -1 do
      line[i], def = def, def.parent
    end
    return line
  end
end

local function new_plan(model, warnings, created)
  return {
    model = model, nodes = {}, transitions = {}, trail = false, warnings = warnings,
    created = created, variant = false,
  }
end

-- Returns a copy of a plan that the caller may change. Its definitions are copies in
-- the same order: parents before children.
local function copy_plan(plan)
  local copy = new_plan(plan.model, plan.warnings, plan.created)
  local nodes, transitions = copy.nodes, copy.transitions
  for i, def in ipairs(plan.nodes) do
    nodes[i] = {
      kind = def.kind, index = i, id = def.id, parent = false, model = def.model,
      data = def.data, proto = false, fqn = def.fqn, depth = def.depth,
      is_leaf = def.is_leaf, otrs = false, members = {}, doo = def.doo,
    }
    nodes[i].parent = nodes[def.parent.index]
    if i > 1 then nodes[i].parent.members[def.id] = nodes[i] end
  end
  for i, def in ipairs(plan.transitions) do
    transitions[i] = {
      kind = def.kind, index = i, id = def.id, parent = nodes[def.parent.index],
      model = def.model, data = def.data, proto = false, src = nodes[def.src.index],
      tgt = nodes[def.tgt.index], events = def.events, pn = def.pn,
      is_internal = def.is_internal, guard = def.guard,
    }
    transitions[i].parent.members[def.id] = transitions[i]
  end
  return copy
end

-- Calls f(t) for each table of a plan's model: elements, their bases, lists of events.
local function each_table(plan, f)
  local function visit(model)
    f(model)
    local base = getmetatable(model).__index
    if base ~= getmetatable(model) and kind_of(base) then visit(base) end
  end
  for _, def in ipairs(plan.nodes) do visit(def.model) end
  for _, def in ipairs(plan.transitions) do
    visit(def.model)
    if type(def.model.events) == "table" then f(def.model.events) end
  end
end

-- Records the keys and values of all tables of a model, in the order of `next`, so that
-- `is_current` finds changes. Each is a number in `ids`, because a comparison of the
-- values by `==` might call an `__eq`. A 0 ends a table.
local function make_trail(plan)
  local ids, n, tables, trail, plain = {}, 0, {}, {}, {}
  local function id_of(value)
    if value ~= value then return 0 end -- NaN never equals itself
    if not ids[value] then n, ids[value] = n + 1, n + 1 end
    return ids[value]
  end
  each_table(plan, function(t)
    tables[#tables + 1] = t
    for key, value in next, t do
      trail[#trail + 1], trail[#trail + 2] = id_of(key), id_of(value)
      if type(value) == "table" and not getmetatable(value) then
        plain[#plain + 1] = value
      end
    end
    trail[#trail + 1] = 0
  end)
  return { ids = ids, tables = tables, trail = trail, plain = plain }
end

-- Does the model have the same keys and values as when the plan was made?
local function is_current(plan)
  local noted = plan.trail
  local ids, tables, trail, at = noted.ids, noted.tables, noted.trail, 1
  for i = 1, #tables do
    for key, value in next, tables[i] do
      if ids[key] ~= trail[at] or ids[value] ~= trail[at + 1] then return false end
      at = at + 2
    end
    if trail[at] ~= 0 then return false end
    at = at + 1
  end
  for i = 1, #noted.plain do
    if getmetatable(noted.plain[i]) then return false end -- it is an element now
  end
  return true
end

interpret(make_trail, true)
interpret(is_current)

-- Machine: an instance of a plan ------------------------------------------------
--
-- A machine is a tree of plain tables. Raw fields are the children by name, transitions
-- by position or name, callbacks, `_parent`, `_otrs`, `_mode` and the user's data. Each
-- element inherits `_fqn`, `_id`, `events` and `pn` from its definition in the plan.
--
-- The configuration is kept only in these fields: `_mode` of each state, `_actchild` of
-- each active composite, and `_act_leaf` of the machine.

local function silent() end

local function no_events() return {} end

-- In a list of hooks OWN marks the place of the hook in a field of the machine, such as
-- `pre_step_hook`. A program may set this field at any time.
local function OWN() end

local OWN_ONLY = { OWN }

-- Fields that a machine inherits until it sets them.
local DEFAULTS = {
  rfsm = "state", type = State.type, new = State.new, _id = "root", _fqn = "root",
  dbg = silent, getevents = no_events, _entry_hooks = false, _exit_hooks = false,
  _reset_hooks = false, _path_hooks = false, _watch_hooks = false,
  _snapshot_hooks = false, _failure = false, _reset_wanted = false, _preparing = false,
  _emit = false, -- the function given to `set_emit`
  _cuts = 0, -- number of iterations that an error has ended
}

do
  -- Returns the function `emit` of a machine, which callbacks call.
  local function new_emit(f)
    return function(name, data)
      if type(name) ~= "string" then
        error("emit: name expected, got " .. type(name), 2)
      end
      f(name, data)
    end
  end

  DEFAULTS.emit = new_emit(silent)

  --- Have f(name, data) called when a callback of a machine or its regions emits.
  --
  -- For hosts. By default `emit` does nothing. Regions merged later are included.
  --
  ---@param fsm rfsm.Machine
  ---@param f fun(name: string, data: any)
  function rfsm.set_emit(fsm, f)
    rfsm.check_machine(fsm, "rfsm.set_emit")
    local emit = new_emit(f)
    for _, at in ipairs(rfsm.machines(fsm)) do
      if not is_state(at.machine.emit) then at.machine.emit = emit end
      at.machine._emit = f
    end
  end
end

-- The fields that a machine has from the start.
local function own_fields()
  return {
    _parent = false, _mode = "inactive", _otrs = false, _act_leaf = false,
    _intq = { "e_init_fsm" }, _curq = {}, _initialized = false,
    -- the structure
    ["_%def"] = false, _plan = false, _nodes = false, _transitions = {},
    -- the iteration, see "Run":
    --   _path       the path being taken, or the last one since `took_path` was called
    --   _ways       connector -> what the last search found there, see `note_of`
    --   _search     number of the current search
    --   _at         number of the action (or part of a doo cycle) that was begun last
    --   _hook       number of the step hook begun last; -1: getevents is not called yet
    --   _given      events that getevents has returned and that are in no list yet
    --   _outcome    of the last iteration: counted (as a step) | idle | free (events
    --               enabled no path: not counted) | refused (entry or step hook failed)
    --   _is_usual   false after an interrupt, error or reset: `iterate` calls `go_on`
    --   _is_lent    true if a callback may have kept the list of current events
    --   _is_cut     true if an error ended the iteration; the next step completes it
    --   _is_hooked  true once a step hook, path hook or getevents was set
    _phase = "idle", _path = false, _ways = {}, _search = 0,
    _outcome = "free", _at = 0, _hook = 0, _is_usual = false, _is_cut = false,
    _given = false, _is_lent = false,
    _is_hooked = false, _pre_hooks = OWN_ONLY, _post_hooks = OWN_ONLY,
  }
end

-- Functions given to `rfsm.borrows`: they do not keep the list of current events.
local borrowers = setmetatable({}, { __mode = "k" })

-- All machines, so that one access shows whether a value is a machine.
local machines = setmetatable({}, { __mode = "k" })

Machine.__index = DEFAULTS

-- These fields of a machine are absent until a program sets them, so that `__newindex`
-- is called for the assignment.
local STEP_HOOKS = { getevents = true, pre_step_hook = true, post_step_hook = true }

function Machine.__newindex(fsm, key, value)
  if STEP_HOOKS[key] and value then
    if not rfsm.is_callable(value) then
      error(key .. ": function expected, " .. got(value), 2)
    end
    fsm._is_hooked, fsm._is_usual = true, false
  end
  rawset(fsm, key, value)
end

-- Returns the value, or in place of a plain table a new one, to be filled later.
local function copy_of(copies, value, pending)
  if type(value) ~= "table" or getmetatable(value) ~= nil then return value end
  if not copies[value] then
    copies[value], pending[#pending + 1] = {}, value
  end
  return copies[value]
end

-- Copies nested plain tables. They wait in the list `pending`, so any depth is allowed.
local function clone_data(copies, value)
  local pending = {}
  local copy = copy_of(copies, value, pending)
  while pending[1] do
    local source = pending[#pending]
    pending[#pending] = nil
    for k, v in pairs(source) do -- any order: independent entries
      copies[source][copy_of(copies, k, pending)] = copy_of(copies, v, pending)
    end
  end
  return copy
end

interpret(clone_data)

local function give_data(element, def, copies)
  local data = def.data
  for i = 1, #data, 2 do
    local key, value = data[i], data[i + 1]
    if type(value) == "table" then value = clone_data(copies, value) end
    element[key] = value
  end
end

-- Makes the elements of a machine for the definitions with numbers from `first_node`
-- and `first_transition` on.
local function make_elements(fsm, plan, first_node, first_transition)
  local nodes, transitions, copies = fsm._nodes, fsm._transitions, {}
  if first_node == 2 then give_data(fsm, plan.nodes[1], copies) end
  for i = first_node, #plan.nodes do
    local def = plan.nodes[i]
    local parent = nodes[def.parent.index]
    local node = def.kind == "state"
      and { _parent = parent, _mode = "inactive", _otrs = false }
      or { _parent = parent, _otrs = false }
    if def.data[1] ~= nil then give_data(node, def, copies) end
    nodes[i] = setmetatable(node, def.proto)
    rawset(parent, def.id, node)
  end
  for i = first_transition, #plan.transitions do
    local def = plan.transitions[i]
    local parent = nodes[def.parent.index]
    local src, tgt = nodes[def.src.index], nodes[def.tgt.index]
    local tr = { src = src, tgt = tgt, _parent = parent, _fsm = fsm }
    if def.data[1] ~= nil then give_data(tr, def, copies) end
    transitions[i] = setmetatable(tr, def.proto)
    rawset(parent, def.id, tr)
  end
end

local function list_otrs(fsm, plan)
  local transitions, nodes = fsm._transitions, fsm._nodes
  for i = 1, #plan.nodes do
    local otrs = plan.nodes[i].otrs
    local list = { otrs[1] and transitions[otrs[1].index] } -- most nodes have one
    for j = 2, #otrs do list[j] = transitions[otrs[j].index] end
    nodes[i]._otrs = list
  end
end

-- Makes a machine use another plan, in which its elements have the same positions.
local function use_plan(fsm, plan)
  fsm._ways = {}
  if fsm._phase == "idle" then fsm._path = fsm._path and NONE end
  fsm._plan, fsm["_%def"] = plan, plan.nodes[1]
  for i = 2, #fsm._nodes do setmetatable(fsm._nodes[i], plan.nodes[i].proto) end
  for i, tr in ipairs(fsm._transitions) do
    setmetatable(tr, plan.transitions[i].proto)
  end
  list_otrs(fsm, plan)
end

-- Report: messages to the printers of a machine, and errors that are kept ----------

local DEFAULT_PRINTER, printer_of

do
  -- Prints values, separated by tabs, to the stream io[stream]. If there is no such
  -- stream, prints them with the current `print`.
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

  DEFAULT_PRINTER = {
    dbg = silent, info = to_stdout, warn = to_stderr, err = to_stderr,
  }

  -- Returns the function for a printer field's value: true prints, false is silent.
  function printer_of(fsm, name)
    local printer = fsm[name]
    if printer == nil then return DEFAULT_PRINTER[name] end
    return printer == true and to_stdout or printer or silent
  end
end

--- Keep an error until the iteration is over, for extensions.
--
-- Then `step` raises the error. If this is called between two steps, the next step
-- raises the error. Of several errors only the first is kept.
--
---@param fsm rfsm.Machine
---@param failure any
function rfsm.keep_failure(fsm, failure)
  fsm._failure = fsm._failure or { failure }
  fsm._is_usual = false
end

local keep_failure = rfsm.keep_failure

local function raise_failure(fsm)
  local kept = fsm._failure
  if not kept then return end
  fsm._failure = false
  error(kept[1], 0)
end

--- Call one of a machine's printers, for extensions.
--
-- An error of the printer is kept until the iteration is over.
--
---@param fsm rfsm.Machine
---@param name "dbg"|"info"|"warn"|"err"
---@param ... any
function rfsm.report(fsm, name, ...)
  local printer = fsm[name]
  if not printer or printer == true then printer = printer_of(fsm, name) end
  local ok, failure = pcall(printer, ...)
  if ok then return end
  if not is_callable(printer) then
    failure = ("rfsm: %s: function, true or false expected, %s"):format(name,
      got(printer))
  end
  keep_failure(fsm, failure)
end

local report = rfsm.report

local function is_traced(fsm)
  local dbg = fsm.dbg
  return dbg and dbg ~= silent
end

--- Did an interrupt such as Control-C raise the error, not a callback? For extensions.
--
-- `step` raises such an error. It is the text "interrupted!", maybe after a position.
--
---@param failure any
---@return boolean
function rfsm.is_interrupt(failure)
  return type(failure) == "string" and (failure == "interrupted!"
    or failure:find("^[^\n]*:%d+: interrupted!$") ~= nil)
end

-- Calls the hooks of a list, such as `_reset_hooks`, from number `at` on. Their errors
-- are kept. It recurses, because LuaJIT would not compile a host's loop around a loop.
local function tell_from(at, fsm, hooks, ...)
  local ok, failure = pcall(hooks[at], fsm, ...)
  if not ok then keep_failure(fsm, failure) end
  if hooks[at + 1] then return tell_from(at + 1, fsm, hooks, ...) end
end

local function tell(fsm, hooks, ...)
  if hooks then return tell_from(1, fsm, hooks, ...) end
end

local function tell_watch(fsm, what, ...)
  if fsm._watch_hooks then return tell(fsm, fsm._watch_hooks[what], ...) end
end

-- Reports that a callback has failed. For a doo `callback` is nil, because the doo was
-- called by its coroutine.
local function report_callback(fsm, name, owner, callback, failure)
  if rfsm.is_interrupt(failure) then return keep_failure(fsm, failure) end
  if callback ~= nil and not is_callable(callback) then
    failure = "function expected, " .. got(callback)
  end
  tell_watch(fsm, "failed", owner, name, failure)
  local text = "error executing " .. name .. " of " .. (owner._fqn or tostring(owner))
  if name == "doo" then text = "doo program of state '" .. owner._fqn .. "' failed" end
  local id = name:upper():gsub("i", "I") -- Turkish has another capital i
  report(fsm, "err", id, text .. ": ", failure)
end

-- Run: one iteration after the other ----------------------------------------------
--
-- Between two iterations exactly one leaf is active, or none before the first entry.
-- `_phase` is one of these:
--
--   idle     nothing: the machine waits for its caller
--   gather   the pending events and the events of getevents become the current events,
--            then the pre step hooks are called
--   search   a path is chosen that the events enable
--   take     the actions of the chosen path are performed
--   doo      there is no path: a doo cycle is run
--   finish   the post step hooks are called
--
-- Each phase ends in a call of the next one.
--
-- An interrupt is an error that a debug hook raises: Control-C, or a host's time limit.
-- It may come at any instruction. It reaches the caller of `step`, and the iteration is
-- marked as cut short. The next step repeats the phase without the callbacks that were
-- begun before the interrupt. One rule makes the repetition correct:
--
--   An action calls callbacks of one kind at most, changes the machine before it calls
--   them, and notes its position right before each call.
--
-- The position is `_at` on a path and in a doo, `_hook` among the step hooks. So each
-- callback is called at most once, and changes of the machine may be repeated. Only
-- guards may be called again.

local compiled, conclude, path_of, perform
local PHASES, search = {}, nil

-- Gather ..........................................................................

-- Makes the current events pending again, ahead of the queue. The phase becomes idle
-- first, so that after an interrupt here `take_queue` finds the events in either list.
local function put_back(fsm)
  fsm._outcome = "refused"
  fsm._phase = "idle"
  fsm._intq = append(append({}, fsm._curq), fsm._intq)
  fsm._curq = {}
end

-- Ends an iteration early, because a step hook or getevents has failed. The
-- current events become pending again before the search, but are dropped after it.
local function give_up(fsm, failure)
  if fsm._phase ~= "gather" then fsm._curq = {} end
  put_back(fsm)
  error(failure, 0)
end

-- Calls getevents. Returns its list of events and nils; on failure nil and an error.
-- The list is kept in `_given` until it is appended, so that no interrupt loses it.
local function ask_getevents(fsm)
  local getevents = fsm.getevents
  if fsm._given then return fsm._given end
  if not getevents or getevents == no_events then return NONE end
  local ok, events = pcall(getevents)
  fsm._given = ok and events or false
  if type(fsm._given) == "table" then return events end
  fsm._given = false
  if ok and events == nil then return NONE end
  if not is_callable(getevents) then
    return nil, "rfsm.step: getevents: function expected, " .. got(getevents)
  elseif not ok then
    return nil, events
  end
  return nil, "rfsm.step: getevents: list of events expected, " .. got(events)
end

-- Appends the events of getevents. After an interrupt they are appended again, without
-- harm: an event that is current twice has the effect of one.
local function append_getevents(fsm, list)
  local events, failure = ask_getevents(fsm)
  if not events then give_up(fsm, failure) end
  for i = 1, #events do list[#list + 1] = events[i] end
  fsm._given = false
end

-- Calls the step hooks whose number is above `_hook`, the number of the last one begun.
local function run_hooks(fsm, hooks, slot)
  for i = fsm._hook + 1, #hooks do
    local hook = hooks[i]
    if hook == OWN then hook = fsm[slot] end
    if hook then
      if not borrowers[hook] then fsm._is_lent = true end
      fsm._hook = i
      local ok, failure = pcall(hook, fsm, fsm._curq)
      if not (ok or is_callable(hook)) then
        failure = ("rfsm.step: %s: function expected, %s"):format(slot, got(hook))
      end
      if not ok then give_up(fsm, failure) end
    end
  end
end

-- Calls getevents (not again after an interrupt) and then the pre step hooks. The
-- pending events have become the current events already.
local function ask_hooks(fsm)
  if fsm._hook < 0 or fsm._given then
    fsm._hook = 0
    if fsm.getevents ~= no_events then append_getevents(fsm, fsm._curq) end
  end
  if fsm._pre_hooks ~= OWN_ONLY or fsm.pre_step_hook then
    run_hooks(fsm, fsm._pre_hooks, "pre_step_hook")
  end
  fsm._phase = "search"
end

-- Resets a machine as if it were new, but keeps the events of the current iteration.
local function reset_now(fsm)
  for _, node in ipairs(fsm._nodes) do
    if node._mode then
      node._mode, node._doo_co = "inactive", nil
      rawset(node, "_actchild", nil)
    end
  end
  fsm._act_leaf = false
  fsm._intq = { "e_init_fsm" }
  tell(fsm, fsm._reset_hooks)
  fsm._reset_wanted = false
end

-- Makes the pending events current: swaps the queue `_intq` with `_curq`, an empty
-- list. After an interrupt both fields may have the same list, or `_curq` may have
-- events, which come first.
local function take_queue(fsm)
  local queue, spare = fsm._intq, fsm._curq
  if rawequal(queue, spare) or spare[1] ~= nil then
    queue = rawequal(queue, spare) and queue or append(append({}, spare), queue)
    spare = {}
  end
  fsm._curq = queue
  fsm._intq = spare
end

function PHASES.gather(fsm, after_free)
  if fsm._reset_wanted then
    fsm._curq = {}
    reset_now(fsm)
  end
  if fsm._hook < 0 then take_queue(fsm) end
  ask_hooks(fsm)
  return search(fsm, after_free)
end

-- Search: the path that the events enable .........................................
--
-- A search that was cut short is done again: guards must not have side effects.

-- Do `events` trigger the transition? A transition without events is always triggered.
local function matches(def, events)
  local wanted = def.events
  if not wanted then return true end
  for i = 1, #wanted do
    local is_predicate = type(wanted[i]) == "function"
    for j = 1, #events do
      if rawequal(wanted[i], events[j]) then return true end
      if is_predicate then
        local ok, answer = pcall(wanted[i], events[j])
        if ok and answer then return true end
      end
    end
  end
  return false
end

-- Returns a copy of `def` for a transition whose target a program has changed to `tgt`.
-- Each copy is made once. Returns nil if `tgt` is no node of the machine.
local function retarget(fsm, def, tgt)
  local node = is_node(tgt) and getmetatable(tgt)["_%def"]
  if rawequal(tgt, fsm) then node = fsm._plan.nodes[1] end
  if not node or not rawequal(fsm._nodes[node.index], tgt) then
    report(fsm, "err", "ERROR: tgt of " .. end_text(fsm._transitions[def.index].src)
      .. ": node of the fsm expected, " .. got(tgt))
    return nil
  end
  if node.kind == "state" and not node.is_leaf then node = node.members.initial end
  if not node then return nil end
  def = fsm._plan.transitions[def.index] -- a guard may have called fsm_merge
  def.aimed = def.aimed or {}
  def.aimed[node] = def.aimed[node] or compile_transition {
    kind = "transition", index = def.index, id = def.id, parent = def.parent,
    model = def.model, src = def.src, tgt = node, events = def.events, pn = def.pn,
  }
  return def.aimed[node]
end

-- Reports that a guard has failed, and returns false as its result. After an interrupt
-- the next step calls the guard again.
local function refuse_guard(fsm, tr, guard, failure)
  if rfsm.is_interrupt(failure) then error(failure, 0) end
  report_callback(fsm, "guard", tr, guard, failure)
  return false
end

-- Calls the guard of a transition whose events match. Returns nil if the guard returns
-- false. Otherwise returns the definition, from `retarget` if the target was changed.
local function ask(fsm, def, events)
  local tr = fsm._transitions[def.index]
  local guard = tr.guard
  if guard then
    if not borrowers[guard] then fsm._is_lent = true end
    local ok, answer = pcall(guard, tr, events)
    if not ok then answer = refuse_guard(fsm, tr, guard, answer) end
    if answer == false then return nil end
  end
  if def.connector == nil then compile_transition(def) end
  if fsm._nodes[def.tgt.index] ~= tr.tgt then return retarget(fsm, def, tr.tgt) end
  return def
end

-- Returns the note of a machine about a connector. `search` is the number of the last
-- search that reached the connector (the current one is `fsm._search`). `way` is the
-- transition with which the path continues there, false if none was found.
local function note_of(fsm, connector)
  local note = fsm._ways[connector] or { search = 0, way = false }
  fsm._ways[connector] = note
  return note
end

local function warn_of_conflict(fsm, ways)
  report(fsm, "warn", "conflicting transitions from src " .. ways[1].src.fqn .. " to")
  for _, def in ipairs(ways) do report(fsm, "warn", "\t" .. def.tgt.fqn) end
end

local lead

-- Finds the way out of a connector, once in each search: its first transition that is
-- enabled and leads to a leaf. Others of the same priority are tried, too, to warn of a
-- conflict. During the search `note.way` is false, so that cycles of connectors end.
local function find_way(fsm, connector, note, events)
  local way, pn, others = false, nil, nil
  note.search, note.way = fsm._search, false
  for _, def in ipairs(connector.otrs) do
    if way and (def.pn or 0) ~= pn then break end
    local found = matches(def, events) and lead(fsm, ask(fsm, def, events), events)
    if found and way then
      others = append(others or { way }, { found })
    elseif found then
      way, pn = found, found.pn or 0
    end
  end
  if others then warn_of_conflict(fsm, others) end
  note.way = way
end

-- Returns `def`, an enabled transition, if its target is a leaf or a connector with a
-- way out. Otherwise returns nil.
function lead(fsm, def, events)
  if not (def and def.connector) then return def end
  local note = note_of(fsm, def.connector)
  if note.search ~= fsm._search then find_way(fsm, def.connector, note, events) end
  return note.way and def or nil
end

-- Returns the first enabled transition of a list. Returns nil if there is none, or if a
-- guard has called `fsm_merge`: the list is out of date then.
local function first_enabled(fsm, list, events)
  local plan = fsm._plan
  for i = 1, #list do
    local def = matches(list[i], events)
      and lead(fsm, ask(fsm, list[i], events), events)
    if def or fsm._plan ~= plan then return def or nil end
  end
end

local choice_of, choose, list_choices

do
  -- Returns the first enabled transition, in the states from the root down to the leaf.
  local function choose_by_node(fsm, leaf, events)
    local traces = is_traced(fsm)
    if traces then
      report(fsm, "dbg", "TRANSITION",
        "searching transitions for events: " .. list_text(events))
    end
    for i, node in ipairs(line_to(leaf)) do
      if traces then
        report(fsm, "dbg", "CHECKING", "depth:", i - 1,
          "for transitions from " .. node.fqn)
      end
      local plan, def = fsm._plan, first_enabled(fsm, node.otrs, events)
      if def or fsm._plan ~= plan then return def end
    end
    if traces then report(fsm, "dbg", "TRANSITION", "no enabled paths found") end
  end

  local OTHER = {} -- the key for all events that no transition names
  local NO_CHOICE = { run = false, run_hooked = false, find = false }

  -- Makes `leaf.choices`: for each event the list of candidates, which are the
  -- transitions that it may trigger while the leaf is active, in search order.
  -- `leaf.ignored` is the leaf's e_done if no transition reacts to it. Otherwise it is
  -- NaN, which equals no event.
  function list_choices(leaf)
    local choices, lists = { [OTHER] = {} }, {}
    lists[1] = choices[OTHER]
    local function add_to(list, def)
      if list[#list] ~= def then list[#list + 1] = def end
    end
    local function add_to_events(def)
      for _, event in ipairs(def.events) do
        local list = choices[event] or append({}, choices[OTHER])
        if not choices[event] then choices[event], lists[#lists + 1] = list, list end
        add_to(list, def)
      end
    end
    for _, node in ipairs(line_to(leaf)) do
      for _, def in ipairs(node.otrs) do
        local is_for_all = not def.events or def.is_asked
        if not is_for_all then add_to_events(def) end
        for _, list in ipairs(is_for_all and lists or NONE) do add_to(list, def) end
      end
    end
    if not choices[OTHER][1] then choices[OTHER] = NO_CHOICE end
    local done = choices[leaf.done_event] or choices[OTHER]
    leaf.ignored = done[1] and 0 / 0 or leaf.done_event
    leaf.choices = choices
    return choices
  end

  function choice_of(leaf, event)
    local choices = leaf.choices ~= NONE and leaf.choices or list_choices(leaf)
    return choices[event] or choices[OTHER]
  end

  -- Returns the candidates for `events`; nil if two events have different candidates.
  local function candidates_of(leaf, events)
    local common = NONE
    for i = 1, #events do
      local list = events[i] ~= leaf.ignored and choice_of(leaf, events[i]) or NONE
      if list[1] and list ~= common then
        if common ~= NONE then return nil end
        common = list
      end
    end
    return common
  end

  -- Returns the transition that the events enable, or nil. If `candidates` are given,
  -- no other transitions are tried. If a guard calls `fsm_merge`, the search is
  -- repeated once.
  function choose(fsm, leaf, events, candidates, is_again)
    local plan, find, from = fsm._plan, choose_by_node, leaf["_%def"]
    if not candidates then
      if events[1] == nil then return nil end
      candidates = not is_traced(fsm) and candidates_of(from, events)
    end
    if candidates then
      if candidates[1] == nil then return nil end
      find = candidates.find or compiled(candidates, "find") or first_enabled
      from = candidates
    end
    fsm._search = fsm._search + 1
    local def = find(fsm, from, events)
    if fsm._plan == plan then return def end
    return not is_again and choose(fsm, leaf, events, nil, true) or nil
  end
end

-- Warns of events that are lost: they were sent before the first entry, the entry
-- consumes them, and no transition of its path names them.
local function warn_of_lost_events(fsm, path, events)
  if rfsm.is_strict(fsm) then return end -- rfsm/strict.lua has warned already
  local lost = {}
  for i = 1, #events do
    local is_named = rawequal(events[i], "e_init_fsm")
    for _, def in ipairs(path.segments) do
      is_named = is_named or def.events and matches(def, { events[i] })
    end
    if not is_named then lost[#lost + 1] = events[i] end
  end
  if lost[1] == nil then return end
  report(fsm, "warn", "WARNING: sent before the machine was entered, which consumes "
    .. "them: " .. list_text(lost))
end

-- Returns the first entry's path, from the root's `initial`; nil if none is enabled.
local function find_entry(fsm, events)
  local root = fsm._plan.nodes[1]
  fsm._search = fsm._search + 1
  local def = not root.is_leaf
    and first_enabled(fsm, root.members.initial.otrs, events)
  if not (def or root.is_leaf) then return nil end
  local path = path_of(root.entrance, def, fsm._ways)
  warn_of_lost_events(fsm, path, events)
  return path
end

-- Reports that no path leads into the machine, and makes the events pending again.
local function refuse_entry(fsm, events)
  report(fsm, "err", "ERROR: cannot enter: no enabled path from 'root.initial' on "
    .. "events: " .. list_text(events))
  put_back(fsm)
  if fsm._reset_wanted then reset_now(fsm) end
  fsm._is_usual = true
  raise_failure(fsm)
  return nil
end

-- Returns the innermost active state.
local function innermost(fsm)
  local state = fsm
  while state._actchild do state = state._actchild end
  return state
end

-- Takes a path. `leaf` is the active leaf, or nil at the first entry.
local function take_path(fsm, leaf, path)
  local name, run = fsm._is_hooked and "run_hooked" or "run", false
  if leaf and fsm.dbg == silent then run = path[name] or compiled(path, name) end
  fsm._at = 0
  if run then
    run(fsm, true)
  else
    fsm._path = path
    fsm._phase = "take"
    perform(fsm)
  end
  return conclude(fsm, "counted")
end

-- Continues after a search from a leaf: takes the path that begins with `def`, the
-- transition found. If `def` is nil, runs the doo or ends the iteration.
local function follow(fsm, after_free, leaf, def)
  if fsm._act_leaf ~= leaf then -- a guard has moved the machine
    leaf = innermost(fsm)
    if def and fsm._nodes[def.lca.index]._mode == "inactive" then def = nil end
  end
  if def then return take_path(fsm, leaf, path_of(leaf["_%def"], def, fsm._ways)) end
  if fsm._curq[1] == nil or after_free then
    fsm._at = 0
    fsm._phase = "doo"
    return PHASES.doo(fsm)
  end
  return conclude(fsm, "free")
end

-- The phase "search". `choice` is the list of candidates, or nil if it is not known.
function search(fsm, after_free, choice)
  local leaf, events = fsm._act_leaf, fsm._curq
  if leaf then
    return follow(fsm, after_free, leaf, choose(fsm, leaf, events, choice))
  end
  local path = find_entry(fsm, events)
  if not path then return refuse_entry(fsm, events) end
  return take_path(fsm, nil, path)
end

-- Take: the actions of a path .....................................................
--
-- A path has a flat list of actions, which are functions f(fsm, arg, at), and a second
-- list with the `arg` of each action, usually a definition. `at` is the position.

-- Calls hooks of extensions in the action at position `at`. Each hook gets a fractional
-- position after `at - 1`, so that no hook is called again after an interrupt.
local function call_hooks(fsm, hooks, what, at)
  for i = 1, #hooks do
    local number = at - 1 + i / #hooks
    if fsm._at < number then
      fsm._at = number
      local ok, failure = pcall(hooks[i], fsm, what)
      if not ok then keep_failure(fsm, failure) end
    end
  end
end

-- Calls the path hooks with the list of the transitions that are about to be taken. The
-- list is empty at the entry of a root without states.
local function show_path(fsm, path, at)
  if not fsm._path_hooks then return end
  local list = {}
  for i, def in ipairs(path.segments) do list[i] = fsm._transitions[def.index] end
  call_hooks(fsm, fsm._path_hooks, list, at)
end

-- Actions that report a record of the trace to `dbg`, by kind of record.
local recorders = {}

do
  local function label_of(node)
    if node.kind == "connector" then return node.fqn .. "[c]" end
    return node.fqn .. (node.is_leaf and "[LS]" or "[CS]")
  end

  -- Makers of trace records, by kind. Each returns the record's id, then its texts.
  local RECORDS = {}

  -- Example, with [LS] for a leaf, [CS] for a composite and [c] for a connector:
  -- root.a[LS]->root.k[c]->root.b[LS]
  function RECORDS.path(path)
    local text = path.text or label_of(path.segments[1].src)
    for _, def in ipairs(path.text and NONE or path.segments) do
      text = text .. "->" .. label_of(def.tgt)
    end
    path.text = text
    return "EXEC_PATH", text
  end

  function RECORDS.exits(def)
    local outermost = line_to(def.src)[def.lca.depth + 2] or def.src -- for the root
    return "TRANS_EXIT", "exiting all up to (including):", outermost.fqn, ", lca:",
      def.lca.fqn
  end

  function RECORDS.exit(state) return "STATE_EXIT", state.fqn end

  function RECORDS.effect(def, fsm)
    return "EFFECT", tostring(fsm._transitions[def.index])
  end

  function RECORDS.entries(def)
    local text, node = def.tgt.fqn, def.tgt.parent
    while node ~= def.lca do text, node = text .. " > " .. node.fqn, node.parent end
    return "TRANS_ENTER", "lca: " .. def.lca.fqn, "down_path: ", text
  end

  function RECORDS.done(leaf) return "RAISED", leaf.done_event end

  function RECORDS.entry(state) return "STATE_ENTER", state.fqn end

  for name, words in pairs(RECORDS) do -- any order: independent entries
    recorders[name] = function(fsm, arg, at)
      local dbg = fsm.dbg
      if dbg == silent or not dbg then return end
      fsm._at = at
      report(fsm, "dbg", words(arg, fsm))
    end
  end
end

local function run_callback(fsm, owner, name, at, ...)
  local callback = owner[name]
  if not callback then return end
  fsm._at = at
  local ok, failure = pcall(callback, fsm, owner, name, ...)
  if not ok then report_callback(fsm, name, owner, callback, failure) end
end

local function run_effect(fsm, def, at)
  local tr = fsm._transitions[def.index]
  if tr.effect and not borrowers[tr.effect] then fsm._is_lent = true end
  run_callback(fsm, tr, "effect", at, fsm._curq)
end

local function leave(fsm, def, at)
  local state = fsm._nodes[def.index]
  state._mode = "inactive"
  state._parent._actchild = nil
  run_callback(fsm, state, "exit", at)
end

local function run_exit_hooks(fsm, def, at)
  local state, hooks = fsm._nodes[def.index], fsm._exit_hooks
  if hooks and hooks[state] then call_hooks(fsm, hooks[state], state, at) end
end

local function be_left(fsm, def)
  local state = fsm._nodes[def.index]
  if fsm._act_leaf == state then fsm._act_leaf = false end
  if state._doo_co then state._doo_co = nil end
end

local function become_active(fsm, def, at)
  local state, hooks = fsm._nodes[def.index], fsm._entry_hooks
  state._mode = "active"
  if def.depth > 0 then state._parent._actchild = state end
  if hooks and hooks[state] then call_hooks(fsm, hooks[state], state, at) end
end

local function enter(fsm, def, at)
  run_callback(fsm, fsm._nodes[def.index], "entry", at)
end

local function become_leaf(fsm, def, at)
  local leaf = fsm._nodes[def.index]
  fsm._act_leaf = leaf
  if not leaf.doo then recorders.done(fsm, def, at) end
end

-- A leaf without doo is done at once. After an interrupt e_done may be queued twice,
-- without harm: an event that is current twice has the effect of one.
local function be_done(fsm, def, at)
  local leaf, queue = fsm._nodes[def.index], fsm._intq
  if leaf.doo then return end
  queue[#queue + 1] = def.done_event
  leaf._mode = "done"
  fsm._at = at
end

-- Lists the actions of a path, and their arguments.
local list_actions

do
  local function add_action(list, action, arg)
    list.actions[#list.actions + 1] = action
    list.args[#list.actions] = arg
  end

  -- Adds the exits of the states from `from` up to the lca, which stays active.
  local function add_exits(list, def, from)
    add_action(list, recorders.exits, def)
    while from ~= def.lca do
      add_action(list, leave, from)
      add_action(list, run_exit_hooks, from)
      add_action(list, be_left, from)
      add_action(list, recorders.exit, from)
      from = from.parent
    end
  end

  local function add_entry(list, state)
    add_action(list, become_active, state)
    add_action(list, enter, state)
    if state.is_leaf then
      add_action(list, become_leaf, state)
      add_action(list, be_done, state)
    end
    add_action(list, recorders.entry, state)
  end

  local shapes = {} -- a tree of all lists of actions, with one action per level

  -- Returns an equal list of actions. All paths with the same actions share this list.
  local function shared(actions)
    local at = shapes
    for _, action in ipairs(actions) do
      at[action] = at[action] or {}
      at = at[action]
    end
    at.list = at.list or actions
    return at.list
  end

  -- Lists for each segment (a) the exits of the states below the lca, (b) the effect,
  -- (c) the entries of the states from below the lca to the target.
  function list_actions(path)
    local from, list = path.from, { actions = {}, args = {} }
    add_action(list, show_path, path)
    if path.entered then add_entry(list, path.entered) end
    if path.segments[1] then add_action(list, recorders.path, path) end
    for _, def in ipairs(path.segments) do
      if not def.is_internal then add_exits(list, def, from) end
      add_action(list, recorders.effect, def)
      add_action(list, run_effect, def)
      if not def.is_internal then add_action(list, recorders.entries, def) end
      for _, state in ipairs(def.is_internal and NONE or def.entries) do
        add_entry(list, state)
      end
      from = def.tgt.parent
    end
    path.args = list.args
    path.actions = shared(list.actions) -- set last: it marks completion
  end
end

local function new_path(at, def)
  local segments = append(append({}, at.segments or NONE), { compile_transition(def) })
  local path = { from = at.from or at, entered = at.entered, segments = segments }
  at.paths = at.paths or {}
  at.paths[def] = path
  return path
end

-- Returns the path that continues `at` with the transition `def` and, at each connector
-- reached, with the transition noted in `ways`. Paths are kept in a tree. Its roots are
-- the leaves and the entrance of the root state; `at` is a root or a part of a path.
function path_of(at, def, ways)
  if def then -- no loop, because LuaJIT would not compile a loop around this one
    at = at.paths and at.paths[def] or new_path(at, def)
    if def.connector then return path_of(at, ways[def.connector].way, ways) end
  end
  if not at.actions then list_actions(at) end
  return at
end

-- Performs the actions of `_path` after the one that was begun last. Returns true.
function perform(fsm)
  local path, begun = fsm._path, fsm._at
  local actions, args = path.actions, path.args
  for at = begun - begun % 1 + 1, #actions do actions[at](fsm, args[at], at) end
  return true
end

function PHASES.take(fsm)
  perform(fsm)
  return conclude(fsm, "counted")
end

local drop_fast, load_fast, prepare_choice, prepare_entry, quick_run

do
  local fast -- the functions of rfsm/fast.lua, false without it

  local function make_fast()
    return loadstring and require("rfsm.fast") {
      loadstring = loadstring, silent = silent, borrowers = borrowers,
      perform = perform, failed = report_callback, call_hooks = call_hooks,
      show_path = show_path, run_effect = run_effect, leave = leave,
      run_exit_hooks = run_exit_hooks, be_left = be_left, become_active = become_active,
      enter = enter, become_leaf = become_leaf, matches = matches,
      refuse_guard = refuse_guard, retarget = retarget, lead = lead, note_of = note_of,
      warn_of_conflict = warn_of_conflict, compile_transition = compile_transition,
    }
  end

  -- Loads rfsm/fast.lua. If that fails, for example for lack of memory, machines work
  -- without this file.
  function load_fast()
    if fast ~= nil then return end
    local ok, made = pcall(make_fast)
    if rfsm.is_interrupt(made) then error(made, 0) end
    fast = ok and made or false
  end

  function drop_fast() fast = false end

  local OFTEN = 3 -- a path or list that is used more often is compiled

  -- Has rfsm/fast.lua make a function for `at`, a path or a list of candidates. The
  -- function, or false if none can be made, is kept in one of these fields:
  --
  --   path.run, path.run_hooked   f(fsm, is_chosen) takes the path. If no search has
  --                               chosen the path, and a guard or a changed target
  --                               requires a search, f does nothing and returns false
  --   list.find                   does the same as `first_enabled`
  local function compile_text(at, name)
    local ok, f = pcall(fast and fast[name] or silent, at)
    if not ok and f ~= "not enough memory" then error(f, 0) end
    at[name] = ok and f or false
    return at[name]
  end

  -- Returns the function in the field `name` of `at`, a path or a list of candidates.
  -- It is compiled after OFTEN calls; until then the result is false.
  function compiled(at, name)
    if at[name] ~= nil then return at[name] end
    at.used = (at.used or 0) + 1
    if fast and at.used <= OFTEN then return false end
    return compile_text(at, name)
  end

  -- Returns the only path that can begin with the transition `def`: each connector on
  -- it has a single transition, without events. (The function compiled from the path
  -- checks guards and changed targets.) Returns nil if there is no such path, or if it
  -- has more than ten segments, because connectors may form a cycle.
  local function straight_path(leaf, def)
    local first, ways, count = compile_transition(def), {}, 1
    while def.connector do
      local otrs = def.connector.otrs
      if #otrs ~= 1 or otrs[1].events or count == 10 then return nil end
      ways[def.connector] = { way = otrs[1] }
      def, count = compile_transition(otrs[1]), count + 1
    end
    return path_of(leaf, first, ways)
  end

  -- Returns the function that takes a path without a search, if `choice` has only one
  -- candidate and this candidate has only one path. Otherwise, or if the function is
  -- not compiled yet, returns false. `choice` keeps the result when it is final.
  function quick_run(leaf, choice, name)
    local def = choice[1]
    local path = def and not (choice[2] or def.is_asked) and straight_path(leaf, def)
    local run = path and compiled(path, name) or false
    if not path or path[name] ~= nil then choice[name] = run end
    return run
  end

  -- Limits of `rfsm.prepare`: the number of paths for a leaf and an event, and the
  -- number of segments in a path.
  local MOST_PATHS, MOST_SEGMENTS = 50, 6
  local paths_left = 0

  -- Makes the paths that continue `at` with transition `def`, and compiles them.
  local function prepare_paths(at, def, name)
    local path = at.paths and at.paths[def] or new_path(at, def)
    local connector = compile_transition(def).connector
    if not connector then
      paths_left = paths_left - 1
      return compile_text(path_of(path), name)
    end
    for _, way in ipairs(#path.segments < MOST_SEGMENTS and connector.otrs or NONE) do
      if paths_left > 0 then prepare_paths(path, way, name) end
    end
  end

  -- Makes and compiles the paths that continue `at` with each transition of a list.
  local function prepare_list(at, list, name)
    paths_left = MOST_PATHS
    for _, def in ipairs(list) do prepare_paths(at, def, name) end
  end

  function prepare_entry(root)
    local initial = root.members.initial
    prepare_list(root.entrance, initial and initial.otrs or NONE, "run")
  end

  function prepare_choice(leaf, choice, name)
    prepare_list(leaf, choice, name)
    for _, def in ipairs(choice) do
      if choice[2] or def.guard or def.is_asked or def.connector then
        compile_text(choice, "find")
      end
    end
    quick_run(leaf, choice, name)
  end
end

-- Doo ............................................................................

local run_doo

do
  -- Drops the coroutine last. After an interrupt the next step drops it in `end_doo`.
  local function fail_doo(fsm, leaf, failure)
    report_callback(fsm, "doo", leaf, nil, failure)
    leaf._doo_co = nil
  end

  local function complete(fsm, leaf)
    local queue, event = fsm._intq, leaf["_%def"].done_event
    if is_traced(fsm) then report(fsm, "dbg", "RAISED", event) end
    queue[#queue + 1] = event
    leaf._mode = "done"
  end

  local function end_doo(fsm, leaf)
    if leaf._mode ~= "done" then complete(fsm, leaf) end
    if fsm._at < 2 then
      fsm._at = 2
      tell_watch(fsm, "ended", leaf)
    end
    if is_traced(fsm) then
      report(fsm, "dbg", "DOO",
        "removing completed coroutine of " .. leaf._fqn .. " doo")
    end
    leaf._doo_co = nil
  end

  -- Makes the coroutine of a leaf's doo and returns it. A leaf without doo is completed
  -- at once; in a Lua without coroutines the doo fails. The result is nil then.
  local function start_doo(fsm, leaf)
    local doo = leaf.doo
    if not doo then return complete(fsm, leaf) end
    if is_traced(fsm) then
      report(fsm, "dbg", "DOO", "created coroutine for " .. leaf._fqn .. " doo")
    end
    if not coroutine then
      leaf._mode = "done"
      return fail_doo(fsm, leaf, "there are no coroutines here")
    end
    leaf._doo_co = coroutine.create(type(doo) == "function" and doo
      or function(...) return doo(...) end)
    return leaf._doo_co
  end

  local resume, status = coroutine and coroutine.resume, coroutine and coroutine.status

  -- Runs one cycle of the active leaf's doo. Returns true if the doo is idle or done.
  -- `_at` is 1 when the doo is resumed, 2 when watch hooks are called at its end, 3 if
  -- getevents is called. If a doo fails, its leaf is done at once, without e_done.
  function run_doo(fsm, leaf)
    local co = leaf._doo_co or leaf._mode ~= "done" and start_doo(fsm, leaf)
    if not co then return true end
    local ok, idle = true, false
    if fsm._at < 1 then
      fsm._at = 1
      if fsm._watch_hooks then tell_watch(fsm, "resumed", leaf) end
      ok, idle = resume(co, fsm, leaf, "doo")
      if not ok then leaf._mode = "done" end
    end
    if ok and status(co) ~= "dead" then return not not idle end
    if ok then end_doo(fsm, leaf) else fail_doo(fsm, leaf, idle) end
    return true
  end
end

local function finish_cycle(fsm, idle)
  if idle and fsm._curq[1] == nil and fsm.getevents ~= no_events
    and (fsm._at < 3 or fsm._given) then
    fsm._at = 3
    append_getevents(fsm, fsm._intq)
  end
  return conclude(fsm, idle and "idle" or "counted")
end

function PHASES.doo(fsm) return finish_cycle(fsm, run_doo(fsm, innermost(fsm))) end

-- Iterate ........................................................................

-- The phase "finish": calls the post step hooks and returns the results of `iterate`.
-- The list of current events is used again, unless a callback may have kept it.
local function finish(fsm)
  if fsm._reset_wanted then reset_now(fsm) end
  if fsm._post_hooks ~= OWN_ONLY or fsm.post_step_hook then
    run_hooks(fsm, fsm._post_hooks, "post_step_hook")
  end
  if fsm._is_lent then
    fsm._curq = {}
    fsm._is_lent = false
  else
    local events = fsm._curq
    for i = #events, 1, -1 do events[i] = nil end
  end
  fsm._phase = "idle"
  fsm._is_usual = not fsm._reset_wanted
  if fsm._failure then raise_failure(fsm) end
  local outcome = fsm._outcome
  return outcome ~= "free",
    outcome == "idle" and fsm._intq[1] == nil and fsm._act_leaf ~= false
end

PHASES.search, PHASES.finish = search, finish

function conclude(fsm, outcome)
  fsm._hook = 0
  fsm._outcome = outcome
  fsm._phase = "finish"
  return finish(fsm)
end

-- Makes one iteration, or the rest of one that was cut short.
local function go_on(fsm, after_free)
  fsm._is_cut = false
  if fsm._phase == "idle" then
    fsm._hook = -1
    fsm._phase = "gather"
  end
  return PHASES[fsm._phase](fsm, after_free)
end

-- The usual iterations, written out ................................................
--
-- An iteration is a usual one if the machine is in a leaf, `dbg` is silent, and there
-- is at most one event. An e_done that no transition names is not counted.

local iterate

do
  -- Makes one iteration of a machine with hooks. The caller has made the pending events
  -- current.
  local function iterate_hooked(fsm, after_free)
    fsm._hook = -1
    fsm._phase = "gather"
    ask_hooks(fsm)
    local leaf, events, choice = fsm._act_leaf, fsm._curq, nil
    if leaf and fsm.dbg == silent then
      local def, event, more = leaf["_%def"], events[1], events[2]
      if event == def.ignored then event, more = more, events[3] end
      if event ~= nil and more == nil then
        choice = def.choices[event] or choice_of(def, event)
        local run = choice.run_hooked
        if run == nil then run = quick_run(def, choice, "run_hooked") end
        if run and run(fsm) then return conclude(fsm, "counted") end
      end
    end
    return search(fsm, after_free, choice)
  end

  -- Makes one iteration without events.
  local function rest(fsm, leaf, after_free)
    local events = fsm._curq
    if leaf._mode == "done" and not leaf._doo_co then
      events[1] = nil
      return true, true
    elseif events[1] ~= nil then
      fsm._phase = "search"
      return search(fsm, after_free)
    end
    fsm._at = 0
    fsm._phase = "doo"
    local idle = run_doo(fsm, leaf)
    if not fsm._is_usual then return finish_cycle(fsm, idle) end
    fsm._phase = "idle"
    return true, idle and fsm._intq[1] == nil and fsm._act_leaf ~= false
  end

  -- Returns the function of the path that a search has found. Returns nil if it is not
  -- compiled, or if the iteration is no longer a usual one because of a guard.
  local function found_run(fsm, leaf, def)
    if not fsm._is_usual or fsm.dbg ~= silent or fsm._act_leaf ~= leaf then
      return nil
    end
    return path_of(leaf["_%def"], def, fsm._ways).run
  end

  -- Makes one iteration. Returns whether it counts as a step and whether the machine is
  -- idle, or only nil if the machine cannot be entered. `after_free` is true if the
  -- last iteration did not count. The two lists of events are swapped. If an interrupt
  -- cuts the swap short, `take_queue` repairs it in the next iteration.
  function iterate(fsm, after_free) -- luacheck: ignore 561 (a call costs time)
    local leaf = fsm._act_leaf
    if not (leaf and fsm._is_usual) or fsm.dbg ~= silent then
      return go_on(fsm, after_free)
    end
    local events = fsm._intq
    local spare = fsm._curq
    fsm._curq = events
    fsm._intq = spare
    if fsm._is_hooked then return iterate_hooked(fsm, after_free) end
    local def, event, more = leaf["_%def"], events[1], events[2]
    if event == def.ignored then event, more = more, events[3] end
    if event == nil then return rest(fsm, leaf, after_free) end
    local choice
    if more == nil then
      choice = def.choices[event] or choice_of(def, event)
      local run = choice.run
      if run == nil then run = quick_run(def, choice, "run") end
      local is_taken = run and run(fsm)
      if not is_taken and choice.find then
        fsm._phase = "search"
        local found = choose(fsm, leaf, events, choice)
        run = found and found_run(fsm, leaf, found)
        if not run then return follow(fsm, after_free, leaf, found) end
        is_taken = run(fsm, true)
      end
      if is_taken and not fsm._is_usual then
        return conclude(fsm, "counted")
      elseif is_taken or not (choice[1] or after_free) then
        if fsm._is_lent then
          fsm._curq = {}
          fsm._is_lent = false
        else
          events[2] = nil
          events[1] = nil
        end
        fsm._phase = "idle"
        return is_taken or false, false
      end
    end
    fsm._phase = "search"
    return search(fsm, after_free, choice)
  end
end

-- Raises an error that has ended an iteration: a kept error, an error of a step hook or
-- an interrupt. The mark `_is_cut` shows that no step is under way any more, although
-- the phase may not be "idle".
local function raise_cut(fsm, failure)
  fsm._cuts = fsm._cuts + 1
  fsm._is_usual = false
  fsm._is_cut = true
  error(failure, 0)
end

-- Build: a plan of a model, and a machine of the plan -------------------------------

-- Accepts a machine that is a program's deep copy. Its plan is a copy, too, but the
-- metatables of its elements belong to the original plan, so it gets the original.
local function adopt_copy(fsm)
  local node = fsm._nodes[2]
  local root = node and node["_%def"].parent or fsm["_%def"]
  fsm._plan, fsm["_%def"], fsm._ways = root.plan, root, {}
  machines[fsm] = true
end

--- Raise an error that blames the caller, unless `fsm` is a machine; for extensions.
---@param fsm any
---@param where string the public function, such as "rfsm.step"
---@param level? integer level of `error`; default 3, which blames the caller's caller
function rfsm.check_machine(fsm, where, level)
  if machines[fsm] then return end
  if rawequal(getmetatable(fsm), Machine) and rawget(fsm, "_initialized") then
    if not fsm._preparing then adopt_copy(fsm) end -- otherwise `init` is running
    return
  end
  local hint = is_state(fsm) and (rawget(fsm, "_initialized")
    and " of another copy of rfsm" or " (rfsm.init makes one of a state)") or ""
  error(where .. ": initialised fsm expected, " .. got(fsm) .. hint, level or 3)
end

local check_machine = rfsm.check_machine

--- Return a table that machines of the same structure share, for extensions.
--
-- A machine gets another table from `fsm_merge`, and when a preproc function changes
-- its transitions.
--
---@param fsm rfsm.Machine
---@return table structure
function rfsm.structure_of(fsm)
  check_machine(fsm, "rfsm.structure_of")
  return fsm._plan
end

local function check_function(f, where)
  if not is_callable(f) then error(where .. ": function expected, " .. got(f), 3) end
end

-- Pads the numbers in a text with zeros, so that trans[10] is sorted after trans[2].
local function natural(text)
  return (text:gsub("%d+", function(n) return ("0"):rep(12 - #n) .. n end))
end

-- Puts the `file` of each item in front of its `line`, which is "location: text".
-- Returns these texts, sorted by location.
local function lines_of(list)
  local keys, lines = {}, {}
  for i = 1, #list do
    local file, line = list[i].file, list[i].line
    lines[i] = (file and file .. ": " or "") .. line
    keys[lines[i]] = natural(line)
  end
  sort(lines, function(a, b) return text_before(keys[a], keys[b]) end)
  return lines
end

local function summary(where, problems)
  local hint = advice == false and "\n  (no hints: rfsm/advice.lua is not installed)"
    or ""
  return ("%s: the model has %d problem%s\n  %s%s"):format(where, #problems,
    #problems == 1 and "" or "s", concat(problems, "\n  "), hint)
end

--- Return the location of an element: "chart.lua:7: root.trans[2] (off -> on)".
--
-- Its constructor was called at this file and line. They are omitted if not known.
--
---@param obj rfsm.State|rfsm.Transition|rfsm.Connector an element of a machine
---@param field? string a field to include: "root.trans[2].events (off -> on)"
---@return string location
function rfsm.location_of(obj, field)
  local def = obj["_%def"]
  local file = made_at[def.model]
  return (file and file .. ": " or "") .. name_of(def, field)
end

local build_plan, new_build, plan_of

do
  -- Model -> plan, a weak table. Machines keep their plan alive. `latest_plan` keeps
  -- one more, for programs that drop each machine before they make the next.
  local plans, latest_plan = setmetatable({}, { __mode = "kv" }), nil
  local is_sparing = false

  function new_build(plan)
    plan.warnings, plan.created = {}, {}
    return { plan = plan, problems = {}, warnings = plan.warnings,
      created = plan.created, mounts = {} }
  end

  -- Removes user data of the root whose key is also a field of every machine.
  local function drop_taken_names(build, root)
    local taken, data = own_fields(), root.data
    root.data = {}
    for i = 1, #data, 2 do
      local key = data[i]
      if taken[key] ~= nil or is_meta(key) and DEFAULTS[key] ~= nil then
        add(build.warnings, root, key, "the machine has a field of this name, this one "
          .. "is ignored")
      else
        append(root.data, { key, data[i + 1] })
      end
    end
  end

  -- Reports each `initial` that no transition leaves: its composite cannot be entered.
  local function check_ways_in(build)
    for _, def in ipairs(build.plan.nodes) do
      if def.id == "initial" and def.kind == "connector" and not def.is_left then
        add(build.problems, def, nil,
          "no transition leaves it (rfsm.trans{ src='initial', tgt=... })")
      end
    end
  end

  local function check_root(build, root)
    local model = root.model
    for _, name in ipairs(HOOKS) do check_callable(build, root, name, model[name]) end
    for _, name in ipairs(PRINTERS) do
      local printer = model[name]
      if printer and printer ~= true and not is_callable(printer) then
        add(build.problems, root, name, "function, true or false expected, "
          .. got(printer))
      end
    end
    if not root.is_leaf and not root.members.initial then
      add(build.problems, root, nil, "the root needs an initial transition "
        .. "(rfsm.trans{ src='initial', tgt=... })")
    end
  end

  -- Checks, clones and resolves a model, without a call of its functions.
  function build_plan(model)
    local build = new_build(new_plan(model))
    local root = new_node(build, "state", model, nil, "root")
    clone_below(build, 1)
    resolve(build, 1)
    check_ways_in(build)
    drop_taken_names(build, root)
    check_root(build, root)
    return build
  end

  -- Returns the plan of a model. If the model has problems, returns nil and their list.
  function plan_of(model)
    local plan = plans[model]
    if plan and is_current(plan) then return plan end
    local build = build_plan(model)
    if build.problems[1] then return nil, lines_of(build.problems) end
    plan = compile(build.plan)
    if is_sparing then return plan end
    plan.trail = make_trail(plan)
    plans[model], latest_plan = plan, plan
    return latest_plan
  end

  --- Use less memory and more time from now on, for all machines of this Lua state.
  --
  -- rfsm/fast.lua compiles nothing more. Each `init` makes a new plan, which is dropped
  -- with its machine.
  function rfsm.save_memory()
    drop_fast()
    is_sparing, latest_plan = true, nil
  end
end

-- Makes a machine of a plan. A printer that cannot be called is replaced by a default.
local function new_machine(plan)
  local fsm = own_fields()
  fsm["_%def"], fsm._plan, fsm._parent, fsm._nodes = plan.nodes[1], plan, fsm, { fsm }
  make_elements(fsm, plan, 2, 1)
  for _, name in ipairs(PRINTERS) do
    local printer = printer_of(fsm, name)
    fsm[name] = is_callable(printer) and printer or DEFAULT_PRINTER[name]
  end
  for name in pairs(STEP_HOOKS) do -- any order: independent entries
    if fsm[name] then fsm._is_hooked = true else fsm[name] = nil end
  end
  return setmetatable(fsm, Machine)
end

interpret(new_machine)

local function report_lines(fsm, name, list)
  if fsm[name] == silent then return end
  for _, line in ipairs(lines_of(list)) do
    report(fsm, name, (name == "info" and "INFO: " or "WARNING: ") .. line)
  end
end

-- Returns the set of composites that are left by a transition from a node inside.
local function left_composites(plan)
  local left = {}
  for _, def in ipairs(plan.transitions) do
    local composite, lca = def.src.parent, find_lca(def.src.parent, def.tgt.parent)
    while composite ~= lca do left[composite], composite = true, composite.parent end
  end
  return left
end

-- Does a composite that contains the state `def` have an outgoing transition?
local function is_left_around(def)
  local around = def.parent
  while around ~= around.parent and not around.otrs[1] do around = around.parent end
  return def.kind == "state" and around.otrs[1] ~= nil
end

-- Warns of the nodes, from number `first` on, that no transition leaves. Returns true
-- if there are none.
local function report_dead_ends(fsm, first)
  local plan, dead, left = fsm._plan, {}, nil
  for i = first, #plan.nodes do
    local def = plan.nodes[i]
    if not (def.otrs[1] or def.model.final or def.parent == def
      or is_left_around(def)) then
      left = left or left_composites(plan)
      local line = "no outgoing transitions from node '" .. def.fqn .. "'"
      dead[#dead + 1] = not left[def] and { line = line } or nil
    end
  end
  report_lines(fsm, "warn", dead)
  return dead[1] == nil
end

-- Reports the warnings of the model, then suspicious guards and events, which preproc
-- functions may have changed.
local function report_findings(fsm, first_node, first_transition)
  local plan, found = fsm._plan, append({}, fsm._plan.warnings)
  for i = first_node, #plan.nodes do
    local def = plan.nodes[i]
    local way = def.id == "initial" and def.otrs[1]
    if way and (way.events or way.guard) then add_advice(found, "initial", def) end
  end
  for i = first_transition, #plan.transitions do
    local def = plan.transitions[i]
    for _, event in ipairs(def.events or NONE) do
      local is_call = type(event) == "string" and event:find("%)$")
      if is_call or type(event) == "table" then
        add_advice(found, "event", def, event)
      end
    end
  end
  report_lines(fsm, "warn", found)
end

--- Functions `f(fsm[, merged])` that `rfsm.init` calls for each machine.
--
-- They run after names are resolved and before events are indexed, and may change
-- `events`, `pn`, `src`, `tgt` and callbacks. `rfsm.fsm_merge` calls them again with
-- the element that it added. A function may return a list of texts "location:
-- problem", which are added to the problems of the model.
--
---@type (fun(fsm: rfsm.Machine, merged?: table): string[]?)[]
rfsm.preproc = {}

--- Functions `f(event)`, one from each extension that raises events. `f` returns the
-- name of its extension if the extension raises `event`, otherwise nil. An optional
-- second result is the FQN of the state that must be active for the event.
---@type (fun(event: string): string?, string?)[]
rfsm.makers = {}

local preprocess

do
  -- Gives each transition the fields `events` and `pn`, which a preproc function may
  -- change. The fields exist already if a preproc function has called `fsm_merge`.
  local function hand_out(fsm, plan)
    for i, tr in ipairs(fsm._transitions) do
      local def = plan.transitions[i]
      tr.events = rawget(tr, "events") or append({}, def.events or NONE)
      tr.pn = rawget(tr, "pn") or def.pn
    end
  end

  -- Returns the name of a field with a wrong value from a preproc function; else false.
  local function wrong_field(fsm, tr)
    local events, pn = tr.events or NONE, rawget(tr, "pn") or 0
    if type(events) ~= "table" and type(events) ~= "string" then return "events" end
    if type(pn) ~= "number" or pn ~= pn then return "pn" end
    if not is_node_of(fsm, tr.src) then return "src" end
    return not is_node_of(fsm, tr.tgt) and "tgt"
  end

  -- Converts the fields of a transition into the form of a plan: a list of events, and
  -- a target that is no composite. Returns the text of a problem, or nil.
  local function check_transition(fsm, tr)
    local wrong = wrong_field(fsm, tr)
    if wrong then
      return ("%s: %s: set by a preproc function, %s"):format(rfsm.location_of(tr),
        wrong, got(tr[wrong]))
    end
    local tgt, events = tr.tgt["_%def"], rawget(tr, "events") or {}
    local is_internal = tr["_%def"].is_internal and rawequal(tr.src, tr.tgt)
    if tgt.kind == "state" and not (tgt.is_leaf or is_internal) then
      local initial = tgt.members.initial
      if not initial then
        return rfsm.location_of(tr)
          .. ": tgt: the composite has no initial transition"
      end
      tr.tgt = fsm._nodes[initial.index]
    end
    tr.events = type(events) == "string" and { events } or events
  end

  -- Do all transitions of a machine have the ends, priority and events of the plan?
  local function fits(fsm, plan)
    local nodes = fsm._nodes
    for i, tr in ipairs(fsm._transitions) do
      local def, events = plan.transitions[i], rawget(tr, "events")
      local known = def.events or NONE
      if type(events) ~= "table" or #events ~= #known
        or (rawget(tr, "pn") or nil) ~= def.pn
        or not rawequal(tr.src, nodes[def.src.index])
        or not rawequal(tr.tgt, nodes[def.tgt.index]) then
        return false
      end
      for j = 1, #known do
        if not rawequal(events[j], known[j]) then return false end
      end
    end
    return true
  end

  -- Returns a plan that fits the machine: the latest variant or `plan`. Otherwise nil.
  local function find_plan(fsm, plan)
    if plan.variant and fits(fsm, plan.variant) then return plan.variant end
    return fits(fsm, plan) and plan or nil
  end

  -- Returns a new plan with the same definitions, and drops what was compiled in them.
  -- Only one machine may have `plan`.
  local function renewed(plan)
    local variant = new_plan(plan.model, plan.warnings, plan.created)
    variant.nodes, variant.transitions = plan.nodes, plan.transitions
    for _, def in ipairs(plan.nodes) do def.paths = nil end
    for _, def in ipairs(plan.transitions) do
      def.connector, def.aimed, def.is_asked = nil, nil, nil
    end
    return variant
  end

  -- Returns a new plan with the transitions as the preproc functions have changed them.
  local function new_variant(fsm, plan)
    local variant = plan.trail and copy_plan(plan) or renewed(plan)
    for i, tr in ipairs(fsm._transitions) do
      local def = variant.transitions[i]
      def.src = variant.nodes[tr.src["_%def"].index]
      def.tgt = variant.nodes[tr.tgt["_%def"].index]
      def.pn = rawget(tr, "pn") or nil
      def.events = tr.events[1] ~= nil and append({}, tr.events)
      def.is_internal = def.is_internal and def.src == def.tgt
    end
    plan.variant = compile(variant)
    return variant
  end

  -- Gives the machine a plan that fits its transitions after the preproc functions.
  -- Machines with equal transitions share this plan.
  local function take_results(fsm, plan, problems)
    local found = find_plan(fsm, plan)
    if not found then
      for _, tr in ipairs(fsm._transitions) do
        problems[#problems + 1] = check_transition(fsm, tr)
      end
      found = problems[1] and plan or find_plan(fsm, plan) or new_variant(fsm, plan)
    end
    for _, tr in ipairs(fsm._transitions) do tr.events, tr.pn = nil, nil end
    if found ~= plan then use_plan(fsm, found) end
  end

  -- Runs the preproc functions and returns the problems they found. If one of them
  -- calls `fsm_merge`, only the functions before it are called for the new element,
  -- because the later ones are still to be called for the whole machine.
  function preprocess(fsm, merged)
    local problems, outer = {}, fsm._preparing
    local last = outer and outer - 1 or #rfsm.preproc
    if last < 1 then return problems end
    hand_out(fsm, fsm._plan)
    for i = 1, last do
      fsm._preparing = i
      local found = rfsm.preproc[i](fsm, merged)
      append(problems, type(found) == "table" and found or {})
    end
    fsm._preparing = outer
    if not outer then take_results(fsm, fsm._plan, problems) end
    sort(problems, function(a, b) return text_before(natural(a), natural(b)) end)
    return problems
  end
end

--- Is a machine strict, by `strict` of its root or RFSM_STRICT=1? For extensions.
---@param root rfsm.State a root state or a machine
---@return boolean
function rfsm.is_strict(root)
  local getenv = find_global("os", "getenv")
  if root.strict ~= nil then return root.strict and true or false end
  return getenv and getenv("RFSM_STRICT") == "1" or false
end

local function refuse_model(model, fsm, problems)
  local err = printer_of(model, "err")
  fsm = fsm or { err = is_callable(err) and err or DEFAULT_PRINTER.err }
  local text = summary("rfsm.init", problems)
  report(fsm, "err", text)
  raise_failure(fsm)
  return false, text, problems
end

--- Check a model and make a machine of it.
--
-- The model is not touched and may be used again. All its problems are reported
-- to `err` in one text, sorted by location.
--
-- @raise when `model` is no state
---@param model rfsm.State a root state; or a machine, to get a new one of its model
---@return rfsm.Machine? fsm false when the model has problems
---@return string? text all problems as one text, which `assert` raises
---@return string[]? problems each "file:line: location: problem"
---@nodiscard
function rfsm.init(model)
  if not is_state(model) then
    error("invalid fsm model passed to rfsm.init: state expected, " .. got(model)
      .. (type(model) == "string" and " (did you mean rfsm.load?)" or ""), 2)
  end
  model = model_of(model)
  if rfsm.is_foreign(model) then
    return refuse_model(model, nil, { "root: " .. FOREIGN })
  end
  local plan, problems = plan_of(model)
  if not plan then return refuse_model(model, nil, problems) end
  load_fast()
  if rfsm.is_strict(model) then find_module("rfsm.strict") end
  local fsm = new_machine(plan)
  fsm._initialized = true
  report_lines(fsm, "info", plan.created)
  list_otrs(fsm, plan)
  problems = preprocess(fsm)
  if problems[1] then
    fsm._initialized = false
    return refuse_model(model, fsm, problems)
  end
  if fsm.warn ~= silent then
    report_findings(fsm, 1, 1)
    report_dead_ends(fsm, 1)
  end
  machines[fsm] = true
  raise_failure(fsm)
  return fsm
end

--- Check a model without making a machine of it.
---@param model rfsm.State
---@return boolean is_valid
---@return string[] problems each "file:line: location: problem"
---@return string[] warnings
function rfsm.verify_early(model)
  if not is_state(model) then
    error("rfsm.verify_early: state expected, " .. got(model), 2)
  end
  local build = build_plan(model_of(model))
  return not build.problems[1], lines_of(build.problems), lines_of(build.warnings)
end

--- Warn of each state or connector that no transition leaves.
---@param fsm rfsm.Machine
---@return boolean is_clean true if there is no such node
function rfsm.check_no_otrs(fsm)
  check_machine(fsm, "rfsm.check_no_otrs")
  return report_dead_ends(fsm, 1)
end

-- Use: what a program does with a machine --------------------------------------------

local function queue_more(queue, ...)
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    if event ~= nil then queue[#queue + 1] = event end
  end
end

--- Send events to a machine. They are pending until the next iteration, in order.
--
-- @usage
--    rfsm.send_events(fsm, "e_start", "e_ready")
--
---@param fsm rfsm.Machine
---@param event? any anything; nil is skipped
---@param ... any more events
function rfsm.send_events(fsm, event, ...)
  if not machines[fsm] then check_machine(fsm, "rfsm.send_events") end
  if fsm.dbg ~= silent and fsm.dbg then report(fsm, "dbg", "RAISED", event, ...) end
  local queue = fsm._intq
  if event ~= nil then queue[#queue + 1] = event end
  if select("#", ...) > 0 then queue_more(queue, ...) end
  local hooks = fsm._watch_hooks
  if hooks and hooks.sent then return tell_from(1, fsm, hooks.sent, event, ...) end
end

-- Raises an error if a step is under way, also if its coroutine is suspended. A step
-- that an error has cut short is not under way.
local function check_no_step(fsm, where, level)
  if fsm._phase == "idle" or fsm._is_cut then return end
  error(where .. ": the machine is in the middle of a step; if its coroutine is never "
    .. "resumed, rfsm.init(fsm) makes a fresh machine", level)
end

local function try(fsm, after_free)
  local ok, counted, idle = pcall(iterate, fsm, after_free)
  if not ok then raise_cut(fsm, counted) end
  return counted, idle
end

--- Raise an error if a step is under way, for extensions.
--
-- The error blames the caller's caller. A step that was cut short is finished first.
--
---@param fsm rfsm.Machine
---@param where string the public function
function rfsm.check_between_steps(fsm, where)
  check_machine(fsm, where, 4)
  check_no_step(fsm, where, 4)
  if fsm._phase ~= "idle" then try(fsm) end
end

local check_between_steps = rfsm.check_between_steps

-- Iterates until `left` iterations have counted as steps or the machine is idle. The
-- result is true if it is idle. `counted` and `idle` come from the last iteration.
local function advance(fsm, left, counted, idle)
  while counted ~= nil do
    if counted then
      left = left - 1
      if left < 1 then return idle end
    end
    local idle_hook = idle and fsm.idle_hook
    if idle and not idle_hook then break end
    if idle_hook then
      if not is_callable(idle_hook) then
        error("rfsm.step: idle_hook: function expected, " .. got(idle_hook), 0)
      end
      idle_hook(fsm)
    end
    counted, idle = try(fsm, not counted)
  end
  if idle and is_traced(fsm) then
    report(fsm, "dbg", "HIBERNATING",
      "no events, no idle_hook, no doos or doo idle, halting engines")
    raise_failure(fsm)
  end
  return idle or false
end

local function step_often(fsm, n)
  if type(n) ~= "number" then
    error("rfsm.step: number of steps expected, " .. got(n)
      .. (type(n) == "string" and " (did you mean rfsm.send_events?)" or ""), 3)
  end
  return advance(fsm, n == n and n or 1, try(fsm)) -- NaN counts as 1
end

--- Advance a machine by at most `n` transitions or doo cycles.
--
-- Returns earlier if the machine is idle. Errors of callbacks are reported to `err`.
-- Errors of step hooks and getevents are raised at once, errors of printers at the end
-- of the iteration. A step that an interrupt has cut short is finished first.
--
---@param fsm rfsm.Machine
---@param n? number at least 1, default 1
---@return boolean idle true if there is nothing left to do
function rfsm.step(fsm, n)
  if not machines[fsm] then check_machine(fsm, "rfsm.step") end
  if fsm._phase ~= "idle" then check_no_step(fsm, "rfsm.step", 3) end
  if n ~= nil then return (step_often(fsm, n)) end -- a tail call shifts error levels
  local ok, counted, idle = pcall(iterate, fsm)
  if ok and counted then return idle end -- no loop: LuaJIT makes one trace of it
  if ok and counted == false then ok, counted, idle = pcall(iterate, fsm, true) end
  if ok and counted then return idle end
  if not ok then raise_cut(fsm, counted) end
  return advance(fsm, 1, counted, idle)
end

--- Advance a machine until no event is pending and no doo is busy.
---@param fsm rfsm.Machine
---@return boolean idle false when the machine could not be entered
function rfsm.run(fsm)
  if not machines[fsm] then check_machine(fsm, "rfsm.run") end
  if fsm._phase ~= "idle" then check_no_step(fsm, "rfsm.run", 3) end
  local ok, counted, idle = pcall(iterate, fsm) -- usually two iterations
  if ok and counted and not idle then ok, counted, idle = pcall(iterate, fsm) end
  if not ok then raise_cut(fsm, counted) end
  if idle and fsm.dbg == silent and not fsm.idle_hook then return true end
  return advance(fsm, huge, counted, idle)
end

--- Make a machine inactive, as it was after `init`, without a call of any exit.
--
-- If a callback of the machine calls this, it takes effect when the iteration ends. A
-- machine whose step was cut short can be stepped again afterwards.
--
---@param fsm rfsm.Machine
function rfsm.reset(fsm)
  check_machine(fsm, "rfsm.reset")
  fsm._reset_wanted, fsm._is_usual = true, false
  if fsm._phase ~= "idle" and not fsm._is_cut then return end
  fsm._given = false
  fsm._phase, fsm._curq, fsm._failure = "idle", {}, false
  reset_now(fsm)
  raise_failure(fsm)
end

--- Call getevents and append its events to the queue.
---@param fsm rfsm.Machine
---@return integer waiting length of the queue
function rfsm.check_events(fsm)
  check_machine(fsm, "rfsm.check_events")
  local events, failure = ask_getevents(fsm)
  if not events then error(failure, 0) end
  append(fsm._intq, events)
  fsm._given = false
  return #fsm._intq
end

--- Return the name of the active leaf.
---@param fsm rfsm.Machine
---@return string|false fqn false when no leaf is active
function rfsm.get_actleaf_fqn(fsm)
  check_machine(fsm, "rfsm.get_actleaf_fqn")
  return fsm._act_leaf and fsm._act_leaf._fqn
end

--- Return the names of the active states, from the root to the leaf.
---@param fsm rfsm.Machine
---@return string[] configuration empty when the machine is inactive
function rfsm.get_active_conf(fsm)
  check_machine(fsm, "rfsm.get_active_conf")
  local names, state = {}, fsm._mode ~= "inactive" and fsm
  while state do
    names[#names + 1], state = state._fqn, state._actchild
  end
  return names
end

--- Return the mode of a state.
---@param state rfsm.State
---@return "active"|"inactive"|"done" mode
function rfsm.get_sta_mode(state)
  return type(state) == "table" and state._mode or "inactive"
end

--- Return the active child of a composite.
---@param state rfsm.State
---@return rfsm.State? child nil if no child is active
function rfsm.actchild_get(state)
  return type(state) == "table" and state._actchild or nil
end

--- Call `f(obj, parent, name)` for each element below `fsm` that `pred` accepts.
--
-- Parents come before children, numeric keys before names, names in sorted order. For a
-- machine the first call is `f(fsm, fsm, "root")`.
--
---@param f fun(obj: table, parent: rfsm.State, name: string|integer): any
---@param fsm table a machine, a model, or any table of elements
---@param pred? fun(obj: any): boolean default is_fsmobj
---@param depth? integer number of levels, default all
---@return any[] results the results of f, in order, without nils
function rfsm.mapfsm(f, fsm, pred, depth)
  check_function(f, "rfsm.mapfsm")
  if type(fsm) ~= "table" then error("rfsm.mapfsm: state expected, " .. got(fsm), 2) end
  pred = pred or rfsm.is_fsmobj
  local results = {}
  local function is_member(value, key)
    return rfsm.is_fsmobj(value) and not is_meta(key)
  end
  local function map_members(state, levels)
    if levels < 1 then return end
    for _, key in ipairs(sorted_keys(state, is_member)) do
      local obj = state[key]
      if pred(obj) then results[#results + 1] = f(obj, state, key) end
      if is_state(obj) then map_members(obj, levels - 1) end
    end
  end
  if rfsm.is_root(fsm) and pred(fsm) then results[1] = f(fsm, fsm, "root") end
  map_members(fsm, depth or huge)
  return results
end

do
  local function itself(element) return element end

  -- Lists the elements of a machine while preproc functions run. They are in the order
  -- of `mapfsm`, which is computed once for all machines of the plan.
  local function planned_elements(fsm, pred)
    local nodes, transitions, order = fsm._nodes, fsm._transitions, fsm._plan.order
    if not order then
      order = rfsm.mapfsm(function(element) return element["_%def"] end, fsm)
      fsm._plan.order = order
    end
    local list, is_simple = {}, pred == rfsm.is_trans -- the most common case
    for i = 1, #order do
      local def = order[i]
      if def.kind == "transition" then
        list[#list + 1] = (is_simple or not pred or pred(transitions[def.index]))
          and transitions[def.index] or nil
      elseif not is_simple and (not pred or pred(nodes[def.index])) then
        list[#list + 1] = nodes[def.index]
      end
    end
    return list
  end

  --- List the elements that `pred` accepts among `obj` and its members, for extensions.
  --
  -- A preproc function `f(fsm, merged)` works on `rfsm.elements(merged or fsm, pred)`.
  -- Machines with the same `rfsm.structure_of` have their elements in the same order.
  --
  ---@param obj table a machine or an element of one
  ---@param pred? fun(obj: any): boolean default is_fsmobj
  ---@return table[] elements parents before children
  function rfsm.elements(obj, pred)
    local is_root = rfsm.is_root(obj)
    if is_root and obj._preparing then return planned_elements(obj, pred) end
    local list = not is_root and (not pred or pred(obj)) and { obj } or {}
    if rfsm.is_trans(obj) then return list end
    return append(list, rfsm.mapfsm(itself, obj, pred)) -- `mapfsm` lists a root
  end
end

--- The field `_regions` of a state in which an extension runs machines.
---@class rfsm.Regions
---@field [integer] rfsm.Machine the machines, in the order in which they are stepped
---@field names any[] the names of these machines, in the same order
---@field entry? function the user's entry, if the extension has replaced it
---@field exit? function the user's exit, if the extension has replaced it

--- List the machines that run in a state, in the order in which they are stepped.
---@param state rfsm.State a state of a machine
---@return rfsm.Machine[] regions empty if there are none; the caller must not change it
---@return rfsm.Regions? own the field `_regions`; nil if no machines run in the state
function rfsm.regions(state)
  local own = is_state(state) and rawget(state, "_regions")
  if type(own) ~= "table" then return NONE, nil end
  return append({}, own), own
end

--- List the nodes to which a transition may lead.
--
-- An extension may change the target of a transition so that it leads to any node in a
-- composite. Then the extension keeps the model's target in the field `_initial`.
--
---@param tr rfsm.Transition a transition of a machine
---@return (rfsm.State|rfsm.Connector)[] targets the target; or `_initial` and all nodes
-- of the composite that contains it
function rfsm.targets(tr)
  local initial = tr._initial
  if not initial then return { tr.tgt } end
  return append({ initial }, rfsm.elements(initial._parent, rfsm.is_node))
end

--- A machine, and where it runs.
---@class rfsm.Place
---@field machine rfsm.Machine
---@field owner rfsm.Machine|false the parent machine, whose state runs it
---@field state rfsm.State|false the state of the parent machine that runs it
---@field prefix string "root", or the name of the region: "root.arms.left"

--- List a machine, then the regions in its states, at any depth.
---@param fsm rfsm.Machine
---@return rfsm.Place[] places
function rfsm.machines(fsm)
  check_machine(fsm, "rfsm.machines")
  local places = {}
  local function visit(machine, owner, state, prefix)
    places[#places + 1] = {
      machine = machine, owner = owner, state = state, prefix = prefix,
    }
    for _, leaf in ipairs(rfsm.elements(machine, rfsm.is_leaf)) do
      local regions, own = rfsm.regions(leaf)
      for i, region in ipairs(regions) do
        local name = text_of(own.names[i])
        visit(region, machine, leaf, prefix .. leaf._fqn:sub(5) .. "." .. name)
      end
    end
  end
  visit(fsm, false, false, "root")
  return places
end

do
  -- Returns the node with a name such as "root.par.left.a" in a machine or its regions.
  local function find_by_name(fsm, name)
    for _, at in ipairs(rfsm.machines(fsm)) do
      for _, node in ipairs(at.machine._nodes) do
        if at.prefix .. node._fqn:sub(5) == name then return node end
      end
    end
  end

  --- Is a state of the machine, or of one of its regions, active?
  ---@param fsm rfsm.Machine
  ---@param state rfsm.State|string a state, or a name such as "root.par.left.a"
  ---@return boolean
  function rfsm.is_in(fsm, state)
    check_machine(fsm, "rfsm.is_in")
    local node = type(state) == "string" and find_by_name(fsm, state) or state
    if not is_state(node) or not node._mode then
      error("rfsm.is_in: state of the machine expected, " .. got(state)
        .. (type(state) == "string" and advise("state_name", fsm, state) or ""), 2)
    end
    return node._mode ~= "inactive"
  end
end

--- Compile a machine completely now, not while it runs.
--
-- Without this call a path is compiled when it has been taken a few times. This is also
-- true of paths that change later, by `fsm_merge` or because a first hook is set.
--
---@param fsm rfsm.Machine
function rfsm.prepare(fsm)
  check_machine(fsm, "rfsm.prepare")
  for _, at in ipairs(rfsm.machines(fsm)) do
    local plan, name = at.machine._plan, at.machine._is_hooked and "run_hooked" or "run"
    prepare_entry(plan.nodes[1])
    for _, def in ipairs(plan.nodes) do
      if def.kind == "connector" then note_of(at.machine, def) end
      for _, choice in pairs(def.is_leaf and list_choices(def) or NONE) do -- any order
        prepare_choice(def, choice, name)
      end
    end
  end
end

-- Tools: functions that inspect or move a machine. No iteration calls them .........

--- Call `f(fsm, state)` for each state from `from` up or down to `to`, both included.
-- @raise when neither is an ancestor of the other
---@param fsm rfsm.Machine
---@param f fun(fsm: rfsm.Machine, state: rfsm.State): any
---@param from rfsm.State where to begin
---@param to rfsm.State an ancestor or descendant of `from`
---@return any[] results the results of f, in order, without nils
function rfsm.map_from_to(fsm, f, from, to)
  check_machine(fsm, "rfsm.map_from_to")
  check_function(f, "rfsm.map_from_to")
  if not (is_node_of(fsm, from) and is_node_of(fsm, to)) then
    error("rfsm.map_from_to: two nodes of the fsm expected, " .. got(from) .. " and "
      .. got(to), 2)
  end
  local up, down, results = from["_%def"], to["_%def"], {}
  local line = line_to(up.depth >= down.depth and up or down)
  if line[up.depth + 1] ~= up or line[down.depth + 1] ~= down then
    error(("rfsm.map_from_to: '%s' and '%s' are not on one line"):format(from._fqn,
      to._fqn), 2)
  end
  for depth = up.depth, down.depth, up.depth > down.depth and -1 or 1 do
    results[#results + 1] = f(fsm, fsm._nodes[line[depth + 1].index])
  end
  return results
end

--- Find the path that events would enable from a node, without taking it.
--
-- A path is a table { node, nextl }. `nextl` is a list of tables { trans, next }, whose
-- `next` is the rest of the path. At the end of the path `nextl` is false.
--
---@param fsm rfsm.Machine
---@param node rfsm.State|rfsm.Connector
---@param events any[]
---@return table|false path false if no path is enabled
function rfsm.node_find_enabled(fsm, node, events)
  check_machine(fsm, "rfsm.node_find_enabled")
  if not is_node_of(fsm, node) then
    error("rfsm.node_find_enabled: node of the fsm expected, " .. got(node), 2)
  end
  if type(events) ~= "table" then
    error("rfsm.node_find_enabled: list of events expected, " .. got(events), 2)
  end
  local ways, number = fsm._ways, fsm._search -- a guard may call this
  fsm._ways, fsm._search = {}, 1
  local def = first_enabled(fsm, node["_%def"].otrs, events)
  local path = def and { node = node, nextl = false } or false
  local at = path
  while def do
    local tail = { node = fsm._nodes[def.tgt.index], nextl = false }
    at.nextl = { { trans = fsm._transitions[def.index], next = tail } }
    at, def = tail, def.connector and fsm._ways[def.connector].way
  end
  fsm._ways, fsm._search = ways, number
  return path
end

--- Exit a state and the active states below it, the innermost first.
---@param fsm rfsm.Machine
---@param state rfsm.State
function rfsm.exit_state(fsm, state)
  check_machine(fsm, "rfsm.exit_state")
  if not is_node_of(fsm, state, "state") then
    error("rfsm.exit_state: state of the fsm expected, " .. got(state), 2)
  end
  if state._mode == "inactive" then return end
  if state._actchild then rfsm.exit_state(fsm, state._actchild) end
  local def, at = state["_%def"], fsm._at -- a callback of a path may call this
  fsm._at = 0
  leave(fsm, def, 1)
  run_exit_hooks(fsm, def, 2)
  be_left(fsm, def)
  recorders.exit(fsm, def, 3)
  fsm._at = at
end

-- Sets the mode of a state. Its ancestors become active, all other states inactive.
local function move_to(state, mode)
  local fsm = state
  while fsm._parent ~= fsm do fsm = fsm._parent end
  local left = fsm -- _actchild leads to all active states
  while left do
    local child = left._actchild
    left._mode = "inactive"
    if left._doo_co then left._doo_co = nil end
    if child then rawset(left, "_actchild", nil) end
    left = child
  end
  fsm._act_leaf = false
  state._mode = mode
  if mode ~= "inactive" and state["_%def"].is_leaf then fsm._act_leaf = state end
  while state ~= fsm do
    local parent = state._parent
    if state._mode ~= "inactive" then parent._actchild = state end
    parent._mode, state = "active", parent
  end
end

--- Set the mode of a state.
--
-- Its ancestors become active, all other states inactive. No callback runs.
--
---@param state rfsm.State a state of a machine
---@param mode "active"|"inactive"|"done"
---@return string mode
function rfsm.set_sta_mode(state, mode)
  local def = is_state(state) and state["_%def"]
  if type(def) ~= "table" then
    error("rfsm.set_sta_mode: state of a fsm expected, " .. got(state), 2)
  elseif mode ~= "active" and mode ~= "inactive" and mode ~= "done" then
    error("rfsm.set_sta_mode: 'active', 'done' or 'inactive' expected, " .. got(mode),
      2)
  end
  local is_active, was_active = mode ~= "inactive", state._mode ~= "inactive"
  if is_active ~= was_active or is_active and def.is_leaf then
    local co = is_active and state._doo_co or nil
    move_to(state, mode)
    state._doo_co = co
  end
  return mode
end

--- Promise that a hook, effect or guard does not keep the list of events that it gets.
--
-- Without this promise the machine makes a new list for the next iteration. An
-- iteration that calls only such functions makes no garbage.
--
-- @usage
--    fsm.post_step_hook = rfsm.borrows(function(fsm, events) count(#events) end)
--
---@param f function
---@return function f
function rfsm.borrows(f)
  check_function(f, "rfsm.borrows")
  borrowers[f] = true
  return f
end

-- Hooks: a list is replaced, never changed, so that a loop over it is not disturbed ...

do
  -- Hooks called in an iteration. Machines with such a hook use `iterate_hooked`.
  local IN_STEP = { _pre_hooks = true, _post_hooks = true, _path_hooks = true,
    _entry_hooks = true, _exit_hooks = true }

  -- Hooks placed in "front" add or record events. They are called before hooks placed
  -- "before", which may remove events. A list has the number of front hooks in `front`.
  local PLACES = { front = true, before = true, after = true }

  -- Adds a hook to the list in a field of `owner`.
  local function put_in(owner, field, hook, place)
    local old = owner[field] or NONE
    local hooks, front = append({}, old), old.front or 0
    local before = place == "before" and front + 1 or #hooks + 1
    insert(hooks, place == "front" and 1 or before, hook)
    hooks.front = place == "front" and front + 1 or front
    owner[field] = hooks
  end

  local function hook_adder(where, field)
    return function(fsm, hook, place)
      check_machine(fsm, where)
      check_function(hook, where)
      if place ~= nil and not PLACES[place] then
        error(where .. ": 'before' or 'after' expected, " .. got(place), 2)
      end
      put_in(fsm, field, hook, place)
      if IN_STEP[field] then fsm._is_hooked, fsm._is_usual = true, false end
    end
  end

  -- Makes a function that adds a hook to the list of a key. Keys are states, or the
  -- words of `rfsm.Watched`.
  local function keyed_adder(where, field, is_key, expected)
    return function(fsm, key, hook)
      check_machine(fsm, where)
      check_function(hook, where)
      if not is_key(fsm, key) then
        error(where .. ": " .. expected .. " expected, " .. got(key), 2)
      end
      fsm[field] = fsm[field] or {}
      put_in(fsm[field], key, hook)
      if IN_STEP[field] then fsm._is_hooked, fsm._is_usual = true, false end
    end
  end

  -- Removes a hook from the list in a field of `owner`. An empty list becomes false, as
  -- in a new machine. Returns true if the hook was in the list.
  local function take_out(owner, field, hook)
    local hooks = owner[field] or NONE
    for i = 1, #hooks do
      if rawequal(hooks[i], hook) then
        local others, front = append({}, hooks), hooks.front or 0
        remove(others, i)
        others.front = i <= front and front - 1 or front
        owner[field] = others[1] and others or false
        if #others == 1 and others[1] == OWN then owner[field] = OWN_ONLY end
        return true
      end
    end
    return false
  end

  -- Makes a function that removes a hook: from the list in `field`, or, if the hook is
  -- in the machine's field `slot`, from this field.
  local function hook_remover(where, field, slot)
    return function(fsm, hook)
      check_machine(fsm, where)
      if take_out(fsm, field, hook) then return true end
      if not slot or hook == nil or not rawequal(fsm[slot], hook) then return false end
      fsm[slot] = nil
      return true
    end
  end

  local function keyed_remover(where, field)
    return function(fsm, key, hook)
      check_machine(fsm, where)
      return take_out(fsm[field] or NONE, key, hook)
    end
  end

  local function is_state_of(fsm, state) return is_node_of(fsm, state, "state") end

  --- Have `hook(fsm, state)` called each time `state` is entered, before its entry.
  --
  -- For extensions: a tool that replaces `state.entry` does not remove the hook. An
  -- error of the hook is raised when the iteration is over.
  --
  ---@type fun(fsm: rfsm.Machine, state: rfsm.State, hook: function)
  rfsm.entry_hook_add = keyed_adder("rfsm.entry_hook_add", "_entry_hooks", is_state_of,
    "state of the fsm")

  --- Remove an entry hook of a state. Return true if the state had this hook.
  ---@type fun(fsm: rfsm.Machine, state: rfsm.State, hook: function): boolean
  rfsm.entry_hook_rm = keyed_remover("rfsm.entry_hook_rm", "_entry_hooks")

  --- Have `hook(fsm, state)` called each time `state` is left, after its exit.
  ---@type fun(fsm: rfsm.Machine, state: rfsm.State, hook: function)
  rfsm.exit_hook_add = keyed_adder("rfsm.exit_hook_add", "_exit_hooks", is_state_of,
    "state of the fsm")

  --- Remove an exit hook of a state. Return true if the state had this hook.
  ---@type fun(fsm: rfsm.Machine, state: rfsm.State, hook: function): boolean
  rfsm.exit_hook_rm = keyed_remover("rfsm.exit_hook_rm", "_exit_hooks")

  --- Have `hook(fsm, events)` called in each iteration before a transition is chosen.
  --
  -- The hook may change the list of events. `fsm.pre_step_hook` is called together with
  -- these hooks, and a program may still set this field. `place`, "after" (default) or
  -- "before", is relative to the other hooks.
  --
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.pre_step_hook_add = hook_adder("rfsm.pre_step_hook_add", "_pre_hooks")

  --- Remove a pre step hook. Return true if the machine had this hook.
  ---@type fun(fsm: rfsm.Machine, hook: function): boolean
  rfsm.pre_step_hook_rm = hook_remover("rfsm.pre_step_hook_rm", "_pre_hooks",
    "pre_step_hook")

  --- Have `hook(fsm, events)` called at the end of each iteration.
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.post_step_hook_add = hook_adder("rfsm.post_step_hook_add", "_post_hooks")

  --- Remove a post step hook. Return true if the machine had this hook.
  ---@type fun(fsm: rfsm.Machine, hook: function): boolean
  rfsm.post_step_hook_rm = hook_remover("rfsm.post_step_hook_rm", "_post_hooks",
    "post_step_hook")

  --- For post step hooks: will `step` iterate again, because no transition was enabled?
  ---@param fsm rfsm.Machine
  ---@return boolean
  function rfsm.is_free(fsm)
    check_machine(fsm, "rfsm.is_free")
    return fsm._outcome == "free"
  end

  --- For post step hooks: is nothing left to do, unless an event comes?
  ---@param fsm rfsm.Machine
  ---@return boolean
  function rfsm.is_idle(fsm)
    check_machine(fsm, "rfsm.is_idle")
    return fsm._outcome == "idle" and fsm._intq[1] == nil
  end

  --- Has the machine taken a path since the last call of this function?
  --
  -- A host that calls this between steps needs no path hook.
  --
  ---@param fsm rfsm.Machine
  ---@return boolean
  function rfsm.took_path(fsm)
    check_machine(fsm, "rfsm.took_path")
    local path = fsm._path
    if fsm._phase ~= "take" then fsm._path = false end
    return path ~= false
  end

  --- Have `hook(fsm, path)` called before a path, a list of transitions, is taken.
  --
  -- For observers. An error of the hook is raised when the iteration is over.
  --
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.path_hook_add = hook_adder("rfsm.path_hook_add", "_path_hooks")

  --- Remove a path hook. Return true if the machine had this hook.
  ---@type fun(fsm: rfsm.Machine, hook: function): boolean
  rfsm.path_hook_rm = hook_remover("rfsm.path_hook_rm", "_path_hooks")

  local WATCHED = { sent = true, failed = true, resumed = true, ended = true,
    merged = true }

  --- Have `hook(fsm, ...)` called for one of five occasions, for observers.
  --
  -- These are the values of `what`, and the arguments of the hook after `fsm`:
  --
  --    "sent": event ...               events were sent
  --    "failed": element, name, error  the callback `name` of the element has failed
  --    "resumed": leaf                 the doo of the leaf is resumed
  --    "ended": leaf                   the doo of the leaf has ended
  --    "merged": element               the element was added by `fsm_merge`
  --
  -- An error of the hook is raised when the iteration is over.
  --
  ---@type fun(fsm: rfsm.Machine, what: rfsm.Watched, hook: function)
  rfsm.watch_hook_add = keyed_adder("rfsm.watch_hook_add", "_watch_hooks",
    function(_, what) return WATCHED[what] end,
    "'sent', 'failed', 'resumed', 'ended' or 'merged'")

  --- Remove a watch hook. Return true if the machine had this hook.
  ---@type fun(fsm: rfsm.Machine, what: rfsm.Watched, hook: function): boolean
  rfsm.watch_hook_rm = keyed_remover("rfsm.watch_hook_rm", "_watch_hooks")

  --- Have `hook(fsm)` called when the machine is reset, to reset an extension's data.
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.reset_hook_add = hook_adder("rfsm.reset_hook_add", "_reset_hooks")

  --- Remove a reset hook. Return true if the machine had this hook.
  ---@type fun(fsm: rfsm.Machine, hook: function): boolean
  rfsm.reset_hook_rm = hook_remover("rfsm.reset_hook_rm", "_reset_hooks")

  --- Have `hook(fsm, state)` list the events to which an extension reacts in a state.
  --
  -- Events of transitions are not included. The result nil means no events.
  -- `rfsm.reactions` lists the events of all hooks. Explorations omit events to which
  -- nothing reacts, and tools warn of them. A function in the list is a predicate.
  --
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.reaction_hook_add = hook_adder("rfsm.reaction_hook_add", "_reaction_hooks")

  --- Have `hook(fsm)` list the events that an extension keeps for later; nil for none.
  --- Tools show them beside the queue.
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.waiting_hook_add = hook_adder("rfsm.waiting_hook_add", "_waiting_hooks")
end

-- Calls all hooks of a list, and joins the lists that they return.
local function collect(hooks, ...)
  local list = {}
  for _, hook in ipairs(hooks or NONE) do append(list, hook(...) or NONE) end
  return list
end

--- List the events to which extensions react while a state is active.
---@param fsm rfsm.Machine
---@param state rfsm.State
---@return any[] events
function rfsm.reactions(fsm, state)
  return collect(fsm._reaction_hooks, fsm, state)
end

--- List the events that extensions keep for later.
---@param fsm rfsm.Machine
---@return any[] events
function rfsm.waiting(fsm) return collect(fsm._waiting_hooks, fsm) end

-- Snapshots: the data of extensions, and the configuration of the machine .........

--- Have snapshots of a machine include data of an extension, under `name`.
--
-- `save(fsm)` returns plain data, or nil. `load(fsm, data, how)` restores the result of
-- `save` or raises an error; the table `how` describes changes of the chart since then.
-- `is_explored` is true if transitions depend on the data: explorations keep it, too.
--
---@param fsm rfsm.Machine
---@param name string
---@param save fun(fsm: rfsm.Machine): any
---@param load fun(fsm: rfsm.Machine, data: any, how: table)
---@param is_explored? boolean
function rfsm.snapshot_hook_add(fsm, name, save, load, is_explored)
  check_machine(fsm, "rfsm.snapshot_hook_add")
  check_function(save, "rfsm.snapshot_hook_add")
  check_function(load, "rfsm.snapshot_hook_add")
  fsm._snapshot_hooks = append(append({}, fsm._snapshot_hooks or NONE),
    { { name = name, save = save, load = load, is_explored = is_explored } })
end

--- List the arguments of all calls of `snapshot_hook_add`, in order, for extensions.
---@param fsm rfsm.Machine
---@return { name: string, save: function, load: function, is_explored?: boolean }[]
function rfsm.snapshot_hooks(fsm) return fsm._snapshot_hooks or NONE end

--- Reset a machine, then make `leaf` active (false: no leaf); no callback runs.
---@type fun(fsm: rfsm.Machine, leaf: rfsm.State|false, mode: string, queue: any[])
function rfsm.place(fsm, leaf, mode, queue)
  check_between_steps(fsm, "rfsm.place")
  if leaf then
    move_to(leaf, mode)
    tell(fsm, fsm._reset_hooks)
    fsm._reset_wanted = false
  else
    reset_now(fsm)
  end
  fsm._intq, fsm._curq, fsm._path = queue, {}, false
  raise_failure(fsm)
end

-- Merge: a new element of a live machine ------------------------------------------

do
  -- Returns the reason why the leaf `parent` cannot become a composite; nil if it can.
  local function leaf_obstacle(fsm, parent)
    if parent._mode ~= "inactive" then
      return ("'%s' is an active leaf state"):format(parent._fqn)
    elseif fsm._phase == "take" or fsm._phase == "search" and not fsm._act_leaf then
      return ("'%s' is a leaf state, while a transition is taken"):format(parent._fqn)
    end
  end

  -- Returns the reason why `obj` cannot become a member of `parent`; nil if it can.
  local function merge_obstacle(fsm, parent, obj, id)
    local kind = kind_of(obj)
    if not is_node_of(fsm, parent, "state") then
      return "parent: a state of the fsm expected, " .. got(parent)
    elseif not kind then
      return "state, transition or connector expected, " .. got(obj)
    elseif id == nil and kind ~= "transition" then
      return "a " .. kind .. " needs a name"
    elseif id ~= id then
      return "a name expected, got NaN"
    elseif id ~= nil and rawget(parent, id) ~= nil then
      return ("'%s' has a member '%s' already"):format(parent._fqn, text_of(id))
    elseif is_node_of(fsm, obj)
      and find_lca(parent["_%def"], obj["_%def"]) == obj["_%def"] then
      return ("'%s' cannot contain itself"):format(obj._fqn)
    elseif kind ~= "transition" and parent["_%def"].is_leaf then
      return leaf_obstacle(fsm, parent)
    end
  end

  -- Adds `obj` to the machine's new plan, as a member of `parent`. Returns the build.
  local function build_merge(fsm, plan, parent, obj, id)
    local build, first = new_build(plan), #plan.transitions + 1
    build.fsm = fsm
    for _, def in ipairs(plan.nodes) do note_mount(build, def) end
    if rfsm.is_trans(obj) then
      new_transition(build, obj, parent, id)
      if parent.is_leaf then
        add(build.warnings, parent, nil, "a transition inside a leaf state")
      end
    else
      local node = new_node(build, kind_of(obj), obj, parent, id)
      clone_below(build, node.index)
      if parent.doo then
        add(build.problems, parent, "doo", "only a leaf state can have a doo")
      end
    end
    resolve(build, first)
    return build
  end

  -- If `parent` was a leaf and is a composite now, makes its `initial` the target of
  -- the transitions to it. Returns the numbers of these transitions.
  local function move_targets(build, parent, first)
    local moved = {}
    if parent.is_leaf then return moved end
    for i = 1, first - 1 do
      local def = build.plan.transitions[i]
      if def.tgt == parent and not def.is_internal then
        moved[#moved + 1], def.tgt = i, find_entrance(build, def, parent)
      end
    end
    return moved
  end

  -- Removes the elements from number `first` on, from the list and from their parents.
  local function truncate(list, first)
    for i = #list, first, -1 do
      local element = list[i]
      if rawequal(rawget(element._parent, element["_%def"].id), element) then
        rawset(element._parent, element["_%def"].id, nil)
      end
      list[i] = nil
    end
  end

  -- Makes a machine use a plan, and sets the targets of the transitions in `moved`.
  local function use_targets(fsm, plan, moved)
    for _, i in ipairs(moved) do
      fsm._transitions[i].tgt = fsm._nodes[plan.transitions[i].tgt.index]
    end
    use_plan(fsm, plan)
  end

  local function undo_merge(fsm, plan, moved)
    truncate(fsm._transitions, #plan.transitions + 1)
    truncate(fsm._nodes, #plan.nodes + 1)
    use_targets(fsm, plan, moved)
  end

  -- Cleans up after an error of a preproc function. If `outer` is a number, the preproc
  -- function with this number has called `fsm_merge`, and continues.
  local function stop_preprocessing(fsm, outer)
    fsm._preparing = outer
    for _, tr in ipairs(outer and NONE or fsm._transitions) do
      tr.events, tr.pn = nil, nil
    end
  end

  local function refuse(fsm, reason)
    report(fsm, "err", reason)
    return false, reason
  end

  --- Add a state, connector or transition to a live machine.
  --
  -- From the next iteration on the machine behaves as if its model had the new element.
  -- If `obj` cannot be added, the reason is reported to `err`, and nothing has changed.
  --
  ---@param fsm rfsm.Machine
  ---@param parent rfsm.State the state of the machine that gets the new element
  ---@param obj rfsm.State|rfsm.Connector|rfsm.Transition the element, which is cloned
  ---@param id? string its name; optional for a transition
  ---@return boolean is_merged
  ---@return string? reason the reason if it was not added
  function rfsm.fsm_merge(fsm, parent, obj, id)
    check_machine(fsm, "rfsm.fsm_merge")
    local obstacle = merge_obstacle(fsm, parent, obj, id)
    if obstacle then return refuse(fsm, "rfsm.fsm_merge: " .. obstacle) end
    if id == nil then id = #parent + 1 end
    local old, plan = fsm._plan, copy_plan(fsm._plan)
    local first_node, first_transition = #plan.nodes + 1, #plan.transitions + 1
    local parent_def = plan.nodes[parent["_%def"].index]
    local build = build_merge(fsm, plan, parent_def, obj, id)
    local moved = move_targets(build, parent_def, first_transition)
    if rfsm.is_trans(obj) and not plan.transitions[first_transition] then
      append(build.problems, build.warnings) -- in a leaf a wrong end is a warning
    end
    local problems = lines_of(build.problems)
    if problems[1] then return refuse(fsm, summary("rfsm.fsm_merge", problems)) end
    compile(plan)
    local outer = fsm._preparing
    local ok, found = pcall(function()
      make_elements(fsm, plan, first_node, first_transition)
      use_targets(fsm, plan, moved)
      return preprocess(fsm, parent[id])
    end)
    if not ok then stop_preprocessing(fsm, outer) end
    if not ok or found[1] then
      undo_merge(fsm, old, moved)
      if rfsm.is_interrupt(found) then error(found, 0) end
      if not ok then found = { "a preproc function failed: " .. text_of(found) } end
      return refuse(fsm, summary("rfsm.fsm_merge", found))
    end
    report_lines(fsm, "info", build.created)
    report_findings(fsm, first_node, first_transition)
    report_dead_ends(fsm, first_node)
    tell_watch(fsm, "merged", parent[id])
    return true
  end
end

-- Names: fields that are modules of their own, and the older names of modules -------

local FIELDS = { seqand = "rfsm_seqand", pp = "rfsmpp" }

setmetatable(rfsm, { __index = function(_, field)
  rfsm[field] = FIELDS[field] and find_module(FIELDS[field])
  return rawget(rfsm, field)
end })

do
  -- Loaded as "libs.rfsm" this file has the prefix "libs."; by `dofile`, a folder only.
  local prefix = tostring((...)):match("^(.+[./])rfsm$")
  local source = (find_global("debug", "getinfo") or tostring)(1, "S")
  local folder = type(source) == "table" and source.source:match("^@(.-)[^/\\]*$")
  local searchers, find_beside

  -- Asks other searchers for a module beside this file; they may look into archives.
  local function find_by_others(name)
    for i = 1, prefix and #searchers or 0 do
      local chunk, where = nil, nil
      if searchers[i] ~= find_beside then
        chunk, where = searchers[i](prefix .. name)
      end
      if type(chunk) == "function" then return chunk, where end
    end
  end

  local function find_file(name)
    local file, folders = name:gsub("%.", "/") .. ".lua", {}
    if folder then folders = { folder, folder .. "compat/" } end
    for other in rawget(_G, "package").path:gmatch("([^;]*)%?%.lua") do
      folders[#folders + 1] = other .. "compat/"
    end
    for _, at in ipairs(folders) do
      local chunk = loadfile(at .. file)
      if chunk then return chunk, at .. file end
    end
  end

  -- Searcher for `require`: finds the modules beside this file, and in compat/ their
  -- older names (rfsm_emem for rfsm.emem). A name with the prefix is the same module.
  function find_beside(name)
    local plain = prefix and name:sub(1, #prefix) == prefix and name:sub(#prefix + 1)
    if not (plain or name):find("^rfsm[%w_.]") then return nil end
    if plain then return function() return require(plain) end, name end
    local chunk, where = find_by_others(name)
    if not chunk then chunk, where = find_file(name) end
    return chunk and function() return chunk(name, where) end, where
  end

  -- Takes the modules of an earlier copy of the core out of `package.loaded`: they know
  -- nothing of machines of this one. Whoever requires them again gets new ones.
  local function forget_modules(loaded)
    for name, module in pairs(loaded) do -- any order: each stands alone
      if type(module) == "table" and tostring(name):find("^rfsm[%w_.]") then
        loaded[name] = nil
      end
    end
  end

  -- Registers the module and the searcher. With a prefix the modules beside this file
  -- come before others that are installed. In a sandbox `package` may have no fields.
  local function register(package)
    searchers = package.searchers or package.loaders
    if searchers and searchers.rfsm and type(package.loaded.rfsm) ~= "table" then
      forget_modules(package.loaded)
    end
    if searchers and loadfile and not searchers.rfsm then
      searchers.rfsm = find_beside -- marks the searcher as installed
      insert(searchers, prefix and 2 or #searchers + 1, find_beside)
    end
    if package.loaded and not package.loaded.rfsm then package.loaded.rfsm = rfsm end
  end

  register(rawget(_G, "package") or NONE)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm", rfsm) end

return rfsm
