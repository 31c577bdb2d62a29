--- Static checks: what is wrong, dead or risky in a chart, as far as its structure
--- tells.
--
-- Each check is a file of its own. It calls `add(code, obj, text)`. Findings are in the
-- order of the tree. A field `checks` of an element silences those of its own.
--
-- @module rfsm.checks.static
-- @license BSD-3-Clause

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
---@alias rfsm_checks.Add fun(code: string, obj: table, text: string)
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

-- Leaves out the findings of init that an element expects.
local function drop_silenced(fsm, findings)
  local is_dropped = {}
  for _, obj in ipairs(rfsm.elements(fsm)) do
    for code in pairs(silences_of(obj)) do -- any order: a set
      if static.is_silenced(obj, code) then
        local _, events = place.split(rfsm.location_of(obj, "events"))
        is_dropped[code .. place.of(obj)], is_dropped[code .. events] = true, true
      end
    end
  end
  local kept = {}
  for _, finding in ipairs(findings) do
    if not is_dropped[finding.code .. finding.place] then kept[#kept + 1] = finding end
  end
  return kept
end

-- Checks ..........................................................................

-- Appends the findings about a machine, in the order of its elements.
local function check_machine(fsm, location, findings)
  local by_element, elements = {}, rfsm.elements(fsm)
  if elements[1] ~= fsm then table.insert(elements, 1, fsm) end -- a part of a machine
  for _, obj in ipairs(elements) do by_element[obj] = {} end
  local function add(code, obj, text)
    if static.is_silenced(obj, code) then return end
    local file, at = place.split(rfsm.location_of(obj))
    table.insert(by_element[obj], codes.finding(code, file, location .. at, text))
  end
  for _, name in ipairs(CHECKS) do require(name).check(fsm, add) end
  for _, obj in ipairs(elements) do check_silences(obj, add) end
  for _, obj in ipairs(elements) do
    for _, finding in ipairs(by_element[obj]) do findings[#findings + 1] = finding end
  end
end

-- The same about a machine and those inside of it.
local function check_machines(fsm, findings)
  for _, entry in ipairs(rfsm.machines(fsm)) do
    check_machine(entry.machine, place.location_of(entry.prefix), findings)
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
  local init = rfsm.seqand and rfsm.seqand.init_apart or rfsm.init
  local ok, fsm, text, problems = pcall(init, model)
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
local function findings_of_model(model)
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
  return check_machines(fsm, drop_silenced(fsm, findings))
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
---@nodiscard
function static.findings(model, settings)
  if not rfsm.is_state(model) then
    error("rfsm_checks.findings: state expected, got " .. type(model), 2)
  end
  local problem = codes.check_settings(settings or {})
  if problem then error("rfsm_checks.findings: settings: " .. problem, 2) end
  local is_machine = rfsm.is_initialized_root(model)
  local findings = is_machine and check_machines(model, {}) or findings_of_model(model)
  return static.apply(findings, settings or {})
end

--- Return a finding in one line: "chart.lua:7: root.a: text [code]". The problems of a
--- model have no code: nothing can silence them.
function static.line(finding)
  local code = finding.code ~= "invalid" and " [" .. finding.code .. "]" or ""
  return finding.file .. finding.place .. ": " .. finding.text .. code
end

return static
