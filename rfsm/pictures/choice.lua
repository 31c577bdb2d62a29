--- Choose the better layout of a chart: the layout of levels, or the plain layout.
--
-- In a layout of levels each composite is laid out by itself; in a plain layout the
-- whole chart is laid out at once. Fewer crossings win, then text that is readable on
-- paper, then shorter lines. The layout of levels never wins if its text is too small
-- to read, and smaller than the text of the plain layout.
--
-- @module rfsm.pictures.choice
-- @license BSD-3-Clause

local lines = require "rfsm.pictures.lines"

local ipairs, sort = ipairs, table.sort
local max, min, sqrt = math.max, math.min, math.sqrt

local choice = {}

-- Appends the straight pieces of a line to a list, each with its lower end first.
-- Returns the length of the line.
local function add_pieces(list, line)
  local length, flat = 0, lines.flat(line.points)
  for i = 2, #flat do
    local x, y, x2, y2 = flat[i - 1][1], flat[i - 1][2], flat[i][1], flat[i][2]
    length = length + sqrt((x2 - x) * (x2 - x) + (y2 - y) * (y2 - y))
    list[#list + 1] = y < y2 and { x, y, x2, y2, line } or { x2, y2, x, y, line }
  end
  return length
end

-- Returns a number whose sign is the side of a piece on which a point is; 0: on it.
local function side_of(piece, x, y)
  return (piece[3] - piece[1]) * (y - piece[2]) - (piece[4] - piece[2]) * (x - piece[1])
end

local function is_crossing(one, other)
  return one[5] ~= other[5]
    and max(one[1], one[3]) > min(other[1], other[3])
    and min(one[1], one[3]) < max(other[1], other[3])
    and side_of(one, other[1], other[2]) * side_of(one, other[3], other[4]) < 0
    and side_of(other, one[1], one[2]) * side_of(other, one[3], one[4]) < 0
end

-- Counts the crossings of pieces. Pieces are compared only if their heights overlap.
local function count_crossings(pieces)
  sort(pieces, function(a, b) return a[2] < b[2] end) -- any order of equals
  local count = 0
  for i, piece in ipairs(pieces) do
    local j, top = i + 1, piece[4]
    local other = pieces[j]
    while other and other[2] < top do
      if is_crossing(piece, other) then count = count + 1 end
      j = j + 1
      other = pieces[j]
    end
  end
  return count
end

local SHORT, LONG = 523, 770 -- points: width and height of A4 within its margins
local READABLE = 0.7 -- scale: labels of 10 pt become 7 pt, just readable

-- Returns the scale of a picture on paper, at most READABLE: more is of no advantage.
local function scale_of(layout)
  local width, height = layout.width, layout.height
  return min(READABLE, max(min(SHORT / width, LONG / height),
    min(LONG / width, SHORT / height)))
end

--- Count the crossings of the arrows in a layout. Return the length of all arrows, too.
---@param layout rfsm.pictures.Layout
---@return integer count
---@return number length in points
function choice.measure(layout)
  local pieces, length = {}, 0
  for _, line in ipairs(layout.lines) do length = length + add_pieces(pieces, line) end
  return count_crossings(pieces), length
end

local MORE, LONGER = 2, 1.25 -- "much better" below: crossings, factor of length

--- Return the better one of two layouts. If there was a former picture, the layout of
-- its kind wins, unless the other layout is much better.
---@param levels rfsm.pictures.Layout
---@param plain rfsm.pictures.Layout
---@param kind? "levels"|"plain" the layout of the former picture
---@return rfsm.pictures.Layout
function choice.of(levels, plain, kind)
  local own, own_length = choice.measure(levels)
  local other, other_length = choice.measure(plain)
  local scale, other_scale = scale_of(levels), scale_of(plain)
  if scale < other_scale then return plain end
  if kind == "plain" then own, own_length = own + MORE, own_length * LONGER end
  if kind == "levels" then other, other_length = other + MORE, other_length * LONGER end
  local is_better = own < other
    or own == other and (scale > other_scale or own_length <= other_length)
  return is_better and levels or plain
end

return choice
