-- Systems against brute force: two or three random charts with timers, predicates,
-- deferred events and sequential AND states, joined by random wires. Whatever random
-- runs of the real machines reach was reached, no verdict is refuted by one, and each
-- witness leads to its end on real machines. A callback may emit several events, which
-- go one by one into wires of several events; some machines take one event at once.

local alphabet = require "rfsm.shared.alphabet"
local charts = require "spec.support.claims.explore"
local exploration = require "rfsm.explore.explore"
local match = require "rfsm.shared.match"
local names = require "rfsm.observe.names"
local reactions = require "rfsm.explore.reactions"
local new_random = require "spec.support.random"
local report = require "rfsm.system.report"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local rfsm_timeevent = require "rfsm_timeevent"
local run_seeds = require "spec.support.run_seeds"
local subject = require "rfsm.explore.subject"
local system = require "rfsm.system"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local claim = { name = "systems and random runs", runs = 20 }

local BOUND = 700 -- configurations: systems that have more are left out

local MOST_ALONE = 15 -- configurations of a machine alone

-- Systems ---------------------------------------------------------------------------

-- Returns the callbacks of a chart; some emit events.
local function emitting(make, emits)
  local own = {}
  for name, f in pairs(make) do own[name] = f end -- any order: a copy
  for _, field in ipairs { "effect", "entry" } do
    own[field] = function(id)
      local f, events = make[field] and make[field](id), emits[field .. " " .. id]
      if not events then return f end
      return function(fsm, ...)
        if f then f(fsm, ...) end
        for _, event in ipairs(events) do fsm.emit(event) end
      end
    end
  end
  return own
end

local function yes() return function() return true end end

local FREE = { guard = yes, predicate = yes, doo = yes }

-- Returns a random chart that has few configurations alone.
local function small_chart(random)
  while true do
    local chart = charts.chart(random:below(100000), random:chance(80) and 2 or nil)
    local model = charts.model_of(chart, FREE, "")
    local walk = exploration.walk(model, { configurations = MOST_ALONE,
      timers = "free" })
    if walk.bound ~= "configurations" then return chart end
  end
end

-- Returns a chart of a system: what it emits by callback, as here and as an option.
local function new_member(random, name)
  local chart = small_chart(random)
  local member = { name = name, chart = chart, emits = {}, sends = {},
    read = random:chance(25) and "one" or nil }
  local function add_emits(field, id, path)
    local events, sends = {}, {}
    for i = 1, random:chance(60) and 1 or random(3) do
      events[i] = "e" .. random(4)
      sends[i] = { emit = events[i] }
    end
    member.emits[field .. " " .. id], member.sends[field .. " " .. path] = events, sends
  end
  local path_of = charts.paths_of(chart)
  member.path_of = path_of
  for _, number in ipairs(rfsm.sorted_keys(path_of)) do
    if random:chance(40) then add_emits("effect", number, path_of[number]) end
  end
  for _, fqn in ipairs(chart.names) do
    if chart.nodes[fqn].kind == "state" and random:chance(10) then
      add_emits("entry", fqn, fqn)
    end
  end
  member.fsm = rfsm.init(charts.model_of(chart, {}, ""))
  member.known = alphabet.of_all(member.fsm)
  return member
end

local function takes(member, event)
  return member.known.takes_any or names.is_event(member.fsm, event)
end

local function does_emit(member, event)
  for _, events in pairs(member.emits) do -- any order: is it there?
    if match.has(events, event) then return true end
  end
end

-- Adds an event to the last wire between two machines, or in a wire of its own.
local function add_event(random, wires, last, from, event, to)
  if last and random:chance(50) then
    table.insert(last.events, event)
    return last
  end
  local kind = random:chance(30) and "data" or "buffer"
  wires[#wires + 1] = { from = from.name, events = { event }, to = to.name,
    kind = kind, size = kind == "buffer" and random(3) or nil }
  return wires[#wires]
end

local function new_wires(random, members)
  local wires, is_there, last = {}, {}, {}
  for _ = 1, 2 + random(6) do
    local from, to = random:pick(members), random:pick(members)
    local event = "e" .. random(4)
    local pair = from.name .. to.name
    if takes(to, event) and does_emit(from, event) and not is_there[pair .. event] then
      is_there[pair .. event] = true
      last[pair] = add_event(random, wires, last[pair], from, event, to)
    end
  end
  return wires
end

local NAMES = { "a", "b", "c" }

-- Returns a random system: its members, wires, and the options of an exploration.
local function new_system(seed)
  local random, members = new_random(seed), {}
  for i = 1, random:chance(70) and 2 or 3 do
    members[i] = new_member(random, NAMES[i])
    members[NAMES[i]] = members[i]
  end
  local options = { machines = {}, configurations = BOUND, properties = {},
    overlap = random:chance(40) }
  for _, member in ipairs(members) do
    options.machines[member.name] = random:chance(8) and { dry_run = true }
      or { sends = member.sends }
  end
  return { members = members, wires = new_wires(random, members), options = options,
    random = random }
end

-- Returns the cell of a system, made with callbacks by name.
local function cell_of(own, make_of)
  local given = { wires = own.wires }
  for _, member in ipairs(own.members) do
    given[member.name] = charts.model_of(member.chart,
      emitting(make_of(member), member.emits), "")
    given[member.name].read = member.read
  end
  return system(given)
end

local function states_of(member)
  local paths = { member.name .. ": root" }
  for _, path in ipairs(rfsm.elements(member.fsm, rfsm.is_leaf)) do
    paths[#paths + 1] = member.name .. ": " .. path._fqn
  end
  return paths
end

-- Adds random properties; those of all kinds that are judged.
local function add_properties(own)
  local random, members, list = own.random, own.members, own.options.properties
  local function state() return random:pick(states_of(random:pick(members))) end
  local function event()
    local member = random:pick(members)
    for _ = 1, 20 do
      local name = "e" .. random(4)
      if match.has(member.known.list, name) then return member.name .. ": " .. name end
    end
  end
  for _ = 1, 2 do
    list[#list + 1] = rfsm_checks.never { state(), state() }
    list[#list + 1] = rfsm_checks.from(state()).can_reach(state())
    for _ = 1, 2 do
      local name = event()
      list[#list + 1] = name and rfsm_checks.after(name).reach(state())
    end
  end
end

-- Random runs -----------------------------------------------------------------------

-- The machines of a system that run, with a clock and random answers.
local function new_run(own, seed)
  local run = { own = own, random = new_random(seed), worlds = {}, now = 0, seen = {},
    came = {}, late = {} }
  run.cell = cell_of(own, function(member)
    local world = { random = run.random, seen = {}, sends = {}, flags = {}, sets = {},
      steps = 0 }
    run.worlds[member.name] = world
    return charts.wanderer(world, function() end)
  end)
  run.cell:shuffle(run.random(100000) * 9973)
  for _, member in ipairs(own.members) do
    for _, entry in ipairs(rfsm.machines(run.cell.machines[member.name])) do
      entry.machine.gettime = function() return run.now, 0 end
      entry.machine.dbg = function(id)
        if id == "TIMEEVENT" then run.fired = run.fired + 1 end
      end
    end
    rfsm.pre_step_hook_add(run.cell.machines[member.name], function(fsm, events)
      for _, event in ipairs(events) do
        local name = member.name .. ": " .. tostring(event)
        if fsm._act_leaf then run.came[name] = true end
      end
    end)
  end
  return run
end

-- Returns the states of all machines as a text.
local function states_in(run)
  local texts = {}
  for i, member in ipairs(run.own.members) do
    local stands = charts.stands_of(run.cell.machines[member.name], {})
    texts[i] = member.name .. " " .. stands[#stands]
  end
  return table.concat(texts, "; ")
end

-- Returns the configuration as a text.
local function stand_of(run)
  local texts = { states_in(run) }
  for i, queue in ipairs(run.cell.queues) do
    texts[#texts + 1] = i .. ":" .. table.concat(queue, ",")
  end
  for _, member in ipairs(run.own.members) do
    for _, put in ipairs(run.cell.unsent[member.name]) do
      texts[#texts + 1] = put.wire .. ">" .. put.event
    end
  end
  return table.concat(texts, "; ")
end

local function is_active(run, name)
  local machine, path = name:match("^(.-): (.*)$")
  local leaf = run.cell.machines[machine]._act_leaf
  while leaf do
    if leaf._fqn == path then return true end
    leaf = not rfsm.is_root(leaf) and leaf._parent
  end
  return false
end

-- Moves a machine with events from outside, unless it is busy with events of its own.
-- Returns how many events have come from outside.
local function move_with(run, member, events)
  local fsm, is_one, wanted = run.cell.machines[member.name], member.read == "one", nil
  local is_busy = run.cell.unsent[member.name][1]
    or is_one and rfsm.check_events(fsm) > 0
  if is_busy then events = {} end
  if events[1] and is_one then wanted = false end
  local holds = run.own.options.overlap and run.random:chance(50)
  run.cell:move(member.name, events, wanted, holds)
  if holds and not match.has(run.own.readers, member.name) then
    run.late[member.name] = true
  end
  return #events
end

-- Moves a random machine. Returns whether more than one event came from outside.
local function move(run, is_alone)
  local random = run.random
  local member, events = random:pick(run.own.members), {}
  local fsm = run.cell.machines[member.name]
  run.fired, run.came = 0, {}
  local wait = random:chance(25) and not is_alone and rfsm_timeevent.next_deadline(fsm)
  if wait then
    run.now = run.now + wait + 0.0000001
  elseif not is_alone and random:chance(50) then
    events[1] = random:pick(member.outside)
  end
  run.worlds[member.name].steps = run.worlds[member.name].steps + 1
  local count = move_with(run, member, events)
  return run.fired + count > 1
end

-- Notes what is seen. A machine that reads no wire never waits in the product before it
-- puts its first event, so then only the states of the machines are noted.
local function note(run)
  for name in pairs(run.late) do -- any order: each stands alone
    if not run.cell.unsent[name][1] then run.late[name] = nil end
  end
  run.seen["states " .. states_in(run)] = true
  if next(run.late) == nil then run.seen[stand_of(run)] = true end
  for i in ipairs(run.cell.wires) do
    if run.cell.lost[i] > 0 then run.seen["lost " .. i] = true end
    if run.cell.queues[i][1] then run.seen["carries " .. i] = true end
  end
  for name, world in pairs(run.worlds) do -- any order: sets
    for text in pairs(world.seen) do run.seen[name .. " " .. text] = true end
  end
end

-- Appends the properties that hold and that a run refutes.
local function refute(run, judged, fail)
  local what = judged.property.kind == "never" and judged.property.what
  if what and is_active(run, what[1]) and is_active(run, what[2]) then
    fail(judged.name .. " was refuted")
  end
end

local LONG = 600 -- moves in which what has to come has come

-- Follows a property that says what comes some time, by moves without an event.
local function await(run, judged, fail)
  local property = judged.property
  for _ = 1, LONG do
    if is_active(run, property.goal) then return end
    move(run, true)
  end
  fail(judged.name .. " was refuted: it does not come")
end

local function run_at_random(own, seed, result, fail)
  local run, awaited = new_run(own, seed), 0
  for _ = 1, claim.runs do
    for _ = 1, run.random(30) do
      if move(run) then break end
      note(run)
      local due
      for _, judged in ipairs(result.properties) do
        if judged.holds then
          refute(run, judged, fail)
          local property = judged.property
          due = due or property.kind == "after" and run.came[property.event] and judged
        end
      end
      if due and awaited < 10 then
        awaited = awaited + 1
        await(run, due, fail)
        break
      end
    end
    run.cell:reset()
    run.late = {}
    for _, world in pairs(run.worlds) do world.steps = world.steps + 1 end
  end
  return run.seen
end

-- Exploration -----------------------------------------------------------------------

-- Returns what the products show of the machines.
local function shown_by(result)
  local shown = {}
  for _, walk in ipairs(result.walks) do
    for _, member in ipairs(walk.members) do
      for _, conf in ipairs(member.confs) do
        for _, leaf in ipairs(subject.leaves(conf)) do
          for _, path in ipairs(leaf.paths) do
            shown[member.name .. " entered " .. path] = true
          end
        end
      end
      for _, moves in pairs(member.moves) do -- any order: sets
        for _, list in pairs(moves) do
          for _, outcome in ipairs(list) do
            for _, path in ipairs(outcome.taken) do
              shown[member.name .. " taken " .. path] = true
            end
            for _, moment in ipairs(outcome.passed) do
              for path in pairs(moment.active) do
                shown[member.name .. " entered " .. path] = true
              end
            end
          end
        end
      end
    end
  end
  return shown
end

-- Returns the text of a configuration as `stand_of`, and as `states_in`; one walk has
-- all machines.
local function stand_in(own, walk, number)
  local conf, texts = walk:configuration(number), {}
  for i, member in ipairs(own.members) do
    for at, each in ipairs(walk.members) do
      if each.name == member.name then
        local parts, stands = each.subject.parts, {}
        for n, position in ipairs(each.confs[conf.numbers[at]]) do
          stands[n] = parts[n].prefix .. " " .. (position.leaf
            and position.leaf._fqn .. " " .. position.mode or "none")
        end
        texts[i] = member.name .. " " .. table.concat(stands, "; ") .. " "
      end
    end
  end
  local states = table.concat(texts, "; ")
  texts = { states }
  for at, queue in ipairs(conf.queues) do
    local list = {}
    for i, put in ipairs(queue) do list[i] = put.name end
    texts[#texts + 1] = at .. ":" .. table.concat(list, ",")
  end
  for i in ipairs(own.members) do
    for _, put in ipairs(conf.unsent[i]) do
      texts[#texts + 1] = put.at .. ">" .. put.name
    end
  end
  return table.concat(texts, "; "), states
end

-- Calls `fail` if what comes to a machine comes by a wire alone.
local function check_outside(own, step, fail)
  for _, occurrence in ipairs(step.occurrences) do
    local event = occurrence.event
    local is_right = occurrence.part.owner or event == reactions.OTHER
      or match.maker_of(event) or match.has(own.members[step.machine].outside, event)
    if not is_right then fail(tostring(event) .. " comes by a wire alone") end
  end
end

-- Follows a witness on machines of its own. Returns the run.
local function follow(own, witness, fail)
  local run, answer_by = { own = own }, {}
  run.cell = cell_of(own, function()
    local world = { random = new_random(1), seen = {}, sends = {}, flags = {},
      sets = {} }
    local make = charts.wanderer(world, function() end)
    answer_by[#answer_by + 1] = charts.answering(make)
    return make
  end)
  for _, fsm in pairs(run.cell.machines) do -- any order: each stands alone
    for _, entry in ipairs(rfsm.machines(fsm)) do
      entry.machine.gettime = function() return 0, 0 end
    end
  end
  for _, step in ipairs(witness) do
    check_outside(own, step, fail)
    for _, begin in ipairs(answer_by) do begin(step.choices) end
    local machine_of, events = {}, {}
    for _, entry in ipairs(rfsm.machines(run.cell.machines[step.machine])) do
      machine_of[entry.prefix] = entry.machine
    end
    for _, occurrence in ipairs(step.occurrences) do
      if occurrence.part.owner then
        charts.send(machine_of[occurrence.part.prefix], occurrence.event)
      elseif match.maker_of(occurrence.event) == "fault" then
        charts.send(run.cell.machines[step.machine], occurrence.event)
      else
        events[#events + 1] = occurrence.event
      end
    end
    run.before = { unpack(run.cell.lost) }
    run.cell:move(step.machine, events, step.read[1] or false, step.holds)
  end
  return run
end

-- The claim -------------------------------------------------------------------------

-- Appends the configurations whose witness does not lead there, of some.
local function follow_some(own, walk, fail)
  for _ = 1, 15 do
    local number = own.random:below(#walk.keys)
    local run = follow(own, walk:witness(number), fail)
    if stand_of(run) ~= stand_in(own, walk, number) then
      fail(("%s is not reached but %s"):format(stand_in(own, walk, number),
        stand_of(run)))
    end
  end
end

-- Does nothing happen any more, whoever moves, and whatever comes?
local function try_all(run, fail)
  local stand = stand_of(run)
  for _, member in ipairs(run.own.members) do
    for _, entry in ipairs(rfsm.machines(run.cell.machines[member.name])) do
      entry.machine.gettime = function() return 1000, 0 end
    end
    for i = 0, #member.outside do
      run.cell:move(member.name, { member.outside[i] })
      if stand_of(run) ~= stand then return fail(stand .. " is no deadlock") end
    end
  end
end

-- Does the end of a witness show what a finding says?
local function check_end(finding, run, judged, fail)
  local what = judged and judged.property.kind == "never" and not judged.label
    and judged.property.what
  if what and not (is_active(run, what[1]) and is_active(run, what[2])) then
    fail(judged.name .. ": its witness does not show it")
  end
  local number = finding.code == "overflow"
    and tonumber(finding.place:match("^wires%[(%d+)"))
  if number and not (run.before[number] == 0 and run.cell.lost[number] > 0) then
    fail(finding.place .. ": no event is lost")
  end
  if finding.code == "deadlock" then try_all(run, fail) end
end

local function follow_findings(own, result, fail)
  local judged_of = {}
  for _, judged in ipairs(result.properties) do judged_of[judged.name] = judged end
  for _, finding in ipairs(result.findings) do
    if finding.witness then
      local run = follow(own, finding.witness, fail)
      check_end(finding, run, judged_of[finding.place], fail)
    end
  end
end

-- Sets the events that may come to each machine from outside.
local function set_outside(own, result)
  for _, walk in ipairs(result.walks) do
    for _, each in ipairs(walk.members) do
      local list = { "e_?" }
      for _, event in ipairs(charts.outside_events(each.subject)) do
        if not each.wired[event] then list[#list + 1] = event end
      end
      own.members[each.name].outside = list
    end
  end
end

-- Adds what a product of all machines shows.
local function add_whole(own, walk, shown)
  for i, wire in ipairs(walk.wires) do
    shown["carries " .. i] = next(walk.carries[wire]) and true
    shown["lost " .. i] = walk.lost[wire] and true
  end
  for number = 1, #walk.keys do
    local text, states = stand_in(own, walk, number)
    shown[text], shown["states " .. states] = true, true
  end
end

-- Appends what was seen and is not shown.
local function check_seen(own, seen, shown, is_whole, fail)
  for text in pairs(seen) do -- any order: sorted
    local name, number = text:match("^(%w+) taken (.*)$")
    local known = name and ("%s taken %s"):format(name,
      own.members[name].path_of[number]) or text
    local is_of_machine = is_whole or name or text:find(" entered ", 1, true)
    if is_of_machine and not shown[known] then fail(known .. " was seen") end
  end
end

local function explore(own)
  local cell = cell_of(own, function() return FREE end)
  own.readers = {}
  for i, wire in ipairs(own.wires) do own.readers[i] = wire.to end
  return report.explore(cell, own.options)
end

-- Appends in which way exploring the system of `seed` and random runs differ.
local function compare(seed, list)
  local own = new_system(seed)
  add_properties(own)
  local function fail(text)
    text = seed .. ": " .. text
    if not match.has(list, text) then list[#list + 1] = text end
  end
  local result = explore(own)
  if result.bound then return end
  set_outside(own, result)
  local shown, walk = shown_by(result), result.walks[1]
  local seen = run_at_random(own, seed, result, fail)
  local is_whole = #walk.members == #own.members
  if is_whole then
    add_whole(own, walk, shown)
    follow_some(own, walk, fail)
    follow_findings(own, result, fail)
  end
  check_seen(own, seen, shown, is_whole, fail)
  return true
end

claim.run = run_seeds(compare)

return claim
