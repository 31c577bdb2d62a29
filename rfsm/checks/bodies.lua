--- Bodies: mistakes in the code of callbacks, found in trees of luacheck's parser.
--
-- A rule reports only what is certainly wrong. So nothing is reported for a guard that
-- may return false somewhere, or for a parameter that is not used.
--
-- @module rfsm.checks.bodies
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local alphabet = require "rfsm.shared.alphabet"
local order = require "rfsm.shared.order"

local ipairs, rawget, type = ipairs, rawget, type

local bodies = {}

--- Call f(node) for a node and the nodes in it. If f(node) returns false, the nodes
--- in that node are left out.
function bodies.walk(node, f)
  if type(node) ~= "table" or node.tag and f(node) == false then return end
  for _, child in ipairs(node) do bodies.walk(child, f) end
end

local walk = bodies.walk

--- Is test(node) true for a node, or for a node in it?
function bodies.has(node, test)
  return type(node) == "table" and (node.tag and test(node)
    or order.any(node, function(child) return bodies.has(child, test) end))
end

local has = bodies.has

--- Call f(node) for the nodes of a function, but not in inner functions.
function bodies.each_node(func, f)
  walk(func[2], function(node)
    f(node)
    return node.tag ~= "Function"
  end)
end

local each_node = bodies.each_node

-- Returns the name in a node that has this tag; an empty text for another node.
local function name_of(node, tag) return node.tag == tag and node[1] or "" end

--- Return the names in a call: "yield" and "rfsm" for rfsm.yield(), "print" for
--- print(). A name that is computed is empty.
---@return string name
---@return string? library
function bodies.called_name(node)
  local callee = node[1]
  if callee.tag ~= "Index" then return name_of(callee, "Id") end
  return name_of(callee[2], "String"), name_of(callee[1], "Id")
end

-- Parameters ......................................................................

local OF_STATES = { "machine", "state", "word", "event" }

local EXPECTED = {
  entry = OF_STATES, exit = OF_STATES, doo = { "machine", "state", "word" },
  guard = { "transition", "list of events", "event" },
  effect = { "machine", "transition", "word", "list of events", "event" },
}

local SIGNATURES = {
  entry = "entry(fsm, state, _, event)", exit = "exit(fsm, state, _, event)",
  doo = "doo(fsm, state)", guard = "guard(tr, events, event)",
  effect = "effect(fsm, tr, _, events, event)",
}

-- Names of parameters, and the value that an author expects under such a name. One that
-- is named `event` may well be the list.
local MEANINGS = {
  fsm = "machine", machine = "machine", tr = "transition", trans = "transition",
  transition = "transition", state = "state", event = "event",
  events = "list of events", evs = "list of events",
}

local function is_name(node, name) return node.tag == "Id" and node[1] == name end

local DECLARES = { Local = true, Localrec = true, Set = true, Forin = true,
  Fornum = true, Function = true }

-- Does the code of a function give another value to the name of a parameter?
local function is_replaced(func, name)
  return has(func[2], function(node)
    local names = DECLARES[node.tag] and node[1] or {}
    return order.any(names.tag and { names } or names, function(target)
      return is_name(target, name)
    end)
  end)
end

-- Calls f(key, node) for each field that the code of a function reads from a parameter;
-- a method that it calls counts.
local function each_read(func, name, f)
  local is_written = {}
  walk(func[2], function(node)
    for _, target in ipairs(node.tag == "Set" and node[1] or {}) do
      is_written[target] = true
    end
    local is_field = node.tag == "Index" or node.tag == "Invoke"
    if is_field and not is_written[node] and is_name(node[1], name)
      and node[2].tag == "String" then
      f(node[2][1], node)
    end
  end)
end

-- Is a list of events read as if it was one event, or is the word indexed? Then the
-- result is always nil or false.
local function is_misread(func, name, expected)
  if is_replaced(func, name) then return false end
  local found = false
  local is_list = expected == "list of events"
  each_read(func, name, function(_, node)
    found = found or is_list or expected == "word" and node.tag == "Index"
  end)
  return found or has(is_list and func[2], function(node)
    local is_compared = node.tag == "Op" and (node[1] == "eq" or node[1] == "ne")
    return is_compared and (is_name(node[2], name) and node[3].tag == "String"
      or is_name(node[3], name) and node[2].tag == "String")
  end)
end

-- Is the parameter at a position named for another value, or read as another one?
local function is_mistaken(func, name, expected)
  local meaning = MEANINGS[name]
  local is_other = meaning and meaning ~= expected
    and not (meaning == "event" and expected == "list of events")
  return is_other and has(func[2], function(node) return is_name(node, name) end)
    or is_misread(func, name, expected)
end

-- Returns the first field that the code reads from its first parameter, and that the
-- value of the parameter does not have; `others` are the elements that may have it.
local function missing_field(func, value, others)
  local name, found = func[1][1] and func[1][1][1], nil
  if not name or MEANINGS[name] or is_replaced(func, name) then return nil end
  each_read(func, name, function(key)
    local is_there = rfsm.is_meta(key) or value[key] ~= nil
    for _, other in ipairs(not is_there and others or {}) do
      found = found or rawget(other, key) ~= nil and key
    end
    found = found or not is_there and func.owner and key
  end)
  return found
end

-- Finds a callback that takes its first parameter for another value: for its state, or,
-- in a method, for its object.
local function check_first(func, field, obj, machine, add)
  local is_guard = field == "guard"
  local key = missing_field(func, is_guard and obj or machine,
    is_guard and { machine, obj.src } or { obj })
  if not key then return end
  local owner = func[1][1].implicit and func.owner
  add("parameters", ("parameter 1 of the %s, '%s', is the %s, which has no field '%s' "
    .. "(%s)"):format(field, func[1][1][1], EXPECTED[field][1], key, owner
    and ("%s = function() %s() end"):format(field, owner) or SIGNATURES[field]))
end

local function check_parameters(func, field, obj, machine, add)
  for i, parameter in ipairs(func[1]) do
    local name, expected = parameter[1], EXPECTED[field][i]
    if expected and is_mistaken(func, name, expected) then
      add("parameters", ("parameter %d of the %s, '%s', is the %s (%s)"):format(i,
        field, name, expected, SIGNATURES[field]))
    end
  end
  check_first(func, field, obj, machine, add)
end

--- Note the method that a node defines: `function robot:beep()` is "robot:beep".
function bodies.note_method(node)
  local func = node.tag == "Set" and node[2] and node[2][1]
  if not func or func.tag ~= "Function" or not (func[1][1] and func[1][1].implicit) then
    return
  end
  local target = node[1][1]
  func.owner = name_of(target[1], "Id") .. ":" .. name_of(target[2], "String")
end

-- Guards ..........................................................................

local NEVER_FALSE = { True = true, Number = true, String = true, Nil = true,
  Table = true, Function = true }

-- Finds a guard that never forbids its transition. An error in a guard forbids, too. A
-- guard that only returns true is a placeholder, and is no mistake.
local function check_guard(func, add)
  local may_forbid, has_value = false, false
  each_node(func, function(node)
    local value = node.tag == "Return" and node[1]
    local name = node.tag == "Call" and bodies.called_name(node)
    has_value = has_value or value
    may_forbid = may_forbid or value and not NEVER_FALSE[value.tag]
      or name == "error" or name == "assert"
  end)
  local only = not func[2][2] and func[2][1]
  local is_placeholder = only and only.tag == "Return" and only[1]
    and only[1].tag == "True"
  if may_forbid or is_placeholder then return end
  add("no-value", not has_value and "the guard returns no value, it never forbids"
    or "the guard never returns false, and only false forbids")
end

-- Calls ...........................................................................

local YIELDS = { rfsm = true, coroutine = true }

local DRIVES = { run = true, step = true, send_events = true }

-- Returns the mistake in a call of rfsm.run, rfsm.step or rfsm.send_events.
local function problem_of_drive(name, first, field, fsm)
  if first.tag == "String" then
    return ("rfsm.%s gets the machine first (rfsm.%s(fsm, ...))"):format(name, name)
  elseif name ~= "send_events" and first.tag == "Id" and first[1] == fsm then
    return ("the %s calls rfsm.%s of its machine, whose step is under way (rfsm."
      .. "send_events is enough, its events are taken next)"):format(field, name)
  end
end

-- Returns the first event in a call of rfsm.send_events that a region sends to itself,
-- and that only the machine around it knows, or another region.
local function event_astray(node, fsm, machine)
  local around = rfsm.parent(machine)
  local own = around and is_name(node[2], fsm) and alphabet.of_all(machine)
  if not own or own.predicates[1] or own.takes_any then return nil end
  local known = alphabet.of_all(around)
  for i = 3, #node do
    local event = name_of(node[i], "String")
    if known.set[event] and not own.set[event] then return event end
  end
end

-- Returns the mistake in a call in a callback that has a machine parameter named `fsm`.
local function problem_of_call(node, field, fsm, machine)
  local name, library = bodies.called_name(node)
  if YIELDS[library or ""] and name == "yield" and field ~= "doo" then
    return ("the %s calls %s.yield (only a doo may yield)"):format(field, library)
  elseif library == "rfsm" and DRIVES[name] and node[2] then
    local event = fsm and name == "send_events" and event_astray(node, fsm, machine)
    if event then
      return ("the %s sends '%s' to its own region, where no transition names it ("
        .. "rfsm.send_events(rfsm.parent(%s), ...))"):format(field, event, fsm)
    end
    return problem_of_drive(name, node[2], field, fsm)
  end
end

-- Returns the mistake in a call of a method, such as fsm:send_events(...).
local function problem_of_method(node, fsm, machine)
  local name = node[2][1]
  local is_machine = fsm and is_name(node[1], fsm)
  local is_function = is_machine and type(rfsm[name]) == "function"
  if is_machine and name == "emit" then
    return ("emit gets the event first (%s.emit(...), with a dot)"):format(fsm)
  elseif is_function and machine[name] == nil then
    return ("a machine has no method '%s' (rfsm.%s(%s, ...))"):format(name, name, fsm)
  end
end

local function check_calls(func, field, machine, add)
  local first = EXPECTED[field][1] == "machine" and func[1][1]
  local fsm = first and first[1] or nil
  each_node(func, function(node)
    local problem = node.tag == "Call" and problem_of_call(node, field, fsm, machine)
      or node.tag == "Invoke" and problem_of_method(node, fsm, machine)
    if problem then add("wrong-call", problem) end
  end)
end

-- Tables ..........................................................................

--- Note keys that occur twice in a table node, and callbacks whose value is a call:
--- "print" for { entry = print() }.
---@param file { lost: table, called: table } lists of { name = key, ... } by line
---@param node table
function bodies.note_table(file, node)
  local seen = {}
  local function note(list, entry)
    list[node.line] = list[node.line] or {}
    table.insert(list[node.line], entry)
  end
  for _, pair in ipairs(node) do
    local key = pair.tag == "Pair" and pair[1].tag == "String" and pair[1][1]
    if key and seen[key] then note(file.lost, { name = key, line = pair.line }) end
    if key then seen[key] = true end
    local is_call = key and EXPECTED[key] and pair[2].tag == "Call"
    local by = is_call and bodies.called_name(pair[2]) or ""
    if by ~= "" then note(file.called, { name = key, by = by }) end
  end
end

--- Find what is wrong with a callback.
---@param func table the node of its function
---@param field string "entry", "guard" ...
---@param obj rfsm.State|rfsm.Transition the element that has the callback
---@param machine rfsm.Machine
---@param add fun(code: string, text: string)
function bodies.check(func, field, obj, machine, add)
  check_parameters(func, field, obj, machine, add)
  check_calls(func, field, machine, add)
  if field == "guard" then check_guard(func, add) end
end

return bodies
