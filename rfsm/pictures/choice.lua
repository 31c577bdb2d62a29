--- Choose the best layout of a chart: few crossings, and text that can be read.
--
-- @module rfsm.pictures.choice
-- @license BSD-3-Clause

local lines = require "rfsm.pictures.lines"

local huge, log, max, min = math.huge, math.log, math.max, math.min
local ipairs, sort = ipairs, table.sort
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

--- Is the text of a layout readable on a sheet?
function choice.is_readable(layout, size)
  return choice.scale(size, layout.width, layout.height) >= READABLE
end

-- All in crossings: how many more than necessary there may be, what the layout of the
-- former picture is worth, and what text is worth that is 2.7 times as large. So one
-- crossing is worth text that is 7 % larger.
local MORE, FORMER, TEXT = 2, 4, 14

--- Return the layout with few crossings and large text; of equal ones the first. The
-- layout of the former picture, `former`, wins unless another one is much better. No
-- layout has many more crossings than the best one of the first two.
---@param layouts { width: number, height: number }[]
---@param crossings_of fun(layout: table): number
---@param size rfsm.pictures.Size of the sheet
---@param former? table the layout of the former picture
function choice.best(layouts, crossings_of, size, former)
  local best, least = layouts[1], huge
  local most = MORE + min(crossings_of(best), crossings_of(layouts[2] or best))
  for _, layout in ipairs(layouts) do
    -- text that is larger than just readable is of no advantage
    local scale = choice.scale(size, layout.width, layout.height)
    local cost = TEXT * log(max(1, READABLE / scale))
      - (layout == former and FORMER or 0)
    -- crossings are counted only where they matter
    local crossings = cost < least and crossings_of(layout) or huge
    if crossings <= most and cost + crossings < least then
      best, least = layout, cost + crossings
    end
  end
  return best
end

return choice
