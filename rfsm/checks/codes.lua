--- The codes of the findings of checks: each has a severity, a meaning and a remedy.
--
-- @module rfsm.checks.codes
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local order = require "rfsm.shared.order"

local ipairs, type = ipairs, type

local codes = {}

--- A code of findings.
---@class rfsm_checks.Code
---@field code string such as "dead-end"
---@field severity "error"|"warning"|"note"
---@field meaning string
---@field hint string the remedy

--- All codes, in the order in which the manual lists them.
---@type rfsm_checks.Code[]
codes.list = {}

--- All codes, by their field `code`, such as "dead-end".
---@type table<string, rfsm_checks.Code>
codes.of = {}

local TEXT = [[
error invalid: the model cannot become a machine
  correct what the text names
warning unreachable: no path of transitions leads to a node
  see which transition leads to it, or remove it
warning dead-end: nothing leads on from a leaf
  add a transition, or declare final = true
warning closed: no path leads through a connector
  see which guards and events its transitions need together
warning connector-cycle: connectors lead back to themselves
  a path passes a connector once: lead the cycle through a state
warning closed-initial: a composite cannot be entered at times
  add an initial transition without guard and events, of the least pn
note no-default: a connector has no way on for some event if its guards say no
  add a transition without guard and events, of the least pn
warning shadowed: a transition is never taken
  see which one is tried earlier: give it a larger pn, other events, or a guard to it
note conflict: two transitions of a node and of equal pn can be enabled at once
  give them different pn, or guards that exclude each other
warning endless: run never becomes idle
  let a state of the cycle wait for an event, or have a doo
warning never-done: an e_done that no state sends
  name a leaf, or mark the last leaf of the composite or of each region: final = true
warning never-called: a callback stands where none is called
  guard and effect belong to transitions; entry, exit and doo to states
warning false-guard: a guard that was false while loading counts as absent
  write a function: guard = function() return speed < max end
warning no-value: a guard that returns neither false nor an expression never forbids
  return false, or a comparison
warning called: a callback was called while the chart was loaded, nothing is left of it
  write a function around the call
warning lost: a key stands twice in a table, the first value is lost
  give one of them another name
warning parameters: a callback takes other parameters than it is given
  guard(tr, events, event), effect(fsm, tr, _, events, event), entry(fsm, state)
warning wrong-call: a callback calls a function in a way that always fails
  see what the text names
warning undefined: a callback reads a global that is not defined; a note if the host may
  correct the name, or define it
warning no-yield: a doo that never returns to the engine
  call rfsm.yield() in its loop
note busy-doo: a doo that is never idle, so that run never returns
  yield true where there is nothing to do
note idle-hook: the root has an idle_hook, so that run does not return
  leave it out, and wait in the loop that calls run
note early-idle: run may return while an event of a region still waits
  write idle_doo = "auto", so that run goes on until all regions are idle
note doo-ends: a doo ends, and nothing waits for its e_done
  add a transition on e_done, or let the doo go on
note any-event: a transition of a state on any event; a warning if others come too late
  name its events, or e_done if it waits for none
warning once: an internal transition takes an e_after, which comes once an entry
  write e_every(T) if it is to come again
warning empty-events: a list of events without any, so that any event matches
  see if a name in it is nil; leave `events` out if any event is meant
warning typo: an event is one letter from another
  use one name; or silence the finding at this transition
warning idle-reaction: an extension reacts to an event, and that changes nothing
  see what the text names
warning odd-event: an event that looks like several, or like a list
  write a string for each: events = { "e_a", "e_b" }
warning unknown-word: an event such as word(...) that no extension knows
  require the module that knows it
warning unknown-field: a field looks like one of the library's
  use the name of the library
warning unmarked: a plain table looks like a state or transition
  use rfsm.state{...} or rfsm.trans{...}
warning misplaced: an element stands where it is ignored or misread
  move it to the composite around
warning init: another warning of rfsm.init
  correct what the text names
warning silence: a field `checks` is wrong
  write checks = { ["a-code"] = "the reason" }
warning trap: states that lead to each other, and never back or to an end
  add a transition back, or silence the finding at one of them
error deadlock: no machine of a system can go on, and one of them waits
  see which event it waits for, and who would have to move first
warning overflow: a buffer between machines can be full, and lose an event
  send less, make it larger, or use kind = "data"
warning untaken: an event of a wire that its reader never takes
  see in which states it comes: take it there, or defer it
warning idle-wire: a wire over which no event goes
  see who should emit the event, or remove the wire
warning unwired: a machine emits an event that no wire carries
  add a wire, or correct the name
warning deployed: a deployment is not as its system says
  launch the system by rfsm_rtt.launch_system, or mend the deployment
error violated: a property that does not hold
  mend the chart, or the property
]]

for severity, code, meaning, hint in TEXT:gmatch("(%l+) (%S+): (.-)\n  (.-)\n") do
  local entry = { severity = severity, code = code, meaning = meaning, hint = hint }
  codes.list[#codes.list + 1], codes.of[code] = entry, entry
end

-- Words that mean an end or a fault in the name of a leaf.
local MEANINGS = {
  ["an end"] = { "OK", "FAILED", "FINI", "FATAL", "FINISHED", "FINAL", "END", "EXIT",
    "STOP", "STOPPED", "FAILURE", "FAIL", "ERROR", "ABORT", "ABORTED", "DONE", "QUIT",
    "SUCCESS", "COMPLETE", "COMPLETED", "TERMINATED", "SHUTDOWN", "CLOSE", "CLOSED",
    "DEAD", "CANCELLED", "CANCELED", "BYE" },
  ["a fault"] = { "FAULT", "ERROR", "FAILURE", "FAILED", "ALARM", "EMERGENCY" },
}

--- Does the name of a leaf contain a word that means an end, or a fault?
---@param state rfsm.State
---@param meaning "an end"|"a fault"
---@return boolean
function codes.means(state, meaning)
  local id = rfsm.text_of(state._id):gsub("i", "I"):upper() -- as in Turkish
  local name = " " .. id:gsub("%A+", " ") .. " "
  return order.any(MEANINGS[meaning], function(word)
    return name:find(" " .. word .. " ", 1, true)
  end)
end

--- Return a hint with the code that is nearest to an unknown code; "" if none is near.
function codes.nearest(code)
  return type(code) == "string"
    and advice.nearest_name(code, rfsm.sorted_keys(codes.of)) or ""
end

local SEVERITIES = { error = true, warning = true, note = true, off = true }

--- Return the problem in the severities that a project sets; nil if there is none.
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
