--- Statecharts in pure Lua: load, check, compile and run a model.
--
-- A model is a tree of plain tables, marked by `rfsm.state`, `rfsm.trans` and
-- `rfsm.conn`. `rfsm.init` checks it, reports every mistake with its location, and
-- makes an independent machine of it. `rfsm.send_events` sends events to the machine.
-- The machine advances only in calls of `rfsm.step` and `rfsm.run`; no call waits.
--
-- The file reads in the order the data flows: model elements, load, check, clone,
-- resolve, index, machine, report, run, build, use, regions, names. An FQN is a fully
-- qualified name ("root.a.b"). An iteration is one turn of the loop inside `step`. The
-- file is complete: rfsm/fast.lua only makes machines faster.
--
-- @module rfsm
-- @license BSD-3-Clause

local error, getmetatable, ipairs = error, getmetatable, ipairs
local next, pairs = next, pairs
local pcall, rawequal, rawget, rawset, select = pcall, rawequal, rawget, rawset, select
local setmetatable, tostring, type = setmetatable, tostring, type
local concat, insert, sort = table.concat, table.insert, table.sort
local huge = 1 / 0

-- Returns a global, or a field of a global table; nil if a sandbox does not have it.
local function find_global(name, field)
  local value = rawget(_G, name)
  if not field then return value end
  return type(value) == "table" and rawget(value, field) or nil
end

local loadfile = find_global "loadfile"
local loadstring = find_global "loadstring" or find_global "load"

-- A bundler may replace it by a local one.
local require = select(2, pcall(function() return require end))

-- LuaJIT 2.1.0-beta3 sometimes skips keys in a traversal that it has compiled.
-- Functions with such a traversal are given to `interpret`, and are never compiled.
local interpret = find_global("jit", "off") or function() end

---@class rfsm
---@field seqand fun(t: rfsm_seqand.Fields): rfsm.State
---@field pp table the module rfsmpp
local rfsm = { _VERSION = "rfsm 1.0.0" }

-- Functions of the engine for the files of the library beside this one.
local engine = { interpret = interpret }

-- Model elements: constructors, predicates, order -----------------------------

local State, Transition = { rfsm = "state" }, { rfsm = "transition" }
local Connector = { rfsm = "connector" }
local CLASSES = { state = State, transition = Transition, connector = Connector }

local Machine = { rfsm = "state", __eq = rawequal, rfsm_copy = rfsm }

local KINDS = {} -- metatable of an element of this library -> kind of the element

local function ask_type(value) return value:type() end

--- Return the kind of a model element, or nil for any other value, for extensions.
--
-- A table of another library is an element, too, if its metatable has a true field
-- `rfsm` and its method `type` returns a kind.
--
---@param value any
---@return "state"|"transition"|"connector"|nil kind
function rfsm.kind_of(value)
  local class = getmetatable(value)
  local known = class ~= nil and KINDS[class]
  if known then return known end
  local mark = type(class) == "table" and rawget(class, "rfsm")
  if not mark or CLASSES[mark] then return mark or nil end
  local ok, kind = pcall(ask_type, value)
  if not ok and rfsm.is_interrupt(kind) then error(kind, 0) end
  return ok and CLASSES[kind] and kind or nil
end

local kind_of = rfsm.kind_of

-- Where the tables of a model were made: table -> "file:line".
local made_at = setmetatable({}, { __mode = "k" })

local define, this_chunk

do
  local getinfo = find_global("debug", "getinfo")
  this_chunk = getinfo and getinfo(1, "S")
  local knows_tail_calls = getinfo ~= nil and pcall(getinfo, 1, "t")

  --- Record where an element was made, for constructors in extensions.
  --
  -- Nothing is recorded after a tail call: the stack frame of the caller is gone.
  --
  ---@param t table the element
  ---@param level integer stack level, as for `error`: 2 is the constructor's caller
  function rfsm.note_location(t, level)
    made_at[t] = nil
    if not getinfo then return end
    if knows_tail_calls and getinfo(level, "t").istailcall then return end
    local caller = getinfo(level + 1, "Sl")
    if caller and caller.currentline > 0
      and caller.short_src ~= this_chunk.short_src then
      local file = caller.source:match("^@(.*)") or caller.short_src -- at most 60 bytes
      made_at[t] = ("%s:%d"):format(file, caller.currentline)
    end
  end

  -- Returns a metatable for elements that inherit from `base`, a state or transition.
  local function heir_class(base)
    local class = getmetatable(base)
    return { rfsm = class.rfsm, __index = base, __tostring = class.__tostring }
  end

  -- Has a table that is no element a class, which an element would lose, or that is
  -- protected?
  local function is_object(t)
    local class = not rfsm.is_foreign(t) and getmetatable(t)
    return class and (type(class) ~= "table" or rawget(class, "__index") ~= nil)
  end

  -- Makes a class its own constructor: X{...} or X:new{...} marks a table as an element
  -- of class X. An element made by base:new{...} inherits from the element `base`.
  function define(class, name)
    function class.new(base, t)
      local kind = type(t) == "table" and kind_of(t)
      if kind and rawget(t, "_parent") ~= nil then return t end -- in a machine
      if type(t) ~= "table" or rawequal(t, rfsm) or kind and kind ~= class.rfsm then
        error("rfsm." .. name .. ": table expected, " .. rfsm.got(t), 2)
      elseif not kind and is_object(t) then
        error("rfsm." .. name .. ": plain table expected, got an object, whose class "
          .. "would be lost (make it a field of the " .. name .. ")", 2)
      end
      rfsm.note_location(t, 2)
      return setmetatable(t, base == class and class or heir_class(base))
    end
    function class.type() return class.rfsm end
    class.__index = class
    return setmetatable(class, { __call = class.new })
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

function rfsm.is_meta(key) return type(key) == "string" and key:byte() == 95 end
function rfsm.is_state(value) return kind_of(value) == "state" end
function rfsm.is_trans(value) return kind_of(value) == "transition" end
function rfsm.is_conn(value) return kind_of(value) == "connector" end
function rfsm.is_fsmobj(value) return kind_of(value) ~= nil end
function rfsm.is_node(value)
  local kind = kind_of(value)
  return kind == "state" or kind == "connector"
end

local is_meta, is_node, is_state = rfsm.is_meta, rfsm.is_node, rfsm.is_state

-- Returns `state` if it is an element of a machine, nil if it is one of a model.
local function live(state)
  return not rawequal(rfsm.model_of(state), state) and state or nil
end

-- Is a value an element of the state in which it is? A program may keep elements in any
-- field of `owner`, a part of a machine. Those of a machine know where they belong.
local function is_member(value, key, owner)
  if type(value) ~= "table" or is_meta(key) or not kind_of(value) then return false end
  return owner == nil
    or rawequal(rawget(value, "_parent"), owner) and rawequal(rawget(value, "_id"), key)
end

local function has_nodes(state)
  local owner = live(state)
  for key, value in pairs(state) do -- any order: one node is enough
    if is_node(value) and is_member(value, key, owner) then return true end
  end
  return false
end

function rfsm.is_composite(value) return is_state(value) and has_nodes(value) end
function rfsm.is_leaf(value) return is_state(value) and not has_nodes(value) end
function rfsm.is_root(value) return rawequal(getmetatable(value), Machine) end
function rfsm.is_initialized_root(value)
  return rfsm.is_root(value) and rawget(value, "_initialized") == true
end

function rfsm.is_nr_node(value) return is_node(value) and not rfsm.is_root(value) end

--- Return the kind of a model element in one or two letters.
---@param value any
---@return "CS"|"LS"|"TR"|"c"|nil letters composite, leaf, transition, connector
function rfsm.fsmobj_tochar(value)
  local kind = kind_of(value)
  if kind == "state" then return has_nodes(value) and "CS" or "LS" end
  return kind == "transition" and "TR" or kind == "connector" and "c" or nil
end

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
  if number ~= number then return "nan" end -- some print "-nan"
  return ((format or "%.14g"):format(number):gsub("[^%d%l+-]+", "."))
end

--- Return the number that a text with a point means in every locale; nil if it is none.
---@param text any
---@return number?
function rfsm.number_of(text)
  if type(text) ~= "string" then return type(text) == "number" and text or nil end
  if text:find("[^%x%s.+xXpP-]") or text:find("^%s*[+-]?0[bB]") then return nil end
  local point = ("%.1f"):format(0.5):sub(2, -2)
  return find_global "tonumber"((text:gsub("%.", point)))
end

--- Does a text come before another one? Bytes decide, in every locale.
---@param a string
---@param b string
---@return boolean
function rfsm.text_before(a, b)
  if "B" < "a" then return a < b end -- bytes decide here, too
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
  if not ok and rfsm.is_interrupt(text) then error(text, 0) end
  return ok and type(text) == "string" and text or kind
end

local is_callable, text_of = rfsm.is_callable, rfsm.text_of

local list_text

--- Return the name of an event with data, a plain table with a text `name`; nil for any
--- other event.
---@param event any
---@return string? name
---@package
function rfsm.name_with_data(event)
  if type(event) ~= "table" or getmetatable(event) then return nil end
  local name = rawget(event, "name")
  return type(name) == "string" and name or nil
end

local name_with_data = rfsm.name_with_data

do
  -- The predicates that `rfsm.named` has made: predicate -> name, name -> predicate.
  local event_names = setmetatable({}, { __mode = "k" })
  local predicates = setmetatable({}, { __mode = "v" })

  --- Return a predicate for `events` that accepts tables whose field `name` is `name`.
  --
  -- Such events carry data: `rfsm.send_events(fsm, { name = "e_paid", amount = 12 })`.
  -- Equal names give the same predicate; `rfsm.event_name` returns a predicate's name.
  --
  ---@param name string
  ---@param ... nil a second name is an error
  ---@return fun(event: any): boolean predicate
  function rfsm.named(name, ...)
    if type(name) ~= "string" or (...) ~= nil then
      error("rfsm.named: name of an event expected, " .. rfsm.got(name)
        .. ((...) ~= nil and " and more" or ""), 2)
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

  -- Returns the text of a value; its kind if the text would have an address.
  local function identity_text(value)
    local kind, text = type(value), text_of(value)
    if kind == "string" or kind == "number" then return text end
    if kind == "function" then return "a predicate" end
    local has_address = text == kind or text:find("^" .. kind .. ": ")
      or text:find("0x%x%x%x%x%x%x")
    return has_address and "a " .. kind or text
  end

  --- Return an event or predicate of a transition as text: its name if it has one.
  --
  -- All tools show this text. If there is room for data, an event with data is shown as
  -- `e_paid{amount=12}`, and a predicate of `rfsm.named` as `e_paid{..}`. No text is an
  -- address, so it is the same in each run.
  --
  ---@param event any
  ---@param has_room? boolean show data, too, in short
  ---@return string
  function rfsm.event_text(event, has_room)
    local name = event_names[event]
    if name then return has_room and name .. "{..}" or name end
    local is_plain = type(event) == "table" and not getmetatable(event)
    local pp = is_plain and has_room and rfsm.pp
    name = name_with_data(event)
    if pp then return pp.short_text(event, name) end
    return name or identity_text(event)
  end

  -- Returns the events of a transition for the trace, where a function is its address,
  -- as in the original.
  function list_text(events)
    local texts = {}
    for i = 1, #events do
      local is_nameless = type(events[i]) == "function" and not event_names[events[i]]
      texts[i] = is_nameless and text_of(events[i]) or rfsm.event_text(events[i])
    end
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
    local text = ("T={ src='%s', tgt='%s'"):format(end_text(tr.src), end_text(tr.tgt))
    local events = type(tr.events) == "string" and { tr.events } or tr.events
    if tr.pn then text = text .. ", pn=" .. text_of(tr.pn) end
    if type(events) == "table" and events[1] ~= nil then
      text = text .. ", events='" .. list_text(events) .. "'"
    end
    return text .. " }"
  end
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
---@param pred? fun(value: any, key: any, ...): boolean true for the keys to return
---@param ... any further arguments of `pred`
---@return any[] keys
function rfsm.sorted_keys(t, pred, ...)
  local keys = {}
  for key, value in next, t do -- any order: sorted
    if not pred or pred(value, key, ...) then keys[#keys + 1] = key end
  end
  sort(keys, key_before)
  return keys
end

local sorted_keys = rfsm.sorted_keys
interpret(sorted_keys)
interpret(has_nodes)

-- Has a composite a leaf right in it that is final?
local function has_final(composite)
  return rfsm.mapfsm(function(leaf)
    return leaf ~= composite and rawequal(leaf.final, true) or nil
  end, composite, rfsm.is_leaf, 1)[1] or false
end

--- Can a state of a machine be done, so that its e_done comes? For extensions.
--
-- A leaf can. A composite needs a leaf right in it with `final = true`; a state with
-- regions needs such a leaf in the root of each region.
--
---@param node rfsm.State|rfsm.Connector
---@return boolean
---@return any region the name of a region without such a leaf
---@package
function rfsm.can_be_done(node)
  if not is_state(node) then return false end
  if not node._is_leaf then return has_final(node) end
  local regions, own = rfsm.regions(node)
  for i, region in ipairs(regions) do
    if not has_final(region) then return false, own.names[i] end
  end
  return true
end

local NONE = {}

local function append(list, more)
  for i = 1, #more do list[#list + 1] = more[i] end
  return list
end

-- Load ------------------------------------------------------------------------

-- Takes modules of rfsm and one named `other` out of `package.loaded`, if their values
-- have a type of the text `types`. Whoever requires them again gets new ones.
local function forget_modules(types, other)
  local loaded = find_global("package", "loaded") or NONE
  for name, module in pairs(loaded) do -- any order: each stands alone
    local is_meant = name == other or tostring(name):find("^rfsm[%w_.]")
    if is_meant and types:find(type(module), 1, true) then loaded[name] = nil end
  end
end

--- Load a module that is needed while machines run, for extensions.
--
-- If an interrupt cuts the load short, the module can be loaded again. `require` of Lua
-- 5.1 would refuse it: its mark stays, which is a userdata, in LuaJIT a number.
--
---@param name string
---@return any? module nil if it is not installed
function rfsm.find_module(name)
  if type(require) ~= "function" then return nil end
  local ok, module = pcall(require, name)
  if ok then return module end
  if not text_of(module):find("module '" .. name .. "' not found", 1, true) then
    forget_modules("userdata number", name)
    error(module, 0)
  end
end

local find_module = rfsm.find_module

local advice

-- Returns the hint of rfsm/advice.lua on a topic, or "" if this file is missing.
local function advise(topic, ...)
  if advice == nil then advice = find_module("rfsm.advice") or false end
  if not advice then return "" end
  return advice[topic](...)
end

-- Returns a problem or warning in the words of rfsm/advice.lua; its name if this file
-- is missing, such as "unusable name".
local function words(name, ...)
  local text = advise("words", name, ...)
  return text ~= "" and text or name
end

-- Returns the place of the last `return` at the margin of a file; line 1 if there is
-- none. After a tail call, as in `return rfsm.state{...}`, it stands for the root.
local function place_of_return(file)
  local lines, line, found = find_global("io", "lines"), 0, 1
  for text in lines and lines(file) or function() end do
    line = line + 1
    if text:find("^return%f[^%w_]") then found = line end
  end
  return file .. ":" .. found
end

-- Runs the chunk of a chart and returns its root state.
local function run_chunk(chunk, file, where, accepts)
  local model = chunk(file)
  if accepts and accepts(model) then return model end
  if not is_state(model) then error(where .. " found." .. advise("chart", model), 0) end
  made_at[model] = made_at[model] or file and place_of_return(file)
  return model
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
    error("rfsm.load: file name expected, " .. rfsm.got(file), 2)
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
    error("rfsm.load_str: string expected, " .. rfsm.got(text), 2)
  end
  if not loadstring then error("rfsm.load_str: there is no load here", 2) end
  local chunk, problem = loadstring(text, chunkname)
  if not chunk then error("rfsm.load_str: failed to load chunk: " .. problem, 0) end
  return run_chunk(chunk, nil, "rfsm.load_str: no valid rfsm in '"
    .. (chunkname or "string") .. "'")
end

-- Check: every mistake in the model, each with its location --------------------
--
-- A check never raises an error. It appends to one of two lists of the `rfsm.Build`:
-- `problems`, which make `init` fail, or `warnings`. `init` sorts both by location.

-- Returns an empty rfsm.Build, for what `init` or `fsm_merge` finds.
function engine.new_build(fsm)
  return {
    fsm = fsm, problems = {}, warnings = {}, created = {}, mounts = {}, copies = {},
  }
end

-- Returns the name of an element for messages: an FQN, or root.trans[2] (a -> b). If
-- `field` is given, the name includes it: root.trans[2].events (a -> b).
local function name_of(obj, field)
  local suffix, key = field and "." .. field or "", text_of(obj._id)
  if kind_of(obj) ~= "transition" then return obj._fqn .. suffix end
  if type(obj._id) == "number" then key = "trans[" .. key .. "]" end
  local name, model = obj._parent._fqn .. "." .. key .. suffix, obj._model
  if type(model.src) ~= "string" or type(model.tgt) ~= "string" then return name end
  return ("%s (%s -> %s)"):format(name, model.src, model.tgt)
end

-- Adds a problem or warning to a list, and returns it.
local function add(list, obj, field, text)
  local found = {
    file = made_at[obj._model], line = name_of(obj, field) .. ": " .. text,
    code = "init",
  }
  list[#list + 1] = found
  return found
end

-- Adds a warning with its code in rfsm/checks/codes.lua; false: a check tells more.
local function add_warning(list, code, ...) add(list, ...).code = code end

local CALLBACKS = {
  state = { entry = true, exit = true, doo = true }, connector = {},
  transition = { guard = true, effect = true },
}

-- Adds the warning of rfsm/advice.lua on a topic, if the file has one. The caller has
-- found something suspicious already, so most charts do not load the file.
local function add_advice(list, topic, obj, ...)
  local text, code, field = advise(topic, obj, ...)
  if text ~= "" then add_warning(list, code, obj, field, text) end
end

--- Describe an unexpected value: "got string 'led'", "got state", for extensions.
---@param value any
---@return string text
function rfsm.got(value)
  local kind = rawequal(value, rfsm) and "the library (rfsm.f, not rfsm:f)"
    or kind_of(value) or type(value)
  if kind == "string" then return "got string '" .. value .. "'" end
  if kind == "number" then return "got number " .. text_of(value) end
  return "got " .. kind
end

local got = rfsm.got

local HOOKS = { "getevents", "idle_hook", "pre_step_hook", "post_step_hook", "gettime" }
local PRINTERS = { "dbg", "info", "warn", "err" }

local function check_callable(build, obj, field, value, other)
  if value and not is_callable(value) then
    add(build.problems, obj, field, "function" .. (other or "") .. " expected, "
      .. got(value))
  end
end

-- Clone: the elements of a machine, one for each position in the model --------------
--
-- A machine is a tree of plain tables. Raw fields are the children by name, transitions
-- by position or name, callbacks, the user's data, and fields of the engine, which
-- begin with an underscore. The configuration is kept only in `_mode` of each state,
-- `_actchild` of each active composite, and `_act_leaf` of the machine.

-- The metatables of elements in machines, by kind.
local LIVE = {}

for kind, class in pairs(CLASSES) do -- any order: independent entries
  LIVE[kind] = {
    rfsm = kind, __tostring = class.__tostring, __index = class,
    __eq = rawequal, -- so that the `__eq` of another value is never called
  }
  KINDS[class], KINDS[LIVE[kind]] = kind, kind
end
KINDS[Machine] = "state"

LIVE.transition.__index = {
  guard = false, effect = false, type = Transition.type, new = Transition.new,
}

-- A state that was never entered has no such fields of its own.
LIVE.state.__index = {
  _mode = "inactive", _is_leaf = true, _choices = NONE, type = State.type,
  new = State.new, rfsm = "state",
}

--- Does a value belong to another copy of this library? For extensions: the metatable
--- of their objects has the field `rfsm_copy`, which is this module.
---@param value any
---@return boolean
function rfsm.is_foreign(value)
  local class = type(value) == "table" and getmetatable(value)
  if not class or KINDS[class] then return false end
  local copy = type(class) == "table" and rawget(class, "rfsm_copy")
  return type(copy) == "table" and not rawequal(copy, rfsm)
end

--- Return the model of a machine, or of an element of a machine, for extensions.
---@param value any
---@return any model or `value` itself, if it is not a part of a machine
function rfsm.model_of(value)
  local class = getmetatable(value)
  local kind = KINDS[class]
  return kind and class ~= CLASSES[kind] and value._model or value
end

local is_foreign, model_of = rfsm.is_foreign, rfsm.model_of

local FOREIGN = "it belongs to another copy of rfsm"
local FOREIGN_MACHINE = FOREIGN .. " (give the model, not the machine)"

-- Is `value` a node of the machine, and of the given kind? Without `kind`, of any kind.
local function is_node_of(fsm, value, kind)
  local index = type(value) == "table" and rawget(value, "_index")
  return index and rawequal(fsm._nodes[index], value)
    and (not kind or kind_of(value) == kind)
end

-- Notes from which model a node was made, because a model may be used repeatedly.
function engine.note_mount(build, node)
  local mounts = build.mounts[node._model] or {}
  mounts[#mounts + 1], build.mounts[node._model] = node, mounts
end

do
  -- Copies nested plain tables. They wait in the list `pending`: any depth is allowed.
  local function clone_data(copies, value)
    local pending, i = {}, 1
    local function copy_of(v)
      if type(v) ~= "table" or getmetatable(v) ~= nil then return v end
      if not copies[v] then copies[v], pending[#pending + 1] = {}, v end
      return copies[v]
    end
    local copy = copy_of(value)
    while pending[i] do
      local source = pending[i]
      for k, v in pairs(source) do copies[source][copy_of(k)] = copy_of(v) end -- a set
      i = i + 1
    end
    return copy
  end

  local ROOT_FIELDS = {}
  for _, name in ipairs(PRINTERS) do ROOT_FIELDS[name] = true end
  for _, name in ipairs(HOOKS) do ROOT_FIELDS[name] = true end

  -- Public fields of the engine. If a model has a field with such a name, the field is
  -- not copied, because it is not the user's data.
  local API_FIELDS = " _act_leaf _actchild _always _choices _curq _depth _done_event "
    .. "_doo_co _fqn _fsm _id _index _initialized _intq _is_asked _is_internal "
    .. "_is_leaf _mode _model _otrs _parent _paths _target "

  -- Fields of a machine that are absent until they are needed, beside DEFAULTS.
  --   _again       the events that `keep_made` has put ahead of the queue
  --   _elements    for `elements`, while preproc functions run
  --   _emit        the function given to `set_emit`
  --   _has_always  has a transition that needs no event: no iteration is usual
  --   _searched    the iteration whose search `note_cut` has ended last
  local LATER_FIELDS = " _again _elements _emit _entry_hooks _event "
    .. "_exit_hooks _failed _failure _fate_hooks _fates _given_to _got _guard_hooks "
    .. "_has_always _has_paths _owner _path_hooks _preparing _reaction_hooks "
    .. "_region_name _reset_hooks _reset_wanted _searched _snapshot_hooks "
    .. "_source_hooks _structure _waiting_hooks _watch_hooks "

  -- Checks the name of a node: a path can contain it, and it is no field of the parent.
  local function check_name(build, kind, node)
    local name, fields = node._id, node._depth == 1 and ROOT_FIELDS or NONE
    local is_usable = type(name) == "string" and name ~= "" and not is_meta(name)
      and not (name:find("[.\\]") or CALLBACKS.state[name] or fields[name])
      and (name ~= "initial" or kind == "connector")
    if not is_usable then
      add(build.problems, node, nil, words("unusable name", name, kind))
    end
  end

  -- Returns the events of a transition as a new list. A model has one string, or a list
  -- without holes. Any value except NaN may be an event.
  local function check_events(build, tr, events)
    local list, count = {}, 0
    if not events then return list end
    if type(events) == "string" then return { events } end
    if type(events) ~= "table" or getmetatable(events) ~= nil then
      add(build.problems, tr, "events", "list of events or a string expected, "
        .. got(events))
      return list
    end
    for _ in pairs(events) do count = count + 1 end -- any order: only counted
    for i = 1, count do
      local event = events[i]
      if event == nil then
        add(build.problems, tr, "events", "list of events expected, got a table with "
          .. "holes or keys" .. advise("list", events))
        return {}
      elseif event ~= event then
        add(build.problems, tr, ("events[%d]"):format(i), "an event cannot be NaN")
      end
      list[i] = event
    end
    if count == 0 then
      add_warning(build.warnings, "empty-events", tr, "events", words("an empty list"))
    end
    return list
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

  -- Is the model of `node` also the model of an ancestor? Then cloning would never end.
  local function is_inside_itself(node)
    local above = node
    while above._parent ~= above do
      above = above._parent
      if rawequal(above._model, node._model) then return true end
    end
    return false
  end

  -- Copies a field of the user's data.
  local function clone_datum(build, kind, obj, key, value)
    local is_root = rawequal(obj, build.fsm)
    if is_root and is_meta(key)
      and (obj[key] ~= nil or LATER_FIELDS:find(" " .. key .. " ", 1, true)) then
      return add(build.warnings, obj, key, words("a field of the machine"))
    end
    if type(value) == "table" then value = clone_data(build.copies, value) end
    rawset(obj, key, value)
    if is_root and ROOT_FIELDS[key] then return end
    local is_odd = kind == "transition" or type(value) == "table"
      or type(value) == "string" or is_callable(value)
    if is_odd then add_advice(build.warnings, "datum", obj, key, obj._model[key]) end
  end

  -- Copies a field that is no node and no transition: a callback or the user's data.
  local function clone_field(build, kind, obj, key, value)
    if CALLBACKS[kind][key] then
      check_callable(build, obj, key, value)
      if value then
        rawset(obj, key, value)
      elseif key == "guard" then
        add_warning(build.warnings, "false-guard", obj, nil, words("a false guard"))
      end
    elseif key == "initial" and kind == "state" then
      add(build.problems, obj, key, words("no connector", got(value)))
    elseif not (is_meta(key) and API_FIELDS:find(" " .. key .. " ", 1, true)) then
      clone_datum(build, kind, obj, key, value)
    end
  end

  -- Makes a node of the machine. `clone_below` adds its fields and members later.
  function engine.new_node(build, kind, model, parent, key)
    local nodes = build.fsm._nodes
    local node = setmetatable({
      _parent = parent, _id = key, _fqn = parent._fqn .. "." .. text_of(key),
      _model = model_of(model), _index = #nodes + 1, _depth = parent._depth + 1,
      _otrs = NONE,
    }, LIVE[kind])
    nodes[node._index], parent._is_leaf = node, false
    engine.note_mount(build, node)
    check_name(build, kind, node)
    if not is_meta(key) then rawset(parent, key, node) end
    return node
  end

  local OWN_FIELDS = { src = true, tgt = true, events = true, pn = true }

  function engine.new_transition(build, model, parent, key)
    model = model_of(model)
    local transitions = build.fsm._transitions
    local tr = setmetatable({
      _parent = parent, _id = key, _fsm = build.fsm, _model = model, src = model.src,
      tgt = model.tgt,
    }, LIVE.transition)
    transitions[#transitions + 1] = tr
    if type(key) == "number" or type(key) == "string"
      and not (is_meta(key) or CALLBACKS.state[key]) then
      rawset(parent, key, tr)
    else
      add(build.problems, tr, nil, words("unusable key", key))
    end
    for field, value in pairs(fields_of(model)) do -- any order: independent entries
      if not OWN_FIELDS[field] then
        clone_field(build, "transition", tr, field, value)
      end
    end
    tr.events, tr.pn = check_events(build, tr, model.events), model.pn or nil
    if tr.pn and (type(tr.pn) ~= "number" or tr.pn ~= tr.pn) then
      add(build.problems, tr, "pn", "number expected, " .. got(tr.pn))
      tr.pn = nil
    end
  end

  -- Checks a node whose members are known: does a leaf have a transition, a composite a
  -- doo?
  function engine.check_members(build, node, has_transition)
    if node._is_leaf and has_transition then
      add_warning(build.warnings, "misplaced", node, nil,
        "a transition inside a leaf state" .. advise("plain_states", node._model))
    elseif not node._is_leaf and node._mode and node.doo then
      add(build.problems, node, "doo", "only a leaf state can have a doo")
    end
  end

  local function clone_node(build, node)
    local has_transition, own_kind = false, kind_of(node)
    for key, value in pairs(fields_of(node._model)) do -- any order: sorted later
      local is_table = type(value) == "table"
      local kind = is_table and kind_of(value)
      if is_table and is_foreign(value) then
        add(build.problems, node, text_of(key), kind and FOREIGN_MACHINE or FOREIGN)
      elseif not kind then
        clone_field(build, own_kind, node, key, value)
      elseif own_kind == "connector" then
        add_warning(build.warnings, "misplaced", node, nil,
          words("in a connector", kind, text_of(key)))
      elseif kind == "transition" then
        engine.new_transition(build, value, node, key)
        has_transition = true
      else
        engine.new_node(build, kind, value, node, key)
      end
    end
    engine.check_members(build, node, has_transition)
  end

  for _, f in ipairs { check_events, clone_data, clone_node, fields_of,
    engine.new_transition } do
    interpret(f)
  end

  -- Adds fields and members to the nodes from number `first` on. New nodes are appended
  -- to the list of nodes, so that the loop reaches them, too.
  function engine.clone_below(build, first)
    local nodes, i = build.fsm._nodes, first
    while nodes[i] do
      local node = nodes[i]
      if build.mounts[node._model][2] and is_inside_itself(node) then
        add(build.problems, node, nil, "a state cannot contain itself")
      else
        clone_node(build, node)
      end
      i = i + 1
    end
  end
end

-- Resolve: names become nodes, `e_done` gets the name of its source -------------

-- Returns the innermost node that contains both nodes or is one of them.
function engine.find_lca(a, b)
  while a ~= b do
    if a._depth >= b._depth then a = a._parent else b = b._parent end
  end
  return a
end

-- Returns the node where a transition to `node` ends: for a composite, its `initial`,
-- unless the transition is internal; nil if there is none.
local function end_at(tr, node)
  if not node._mode or node._is_leaf or tr._is_internal and node == tr.src then
    return node
  end
  local initial = rawget(node, "initial")
  return kind_of(initial) == "connector" and initial or nil
end

-- Lists the states from the root to `leaf`.
local function line_to(leaf)
  local line, state = {}, leaf
  for i = leaf._depth + 1, 1, -1 do
    line[i], state = state, state._parent
  end
  return line
end

do
  -- Returns the node at the path "a.b" below `node`. If there is no such node, returns
  -- nil and the reason, which may suggest a node from the list `all`.
  local function find_below(node, path, all)
    for name in (path .. "."):gmatch("([^.]*)%.") do
      local child = rawget(node, name)
      if not is_node(child) or is_meta(name) then
        return nil, words("unknown name", name, node, all, path)
      end
      node = child
    end
    return node
  end

  -- Returns the node that a name in a transition of `composite` refers to:
  -- (a) ".a.b" or "..a.b" is a path below the composite;
  -- (b) "a" is a member of the composite; "root" is the root, unless the composite has
  --     a member of this name;
  -- (c) "a.b" or "root.a.b" is a path below the root; "root.a" may also lead to the
  --     member "a" of a member "root", if the root has no member "a".
  local function find_named(build, composite, name)
    local all, relative = build.fsm._nodes, name:match("^%.%.?([^.].*)$")
    local root, rest = all[1], name:match("^root%.(.*)$")
    if relative then return find_below(composite, relative, all) end
    local is_path = name:find(".", 1, true)
    local node, reason = find_below(is_path and root or composite, rest or name, all)
    if name == "root" then return node or root end
    if node or not (rest and is_node(rawget(root, "root"))) then return node, reason end
    return find_below(root, name, all), reason
  end

  -- Returns the node for `ref`, which is a table of the model and not a name. If the
  -- model uses this table in several places, returns the node nearest to `composite`.
  local function find_mounted(build, composite, ref)
    local nearest, most, is_tie = nil, -1, false
    if is_node_of(build.fsm, ref) then return ref end
    for _, mount in ipairs(build.mounts[model_of(ref)] or {}) do
      local depth = engine.find_lca(composite, mount)._depth
      if depth >= most then is_tie, nearest, most = depth == most, mount, depth end
    end
    if is_tie then
      return nil, "the table given stands in several places, use a name"
    end
    return nearest, not nearest and "the table given is no part of this model" or nil
  end

  -- Returns the node to which `src` or `tgt` refers, or nil and a reason.
  local function find_end(build, tr, field)
    local ref = tr[field]
    if type(ref) == "string" then
      local member = rawget(tr._parent, ref) -- the usual case; not a field "_parent"
      if is_node(member) and member._id == ref then return member end
      local node, reason = find_named(build, tr._parent, ref)
      return node, reason and ("%s '%s': %s"):format(field, ref, reason)
    elseif is_node(ref) then
      local node, reason = find_mounted(build, tr._parent, ref)
      return node, reason and field .. ": " .. reason
    elseif ref == nil then
      return nil, field .. " is missing, the name of a state or connector expected"
        .. advise("other_word", tr._model, field)
    end
    return nil, field .. ": name of a state or connector expected, " .. got(ref)
  end

  -- Makes the connector `initial` if a transition starts from it and none is declared.
  local function create_initial(build, tr)
    local composite = tr._parent
    if tr.src ~= "initial" or composite._is_leaf
      or is_node(rawget(composite, "initial")) then
      return
    end
    local connector =
      engine.new_node(build, "connector", Connector {}, composite, "initial")
    build.created[#build.created + 1] = {
      line = "created undeclared connector " .. connector._fqn, node = connector,
    }
  end

  -- Returns the node where a transition to `node` ends. If a composite has no initial,
  -- adds a problem and returns nil.
  function engine.find_entrance(build, tr, node)
    local entrance = end_at(tr, node)
    if entrance or node._parent == node then return entrance end -- see `check_root`
    add(build.problems, tr, nil, words("tgt has no initial", node))
  end

  local function resolve_e_done(build, tr)
    local events, src = tr.events, tr.src
    for i = 1, #events do
      if events[i] == "e_done" then
        events[i] = "e_done@" .. src._fqn
        if not rfsm.can_be_done(src) then
          add_warning(build.warnings, false, tr, nil, words("e_done never fires", src))
        end
      end
    end
  end

  -- Returns the target of a transition from `src`, or nil and a reason. For an internal
  -- transition returns `src`, nil and true.
  local function find_target(build, tr, src)
    if tr.tgt ~= "internal" or is_node(rawget(tr._parent, "internal")) then
      return find_end(build, tr, "tgt")
    elseif src and kind_of(src) == "connector" then
      return nil, "tgt 'internal': only a state has internal transitions"
    end
    return src, nil, true
  end

  -- Resolves the ends of a transition. Returns false if one of them is not found.
  local function resolve_transition(build, tr)
    local src, src_reason = find_end(build, tr, "src")
    local tgt, tgt_reason, is_internal = find_target(build, tr, src)
    if not tr._parent._is_leaf then -- a leaf got a warning already
      if src_reason then add(build.problems, tr, nil, src_reason) end
      if tgt_reason then add(build.problems, tr, nil, tgt_reason) end
    end
    if src then build.is_left[src] = true end
    tgt = is_internal and src or tgt and engine.find_entrance(build, tr, tgt)
    if not (src and tgt) then return false end
    tr.src, tr.tgt, tr._is_internal = src, tgt, is_internal
    if tr.always == true then rfsm.check_always(build, tr) end
    resolve_e_done(build, tr)
    return true
  end

  -- Resolves the transitions from number `first` on. Transitions with a wrong reference
  -- are dropped: inside a leaf they give only a warning, and `init` may succeed.
  function engine.resolve(build, first)
    local transitions, kept = build.fsm._transitions, first - 1
    build.is_left = {}
    for i = first, #transitions do create_initial(build, transitions[i]) end
    for i = first, #transitions do
      local tr = transitions[i]
      transitions[i] = nil
      if resolve_transition(build, tr) then
        kept = kept + 1
        transitions[kept] = tr
      elseif rawequal(rawget(tr._parent, tr._id), tr) then
        rawset(tr._parent, tr._id, nil)
      end
    end
  end
end

-- Index: the lists in which an iteration searches --------------------------------
--
-- At init only the outgoing transitions of each node are listed. Candidates, segments
-- and paths are made when they are first needed, so that unused parts take neither time
-- nor memory. No callback is kept in them: each is read when it is called.

-- Is transition `a` of a node tried before `b`? Larger pn first; then the transition
-- whose parent is less deep; then by FQN of the parent; then by position or name.
local function tried_before(a, b)
  local a_pn, b_pn, a_at, b_at = a.pn or 0, b.pn or 0, a._parent, b._parent
  if a_pn ~= b_pn then return a_pn > b_pn end
  if a_at._depth ~= b_at._depth then return a_at._depth < b_at._depth end
  if a_at ~= b_at then return text_before(a_at._fqn, b_at._fqn) end
  return key_before(a._id, b._id)
end

-- Gives each node the list of its outgoing transitions, in search order.
function engine.list_otrs(fsm)
  local nodes, transitions = fsm._nodes, fsm._transitions
  for i = 1, #nodes do nodes[i]._otrs = {} end
  for i = 1, #transitions do
    local tr = transitions[i]
    local otrs, events = tr.src._otrs, tr.events
    otrs[#otrs + 1] = tr
    if tr.always == true then -- its file is loaded here: a preproc may have set it
      local load = rfsm.check_always
      if not engine.PHASES.always then load() end -- it says that the file is missing
      fsm._has_always, fsm._is_usual = true, false
    end
    for j = 1, #events do
      if type(events[j]) == "function" then tr._is_asked = true end
    end
  end
  for i = 1, #nodes do
    if nodes[i]._otrs[2] then sort(nodes[i]._otrs, tried_before) end
  end
end

-- Returns the event that tells that a leaf is done. It is made when it is needed
-- first.
local function done_event(leaf)
  leaf._done_event = leaf._done_event or "e_done@" .. leaf._fqn
  return leaf._done_event
end

-- Drops the candidates and paths of a machine.
function engine.drop_paths(fsm)
  -- the path of the first entry begins here; for a root without states it ends here
  fsm._entrance, fsm._has_paths = { from = fsm, entered = fsm }, false
  for _, node in ipairs(fsm._nodes) do
    node._choices, node._paths, node._ignored, node._always = nil, nil, nil, nil
  end
end

-- Drops all that was made of the structure while the machine ran.
function engine.forget(fsm)
  fsm._merges, fsm._structure, fsm._segments = fsm._merges + 1, false, NONE
  engine.drop_paths(fsm)
end

-- Returns an rfsm.Segment: a transition with the target that it has now.
local function new_segment(tr, tgt)
  local is_internal = tr._is_internal and tr.src == tgt
  local lca = is_internal and tgt or engine.find_lca(tr.src._parent, tgt._parent)
  local segment = { tr = tr, tgt = tgt, lca = lca }
  if is_internal then segment.is_internal = true end -- absent: less memory
  if not tgt._mode then segment.connector = tgt end
  return segment
end

-- Returns the segment of a transition whose target a program may have changed. Each
-- is made once, and is found by its target in the first one, which the machine keeps.
-- Returns nil if the target is no node of the machine.
function engine.segment_of(fsm, tr)
  local tgt, first = tr.tgt, fsm._segments[tr]
  if first and first[tgt] then return first[tgt] end
  if not is_node_of(fsm, tgt) then
    rfsm.report(fsm, "err", "ERROR: tgt of " .. text_of(tr.src._fqn or tr.src)
      .. ": node of the fsm expected, " .. got(tgt))
    return nil
  end
  local to = end_at(tr, tgt)
  if not to then return nil end
  local segment = new_segment(tr, to)
  first = first or segment
  first[tgt] = segment
  if fsm._segments == NONE then fsm._segments = {} end
  fsm._segments[tr] = first
  return segment
end

-- Machine: the root of the tree, with the fields of the engine ----------------------

local function silent() end

local function no_events() return {} end

-- Fields that a machine inherits until it sets them.
local DEFAULTS = {
  rfsm = "state", type = State.type, new = State.new, _id = "root", _fqn = "root",
  _choices = NONE, _given_at = 0, _segments = NONE, -- transition -> target -> Segment
  dbg = silent, getevents = no_events, _merges = 0,
  _cuts = 0, -- number of iterations that an error has ended, and of such resets
}

-- Returns the function `emit` of a machine, which callbacks call.
function engine.new_emit(f)
  return function(name, data)
    if type(name) ~= "string" then
      error("emit: name expected, got " .. (is_state(name)
        and "state (call it with a dot: fsm.emit)" or type(name)), 2)
    end
    f(name, data)
  end
end

DEFAULTS.emit = engine.new_emit(silent)

-- The fields that a machine has from the start.
local function own_fields()
  return {
    _parent = false, _mode = "inactive", _otrs = NONE, _act_leaf = false,
    _intq = { "e_init_fsm" }, _curq = {}, _initialized = false,
    -- the structure
    _model = false, _nodes = false, _transitions = {}, _index = 1, _depth = 0,
    _is_leaf = true,
    -- the iteration, see "Run":
    --   _path       the path being taken, or the last one since `took_path` was called
    --   _event      the event that counts for the segment being taken
    --   _ways       connector -> what the last search found there, see `note_of`
    --   _search     number of the current search
    --   _at         number of the action (or part of a doo cycle) that was begun last
    --   _hook       number of the step hook begun last
    --   _turn       number of the iteration, if the machine has step hooks
    --   _unread     events that are taken one by one before getevents is asked again
    --   _given      events that getevents has returned and that are in no list yet
    --   _given_to   the queue that has had them appended
    --   _given_at   the number of current events before them
    --   _outcome    of the last iteration: counted (as a step) | idle | free (events
    --               enabled no path: not counted) | refused (entry or step hook failed)
    --   _is_usual   false after an interrupt, error or reset: `iterate` calls `go_on`
    --   _is_lent    true if a callback may have kept the list of current events
    --   _is_cut     true if an error ended the iteration; the next step completes it
    --   _is_hooked  true if the machine has step hooks or getevents
    _phase = "idle", _path = false, _ways = {}, _search = 0,
    _outcome = "free", _at = 0, _hook = 0, _is_usual = false, _is_cut = false,
    _given = false, _is_lent = false, _is_hooked = false, _turn = 0,
    _before = false, _after = false, _lends = false, _unread = 0, _reads_one = false,
    _pre_hooks = DEFAULTS._pre_hooks, _post_hooks = DEFAULTS._post_hooks,
  }
end

-- What functions promise, by `rfsm.borrows` or `rfsm.repeatable`: the name of that
-- function.
local promises = setmetatable({}, { __mode = "k" })

-- All machines, so that one access shows whether a value is a machine.
local machines = setmetatable({}, { __mode = "k" })

Machine.__index = DEFAULTS

-- Report: messages to the printers of a machine, and errors that are kept ----------

local DEFAULT_PRINTER, printer_of

do
  -- Prints values, separated by tabs, to the stream io[stream]. If there is no such
  -- stream, prints them with the current `print`.
  local function print_line(stream, ...)
    local texts = {}
    for i = 1, select("#", ...) do texts[i] = text_of((select(i, ...))) end
    local line, file = concat(texts, "\t"), stream and find_global("io", stream)
    if file then file:write(line, "\n") else (find_global "print" or text_of)(line) end
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

function engine.raise_failure(fsm)
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
  local printer = printer_of(fsm, name)
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

local function trace(fsm, id, text, ...)
  if is_traced(fsm) then report(fsm, "dbg", id, text:format(...)) end
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

function engine.tell_watch(fsm, what, ...)
  if fsm._watch_hooks then return tell(fsm, fsm._watch_hooks[what], ...) end
end

-- Calls the watch hooks of a kind, of which `count` others are before them, and notes
-- them in `failed.told` as `run_hooks` does. Returns how many are behind.
local function tell_part(fsm, what, failed, count, ...)
  for _, hook in ipairs(fsm._watch_hooks and fsm._watch_hooks[what] or NONE) do
    local is_repeatable = promises[hook] == "repeatable"
    count = count + 1
    if count > failed.told then
      if not is_repeatable then failed.told = count end
      local ok, failure = pcall(hook, fsm, ...)
      if not ok and is_repeatable then error(failure, 0) end
      if not ok then keep_failure(fsm, failure) end
      failed.told = count
    end
  end
  return count
end

-- Tells of the failure in the field `_failed`: the watch hooks first, then `err`. After
-- an interrupt the next step goes on behind what was begun.
local function tell_failure(fsm)
  local failed, around = fsm._failed, fsm
  local owner, name = failed.owner, failed.name
  local failure, callback = failed.failure, failed.callback
  if rfsm.is_interrupt(failure) then
    keep_failure(fsm, failure)
    fsm._failed = false
    return
  end
  if callback ~= nil and not is_callable(callback) then
    failure = "function expected, " .. got(callback)
  end
  local count = tell_part(fsm, "failed", failed, 0, owner, name, failure)
  while around do
    count = tell_part(around, "failed_inside", failed, count, fsm, owner, name, failure,
      callback)
    around = around._owner
  end
  local text = "error executing " .. name .. " of " .. (owner._fqn or tostring(owner))
  if name == "doo" then text = "doo program of state '" .. owner._fqn .. "' failed" end
  local id = name:gsub("i", "I"):upper() -- Turkish has another capital i
  fsm._failed = false
  report(fsm, "err", id, text .. ": ", failure)
end

-- Reports that a callback has failed. For a doo `callback` is nil, because the doo was
-- called by its coroutine; for a guard it is nil if a guard hook has failed.
local function report_callback(fsm, name, owner, callback, failure)
  fsm._failed = { owner = owner, name = name, failure = failure, callback = callback,
    told = 0 }
  tell_failure(fsm)
end

-- Run: one iteration after the other ----------------------------------------------
--
-- Between two iterations exactly one leaf is active, or none before the first entry.
-- `_phase` is one of these:
--
--   idle     nothing: the machine waits for its caller
--   always   a path is searched that needs no event, see rfsm/always.lua
--   begin    the pending events become the current events
--   gather   getevents adds its events, and the pre step hooks are called
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

-- Functions of rfsm/fast.lua, which turn paths into functions. `path.run` takes a path
-- after a search. `choice.run` takes the only path that an event may enable, or returns
-- false if a guard or a changed target requires a search.
local fast = { compile = silent, compiled = silent, quick_run = silent }

local conclude, iterate, path_of, perform
local PHASES, search = {}, nil

-- Gather ..........................................................................

-- Makes the current events pending again, ahead of the queue. The phase becomes idle
-- first: then `PHASES.begin` finds the events in either list after an interrupt here.
local function put_back(fsm)
  local queue = append(append({}, fsm._curq), fsm._intq)
  queue.rest_of = fsm._curq
  fsm._outcome = "refused"
  fsm._phase = "idle"
  fsm._intq = queue
  fsm._curq = {}
  queue.rest_of = nil
end

-- Ends an iteration early, because a pre step hook or getevents has failed. The current
-- events become pending again before the search, but are dropped after it. If a post
-- step hook has failed, the other hooks are called first.
local function give_up(fsm, failure)
  if fsm._phase == "finish" then return keep_failure(fsm, failure) end
  put_back(fsm)
  error(failure, 0)
end

-- Returns the events of getevents that an error has kept out of a list. If they have
-- metamethods, which fail again, drops them and returns nil and the error.
local function given_again(fsm)
  if getmetatable(fsm._given) == nil then return fsm._given end
  local ok, list = pcall(append, {}, fsm._given)
  fsm._given = ok and list
  return fsm._given or nil, list
end

-- Calls getevents. Returns its list of events and nils; on failure nil and an error.
-- The list is kept in `_given` until its events are in another list, so that no
-- interrupt loses them.
function engine.ask_getevents(fsm)
  local getevents = fsm.getevents
  if fsm._given then return given_again(fsm) end
  if not getevents or getevents == no_events then return NONE end
  fsm._given_to = false
  fsm._given_at = #fsm._curq
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

-- Makes the events of getevents pending. A longer list replaces the queue, and is
-- noted, so that after an interrupt they are not appended again.
function engine.queue_given(fsm, events)
  local queue = fsm._intq
  if #events > 0 and queue ~= fsm._given_to then
    fsm._given_to = append(append({}, queue), events)
    fsm._intq = fsm._given_to
  end
  fsm._given = false
end

-- Makes the events of getevents current. No list is made for them: nobody else adds to
-- the current events meanwhile, so after an interrupt they are written to the same
-- places again.
local function take_given(fsm, events)
  local list, at = fsm._curq, fsm._given_at
  for i = 1, #events do
    if events[i] ~= nil then
      at = at + 1
      list[at] = events[i]
    end
  end
  fsm._given = false
end

local function append_getevents(fsm, put)
  local events, failure = engine.ask_getevents(fsm)
  if not events then give_up(fsm, failure) end
  put(fsm, events)
end

-- Does an iteration take only the first pending event? The root's field `read` decides,
-- or in a region that of the parent machine; any value but these two is a user's data.
local function reads_one(fsm)
  local read = fsm.read
  if read == "one" or read == "all" then return read == "one" end
  return fsm._owner and reads_one(fsm._owner) or false
end

-- Makes all current events but the first one pending again, ahead of the queue. The new
-- queue says from which list they are, in case an interrupt comes before the other one.
local function take_one(fsm)
  local events, queue = fsm._curq, {}
  if reads_one(fsm) ~= fsm._reads_one then engine.list_again(fsm) end -- written since
  if events[2] == nil or not fsm._reads_one then return end
  if fsm._intq.rest_of ~= events then
    for i = 2, #events do queue[i - 1] = events[i] end
    queue.rest_of = events
    fsm._intq = append(queue, fsm._intq)
  end
  fsm._curq = { events[1] }
  fsm._intq.rest_of = nil
end

-- Ends an iteration in which a step hook has failed. A hook that may be repeated fails
-- only by an interrupt: then the next step calls it again.
local function fail_hook(fsm, hook, failure)
  if promises[hook] == "repeatable" then error(failure, 0) end
  give_up(fsm, failure)
end

local run_hooks

do
  -- Returns the hook that a program has set in a field of the machine, at any time.
  local function own_hook(fsm, slot)
    local hook = fsm[slot]
    if hook and not promises[hook] then fsm._is_lent = true end
    if not hook or is_callable(hook) then return hook end
    give_up(fsm, ("rfsm.step: %s: function expected, %s"):format(slot, got(hook)))
  end

  local function take_getevents(fsm)
    if fsm._unread > 1 then
      fsm._unread = fsm._unread - 1
      return
    end
    local count = #fsm._curq
    append_getevents(fsm, take_given)
    if fsm._reads_one then fsm._unread = #fsm._curq > count and #fsm._curq or 0 end
  end

  -- Fields of a machine whose names are in lists of hooks. The function does what the
  -- field decides, or returns the user's hook, which is called then.
  local FIELDS = { pre_step_hook = own_hook, post_step_hook = own_hook,
    getevents = take_getevents, read = take_one }
  DEFAULTS._pre_hooks, DEFAULTS._post_hooks = { "pre_step_hook" }, { "post_step_hook" }
  promises.read = "repeatable"

  -- Is called for an assignment to one of these fields while it is absent.
  function Machine.__newindex(fsm, key, value)
    local is_hook = FIELDS[key] and key ~= "read"
    if is_hook and not value then return end -- false would be a value
    if is_hook and not is_callable(value) then
      error(key .. ": function expected, " .. got(value), 2)
    end
    rawset(fsm, key, value)
    if FIELDS[key] then engine.list_again(fsm) end
  end

  -- Calls the step hooks of a list from number `i` on. A hook that may be repeated is
  -- noted when it has returned, any other hook when it begins. This is no loop: LuaJIT
  -- would give up a host's loop around a loop that mostly turns once.
  function run_hooks(fsm, hooks, i)
    local hook = hooks[i]
    if promises[hook] ~= "repeatable" then fsm._hook = i end
    if FIELDS[hook] then hook = FIELDS[hook](fsm, hook) end
    if hook then
      local ok, failure = pcall(hook, fsm, fsm._curq)
      if not ok then fail_hook(fsm, hook, failure) end
    end
    fsm._hook = i
    if hooks[i + 1] then return run_hooks(fsm, hooks, i + 1) end
  end

  -- Returns the hooks that are called now: a field that is not set has none.
  local function present(fsm, hooks)
    local list = {}
    for _, hook in ipairs(hooks) do
      if not FIELDS[hook] or fsm[hook] then list[#list + 1] = hook end
    end
    return list
  end

  -- Returns a list of hooks, false if it is empty. `one` is the first hook, unless it
  -- is a field; `noted` is the position to note before this hook is called.
  local function finished(fsm, list)
    local one = list[1]
    if not one then return false end
    for _, hook in ipairs(list) do
      fsm._lends = fsm._lends or not (promises[hook] or FIELDS[hook])
    end
    list.one = not FIELDS[one] and one
    list.noted = list.one and promises[one] ~= "repeatable" and 1 or 0
    list.has_getevents = one == "getevents"
    return list
  end

  -- Makes fields with false absent, so that `__newindex` is called when they are set.
  local function empty_slots(fsm)
    for _, slot in ipairs(HOOKS) do
      if rawget(fsm, slot) == false then rawset(fsm, slot, nil) end
    end
  end

  -- Makes the lists of what each iteration calls, `_before` and `_after`; false if they
  -- are empty. If one event is taken, all events that come are added before. A field
  -- `read` that is there is written unseen, so it stands in the list. `_lends` is true
  -- if a hook may keep the list of events.
  function engine.list_hooks(fsm)
    empty_slots(fsm)
    local is_one, sources = reads_one(fsm), fsm._source_hooks or NONE
    fsm._reads_one = is_one
    local before = present(fsm, fsm._pre_hooks)
    local at = is_one and 0 or fsm._pre_hooks.front or 0
    for i, source in ipairs(sources) do insert(before, at + i, source) end
    if is_one or fsm.read ~= nil then insert(before, #sources + 1, "read") end
    local has_getevents = fsm.getevents and fsm.getevents ~= no_events
    if has_getevents then insert(before, 1, "getevents") end
    fsm._is_usual, fsm._lends = false, false
    fsm._before = finished(fsm, before)
    fsm._after = finished(fsm, present(fsm, fsm._post_hooks))
    fsm._is_hooked = not not (fsm._before or fsm._after)
    fsm._is_lent = fsm._is_lent or fsm._lends
  end
end

-- Lists the hooks of a machine and its regions anew: they read as their parent does.
function engine.list_again(fsm)
  engine.list_hooks(fsm)
  for _, state in ipairs(rfsm.elements(fsm, is_state)) do
    for _, region in ipairs(rfsm.regions(state)) do engine.list_again(region) end
  end
end

-- Resets a machine as if it were new, but keeps the events of the current iteration.
function engine.reset_now(fsm)
  for _, node in ipairs(fsm._nodes) do
    if node._mode then
      node._mode, node._doo_co = "inactive", nil
      rawset(node, "_actchild", nil)
    end
  end
  fsm._act_leaf, fsm._unread = false, 0
  fsm._intq = { "e_init_fsm" }
  local kept = fsm._failure
  tell(fsm, fsm._reset_hooks)
  if fsm._failure ~= kept then fsm._cuts = fsm._cuts + 1 end -- a hook may not know
  fsm._reset_wanted = false
end

-- The phase "begin": makes the pending events current. It swaps the queue `_intq` with
-- `_curq`, an empty list. After an interrupt both fields may have the same list, or
-- `_curq` may have events, which come first.
function PHASES.begin(fsm, after_free)
  if fsm._reset_wanted then
    fsm._curq = {}
    engine.reset_now(fsm)
  end
  local queue, spare = fsm._intq, fsm._curq
  if rawequal(queue, spare) or queue.rest_of == spare then
    spare = {}
  elseif spare.rest_of == queue then
    queue, spare = spare, {}
  elseif spare[1] ~= nil then
    local all = append(append({}, spare), queue)
    all.rest_of = queue
    queue, spare = all, {}
  end
  fsm._curq = queue
  fsm._intq = spare
  if queue.rest_of then queue.rest_of = nil end
  fsm._hook = 0
  fsm._phase = "gather"
  return PHASES.gather(fsm, after_free)
end

-- The phase "gather": calls getevents and the pre step hooks.
function PHASES.gather(fsm, after_free)
  if fsm._given then append_getevents(fsm, take_given) end
  local hooks, next_one = fsm._before, fsm._hook + 1
  if hooks and hooks[next_one] then run_hooks(fsm, hooks, next_one) end
  fsm._phase = "search"
  return search(fsm, after_free)
end

-- Search: the path that the events enable .........................................
--
-- A search that was cut short is done again: guards must not have side effects.

-- Do `events` trigger the transition? Also returns the first event that does; nil for a
-- transition without events, which is always triggered.
local function matches(tr, events)
  local wanted = tr.events
  if not wanted or wanted[1] == nil then return true, nil end
  for i = 1, #events do
    local event = events[i]
    for j = 1, #wanted do
      if rawequal(wanted[j], event) then return true, event end
      if type(wanted[j]) == "function" then
        local ok, answer = pcall(wanted[j], event)
        if not ok and rfsm.is_interrupt(answer) then error(answer, 0) end
        if ok and answer then return true, event end
      end
    end
  end
  return false, nil
end

local enabled, first_enabled

do
  -- Reports that a guard has failed, and returns false as its result. After an
  -- interrupt the next step calls the guard again.
  local function refuse_guard(fsm, tr, guard, failure)
    if rfsm.is_interrupt(failure) then error(failure, 0) end
    report_callback(fsm, "guard", tr, guard, failure)
    return false
  end

  -- Does a guard hook of an extension forbid the transition?
  local function is_forbidden(fsm, tr, events, event)
    for _, hook in ipairs(fsm._guard_hooks[tr] or NONE) do
      if not promises[hook] then fsm._is_lent = true end
      local ok, answer = pcall(hook, tr, events, event)
      if not ok then answer = refuse_guard(fsm, tr, nil, answer) end
      if answer == false then return true end
    end
    return false
  end

  -- Returns the note of a machine about a connector. `search` is the number of the last
  -- search that reached it (the current one is `fsm._search`), `first` the event of the
  -- path's first segment then. `way` is the segment with which the path continues,
  -- false if none was found; `event` is the event that counts for it.
  function engine.note_of(fsm, connector)
    local note = fsm._ways[connector] or { search = 0, first = false, asked = false,
      way = false, event = false, others = false, connector = connector }
    fsm._ways[connector] = note
    return note
  end

  local function is_same(a, b) return rawequal(a, b) or a ~= a and b ~= b end -- NaN

  -- Turns a note to `first` in the same search. Returns true if the connector was asked
  -- for that event before. The search goes on only where no event had a way out.
  local function turn_to(note, first)
    if is_same(note.first, first) then return true end
    local asked = note.asked or {}
    asked[#asked + 1] = note.first
    note.first, note.asked = first, asked
    for i = 1, #asked do
      if is_same(asked[i], first) then return true end
    end
    return false
  end

  local function warn_of_conflict(fsm, ways)
    report(fsm, "warn", "conflicting transitions from src " .. ways[1].tr.src._fqn
      .. " to")
    for _, segment in ipairs(ways) do report(fsm, "warn", "\t" .. segment.tgt._fqn) end
  end

  -- Finds the way out of a connector: its first transition, from number `i` on, that is
  -- enabled and leads to a leaf. Others of the same priority are tried, too, to warn of
  -- a conflict. No loop, as in `run_hooks`. It and `enabled` have few variables: a path
  -- may go over thousands of connectors.
  local function find_way(fsm, note, way, i, events, first) -- luacheck: ignore 561
    local tr = note.connector._otrs[i]
    if not tr or way and (tr.pn or 0) ~= (way.tr.pn or 0) then
      if note.others then
        warn_of_conflict(fsm, note.others)
        note.others = false
      end
      note.way = way
      return
    end
    local is_triggered, event = true, first
    if tr.events[1] ~= nil then is_triggered, event = matches(tr, events) end
    local segment = is_triggered and enabled(fsm, tr, events, event, first)
    if segment and way then
      note.others = append(note.others or { way }, { segment })
    elseif segment then
      way, note.event = segment, event
    end
    return find_way(fsm, note, way, i + 1, events, first)
  end

  -- Returns the segment of a transition that `event` triggers, if its guard and the
  -- guard hooks allow it, and it leads to a leaf or to a connector with a way out.
  -- Otherwise returns nil. A connector is asked once in a search for each `first`.
  -- Meanwhile `note.way` is false, so that cycles of connectors end.
  function enabled(fsm, tr, events, event, first)
    do
      local guard = tr.guard
      if fsm._guard_hooks and is_forbidden(fsm, tr, events, event) then return nil end
      if guard then
        if not promises[guard] then fsm._is_lent = true end
        local ok, answer = pcall(guard, tr, events, event)
        if not ok then answer = refuse_guard(fsm, tr, guard, answer) end
        if answer == false then return nil end
      end
    end
    local segment = fsm._segments[tr]
    segment = segment and segment[tr.tgt] or engine.segment_of(fsm, tr)
    local note = segment and segment.connector
    if not note then return segment end
    note = fsm._ways[note] or engine.note_of(fsm, note)
    local current = fsm._search
    if note.search ~= current then
      note.search = current -- one by one: fewer instructions
      note.first = first
      note.asked = false
      note.way = false
      note.others = false
      find_way(fsm, note, false, 1, events, first)
    elseif not turn_to(note, first) then
      find_way(fsm, note, false, 1, events, first)
    end
    return note.way and segment or nil
  end

  -- Returns the segment of the first enabled transition of a list, from number `i` on,
  -- and the event that counts; nil if none is enabled. `event` is known to trigger
  -- those that call no predicate; nil: nothing is known.
  function first_enabled(fsm, list, i, events, event)
    local tr = list[i]
    if not tr then return nil end
    local is_triggered, own = true, event
    if event == nil or tr._is_asked then
      is_triggered, own = matches(tr, events)
      if own == nil then own = events[1] end
    end
    local found = is_triggered and enabled(fsm, tr, events, own, own)
    if found then return found, own end
    return first_enabled(fsm, list, i + 1, events, event)
  end
end

local choice_of, choose

-- Lists the transitions from a node that need no event, or the others.
function engine.list_otrs_of(node, are_always)
  local list = {}
  for _, tr in ipairs(node._otrs) do
    if (tr.always == true) == are_always then list[#list + 1] = tr end
  end
  return list
end

do
  -- Returns the first enabled segment, in the states from the root down to the leaf.
  local function choose_by_node(fsm, leaf, events)
    local traces = is_traced(fsm)
    if traces then
      report(fsm, "dbg", "TRANSITION",
        "searching transitions for events: " .. list_text(events))
    end
    for i, node in ipairs(line_to(leaf)) do
      if traces then
        report(fsm, "dbg", "CHECKING", "depth:", i - 1,
          "for transitions from " .. node._fqn)
      end
      local merges = fsm._merges
      local otrs = fsm._has_always and engine.list_otrs_of(node, false) or node._otrs
      local found, event = first_enabled(fsm, otrs, 1, events)
      if found or fsm._merges ~= merges then return found, event end
    end
    if traces then report(fsm, "dbg", "TRANSITION", "no enabled paths found") end
  end

  local OTHER = {} -- the key for all events that no transition names
  local NO_CHOICE = { run = false }

  -- Makes `leaf._choices`: for each event the list of candidates, which are the
  -- transitions that it may trigger while the leaf is active, in search order.
  -- `leaf._ignored` is the leaf's e_done if no transition reacts to it. Otherwise it is
  -- NaN, which equals no event.
  function engine.list_choices(leaf)
    local choices, other, own = {}, {}, leaf._otrs
    local lists = { other }
    if own.run then own.run = nil end -- nil for a new key takes memory
    local function add_to(list, tr)
      if list[#list] ~= tr then list[#list + 1] = tr end
    end
    local function add_to_events(tr)
      for _, event in ipairs(tr.events) do
        -- the only transition of the leaf needs no second list of it
        local is_own = tr.src == leaf and not (own[2] or other[1])
        local list = choices[event] or is_own and own or append({}, other)
        if not choices[event] then choices[event], lists[#lists + 1] = list, list end
        add_to(list, tr)
      end
    end
    for _, node in ipairs(line_to(leaf)) do
      for _, tr in ipairs(engine.list_otrs_of(node, false)) do
        local is_for_all = tr.events[1] == nil or tr._is_asked
        if not is_for_all then add_to_events(tr) end
        for _, list in ipairs(is_for_all and lists or NONE) do add_to(list, tr) end
      end
    end
    if other[1] then choices[OTHER] = other end -- absent: less memory
    leaf._choices = choices
    leaf._ignored = choice_of(leaf, done_event(leaf))[1] and 0 / 0 or leaf._done_event
    return choices
  end

  function choice_of(leaf, event)
    local choices = leaf._choices ~= NONE and leaf._choices or engine.list_choices(leaf)
    return choices[event] or choices[OTHER] or NO_CHOICE
  end

  -- Returns the candidates for `events`, and the first event that has them; nil if two
  -- events have different candidates.
  local function candidates_of(leaf, events)
    local common, first = NONE, nil
    for i = 1, #events do
      local event = events[i]
      local list = event ~= leaf._ignored and choice_of(leaf, event) or NONE
      if list[1] and list ~= common then
        if common ~= NONE then return nil end
        common, first = list, event
      end
    end
    return common, first
  end

  -- Returns the segment that the events enable, and the event that counts; or nil. If
  -- `candidates` are given, which `event` has, no other transitions are tried. If a
  -- guard calls `fsm_merge`, the search is repeated once.
  function choose(fsm, leaf, events, candidates, event, is_again)
    local merges, found = fsm._merges
    if not candidates then
      if events[1] == nil then return nil end
      if not is_traced(fsm) then candidates, event = candidates_of(leaf, events) end
    end
    fsm._search = fsm._search + 1
    if candidates then
      found, event = first_enabled(fsm, candidates, 1, events, event)
    else
      found, event = choose_by_node(fsm, leaf, events)
    end
    if fsm._merges == merges then return found, event end
    if is_again then return nil end
    return choose(fsm, leaf, events, nil, nil, true)
  end
end

-- Returns the innermost active state.
local function innermost(fsm)
  local state = fsm
  while state._actchild do state = state._actchild end
  return state
end

local follow

do
  -- Warns of events that are lost: they were sent before the first entry, the entry
  -- consumes them, and no transition of its path names them.
  local function warn_of_lost_events(fsm, path, events)
    if rfsm.is_strict(fsm) then return end -- rfsm/strict.lua has warned already
    local lost, segments = {}, engine.segments_of(path)
    for i = 1, #events do
      local is_named = rawequal(events[i], "e_init_fsm")
      for _, segment in ipairs(segments) do
        is_named = is_named or segment.tr.events[1] ~= nil
          and matches(segment.tr, { events[i] })
      end
      if not is_named then lost[#lost + 1] = events[i] end
    end
    if lost[1] == nil then return end
    report(fsm, "warn", "WARNING: sent before the machine was entered, which consumes "
      .. "them: " .. list_text(lost))
  end

  -- Returns the first entry's path, from the root's `initial`; nil if none is enabled.
  local function find_entry(fsm, events)
    local found, event = nil, events[1]
    fsm._search = fsm._search + 1
    if not fsm._is_leaf then
      found, event = first_enabled(fsm, rawget(fsm, "initial")._otrs, 1, events)
      if not found then return nil end
    end
    local path = path_of(fsm, fsm._entrance, found, fsm._ways)
    warn_of_lost_events(fsm, path, events)
    return path, event
  end

  -- Takes a path. `leaf` is the active leaf, or nil at the first entry; `event` is the
  -- event that counts for the first segment.
  local function take_path(fsm, leaf, path, event)
    local run = leaf and fsm.dbg == silent and (path.run or fast.compiled(path))
    fsm._at = 0
    if run then
      run(fsm, event, true)
    else
      fsm._path = path
      fsm._event = event
      fsm._phase = "take"
      perform(fsm)
    end
    return conclude(fsm, "counted")
  end

  -- Continues after a search from a leaf: takes the path that begins with the segment
  -- found. If none was found, runs the doo or ends the iteration.
  function follow(fsm, after_free, leaf, found, event)
    if fsm._act_leaf ~= leaf then -- a guard has moved the machine
      leaf = innermost(fsm)
      if found and found.lca._mode == "inactive" then found = nil end
    end
    if found then
      return take_path(fsm, leaf, path_of(fsm, leaf, found, fsm._ways), event)
    elseif fsm._curq[1] == nil or after_free then
      fsm._at = 0
      fsm._phase = "doo"
      return PHASES.doo(fsm)
    end
    return conclude(fsm, "free")
  end

  -- The phase "search". `choice` is the list of the candidates of `event`, or nil if it
  -- is not known.
  function search(fsm, after_free, choice, event)
    local leaf, events = fsm._act_leaf, fsm._curq
    if leaf then
      return follow(fsm, after_free, leaf, choose(fsm, leaf, events, choice, event))
    end
    local path, first = find_entry(fsm, events)
    if path then return take_path(fsm, nil, path, first) end
    report(fsm, "err", "ERROR: cannot enter: no enabled path from 'root.initial' on "
      .. "events: " .. list_text(events))
    put_back(fsm)
    if fsm._reset_wanted then engine.reset_now(fsm) end
    fsm._is_usual = not fsm._has_always
    engine.raise_failure(fsm)
  end
end

-- Take: the actions of a path .....................................................
--
-- A path has a flat list of actions, which are functions f(fsm, arg, at). `at` is the
-- position of the action, and of `arg` in the path itself, such as a state.

local actions = {}

-- Actions that report a record of the trace to `dbg`, by kind of record.
local recorders = {}

function engine.may_repeat(hook) return promises[hook] == "repeatable" end

-- Calls a hook of an extension. One that may be repeated is noted when it has returned.
local function call_hook(fsm, hook, subject, at)
  local is_repeatable = promises[hook] == "repeatable"
  if not is_repeatable then fsm._at = at end
  local ok, failure = pcall(hook, fsm, subject, fsm._event)
  if not ok then
    if is_repeatable then error(failure, 0) end
    keep_failure(fsm, failure)
  end
  fsm._at = at
end

-- Calls a path hook with the list of the transitions that are about to be taken. The
-- list is empty at the entry of a root without states.
function actions.path_hook(fsm, arg, at)
  local list = {}
  for i, segment in ipairs(engine.segments_of(arg.path)) do list[i] = segment.tr end
  call_hook(fsm, arg.hook, list, at)
end

local function run_callback(fsm, owner, name, at, ...)
  local callback = owner[name]
  if not callback then return end
  fsm._at = at
  local ok, failure = pcall(callback, fsm, owner, name, ...)
  if not ok then report_callback(fsm, name, owner, callback, failure) end
end

function actions.effect(fsm, segment, at)
  local tr = segment.tr
  if tr.effect and not promises[tr.effect] then fsm._is_lent = true end
  run_callback(fsm, tr, "effect", at, fsm._curq, fsm._event)
end

-- Begins a segment that is not the first one of its path.
function actions.go_through(fsm, connector)
  fsm._event = fsm._ways[connector].event
end

local function leave(fsm, state, at, event)
  state._mode = "inactive"
  state._parent._actchild = nil
  run_callback(fsm, state, "exit", at, event)
end

function actions.exit(fsm, state, at) leave(fsm, state, at, fsm._event) end

function actions.be_left(fsm, state)
  if fsm._act_leaf == state then fsm._act_leaf = false end
  if state._doo_co then state._doo_co = nil end
end

function actions.become_active(_, state)
  state._mode = "active"
  if state._depth > 0 then state._parent._actchild = state end
end

function actions.entry(fsm, state, at)
  run_callback(fsm, state, "entry", at, fsm._event)
end

-- Queues the e_done of a leaf, which is done after that. If an interrupt came at this
-- position, the event may be the last one of the queue already.
local function queue_done(fsm, leaf, at)
  local queue, event = fsm._intq, done_event(leaf)
  if fsm._at == at and rawequal(queue[#queue], event) then return end
  fsm._at = at
  queue[#queue + 1] = event
end

-- A leaf without doo is done at once.
function actions.be_done(fsm, leaf, at)
  if leaf.doo then return end
  queue_done(fsm, leaf, at)
  leaf._mode = "done"
end

-- Right after `queue_done`: queues the e_done of the composite around the leaf, if the
-- leaf is final and a transition of the composite waits for it. After an interrupt it
-- may be the last event of the queue already.
local function complete_around(fsm, leaf, at)
  local queue, around = fsm._intq, leaf._parent
  local is_last = rawequal(leaf.final, true) and around ~= leaf
  if not (is_last and rfsm.names_done(around)) then return end
  local event = done_event(around)
  if not rawequal(queue[#queue], event) then queue[#queue + 1] = event end
  recorders.done(fsm, around, at)
end

function actions.be_done_around(fsm, leaf, at)
  fsm._at = at
  if leaf._mode == "done" then complete_around(fsm, leaf, at) end
end

-- Has the machine, or an extension, made the event?
function engine.is_made(event)
  event = name_with_data(event) or event
  if type(event) ~= "string" then return false end
  if event == "e_init_fsm" or event:find("^e_done@root") then return true end
  for _, maker in ipairs(rfsm.makers) do
    if maker(event) then return true end
  end
  return false
end

-- May one of some candidates take an event that the machine has made? Predicates of a
-- program are not called.
local function may_be_taken(candidates, event)
  for i = 1, #candidates do
    local tr = candidates[i]
    if not tr._is_asked then return true end -- it names the event, or needs no name
    for _, other in ipairs(tr.events) do
      local may_accept = type(other) == "function"
        and (not rfsm.event_name(other) or other(event))
      if may_accept or rawequal(other, event) then return true end
    end
  end
  return false
end

-- Puts events ahead of the queue; twice in an iteration is as good as once.
local function put_in_front(fsm, made)
  local again = fsm._again -- for extensions
  if not again or again.of ~= fsm._curq then
    fsm._is_lent = true -- no other iteration gets this list
    again = { turn = fsm._turn, count = #made, of = fsm._curq, before = fsm._intq }
    fsm._again = again
  end
  -- after an interrupt they may be there already
  if fsm._intq == again.before then fsm._intq = append(made, fsm._intq) end
end

-- Makes events pending again, ahead of the queue, that the machine itself has made,
-- such as the event of a timer, if an internal transition was taken that does not name
-- them: nothing was left, so they would never come again.
function actions.keep_made(fsm, segment)
  local tr, leaf, made = segment.tr, fsm._act_leaf, {}
  for _, event in ipairs(leaf and tr.events[1] ~= nil and fsm._curq or NONE) do
    if event ~= "e_init_fsm" and engine.is_made(event)
      and may_be_taken(choice_of(leaf, event), event)
      and not matches(tr, { event }) then
      made[#made + 1] = event
    end
  end
  if made[1] then put_in_front(fsm, made) end
end

local function label_of(node)
  if not node._mode then return node._fqn .. "[c]" end
  return node._fqn .. (node._is_leaf and "[LS]" or "[CS]")
end

-- Makers of trace records, by kind. Each returns the record's id, then its texts.
local RECORDS = {}

-- Example, with [LS] for a leaf, [CS] for a composite and [c] for a connector:
-- root.a[LS]->root.k[c]->root.b[LS]
function RECORDS.path(path)
  local segments = engine.segments_of(path)
  local text = label_of(segments[1].tr.src)
  for _, segment in ipairs(segments) do
    text = text .. "->" .. label_of(segment.tgt)
  end
  return "EXEC_PATH", text
end

function RECORDS.exits(segment)
  local src, lca = segment.tr.src, segment.lca
  local outermost = line_to(src)[lca._depth + 2] or src -- for the root
  return "TRANS_EXIT", "exiting all up to (including):", outermost._fqn, ", lca:",
    lca._fqn
end

function RECORDS.exit(state) return "STATE_EXIT", state._fqn end

function RECORDS.effect(segment) return "EFFECT", tostring(segment.tr) end

function RECORDS.entries(segment)
  local text, node = segment.tgt._fqn, segment.tgt._parent
  while node ~= segment.lca do
    text, node = text .. " > " .. node._fqn, node._parent
  end
  return "TRANS_ENTER", "lca: " .. segment.lca._fqn, "down_path: ", text
end

function RECORDS.done(leaf) return "RAISED", leaf._done_event end

function RECORDS.entry(state) return "STATE_ENTER", state._fqn end

for name, record_of in pairs(RECORDS) do -- any order: independent entries
  recorders[name] = function(fsm, arg, at)
    local dbg = fsm.dbg
    if dbg == silent or not dbg then return end
    fsm._at = at
    report(fsm, "dbg", record_of(arg))
  end
end

function actions.become_leaf(fsm, leaf, at)
  fsm._act_leaf = leaf
  if not leaf.doo then recorders.done(fsm, leaf, at) end
end

do
  -- The actions that call the hooks of states: hook -> action.
  local callers = setmetatable({}, { __mode = "kv" })

  local function add_action(list, action, arg)
    list.actions[#list.actions + 1] = action
    list.path[#list.actions] = arg
  end

  local function add_hooks(list, hooks, state)
    for _, hook in ipairs(hooks and hooks[state] or NONE) do
      local action = callers[hook]
        or function(fsm, arg, at) call_hook(fsm, hook, arg, at) end
      callers[hook] = action
      add_action(list, action, state)
    end
  end

  -- Adds the exits of the states from `from` up to the lca, which stays active.
  local function add_exits(fsm, list, segment, from)
    add_action(list, recorders.exits, segment)
    while from ~= segment.lca do
      add_action(list, actions.exit, from)
      add_hooks(list, fsm._exit_hooks, from)
      add_action(list, actions.be_left, from)
      add_action(list, recorders.exit, from)
      from = from._parent
    end
  end

  local function add_entry(fsm, list, state)
    add_action(list, actions.become_active, state)
    add_hooks(list, fsm._entry_hooks, state)
    add_action(list, actions.entry, state)
    if state._is_leaf then
      done_event(state)
      add_action(list, actions.become_leaf, state)
      add_action(list, actions.be_done, state)
      if rfsm.names_done(state._parent) then
        add_action(list, actions.be_done_around, state)
      end
    end
    add_action(list, recorders.entry, state)
  end

  -- Adds the entries of the states from below the lca to the target.
  local function add_entries(fsm, list, segment)
    local line = line_to(segment.connector and segment.tgt._parent or segment.tgt)
    for i = segment.lca._depth + 2, #line do add_entry(fsm, list, line[i]) end
  end

  local shapes = setmetatable({}, { __mode = "v" }) -- text of a list of actions -> list

  -- Returns an equal list of actions. All paths with the same actions share this list.
  local function shared(list)
    local texts = {}
    for i, action in ipairs(list) do texts[i] = tostring(action) end
    local shape = concat(texts)
    shapes[shape] = shapes[shape] or list
    return shapes[shape]
  end

  -- Lists for each segment (a) the exits of the states below the lca, (b) the effect,
  -- (c) the entries of the states from below the lca to the target.
  local function list_actions(fsm, path)
    local from, list = path.from, { actions = {}, path = path }
    local segments, has_events = engine.segments_of(path), false
    for _, hook in ipairs(fsm._path_hooks or NONE) do
      add_action(list, actions.path_hook, { hook = hook, path = path })
    end
    if path.entered then add_entry(fsm, list, path.entered) end
    if segments[1] then add_action(list, recorders.path, path) end
    for i, segment in ipairs(segments) do
      -- behind a connector another event may count
      has_events = has_events or i > 1 and segment.tr.events[1] ~= nil
      if has_events then add_action(list, actions.go_through, segment.tr.src) end
      if not segment.is_internal then add_exits(fsm, list, segment, from) end
      add_action(list, recorders.effect, segment)
      add_action(list, actions.effect, segment)
      add_action(list, segment.is_internal and actions.keep_made or recorders.entries,
        segment)
      add_entries(fsm, list, segment)
      from = segment.tgt._parent
    end
    fsm._has_paths = true
    path.actions = shared(list.actions) -- set last: it marks completion
  end

  -- Returns the segments of a path, or of the entrance, which has none.
  function engine.segments_of(path)
    local list = {}
    while path and path.segment do
      insert(list, 1, path.segment)
      path = path.before
    end
    return list
  end

  function engine.new_path(base, segment)
    local path = { from = base, segment = segment, actions = false }
    if not base._mode then -- no leaf: a leaf may have data with these names
      path.from, path.entered, path.before = base.from, base.entered, base
    end
    base._paths = base._paths or {}
    base._paths[segment] = path
    return path
  end

  interpret(engine.new_path) -- a trace of LuaJIT had nil as a string in its place

  -- Returns the path that continues `base` with a segment and, at each connector
  -- reached, with the segment noted in `ways`. Paths are kept in a tree. Its roots are
  -- the leaves and the entrance of the machine; `base` is a root or a part of a path.
  function path_of(fsm, base, segment, ways)
    if segment then -- no loop, because LuaJIT would not compile a loop around this one
      base = base._paths and base._paths[segment] or engine.new_path(base, segment)
      if segment.connector then
        return path_of(fsm, base, ways[segment.connector].way, ways)
      end
    end
    if not base.actions then list_actions(fsm, base) end
    return base
  end
end

-- Performs the actions of `_path` after the one that was begun last. Returns true.
function perform(fsm)
  local path = fsm._path
  local list = path.actions
  for at = fsm._at + 1, #list do list[at](fsm, path[at], at) end
  return true
end

-- The phase "take", after an interrupt. The actions that queue e_done are noted before
-- they do so, and are repeated.
function PHASES.take(fsm)
  local path, at = fsm._path, fsm._at
  local action = path.actions[at]
  if action == actions.be_done or action == actions.be_done_around then
    action(fsm, path[at], at)
  end
  perform(fsm)
  return conclude(fsm, "counted")
end

-- Loads rfsm/fast.lua. If that fails, for example for lack of memory, machines work
-- without this file.
local function load_fast()
  if fast.is_loaded then return end
  fast.is_loaded = true
  local ok, make = pcall(find_module, "rfsm.fast")
  if ok and loadstring then
    ok, make = pcall(make, engine)
  end
  if not ok and rfsm.is_interrupt(make) then
    fast.is_loaded = false
    error(make, 0)
  end
end

-- Doo ............................................................................

local run_doo

do
  local coroutine = find_global "coroutine" or { create = function(doo) return doo end,
    resume = function() return false, "there are no coroutines here" end }
  local resume, status = coroutine.resume, coroutine.status

  -- Queues e_done. The leaf is done last: until then this may be called again.
  function engine.complete(fsm, leaf)
    if fsm._at < 3 then
      trace(fsm, "RAISED", "%s", done_event(leaf))
      queue_done(fsm, leaf, 2)
      fsm._at = 3
    end
    if leaf.final then complete_around(fsm, leaf, 3) end
    leaf._mode = "done"
  end

  --- End the doo of the active leaf as if it had returned, for extensions.
  --
  -- The doo calls this, and then yields true. So its coroutine stays alive for machines
  -- that are copies of this one.
  --
  ---@param fsm rfsm.Machine
  ---@param leaf rfsm.State
  ---@package
  function rfsm.end_doo(fsm, leaf)
    local co = leaf._doo_co
    if leaf._mode ~= "done" then engine.complete(fsm, leaf) end
    if not co then return end
    if fsm._at < 4 then
      fsm._at = 4
      engine.tell_watch(fsm, "ended", leaf)
      trace(fsm, "DOO", "removing completed coroutine of %s doo", leaf._fqn)
    end
    leaf._doo_co = nil
  end

  local function start_doo(fsm, leaf, doo)
    trace(fsm, "DOO", "created coroutine for %s doo", leaf._fqn)
    leaf._is_resumed_again = status and promises[doo] == "repeatable" or nil
    leaf._doo_co = coroutine.create(type(doo) == "function" and doo
      or function(...) return doo(...) end)
    return leaf._doo_co
  end

  -- Runs one cycle of the active leaf's doo. Returns true if the doo is idle or done; a
  -- leaf without doo is done at once, one whose doo fails, too, but without e_done.
  -- `_at` is 1 when the doo is resumed, 2 and 3 while events are queued at its end, 4
  -- when watch hooks are called then or the doo has failed, 5 if getevents is called.
  function run_doo(fsm, leaf)
    local co, ok, idle = leaf._doo_co, true, false
    if not co then
      local doo = leaf.doo
      if leaf._mode == "done" or not doo then
        rfsm.end_doo(fsm, leaf)
        return true
      end
      co = start_doo(fsm, leaf, doo)
    end
    if fsm._at < 1 then
      fsm._at = 1
      if fsm._watch_hooks then engine.tell_watch(fsm, "resumed", leaf) end
      if leaf._is_resumed_again then -- the next cycle begins one anew that has failed
        ok, idle = resume(co, fsm, leaf, "doo")
        if not ok then
          leaf._doo_co = nil
          keep_failure(fsm, idle)
          return false
        end
      else
        ok, idle = resume(co, fsm, leaf, "doo")
        if not ok then
          leaf._mode = "done"
          fsm._at = 4
          report_callback(fsm, "doo", leaf, nil, idle)
        end
      end
    end
    if ok and status(co) ~= "dead" then return not not idle end
    rfsm.end_doo(fsm, leaf)
    return true
  end
end

local function finish_cycle(fsm, idle)
  if idle and fsm._curq[1] == nil and fsm.getevents ~= no_events
    and (fsm._at < 5 or fsm._given) then
    fsm._at = 5
    append_getevents(fsm, engine.queue_given)
  end
  return conclude(fsm, idle and "idle" or "counted")
end

function PHASES.doo(fsm) return finish_cycle(fsm, run_doo(fsm, innermost(fsm))) end

-- Iterate ........................................................................

local function empty(list)
  for i = #list, 1, -1 do list[i] = nil end
end

-- Makes the iteration after one that was free, for which no other step is made.
local function iterate_again(fsm)
  if fsm._has_always then fsm._is_usual = false end
  return iterate(fsm, true)
end

-- Ends an iteration whose hooks were called. Returns the result of `iterate`. The list
-- of current events is used again, unless a callback may have kept it.
local function close(fsm)
  if fsm._is_lent then
    fsm._curq = {}
    fsm._is_lent = fsm._lends
  else
    local events = fsm._curq
    if events[2] ~= nil then empty(events) end
    events[1] = nil
  end
  fsm._phase = "idle"
  if not fsm._is_usual then
    fsm._is_usual = not (fsm._reset_wanted or fsm._has_always)
    fsm._is_cut = false
    if fsm._failure then engine.raise_failure(fsm) end
  end
  if fsm._outcome == "free" then
    local idle = iterate_again(fsm)
    return idle
  end
  return fsm._outcome == "idle" and fsm._intq[1] == nil and fsm._act_leaf ~= false
end

-- The phase "finish": calls the post step hooks.
local function finish(fsm)
  if fsm._reset_wanted then engine.reset_now(fsm) end
  local hooks, next_one = fsm._after, fsm._hook + 1
  if hooks and hooks[next_one] then run_hooks(fsm, hooks, next_one) end
  return close(fsm)
end

PHASES.search, PHASES.finish = search, finish

function conclude(fsm, outcome)
  fsm._outcome = outcome
  fsm._hook = 0
  fsm._phase = "finish"
  return finish(fsm)
end

-- Makes one iteration, or the rest of one that was cut short.
local function go_on(fsm, after_free)
  fsm._is_cut = false
  if fsm._failed then tell_failure(fsm) end
  if fsm._phase == "idle" then
    fsm._turn = fsm._turn + 1
    fsm._phase = fsm._has_always and "always" or "begin"
  end
  return PHASES[fsm._phase](fsm, after_free)
end

-- The usual iterations, written out ................................................
--
-- An iteration is a usual one if the machine is in a leaf, `dbg` is silent, and there
-- is at most one event. An e_done that no transition names is not counted.

-- Makes one iteration of a machine with step hooks. The first hook of a list is
-- called here: most machines have only one.
local function iterate_hooked(fsm, after_free, leaf) -- luacheck: ignore 561
  local hooks, has_getevents, events = fsm._before, false, fsm._intq
  local spare = fsm._curq
  fsm._curq = events
  fsm._intq = spare
  fsm._turn = fsm._turn + 1
  if hooks then
    local hook = hooks.one
    fsm._hook = hooks.noted
    fsm._phase = "gather"
    if hook then
      local ok, failure = pcall(hook, fsm, events)
      if not ok then fail_hook(fsm, hook, failure) end
      if hooks[2] then run_hooks(fsm, hooks, 2) end
    else
      run_hooks(fsm, hooks, 1)
    end
    fsm._phase = "search"
    events = fsm._curq -- getevents and `take_one` may replace the list
    has_getevents = hooks.has_getevents
    if not fsm._is_usual or fsm._act_leaf ~= leaf or fsm.dbg ~= silent then
      return search(fsm, after_free)
    end
  end
  local event, more = events[1], events[2]
  if event == leaf._ignored then event, more = more, events[3] end
  local choice, outcome
  if event == nil then
    if leaf._mode == "done" and not (leaf._doo_co or has_getevents) then
      outcome = (events[1] == nil or after_free) and "idle" or "free"
    end
  elseif more == nil then
    choice = leaf._choices[event] or choice_of(leaf, event)
    local run = choice.run
    if run == nil then run = fast.quick_run(fsm, leaf, choice) end
    if run and run(fsm, event) then
      if not fsm._is_usual then return conclude(fsm, "counted") end
      outcome = "counted"
    end
  end
  if not outcome then
    fsm._phase = "search"
    return search(fsm, after_free, choice, event)
  end
  fsm._outcome = outcome
  hooks = fsm._after
  if hooks then
    local hook = hooks.one
    fsm._hook = hooks.noted
    fsm._phase = "finish"
    if hook then
      local ok, failure = pcall(hook, fsm, events)
      if not ok then fail_hook(fsm, hook, failure) end
      if hooks[2] then run_hooks(fsm, hooks, 2) end
    else
      run_hooks(fsm, hooks, 1)
    end
  end
  if fsm._is_lent or not fsm._is_usual then return close(fsm) end
  if events[2] ~= nil then empty(events) end
  events[1] = nil
  fsm._phase = "idle"
  if outcome == "counted" then return false end
  if outcome == "idle" then return fsm._intq[1] == nil and fsm._act_leaf ~= false end
  local idle = iterate_again(fsm)
  return idle
end

-- Makes one iteration without events.
local function rest(fsm, leaf, after_free)
  local events = fsm._curq
  if leaf._mode == "done" and not leaf._doo_co then
    events[1] = nil
    return true
  elseif events[1] ~= nil then
    fsm._phase = "search"
    return search(fsm, after_free)
  end
  fsm._at = 0
  fsm._phase = "doo"
  local idle = run_doo(fsm, leaf)
  if not fsm._is_usual then return finish_cycle(fsm, idle) end
  fsm._phase = "idle"
  return idle and fsm._intq[1] == nil and fsm._act_leaf ~= false
end

-- Makes one iteration, and another one if it does not count as a step; `after_free`
-- is true for that. Returns whether the machine is idle, nil if it cannot be entered.
-- The two lists of events are swapped. If an interrupt cuts the swap short,
-- `PHASES.begin` repairs it in the next iteration.
function iterate(fsm, after_free) -- luacheck: ignore 561 (a call costs time)
  local leaf = fsm._act_leaf
  if not (leaf and fsm._is_usual) or fsm.dbg ~= silent then
    return go_on(fsm, after_free)
  end
  if fsm._is_hooked then -- no tail call: LuaJIT gives up what returns to a pcall
    local idle = iterate_hooked(fsm, after_free, leaf)
    return idle
  end
  local events = fsm._intq
  local spare = fsm._curq
  fsm._curq = events
  fsm._intq = spare
  local event, more = events[1], events[2]
  if event == leaf._ignored then event, more = more, events[3] end
  if event == nil then return rest(fsm, leaf, after_free) end
  local choice
  if more == nil then
    choice = leaf._choices[event] or choice_of(leaf, event)
    local run = choice.run
    if run == nil then run = fast.quick_run(fsm, leaf, choice) end
    local is_taken = run and run(fsm, event)
    if not is_taken and choice[1] then
      fsm._phase = "search"
      local found, own = choose(fsm, leaf, events, choice, event)
      run = nil -- a guard may have moved the machine, or switched dbg on
      if found and fsm._is_usual and fsm._act_leaf == leaf and fsm.dbg == silent then
        run = path_of(fsm, leaf, found, fsm._ways).run
      end
      if not run then return follow(fsm, after_free, leaf, found, own) end
      is_taken = run(fsm, own, true)
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
      if is_taken then return false end
      local idle = iterate_again(fsm)
      return idle
    end
  end
  fsm._phase = "search"
  return search(fsm, after_free, choice, event)
end

-- Marks the iteration as cut short. The mark `_is_cut` shows that no step is under way
-- any more, although the phase may not be "idle"; if it is, the step that would have
-- gone on is over. An iteration that was counted, but has not begun, is counted once
-- more: what comes again in the next one still does so.
function engine.cut(fsm)
  local again = fsm._again
  local has_begun = fsm._phase ~= "idle" or fsm._curq[1] == nil
  if again and not has_begun and again.turn == fsm._turn - 1 then
    again.turn = fsm._turn
  end
  if fsm._phase == "idle" and fsm._outcome == "free" then fsm._outcome = "counted" end
  fsm._cuts = fsm._cuts + 1
  fsm._is_usual = false
  fsm._is_cut = true
end

-- Raises an error that has ended an iteration: a kept error, an error of a step hook or
-- an interrupt.
local function raise_cut(fsm, failure)
  engine.cut(fsm)
  error(failure, 0)
end

-- Build: a machine of a model -------------------------------------------------------

--- Raise an error that blames the caller, unless `fsm` is a machine; for extensions.
---@param fsm any
---@param where string the public function, such as "rfsm.step"
---@param level? integer level of `error`; default 3, which blames the caller's caller
function rfsm.check_machine(fsm, where, level)
  if machines[fsm] then return end
  if rawequal(getmetatable(fsm), Machine) and rawget(fsm, "_initialized") then
    if fsm._preparing then return end -- `init` is running
    -- a program's deep copy: what was made of the structure may still lead to elements
    -- of the original
    engine.forget(fsm)
    machines[fsm] = true
    return
  end
  local hint = is_state(fsm) and (rawget(fsm, "_initialized")
    and " of another copy of rfsm" or " (rfsm.init makes one of a state)") or ""
  error(where .. ": initialised fsm expected, " .. got(fsm) .. hint, level or 3)
end

local check_machine = rfsm.check_machine

function engine.check_function(f, where)
  if not is_callable(f) then error(where .. ": function expected, " .. got(f), 3) end
end

-- Pads the numbers in a text with zeros, so that trans[10] is sorted after trans[2].
local function natural(text)
  return (text:gsub("%d+", function(n) return ("0"):rep(12 - #n) .. n end))
end

-- Puts the `file` of each item in front of its `line`, which is "location: text".
-- Returns these texts, sorted by location, and the code of each.
function engine.lines_of(list)
  local keys, lines, codes = {}, {}, {}
  for i = 1, #list do
    local file, line = list[i].file, list[i].line
    lines[i] = (file and file .. ": " or "") .. line
    keys[lines[i]], codes[lines[i]] = natural(line), list[i].code
  end
  sort(lines, function(a, b) return text_before(keys[a], keys[b]) end)
  return lines, codes
end

function engine.summary(where, problems)
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
  local file = made_at[obj._model]
  return (file and file .. ": " or "") .. name_of(obj, field)
end

local function is_closed(build, node)
  return node._id == "initial"
    and not (node._mode or build.is_left[node] or node._otrs[1])
end

-- Reports each `initial` that no transition leaves: a problem if the first entry or a
-- transition leads to it, else a warning. A merge has added the transitions from
-- number `first` on: only problems are reported, and only theirs.
function engine.check_ways_in(build, first)
  local fsm, is_entered = build.fsm, {}
  if not first then is_entered[rawget(fsm, "initial") or fsm] = true end
  for i = first or 1, #fsm._transitions do
    is_entered[fsm._transitions[i].tgt] = true
  end
  for _, node in ipairs(fsm._nodes) do
    local list = is_entered[node] and build.problems or not first and build.warnings
    if list and is_closed(build, node) then
      add(list, node, nil, words("no transition leaves it"))
    end
  end
end

-- Clones and resolves a model, without a call of its functions. Returns the build. A
-- printer that cannot be called is replaced by a default.
function engine.build_machine(model)
  local fsm = setmetatable(own_fields(), Machine)
  local build = engine.new_build(fsm)
  fsm._model, fsm._parent, fsm._nodes = model, fsm, { fsm }
  fsm._entrance = { from = fsm, entered = fsm }
  engine.note_mount(build, fsm)
  engine.clone_below(build, 1)
  engine.resolve(build, 1)
  engine.check_ways_in(build)
  for _, name in ipairs(HOOKS) do check_callable(build, fsm, name, model[name]) end
  for _, name in ipairs(PRINTERS) do
    local printer = model[name] ~= true and model[name]
    check_callable(build, fsm, name, printer, ", true or false")
    printer = printer_of(fsm, name)
    rawset(fsm, name, is_callable(printer) and printer or DEFAULT_PRINTER[name])
  end
  if not (fsm._is_leaf or is_node(rawget(fsm, "initial"))) then
    add(build.problems, fsm, nil, words("the root needs an initial"))
  end
  engine.list_hooks(fsm)
  return build
end

-- A function `f(fsm, code, text)` that is called for each warning, or false.
---@package
rfsm.warned = false

--- Warn of something in a chart, for extensions.
---@param fsm rfsm.Machine
---@param code string|false the code of the warning in rfsm/checks/codes.lua; false: a
-- check tells more
---@param text string "location: what is wrong"
function rfsm.warn(fsm, code, text)
  if rfsm.warned then rfsm.warned(fsm, code, text) end
  report(fsm, "warn", "WARNING: " .. text)
end

local function report_warnings(fsm, list)
  if fsm.warn == silent then return end
  local lines, codes = engine.lines_of(list)
  for _, line in ipairs(lines) do rfsm.warn(fsm, codes[line], line) end
end

-- Reports the connectors that the model does not declare. Each is located where its
-- first transition was made.
function engine.report_created(build)
  for _, created in ipairs(build.created) do
    local first = created.node._otrs[1]
    made_at[created.node._model] = first and made_at[first._model]
  end
  for _, line in ipairs((engine.lines_of(build.created))) do
    report(build.fsm, "info", "INFO: " .. line)
  end
end

-- Returns the set of composites that are left by a transition from a node inside.
local function left_composites(fsm)
  local left = {}
  for _, tr in ipairs(fsm._transitions) do
    local composite = tr.src._parent
    local lca = engine.find_lca(composite, tr.tgt._parent)
    while composite ~= lca do left[composite], composite = true, composite._parent end
  end
  return left
end

-- Warns of the nodes, from number `first` on, that no transition leaves. Returns true
-- if there are none.
function engine.report_dead_ends(fsm, first)
  local nodes, dead, left = fsm._nodes, {}, nil
  for i = first, #nodes do
    local node, around = nodes[i], nodes[i]
    while around._mode and around ~= fsm and not around._otrs[1] do
      around = around._parent
    end
    if not (around._otrs[1] or node._model.final or node == fsm) then
      left = left or left_composites(fsm)
      local line = "no outgoing transitions from node '" .. node._fqn .. "'"
      dead[#dead + 1] = not left[node] and { line = line, code = false } or nil
    end
  end
  report_warnings(fsm, dead)
  return dead[1] == nil
end

-- Events that extensions know or that are no events, beside those such as e_after(1).
local ODD_EVENTS = { e_fault = true, always = true }

-- Reports the warnings of the model, then suspicious guards and events, which preproc
-- functions may have changed, then dead ends.
function engine.report_findings(build, first_node, first_transition)
  local fsm, found = build.fsm, append({}, build.warnings)
  for i = first_node, #fsm._nodes do
    local node = fsm._nodes[i]
    local way = node._id == "initial" and node._otrs[1]
    if way and (way.events[1] ~= nil or way.guard) then
      add_advice(found, "initial", node)
    end
  end
  for i = first_transition, #fsm._transitions do
    local tr = fsm._transitions[i]
    for _, event in ipairs(tr.events) do
      local is_odd = type(event) == "table" or type(event) == "string"
        and (event:find("%)$") or ODD_EVENTS[event])
      if is_odd then add_advice(found, "event", tr, event) end
    end
  end
  report_warnings(fsm, found)
  engine.report_dead_ends(fsm, first_node)
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

do
  local function has_nan(events)
    for _, event in ipairs(type(events) == "table" and events or NONE) do
      if event ~= event then return true end
    end
    return false
  end

  -- Returns the name of a field with a wrong value from a preproc function; else false.
  local function wrong_field(fsm, tr)
    local events, pn = tr.events or NONE, tr.pn or 0
    if has_nan(events) or type(events) ~= "table" and type(events) ~= "string" then
      return "events"
    end
    if type(pn) ~= "number" or pn ~= pn then return "pn" end
    if not is_node_of(fsm, tr.src) then return "src" end
    return not is_node_of(fsm, tr.tgt) and "tgt"
  end

  -- Checks what preproc functions have made of a transition. Its events become a list,
  -- its target no composite. Returns the text of a problem, or nil.
  local function check_transition(fsm, tr)
    local wrong, tgt = wrong_field(fsm, tr), tr.tgt
    if wrong then
      return ("%s: %s: set by a preproc function, %s"):format(rfsm.location_of(tr),
        wrong, got(tr[wrong]))
    end
    tr._is_internal = tr._is_internal and rawequal(tr.src, tgt)
    tr.tgt = end_at(tr, tgt)
    local is_composite = tr.tgt ~= tgt
    if not tr.tgt or is_composite and not tr.tgt._otrs[1] then
      return rfsm.location_of(tr) .. ": tgt: the composite has no initial transition"
    end
    tr.events = type(tr.events) == "string" and { tr.events } or tr.events or {}
  end

  -- Checks all transitions after preproc functions, if `is_changed`; lists problems.
  local function check_transitions(fsm, is_changed, problems)
    for _, tr in ipairs(fsm._transitions) do
      if is_changed then problems[#problems + 1] = check_transition(fsm, tr) end
      tr._target = tr._target or tr.tgt
    end
    if is_changed and not problems[1] then engine.list_otrs(fsm) end
  end

  -- Runs the preproc functions and returns the problems they found. If one of them
  -- calls `fsm_merge`, only the functions before it are called for the new element,
  -- because the later ones are still to be called for the whole machine.
  function engine.preprocess(fsm, merged)
    local problems, outer = {}, fsm._preparing
    local last = outer and outer - 1 or #rfsm.preproc
    fsm._elements = false
    for i = 1, last do
      fsm._preparing = i
      local found = rfsm.preproc[i](fsm, merged)
      append(problems, type(found) == "table" and found or {})
    end
    fsm._preparing, fsm._elements = outer, false
    if not outer then check_transitions(fsm, last > 0, problems) end
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

local function refuse_model(fsm, problems)
  local text = engine.summary("rfsm.init", problems)
  report(fsm, "err", text)
  engine.raise_failure(fsm)
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
  if is_foreign(model) then
    return refuse_model({ err = model.err }, { "root: " .. FOREIGN_MACHINE })
  end
  local build = engine.build_machine(model)
  local fsm, problems = build.fsm, (engine.lines_of(build.problems))
  if problems[1] then return refuse_model(fsm, problems) end
  load_fast()
  if rfsm.is_strict(model) then find_module("rfsm.strict") end
  fsm._initialized = true
  engine.list_otrs(fsm)
  engine.report_created(build)
  problems = engine.preprocess(fsm)
  if problems[1] then
    fsm._initialized = false
    return refuse_model(fsm, problems)
  end
  if fsm.warn ~= silent then engine.report_findings(build, 1, 1) end
  machines[fsm] = true
  engine.raise_failure(fsm)
  return fsm
end

--- Check a model without making a machine of it.
---@param model rfsm.State
---@return boolean is_valid
---@return string[] problems each "file:line: location: problem"
---@return string[] warnings
---@return table<string, string|false> codes the code of each warning
function rfsm.verify_early(model)
  if not is_state(model) then
    error("rfsm.verify_early: state expected, " .. got(model), 2)
  end
  model = model_of(model)
  if is_foreign(model) then return false, { "root: " .. FOREIGN_MACHINE }, {}, {} end
  local build = engine.build_machine(model)
  local warnings, codes = engine.lines_of(build.warnings)
  return not build.problems[1], (engine.lines_of(build.problems)), warnings, codes
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
function engine.check_no_step(fsm, where, level)
  if fsm._phase == "idle" or fsm._is_cut then return end
  error(where .. ": the machine is in the middle of a step; if its coroutine is never "
    .. "resumed, rfsm.init(fsm) makes a fresh machine", level)
end

function engine.try(fsm)
  local ok, idle = pcall(iterate, fsm)
  if not ok then raise_cut(fsm, idle) end
  return idle
end

-- Makes more steps, until `left` steps are made or the machine is idle. The result is
-- true if it is idle. `idle` comes from the last step.
local function advance(fsm, left, idle)
  while idle ~= nil do
    left = left - 1
    if left < 1 then return idle end
    local idle_hook = idle and fsm.idle_hook
    if idle and not idle_hook then break end
    if idle_hook then
      if not is_callable(idle_hook) then
        error("rfsm.step: idle_hook: function expected, " .. got(idle_hook), 0)
      end
      idle_hook(fsm)
    end
    idle = engine.try(fsm)
  end
  if idle and is_traced(fsm) then
    report(fsm, "dbg", "HIBERNATING",
      "no events, no idle_hook, no doos or doo idle, halting engines")
    engine.raise_failure(fsm)
  end
  return idle or false
end

local function step_often(fsm, n)
  if type(n) ~= "number" then
    error("rfsm.step: number of steps expected, " .. got(n)
      .. (type(n) == "string" and " (did you mean rfsm.send_events?)" or ""), 3)
  end
  return advance(fsm, n == n and n or 1, engine.try(fsm)) -- NaN counts as 1
end

--- Advance a machine by at most `n` transitions or doo cycles.
--
-- Returns earlier if the machine is idle. Errors of callbacks are reported to `err`.
-- Errors of pre step hooks and getevents are raised at once, those of printers and
-- post step hooks at the end of the iteration. A step that an interrupt has cut short
-- is finished first.
--
---@param fsm rfsm.Machine
---@param n? number at least 1, default 1
---@return boolean idle true if there is nothing left to do
function rfsm.step(fsm, n)
  if not machines[fsm] then check_machine(fsm, "rfsm.step") end
  if fsm._phase ~= "idle" then engine.check_no_step(fsm, "rfsm.step", 3) end
  if n ~= nil then return (step_often(fsm, n)) end -- a tail call shifts error levels
  local ok, idle = pcall(iterate, fsm)
  if not ok then raise_cut(fsm, idle) end
  return idle or false
end

--- Advance a machine until no event is pending and no doo is busy.
---@param fsm rfsm.Machine
---@return boolean idle false when the machine could not be entered
function rfsm.run(fsm)
  if not machines[fsm] then check_machine(fsm, "rfsm.run") end
  if fsm._phase ~= "idle" then engine.check_no_step(fsm, "rfsm.run", 3) end
  local ok, idle = pcall(iterate, fsm) -- usually two steps; no loop, for LuaJIT
  if ok and idle == false then ok, idle = pcall(iterate, fsm) end
  if not ok then raise_cut(fsm, idle) end
  if idle and fsm.dbg == silent and not fsm.idle_hook then return true end
  return advance(fsm, huge, idle)
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
  fsm._phase, fsm._curq, fsm._failure, fsm._failed = "idle", {}, false, false
  engine.reset_now(fsm)
  engine.raise_failure(fsm)
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
  engine.check_function(f, "rfsm.mapfsm")
  if type(fsm) ~= "table" then error("rfsm.mapfsm: state expected, " .. got(fsm), 2) end
  local results = {}
  local function map_members(state, levels)
    if levels < 1 then return end
    for _, key in ipairs(sorted_keys(state, is_member, live(state))) do
      local obj = state[key]
      if not pred or pred(obj) then results[#results + 1] = f(obj, state, key) end
      if is_state(obj) then map_members(obj, levels - 1) end
    end
  end
  if rfsm.is_root(fsm) and (not pred or pred(fsm)) then
    results[1] = f(fsm, fsm, "root")
  end
  map_members(fsm, depth or huge)
  return results
end

--- List the elements that `pred` accepts among `obj` and its members, for extensions.
--
-- A preproc function `f(fsm, merged)` works on `rfsm.elements(merged or fsm, pred)`.
--
---@param obj table a machine or an element of one
---@param pred? fun(obj: any): boolean default is_fsmobj
---@return table[] elements parents before children
function rfsm.elements(obj, pred)
  local is_root, list = rfsm.is_root(obj), {}
  local all = is_root and obj._elements
  if not all then
    local function itself(element) return element end
    all = is_root and {} or { obj } -- `mapfsm` lists a root
    if not rfsm.is_trans(obj) then append(all, rfsm.mapfsm(itself, obj)) end
    if is_root and obj._preparing then obj._elements = all end
  end
  for i = 1, #all do
    if not pred or pred(all[i]) then list[#list + 1] = all[i] end
  end
  return list
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
  local at, hooks = fsm._at, fsm._exit_hooks -- a callback of a path may call this
  leave(fsm, state, at, nil)
  if hooks then tell(fsm, hooks[state], state) end
  actions.be_left(fsm, state)
  recorders.exit(fsm, state, at)
end

-- Hooks ...........................................................................
--
-- A list of hooks is replaced, never changed, so that a call of its hooks is not
-- disturbed. rfsm/shared/types.lua describes the functions and their arguments.

do
  local WATCHED = { sent = true, failed = true, resumed = true, ended = true,
    merged = true, discarded = true, failed_inside = true }

  local OF_STATE = { is_path = true, expected = "state of the fsm",
    is_subject = function(fsm, state) return is_node_of(fsm, state, "state") end }

  -- The kinds of hooks, rfsm.HookKind by name: rfsm.<kind>_hook_add and _rm.
  local KINDS_OF_HOOKS = {
    pre_step = { list = "_pre_hooks", own = "pre_step_hook", is_step = true },
    post_step = { list = "_post_hooks", own = "post_step_hook", is_step = true },
    source = { is_step = true }, path = { is_path = true }, entry = OF_STATE,
    exit = OF_STATE, reset = {}, reaction = {}, waiting = {}, fate = {},
    guard = { is_path = true, expected = "transition of the fsm",
      is_subject = function(fsm, tr) return rfsm.is_trans(tr) and tr._fsm == fsm end },
    watch = { is_subject = function(_, what) return WATCHED[what] end,
      expected = "'sent', 'failed', 'failed_inside', 'resumed', 'ended', 'merged' or "
        .. "'discarded'" },
  }

  -- Hooks placed in "front" record events. They are called before hooks placed
  -- "before", which may remove events. A list has the number of the former in `front`.
  local PLACES = { front = true, before = true, after = true }

  -- Lists of one hook, which many states may have: hook -> list.
  local singles = setmetatable({}, { __mode = "kv" })

  local function put_in(owner, field, hook, place)
    if not (owner[field] or place == "front") then
      singles[hook] = singles[hook] or { hook }
      owner[field] = singles[hook]
      return
    end
    local old = owner[field] or NONE
    local hooks, front = append({}, old), old.front or 0
    local before = place == "before" and front + 1 or #hooks + 1
    insert(hooks, place == "front" and 1 or before, hook)
    hooks.front = place == "front" and front + 1 or old.front
    owner[field] = hooks
  end

  -- Removes a hook from the list in a field of `owner`. An empty list becomes nil, as
  -- in a new machine. Returns true if the hook was in the list.
  local function take_out(owner, field, hook)
    local old = owner[field] or NONE
    for i = 1, #old do
      if rawequal(old[i], hook) then
        local hooks, front = append({}, old), old.front or 0
        table.remove(hooks, i)
        hooks.front = i <= front and front - 1 or front
        owner[field] = hooks[1] and hooks or nil
        return true
      end
    end
    return false
  end

  local function note_change(fsm, kind)
    if kind.is_step then engine.list_hooks(fsm) end
    if kind.is_path and fsm._has_paths then engine.drop_paths(fsm) end
  end

  for name, kind in pairs(KINDS_OF_HOOKS) do -- any order: independent entries
    local where = "rfsm." .. name .. "_hook_add"
    local field = kind.list or "_" .. name .. "_hooks"

    rfsm[name .. "_hook_add"] = function(fsm, subject, hook)
      local place = nil
      check_machine(fsm, where)
      if not kind.is_subject then subject, hook, place = nil, subject, hook end
      engine.check_function(hook, where)
      if place ~= nil and not PLACES[place] then
        error(where .. ": 'before' or 'after' expected, " .. got(place), 2)
      elseif not kind.is_subject then
        put_in(fsm, field, hook, place)
      elseif not kind.is_subject(fsm, subject) then
        error(where .. ": " .. kind.expected .. " expected, " .. got(subject), 2)
      else
        fsm[field] = fsm[field] or {}
        put_in(fsm[field], subject, hook)
      end
      note_change(fsm, kind)
      if subject == "discarded" or name == "fate" then rfsm.follow_fates(fsm) end
    end

    rfsm[name .. "_hook_rm"] = function(fsm, subject, hook)
      local owner, key = fsm, field
      check_machine(fsm, "rfsm." .. name .. "_hook_rm")
      if kind.is_subject then
        owner, key = fsm[field] or NONE, subject
      else
        hook = subject
      end
      local is_removed = is_callable(hook) and take_out(owner, key, hook)
      if is_removed then note_change(fsm, kind) end
      if is_removed and fsm._fates then rfsm.leave_fates(fsm) end
      if is_removed or not kind.own or hook == nil then return is_removed end
      is_removed = rawequal(fsm[kind.own], hook)
      if is_removed then fsm[kind.own] = nil end
      return is_removed
    end
  end
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
  engine.check_function(f, "rfsm.borrows")
  promises[f] = promises[f] or "borrows"
  return f
end

--- Promise that a hook of an extension may be called again after an interrupt.
--
-- Twice must be as good as once. So an interrupt loses nothing that the hook does. The
-- hook must not raise errors of its own, and not keep the list of events.
--
---@param f function
---@return function f
function rfsm.repeatable(f)
  engine.check_function(f, "rfsm.repeatable")
  promises[f] = "repeatable"
  return f
end

--- Note that an extension keeps a current event which no transition takes.
---@param fsm rfsm.Machine
---@param event any
---@param state? rfsm.State the state for which it is kept
---@param word? string what the extension does: "defers"
function rfsm.note_kept(fsm, event, state, word)
  if fsm._fates then fsm._fates:keep(event, state, word) end
end

--- List the events to which extensions react while a state is active.
--
-- `rfsm.foretell` asks the same hooks about events that may come now.
--
---@param fsm rfsm.Machine
---@param state rfsm.State
---@return any[] events
---@return { events: any[], word: string }[] shown those of extensions that want them
-- to be drawn in the state, as "e_job / defer"
function rfsm.reactions(fsm, state)
  local list, shown = {}, {}
  for _, hook in ipairs(fsm._reaction_hooks or NONE) do
    local events, word = hook(fsm, state)
    append(list, events or NONE)
    if word and events then shown[#shown + 1] = { events = events, word = word } end
  end
  return list, shown
end

--- Have snapshots of a machine include data of an extension, under `name`.
--
-- `save(fsm)` returns plain data, or nil. `load(fsm, data, how)` restores the result of
-- `save` or raises an error; the table `how` describes changes of the chart since then.
-- `is_explored` is true if transitions depend on the data: explorations keep it, too,
-- and call `save(fsm, true)`.
--
---@param fsm rfsm.Machine
---@param name string
---@param save fun(fsm: rfsm.Machine, is_explored?: boolean): any
---@param load fun(fsm: rfsm.Machine, data: any, how: table)
---@param is_explored? boolean
function rfsm.snapshot_hook_add(fsm, name, save, load, is_explored)
  check_machine(fsm, "rfsm.snapshot_hook_add")
  engine.check_function(save, "rfsm.snapshot_hook_add")
  engine.check_function(load, "rfsm.snapshot_hook_add")
  fsm._snapshot_hooks = append(append({}, fsm._snapshot_hooks or NONE),
    { { name = name, save = save, load = load, is_explored = is_explored } })
end

-- Regions: machines in a state of another machine ----------------------------------

--- List the machines that run in a state, in the order in which they are stepped.
---@param state rfsm.State a state of a machine
---@return rfsm.Machine[] regions empty if there are none; the caller must not change it
---@return rfsm.Regions? own the field `_regions`; nil if no machines run in the state
function rfsm.regions(state)
  local own = is_state(state) and rawget(state, "_regions")
  if type(own) ~= "table" then return NONE, nil end
  return append({}, own), own
end

--- Does a transition from a state wait for its e_done? For extensions.
---@param state rfsm.State a state of a machine
---@return boolean
---@package
function rfsm.names_done(state)
  for _, tr in ipairs(state._otrs) do
    for _, event in ipairs(tr.events) do
      if event == done_event(state) then return true end
    end
  end
  return state._awaits_done or false
end

--- Make a machine a region of another one, for extensions.
---@param region rfsm.Machine
---@param fsm rfsm.Machine the parent machine
---@param name any the name of the region
function rfsm.set_parent(region, fsm, name)
  check_machine(region, "rfsm.set_parent")
  rawset(region, "_owner", fsm)
  rawset(region, "_region_name", name)
  rawset(region, "_got", { turn = 0, count = 0, length = huge }) -- see `forward`
  engine.list_again(region)
end

--- Return the machine around a region, and the name of the region there.
---@param fsm rfsm.Machine
---@return rfsm.Machine? parent nil if the machine is no region
---@return any name
function rfsm.parent(fsm)
  check_machine(fsm, "rfsm.parent")
  return fsm._owner or nil, fsm._region_name
end

-- Names: files that are loaded when one of their names is first read ----------------

do
  local PARTS = { seqand = "rfsm_seqand", forward = "rfsm_seqand", pp = "rfsmpp",
    fsm_merge = "rfsm.merge", follow_fates = "rfsm.fates", foretell = "rfsm.fates",
    prepare = "rfsm.prepare", save_memory = "rfsm.prepare", machines = "rfsm.prepare",
    note_cut = "rfsm.prepare", set_emit = "rfsm.prepare", check_always = "rfsm.always" }

  for name in ([[check_between_steps check_no_otrs is_in map_from_to
    node_find_enabled place set_sta_mode begin_in snapshot_hooks structure_of target_of
    targets took_path waiting check_events is_free is_idle ]]):gmatch("%S+") do
    PARTS[name] = "rfsm.tools"
  end

  engine.add, engine.advise, engine.append = add, advise, append
  engine.enabled, engine.first_enabled, engine.follow = enabled, first_enabled, follow
  engine.is_node_of, engine.line_to, engine.path_of = is_node_of, line_to, path_of
  engine.iterate, engine.matches, engine.PHASES = iterate, matches, PHASES
  engine.silent, engine.tell, engine.fast = silent, tell, fast
  engine.actions, engine.recorders, engine.perform = actions, recorders, perform
  engine.failed, engine.promises, engine.loadstring =
    report_callback, promises, loadstring

  -- Loads the file with the function of a name. Files named rfsm.<part> return a
  -- function that adds theirs to this table. Any other is a module of the user's.
  local function load_part(_, name)
    local module = PARTS[name]
    if not module then return nil end
    local part = find_module(module)
    if part and module:find("^rfsm%.") then part(rfsm, engine) end
    rfsm[name] = rawget(rfsm, name) or part or module ~= "rfsmpp" and function()
      error(("rfsm.%s: %s.lua is not installed beside rfsm.lua"):format(name,
        module:gsub("%.", "/")), 2)
    end or nil
    return rawget(rfsm, name)
  end

  setmetatable(rfsm, { __index = load_part })
end

do
  -- Loaded as "libs.rfsm" this file has the prefix "libs."; by `dofile`, a folder only.
  local prefix = tostring((...)):match("^(.+[./])rfsm$")
  local folder = this_chunk and this_chunk.source:match("^@(.-)[^/\\]*$")
  local searchers

  -- Finds a module beside this file. The other searchers may look into archives.
  local function find_module_of(name)
    for i = 1, #searchers do
      local chunk, where = nil, nil
      if searchers[i] ~= searchers.rfsm then
        chunk, where = searchers[i]((prefix or "") .. name)
      end
      if type(chunk) == "function" then return chunk, where end
    end
    local file = folder and folder .. name:gsub("%.", "/") .. ".lua"
    return file and loadfile(file), file
  end

  -- Searcher for `require`: finds the modules beside this file, and in compat/ their
  -- older names (rfsm_emem for rfsm.emem). A name with the prefix is the same module.
  local function find_beside(name)
    local plain = prefix and name:sub(1, #prefix) == prefix and name:sub(#prefix + 1)
    if not (plain or name):find("^rfsm[%w_.]") then return nil end
    if plain then return function() return require(plain) end, name end
    for _, at in ipairs { "compat." .. name, name } do -- a chart may have such a file
      local chunk, where = find_module_of(at)
      if chunk then return chunk, where end
    end
  end

  -- Registers the module and the searcher. With a prefix the modules beside this file
  -- come before others that are installed. In a sandbox `package` may have no fields.
  local function register(package)
    searchers = package.searchers or package.loaders
    if searchers and searchers.rfsm and type(package.loaded.rfsm) ~= "table" then
      forget_modules "table" -- of an earlier core: they know no machine of this one
    end
    if searchers and loadfile and not searchers.rfsm then
      searchers.rfsm = find_beside -- marks the searcher as installed
      insert(searchers, prefix and 2 or #searchers + 1, find_beside)
    end
    if package.loaded and not package.loaded.rfsm then package.loaded.rfsm = rfsm end
  end

  register(rawget(_G, "package") or NONE)
  if not rawget(_G, "RFSM_NO_GLOBALS") then pcall(rawset, _G, "rfsm", rfsm) end
end

return rfsm
