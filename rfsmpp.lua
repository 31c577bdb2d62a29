--- A machine and its trace as text, in colour.
--
-- `rfsmpp.gen_dbgcolor` makes a `dbg` function for a machine; `rfsmpp.fsm2str` draws
-- its states. Colours come from the package `ansicolors`. Without it, when the output
-- is no terminal, or when NO_COLOR is set, the text is plain; a print function that is
-- handed in gets colour whatever the output is.
--
-- @module rfsmpp
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, getmetatable, pcall, rawget = error, getmetatable, pcall, rawget
local require, select, tostring, type = require, select, tostring, type
local concat = table.concat

local rfsmpp = {}

-- Colours: escape sequences by name ---------------------------------------------

local has_ansicolors, ansicolors = pcall(require, "ansicolors")

local function escape(names)
  return has_ansicolors and ansicolors.noReset("%{" .. names .. "}") or ""
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
  active_leaf = escape("green bright"),
}

-- Asks what can be asked: luaposix, LuaJIT's C calls, or the shell.
local function is_stdout_terminal()
  local has_unistd, unistd = pcall(require, "posix.unistd")
  if has_unistd and unistd.isatty then return unistd.isatty(1) == 1 end
  local os = rawget(_G, "os")
  local status = os and os.execute and os.execute("test -t 1 2>/dev/null")
  return status == true or status == 0
end

-- Should text for stdout be in colour? Asked at each use: NO_COLOR may change; the
-- terminal does not.
local is_terminal
local function wants_colour()
  local getenv = rawget(_G, "os") and os.getenv
  if not (has_ansicolors and getenv) then return false end
  if (getenv("NO_COLOR") or "") ~= "" then return false end
  local term = getenv("TERM")
  if not term or term == "dumb" then return false end
  if is_terminal == nil then is_terminal = is_stdout_terminal() end
  return is_terminal
end

local function paint(is_coloured, colour, text)
  if not is_coloured or not colour or colour == "" then return text end
  return colour .. text .. RESET
end

-- Trace: one record, one line ---------------------------------------------------

local function text_of(value)
  if type(value) == "number" then return ("%.14g"):format(value) end
  local ok, text = pcall(tostring, value)
  return ok and type(text) == "string" and text or type(value)
end

local function line_of(is_coloured, name, id, ...)
  local id_text = text_of(id)
  local parts = { paint(is_coloured, NAME, text_of(name)) .. ":\t"
    .. paint(is_coloured, ID[id], id_text .. (" "):rep(20 - #id_text)) }
  for i = 1, select("#", ...) do parts[i + 1] = text_of((select(i, ...))) end
  return concat(parts, " ")
end

--- Make the line of one trace record.
--
-- @usage
--    rfsmpp.dbgcolorize("arm", "STATE_ENTER", "root.moving")
--
---@param name string name of the machine
---@param id string id of the record
---@param ... any its arguments
---@return string line in colour, when stdout wants it
function rfsmpp.dbgcolorize(name, id, ...)
  return line_of(wants_colour(), name, id, ...)
end

--- Print the line of one trace record.
---@param name string name of the machine
---@param id string id of the record
---@param ... any its arguments
function rfsmpp.dbgcolor(name, id, ...)
  rawget(_G, "print")(rfsmpp.dbgcolorize(name, id, ...))
end

local function is_function(value)
  if type(value) == "function" then return true end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") ~= nil
end

local function check_arguments(ids, print_fn)
  if ids ~= nil and type(ids) ~= "table" then
    error("rfsmpp.gen_dbgcolor: table of ids expected, got " .. type(ids), 3)
  end
  if print_fn ~= nil and not is_function(print_fn) then
    error("rfsmpp.gen_dbgcolor: function expected, got " .. type(print_fn), 3)
  end
end

--- Make a `dbg` function for a machine.
--
-- @usage
--    fsm.dbg = rfsmpp.gen_dbgcolor("arm", { STATE_ENTER = true }, false)
--
-- @raise when `ids` is no table or `print_fn` cannot be called
---@param name? string name of the machine, in front of each line
---@param ids? table<string, boolean> which ids to print, and which not
---@param defshow? boolean print those that `ids` does not mention? default true
---@param print_fn? fun(line: string) default print; one handed in gets colour
---@return fun(id: string, ...) dbg
---@nodiscard
function rfsmpp.gen_dbgcolor(name, ids, defshow, print_fn)
  check_arguments(ids, print_fn)
  name, ids = name or "rfsm", ids or {}
  if defshow == nil then defshow = true end
  return function(id, ...)
    local is_wanted = ids[id]
    if is_wanted == nil then is_wanted = defshow end
    if not is_wanted then return end
    local is_coloured = print_fn ~= nil and has_ansicolors or wants_colour()
    local line = line_of(is_coloured, name, id, ...)
    if print_fn then print_fn(line) else rawget(_G, "print")(line) end
  end
end

-- States: one a line, indented as they are nested ----------------------------------

-- A name is one line, whatever is in it.
local function escape_control(character) return ("\\%d"):format(character:byte()) end

local function state_line(fsm, state, name, is_coloured, depth, indent)
  name = name:gsub("%c", escape_control)
  local mode = rfsm.get_sta_mode(state)
  local is_active_leaf = mode == "active" and fsm._act_leaf == state
  local colour = MODE[is_active_leaf and "active_leaf" or mode]
  return indent .. ("  "):rep(depth) .. paint(is_coloured, colour, name) .. "["
    .. rfsm.fsmobj_tochar(state) .. "]" .. (is_coloured and "" or " " .. mode)
end

local function add_lines(lines, fsm, state, is_coloured, depth, indent)
  rfsm.mapfsm(function(child, _, name)
    lines[#lines + 1] = state_line(fsm, child, name, is_coloured, depth, indent)
    add_lines(lines, fsm, child, is_coloured, depth + 1, indent)
  end, state, rfsm.is_state, 1)
end

--- Draw the states of a machine as a tree.
--
-- Active states are green, the active leaf bright, done ones yellow, inactive ones red.
-- Without colour the mode follows as a word: `hello[LS] done`.
--
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@param indent? string in front of each line
---@return string tree one state a line
---@nodiscard
function rfsmpp.fsm2str(fsm, indent)
  if not rfsm.is_initialized_root(fsm) then
    error("rfsmpp.fsm2str: initialised fsm expected, got " .. type(fsm), 2)
  end
  local is_coloured = wants_colour()
  indent = indent or ""
  local lines = { state_line(fsm, fsm, "root", is_coloured, 0, indent) }
  add_lines(lines, fsm, fsm, is_coloured, 1, indent)
  return concat(lines, "\n")
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsmpp", rfsmpp) end

return rfsmpp
