-- Writes the lists of the development rockspec, and the modules of doc/config.ld, anew:
--   LUA tools/rockspec.lua
-- Prints the rockspec of a release: LUA tools/rockspec.lua VERSION URL
--
-- The latter is the development rockspec with this version, with the tag of the release
-- in the repository at URL, and with the address of that as homepage.

local files = require "rfsm.shared.files"

local DEV, PAGES = "rockspec/rfsm-dev-1.rockspec", "doc/config.ld"

local version, url = arg[1], arg[2]
if version and not (url and version:find("^%d+%.%d+%.%d+$")) then
  io.stderr:write("usage: tools/rockspec.lua [VERSION URL] (such as 1.2.0 ",
    "git+https://example.org/rfsm.git)\n")
  os.exit(2)
end

local function read(name) return assert(files.read(name)) end

local text = read(DEV)

local function replace(pattern, replacement)
  local count
  text, count = text:gsub(pattern, (replacement:gsub("%%", "%%%%")))
  assert(count == 1, "one place expected: " .. pattern)
end

-- Returns a list of the lines that `line_of` makes of the files that a shell pattern
-- finds; of no file if that is nil.
local function list(indent, patterns, line_of)
  local lines, pipe = {}, assert(io.popen("export LC_ALL=C; ls " .. patterns))
  for found in pipe:lines() do
    local line = line_of(found)
    lines[#lines + 1] = line and indent .. line .. ",\n"
  end
  pipe:close()
  return "{\n" .. table.concat(lines) .. indent:sub(3) .. "}"
end

local function module_of(found)
  local name = found:gsub("^compat/", ""):gsub("%.lua$", ""):gsub("/", ".")
  return ('["%s"] = "%s"'):format(name, found)
end

local function tool_of(found)
  return ('["%s"] = "%s"'):format(found:match("[^/]*$"), found)
end

-- Modules that nobody requires but the library.
local IS_PRIVATE = { ["rfsm/advice.lua"] = true, ["rfsm/fast.lua"] = true }

-- Public are the modules that are not in a folder, and have more than one line; and the
-- submodules of these.
local function page_of(found)
  local is_part, source = found:find("^rfsm/.*/"), read(found)
  local is_public = not (is_part or IS_PRIVATE[found] or source:find("^return require"))
    or is_part and source:find("\n-- @submodule ")
  return is_public and ("'../%s'"):format(found) or nil
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
  replace("bin = %b{}", "bin = " .. list("      ", "tools/rfsm*", tool_of))
  assert(files.write(DEV, text))
  text = read(PAGES)
  replace("\nfile = %b{}", "\nfile = " .. list("  ",
    "*.lua && ls rfsm/*.lua rfsm/*/*.lua", page_of))
  assert(files.write(PAGES, text))
end
