--- A machine as plain tables, which exporters and protocols read.
--
-- All lists are in a fixed order: nodes in the order of a walk from `initial`,
-- transitions in the order of `rfsm.mapfsm`.
--
-- The sections follow the steps in which a description is made: order of nodes, texts
-- of callbacks, texts of events, tables, JSON.
--
-- @module rfsm.marsh
-- @license BSD-3-Clause

local digits_of = require("rfsm.shared.exact_json").digits_of
local files = require "rfsm.shared.files"
local instrument = require "rfsm.shared.instrument"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local io, ipairs, rawget, rawset = rawget(_G, "io"), ipairs, rawget, rawset
local select, setmetatable = select, setmetatable
local type = type
local concat = table.concat
local compile = rawget(_G, "loadstring") or rawget(_G, "load")
local debug = rawget(_G, "debug")
local original = instrument.original

local marsh = {}

--- A transition as a plain table. Only a full description has the fields from `key` on.
---@class rfsm.marsh.Transition
---@field type "transition"
---@field src string FQN of the source
---@field tgt string FQN of the target, or of the `initial` of a composite target
---@field pn? number priority number of the transition
---@field events any[] empty if any event triggers it
---@field always? true it needs no event
---@field internal? true no state is left or entered, `src` and `tgt` are the same
---@field key? string location of the transition: "root.trans[2]"
---@field words? string[] its events in words: "e_go", "after 5 s", "done"
---@field with_data? string[] only in JSON: the names of the events that have data
---@field guard? string the name, code or comment of the guard in its source
---@field effect? string the name, code or comment of the effect in its source
---@field at? string where callbacks begin: "guard chart.lua:7, effect chart.lua:9"
---@field doc? string the field `doc` of the transition in the model

--- A node as a plain table. Only a composite has `transitions` and `subnodes`. Only a
-- full description has the fields from `entry` on.
---@class rfsm.marsh.Node
---@field id string
---@field type "state"|"connector"
---@field transitions? rfsm.marsh.Transition[]
---@field subnodes? rfsm.marsh.Node[]
---@field entry? string the name, code or comment of the callback in its source
---@field exit? string the name, code or comment of the callback in its source
---@field doo? string the name, code or comment of the callback in its source
---@field at? string where each callback begins: "entry chart.lua:7"
---@field doc? string the field `doc` of the state in the model
---@field reactions? { word: string, words: string[] }[] events to which extensions
-- react: "defer", with the events in words
---@field final? true the model has `final` in this state
---@field history? "shallow"|"deep" given if transitions enter the composite by history
---@field mode? "active"|"done" mode in a live machine; absent if the state is inactive
---@field regions? rfsm.marsh.Node[] the regions of a sequential AND state; their FQNs
-- begin with the FQN of the state and the name of the region: "root.arms.left.open"

-- Order: a walk from `initial` ------------------------------------------------

-- Returns the target that a transition has in the model; history may change `tr.tgt`.
local function target_of(tr) return rfsm.targets(tr)[1] end

-- Notes a transition in `links`, as an edge between two children of the innermost
-- composite around source and target. Below these children, notes in `entries` which
-- child of each composite the transition enters.
local function note_links(tr, links, entries)
  local around, child, tgt = {}, target_of(tr), target_of(tr)
  while not rfsm.is_root(child) do
    around[child._parent], child = child, child._parent
  end
  child = tr.src
  while not (rfsm.is_root(child) or around[child._parent]) do child = child._parent end
  local home = not rfsm.is_root(child) and child._parent
  if home and around[home] ~= child then order.append(links, child, around[home]) end
  while not rfsm.is_root(tgt) and tgt._parent ~= home do
    order.append(entries, tgt._parent, tgt)
    tgt = tgt._parent
  end
end

local function members_of(fsm)
  local transitions, nodes, links, entries = {}, {}, {}, {}
  rfsm.mapfsm(function(element, composite)
    if rfsm.is_trans(element) then
      order.append(transitions, composite, element)
      note_links(element, links, entries)
    elseif element ~= fsm then
      order.append(nodes, composite, element)
    end
  end, fsm)
  return transitions, nodes, links, entries
end

-- Returns a function that lists the nodes of a composite (nil for a leaf), then a table
-- of the transitions by composite. A list of nodes has a breadth-first walk from
-- `initial`, then walks from nodes that are entered from outside, then from the other
-- nodes by name.
local function new_walk(fsm)
  local transitions, nodes_in, links, entries = members_of(fsm)
  return function(composite)
    local nodes = nodes_in[composite]
    if not nodes then return nil end
    local walked, is_listed, done, count = {}, {}, 0, 0
    local function add(node)
      if is_listed[node] then return end
      count = count + 1
      walked[count], is_listed[node] = node, true
    end
    local function start(node)
      add(node)
      while done < count do
        done = done + 1
        for _, tgt in ipairs(links[walked[done]] or {}) do add(tgt) end
      end
    end
    for _, node in ipairs(nodes) do if node._id == "initial" then start(node) end end
    for _, node in ipairs(entries[composite] or {}) do start(node) end
    for _, node in ipairs(nodes) do start(node) end
    return walked
  end, transitions
end

-- Callbacks: their name, text, comment or calls in the source ------------------

--- Read a source file. A host without `io` may replace this function.
---@param name string the file: "chart.lua" for a function of the chunk "@chart.lua"
---@return string? text nil if it cannot be read
function marsh.read_source(name)
  return io and files.read(name) or nil
end

-- Returns the lines of a source; none if the source cannot be read.
local function lines_of(source)
  local name, lines = source:match("^[@=](.*)$"), {}
  local text = source
  if name then text = marsh.read_source(name) or "" end
  for line in text:gmatch("([^\n]*)\n?") do lines[#lines + 1] = line end
  return lines
end

-- Returns a list of parameters with the values of a function's upvalues in place of
-- their names: "(motor, speed)" becomes "(motor, 5)".
local function arguments_of(f, parameters)
  local values = {}
  for i = 1, debug.getinfo(f, "u").nups do
    local name, value = debug.getupvalue(f, i)
    local kind = type(value)
    values[name] = kind == "string" and '"' .. value .. '"'
      or (kind == "number" or kind == "boolean") and rfsm.text_of(value) or nil
  end
  return (parameters:gsub("[%a_][%w_]*", values))
end

local IS_FIELD = { entry = true, exit = true, doo = true, guard = true, effect = true }
-- Returns the name of a function from the line in which it begins, or nil. If several
-- functions begin there, the first is taken to return this one: its call is "move(5)".
local function name_in_line(f, line, count)
  local name, parameters = line:match("function%s+([%a_][%w_.:]*)%s*(%b())")
  if name and count > 1 then return name .. arguments_of(f, parameters) end
  name = name or line:match("([%a_][%w_]*)%s*=%s*function%f[^%w_]")
  return name and not IS_FIELD[name] and name or nil
end

local LONGEST = 40 -- most bytes of a body that is shown
local HEAD = "function%s*%b()%s*"

-- Returns the body of the function whose head a text matches; nil if the text has two
-- of them. The body ends at the first "end" at which it is whole.
local function body_behind(line, head)
  local text, is_only = line:match(head .. "(.*)"), select(2, line:gsub(head, "")) == 1
  for at in (is_only and compile and text or ""):gmatch("()%f[%w_]end%f[^%w_]") do
    local body = text:sub(1, at - 1)
    if compile(body) then return body end
  end
end

-- Returns the body of a function of one line, or of three lines with the body between.
local function body_of(info, lines, count, field)
  local first, last = info.linedefined, info.lastlinedefined
  local body
  if first == last and count == 1 then
    body = body_behind(lines[first], HEAD)
  elseif first == last and field then
    body = body_behind(lines[first], "%f[%w_]" .. field .. "%s*=%s*" .. HEAD)
  elseif last == first + 2 and lines[first]:find("function%s*%b()%s*$") then
    body = lines[first + 1]:gsub("%s+%-%-.*$", ""):match("^%s*(.*)$")
  end
  body = (body or ""):gsub("^return%f[^%w_]%s*", ""):gsub("[%s;]+$", "")
  return #body <= LONGEST and body ~= "" and not body:find("^%-%-") and body or nil
end

local LONGEST_COMMENT = 60 -- most bytes of a comment that is shown

-- Returns the comment behind a function's parameters, or else in the line above them.
local function comment_of(info, lines)
  local line, before = lines[info.linedefined], lines[info.linedefined - 1] or ""
  local text = line:match("function%s*%b()%s*%-%-+%s*(.-)%s*$")
    or before:match("^%s*%-%-+%s*(.-)%s*$")
  if not text or text:find("^%[=*%[") or not text:find("%w") then return nil end
  return #text <= LONGEST_COMMENT and text or nil
end

local IS_KEYWORD = {}
for word in ("and do else elseif end for function if in local not or repeat return "
  .. "then until while"):gmatch("%a+") do
  IS_KEYWORD[word] = true
end

-- Calls f(call) for each call in a body, but not for calls in arguments of a call.
local function each_call(body, f)
  local position = 1
  while true do
    local name, at = body:match("%f[%w_]([%a_][%w_.:]*)%s*()[(\"{]", position)
    if not name then return end
    position = at + 1
    if not IS_KEYWORD[name] then
      local arguments = body:match("^%b()", at) or body:match("^%b{}", at) or '""'
      f(name .. (arguments:find("^%(%s*%)") and "()" or "(..)"))
      position = at + #arguments
    end
  end
end

-- Returns the calls in the body of a function, in short: "motor.stop(), log(..)".
local function calls_of(info, lines)
  local text = concat(lines, "\n", info.linedefined, info.lastlinedefined)
  text = (body_behind(text, HEAD) or text:match(HEAD .. "(.*)") or "")
    :gsub('"[^"\n]*"', '""'):gsub("'[^'\n]*'", '""')
    :gsub("%-%-[^\n]*", "")
  local result, last = nil, nil
  each_call(text, function(call)
    if call == last or last == ".." then return end
    last = (not result or #result + #call < LONGEST) and call or ".."
    result = (result and result .. ", " or "") .. last
  end)
  return result
end

-- Returns the name of a function in its source; or else its body, comment or calls.
local function text_in_source(f, info, lines, field)
  local line = lines[info.linedefined]
  if not line then return nil end
  local _, count = line:gsub("%f[%w_]function%f[^%w_]", "")
  return name_in_line(f, line, count) or body_of(info, lines, count, field)
    or comment_of(info, lines) or count == 1 and calls_of(info, lines) or nil
end

-- Returns the text of a value; nil if it has an address, which differs in each run.
local function text_without_address(value)
  local kind = type(value)
  if kind == "string" then return value end
  local text = rfsm.text_of(value)
  if kind == "number" then return (text:gsub("^%-0$", "0")) end
  local is_address = text == kind or text:find("^" .. kind .. ": ")
    or text:find("^builtin: ") or text:find("0x%x")
  return not is_address and kind ~= "function" and kind ~= "thread" and text or nil
end

--- The text of a callback whose source gives no name, code or comment.
marsh.UNKNOWN = ".."

-- Returns a function that returns two texts about a callback: a short description, then
-- file and line ("" if unknown). Both texts are equal in each run and on each Lua.
local function new_callback_text()
  local sources = {}
  local function new_text(f, field)
    local info = debug and type(f) == "function" and debug.getinfo(f, "S")
    if not info or info.what == "C" then
      return text_without_address(f) or type(f) ~= "function" and type(f)
    end
    local source = info.source
    sources[source] = sources[source] or lines_of(source)
    local file = source:match("^[@=].-([^/\\]*)$") or ""
    return text_in_source(f, info, sources[source], field),
      file .. ":" .. info.linedefined
  end
  local texts, places = {}, {}
  return function(f, field)
    if not texts[f] then
      local text, place = new_text(f, field)
      texts[f], places[f] = text or marsh.UNKNOWN, place or ""
    end
    return texts[f], places[f]
  end
end

-- Events: a text for any value, and words for a reader ------------------------

--- Return a function that gives each event a text, the same on each run and each Lua.
--
-- An event whose text would be an address, such as a function, gets its type and a
-- number, so that two of them differ: "function 1" is the first function for which a
-- text was requested.
--
---@return fun(event: any): string text_of
---@nodiscard
function marsh.gen_event_text()
  local texts, counts = {}, {}
  return function(event)
    local name = rfsm.event_name(event) or rfsm.name_with_data(event)
    local text = texts[event] or name or text_without_address(event)
    if text then return text end
    local kind = type(event)
    counts[kind] = (counts[kind] or 0) + 1
    texts[event] = kind .. " " .. counts[kind]
    return texts[event]
  end
end

--- Return an event in words: "after 5 s", "done".
---@param text string the event: "e_after(5)@root.on"
---@param fqn string FQN of the source of the event's transition
---@return string
---@nodiscard
function marsh.words_of(text, fqn)
  if text:sub(-#fqn - 1) == "@" .. fqn then text = text:sub(1, -#fqn - 2) end
  if text == "e_done" then return "done" end
  local kind, time = text:match("^e_(%l+)%((.*)%)$")
  if kind ~= "after" and kind ~= "every" and kind ~= "at" then return text end
  return kind .. " " .. time .. (rfsm.number_of(time) and " s" or "")
end

-- Tables ----------------------------------------------------------------------

--- The functions and tables from which the table of a machine is made.
---@class rfsm.marsh.Writer
---@field fsm rfsm.Machine
---@field walk fun(composite: rfsm.State): rfsm.Node[]? lists the nodes of a composite
---@field transitions table<rfsm.State, rfsm.Transition[]> transitions in each composite
---@field prefix string the FQN of the root
---@field callback_text? fun(f: function, field?: string): string for full descriptions
---@field event_text fun(event: any): string returns the text of an event
---@field has_history table<rfsm.State, true> composites entered through their history

local function source_of(f)
  return debug and type(f) == "function" and debug.getinfo(f, "S").source
end

-- Returns a table with the user's callbacks of a state. If the state has regions, an
-- extension has set its doo, and perhaps entry and exit. The user's entry and exit are
-- then kept by the extension.
local function callbacks_of(state)
  local regions, kept = rfsm.regions(state)
  if not regions[1] then return state end
  local source = source_of(original(state, "doo"))
  local function user_s(field)
    local f = original(kept, field) or original(state, field)
    return (not f or source_of(f) ~= source) and f or nil
  end
  return { entry = user_s("entry"), exit = user_s("exit"), doc = state.doc }
end

local function add_texts(writer, tab, element, fields)
  for _, field in ipairs(fields) do
    local f = original(element, field)
    if f then
      local text, place = writer.callback_text(f, field)
      tab[field] = text
      if place ~= "" then
        tab.at = (tab.at and tab.at .. ", " or "") .. field .. " " .. place
      end
    end
  end
  tab.doc = type(element.doc) == "string" and element.doc or nil
end

local EFFECTS, PROGRAMS = { "guard", "effect" }, { "entry", "exit", "doo" }

-- Returns a name for an event that is a function: its text, or else file and line; a
-- function in C has neither.
local function name_of(writer, f)
  local text, place = writer.callback_text(f)
  return text == marsh.UNKNOWN and place ~= "" and place or text
end

-- Returns the events of a transition or reaction in words.
local function words_of(writer, events, fqn)
  local words = {}
  for i, event in ipairs(events) do
    local is_nameless = type(event) == "function" and not rfsm.event_name(event)
    words[i] = is_nameless and name_of(writer, event)
      or marsh.words_of(writer.event_text(event), fqn)
  end
  return words
end

local function transition_table(writer, tr)
  local events = {}
  for i = 1, tr.events and #tr.events or 0 do events[i] = tr.events[i] end
  local tab = {
    type = "transition", src = location.path(tr.src, writer.prefix),
    tgt = location.path(target_of(tr), writer.prefix), pn = tr.pn, events = events,
    always = tr.always and true or nil,
    internal = rfsm.target_of(tr) == "internal" or nil,
  }
  if not writer.callback_text then return tab end
  tab.key = location.path(tr, writer.prefix)
  tab.words = words_of(writer, events, tr.src._fqn)
  add_texts(writer, tab, tr, EFFECTS)
  return tab
end

local machine_table

-- Adds the fields of a state that only a full description has.
local function add_details(writer, tab, state)
  local regions, own = rfsm.regions(state)
  local path, mode = location.path(state, writer.prefix), rfsm.get_sta_mode(state)
  local _, shown = rfsm.reactions(writer.fsm, state)
  for i, reaction in ipairs(shown) do
    shown[i] = { word = reaction.word,
      words = words_of(writer, reaction.events, state._fqn) }
  end
  tab.reactions = shown[1] and shown
  add_texts(writer, tab, callbacks_of(state), PROGRAMS)
  tab.final = state.final and true or nil
  tab.history = writer.has_history[state] and state.history or nil
  tab.mode = mode ~= "inactive" and mode or nil
  tab.regions = regions[1] and {}
  for i, region in ipairs(regions) do
    local id = rfsm.text_of(own.names[i])
    tab.regions[i] = machine_table(region, id, path .. "." .. id, writer)
  end
end

local function node_table(writer, node)
  if rfsm.is_conn(node) then return { id = node._id, type = "connector" } end
  local tab = { id = node._id, type = "state" }
  if writer.callback_text then add_details(writer, tab, node) end
  local nodes = writer.walk(node)
  if not nodes then return tab end
  tab.transitions, tab.subnodes = {}, {}
  for i, tr in ipairs(writer.transitions[node] or {}) do
    tab.transitions[i] = transition_table(writer, tr)
  end
  for i, subnode in ipairs(nodes) do
    tab.subnodes[i] = node_table(writer, subnode)
  end
  return tab
end

-- Returns the set of the composites that some transition enters through their history.
local function histories_of(fsm)
  local composites = {}
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    local targets = rfsm.targets(tr)
    if targets[2] then composites[targets[1]._parent] = true end
  end
  return composites
end

-- Returns the table of a machine or region, with this `id`. `texts` has the fields of a
-- writer that a full description needs; it is empty if the description is not full.
function machine_table(fsm, id, prefix, texts)
  local walk, transitions = new_walk(fsm)
  local tab = node_table({ fsm = fsm, walk = walk, transitions = transitions,
    prefix = prefix, callback_text = texts.callback_text, event_text = texts.event_text,
    has_history = histories_of(fsm) }, fsm)
  tab.id = id
  return tab
end

local function description_of(fsm, is_full)
  return machine_table(fsm, "root", "root", is_full and {
    callback_text = new_callback_text(), event_text = marsh.gen_event_text() } or {})
end

--- Return the structure of a machine.
--
-- A full description has all that a picture shows: texts of callbacks, regions, and
-- which states are active.
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

--- Return the active leaf of a machine, and its mode.
-- @raise if `fsm` was not initialised
---@param fsm rfsm.Machine
---@return string|false fqn of the active leaf; false if there is none
---@return string|false mode of the leaf
---@return false path always false
---@nodiscard
function marsh.actinfo2tab(fsm)
  rfsm.check_machine(fsm, "rfsm.marsh.actinfo2tab")
  local leaf = fsm._act_leaf
  if not leaf then return false, false, false end
  return leaf._fqn, rfsm.get_sta_mode(leaf), false
end

-- JSON: UTF-8, and numbers that look alike ------------------------------------

local REPLACEMENT = "\239\191\189" -- U+FFFD

-- Patterns of the UTF-8 characters that have more than one byte.
local CHARACTERS = { "^[\194-\223][\128-\191]", "^\224[\160-\191][\128-\191]",
  "^[\225-\236\238\239][\128-\191][\128-\191]", "^\237[\128-\159][\128-\191]",
  "^\240[\144-\191][\128-\191][\128-\191]",
  "^[\241-\243][\128-\191][\128-\191][\128-\191]",
  "^\244[\128-\143][\128-\191][\128-\191]" }

-- Keeps the UTF-8 character at the start of the bytes, if it is complete. Each other
-- byte becomes U+FFFD.
local function mend(bytes)
  for _, character in ipairs(CHARACTERS) do
    local _, last = bytes:find(character)
    if last then return bytes:sub(1, last) .. REPLACEMENT:rep(#bytes - last) end
  end
  return REPLACEMENT:rep(#bytes)
end

--- Return a text as UTF-8: each byte that belongs to no character becomes U+FFFD.
---@param text string
---@return string
---@nodiscard
function marsh.utf8(text)
  if not text:find("[\128-\255]") then return text end
  return (text:gsub("[\128-\255][\128-\191]*", mend))
end

-- Returns a value that dkjson writes as the exact digits of a number; the text "inf" or
-- "-inf" if the number is infinite.
local function plain_number(number)
  if number - number ~= 0 then return number > 0 and "inf" or "-inf" end
  local digits = digits_of(number + 0) -- + 0 turns -0 into 0
  return setmetatable({}, { __tojson = function() return digits end })
end

-- Returns an event as JSON has it: a boolean, a finite number, or else a text.
local function plain_event(event, text_of)
  local kind = type(event)
  if kind == "boolean" then return event end
  if kind == "number" then return plain_number(event) end
  return marsh.utf8(text_of(event))
end

local TEXTS = { "id", "src", "tgt", "key", "at", "doc", "guard", "effect", "entry",
  "exit", "doo" }

local function make_events_plain(tab, text_of)
  local names = {}
  for i, event in ipairs(tab.events) do
    local name = rfsm.event_name(event)
    names[#names + 1] = name and marsh.utf8(name)
    tab.events[i] = plain_event(event, text_of)
  end
  tab.with_data = names[1] and names
end

-- Changes the table of an element so that dkjson writes it without loss.
local function plain(tab, text_of)
  for _, key in ipairs(TEXTS) do tab[key] = tab[key] and marsh.utf8(tab[key]) end
  tab.pn = tab.pn and plain_number(tab.pn)
  if tab.events then make_events_plain(tab, text_of) end
  for i, text in ipairs(tab.words or {}) do tab.words[i] = marsh.utf8(text) end
  for _, key in ipairs { "reactions", "transitions", "subnodes", "regions" } do
    for _, element in ipairs(tab[key] or {}) do plain(element, text_of) end
  end
  return tab
end

--- Return the structure of a machine as dkjson should write it.
--
-- It differs from the result of `model2tab`: numbers have the same digits on every Lua,
-- texts are UTF-8, and events that JSON lacks are texts.
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
