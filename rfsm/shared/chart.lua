--- Chart files for the tools: loaded with a watch on globals, failures in one line.
--
-- Charts written for rFSM use the globals `rfsmpp`, `rfsm_ext` and `rfsm_timeevent`
-- without requiring them, because its tools loaded them. Here they find them, too.
--
-- @module rfsm.shared.chart
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local getmetatable, io, ipairs, next = getmetatable, io, ipairs, next
local pcall, rawget, require = pcall, rawget, require
local setmetatable, type = setmetatable, type
local getinfo = rawget(_G, "debug") and rawget(_G, "debug").getinfo

local chart = {}

--- Return the name of a chart's file in messages; `-` is stdin.
---@param file string
---@return string name
function chart.name_of(file) return file == "-" and "stdin" or file end

--- Return a problem with its file in front, unless it begins with a location.
---@param file string
---@param text string
---@param kind? string such as "warning: ", to stand behind the location
---@return string line
function chart.line(file, text, kind)
  local name = chart.name_of(file)
  local location, rest = text:match("^(%S+:%d+: )(.*)$")
  if text:sub(1, #name) == name then -- may have blanks
    location, rest = text:match("^(:%d+: )(.*)$", #name + 1)
    location = location and name .. location
  end
  if not location then location, rest = name .. ": ", text end
  return location .. (kind or "") .. rest
end

local NO_ERROR = "<no error object>" -- in place of nil, since 5.5

--- Return the first line of a failure; a traceback or a list of paths may follow it.
---@param failure any
---@return string line
function chart.first_line(failure)
  local text = rfsm.text_of(failure)
  return ((text:match("[^\n]+") or text):gsub(":%s*$", ""))
end

--- Return why a chart cannot be used, in one line with its file.
---@param file string
---@param failure any
---@return string line
function chart.reason(file, failure)
  local text = chart.first_line(failure)
  if failure == nil or text == "" or text == NO_ERROR then
    text = "failed without a message"
  end
  if text:find("^%a+: 0x") then text = "failed with a " .. type(failure) end
  text = text:gsub("^rfsm%.json: ", ""):gsub("^rfsm%.load[_str]*: ", "")
    :gsub("^failed to load chunk: ", ""):gsub("^rfsm%.%l+%.encode: ", "")
    :gsub("'=stdin'", "stdin")
  if text:find(chart.name_of(file), 1, true) then return text end
  return chart.name_of(file) .. ": " .. text
end

-- What stands around a global whose existence is asked for.
local QUESTIONS = {
  "not%s+NAME%f[^%w_]", "NAME%s*[~=]=%s*nil", "NAME%s+and%f[%W]", "NAME%s+or%f[%W]",
  "NAME%s+then%f[%W]",
}

-- Does a line of a file ask whether a global exists? Then the host may define it.
local function is_asked(file, line, name)
  if file == "-" then return false end
  local number = 0
  for text in io.lines(file) do
    number = number + 1
    for _, pattern in ipairs(number == line and QUESTIONS or {}) do
      if text:find("%f[%w_]" .. pattern:gsub("NAME", name)) then return true end
    end
  end
  return false
end

-- The modules of globals that a chart may expect.
local GIVEN = {
  rfsmpp = "rfsmpp", rfsm_ext = "rfsm.monitor", rfsm_timeevent = "rfsm_timeevent",
}

local function find_given(name)
  local ok, module = pcall(require, GIVEN[name])
  return ok and module or nil
end

-- Calls f(...), and calls note(name, line) for each global that `source` reads and that
-- does not exist. Returns what pcall does.
local function with_watch(source, note, f, ...)
  if not getinfo or getmetatable(_G) then return pcall(f, ...) end
  local function watch(_, name)
    local module = GIVEN[name] and find_given(name)
    if module then return module end
    local reader = getinfo(2, "Sl")
    if reader and reader.source == source then note(name, reader.currentline) end
  end
  local class = { __index = watch }
  setmetatable(_G, class)
  local ok, model = pcall(f, ...)
  class.__index = class.__index ~= watch and class.__index or nil -- a chart's own
  if getmetatable(_G) == class and not next(class) then setmetatable(_G, nil) end
  return ok, model
end

-- A first line for the shell (#!) is none of Lua's business.
local function load_stdin()
  local text = io.read("*a"):gsub("^#[^\n]*", "")
  return rfsm.load_str(text, "=stdin")
end

--- Load the model in a file; `-` is stdin.
--
-- A chart that reads the global `rfsm_timeevent` switches time events on.
--
---@param file string
---@return rfsm.State? model nil if there is none
---@return string[]|string warnings a line for each undefined global; or the problem
function chart.load(file)
  local warnings, is_known = {}, {}
  local load, source = rfsm.load, "@" .. file
  if file == "-" then load, source = load_stdin, "=stdin" end
  find_given("rfsmpp") -- for callbacks; these two change no machines
  find_given("rfsm_ext")
  local ok, model = with_watch(source, function(name, line)
    if is_known[name] or type(name) ~= "string" then return end
    is_known[name] = true
    if is_asked(file, line, name) then return end
    warnings[#warnings + 1] = ("%s:%d: warning: undefined global '%s'%s"):format(
      chart.name_of(file), line, name,
      name:find("^e_") and " (an event is a string, in quotes)" or "")
  end, load, file)
  if ok then return model, warnings end
  return nil, chart.reason(file, model)
end

--- Make the machine of the chart in a file.
---@param file string
---@param init fun(model: rfsm.State): rfsm.Machine|false, string?, string[]?
---@param warn fun(line: string) called for each undefined global
---@return rfsm.Machine|false fsm
---@return rfsm.State|string[] model or the problems, a line each
function chart.open(file, init, warn)
  local model, warnings = chart.load(file)
  if not model then return false, { warnings } end
  for _, line in ipairs(warnings) do warn(line) end
  local ok, fsm, _, problems = pcall(init, model)
  if not ok then return false, { chart.reason(file, fsm) } end
  if fsm then return fsm, model end
  for i, text in ipairs(problems) do problems[i] = chart.line(file, text) end
  return false, problems
end

return chart
