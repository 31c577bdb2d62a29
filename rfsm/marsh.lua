--- A machine as plain tables, which exporters and protocols read.
--
-- All lists are in a fixed order: nodes in that of a walk from `initial`, transitions
-- in that of `rfsm.mapfsm`.
--
-- The file reads in the order in which a description is made: order of nodes, texts of
-- callbacks, texts of events, tables, JSON.
--
-- @module rfsm.marsh
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local io, ipairs, rawget, rawset = io, ipairs, rawget, rawset
local setmetatable, tonumber, type = setmetatable, tonumber, type
local math_type, debug = rawget(math, "type"), rawget(_G, "debug")

local marsh = {}

--- A transition as a plain table. A full one has the fields from `key` on, too.
---@class rfsm.marsh.Transition
---@field type "transition"
---@field src string FQN
---@field tgt string FQN; a composite stands as its `initial`
---@field pn? number
---@field events any[] empty if any event triggers it
---@field internal? true nothing is left or entered; src and tgt are the same
---@field key? string its location: "root.trans[2]"
---@field words? string[] its events for a reader: "e_go", "after 5 s", "done"
---@field guard? string a text of the callback
---@field effect? string likewise
---@field doc? string that field of the model, for a reader

--- A node as a plain table. Only a composite has the two lists. A full one has the
-- fields from `entry` on, too.
---@class rfsm.marsh.Node
---@field id string
---@field type "state"|"connector"
---@field transitions? rfsm.marsh.Transition[]
---@field subnodes? rfsm.marsh.Node[]
---@field entry? string a text of the callback
---@field exit? string likewise
---@field doo? string likewise
---@field doc? string that field of the model, for a reader
---@field final? true that field of the model
---@field mode? "active"|"done" of a live machine
---@field regions? rfsm.marsh.Node[] the machines of a sequential AND state; their FQNs
-- begin with that of the state and the region's name: "root.arms.left.open"

-- Order: a walk from `initial` ---------------------------------------------------

local function append(lists, key, value)
  local list = lists[key] or {}
  lists[key] = list
  list[#list + 1] = value
end

-- Notes which child of a composite a transition leads to, and from which one; a child
-- that is entered from outside is noted for the composite.
local function note_links(tr, links, entries)
  local on_the_way, child = {}, tr.tgt
  while not rfsm.is_root(child) do
    on_the_way[child._parent], child = child, child._parent
  end
  child = tr.src
  while not rfsm.is_root(child) do
    local tgt = on_the_way[child._parent]
    if tgt and tgt ~= child then append(links, child, tgt) end
    on_the_way[child._parent], child = nil, child._parent
  end
  child = tr.tgt
  while not rfsm.is_root(child) do
    if on_the_way[child._parent] then append(entries, child._parent, child) end
    child = child._parent
  end
end

local function itself(element) return element end

-- Returns a function that lists the nodes of a composite: breadth first from `initial`,
-- then from those that are entered from outside, then from the others by name.
local function new_walk(fsm)
  local links, entries = {}, {}
  rfsm.mapfsm(function(tr) note_links(tr, links, entries) end, fsm, rfsm.is_trans)
  return function(composite)
    local order, is_listed, done = {}, {}, 0
    local function add(node)
      if not is_listed[node] then order[#order + 1], is_listed[node] = node, true end
    end
    local function start(node)
      add(node)
      while done < #order do
        done = done + 1
        for _, tgt in ipairs(links[order[done]] or {}) do add(tgt) end
      end
    end
    local nodes = rfsm.mapfsm(itself, composite, rfsm.is_nr_node, 1)
    for _, node in ipairs(nodes) do if node._id == "initial" then start(node) end end
    for _, node in ipairs(entries[composite] or {}) do start(node) end
    for _, node in ipairs(nodes) do start(node) end
    return order
  end
end

-- Callbacks: their name or text in the source, or its file and line ------------------

-- Returns the lines of a source; none where it cannot be read.
local function lines_of(source)
  local text, lines = source, {}
  if source:find("^[@=]") then
    local file = source:sub(1, 1) == "@" and io.open(source:sub(2))
    text = file and file:read("*a") or ""
    if file then file:close() end
  end
  for line in text:gmatch("([^\n]*)\n?") do lines[#lines + 1] = line end
  return lines
end

-- Puts what a function has kept in place of the parameters of its maker.
local function arguments_of(f, parameters)
  local values, i = {}, 1
  local name, value = debug.getupvalue(f, 1)
  while name do
    local kind = type(value)
    values[name] = kind == "string" and '"' .. value .. '"'
      or (kind == "number" or kind == "boolean") and rfsm.text_of(value) or nil
    i = i + 1
    name, value = debug.getupvalue(f, i)
  end
  return (parameters:gsub("[%a_][%w_]*", values))
end

local IS_FIELD = { entry = true, exit = true, doo = true, guard = true, effect = true }
local LONGEST = 40 -- bytes of a body

-- Returns what a line calls the function that begins in it, or the function's body.
local function text_in_line(f, info, line)
  local _, count = line:gsub("%f[%w_]function%f[^%w_]", "")
  local name, parameters = line:match("function%s+([%a_][%w_.:]*)%s*(%b())")
  if name and count > 1 then return name .. arguments_of(f, parameters) end
  name = name or line:match("([%a_][%w_]*)%s*=%s*function%f[^%w_]")
  if name and not IS_FIELD[name] then return name end
  if count ~= 1 or info.linedefined ~= info.lastlinedefined then return nil end
  local body = line:match("function%s*%b()%s*(.*)%f[%w_]end%f[^%w_]") or ""
  body = body:gsub("^return%f[^%w_]%s*", ""):gsub("%s+$", "")
  return #body <= LONGEST and body ~= "" and body or nil
end

-- Returns a function that gives a callback a text, the same on each run and each Lua.
local function new_callback_text()
  local sources = {}
  return function(f)
    local info = debug and type(f) == "function" and debug.getinfo(f, "S")
    if not info or info.what == "C" then return type(f) end
    local source = info.source
    sources[source] = sources[source] or lines_of(source)
    local line = sources[source][info.linedefined]
    local text = line and text_in_line(f, info, line)
    if text then return text end
    local file = source:match("^[@=](.*)$")
    return (file and file:match("[^/\\]*$") or "line") .. ":" .. info.linedefined
  end
end

-- Events: a text for any value, and words for a reader ------------------------------

-- Returns the text of a value; nil if it is an address, which no two runs share.
local function text_without_address(value)
  local kind, text = type(value), rfsm.text_of(value)
  if kind == "number" then return (text:gsub("^%-0$", "0")) end
  if kind == "string" or kind == "boolean" then return text end
  local is_address = text == kind or text:find("^" .. kind .. ": ")
    or text:find("^builtin: ") or text:find("0x%x")
  return not is_address and kind ~= "function" and kind ~= "thread" and text or nil
end

--- Return a function that gives each event a text, the same on each run and each Lua.
--
-- An event without a text of its own, such as a function, is called by its type and a
-- number: "function 1" is the first that was asked for.
--
---@return fun(event: any): string text_of
---@nodiscard
function marsh.gen_event_text()
  local texts, counts = {}, {}
  return function(event)
    local text = texts[event] or text_without_address(event)
    if text then return text end
    local kind = type(event)
    counts[kind] = (counts[kind] or 0) + 1
    texts[event] = kind .. " " .. counts[kind]
    return texts[event]
  end
end

--- Return an event in words: "after 5 s", "done".
---@param text string
---@param fqn string of the source of its transition
---@return string
---@nodiscard
function marsh.words_of(text, fqn)
  if text:sub(-#fqn - 1) == "@" .. fqn then text = text:sub(1, -#fqn - 2) end
  if text == "e_done" then return "done" end
  local kind, time = text:match("^e_(a%l+)%((.*)%)$")
  if kind ~= "after" and kind ~= "at" then return text end
  return kind .. " " .. time .. (tonumber(time) and " s" or "")
end

-- Tables -----------------------------------------------------------------------------

--- How the tables of a machine are made.
---@class rfsm.marsh.Writer
---@field walk fun(composite: rfsm.State): rfsm.Node[]
---@field prefix string the FQN of the root
---@field callback_text? fun(f: function): string only of a full description
---@field event_text fun(event: any): string

local function path_of(writer, node) return writer.prefix .. node._fqn:sub(5) end

-- Adds texts of some fields of an element.
local function add_texts(writer, tab, element, fields)
  for _, field in ipairs(fields) do
    local f = element[field]
    tab[field] = f and writer.callback_text(f) or nil
  end
  tab.doc = type(element.doc) == "string" and element.doc or nil
end

local EFFECTS, PROGRAMS = { "guard", "effect" }, { "entry", "exit", "doo" }

local function add_words(writer, tab, tr)
  local words = {}
  for i, event in ipairs(tab.events) do
    words[i] = type(event) == "function" and writer.callback_text(event)
      or marsh.words_of(writer.event_text(event), tr.src._fqn)
  end
  tab.words = words
end

local function transition_table(writer, tr, composite, name)
  local events = {}
  for i = 1, tr.events and #tr.events or 0 do events[i] = tr.events[i] end
  local tab = {
    type = "transition", src = path_of(writer, tr.src), tgt = path_of(writer, tr.tgt),
    pn = tr.pn, events = events, internal = tr._is_internal,
  }
  if not writer.callback_text then return tab end
  tab.key = path_of(writer, composite)
    .. (type(name) == "number" and ".trans[%s]" or ".%s"):format(rfsm.text_of(name))
  add_words(writer, tab, tr)
  add_texts(writer, tab, tr, EFFECTS)
  return tab
end

local machine_table

-- Adds the part of a state that only a full description has.
local function add_details(writer, tab, state)
  local regions, mode = state._regions, rfsm.get_sta_mode(state)
  add_texts(writer, tab, regions and { entry = regions.entry, exit = regions.exit,
    doc = state.doc } or state, PROGRAMS)
  tab.final = state.final and true or nil
  tab.mode = mode ~= "inactive" and mode or nil
  if not regions then return end
  tab.regions = {}
  for i, region in ipairs(regions) do
    local id = rfsm.text_of(regions.names[i])
    tab.regions[i] = machine_table(region, id, path_of(writer, state) .. "." .. id,
      writer)
  end
end

local function node_table(writer, node)
  if rfsm.is_conn(node) then return { id = node._id, type = "connector" } end
  local tab = { id = node._id, type = "state" }
  if writer.callback_text then add_details(writer, tab, node) end
  if rfsm.is_leaf(node) then return tab end
  tab.transitions = rfsm.mapfsm(function(tr, composite, name)
    return transition_table(writer, tr, composite, name)
  end, node, rfsm.is_trans, 1)
  tab.subnodes = writer.walk(node)
  for i, subnode in ipairs(tab.subnodes) do
    tab.subnodes[i] = node_table(writer, subnode)
  end
  return tab
end

-- Returns the table of a machine under a name; texts are those of `texts`.
function machine_table(fsm, id, prefix, texts)
  local tab = node_table({ walk = new_walk(fsm), prefix = prefix,
    callback_text = texts.callback_text, event_text = texts.event_text }, fsm)
  tab.id = id
  return tab
end

local function description_of(fsm, is_full)
  return machine_table(fsm, "root", "root", is_full and {
    callback_text = new_callback_text(), event_text = marsh.gen_event_text(),
  } or {})
end

--- Return the structure of a machine.
--
-- A full description has all that a picture shows: texts of callbacks, regions, and the
-- states that are active.
--
-- @raise if `fsm` was not initialised
---@param fsm rfsm.Machine
---@param is_full? boolean
---@return rfsm.marsh.Node root
---@nodiscard
function marsh.model2tab(fsm, is_full)
  rfsm.check_machine(fsm, "rfsm.marsh.model2tab")
  return description_of(fsm, is_full)
end

--- Return what is active in a machine.
-- @raise if `fsm` was not initialised
---@param fsm rfsm.Machine
---@return string|false fqn of the active leaf; false if there is none
---@return string|false mode
---@return false path
---@nodiscard
function marsh.actinfo2tab(fsm)
  rfsm.check_machine(fsm, "rfsm.marsh.actinfo2tab")
  local leaf = fsm._act_leaf
  if not leaf then return false, false, false end
  return leaf._fqn, rfsm.get_sta_mode(leaf), false
end

-- JSON: UTF-8, and numbers that look alike -------------------------------------------

local REPLACEMENT = "\239\191\189" -- U+FFFD

-- The second bytes that may follow some first ones.
local LOWEST, HIGHEST = { [224] = 160, [240] = 144 }, { [237] = 159, [244] = 143 }

-- How many bytes follow a first one.
local function count_of(byte)
  return not byte and 0 or byte < 224 and 1 or byte < 240 and 2 or 3
end

-- Replaces the bytes of a sequence that are no UTF-8: a first byte and those behind it.
local function mend(first, others)
  local byte, second = first:byte(), others:byte()
  local count = count_of(byte)
  if byte and (#others < count or second < (LOWEST[byte] or 128)
    or second > (HIGHEST[byte] or 191)) then
    return REPLACEMENT:rep(1 + #others)
  end
  return first .. others:sub(1, count) .. REPLACEMENT:rep(#others - count)
end

--- Return a text as UTF-8: U+FFFD replaces each byte that is none.
---@param text string
---@return string
---@nodiscard
function marsh.utf8(text)
  if not text:find("[\128-\255]") then return text end
  text = text:gsub("[\192\193\245-\255]", REPLACEMENT)
  return (text:gsub("([\194-\244]?)([\128-\191]*)", mend))
end

-- Digits that give back the number, and look alike on every Lua (5.3 shows 5.0) and in
-- every locale (some have a comma).
local function digits_of(number)
  if math_type and math_type(number) == "integer" then return ("%d"):format(number) end
  if number == 0 then return "0" end -- not -0
  local digits = ("%.14g"):format(number)
  if tonumber(digits) ~= number then digits = ("%.17g"):format(number) end
  return (digits:gsub(",", "."))
end

-- A number that dkjson writes with these digits; JSON has no infinite ones.
local function plain_number(number)
  if number - number ~= 0 then return number > 0 and "inf" or "-inf" end
  local digits = digits_of(number)
  return setmetatable({}, { __tojson = function() return digits end })
end

-- JSON knows strings, finite numbers and booleans; other events become their text.
local function plain_event(event, text_of)
  local kind = type(event)
  if kind == "boolean" then return event end
  if kind == "number" then return plain_number(event) end
  return marsh.utf8(text_of(event))
end

-- Marks a list, so that an empty one is no object.
local function as_array(list) return setmetatable(list, { __jsontype = "array" }) end

local TEXTS = { "id", "src", "tgt", "key", "doc", "guard", "effect", "entry", "exit",
  "doo" }
local LISTS = { "events", "words", "transitions", "subnodes", "regions" }

local function each(tab, keys, f)
  for _, key in ipairs(keys) do tab[key] = tab[key] and f(tab[key]) end
end

-- Makes an element of what dkjson can write without losing or adding anything.
local function plain(tab, text_of)
  each(tab, TEXTS, marsh.utf8)
  each(tab, LISTS, as_array)
  tab.pn = tab.pn and plain_number(tab.pn)
  for i, event in ipairs(tab.events or {}) do
    tab.events[i] = plain_event(event, text_of)
  end
  for i, text in ipairs(tab.words or {}) do tab.words[i] = marsh.utf8(text) end
  for _, key in ipairs { "transitions", "subnodes", "regions" } do
    for _, element in ipairs(tab[key] or {}) do plain(element, text_of) end
  end
  return tab
end

--- Return the structure of a machine as dkjson should write it.
--
-- As `model2tab`, but the lists are marked as arrays, numbers look alike on every Lua,
-- texts are UTF-8, and events that JSON does not know are their text.
--
-- @raise if `fsm` was not initialised
---@param fsm rfsm.Machine
---@param is_full? boolean
---@return rfsm.marsh.Node root
---@nodiscard
function marsh.jsontab(fsm, is_full)
  rfsm.check_machine(fsm, "rfsm.marsh.jsontab")
  return plain(description_of(fsm, is_full), marsh.gen_event_text())
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_marsh", marsh) end

return marsh
