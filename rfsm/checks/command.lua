--- What the command `rfsm check` does with findings: settings in, lines out.
--
-- @module rfsm.checks.command
-- @license BSD-3-Clause

local chart = require "rfsm.shared.chart"
local codes = require "rfsm.checks.codes"
local rfsm_checks = require "rfsm_checks"
local static = require "rfsm.checks.static"
local verdict = require "rfsm.checks.verdict"

local assert, error, io, ipairs = assert, error, io, ipairs
local loadfile, os, pcall, require, type = loadfile, os, pcall, require, type

local command = {}

local SETTINGS = ".rfsmcheck.lua"

-- Does a file exist?
local function exists(name)
  local handle = io.open(name)
  return handle ~= nil and handle:close() ~= nil
end

-- Returns the nearest file of settings, from the folder of a file up to the working
-- directory, or to /; nil if there is none.
local function find_settings(file)
  local folder = file:match("^(.*/)") or ""
  while not exists(folder .. SETTINGS) do
    if folder == "" or folder == "/" then return nil end
    folder = folder:match("^(.*/)[^/]*/$") or ""
  end
  return folder .. SETTINGS
end

--- Load the settings that hold for a chart: those in the nearest `.rfsmcheck.lua`.
---@param file string of the chart
---@return table<string, string>? settings code -> severity; nil if they are wrong
---@return string? problem
function command.settings_for(file)
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
  local line = static.line(finding)
  if finding.code ~= "invalid" and not finding.text:find("%)$") then
    line = line:gsub(" %[[%w-]*%]$", function(code)
      return " (" .. finding.hint .. ")" .. code
    end)
  end
  return chart.line(file, line, kind)
end

-- Returns the gravest severity of findings, but for notes.
local function gravest_of(findings)
  local found = {}
  for _, finding in ipairs(findings) do found[finding.severity] = true end
  return found.error and "error" or found.warning and "warning" or nil
end

-- Returns the findings about a chart in lines, those of each severity in the order of
-- the tree, and the gravest severity.
local function report(file, findings, warnings, has_notes)
  local lines = {}
  for _, severity in ipairs { "error", "warning", has_notes and "note" } do
    if severity == "warning" then
      for _, line in ipairs(warnings) do lines[#lines + 1] = line end
    end
    for _, finding in ipairs(findings) do
      if finding.severity == severity then
        lines[#lines + 1] = line_of(file, finding)
      end
    end
  end
  if not lines[1] then lines[1] = chart.name_of(file) .. ": ok" end
  return lines, gravest_of(findings) or warnings[1] and "warning" or nil
end

-- Explore .........................................................................

-- Returns what the file beside a chart declares: a.lua has a_properties.lua.
local function declared_for(file)
  local name = file:gsub("%.lua$", "") .. "_properties.lua"
  if file == "-" or not exists(name) then return {} end
  local declared = assert(loadfile(name))()
  if type(declared) ~= "table" then
    error(name .. ": table with the field 'properties' expected, got "
      .. type(declared), 0)
  end
  return declared
end

local real_stderr = io and io.stderr

-- Returns a function that keeps a line of a terminal up to date; nil without one.
local function progress_line()
  local ok, unistd = pcall(require, "posix.unistd")
  if not (ok and unistd.isatty(2)) then return nil end
  return function(configurations, depth)
    real_stderr:write(("\r%d configurations, depth %d "):format(configurations, depth))
  end
end

-- Writes the run that shows the first finding to a new file.
local function write_witness(model, findings, name)
  for _, finding in ipairs(findings) do
    if finding.witness and finding.witness[1] then
      os.remove(name) -- a recording is appended to
      return rfsm_checks.record_witness(model, finding.witness, name)
    end
  end
end

-- Appends the report of an exploration; returns the gravest severity.
local function explore(lines, file, model, settings, options)
  local own = declared_for(file)
  own.together, own.seconds = options.together, options.seconds
  own.configurations, own.progress = options.configurations, progress_line()
  local result = rfsm_checks.explore(model, own)
  if own.progress then real_stderr:write("\r\27[K") end
  result.findings = static.apply(result.findings, settings)
  if options.record then write_witness(model, result.findings, options.record) end
  local is_wanted = { error = true, warning = true, note = options.all }
  local name = chart.name_of(file) .. ": "
  for _, line in ipairs(verdict.report(result, name, is_wanted)) do
    lines[#lines + 1] = line
  end
  return gravest_of(result.findings)
end

--- Return the findings about a chart in lines.
---@param file string of the chart
---@param model rfsm.State
---@param warnings string[] about its file
---@param settings table<string, string>
---@param options table of the command: all, explore, together ...
---@return string[] lines "chart.lua: ok" if there is nothing to report
---@return "error"|"warning"|nil gravest severity, but for notes
function command.review(file, model, warnings, settings, options)
  local lines, gravest = report(file, static.findings(model, settings), warnings,
    options.all)
  if options.explore and gravest ~= "error" then
    gravest = explore(lines, file, model, settings, options) or gravest
  end
  return lines, gravest
end

--- Return the table of all codes.
function command.codes_text()
  local lines = {}
  for i, entry in ipairs(codes.list) do
    lines[i] = ("%-16s%-9s%s"):format(entry.code, entry.severity, entry.meaning)
  end
  return table.concat(lines, "\n") .. "\n"
end

return command
