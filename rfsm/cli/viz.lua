--- `rfsm viz`: draw charts.
--
-- @module rfsm.cli.viz
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local exporters = require "rfsm.cli.exporters"
local dot = require "rfsm.dot"
local order = require "rfsm.shared.order"
local pages = require "rfsm.cli.pages"
local quoted = require("rfsm.shared.programs").quoted

local concat = table.concat

-- All formats of an output: three are made by Graphviz, the others are texts that an
-- exporter makes.
local FORMATS, BY_ENDING = { "svg", "png", "pdf" }, { gv = "dot" }
local IS_TEXT = { svg = false, png = false, pdf = false }
for _, exporter in ipairs(exporters.list) do
  FORMATS[#FORMATS + 1], IS_TEXT[exporter.name] = exporter.name, true
  BY_ENDING[exporter.ending] = exporter.name
end

local viz = { summary = "Draw charts.",
  epilog = "Without -T the ending of the output decides, or it is dot." }

function viz.add_arguments(command)
  common.add_files(command)
  common.add_stub(command)
  common.add_machine(command)
  common.add_option(command, "-T --format", concat(FORMATS, ", "))
    :argname("FORMAT"):choices(FORMATS)
  common.add_output(command, "file to write; - is stdout", "-")
  command:option("--active", "draw state FQN as active, once for each region")
    :argname("FQN"):count("*")
  common.add_number(command, "--depth", "draw N levels of states")
  command:option("--coverage", "mark the counts that rfsm_checks.coverage wrote")
    :argname("JSON")
  command:option("--trace", "number the steps of a recording (JSON lines)")
    :argname("JSON")
  command:option("--direction", "TB (down) or LR (to the right)"):argname("DIR")
    :choices { "TB", "LR" }
  command:option("--for", "a4 (default), slide or WIDTHxHEIGHT in points")
    :argname("SHEET"):target("sheet")
  command:flag("--pages", "pictures with links, in the folder or PDF of -o")
  command:option("--like", "keep the order of states in a former picture")
    :argname("SVG")
end

local function read_values(file)
  local ok, values = pcall(require("rfsm.json").decode_all, common.read(file))
  if not ok then common.fail(file .. ": " .. values) end
  return values
end

local function read_coverage(file)
  local coverage = read_values(file)[1]
  local is_coverage = type(coverage) == "table" and type(coverage.states) == "table"
    and type(coverage.transitions) == "table"
  if is_coverage then return coverage end
  common.fail(file .. ": an object with \"states\" and \"transitions\" expected")
end

local function is_step(step)
  return type(step) == "string"
    or type(step) == "table" and (step.record or step.leaf or step.taken)
end

-- Returns the steps of a run. The file has a JSON list of steps, or one step per line.
local function read_trace(file)
  local values = read_values(file)
  local first = values[1]
  if values[2] == nil and type(first) == "table" and first[1] then values = first end
  if order.any(values, is_step) then return values end
  common.fail(file .. ": steps of a recording expected")
end

-- Returns the text of a picture.
local function read_picture(file)
  local text = common.read(file)
  if text:find('<g id="', 1, true) then return text end
  common.fail(file .. ": a picture of rfsm viz expected")
end

local function format_of(options, parser)
  local file = options.output
  local ending = (file:match("%.(%w+)$") or ""):lower()
  local format = options.format or options.pages and ending ~= "pdf" and "svg"
    or file == "-" and "dot" or BY_ENDING[ending] or ending
  if IS_TEXT[format] == nil then
    parser:error("the ending of '" .. file .. "' is no format, -T expected ("
      .. concat(FORMATS, ", ") .. ")")
  elseif not IS_TEXT[format] and options.files[2] then
    parser:error("one FILE expected, " .. format .. " holds one chart, got "
      .. #options.files)
  end
  return format
end

-- Ends the program if Graphviz fails; the message names the chart.
local function try(options, result, problem)
  return result or common.fail((problem:gsub("^dot: ", function(words)
    return options.files[1] .. ": " .. words
  end)))
end

-- Writes pictures into a folder, or as pages of one PDF.
local function write_pages(options, machine, looks, format)
  local tab = require("rfsm.marsh").model2tab(machine, true)
  local ok, list = pcall(pages.of, tab, looks, format)
  list = try(options, ok and list, list)
  local pictures, output = {}, options.output
  for i, page in ipairs(list) do
    pictures[i] = try(options, dot.render(page.graph, format))
  end
  if format == "pdf" and output:find("%.pdf$") then
    return common.write(output, common.try(pages.join(pictures)))
  end
  os.execute("mkdir -p " .. quoted(output))
  for i, page in ipairs(list) do
    common.write(output .. "/" .. page.file, pictures[i])
  end
end

local function looks_of(options)
  return {
    depth = options.depth, direction = options.direction, sheet = options.sheet,
    active = options.active[1] and options.active,
    coverage = options.coverage and read_coverage(options.coverage),
    trace = options.trace and read_trace(options.trace),
    like = options.like and read_picture(options.like),
  }
end

-- Ends the program if the file of the picture stands where a chart is expected.
local function refuse_picture(options, parser)
  local last = options.files[#options.files]
  local ending = last:match("%.(%w+)$") or ""
  local is_picture = IS_TEXT[BY_ENDING[ending] or ending] ~= nil
  if options.output == "-" and is_picture then
    parser:error(("'%s' is no chart, a picture is written by -o %s"):format(last, last))
  end
end

-- Has a function draw the chart in each file. Returns the texts, the last machine, and
-- the options of its picture.
local function encode(options, draw)
  local looks, machine = looks_of(options), nil
  local texts = common.encode_all(options, function(fsm, title, foot)
    looks.title, looks.foot, machine = title, foot or nil, fsm
    return draw(fsm, looks)
  end)
  return texts, machine, looks
end

function viz.run(options, parser)
  refuse_picture(options, parser)
  local format = format_of(options, parser)
  local is_text = IS_TEXT[format]
  if options.pages and (is_text or options.output == "-") then
    parser:error("--pages needs -o FOLDER or FILE.pdf, and no text for -T")
  end
  local exporter = is_text and require("rfsm." .. format) or dot
  local texts, machine, looks = encode(options,
    (is_text or options.pages) and exporter.encode or dot.layout)
  if is_text then return common.write(options.output, concat(texts)) end
  if options.pages then return write_pages(options, machine, looks, format) end
  -- if Graphviz cannot lay out a chart, it may still draw the text of `encode`
  local graph = texts[1] or dot.encode(machine, looks)
  common.write(options.output, try(options, dot.render(graph, format)))
end

return viz
