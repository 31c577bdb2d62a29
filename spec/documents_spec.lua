-- The documents, followed as a reader does. A `lua` block that begins with
-- "-- NAME.lua" is saved under that name. A block that begins with "$ " is a session:
-- commands to run beside the saved files, after "> " lines to type, and the output.

local helper = require "spec.helper"

local lines_of = helper.lines_of

local CHECKOUT = lines_of("pwd")[1]
local LUA = arg[-1]:find("^/") and arg[-1] or CHECKOUT .. "/" .. arg[-1]

local function quoted(text) return "'" .. text:gsub("'", "'\\''") .. "'" end

local function write_file(name, text)
  local file = assert(io.open(name, "wb"))
  file:write(text)
  file:close()
end

-- Returns an empty folder, in which `lua` is the interpreter that runs this.
local function new_folder()
  local folder = os.tmpname()
  os.remove(folder)
  assert(os.execute("mkdir -p " .. folder .. "/.bin"))
  write_file(folder .. "/.bin/lua", ("#!/bin/sh\nexec %s \"$@\"\n"):format(quoted(LUA)))
  assert(os.execute(("chmod +x %s/.bin/lua; ln -s %s %s/examples"):format(folder,
    quoted(CHECKOUT .. "/examples"), folder)))
  return folder
end

-- Runs a command in a folder as a user of this checkout; returns the lines it prints.
local function output_of(folder, command)
  local lines = lines_of(([[
cd %s && PATH=$PWD/.bin:%s/tools:$PATH LUA=lua LUA_PATH='%s/?.lua;%s/compat/?.lua;;' \
HOME=/nowhere TERM=dumb sh -c %s </dev/null 2>&1]]):format(folder, quoted(CHECKOUT),
    CHECKOUT, CHECKOUT, quoted(command)))
  for i, line in ipairs(lines) do lines[i] = line:match("^(.-)%s*$") end
  return lines
end

-- Splits a session into { command =, lines = {...} }.
local function commands_of(text)
  local commands = {}
  for line in text:gmatch("([^\n]*)\n") do
    local command = line:match("^%$ (.*)")
    local lines = command and {} or commands[#commands].lines
    if command then
      commands[#commands + 1] = { command = command, lines = lines }
    else
      lines[#lines + 1] = line:match("^(.-)%s*$")
    end
  end
  return commands
end

-- Returns the lines that a terminal shows for a command. A tool makes those of the
-- simulator: it types the lines after "> ".
local function replay(folder, step)
  if not step.command:find("^rfsm sim ") then return output_of(folder, step.command) end
  local name = helper.file_with(("```\n$ %s\n%s\n```\n"):format(step.command,
    table.concat(step.lines, "\n")))
  local lines = output_of(folder, ("lua %s %s"):format(
    quoted(CHECKOUT .. "/tools/transcript.lua"), name))
  for _ = 1, 2 do table.remove(lines, 1) end -- the fence and the command
  lines[#lines] = nil
  return lines
end

-- Returns the blocks of a document: { line =, text =, file =, commands = } each.
local function blocks_of(document)
  local blocks, number, block = {}, 0, nil
  for line in helper.content(document):gmatch("([^\n]*)\n") do
    number = number + 1
    if not line:find("^```") then
      if block then block.text = block.text .. line .. "\n" end
    elseif block then
      block.file = block.language == "lua" and block.text:match("^%-%- (%S+%.lua)\n")
      block.commands = block.text:find("^%$ ") and commands_of(block.text)
      blocks[#blocks + 1], block = block, nil
    else
      block = { line = number + 1, text = "", language = line:sub(4) }
    end
  end
  return blocks
end

after_each(helper.remove_files)

-- Saves the files of a block, and types its commands.
local function follow(folder, block)
  if block.file then write_file(folder .. "/" .. block.file, block.text) end
  for _, step in ipairs(block.commands or {}) do
    assert.same(step.lines, replay(folder, step),
      ("at line %d: %s"):format(block.line, step.command))
  end
end

describe("who follows", function()
  local folder

  before_each(function() folder = new_folder() end)
  after_each(function() os.execute("rm -r " .. folder) end)

  for _, document in ipairs(lines_of("ls *.md .github/*.md doc/*.md")) do
    it(document .. " sees what it says", function()
      for _, block in ipairs(blocks_of(document)) do follow(folder, block) end
    end)
  end
end)

describe("the chart in the README", function()
  local folder

  setup(function()
    folder = new_folder()
    for _, block in ipairs(blocks_of("README.md")) do follow(folder, block) end
  end)

  teardown(function() os.execute("rm -r " .. folder) end)

  it("is the example lamp.lua, which make sim opens", function()
    assert.equal(helper.content("examples/lamp.lua"),
      helper.content(folder .. "/lamp.lua"))
  end)

  it("is taken by every command", function()
    for _, command in ipairs { "rfsm json -o lamp.json", "rfsm plantuml -o lamp.puml",
      "rfsm dot -o lamp.dot", "rfsm mermaid -o lamp.mmd", "rfsm viz -o lamp.svg",
      "rfsm viz -T plantuml -o lamp.txt", "rfsm check -q -s", "rfsm-check -q",
      "rfsm-viz -o lamp.pdf", "rfsm2json", "rfsm2plantuml", "rfsm-sim -q -e 'pp()'" } do
      local lines = output_of(folder, command .. " lamp.lua && echo done")
      assert.equal("done", lines[#lines], command)
    end
  end)
end)

describe("the page of all functions", function()
  it("is what the comments say", function()
    assert.equal(helper.text_of(LUA .. " tools/functions.lua"),
      helper.content("doc/functions.md"))
  end)
end)

describe("the index of examples in the manual", function()
  it("has each of them", function()
    local manual, missing = helper.content("doc/manual.md"), {}
    for _, file in ipairs(lines_of("find examples/*.lua examples/hosts -type f")) do
      if not manual:find("(../" .. file .. ")", 1, true) then
        missing[#missing + 1] = file
      end
    end
    assert.same({}, missing)
  end)
end)

local UNITS = {
  us = true, ns = true, ms = true, KiB = true, MiB = true, kB = true, MB = true,
  x = true, times = true,
}

-- Returns the figures of a text that doc/performance.md does not have.
local function unfounded_in(text)
  local list, performance = {}, " " .. helper.content("doc/performance.md")
  local function check(number, unit)
    number = number:gsub("%.$", "")
    local token = "[^%d.,]" .. number:gsub("%.", "%%.") .. "%f[^%d]"
    if not performance:find(token) then list[#list + 1] = number .. " " .. unit end
  end
  for number, unit in text:gmatch("%f[%d](%d[%d.,]*)%s*(%a+)") do
    if UNITS[unit] then check(number, unit) end
  end
  for number in text:gmatch("%f[%d](%d[%d.,]*)%s*%%") do check(number, "%") end
  return list
end

describe("a figure with a unit", function()
  it("is found unless doc/performance.md has it", function()
    assert.same({ "7.77 us", "3.7 times", "78.5 %" },
      unfounded_in("takes 7.77 us, 3.7 times as long, 78.5 % more in 3 rounds"))
  end)

  for _, document in ipairs { "README.md", "CHANGELOG.md", "doc/howto.md",
    "doc/manual.md", "doc/checks.md", "doc/emem.md" } do
    it("in " .. document .. " is one of doc/performance.md", function()
      assert.same({}, unfounded_in(helper.content(document)))
    end)
  end
end)
