--- Options of functions: tests of their values, and defaults. Also loads the packages
-- that modules need.
--
-- @module rfsm.shared.options
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local try = require("rfsm.shared.calls").try

local error, getmetatable, ipairs = error, getmetatable, ipairs
local type = type
local floor, huge = math.floor, math.huge
local concat = table.concat

local options = {}

--- Return a function that tests if a value has a type.
function options.is_a(kind)
  return function(x) return type(x) == kind end
end

--- Is the value a text that is not empty?
function options.is_text(x) return type(x) == "string" and x ~= "" end

--- Return a function that tests if a value is a whole number from `least` to `most`.
function options.is_whole(least, most)
  return function(x)
    return type(x) == "number" and x >= least and x <= most and x == floor(x)
  end
end

--- Return the option of a whole number from `least` (1) to `most` (any), for `read`.
function options.whole(least, most, default)
  least, most = least or 1, most or huge
  local bounds = most < huge and ("from %d to %d"):format(least, most)
    or least == 1 and "above 0" or ("from %d on"):format(least)
  return { "whole number " .. bounds, options.is_whole(least, most), default }
end

--- Is the value a finite number of seconds, not below 0?
function options.is_seconds(x) return type(x) == "number" and x >= 0 and x < huge end

--- Return a function that tests if a value is a table, and problem_of(key, value) finds
--- no problem in any of its fields.
function options.each_field(problem_of)
  return function(t)
    for _, key in ipairs(type(t) == "table" and rfsm.sorted_keys(t) or {}) do
      local problem = problem_of(key, t[key])
      if problem then return false, problem end
    end
    return type(t) == "table"
  end
end

--- Is the value a plain list without holes?
function options.is_list(value)
  if type(value) ~= "table" or getmetatable(value) or rfsm.is_fsmobj(value) then
    return false
  end
  return #rfsm.sorted_keys(value) == #value
end

--- Return how many things there are as a text: "1 event", "2 events".
function options.counted(count, word)
  return ("%d %s%s"):format(count, word, count == 1 and "" or "s")
end

--- Return the end of a message: "got string 'x'", "got 7".
function options.got(value) return (rfsm.got(value):gsub("^got number ", "got ")) end

--- Return the given options with defaults for the others. If an option is wrong, return
-- nil and the problem. `known` has a list for each option: description, test, default.
-- A test returns whether a value is right; a second result is the problem.
function options.read(known, given)
  if type(given) ~= "table" then
    return nil, "table of options expected, " .. options.got(given)
  end
  local settings = {}
  for _, name in ipairs(rfsm.sorted_keys(given)) do
    local option, value = known[name], given[name]
    if not option then
      local text, names = rfsm.text_of(name), rfsm.sorted_keys(known)
      return nil, ("unknown option '%s'%s, expected: %s"):format(text,
        advice.did_you_mean(text, names), concat(names, ", "))
    end
    local is_right, why = option[2](value)
    if not is_right then
      why = why or option[1] .. " expected, " .. options.got(value)
      return nil, name .. ": " .. why
    end
    settings[name] = value
  end
  for _, name in ipairs(rfsm.sorted_keys(known)) do
    if settings[name] == nil then settings[name] = known[name][3] end
  end
  return settings
end

--- Return the options as `read` does. If one is wrong, raise an error that blames the
-- caller of the function `where`, or with `level` a caller further out.
function options.take(where, known, given, level)
  local settings, problem = options.read(known, given or {})
  return settings or error(where .. ": " .. problem, level or 3)
end

--- Raise an error that blames the caller of the function `where`, unless a value is the
-- name of a file.
function options.check_file(where, file)
  if options.is_text(file) then return end
  error(("%s: file name expected, %s"):format(where, options.got(file)), 3)
end

-- The names of packages whose modules have other names: of rocks, and of Debian, with
-- what one has to know of that.
local ROCKS, DEBIAN = { socket = "luasocket", lxp = "luaexpat" },
  { lxp = "expat", redis = "redis, for Lua 5.1 to 5.3" }

--- Load the modules of one or two packages, and return them. If a package is missing,
-- return nil and the problem.
function options.find_package(name, other)
  local ok, module = try(rfsm.find_module, name)
  if not ok or type(module) ~= "table" then
    return nil, ("the package %s is missing (on Debian: apt-get install lua-%s)")
      :format(ROCKS[name] or name, DEBIAN[name] or name)
  elseif other == nil then
    return module
  end
  local second, problem = options.find_package(other)
  if not second then return nil, problem end
  return module, second
end

--- Load a module that the extension `where` needs; raise an error if it is missing.
function options.need(where, name)
  local module, problem = options.find_package(name)
  return module or error(where .. ": " .. problem, 0)
end

return options
