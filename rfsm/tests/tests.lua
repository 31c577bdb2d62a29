--- Tests: runs that together take each transition of a chart that can be taken, on each
--- of its events. They also show which of two enabled transitions is taken.
--
-- The steps come from an exploration with two events in a step. A run goes on to the
-- nearest step that shows something new. If the run is long, and such a step is as near
-- to the start, a new run begins. At the first visit of a leaf, steps are added that
-- the leaf ignores: one without an event, one with an event of no transition, and one
-- with an event to which only other leaves react.
--
-- @module rfsm.tests.tests
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local encoding = require "rfsm.snapshot.encoding"
local explore = require "rfsm.explore.explore"
local graph = require "rfsm.explore.graph"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local location = require "rfsm.shared.location"
local subject = require "rfsm.explore.subject"
local reactions = require "rfsm.explore.reactions"
local rehearsal = require "rfsm.tests.rehearsal"

local error, ipairs, pairs = error, ipairs, pairs
local type = type
local concat = table.concat

local tests = {}

--- Runs of a chart.
---@class rfsm_checks.Tests
---@field runs { steps: rfsm_checks.TestStep[] }[]
---@field steps integer number of steps in all runs
---@field taken integer number of transitions that the exploration has taken
---@field transitions integer number of transitions of the chart
---@field skipped integer planned runs whose repetition gave another result
---@field modules table<string, true> names of extensions whose events the chart names
---@field bound string? the bound that ended the exploration too early

--- A step of a test run, and its result.
---@class rfsm_checks.TestStep
---@field what table the argument of `Rehearsal:step`
---@field result string

-- Returns the transition that is tried after `tr` at the same node; nil if none is.
local function next_of(tr)
  for i, other in ipairs(tr.src._otrs) do
    if other == tr then return tr.src._otrs[i + 1] end
  end
end

-- Steps of the exploration ..........................................................

-- Can an event of a step be written in a spec? It must be a plain value or have a name,
-- and not go to a region.
local function is_plain(occurrence)
  return encoding.is_event(occurrence.event) and not occurrence.part.owner
end

-- Lists the facts that the last step shows, as keys: "taken 3" for transition 3,
-- "taken 3 on 1" if it names event 1, which came, and "taken 3 before 4" if transition
-- 4, which is tried next, was enabled, too.
local function shown_by(own)
  local keys, events = {}, own.last_events
  for _, number in ipairs(own.taken) do
    local tr, key = own.transitions[number].tr, "taken " .. number
    keys[#keys + 1] = key
    for _, event in ipairs(events) do
      if match.names(tr, event) then
        keys[#keys + 1] = key .. " on " .. own:number_of_event(event)
      end
    end
    local following = next_of(tr)
    if following and match.may_enable(following, events) then
      keys[#keys + 1] = key .. " before " .. own.number_of[following]
    end
  end
  return keys
end

-- Returns the set of all facts that steps may show, some of which no step may.
local function facts_of(own)
  local facts = {}
  for number, entry in ipairs(own.transitions) do
    local key, following = "taken " .. number, next_of(entry.tr)
    facts[key] = true
    for _, event in ipairs(entry.tr.events or {}) do
      if type(event) ~= "function" then
        facts[key .. " on " .. own:number_of_event(event)] = true
      end
    end
    if following then facts[key .. " before " .. own.number_of[following]] = true end
  end
  return facts
end

-- Notes the steps of an exploration, which ends when they have shown all facts. Of
-- several steps with the same source, target and facts only the first one is noted.
local function watch_steps(walk)
  local edges, is_noted, own = {}, {}, walk.subject
  local left = facts_of(own)
  own.notes_events = true
  walk:take_two()
  function walk.look(_, from, tgt, events, label)
    local keys = shown_by(own)
    local key = from .. " " .. tgt .. " " .. concat(keys, ",")
    local is_wanted = order.all(events, is_plain) and (tgt ~= from or keys[1])
    if is_noted[key] or not is_wanted then return end
    is_noted[key] = true
    for _, fact in ipairs(keys) do left[fact] = nil end
    walk.has_ended = order.is_empty(left)
    order.append(edges, from, { from = from, tgt = tgt, shows = keys,
      label = label() })
  end
  walk.edges = edges
end

-- Runs ..............................................................................

-- Returns the shortest list of steps from the configuration `start` to a step that
-- shows a fact in `left`.
local function find_way(walk, start, left)
  return graph.find_way(walk.edges, start, function(edge)
    return order.any(edge.shows, function(key) return left[key] end)
  end)
end

local LONG = 12 -- steps; a longer run ends if the start is as near to a new fact

-- Returns runs that together show all facts in `left`. A run is a list of steps.
local function plan(walk, left)
  local runs, run, at = {}, nil, 1
  while true do
    local way = run and find_way(walk, at, left)
    local fresh = (not way or #run + #way > LONG) and find_way(walk, 1, left)
    if not (way or fresh) then return runs end
    if not way or fresh and #fresh <= #way then
      run, way = {}, fresh
      runs[#runs + 1] = run
    end
    for _, edge in ipairs(way) do
      run[#run + 1] = edge
      for _, key in ipairs(edge.shows) do left[key] = nil end
    end
    at = way[#way].tgt
  end
end

-- Steps for the rehearsal ...........................................................

-- Returns the seconds in a timer event such as "e_every(3)@root.a"; else nil or false.
local function seconds_of(event)
  return type(event) == "string" and rfsm.number_of(event:match("^e_after%(([%d.]+)%)@")
    or event:match("^e_every%(([%d.]+)%)@"))
end

local MARGIN = 0.001 -- seconds to wait longer: a timer expires only after its time

-- Returns the argument of `Rehearsal:step` for a step of the exploration. With `waits`
-- the rehearsal lets time pass in place of sending timer events.
local function told_of(walk, own, edge, waits)
  local step = walk:rerun(edge.from, edge.label)
  local what = own:answers_of(step)
  for i = 1, #step.values do
    local seconds = waits and seconds_of(step.values[i])
    if seconds then
      what.after = seconds + MARGIN
    else
      what[#what + 1] = step.values[i]
    end
  end
  return what
end

-- May an event with an unknown name trigger a transition that is tried in `leaf`?
local function takes_any(part, leaf)
  return order.any(location.transitions(part.fsm, leaf), function(tr)
    return match.triggers(tr, "e_unknown") ~= false
  end)
end

-- Lists steps that a leaf ignores: without an event, with an event that no transition
-- names, and with an event to which only other leaves react.
local function steps_at_rest(walk, number)
  local own, conf = walk.subject, walk:configuration(number)
  local leaf = conf[1].leaf
  local found = reactions.of(own.parts[1], leaf)
  local is_open = takes_any(own.parts[1], leaf) or rfsm.regions(leaf)[1]
  if subject.is_driven(conf) or is_open then return {} end
  local goes_on = conf[1].mode == "active" and { location.name_of(leaf, "root") } or nil
  local list = { { goes_on = goes_on }, { "e_unknown" } }
  for _, event in ipairs(own.event_list) do
    local is_named = type(event) == "string" or rfsm.name_with_data(event)
    if is_named and not (found.set[event] or own:maker_of(event)) then
      list[3] = { event }
      break
    end
  end
  return list
end

-- Did the rehearsal take the same transitions to the same leaf as the exploration?
local function is_as_explored(walk, own, edge)
  local step = walk:rerun(edge.from, edge.label)
  local paths = own.subject:paths_of()
  return concat(step.taken, ",") == concat(paths, ",")
    and step.leaf == rfsm.get_actleaf_fqn(own.subject.parts[1].fsm)
end

-- Takes a planned run on a machine. Returns the steps; nil if the machine departs from
-- the plan. With `waits` time passes in place of timer events. Sets `is_seen[leaf]`.
local function rehearse(walk, model, run, waits, is_seen, options)
  local steps = {}
  local own = rehearsal.rehearsal(model, { callbacks = options.callbacks })
  local function add(what)
    steps[#steps + 1] = { what = what, result = own:step(what) }
  end
  for _, edge in ipairs(run) do
    add(told_of(walk, own, edge, waits))
    if not is_as_explored(walk, own, edge) then return nil end
    local leaf = walk:configuration(edge.tgt)[1].leaf
    local at_rest = not is_seen[leaf] and steps_at_rest(walk, edge.tgt) or {}
    is_seen[leaf] = is_seen[leaf] or at_rest[1] ~= nil
    for _, what in ipairs(at_rest) do add(what) end
  end
  return steps
end

-- Public functions ..................................................................

--- Options for the planning of tests.
---@class rfsm_checks.TestOptions
---@field callbacks? boolean run entries, exits and effects
---@field stub? boolean load the file with stubs in place of missing modules
---@field machine? integer number of the machine, if the file is a program with several
---@field file? string the file of the model; each run is repeated on the chart in it
---@field configurations? integer explore so many, at most (1,000,000)
---@field seconds? number explore so long, at most

-- Are the results of a run the same if the chart is loaded from its file again?
local function does_repeat(steps, options)
  if not options.file then return true end
  local own = rehearsal.rehearsal(options.file, { callbacks = options.callbacks,
    stub = options.stub, machine = options.machine })
  return order.all(steps, function(step) return own:step(step.what) == step.result end)
end

--- Plan runs that take every transition of a model that can be taken.
---@param model rfsm.Model
---@param options? rfsm_checks.TestOptions
---@return rfsm_checks.Tests
function tests.plan(model, options)
  options = options or {}
  local walk = explore.walk(model, { timers = "free", seconds = options.seconds,
    configurations = options.configurations }, watch_steps)
  local left, result = {}, { runs = {}, steps = 0,
    taken = #rfsm.sorted_keys(walk.taken), transitions = #walk.subject.transitions,
    skipped = 0, modules = {}, bound = walk.ended_by }
  for _, event in ipairs(walk.subject.event_list) do
    local module = match.maker_of(event) and advice.module_for(event)
    if module then result.modules[module] = true end
  end
  for _, list in pairs(walk.edges) do -- any order: `left` is a set
    for _, edge in ipairs(list) do
      for _, key in ipairs(edge.shows) do left[key] = true end
    end
  end
  local is_seen = {}
  for _, run in ipairs(plan(walk, left)) do
    local steps = rehearse(walk, model, run, true, is_seen, options)
      or rehearse(walk, model, run, false, is_seen, options)
    if steps and does_repeat(steps, options) then
      result.runs[#result.runs + 1] = { steps = steps }
      result.steps = result.steps + #steps
    else
      result.skipped = result.skipped + 1
    end
  end
  return result
end

-- Text ..............................................................................

local function quoted(value)
  local name = rfsm.name_with_data(value)
  if name then return ("{ name = %q }"):format(name) end
  return type(value) == "string" and ("%q"):format(value) or rfsm.text_of(value)
end

local function guard_texts(guards)
  local texts = {}
  for i, name in ipairs(rfsm.sorted_keys(guards or {})) do
    texts[i] = ("[%q] = %s"):format(name, rfsm.text_of(guards[name]))
  end
  return texts
end

local function step_text(what)
  local parts = {}
  local function add(field, items)
    if items[1] then
      parts[#parts + 1] = field .. " = { " .. concat(items, ", ") .. " }"
    end
  end
  for i = 1, #what do parts[i] = quoted(what[i]) end
  if what.after then parts[#parts + 1] = "after = " .. rfsm.text_of(what.after) end
  add("guards", guard_texts(what.guards))
  add("ends", order.map(what.ends or {}, quoted))
  add("goes_on", order.map(what.goes_on or {}, quoted))
  return parts[1] and "run:step { " .. concat(parts, ", ") .. " }" or "run:step()"
end

local HEAD = [[
-- Runs of %s that take %d of its %d transitions, in %d steps.
--
-- %s
-- `guards` has the answers of guards, `ends` and `goes_on` states whose doo does so;
-- `after` lets that many seconds go by. What is asked and not mentioned is part of the
-- result.

%slocal rehearsal = require("rfsm_checks").rehearsal

local here = debug.getinfo(1, "S").source:match("^@(.*/)") or ""
local FILE = %s
local OPTIONS = { %s }

]]

local RUNS = {
  [true] = "Entries, exits and effects run, in the order that is behind the colon.\n"
    .. "-- The field `fakes` of OPTIONS has what they find as globals.",
  [false] = "Callbacks of the chart do not run.",
}

local BEGIN = "-- rfsm check --tests: what stands from here ...\n"
local END = "-- rfsm check --tests: ... to here is written anew.\n"

local WIDTH = 88 -- columns of a line in the spec

local function add_step(lines, step)
  local call, result = step_text(step.what), quoted(step.result)
  local line = ("    assert.equal(%s, %s)"):format(result, call)
  if #line > WIDTH then
    line = ("    assert.equal(%s,\n      %s)"):format(result, call)
  end
  lines[#lines + 1] = line
end

-- Names a run by the leaves that it reaches; a long name lacks leaves in the middle.
local function name_of(run)
  local names = {}
  for _, step in ipairs(run.steps) do
    local leaf = step.result:gsub(", %(.*$", ""):gsub(": .*$", "")
      :match("%-> ([^>]*)$")
    local is_new = leaf and leaf ~= "internal" and leaf ~= names[#names]
    if is_new then names[#names + 1] = leaf end
  end
  local text = concat(names, ", ")
  while #text > WIDTH - 30 and names[3] do
    table.remove(names, #names - 1)
    text = concat(names, ", ", 1, #names - 1) .. " ... " .. names[#names]
  end
  return "goes to " .. text
end

-- Returns a Lua expression for the chart's file, relative to the folder of the spec.
local function file_text(file, output)
  if not output or output == "-" or file:find("^/") then return quoted(file) end
  local folder = output:match("^.*/") or ""
  if folder:find("^/") or folder:find("..", 1, true) then return quoted(file) end
  local first = folder:match("^[^/]*/")
  while first and file:sub(1, #first) == first do
    folder, file = folder:sub(#first + 1), file:sub(#first + 1)
    first = folder:match("^[^/]*/")
  end
  return "here .. " .. quoted(folder:gsub("%.?[^/]*/", "../") .. file)
end

-- Returns the spec `old` with new runs between its marks; without `old`, a new spec.
local function merge(old, head, body)
  if not old or old == "" then return head .. BEGIN .. body .. END end
  local _, from = old:find(BEGIN, 1, true)
  local to = from and old:find(END, from + 1, true)
  if not to then error("the output has no marks of an earlier call: it is kept", 0) end
  return old:sub(1, from) .. body .. old:sub(to)
end

local function options_text(options)
  local texts = { "callbacks = " .. rfsm.text_of(options.callbacks or false) }
  if options.stub then texts[2] = "stub = true" end
  if options.machine then texts[#texts + 1] = "machine = " .. options.machine end
  return concat(texts, ", ")
end

--- Write the runs of a chart as a spec for busted.
---@param file string the file of the chart
---@param model rfsm.Model
---@param options? rfsm_checks.TestOptions
---@param output? string the file of the spec; the chart is loaded relative to it
---@param old? string the present text of `output`; its marked lines are replaced
---@return string text
---@return rfsm_checks.Tests
function tests.busted(file, model, options, output, old)
  options = options or {}
  local result = tests.plan(model, options)
  local modules, blocks = "", {}
  for _, module in ipairs(rfsm.sorted_keys(result.modules)) do
    modules = modules .. ("require %q\n"):format(module)
  end
  for i, run in ipairs(result.runs) do
    local lines = { ("  it(%q, function()"):format(name_of(run)),
      "    local run = rehearsal(FILE, OPTIONS)" }
    for _, step in ipairs(run.steps) do add_step(lines, step) end
    blocks[i] = concat(lines, "\n") .. "\n  end)\n"
  end
  local head = HEAD:format(file, result.taken, result.transitions, result.steps,
    RUNS[options.callbacks or false], modules, file_text(file, output),
    options_text(options))
  return merge(old, head, ("describe(%q, function()\n"):format(file)
    .. concat(blocks, "\n") .. "end)\n"), result
end

return tests
