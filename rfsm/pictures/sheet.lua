--- The shapes of levels: how they may be laid out, and which shapes make a picture.
--
-- Bottom-up, each level is laid out as Graphviz does it: its *first* shape. If a chart
-- is too large for its sheet, there are tight shapes, most of them with rows. One is
-- kept for each *aim*: a large scale, little height, little width; all composites in a
-- level have shapes for one aim. The shapes of all levels of one height are laid out in
-- one run of Graphviz.
--
-- In a *turned* shape arrows lead from left to right, and leaves that are linked to one
-- node only are at both sides of this node.
--
-- @module rfsm.pictures.sheet
-- @license BSD-3-Clause

local choice = require "rfsm.pictures.choice"
local graphs = require "rfsm.pictures.graphs"
local lines = require "rfsm.pictures.lines"
local links = require "rfsm.pictures.links"
local looks = require "rfsm.pictures.looks"
local order = require "rfsm.shared.order"
local rows = require "rfsm.pictures.rows"

local abs, huge, ipairs = math.abs, math.huge, ipairs
local concat, max, min, type = table.concat, math.max, math.min, type

local sheet = {}

--- A way to lay out a level: a copy of it.
---@class rfsm.pictures.Shape: rfsm.pictures.Level
---@field kids table<integer, rfsm.pictures.Shape> the shapes of the composites in it
---@field deal integer[]|"plain"|"turned" the row of each node, or no rows
---@field key string the same for shapes with the same rows
---@field crossings? number in the level and in its kids; huge if a line covers a box

-- Makes a shape the level of its composite.
local function put(shape)
  shape.composite.level = shape
  for _, node in ipairs(shape.composite.nodes) do
    node.least = shape.least and shape.least[node]
  end
end

-- Judging ---------------------------------------------------------------------

-- Is a part of the piece from a to b in a box, deeper than its round corners?
local function is_through(a, b, box)
  local width, height = box.width / 2 - 3, box.height / 2 - 3
  local x, y, x2, y2 = a[1] - box.x, a[2] - box.y, b[1] - box.x, b[2] - box.y
  return min(x, x2) < width and max(x, x2) > -width
    and min(y, y2) < height and max(y, y2) > -height
    and abs(x * y2 - y * x2) < width * abs(y2 - y) + height * abs(x2 - x)
end

-- Does a line run through a box that is not its end?
local function is_covering(level, line)
  local flat = line.flat
  for i, box in ipairs(level.boxes) do
    local node = level.composite.nodes[i]
    for k = 2, node ~= line.upper and node ~= line.lower and #flat or 1 do
      if is_through(flat[k - 1], flat[k], box) then return true end
    end
  end
  return false
end

-- Returns the lines of a level, flat: its links, and from each gate to the frame, since
-- Graphviz does not always put gates into the first or the last rank.
local function lines_in(level)
  local list, axis = {}, 3 - lines.axis_of(level)
  for _, link in ipairs(level.links) do
    list[#list + 1] = { flat = lines.flat(link.points),
      upper = link.upper.node, lower = link.lower.node }
  end
  for _, gate in ipairs(level.gates) do
    local at, border = gate.at, { gate.at[1], gate.at[2] }
    local far = axis == 2 and level.inner_height or level.inner_width
    border[axis] = gate.is_upper == (axis == 2) and far or 0
    list[#list + 1] = { flat = { at, border } }
  end
  return list
end

-- Returns the number of crossings in a shape; huge if a line covers a box. It is only
-- counted where it matters: most shapes are out of question by their size.
local function crossings_of(shape)
  if shape.crossings then return shape.crossings end
  local list = lines_in(shape)
  shape.crossings = order.any(list, function(line)
    return is_covering(shape, line)
  end) and huge or choice.count_crossings(list)
  for _, kid in order.each(shape.kids) do -- any order
    shape.crossings = shape.crossings + crossings_of(kid)
  end
  return shape.crossings
end

-- Aims ------------------------------------------------------------------------

local AIMS = { "scale", "height", "width" }

-- How badly a shape serves an aim.
local MISFITS = {
  scale = function(shape, size)
    return -choice.scale(size, shape.width, shape.height)
  end,
  height = function(shape) return shape.height + shape.width / 50 end,
  width = function(shape) return shape.width + shape.height / 50 end,
}

-- Returns the shape of a level that serves an aim best: the one with a given key if it
-- has one. No shape has more crossings than the first.
local function best_for(aim, level, size, key)
  local first, best, least = level.kept.first, level.kept.first, huge
  for _, shape in ipairs(level.shapes) do
    local misfit = shape.key == key and -huge or MISFITS[aim](shape, size)
    if misfit < least - 0.001 and crossings_of(shape) < huge
      and crossings_of(shape) <= crossings_of(first) then
      best, least = shape, misfit
    end
  end
  return best
end

-- Returns a text that is the same for levels with the same states and as many links.
local function text_of_level(level)
  local texts = { #level.links }
  for i, node in ipairs(level.composite.nodes) do
    texts[i + 1] = node.name .. (node.level and text_of_level(node.level) or "")
  end
  return concat(texts, "\n")
end

-- Sets the field `kept` of a level: for each aim the shape that serves it best. `keys`
-- has the keys of shapes of other levels, for each aim and text of a level: levels with
-- the same states are alike.
local function keep_best(level, size, keys)
  local kept, text = level.kept, text_of_level(level)
  for _, aim in ipairs(AIMS) do
    local same = aim .. text
    kept[aim] = best_for(aim, level, size, keys[same])
    keys[same] = keys[same] or kept[aim].key
  end
  if kept.former and crossings_of(kept.former) == huge then kept.former = kept.first end
end

-- Turned levels ---------------------------------------------------------------

-- Can a level run from left to right? It cannot if it has regions, if an arrow crosses
-- its frame or the frame of a composite in it, or is a loop at such a composite.
local function can_be_turned(level)
  return not level.gates[1] and not order.any(level.composite.nodes, function(node)
    return node.is_region or node.level and (node.has_loop or node.level.gates[1])
  end)
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

-- Deals: the rows of a level --------------------------------------------------

local LONG = 6 -- nodes; the first shape of a level with fewer is not turned
local LARGE = 100 -- bent links; a level with more is not put into rows

-- Returns the boxes of the nodes in a level, with the given shapes in it.
local function boxes_of(level, kids)
  local boxes = {}
  for i, node in ipairs(level.composite.nodes) do boxes[i] = kids[i] or node.size end
  return boxes
end

-- Returns the rows of a level in a former picture. A new node is in the row of the node
-- before it, or begins the next one. A node that cannot be in its row begins another.
local function former_rows(level)
  local numbers, last, first, shift = {}, 1, 1, 0
  for i, node in ipairs(level.composite.nodes) do
    local number = max(last, node.row and node.row + shift or last)
    if number == last and (level.bounds[i] or 0) >= first then number = number + 1 end
    shift, first = node.row and number - node.row or shift, number > last and i or first
    numbers[i], last = number, number
  end
  return numbers
end

-- Returns the deal that a level has in a former picture.
local function former_deal(level)
  for _, node in ipairs(level.composite.nodes) do
    if node.row == 0 then return can_be_turned(level) and "turned" or "plain" end
    if node.row then return former_rows(level) end
  end
  return "plain"
end

-- Returns the deals that are tried for a level with the shapes `kids` in it.
local function deals_of(level, aim, kids)
  if aim == "former" then return { former_deal(level) } end
  local nodes, deals, is_first = level.composite.nodes, {}, aim == "first"
  if nodes[2] and not (is_first or nodes[1].is_region) and level.bent <= LARGE then
    deals = rows.deals(level, boxes_of(level, kids))
  end
  deals[#deals + 1] = "plain"
  if is_first and not nodes[LONG] then return deals end
  deals[#deals + 1] = can_be_turned(level) and "turned" or nil
  return deals
end

-- Layout ----------------------------------------------------------------------

-- Adds a shape to a level, and to the jobs. Returns it, or the equal one that is there.
local function add_shape(jobs, level, aim, deal, kids)
  local texts = { aim == "first" and "loose" or "tight",
    type(deal) == "table" and concat(deal, " ") or deal }
  for i in ipairs(level.composite.nodes) do
    texts[#texts + 1] = kids[i] and kids[i].key
  end
  local key, shapes = concat(texts, "(") .. ")", level.shapes
  if not shapes[key] then
    local shape = links.copy(level)
    shape.kids, shape.deal, shape.key, shape.is_tight = kids, deal, key, aim ~= "first"
    shapes[key], shapes[#shapes + 1], jobs[#jobs + 1] = shape, shape, shape
  end
  return shapes[key]
end

-- Adds the shapes that are tried for an aim.
local function add_shapes(jobs, level, aim)
  local kids = {}
  for i, node in ipairs(level.composite.nodes) do
    kids[i] = node.level and node.level.kept[aim]
  end
  for _, deal in ipairs(deals_of(level, aim, kids)) do
    level.kept[aim] = add_shape(jobs, level, aim, deal, kids)
  end
end

-- Makes the regions in a composite equally high, or equally wide if their arrows lead
-- from left to right.
local function align_regions(composite)
  local height, width, regions = 0, 0, {}
  for _, node in ipairs(composite.nodes) do
    if node.is_region and node.level then
      regions[#regions + 1] = node
      height, width = max(height, node.level.height), max(width, node.level.width)
    end
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

local function prepare(shape)
  local deal = shape.deal
  for _, kid in order.each(shape.kids) do put(kid) end -- any order
  align_regions(shape.composite)
  if deal == "turned" then
    shape.direction = "LR"
    spread(shape)
  elseif deal ~= "plain" then
    rows.apply(shape, deal, boxes_of(shape, shape.kids))
  end
  put(shape)
end

-- Lays out levels of one height in the shapes for some aims. The first shape of a level
-- is turned if it would be far too long.
local function lay_out_height(list, aims, run)
  local jobs = {}
  for _, level in ipairs(list) do
    level.shapes, level.kept = level.shapes or {}, {}
    if aims[2] then rows.prepare(level) end
    for _, aim in ipairs(aims) do add_shapes(jobs, level, aim) end
  end
  local problem = jobs[1] and graphs.lay_out(jobs, run, prepare, rows.draw)
  for _, level in ipairs(problem and {} or list) do
    local plain = level.shapes[1]
    local length, depth = lines.size_of(plain, lines.axis_of(plain))
    if length <= 2 * depth then level.kept.first = plain end
  end
  return problem
end

-- Returns lists of levels. A level in the first list contains no other level; a level
-- in the second list contains only levels of the first list, and so on. The level
-- around the root is there if an arrow is in it, or if the root is a leaf.
local function by_height(chart)
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

-- Is a chart larger than its sheet, by Graphviz alone and, if it has no composites, in
-- its first shape, too?
local function is_large(chart, heights)
  local first = not heights[2] and heights[1][1].kept.first
  return chart.kind == "sheet"
    or not (chart.whole and choice.is_readable(chart.whole, chart.sheet))
    and not (first and choice.is_readable(first, chart.sheet))
end

-- Public functions ------------------------------------------------------------

--- Lay out all levels of a chart, each in its first shape, or in several shapes if the
-- chart `is_large`, as the first run shows. Return a problem if there is one.
---@return string? problem
function sheet.lay_out(chart, run)
  local keys, heights, aims = {}, by_height(chart), { "first" }
  local problem = lay_out_height(heights[1], aims, run)
  if problem then return problem end
  for i, aim in ipairs(is_large(chart, heights) and AIMS or {}) do
    aims[i + 1] = aim
  end
  aims[#aims + 1] = chart.kind == "sheet" and "former" or nil
  for _, list in ipairs(heights) do
    problem = lay_out_height(list, aims, run)
    if problem then return problem end
    for _, level in ipairs(list) do keep_best(level, chart.sheet, keys) end
  end
  chart.outer = heights[#heights][1]
end

--- Return the best layout of a chart: one of its shapes, or the plain layout.
function sheet.best(chart)
  local outer, whole = chart.outer, chart.whole
  local kept, layouts = outer.kept, { outer.kept.first, whole }
  layouts[#layouts + 1] = kept.scale -- of equal ones the largest
  for _, shape in ipairs(outer.shapes) do layouts[#layouts + 1] = shape end
  local former = { levels = kept.first, plain = whole, sheet = kept.former }
  return choice.best(layouts, crossings_of, chart.sheet, former[chart.kind])
end

--- Put a shape and those in it. The nodes note them, so that the picture has them.
function sheet.put(shape)
  local composite, deal = shape.composite, shape.deal
  put(shape)
  for i, node in ipairs(composite.nodes) do
    node.row = deal == "turned" and 0 or type(deal) == "table" and deal[i] or nil
    if shape.kids[i] then sheet.put(shape.kids[i]) end
  end
  align_regions(composite)
end

return sheet
