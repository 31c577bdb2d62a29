--- Columns: a level that is too long is divided into parts side by side.
--
-- A column has a part of the nodes, in the order of the walk from `initial`. It is a
-- composite without a frame, which Graphviz lays out. An arrow from a column to a later
-- one leaves it below, runs up in the channel before the other one, and enters that
-- from above. One that leads back takes the same way in the other direction. If the
-- direction is LR, the columns are rows.
--
-- Positions have two parts: `u` runs across, from column to column, and `v` along, from
-- the upper end of the columns to the lower one.
--
-- @module rfsm.pictures.columns
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"
local lines = require "rfsm.pictures.lines"
local links = require "rfsm.pictures.links"

local abs, ipairs, log, max = math.abs, ipairs, math.log, math.max

local columns = {}

columns.RATIO = 4 / 3 -- of width to height

local function misfit_of(width, height)
  return abs(log(width / height / columns.RATIO))
end

--- Return how far a level is from the ratio that is aimed at; 0 if it has it.
function columns.misfit(level) return misfit_of(level.width, level.height) end

-- Columns: which nodes are in them --------------------------------------------

-- Returns the size of a box: across and along.
local function size_of(box, direction)
  if direction == "TB" then return box.width, box.height end
  return box.height, box.width
end

-- Points, about: behind a node, behind an initial, beside a column, beside a line that
-- passes a node, above and below all columns; the size of a character of a label.
local GAP, START, CHANNEL, PASS, TRACKS, CHARACTER, LINE = 35, 18, 20, 30, 60, 5.5, 14
local PITCH = 8 -- between tracks

local function label_width(level)
  local most = 0
  for _, link in ipairs(level.links) do
    for _, line in ipairs(diagram.label_lines(link.arrow)) do
      most = max(most, #line)
    end
  end
  return most * CHARACTER
end

-- Returns the space between nodes in a column, and that beside them: labels are beside
-- the lines, which run through the middle of columns.
local function gaps_of(level, across, label)
  if level.direction == "LR" then return GAP + label, CHANNEL end
  return GAP, max(0, label - across / 2) + CHANNEL
end

-- Returns how long each node of a level is in its column, with the space behind it.
local function lengths_of(level, gap)
  local lengths = {}
  for i, box in ipairs(level.boxes) do
    local node, _, length = level.composite.nodes[i], size_of(box, level.direction)
    lengths[i] = length + (node.kind == "initial" and START or gap)
  end
  return lengths
end

-- Fills columns up to a length. Returns the number of the column of each node.
local function fill(lengths, most)
  local numbers, number, sum = {}, 1, 0
  for i, length in ipairs(lengths) do
    sum = sum + length
    if sum > most and i > 1 then number, sum = number + 1, length end
    numbers[i] = number
  end
  return numbers
end

-- Deals nodes into columns, of which the longest is as short as it can be. Returns the
-- number of the column of each node, and the length of the longest column.
local function deal(lengths, count)
  local least, most = 0, 1
  for _, length in ipairs(lengths) do
    least, most = max(least, length), most + length
  end
  while most - least > 1 do
    local middle = (least + most) / 2
    local numbers = fill(lengths, middle)
    if numbers[#numbers] > count then least = middle else most = middle end
  end
  return fill(lengths, most), most
end

-- Counts the arrows from column to column, and the nodes in columns that these pass.
local function crossing_of(level, numbers)
  local crossing, passing = 0, 0
  for _, link in ipairs(level.links) do
    local upper, lower = link.upper and link.upper.node, link.lower.node
    local i, j = upper and upper.index, lower and lower.index
    if upper and lower and numbers[i] ~= numbers[j] then
      crossing = crossing + 1
      if numbers[i + 1] == numbers[i] then passing = passing + 1 end
      if numbers[j - 1] == numbers[j] then passing = passing + 1 end
    end
  end
  return crossing, passing
end

local MOST = 2 -- arrows between columns, for each channel

--- Return the number of the column for each node of a level, nil if columns do not fit:
-- if too many arrows would lead from one to the other.
function columns.plan(level)
  local across, direction, label = 0, level.direction, label_width(level)
  for _, box in ipairs(level.boxes) do
    across = max(across, (size_of(box, direction)))
  end
  local gap, room = gaps_of(level, across, label)
  local lengths, best, least = lengths_of(level, gap), nil, columns.misfit(level)
  for count = 2, #level.boxes do
    local numbers, length = deal(lengths, count)
    local crossing, passing = crossing_of(level, numbers)
    local width, height = (across + room) * count
      + crossing * (PITCH + (direction == "TB" and label or LINE)) + passing * PASS,
      length + TRACKS
    if direction == "LR" then width, height = height, width end
    local cost = misfit_of(width, height) + crossing / max(1, #level.links)
    if cost > least then break end
    best, least = crossing <= MOST * (count - 1) and numbers or nil, cost
  end
  return best
end

--- Put the nodes of a level into columns, of which each node has the number; return the
-- levels of the columns.
function columns.split(chart, level, numbers)
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
  links.renew(chart, level)
  return levels
end

-- Tracks: where the arrows between columns run --------------------------------

-- Gives each link a track from one column to another; links that do not meet may share
-- one. Returns the size of the tracks.
local function assign_tracks(crossing, first, last, field)
  local ends, count = {}, 0
  for _, link in ipairs(crossing) do
    local track = 1
    while ends[track] and ends[track] >= first(link) do track = track + 1 end
    ends[track], link[field], count = last(link), track, max(count, track)
  end
  return count > 0 and (count + 1) * PITCH or 0
end

local function src_column(link) return link.upper.node.index end
local function tgt_column(link) return link.lower.node.index end

-- The places of columns and tracks in a level.
local function new_grid(level)
  local grid = { level = level, direction = level.direction, crossing = {}, u = {} }
  for _, link in ipairs(level.links) do
    if link.upper.node and link.lower.node then
      grid.crossing[#grid.crossing + 1] = link
    end
  end
  links.sort_by(grid.crossing, src_column)
  grid.below = assign_tracks(grid.crossing, src_column, function(link)
    return tgt_column(link) - 0.5
  end, "below")
  links.sort_by(grid.crossing, tgt_column)
  grid.above = assign_tracks(grid.crossing, tgt_column, tgt_column, "above")
  return grid
end

-- Places the columns across, each behind the tracks in its channel.
local function place_across(grid, from)
  local u, length = from, 0
  for i, column in ipairs(grid.level.composite.nodes) do
    if i > 1 then u = u + 2 * PITCH end
    for _, link in ipairs(grid.crossing) do
      if link.lower.node == column then
        local label = link.arrow.label_box
        link.u = u
        u = u + PITCH + (label and size_of(label, grid.direction) + 4 or 0)
      end
    end
    local width, height = size_of(column.level, grid.direction)
    grid.u[i] = u
    u, length = u + width, max(length, height)
  end
  grid.across, grid.length = u, length
end

-- Makes room for name and rows: above the columns, or beside them if an arrow leads up
-- from a column to the frame.
local function place_header(grid, header)
  local from = 0
  grid.start = grid.above
  if header and grid.direction == "TB" then
    grid.start = grid.start + header.height + PITCH
    for _, link in ipairs(grid.level.links) do
      if not link.upper.node then from = header.width + PITCH end
    end
  end
  place_across(grid, from)
  if header and grid.direction == "TB" then
    grid.across = max(grid.across, header.width)
  end
  grid.foot = grid.start + grid.length
  grid.along = grid.foot + grid.below
  return from > 0
end

local function point_at(grid, u, v)
  if grid.direction == "TB" then return { u, grid.along - v } end
  return { v, grid.across - u }
end

-- Returns where a link meets a column: across, and along.
local function foot_of(grid, finish, is_upper)
  local column = finish.node
  local _, length = size_of(column.level, grid.direction)
  return grid.u[column.index] + finish.gate.offset,
    grid.start + (is_upper and length or 0)
end

-- Returns the corners of a link between columns, or to a gate of the level.
local function corners_of(grid, link)
  local function at(u, v) return point_at(grid, u, v) end
  if not link.upper.node then
    local u, v = foot_of(grid, link.lower, false)
    link.upper.gate.at = at(u, 0)
    return { at(u, 0), at(u, v) }
  end
  local u, v = foot_of(grid, link.upper, true)
  if not link.lower.node then
    link.lower.gate.at = at(u, grid.along)
    return { at(u, v), at(u, grid.along) }
  end
  local below, above = grid.foot + link.below * PITCH, grid.start - link.above * PITCH
  local tgt, top = foot_of(grid, link.lower, false)
  local label = link.arrow.label_box
  if label then
    link.label_at = at(link.u + 3 + size_of(label, grid.direction) / 2,
      (below + above) / 2)
  end
  return { at(u, v), at(u, below), at(link.u, below), at(link.u, above), at(tgt, above),
    at(tgt, top) }
end

--- Place the columns of a level, and the arrows between them; `header` is the size of
-- its name and rows.
function columns.arrange(level, header)
  local grid = new_grid(level)
  local is_beside = place_header(grid, header)
  for i, column in ipairs(level.composite.nodes) do
    local width, height = size_of(column.level, grid.direction)
    local middle = point_at(grid, grid.u[i] + width / 2, grid.start + height / 2)
    level.boxes[i] = { x = middle[1], y = middle[2] }
  end
  for _, link in ipairs(level.links) do
    link.points = lines.rounded(corners_of(grid, link))
  end
  level.inner_width, level.inner_height = size_of({ width = grid.across,
    height = grid.along }, grid.direction)
  if not header then return end
  if grid.direction == "LR" then
    level.inner_height = level.inner_height + header.height + PITCH
    level.inner_width = max(level.inner_width, header.width)
  end
  level.header = { x = is_beside and header.width / 2 or level.inner_width / 2,
    y = level.inner_height - header.height / 2 }
end

return columns
