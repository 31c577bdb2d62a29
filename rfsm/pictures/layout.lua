--- A chart with the position of everything in it: a graph that Graphviz only draws.
--
-- @module rfsm.pictures.layout
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"
local levels = require "rfsm.pictures.levels"
local lines = require "rfsm.pictures.lines"
local looks = require "rfsm.pictures.looks"

local ipairs = ipairs
local concat, add = table.concat, diagram.add

local layout = {}

-- Positions: from those in a level to those in the picture --------------------

-- Puts a composite, and all that is in it, where its lower left corner shall be.
local function move(composite, left, bottom)
  local level = composite.level
  level.left, level.bottom = left, bottom
  level.x, level.y = left + level.x, bottom + level.y
  for i, node in ipairs(composite.nodes) do
    local box = level.boxes[i]
    node.x, node.y = level.x + box.x, level.y + box.y
    if node.level then
      move(node, node.x - node.level.width / 2, node.y - node.level.height / 2)
    end
  end
end

local function point_text(x, y)
  return looks.number_text(x) .. "," .. looks.number_text(y)
end

-- Lines: the links of an arrow, joined ----------------------------------------

local function arch_line(box, from, to, direction)
  if direction == "TB" then
    local top = box.y + box.height / 2
    return lines.rounded { from, { from[1], top }, { to[1], top }, to }
  end
  local left = box.x - box.width / 2
  return lines.rounded { from, { left, from[2] }, { left, to[2] }, to }
end

-- Joins the links of an arrow. Returns the line, the tip and the position of the label.
local function line_of(arrow, direction)
  local line, tip, label, axis = {}, nil, nil, direction == "TB" and 1 or 2
  for _, link in ipairs(arrow.links) do
    local level, arch = link.level, link.arch
    local function place(point) return { level.x + point[1], level.y + point[2] } end
    local points = lines.moved(link.points, level.x, level.y, link.is_turned)
    if arch and link == arch.legs[2] then
      local box = level.arches[arch.id]
      label = place { box.x, box.y }
      lines.join(line, arch_line({ x = label[1], y = label[2], width = box.width,
        height = box.height }, line[#line], points[1], level.direction), axis)
    end
    lines.join(line, points, axis)
    tip = link.head and place(link.tip) or tip
    label = link.label_at and place(link.label_at) or label
  end
  return line, tip, label
end

-- The graph -------------------------------------------------------------------

local function position_of(node)
  local level = node.level
  if not level then return (', pos="%s"'):format(point_text(node.x, node.y)) end
  return (', bb="%s,%s", lp="%s"'):format(point_text(level.left, level.bottom),
    point_text(level.left + level.width, level.bottom + level.height),
    point_text(level.x + level.header.x, level.y + level.header.y))
end

-- Returns the identifier for an end of an arrow: at a composite, that of a leaf in it.
local function anchor_of(node)
  while node.level do node = node.nodes[1] end
  return node.id
end

local function end_text(name, node)
  return node.level and (", %s=cluster_%s"):format(name, node.id) or ""
end

local function add_arrow(texts, arrow, chart)
  local line, tip, label = line_of(arrow, chart.direction)
  local points = {}
  for i, point in ipairs(lines.inside(line, chart.root.level or chart.top.level)) do
    points[i] = point_text(point[1], point[2])
  end
  add(texts, 1, ('%s -> %s [%s, %s%s%s, pos="e,%s %s"%s]'):format(
    anchor_of(arrow.src), anchor_of(arrow.tgt), looks.id_of(arrow.key),
    looks.arrow_text(arrow), end_text("ltail", arrow.src), end_text("lhead", arrow.tgt),
    point_text(tip[1], tip[2]), concat(points, " "),
    arrow.parts[1] and (', lp="%s", label=%s'):format(point_text(label[1], label[2]),
      looks.arrow_label(arrow)) or ""))
end

--- Return the graph of a chart, with positions; nil and the problem if there is one.
function layout.draw(chart, run)
  local root = chart.root
  root.name = chart.title or root.name
  local problem = levels.lay_out(chart, run)
  if problem then return nil, problem end
  local top = chart.top
  move(top, 0, 0)
  local texts = { "digraph " .. looks.quoted(root.name) .. " {",
    looks.head(chart.direction), ('  graph [layout=nop2, outputorder=nodesfirst, '
    .. 'bb="0,0,%s"]'):format(point_text(top.level.width, top.level.height)) }
  looks.add_node(texts, 1, chart.root, position_of)
  for _, arrow in ipairs(chart.all) do add_arrow(texts, arrow, chart) end
  add(texts, 0, "}")
  return concat(texts, "\n") .. "\n"
end

return layout
