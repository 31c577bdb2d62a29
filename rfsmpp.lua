--- A machine and its trace as text, in colour.
--
-- `rfsmpp.gen_dbgcolor` makes a `dbg` function for a machine. `rfsmpp.fsm2str` draws
-- the states. `rfsmpp.value_text` is the text of any data, for all tools. Colours
-- come from the package `ansicolors`, or from the older module of that name. If there
-- is neither, if NO_COLOR is set, if TERM is missing or "dumb", or if `rfsmpp.is_plain`
-- is true, the text is plain.
--
-- @module rfsmpp
-- @license BSD-3-Clause

local home = tostring((...)):match("^(.+[./])rfsmpp$") -- "libs."
if home then require(home .. "rfsm") return require "rfsmpp" end -- one copy

local rfsm = require "rfsm"

local error, getmetatable = error, getmetatable
local pcall, rawget, rawset, require = pcall, rawget, rawset, require
local select, setmetatable, tostring, type = select, setmetatable, tostring, type
local concat = table.concat
local text_of = rfsm.text_of

local rfsmpp = { is_plain = false }

-- Colours: escape sequences by name ---------------------------------------------

local has_ansicolors, ansicolors = pcall(require, "ansicolors")

-- Returns the escape sequence for names such as "red bright"; an empty text if
-- ansicolors is missing.
local function escape(names)
  if not has_ansicolors then return "" end
  if ansicolors.noReset then return ansicolors.noReset("%{" .. names .. "}") end
  return (names:gsub("(%a+) ?", function(name) return tostring(ansicolors[name]) end))
end

local RESET = escape("reset")
local NAME = escape("cyan bright")

local ID = {
  STATE_ENTER = escape("green"), STATE_EXIT = escape("red"), EFFECT = escape("yellow"),
  DOO = escape("blue"), EXEC_PATH = escape("cyan"), ERROR = escape("red bright"),
  HIBERNATING = escape("magenta"), RAISED = escape("white bright"),
  TIMEEVENT = escape("yellow bright"),
}

local MODE = {
  active = escape("green"), done = escape("yellow"), inactive = escape("red"),
}
local ACTIVE_LEAF = escape("green bright")

local function is_colour_wanted()
  local getenv = rawget(_G, "os") and os.getenv
  if rfsmpp.is_plain or not (has_ansicolors and getenv) then return false end
  return (getenv("NO_COLOR") or "") == "" and (getenv("TERM") or "dumb") ~= "dumb"
end

local function paint(is_coloured, colour, text)
  return is_coloured and colour and colour .. text .. RESET or text
end

--- Return a text in a colour, or unchanged if colour is not wanted.
---@param colour string as ansicolors names it: "green bright"
---@param text string
---@return string text
---@nodiscard
function rfsmpp.paint(colour, text)
  return paint(is_colour_wanted(), escape(colour), text)
end

-- Data: any value as a bounded text ----------------------------------------------

local LEVELS, FIELDS = 3, 20 -- tables inside each other; fields of a table

-- How tables and nodes are written: in records, which tools read, and for a person.
local RECORD = { open = "{", close = "}", comma = ",", equals = "=",
  text_of_node = function(node) return node._fqn or text_of(node) end }
local PERSON = { open = "{ ", close = " }", comma = ", ", equals = " = ",
  text_of_node = text_of }

-- How the data of an event are written: at most `most` bytes of a text, no addresses.
local SHORT = { open = "{", close = "}", comma = ",", equals = "=", most = 24,
  text_of_node = RECORD.text_of_node }
local NAMELESS = { open = "{ ", close = " }", comma = ", ", equals = " = ", most = 24,
  text_of_node = text_of }
local LONGEST = 80 -- bytes of the data of an event

-- Control characters are escaped, so that a text takes one line.
local function escape_control(character) return ("\\%d"):format(character:byte()) end

local ESCAPES = setmetatable({ ["\n"] = "\\n", ['"'] = '\\"', ["\\"] = "\\\\" },
  { __index = function(_, character) return escape_control(character) end })

local to_text

-- Returns the text of a value that is not looked into.
local function plain_text(value, style)
  if rfsm.is_node(value) then return style.text_of_node(value) end
  if not style.most then return text_of(value) end
  if value ~= value then return "nan" end
  if type(value) == "table" and not getmetatable(value) then return "{..}" end
  return rfsm.event_text(value)
end

-- Returns a text in quotes, cut behind its first `most` bytes, between characters.
local function quoted(text, most)
  local rest = #text > most and ".." or ""
  if rest ~= "" then
    text = text:sub(1, most):gsub("[\194-\244]?[\128-\191]*$", "")
  end
  return '"' .. text:gsub('[%c"\\]', ESCAPES) .. rest .. '"'
end

-- Returns the key of a field, and what is between the key and the value.
local function key_to_text(key, style, seen, level)
  local is_name = type(key) == "string" and key:find("^[%a_][%w_]*$")
  return (is_name and key or "[" .. to_text(key, style, seen, level) .. "]")
    .. style.equals
end

-- Returns the contents of a table as a text: {"a","b",x=1}, without the key `hidden`.
local function table_to_text(t, style, seen, level, hidden)
  local texts, length = {}, 0
  while length < FIELDS and t[length + 1] ~= nil do
    length = length + 1
    texts[length] = to_text(t[length], style, seen, level)
  end
  local keys = t[length + 1] == nil and rfsm.sorted_keys(t, function(_, key)
    return key ~= hidden
      and not (type(key) == "number" and key >= 1 and key <= length and key % 1 == 0)
  end) or { length + 1 }
  for i = 1, #keys do
    if #texts == FIELDS then
      texts[FIELDS + 1] = "..."
      break
    end
    texts[#texts + 1] = key_to_text(keys[i], style, seen, level)
      .. to_text(t[keys[i]], style, seen, level)
  end
  return texts[1] and style.open .. concat(texts, style.comma) .. style.close or "{}"
end

-- Returns a value as a text. `level` is the number of tables around it; a string in a
-- table is in quotes. `seen` is the set of the tables that have been written.
function to_text(value, style, seen, level)
  if type(value) == "string" and level > 0 then
    return quoted(value, style.most or #value)
  elseif type(value) ~= "table" or seen[value] or getmetatable(value)
    or level == LEVELS then
    return plain_text(value, style)
  end
  seen[value] = true
  return table_to_text(value, style, seen, level + 1)
end

--- Return a value as a text for a person: `{ "a", x = { y = 2 } }`.
--
-- At most three tables inside each other are written, twenty fields of each, and each
-- table once; `table: 0x...` stands for the others. Keys are in a fixed order.
--
---@param value any
---@return string text
---@nodiscard
function rfsmpp.value_text(value) return to_text(value, PERSON, {}, 0) end

--- Return an event that is a plain table in short: `e_paid{amount=12,by={id=3}}`.
--
-- The data have at most 80 bytes. What does not fit becomes `..`, as do tables that
-- were written before. An event without a name is `{ 1, 2 }`.
--
---@param event table
---@param name string|false the field `name` of the event
---@return string text
---@nodiscard
function rfsmpp.short_text(event, name)
  local style = name and SHORT or NAMELESS
  local text = table_to_text(event, style, { [event] = true }, 1, name and "name")
  if #text > LONGEST then
    local kept = text:sub(1, LONGEST - 4):match("^(.*),")
    text = kept and kept .. style.comma .. ".." .. style.close or "{..}"
  end
  return (name or "") .. text
end

-- Returns an argument of a record as a text.
local function argument_text(value) return to_text(value, RECORD, {}, 0) end

-- The records whose arguments are events.
local OF_EVENTS = { RAISED = true, DEFERRED = true, RECALLED = true }

-- Returns an event as a text; one with data as all tools show it.
local function event_text(event)
  local name = rfsm.name_with_data(event)
  return name and rfsmpp.short_text(event, name) or argument_text(event)
end

-- Trace: one record, one line ---------------------------------------------------

local function prefix_of(is_coloured, name)
  return name and paint(is_coloured, NAME, argument_text(name) .. ":") .. "\t" or ""
end

local function line_of(is_coloured, prefix, id, ...)
  local padded, texts = ("%-20s"):format(argument_text(id)), {}
  local to_line = OF_EVENTS[id] and event_text or argument_text
  for i = 1, select("#", ...) do texts[i] = to_line((select(i, ...))) end
  return prefix .. paint(is_coloured, ID[id], padded) .. concat(texts, " ")
end

--- Make the line of one trace record.
--
-- @usage
--    rfsmpp.dbgcolorize("arm", "STATE_ENTER", "root.moving")
--
---@param name? string name of the machine
---@param id string id of the record
---@param ... any arguments of the record; the line shows the contents of tables
---@return string line
function rfsmpp.dbgcolorize(name, id, ...)
  local is_coloured = is_colour_wanted()
  return line_of(is_coloured, prefix_of(is_coloured, name), id, ...)
end

--- Print the line of one trace record.
---@param name? string name of the machine
---@param id string id of the record
---@param ... any its arguments
function rfsmpp.dbgcolor(name, id, ...)
  rawget(_G, "print")(rfsmpp.dbgcolorize(name, id, ...))
end

local function check_arguments(ids, print_fn)
  if ids ~= nil and type(ids) ~= "table" then
    error("rfsmpp.gen_dbgcolor: table of ids expected, got " .. type(ids), 3)
  end
  if print_fn ~= nil and not rfsm.is_callable(print_fn) then
    error("rfsmpp.gen_dbgcolor: function expected, got " .. type(print_fn), 3)
  end
end

--- Make a `dbg` function for a machine.
--
-- Whether the function prints in colour is decided here, not at each call.
--
-- @usage
--    fsm.dbg = rfsmpp.gen_dbgcolor("arm", { STATE_ENTER = true }, false)
--
-- @raise if `ids` is no table or `print_fn` cannot be called
---@param name? string name of the machine, in front of each line
---@param ids? table<string, boolean> by id of a record: true to print it, false to omit
---@param defshow? boolean print all records whose id is not in `ids`? default true
---@param print_fn? fun(line: string) default print
---@return fun(id: string, ...) dbg
---@nodiscard
function rfsmpp.gen_dbgcolor(name, ids, defshow, print_fn)
  check_arguments(ids, print_fn)
  if defshow == nil then defshow = true end
  local is_coloured = is_colour_wanted()
  local prefix = prefix_of(is_coloured, name or "<unnamed SM>")
  ids = ids or {}
  return function(id, ...)
    local is_shown = ids[id]
    if is_shown == nil then is_shown = defshow end
    if not is_shown then return end
    (print_fn or rawget(_G, "print"))(line_of(is_coloured, prefix, id, ...))
  end
end

-- States: one a line, indented as they are nested ----------------------------------

-- Returns the name of a state, in the colour of its mode, or with the mode as a word.
local function state_text(state, letters, is_coloured)
  local name, mode = state._id:gsub("%c", escape_control), rfsm.get_sta_mode(state)
  local is_active_leaf = mode == "active" and rfsm.is_leaf(state)
  local colour = is_active_leaf and ACTIVE_LEAF or MODE[mode]
  return paint(is_coloured, colour, name) .. letters
    .. (is_coloured and "" or " " .. mode) .. "\n"
end

local function add_states(lines, parent, depth, is_coloured)
  rfsm.mapfsm(function(state)
    if state == parent then return end -- `mapfsm` passes the machine itself, too
    lines[#lines + 1] = ("    "):rep(depth) .. state_text(state,
      "[" .. rfsm.fsmobj_tochar(state) .. "]", is_coloured)
    add_states(lines, state, depth + 1, is_coloured)
  end, parent, rfsm.is_state, 1)
end

--- Draw the states of a machine as a tree, one state per line.
--
-- Active states are green, the active leaf bright, done ones yellow, inactive ones red.
-- Without colour the mode follows as a word: `hello[LS] done`.
--
-- @raise if `fsm` was not initialised
---@param fsm rfsm.Machine
---@param depth? integer levels by which the states in the root are indented, default 1
---@return string tree
---@nodiscard
function rfsmpp.fsm2str(fsm, depth)
  rfsm.check_machine(fsm, "rfsmpp.fsm2str")
  local is_coloured = is_colour_wanted()
  local lines = { state_text(fsm, "", is_coloured) }
  add_states(lines, fsm, depth or 1, is_coloured)
  return concat(lines)
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsmpp", rfsmpp) end

return rfsmpp
