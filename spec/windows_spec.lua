-- The commands on a system like Windows: backslashes in paths, no popen, no shell, no
-- terminal. The files are found by a Lua that reads backslashes as slashes.

local helper = require "spec.helper"

-- What is different. The files that the system opens have backslashes as separators.
local SYSTEM = [=[
package.config = "\\" .. package.config:sub(2)
io.popen = nil
os.execute = function(command) return command == nil and false or nil end
for _, entry in ipairs { { io, "open" }, { io, "lines" }, { _G, "loadfile" },
  { os, "remove" }, { os, "rename" } } do
  local real = entry[1][entry[2]]
  entry[1][entry[2]] = function(name, ...)
    return real(name and name:gsub("\\", "/") .. "", ...)
  end
end
]=]

-- Returns what a command prints.
local function output_of(...)
  local words = { "[0] = [[tools\\rfsm]]" }
  for _, word in ipairs { ... } do words[#words + 1] = ("%q"):format(word) end
  local file = helper.file_with(("%s\narg = { %s }\ndofile 'tools/rfsm'\n"):format(
    SYSTEM, table.concat(words, ", ")))
  return (helper.text_of(("%s %s </dev/null 2>&1"):format(helper.interpreter(), file))
    :gsub("\n$", ""))
end

describe("without what Unix has", function()
  after_each(helper.remove_files)

  it("rfsm check reads a chart", function()
    assert.equal("examples/on_off.lua: ok (0 properties judged)",
      output_of("check", "examples\\on_off.lua"))
  end)

  for _, format in ipairs { "json", "plantuml", "mermaid", "dot" } do
    it("rfsm " .. format .. " prints a chart as elsewhere", function()
      assert.equal(output_of(format, "-o", "-", "examples/on_off.lua"),
        output_of(format, "-o", "-", "examples\\on_off.lua"))
    end)
  end

  it("rfsm viz writes a graph, and reports that it cannot draw", function()
    assert.matches('^digraph "on_off"', output_of("viz", "examples\\on_off.lua"))
    local name = os.tmpname()
    assert.matches("^rfsm viz: [^\n]*Graphviz[^\n]*$", output_of("viz",
      "examples\\on_off.lua", "-o", name .. ".svg"))
    os.remove(name)
  end)

  it("rfsm sim runs commands", function()
    assert.matches("active: root.on%(", output_of("sim", "-q", "-e",
      "run() ser('e_push')", "examples\\on_off.lua"))
  end)
end)
