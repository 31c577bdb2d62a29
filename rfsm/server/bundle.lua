--- Bundles: modules as functions in one text, for a sandbox without files.
--
-- @module rfsm.server.bundle
-- @license BSD-3-Clause

local files = require "rfsm.shared.files"

local bundle = {}

--- The text before the modules. It defines the `require` that the modules call. A text
-- before it has to declare `outer_require`: the `require` of the host, or nil.
bundle.HEAD = [[
local bundled, loaded = {}, {}

local function require(name)
  if not bundled[name] then
    if type(outer_require) == "function" then return outer_require(name) end
    error("module '" .. name .. "' not found", 2)
  end
  if loaded[name] == nil then
    loaded[name] = true
    loaded[name] = bundled[name](name) or true
  end
  return loaded[name]
end

]]

--- Append a module to the parts of a bundle, under its name or the name `as`. Return
-- the source of the module; nil if it is not found.
function bundle.add(parts, name, as)
  local text = files.find((name:gsub("%.", "/")))
  if not text then return nil end
  parts[#parts + 1] = ("bundled[%q] = function(...)\n%s\nend\n"):format(as or name,
    text)
  return text
end

return bundle
