--- The codes of findings: severity, meaning, and the way to mend each.
--
-- @module rfsm.checks.codes
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"

local ipairs, type = ipairs, type

local codes = {}

--- What is known of a code.
---@class rfsm_checks.Code
---@field code string
---@field severity "error"|"warning"|"note"
---@field meaning string
---@field hint string

--- All codes, in the order in which the manual lists them.
---@type rfsm_checks.Code[]
codes.list = {}

--- The same by code.
---@type table<string, rfsm_checks.Code>
codes.of = {}

--- The code of the static check that finds what an exploration finds under a code.
---@type table<string, string>
codes.twin = { unreached = "unreachable", untaken = "shadowed", stuck = "dead-end",
  livelock = "endless", swallowed = "no-default", clash = "conflict",
  closed = "connector-end" }

--- How many of them are found by static checks; they come first.
codes.static = 0

local function define(severity, code, meaning, hint)
  local entry = { code = code, severity = severity, meaning = meaning, hint = hint }
  codes.list[#codes.list + 1], codes.of[code] = entry, entry
end

define("error", "invalid", "the model cannot become a machine",
  "correct what the text names")
define("warning", "unreachable", "no path of transitions leads to a node",
  "add a transition to it, or remove it")
define("warning", "dead-end", "a leaf and the composites around it are never left",
  "add a transition, or declare final = true")
define("warning", "connector-end", "nothing leaves a connector",
  "add a transition from it")
define("warning", "connector-cycle", "connectors lead back to themselves",
  "a path passes a connector once: lead the cycle through a state")
define("warning", "closed-initial", "a composite cannot be entered at times",
  "add an initial transition without guard and events, of the least pn")
define("note", "no-default", "a connector has no way on for some event if its guards "
  .. "say no", "add a transition without guard and events, of the least pn")
define("warning", "shadowed", "a transition is never taken, others are tried earlier",
  "give it a larger pn or other events, or a guard to the others")
define("note", "conflict", "two transitions of a node and of equal pn can be enabled "
  .. "at once", "give them different pn, or guards that exclude each other")
define("warning", "endless", "run never becomes idle",
  "let a state of the cycle wait for an event, or have a doo")
define("warning", "never-done", "an e_done that no leaf sends",
  "name a leaf state, or a final event of your own")
define("warning", "never-called", "a callback stands where none is called",
  "guard and effect belong to transitions; entry, exit and doo to states")
define("warning", "typo", "an event is one letter from another",
  "use one name; or silence the finding at this transition")
define("warning", "odd-event", "an event that looks like several, or like a list",
  'write a string for each: events = { "e_a", "e_b" }')
define("warning", "unknown-word", "an event such as word(...) that no extension knows",
  "require the module that knows it")
define("warning", "unknown-field", "a field looks like one of the library's",
  "use the name of the library")
define("warning", "unmarked", "a plain table looks like a state or transition",
  "use rfsm.state{...} or rfsm.trans{...}")
define("warning", "misplaced", "an element stands where it is ignored or misread",
  "move it to the composite around")
define("warning", "init", "another warning of rfsm.init", "correct what the text names")
define("warning", "silence", "a field `checks` is wrong",
  'write checks = { ["a-code"] = "the reason" }')

codes.static = #codes.list -- those that follow are found by exploration

define("warning", "unreached", "a state that is active in no configuration",
  "see which guard, priority or event keeps its transitions from being taken")
define("warning", "untaken", "a transition that no step takes",
  "see which transition is tried earlier, or which connector is closed")
define("warning", "closed", "a connector that no step passes",
  "see which guards and events its transitions need together")
define("warning", "stuck", "a configuration that nothing leaves",
  "add a transition, or declare final = true")
define("warning", "trap", "states that lead to each other, and never back or to an end",
  "add a transition back, or silence the finding at one of them")
define("warning", "livelock", "a configuration from which run never becomes idle",
  "let a state of the cycle wait for an event, or have a doo")
define("note", "clash", "a transition enabled together with one of equal pn",
  "give them different pn, or guards that exclude each other")
define("note", "swallowed", "an event is discarded at a closed connector",
  "give the connector a default, or the event a transition of less pn")
define("error", "violated", "a property that does not hold",
  "mend the chart, or the property")

--- Make a finding.
---@param code string
---@param file string
---@param at string its place
---@param text string
---@return rfsm_checks.Finding
function codes.finding(code, file, at, text)
  return { code = code, severity = codes.of[code].severity, file = file, place = at,
    text = text, hint = codes.of[code].hint }
end

local ENDS = { OK = true, FAILED = true, FINI = true, FATAL = true, FINISHED = true,
  FINAL = true, END = true }

--- Is there a word in the name of a leaf that means an end?
---@param state rfsm.State
---@return boolean
function codes.is_named_as_end(state)
  for word in rfsm.text_of(state._id):upper():gmatch("%a+") do
    if ENDS[word] then return true end
  end
  return false
end

-- Texts of the core's warnings, and their codes.
local WARNINGS = {
  { "has no field '", "unknown-field" },
  { "a plain table that", "unmarked" },
  { "a transition inside a leaf state", "misplaced" },
  { "a connector holds no", "misplaced" },
  { "never fires here", "never-done" },
  { "no loaded extension knows", "unknown-word" },
}

--- Return the code of a warning of the core.
function codes.of_warning(text)
  for _, pair in ipairs(WARNINGS) do
    if text:find(pair[1], 1, true) then return pair[2] end
  end
  return "init"
end

--- Return the hint that a code was misspelt.
function codes.nearest(code)
  return type(code) == "string"
    and advice.nearest_name(code, rfsm.sorted_keys(codes.of)) or ""
end

local SEVERITIES = { error = true, warning = true, note = true, off = true }

--- Return what is wrong with the settings of a project; nil if nothing is.
---@param settings any code -> "error"|"warning"|"note"|"off"
---@return string? problem
function codes.check_settings(settings)
  if type(settings) ~= "table" then
    return "table of severities expected, got " .. type(settings)
  end
  for _, code in ipairs(rfsm.sorted_keys(settings)) do
    local severity = settings[code]
    if not codes.of[code] then
      return ("no check has the code '%s'%s"):format(rfsm.text_of(code),
        codes.nearest(code))
    elseif not SEVERITIES[severity] then
      return ("%s: 'error', 'warning', 'note' or 'off' expected, got %s"):format(code,
        type(severity) == "string" and "'" .. severity .. "'" or type(severity))
    end
  end
end

return codes
