--- Strict: warnings of events that are odd, early or undeclared, and of fields that are
--- not there, with the sender's file and line.
--
-- It is on for machines whose root has `strict = true`, and for all if the environment
-- has RFSM_STRICT=1: the core loads it then. Each warning comes once a machine.
--
-- @module rfsm.strict
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"

local getmetatable, ipairs, rawget = getmetatable, ipairs, rawget
local select, type = select, type
local getinfo = (rawget(_G, "debug") or {}).getinfo
local text_of = rfsm.text_of

local strict = { is_watching = false }

-- Each warning that was given is noted in the field `_strict` of the machine.
local function warn(fsm, text)
  if fsm._strict[text] then return end
  fsm._strict[text] = true
  rfsm.report(fsm, "warn", "WARNING: " .. text)
end

-- Events ............................................................................

local function names_of(known)
  local names = {}
  for _, list in ipairs { known.list, known.reactions } do
    for _, event in ipairs(list) do names[#names + 1] = text_of(event) end
  end
  return names
end

local function is_state_name(fsm, event)
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    if state._id == event or state._fqn == event then return true end
  end
  return false
end

local function oddness_of(fsm, known, event)
  if type(event) == "table" and not getmetatable(event) then
    return event[1] ~= nil and "a list is one event (did you mean "
      .. "rfsm.send_events(fsm, unpack(list))?)"
      or "a table is an event of its own, as each argument is"
  elseif type(event) ~= "string" then
    return ("no transition names the event %s"):format(text_of(event))
  elseif is_state_name(fsm, event) then
    return ("'%s' is the name of a state, no event"):format(event)
  elseif event:match("^[^(@]*"):find("[,|%s]") then
    local hint = advice.event_meant(event)
    return ("'%s' is one event%s"):format(event,
      hint ~= "" and hint or " (write an argument for each)")
  end
  return ("no transition names the event '%s'%s"):format(event,
    advice.nearest_name(event, names_of(known)))
end

-- Warns once of an event that comes before the machine is entered.
local function check_early(fsm, at, event)
  local name = text_of(event)
  local is_told = fsm._strict["early: " .. name]
  if is_told or rfsm.get_sta_mode(fsm) ~= "inactive" then return end
  fsm._strict["early: " .. name] = true
  warn(fsm, ("%sevent '%s' is sent before the first step, whose entry consumes it")
    :format(at, name))
end

-- Warns of what is sent to a machine. `at`: the sender, "lamp.lua:7: ".
local function check_events(fsm, at, ...)
  local known = alphabet.of_all(fsm)
  for i = 1, select("#", ...) do
    local event = select(i, ...)
    if event == nil then
      warn(fsm, ("%sargument %d is nil, which is no event"):format(at, i))
    elseif not alphabet.has(known, event) then
      warn(fsm, at .. oddness_of(fsm, known, event))
    else
      check_early(fsm, at, event)
    end
  end
end

local function sender()
  local info = getinfo and getinfo(3, "Sl")
  return info and info.currentline > 0
    and ("%s:%d: "):format(info.short_src, info.currentline) or ""
end

-- From the first strict machine on events go this way.
local function watch_senders()
  local send_events = rfsm.send_events
  function rfsm.send_events(fsm, ...)
    if rfsm.is_root(fsm) and fsm._strict then check_events(fsm, sender(), ...) end
    return send_events(fsm, ...)
  end
end

-- Fields ............................................................................

local CALLBACKS = { state = { "entry", "exit", "doo" },
  transition = { "guard", "effect" }, connector = {} }

-- Warns of callbacks that cannot be called, and of fields that are nearly those of the
-- library, in an element of a machine.
local function check_fields(fsm, obj)
  local kind = rfsm.kind_of(obj)
  for _, field in ipairs(CALLBACKS[kind]) do
    local value = obj[field]
    if value and not rfsm.is_callable(value) then
      warn(fsm, ("%s: function expected, got %s '%s'"):format(
        rfsm.location_of(obj, field), type(value), text_of(value)))
    end
  end
  for _, key in ipairs(rfsm.sorted_keys(obj)) do
    local is_field = type(key) == "string" and not rfsm.is_meta(key)
    local meant = is_field and rfsm.is_callable(obj[key])
      and advice.field_meant(rfsm.is_root(obj) and "root" or kind, key) or ""
    if meant ~= "" then
      warn(fsm, ("%s: a %s has no field '%s' (did you mean '%s'?)"):format(
        rfsm.location_of(obj), kind, key, meant))
    end
  end
end

-- The pre step hook. Events of getevents have no sender.
local function check_machine(fsm, events)
  for _, obj in ipairs(rfsm.elements(fsm)) do check_fields(fsm, obj) end
  for _, event in ipairs(events) do
    if event ~= "e_init_fsm" then check_early(fsm, "", event) end
  end
end

-- Public functions ..................................................................

--- Have a machine warn of what is odd.
---@param fsm rfsm.Machine
function strict.watch(fsm)
  if not strict.is_watching then watch_senders() end
  strict.is_watching = true
  if fsm._strict then return end
  fsm._strict = {}
  rfsm.pre_step_hook_add(fsm, check_machine)
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if rfsm.is_strict(fsm) and not merged then strict.watch(fsm) end
end

return strict
