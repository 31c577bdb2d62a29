--- Instruments: a tool replaces fields of machines and their elements, and adds hooks,
--- for a while.
--
-- Each function appends its changes to a list, from which `give_back` undoes them.
--
-- @module rfsm.shared.instrument
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"

local ipairs, rawequal, rawget, rawset = ipairs, rawequal, rawget, rawset
local type, remove = type, table.remove

--- The fields of callbacks: of states, then of transitions.
local instrument = { CALLBACKS = { "entry", "exit", "doo", "guard", "effect" } }

-- The changes of an object's fields, the latest last. The object has them itself, since
-- Lua 5.1 never collects a weak table whose values lead to their keys.
local function changes_of(obj) return rawget(obj, "_replaced") or {} end

--- Replace a field. Return the change: `own` has the old value, `new` the new one.
-- `was` is the old value, also if that is inherited; a wrapper calls it from there.
function instrument.put(changes, obj, field, value)
  local done = { obj = obj, field = field, own = rawget(obj, field), was = obj[field],
    new = value }
  local all = changes_of(obj)
  rawset(obj, "_replaced", all)
  all[#all + 1], changes[#changes + 1] = done, done
  obj[field] = value
  return done
end

--- Return the value that a field would have without any tool.
function instrument.original(obj, field)
  local all, own, value = changes_of(obj), rawget(obj, field), obj[field]
  for i = #all, 1, -1 do
    local done = all[i]
    if done.field == field and rawequal(done.new, own) then
      own, value = done.own, done.was
    end
  end
  return value
end

--- Have a printer of a machine, such as `warn`, call `note` before it prints.
function instrument.listen(changes, fsm, name, note)
  local own = fsm[name]
  instrument.put(changes, fsm, name, function(...)
    note(...)
    if rfsm.is_callable(own) then return own(...) end
    if own then rawget(_G, "print")(calls.text("\t", ...)) end -- a printer may be true
  end)
end

--- Add a hook by rfsm.X_hook_add(fsm, ...), where X is the kind. The hook must not keep
-- the list of events: the machine reuses it.
function instrument.hook(changes, fsm, kind, ...)
  local first, second = ...
  rfsm.borrows(type(first) == "function" and first or second)
  rfsm[kind .. "_hook_add"](fsm, ...)
  changes[#changes + 1] = { remove = function()
    rfsm[kind .. "_hook_rm"](fsm, first, second)
  end }
end

--- Return the table with the user's entry and exit of a state. If an extension runs the
--- regions of the state, the state itself has the entry and exit of the extension.
function instrument.owner_of_callbacks(state)
  local _, own = rfsm.regions(state)
  return own or state
end

local ROOT_FIELDS = { "idle_hook", "pre_step_hook", "post_step_hook" }
local STATE_FIELDS, TRANSITION_FIELDS = { "entry", "exit" }, { "effect", "likely" }

local function take_away(changes, obj, fields)
  for _, field in ipairs(fields) do
    if rawget(obj, field) then instrument.put(changes, obj, field, nil) end
  end
end

--- Take the functions of a chart away from its machine, except guards, doos and
-- getevents; return the states that have a doo.
function instrument.take_functions(changes, fsm)
  local doers = {}
  take_away(changes, fsm, ROOT_FIELDS)
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    local owner = instrument.owner_of_callbacks(state)
    take_away(changes, owner, STATE_FIELDS)
    if state.doo and owner == state then doers[#doers + 1] = state end
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    take_away(changes, tr, TRANSITION_FIELDS)
  end
  return doers
end

-- Takes a change out of those of its object. If another tool has replaced the field
-- since, that tool gets the old value; if a program has set it, nothing happens.
local function take_back(done)
  local obj, field, all = done.obj, done.field, changes_of(done.obj)
  for i = #all, 1, -1 do
    local other = all[i]
    if other == done then remove(all, i) end
    if other.field == field and rawequal(other.own, done.new) then
      other.own, other.was = done.own, done.was
    end
  end
  if not all[1] then rawset(obj, "_replaced", nil) end
  if rawequal(rawget(obj, field), done.new) then obj[field] = done.own end
end

--- Restore the fields, unless a program has set them meanwhile; remove the hooks.
function instrument.give_back(changes)
  for i = #changes, 1, -1 do
    local done = changes[i]
    if done.remove then done.remove() else take_back(done) end
    changes[i] = nil
  end
end

return instrument
