--- Stubs: values that replace missing modules and globals, such as those of a robot.
--
-- A stub returns a stub if it is indexed or called. If it is called with a state, it
-- returns a copy of the state, or the state itself if it is in a machine. In a
-- concatenation a stub is its name, such as 'rf.findFile("arm.lua")', and in
-- arithmetic it is 0. A loop over a stub ends.
--
-- @module rfsm.shared.stubs
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local getmetatable, ipairs, rawequal = getmetatable, ipairs, rawequal
local rawget, rawset = rawget, rawset
local select, setmetatable, type = select, setmetatable, type
local concat = table.concat

--- The field `are_used` is true if a stub was made since `forget`.
local stubs = { are_used = false }

local Stub = {}
-- Name, fields and listener of each stub. The stub itself is an empty table.
local names = setmetatable({}, { __mode = "k" })
local fields = setmetatable({}, { __mode = "k" })
local listeners = setmetatable({}, { __mode = "k" })

--- Return a stub. If there is a listener, a call of the stub or of a field in it calls
--- `listener(name, ...)`.
function stubs.new(name, listener)
  local stub = setmetatable({}, Stub)
  names[stub], fields[stub], listeners[stub] = name, {}, listener
  stubs.are_used = true
  return stub
end

--- Return the name of a stub; nil for all other values.
function stubs.name_of(value)
  return type(value) == "table" and getmetatable(value) == Stub and names[value] or nil
end

-- Returns the name of a stub; "a stub" for a copy of a stub that the chart has made.
local function name_of(stub) return names[stub] or "a stub" end

local MOST = 9 -- list elements that a stub has, so that `ipairs` over it ends

function Stub.__index(stub, key)
  if type(key) == "number" and key > MOST then return nil end
  local known = fields[stub] or {}
  fields[stub] = known
  if not known[key] then
    known[key] = stubs.new(name_of(stub) .. "." .. rfsm.text_of(key), listeners[stub])
  end
  return known[key]
end

local LONGEST = 200 -- bytes of a name; a call that would exceed it keeps the old name

-- Returns the first state among the arguments of a call, or nil.
local function find_state(...)
  for i = 1, select("#", ...) do
    local argument = select(i, ...)
    if rfsm.is_state(argument) then return argument end
  end
end

-- Returns a copy of a state, transition or connector, and of all elements in it.
local function copy_of(element)
  local copy = {}
  for key, value in order.each(element) do -- any order: a copy
    copy[key] = rfsm.is_fsmobj(value) and copy_of(value) or value
  end
  return setmetatable(copy, getmetatable(element))
end

-- A `for` loop over a stub calls it with two nils. The result nil ends the loop.
function Stub.__call(stub, ...)
  local texts, count = {}, select("#", ...)
  if count == 2 and (...) == nil and select(2, ...) == nil then return nil end
  if listeners[stub] then
    listeners[stub](names[stub], ...)
    return stub
  end
  local state = find_state(...)
  if state then
    return rawequal(rfsm.model_of(state), state) and copy_of(state) or state
  end
  for i = 1, count do
    local argument = select(i, ...)
    if type(argument) == "string" then texts[#texts + 1] = '"' .. argument .. '"' end
  end
  local name = ("%s(%s)"):format(name_of(stub), concat(texts, ", "))
  return stubs.new(#name <= LONGEST and name or name_of(stub))
end

local shown = {} -- names of stubs on which tostring was called

function Stub.__tostring(stub)
  shown[name_of(stub)] = true
  return name_of(stub)
end

function Stub.__concat(a, b) return rfsm.text_of(a) .. rfsm.text_of(b) end

--- Forget which stubs were made and converted to texts, before another chart is loaded.
function stubs.forget() shown, stubs.are_used = {}, false end

--- Does a text contain the name of a stub that was converted to a text?
---@param text string
---@return boolean
function stubs.is_in(text)
  for name in order.each(shown) do -- any order: one decides
    local word = "[^%w_]" .. name:gsub("%p", "%%%0") .. "[^%w_]"
    if (" " .. text .. " "):find(word) then return true end
  end
  return false
end

local function zero() return 0 end
local function no() return false end

for _, operator in ipairs { "add", "sub", "mul", "div", "mod", "pow", "unm", "len",
  "idiv", "band", "bor", "bxor", "shl", "shr", "bnot" } do
  rawset(Stub, "__" .. operator, zero)
end
Stub.__lt, Stub.__le = no, no

-- States that replace stubs, with the substates that transitions name --------------

local MARK = " is a stub" -- the end of `doc` in states that replace stubs
local WIDEST = 30 -- bytes of a name in `doc`, so that a picture has one line for it

local is_inner = setmetatable({}, { __mode = "k" }) -- substates of such states

local function is_stubbed(state)
  local doc = rawget(state, "doc")
  return is_inner[state] or type(doc) == "string" and doc:sub(-#MARK) == MARK
end

-- Returns a constructor that notes no location, since it would be a line of this file.
local function without_location(constructor)
  local class = getmetatable(constructor {})
  return function(t) return setmetatable(t, class) end
end

local new_state, new_trans, new_conn = without_location(rfsm.state),
  without_location(rfsm.trans), without_location(rfsm.conn)

--- Return a state that replaces the stub of this name. A long name loses its beginning.
function stubs.new_state(name)
  if #name > WIDEST then
    name = ".." .. name:sub(2 - WIDEST):gsub("^[\128-\191]+", "")
  end
  return new_state { doc = name .. MARK }
end

-- Adds a substate to a state that replaces a stub. The first substate is initial.
local function add_substate(state, name)
  state[name] = name == "initial" and new_conn {} or new_state {}
  is_inner[state[name]] = true
  if not state.initial and not state[1] then
    state[1] = new_trans { src = "initial", tgt = name }
  end
end

-- Replaces stubs on the path of a transition's source or target by states.
local function complete_path(root, state, path)
  if path:find("^root%.") then state, path = root, path:sub(6) end
  for name in path:gmatch("[^.]+") do
    local stub = stubs.name_of(rawget(state, name))
    if stub then state[name] = stubs.new_state(stub) end
    if is_stubbed(state) and not rawget(state, name) then add_substate(state, name) end
    state = rawget(state, name)
    if not rfsm.is_state(state) then return end
  end
end

-- Returns the model of a node, or the node itself if it stands in a model.
local function model_of(node) return rfsm.model_of(node) or node end

--- Does a finding about an element depend on what is in a state that replaces a stub?
--- That nothing leads to the state is certain.
---@param element rfsm.State|rfsm.Transition|rfsm.Connector|nil
---@param is_reach boolean the finding is that nothing leads to the element
---@return boolean
function stubs.is_invented(element, is_reach)
  local node = rfsm.is_trans(element) and element.src or element
  while rfsm.is_node(node) do
    if is_inner[model_of(node)] then return true end
    if rfsm.is_state(node) and is_stubbed(model_of(node))
      and not (node == element and is_reach) then
      return true
    end
    node = node._parent ~= node and node._parent or nil
  end
  return false
end

--- Replace the stubs that are sources or targets of transitions by states.
function stubs.complete(model)
  rfsm.mapfsm(function(tr, state)
    for _, path in ipairs { tr.src, tr.tgt } do
      if type(path) == "string" then complete_path(model, state, path) end
    end
  end, model, rfsm.is_trans)
end

return stubs
