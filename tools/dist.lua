-- Prints one file that holds the modules named:  LUA tools/dist.lua MODULE...
--
-- Each module becomes a function in that file, found by a `require` of its own, so that
-- the file also works in a sandbox that has none. The first module is the core; loading
-- the file returns it.

package.path = "./?.lua;./compat/?.lua;" .. package.path

local bundle = require "rfsm.server.bundle"
local files = require "rfsm.shared.files"

local HEAD = [[
-- %s in one file: %s.
-- Made by tools/dist.lua; the sources and the license are in the repository.

-- The global of this name, which a sandbox may lack.
local _, outer_require = pcall(function() return require end)
]]

-- The types are comments: nothing loads them.
local TYPES = assert(files.read("rfsm/shared/types.lua"))
  :gsub("^%-%-%-@meta\n.-\n\n", "")

local FOOT = [[
local _, preload = pcall(function() return package.preload end)
for name in pairs(type(preload) == "table" and bundled or {}) do -- any order
  if name ~= %q and not preload[name] then
    preload[name] = function() return require(name) end
  end
end

---@type %s
local module = require %q

return module
]]

local names, parts, version = {}, {}, nil
for _, name in ipairs(arg) do
  local text = bundle.add(parts, name)
  if text then
    names[#names + 1] = name
    version = version or text:match('_VERSION = "([^"]+)"')
  else
    io.stderr:write("tools/dist.lua: there is no ", name, ", it is left out\n")
  end
end
io.write(HEAD:format(version, table.concat(names, ", ")), bundle.HEAD,
  table.concat(parts, "\n"), "\n", TYPES, "\n",
  FOOT:format(names[1], names[1], names[1]))
