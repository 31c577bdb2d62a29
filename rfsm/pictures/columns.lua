--- Columns: a chain of nodes that is too long is divided into parts side by side.
--
-- A column has a part of the nodes, in the order of the walk from `initial`. It is a
-- composite without a frame, whose nodes Graphviz lays out. Between a column and the
-- next one there is one arrow at most, in either direction. Its line leaves the first
-- column at the lower end, runs up in the channel between the columns, and enters the
-- next column from above. If the direction is LR, the columns are rows.
--
-- Positions have two coordinates: `u` goes *across*, from column to column, and `v`
-- *along*, from the upper end of the columns to the lower end.
--
-- @module rfsm.pictures.columns
-- @license BSD-3-Clause

local lines = require "rfsm.pictures.lines"
local links = require "rfsm.pictures.links"

local abs, floor, ipairs, log = math.abs, math.floor, ipairs, math.log
local max, min = math.max, math.min

local columns = {}

local RATIO = 4 / 3 -- of width to height: the best shape

local function misfit_of(width, height)
  return abs(log(width / height / RATIO))
end

--- Return how much the ratio of width to height of a level differs from `RATIO`.
function columns.misfit(level) return misfit_of(level.width, level.height) end

-- Columns: which nodes are in them --------------------------------------------

-- Returns two sizes of a box: across the columns, and along them.
local function size_of(box, direction)
  if direction == "TB" then return box.width, box.height end
  return box.height, box.width
end

-- Lengths in points: about the width of the channel between two columns, about the
-- height of the lines above and below columns, and the distance between lines.
local CHANNEL, TRACKS, PITCH = 40, 60, 8

-- Returns a list with the number of the column of each node. The nodes are divided
-- among `count` columns of equal length.
local function deal(level, count)
  local numbers, is_down = {}, level.direction == "TB"
  local length = is_down and level.inner_height or level.inner_width
  for i, box in ipairs(level.boxes) do
    local along = is_down and length - box.y or box.x
    numbers[i] = min(count, 1 + floor(along / length * count))
  end
  return numbers
end

-- Is there at most one arrow between neighbouring columns, and none between others?
local function is_chain(level, numbers)
  local is_linked = {}
  for _, link in ipairs(level.links) do
    local last = numbers[link.lower.node.index]
    local first = link.upper and numbers[link.upper.node.index] or last
    if first ~= last then
      if last ~= first + 1 or is_linked[last] then return false end
      is_linked[last] = true
    end
  end
  return true
end

--- Return a list with the number of the column of each node of a level. Return nil if
-- arrows cross the frame of the level, if columns do not improve its shape, or if the
-- arrows between them form no chain.
function columns.plan(level)
  if level.gates[1] then return nil end
  local across, length = size_of(level, level.direction)
  local best, least = nil, columns.misfit(level)
  for count = 2, #level.boxes do
    local width, height = (across + CHANNEL) * count, length / count + TRACKS
    if level.direction == "LR" then width, height = height, width end
    local misfit, numbers = misfit_of(width, height), deal(level, count)
    if misfit > least then break end
    best, least = is_chain(level, numbers) and numbers or best, misfit
  end
  return best
end

--- Put node i of a level into column numbers[i]. Return the levels of the columns.
function columns.split(level, numbers)
  local composite, nodes, levels = level.composite, {}, {}
  for i, node in ipairs(composite.nodes) do
    local number = numbers[i]
    local column = nodes[number]
    if not column then
      column = { kind = "composite", is_column = true, parent = composite,
        index = number, nodes = {} }
      column.level = links.new_level(column, level.direction)
      nodes[number], levels[number] = column, column.level
    end
    node.parent, node.index = column, #column.nodes + 1
    column.nodes[node.index] = node
  end
  composite.nodes = nodes
  links.renew(level)
  return levels
end

-- Places: of the columns, and of the arrows between them -----------------------

-- Places the columns side by side, each behind its channel. Returns a list of places,
-- and the total size: across and along.
local function place_columns(level)
  local list, into, u, length = {}, {}, 0, 0
  for _, link in ipairs(level.links) do into[link.lower.node.index] = link end
  for i, column in ipairs(level.composite.nodes) do
    local link, place = into[i], { column = column, link = into[i] }
    local label = link and link.arrow.label_box
    place.channel = u + 2 * PITCH
    u = i > 1 and place.channel + PITCH or 0
    u = label and u + size_of(label, level.direction) + 4 or u
    place.u = u
    local width, height = size_of(column.level, level.direction)
    list[i], u, length = place, u + width, max(length, height)
  end
  return list, u, length
end

-- Returns the corners of the line into a column from the column before it. at(u, v)
-- returns the point for a position. The columns begin at v = `top`; `foot` is the end
-- of the longest column.
local function corners_of(at, before, place, top, foot, direction)
  local link = place.link
  local _, from = size_of(before.column.level, direction)
  local u, tgt = before.u + link.upper.gate.offset, place.u + link.lower.gate.offset
  return { at(u, top + from), at(u, foot + PITCH), at(place.channel, foot + PITCH),
    at(place.channel, top - PITCH), at(tgt, top - PITCH), at(tgt, top) }
end

-- Sets the line of the arrow into a column, and the place of its label in the channel.
local function place_link(at, before, place, top, foot, direction)
  local link, label = place.link, place.link.arrow.label_box
  link.points = lines.rounded(corners_of(at, before, place, top, foot, direction))
  if label then
    local width, height = size_of(label, direction)
    link.label_at = at(place.channel + 3 + width / 2, foot - height / 2)
  end
end

-- Sets the size of a level, and the place of its header.
local function measure(level, across, along, header)
  if level.direction == "LR" then
    across, along = along, across + (header and header.height + PITCH or 0)
  end
  level.inner_width, level.inner_height = max(across, header and header.width or 0),
    along
  level.header = header and { x = level.inner_width / 2,
    y = level.inner_height - header.height / 2 }
end

--- Place the columns of a level, and the arrows between them. `header` is the size of
-- the name of the level and the rows below the name.
function columns.arrange(level, header)
  local is_down, direction = level.direction == "TB", level.direction
  local places, across, length = place_columns(level)
  local top = 2 * PITCH + (header and is_down and header.height + PITCH or 0)
  local foot = top + length
  local along = foot + 2 * PITCH
  local function at(u, v)
    if is_down then return { u, along - v } end
    return { v, across - u }
  end
  for i, place in ipairs(places) do
    local width, height = size_of(place.column.level, direction)
    local middle = at(place.u + width / 2, top + height / 2)
    level.boxes[i] = { x = middle[1], y = middle[2] }
    if place.link then place_link(at, places[i - 1], place, top, foot, direction) end
  end
  measure(level, across, along, header)
end

return columns
