--- Loads chart files for the tools. Undefined globals are reported as warnings, and a
--- failure is reported in one line.
--
-- Charts written for the original rFSM use the globals `rfsmpp`, `rfsm_ext` and
-- `rfsm_timeevent` without requiring them, because the tools of rFSM loaded these
-- modules. This module does the same.
--
-- @module rfsm.shared.chart
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local load_file = rfsm.load -- before `search` replaces it
local calls = require "rfsm.shared.calls"
local limit = require "rfsm.shared.limit"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"
local search = require "rfsm.shared.search"
local stubs = require "rfsm.shared.stubs"
local writes = require "rfsm.shared.writes"

local error, getmetatable, io, ipairs, next = error, getmetatable, io, ipairs, next
local os, pcall, rawget, rawset = os, pcall, rawget, rawset
local setmetatable, type = setmetatable, type
local concat = table.concat
local getinfo = rawget(_G, "debug") and rawget(_G, "debug").getinfo

local chart = {}

--- Return the name of a chart's file in messages; `-` is stdin.
function chart.name_of(file) return file == "-" and "stdin" or file end

--- Return the text of a problem with its file in front, unless it begins with a
-- location. A `kind` such as "warning: " is put behind the location.
function chart.line(file, text, kind)
  local name = chart.name_of(file)
  local place, rest = text:match("^(%S+:%d+: )(.*)$")
  if text:sub(1, #name) == name then -- the name may have blanks
    place, rest = text:match("^(:%d+: )(.*)$", #name + 1)
    place = place and name .. place
  end
  if not place then place, rest = name .. ": ", text end
  return place .. (kind or "") .. rest
end

local NO_ERROR = "<no error object>" -- what `pcall` returns for error(nil) in Lua 5.5

--- Return the first line of a failure, without a traceback or list of paths behind it.
function chart.first_line(failure)
  local text = rfsm.text_of(failure)
  return ((text:match("[^\n]+") or text):gsub(":%s*$", ""))
end

-- Mistakes of syntax, and what is meant most often.
local SYNTAX = {
  { "near 'end'$", " (one too many? the name of a state is written [\"end\"])" },
  { "'}' expected.* near '[%a_]", " (is a comma missing in front of it?)" },
}

-- Returns a hint if an error text is about a mistake of syntax, or about the call of a
-- function that the library does not have; otherwise the empty text.
local function hint_for(text)
  for _, case in ipairs(SYNTAX) do if text:find(case[1]) then return case[2] end end
  local name = text:match("call a nil value %(field '(.-)'%)$")
    or text:match("call field '(.-)' %(a nil value%)$")
  if not name or rfsm[name] ~= nil then return "" end
  return rfsm.find_module("rfsm.advice").function_meant(name)
end

--- Return the reason why a chart cannot be used, in one line with its file; for a
-- system (`rfsm.system`) one line for each problem.
function chart.reason(file, failure)
  local problems = calls.problems_of(failure)
  if problems then return concat(problems, "\n") end
  local text = chart.first_line(failure)
  if failure == nil or text == "" or text == NO_ERROR then
    text = "failed without a message"
  end
  if text:find("^%a+: 0x") then text = "failed with a " .. type(failure) end
  text = text:gsub("^rfsm%.json: ", ""):gsub("^rfsm%.load[_str]*: ", "")
    :gsub("^failed to load chunk: ", ""):gsub("^rfsm%.%l+%.encode: ", "")
    :gsub("^rfsm%.dot%.layout: ", ""):gsub("'=stdin'", "stdin")
  text = text .. hint_for(text)
  if text:find(chart.name_of(file), 1, true) then return text end
  return chart.name_of(file) .. ": " .. text
end

-- Patterns of expressions that test if a global exists.
local QUESTIONS = {
  "not%s+NAME%s*%f[^%w_%s:.%[(]", "not%s+NAME%s+%w", "NAME%s*[~=]=%s*nil",
  "NAME%s+and%f[%W]", "NAME%s+or%f[%W]", "NAME%s+then%f[%W]",
}

-- Does a line of a file test if a global exists? The program that loads the chart later
-- may define such a global.
local function is_asked(file, line, name)
  local handle, number = io.open(file), 0
  for text in handle and handle:lines() or function() end do
    number = number + 1
    for _, pattern in ipairs(number == line and QUESTIONS or {}) do
      if text:find("%f[%w_]" .. pattern:gsub("NAME", name)) then return true end
    end
  end
  return false
end

-- The modules for the globals that charts use without requiring them.
local GIVEN = {
  rfsmpp = "rfsmpp", rfsm_ext = "rfsm.monitor", rfsm_timeevent = "rfsm_timeevent",
}

local function find_given(name)
  local ok, module = calls.try(rfsm.find_module, GIVEN[name])
  return ok and module or nil
end

-- Globals: warnings and stubs for undefined ones -------------------------------------

-- Returns the warning about an undefined global; nil if the code tests if it exists.
local function warning_of(name, reader)
  local file, line = reader.source:match("^@(.*)"), reader.currentline
  if file and is_asked(file, line, name) then return nil end
  return ("%s:%d: warning: undefined global '%s'%s"):format(file or "stdin", line, name,
    name:find("^e_") and " (an event is a string, in quotes)"
      or " (nil while the chart is loaded)")
end

-- Returns a function for `__index` of _G, called if the chart reads an undefined
-- global. A name such as e_go is an event whose quotes were forgotten: it gets no stub.
local function new_index(world, warnings)
  local is_known = {}
  local function note(name, reader)
    if reader.source ~= world.source or is_known[name] then return end
    is_known[name] = true
    warnings[#warnings + 1] = warning_of(name, reader)
  end
  return function(_, name)
    local module = GIVEN[name] and find_given(name)
    if module then return module end
    local reader = type(name) == "string" and getinfo(2, "Sl")
    if not reader or search.world_of(reader.source) ~= world then return nil end
    if world.has_stubs and not name:find("^e_") then
      local is_wanted = world.insists or warning_of(name, reader) -- no test for it
      return is_wanted and search.stub(world, name) or nil
    end
    note(name, reader)
  end
end

local stub_class = nil -- the metatable that _G has as long as stubs are in use

-- Calls f(...) while undefined globals are noted. With stubs the metatable of _G stays,
-- since callbacks read stubs later. Returns the results of pcall.
local function with_notes(world, warnings, f, ...)
  if getmetatable(_G) == stub_class then setmetatable(_G, nil) end
  if not getinfo or getmetatable(_G) then return pcall(f, ...) end
  local index = new_index(world, warnings)
  local class = { __index = index }
  setmetatable(_G, class)
  local ok, model = pcall(f, ...)
  if world.has_stubs then
    stub_class = class
    return ok, model
  end
  class.__index = class.__index ~= index and class.__index or nil -- set by the chart
  if getmetatable(_G) == class and not next(class) then setmetatable(_G, nil) end
  return ok, model
end

-- Bounds: what must not happen while a chart is loaded ---------------------------

local function refuse_exit() error("os.exit is called while the chart is loaded", 2) end

-- Returns load(file). A call of `os.exit` by the file raises an error, and the loading
-- is stopped if it takes too long.
local function within_bounds(world, load, file)
  local exit = os.exit
  if not world.has_stubs then rawset(os, "exit", refuse_exit) end
  local ok, model, is_late = limit.load(load, file, { os.time, os.clock },
    search.world_of)
  rawset(os, "exit", exit)
  world.is_late = is_late or false
  return ok and model or error(model, 0)
end

-- Programs: files that make machines, and return no state --------------------------

local HALT = {} -- the error value by which the loading of a program is stopped

local function halt(world)
  world.is_halted = true
  error(HALT, 0)
end

-- Returns init(model), but prints nothing, since the tool reports the problems later.
local function init_silently(init, model)
  if not rfsm.is_state(model) then return init(model) end
  return calls.silently(init, model)
end

local NO_STATE = "no valid rfsm in" -- text in an error of `rfsm.load`

-- Makes a machine, and notes its model unless the machine is a region (`depth` above
-- 0). If the model has problems, the loading is stopped.
local function note_machine(world, depth, init, model)
  world.depth = depth + 1
  local fsm, text, problems = calls.finally(function() world.depth = depth end,
    init_silently, init, model)
  if depth > 0 then return fsm, text, problems end
  local number = #world.models + 1
  world.models[number] = rfsm.model_of(model)
  if not fsm then halt(world) end
  world.places[number] = location.split(rfsm.location_of(fsm)):gsub(": $", "")
  world.is_made[fsm] = true
  return fsm, text, problems
end

-- Loads a file, and notes the machines that it makes. The first step of one of them
-- stops the loading. `rfsm.init`, `step` and `run` are replaced meanwhile. As a module
-- may keep a replacement, replacements test `is_loading`.
local function noting_machines(world, load, file)
  local init, plain = rfsm.init, { step = rfsm.step, run = rfsm.run }
  local is_loading = true
  rawset(rfsm, "init", function(model)
    if not is_loading or calls.is_apart then return init(model) end
    return note_machine(world, world.depth, init, model)
  end)
  for name, f in order.each(plain) do -- any order: each stands alone
    rawset(rfsm, name, function(fsm, ...)
      if is_loading and world.is_made[fsm or world] then halt(world) end
      return f(fsm, ...)
    end)
  end
  return calls.finally(function()
    is_loading = false
    for name, f in order.each(plain) do rawset(rfsm, name, f) end -- any order
    rawset(rfsm, "init", init)
  end, within_bounds, world, load, file)
end

-- Returns the lines of the models: "chart.lua:7, chart.lua:12".
local function places_of(world)
  local texts = {}
  for i in ipairs(world.models) do texts[i] = world.places[i] or "with problems" end
  return concat(texts, ", ")
end

-- Returns the results of loading. If the file is a program that made machines and
-- returned no state, or if a number is given, the model of a machine is returned.
local function chosen_model(file, world, ok, model)
  local is_program = world.models[1] and not ok
    and (world.is_halted or rfsm.text_of(model):find(NO_STATE, 1, true))
  local number = world.number or 1
  if not (is_program or ok and world.number) then
    world.models = {} -- the file returned a chart, whose regions are these machines
    return ok, model
  end
  if world.models[number] then return true, world.models[number] end
  return false, ("%s: no machine %d, it makes %d%s"):format(chart.name_of(file), number,
    #world.models, world.models[1] and " (" .. places_of(world) .. ")" or "")
end

local function load_stdin() -- without a first line for the shell (#!)
  local text = io.read("*a"):gsub("^#[^\n]*", "")
  writes.keep_text("=stdin", text)
  return rfsm.load_str(text, "=stdin")
end

-- Tries to load the model in a file. With `insists`, an undefined global is a stub even
-- where the code tests if it exists.
local function try_load(file, has_stubs, number, load, insists)
  local warnings, source = {}, file == "-" and "=stdin" or "@" .. file
  local world = search.enter(file, source, has_stubs)
  world.insists, world.number = insists or false, number
  if file == "-" then load = load_stdin end
  local ok, model = chosen_model(file, world, with_notes(world, warnings,
    noting_machines, world, load, file))
  search.leave()
  return ok, model, warnings, world
end

--- Load the model in a file; `-` is stdin. With `has_stubs`, modules and globals that
-- do not exist are replaced by stubs.
--
-- A chart that reads the global `rfsm_timeevent` switches time events on. If the file
-- is a program that returns no state, the model of the first machine that it makes is
-- returned, or the model of machine `number`.
--
---@param file string
---@param has_stubs? boolean
---@param number? integer
---@param load? fun(file: string): any in place of `rfsm.load`
---@return any model a state, or what `load` returns; nil if there is none
---@return string[]|string warnings a line for each undefined global; the problem if
-- `model` is nil
---@return rfsm.shared.World world its field `names` lists the stubs
function chart.load(file, has_stubs, number, load)
  load = load or load_file
  find_given("rfsmpp") -- callbacks may use both modules; loading them is harmless
  find_given("rfsm_ext")
  local ok, model, warnings, world = try_load(file, has_stubs, number, load)
  if not (ok or world.is_late) and has_stubs and file ~= "-" then
    local is_better, other, more, other_world = try_load(file, true, number, load, true)
    if is_better then ok, model, warnings, world = true, other, more, other_world end
  end
  if ok and has_stubs and rfsm.is_state(model) then stubs.complete(model) end
  if ok then return model, warnings, world end
  return nil, chart.reason(file, model), world
end

--- Return lines for the user: the names of the stubs of a chart, and the machines of a
-- program that makes several.
---@return string[] lines
function chart.lines_of(file, world)
  local lines, models = {}, world.models
  if world.names[1] then
    lines[1] = chart.line(file, "stubbed: " .. concat(world.names, ", "))
  end
  if models[2] then
    lines[#lines + 1] = chart.line(file, ("machine %d of %d (%s); --machine N takes "
      .. "another"):format(world.number or 1, #models, places_of(world)))
  end
  return lines
end

--- Make the machine of the chart in a file by `init`, a function such as `rfsm.init`.
-- Return the machine and the model, or false and a list of problems. `warn` is called
-- with a line for each undefined global, and for the stubs. `load` is passed on to
-- `chart.load`.
function chart.open(file, init, warn, has_stubs, load)
  local model, warnings, world = chart.load(file, has_stubs, nil, load)
  if not model then return false, { warnings } end
  for _, line in ipairs(warnings) do warn(line) end
  for _, line in ipairs(chart.lines_of(file, world)) do warn(line) end
  local ok, fsm, _, problems = pcall(init, model)
  if not ok then return false, { chart.reason(file, fsm) } end
  if fsm then return fsm, model end
  for i, text in ipairs(problems) do problems[i] = chart.line(file, text) end
  return false, problems
end

return chart
