--- Review: the command `rfsm check` reads settings, checks and explores a chart, and
-- prints the findings as lines.
--
-- @module rfsm.cli.review
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"
local chart = require "rfsm.shared.chart"
local files = require "rfsm.shared.files"
local exists = require("rfsm.shared.search").exists
local code = require "rfsm.shared.code"
local codes = require "rfsm.checks.codes"
local match = require "rfsm.shared.match"
local location = require "rfsm.shared.location"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local report = require "rfsm.system.report"
local sequence = require "rfsm.system.sequence"
local source = require "rfsm.checks.source"
local static = require "rfsm.checks.static"
local system = require "rfsm.system"
local verdict = require "rfsm.explore.verdict"

local error, io, ipairs = error, io, ipairs
local loadfile, os, pcall = loadfile, os, pcall
local getmetatable, package, pairs, rawget = getmetatable, package, pairs, rawget
local rawset, require, type = rawset, require, type
local concat = table.concat

local review = {}

local SETTINGS = ".rfsmcheck.lua"

-- Returns the name of the nearest file of settings. It is searched for in the folder of
-- a chart, then in its parent folders, up to the working directory or /. Returns nil if
-- there is no such file.
local function find_settings(file)
  local folder = file:match("^(.*/)") or ""
  while not exists(folder .. SETTINGS) do
    if folder == "" or folder == "/" then return nil end
    folder = folder:match("^(.*/)[^/]*/$") or ""
  end
  return folder .. SETTINGS
end

--- Load the settings for a chart, from the nearest `.rfsmcheck.lua`.
---@param file string file name of the chart
---@return table<string, string>? settings code -> severity; nil if a setting is wrong
---@return string? problem
function review.settings_for(file)
  local name = find_settings(file)
  if not name then return {} end
  local chunk, problem = loadfile(name)
  local ok, settings = pcall(chunk or error, problem, 0)
  if not ok then return nil, chart.reason(name, settings) end
  problem = codes.check_settings(settings)
  if problem then return nil, name .. ": " .. problem end
  return settings
end

-- Returns a finding as a line: "chart.lua:7: warning: root.a: text (hint) [code]".
local function line_of(file, finding)
  local kind = finding.severity ~= "error" and finding.severity .. ": " or ""
  local has_hint = finding.code ~= "invalid" and finding.code ~= "violated"
    and not finding.text:find("%)$")
  return chart.line(file, static.line(finding, has_hint), kind)
end

-- Returns the gravest severity of findings: "error" or "warning"; nil for notes only.
local function gravest_of(findings)
  local found = {}
  for _, finding in ipairs(findings) do found[finding.severity] = true end
  return found.error and "error" or found.warning and "warning" or nil
end

-- Explore .........................................................................

--- Return the name of the file with the declarations for a chart. For a.lua it is
--- a_properties.lua.
function review.properties_of(file)
  return file:gsub("%.lua$", "") .. "_properties.lua"
end

-- Names that a file of declarations for the chart `x.lua` may have by mistake.
local MISNAMED = { "x.properties.lua", "x-properties.lua", "xproperties.lua",
  "x_property.lua", "x_props.lua", "properties_x.lua", "properties.lua" }

-- Returns a warning of a file of declarations that is not read because of its name.
local function misnamed_beside(file)
  local name = review.properties_of(file)
  local folder, stem = file:match("^(.-)([^/]*)%.lua$")
  for _, other in ipairs(stem and not exists(name) and MISNAMED or {}) do
    other = folder .. other:gsub("%f[%w]x", (stem:gsub("%%", "%%%%")))
    if exists(other) and other ~= file then
      return ("%s: warning: %s is not read, its name would be %s"):format(
        chart.name_of(file), other, name)
    end
  end
end

-- Returns the table of declarations for a chart, which is empty if no file has them.
local function declared_for(file)
  local name = review.properties_of(file)
  if file == "-" or not exists(name) then return {} end
  local chunk, problem = loadfile(name)
  local declared = (chunk or error(problem, 0))()
  if type(declared) ~= "table" or rawget(declared, 1) ~= nil or getmetatable(declared)
  then
    error(("%s: table with the field 'properties' expected, got %s (return { "
      .. "properties = { ... } })"):format(name, type(declared) ~= "table"
      and type(declared) or getmetatable(declared) and "a property" or "a list"), 0)
  end
  return declared
end

-- The most configurations that are explored by default: of a chart, and of a system.
review.MANY = 10000
local MANY_TOGETHER = 100000

local real_stderr = io and io.stderr

-- Returns a function that shows the progress in one line; nil if stderr is no terminal.
local function progress_line()
  if not require("rfsm.sim.terminal").is_terminal(2) then return nil end
  return function(configurations, depth)
    real_stderr:write(("\r%d configurations, depth %d "):format(configurations, depth))
  end
end

-- Writes the run that shows a finding to a file.
local function write_witness(model, witness, name)
  if not system.is_system(model) then
    os.remove(name) -- or the recording would be appended to an older one
    return rfsm_checks.record_witness(model, witness, name)
  end
  local text = name:find("%.mmd") and sequence.mermaid(model.names, witness)
    or concat(sequence.lines_of(witness), "\n") .. "\n"
  local ok, problem = files.write(name, text)
  if not ok then error(problem, 0) end
end

-- Writes the runs that show findings to the files `name`, `name`.2, `name`.3. Sets the
-- field `record` of each such finding to the name of its file.
local function write_witnesses(model, findings, name)
  local count = 0
  for _, finding in ipairs(findings) do
    local witness = finding.witness or finding.run
    if witness and witness[1] then
      count = count + 1
      finding.record = count > 1 and name .. "." .. count or name
      write_witness(model, witness, finding.record)
    end
  end
end

-- Returns "7: " if line 7 of a text is the first line that contains a certain word: the
-- first name in quotes in the problem, or else the word with which the problem begins.
-- Returns an empty text if no line contains it.
local function line_with(text, problem)
  local wanted, number = problem:match("'(.-)'") or problem:match("^(%w+)") or "", 0
  for line in (text .. "\n"):gmatch("(.-)\n") do
    number = number + 1
    if wanted ~= "" and line:find(wanted, 1, true) then return number .. ": " end
  end
  return ""
end

-- Raises the failure of an exploration. If there is a file of declarations, it is taken
-- to be the cause: the name of the file and a line number are put in front.
local function refuse(name, failure)
  local text = type(failure) == "string" and files.read(name)
  local place, rest = rfsm.text_of(failure):match("^(%S+:%d+: )(.*)")
  if place then
    error(place .. rest:gsub("^rfsm[_%.]%l+%.explore: ", ""), 0)
  elseif not text then
    error(failure, 0)
  end
  local problem = failure:gsub("^rfsm[_%.]%l+%.explore: ", "")
  error(name .. ":" .. (line_with(text, problem):gsub("^$", " ")) .. problem, 0)
end

-- Calls explore(model, own). `own` is the table of declarations; options of the command
-- replace its bounds. By default at most `most` configurations are explored.
local function run_explore(file, model, own, options, explore, most)
  for _, name in ipairs { "together", "seconds", "configurations" } do
    if options[name] ~= nil then own[name] = options[name] end
  end
  own.configurations = own.configurations or most
  own.progress = progress_line()
  local ok, result = calls.try(explore, model, own)
  if not ok then refuse(review.properties_of(file), result) end
  if own.progress then real_stderr:write("\r\27[K") end
  return result
end

-- Returns the options for exploring one machine of a system: the declarations for its
-- chart, without the alphabet. A declaration of the system (`given`) takes precedence.
local function machine_options(cell, name, given)
  local fsm = static.init(cell.models[name], false)
  local chart_file = location.split(rfsm.location_of(fsm))
  local beside, own = declared_for((chart_file:gsub(":%d+: $", ""))), {}
  for _, field in ipairs(report.OF_MACHINE) do own[field] = beside[field] end
  own.alphabet = nil
  for field, value in pairs(given) do own[field] = value end -- any order: a copy
  return own
end

-- Explores a system with the declarations for the system and for each of its charts.
local function explore_system(file, cell, options)
  local own = declared_for(file)
  local machines = own.machines or {}
  for _, name in ipairs(type(machines) == "table" and cell.names or {}) do
    machines[name] = machine_options(cell, name, machines[name] or {})
  end
  own.machines = machines
  if options.no_overlap then own.overlap = false end
  return run_explore(file, cell, own, options, report.explore,
    MANY_TOGETHER)
end

-- The modules that `rfsm check` loads, so that events such as e_after(1) are known.
local EXTENSIONS = { "rfsm_timeevent", "rfsm.timeevent", "rfsm_await", "rfsm.await" }

--- Call a function that loads a chart, and note the extensions that the chart requires.
---@return table<string, true> required their names: "rfsm_timeevent", "rfsm_await"
---@return any ... the results of `f`
function review.noting_extensions(f, ...)
  local required, kept = {}, {}
  local loaded, preload = package.loaded, package.preload
  for _, name in ipairs(EXTENSIONS) do
    kept[name] = { require(name), rawget(_G, name) }
    preload[name] = function()
      required[name:gsub("%.", "_")] = true
      rawset(_G, name, kept[name][2])
      return kept[name][1]
    end
  end
  for name in pairs(kept) do -- any order: each is independent
    loaded[name] = nil
    rawset(_G, name, nil)
  end
  return required, calls.finally(function()
    for name, values in pairs(kept) do -- any order: each is independent
      loaded[name], preload[name] = values[1], nil
      rawset(_G, name, values[2])
    end
  end, f, ...)
end

-- Adds a finding for each event of an extension that the chart does not require. If the
-- file requires no module at all, its host does so, and the findings are notes.
local function add_missing_extensions(findings, fsm, required, file)
  local requires_any = code.of(files.read(file) or "require"):find(
    "%f[%w_]require%f[^%w_]")
  for entry, tr in location.each(fsm, rfsm.is_trans) do
    for _, event in ipairs(tr.events or {}) do
      local module = match.maker_of(event) and advice.module_for(event)
      if module and not required[module:gsub("%.", "_")] then
        local text = "the chart does not load the extension that knows '%s' "
          .. "(require %q)"
        local finding = findings:add("unknown-word", tr,
          location.path(tr, entry.prefix), text:format(event:gsub("@root.*$", ""),
          module), location.in_words(tr, entry.prefix))
        if finding and not requires_any then finding.severity = "note" end
      end
    end
  end
end

-- Returns all findings about a chart. The second result is the exploration, nil if the
-- chart was not explored.
local function find_all(file, model, settings, options)
  if system.is_system(model) then
    local result = not options.static and explore_system(file, model, options)
    local findings = result and result.findings or static.new_list()
    if options.deployed then
      require("rfsm.rtt.launch_system_deployed").check(model,
        require("rfsm.rtt.launch_system_files").read(options.deployed), findings)
    end
    return static.apply(findings, settings), result or nil
  elseif options.deployed then
    error("--deployed is for a system, not for a chart", 0)
  end
  local findings, fsm = static.collect(model, static.OF_FILES)
  if gravest_of(findings) == "error" then return static.apply(findings, settings) end
  add_missing_extensions(findings, fsm, options.required or {},
    file)
  if options.static then return static.apply(findings, settings) end
  local result = run_explore(file, model, declared_for(file), options,
    rfsm_checks.explore, review.MANY)
  findings:join(result.findings)
  if not result.bound then findings:add_idle_silences(fsm) end
  return static.apply(findings, settings), result
end

-- Appends the lines of a finding, and the lines of the run that shows it.
local function add_finding(lines, file, finding)
  lines[#lines + 1] = line_of(file, finding)
  local witness = finding.witness or {}
  local is_of_system = witness[1] and witness[1].machine
  for _, line in ipairs((is_of_system and sequence or verdict).lines_of(witness)) do
    lines[#lines + 1] = "  " .. line
  end
  if finding.record then lines[#lines + 1] = "  recorded in " .. finding.record end
end

local function lines_of_all(file, findings, warnings, has_notes)
  local lines = {}
  for _, severity in ipairs { "error", "warning", has_notes and "note" } do
    for _, line in ipairs(severity == "warning" and warnings or {}) do
      lines[#lines + 1] = line
    end
    for _, finding in ipairs(findings) do
      if finding.severity == severity then add_finding(lines, file, finding) end
    end
  end
  return lines
end

-- Returns the verdict on a chart of which there is nothing to report: how far it was
-- explored, and whether there was a property to judge.
local function verdict_of(result)
  return (result and result.bound and ": ok as far as explored" or ": ok")
    .. (result and not result.properties[1] and " (0 properties judged)" or "")
end

-- Returns a line if the text of callbacks was not read.
local function line_of_source(file)
  return not source.is_there and chart.name_of(file) .. ": the text of callbacks was "
    .. "not read, luacheck is not installed"
end

--- Return the findings about a chart in lines: errors first, then warnings and notes.
--- Lines with the summary of the exploration follow.
---@param file string
---@param model rfsm.Model|rfsm.System
---@param warnings string[] texts about the file of the chart
---@param settings table<string, string> see `review.settings_for`
---@param options table options of the command, such as `all` and `static`; `required`
-- is the first result of `review.noting_extensions`
---@return string[] lines "chart.lua: ok" if there is nothing to report
---@return "error"|"warning"|nil gravest severity; nil if there are only notes
function review.of(file, model, warnings, settings, options)
  local findings, result = find_all(file, model, settings, options)
  warnings = match.with(warnings, misnamed_beside(file))
  local gravest = gravest_of(findings) or warnings[1] and "warning" or nil
  if options.record then write_witnesses(model, findings, options.record) end
  local lines = lines_of_all(file, findings, warnings, options.all)
  if not lines[1] then lines[1] = chart.name_of(file) .. verdict_of(result) end
  for _, line in ipairs(result and result:summary(options.explore) or {}) do
    lines[#lines + 1] = chart.name_of(file) .. ": " .. line
  end
  lines[#lines + 1] = options.all and line_of_source(file) or nil
  return lines, gravest
end

return review
