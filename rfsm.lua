--- Statecharts in pure Lua: load, check, compile and run a model.
--
-- A model is a tree of plain tables, marked by `rfsm.state`, `rfsm.trans` and
-- `rfsm.conn`. `rfsm.init` checks it, reports every mistake with its location, and
-- makes an independent machine of it; `rfsm.step` and `rfsm.run` advance the machine,
-- and `rfsm.send_events` feeds it. The caller drives: nothing here waits by itself.
--
-- The file reads in the order the data flows: model elements, load, check, clone,
-- resolve, compile, machine, run, build, use, tools, merge. An FQN is a fully qualified
-- name ("root.a.b"); an iteration is one turn of the loop inside `step`. What a machine
-- does is complete here; rfsm/fast.lua makes it faster.
--
-- @module rfsm
-- @license BSD-3-Clause

local error, getmetatable, ipairs = error, getmetatable, ipairs
local next, pairs = next, pairs
local pcall, rawequal, rawget, rawset, select = pcall, rawequal, rawget, rawset, select
local setmetatable, tostring, type, xpcall = setmetatable, tostring, type, xpcall
local concat, insert = table.concat, table.insert
local remove, sort = table.remove, table.sort
local huge = 1 / 0

-- Returns a global, or a field of one; nil where a sandbox lacks it.
local function find_global(name, field)
  local value = rawget(_G, name)
  if not field then return value end
  return type(value) == "table" and rawget(value, field) or nil
end

local coroutine, loadfile = find_global "coroutine", find_global "loadfile"
local loadstring = find_global "loadstring" or find_global "load"
local unpack = find_global("table", "unpack") or find_global "unpack"
local getinfo = find_global("debug", "getinfo")
local getlocal = getinfo and find_global("debug", "getlocal")
local _, require = pcall(function() return require end) -- also one of a bundle

-- LuaJIT 2.1.0-beta3 now and then skips keys in a traversal that it has compiled: those
-- functions are interpreted.
local interpret = find_global("jit", "off") or function() end

---@class rfsm
---@field seqand fun(t: table): rfsm.State
---@field pp table the module rfsmpp
local rfsm = { _VERSION = "rfsm 1.0.0" }

-- Model elements: constructors, predicates, order -----------------------------

--- A state as the user writes it.
--
-- Every key not named here is the user's data. Only a leaf state can have a doo, a
-- coroutine; a true value that it yields means that it is idle.
--
---@class rfsm.State
---@field entry? false|fun(fsm: rfsm.Machine, state: rfsm.State, what: "entry")
---@field exit? false|fun(fsm: rfsm.Machine, state: rfsm.State, what: "exit")
---@field doo? false|fun(fsm: rfsm.Machine, state: rfsm.State, what: "doo"): boolean?
---@field final? boolean a leaf that is meant to be the end
---@field getevents? false|fun(fsm: rfsm.Machine): any[]? this and the rest: root only
---@field dbg? boolean|fun(id: string, ...)
---@field info? boolean|fun(...)
---@field warn? boolean|fun(...)
---@field err? boolean|fun(...)
---@field idle_hook? false|fun(fsm: rfsm.Machine) called instead of returning when idle
---@field pre_step_hook? false|fun(fsm: rfsm.Machine, events: any[])
---@field post_step_hook? false|fun(fsm: rfsm.Machine, events: any[])
---@field gettime? false|fun(): number, number the machine's clock: seconds, nanoseconds
---@field [string|integer] any

--- The same as a constructor returns it, which is no machine.
---@class rfsm.Model : rfsm.State

local State = { rfsm = "state" }

--- An edge from one state or connector to another, as the user writes it.
---@class rfsm.Edge
---@field src string|rfsm.State|rfsm.Connector source; a node after init
---@field tgt string|rfsm.State|rfsm.Connector target; a node after init
---@field events? false|any[]|string any one of them triggers; none: any event does
---@field guard? false|fun(tr: rfsm.Transition, events: any[]): boolean? false inhibits
---@field effect? false|fun(m: rfsm.Machine, tr: rfsm.Transition, s: string, e: any[])
---@field pn? number priority among the transitions of a node, larger first (0)
---@field [string] any

--- The same in a machine.
---@class rfsm.Transition : rfsm.Edge
---@field _fsm rfsm.Machine

local Transition = { rfsm = "transition" }

--- A point where transitions meet; never active.
---@class rfsm.Connector
---@field [string] any

local Connector = { rfsm = "connector" }

--- A model made ready to run by `rfsm.init`; the root state of its own tree.
---@class rfsm.Machine : rfsm.State
---@field _act_leaf rfsm.State|false the innermost active state
---@field _intq any[] events that wait for the next iteration
---@field _curq any[] events of the running iteration

local Machine = { rfsm = "state" }

local KINDS = { state = "state", transition = "transition", connector = "connector" }

--- Return the kind of a model element, nil for any other value, for extensions.
--
-- A table of another library counts if its metatable has a true `rfsm` and its method
-- `type` names a kind.
--
---@param value any
---@return "state"|"transition"|"connector"|nil kind
function rfsm.kind_of(value)
  local class = getmetatable(value)
  local mark = type(class) == "table" and rawget(class, "rfsm")
  if not mark then return nil end
  if KINDS[mark] then return mark end
  local ok, kind = pcall(function() return KINDS[value:type()] end)
  return ok and kind or nil
end

local kind_of = rfsm.kind_of

---@class rfsm.StateConstructor
---@field new fun(self: any, t: rfsm.State): rfsm.Model
---@overload fun(t: rfsm.State): rfsm.Model

---@class rfsm.TransitionConstructor
---@field new fun(self: any, t: rfsm.Edge): rfsm.Transition
---@overload fun(t: rfsm.Edge): rfsm.Transition

---@class rfsm.ConnectorConstructor
---@field new fun(self: any, t: table): rfsm.Connector
---@overload fun(t: table): rfsm.Connector

-- Where the tables of a model were made: table -> "file:line".
local made_at = setmetatable({}, { __mode = "k" })

local define

do
  local this_file = getinfo and getinfo(1, "S").short_src
  local knows_tail_calls = getinfo ~= nil and pcall(getinfo, 1, "t")

  -- Notes the line that called a constructor, `level` functions up. After a tail call
  -- the caller's frame is gone, and `level` names a different function.
  local function note_caller(t, level)
    if not getinfo then return end
    if knows_tail_calls and getinfo(level, "t").istailcall then return end
    local caller = getinfo(level + 1, "Sl")
    if caller and caller.currentline > 0 and caller.short_src ~= this_file then
      local file = caller.source:match("^@(.*)") or caller.short_src -- cut to 60
      made_at[t] = ("%s:%d"):format(file, caller.currentline)
    end
  end

  --- Note the location of an element whose constructor is an extension's.
  ---@param t table the element
  ---@param level integer whose line it is: 2 for the caller of the constructor
  function rfsm.note_location(t, level)
    made_at[t] = nil
    note_caller(t, level + 1)
  end

  -- A metatable for elements that inherit from `base`, a state or transition.
  local function heir_class(base)
    local class = getmetatable(base)
    return {
      rfsm = class.rfsm, type = class.type, new = class.new, __index = base,
      __tostring = class.__tostring,
    }
  end

  -- Gives `class` its constructor: X{...}, X:new{...}; base:new{...} inherits from
  -- base.
  function define(class, name)
    local function mark(base, t, level)
      if type(t) ~= "table" then
        error("rfsm." .. name .. ": table expected, got " .. type(t), level + 1)
      end
      if rawget(t, "_parent") ~= nil and kind_of(t) then return t end -- a live one
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

--- Suspend a doo until the next doo cycle; a true value means idle.
---@type fun(idle?: boolean): rfsm.Machine, rfsm.State, "doo"
rfsm.yield = find_global("coroutine", "yield")

--- Is `key` one of the engine's own (a leading underscore)?
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
  for key, value in pairs(state) do -- any order: one node decides
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
function rfsm.is_root(value) return getmetatable(value) == Machine end

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

--- Return any value as text: numbers alike on every Lua, and no error for any value.
---@param value any
---@return string
function rfsm.text_of(value)
  if type(value) == "number" then return ("%.14g"):format(value) end
  local ok, text = pcall(tostring, value)
  return ok and type(text) == "string" and text or type(value)
end

local is_callable, text_of = rfsm.is_callable, rfsm.text_of

local function list_text(values)
  local texts = {}
  for i = 1, #values do texts[i] = text_of(values[i]) end
  return concat(texts, ", ")
end

local function end_text(node)
  return is_node(node) and (node._fqn or kind_of(node)) or text_of(node)
end

-- state root.a (active)
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

-- T={ src='a', tgt='b', pn=3, events='x, y' }, with FQNs after init.
function Transition.__tostring(tr)
  local text = "T={ src='" .. end_text(tr.src) .. "', tgt='" .. end_text(tr.tgt) .. "'"
  local events = type(tr.events) == "string" and { tr.events } or tr.events
  if tr.pn then text = text .. ", pn=" .. text_of(tr.pn) end
  if type(events) == "table" and events[1] ~= nil then
    text = text .. ", events='" .. list_text(events) .. "'"
  end
  return text .. " }"
end

-- Numbers ascending, then all others by their text.
local function key_before(a, b)
  local is_number = type(a) == "number"
  if is_number ~= (type(b) == "number") then return is_number end
  if is_number then return a < b end
  return text_of(a) < text_of(b)
end

--- Return the keys of a table, numbers ascending, then others by text, for extensions.
---@param t table
---@param pred? fun(value: any, key: any): boolean the keys wanted, default all
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
  local open = find_global("io", "open")
  local returned_by = setmetatable({}, { __mode = "k" }) -- root -> file

  -- Returns the line at which a chart returns its root: the last of the least indented
  -- that begin with `return`. The constructor there is a tail call, of which no frame
  -- has the line.
  local function line_of_root(file)
    local handle, number, found, least = open and open(file), 0, 1, huge
    if not handle then return found end
    for line in handle:lines() do
      number = number + 1
      local indent = line:match("^(%s*)return%f[^%w_]")
      if indent and #indent <= least then found, least = number, #indent end
    end
    handle:close()
    return found
  end

  getmetatable(made_at).__index = function(_, model)
    local file = returned_by[model]
    if not file then return nil end
    made_at[model] = file .. ":" .. line_of_root(file)
    return made_at[model]
  end

  -- Runs a chunk of a chart and returns its state.
  function run_chunk(chunk, file, where)
    local model = chunk(file)
    if is_state(model) then
      returned_by[model] = file
      return model
    end
    local hint = model == nil and " (a chart ends with: return rfsm.state{...})"
      or type(model) == "table" and " (did you mean: return rfsm.state{...}?)" or ""
    error(where .. " found." .. hint, 0)
  end
end

--- Load a model from a file that returns it.
--
-- @usage
--    local fsm = rfsm.init(rfsm.load("examples/hello_world.lua"))
--
-- @raise when there is no file name, the file cannot be read or fails, or it returns
-- no state
---@param file string
---@return rfsm.Model model
---@nodiscard
function rfsm.load(file)
  if type(file) ~= "string" then
    error("rfsm.load: file name expected, got " .. type(file), 2)
  end
  if not loadfile then error("rfsm.load: there is no loadfile here", 2) end
  local chunk, problem = loadfile(file)
  if not chunk then error("rfsm.load: " .. problem, 0) end
  return run_chunk(chunk, file, "rfsm.load: no valid rfsm in file '" .. file .. "'")
end

--- Load a model from a text that returns it.
-- @raise when the text does not compile or fails, or it returns no state
---@param text string Lua source
---@param chunkname? string its name in error messages
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
-- A check appends to the `problems` (they fail `init`) or `warnings` of the build and
-- never raises. They come in the order of the walk; `init` sorts them by location.

--- The data of one `init` or `fsm_merge`. A plan is the part that machines share.
---@class rfsm.Build
---@field plan rfsm.Plan the result
---@field problems { at: string, file?: string, text: string }[]
---@field warnings { at: string, file?: string, text: string }[]
---@field created { line: string }[] `initial` connectors that are not declared
---@field mounts table<table, rfsm.Def[]> model node -> its clones
---@field fsm rfsm.Machine? the machine that something is merged into

--- The definition of a node or transition: all that is known before a machine runs.
--
-- The machines of a model share it. The table of an element in a machine holds the
-- fields of that machine, and inherits the rest from `proto`.
--
---@class rfsm.Def
---@field kind "state"|"transition"|"connector"
---@field index integer its position among the nodes or transitions of the plan
---@field id string|integer
---@field parent rfsm.Def its composite; the root is its own
---@field model table its source in the model
---@field data any[] callbacks and the user's data: key, value, key, value ...
---@field proto table metatable of the elements
---@field fqn string of a node
---@field is_leaf boolean of a state
---@field otrs rfsm.Def[] transitions that leave the node, in the order of trying
---@field src rfsm.Def of a transition, as `tgt`, `events`, `pn`

-- Returns a module that may be missing, nil then.
local function find_module(name)
  if type(require) ~= "function" then return nil end
  local ok, module = pcall(require, name)
  if ok then return module end
  if not text_of(module):find("module '" .. name .. "' not found", 1, true) then
    error(module, 0)
  end
end

-- Returns the hint of rfsm/advice.lua on a topic, an empty text if there is no such
-- file.
local advice

local function advise(topic, ...)
  if advice == nil then advice = find_module("rfsm.advice") or false end
  if not advice then return "" end
  return advice[topic](...)
end

-- The name of an element in messages: an FQN, or root.trans[2] (a -> b), with
-- `field`.
local function name_of(def, field)
  local suffix = field and "." .. field or ""
  if def.kind ~= "transition" then return def.fqn .. suffix end
  local key, model, arrow = def.id, def.model, ""
  if type(model.src) == "string" and type(model.tgt) == "string" then
    arrow = (" (%s -> %s)"):format(model.src, model.tgt)
  end
  if type(key) == "number" then
    return ("%s.trans[%s]%s%s"):format(def.parent.fqn, text_of(key), suffix, arrow)
  end
  return def.parent.fqn .. "." .. text_of(key) .. suffix .. arrow
end

local function add(list, def, field, text, ...)
  if select("#", ...) > 0 then text = text:format(...) end
  list[#list + 1] = {
    at = name_of(def, field), file = made_at[def.model], text = text,
  }
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

local CALLBACKS = {
  state = { entry = true, exit = true, doo = true }, connector = {},
  transition = { guard = true, effect = true },
}
local HOOKS = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook", "gettime" }
local PRINTERS = { "dbg", "info", "warn", "err" }

local function check_callable(build, def, field, value)
  if value and not is_callable(value) then
    add(build.problems, def, field, "function expected, " .. got(value))
  end
end

-- Clone: a definition for each position of a node -------------------------------

--- Return the model that a machine or an element of one was made of, for extensions.
---@param value any
---@return any model the value itself if it is no part of a machine
function rfsm.model_of(value)
  local class = getmetatable(value)
  if class == Machine then return value._plan.model end
  local def = type(class) == "table" and rawget(class, "_%def")
  return def and def.model or value
end

--- Return a table that machines of the same structure share, for extensions.
--
-- `fsm_merge`, and events that a preproc function changes, give a machine another one.
--
---@param fsm rfsm.Machine
---@return table structure
function rfsm.structure_of(fsm) return fsm._plan end

--- Return the name of the target that the model gives a transition, for extensions.
---@param tr rfsm.Transition a transition of a machine
---@return string fqn "internal" for an internal transition
function rfsm.target_of(tr)
  return tr._is_internal and "internal" or tr["_%def"].tgt.fqn
end

local model_of = rfsm.model_of

-- A node table of a model may stand in several places: notes that `def` is one of them.
local function note_mount(build, def)
  local mounts = build.mounts[def.model] or {}
  mounts[#mounts + 1], build.mounts[def.model] = def, mounts
end

local clone_below, new_node, new_transition

do
  local CONSTRUCTORS = {
    [State] = "state", [Transition] = "trans", [Connector] = "conn",
  }
  local ROOT_FIELDS = {}
  for i = 1, 4 do ROOT_FIELDS[PRINTERS[i]] = true end
  for i = 1, #HOOKS do ROOT_FIELDS[HOOKS[i]] = true end

  -- The engine's own fields that anybody may read: never taken for the user's data.
  local API_FIELDS = {}
  for name in ("act_leaf actchild curq doo_co fqn fsm id initialized intq mode otrs "
    .. "parent"):gmatch("%S+") do
    API_FIELDS["_" .. name] = true
  end

  -- A node needs a name that a reference can spell and that is no field of its parent.
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

  -- Returns the events of a transition as a list of its own: a list of anything but NaN
  -- without holes, or one string. False when there are none.
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
          .. "holes or keys")
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

  -- Warns of a plain table that looks like a state or transition somebody forgot to
  -- mark.
  local function check_plain_table(build, def, key, t)
    local form = rawget(t, "src") ~= nil and rawget(t, "tgt") ~= nil and "trans"
    for _, value in pairs(t) do -- any order: one element decides
      if not form and rfsm.is_fsmobj(value) then form = "state" end
    end
    if not form then return end
    local what = form == "trans" and "has 'src' and 'tgt'"
      or "contains states or transitions"
    add(build.warnings, def, text_of(key),
      "a plain table that %s is ignored (did you mean rfsm.%s{...}?)", what, form)
  end

  -- Warns of a field that looks like one of the library's in other words.
  local function check_unknown_field(build, def, key, value)
    if def.kind ~= "transition" and not is_callable(value) then return end
    local meant = def.kind == "transition" and key == "event" and "events"
      or advise("field_meant", def.parent == def and "root" or def.kind, key)
    if meant ~= "" and def.model[meant] == nil then
      add(build.warnings, def, nil, "a %s has no field '%s' (did you mean '%s'?)",
        def.kind, key, meant)
    end
  end

  -- Warns of what would be taken for the user's data, and is more likely a mistake.
  local function check_datum(build, def, key, value)
    local name = CONSTRUCTORS[value]
    if type(value) == "table" and getmetatable(value) == nil then
      check_plain_table(build, def, key, value)
    end
    if name then
      add(build.warnings, def, text_of(key), "rfsm.%s is not called (rfsm.%s{...})",
        name, name)
    elseif def.kind == "connector" and (CALLBACKS.state[key]
      or CALLBACKS.transition[key]) then
      add(build.warnings, def, key, "a connector has no %s, this one is ignored", key)
    elseif type(key) == "string" and not is_meta(key) then
      check_unknown_field(build, def, key, value)
    end
  end

  -- Returns the fields of a model element. An heir inherits callbacks and data, no
  -- nodes and transitions.
  local function fields_of(model)
    local class = getmetatable(model)
    local base = class.__index
    if KINDS[class.rfsm] and base == class or not kind_of(base) then return model end
    local fields = {}
    for key, value in pairs(fields_of(base)) do -- any order: each stands alone
      if not kind_of(value) then fields[key] = value end
    end
    for key, value in pairs(model) do fields[key] = value end -- any order: as above
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

  -- Makes the bare node; `clone_below` fills it in when its turn comes.
  function new_node(build, kind, model, parent, key)
    local def = new_def(build.plan.nodes, kind, model_of(model), parent or false, key)
    def.fqn = parent and parent.fqn .. "." .. text_of(key) or key
    def.depth = parent and parent.depth + 1 or 0
    def.parent = parent or def
    def.is_leaf, def.otrs, def.members = kind == "state", {}, {}
    note_mount(build, def)
    if parent then
      parent.members[key], parent.is_leaf = def, false
      check_name(build, def)
    end
    return def
  end

  -- Is the model of `def` also the model of an ancestor? The walk would never end.
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

  -- Takes over a field that is no element of the model: a callback or the user's data.
  local function clone_field(build, def, key, value)
    if CALLBACKS[def.kind][key] then
      check_callable(build, def, key, value)
      if key == "guard" and value == false then
        add(build.warnings, def, nil, "its guard is false and counts as absent, it was "
          .. "made while the chart was loaded")
      end
      def[key] = value
      if value then add_datum(def, key, value) end
    elseif key == "initial" and def.kind == "state" then
      add(build.problems, def, key, "connector expected, %s "
        .. "(rfsm.trans{ src='initial', tgt=... })", got(value))
    elseif not API_FIELDS[key] then
      add_datum(def, key, value)
      if def.parent == def and ROOT_FIELDS[key] then return end
      check_datum(build, def, key, value)
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
    for field, value in pairs(fields_of(model)) do -- any order: each stands alone
      if not OWN_FIELDS[field] then clone_field(build, def, field, value) end
    end
    def.src, def.tgt, def.pn = model.src, model.tgt, model.pn or nil
    def.events = check_events(build, def, model.events)
    if def.pn and (type(def.pn) ~= "number" or def.pn ~= def.pn) then
      add(build.problems, def, "pn", "number expected, " .. got(def.pn))
      def.pn = nil
    end
    parent.members[key] = def
  end

  local function clone_connector(build, def)
    for key, value in pairs(fields_of(def.model)) do -- any order: each stands alone
      local kind = kind_of(value)
      if kind then
        add(build.warnings, def, nil, "a connector holds no %s, '%s' is ignored", kind,
          text_of(key))
      else
        clone_field(build, def, key, value)
      end
    end
  end

  local function clone_state(build, def)
    local has_transition = false
    for key, value in pairs(fields_of(def.model)) do -- any order: sorted later
      local kind = kind_of(value)
      if not kind then
        clone_field(build, def, key, value)
      elseif kind == "transition" then
        new_transition(build, value, def, key)
        has_transition = true
      else
        new_node(build, kind, value, def, key)
      end
    end
    if def.is_leaf and has_transition then
      add(build.warnings, def, nil, "a transition inside a leaf state")
    elseif def.doo and not def.is_leaf then
      add(build.problems, def, "doo", "only a leaf state can have a doo")
    end
  end

  for _, f in ipairs({ check_events, check_plain_table, clone_connector, clone_state,
    fields_of, new_transition }) do
    interpret(f)
  end

  -- Fills in the nodes from number `first` on; the list grows as it is walked.
  function clone_below(build, first)
    local nodes, i = build.plan.nodes, first
    while nodes[i] do
      if is_inside_itself(nodes[i]) then
        add(build.problems, nodes[i], nil, "a state cannot contain itself")
      elseif nodes[i].kind == "state" then
        clone_state(build, nodes[i])
      else
        clone_connector(build, nodes[i])
      end
      i = i + 1
    end
  end
end

-- Resolve: names become nodes, `e_done` gets the name of its source -------------

local find_entrance, resolve

do
  -- Walks from `def` down the names of a path "a.b"; nil and a reason when one fails.
  -- For a name alone a hint may come from `all` nodes.
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
          def.fqn, advise("nearest_node", name, def, all or NONE))
      end
      def = child
    end
    return def
  end

  -- Returns the node that a name in a transition of `composite` refers to:
  -- (a) ".a.b" or "..a.b" from the composite, (b) "a" in it, or the root itself,
  -- (c) others from the root, where `root.` in front is optional, and a state may be
  -- named so.
  local function find_named(build, composite, name)
    local root, relative = build.plan.nodes[1], name:match("^%.%.?([^.].*)$")
    if relative then return find_below(composite, relative) end
    if not name:find(".", 1, true) then
      local def, reason = find_below(composite, name, build.plan.nodes)
      if name == "root" then return def or root end
      return def, reason
    end
    if name:sub(1, 5) ~= "root." then return find_below(root, name) end
    local def, reason = find_below(root, name:sub(6))
    return def or root.members.root and find_below(root, name), reason
  end

  -- How many ancestors two nodes share.
  local function shared_depth(a, b)
    while a.depth > b.depth do a = a.parent end
    while b.depth > a.depth do b = b.parent end
    while a ~= b do a, b = a.parent, b.parent end
    return a.depth
  end

  -- A node table of the model may be mounted more than once: the nearest clone counts.
  local function find_mounted(build, composite, ref)
    local nearest, most, is_tie = nil, -1, false
    local nodes, live = build.fsm and build.fsm._nodes, getmetatable(ref)["_%def"]
    if nodes and live and rawequal(nodes[live.index], ref) then
      return build.plan.nodes[live.index]
    end
    for _, mount in ipairs(build.mounts[model_of(ref)] or {}) do
      local depth = shared_depth(composite, mount)
      if depth >= most then nearest, most, is_tie = mount, depth, depth == most end
    end
    if is_tie then
      return nil, "the table given stands in several places, use a name"
    end
    return nearest, not nearest and "the table given is no part of this model" or nil
  end

  -- Returns the node that src or tgt of a transition means; nil and a reason when none.
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

  -- An undeclared `initial` comes into being where a transition starts from it.
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

  -- Returns the node at which `def` ends: a composite is entered at its `initial`. Nil,
  -- and a problem, if it has none.
  function find_entrance(build, def, node)
    if node.kind == "connector" or node.is_leaf then return node end
    local initial = node.members.initial
    if initial and initial.kind == "connector" then return initial end
    if node.parent == node then return nil end -- a problem of the root's own
    add(build.problems, def, nil, "tgt '%s': the composite has no initial transition "
      .. "(rfsm.trans{ src='initial', tgt=... })", node.fqn)
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

  -- Returns the node where a transition from `src` ends; of an internal one it is src.
  local function find_target(build, def, src)
    if def.tgt ~= "internal" or def.parent.members.internal then
      return find_end(build, def, "tgt")
    elseif src and src.kind == "connector" then
      return nil, "tgt 'internal': only a state has internal transitions"
    end
    return src, nil, true
  end

  local function resolve_transition(build, def)
    local src, src_reason = find_end(build, def, "src")
    if src then src.is_left = true end
    local tgt, tgt_reason, is_internal = find_target(build, def, src)
    if not def.parent.is_leaf then -- there is a warning of those
      if src_reason then add(build.problems, def, nil, src_reason) end
      if tgt_reason then add(build.problems, def, nil, tgt_reason) end
    end
    tgt = is_internal and src or tgt and find_entrance(build, def, tgt)
    if not (src and tgt) then
      def.is_void = true
      return
    end
    def.src, def.tgt, def.is_internal = src, tgt, is_internal
    resolve_e_done(build, def)
  end

  -- Resolves the transitions from number `first` on. Inside a leaf, one with a wrong
  -- reference is dropped.
  function resolve(build, first)
    local transitions, kept = build.plan.transitions, first - 1
    for i = first, #transitions do create_initial(build, transitions[i]) end
    for i = first, #transitions do
      local def = transitions[i]
      resolve_transition(build, def)
      transitions[i] = nil
      if not def.is_void then
        kept = kept + 1
        transitions[kept], def.index = def, kept
      end
    end
  end
end

-- Compile: the structure becomes lists, shared by all machines of the model ------
--
-- At init only the transitions of each node are listed. The rest is made when a leaf is
-- searched or a transition is taken for the first time, so that unused parts take
-- neither time nor memory. Callbacks are not compiled: each is read when it is called.

--- The structure that machines of a model share.
---@class rfsm.Plan
---@field model rfsm.State its source
---@field nodes rfsm.Def[] parents before children, the root first
---@field transitions rfsm.Def[]
---@field events table<any, true> the events that transitions name
---@field trail table|false see `is_current`; only the plan of a model has one
---@field variants rfsm.Plan[] those made by preproc functions, the latest ones
---@field is_settled boolean? machines have been made of it

local compile, compile_transition, line_to

do
  -- The order in which the transitions of a node are tried: larger pn first, then the
  -- one declared further out, then position in its table, then name.
  local function tried_before(a, b)
    local a_pn, b_pn = a.pn or 0, b.pn or 0
    if a_pn ~= b_pn then return a_pn > b_pn end
    if a.parent.depth ~= b.parent.depth then return a.parent.depth < b.parent.depth end
    if a.parent ~= b.parent then return a.parent.fqn < b.parent.fqn end
    return key_before(a.id, b.id)
  end

  local CLASSES = { state = State, transition = Transition, connector = Connector }

  -- The events of a transition: a list of the caller's own, since machines share the
  -- definition.
  local Events = {}
  function Events.__index(proto, key)
    return key == "events" and append({}, proto["_%def"].events or NONE) or nil
  end

  -- Makes the metatable of the elements, in which absent fields are looked up.
  local function make_proto(def)
    local class = CLASSES[def.kind]
    local proto = {
      ["_%def"] = def, rfsm = def.kind, type = class.type, new = class.new,
      __tostring = class.__tostring, _id = def.id, _fqn = def.fqn, pn = def.pn,
      __eq = rawequal, -- so that no other one's is ever asked
    }
    if def.kind == "transition" then
      proto.guard, proto.effect = false, false
      proto._is_internal = def.is_internal or nil
      setmetatable(proto, Events)
    end
    proto.__index = proto
    def.proto = proto
    if def.is_leaf then def.done_event = "e_done@" .. def.fqn end
  end

  -- Gives each node the list of its outgoing transitions, in order, and removes the
  -- notes of an older structure.
  function compile(plan)
    local nodes, transitions, events = plan.nodes, plan.transitions, {}
    for i = 1, #nodes do
      nodes[i].otrs = {}
      make_proto(nodes[i])
    end
    for i = 1, #transitions do
      local def = transitions[i]
      local otrs = def.src.otrs
      otrs[#otrs + 1] = def
      for j = 1, def.events and #def.events or 0 do events[def.events[j]] = true end
      make_proto(def)
    end
    for i = 1, #nodes do
      if nodes[i].otrs[2] then sort(nodes[i].otrs, tried_before) end
    end
    plan.events, nodes[1].plan = events, plan
    return plan
  end

  -- Returns the nearest ancestor of both ends that stays active. States in it are left
  -- and entered. The root also stays active under a transition from the root.
  local function find_lca(src, tgt)
    local a, b = src.parent, tgt.parent
    while a ~= b do
      if a.depth >= b.depth then a = a.parent else b = b.parent end
    end
    return a
  end

  -- Lists the states that a transition enters, outermost first, and notes the fields
  -- that a run reads, once. Returns the definition.
  function compile_transition(def)
    if def.connector ~= nil then return def end
    local lca, tgt, entries = find_lca(def.src, def.tgt), def.tgt, {}
    local state = tgt.kind == "state" and tgt or tgt.parent
    if def.is_internal then lca, state = tgt, tgt end
    for i = state.depth - lca.depth, 1, -1 do
      entries[i], state = state, state.parent
    end
    def.lca, def.entries = lca, entries
    def.connector = tgt.kind == "connector" and tgt -- last: the others are set
    return def
  end

  -- Lists the states from the root to `leaf`.
  function line_to(leaf)
    if leaf.line then return leaf.line end
    local line, def = {}, leaf
    for i = leaf.depth + 1, 1, -1 do
      line[i], def = def, def.parent
    end
    leaf.line = line
    return line
  end
end

local function new_plan(model)
  return {
    model = model, nodes = {}, transitions = {}, events = {}, trail = false,
    warnings = {}, created = {}, variants = {},
  }
end

-- Returns a plan like this one, for changes: its definitions are new ones.
local function copy_plan(plan)
  local copies, copy = {}, new_plan(plan.model)
  copy.warnings, copy.created = plan.warnings, plan.created
  for _, list in ipairs({ "nodes", "transitions" }) do
    for i, def in ipairs(plan[list]) do
      copies[def] = {}
      copy[list][i] = copies[def]
    end
  end
  local STRUCTURE = {
    "kind", "index", "id", "parent", "model", "data", "fqn", "depth", "is_leaf", "src",
    "tgt", "events", "pn", "is_internal", "doo", "guard",
  }
  for def, new in pairs(copies) do -- any order: each stands alone
    for _, field in ipairs(STRUCTURE) do
      new[field] = copies[def[field]] or def[field]
    end
    if def.members then
      new.members = {}
      for key, member in pairs(def.members) do new.members[key] = copies[member] end
    end
  end
  return copy
end

interpret(copy_plan)

local make_trail, is_current

do
  -- Calls f(t) for each table of the model that a plan was made of.
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

  -- Notes a model, table by table, as the walk of `next` finds it: numbers stand for
  -- keys and values, so that no value is ever compared with another by `==`. A 0 ends a
  -- table.
  function make_trail(plan)
    local ids, n, tables, trail, plain = {}, 0, {}, {}, {}
    local function id_of(value)
      if value ~= value then return 0 end -- NaN: never the same
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

  -- Is the model still the same as when the plan was made?
  function is_current(plan)
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
      if getmetatable(noted.plain[i]) then return false end -- it has become an element
    end
    return true
  end

  interpret(make_trail, true)
  interpret(is_current)
end

-- Machine: an instance of a plan ------------------------------------------------
--
-- A machine is a tree of plain tables: children by name, transitions by position or
-- name, callbacks, `_parent`, `_otrs`, `_mode` and the user's data are raw. `_fqn`,
-- `_id`, `events`, `pn` are inherited from the definition.
--
-- The configuration is kept in the machine, and nowhere else: `_mode` of each state,
-- `_actchild` of each active composite, `_act_leaf`.

local function silent() end

local function no_events() return {} end

-- Stands in a list of hooks for the one that the program has set, such as the field
-- `pre_step_hook`.
local function OWN() end

local OWN_ONLY = { OWN }

-- Fields that few machines ever set.
local DEFAULTS = {
  rfsm = "state", type = State.type, new = State.new, _id = "root", _fqn = "root",
  dbg = silent, getevents = no_events, _entry_hooks = false, _exit_hooks = false,
  _reset_hooks = NONE, _failure = false, _joined = false, _reset_wanted = false,
  _preparing = false, _lends_events = false, _is_prepared = false, _spare = false,
}

-- The fields that a machine has from the start.
local function own_fields()
  return {
    _parent = false, _mode = "inactive", _otrs = false, _act_leaf = false,
    _intq = { "e_init_fsm" }, _curq = {}, _initialized = false,
    -- the structure
    ["_%def"] = false, _plan = false, _nodes = false, _transitions = {},
    -- the iteration, see "Run"
    _act = false, _run = false, _phase = "idle", _path = false, _from = false,
    _ways = {}, _outcome = "free", _after_free = false,
    _calls = { count = 0, begun = 0, noted = 0, ok = true, result = nil, more = nil },
    _pre_hooks = OWN_ONLY, _post_hooks = OWN_ONLY,
    -- for rfsm/fast.lua: are there hooks or a getevents? Is there nothing to do but to
    -- take a path, now and at the end of the iteration?
    _is_hooked = false, _is_usual = false,
  }
end

-- Functions that do not keep the list of events that they get.
local borrowers = setmetatable({}, { __mode = "k" })

-- All machines, so that one access decides if a value is one.
local machines = setmetatable({}, { __mode = "k" })

Machine.__index, Machine.__eq = DEFAULTS, rawequal

-- These fields are absent until a hook is set: then `__newindex` is called.
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

local clone_data

do
  -- Returns the copy of `value`. A plain table is filled later.
  local function copy_of(copies, value, pending)
    if type(value) ~= "table" or getmetatable(value) ~= nil then return value end
    if not copies[value] then
      copies[value], pending[#pending + 1] = {}, value
    end
    return copies[value]
  end

  -- Copies a plain table; a list of pending tables instead of recursion bears any
  -- depth.
  function clone_data(copies, value)
    local pending = {}
    local copy = copy_of(copies, value, pending)
    while pending[1] do
      local source = pending[#pending]
      pending[#pending] = nil
      for k, v in pairs(source) do -- any order: each pair stands alone
        copies[source][copy_of(copies, k, pending)] = copy_of(copies, v, pending)
      end
    end
    return copy
  end

  interpret(clone_data)
end

-- Gives an element its callbacks and the user's data.
local function give_data(element, def, copies)
  local data = def.data
  for i = 1, #data, 2 do
    local key, value = data[i], data[i + 1]
    if type(value) == "table" then value = clone_data(copies, value) end
    element[key] = value
  end
end

-- Makes the elements of the definitions from the given numbers on.
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
  return fsm
end

-- Lists in each node the transitions that leave it.
local function list_otrs(fsm, plan)
  local transitions, nodes = fsm._transitions, fsm._nodes
  for i = 1, #plan.nodes do
    local otrs = plan.nodes[i].otrs
    local list = { otrs[1] and transitions[otrs[1].index] }
    for j = 2, #otrs do list[j] = transitions[otrs[j].index] end
    nodes[i]._otrs = list
  end
end

-- Run: one iteration after the other ----------------------------------------------
--
-- Between two iterations exactly one leaf is active, or none before the first entry. An
-- iteration goes through phases; `_phase` names the one that is under way:
--
--   idle     none: the machine waits for its caller
--   begin    an iteration is about to begin
--   collect  the pending events, then those of getevents, become the current ones
--   before   the pre step hooks are called
--   search   a path is chosen that the events enable
--   refuse   no path leads into the machine, or a hook has failed: the events are
--            pending again
--   take     the states of that path are left and entered
--   doo      there is no path: a doo cycle is run
--   after    the post step hooks are called
--
-- An interrupt is an error that a debug hook raises: Control-C, a host's limit of time.
-- It may come at any instruction, and reaches the caller of `step`. The next step goes
-- on with the phase that was cut short, from its start. That is safe because only the
-- calls of the user's functions cannot be repeated, and `call` makes none of them
-- twice.

local DEFAULT_PRINTER, printer_of

do
  -- Prints any values, separated by tabs: to stderr if there is one, else with the
  -- current `print`.
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

  -- Returns the function that a printer field means: true prints, false is silent.
  function printer_of(fsm, name)
    local printer = fsm[name]
    if printer == nil then return DEFAULT_PRINTER[name] end
    return printer == true and to_stdout or printer or silent
  end
end

--- Keep an error until the iteration is over, for extensions.
--
-- `step` raises it then. Between two steps the next one does. The first error counts.
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

-- What rfsm/fast.lua may replace. The functions below are the specification.
--
--   choose(fsm, events)         the transition with which an enabled path begins
--   take(fsm)                   takes the path that begins with `_path`
--   iterate(fsm, after_free)    one iteration
--   prepare(fsm)                compiles what would be compiled in a run
--   note_failure(f, level)      an error was raised while the function `f` ran
--   is_taking(f, level, fsm)    is `f` a function that takes a path of this machine?
local engine = { prepare = false, note_failure = false, is_taking = false }

-- What the handler of an error returns if the iteration is to go on: the error is that
-- of a callback, and has been noted as the result of its call.
local function GO_ON() end

local go_on

-- The functions of the phases.
local PHASES = {}

-- Calls of the user's functions .....................................................
--
-- The calls of an iteration are numbered in the order in which they are made.
-- `_calls.count` is the number of the last one that was reached, `begun` of the last
-- one that was made, `noted` of the last one whose results are known. Each phase,
-- segment and action, and the resume of a doo, begins at a number that does not depend
-- on those before it, so that a hook that is added to one of them does not change those
-- of the next.

local ACTION, SEGMENT = 1e3, 1e9
local FIRST = {
  begin = 0, collect = 0, before = 1e6, search = 2e6, refuse = 2e6, take = SEGMENT,
  doo = 1e15, resume = 1e15 + 1, after = 2e15,
}

-- Calls f(...) in protected mode; returns as `pcall` does, with at most two results.
-- A call that was made before the phase was cut short is not made again: its results
-- are returned, or none if later calls have been made.
--
-- `note_interrupt` reads the locals. The sum in `count + 1` is made where `ok` will be,
-- which is therefore a boolean only after the call.
local function call(fsm, f, ...)
  local calls = fsm._calls
  local count, begun = calls.count, calls.begun
  calls.count = count + 1
  if begun <= count then
    calls.begun = count + 1
    local ok, result, more = pcall(f, ...)
    calls.ok, calls.result, calls.more = ok, result, more
    calls.noted = count + 1
  end
  if calls.noted ~= count + 1 then return true end
  return calls.ok, calls.result, calls.more
end

-- The same for a call that belongs to no phase.
local function call_aside(_, f, ...) return pcall(f, ...) end

-- How many locals come before `calls`: Lua 5.1 has a hidden one for the rest of the
-- arguments.
local FIRST_LOCAL = getlocal and (function(...) -- luacheck: ignore 212 (it has to be)
  local mark = getlocal
  local _, value = getlocal(1, 1)
  return value == mark and 2 or 3
end)()

-- `call` was cut short: was that before the user's function or after it? The call
-- counts as not begun, or its results are noted. `count`, `begun` and the rest are its
-- locals.
local function note_call(calls, count, begun, ok, result, more)
  if type(count) ~= "number" or calls.begun ~= count + 1 or calls.noted == count + 1
    or type(begun) ~= "number" or begun > count then
    return
  elseif type(ok) ~= "boolean" then
    calls.begun = count
    return
  end
  calls.ok, calls.result, calls.more = ok, result, more
  calls.noted = count + 1
end

-- The handler of errors that are raised in the engine itself: none comes from inside of
-- the user's functions that `call` calls.
local function note_interrupt(failure)
  local level, info = 2, getinfo(2, "f")
  while info and info.func ~= call and info.func ~= go_on do
    local note = engine.note_failure
    if note and note(info.func, level + 1, failure) then return GO_ON end
    level = level + 1
    info = getinfo(level, "f")
  end
  if not info or info.func ~= call then return failure end
  local values = {}
  for i = 1, 6 do
    local _, value = getlocal(level, FIRST_LOCAL + i)
    values[i] = value
  end
  if type(values[1]) == "table" then note_call(unpack(values, 1, 6)) end
  return failure
end

-- Calls one of the machine's printers by `protect`, which is `call` or `call_aside`.
local function print_by(protect, fsm, name, ...)
  local printer = printer_of(fsm, name)
  local ok, failure = protect(fsm, printer, ...)
  if ok then return end
  if not is_callable(printer) then
    failure = ("rfsm: %s: function, true or false expected, %s"):format(name,
      got(printer))
  end
  keep_failure(fsm, failure)
end

--- Call one of a machine's printers, for extensions.
--
-- An error of the printer is kept until the iteration is over.
--
---@param fsm rfsm.Machine
---@param name "dbg"|"info"|"warn"|"err"
---@param ... any
function rfsm.report(fsm, name, ...) return print_by(call_aside, fsm, name, ...) end

local report = rfsm.report

local function is_traced(fsm)
  local dbg = fsm.dbg
  return dbg and dbg ~= silent
end

--- Did an interrupt such as Control-C raise the error, rather than a callback? It is
-- for the caller of `step` then. For extensions.
--
-- The text is that of the interpreters, alone or behind a position.
--
---@param failure any
---@return boolean
function rfsm.is_interrupt(failure)
  return type(failure) == "string" and (failure == "interrupted!"
    or failure:find("^[^\n]*:%d+: interrupted!$") ~= nil)
end

-- A callback of a state or transition failed.
local function report_callback(protect, fsm, name, owner, callback, failure)
  if rfsm.is_interrupt(failure) then return keep_failure(fsm, failure) end
  if not is_callable(callback) then failure = "function expected, " .. got(callback) end
  local text = "error executing " .. name .. " of " .. (owner._fqn or tostring(owner))
  print_by(protect, fsm, "err", name:upper(), text .. ": ", failure)
end

-- Calls a callback of a state, if it has one.
local function run_callback(protect, fsm, state, name)
  local callback = state[name]
  if not callback then return end
  local ok, failure = protect(fsm, callback, fsm, state, name)
  if not ok then report_callback(protect, fsm, name, state, callback, failure) end
end

-- Calls the hooks of extensions for the entry or exit of a state. `hooks` is false, or
-- has a list for the state.
local function run_state_hooks(protect, fsm, state, hooks)
  hooks = hooks and hooks[state]
  for i = 1, hooks and #hooks or 0 do
    local ok, failure = protect(fsm, hooks[i], fsm, state)
    if not ok then keep_failure(fsm, failure) end
  end
end

-- The current events come first in the queue again. It may be cut short anywhere, and
-- is done again by the phase "refuse".
local function put_back(fsm)
  if not rawequal(fsm._joined, fsm._intq) then
    fsm._joined = append(append({}, fsm._curq), fsm._intq)
  end
  fsm._intq = fsm._joined
  fsm._curq = {}
  fsm._joined = false
end

-- Ends an iteration early: a hook or getevents has failed.
local function give_up(fsm, failure)
  fsm._outcome = "refused"
  if fsm._phase ~= "after" then fsm._phase = "refuse" end
  if fsm._phase == "refuse" then put_back(fsm) else fsm._curq = {} end
  fsm._phase = "idle"
  error(failure, 0)
end

-- Returns the events of getevents, a list with nils perhaps; nil and the failure.
local function ask_getevents(fsm, protect)
  local getevents = fsm.getevents
  if not getevents or getevents == no_events then return NONE end
  local ok, events = protect(fsm, getevents)
  if not is_callable(getevents) then
    return nil, "rfsm.step: getevents: function expected, " .. got(getevents)
  elseif not ok then
    return nil, events
  elseif events ~= nil and type(events) ~= "table" then
    return nil, "rfsm.step: getevents: list of events expected, " .. got(events)
  end
  return events or NONE
end

-- Calls step hooks; returns false and the failure of one.
local function run_hooks(fsm, hooks, slot)
  for i = 1, #hooks do
    local hook = hooks[i]
    if hook == OWN then hook = fsm[slot] end
    if hook then
      local ok, failure = call(fsm, hook, fsm, fsm._curq)
      if not (ok or is_callable(hook)) then
        failure = ("rfsm.step: %s: function expected, %s"):format(slot, got(hook))
      end
      if not ok then give_up(fsm, failure) end
    end
  end
end

-- Search: the path that the events enable .........................................
--
-- A search may be done twice if it is cut short: guards have no side effects.

local enabled

-- Is one of `events` among those of the transition, or accepted by a predicate there?
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

-- A guard that fails does not let its transition pass. One that is interrupted is asked
-- again by the next step.
local function refuse_guard(fsm, tr, guard, failure)
  if rfsm.is_interrupt(failure) then error(failure, 0) end
  report_callback(call_aside, fsm, "guard", tr, guard, failure)
end

local function allows(fsm, tr, guard, events)
  local ok, answer = pcall(guard, tr, events)
  if not ok then refuse_guard(fsm, tr, guard, answer) end
  return ok and answer ~= false
end

local function warn_of_conflict(fsm, connector, ways)
  report(fsm, "warn", "conflicting transitions from src " .. connector.fqn .. " to")
  for i = 1, #ways do report(fsm, "warn", "\t" .. ways[i].tgt.fqn) end
end

-- Returns the way out of a connector: the first of its transitions that is enabled, or
-- false. Further ones of the same priority are searched to warn of a conflict.
local function choose_way(fsm, connector, events, depth)
  local ways = {}
  for i = 1, #connector.otrs do
    local def = connector.otrs[i]
    if ways[1] and (def.pn or 0) ~= (ways[1].pn or 0) then break end
    ways[#ways + 1] = matches(def, events) and enabled(fsm, def, events, depth + 1)
      or nil
  end
  if ways[2] then warn_of_conflict(fsm, connector, ways) end
  return ways[1] or false
end

-- So many connectors wait for each other on one stack; LuaJIT's has room for 1,500.
local MAX_DEPTH = 500

-- The same in a new coroutine, which has an empty stack. A guard that yields there does
-- not enable.
local function choose_way_aside(fsm, connector, events)
  local co = coroutine.create(choose_way)
  local ok, way = coroutine.resume(co, fsm, connector, events, 1)
  if not ok then error(way, 0) end
  return coroutine.status(co) == "dead" and way
end

-- Returns the way out of a connector, or false. It is chosen once a search. During
-- its evaluation a connector counts as not enabled, so that cycles end.
local function find_way(fsm, connector, events, depth)
  local ways = fsm._ways
  if ways[connector] == nil then
    ways[connector] = false
    local choose_here = depth < MAX_DEPTH and coroutine and choose_way
      or choose_way_aside
    ways[connector] = choose_here(fsm, connector, events, depth)
  end
  return ways[connector]
end

-- A transition of the machine has got another target. Returns its definition with that
-- target, of which one is made; nil if that is no node of the machine.
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
  def = fsm._plan.transitions[def.index] -- a guard may have merged something
  def.aimed = def.aimed or {}
  def.aimed[node] = def.aimed[node] or compile_transition {
    kind = "transition", index = def.index, id = def.id, parent = def.parent,
    model = def.model, src = def.src, tgt = node, events = def.events, pn = def.pn,
  }
  return def.aimed[node]
end

-- Is the path through `def` to `tgt` enabled? Returns the definition of its first
-- segment, which is another one if the machine has changed the target.
local function enabled_with(fsm, def, tgt, events, depth)
  if fsm._nodes[def.tgt.index] ~= tgt then def = retarget(fsm, def, tgt) end
  local connector = def and compile_transition(def).connector
  if connector and not find_way(fsm, connector, events, depth) then return nil end
  return def
end

-- Is the transition enabled, with a path up to a leaf? Its events match. Returns its
-- definition. `depth` counts the connectors before it.
function enabled(fsm, def, events, depth)
  local tr = fsm._transitions[def.index]
  local guard = tr.guard
  if guard and not allows(fsm, tr, guard, events) then return nil end
  return enabled_with(fsm, def, tr.tgt, events, depth)
end

-- Returns the first transition from a node that is enabled, or nil.
local function find_transition(fsm, node, events)
  for i = 1, #node.otrs do
    local def = node.otrs[i]
    local found = matches(def, events) and enabled(fsm, def, events, 0)
    if found then return found end
  end
end

-- Returns the transition that the events enable, or nil: node by node from the root
-- down to the active leaf. A guard may merge something into the machine: then it is
-- searched again.
local function choose(fsm, events)
  if events[1] == nil then return nil end
  local plan, line = fsm._plan, line_to(fsm._act_leaf["_%def"])
  local traces = is_traced(fsm)
  fsm._ways = {}
  if traces then
    report(fsm, "dbg", "TRANSITION",
      "searching transitions for events: " .. list_text(events))
  end
  for i = 1, #line do
    if traces then
      report(fsm, "dbg", "CHECKING", "depth:", i - 1,
        "for transitions from " .. line[i].fqn)
    end
    local def = find_transition(fsm, line[i], events)
    if fsm._plan ~= plan then return choose(fsm, events) end
    if def then return def end
  end
  if traces then report(fsm, "dbg", "TRANSITION", "no enabled paths found") end
end

-- Warns of events that were sent before the first entry, and that its path does not
-- name: they are consumed by it.
local function warn_of_lost_events(fsm, def, events)
  local lost, told = {}, fsm._told_early or NONE -- by rfsm/strict.lua
  for i = 1, #events do
    local at, is_named = def, rawequal(events[i], "e_init_fsm") or told[events[i]]
    while at and not is_named do
      is_named = at.events and matches(at, { events[i] })
      at = at.connector and fsm._ways[at.connector]
    end
    if not is_named then lost[#lost + 1] = events[i] end
  end
  if lost[1] == nil then return end
  report(fsm, "warn", "WARNING: sent before the machine was entered, which consumes "
    .. "them: " .. list_text(lost))
end

-- No path leads into the machine.
local function refuse_entry(fsm, events)
  report(fsm, "err", "ERROR: cannot enter: no enabled path from 'root.initial' on "
    .. "events: " .. list_text(events))
  fsm._outcome = "refused"
  fsm._phase = "refuse"
end

function PHASES.refuse(fsm)
  put_back(fsm)
  fsm._phase = "idle"
end

-- First entry: the path from `initial`. It begins with the definition of the root.
local function find_entry(fsm, events)
  local root = fsm._plan.nodes[1]
  fsm._ways = {}
  local def = not root.is_leaf and find_transition(fsm, root.members.initial, events)
  fsm._ways[root] = def
  if not (def or root.is_leaf) then return nil end
  warn_of_lost_events(fsm, def, events)
  return root
end

-- Returns the innermost active state.
local function innermost(fsm)
  local state = fsm
  while state._actchild do state = state._actchild end
  return state
end

-- Ends the phase "search", in which `def` was found or nothing. A guard may have moved
-- the machine.
local function decide(fsm, leaf, def)
  if def and leaf and not rawequal(fsm._act_leaf, leaf) then
    leaf = innermost(fsm)
    if fsm._nodes[def.lca.index]._mode == "inactive" then def = nil end
  end
  fsm._from = leaf or fsm
  if def then
    fsm._path = def
    fsm._phase = "take"
  elseif fsm._curq[1] == nil or fsm._after_free then
    fsm._phase = "doo"
  else
    fsm._outcome = "free"
    fsm._phase = "after"
  end
end

function PHASES.search(fsm)
  local leaf, events = fsm._act_leaf, fsm._curq
  if leaf then return decide(fsm, leaf, engine.choose(fsm, events)) end
  local def = find_entry(fsm, events)
  if not def then return refuse_entry(fsm, events) end
  return decide(fsm, leaf, def)
end

-- Take: leave, effect, enter ......................................................
--
-- A path is a sequence of actions: a state is left, an effect is run, a state is
-- entered, a record is traced. Taken again, it skips those that were completed.

-- Begins the next action. Returns false if a later one has called something already.
local function begin_action(fsm)
  local calls = fsm._calls
  calls.count = calls.count - calls.count % ACTION + ACTION
  return calls.begun < calls.count + ACTION
end

-- Traces a record of a path; `describe` returns its parts.
local function record(fsm, describe, def)
  if begin_action(fsm) and is_traced(fsm) then
    print_by(call, fsm, "dbg", describe(fsm, def))
  end
end

local function leave(protect, fsm, state)
  state._mode = "inactive"
  state._parent._actchild = nil
  run_callback(protect, fsm, state, "exit")
  run_state_hooks(protect, fsm, state, fsm._exit_hooks)
  if rawequal(fsm._act_leaf, state) then fsm._act_leaf = false end
  state._doo_co = nil
  if is_traced(fsm) then print_by(protect, fsm, "dbg", "STATE_EXIT", state._fqn) end
end

-- A leaf has done its work.
local function complete(fsm, leaf)
  local queue, event = fsm._intq, leaf["_%def"].done_event
  if is_traced(fsm) then print_by(call, fsm, "dbg", "RAISED", event) end
  if not rawequal(queue[#queue], event) then queue[#queue + 1] = event end
  leaf._mode = "done"
end

local function enter(fsm, state, def)
  state._mode = "active"
  if state ~= fsm then state._parent._actchild = state end
  run_state_hooks(call, fsm, state, fsm._entry_hooks)
  run_callback(call, fsm, state, "entry")
  if def.is_leaf then
    fsm._act_leaf = state
    if not state.doo then complete(fsm, state) end
  end
  if is_traced(fsm) then print_by(call, fsm, "dbg", "STATE_ENTER", state._fqn) end
end

-- What a path traces. Texts are kept with the definitions.
local RECORDS = {}

function RECORDS.exits(_, def)
  local outermost = def.outermost or def.src
  while outermost.parent ~= def.lca and outermost.parent ~= outermost do
    outermost = outermost.parent
  end
  def.outermost = outermost
  return "TRANS_EXIT", "exiting all up to (including):", outermost.fqn, ", lca:",
    def.lca.fqn
end

function RECORDS.effect(fsm, def)
  return "EFFECT", tostring(fsm._transitions[def.index])
end

function RECORDS.entries(_, def)
  local names, node = {}, def.tgt
  while not def.down_path and node ~= def.lca do
    names[#names + 1], node = node.fqn, node.parent
  end
  def.down_path = def.down_path or concat(names, " > ")
  return "TRANS_ENTER", "lca: " .. def.lca.fqn, "down_path: ", def.down_path
end

local function label_of(node)
  if node.kind == "connector" then return node.fqn .. "[c]" end
  return node.fqn .. (node.is_leaf and "[LS]" or "[CS]")
end

-- root.a[LS]->root.k[c]->root.b[LS]
function RECORDS.path(fsm, def)
  local text = label_of(def.src)
  while def do
    text = text .. "->" .. label_of(def.tgt)
    def = def.connector and fsm._ways[def.connector]
  end
  return "EXEC_PATH", text
end

local function run_effect(fsm, def)
  local tr = fsm._transitions[def.index]
  local effect = tr.effect
  record(fsm, RECORDS.effect, def)
  if not (begin_action(fsm) and effect) then return end
  local ok, failure = call(fsm, effect, fsm, tr, "effect", fsm._curq)
  if not ok then report_callback(call, fsm, "effect", tr, effect, failure) end
end

local function begin_segment(calls)
  calls.count = calls.count - calls.count % SEGMENT + SEGMENT
end

-- Takes the segment `def` from the active state `state`: (a) leaves the states up to
-- the lca, (b) runs the effect, (c) enters the states down to the target.
local function take_segment(fsm, def, state)
  local nodes, entries = fsm._nodes, def.entries
  begin_segment(fsm._calls)
  if def.is_internal then return run_effect(fsm, def) end
  record(fsm, RECORDS.exits, def)
  while state ~= nodes[def.lca.index] do
    if begin_action(fsm) then leave(call, fsm, state) end
    state = state._parent
  end
  run_effect(fsm, def)
  record(fsm, RECORDS.entries, def)
  for i = 1, #entries do
    if begin_action(fsm) then enter(fsm, nodes[entries[i].index], entries[i]) end
  end
end

-- Takes the path that begins with `_path`. At the first entry it begins with the root.
local function take(fsm)
  local def, state, ways = fsm._path, fsm._from, fsm._ways
  fsm._calls.count = FIRST.take -- not when a function of rfsm/fast.lua goes on here
  if def.kind == "state" then
    if begin_action(fsm) then enter(fsm, fsm, def) end
    def = ways[def]
  end
  if def then record(fsm, RECORDS.path, def) end
  while def do
    take_segment(fsm, def, state)
    local connector = def.connector
    if not connector then return end
    def, state = ways[connector], fsm._nodes[connector.parent.index]
  end
end

-- Doo ............................................................................

local run_doo

do
  -- Makes the coroutine of a doo, in which the engine runs nothing.
  local function new_doo(doo)
    if type(doo) == "function" then return coroutine.create(doo) end
    return coroutine.create(function(...) return doo(...) end)
  end

  -- The coroutine is dropped last: if a doo's end is cut short, it is done again.
  local function fail_doo(fsm, leaf, failure)
    leaf._mode = "done"
    if rfsm.is_interrupt(failure) then
      keep_failure(fsm, failure)
    else
      print_by(call, fsm, "err", "DOO",
        "doo program of state '" .. leaf._fqn .. "' failed: ", failure)
    end
    leaf._doo_co = nil
  end

  local function end_doo(fsm, leaf)
    complete(fsm, leaf)
    if is_traced(fsm) then
      print_by(call, fsm, "dbg", "DOO",
        "removing completed coroutine of " .. leaf._fqn .. " doo")
    end
    leaf._doo_co = nil
  end

  -- Makes the coroutine of a leaf's doo. Returns nil, and the doo has failed, if there
  -- are no coroutines.
  local function start_doo(fsm, leaf)
    if is_traced(fsm) then
      print_by(call, fsm, "dbg", "DOO",
        "created coroutine for " .. leaf._fqn .. " doo")
    end
    if not coroutine then return fail_doo(fsm, leaf, "there are no coroutines here") end
    leaf._doo_co = new_doo(leaf.doo)
    return leaf._doo_co
  end

  -- Resumes a doo; true when it is idle or over.
  local function resume_doo(fsm, leaf, co)
    fsm._calls.count = FIRST.resume
    local _, ok, idle = call(fsm, coroutine.resume, co, fsm, leaf, "doo")
    if ok == false then
      fsm._outcome = "failed"
    elseif ok then -- nil if later calls have been made, which depend on `_outcome`
      fsm._outcome = coroutine.status(co) == "dead" and "ended" or "counted"
    end
    if fsm._outcome == "counted" then return idle and true or false end
    local finish_doo = fsm._outcome == "failed" and fail_doo or end_doo
    finish_doo(fsm, leaf, idle)
    return true
  end

  -- One cycle of the active leaf's doo; true when it is idle or done.
  function run_doo(fsm, leaf)
    local co = leaf._doo_co
    if leaf._mode == "done" and not co then return true end
    if not (co or leaf.doo) then
      complete(fsm, leaf)
      return true
    end
    co = co or start_doo(fsm, leaf)
    return not co or resume_doo(fsm, leaf, co)
  end
end

-- Iterate ........................................................................

local function set_inactive(fsm)
  for _, node in ipairs(fsm._nodes) do
    if node._mode then
      node._mode, node._doo_co = "inactive", nil
      rawset(node, "_actchild", nil)
    end
  end
  fsm._act_leaf = false
end

-- Makes a machine as it was after init, but for the events of the current iteration.
local function run_reset_hooks(fsm)
  fsm._reset_wanted = false
  for _, hook in ipairs(fsm._reset_hooks) do hook(fsm) end
end

local function reset_now(fsm)
  set_inactive(fsm)
  fsm._intq = { "e_init_fsm" }
  run_reset_hooks(fsm)
end

-- The phase "collect". If one before was cut short, or a hook failed in it, its events
-- come first.
function PHASES.collect(fsm)
  if fsm._reset_wanted then
    fsm._curq = {}
    reset_now(fsm)
  end
  if fsm._curq[1] == nil then fsm._curq = fsm._intq end
  if rawequal(fsm._curq, fsm._intq) then fsm._intq = {} end
  local events, failure = ask_getevents(fsm, call)
  if not events then give_up(fsm, failure) end
  if #events > 0 then fsm._joined = append(append({}, fsm._curq), events) end
  fsm._phase = "before"
end

function PHASES.before(fsm)
  local joined = fsm._joined
  if joined then fsm._curq = joined end
  fsm._joined = false
  run_hooks(fsm, fsm._pre_hooks, "pre_step_hook")
  fsm._phase = "search"
end

function PHASES.doo(fsm)
  local idle = run_doo(fsm, fsm._from)
  if idle and fsm._curq[1] == nil then
    local events, failure = ask_getevents(fsm, call)
    if not events then give_up(fsm, failure) end
    if #events > 0 then fsm._joined = append(append({}, fsm._intq), events) end
  end
  fsm._outcome = idle and "idle" or "counted"
  fsm._phase = "after"
end

function PHASES.take(fsm)
  engine.take(fsm)
  fsm._outcome = "counted"
  fsm._phase = "after" -- last: an interrupt between both repeats the phase
end

local function call_post_hooks(fsm)
  if fsm._joined then fsm._intq = fsm._joined end -- those of getevents
  fsm._joined = false
  if fsm._reset_wanted then reset_now(fsm) end
  run_hooks(fsm, fsm._post_hooks, "post_step_hook")
end

function PHASES.after(fsm)
  call_post_hooks(fsm)
  fsm._curq = {}
  fsm._phase = "idle"
end

function PHASES.begin(fsm)
  local calls = fsm._calls
  calls.begun, calls.noted = 0, 0
  fsm._phase = "collect"
end

-- Goes through the phases of an iteration, from the one that is under way on, up to
-- `last`, if it is given.
function go_on(fsm, last)
  repeat
    local phase = fsm._phase
    fsm._calls.count = FIRST[phase]
    PHASES[phase](fsm)
  until fsm._phase == "idle" or fsm._phase == last
end

local iterate

-- Without `debug` the thread that runs a step is noted: see `is_stepping`.
local running = not getinfo and find_global("coroutine", "running")

local function same(failure) return failure end

local function results_of(fsm, outcome)
  if fsm._reset_wanted and outcome == "refused" then reset_now(fsm) end
  raise_failure(fsm)
  if outcome == "refused" then return nil end
  return outcome ~= "free",
    outcome == "idle" and fsm._intq[1] == nil and fsm._act_leaf ~= false
end

-- One iteration, or the rest of one that was cut short. Returns nil if the machine
-- cannot be entered, else whether it counts as a step and whether the machine is idle.
-- `after_free`: the last iteration did not count; not looked at in the rest of one.
function iterate(fsm, after_free)
  if fsm._phase == "idle" then
    fsm._after_free = after_free
    fsm._phase = "begin"
  end
  fsm._run = go_on
  if running then fsm._thread = running() or true end
  local ok, failure = xpcall(fsm._act, getlocal and note_interrupt or same)
  if running then fsm._thread = false end
  if not ok then
    if failure == GO_ON then return iterate(fsm, after_free) end
    error(failure, 0)
  end
  fsm._calls.noted = 0
  return results_of(fsm, fsm._outcome)
end

engine.choose, engine.take, engine.iterate = choose, take, iterate

-- So many iterations come before rfsm/fast.lua is loaded: a program that does little
-- should not pay for it.
local patience = 8

local PARTS = {
  ACTION = ACTION, SEGMENT = SEGMENT, append = append, ask_getevents = ask_getevents,
  borrowers = borrowers, call = call, call_post_hooks = call_post_hooks,
  choose = choose, compile_transition = compile_transition, decide = decide,
  enabled = enabled, enabled_with = enabled_with, enter = enter, FIRST = FIRST,
  give_up = give_up, go_on = go_on, GO_ON = GO_ON,
  handler = note_interrupt, interpret = interpret, is_callable = is_callable,
  iterate = iterate, leave = leave, line_to = line_to, loadstring = loadstring,
  matches = matches, no_events = no_events, OWN_ONLY = OWN_ONLY,
  refuse_guard = refuse_guard, results_of = results_of,
  silent = silent, take = take, warn_of_conflict = warn_of_conflict,
}

local load_fast

do
  local faster = {}

  -- Makes the functions of rfsm/fast.lua, which need the handler.
  local function make() return getlocal and require("rfsm.fast")(faster, PARTS) end

  -- Puts them in place of those here, all or none: what keeps rfsm/fast.lua from being
  -- loaded, such as too little memory, is no failure of the machine.
  function load_fast()
    patience = -1
    engine.iterate = iterate
    local ok, failure = pcall(make)
    if rfsm.is_interrupt(failure) then error(failure, 0) end
    for name, f in pairs(ok and faster or NONE) do engine[name] = f end -- any order
  end
end

-- The first iterations of a program, and all of them if there is no rfsm/fast.lua.
local function iterate_patiently(fsm, after_free)
  if patience == 0 then
    load_fast()
    return engine.iterate(fsm, after_free)
  end
  patience = patience - 1
  return iterate(fsm, after_free)
end

engine.iterate = iterate_patiently

-- Build: a plan of a model, and a machine of the plan -------------------------------

-- Gives a machine the function that `xpcall` calls without arguments.
local function give_act(fsm)
  fsm._act = function() return (fsm._run(fsm)) end -- no tail call: see `is_stepping`
end

-- A copy of all tables of a machine has the function of that machine, and a copy of its
-- plan, which the metatables of its elements do not know: it gets its own and theirs.
local function adopt_copy(fsm)
  local node = fsm._nodes[2]
  local root = node and node["_%def"].parent or fsm["_%def"]
  fsm._plan, fsm["_%def"] = root.plan, root
  give_act(fsm)
  machines[fsm] = true
end

--- Raise an error that blames the caller, unless `fsm` is a machine; for extensions.
---@param fsm any
---@param where string the public function, such as "rfsm.step"
---@param level? integer the function to blame: 3, the default, for the caller's caller
function rfsm.check_machine(fsm, where, level)
  if machines[fsm] then return end
  if getmetatable(fsm) == Machine and rawget(fsm, "_initialized") then
    if not fsm._preparing then adopt_copy(fsm) end -- else `init` goes on with it
    return
  end
  local hint = is_state(fsm) and (rawget(fsm, "_initialized")
    and " of another copy of rfsm" or " (rfsm.init makes one of a state)") or ""
  error(where .. ": initialised fsm expected, " .. got(fsm) .. hint, level or 3)
end

local check_machine = rfsm.check_machine

local function check_function(f, where, level)
  if is_callable(f) then return end
  error(where .. ": function expected, " .. got(f), level or 3)
end

-- Is `value` a node of that machine? A live state, if `kind` says so.
local function is_node_of(fsm, value, kind)
  local value_kind = kind_of(value)
  local def = value_kind and value["_%def"]
  return type(def) == "table" and (not kind or value_kind == kind)
    and rawequal(fsm._nodes[def.index], value)
end

-- Digits padded, so that trans[10] comes after trans[2].
local function natural(text)
  return (text:gsub("%d+", function(n) return ("0"):rep(12 - #n) .. n end))
end

-- Turns { at, file, text } into lines "file: at: text", sorted by location.
local function lines_of(list)
  local keys, lines = {}, {}
  for i = 1, #list do
    local line = list[i].line or list[i].at .. ": " .. list[i].text
    lines[i] = (list[i].file and list[i].file .. ": " or "") .. line
    keys[lines[i]] = natural(line)
  end
  sort(lines, function(a, b) return keys[a] < keys[b] end)
  return lines
end

local function summary(where, problems)
  local hint = advice == false and "\n  (no hints: rfsm/advice.lua is not installed)"
    or ""
  return ("%s: the model has %d problem%s\n  %s%s"):format(where, #problems,
    #problems == 1 and "" or "s", concat(problems, "\n  "), hint)
end

--- Return where an element stands: "chart.lua:7: root.trans[2] (off -> on)".
--
-- The file and line are those of its constructor, left out where they are not known.
--
---@param obj rfsm.State|rfsm.Transition|rfsm.Connector an element of a machine
---@param field? string of the element: "root.trans[2].events (off -> on)"
---@return string location
function rfsm.location_of(obj, field)
  local def = obj["_%def"]
  local file = made_at[def.model]
  return (file and file .. ": " or "") .. name_of(def, field)
end

local build_plan, new_build, new_machine, plan_of

do
  -- The plans of models, kept by their machines; the latest one in any case, for
  -- programs that drop each machine before they make the next.
  local plans, latest_plan = setmetatable({}, { __mode = "kv" }), nil

  function new_build(plan)
    return { plan = plan, problems = {}, warnings = {}, created = {}, mounts = {} }
  end

  -- The user's data at the root that has the name of one of the machine's fields is
  -- left out.
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

  -- A path into a composite ends at an `initial` that nothing leaves.
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
    for i = 1, #HOOKS do check_callable(build, root, HOOKS[i], model[HOOKS[i]]) end
    for i = 1, 4 do
      local printer = model[PRINTERS[i]]
      if printer and printer ~= true and not is_callable(printer) then
        add(build.problems, root, PRINTERS[i], "function, true or false expected, "
          .. got(printer))
      end
    end
    if not root.is_leaf and not root.members.initial then
      add(build.problems, root, nil, "the root needs an initial transition "
        .. "(rfsm.trans{ src='initial', tgt=... })")
    end
  end

  -- Check, clone, resolve: all that can be said of a model without running anything.
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

  -- Returns the plan of a model; nil and the problems of a model that can have none.
  function plan_of(model)
    local plan = plans[model]
    if plan and is_current(plan) then return plan end
    local build = build_plan(model)
    if build.problems[1] then return nil, lines_of(build.problems) end
    plan = compile(build.plan)
    plan.trail = make_trail(plan)
    plan.warnings, plan.created = build.warnings, build.created
    plans[model], latest_plan = plan, plan
    return latest_plan
  end

  function new_machine(plan)
    local fsm = own_fields()
    fsm["_%def"], fsm._plan, fsm._parent, fsm._nodes = plan.nodes[1], plan, fsm, { fsm }
    return make_elements(fsm, plan, 2, 1)
  end
end

-- Gives a machine what it cannot share: functions for its printers, and the function
-- that `xpcall` calls. Wrong printers are replaced.
local function finish_machine(fsm)
  for i = 1, 4 do
    local name = PRINTERS[i]
    local printer = printer_of(fsm, name)
    fsm[name] = is_callable(printer) and printer or DEFAULT_PRINTER[name]
  end
  for name in pairs(STEP_HOOKS) do -- any order: each stands alone
    fsm._is_hooked = fsm._is_hooked or fsm[name] and true or false
    fsm[name] = fsm[name] or nil
  end
  give_act(fsm)
  return setmetatable(fsm, Machine)
end

interpret(finish_machine)

-- Prints a line for each problem of a list.
local function report_lines(fsm, name, list)
  if fsm[name] == silent then return end
  for _, line in ipairs(lines_of(list)) do
    report(fsm, name, (name == "info" and "INFO: " or "WARNING: ") .. line)
  end
end

-- Returns the set of the composites that a transition leaves from inside.
local function left_composites(plan)
  local left = {}
  for _, def in ipairs(plan.transitions) do
    local composite, tgt = def.src.parent, def.tgt
    while tgt.depth > composite.depth do tgt = tgt.parent end
    while composite ~= tgt do
      left[composite], composite = true, composite.parent
      if tgt.depth > composite.depth then tgt = tgt.parent end
    end
  end
  return left
end

-- Warns of the nodes, from number `first` on, that nothing leaves.
local function report_dead_ends(fsm, first)
  local plan, dead, left = fsm._plan, {}, nil
  for i = first, #plan.nodes do
    local def = plan.nodes[i]
    if not (def.otrs[1] or def.model.final or def.parent == def) then
      left = left or left_composites(plan)
      local line = "no outgoing transitions from node '" .. def.fqn .. "'"
      dead[#dead + 1] = not left[def] and { line = line } or nil
    end
  end
  report_lines(fsm, "warn", dead)
  return dead[1] == nil
end

local report_findings

do
  -- Warns of an `initial` that may not be enabled: its composite has no entry then.
  local function check_initial(found, def)
    for _, tr in ipairs(def.otrs) do
      if not (tr.events or tr.guard) then return end
    end
    if def.id ~= "initial" or not def.otrs[1] then return end
    add(found, def, nil, "each transition from here has events or a guard, '%s' cannot "
      .. "be entered while none of them is enabled", def.parent.fqn)
  end

  -- Warns of events such as e_after(1) that no extension has made its own. An extension
  -- that knows the word has warned itself.
  local function check_words(found, def)
    for _, event in ipairs(def.events or {}) do
      local word = type(event) == "string" and event:match("^([%w_]+)%(.*%)$")
      local hint = word and advise("module_of", word)
      if hint then
        add(found, def, "events", "no loaded extension knows '%s'%s", event, hint)
      end
    end
  end

  -- Reports the warnings of the model, also after the preproc functions.
  function report_findings(fsm, first_node, first_transition)
    local plan, found = fsm._plan, append({}, fsm._plan.warnings)
    for i = first_node, #plan.nodes do check_initial(found, plan.nodes[i]) end
    for i = first_transition, #plan.transitions do
      check_words(found, plan.transitions[i])
    end
    report_lines(fsm, "warn", found)
  end
end

--- Functions `f(fsm[, merged])` that `rfsm.init` calls for each machine.
--
-- They run after names are resolved and before events are indexed, and may change
-- `events`, `pn`, `src`, `tgt` and callbacks. `rfsm.fsm_merge` calls them again with
-- the element that it added. A list of texts "location: problem" that one returns
-- counts among the model's problems.
--
---@type (fun(fsm: rfsm.Machine, merged?: table): string[]?)[]
rfsm.preproc = {}

local preprocess, use_plan

do
  -- Each transition gets what a preproc function may change: the events and priority
  -- that stand in the model; after a merge, those that the machine has.
  local function hand_out(fsm, plan)
    for i, tr in ipairs(fsm._transitions) do
      local def = plan.transitions[i]
      tr.events = rawget(tr, "events") or append({}, def.written or def.events or NONE)
      tr.pn = rawget(tr, "pn") or def.pn
    end
  end

  -- Returns the field that got a wrong value from a preproc function.
  local function wrong_field(fsm, tr)
    local events, pn = tr.events or NONE, rawget(tr, "pn") or 0
    if type(events) ~= "table" and type(events) ~= "string" then return "events" end
    if type(pn) ~= "number" or pn ~= pn then return "pn" end
    if not is_node_of(fsm, tr.src) then return "src" end
    return not is_node_of(fsm, tr.tgt) and "tgt"
  end

  -- Gives the fields of a transition the form that a plan has: a list of events, a
  -- target that is no composite. Returns a problem if there is one.
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

  -- Has a transition still the ends and the priority of a plan?
  local function has_ends(tr, def, nodes)
    return (rawget(tr, "pn") or nil) == def.pn
      and rawequal(tr.src, nodes[def.src.index])
      and rawequal(tr.tgt, nodes[def.tgt.index])
  end

  -- The same, and its events?
  local function is_as_planned(tr, def, nodes)
    local events, known = rawget(tr, "events"), def.events or NONE
    if type(events) ~= "table" or #events ~= #known or not has_ends(tr, def, nodes) then
      return false
    end
    for i = 1, #known do
      if not rawequal(events[i], known[i]) then return false end
    end
    return true
  end

  -- Has each transition of a machine what `plan` has?
  local function fits(fsm, plan)
    local transitions = fsm._transitions
    for i = 1, #transitions do
      if not is_as_planned(transitions[i], plan.transitions[i], fsm._nodes) then
        return false
      end
    end
    return true
  end

  -- Returns the plan that fits a machine, one of the variants or the plan itself.
  local function find_plan(fsm, plan)
    for i = #plan.variants, 1, -1 do -- the latest first
      if fits(fsm, plan.variants[i]) then return plan.variants[i] end
    end
    return fits(fsm, plan) and plan or nil
  end

  -- The first machine of a plan decides about the events in it: those of the model are
  -- kept as `written`. Where more was changed the plan stays as it is, and the result
  -- is nil.
  local function settle(fsm, plan)
    if plan.is_settled then return nil end
    for i, tr in ipairs(fsm._transitions) do
      if not has_ends(tr, plan.transitions[i], fsm._nodes) then return nil end
    end
    for i, tr in ipairs(fsm._transitions) do
      local def = plan.transitions[i]
      def.written = def.events or NONE
      def.events = tr.events[1] ~= nil and append({}, tr.events)
    end
    use_plan(fsm, compile(plan))
    return plan
  end

  local MAX_VARIANTS = 8 -- of a plan: machines that differ more often share less

  -- Returns a plan whose transitions are what the preproc functions have made of them.
  local function new_variant(fsm, plan)
    local variant, variants = copy_plan(plan), plan.variants
    for i, tr in ipairs(fsm._transitions) do
      local def = variant.transitions[i]
      def.src = variant.nodes[tr.src["_%def"].index]
      def.tgt = variant.nodes[tr.tgt["_%def"].index]
      def.pn = rawget(tr, "pn") or nil
      def.events = tr.events[1] ~= nil and append({}, tr.events)
      def.is_internal = def.is_internal and def.src == def.tgt
    end
    variant.base = plan
    if #variants == MAX_VARIANTS then remove(variants, 1) end
    variants[#variants + 1] = compile(variant)
    return variant
  end

  -- The machine gets the plan of what the preproc functions have made of its
  -- transitions. Machines with the same result share it.
  local function take_results(fsm, plan, problems)
    local found = find_plan(fsm, plan)
    if not found then
      for _, tr in ipairs(fsm._transitions) do
        problems[#problems + 1] = check_transition(fsm, tr)
      end
      found = not problems[1] and (find_plan(fsm, plan) or settle(fsm, plan)
        or new_variant(fsm, plan))
    end
    for _, tr in ipairs(fsm._transitions) do tr.events, tr.pn = nil, nil end
    if not found then return end
    plan.is_settled = true
    if found ~= plan then use_plan(fsm, found) end
  end

  -- Runs the preproc functions; returns the problems they found. When one of them
  -- merges something into the machine, those before it are called for that, the others
  -- are still to come.
  function preprocess(fsm, merged)
    local problems, outer = {}, fsm._preparing
    local last = outer and outer - 1 or #rfsm.preproc
    if last < 1 then
      fsm._plan.is_settled = true
      return problems
    end
    hand_out(fsm, fsm._plan)
    for i = 1, last do
      fsm._preparing = i
      local found = rfsm.preproc[i](fsm, merged)
      append(problems, type(found) == "table" and found or {})
    end
    fsm._preparing = outer
    if not outer then take_results(fsm, fsm._plan, problems) end
    sort(problems, function(a, b) return natural(a) < natural(b) end)
    return problems
  end
end

--- Are there to be more warnings? The environment may ask for them, for extensions.
---@param root rfsm.State a root state or a machine
---@return boolean
function rfsm.is_strict(root)
  local getenv = find_global("os", "getenv")
  if root.strict ~= nil then return root.strict and true or false end
  return getenv and getenv("RFSM_STRICT") == "1" or false
end

-- Reports the problems of a model to `err`.
local function refuse_model(model, fsm, problems)
  local err = model.err
  if err and err ~= true and not is_callable(err) then err = nil end
  fsm = fsm or { err = err }
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
---@param model rfsm.State a root state, or a machine for a fresh one of the same model
---@return rfsm.Machine? fsm false when the model has problems
---@return string? text all problems, for `assert`
---@return string[]? problems each "file:line: location: problem"
---@nodiscard
function rfsm.init(model)
  if not is_state(model) then
    error("invalid fsm model passed to rfsm.init: state expected, " .. got(model), 2)
  end
  model = model_of(model)
  local plan, problems = plan_of(model)
  if not plan then return refuse_model(model, nil, problems) end
  if rfsm.is_strict(model) then find_module("rfsm.strict") end
  local fsm = finish_machine(new_machine(plan))
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

--- Warn of each state or connector that nothing leaves.
---@param fsm rfsm.Machine
---@return boolean is_clean true when there is none
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
---@param ... any more of them
function rfsm.send_events(fsm, event, ...)
  if not machines[fsm] then check_machine(fsm, "rfsm.send_events") end
  if fsm.dbg ~= silent and fsm.dbg then report(fsm, "dbg", "RAISED", event, ...) end
  local queue = fsm._intq
  if event ~= nil then queue[#queue + 1] = event end
  if select("#", ...) > 0 then return queue_more(queue, ...) end
end

local function is_on_stack(fsm)
  local level, info, is_taking = 3, getinfo(3, "f"), engine.is_taking
  while info do
    local f = info.func
    if f == fsm._act or is_taking and is_taking(f, level + 1, fsm) then return true end
    level = level + 1
    info = getinfo(level, "f")
  end
  return false
end

-- Is a step of this machine under way, rather than cut short? Then `_act` is on the
-- stack, or a doo is running. Without `debug` the thread of the step has been noted.
local function is_stepping(fsm)
  if fsm._phase == "idle" then return false end
  local co = fsm._act_leaf and fsm._act_leaf._doo_co or fsm._thread
  local status = co and (co == true and "running" or coroutine.status(co))
  if status == "running" or status == "normal" then return true end
  return getinfo ~= nil and is_on_stack(fsm)
end

local function check_no_step(fsm, where, level)
  if fsm._phase == "idle" then return end
  fsm._is_usual = false
  if not is_stepping(fsm) then return end
  error(where .. ": the machine is in the middle of a step", level)
end

--- Raise an error that blames the caller's caller while a step is under way, for
-- extensions. A step that was cut short is finished.
---@param fsm rfsm.Machine
---@param where string the public function
function rfsm.check_between_steps(fsm, where)
  check_machine(fsm, where, 4)
  check_no_step(fsm, where, 4)
  if fsm._phase ~= "idle" then iterate(fsm) end
end

local check_between_steps = rfsm.check_between_steps

-- Iterates until `left` iterations counted or the machine is idle. Returns whether it
-- is idle. `counted` and `idle` are the results of the last iteration.
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
    counted, idle = engine.iterate(fsm, not counted)
  end
  if idle and is_traced(fsm) then
    report(fsm, "dbg", "HIBERNATING",
      "no events, no idle_hook, no doos or doo idle, halting engines")
    raise_failure(fsm)
  end
  return idle or false
end

--- Advance a machine by at most `n` transitions or doo cycles.
--
-- Returns earlier if it is idle. Errors of callbacks are reported to `err`. Those of
-- step hooks and getevents are raised at once, those of printers when the iteration is
-- over. A step that an interrupt has cut short is finished first.
--
---@param fsm rfsm.Machine
---@param n? number at least 1, default 1
---@return boolean idle true if there is nothing left to do
function rfsm.step(fsm, n)
  if not machines[fsm] then check_machine(fsm, "rfsm.step") end
  if fsm._phase ~= "idle" then check_no_step(fsm, "rfsm.step", 3) end
  if n == nil then
    local counted, idle = engine.iterate(fsm, false)
    if counted then return idle end -- without a loop: LuaJIT makes one trace of it
    return advance(fsm, 1, counted, idle)
  elseif type(n) ~= "number" then
    error("rfsm.step: number of steps expected, " .. got(n), 2)
  end
  return advance(fsm, n == n and n or 1, engine.iterate(fsm, false)) -- NaN is 1
end

--- Advance a machine until no event is pending and no doo is busy.
---@param fsm rfsm.Machine
---@return boolean idle false when the machine could not be entered
function rfsm.run(fsm)
  if not machines[fsm] then check_machine(fsm, "rfsm.run") end
  if fsm._phase ~= "idle" then check_no_step(fsm, "rfsm.run", 3) end
  local counted, idle = engine.iterate(fsm, false) -- the usual two without a loop
  if counted and not idle then counted, idle = engine.iterate(fsm, false) end
  if idle and fsm.dbg == silent and not fsm.idle_hook then return true end
  return advance(fsm, huge, counted, idle)
end

--- Make a machine as it was after `init`: inactive, no exit is called.
--
-- Called by one of the machine's own functions it takes effect when the iteration ends.
-- It revives a machine whose step was cut short.
--
---@param fsm rfsm.Machine
function rfsm.reset(fsm)
  check_machine(fsm, "rfsm.reset")
  fsm._reset_wanted, fsm._is_usual = true, false
  if is_stepping(fsm) then return end
  fsm._phase, fsm._curq, fsm._joined, fsm._failure = "idle", {}, false, false
  reset_now(fsm)
end

--- Move the events of getevents to the queue.
---@param fsm rfsm.Machine
---@return integer waiting length of the queue
function rfsm.check_events(fsm)
  check_machine(fsm, "rfsm.check_events")
  local events, failure = ask_getevents(fsm, call_aside)
  if not events then error(failure, 0) end
  append(fsm._intq, events)
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
---@return rfsm.State? child nil when there is none
function rfsm.actchild_get(state)
  return type(state) == "table" and state._actchild or nil
end

--- Call `f(obj, parent, name)` for each element below `fsm` that `pred` accepts.
--
-- Parents before children; the array part first, then names sorted. A machine itself
-- comes first, as `f(fsm, fsm, "root")`.
--
---@param f fun(obj: table, parent: rfsm.State, name: string|integer): any
---@param fsm table a machine, a model, or any table of elements
---@param pred? fun(obj: any): boolean default is_fsmobj
---@param depth? integer how many levels, default all
---@return any[] results those of f, in order, without nils
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

local function itself(element) return element end

-- Lists the elements of a machine that is being prepared, all of its plan, which has
-- the order of their definitions then.
local function planned_elements(fsm, pred)
  local nodes, transitions, order = fsm._nodes, fsm._transitions, fsm._plan.order
  if not order then
    order = rfsm.mapfsm(function(element) return element["_%def"] end, fsm)
    fsm._plan.order = order
  end
  local list, is_simple = {}, pred == rfsm.is_trans -- as most preproc functions ask
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

--- List an element and those below it that `pred` accepts, for extensions.
--
-- A preproc function `f(fsm, merged)` works on `rfsm.elements(merged or fsm, pred)`.
-- Machines that share `structure_of` have their elements at the same positions.
--
---@param obj table a machine or an element of one
---@param pred? fun(obj: any): boolean default is_fsmobj
---@return table[] elements parents before children
function rfsm.elements(obj, pred)
  if rfsm.is_root(obj) and obj._preparing then return planned_elements(obj, pred) end
  if rfsm.is_trans(obj) then return (not pred or pred(obj)) and { obj } or {} end
  local list = rfsm.mapfsm(itself, obj, pred)
  if not rfsm.is_root(obj) and (not pred or pred(obj)) then
    return append({ obj }, list)
  end
  return list
end

--- List the machines that run in a state, in the order in which they are stepped.
--
-- An extension that runs machines in a state lists them in its field `_regions`, whose
-- own field `names` has their names.
--
---@param state rfsm.State a state of a machine
---@return rfsm.Machine[] regions empty where there are none
function rfsm.regions(state)
  local regions = is_state(state) and rawget(state, "_regions")
  return append({}, type(regions) == "table" and regions or NONE)
end

--- A machine, and where it runs.
---@class rfsm.Place
---@field machine rfsm.Machine
---@field owner rfsm.Machine|false the parent machine, whose state runs it
---@field state rfsm.State|false that state
---@field prefix string "root", or the name of the region: "root.arms.left"

--- List a machine and the regions in its states, at any depth; itself first.
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
      for i, region in ipairs(rfsm.regions(leaf)) do
        local name = text_of(leaf._regions.names[i])
        visit(region, machine, leaf, prefix .. leaf._fqn:sub(5) .. "." .. name)
      end
    end
  end
  visit(fsm, false, false, "root")
  return places
end

--- Load and compile now what would be loaded and compiled while a machine runs.
--
-- Without it a machine is compiled bit by bit, as its transitions are taken for the
-- first time, and rfsm/fast.lua is loaded in one of the first iterations. What comes
-- later, by `fsm_merge` or as a first hook, is run uncompiled until the next `prepare`.
--
---@param fsm rfsm.Machine
function rfsm.prepare(fsm)
  check_machine(fsm, "rfsm.prepare")
  if patience >= 0 then load_fast() end
  for _, at in ipairs(rfsm.machines(fsm)) do
    local plan = at.machine._plan
    for _, def in ipairs(plan.nodes) do if def.is_leaf then line_to(def) end end
    for _, def in ipairs(plan.transitions) do compile_transition(def) end
    if engine.prepare then engine.prepare(at.machine) end
  end
end

-- Tools: they look at a machine or move it; no part of a run ......................

--- Call `f(fsm, state)` for each state on the line between two, both included.
-- @raise when neither is an ancestor of the other
---@param fsm rfsm.Machine
---@param f fun(fsm: rfsm.Machine, state: rfsm.State): any
---@param from rfsm.State where to begin
---@param to rfsm.State an ancestor or descendant of `from`
---@return any[] results those of f, in order, without nils
function rfsm.map_from_to(fsm, f, from, to)
  check_machine(fsm, "rfsm.map_from_to")
  check_function(f, "rfsm.map_from_to")
  if not (is_node_of(fsm, from) and is_node_of(fsm, to)) then
    error("rfsm.map_from_to: two nodes of the fsm expected, " .. got(from) .. " and "
      .. got(to), 2)
  end
  local is_upwards = from["_%def"].depth >= to["_%def"].depth
  local node, last = is_upwards and from or to, is_upwards and to or from
  local line, results = { node }, {}
  while node ~= last and node ~= fsm do
    node = node._parent
    if is_upwards then line[#line + 1] = node else insert(line, 1, node) end
  end
  if node ~= last then
    error(("rfsm.map_from_to: '%s' and '%s' are not on one line"):format(from._fqn,
      to._fqn), 2)
  end
  for i = 1, #line do results[#results + 1] = f(fsm, line[i]) end
  return results
end

--- Find the path that events would enable from one node, and do not take it.
--
-- A path is { node, nextl }: `nextl` is a list of { trans, next }, and false at the
-- leaf at the end of the path.
--
---@param fsm rfsm.Machine
---@param node rfsm.State|rfsm.Connector
---@param events any[]
---@return table|false path false when there is none
function rfsm.node_find_enabled(fsm, node, events)
  check_machine(fsm, "rfsm.node_find_enabled")
  if not is_node_of(fsm, node) then
    error("rfsm.node_find_enabled: node of the fsm expected, " .. got(node), 2)
  end
  if type(events) ~= "table" then
    error("rfsm.node_find_enabled: list of events expected, " .. got(events), 2)
  end
  local ways = fsm._ways -- a callback may ask while another path is searched or taken
  fsm._ways = {}
  local def = find_transition(fsm, node["_%def"], events)
  local path = def and { node = node, nextl = false } or false
  local at = path
  while def do
    local tail = { node = fsm._nodes[def.tgt.index], nextl = false }
    at.nextl = { { trans = fsm._transitions[def.index], next = tail } }
    at, def = tail, def.connector and fsm._ways[def.connector]
  end
  fsm._ways = ways
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
  leave(call_aside, fsm, state)
end

-- Makes the states from the root to `state` the active ones, or those above it.
local function move_to(state, mode)
  local fsm = state
  while fsm._parent ~= fsm do fsm = fsm._parent end
  local left = fsm -- what is active is reached by _actchild
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
-- The machine stands then where the state has that mode; no callback runs.
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
-- Otherwise the machine needs a new list for the next iteration. An event that calls
-- only such functions costs no garbage.
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

-- Hooks: lists that are replaced, never changed: a run over one is not disturbed ...

do
  -- Makes the function that adds a hook to the list `field` of a machine.
  local function hook_adder(where, field)
    return function(fsm, hook, place)
      check_machine(fsm, where)
      check_function(hook, where)
      if place ~= nil and place ~= "before" and place ~= "after" then
        error(where .. ": 'before' or 'after' expected, " .. got(place), 2)
      end
      local hooks = append({}, fsm[field])
      insert(hooks, place == "before" and 1 or #hooks + 1, hook)
      fsm[field] = hooks
      if field == "_reset_hooks" then return end
      fsm._is_hooked, fsm._is_usual = true, false
      if not borrowers[hook] then fsm._lends_events = true end
    end
  end

  -- Returns the list without a hook; nil if that is not in it.
  local function without(hooks, hook)
    for i = 1, #hooks do
      if rawequal(hooks[i], hook) then
        local others = append({}, hooks)
        remove(others, i)
        return others
      end
    end
  end

  -- Makes the function that takes a hook out again, also the model's own at `slot`.
  local function hook_remover(where, field, slot)
    return function(fsm, hook)
      check_machine(fsm, where)
      local hooks = without(fsm[field], hook)
      if hooks then
        fsm[field] = slot and #hooks == 1 and hooks[1] == OWN and OWN_ONLY or hooks
        return true
      end
      if not slot or hook == nil or not rawequal(fsm[slot], hook) then return false end
      fsm[slot] = nil
      return true
    end
  end

  -- Makes the function that adds a hook to the list `field` of a state.
  local function state_hook_adder(where, field)
    return function(fsm, state, hook)
      check_machine(fsm, where)
      check_function(hook, where)
      if not is_node_of(fsm, state, "state") then
        error(where .. ": state of the fsm expected, " .. got(state), 2)
      end
      fsm[field] = fsm[field] or {}
      fsm[field][state] = append(append({}, fsm[field][state] or {}), { hook })
      fsm._is_hooked, fsm._is_usual = true, false
    end
  end

  --- Have `hook(fsm, state)` called each time `state` is entered, before its entry.
  --
  -- For extensions: unlike a wrapped entry it stays when a tool replaces `state.entry`.
  -- Its error is raised when the iteration is over.
  --
  ---@type fun(fsm: rfsm.Machine, state: rfsm.State, hook: function)
  rfsm.entry_hook_add = state_hook_adder("rfsm.entry_hook_add", "_entry_hooks")

  --- Remove an entry hook of a state. Return whether it was there.
  ---@param fsm rfsm.Machine
  ---@param state rfsm.State
  ---@param hook function
  ---@return boolean
  function rfsm.entry_hook_rm(fsm, state, hook)
    check_machine(fsm, "rfsm.entry_hook_rm")
    local hooks = without(fsm._entry_hooks and fsm._entry_hooks[state] or NONE, hook)
    if hooks then fsm._entry_hooks[state] = hooks[1] and hooks end
    return hooks ~= nil
  end

  --- Have `hook(fsm, state)` called each time `state` is left, after its exit.
  ---@type fun(fsm: rfsm.Machine, state: rfsm.State, hook: function)
  rfsm.exit_hook_add = state_hook_adder("rfsm.exit_hook_add", "_exit_hooks")

  --- Have `hook(fsm, events)` called in each iteration before anything is chosen.
  --
  -- It may change the list of events. The machine's own `pre_step_hook` is among the
  -- hooks, and stays replaceable. `place`, "after" (default) or "before", is relative
  -- to the other hooks.
  --
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.pre_step_hook_add = hook_adder("rfsm.pre_step_hook_add", "_pre_hooks")

  --- Remove a pre step hook. Return whether it was there.
  ---@type fun(fsm: rfsm.Machine, hook: function): boolean
  rfsm.pre_step_hook_rm = hook_remover("rfsm.pre_step_hook_rm", "_pre_hooks",
    "pre_step_hook")

  --- Have `hook(fsm, events)` called at the end of each iteration.
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.post_step_hook_add = hook_adder("rfsm.post_step_hook_add", "_post_hooks")

  --- Remove a post step hook. Return whether it was there.
  ---@type fun(fsm: rfsm.Machine, hook: function): boolean
  rfsm.post_step_hook_rm = hook_remover("rfsm.post_step_hook_rm", "_post_hooks",
    "post_step_hook")

  --- For post step hooks: does the step go on with another iteration, because events
  -- came and nothing was taken?
  ---@param fsm rfsm.Machine
  ---@return boolean
  function rfsm.is_free(fsm)
    check_machine(fsm, "rfsm.is_free")
    return fsm._outcome == "free"
  end

  --- Have `hook(fsm)` called when the machine is reset, for the data of an extension.
  ---@type fun(fsm: rfsm.Machine, hook: function, place?: "before"|"after")
  rfsm.reset_hook_add = hook_adder("rfsm.reset_hook_add", "_reset_hooks")

  --- Remove a reset hook. Return whether it was there.
  ---@type fun(fsm: rfsm.Machine, hook: function): boolean
  rfsm.reset_hook_rm = hook_remover("rfsm.reset_hook_rm", "_reset_hooks")
end

-- Snapshots: what an extension keeps of a machine, and where the machine stands ....

--- Have snapshots hold what an extension keeps of a machine, under `name`.
--
-- `save(fsm, how)` returns plain data, nil if there is nothing to keep. `load(fsm,
-- data, how)` takes it back, also nil, and raises an error if the data is not its own.
--
---@type fun(fsm: rfsm.Machine, name: string, save: function, load: function)
function rfsm.snapshot_hook_add(fsm, name, save, load)
  check_machine(fsm, "rfsm.snapshot_hook_add")
  check_function(save, "rfsm.snapshot_hook_add")
  check_function(load, "rfsm.snapshot_hook_add")
  fsm._snapshot_hooks = append(append({}, fsm._snapshot_hooks or {}),
    { { name = name, save = save, load = load } })
end

--- List what `snapshot_hook_add` was called with, in that order, for extensions.
---@param fsm rfsm.Machine
---@return { name: string, save: function, load: function }[] hooks not to be changed
function rfsm.snapshot_hooks(fsm) return fsm._snapshot_hooks or NONE end

--- Reset a machine and have it stand in a leaf, false for none; no callback runs.
---@type fun(fsm: rfsm.Machine, leaf: rfsm.State|false, mode: string, queue: any[])
function rfsm.place(fsm, leaf, mode, queue)
  check_between_steps(fsm, "rfsm.place")
  if leaf then
    move_to(leaf, mode)
    run_reset_hooks(fsm)
  else
    reset_now(fsm)
  end
  fsm._intq, fsm._curq = queue, {}
end

-- Merge: a new element of a live machine ------------------------------------------

-- Drops the definitions of the old plan, but for those of the path that is being taken.
local function forget_paths(fsm)
  local old, ways, def = fsm._ways, {}, fsm._phase == "take" and fsm._path
  while def do
    local node = def.kind == "state" and def or def.connector
    if node then ways[node] = old[node] end
    def = node and old[node]
  end
  fsm._ways = ways
  if fsm._phase == "idle" then fsm._path = false end
end

-- Makes a machine use another plan, in which its elements have the same positions.
function use_plan(fsm, plan)
  forget_paths(fsm)
  fsm._plan, fsm["_%def"] = plan, plan.nodes[1]
  for i = 2, #fsm._nodes do setmetatable(fsm._nodes[i], plan.nodes[i].proto) end
  for i, tr in ipairs(fsm._transitions) do
    setmetatable(tr, plan.transitions[i].proto)
  end
  list_otrs(fsm, plan)
end

do
  -- Is `state` the state `other`, or inside of it?
  local function is_inside(state, other)
    while state ~= other and state._parent ~= state do state = state._parent end
    return state == other
  end

  -- Why nothing can be added below `parent`, a leaf so far; nil when it can.
  local function leaf_obstacle(fsm, parent)
    if parent._mode ~= "inactive" then
      return ("'%s' is an active leaf state"):format(parent._fqn)
    elseif fsm._phase == "take" or fsm._phase == "search" and not fsm._act_leaf then
      return ("'%s' is a leaf state, while a transition is taken"):format(parent._fqn)
    end
  end

  -- Why `obj` cannot become a member of `parent`; nil when it can.
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
    elseif rawget(obj, "_parent") and is_inside(parent, obj) then
      return ("'%s' cannot contain itself"):format(obj._fqn)
    elseif kind ~= "transition" and parent["_%def"].is_leaf then
      return leaf_obstacle(fsm, parent)
    end
  end

  -- Adds `obj` to a plan for the machine, as a member of `parent`.
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
    plan.warnings, plan.created = build.warnings, build.created
    return build
  end

  -- Transitions to a leaf that has become a composite end at its `initial` now.
  local function move_targets(build, parent, first)
    local moved = {}
    if parent.is_leaf then return moved end
    for i = 1, first - 1 do
      local def = build.plan.transitions[i]
      if def.tgt == parent and not def.is_internal then
        moved[i], def.tgt = true, find_entrance(build, def, parent)
      end
    end
    return moved
  end

  -- Takes out again what the list holds from number `first` on.
  local function truncate(list, first)
    for i = #list, first, -1 do
      local element = list[i]
      if rawequal(rawget(element._parent, element["_%def"].id), element) then
        rawset(element._parent, element["_%def"].id, nil)
      end
      list[i] = nil
    end
  end

  -- Uses a plan, and its targets for the transitions in `moved`.
  local function use_targets(fsm, plan, moved)
    for i = 1, #plan.transitions do
      if moved[i] then
        fsm._transitions[i].tgt = fsm._nodes[plan.transitions[i].tgt.index]
      end
    end
    use_plan(fsm, plan)
  end

  -- The machine is again as it was with the plan `plan`.
  local function undo_merge(fsm, plan, moved)
    truncate(fsm._transitions, #plan.transitions + 1)
    truncate(fsm._nodes, #plan.nodes + 1)
    use_targets(fsm, plan, moved)
  end

  local function refuse(fsm, reason)
    report(fsm, "err", reason)
    return false, reason
  end

  --- Add a state, connector or transition to a live machine.
  --
  -- From the next iteration on the machine behaves as if it had been there at `init`.
  -- If it cannot be added, the reason is reported to `err`, and nothing has changed.
  --
  ---@param fsm rfsm.Machine
  ---@param parent rfsm.State the state of the machine that gets it
  ---@param obj rfsm.State|rfsm.Connector|rfsm.Transition it is cloned, as `init` does
  ---@param id? string name; optional for a transition
  ---@return boolean is_merged
  ---@return string? reason why not
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
      append(build.problems, build.warnings) -- in a leaf, and leads nowhere
    end
    local problems = lines_of(build.problems)
    if problems[1] then return refuse(fsm, summary("rfsm.fsm_merge", problems)) end
    compile(plan)
    make_elements(fsm, plan, first_node, first_transition)
    use_targets(fsm, plan, moved)
    local ok, found = pcall(preprocess, fsm, parent[id])
    if not ok then found = { "a preproc function failed: " .. text_of(found) } end
    if found[1] then
      undo_merge(fsm, old, moved)
      return refuse(fsm, summary("rfsm.fsm_merge", found))
    end
    report_lines(fsm, "info", build.created)
    report_findings(fsm, first_node, first_transition)
    report_dead_ends(fsm, first_node)
    return true
  end
end

-- Names: fields that are modules of their own, and the older names of modules -------

local FIELDS = { seqand = "rfsm_seqand", pp = "rfsmpp" }

setmetatable(rfsm, { __index = function(_, field)
  rfsm[field] = FIELDS[field] and find_module(FIELDS[field])
  return rawget(rfsm, field)
end })

-- Finds flat names (rfsm_emem for rfsm.emem) in the folder compat/ beside this file.
local function find_old_name(name)
  if not name:find("^rfsm[%w_]+$") then return nil end
  local file = "compat/" .. name .. ".lua"
  for folder in rawget(_G, "package").path:gmatch("([^;]*)%?%.lua") do
    local chunk = loadfile(folder .. file)
    if chunk then return chunk, folder .. file end
  end
end

-- Makes the module known; a sandbox may have no `package`, or none of its fields.
local function register(package)
  local searchers = package.searchers or package.loaders
  if searchers and loadfile and not searchers.rfsm then
    searchers.rfsm = find_old_name -- a mark: one searcher is enough
    searchers[#searchers + 1] = find_old_name
  end
  if package.loaded and not package.loaded.rfsm then package.loaded.rfsm = rfsm end
end

register(rawget(_G, "package") or {})
if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm", rfsm) end

return rfsm
