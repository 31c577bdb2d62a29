--- What the exporting tools have in common: charts in, texts out.
--
-- `tools/rfsm2json` and `tools/rfsm2plantuml` are a name and an encoder each.
--
-- @module rfsm_export
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, pcall, require, tostring = ipairs, pcall, require, tostring
local io, os = io, os
local concat = table.concat

local rfsm_export = {}

-- Ends the tool with one clear line.
local function fail(name, text)
  io.stderr:write(name, ": ", text, "\n")
  os.exit(1)
end

local function first_line(problem) return (tostring(problem):match("^[^\n]*")) end

--- Load and initialise the chart in a file, silently.
---@param file string
---@return rfsm.Machine? fsm
---@return string? problem in one line
function rfsm_export.load(file)
  local ok, model = pcall(rfsm.load, file)
  if not ok then return nil, (first_line(model):gsub("^rfsm%.load: ", "")) end
  model.err, model.warn, model.info = false, false, false
  local fsm, problems = rfsm.init(model)
  if fsm then return fsm end
  return nil, file .. ": " .. concat(problems, "; ")
end

local function parse(name, what, argv)
  local has_argparse, argparse = pcall(require, "argparse")
  if not has_argparse then
    fail(name, "argparse is missing; please type: sudo apt-get install lua-argparse")
  end
  local parser = argparse(name, "Write charts as " .. what .. ".")
  parser:argument("files", "Lua files that return a chart"):args("+"):argname("FILE")
  parser:option("-o --output", "file to write; - is stdout", "-"):argname("FILE")
  return parser:parse(argv)
end

local function write(name, file, text)
  if file == "-" then return io.stdout:write(text) end
  local handle, problem = io.open(file, "w")
  if not handle then fail(name, problem) end
  handle:write(text)
  handle:close()
end

--- Run an exporting tool: every chart is read before anything is written.
---@param name string of the tool
---@param what string what it writes
---@param encode fun(fsm: rfsm.Machine, file: string): string
---@param argv string[] the command line
function rfsm_export.main(name, what, encode, argv)
  local options = parse(name, what, argv)
  local texts = {}
  for i, file in ipairs(options.files) do
    local fsm, problem = rfsm_export.load(file)
    if not fsm then fail(name, problem) end
    local ok, text = pcall(encode, fsm, file)
    if not ok then fail(name, first_line(text)) end
    texts[i] = text:gsub("\n*$", "\n")
  end
  write(name, options.output, concat(texts))
end

return rfsm_export
