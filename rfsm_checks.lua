--- Checks: find undeclared events, and dead or suspicious parts of a model.
--
-- `rfsm_checks.check` looks at the structure of a model. `rfsm_checks.watch` has a
-- machine warn of each event that no transition names. So does `checkevents = true` in
-- the root of its model. `rfsm_checks.watch_all` and `require "rfsm.checkevents"` have
-- all machines that are initialised afterwards warn.
--
-- @module rfsm_checks
-- @license BSD-3-Clause

local home = tostring((...)):match("^(.+[./])rfsm_checks$") -- "libs."
if home then require(home .. "rfsm") return require "rfsm_checks" end -- one copy

local rfsm = require "rfsm"

local error, ipairs, pcall, rawget = error, ipairs, pcall, rawget
local rawset, setmetatable, type = rawset, setmetatable, type
local is_state = rfsm.is_state
local elements = rfsm.elements

--- Functions from modules in the folders of rfsm/, which are loaded at their first use.
---@class rfsm_checks
---@field findings fun(model: rfsm.State, settings?: table): rfsm_checks.Finding[]
---@field explore fun(model: rfsm.State, options?: table): rfsm_checks.Exploration
---@field why fun(fsm: rfsm.Machine, ...: any): rfsm_checks.Why, string
---@field enabled fun(fsm: rfsm.Machine): any[], string events that do something now
---@field coverage fun(fsm: rfsm.Machine, earlier?: table): rfsm_checks.Coverage
---@field rehearsal fun(chart: string|rfsm.State): rfsm_checks.Rehearsal for tests
---@field record_witness fun(model: rfsm.State, witness: table, sink: table|string)
---@field path_of fun(witness: table): string[] for the option `trace` of a picture
---@field never fun(condition: any): rfsm_checks.Property the condition never holds
---@field always fun(condition: any): rfsm_checks.Property the condition always holds
---@field after fun(event: any): table after(event).reach(condition)
---@field from fun(condition: any): table from(condition).can_reach(condition)
---@field precedes fun(first: any, second: any): rfsm_checks.Property
---@field until_ fun(first: any, second: any): rfsm_checks.Property
---@field at_most fun(count: integer, event: any): table at_most(n, event).within(s)
---@field at_least fun(count: integer, event: any): table
---@field observer fun(chart: rfsm.State): rfsm_checks.Property
---@field watch_properties fun(fsm: rfsm.Machine, given?: table): fun()
local rfsm_checks = {}

-- Watch: undeclared events ------------------------------------------------------

--- The events that a machine knows, in its field `_checks`.
---@class rfsm_checks.Known
---@field events table<any, boolean> empty until the first event comes
---@field predicates function[]|false the predicates; false: not collected yet

local function add_events(known, events)
  for _, event in ipairs(events) do
    known.events[event] = true
    if type(event) == "function" then
      known.predicates[#known.predicates + 1] = event
    end
  end
end

-- Collects the events that transitions, extensions and the engine itself know.
local function collect_known(fsm, known)
  known.events, known.predicates = { e_init_fsm = true }, {}
  for _, tr in ipairs(elements(fsm, rfsm.is_trans)) do
    add_events(known, tr.events or {})
  end
  for _, state in ipairs(elements(fsm, is_state)) do
    add_events(known, rfsm.reactions(fsm, state))
  end
  for _, state in ipairs(elements(fsm, rfsm.can_be_done)) do
    known.events["e_done@" .. state._fqn] = true
  end
end

local function is_known(known, event)
  if known.events[event] then return true end
  for i = 1, #known.predicates do
    local ok, answer = pcall(known.predicates[i], event)
    if ok and answer then return true end
  end
  return false
end

local function check_event(fsm, event)
  if not fsm._checks.predicates then collect_known(fsm, fsm._checks) end
  if is_known(fsm._checks, event) then return end
  rfsm.report(fsm, "warn",
    "WARNING: undeclared event " .. rfsm.event_text(event) .. " received")
end

-- The pre step hook. It is fast, as it runs in every iteration: a declared event takes
-- one access to a table.
local function check_events(fsm)
  local events, known = fsm._curq, fsm._checks.events
  for i = 1, #events do
    if not known[events[i]] then check_event(fsm, events[i]) end
  end
end

-- Has a machine warn of undeclared events. Declared events are collected when the first
-- event comes, since other extensions may declare events until then.
local function watch(fsm)
  if not fsm._checks then rfsm.pre_step_hook_add(fsm, rfsm.borrows(check_events)) end
  fsm._checks = { events = {}, predicates = false }
end

local watches_all = false

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  local is_wanted = fsm.checkevents == true or watches_all and fsm.checkevents ~= false
  if fsm._checks or is_wanted and not merged then watch(fsm) end
end

-- Public functions ------------------------------------------------------------

-- Function of rfsm_checks -> the module that has it, loaded at its first use.
local ELSEWHERE = {
  why = "rfsm.observe.why", enabled = "rfsm.observe.why",
  findings = "rfsm.checks.static", explore = "rfsm.explore.explore",
  coverage = "rfsm.observe.coverage", rehearsal = "rfsm.tests.rehearsal",
  record_witness = "rfsm.tests.rehearsal", path_of = "rfsm.tests.rehearsal",
  never = "rfsm.explore.properties", always = "rfsm.explore.properties",
  after = "rfsm.explore.properties", from = "rfsm.explore.properties",
  precedes = "rfsm.explore.properties", until_ = "rfsm.explore.properties",
  at_most = "rfsm.explore.properties", at_least = "rfsm.explore.properties",
  observer = "rfsm.explore.properties",
  watch_properties = "rfsm.observe.watch_properties",
}

-- Returns the hint for a function that there is not.
local function hint_for(name)
  local advice, names = rfsm.find_module "rfsm.advice", rfsm.sorted_keys(ELSEWHERE)
  for _, own in ipairs(rfsm.sorted_keys(rfsm_checks)) do names[#names + 1] = own end
  return advice and type(name) == "string" and advice.did_you_mean(name, names) or ""
end

setmetatable(rfsm_checks, { __index = function(_, name)
  if not ELSEWHERE[name] then
    local hint = hint_for(name)
    if hint == "" then return nil end
    error("rfsm_checks has no function '" .. name .. "'" .. hint, 2)
  end
  local part = rfsm.find_module(ELSEWHERE[name])
  if not part then
    error(("rfsm_checks.%s: module '%s' is not installed"):format(name,
      ELSEWHERE[name]), 2)
  end
  rfsm_checks[name] = part[name]
  return rfsm_checks[name]
end })

-- Lists the problems and warnings that `rfsm.init` finds.
local function check_early(model)
  local _, problems, warnings = rfsm.verify_early(model)
  for _, line in ipairs(warnings) do problems[#problems + 1] = line end
  return problems
end

--- Find mistakes, dead parts and risks in a model, as lines of text.
--
-- Notes are left out; `rfsm_checks.findings` returns them, too. A field `final = true`
-- declares a leaf without a way out; a field `checks` silences findings of its element.
-- Without the folder rfsm/checks only the problems and warnings of `rfsm.init` are
-- returned, without codes.
--
-- @raise if `model` is no state
---@param model rfsm.State a model, or a machine
---@return string[] lines each "file:line: place: text [code]"; problems first
---@nodiscard
function rfsm_checks.check(model)
  if not is_state(model) then
    error("rfsm_checks.check: state expected, got " .. type(model), 2)
  end
  local static = rfsm.find_module("rfsm.checks.static")
  if not static then return check_early(model) end
  local findings, lines = static.findings(model), {}
  for _, severity in ipairs { "error", "warning" } do
    for _, finding in ipairs(findings) do
      if finding.severity == severity then
        lines[#lines + 1] = static.line(finding)
      end
    end
  end
  return lines
end

--- Have a machine warn of each event that it receives and no transition names.
---@param fsm rfsm.Machine
function rfsm_checks.watch(fsm)
  rfsm.check_machine(fsm, "rfsm_checks.watch")
  watch(fsm)
end

local function set_global(name)
  if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, name, rfsm_checks) end
end

--- Let all machines initialised from now on warn of undeclared events.
--
-- `checkevents = false` in the root of a model excludes its machines. Requiring
-- `rfsm.checkevents` or `rfsm_checkevents` calls this function.
--
---@return table rfsm_checks this module; `require` of these names returns it, too
function rfsm_checks.watch_all()
  watches_all = true
  set_global("rfsm_checkevents")
  return rfsm_checks
end

set_global("rfsm_checks")

return rfsm_checks
