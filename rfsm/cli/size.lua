--- `rfsm size`: the memory that a chart needs on a robot.
--
-- @module rfsm.cli.size
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local files = require "rfsm.shared.files"
local quoted = require("rfsm.shared.programs").quoted
local rfsm = require "rfsm"

local io, ipairs, package = io, ipairs, package
local ceil, concat = math.ceil, table.concat

local size = { summary = "Print the memory that a chart needs on a robot.",
  epilog = "The chart is loaded and prepared, its callbacks are not called: what they "
    .. "keep comes on top. The figures of a pool are estimated, for "
    .. "OCL::LuaTLSFComponent on 64 bits." }

function size.add_arguments(command)
  common.add_file(command)
  common.add_stub(command)
  command:option("--lua", "the Lua to measure, lua5.1 by default, as in RTT", "lua5.1")
    :argname("LUA")
end

local FORMS = { "source", "stripped" }
local EXTRAS = { "rfsmpp", "rfsm.record", "rfsm.proto" }

-- KiB in a pool for each KiB of heap. A pool adds bytes to each block; code has many
-- small blocks.
local CODE, DATA = 1.29, 1.12
local FACTORS = { library = CODE, modules = CODE, module = CODE, chart = DATA }

-- KiB by form: the memory of a Lua with RTT 2.10, and what a launch adds for good.
-- RTTLIB comes on top if a chart uses rttlib or utils, which OCL installs as source.
local BASE = {
  source = { heap = 112, pool = 156 },
  stripped = { heap = 104, pool = 140 },
}
local RTTLIB = { heap = 94, pool = 117 }

-- A pool needs room for garbage: it is larger than the memory in use by this factor.
local ROOM = 1.2

-- Notes a value that rfsm/cli/measure.lua prints. A value with a factor is KiB of heap.
local function note(values, key, value)
  local factor, sum = FACTORS[key], values.together
  if factor then value = rfsm.number_of(value) end
  values[key] = factor and { heap = value, pool = value * factor } or value
  if not factor then return end
  sum.heap, sum.pool = sum.heap + values[key].heap, sum.pool + values[key].pool
end

-- Returns the measured values of a form by name; nil if the Lua loads no stripped code.
local function measure(options, form, kind, name)
  local _, program = files.find "rfsm/cli/measure"
  local pipe = io.popen(("%s %s %s %s %s %s %s 2>&1"):format(options.lua,
    quoted(program), form, quoted(package.path), kind, quoted(name),
    options.stub and "stub" or ""))
  local base, last = BASE[form], "nothing"
  local values = { base = base, rttlib = RTTLIB,
    together = { heap = base.heap, pool = base.pool } }
  for line in pipe:lines() do
    local key, value = line:match("^(%l+) (.*)$")
    if key then note(values, key, value) end
    last = line
  end
  pipe:close()
  if values.problem then common.fail(common.with_hint(values.problem, options.stub)) end
  if values.chart or values.module then return values end
  if form ~= "stripped" then common.fail(options.lua .. ": " .. last) end
end

-- Returns the values of each form that can be measured.
local function measure_all(options, kind, name)
  local results = {}
  for i, form in ipairs(FORMS) do results[i] = measure(options, form, kind, name) end
  return results
end

local function write_row(name, results, key)
  local texts = {}
  for i, values in ipairs(results) do
    texts[i] = ("%7.0f%7.0f"):format(values[key].heap, values[key].pool)
  end
  io.stdout:write(("%-36s"):format(name), concat(texts), "\n")
end

function size.run(options)
  common.read(options.file)
  local results = measure_all(options, "chart", options.file)
  local source = results[1]
  io.stdout:write(("%-36s"):format("KiB, " .. options.lua),
    ("%14s%14s"):format("from source", "stripped"):sub(1, 14 * #results),
    "\n", (" "):rep(36), ("   heap   pool"):rep(#results), "\n")
  write_row("Lua with RTT and a launch", results, "base")
  write_row("rfsm and rfsm.rtt", results, "library")
  write_row("modules that the chart loads", results, "modules")
  write_row(("%s: %s states, %s transitions"):format(options.file:match("[^/]*$"),
    source.states, source.transitions), results, "chart")
  write_row("together", results, "together")
  write_row("+ rttlib and utils", results, "rttlib")
  for _, name in ipairs(EXTRAS) do
    write_row("+ " .. name, measure_all(options, "module", name), "module")
  end
  io.stdout:write(("launch { pool = %d } leaves room for garbage\n"):format(
    ceil(source.together.pool * ROOM / 50) * 50))
end

return size
