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
local looks = require "rfsm.pictures.looks"
local order = require "rfsm.shared.order"
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

local TABLE = '<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0" CELLPADDING="0"'
local FIXED = ' FIXEDSIZE="TRUE" WIDTH="%d" HEIGHT="%d"'
local CELL = "<TD" .. FIXED .. "%s>%s</TD>"

-- Returns an HTML table. Its cells are a column if the direction is LR, else a row.
local function table_of(direction, cells, attributes)
  return TABLE .. (attributes or "") .. "><TR>"
    .. concat(cells, direction == "LR" and "</TR><TR>" or "") .. "</TR></TABLE>"
end

-- Returns a cell. `across` is its size across the arrows of a level; `along` is its
-- size along the arrows.
local function cell_of(direction, across, along, port, content)
  if direction == "LR" then across, along = along, across end
  return CELL:format(across, along, port and (' PORT="%s"'):format(port) or "",
    content or "")
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

-- Returns a side of a box as cells: a cell with a port for each gate, and empty cells
-- between them.
local function side_text(level, prefix, is_upper, length)
  local direction, cells, from = level.direction, {}, 0
  local list = gates_at(level, is_upper)
  local function add_cell(size, port)
    if size > 0 then cells[#cells + 1] = cell_of(direction, size, 1, port) end
  end
  for i, gate in ipairs(list) do
    local last = length - 2 * (#list - i + 1)
    local position = max(from, min(last, floor(gate.offset - 0.5)))
    add_cell(position - from)
    add_cell(2, prefix .. gate.id)
    from = position + 2
  end
  add_cell(length - from)
  return cell_of(direction, length, 1, nil, table_of(direction, cells))
end

-- Returns the box of a composite. The names of its ports begin with a prefix. Its size
-- is fixed, so that it is in the middle of a cell of a run.
local function box_of_level(level, prefix)
  local across, along = level.width, level.height
  if level.direction == "LR" then across, along = along, across end
  return table_of(level.direction == "LR" and "TB" or "LR", {
    side_text(level, prefix, true, across),
    cell_of(level.direction, across, along - 2),
    side_text(level, prefix, false, across) }, FIXED:format(level.width, level.height))
end

local APART = 14 -- points between ports of a node, at most

-- Appends ports of node i in a run to a list, at one of its sides: one for each link
-- that leads to another row, and not to a gate.
local function add_ports(ports, level, i, length, is_upper)
  local list = {}
  for _, link in ipairs(level.links) do
    local finish = is_upper and link.lower or link.upper
    list[#list + 1] = finish.node == level.composite.nodes[i]
      and not (finish.gate or link.is_straight) and link or nil
  end
  local step = min(APART, (length - 12) / max(1, #list - 1))
  for k, link in ipairs(list) do
    ports[#ports + 1] = { id = (is_upper and "l" or "u") .. link.id,
      is_upper = is_upper, offset = length / 2 + (k - (#list + 1) / 2) * step }
  end
end

-- Returns the box of a run: the boxes of its nodes, with room between them.
local function box_of_run(level, run)
  local cells, direction = {}, level.direction
  for k, i in ipairs(run.nodes) do
    local inner, size = level.composite.nodes[i].level, level.sizes[i]
    local width, height, gates = ceil(size.width), ceil(size.height), {}
    for j, gate in ipairs(inner and inner.gates or gates) do gates[j] = gate end
    local length = direction == "TB" and width or height
    add_ports(gates, level, i, length, true)
    add_ports(gates, level, i, length, false)
    cells[2 * k - 1] = "<TD>" .. box_of_level({ direction = direction, width = width,
      height = height, gates = gates }, "n" .. i) .. "</TD>"
    local room = run.nodes[k + 1] and level.rooms[min(i, run.nodes[k + 1])]
    cells[2 * k] = room and cell_of(direction, room.length, 1)
  end
  return table_of(direction, cells)
end

local function box_text(box) return 'shape=plain, style="", label=<' .. box .. ">" end

-- Graphs ----------------------------------------------------------------------

local POINT = '%s [shape=box, style=invis, label="", width=0.01, height=0.01]'

local function has_upper_gate(level)
  return order.any(level.gates, function(gate) return gate.is_upper end)
end

-- Is the header of a composite (its name and rows) a node in the first rank, beside the
-- upper gates? If not, the header is the label of the graph.
local function has_header_rank(level)
  return level.direction == "TB" and level.composite.fqn and has_upper_gate(level)
end

local function add_rank(lines, rank, ids)
  if ids[1] then add(lines, 1, ("{ rank=%s; %s }"):format(rank, concat(ids, "; "))) end
end

-- Keeps a node below another one.
local function add_below(lines, upper, lower)
  add(lines, 1, ("%s -> %s [style=invis, weight=0]"):format(upper, lower))
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
  add_rank(lines, "source", first)
  add_rank(lines, "sink", last)
end

-- Returns the name of node i in a graph, or the name of its run.
local function id_of(level, i)
  local run = level.run_of and level.run_of[i]
  return run and run.id or "n" .. i
end

local function add_nodes(lines, level)
  for i, node in ipairs(level.composite.nodes) do
    local run = level.run_of and level.run_of[i]
    if not run or run.first == i then
      add(lines, 1, ("%s [%s]"):format(id_of(level, i), run
        and box_text(box_of_run(level, run)) or node.level
        and box_text(box_of_level(node.level, "")) or looks.leaf_text(node)))
    end
  end
end

-- Keeps the header above all nodes: an invisible edge leads from the header to each
-- node that no link keeps below another node.
local function add_order(lines, level)
  local is_lower = {}
  for _, link in ipairs(level.links) do
    is_lower[link.upper.node ~= link.lower.node and link.lower.node or false] = true
  end
  for i, node in ipairs(level.composite.nodes) do
    if not is_lower[node] then add_below(lines, "h", id_of(level, i)) end
  end
end

-- Keeps regions side by side, in the order in which they are stepped.
local function add_regions(lines, composite)
  local ids = {}
  for i, node in ipairs(composite.nodes) do
    ids[#ids + 1] = node.is_region and "n" .. i or nil
  end
  add_rank(lines, "same", { ids[2] and concat(ids, " -> ") .. " [style=invis]" })
end

-- Puts the nodes of each row into one rank, below the row before it, and all rows
-- between the upper gates and the lower ones.
local function add_rows(lines, level)
  local before
  for _, row in ipairs(level.rows or {}) do
    local ids = {}
    for i, run in ipairs(row) do ids[i] = id_of(level, run.first) end
    add_rank(lines, "same", ids)
    if before then add_below(lines, before, ids[1]) end
    before = ids[1]
  end
  for _, gate in ipairs(before and level.gates or {}) do
    if gate.is_upper then
      add_below(lines, gate.id, id_of(level, level.rows[1][1].first))
    else
      add_below(lines, before, gate.id)
    end
  end
end

local SIDES, COMPASS = { "u", "l" }, { TB = { "s", "n" }, LR = { "e", "w" } }

-- Returns the text of an end of an edge. Its compass point makes the line meet a frame
-- at a right angle.
local function end_text(level, link, is_tail)
  local finish, side = is_tail and link.upper or link.lower, is_tail and 1 or 2
  local compass = ":" .. COMPASS[level.direction][side]
  local node, port = finish.node, finish.gate and finish.gate.id
  if not node then return port .. compass end
  local id, name = id_of(level, node.index), "n" .. node.index
  if id == name then
    if not port then return node.kind == "connector" and id .. ":p" or id end
    return id .. ":" .. port .. compass
  end
  return id .. ":" .. name .. (port or SIDES[side] .. link.id) .. compass
end

-- Returns how many points of room are around a label.
local function room_of(level)
  if not level.is_tight then return 3 end
  return level.direction == "TB" and 2 or 1
end

local function add_link(lines, level, link)
  local has_label = link.is_home and link.arrow.parts[1]
  local dir = link.has_head and (link.is_turned and "back" or "forward") or "none"
  add(lines, 1, ("%s -> %s [id=%d, dir=%s%s]"):format(end_text(level, link, true),
    end_text(level, link, false), link.id, dir,
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
  add_regions(lines, composite)
  add_rows(lines, level)
  for _, link in ipairs(level.links) do
    if not link.is_straight then add_link(lines, level, link) end
  end
  lines[#lines + 1] = "}\n"
  return concat(lines, "\n")
end

-- Answers ---------------------------------------------------------------------

-- Returns the numbers in a text.
local function numbers_in(text)
  local list = {}
  for number in text:gmatch("[%d.e+-]+") do
    list[#list + 1] = tonumber(number) or number_of(number) -- in most locales the same
  end
  return list
end

-- Returns the middle of a node and its size, in points.
local function box_of(attributes)
  local point = numbers_in(attributes.pos)
  return { x = point[1], y = point[2], width = numbers_in(attributes.width)[1] * 72,
    height = numbers_in(attributes.height)[1] * 72 }
end

--- Return the points of a line, and the tip of its arrowhead.
function graphs.line_of(text)
  local line = { points = {} }
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
end

local function read_node(level, id, attributes)
  local box, kind, number = box_of(attributes), id:sub(1, 1), tonumber(id:sub(2))
  if kind == "h" then
    level.header = box
  elseif kind == "n" then
    level.boxes[number] = box
  elseif kind == "r" then
    level.run_boxes[number] = box
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

local function read_statement(level, id, attributes)
  if attributes.bb then
    read_size(level, attributes)
  elseif id:find("->", 1, true) then
    local link = level.links[numbers_in(attributes.id or "")[1]]
    if link then read_link(link, attributes) end
  elseif attributes.pos then
    read_node(level, id, attributes)
  end
end

local STATEMENT = "([^%s%[][^\n%[]-) ?%[(.-)%];\r?\n" -- an identifier, attributes

-- Reads the graph that begins at a position of an answer, in which each attribute is a
-- line. Returns the position behind the graph.
--
-- Graphviz 16 omits the width or height of a node that equals the one in the statement
-- "node [...]".
local function read_level(level, text, position)
  local usual, _, stop = {}, text:find("\n}\r?\n", position)
  level.boxes, level.run_boxes, level.header = {}, {}, nil
  for id, body in text:sub(position, stop):gmatch(STATEMENT) do
    local attributes = { width = usual.width, height = usual.height }
    for name, value in ("\n" .. body):gmatch('\n%s*(%l+)="?([^"\n]*)') do
      attributes[name] = value
    end
    if id == "node" then usual = attributes end
    read_statement(level, id, attributes)
  end
  return stop + 1
end

-- Public functions ------------------------------------------------------------

--- Give a level its size, and its gates their positions.
function graphs.measure(level)
  local composite = level.composite
  local margin = composite.fqn and looks.margin_of(composite) or 0
  if level.is_tight then margin = min(margin, 6) end
  level.width = ceil(level.inner_width) + 2 * margin
  level.height = ceil(level.inner_height) + 2 * margin
  level.x, level.y = margin, level.height - ceil(level.inner_height) - margin
  for _, gate in ipairs(level.gates) do
    gate.offset = level.direction == "TB" and gate.at[1] + level.x
      or level.height - gate.at[2] - level.y
  end
  if level.header and not has_upper_gate(level) then
    level.header.x = level.inner_width / 2
  end
end

--- Have Graphviz lay out levels; return a problem if there is one.
-- prepare(level) is called before the graph of a level is made, done(level) when the
-- answer is read. Equal graphs are laid out once.
function graphs.lay_out(list, run, prepare, done)
  local texts, unique, starts = {}, {}, {}
  for i, level in ipairs(list) do
    prepare(level)
    texts[i] = graph_of(level)
    if not starts[texts[i]] then
      unique[#unique + 1], starts[texts[i]] = texts[i], true
    end
  end
  local answer, problem = run(concat(unique))
  if not answer then return problem end
  local position = 1
  for i, level in ipairs(list) do
    local start = starts[texts[i]]
    if start == true then start, starts[texts[i]] = position, position end
    position = max(position, read_level(level, answer, start))
    graphs.measure(level)
    done(level)
  end
end

--- Return a graph with the leaves and the labels of a chart, whose size Graphviz finds.
-- Also return a function that reads the sizes from an answer, from a position on. It
-- returns the position behind them.
function graphs.sizes_of(chart)
  local elements, lines = {}, { "digraph {", looks.head("TB") }
  local function add_element(element, attributes)
    elements[#elements + 1] = element
    add(lines, 1, ("n%d [%s]"):format(#elements, attributes))
  end
  for _, node in ipairs(chart.nodes) do
    if not node.level then add_element(node, looks.leaf_text(node)) end
  end
  for _, arrow in ipairs(chart.all) do add_element(arrow, looks.label_text(arrow)) end
  return concat(lines, "\n") .. "\n}\n", function(answer, position)
    local level = { gates = {}, links = {} }
    position = read_level(level, answer, position)
    for i, element in ipairs(elements) do element.size = level.boxes[i] end
    return position
  end
end

return graphs
