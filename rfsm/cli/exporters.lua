--- The exporters. Each is a module `rfsm.NAME` with `encode(fsm)`, and a command that
-- writes each chart to a file. The help, `rfsm viz` and tools/house.lua read this list.
--
-- @module rfsm.cli.exporters
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local files = require "rfsm.shared.files"

local concat = table.concat

--- One exporter.
---@class rfsm.cli.Exporter
---@field name string NAME of the module and of the command
---@field language string name of the format, for the help
---@field ending string ending of the file names
local EXPORTERS = {
  { name = "dot", language = "Graphviz graphs", ending = "dot" },
  { name = "plantuml", language = "PlantUML diagrams", ending = "puml" },
  { name = "mermaid", language = "Mermaid diagrams", ending = "mmd" },
  { name = "json", language = "JSON", ending = "json" },
}

local function add_arguments(command)
  common.add_files(command)
  common.add_stub(command)
  common.add_machine(command)
  common.add_output(command, "one file for all; - is stdout")
end

-- Writes a text to the file beside a chart, and warns if the file had another text.
local function write_beside(file, ending, text)
  local output = file == "-" and "-" or file:gsub("%.lua$", "") .. ending
  local old = output ~= "-" and files.read(output)
  common.write(output, text)
  if old and old ~= text then common.warn(output .. " was replaced") end
end

-- Makes the command of an exporter.
local function new_command(exporter)
  local ending = "." .. exporter.ending
  local function run(options)
    local encode = require("rfsm." .. exporter.name).encode
    local texts = common.encode_all(options, function(fsm, title, foot)
      return encode(fsm, { title = title, foot = foot or nil })
    end)
    if options.output then return common.write(options.output, concat(texts)) end
    for i, file in ipairs(options.files) do
      write_beside(file, ending, texts[i])
    end
  end

  return { name = exporter.name,
    summary = "Write charts as " .. exporter.language .. ".",
    epilog = "The result for a.lua is a" .. ending .. ".",
    add_arguments = add_arguments, run = run }
end

local exporters = { list = EXPORTERS, commands = {} }

for i, exporter in ipairs(EXPORTERS) do
  exporters.commands[i] = new_command(exporter)
end

return exporters
