--- Bodies: mistakes in the code of callbacks, found in trees of luacheck's parser.
--
-- A rule reports only what is certainly wrong. So nothing is reported for a guard that
-- may return false somewhere, or for a parameter that is not used.
--
-- @module rfsm.checks.bodies
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, rawget, type = ipairs, rawget, type

local bodies = {}

--- Call f(node) for a node and the nodes in it. If f(node) returns false, the nodes
--- in that node are left out.
function bodies.walk(node, f)
  if type(node) ~= "table" or node.tag and f(node) == false then return end
  for _, child in ipairs(node) do bodies.walk(child, f) end
end

local walk = bodies.walk

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

local OF_STATES = { "machine", "state", "word" }

local EXPECTED = {
  entry = OF_STATES, exit = OF_STATES, doo = OF_STATES,
  guard = { "transition", "list of events" },
  effect = { "machine", "transition", "word", "list of events" },
}

local SIGNATURES = {
  entry = "entry(fsm, state)", exit = "exit(fsm, state)", doo = "doo(fsm, state)",
  guard = "guard(tr, events)", effect = "effect(fsm, tr, _, events)",
}

-- Names of parameters, and the value that an author expects under such a name.
local MEANINGS = {
  fsm = "machine", machine = "machine", tr = "transition", trans = "transition",
  transition = "transition", state = "state", event = "list of events",
  events = "list of events", evs = "list of events",
}

local function is_used(func, name)
  local found = false
  walk(func[2], function(node)
    found = found or node.tag == "Id" and node[1] == name
  end)
  return found
end

local function check_parameters(func, field, add)
  for i, parameter in ipairs(func[1]) do
    local name, expected = parameter[1], EXPECTED[field][i]
    local meaning = MEANINGS[name]
    if expected and meaning and meaning ~= expected and is_used(func, name) then
      add("parameters", ("parameter %d of the %s, '%s', is the %s (%s)"):format(i,
        field, name, expected, SIGNATURES[field]))
    end
  end
end

-- Guards ..........................................................................

local NEVER_FALSE = { True = true, Number = true, String = true, Nil = true,
  Table = true, Function = true }

-- Returns the only statement of a function; nil if it has several.
local function sole(func) return not func[2][2] and func[2][1] or nil end

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
  local only = sole(func)
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

-- Returns the mistake in a call in a callback that has a machine parameter named `fsm`.
local function problem_of_call(node, field, fsm)
  local name, library = bodies.called_name(node)
  if YIELDS[library or ""] and name == "yield" and field ~= "doo" then
    return ("the %s calls %s.yield (only a doo may yield)"):format(field, library)
  elseif library == "rfsm" and DRIVES[name] and node[2] then
    return problem_of_drive(name, node[2], field, fsm)
  end
end

-- Returns the mistake in a call of a method, such as fsm:send_events(...).
local function problem_of_method(node, fsm, machine)
  local name = node[2][1]
  local is_machine = fsm and node[1].tag == "Id" and node[1][1] == fsm
  local is_function = type(rawget(rfsm, name)) == "function"
  if is_machine and is_function and machine[name] == nil then
    return ("a machine has no method '%s' (rfsm.%s(%s, ...))"):format(name, name, fsm)
  end
end

local function check_calls(func, field, machine, add)
  local first = EXPECTED[field][1] == "machine" and func[1][1]
  local fsm = first and first[1] or nil
  each_node(func, function(node)
    local problem = node.tag == "Call" and problem_of_call(node, field, fsm)
      or node.tag == "Invoke" and problem_of_method(node, fsm, machine)
    if problem then add("wrong-call", problem) end
  end)
end

-- Tables ..........................................................................

-- Returns the function that a field's value calls: "print" for { entry = print() }.
local function called_in(pair)
  local value = pair[2]
  local name = value.tag == "Call" and bodies.called_name(value)
  return name ~= "" and name or nil
end

--- Note keys that occur twice in a table node, and callbacks whose value is a call.
---@param file { lost: table, called: table } lists of { name = key, ... } by line
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
    local by = key and EXPECTED[key] and called_in(pair)
    if by then note(file.called, { name = key, by = by }) end
  end
end

--- Find what is wrong with a callback.
---@param func table the node of its function
---@param field string "entry", "guard" ...
---@param machine rfsm.Machine
---@param add fun(code: string, text: string)
function bodies.check(func, field, machine, add)
  check_parameters(func, field, add)
  check_calls(func, field, machine, add)
  if field == "guard" then check_guard(func, add) end
end

return bodies
