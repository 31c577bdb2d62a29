--- OCL's modules rttlib and utils, loaded when they are first used.
--
-- They take more of a pool than a chart of 15 states, and many charts use none of them.
-- So a launch in a pool puts placeholders where rttlib is noticed. The first use of one
-- removes them all, and loads the modules. This file is forgotten in between.
--
-- @module rfsm.rtt.rttlib
-- @license BSD-3-Clause

local rfsm_rtt = require "rfsm.rtt"

local debug, getmetatable, ipairs, package = debug, getmetatable, ipairs, package
local pairs, pcall, rawget, rawset = pairs, pcall, rawget, rawset
local require, setmetatable, tostring = require, setmetatable, tostring
local type = type

local rttlib = {}

-- What rttlib makes: constructors that can be called; operations that are methods;
-- texts of objects; methods.
local CONSTRUCTORS = { "Variable", "Property", "Attribute", "InputPort", "OutputPort",
  "EEHook" }
local WITH_OPERATIONS = { "TaskContext", "Service" }
local WITH_TEXT = { "TaskContext", "Variable", "Property", "Attribute", "Service",
  "ServiceRequester", "Operation", "InputPort", "OutputPort" }
local METHODS = { fromtab = { "Variable", "Property", "Attribute" },
  var2tab = { "Variable" }, totab = { "Variable" } }

-- Placeholders: they refer to nothing in this file but `load` ------------------------

local function load() require("rfsm.rtt.rttlib").load() end

-- Stands for a module.
local function new_module(name)
  return setmetatable({}, { __index = function(_, key)
    load()
    return rawget(_G, name)[key]
  end, __newindex = function(_, key, value)
    load()
    rawget(_G, name)[key] = value
  end })
end

-- Stands for the loader of a module.
local function new_loader(name)
  return function()
    load()
    return package.loaded[name]
  end
end

local function new_globals(rtt)
  return setmetatable({}, { __index = function(_, key)
    load()
    return rtt.globals[key]
  end })
end

local function value_of(index, object, key)
  if type(index) == "function" then return index(object, key) end
  return type(index) == "table" and index[key] or nil
end

-- Finds what the class has; for other names rttlib may have an operation.
local function new_index(class)
  local index = class.__index
  return function(object, key)
    local value = value_of(index, object, key)
    if value ~= nil then return value end
    load()
    return value_of(class.__index, object, key)
  end
end

local CALLS = { __call = function(class, ...)
  load()
  return class(...)
end }

local function text(object)
  load()
  return tostring(object)
end

local function new_method(key)
  return function(object, ...)
    load()
    return getmetatable(object)[key](object, ...)
  end
end

-- Places -----------------------------------------------------------------------------

-- Calls visit(t, key, placeholder) for each place.
local function each_place(rtt, visit)
  local classes = debug.getregistry()
  for _, name in ipairs { "rttlib", "utils" } do
    visit(_G, name, new_module(name))
    visit(package.preload, name, new_loader(name))
  end
  visit(rtt, "globals", new_globals(rtt))
  for _, name in ipairs(WITH_OPERATIONS) do
    local class = classes[name]
    if class then visit(class, "__index", new_index(class)) end
  end
  for _, name in ipairs(WITH_TEXT) do visit(classes[name], "__tostring", text) end
  for key, names in pairs(METHODS) do -- any order: different fields
    for _, name in ipairs(names) do visit(classes[name], key, new_method(key)) end
  end
end

-- Gives the constructors the metatable `calls`, if they have the metatable `before`.
local function set_calls(rtt, before, calls)
  for _, name in ipairs(CONSTRUCTORS) do
    if rtt[name] and getmetatable(rtt[name]) == before then
      setmetatable(rtt[name], calls)
    end
  end
end

--- Put placeholders. `note` is called before the modules are loaded.
---@param rtt table the module of RTT
---@param note fun()
function rttlib.put(rtt, note)
  local before = {} -- the values that were there: a list of tables, keys and values
  each_place(rtt, function(t, key, placeholder)
    if not t then return end
    local value, n = rawget(t, key), #before
    if value ~= nil then before[n + 1], before[n + 2], before[n + 3] = t, key, value end
    rawset(t, key, placeholder)
  end)
  set_calls(rtt, nil, CALLS)
  rfsm_rtt.placeholders = { rtt = rtt, note = note, before = before, calls = CALLS }
end

--- Load the modules in place of the placeholders.
function rttlib.load()
  local put = rfsm_rtt.placeholders
  package.loaded["rfsm.rtt.rttlib"] = nil
  if not put then return end
  rfsm_rtt.placeholders = nil
  put.note()
  each_place(put.rtt, function(t, key) if t then rawset(t, key, nil) end end)
  local before = put.before
  for i = 1, #before, 3 do rawset(before[i], before[i + 1], before[i + 2]) end
  set_calls(put.rtt, put.calls, nil)
  package.loaded.rttlib, package.loaded.utils = nil, nil -- one of them is loading
  pcall(require, "rttlib")
  local ok, utils = pcall(require, "utils")
  if ok and not rawget(_G, "utils") then rawset(_G, "utils", utils) end
end

return rttlib
