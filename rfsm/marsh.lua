--- A machine as plain tables, the input of every exporter.
--
-- All lists are in a fixed order: nodes sorted by name, transitions in the order of
-- `rfsm.mapfsm`.
--
-- @module rfsm.marsh
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, rawget, rawset = ipairs, rawget, rawset
local setmetatable, tonumber, type = setmetatable, tonumber, type
local math_type = rawget(math, "type")

local marsh = {}

--- A transition as a plain table.
---@class rfsm.marsh.Transition
---@field type "transition"
---@field src string FQN
---@field tgt string FQN; a composite stands as its `initial`
---@field pn? number
---@field events any[] empty when any event triggers
---@field guard? true it has one; only when callbacks are asked for
---@field effect? true likewise
---@field internal? true nothing is left or entered; src and tgt are the same

--- A node as a plain table; only a composite has the two lists.
---@class rfsm.marsh.Node
---@field id string
---@field type "state"|"connector"
---@field transitions? rfsm.marsh.Transition[]
---@field subnodes? rfsm.marsh.Node[]

local function node_table(node, has_callbacks)
  if rfsm.is_conn(node) then return { id = node._id, type = "connector" } end
  if rfsm.is_leaf(node) then return { id = node._id, type = "state" } end
  local function transition_table(tr)
    local events = {}
    for i = 1, tr.events and #tr.events or 0 do events[i] = tr.events[i] end
    return {
      type = "transition", src = tr.src._fqn, tgt = tr.tgt._fqn, pn = tr.pn,
      events = events, internal = tr._is_internal,
      guard = has_callbacks and tr.guard and true or nil,
      effect = has_callbacks and tr.effect and true or nil,
    }
  end
  local function subnode_table(subnode) return node_table(subnode, has_callbacks) end
  return {
    id = node._id, type = "state",
    transitions = rfsm.mapfsm(transition_table, node, rfsm.is_trans, 1),
    subnodes = rfsm.mapfsm(subnode_table, node, rfsm.is_nr_node, 1),
  }
end

--- Return the structure of a machine.
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@param has_callbacks? boolean include whether transitions have a guard, an effect
---@return rfsm.marsh.Node root
---@nodiscard
function marsh.model2tab(fsm, has_callbacks)
  rfsm.check_machine(fsm, "rfsm.marsh.model2tab")
  return node_table(fsm, has_callbacks)
end

--- Return what is active in a machine.
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@return string|false fqn of the active leaf; false if there is none
---@return string|false mode
---@return false path
---@nodiscard
function marsh.actinfo2tab(fsm)
  rfsm.check_machine(fsm, "rfsm.marsh.actinfo2tab")
  local leaf = fsm._act_leaf
  if not leaf then return false, false, false end
  return leaf._fqn, rfsm.get_sta_mode(leaf), false
end

-- Returns the text of a value; nil if it is an address, which no two runs share.
local function text_without_address(value)
  local kind, text = type(value), rfsm.text_of(value)
  if kind == "number" then return (text:gsub("^%-0$", "0")) end
  if kind == "string" or kind == "boolean" then return text end
  local is_address = text == kind or text:find("^" .. kind .. ": ")
    or text:find("^builtin: ") or text:find("0x%x")
  return not is_address and kind ~= "function" and kind ~= "thread" and text or nil
end

--- Return a function that gives each event a text, the same on each run and each Lua.
--
-- An event without a text of its own, such as a function, is called by its type and a
-- number: "function 1" is the first that was asked for.
--
---@return fun(event: any): string text_of
---@nodiscard
function marsh.gen_event_text()
  local texts, counts = {}, {}
  return function(event)
    local text = texts[event] or text_without_address(event)
    if text then return text end
    local kind = type(event)
    counts[kind] = (counts[kind] or 0) + 1
    texts[event] = kind .. " " .. counts[kind]
    return texts[event]
  end
end

local REPLACEMENT = "\239\191\189" -- U+FFFD

-- The second bytes that may follow some first ones.
local LOWEST, HIGHEST = { [224] = 160, [240] = 144 }, { [237] = 159, [244] = 143 }

-- How many bytes follow a first one.
local function count_of(byte)
  return not byte and 0 or byte < 224 and 1 or byte < 240 and 2 or 3
end

-- Replaces the bytes of a sequence that are no UTF-8: a first byte and those behind it.
local function mend(first, others)
  local byte, second = first:byte(), others:byte()
  local count = count_of(byte)
  if byte and (#others < count or second < (LOWEST[byte] or 128)
    or second > (HIGHEST[byte] or 191)) then
    return REPLACEMENT:rep(1 + #others)
  end
  return first .. others:sub(1, count) .. REPLACEMENT:rep(#others - count)
end

--- Return a text as UTF-8: U+FFFD replaces each byte that is none.
---@param text string
---@return string
---@nodiscard
function marsh.utf8(text)
  if not text:find("[\128-\255]") then return text end
  text = text:gsub("[\192\193\245-\255]", REPLACEMENT)
  return (text:gsub("([\194-\244]?)([\128-\191]*)", mend))
end

-- Digits that give back the number, and look alike on every Lua (5.3 shows 5.0) and in
-- every locale (some have a comma).
local function digits_of(number)
  if math_type and math_type(number) == "integer" then return ("%d"):format(number) end
  if number == 0 then return "0" end -- not -0
  local digits = ("%.14g"):format(number)
  if tonumber(digits) ~= number then digits = ("%.17g"):format(number) end
  return (digits:gsub(",", "."))
end

-- A number that dkjson writes with these digits; JSON has no infinite ones.
local function plain_number(number)
  if number - number ~= 0 then return number > 0 and "inf" or "-inf" end
  local digits = digits_of(number)
  return setmetatable({}, { __tojson = function() return digits end })
end

-- JSON knows strings, finite numbers and booleans; other events become their text.
local function plain_event(event, text_of)
  local kind = type(event)
  if kind == "boolean" then return event end
  if kind == "number" then return plain_number(event) end
  return marsh.utf8(text_of(event))
end

-- Marks a list, so that an empty one is no object.
local function as_array(list) return setmetatable(list, { __jsontype = "array" }) end

local function plain_transition(tr, text_of)
  tr.src, tr.tgt = marsh.utf8(tr.src), marsh.utf8(tr.tgt)
  tr.pn = tr.pn and plain_number(tr.pn)
  for i = 1, #tr.events do tr.events[i] = plain_event(tr.events[i], text_of) end
  as_array(tr.events)
end

-- Makes a node of what dkjson can write without losing or adding anything.
local function plain_node(node, text_of)
  node.id = marsh.utf8(node.id)
  if not node.subnodes then return node end
  for _, tr in ipairs(as_array(node.transitions)) do plain_transition(tr, text_of) end
  for _, subnode in ipairs(as_array(node.subnodes)) do plain_node(subnode, text_of) end
  return node
end

--- Return the structure of a machine as dkjson should write it.
--
-- As `model2tab`, but the lists are marked as arrays, numbers look alike on every Lua,
-- texts are UTF-8, and events that JSON does not know are their text.
--
-- @raise when `fsm` was not initialised
---@param fsm rfsm.Machine
---@return rfsm.marsh.Node root
---@nodiscard
function marsh.jsontab(fsm)
  rfsm.check_machine(fsm, "rfsm.marsh.jsontab")
  return plain_node(node_table(fsm), marsh.gen_event_text())
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_marsh", marsh) end

return marsh
