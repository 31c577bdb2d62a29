--- A layout for a sheet: several shapes of each level, and the best combination.
--
-- Bottom-up, each level gets *shapes*: the one of `rfsm.pictures.levels`, then rows of
-- different ratios. One shape is kept for each aim: little area, a large scale on the
-- sheet, little height, little width. The shapes of all levels of one height are laid
-- out in one run of Graphviz. Levels with the same states have the same shapes.
--
-- @module rfsm.pictures.sheet
-- @license BSD-3-Clause

local choice = require "rfsm.pictures.choice"
local graphs = require "rfsm.pictures.graphs"
local levels = require "rfsm.pictures.levels"
local lines = require "rfsm.pictures.lines"
local rows = require "rfsm.pictures.rows"

local abs, huge, ipairs, pairs = math.abs, math.huge, ipairs, pairs
local concat, max, type = table.concat, math.max, type

local sheet = {}

--- A way to lay out a level, with the fields of the level, of its gates and its links.
---@class rfsm.pictures.Shape
---@field level rfsm.pictures.Level
---@field kids table<integer, rfsm.pictures.Shape> the shapes of the composites in it
---@field deal integer[]|"first"|"plain"|"turned" the row of each node, or no rows
---@field key string the same for shapes with the same rows
---@field crossings number in the level and in its kids; huge if a line covers a box

-- Shapes: what is kept of a level ---------------------------------------------

local OF_LEVEL = { "direction", "boxes", "arches", "header", "inner_width",
  "inner_height", "width", "height", "x", "y", "is_spread", "rows", "run_of" }
local OF_GATE = { "at", "x", "y", "offset" }
local OF_LINK = { "upper", "lower", "is_turned", "is_straight", "points", "tip",
  "label_at" }

local function copy(from, fields, to)
  for _, field in ipairs(fields) do to[field] = from[field] end
  return to
end

local function copy_all(from, fields, to)
  for i, element in ipairs(from) do to[i] = copy(element, fields, to[i] or {}) end
  return to
end

-- Notes in a shape how its level is laid out now.
local function take(shape)
  local level = shape.level
  copy(level, OF_LEVEL, shape)
  shape.gates = copy_all(level.gates, OF_GATE, {})
  shape.links = copy_all(level.links, OF_LINK, {})
  shape.nodes = copy_all(level.composite.nodes, { "least" }, {})
end

-- Lays out a level as noted in a shape.
local function put(shape)
  local level = shape.level
  copy(shape, OF_LEVEL, level)
  level.header = shape.header and copy(shape.header, { "x", "y" }, {})
  copy_all(shape.gates, OF_GATE, level.gates)
  copy_all(shape.links, OF_LINK, level.links)
  copy_all(shape.nodes, { "least" }, level.composite.nodes)
end

local function put_all(shape)
  put(shape)
  for _, kid in pairs(shape.kids) do put_all(kid) end -- any order
  levels.align_regions(shape.level.composite)
end

local function text_of(deal)
  return type(deal) == "table" and concat(deal, " ") or deal
end

-- Returns a shape that is not laid out yet. `deal` is the row of each node; or a word.
local function new_shape(level, kids, deal)
  local texts = { text_of(deal) }
  for i in ipairs(level.composite.nodes) do
    texts[#texts + 1] = kids[i] and kids[i].key
  end
  return { level = level, kids = kids, deal = deal, key = concat(texts, "(") .. ")" }
end

-- Judging ---------------------------------------------------------------------

-- Does a line run through a box that is not its end?
local function is_covering(level, link)
  local flat = lines.flat(link.points)
  for i, box in ipairs(level.boxes) do
    local node = level.composite.nodes[i]
    local is_end = link.upper and link.upper.node == node or link.lower.node == node
    for _, point in ipairs(is_end and {} or flat) do
      if abs(point[1] - box.x) < box.width / 2 - 3
        and abs(point[2] - box.y) < box.height / 2 - 3 then return true end
    end
  end
  return false
end

-- Returns the lines of a level: its links, and from each gate to the frame, since
-- Graphviz does not always put gates into the first or the last rank.
local function lines_in(level)
  local list, axis = {}, level.direction == "TB" and 2 or 1
  for _, link in ipairs(level.links) do
    list[#list + 1] = not link.is_loop and link or nil
  end
  for _, gate in ipairs(level.gates) do
    local at, border = gate.at, { gate.at[1], gate.at[2] }
    local far = axis == 2 and level.inner_height or level.inner_width
    border[axis] = gate.is_upper == (axis == 2) and far or 0
    local line = {}
    lines.join(line, { at })
    lines.join(line, { border })
    if line[2] then list[#list + 1] = { points = line, lower = {} } end
  end
  return list
end

-- Counts the crossings in a shape; huge if a line covers a box.
local function count_crossings(shape)
  local list = lines_in(shape.level)
  for _, line in ipairs(list) do
    if is_covering(shape.level, line) then return huge end
  end
  local count = choice.measure { lines = list }
  for _, kid in pairs(shape.kids) do count = count + kid.crossings end -- any order
  return count
end

-- Choosing --------------------------------------------------------------------

local AIMS = { "area", "scale", "more", "height", "width" }

local function misfit_of_scale(shape, size)
  return -choice.scale(size, shape.width, shape.height)
end

-- How badly a shape serves an aim. "more" is a scale at the price of crossings.
local MISFITS = { scale = misfit_of_scale, more = misfit_of_scale,
  area = function(shape) return shape.width * shape.height end,
  height = function(shape) return shape.height + shape.width / 50 end,
  width = function(shape) return shape.width + shape.height / 50 end,
}

local SLACK = 2 -- crossings that the aim "more" allows in an inner level

-- Returns the most crossings of a level for an aim; `limits` are those of the picture.
local function most_of(level, aim, limits)
  local is_outer = (level.composite.depth or 0) == 0
  if is_outer then return aim == "more" and limits.more or limits.same end
  return level.first.crossings + (aim == "more" and SLACK or 0)
end

-- Sets the field `kept` of a level: for each aim the shape that serves it best. It is
-- the last one if that is fixed.
local function keep_best(level, size, limits, is_fixed)
  local only = is_fixed and level.shapes[#level.shapes]
  for _, aim in ipairs(AIMS) do
    local best, least = level.first, huge
    if only and only.crossings < huge then best, least = only, -huge end
    for _, shape in ipairs(level.shapes) do
      local misfit = MISFITS[aim](shape, size)
      if shape.crossings <= most_of(level, aim, limits) and misfit < least - 0.001 then
        best, least = shape, misfit
      end
    end
    level.kept[aim] = best
  end
end

-- Jobs: shapes that are not laid out yet --------------------------------------

local LARGE = 100 -- bent links; a level with more is not put into rows

-- Returns a box for each node of a level, with the given shapes in it.
local function boxes_of(level, kids)
  local boxes = {}
  for i, box in ipairs(level.first.boxes) do boxes[i] = kids[i] or box end
  return boxes
end

-- Can a level run from left to right? Regions stay side by side.
local function can_be_turned(level)
  local composite = level.composite
  return level.base == "TB" and levels.is_closed(level)
    and not (composite.is_region or composite.nodes[1].is_region)
end

-- Returns the deals that are tried for a level with the given shapes in it. `fixed` is
-- the only one if it is given.
local function deals_of(level, kids, fixed)
  local can_turn = can_be_turned(level)
  if fixed then return { fixed == "turned" and not can_turn and "plain" or fixed } end
  local nodes, deals = level.composite.nodes, {}
  if nodes[2] and not nodes[1].is_region and level.bent <= LARGE then
    deals = rows.deals(level, boxes_of(level, kids))
  end
  deals[#deals + 1], deals[#deals + 2] = "plain", can_turn and "turned" or nil
  return deals
end

local function kids_of(level, f)
  local kids = {}
  for i, node in ipairs(level.composite.nodes) do
    kids[i] = node.level and f(node.level)
  end
  return kids
end

-- Returns the shape that a level has got from `rfsm.pictures.levels`.
local function first_shape(level)
  local kids = kids_of(level, function(kid) return kid.first end)
  local shape = new_shape(level, kids, "first")
  take(shape)
  shape.crossings = count_crossings(shape)
  return shape
end

-- Adds the jobs of a level, of which fixed(level) may be the only deal.
local function add_jobs(jobs, level, fixed)
  local seen = {}
  level.shapes, level.kept = { level.first }, {}
  for _, aim in ipairs(AIMS) do
    local kids = kids_of(level, function(kid) return kid.kept[aim] end)
    for _, deal in ipairs(deals_of(level, kids, fixed(level))) do
      local job = new_shape(level, kids, deal)
      if not seen[job.key] and deal ~= "first" then jobs[#jobs + 1] = job end
      seen[job.key] = true
    end
  end
end

local function prepare(job)
  local level, deal = job.level, job.deal
  for _, kid in pairs(job.kids) do put(kid) end -- any order
  levels.align_regions(level.composite)
  levels.reset(level, level.base)
  level.is_tight = true
  if deal == "turned" then
    levels.turn(level)
  elseif deal ~= "plain" then
    rows.apply(level, deal, boxes_of(level, job.kids))
  end
end

-- Lays out jobs, and adds their shapes to those of their levels.
local function lay_out(jobs, run)
  return jobs[1] and graphs.lay_out(jobs, run, prepare, function(job)
    local level = job.level
    levels.draw_loops(level)
    rows.draw(level)
    take(job)
    job.crossings = count_crossings(job)
    level.shapes[#level.shapes + 1] = job
  end)
end

-- Same states, same shape -----------------------------------------------------

-- Returns the names of the states in a level; nil if there is a composite in it.
local function names_in(level)
  local names = {}
  for i, node in ipairs(level.composite.nodes) do
    if node.level then return nil end
    names[i] = node.name
  end
  return concat(names, "\n")
end

-- Lists the deals in a shape, by the names of the states that are dealt.
local function list_deals(shape, lists)
  local names = names_in(shape.level)
  if names then
    lists[names] = lists[names] or {}
    lists[names][#lists[names] + 1] = shape.deal
  end
  for i in ipairs(shape.level.composite.nodes) do
    if shape.kids[i] then list_deals(shape.kids[i], lists) end
  end
  return lists
end

-- Returns the deal that is most often in a list.
local function most_common(list)
  local counts, best = {}, list[1]
  for _, deal in ipairs(list) do
    local text = text_of(deal)
    counts[text] = (counts[text] or 0) + 1
    if counts[text] > counts[text_of(best)] then best = deal end
  end
  return best
end

-- Public functions ------------------------------------------------------------

--- Lay out a chart that `rfsm.pictures.levels` has laid out. `limits.same` and
-- `limits.more` are the most crossings, and the most if the text is larger.
-- fixed(level) may return the only deal of a level. Return a problem if there is one,
-- else the shapes of the picture.
---@return string? problem
---@return rfsm.pictures.Shape[] shapes
function sheet.shapes_of(chart, limits, run, fixed)
  local top, heights = chart.top.level, levels.by_height(chart)
  if not top.links[1] then heights[#heights] = nil end
  for _, list in ipairs(heights) do
    local jobs = {}
    for _, level in ipairs(list) do
      level.base, level.first = chart.direction, level.first or first_shape(level)
      levels.reset(level, chart.direction)
      rows.prepare(level)
      add_jobs(jobs, level, fixed)
    end
    local problem = lay_out(jobs, run)
    if problem then return problem end
    for _, level in ipairs(list) do
      keep_best(level, chart.sheet, limits, fixed(level))
    end
  end
  return nil, heights[#heights][1].shapes
end

--- Return a function for `fixed` that gives levels with the same states the deal that
-- most of them have in a shape; nil if all of them have it.
function sheet.alike(shape)
  local lists, are_alike = list_deals(shape, {}), true
  for _, list in pairs(lists) do -- any order
    for _, deal in ipairs(list) do
      are_alike = are_alike and text_of(deal) == text_of(list[1])
    end
  end
  return not are_alike and function(level)
    local list = lists[names_in(level) or false]
    return list and list[2] and most_common(list)
  end or nil
end

-- Returns the rows of a level in a former picture. A new node is in the row of the node
-- before it. A node that cannot be in its row begins another one.
local function former_rows(level)
  local numbers, last, first, shift = {}, 1, 1, 0
  for i, node in ipairs(level.composite.nodes) do
    local number = max(last, node.row and node.row + shift or last)
    if number == last and (level.bounds[i] or 0) >= first then
      number, shift = number + 1, shift + 1
    end
    first = number > last and i or first
    numbers[i], last = number, number
  end
  return numbers
end

--- Return the deal that a level has in a former picture, for `fixed`.
function sheet.former(level)
  if level.composite.is_turned then return "turned" end
  for _, node in ipairs(level.composite.nodes) do
    if node.row then return former_rows(level) end
  end
  return "plain"
end

-- Notes the shapes in the nodes, so that the picture has them.
local function note(shape)
  local composite, deal = shape.level.composite, shape.deal
  composite.is_turned = deal == "turned" or nil
  for i, node in ipairs(composite.nodes) do
    node.row = type(deal) == "table" and deal[i] or nil
    if shape.kids[i] then note(shape.kids[i]) end
  end
end

--- Lay out a chart as in a shape of it.
function sheet.put(chart, shape)
  put_all(shape)
  note(shape)
  if shape.level ~= chart.top.level then levels.enclose(chart.top.level) end
end

return sheet
