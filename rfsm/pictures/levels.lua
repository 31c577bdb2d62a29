--- What is done to a level before and after Graphviz lays it out.
--
-- A level with too many nodes beside each other runs from left to right, and leaves
-- linked to one node only are put at both sides of it.
--
-- @module rfsm.pictures.levels
-- @license BSD-3-Clause

local links = require "rfsm.pictures.links"
local looks = require "rfsm.pictures.looks"
local order = require "rfsm.shared.order"

local ipairs, max = ipairs, math.max

local levels = {}

-- Levels that do not fit ------------------------------------------------------

--- Can a level run from left to right? It cannot if it has regions, if an arrow crosses
-- its frame or the frame of a composite in it, or is a loop at such a composite.
function levels.can_be_turned(level)
  for _, node in ipairs(level.composite.nodes) do
    if node.is_region or node.level and (node.has_loop or node.level.gates[1]) then
      return false
    end
  end
  return not level.gates[1]
end

local function swap(link)
  link.upper, link.lower, link.is_turned = link.lower, link.upper, not link.is_turned
end

-- Returns a table by hub. A hub is the only node to which some leaves are linked, apart
-- from loops; its value is a list with the links of each of these leaves.
local function rays_of(level)
  local hub_of, links_of, rays = {}, {}, {}
  for _, link in ipairs(level.links) do
    for _, pair in ipairs { { link.upper, link.lower }, { link.lower, link.upper } } do
      local node, other = pair[1].node, pair[2].node
      if node ~= other then
        order.append(links_of, node, link)
        hub_of[node] = (hub_of[node] == nil or hub_of[node] == other) and other
      end
    end
  end
  for _, node in ipairs(level.composite.nodes) do
    local hub = node.kind == "leaf" and hub_of[node]
    if hub then order.append(rays, hub, links_of[node]) end
  end
  return rays
end

local FEW = 4 -- leaves of a hub: if there are no more, all stay at the same side of it

local BESIDE = 0.12 -- inches between arrows at a hub

-- Puts every second leaf of a hub before the hub, by turning its links, and makes the
-- hub as high as the arrows at each side of it need.
local function spread(level)
  local rays = rays_of(level)
  level.least = {}
  for _, hub in ipairs(level.composite.nodes) do
    local leaves, count = rays[hub] or {}, 0
    for i, list in ipairs(#leaves > FEW and leaves or {}) do
      count, level.is_spread = count + #list, true
      for _, link in ipairs(i % 2 == 0 and list or {}) do swap(link) end
      level.least[hub] = ", height="
        .. looks.number_text(max(0.75, count / 2 * BESIDE))
    end
  end
end

--- Have a level that was not laid out run from left to right.
function levels.turn(level)
  level.direction = "LR"
  spread(level)
end

--- Is a shape of a level far too long, across its arrows?
function levels.is_wide(shape)
  local width, height = shape.width, shape.height
  if shape.direction ~= "TB" then width, height = height, width end
  return width > 2 * height
end

-- Layout ----------------------------------------------------------------------

--- Make the regions in a composite equally high, or equally wide if their arrows lead
-- from left to right.
function levels.align_regions(composite)
  local height, width, regions = 0, 0, {}
  for _, node in ipairs(composite.nodes) do
    regions[#regions + 1] = node.is_region and node.level and node or nil
  end
  for _, node in ipairs(regions) do
    height, width = max(height, node.level.height), max(width, node.level.width)
  end
  for _, node in ipairs(regions) do
    local old, level = node.level, links.copy(node.level)
    if level.direction == "TB" then
      level.y, level.height = old.y + height - old.height, height
    else
      level.header = { x = old.header.x + (width - old.width) / 2, y = old.header.y }
      level.width = width
    end
    node.level = level
  end
end

--- Return lists of levels. A level in the first list contains no other level; a level
-- in the second list contains only levels of the first list, and so on. The level
-- around the root is there if an arrow is in it, or if the root is a leaf.
function levels.by_height(chart)
  local list = {}
  local function visit(composite)
    local height = 1
    for _, node in ipairs(composite.nodes) do
      if node.level then height = max(height, visit(node) + 1) end
    end
    order.append(list, height, composite.level)
    return height
  end
  visit(chart.root.level and not chart.top.level.links[1] and chart.root or chart.top)
  return list
end

return levels
