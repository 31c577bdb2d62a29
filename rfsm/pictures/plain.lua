--- The layout of a chart as a whole: where Graphviz puts everything.
--
-- The graph is that of `rfsm.dot.encode`. A label is a node in it, so that an arrow is
-- two edges, which are joined here.
--
-- @module rfsm.pictures.plain
-- @license BSD-3-Clause

local graphs = require "rfsm.pictures.graphs"
local lines = require "rfsm.pictures.lines"
local looks = require "rfsm.pictures.looks"

local ipairs = ipairs

local plain = {}

-- Returns the elements of an answer: frames and nodes by identifier, edges by id.
local function elements_of(answer)
  local frames, nodes, edges = {}, {}, {}
  graphs.read(answer, 1, function(id, attributes, cluster)
    if id == "graph" and attributes.bb then
      frames[cluster or ""] = attributes
    elseif id:find("->", 1, true) then
      edges[attributes.id or id] = attributes
    else
      nodes[id] = attributes
    end
  end)
  return frames, nodes, edges
end

local function frame_of(attributes)
  local corners = graphs.numbers_in(attributes.bb)
  local header = graphs.numbers_in(attributes.lp or "")
  return { left = corners[1], bottom = corners[2], width = corners[3] - corners[1],
    height = corners[4] - corners[2], x = header[1], y = header[2] }
end

-- Joins the halves of the line of an arrow, of which the second may be turned: the
-- first half is, too, unless the arrow is a loop around its label.
local function join(label, box, direction, first, second)
  local is_down = direction == "TB"
  local x, y = box.pos[1], box.pos[2]
  if second.is_turned then second.points = lines.moved(second.points, 0, 0, true) end
  if label.is_round then
    local far = is_down and y - box.height * 36 or x + box.width * 36
    local from, to = first.points[#first.points], second.points[1]
    lines.join(first.points, lines.around(from, to, far, direction))
  elseif second.is_turned then
    first.points = lines.moved(first.points, 0, 0, true)
  end
  lines.join(first.points, second.points)
  return { points = first.points, tip = second.tip, label = { x, y } }
end

-- Returns the line of an arrow; nil if Graphviz has drawn no part of it.
local function line_of(chart, arrow, nodes, edges)
  local function half(name)
    local attributes = edges[looks.plain_id(arrow.key .. name)]
    return attributes and attributes.pos and graphs.line_of(attributes.pos)
  end
  local label = arrow.label
  local first, second = half(label and "/src" or ""), label and half "/tgt"
  local box = label and nodes[label.id]
  if not label then
    if first and first.is_turned then
      first.points = lines.moved(first.points, 0, 0, true)
    end
    return first
  elseif first and second and box and box.pos then
    return join(label, { pos = graphs.numbers_in(box.pos), width = box.width,
      height = box.height }, chart.direction, first, second)
  end
end

--- Return the layout that an answer of Graphviz has; nil if it lacks anything.
---@param chart rfsm.pictures.Chart
---@param answer string
---@return rfsm.pictures.Layout?
function plain.read(chart, answer)
  local frames, nodes, edges = elements_of(answer)
  local layout = frame_of(frames[""])
  layout.kind, layout.places, layout.lines = "plain", {}, {}
  for _, node in ipairs(chart.nodes) do
    local frame, box = frames["cluster_" .. node.id], nodes[node.id]
    local point = box and box.pos and graphs.numbers_in(box.pos)
    layout.places[node] = frame and frame_of(frame)
      or point and { x = point[1], y = point[2] }
    if not layout.places[node] then return nil end
  end
  for i, arrow in ipairs(chart.all) do
    layout.lines[i] = line_of(chart, arrow, nodes, edges)
    if not layout.lines[i] then return nil end
  end
  return layout
end

return plain
