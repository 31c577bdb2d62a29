-- Prints one file that holds the modules named:  LUA tools/dist.lua MODULE...
--
-- Each module becomes a function in that file, found by a `require` of its own, so that
-- the file also works in a sandbox that has none. The first module is the core; loading
-- the file returns it.

local function read(name)
  local file = name:gsub("%.", "/") .. ".lua"
  local handle = io.open(file) or io.open("compat/" .. file)
  if not handle then return nil end
  local text = handle:read("*a")
  handle:close()
  return text
end

local HEAD = [[
-- %s in one file: %s.
-- Made by tools/dist.lua; the sources and the license are in the repository.

local bundled, loaded = {}, {}

-- Stands for the global of this name, which a sandbox may lack.
local outer_require = require
local function require(name)
  if not bundled[name] then
    if outer_require then return outer_require(name) end
    error("module '" .. name .. "' not found", 2)
  end
  if loaded[name] == nil then
    loaded[name] = true
    loaded[name] = bundled[name](name) or true
  end
  return loaded[name]
end
]]

local FOOT = [[
for name in pairs(bundled) do -- any order: each stands alone
  if package and package.preload and name ~= %q and not package.preload[name] then
    package.preload[name] = function() return require(name) end
  end
end

return require %q
]]

local names, parts = {}, {}
for _, name in ipairs(arg) do
  local text = read(name)
  if text then
    names[#names + 1] = name
    parts[#parts + 1] = ("bundled[%q] = function(...)\n%s\nend\n"):format(name, text)
  else
    io.stderr:write("tools/dist.lua: there is no ", name, ", it is left out\n")
  end
end
local version = assert(read(names[1])):match('_VERSION = "([^"]+)"')
io.write(HEAD:format(version, table.concat(names, ", ")), "\n",
  table.concat(parts, "\n"), "\n", FOOT:format(names[1], names[1]))
