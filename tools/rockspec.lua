-- Prints the rockspec of a release:  LUA tools/rockspec.lua VERSION URL
--
-- It is the development rockspec with this version, with the tag of the release in the
-- repository at URL, and with the address of that as homepage.

local version, url = arg[1], arg[2]
if not url or not version:find("^%d+%.%d+%.%d+$") then
  io.stderr:write("usage: tools/rockspec.lua VERSION URL (such as 1.2.0 ",
    "git+https://example.org/rfsm.git)\n")
  os.exit(2)
end

local file = assert(io.open("rockspec/rfsm-dev-1.rockspec"))
local text = file:read("*a")
file:close()

local function replace(pattern, replacement)
  local count
  text, count = text:gsub(pattern, (replacement:gsub("%%", "%%%%")))
  assert(count == 1, "rockspec: one line expected: " .. pattern)
end

replace('version = "dev%-1"', ('version = "%s-1"'):format(version))
replace("source = [^\n]*",
  ('source = { url = "%s", tag = "v%s" }'):format(url, version))
replace('  license = ', ('  homepage = "%s",\n  license = '):format(
  url:gsub("^git%+", ""):gsub("%.git$", "")))
io.write(text)
