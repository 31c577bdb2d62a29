-- Writes the lists of the development rockspec anew: LUA tools/rockspec.lua
-- Prints the rockspec of a release:                  LUA tools/rockspec.lua VERSION URL
--
-- The latter is the development rockspec with this version, with the tag of the release
-- in the repository at URL, and with the address of that as homepage.

local DEV = "rockspec/rfsm-dev-1.rockspec"

local version, url = arg[1], arg[2]
if version and not (url and version:find("^%d+%.%d+%.%d+$")) then
  io.stderr:write("usage: tools/rockspec.lua [VERSION URL] (such as 1.2.0 ",
    "git+https://example.org/rfsm.git)\n")
  os.exit(2)
end

local file = assert(io.open(DEV))
local text = file:read("*a")
file:close()

local function replace(pattern, replacement)
  local count
  text, count = text:gsub(pattern, (replacement:gsub("%%", "%%%%")))
  assert(count == 1, "rockspec: one place expected: " .. pattern)
end

-- Returns lines `["name"] = "file",` for the files that a shell pattern finds.
local function list(indent, patterns, name_of)
  local lines, pipe = {}, assert(io.popen("ls " .. patterns))
  for found in pipe:lines() do
    lines[#lines + 1] = ('%s["%s"] = "%s",\n'):format(indent, name_of(found), found)
  end
  pipe:close()
  return "{\n" .. table.concat(lines) .. indent:sub(3) .. "}"
end

local function module_of(found)
  return (found:gsub("^compat/", ""):gsub("%.lua$", ""):gsub("/", "."))
end

if version then
  replace('version = "dev%-1"', ('version = "%s-1"'):format(version))
  replace("source = [^\n]*",
    ('source = { url = "%s", tag = "v%s" }'):format(url, version))
  replace('  license = ', ('  homepage = "%s",\n  license = '):format(
    url:gsub("^git%+", ""):gsub("%.git$", "")))
  io.write(text)
else
  replace("modules = %b{}", "modules = " .. list("    ",
    "*.lua rfsm/*.lua rfsm/*/*.lua compat/*.lua", module_of))
  replace("bin = %b{}", "bin = " .. list("      ", "tools/rfsm*",
    function(found) return found:match("[^/]*$") end))
  file = assert(io.open(DEV, "w"))
  file:write(text)
  file:close()
end
