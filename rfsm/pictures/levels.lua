--- The layout of a chart: level by level, the innermost ones first.
--
-- Graphviz lays out each level. A chain that is too long is put into columns. A level
-- with too many nodes beside each other is laid out again, from left to right. Leaves
-- linked to one node only are put at both sides of it. Loops at states are drawn here.
--
-- @module rfsm.pictures.levels
-- @license BSD-3-Clause

local columns = require "rfsm.pictures.columns"
local graphs = require "rfsm.pictures.graphs"
local links = require "rfsm.pictures.links"
local looks = require "rfsm.pictures.looks"

local ipairs, log, max = ipairs, math.log, math.max

local levels = {}

-- Loops: arrows from a state to itself, beside it -----------------------------

local DEPTH, LEAST = 22, 18 -- points: extent of a loop, least distance of two loops

-- Returns the length that a loop and its label take along the side of a node.
local function step_of(link)
  local box = link.arrow.label_box
  return max(LEAST, link.level.direction == "TB" and box.height + 4 or box.width + 10)
end

local function add_loop(link)
  local node, box = link.upper.node, link.arrow.label_box
  local is_down, room = link.level.direction == "TB",
    node.loops or { length = 0, width = 2, height = 2 }
  node.loops, room.length = room, room.length + step_of(link)
  local field = is_down and "width" or "height"
  room[field] = max(room[field], box[field] + DEPTH - 8)
  node.least = (is_down and ", height=" or ", width=")
    .. looks.number_text(max(is_down and 0.4 or 0.75, room.length / 72))
end

-- Sets the field `label_box` of arrows or levels to the size of their label. Returns a
-- problem if there is one.
local function measure_labels(owners, run)
  local labels = {}
  for i, owner in ipairs(owners) do
    labels[i] = owner.parts and "fontsize=10, label=" .. looks.arrow_label(owner)
      or "label=" .. looks.state_label(owner.composite)
  end
  if not labels[1] then return nil end
  local boxes, problem = graphs.sizes_of(labels, run)
  for i, box in ipairs(boxes or {}) do owners[i].label_box = box end
  return problem
end

local function find_loops(chart, run)
  local list = {}
  for _, arrow in ipairs(chart.all) do
    list[#list + 1] = arrow.links[1].is_loop and arrow or nil
  end
  local problem = measure_labels(list, run)
  for _, arrow in ipairs(problem and {} or list) do add_loop(arrow.links[1]) end
  return problem
end

-- The points of a loop at the right side of a box, from its upper end to its lower one.
-- In a level that runs from left to right, loops are at the upper side.
local LOOP = { { 0, 5 }, { 12, 8 }, { 18, 7 }, { 18, 0 }, { 18, -6 }, { 14, -8 },
  { 6.5, -6.5 } }
local TIP = { 0, -4.5 }

local function draw_loop(link, x, y)
  local is_down, box = link.level.direction == "TB", link.arrow.label_box
  local function at(point)
    if is_down then return { x + point[1], y + point[2] } end
    return { x - point[2], y + point[1] }
  end
  link.points = {}
  for i, point in ipairs(LOOP) do link.points[i] = at(point) end
  link.tip = at(TIP)
  link.label_at = at { DEPTH + (is_down and box.width or box.height) / 2 - 1, 0 }
end

local function draw_loops(level)
  local offsets = {}
  for _, link in ipairs(level.links) do
    local node = link.is_loop and link.upper.node
    if node then
      local box, step = level.boxes[node.index], step_of(link)
      local offset = offsets[node] or -node.loops.length / 2
      offsets[node] = offset + step
      local along = offset + step / 2
      if level.direction == "TB" then
        draw_loop(link, box.x + box.width / 2, box.y - along)
      else
        draw_loop(link, box.x + along, box.y + box.height / 2)
      end
    end
  end
end

local function lay_out(list, run)
  local problem = list[1] and graphs.lay_out(list, run)
  for _, level in ipairs(problem and {} or list) do draw_loops(level) end
  return problem
end

-- Levels that do not fit ------------------------------------------------------

local FEWEST, MANY = 6, 8 -- least numbers of nodes to change a level, to divide it
local TALLEST, WIDEST = 420, 800 -- points: smaller inner levels keep their direction
local LONGEST = 1000 -- points: shorter levels are readable on A4, and not divided
local MISFIT = log(1.7)

-- Returns the size of a level along its arrows.
local function length_of(level)
  return level.direction == "TB" and level.height or level.width
end

-- Is a level longer along its arrows than across? If not, many nodes are side by side.
local function is_long(level)
  return length_of(level) == max(level.width, level.height)
end

local function divide(list, run)
  local parts, owners = {}, {}
  for _, level in ipairs(list) do
    for _, part in ipairs(columns.split(level, level.plan)) do
      parts[#parts + 1] = part
    end
    owners[#owners + 1] = level
    for _, link in ipairs(level.links) do
      owners[#owners + 1] = link.is_home and link.arrow.parts[1] and link.arrow or nil
    end
  end
  local problem = lay_out(parts, run) or measure_labels(owners, run)
  if problem then return problem end
  for _, level in ipairs(list) do
    columns.arrange(level, level.label_box)
    graphs.measure(level)
  end
end

-- Returns true if no arrow crosses the frame of a level or of a composite in it, and no
-- arrow in the level is a loop.
local function is_closed(level)
  for _, node in ipairs(level.composite.nodes) do
    if node.loops or node.level and node.level.gates[1] then return false end
  end
  return not level.gates[1]
end

local function swap(link)
  link.upper, link.lower, link.is_turned = link.lower, link.upper, not link.is_turned
end

-- Returns a table by hub. A hub is the only node to which some leaves are linked; its
-- value is a list with the links of each of these leaves.
local function rays_of(level)
  local hub_of, links_of, rays = {}, {}, {}
  for _, link in ipairs(level.links) do
    for _, pair in ipairs { { link.upper, link.lower }, { link.lower, link.upper } } do
      local node, other = pair[1].node, pair[2].node
      links_of[node] = links_of[node] or {}
      links_of[node][#links_of[node] + 1] = link
      hub_of[node] = (hub_of[node] == nil or hub_of[node] == other) and other
    end
  end
  for _, node in ipairs(level.composite.nodes) do
    local hub = node.kind == "leaf" and hub_of[node]
    if hub then
      rays[hub] = rays[hub] or {}
      rays[hub][#rays[hub] + 1] = links_of[node]
    end
  end
  return rays
end

local FEW = 4 -- leaves of a hub: if there are no more, all stay at the same side of it

local BESIDE = 0.12 -- inches between arrows at a hub

-- Puts every second leaf of a hub before the hub, by turning its links, and makes the
-- hub as high as the arrows at each side of it need.
local function spread(level)
  local rays = rays_of(level)
  for _, hub in ipairs(level.composite.nodes) do
    local leaves, count = rays[hub] or {}, 0
    for i, list in ipairs(#leaves > FEW and leaves or {}) do
      count, level.is_spread = count + #list, true
      for _, link in ipairs(i % 2 == 0 and list or {}) do swap(link) end
      hub.least = ", height=" .. looks.number_text(max(0.75, count / 2 * BESIDE))
    end
  end
end

-- Lays levels out from left to right.
local function turn(list, run)
  for _, level in ipairs(list) do
    level.direction = "LR"
    spread(level)
  end
  return lay_out(list, run)
end

local function is_misfit(level)
  return #level.boxes >= FEWEST and columns.misfit(level) >= MISFIT
    and not level.composite.nodes[1].is_region -- all nodes are regions, or none is
end

-- Returns how a level is changed: "turn" or "divide"; nil if it stays as it is.
local function change_of(chart, level)
  if not is_misfit(level) then return nil end
  if is_long(level) then
    level.plan = length_of(level) > LONGEST and #level.boxes >= MANY
      and columns.plan(level)
    return level.plan and "divide" or nil
  end
  local is_large = level.composite == chart.root or level.height > TALLEST
    or level.width > WIDEST
  return is_large and is_closed(level) and "turn" or nil
end

local function mend(chart, list, run)
  local levels_for = { turn = {}, divide = {} }
  for _, level in ipairs(list) do
    local group = levels_for[change_of(chart, level) or false] or {}
    group[#group + 1] = level
  end
  return turn(levels_for.turn, run) or divide(levels_for.divide, run)
end

-- Layout ----------------------------------------------------------------------

-- Makes the regions in a composite equally high, or equally wide if their arrows lead
-- from left to right.
local function align_regions(composite)
  local height, width, regions = 0, 0, {}
  for _, node in ipairs(composite.nodes) do
    regions[#regions + 1] = node.is_region and node.level or nil
  end
  for _, level in ipairs(regions) do
    height, width = max(height, level.height), max(width, level.width)
  end
  for _, level in ipairs(regions) do
    if level.direction == "TB" then
      level.y, level.height = level.y + height - level.height, height
    else
      level.header.x = level.header.x + (width - level.width) / 2
      level.width = width
    end
  end
end

-- Returns lists of levels. A level in the first list contains no other level; a level
-- in the second list contains only levels of the first list, and so on.
local function levels_by_height(chart)
  local list = {}
  local function visit(composite)
    local height = 1
    for _, node in ipairs(composite.nodes) do
      if node.level then height = max(height, visit(node) + 1) end
    end
    list[height] = list[height] or {}
    list[height][#list[height] + 1] = composite.level
    return height
  end
  visit(chart.top)
  return list
end

--- Lay out all levels of a chart; return a problem if there is one.
function levels.lay_out(chart, run)
  links.prepare(chart)
  local problem = find_loops(chart, run)
  for _, list in ipairs(levels_by_height(chart)) do
    for _, level in ipairs(list) do align_regions(level.composite) end
    problem = problem or lay_out(list, run) or mend(chart, list, run)
  end
  return problem
end

return levels
