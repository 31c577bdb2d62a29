--- What the command `rfsm check` does with findings: settings in, lines out.
--
-- @module rfsm.checks.command
-- @license BSD-3-Clause

local chart = require "rfsm.chart"
local codes = require "rfsm.checks.codes"
local static = require "rfsm.checks.static"
local verdict = require "rfsm.checks.verdict"

local assert, error, io, ipairs = assert, error, io, ipairs
local loadfile, os, pcall, require, type = loadfile, os, pcall, require, type

local command = {}

local SETTINGS = ".rfsmcheck.lua"

-- Lists the folders from that of a file up to the working directory, or to /.
local function folders_of(file)
  local folder = file:match("^(.*/)") or ""
  local folders = { folder }
  while folder ~= "" and folder ~= "/" do
    folder = folder:match("^(.*/)[^/]*/$") or ""
    folders[#folders + 1] = folder
  end
  return folders
end

-- Returns the nearest file of settings; nil if there is none.
local function find_settings(file)
  for _, folder in ipairs(folders_of(file)) do
    local handle = io.open(folder .. SETTINGS)
    if handle then
      handle:close()
      return folder .. SETTINGS
    end
  end
end

--- Load the settings that hold for a chart: those in the nearest `.rfsmcheck.lua`.
---@param file string of the chart
---@return table<string, string>? settings code -> severity; nil if they are wrong
---@return string? problem
function command.settings_for(file)
  local name = find_settings(file)
  if not name then return {} end
  local chunk, problem = loadfile(name)
  local ok, settings = false, problem
  if chunk then ok, settings = pcall(chunk) end
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

-- Appends the lines of a severity; returns whether there are any.
local function append(lines, file, findings, severity)
  local count = #lines
  for _, finding in ipairs(findings) do
    if finding.severity == severity then lines[#lines + 1] = line_of(file, finding) end
  end
  return #lines > count
end

-- Returns the findings about a chart in lines, those of each severity in the order of
-- the tree, and the gravest severity, but for notes.
local function report(file, findings, warnings, has_notes)
  local lines = {}
  local gravest = append(lines, file, findings, "error") and "error" or nil
  for _, line in ipairs(warnings) do lines[#lines + 1] = line end
  local has_warnings = append(lines, file, findings, "warning") or warnings[1]
  gravest = gravest or has_warnings and "warning" or nil
  if has_notes then append(lines, file, findings, "note") end
  if not lines[1] then lines[1] = chart.name_of(file) .. ": ok" end
  return lines, gravest
end

-- Explore .........................................................................

-- Returns what the file beside a chart declares: a.lua has a_properties.lua.
local function declared_for(file)
  local name = file:gsub("%.lua$", "") .. "_properties.lua"
  local handle = file ~= "-" and io.open(name)
  if not handle then return {} end
  handle:close()
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
      require("rfsm.checks.witness").record_witness(model, finding.witness, name)
      return
    end
  end
end

-- Appends the report of an exploration; returns the gravest severity.
local function explore(lines, file, model, settings, options)
  local own = declared_for(file)
  own.together, own.seconds = options.together, options.seconds
  own.configurations, own.progress = options.configurations, progress_line()
  local result = require("rfsm.checks.explore").explore(model, own)
  if own.progress then real_stderr:write("\r\27[K") end
  result.findings = static.apply(result.findings, settings)
  if options.record then write_witness(model, result.findings, options.record) end
  local is_wanted = { error = true, warning = true, note = options.all }
  local found = {}
  for i, line in ipairs(verdict.report(result, is_wanted)) do
    lines[#lines + 1] = i == 1 and chart.name_of(file) .. ": " .. line or line
  end
  for _, finding in ipairs(result.findings) do found[finding.severity] = true end
  return found.error and "error" or found.warning and "warning"
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
---@return string text
function command.codes_text()
  local lines = {}
  for i, entry in ipairs(codes.list) do
    lines[i] = ("%-16s%-9s%s"):format(entry.code, entry.severity, entry.meaning)
  end
  return table.concat(lines, "\n") .. "\n"
end

return command
