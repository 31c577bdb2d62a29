--- OCL's modules rttlib and utils, loaded when they are first used.
--
-- They take more of a pool than a chart of 20 states, and many charts use none of them.
-- So a launch in a pool puts placeholders where rttlib is noticed. The first use of one
-- removes them all, and loads the modules.
--
-- @module rfsm.rtt.rttlib
-- @license BSD-3-Clause

local debug, error, getmetatable, ipairs = debug, error, getmetatable, ipairs
local package = package
local pairs, pcall, rawget, rawset = pairs, pcall, rawget, rawset
local require, setmetatable, tostring = require, setmetatable, tostring
local type = type

-- What rttlib makes: constructors that can be called; operations that are methods;
-- texts of objects; methods.
local CONSTRUCTORS = { "Variable", "Property", "Attribute", "InputPort", "OutputPort",
  "EEHook" }
local WITH_OPERATIONS = { "TaskContext", "Service" }
local WITH_TEXT = { "TaskContext", "Variable", "Property", "Attribute", "Service",
  "ServiceRequester", "Operation", "InputPort", "OutputPort" }
local METHODS = {
  Variable = { "fromtab", "var2tab", "totab" }, Property = { "fromtab" },
  Attribute = { "fromtab" },
}

-- Returns the value of a field of an object whose class has this `__index`.
local function value_of(index, object, key)
  if type(index) == "function" then return index(object, key) end
  return type(index) == "table" and index[key] or nil
end

--- Have rttlib and utils loaded at their first use. `note` is called before that.
---@param rtt table the module of RTT
---@param note fun()
return function(rtt, note)
  local changes = {} -- tables, keys, values before, one after the other
  local constructors = {} -- a table that is called -> its metatable before
  local load

  local function put(t, key, value)
    local n = #changes
    changes[n + 1], changes[n + 2], changes[n + 3] = t, key, rawget(t, key) or false
    rawset(t, key, value)
  end

  local function remove_placeholders()
    for i = #changes - 2, 1, -3 do
      rawset(changes[i], changes[i + 1], changes[i + 2] or nil)
    end
    changes = {}
    for class, metatable in pairs(constructors) do -- any order: different classes
      setmetatable(class, metatable or nil)
    end
  end

  function load()
    if not changes[1] then return end
    note()
    remove_placeholders()
    package.loaded.rttlib, package.loaded.utils = nil, nil -- one of them is loading
    pcall(require, "rttlib")
    local ok, utils = pcall(require, "utils")
    if ok and not rawget(_G, "utils") then rawset(_G, "utils", utils) end
  end

  -- Puts a table in place of a module.
  local function put_module(name)
    put(_G, name, setmetatable({}, {
      __index = function(_, key)
        load()
        local module = rawget(_G, name)
        if module then return module[key] end
        error("no module '" .. name .. "'", 2)
      end,
      __newindex = function(_, key, value)
        load()
        rawget(_G, name)[key] = value
      end,
    }))
    put(package.preload, name, function()
      load()
      return package.loaded[name]
    end)
  end

  local function put_call(class)
    constructors[class] = getmetatable(class) or false
    setmetatable(class, { __call = function(_, ...)
      load()
      return class(...)
    end })
  end

  local function put_method(class, key)
    put(class, key, function(...)
      load()
      return class[key](...)
    end)
  end

  local function put_index(class)
    local index = class.__index
    put(class, "__index", function(object, key)
      local value = value_of(index, object, key)
      if value ~= nil then return value end
      load()
      return value_of(class.__index, object, key)
    end)
  end

  local function put_text(class)
    put(class, "__tostring", function(object)
      load()
      return tostring(object)
    end)
  end

  for _, name in ipairs { "rttlib", "utils" } do put_module(name) end
  put(rtt, "globals", setmetatable({}, { __index = function(_, key)
    load()
    return rtt.globals[key]
  end }))
  for _, name in ipairs(CONSTRUCTORS) do
    if rtt[name] then put_call(rtt[name]) end
  end
  local classes = debug.getregistry()
  for _, name in ipairs(WITH_OPERATIONS) do
    if classes[name] then put_index(classes[name]) end
  end
  for _, name in ipairs(WITH_TEXT) do
    if classes[name] then put_text(classes[name]) end
  end
  for name, keys in pairs(METHODS) do -- any order: different classes
    for _, key in ipairs(classes[name] and keys or {}) do
      put_method(classes[name], key)
    end
  end
end
