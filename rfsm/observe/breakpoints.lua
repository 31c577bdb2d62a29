--- Breakpoints and watched expressions.
--
-- They are in the list `sim.points`, for the machine `sim.fsm`. `sim` is a session of
-- the simulator or a view of a web page. Only a session has watched expressions, which
-- its function `value_of(text)` evaluates.
--
-- @module rfsm.observe.breakpoints
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local location = require "rfsm.shared.location"
local names = require "rfsm.observe.names"
local rfsmpp = require "rfsmpp"

local error, ipairs, print, rawequal, type = error, ipairs, print, rawequal, type
local remove = table.remove
local text_of = rfsm.text_of

local breakpoints = {}

--- A breakpoint, or an expression that is watched.
---@class rfsm.observe.Breakpoint
---@field kind "state"|"transition"|"event"|"watch"
---@field name string the text to show; for "watch" the text of the expression
---@field value any state name, set of transitions, event, or last value of the "watch"
---@field condition? string text of the expression after `if`
---@field holds? fun(event: any): any the condition, compiled

-- Is the source or target of a transition `node` itself, or its initial connector?
local function is_at(tr_end, node)
  return node and (tr_end == node or tr_end == node.initial)
end

-- Returns a breakpoint at the transitions of a machine and its regions for which
-- `is_meant(tr)` is true, named after the first of them; nil if there are none.
local function at_transitions(fsm, is_meant)
  local point
  for at, tr in location.each(fsm, rfsm.is_trans) do
    if is_meant(tr) then
      point = point or { kind = "transition", value = {}, name = location.path(tr.src,
        at.prefix) .. " -> " .. location.path(tr.tgt, at.prefix) }
      point.value[tr] = true
    end
  end
  return point
end

local function fail(fsm, text)
  local list, nodes = names.events(fsm), names.nodes(fsm)
  for _, name in ipairs(nodes) do
    list[#list + 1] = name
    list[#list + 1] = name:gsub("^root%.", "")
  end
  local hint = names.elsewhere(text, nodes) or advice.nearest_name(text, list)
  error(("breakpoint: state, event or transition (off -> on) expected, got '%s'%s")
    :format(text, hint ~= "" and hint or ", pp() shows the states"), 0)
end

local function of_text(fsm, text)
  local by_name = select(2, names.nodes(fsm))
  local function full(name) return by_name[name] and name or "root." .. name end
  local name = full(text)
  if rfsm.is_state(by_name[name]) then
    return { kind = "state", name = name, value = name }
  end
  local src, tgt = text:match("^(.-)%s*%->%s*(.-)$")
  local point = src and at_transitions(fsm, function(tr)
    return is_at(tr.src, by_name[full(src)]) and is_at(tr.tgt, by_name[full(tgt)])
  end)
  if point then return point end
  if not names.is_event(fsm, text) then fail(fsm, text) end
  return { kind = "event", name = text, value = text }
end

--- Add a breakpoint at a state, a transition or an event, given as a value or by name;
-- return the number of the breakpoint.
function breakpoints.add(sim, what)
  local point
  if rfsm.is_trans(what) then
    point = at_transitions(sim.fsm, function(tr) return tr == what end)
      or fail(sim.fsm, text_of(what))
  elseif type(what) == "string" or rfsm.is_node(what) and what._fqn then
    point = of_text(sim.fsm, type(what) == "string" and what or what._fqn)
  else
    point = { kind = "event", name = rfsm.event_text(what, true), value = what }
  end
  sim.points[#sim.points + 1] = point
  return #sim.points
end

--- Call f(i, point) for each breakpoint in `list` that has this `kind` and is hit by
-- `value`: the name of a state entered, a transition taken, or an event received.
function breakpoints.each_reached(list, kind, value, f)
  for i, point in ipairs(list) do
    local is_named = kind == "event" and rfsm.name_with_data(value) == point.value
    if point.kind == kind and (rawequal(point.value, value) or is_named
      or kind == "transition" and point.value[value]) then
      f(i, point)
    end
  end
end

--- Watch an expression: its value is shown after each advance.
function breakpoints.add_watch(sim, text)
  local ok, value = sim.value_of(text)
  if not ok then error(value, 0) end
  sim.points[#sim.points + 1] = { kind = "watch", name = text, value = value }
end

--- Print the values of watched expressions.
function breakpoints.show_watched(sim)
  for _, point in ipairs(sim.points) do
    if point.kind == "watch" then
      local ok, value = sim.value_of(point.name)
      local is_same = rawequal(value, point.value)
      print("watch:  " .. point.name .. " = "
        .. (ok and rfsmpp.value_text(value) or text_of(value))
        .. (is_same and "" or " (was " .. rfsmpp.value_text(point.value) .. ")"))
      point.value = value
    end
  end
end

--- Return a breakpoint or an expression as a text for a person.
function breakpoints.text(point)
  return point.kind .. " " .. point.name
    .. (point.condition and " if " .. point.condition or "")
end

--- Print the breakpoints and expressions with their numbers.
function breakpoints.list(sim)
  for i, point in ipairs(sim.points) do
    print(("%d  %s"):format(i, breakpoints.text(point)))
  end
  if not sim.points[1] then print("there is none") end
end

--- Remove the breakpoint or expression with number `n`, or all if `n` is nil.
function breakpoints.delete(sim, n)
  if n ~= nil and not sim.points[n] then
    error("delete: number of a breakpoint expected, got " .. text_of(n), 0)
  end
  if n then remove(sim.points, n) else sim.points = {} end
end

--- Move all breakpoints to the states and transitions with the same names in a new
-- machine. If a name is missing there, the breakpoint is removed, and `complain(line)`
-- is called.
function breakpoints.renew(sim, complain)
  for i = #sim.points, 1, -1 do
    local point = sim.points[i]
    if point.kind == "state" or point.kind == "transition" then
      local ok, renewed = pcall(of_text, sim.fsm, point.name)
      if ok and renewed.kind == point.kind then
        point.value = renewed.value
      else
        complain(("%d %s: is gone, and no breakpoint now"):format(i,
          breakpoints.text(point)))
        remove(sim.points, i)
      end
    end
  end
end

return breakpoints
