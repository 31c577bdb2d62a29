--- Levels as graphs for Graphviz, and the positions in the answers of Graphviz.
--
-- A *level* is the inside of one composite. A *gate* is a place where an arrow crosses
-- the frame of a composite (see `rfsm.pictures.links`). One run of Graphviz lays out
-- many levels, because its start takes longest.
--
-- The file reads in this order: boxes with ports, graphs, answers, public functions.
--
-- @module rfsm.pictures.graphs
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"
local curves = require "rfsm.pictures.lines"
local looks = require "rfsm.pictures.looks"
local rfsm = require "rfsm"

local ceil, floor, max, min = math.ceil, math.floor, math.max, math.min
local ipairs, tonumber = ipairs, tonumber
local number_of = rfsm.number_of
local concat, sort, add = table.concat, table.sort, diagram.add

local graphs = {}

--- A function that has Graphviz lay out graphs. It returns the graphs with positions as
-- an answer, or nil and a problem. In the answers that this file reads, each statement
-- is one line: `rfsm.pictures.layout` has joined broken lines.
---@alias rfsm.pictures.Run fun(graphs: string): string?, string?

-- Boxes: composites, with a port for each gate --------------------------------

local TABLE = '<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0" CELLPADDING="0">'
local CELL = '<TD FIXEDSIZE="TRUE" WIDTH="%d" HEIGHT="%d"%s>%s</TD>'

-- Returns an HTML table. Its cells are a column if the direction is LR, else a row.
local function table_of(direction, cells)
  return TABLE .. "<TR>" .. concat(cells, direction == "LR" and "</TR><TR>" or "")
    .. "</TR></TABLE>"
end

-- Returns a cell. `across` is its size across the arrows of a level; `along` is its
-- size along the arrows.
local function cell_of(direction, across, along, port, content)
  if direction == "LR" then across, along = along, across end
  return CELL:format(across, along, port and (' PORT="%s"'):format(port) or "",
    content or "")
end

-- Returns a side of a box as cells: a cell with a port for each gate, and empty cells
-- between them.
local function side_text(level, list, length)
  local direction, cells, from = level.direction, {}, 0
  local function add_cell(size, port)
    if size > 0 then cells[#cells + 1] = cell_of(direction, size, 1, port) end
  end
  for i, gate in ipairs(list) do
    local last = length - 2 * (#list - i + 1)
    local position = max(from, min(last, floor(gate.offset - 0.5)))
    add_cell(position - from)
    add_cell(2, gate.id)
    from = position + 2
  end
  add_cell(length - from)
  return cell_of(direction, length, 1, nil, table_of(direction, cells))
end

-- Returns the gates at a side, in the order of their positions.
local function gates_at(level, is_upper)
  local list = {}
  for _, gate in ipairs(level.gates) do
    if gate.is_upper == is_upper then list[#list + 1] = gate end
  end
  sort(list, function(a, b)
    if a.offset ~= b.offset then return a.offset < b.offset end
    return a.id < b.id
  end)
  return list
end

local function box_text(level)
  local across, along = level.width, level.height
  if level.direction == "LR" then across, along = along, across end
  local rows = { side_text(level, gates_at(level, true), across),
    cell_of(level.direction, across, along - 2),
    side_text(level, gates_at(level, false), across) }
  return 'shape=plain, style="", label=<'
    .. table_of(level.direction == "LR" and "TB" or "LR", rows) .. ">"
end

-- Graphs ----------------------------------------------------------------------

local POINT = '%s [shape=box, style=invis, label="", width=0.01, height=0.01]'

-- Is the header of a composite (its name and rows) a node in the first rank, beside the
-- upper gates? If not, the header is the label of the graph.
local function has_header_rank(level)
  local is_upper = false
  for _, gate in ipairs(level.gates) do is_upper = is_upper or gate.is_upper end
  return is_upper and level.direction == "TB" and level.composite.fqn ~= nil
end

-- Adds the header of a composite, and its gates: the upper gates in the first rank, the
-- lower gates in the last.
local function add_border(lines, level)
  local first, last, composite = {}, {}, level.composite
  local header = composite.fqn and looks.state_label(composite)
  if has_header_rank(level) then
    add(lines, 1, 'h [shape=plain, style="", label=' .. header .. "]")
    first[1] = "h"
  elseif header then
    add(lines, 1, "graph [labelloc=t, label=" .. header .. "]")
  end
  for _, gate in ipairs(level.gates) do
    add(lines, 1, POINT:format(gate.id))
    local list = gate.is_upper and first or last
    list[#list + 1] = gate.id
  end
  local function add_rank(rank, ids)
    if not ids[1] then return end
    add(lines, 1, ("{ rank=%s; %s }"):format(rank, concat(ids, "; ")))
  end
  add_rank("source", first)
  add_rank("sink", last)
end

local HIDDEN = '  n%d -> n%d [style=invis, label=<<TABLE BORDER="0" CELLPADDING="0">'
  .. '<TR><TD FIXEDSIZE="TRUE" WIDTH="%d" HEIGHT="%d"></TD></TR></TABLE>>]'

-- Returns the name of node i in a graph, or the name of its run.
local function id_of(level, i)
  local run = level.run_of and level.run_of[i]
  return run and run.id or "n" .. i
end

local function add_nodes(lines, level)
  for i, node in ipairs(level.composite.nodes) do
    local room, run = node.loops, level.run_of and level.run_of[i]
    if not run or run.first == i then
      add(lines, 1, ("%s [%s]"):format(id_of(level, i), run and box_text(run)
        or node.level and box_text(node.level) or looks.leaf_text(node)))
    end
    if room then
      lines[#lines + 1] = HIDDEN:format(i, i, ceil(room.width), ceil(room.height))
    end
  end
end

-- Keeps the header above all nodes: an invisible edge leads from the header to each
-- node that no link keeps below another node.
local function add_order(lines, level)
  local is_lower = {}
  for _, link in ipairs(level.links) do
    is_lower[not link.is_loop and link.lower.node or false] = true
  end
  for i, node in ipairs(level.composite.nodes) do
    if not is_lower[node] then
      add(lines, 1, ("h -> %s [style=invis, weight=0]"):format(id_of(level, i)))
    end
  end
end

-- Adds the labels of arches. An arch is a label above a composite, with two lines from
-- the label to gates of the frame: the left line leads to the left gate.
local function add_arches(lines, level)
  for _, link in ipairs(level.links) do
    local legs = link.arch and link.arch.legs
    if legs and legs[1] == link then
      local is_right = link.lower.gate.offset > legs[2].lower.gate.offset
      link.foot, legs[2].foot = is_right and "r" or "l", is_right and "l" or "r"
      add(lines, 1, ("a%d [%s]"):format(link.id,
        looks.arch_text(link.arrow, level.direction)))
    end
  end
end

-- Keeps regions side by side, in the order in which they are stepped.
local function add_regions(lines, composite)
  local ids = {}
  for i, node in ipairs(composite.nodes) do
    ids[#ids + 1] = node.is_region and "n" .. i or nil
  end
  if not ids[2] then return end
  add(lines, 1, ("{ rank=same; %s [style=invis] }"):format(concat(ids, " -> ")))
end

-- Puts the nodes of each row into one rank, below the row before it, and all rows
-- between the upper gates and the lower ones.
local function add_rows(lines, level)
  local function add_below(upper, lower)
    add(lines, 1, ("%s -> %s [style=invis, weight=0]"):format(upper, lower))
  end
  local before
  for _, row in ipairs(level.rows or {}) do
    local ids = {}
    for i, run in ipairs(row) do ids[i] = id_of(level, run.first) end
    add(lines, 1, ("{ rank=same; %s }"):format(concat(ids, "; ")))
    if before then add_below(before, ids[1]) end
    before = ids[1]
  end
  for _, gate in ipairs(before and level.gates or {}) do
    if gate.is_upper then
      add_below(gate.id, id_of(level, level.rows[1][1].first))
    else
      add_below(before, gate.id)
    end
  end
end

local COMPASS = { TB = { "s", "n" }, LR = { "e", "w" } }

-- Returns the text of an end of an edge. Its compass point makes the line meet a frame
-- at a right angle.
local function end_text(level, link, is_tail)
  local finish = is_tail and link.upper or link.lower
  local compass = COMPASS[level.direction][is_tail and 1 or 2]
  if not finish.node then return finish.gate.id .. ":" .. compass end
  local id, run = id_of(level, finish.node.index), level.run_of
    and level.run_of[finish.node.index]
  if run then return ("%s:%s:%s"):format(id, run.gate_of[link][is_tail].id, compass) end
  if finish.gate then return ("%s:%s:%s"):format(id, finish.gate.id, compass) end
  return finish.node.kind == "connector" and id .. ":p" or id
end

local function dir_of(link)
  if not link.has_head then return "none" end
  return link.is_turned and "back" or "forward"
end

-- Returns how many points of room are around a label.
local function room_of(level)
  if not level.is_tight then return 3 end
  return level.direction == "TB" and 2 or 1
end

local function add_link(lines, level, link)
  local arch = link.arch
  local tail = arch and ("a%d:%s:%s"):format(arch.id, link.foot,
    COMPASS[level.direction][1]) or end_text(level, link, true)
  local has_label = link.is_home and not arch and link.arrow.parts[1]
  add(lines, 1, ("%s -> %s [id=%d, dir=%s%s%s]"):format(tail,
    end_text(level, link, false), link.id, dir_of(link),
    arch and ", weight=8" or "",
    has_label and ", label=" .. looks.roomy_label(link.arrow, room_of(level)) or ""))
end

local LARGE = 100 -- links; a level with more is laid out with less effort

local function graph_of(level)
  local composite = level.composite
  local lines = { "digraph {", looks.head(level.direction),
    "  graph [newrank=true, nodesep=0.2, mclimit=2]" }
  if #level.links > LARGE then
    add(lines, 1, "graph [nslimit=2, nslimit1=2, mclimit=0.5]")
  end
  if level.is_tight then add(lines, 1, "graph [ranksep=0.15]") end
  if level.is_spread then add(lines, 1, "graph [ranksep=1, nodesep=0.1]") end
  add_border(lines, level)
  add_nodes(lines, level)
  if has_header_rank(level) then add_order(lines, level) end
  add_arches(lines, level)
  add_regions(lines, composite)
  add_rows(lines, level)
  for _, link in ipairs(level.links) do
    if not (link.is_loop or link.is_straight) then add_link(lines, level, link) end
    local twin = link.upper and link.upper.gate and link.upper.gate.twin
    if twin and not link.upper.node then -- the two gates shall be beside each other
      add(lines, 1, ("%s -> %s [style=invis]"):format(twin.id,
        end_text(level, link, false)))
    end
  end
  lines[#lines + 1] = "}\n"
  return concat(lines, "\n")
end

-- Answers ---------------------------------------------------------------------

-- Returns the position of the last character of the value that begins at `from`.
local function value_end(text, from)
  local first = text:sub(from, from)
  if first == "<" then return select(2, text:find("%b<>", from)) end
  if first ~= '"' then return select(2, text:find("^[^,%]%s]*", from)) end
  local position = text:find('["\\]', from + 1)
  while text:sub(position, position) == "\\" do
    position = text:find('["\\]', position + 2)
  end
  return position
end

-- Reads the attributes that begin at a position. Returns their table, and the position
-- behind them.
local function read_attributes(text, position)
  local attributes = {}
  while true do
    local _, stop, name = text:find("^[%s,]*([%w_]+)=", position)
    if not name then return attributes, position end
    local last = value_end(text, stop + 1)
    attributes[name] = text:sub(stop + 1, last):gsub('^"(.*)"$', "%1")
    position = last + 1
  end
end

--- Return the numbers in a text.
function graphs.numbers_in(text)
  local list = {}
  for number in text:gmatch("[%d.e+-]+") do list[#list + 1] = number_of(number) end
  return list
end

local numbers_in = graphs.numbers_in

--- Return the middle of a node and its size, in points.
function graphs.box_of(attributes)
  local point = numbers_in(attributes.pos)
  return { x = point[1], y = point[2], width = number_of(attributes.width) * 72,
    height = number_of(attributes.height) * 72 }
end

--- Return the points of a line, and the tip of its arrowhead. `is_turned` is true if
-- the arrowhead is at the first point.
function graphs.line_of(text)
  local line = { points = {}, is_turned = text:find("^s") ~= nil }
  local rest = text:gsub("[es],([^ ]+) ?", function(point)
    line.tip = numbers_in(point)
    return ""
  end)
  for point in rest:gmatch("[^ ]+") do
    line.points[#line.points + 1] = numbers_in(point)
  end
  return line
end

local function read_link(link, attributes)
  local line = graphs.line_of(attributes.pos)
  link.points, link.tip = line.points, line.tip
  link.label_at = attributes.lp and numbers_in(attributes.lp)
  if link.label_at then
    curves.attract(link.label_at, diagram.label_of(link.arrow), line.points,
      link.level.direction == "TB" and 1 or 2)
  end
end

local function read_node(level, id, attributes)
  local box, kind, number = graphs.box_of(attributes), id:sub(1, 1), tonumber(id:sub(2))
  if kind == "h" then
    level.header = box
  elseif kind == "n" then
    level.boxes[number] = box
  elseif kind == "r" then
    level.run_boxes[number] = box
  elseif kind == "a" then
    level.arches[number] = box
  else
    level.gates[number].at = { box.x, box.y }
  end
end

local function read_size(level, attributes)
  local corner, at = numbers_in(attributes.bb), attributes.lp
  level.inner_width, level.inner_height = corner[3], corner[4]
  if at then
    at = numbers_in(at)
    level.header = { x = at[1], y = at[2] }
  end
end

local function read_element(level, id, attributes, cluster)
  if id == "graph" then
    if attributes.bb and not cluster then read_size(level, attributes) end
  elseif id:find("->", 1, true) then
    local link = level.links[tonumber(attributes.id)]
    if link then read_link(link, attributes) end
  elseif attributes.pos then
    read_node(level, id, attributes)
  end
end

--- Call f(id, attributes, cluster) for each element in a graph of an answer; `cluster`
-- is the cluster that began last. Return the position behind the graph.
--
-- Graphviz 16 omits the width or height of a node that equals the one in the statement
-- "node [...]".
function graphs.read(text, position, f)
  local cluster, usual = nil, {}
  while true do
    local _, stop, id, mark = text:find("\n%s*([^\n{}]-)%s*([%[{}])", position)
    position, id = stop + 1, id:gsub('"', "")
    if mark == "[" then
      local attributes
      attributes, position = read_attributes(text, position)
      if id == "node" then usual = attributes end
      attributes.width = attributes.width or usual.width
      attributes.height = attributes.height or usual.height
      f(id, attributes, cluster)
    elseif mark == "{" then
      cluster = id:match("^subgraph (.*)")
    elseif text:find("^\n}", stop - 1) then
      return position
    end
  end
end

local function read_level(level, text, position)
  level.boxes, level.run_boxes, level.arches, level.header = {}, {}, {}, nil
  return graphs.read(text, position, function(...) read_element(level, ...) end)
end

-- Public functions ------------------------------------------------------------

local function place_gate(level, gate)
  local x, y = gate.at[1] + level.x, gate.at[2] + level.y
  if level.direction == "TB" then
    gate.x, gate.y, gate.offset = x, gate.is_upper and level.height or 0, x
  else
    gate.x, gate.y = gate.is_upper and 0 or level.width, y
    gate.offset = level.height - y
  end
end

--- Give a level its size, and its gates their positions.
function graphs.measure(level)
  local composite = level.composite
  local margin = composite.fqn and looks.margin_of(composite) or 0
  if level.is_tight then margin = min(margin, 6) end
  local least = composite.loops and composite.loops.length or 0
  level.width, level.height = ceil(level.inner_width) + 2 * margin,
    max(ceil(level.inner_height) + 2 * margin, ceil(least))
  level.x, level.y = margin, level.height - ceil(level.inner_height) - margin
  local is_centred = level.header ~= nil
  for _, gate in ipairs(level.gates) do
    is_centred = is_centred and not gate.is_upper
    place_gate(level, gate)
  end
  if is_centred then level.header.x = level.inner_width / 2 end
end

--- Have Graphviz lay out jobs, each with a level; return a problem if there is one.
-- prepare(job) makes the level what the job wants, before its graph is made and again
-- before the answer is read. Then done(job) is called. Equal graphs are laid out once.
function graphs.lay_out(jobs, run, prepare, done)
  local texts, unique, starts = {}, {}, {}
  for i, job in ipairs(jobs) do
    prepare(job)
    texts[i] = graph_of(job.level)
    if not starts[texts[i]] then
      unique[#unique + 1], starts[texts[i]] = texts[i], true
    end
  end
  local answer, problem = run(concat(unique))
  if not answer then return problem end
  local position = 1
  for i, job in ipairs(jobs) do
    local start = starts[texts[i]]
    if start == true then start, starts[texts[i]] = position, position end
    prepare(job)
    local stop = read_level(job.level, answer, start)
    position = max(position, stop)
    graphs.measure(job.level)
    done(job)
  end
end

--- Have Graphviz measure nodes, of which the attributes are given, and lay out another
-- graph in the same run if that does not fail. Return the boxes of the nodes and the
-- answer for this graph, if there is one; or nil and a problem.
--
-- Graphviz visits clusters in the order of the addresses of their names. These ascend
-- in each run only if a new process reads the graph first, so it is before the nodes.
function graphs.sizes_of(nodes, graph, run)
  local lines = { "digraph {", looks.head("TB") }
  for i, node in ipairs(nodes) do add(lines, 1, ("n%d [%s]"):format(i, node)) end
  lines[#lines + 1] = "}\n"
  local sizes, level = concat(lines, "\n"), { gates = {}, links = {} }
  local answer, problem = run(graph .. sizes)
  local stop = answer and graph ~= "" and answer:find("\n}", 1, true)
  if not answer and graph ~= "" then answer, problem = run(sizes) end
  if not answer then return nil, problem end
  read_level(level, answer, stop and stop + 2 or 1)
  return level.boxes, stop and answer or nil
end

return graphs
