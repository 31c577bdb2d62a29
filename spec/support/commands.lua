-- Runs the commands of `rfsm` in this process.

local cli = require "rfsm.cli.main"
local helper = require "spec.helper"

local commands = {}

--- Returns a stream that appends to a text.
function commands.new_stream()
  local stream = { text = "" }
  function stream.write(self, ...)
    self.text = self.text .. table.concat(helper.texts(...))
    return self
  end
  function stream.flush(self) return self end
  function stream.setvbuf() end
  return stream
end

-- Splits a command line; a word with blanks stands in quotes.
local function split(command)
  local words = {}
  for text in command:gsub("'[^']*'", function(quoted)
    return (quoted:sub(2, -2):gsub(" ", "\1"))
  end):gmatch("%S+") do
    words[#words + 1] = text:gsub("\1", " ")
  end
  return words
end

--- Runs a command line in this process, while these modules are replaced; returns
--- stdout, stderr and the status.
function commands.run(command, modules)
  local out, err, default = commands.new_stream(), commands.new_stream(), nil
  local argv = split(command)
  local function exit(status) error({ status = status }, 0) end
  local function output(stream)
    default = stream or default
    return default
  end
  local function print_out(...)
    out:write(table.concat(helper.texts(...), "\t"), "\n")
  end
  local ok, status = pcall(helper.with, package.loaded, modules or {}, function()
    return helper.with(os, { exit = exit }, function()
      return helper.with(io, { stdout = out, stderr = err, output = output }, function()
        return helper.with(_G, { print = print_out }, function()
          return cli.main(argv)
        end)
      end)
    end)
  end)
  if ok then return out.text, err.text, status end
  if type(status) ~= "table" then error(status, 0) end
  return out.text, err.text, status.status
end

--- Returns what a program prints if its command line is wrong.
function commands.refusal(program, problem)
  return ("%s: %s; see %s --help\n"):format(program, problem, program)
end

--- Returns the formats of `rfsm viz`: pictures, and one for each exporter.
function commands.formats()
  local formats = { "svg", "png", "pdf" }
  for _, exporter in ipairs(require("rfsm.cli.exporters").list) do
    formats[#formats + 1] = exporter.name
  end
  return formats
end

return commands
