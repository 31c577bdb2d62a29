--- Choose the better layout of a chart: the layout of levels, or the plain layout.
--
-- In a layout of levels each composite is laid out by itself; in a plain layout the
-- whole chart is laid out at once. Fewer crossings win, then the layout of levels. This
-- never wins if its text is too small to read, and smaller than that of the other.
--
-- @module rfsm.pictures.choice
-- @license BSD-3-Clause

local lines = require "rfsm.pictures.lines"

local ipairs, sort = ipairs, table.sort
local max, min = math.max, math.min
local tonumber = tonumber

local choice = {}

-- Appends the straight pieces of a line to a list, each with its lower end first.
local function add_pieces(list, line)
  local flat = line.flat or lines.flat(line.points)
  for i = 2, #flat do
    local x, y, x2, y2 = flat[i - 1][1], flat[i - 1][2], flat[i][1], flat[i][2]
    list[#list + 1] = y < y2 and { x, y, x2, y2, line } or { x2, y2, x, y, line }
  end
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

--- Count the crossings of lines.
---@param list { points: number[][], flat?: number[][] }[] `flat` as by `lines.flat`
function choice.count_crossings(list)
  local pieces, count = {}, 0
  for _, line in ipairs(list) do add_pieces(pieces, line) end
  sort(pieces, function(a, b) return a[2] < b[2] end) -- any order of equals
  for i, piece in ipairs(pieces) do
    local j, top = i + 1, piece[4]
    local other = pieces[j]
    while other and other[2] < top do -- their heights overlap
      if is_crossing(piece, other) then count = count + 1 end
      j = j + 1
      other = pieces[j]
    end
  end
  return count
end

local READABLE = 0.7 -- scale: labels of 10 pt become 7 pt, just readable

--- A sheet: width and height in points within its margins. Can it be turned?
---@class rfsm.pictures.Size
---@field width number
---@field height number
---@field can_turn boolean
local SIZES = { a4 = { width = 510, height = 757, can_turn = true },
  slide = { width = 720, height = 380, can_turn = false } }

--- Return the size of a sheet by its name, or of "1200x800"; nil if there is none.
function choice.size_of(name)
  local width, height = name:match("^([1-9]%d*)x([1-9]%d*)$")
  return SIZES[name] or width and { can_turn = false, width = tonumber(width),
    height = tonumber(height) } or nil
end

--- Return the scale at which a picture fits a sheet.
function choice.scale(size, width, height)
  local scale = min(size.width / width, size.height / height)
  return size.can_turn and max(scale, min(size.height / width, size.width / height))
    or scale
end

-- Returns the scale of a picture on a sheet, at most READABLE: more is of no advantage.
local function scale_of(layout, size)
  return min(READABLE, choice.scale(size, layout.width, layout.height))
end

local MORE = 2 -- crossings: "much better" below

--- Return the better one of two layouts. If there was a former picture, the layout of
-- its kind wins, unless the other layout is much better.
---@param levels rfsm.pictures.Layout
---@param plain rfsm.pictures.Layout
---@param kind? "levels"|"plain"|"sheet" the layout of the former picture
---@param size rfsm.pictures.Size of the sheet
---@return rfsm.pictures.Layout
function choice.of(levels, plain, kind, size)
  if scale_of(levels, size) < scale_of(plain, size) then return plain end
  local margin = kind == "plain" and -MORE or kind == "levels" and MORE or 0.5
  return choice.count_crossings(levels.lines)
    < choice.count_crossings(plain.lines) + margin and levels or plain
end

--- Is the text of a layout readable on a sheet?
function choice.is_readable(layout, size)
  return choice.scale(size, layout.width, layout.height) >= READABLE
end

local LARGER, FIFTH = 1.02, 1.2 -- factors of the scale

--- Return the best of some shapes for a sheet that have no more than `most` crossings,
-- or two more if text that is not readable becomes a fifth larger; nil if none has
-- larger text than a layout.
function choice.for_sheet(shapes, layout, size, most)
  local best, scale = nil, LARGER * choice.scale(size, layout.width, layout.height)
  for more = 0, MORE, MORE do
    for _, shape in ipairs(shapes) do
      local one = choice.scale(size, shape.width, shape.height)
      local is_better = shape.crossings <= most + more and one > scale
      if is_better then best, scale = shape, one end
    end
    if scale >= READABLE then break end
    scale = FIFTH * scale
  end
  return best
end

local MUCH_LARGER = 1.15 -- "much better" for a shape: factor of the scale

--- Is the shape that a chart had in a former picture kept, although a shape or layout
-- may be better? It is, unless the other one, or a layout of `most` crossings, is much
-- better.
function choice.keeps(former, other, size, most)
  return former.crossings <= most + MORE
    and choice.scale(size, other.width, other.height)
    < MUCH_LARGER * choice.scale(size, former.width, former.height)
end

return choice
