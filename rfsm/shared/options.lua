--- Options of functions: tests and defaults; packages that an extension needs.
--
-- @module rfsm.shared.options
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"

local error, ipairs, pairs, pcall = error, ipairs, pairs, pcall
local require, type = require, type
local floor, huge = math.floor, math.huge
local concat = table.concat

local options = {}

--- Is it a text that is not empty?
function options.is_text(x) return type(x) == "string" and x ~= "" end

--- Return a test for whole numbers within bounds.
function options.is_whole(least, most)
  return function(x)
    return type(x) == "number" and x >= least and x <= most and x == floor(x)
  end
end

--- Is it a finite number of seconds, not below 0?
function options.is_seconds(x) return type(x) == "number" and x >= 0 and x < huge end

--- Return the end of a message: "got string 'x'".
function options.got(value)
  if type(value) == "string" then return ("got string '%s'"):format(value) end
  return "got " .. (type(value) == "number" and rfsm.text_of(value) or type(value))
end

--- Return the options with their defaults.
---@param known table<string, any[]> description, test, default of each; a test may
-- return false and the problem
---@return table? settings nil if one is wrong
---@return string? problem in one line
function options.read(known, given)
  if type(given) ~= "table" then
    return nil, "table of options expected, " .. options.got(given)
  end
  local settings = {}
  for _, name in ipairs(rfsm.sorted_keys(given)) do
    local option, value = known[name], given[name]
    if not option then
      local text, names = rfsm.text_of(name), rfsm.sorted_keys(known)
      local hint = advice.nearest_name(text, names):match("^ %(did you mean.*") or ""
      return nil, ("unknown option '%s'%s, expected: %s"):format(text, hint,
        concat(names, ", "))
    end
    local is_right, why = option[2](value)
    if not is_right then
      why = why or option[1] .. " expected, " .. options.got(value)
      return nil, name .. ": " .. why
    end
    settings[name] = value
  end
  for name, option in pairs(known) do -- any order: each stands alone
    if settings[name] == nil then settings[name] = option[3] end
  end
  return settings
end

--- Load a module that an extension needs.
---@param package string that of Debian which has it
---@return table? module nil if it is missing
---@return string? problem in one line
function options.find_package(name, package)
  local ok, module = pcall(require, name)
  if ok and type(module) == "table" then return module end
  return nil, ("the package %s is missing (on Debian: apt-get install %s)"):format(
    name == "socket" and "luasocket" or name, package)
end

--- Load a module that an extension needs.
-- @raise if it is missing
---@param where string the name of the extension
function options.need(where, name, package)
  local module, problem = options.find_package(name, package)
  return module or error(where .. ": " .. problem, 0)
end

return options
