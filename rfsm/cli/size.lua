--- `rfsm size`: the memory that a chart needs on a robot.
--
-- @module rfsm.cli.size
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local files = require "rfsm.shared.files"

local io, ipairs, package = io, ipairs, package
local tonumber = tonumber
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

-- What a pool takes for 1 KiB of heap: it adds bytes to each block, and code has many.
local CODE, DATA = 1.29, 1.12

-- KiB by form: those of a Lua with RTT 2.10 and rttlib, and what a launch leaves there.
local BASE = {
  source = { heap = 155 + 40, pool = 210 + 52 },
  stripped = { heap = 155 + 32, pool = 210 + 39 },
}

-- A pool needs room for garbage: it has to be so many times what is in use.
local ROOM = 1.2

local function quoted(text) return "'" .. text:gsub("'", "'\\''") .. "'" end

-- Returns the name of the program that measures.
local function find_program()
  for template in package.path:gmatch("[^;]+") do
    local name = template:gsub("%?", "rfsm/cli/measure")
    if files.read(name) then return name end
  end
end

-- Returns the values that rfsm/cli/measure.lua prints; nil if nothing can be stripped.
local function measure(options, form, kind, name)
  local pipe = io.popen(("%s %s %s %s %s %s %s 2>&1"):format(options.lua,
    quoted(find_program()), form, quoted(package.path), kind, quoted(name),
    options.stub and "stub" or ""))
  local values, last = {}, "nothing"
  for line in pipe:lines() do
    local key, value = line:match("^(%l+) (.*)$")
    if key then values[key] = tonumber(value) or value end
    last = line
  end
  pipe:close()
  if values.problem then common.fail(common.with_hint(values.problem, options.stub)) end
  if not (values.chart or values.module) then
    if form == "stripped" then return nil end
    common.fail(options.lua .. ": " .. last)
  end
  return values
end

local function write_row(name, cells)
  local texts = {}
  for i, value in ipairs(cells) do texts[i] = ("%7.0f"):format(value) end
  io.stdout:write(("%-36s"):format(name), concat(texts), "\n")
end

-- Appends two cells: KiB in the heap, and in a pool, which takes `factor` times that.
local function add(cells, kib, factor)
  cells[#cells + 1], cells[#cells + 2] = kib, kib * factor
end

-- Returns the rows of the table, each a name and a list of cells.
local function rows_of(options, results)
  local base, library, modules, chart, sum = {}, {}, {}, {}, {}
  for _, form in ipairs(FORMS) do
    local values = results[form]
    if values then
      base[#base + 1], base[#base + 2] = BASE[form].heap, BASE[form].pool
      add(library, values.library, CODE)
      add(modules, values.modules, CODE)
      add(chart, values.chart, DATA)
    end
  end
  for i in ipairs(base) do sum[i] = base[i] + library[i] + modules[i] + chart[i] end
  local counts = ("%s: %d states, %d transitions"):format(options.file:match("[^/]*$"),
    results.source.states, results.source.transitions)
  return { { "Lua with RTT, rttlib and a launch", base },
    { "rfsm and rfsm.rtt", library }, { "modules that the chart loads", modules },
    { counts, chart }, { "together", sum } }
end

function size.run(options)
  common.check_readable(options.file)
  local results = {}
  for _, form in ipairs(FORMS) do
    results[form] = measure(options, form, "chart", options.file)
  end
  local form_count = results.stripped and 2 or 1
  io.stdout:write(("%-36s"):format("KiB, " .. options.lua),
    ("%14s%14s"):format("from source", "stripped"):sub(1, 14 * form_count),
    "\n", (" "):rep(36), ("   heap   pool"):rep(form_count), "\n")
  local rows = rows_of(options, results)
  for _, line in ipairs(rows) do write_row(line[1], line[2]) end
  for _, name in ipairs(EXTRAS) do
    local cells = {}
    for _, form in ipairs(FORMS) do
      local values = results[form] and measure(options, form, "module", name)
      if values then add(cells, values.module, CODE) end
    end
    write_row("+ " .. name, cells)
  end
  io.stdout:write(("launch { pool = %d } leaves room for garbage\n"):format(
    ceil(rows[#rows][2][2] * ROOM / 50) * 50))
end

return size
