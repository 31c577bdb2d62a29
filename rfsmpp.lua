--- A machine and its trace as text, in colour.
--
-- `rfsmpp.gen_dbgcolor` makes a `dbg` function for a machine. `rfsmpp.fsm2str` draws
-- the states. Colours come from the package `ansicolors`, or from the older module of
-- that name. If there is neither, if NO_COLOR is set, if TERM is missing or "dumb", or
-- if `rfsmpp.is_plain` is true, the text is plain.
--
-- @module rfsmpp
-- @license BSD-3-Clause

local home = tostring((...)):match("^(.+[./])rfsmpp$") -- "libs."
if home then require(home .. "rfsm") return require "rfsmpp" end -- one copy

local rfsm = require "rfsm"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local pcall, rawget, rawset, require = pcall, rawget, rawset, require
local select, tostring, type = select, tostring, type
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

-- Trace: one record, one line ---------------------------------------------------

local to_text

-- Returns the contents of a table as a text: {"a","b",x=1}. `open` is the set of the
-- tables that contain this table.
local function table_to_text(t, open)
  local texts, length = {}, 0
  for i, key in ipairs(rfsm.sorted_keys(t)) do
    texts[i] = to_text(t[key], open)
    if key == length + 1 then
      length = key
    elseif type(key) == "string" and key:find("^[%a_][%w_]*$") then
      texts[i] = key .. "=" .. texts[i]
    else
      texts[i] = "[" .. to_text(key, open) .. "]=" .. texts[i]
    end
  end
  return "{" .. concat(texts, ",") .. "}"
end

-- Returns a value as a text. If `open` is given, the value is in a table, and a string
-- is put in quotes; otherwise it is an argument of a record.
function to_text(value, open)
  if type(value) == "string" and open then
    return '"' .. value:gsub('"', '\\"'):gsub("\n", "\\n") .. '"'
  elseif type(value) ~= "table" or open and open[value] then
    return text_of(value)
  elseif getmetatable(value) then
    return rfsm.is_node(value) and value._fqn or text_of(value)
  end
  open = open or {}
  open[value] = true
  local text = table_to_text(value, open)
  open[value] = nil
  return text
end

local function prefix_of(is_coloured, name)
  return name and paint(is_coloured, NAME, to_text(name) .. ":") .. "\t" or ""
end

local function line_of(is_coloured, prefix, id, ...)
  local padded, texts = ("%-20s"):format(to_text(id)), {}
  for i = 1, select("#", ...) do texts[i] = to_text((select(i, ...))) end
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

-- Control characters are escaped, so that a name takes one line.
local function escape_control(character) return ("\\%d"):format(character:byte()) end

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
