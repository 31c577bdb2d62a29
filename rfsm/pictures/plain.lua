--- The plain layout: Graphviz lays out the whole chart as one graph.
--
-- `rfsm.dot.encode` makes the graph. In this graph the label of an arrow is a node, so
-- an arrow with a label is two edges. The lines of the two edges are joined here.
--
-- @module rfsm.pictures.plain
-- @license BSD-3-Clause

local graphs = require "rfsm.pictures.graphs"
local lines = require "rfsm.pictures.lines"
local looks = require "rfsm.pictures.looks"

local ipairs = ipairs

local plain = {}

local function frame_of(attributes)
  local corners = graphs.numbers_in(attributes.bb)
  local header = graphs.numbers_in(attributes.lp or "")
  return { left = corners[1], bottom = corners[2], width = corners[3] - corners[1],
    height = corners[4] - corners[2], x = header[1], y = header[2] }
end

-- Reads an answer of Graphviz. Returns three tables, by identifier: the frames of
-- composites, the boxes of nodes and labels, and the lines of edges.
local function elements_of(answer)
  local frames, boxes, halves = {}, {}, {}
  graphs.read(answer, 1, function(id, attributes, cluster)
    if attributes.bb then
      frames[cluster or ""] = frame_of(attributes)
    elseif attributes.pos and id:find("->", 1, true) then
      halves[attributes.id] = graphs.line_of(attributes.pos)
    elseif attributes.pos then
      boxes[id] = graphs.box_of(attributes)
    end
  end)
  return frames, boxes, halves
end

local function turn(line) line.points = lines.moved(line.points, 0, 0, true) end

-- Joins the two halves of the line of an arrow. If Graphviz drew the second half from
-- its tip, the first half is backward, too, and is turned, unless the arrow is a loop
-- around its label.
local function join(label, box, direction, first, second)
  if label.is_round then
    local from, to = first.points[#first.points], second.points[1]
    local far = direction == "TB" and box.y - box.height / 2 or box.x + box.width / 2
    lines.join(first.points, lines.around(from, to, far, direction))
  elseif second.is_turned then
    turn(first)
  end
  lines.join(first.points, second.points)
  return { points = first.points, tip = second.tip, label = { box.x, box.y } }
end

-- Returns the line of an arrow; nil if Graphviz has not drawn all of it.
local function line_of(chart, arrow, boxes, halves)
  local label = arrow.label
  local function half(name) return halves[looks.plain_id(arrow.key .. name)] end
  local last = half(label and "/tgt" or "")
  if last and last.is_turned then turn(last) end
  if not label then return last end
  local first, box = half "/src", boxes[label.id]
  return first and last and box and join(label, box, chart.direction, first, last)
end

--- Return the layout in an answer of Graphviz; nil if a node or an arrow is missing.
---@param chart rfsm.pictures.Chart
---@param answer string
---@return rfsm.pictures.Layout?
function plain.read(chart, answer)
  local frames, boxes, halves = elements_of(answer)
  local layout = frames[""]
  layout.kind, layout.places, layout.lines, layout.leasts = "plain", {}, {}, {}
  for _, node in ipairs(chart.nodes) do
    layout.places[node] = frames["cluster_" .. node.id] or boxes[node.id]
    if not layout.places[node] then return nil end
  end
  for i, arrow in ipairs(chart.all) do
    layout.lines[i] = line_of(chart, arrow, boxes, halves)
    if not layout.lines[i] then return nil end
  end
  return layout
end

return plain
