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
local order = require "rfsm.shared.order"

local insert, ipairs, setmetatable = table.insert, ipairs, setmetatable

local links = {}

--- The inside of a composite. Positions are in points, from the lower left corner.
---@class rfsm.pictures.Level
---@field composite rfsm.pictures.Node
---@field direction "TB"|"LR"
---@field gates rfsm.pictures.Gate[]
---@field links rfsm.pictures.Link[]
---@field boxes? rfsm.pictures.Box[] the boxes of the nodes
---@field width? number
---@field height? number
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
---@field at number[] its point in the level
---@field offset number distance from the corner where its side of the frame begins

--- An end of a link: a node, a gate of a node's box, or a gate of the level.
---@class rfsm.pictures.End
---@field node? rfsm.pictures.Node
---@field gate? rfsm.pictures.Gate

--- A part of an arrow: the line between two ends in a level.
---@class rfsm.pictures.Link
---@field id integer
---@field composite rfsm.pictures.Node it is in the level of this composite
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

local function new_level(composite, direction)
  return { composite = composite, direction = direction, gates = {}, links = {} }
end

--- Return a level with gates and links of its own, which has all else of another one.
function links.copy(level)
  local function heir(element) return setmetatable({}, { __index = element }) end
  local copy = heir(level)
  copy.gates, copy.links = order.map(level.gates, heir), order.map(level.links, heir)
  return copy
end

local function add_gate(level, is_upper)
  local index = #level.gates + 1
  level.gates[index] = { id = (is_upper and "t" or "b") .. index, index = index,
    is_upper = is_upper }
  return level.gates[index]
end

-- Adds a link to the level of a composite, and to its arrow, at a position.
local function add_link(composite, position, link)
  local list = composite.level.links
  link.id, link.composite = #list + 1, composite
  list[link.id] = link
  insert(link.arrow.links, position, link)
end

-- Chains: from the source out to the home, and in to the target ---------------

-- Adds the links from an end of an arrow out to the arrow's home, behind the links that
-- are there. Returns the end of the arrow in the level of the home.
local function climb(arrow, node, is_upper, is_src)
  local composite, finish, position = node.parent, { node = node }, #arrow.links + 1
  while composite ~= arrow.home do
    local gate = add_gate(composite.level, is_upper)
    local upper, lower = finish, { gate = gate }
    if is_upper then upper, lower = lower, upper end
    add_link(composite, is_src and #arrow.links + 1 or position, {
      arrow = arrow, upper = upper, lower = lower, is_turned = is_upper == is_src,
      has_head = not (is_src or finish.gate),
    })
    finish, composite = { node = composite, gate = gate }, composite.parent
  end
  return finish
end

local function add_links(arrow)
  if diagram.is_inside(arrow.tgt, arrow.src) then
    climb(arrow, arrow.tgt, true, false)
    arrow.links[1].is_home, arrow.links[1].is_inner = true, true
    return
  end
  local src, tgt = diagram.ends_in(arrow, arrow.home)
  local is_down = src.index <= tgt.index
  local upper, position = climb(arrow, arrow.src, not is_down, true), #arrow.links + 1
  local lower = climb(arrow, arrow.tgt, is_down, false)
  local has_head = not lower.gate
  if not is_down then upper, lower = lower, upper end
  add_link(arrow.home, position, { arrow = arrow, upper = upper, lower = lower,
    is_turned = not is_down, is_home = true, has_head = has_head })
end

--- Give each composite its level, and each arrow its links.
function links.prepare(chart)
  chart.top.level = new_level(chart.top, chart.direction)
  for _, node in ipairs(chart.nodes) do
    node.level = node.kind == "composite" and new_level(node, chart.direction) or nil
  end
  for _, arrow in ipairs(chart.all) do
    arrow.links = {}
    add_links(arrow)
  end
end

return links
