--- OCL's modules rttlib and utils, loaded when they are first used.
--
-- They take more of a pool than a chart of 20 states, and many charts use none of them.
-- So a launch in a pool puts placeholders where rttlib is noticed. The first use of one
-- removes them all, and loads the modules.
--
-- @module rfsm.rtt.rttlib
-- @license BSD-3-Clause

local debug, error, getmetatable, ipairs = debug, error, getmetatable, ipairs
local package, pairs, pcall, rawget = package, pairs, pcall, rawget
local rawset, require, setmetatable = rawset, require, setmetatable
local tostring, type = tostring, type

-- What rttlib makes: constructors that can be called; operations that are methods;
-- texts of objects; methods.
local CONSTRUCTORS = { "Variable", "Property", "Attribute", "InputPort", "OutputPort",
  "EEHook" }
local WITH_OPERATIONS = { "TaskContext", "Service" }
local WITH_TEXT = { "TaskContext", "Variable", "Property", "Attribute", "Service",
  "ServiceRequester", "Operation", "InputPort", "OutputPort" }
local METHODS = { fromtab = { "Variable", "Property", "Attribute" },
  var2tab = { "Variable" }, totab = { "Variable" } }

-- Returns the value of a field of an object whose class has this `__index`.
local function value_of(index, object, key)
  if type(index) == "function" then return index(object, key) end
  return type(index) == "table" and index[key] or nil
end

--- Have rttlib and utils loaded at their first use. `note` is called before that.
---@param rtt table the module of RTT
---@param note fun()
return function(rtt, note)
  local changes, load = {}, nil -- a table -> its fields before, false if there was none

  local function put(t, key, value)
    if not t then return end
    local before = changes[t] or {}
    changes[t], before[key] = before, rawget(t, key) or false
    rawset(t, key, value)
  end

  local calls = { __call = function(class, ...)
    load()
    return class(...)
  end }

  function load()
    if not changes then return end
    note()
    for t, before in pairs(changes) do -- any order: different fields
      for key, value in pairs(before) do rawset(t, key, value or nil) end
    end
    changes = nil
    for _, name in ipairs(CONSTRUCTORS) do
      if rtt[name] and getmetatable(rtt[name]) == calls then
        setmetatable(rtt[name], nil)
      end
    end
    package.loaded.rttlib, package.loaded.utils = nil, nil -- one of them is loading
    pcall(require, "rttlib")
    local ok, utils = pcall(require, "utils")
    if ok and not rawget(_G, "utils") then rawset(_G, "utils", utils) end
  end

  -- Puts a table in place of a module.
  local function put_module(name)
    local function module()
      load()
      return rawget(_G, name) or error("no module '" .. name .. "'", 3)
    end
    put(_G, name, setmetatable({}, {
      __index = function(_, key) return module()[key] end,
      __newindex = function(_, key, value) module()[key] = value end,
    }))
    put(package.preload, name, function()
      load()
      return package.loaded[name]
    end)
  end

  local function put_index(class)
    local index = class and class.__index
    put(class, "__index", function(object, key)
      local value = value_of(index, object, key)
      if value ~= nil then return value end
      load()
      return value_of(class.__index, object, key)
    end)
  end

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

  local classes = debug.getregistry()
  for _, name in ipairs { "rttlib", "utils" } do put_module(name) end
  put(rtt, "globals", setmetatable({}, { __index = function(_, key)
    load()
    return rtt.globals[key]
  end }))
  for _, name in ipairs(CONSTRUCTORS) do
    if rtt[name] then setmetatable(rtt[name], calls) end
  end
  for _, name in ipairs(WITH_OPERATIONS) do put_index(classes[name]) end
  for _, name in ipairs(WITH_TEXT) do put(classes[name], "__tostring", text) end
  for key, names in pairs(METHODS) do -- any order: different fields
    local method = new_method(key)
    for _, name in ipairs(names) do put(classes[name], key, method) end
  end
end
