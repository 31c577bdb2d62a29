--- Static checks: mistakes, dead parts and risks that the structure of a chart shows.
--
-- Each check is a module that calls `add(code, obj, text)` for each of its findings.
-- The findings are sorted in the order of the tree. An element can silence findings
-- about itself with a field `checks`.
--
-- @module rfsm.checks.static
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"
local codes = require "rfsm.checks.codes"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"
local structure = require "rfsm.checks.structure"
local stubs = require "rfsm.shared.stubs"

local error, ipairs = error, ipairs
local select, setmetatable = select, setmetatable
local table, type = table, type
local concat = table.concat

local static = {}

--- A finding.
---@class rfsm_checks.Finding
---@field code string the kind of finding, such as "dead-end"
---@field severity "error"|"warning"|"note"
---@field file string file and line, such as "chart.lua:7: "; empty if not known
---@field place string location: "root.trans[2] (off -> on)" or "root.par.left: root.a"
---@field text string one sentence
---@field hint string a remedy
---@field witness? rfsm_checks.WitnessStep[] the run by which an exploration found it
---@field run? rfsm_checks.WitnessStep[] the run that confirmed a static finding

--- A check is a function that calls `add` for each finding about a machine. `reached`
--- is the set of nodes to which a path of transitions leads.
---@alias rfsm_checks.Add fun(code: string, obj: table, text: string, severity?: any)
---@alias rfsm_checks.Check fun(fsm: rfsm.Machine, add: rfsm_checks.Add, reached: table)

local CHECKS = {
  "rfsm.checks.structure", "rfsm.checks.priority", "rfsm.checks.loops",
  "rfsm.checks.event_names",
}

--- The checks for a chart from a file. The last check reads the text of the file.
static.OF_FILES = { CHECKS[1], CHECKS[2], CHECKS[3], CHECKS[4], "rfsm.checks.source" }

-- Findings, except those that an element expects ......................................

local function silences_of(obj)
  local silences = obj.checks
  return type(silences) == "table" and not rfsm.is_fsmobj(silences) and silences or {}
end

local function is_reason(value)
  return type(value) == "string" and value:find("%S") ~= nil
end

local function is_silenced(obj, code) return is_reason(silences_of(obj)[code]) end

--- A list of findings.
---@class rfsm_checks.Findings
---@field [integer] rfsm_checks.Finding
---@field silenced table<string, true> findings that elements silence: "root.a dead-end"
---@field told table<string, true> findings in the list: "dead-end root.a no exit, ..."
local Findings = {}
Findings.__index = Findings

--- Return an empty list of findings.
---@return rfsm_checks.Findings
function static.new_list()
  return setmetatable({ silenced = {}, told = {} }, Findings)
end

--- Append a finding, unless its element silences it or the list has it already.
---@param code string
---@param obj rfsm.State|rfsm.Transition|rfsm.Connector|nil
---@param path string path of the element, as `location.path` returns it
---@param text string
---@param at? string location of the element, shown in place of the path
---@param file? string
---@return rfsm_checks.Finding? finding
function Findings:add(code, obj, path, text, at, file)
  if obj and is_silenced(obj, code) then
    self.silenced[path .. " " .. code] = true
    return nil
  elseif codes.of[code].severity ~= "error"
    and (stubs.is_in(text) or stubs.is_invented(obj, code == "unreachable")) then
    return nil -- it is about a stub, whose real value is not known
  end
  local known, key = codes.of[code], concat({ code, path or at, text }, " ")
  if self.told[key] then return nil end
  self.told[key] = true
  local finding = { code = code, severity = known.severity, hint = known.hint,
    file = file or obj and location.split(rfsm.location_of(obj)) or "",
    place = at or path, text = text }
  self[#self + 1] = finding
  return finding
end

-- Returns the finding in the list that has the same code and the same element.
function Findings:find_same(finding)
  for _, other in ipairs(self) do
    local path = other.place:gsub(" %(.* %-> .*%)$", ""):gsub(": root", "")
    if path == finding.place and other.code == finding.code then return other end
  end
end

--- Append the findings of an exploration. A finding that the list already has is not
--- appended, but gets the run by which the exploration found it.
---@param others rfsm_checks.Findings
function Findings:join(others)
  local more = {}
  for _, finding in ipairs(others) do
    local same = self:find_same(finding)
    if same then same.run = finding.witness else more[#more + 1] = finding end
  end
  for _, finding in ipairs(more) do self[#self + 1] = finding end
  for note in order.each(others.silenced) do self.silenced[note] = true end -- any order
end

--- Append a finding for each useless entry of a field `checks`: it silenced nothing.
function Findings:add_idle_silences(fsm)
  for entry, obj in location.each(fsm) do
    for _, code in ipairs(rfsm.sorted_keys(silences_of(obj))) do
      local path = location.path(obj, entry.prefix)
      if is_silenced(obj, code) and not self.silenced[path .. " " .. code] then
        self:add("silence", obj, path, ("checks['%s']: there is nothing to silence "
          .. "any more"):format(code), location.in_words(obj, entry.prefix))
      end
    end
  end
end

-- Finds entries of a field `checks` whose code does not exist, or that have no reason.
local function check_silences(obj, add)
  local silences = silences_of(obj)
  for _, code in ipairs(rfsm.sorted_keys(silences)) do
    local reason = silences[code]
    if not codes.of[code] then
      add("silence", obj, ("checks: no check has the code '%s'%s"):format(
        rfsm.text_of(code), codes.nearest(code)))
    elseif not is_reason(reason) then
      add("silence", obj, ("checks['%s']: a reason expected, got %s"):format(code,
        type(reason) == "string" and "an empty string" or type(reason)))
    end
  end
end

-- Checks ..........................................................................

-- Appends the findings about a machine, in the order of its elements.
local function check_machine(entry, findings, checks)
  local fsm, by_element, elements = entry.machine, {}, rfsm.elements(entry.machine)
  for _, obj in ipairs(elements) do by_element[obj] = {} end
  local function add(code, obj, text, severity)
    table.insert(by_element[obj], { code = code, text = text, severity = severity })
  end
  local reached = structure.reached(fsm)
  for _, name in ipairs(checks) do
    rfsm.find_module(name).check(fsm, add, reached)
  end
  for _, obj in ipairs(elements) do
    check_silences(obj, add)
    for _, found in ipairs(by_element[obj]) do
      local finding = findings:add(found.code, obj, location.path(obj, entry.prefix),
        found.text, location.in_words(obj, entry.prefix))
      if finding then finding.severity = found.severity or finding.severity end
    end
  end
end

-- Machines of the model ...........................................................

--- Make a machine that prints nothing; its warnings go to `warn`. It is made of the
--- model itself, not of a copy, because transitions may name the root as a table.
function static.init(model, warn)
  return calls.silently(calls.init_apart, model, warn)
end

--- Return the results of init(model, false). `prepare(fsm)` is called before the engine
--- indexes the events. This preproc function is then removed by its position, since an
--- extension that is loaded meanwhile may append its own.
function static.prepared(init, model, prepare)
  local preproc, at = rfsm.preproc, #rfsm.preproc + 1
  preproc[at] = prepare
  return calls.finally(function() table.remove(preproc, at) end, init, model, false)
end

-- Returns a table of a machine's elements. Its keys are the locations in warnings.
local function elements_by_place(fsm)
  local found = {}
  for _, obj in ipairs(fsm and rfsm.elements(fsm) or {}) do
    for _, text in ipairs { rfsm.location_of(obj), rfsm.location_of(obj, "events") }
    do
      found[select(2, location.split(text))] = obj
    end
  end
  return found
end

-- Appends a finding for each problem or warning of `rfsm.init` in `lines`. `code_of`
-- has the codes by line; false: a check tells more.
local function add_lines(findings, lines, code_of, fsm, prefix)
  local by_place = elements_by_place(fsm)
  for _, line in ipairs(lines) do
    local file, rest = location.split(line)
    local at, text = rest:match("^(root.-): (.*)$")
    local obj, code = by_place[at], code_of[line]
    if code then
      local path = obj and location.path(obj, prefix)
      local finding = findings:add(code, obj, path, text or rest,
        location.prefix(prefix) .. (at or "root"), file)
      if finding and obj and code == "empty-events" and rfsm.is_conn(obj.src) then
        finding.severity = "note" -- a path has its events before the connector
      end
    end
  end
end

-- Initialises a model. Returns the machine, the problems, the warnings, and their
-- codes; warnings about regions are left out.
local function init_and_listen(model)
  local warnings, code_of, outer = {}, {}, rfsm.warned
  function rfsm.warned(fsm, code, text)
    if rfsm.model_of(fsm) ~= model then return end
    warnings[#warnings + 1], code_of[text] = text, code
  end
  local fsm, _, problems = calls.finally(function() rfsm.warned = outer end,
    static.init, model, function() end)
  return fsm, problems, warnings, code_of
end

local IS_INVALID = setmetatable({}, { __index = function() return "invalid" end })

-- Appends findings for the problems of a model and the warnings of init. Returns the
-- machine; nil if there is none.
local function check_model(findings, model)
  local is_valid, problems, warnings, code_of = rfsm.verify_early(model)
  local fsm, regions = nil, {}
  if is_valid then
    fsm, problems, warnings, code_of = init_and_listen(model)
    regions = fsm and rfsm.machines(fsm) or {}
  end
  add_lines(findings, problems or {}, IS_INVALID, nil, "root")
  add_lines(findings, warnings, code_of, fsm, "root")
  for i = 2, #regions do
    local region = regions[i].machine
    local _, _, own, codes_of_own = init_and_listen(rfsm.model_of(region))
    add_lines(findings, own, codes_of_own, region, regions[i].prefix)
  end
  return fsm
end

--- Return all findings, of any severity.
---@param model rfsm.State a model, or a machine
---@param checks? string[] names of the modules with the checks
---@return rfsm_checks.Findings
---@return rfsm.Machine? fsm the machine of the model; nil if the model is wrong
function static.collect(model, checks)
  local findings = static.new_list()
  local fsm = rfsm.is_initialized_root(model) and model or check_model(findings, model)
  for _, entry in ipairs(fsm and rfsm.machines(fsm) or {}) do
    check_machine(entry, findings, checks or CHECKS)
  end
  return findings, fsm
end

--- Give findings the severity that a project has set. Drop findings set to "off".
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

--- Find mistakes, dead parts and risks in a model.
--
-- A finding is left out if the field `checks` of its element has the finding's code
-- with a reason. `settings` has, for some codes, the severity of the project, or "off".
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
  return static.apply((static.collect(model)), settings or {})
end

--- Return a finding in a line: "chart.lua:7: root.a: text (hint) [code]". Problems of a
--- model are shown without a code, because nothing can silence them.
function static.line(finding, has_hint)
  local hint = has_hint and " (" .. finding.hint .. ")" or ""
  local code = finding.code ~= "invalid" and " [" .. finding.code .. "]" or ""
  return finding.file .. finding.place .. ": " .. finding.text .. hint .. code
end

return static
