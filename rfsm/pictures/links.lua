--- Levels and links: a level is the inside of a composite, a link a part of an arrow.
--
-- A composite is a box in the level of its parent. Where an arrow crosses the frame of
-- the composite, the frame has a gate at its upper or lower side: a port of the box,
-- and a point in the level of the composite. An arrow is a chain of links, from its
-- source out to its home, the innermost composite that contains both ends, and in to
-- its target. All links lead downward, in the order of the walk from `initial`; the
-- links of an arrow that leads upward are *turned*.
--
-- If the direction is LR, "upper" means left and "lower" means right.
--
-- @module rfsm.pictures.links
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"

local ipairs, setmetatable = ipairs, setmetatable

local links = {}

--- The inside of a composite. Positions are in points, from the lower left corner.
---@class rfsm.pictures.Level
---@field composite rfsm.pictures.Node
---@field direction "TB"|"LR"
---@field gates rfsm.pictures.Gate[]
---@field gate_of table<string, rfsm.pictures.Gate> key of an arrow -> its gate
---@field links rfsm.pictures.Link[]
---@field link_of table<string, rfsm.pictures.Link> key of an arrow -> its link
---@field boxes rfsm.pictures.Box[] the boxes of the nodes
---@field width number
---@field height number
---@field is_spread? boolean leaves are at both sides of a hub
---@field header? rfsm.pictures.Box the box of the composite's name and rows

--- A part of a level: its middle, and its size.
---@class rfsm.pictures.Box
---@field x number
---@field y number
---@field width number
---@field height number

--- The place where an arrow crosses a frame.
---@class rfsm.pictures.Gate
---@field id string
---@field index integer
---@field is_upper boolean
---@field x number
---@field y number
---@field offset number distance from the corner where its side of the frame begins

--- An end of a link: a node, a gate of a node's box, or a gate of the level.
---@class rfsm.pictures.End
---@field node? rfsm.pictures.Node
---@field gate? rfsm.pictures.Gate

--- A part of an arrow: the line between two ends in a level.
---@class rfsm.pictures.Link
---@field id integer
---@field level rfsm.pictures.Level
---@field arrow rfsm.pictures.Arrow
---@field upper rfsm.pictures.End
---@field lower rfsm.pictures.End
---@field is_turned boolean the arrow leads from the lower end to the upper one
---@field is_home? boolean this link is in the home of the arrow, and has the label
---@field has_head? boolean this link has the arrowhead
---@field is_inner? boolean its arrow begins at its upper gate, inside of the frame
---@field points? number[][] the points of the line
---@field tip? number[] the tip of the arrowhead
---@field label_at? number[] the position of the label

-- Gates and links -------------------------------------------------------------

--- Return an empty level.
function links.new_level(composite, direction)
  return { composite = composite, direction = direction, gates = {}, gate_of = {},
    links = {}, link_of = {}, boxes = {}, width = 0, height = 0 }
end

--- Return a level with gates and links of its own, which has all else of another one.
function links.copy(level)
  local function heir(element) return setmetatable({}, { __index = element }) end
  local copy = heir(level)
  copy.gates, copy.links = {}, {}
  for i, gate in ipairs(level.gates) do copy.gates[i] = heir(gate) end
  for i, link in ipairs(level.links) do
    copy.links[i] = heir(link)
    copy.links[i].level = copy
  end
  return copy
end

-- Returns the gate of an arrow in a level; the first call makes it.
local function gate_of(level, arrow, is_upper)
  local key = arrow.key
  local gate = level.gate_of[key]
  if gate then return gate end
  local index = #level.gates + 1
  gate = { id = (is_upper and "t" or "b") .. index, index = index, is_upper = is_upper }
  level.gates[index], level.gate_of[key] = gate, gate
  return gate
end

-- Returns the link of an arrow in a level; the first call adds the given link.
local function link_of(level, link)
  local key = link.arrow.key
  if not level.link_of[key] then
    link.id, link.level = #level.links + 1, level
    level.links[link.id], level.link_of[key] = link, link
  end
  return level.link_of[key]
end

local function append(list, more)
  for _, element in ipairs(more) do list[#list + 1] = element end
  return list
end

local function reversed(list)
  local result = {}
  for i, element in ipairs(list) do result[#list + 1 - i] = element end
  return result
end

-- Chains: from the source out to the home, and in to the target ---------------

-- Follows an arrow from the node at one of its ends out to its home. Returns the end of
-- the arrow in the level of the home, and the links from the node to that end.
local function climb(arrow, node, is_upper, is_src)
  local composite, finish, list = node.parent, { node = node }, {}
  while composite ~= arrow.home do
    local gate = gate_of(composite.level, arrow, is_upper)
    local upper, lower = finish, { gate = gate }
    if is_upper then upper, lower = lower, upper end
    list[#list + 1] = link_of(composite.level, {
      arrow = arrow, upper = upper, lower = lower, is_turned = is_upper == is_src,
      has_head = not (is_src or finish.gate),
    })
    finish = { node = composite, gate = gate }
    composite = composite.parent
  end
  return finish, list
end

-- Returns the links of an arrow from a composite to a node in it: it begins at the
-- inner side of the frame.
local function inner_links(arrow)
  local _, list = climb(arrow, arrow.tgt, true, false)
  list[#list].is_home, list[#list].is_inner = true, true
  return reversed(list)
end

local function links_of(arrow)
  if diagram.is_inside(arrow.tgt, arrow.src) then return inner_links(arrow) end
  local src, tgt = diagram.ends_in(arrow, arrow.home)
  local is_down = src.index <= tgt.index
  local out, list = climb(arrow, arrow.src, not is_down, true)
  local into, inner = climb(arrow, arrow.tgt, is_down, false)
  local upper, lower = out, into
  if not is_down then upper, lower = into, out end
  list[#list + 1] = link_of(arrow.home.level, {
    arrow = arrow, upper = upper, lower = lower, is_turned = not is_down,
    is_home = true, has_head = not into.gate,
  })
  return append(list, reversed(inner))
end

--- Give each composite its level, and each arrow its links. `chart.top` is a composite
-- around the root, so that arrows at the root have a level, too.
function links.prepare(chart)
  chart.top = { nodes = { chart.root }, kind = "top" }
  chart.top.level = links.new_level(chart.top, chart.direction)
  chart.root.parent = chart.top
  for _, node in ipairs(chart.nodes) do
    if node.kind == "composite" then
      node.level = links.new_level(node, chart.direction)
    end
  end
  for _, arrow in ipairs(chart.all) do
    arrow.home = arrow.home or chart.top
    arrow.links = links_of(arrow)
  end
end

return links
