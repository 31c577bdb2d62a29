--- Reports: what the products of a system show, and which properties hold.
--
-- Machines that a wire or property joins are a group. Groups are explored one by one.
--
-- @module rfsm.system.report
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local codes = require "rfsm.checks.codes"
local data = require "rfsm.explore.data"
local explore = require "rfsm.explore.explore"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local monitors = require "rfsm.explore.monitors"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local product = require "rfsm.system.product"
local properties = require "rfsm.explore.properties"
local reactions = require "rfsm.explore.reactions"
local replacements = require "rfsm.explore.replacements"
local rfsm = require "rfsm"
local sequence = require "rfsm.system.sequence"
local static = require "rfsm.checks.static"
local subject = require "rfsm.explore.subject"
local verdict = require "rfsm.explore.verdict"

local error, ipairs, pcall = error, ipairs, pcall
local setmetatable, type = setmetatable, type
local concat, min = table.concat, math.min

local report = {}

local WHERE = "rfsm.system.explore"

--- The options of an exploration that each machine of a system has for itself.
report.OF_MACHINE = { "alphabet", "classes", "complementary", "deferred", "dry_run",
  "exclusive", "flags", "run", "same", "sends", "vars" }

local OF_SYSTEM = { "configurations", "depth", "progress", "properties", "seconds" }

--- The results of exploring a system; `tostring` returns them as a text.
---@class rfsm.system.Report
---@field configurations integer those that are reached if moves do not cross
---@field crossing integer|false those that are reached if they may; false: not tried
---@field walks rfsm.system.Product[] one for each group of machines
---@field steps integer steps that the engine took
---@field findings rfsm_checks.Finding[] the field `witness` is the run to a finding
---@field properties { name: string, holds: boolean|nil, vacuous?: string }[] verdicts
---@field premises string[] assumptions under which the results hold
---@field bound string? the first bound that was hit
---@field untried string[] what was not tried, as texts
local Report = {}
Report.__index = Report

-- Properties ........................................................................

-- Lists the machines that a property names; all machines if it has a function.
local function machines_in(cell, property)
  local names = {}
  for _, field in ipairs { "what", "goal", "event" } do
    local value = property[field]
    if type(value) == "function" then return cell.names end
    for _, name in ipairs(type(value) == "table" and value or { value }) do
      names[#names + 1] = rfsm.text_of(name):match("^%s*(.-)%s*:")
    end
  end
  return names
end

-- Makes a product watch for the event of a property.
local function watch_event(walk, judged)
  local ok, member, event = pcall(walk.split, walk, judged.property.event)
  if not ok then properties.refuse(WHERE, judged, member) end
  local own = member.subject
  local meant = own:event_meant(event)
  if not (own.event_numbers[meant] or own.free.predicates) then
    properties.refuse(WHERE, judged, ("no transition of '%s' names the event '%s'%s")
      :format(member.name, event, advice.nearest_name(event, own:named_texts())))
  end
  judged.member, judged.event = member, event
  member.wanted[#member.wanted + 1], own.wanted[meant] = event, false
  walk.afters[#walk.afters + 1], judged.owed = judged, {}
end

-- Makes a product judge a property. Raises an error if a product cannot judge its kind.
local function watch(walk, judged)
  if not monitors.kinds[judged.property.kind].judge then
    properties.refuse(WHERE, judged, "it is not judged for a system, expected: never, "
      .. "always, from(...).can_reach or after(...).reach")
  end
  properties.check_names(WHERE, judged, { active = walk:view(walk:configuration(1)) })
  if judged.property.event then watch_event(walk, judged) end
end

-- Findings ..........................................................................

-- Adds a finding. Its witness is the run to the configuration `shown.at`, then the move
-- `shown.label` if there is one, then, if there is a `shown.tgt`, a run to where the
-- system may stay for ever. Returns false, and adds nothing, if the run is doubtful.
local function add_run(walk, findings, code, path, text, shown, where)
  local witness = walk:witness(shown.at, shown.label, shown.tgt)
  if explore.is_doubtful(witness) then return false end
  local finding = findings:add(code, nil, path, text, nil, where)
  if finding then finding.witness = witness end
  return true
end

-- Does a machine wait for an event? It does if it was not entered, or if one of its
-- leaves is not an end and an event can have an effect there.
local function is_waiting(member, conf)
  for i, part in ipairs(member.subject.parts) do
    local leaf = conf[i].leaf
    local is_end = leaf and (leaf.final == true or codes.means(leaf, "an end"))
    local found = (leaf or i == 1) and not is_end and reactions.of(part, leaf)
    if found and (not leaf or found[1] ~= nil or found.any) then return true end
  end
  return false
end

-- Adds a finding if nothing can happen in a configuration, but a machine still waits.
local function add_deadlock(walk, findings, number)
  local texts, waits = {}, false
  for i, member in ipairs(walk.members) do
    local conf = member.confs[walk:configuration(number).numbers[i]]
    local leaves = subject.leaves(conf)
    texts[i] = member.name .. ": " .. (leaves[1] and leaves[#leaves].path
      or "not entered")
    waits = waits or is_waiting(member, conf)
  end
  if waits then
    add_run(walk, findings, "deadlock", concat(texts, ", "),
      "nobody can go on any more", { at = number }, "")
  end
end

local function wire_text(wire)
  return ("wires[%d] (%s %s -> %s)"):format(wire.number, wire.from,
    concat(wire.events, ", "), wire.to)
end

-- Does a transition or an extension ever take an event?
local function takes(member, event)
  return member.takes[event]
    or match.has(alphabet.of_all(member.subject.parts[1].fsm).reactions, event)
end

-- Adds findings about the events of a wire that are never sent, or are never taken.
local function find_in_events(walk, wire, findings, place, where)
  local function add(code, text) findings:add(code, nil, place, text, nil, where) end
  local carried, reader = walk.carries[wire], walk:split(wire.to .. ":")
  if order.is_empty(carried) then
    return add("idle-wire", "no event ever goes over it")
  end
  for _, event in ipairs(wire.events) do
    if not carried[event] then
      add("idle-wire", ("no '%s' ever goes over it"):format(event))
    elseif not takes(reader, event) then
      add("untaken", ("'%s' never takes '%s'"):format(wire.to, event))
    end
  end
end

-- Adds findings about a wire: its events can be lost, are never sent, or never taken.
local function find_in_wire(walk, wire, findings)
  local place = wire_text(wire)
  local where = wire.location ~= "" and wire.location .. ": " or ""
  if walk.lost[wire] then
    add_run(walk, findings, "overflow", place, ("the buffer of %d can be full, the new "
      .. "event is lost"):format(wire.size), walk.lost[wire], where)
  end
  if not walk.bound then find_in_events(walk, wire, findings, place, where) end
end

local WITHOUT_DATA = "'%s' emits '%s' without data, '%s' takes it with data only "
  .. "(events = { '%s' })"
local WITH_DATA = "'%s' emits '%s' with data, '%s' takes the text only (events = { "
  .. "rfsm.named '%s' })"

-- Returns a text if a machine emits an event in another form than a reader takes.
local function other_form(sender, reader, event)
  local known, emitted, with_data = alphabet.of_all(reader),
    replacements.emitted_by(sender)
  if known.takes_any then return nil end
  if with_data[event] then
    return known.set[event] and not known.predicates[1] and WITH_DATA or nil
  end
  return alphabet.needs_data(reader, event) and emitted and WITHOUT_DATA or nil
end

-- Finds events whose data the reader of a wire does not take, or waits for in vain.
local function find_in_data(cell, machines, findings)
  for _, wire in ipairs(cell.wires) do
    for _, event in ipairs(wire.events) do
      local text = other_form(machines[wire.from], machines[wire.to], event)
      if text then
        findings:add("untaken", nil, wire_text(wire), text:format(wire.from, event,
          wire.to, event), nil, wire.location ~= "" and wire.location .. ": " or "")
      end
    end
  end
end

-- Lists the events that a machine emits and that no wire from it carries.
local function unwired_of(cell, name, fsm)
  local wired, list = {}, {}
  for _, wire in ipairs(cell.wires) do
    if wire.from == name then wired = match.joined(wired, wire.events) end
  end
  for _, event in ipairs(replacements.emitted_by(fsm) or {}) do
    local is_new = not match.has(wired, event) and not match.has(list, event)
    if is_new then list[#list + 1] = event end
  end
  return list, wired
end

-- Finds events that no wire carries. A system may leave out a wire, so that such an
-- event is a premise, unless it looks like one that a wire carries.
local function find_unwired(cell, machines, result)
  for _, name in ipairs(cell.names) do
    local list, wired = unwired_of(cell, name, machines[name])
    for _, event in ipairs(list) do
      local hint = advice.did_you_mean(event, wired)
      if hint ~= "" then
        result.findings:add("unwired", nil, name, ("it emits '%s', which no wire from "
          .. "it carries%s"):format(event, hint), nil,
          cell.places[name] and cell.places[name] .. ": " or "")
      else
        result.premises[#result.premises + 1] = ("%s: '%s' goes nowhere, no wire from "
          .. "it carries it"):format(name, event)
      end
    end
  end
end

-- Finds what is wrong before anything moves, in machines that are never run.
local function find_in_texts(cell, result)
  local machines = {}
  for _, name in ipairs(cell.names) do
    machines[name] = static.init(cell.models[name], false)
  end
  find_in_data(cell, machines, result.findings)
  find_unwired(cell, machines, result)
end

local MANY_ALONE = 1000 -- most configurations of a chart that is explored alone

-- Explores a chart alone. Returns the set of the paths of states that are active then.
local function reached_alone(member, model, settings, options)
  local own = { timers = "free", ends = options.ends,
    configurations = min(options.configurations, MANY_ALONE) }
  for _, name in ipairs(report.OF_MACHINE) do own[name] = settings[name] end
  for event in order.each(own.alphabet and member.wired or {}) do -- any order: a set
    own.alphabet = match.with(own.alphabet, event)
  end
  local walk = explore.walk(model, own)
  return verdict.active_in(walk.subject, walk.passed)
end

-- Finds states that are not active in the system, but in the chart alone.
local function find_unreached(member, findings, model, settings, options)
  local own, alone = member.subject, nil
  local active = verdict.active_in(own, member.passed)
  for _, path in ipairs(own.paths) do
    local above = path:match("^(.*)%.[^.]*$")
    if not active[path] and (not above or active[above]) then
      alone = alone or reached_alone(member, model, settings, options)
      if alone[path] then
        findings:add("unreachable", own.names[path], member.name .. ": " .. path,
          "active in no configuration of the system, though the chart alone reaches it")
      end
    end
  end
end

-- The whole .........................................................................

-- Returns the group of each machine. Machines that a wire or property joins have the
-- same group.
local function groups_of(cell, list)
  local group_of = {}
  for _, name in ipairs(cell.names) do group_of[name] = name end
  local function join(a, b)
    local one, other = group_of[a], group_of[b]
    for _, name in ipairs(one and other and cell.names or {}) do
      if group_of[name] == other then group_of[name] = one end
    end
  end
  for _, wire in ipairs(cell.wires) do join(wire.from, wire.to) end
  for _, judged in ipairs(list) do
    local names = machines_in(cell, judged.property)
    judged.first = names[1]
    for _, name in ipairs(names) do join(names[1], name) end
  end
  return group_of
end

local function add_premises(result, walk, settings)
  local function add(text) result.premises[#result.premises + 1] = text end
  for _, member in ipairs(walk.members) do
    local own = member.subject
    local free = rfsm.sorted_keys(own.free)
    if free[1] then add(member.name .. ": " .. concat(free, ", ") .. " free") end
    if member.reads_one then
      add(member.name .. ": one event an iteration, none from outside while one waits")
    end
    if settings[member.name].alphabet then
      add(member.name .. ": no event outside of the alphabet")
    end
    for _, text in ipairs(data.premises(own)) do add(member.name .. ": " .. text) end
  end
  for _, wire in ipairs(walk.wires) do
    add(("%s: %s"):format(wire_text(wire), wire.kind == "data" and "data"
      or "buffer of " .. wire.size))
  end
end

local function add_walk(result, walk, cell, settings, options)
  explore.walk_all(walk, options)
  result.configurations = result.configurations + #walk.keys
  result.steps = result.steps + walk:steps_run()
  result.bound = result.bound or walk.bound
  result.untried = match.joined(result.untried, walk.untried)
  add_premises(result, walk, settings)
  for _, number in ipairs(walk.is_partial and {} or walk.stuck) do
    add_deadlock(walk, result.findings, number)
  end
  for _, wire in ipairs(walk.wires) do find_in_wire(walk, wire, result.findings) end
  for _, member in ipairs(walk.wires[1] and not walk.bound and walk.members or {}) do
    find_unreached(member, result.findings, cell.models[member.name],
      settings[member.name], options)
  end
end

-- Judges a property, and adds a finding if it does not hold.
local function judge(result, judged)
  properties.judge(judged.walk, judged)
  if judged.at and not add_run(judged.walk, result.findings, "violated", judged.name,
    "does not hold", judged, "") then
    judged.holds = nil
  end
end

local function read_settings(cell, options)
  local settings, given = {}, options.machines
  for _, name in ipairs(rfsm.sorted_keys(given)) do
    if not cell.models[name] then location.refuse_name(name, "machine", cell.names) end
  end
  for _, name in ipairs(cell.names) do
    local own, problem = explore.settings(given[name] or {}, report.OF_MACHINE)
    if not own then error(("machines.%s: %s"):format(name, problem), 0) end
    settings[name], own.ends = own, options.ends
  end
  return settings
end

-- Returns the options of each machine, and the products of the groups of machines in a
-- list and by group.
local function new_walks(cell, group_of, options, overlap)
  local settings, walks, by_group = read_settings(cell, options), {}, {}
  for _, name in ipairs(cell.names) do
    local group = group_of[name]
    if not by_group[group] then
      by_group[group] = product.new(cell, group_of, group, settings, overlap)
      walks[#walks + 1] = by_group[group]
    end
  end
  return settings, walks, by_group
end

local CROSSING = "moves cross: others move also between what a machine reads and the "
  .. "events that it emits then, which are put one by one"
local NOT_CROSSING = "moves do not cross: the first event that a machine emits is put "
  .. "in the move that reads, others one by one"

local function explored(cell, options, overlap)
  local list = properties.list_of(WHERE, options.properties)
  local group_of = groups_of(cell, list)
  local ok, settings, walks, by_group = pcall(new_walks, cell, group_of, options,
    overlap)
  if not ok then error(WHERE .. ": " .. rfsm.text_of(settings), 0) end
  local result = setmetatable({ configurations = 0, steps = 0, walks = walks,
    crossing = false, findings = static.new_list(), properties = list, untried = {},
    premises = { "any order, any time", "one event from outside in a move",
      overlap and CROSSING or NOT_CROSSING,
      "a connection for each wire, all of them read at one moment" } }, Report)
  for _, judged in ipairs(list) do
    judged.walk = by_group[group_of[judged.first]] or walks[1]
    watch(judged.walk, judged)
  end
  find_in_texts(cell, result)
  for _, walk in ipairs(walks) do add_walk(result, walk, cell, settings, options) end
  for _, judged in ipairs(list) do judge(result, judged) end
  return result
end

local MANY_CROSSING = 200000 -- most configurations, unless `overlap` is true

-- Explores a system without moves that cross, and then with them. If the second walk
-- comes to a bound, the first one counts, and its verdicts say so.
local function explored_twice(cell, options)
  local first = explored(cell, options, false)
  if options.overlap == false or first.bound then return first end
  if not options.overlap then
    options.configurations = min(options.configurations, MANY_CROSSING)
  end
  local result = explored(cell, options, true)
  if result.bound and options.overlap == nil then
    first.premises[3] = NOT_CROSSING .. "; not tried with moves that cross: "
      .. concat(result.untried, "; ")
    return first
  end
  result.crossing = result.configurations
  result.configurations = first.configurations
  result.steps = result.steps + first.steps
  return result
end

--- Explore a system: every configuration that its machines can reach together.
--
-- @raise if an option is wrong
---@param cell rfsm.System
---@param options? table `machines`: options of `rfsm_checks.explore` by machine;
-- `properties`, `configurations`, `depth`, `seconds`, `progress`; `overlap`: may others
-- move between what a machine reads and the first event that it emits then? By default
-- they may, if that stays within the bounds
---@return rfsm.system.Report
function report.explore(cell, options)
  local settings, problem = explore.settings(options or {}, OF_SYSTEM, {
    machines = { "table of options by machine", opts.is_a("table"), {} },
    overlap = { "boolean", opts.is_a("boolean") } })
  if not settings then error(WHERE .. ": " .. problem, 0) end
  return explored_twice(cell, settings)
end

-- Text ..............................................................................

local FAIR = " (each machine moves again and again, doos end)"

local function property_line(judged, are_crossing)
  if judged.holds == nil then return judged.name .. ": not known" end
  return judged.name .. ": holds" .. (are_crossing and "" or " if moves do not cross")
    .. (judged.event and FAIR or "")
    .. (judged.vacuous and " vacuously, " .. judged.vacuous or "")
end

--- Return the lines of a report without its findings.
---@param has_numbers boolean? begin with the numbers of configurations and steps
---@return string[] lines
function Report:summary(has_numbers)
  local lines = {}
  if has_numbers or self.bound then
    lines[1] = ("%d configurations%s, %d steps run"):format(self.configurations,
      self.crossing and (", %d with moves that cross"):format(self.crossing) or "",
      self.steps)
  end
  if self.bound then
    lines[2] = "not tried: " .. concat(self.untried, "; ") .. "; what was not found is "
      .. "not known"
  end
  for _, judged in ipairs(self.properties) do
    if judged.holds ~= false then
      lines[#lines + 1] = property_line(judged, self.crossing)
    end
  end
  lines[#lines + 1] = "premises: " .. concat(self.premises, "; ")
  return lines
end

function Report:__tostring()
  local lines = self:summary(true)
  for _, finding in ipairs(self.findings) do
    lines[#lines + 1] = static.line(finding)
    for _, line in ipairs(sequence.lines_of(finding.witness or {})) do
      lines[#lines + 1] = "  " .. line
    end
  end
  return concat(lines, "\n")
end

return report
