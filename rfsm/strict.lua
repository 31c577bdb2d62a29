--- Strict: warns of events that are undeclared, too early or lost, of functions and
--- fields that do not exist, and of a run that does not end.
--
-- Machines whose root has `strict = true` are watched; if the environment has
-- RFSM_STRICT=1, all machines are. The core then loads this module. Warnings name the
-- caller's file and line. A machine gives each warning once.
--
-- @module rfsm.strict
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"

local getmetatable, ipairs, next = getmetatable, ipairs, next
local rawequal, rawget, select = rawequal, rawget, select
local type = type
local concat = table.concat
local getinfo = (rawget(_G, "debug") or {}).getinfo
local text_of = rfsm.text_of

local strict = {}

-- The strict machine that was made last. It warns of functions that rfsm does not have.
local latest = nil

--- The notes about a machine, in its field `_strict`.
---@class rfsm.strict.Notes
---@field told table<string, true> warnings that were given
---@field models table<table, table> element -> the callbacks that its model had
---@field path rfsm.Transition[]|false the path that this iteration has taken
---@field count integer|false iterations since `rfsm.run` was called
---@field event any the first event of the last iteration that had events
---@field event_at integer the value of `count` in that iteration
---@field chains table a list, and by machine: see `check_chain`
---@field structure table|false the structure to which `known` belongs
---@field known rfsm.Alphabet|false the events of the machine

local function warn(fsm, text)
  if fsm._strict.told[text] then return end
  fsm._strict.told[text] = true
  rfsm.report(fsm, "warn", "WARNING: " .. text)
end

-- Events ............................................................................

-- Returns two lists: the names of all events, and the names of the events with data.
local function names_of(known)
  local names, named = {}, {}
  for _, list in ipairs { known.list, known.reactions } do
    for _, event in ipairs(list) do names[#names + 1] = rfsm.event_text(event) end
  end
  for _, predicate in ipairs(known.predicates) do
    named[#named + 1] = rfsm.event_name(predicate)
  end
  return names, named
end

-- Returns the hint for an event that no transition names.
local function hint_for(known, event)
  local names, named = names_of(known)
  local other = rfsm.number_of(event)
  if type(event) == "string" and other and known.set[other] then
    return (" (did you mean the number %s?)"):format(event)
  end
  for _, name in ipairs(named) do
    if name == event then return (" (did you mean { name = '%s' }?)"):format(name) end
  end
  for _, name in ipairs(event == "e_done" and names or {}) do
    if name:find("^e_done@") then return " (the machine makes " .. name .. ")" end
  end
  if known.set["e_" .. text_of(event)] then event = "e_" .. event end
  return advice.nearest_name(text_of(event), names)
end

-- Returns the name that a table has in another field than `name`: { type = "e_go" } or
-- { "e_go", n = 1 }. It counts if a transition names it. A large table is no event that
-- was written by hand; it is not looked at, because it may come often.
local function name_meant(known, event)
  local count = 0
  for _ in order.each(event) do -- any order: counted
    count = count + 1
    if count > 20 then return nil end
  end
  for _, key in ipairs(rfsm.sorted_keys(event)) do
    local value = event[key]
    local is_known = type(value) == "string"
      and (known.set[value] or known.set[rfsm.named(value)])
    if is_known and (key ~= 1 or event[2] == nil) then return key, value end
  end
end

-- Returns the warning for a table without a name.
local function oddness_of_nameless(known, event)
  local key, value = name_meant(known, event)
  local _, named = names_of(known)
  if event.name ~= nil and event[1] == nil then
    return "name: text expected, " .. rfsm.got(event.name)
  elseif event[1] ~= nil and not (key == 1 and next(event, 1) ~= nil) then
    return "a list is one event (did you mean rfsm.send_events(fsm, unpack(list))?)"
  elseif key ~= nil then
    return ("the table has no field 'name' (did you mean name = '%s' in place of %s?)")
      :format(value, key == 1 and "the first item" or "'" .. text_of(key) .. "'")
  elseif named[1] then
    return "the table has no field 'name'" .. advice.nearest_name("name", named)
  end
  return "a table is an event of its own, as each argument is"
end

-- Returns the warning for an event that is a plain table. A table with a field `name`
-- is an event with data.
local function oddness_of_table(known, event)
  local _, named = names_of(known)
  local name = rfsm.name_with_data(event)
  if not name or event[1] ~= nil then return oddness_of_nameless(known, event) end
  if not (known.set[name] or named[1]) then
    return "a table is an event of its own, as each argument is"
  end
  return ("no transition names the event { name = '%s' }%s"):format(name,
    known.set[name] and (" (did you mean '%s', or rfsm.named '%s' in the chart?)")
      :format(name, name) or advice.nearest_name(name, named))
end

local function is_state_name(fsm, event)
  return order.any(rfsm.elements(fsm, rfsm.is_state), function(state)
    return state._id == event or state._fqn == event
  end)
end

local function oddness_of(fsm, known, event)
  if type(event) == "table" and not getmetatable(event) then
    return oddness_of_table(known, event)
  elseif type(event) ~= "string" then
    local hint = type(event) == "number" and hint_for(known, event) or ""
    return ("no transition names the event %s%s"):format(rfsm.event_text(event), hint)
  elseif is_state_name(fsm, event) then
    return ("'%s' is the name of a state, no event%s"):format(event,
      known.set["e_" .. event] and hint_for(known, event) or "")
  elseif event:match("^[^(@]*"):find("[,|%s]") then
    local hint = advice.event_meant(event)
    return ("'%s' is one event%s"):format(event,
      hint ~= "" and hint or " (write an argument for each)")
  end
  return ("no transition names the event '%s'%s"):format(event, hint_for(known, event))
end

-- Warns once of an event that comes before the machine is entered.
local function check_early(fsm, at, event)
  local name = rfsm.event_text(event)
  local told = fsm._strict.told
  local is_late = rfsm.get_sta_mode(fsm) ~= "inactive" or fsm.read == "one"
  if told["early: " .. name] or is_late then return end
  told["early: " .. name] = true
  warn(fsm, ("%sevent '%s' is sent before the first step, whose entry consumes it")
    :format(at, name))
end

-- Returns the alphabet of a machine: the events that it knows. A merge renews it.
local function alphabet_of(fsm)
  local notes, structure = fsm._strict, rfsm.structure_of(fsm)
  if notes.structure ~= structure then
    notes.structure, notes.known = structure, alphabet.of_all(fsm)
  end
  return notes.known
end

-- Checks events that are sent to a machine. `at` is the sender, such as "lamp.lua:7: ".
local function check_events(fsm, at, ...)
  local known = alphabet_of(fsm)
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    if event == nil then
      warn(fsm, ("%sargument %d is nil, which is no event (is it a name without "
        .. "quotes?)"):format(at, i))
    elseif not alphabet.has(known, event) then
      warn(fsm, at .. oddness_of(fsm, known, event))
    else
      check_early(fsm, at, event)
    end
  end
end

-- The folder of this library, with which the chunk names of its modules begin.
local own_folder = getinfo and getinfo(1, "S").source:match("^(@.*rfsm/)") or "none"

-- Returns the place, such as "lamp.lua:7: ", from which the caller of this function was
-- called; "" if the place is in this library.
local function caller()
  local info = getinfo and getinfo(3, "Sl")
  local is_own = info and info.source:sub(1, #own_folder) == own_folder
  return info and info.currentline > 0 and not is_own
    and ("%s:%d: "):format(info.short_src, info.currentline) or ""
end

-- Is a machine watched? A region is not: it gets the events of its parent machine,
-- which were checked there.
local function is_watched(fsm)
  return rfsm.is_root(fsm) and fsm._strict and not rawget(fsm, "_owner")
end

-- Functions ........................................................................

-- Functions that programs call as methods of a machine, by mistake.
local METHODS = { run = true, step = true, send_events = true, reset = true,
  is_in = true, is_idle = true }

-- Fields in which other libraries have the active state.
local STATE_FIELDS = { state = true, current = true, current_state = true,
  currentState = true, active_state = true, active = true }

-- Returns the function that was meant by a field that a machine does not have.
local function function_for(name)
  return METHODS[name] and ("rfsm.%s(fsm)"):format(name)
    or STATE_FIELDS[name] and "rfsm.get_actleaf_fqn(fsm)"
end

-- Warns of reads of functions that do not exist: rfsm.send_event, fsm:run().
local function watch_reads()
  local Library, Machine = getmetatable(rfsm), getmetatable(latest)
  local load_field, defaults, told = Library.__index, Machine.__index, {}
  function Library.__index(_, name)
    local value = load_field(rfsm, name)
    local is_new = value == nil and type(name) == "string" and not told[name]
    local hint = is_new and advice.function_meant(name) or ""
    if hint == "" then return value end
    told[name] = true
    rfsm.report(latest, "warn", ("WARNING: %srfsm has no function '%s'%s"):format(
      caller(), name, hint))
  end
  function Machine.__index(machine, name)
    local value = defaults[name]
    local meant = value == nil and function_for(name)
    if meant and rawget(machine, "_strict") then
      warn(machine, ("%sa machine has no field '%s' (did you mean %s?)"):format(
        caller(), name, meant))
    end
    return value
  end
end

-- Replaces rfsm.send_events and rfsm.run by functions that check their arguments first.
local function watch_calls()
  local send_events, run = rfsm.send_events, rfsm.run
  function rfsm.send_events(fsm, ...)
    if is_watched(fsm) then check_events(fsm, caller(), ...) end
    return send_events(fsm, ...)
  end
  function rfsm.run(fsm, ...)
    if is_watched(fsm) and select("#", ...) > 0 then
      warn(fsm, caller() .. "rfsm.run takes a machine only (did you mean "
        .. "rfsm.send_events?)")
    end
    if is_watched(fsm) then fsm._strict.count = 0 end
    return run(fsm)
  end
end

-- Fields ............................................................................

local CALLBACKS = { state = { "entry", "exit", "doo" },
  transition = { "guard", "effect" }, connector = {} }

-- Returns the callbacks that an element's model has.
local function callbacks_of_model(obj)
  local model, callbacks = rfsm.model_of(obj), {}
  for _, field in ipairs(CALLBACKS[rfsm.kind_of(obj)]) do
    callbacks[field] = model[field]
  end
  return callbacks
end

-- Warns of a callback that was put into the model after the machine was made.
local function check_model(fsm, obj)
  local notes, model = fsm._strict.models, callbacks_of_model(obj)
  notes[obj] = notes[obj] or model
  for field, value in order.each(model) do -- any order: each has its own text
    if not rawequal(notes[obj][field], value) then
      warn(fsm, ("%s: was set in the model after rfsm.init (set it in the machine)")
        :format(rfsm.location_of(obj, field)))
    end
  end
end

-- Is a value an element that was put into a machine after rfsm.init? Such an element is
-- not a part of the machine.
local function is_foreign(value)
  return rfsm.is_fsmobj(value) and rawget(value, "_parent") == nil
end

-- Warns of callbacks that cannot be called.
local function check_callbacks(fsm, obj)
  for _, field in ipairs(CALLBACKS[rfsm.kind_of(obj)]) do
    local value = obj[field]
    if value and not rfsm.is_callable(value) then
      warn(fsm, ("%s: function expected, got %s '%s'"):format(
        rfsm.location_of(obj, field), type(value), text_of(value)))
    end
  end
end

-- Warns of what was put into the machine after rfsm.init: functions in fields whose
-- names look like misspelt ones (`entri`), and elements.
local function check_fields(fsm, obj)
  local model = rfsm.model_of(obj)
  for _, key in ipairs(rfsm.sorted_keys(obj)) do
    local value = not rfsm.is_meta(key) and obj[key]
    local is_new = type(key) == "string" and not rawequal(value, rawget(model, key))
    local text = is_new and value and advice.misspelt(obj, key, value) or ""
    if text ~= "" then
      warn(fsm, rfsm.location_of(obj) .. ": " .. text)
    elseif is_foreign(value) then
      warn(fsm, ("%s.%s: a %s that was added after rfsm.init is not looked at (did you "
        .. "mean rfsm.fsm_merge?)"):format(rfsm.location_of(obj), text_of(key),
        rfsm.kind_of(value)))
    end
  end
end

-- Iterations ........................................................................

local MANY = 10000 -- iterations of one run
local LAST = 100 -- iterations of which the states and events are named
local MOST = 6 -- names in a warning

local function warn_of_end(fsm, names, reason)
  warn(fsm, ("rfsm.run has made %d iterations and goes on, in %s: %s"):format(MANY,
    names, reason))
end

-- Returns the names in a set as a text: "'root.a', 'root.b' and 3 more".
local function text_of_names(is_name)
  local list = rfsm.sorted_keys(is_name)
  local more = #list - MOST
  for i = #list, 1, -1 do list[i] = i <= MOST and "'" .. list[i] .. "'" or nil end
  local text = concat(list, ", ")
  return more > 0 and ("%s and %d more"):format(text, more) or text, list[2] ~= nil
end

-- Notes the leaf and the events of an iteration; events that no transition names do not
-- count.
local function note_names(fsm, at, chain, events)
  local leaf = at.machine._act_leaf
  if leaf then chain.states[location.path(leaf, at.prefix)] = true end
  for _, event in ipairs(events) do
    local is_known = alphabet.has(alphabet_of(fsm), event)
    chain.events[rfsm.event_text(event)] = is_known or nil
  end
end

-- The post step hook of a machine or region: warns of callbacks that send to each other
-- without end. `chain.count` is the number of iterations that have ended with events in
-- the queue, one after the other: only the machine itself has sent them. Transitions
-- that need no event are no such chain, whatever waits behind them.
local function check_chain(fsm, at, chain, events)
  chain.count = rfsm.check_events(at.machine) > 0 and chain.count + 1 or 0
  if chain.count <= MANY - LAST or chain.count > MANY then return end
  note_names(fsm, at, chain, events)
  if chain.count < MANY then return end
  if order.is_empty(chain.events) then -- no transition names what comes
    for _, event in ipairs(events) do
      chain.events[rfsm.event_text(event, true)] = true
    end
  end
  local names, has_many = text_of_names(chain.events)
  warn_of_end(fsm, (text_of_names(chain.states)), ("event%s %s come%s again and again")
    :format(has_many and "s" or "", names, has_many and "" or "s"))
  chain.states, chain.events = {}, {}
end

-- Adds this hook to a machine and its regions that do not have it.
local function watch_chains(fsm)
  local chains = fsm._strict.chains
  for _, at in ipairs(rfsm.machines(fsm)) do
    if not chains[at.machine] then
      local chain = { count = 0, states = {}, events = {} }
      chains[at.machine], chains[#chains + 1] = chain, chain
      rfsm.post_step_hook_add(at.machine, function(_, events)
        if events[1] ~= nil then check_chain(fsm, at, chain, events) end
      end)
    end
  end
end

local function is_chain(chain) return chain.count > MANY - LAST end

-- Warns of a run that does not end, unless an idle hook shows that this is intended.
local function check_end(fsm, events)
  local notes, leaf = fsm._strict, fsm._act_leaf
  notes.count = notes.count and notes.count + 1
  if events[1] ~= nil then notes.event, notes.event_at = events[1], notes.count or 0 end
  if notes.count ~= MANY or fsm.idle_hook or order.any(notes.chains, is_chain) then
    return
  end
  warn_of_end(fsm, "'" .. (leaf and leaf._fqn or "root") .. "'",
    MANY - notes.event_at > 9
    and "its doo is never idle (rfsm.yield(true) lets run return)"
    or ("event '%s' comes again and again"):format(rfsm.event_text(notes.event, true)))
end

-- The path hook: notes the path for the post step hook.
local function note_path(fsm, path)
  local notes, tr = fsm._strict, path[1]
  notes.path = path
  notes.always = tr and tr.always == true and notes.always + 1 or 0
  if notes.always == MANY then
    warn(fsm, ("transitions that need no event are taken again and again, such as %s "
      .. "(give one of them a guard)"):format(rfsm.location_of(tr)))
  end
end

-- Does a transition name an event, also by `rfsm.named`?
local function names(tr, event)
  local name = rfsm.name_with_data(event)
  return match.names(tr, event) or name and match.names(tr, rfsm.named(name)) or false
end

-- May a transition of a path have taken an event? Predicates without a name may.
local function is_named_in(path, event)
  return order.any(path, function(tr)
    return match.is_any(tr) or names(tr, event) or order.any(tr.events, function(own)
      return type(own) == "function" and not rfsm.event_name(own)
    end)
  end)
end

-- Returns the transitions of the active states, those of the outermost one first.
local function tried(fsm)
  return fsm._act_leaf and location.transitions(fsm, fsm._act_leaf) or {}
end

-- Returns the FQN of the innermost active state that has a transition for an event.
local function waiting_for(fsm, event)
  local fqn
  for _, tr in ipairs(tried(fsm)) do
    if names(tr, event) then fqn = tr.src._fqn end
  end
  return fqn
end

-- Warns if no path was taken, although a transition of an active state names an event:
-- no way on is open behind the connector to which it leads.
local function check_closed(fsm, events)
  for _, tr in ipairs(events[1] ~= nil and tried(fsm) or {}) do
    for _, event in ipairs(rfsm.is_conn(tr.tgt) and not tr.guard and events or {}) do
      if names(tr, event) then
        warn(fsm, ("event '%s' is discarded, no transition from '%s' is enabled (add "
          .. "one without a guard, of the least pn)"):format(rfsm.event_text(event),
          tr.tgt._fqn))
      end
    end
  end
end

-- The post step hook: warns if an event was discarded because it came together with the
-- event of the path, and a state that is active now has a transition for it.
local function check_lost(fsm, events)
  local path = fsm._strict.path
  fsm._strict.path = false
  if not path then return check_closed(fsm, events) end
  local first = path[1] -- none if the root is a leaf
  if not first or rfsm.is_conn(first.src) then return end
  for _, event in ipairs(events) do
    local fqn = not match.maker_of(event) and not is_named_in(path, event)
      and waiting_for(fsm, event)
    if fqn then
      warn(fsm, ("event '%s' came together with another one and is discarded, '%s' "
        .. "waits for it (call rfsm.run before it is sent)"):format(
        rfsm.event_text(event), fqn))
    end
  end
end

-- The pre step hook: checks the elements of the machine, and warns of events that come
-- too early. For an event from `getevents` the sender's line is not known.
local function check_machine(fsm, events)
  fsm._strict.always = 0
  check_end(fsm, events)
  local chain = fsm._strict.chains[fsm] -- a step does not know `count`
  local count = fsm._strict.count or chain and chain.count or 0
  local is_due = count < 100 or count % 100 == 0 -- a long run is not slowed down
  if is_due then watch_chains(fsm) end
  for _, obj in ipairs(is_due and rfsm.elements(fsm) or {}) do
    check_callbacks(fsm, obj)
    check_fields(fsm, obj)
    check_model(fsm, obj)
  end
  for _, event in ipairs(events) do
    if event ~= "e_init_fsm" then check_early(fsm, "", event) end
  end
end

-- Public functions ..................................................................

--- Have a machine warn of suspicious events, fields and runs.
---@param fsm rfsm.Machine
function strict.watch(fsm)
  rfsm.check_machine(fsm, "rfsm.strict.watch")
  if not latest then
    latest = fsm
    watch_calls()
    watch_reads()
  end
  latest = fsm
  if fsm._strict then return end
  fsm._strict = { told = {}, models = {}, path = false, count = false,
    event = false, event_at = 0, always = 0, structure = false, known = false,
    chains = {} }
  for _, obj in ipairs(rfsm.elements(fsm)) do check_model(fsm, obj) end
  rfsm.pre_step_hook_add(fsm, rfsm.repeatable(check_machine))
  rfsm.path_hook_add(fsm, note_path)
  rfsm.post_step_hook_add(fsm, check_lost)
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if rfsm.is_strict(fsm) and not merged then strict.watch(fsm) end
end

return strict
