--- Rows: the nodes of a level in rows, one below the other, as words on a page.
--
-- Every second row runs backward, so that a chain goes to and fro. Only neighbours in a
-- row may be linked, and only without gates. Linked neighbours are a *run*: arrows
-- between them are straight, each with its label above it. For Graphviz a run is one
-- box, with a port for each other link, which leads to another row. If the direction is
-- LR, rows are columns, and a label is at the right of its arrow.
--
-- Axes: x is 1, y is 2. `run` is the axis along which rows run.
--
-- @module rfsm.pictures.rows
-- @license BSD-3-Clause

local lines = require "rfsm.pictures.lines"
local order = require "rfsm.shared.order"

local ceil, ipairs, max, min = math.ceil, ipairs, math.max, math.min
local concat, insert, sqrt = table.concat, table.insert, math.sqrt

local rows = {}

--- The room between two neighbours in a row.
---@class rfsm.pictures.Room
---@field links rfsm.pictures.Link[]
---@field offsets number[] how far each line is from the middle of the row
---@field span number points from the first line to the last
---@field length number along the row
---@field depth number across the row

--- Linked neighbours in a row.
---@class rfsm.pictures.RunOfNodes
---@field id string
---@field first integer the first node
---@field nodes integer[] from left to right, or from the top
---@field width number
---@field height number
---@field at number[] how far the middle of each node is from the beginning of the run

local axis_of, size_of = lines.axis_of, lines.size_of

-- Rooms: what can be straight -------------------------------------------------

-- Returns the two nodes of a link, in their order; nil if it ends at a gate outside.
local function nodes_of(link)
  local a, b = link.upper.node, link.lower.node
  if not (a and b) or a == b then return nil end
  if a.index > b.index then a, b = b, a end
  return a, b
end

local function can_be_straight(link, a, b)
  return b.index == a.index + 1 and not (link.upper.gate or link.lower.gate)
    and a.kind ~= "connector" and b.kind ~= "connector"
    and not (a.has_loop or b.has_loop)
end

local PAD, GAP = 14, 4 -- points: beside a label, between a line and the next label

-- Returns the room for links, with a label for each above its line.
local function room_of(list, run)
  local offsets, span, longest, first = {}, 0, 0, 0
  for i, link in ipairs(list) do
    local length, depth = size_of(link.arrow.size, run)
    span, first = i > 1 and span + depth + GAP or 0, i == 1 and depth or first
    offsets[i], longest = -span, max(longest, length)
  end
  for i, offset in ipairs(offsets) do offsets[i] = offset + span / 2 end
  return { links = list, offsets = offsets, span = span,
    length = ceil(longest) + 2 * PAD, depth = span + 2 * first + GAP }
end

local HIGHEST = 20 -- points between the outer ones of straight lines

local function separate(level, a, b, count)
  level.bounds[b] = max(level.bounds[b] or 0, a)
  level.bent = level.bent + count
end

--- Give a level the fields `bounds`, `rooms` and `bent`. bounds[i] is the last node
-- before node i that cannot be in one row with it, rooms[i] the room for links between
-- the nodes i and i + 1. `bent` counts the links that can never be straight.
function rows.prepare(level)
  local pairs_of = {}
  level.bounds, level.rooms, level.bent = {}, {}, 0
  for _, link in ipairs(level.links) do
    local a, b = nodes_of(link)
    if a and can_be_straight(link, a, b) then
      order.append(pairs_of, a.index, link)
    elseif a then
      separate(level, a.index, b.index, 1)
    end
  end
  for i = 1, #level.composite.nodes - 1 do
    local room = room_of(pairs_of[i] or {}, axis_of(level))
    if room.span > HIGHEST then
      separate(level, i, i + 1, #room.links)
      room = room_of({}, axis_of(level))
    end
    level.rooms[i] = room
  end
end

-- Deal: which node is in which row --------------------------------------------

local BETWEEN = 36 -- points between rows, about

-- Deals nodes to rows that are not longer than `most` if possible. lengths[i] is the
-- length of node i with the room before it. Returns the row of each node.
local function deal(lengths, bounds, most)
  local numbers, number, first, sum = {}, 1, 1, 0
  for i, length in ipairs(lengths) do
    if i > 1 and (sum + length > most or (bounds[i] or 0) >= first) then
      number, first, sum = number + 1, i, 0
    end
    numbers[i], sum = number, sum + length
  end
  return numbers
end

local RATIOS = { 0.35, 0.5, 0.7, 1, 1.4, 2, 3 } -- of width to height

--- Return a few ways to deal the nodes of a level to rows, with different ratios of
-- width to height. Each is a list with the row of each node.
function rows.deals(level, boxes)
  local found, seen, lengths, area, run = {}, {}, {}, 0, axis_of(level)
  for i, box in ipairs(boxes) do
    local length, depth = size_of(box, run)
    lengths[i] = length + (i > 1 and level.rooms[i - 1].length or 0)
    area = area + lengths[i] * (depth + BETWEEN)
  end
  for _, ratio in ipairs(RATIOS) do
    local most = sqrt(area * (run == 1 and ratio or 1 / ratio))
    local numbers = deal(lengths, level.bounds, most)
    local key = concat(numbers, " ")
    found[#found + 1], seen[key] = not seen[key] and numbers or nil, true
  end
  return found
end

-- Runs: what is where in a row ------------------------------------------------

-- Sets the size of a run, and the places of its nodes.
local function measure(level, run, boxes)
  local axis, length, depth, last = axis_of(level), 0, 0, nil
  for _, i in ipairs(run.nodes) do
    local room = last and level.rooms[min(last, i)]
    local size, across = size_of(boxes[i], axis)
    length, last = length + (room and room.length or 0), i
    run.at[i], depth = length + size / 2, max(depth, across, room and room.depth or 0)
    length = length + size
  end
  run.width, run.height = ceil(length), ceil(depth)
  if axis == 2 then run.width, run.height = run.height, run.width end
end

--- Put the nodes of a level into rows: numbers[i] is the row of node i, boxes[i] its
-- size. `level.rows` lists the runs of each row, `level.run_of` has the run of each
-- node that has neighbours in it.
function rows.apply(level, numbers, boxes)
  local run
  level.rows, level.run_of, level.sizes = {}, {}, boxes
  for i, number in ipairs(numbers) do
    if numbers[i - 1] == number and level.rooms[i - 1].links[1] then
      level.run_of[run.first], level.run_of[i] = run, run
      for _, link in ipairs(level.rooms[i - 1].links) do
        level.links[link.id].is_straight = true
      end
    else
      run = { id = "r" .. i, first = i, nodes = {}, at = {} }
      order.append(level.rows, number, run)
    end
    insert(run.nodes, number % 2 == 1 and #run.nodes + 1 or 1, i)
  end
  for _, row in ipairs(level.rows) do
    for _, each in ipairs(row) do
      if each.nodes[2] then measure(level, each, boxes) end
    end
  end
end

-- Lines -----------------------------------------------------------------------

local HEAD = 7 -- points: the length of an arrowhead

-- Draws a straight link between two boxes.
local function draw_straight(link, boxes, axis, offset)
  local src, tgt = boxes[link.upper.node.index], boxes[link.lower.node.index]
  if link.is_turned then src, tgt = tgt, src end
  local from, to = ({ src.x, src.y })[axis], ({ tgt.x, tgt.y })[axis]
  local middle, sign = ({ src.y, src.x })[axis] + offset, from < to and 1 or -1
  from, to = from + sign * size_of(src, axis) / 2, to - sign * size_of(tgt, axis) / 2
  local function at(along, across)
    return axis == 1 and { along, across } or { across, along }
  end
  local line = {}
  lines.join(line, { at(from, middle) })
  lines.join(line, { at(to - sign * HEAD, middle) })
  link.points, link.tip = lines.moved(line, 0, 0, link.is_turned), at(to, middle)
  local _, depth = size_of(link.arrow.size, axis)
  link.label_at = at((from + to) / 2, middle + depth / 2 + 1)
end

-- Sets the boxes of the nodes in a run whose box is given.
local function draw_run(level, run, box)
  local axis = axis_of(level)
  for _, i in ipairs(run.nodes) do
    local size = level.sizes[i]
    level.boxes[i] = { width = size.width, height = size.height,
      x = axis == 1 and box.x - run.width / 2 + run.at[i] or box.x,
      y = axis == 1 and box.y or box.y + run.height / 2 - run.at[i] }
  end
end

--- Set the boxes of nodes in runs, and the lines of their links.
function rows.draw(level)
  for _, row in ipairs(level.rows or {}) do
    for _, run in ipairs(row) do
      if run.nodes[2] then draw_run(level, run, level.run_boxes[run.first]) end
    end
  end
  for _, room in ipairs(level.rows and level.rooms or {}) do
    for j, straight in ipairs(room.links) do
      local link = level.links[straight.id]
      if link.is_straight then
        draw_straight(link, level.boxes, axis_of(level), room.offsets[j])
      end
    end
  end
end

return rows
