--- Static checks: what is wrong, dead or risky in a chart, as far as its structure
--- tells.
--
-- Each check is a file of its own. It calls `add(code, obj, text)`. Findings are in the
-- order of the tree. A field `checks` of an element silences those of its own.
--
-- @module rfsm.checks.static
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"
local codes = require "rfsm.checks.codes"
local place = require "rfsm.checks.place"

local error, ipairs, pairs, pcall = error, ipairs, pairs, pcall
local require, select, table, type = require, select, table, type

local static = {}

--- A finding.
---@class rfsm_checks.Finding
---@field code string "dead-end"
---@field severity "error"|"warning"|"note"
---@field file string "chart.lua:7: "; empty if it is not known
---@field place string "root.trans[2] (off -> on)", in a region "root.par.left: root.a"
---@field text string one sentence
---@field hint string how to mend it

--- A check: calls `add` for each finding about a machine.
---@alias rfsm_checks.Add fun(code: string, obj: table, text: string, severity?: any)
---@alias rfsm_checks.Check fun(fsm: rfsm.Machine, add: rfsm_checks.Add)

local CHECKS = {
  "rfsm.checks.structure", "rfsm.checks.paths", "rfsm.checks.order",
  "rfsm.checks.loops", "rfsm.checks.names",
}

-- Silence: findings that an element expects ........................................

local function silences_of(obj)
  local silences = obj.checks
  return type(silences) == "table" and not rfsm.is_fsmobj(silences) and silences or {}
end

-- Finds codes that do not exist, and those without a reason.
local function check_silences(obj, add)
  local silences = silences_of(obj)
  for _, code in ipairs(rfsm.sorted_keys(silences)) do
    local reason = silences[code]
    if not codes.of[code] then
      add("silence", obj, ("checks: no check has the code '%s'%s"):format(
        rfsm.text_of(code), codes.nearest(code)))
    elseif type(reason) ~= "string" or not reason:find("%S") then
      add("silence", obj, ("checks['%s']: a reason expected, got %s"):format(code,
        type(reason) == "string" and "an empty string" or type(reason)))
    end
  end
end

--- Does an element expect the findings of a code, with a reason?
function static.is_silenced(obj, code)
  local reason = silences_of(obj)[code]
  return type(reason) == "string" and reason:find("%S") ~= nil
end

--- The codes that elements have silenced: "root.a dead-end".
---@alias rfsm_checks.Silenced table<string, true>

--- Note that a finding was silenced at a path.
function static.note_silenced(silenced, path, code)
  silenced[path .. " " .. code] = true
end

--- List findings about silences that silence nothing.
---@param model rfsm.State
---@param silenced rfsm_checks.Silenced
---@return rfsm_checks.Finding[]
function static.idle_silences(model, silenced)
  local findings = {}
  for _, entry in ipairs(rfsm.machines(static.init(model, false))) do
    for _, obj in ipairs(rfsm.elements(entry.machine)) do
      for _, code in ipairs(rfsm.sorted_keys(silences_of(obj))) do
        local path = place.path(obj, entry.prefix)
        if static.is_silenced(obj, code) and not silenced[path .. " " .. code] then
          local file, at = place.split(rfsm.location_of(obj))
          findings[#findings + 1] = codes.finding("silence", file,
            place.location_of(entry.prefix) .. at,
            ("checks['%s']: there is nothing to silence any more"):format(code))
        end
      end
    end
  end
  return findings
end

-- Leaves out the findings of init that an element expects.
local function drop_silenced(fsm, findings, silenced)
  local is_dropped = {}
  for _, obj in ipairs(rfsm.elements(fsm)) do
    for code in pairs(silences_of(obj)) do -- any order: a set
      if static.is_silenced(obj, code) then
        local _, events = place.split(rfsm.location_of(obj, "events"))
        local note = place.path(obj) .. " " .. code
        is_dropped[code .. place.of(obj)], is_dropped[code .. events] = note, note
      end
    end
  end
  local kept = {}
  for _, finding in ipairs(findings) do
    local note = is_dropped[finding.code .. finding.place]
    if note then silenced[note] = true else kept[#kept + 1] = finding end
  end
  return kept
end

-- Checks ..........................................................................

-- Appends the findings about a machine, in the order of its elements.
local function check_machine(entry, findings, silenced)
  local fsm, location = entry.machine, place.location_of(entry.prefix)
  local by_element, elements = {}, rfsm.elements(fsm)
  if elements[1] ~= fsm then table.insert(elements, 1, fsm) end -- a part of a machine
  for _, obj in ipairs(elements) do by_element[obj] = {} end
  local function add(code, obj, text, severity)
    if static.is_silenced(obj, code) then
      return static.note_silenced(silenced, place.path(obj, entry.prefix), code)
    end
    local file, at = place.split(rfsm.location_of(obj))
    local finding = codes.finding(code, file, location .. at, text)
    finding.severity = severity or finding.severity
    table.insert(by_element[obj], finding)
  end
  for _, name in ipairs(CHECKS) do require(name).check(fsm, add) end
  for _, obj in ipairs(elements) do check_silences(obj, add) end
  for _, obj in ipairs(elements) do
    for _, finding in ipairs(by_element[obj]) do findings[#findings + 1] = finding end
  end
end

-- The same about a machine and those inside of it.
local function check_machines(fsm, findings, silenced)
  for _, entry in ipairs(rfsm.machines(fsm)) do
    check_machine(entry, findings, silenced)
  end
  return findings
end

-- Machines of the model ...........................................................

local PRINTERS = { "dbg", "info", "warn", "err" }

--- Make a machine that prints nothing but its warnings, with `warn`. It is made of the
--- model itself, because transitions may name its root.
function static.init(model, warn)
  local own = {}
  for _, name in ipairs(PRINTERS) do
    own[name] = model[name]
    if not rfsm.is_fsmobj(own[name]) then model[name] = name == "warn" and warn end
  end
  local ok, fsm, text, problems = pcall(calls.init_apart, model)
  for _, name in ipairs(PRINTERS) do model[name] = own[name] end
  if not ok then error(fsm, 0) end
  return fsm, text, problems
end

-- What the checks find in more detail.
local function is_finding(text)
  return text:find("^no outgoing transitions from node")
    or text:find("each transition from here has events or a guard", 1, true)
    or text:find("'e_done' never fires here", 1, true)
end

local function add_lines(findings, lines, code_of, location)
  for _, line in ipairs(lines) do
    local file, rest = place.split(line)
    local at, text = rest:match("^(root.-): (.*)$")
    local code = code_of(line)
    if code == "invalid" or not is_finding(line) then
      findings[#findings + 1] = codes.finding(code, file, location .. (at or "root"),
        text or rest)
    end
  end
end

local function invalid() return "invalid" end

-- Returns all findings about a model: problems, warnings of init, those of the checks.
local function findings_of_model(model, silenced)
  local findings = {}
  local is_valid, problems, early = rfsm.verify_early(model)
  add_lines(findings, problems, invalid, "")
  if not is_valid then
    add_lines(findings, early, codes.of_warning, "")
    return findings
  end
  local fsm, _, found = static.init(model, function(text)
    text = rfsm.text_of(text):gsub("^WARNING: ", "")
    add_lines(findings, { text }, codes.of_warning, "")
  end)
  add_lines(findings, found or {}, invalid, "")
  if not fsm then return findings end
  for _, entry in ipairs(rfsm.machines(fsm)) do
    local warnings = entry.owner and select(3, rfsm.verify_early(entry.machine)) or {}
    add_lines(findings, warnings, codes.of_warning, place.location_of(entry.prefix))
  end
  return check_machines(fsm, drop_silenced(fsm, findings, silenced), silenced)
end

--- Give findings the severity that a project has set, and drop those that are off.
---@param findings rfsm_checks.Finding[]
---@param settings table<string, string>
---@return rfsm_checks.Finding[] kept
function static.apply(findings, settings)
  local kept = {}
  for _, finding in ipairs(findings) do
    finding.severity = settings[finding.code] or finding.severity
    if finding.severity ~= "off" then kept[#kept + 1] = finding end
  end
  return kept
end

--- Find what is wrong, dead or risky in a model.
--
-- A finding of an element is left out if its field `checks` has the code, with a
-- reason. The fields of a project's settings are codes, their values severities or
-- "off".
--
-- @raise if `model` is no state, or a setting is wrong
---@param model rfsm.State a model, or a machine
---@param settings? table<string, string>
---@return rfsm_checks.Finding[] findings in the order of the tree
---@return rfsm_checks.Silenced silenced what elements expect
---@nodiscard
function static.findings(model, settings)
  if not rfsm.is_state(model) then
    error("rfsm_checks.findings: state expected, got " .. type(model), 2)
  end
  local problem = codes.check_settings(settings or {})
  if problem then error("rfsm_checks.findings: settings: " .. problem, 2) end
  local is_machine = rfsm.is_initialized_root(model)
  local silenced = {}
  local findings = is_machine and check_machines(model, {}, silenced)
    or findings_of_model(model, silenced)
  return static.apply(findings, settings or {}), silenced
end

--- Return a finding in one line: "chart.lua:7: root.a: text [code]". The problems of a
--- model have no code: nothing can silence them.
function static.line(finding)
  local code = finding.code ~= "invalid" and " [" .. finding.code .. "]" or ""
  return finding.file .. finding.place .. ": " .. finding.text .. code
end

return static
