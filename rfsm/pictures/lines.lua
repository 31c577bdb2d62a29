--- Lines in the form of Graphviz: the start, then for each curve two control points and
-- its end.
--
-- @module rfsm.pictures.lines
-- @license BSD-3-Clause

local abs, ipairs, max, min = math.abs, ipairs, math.max, math.min

local lines = {}

--- Return the axis across the arrows of a level (1: x, 2: y).
function lines.axis_of(level) return level.direction == "TB" and 1 or 2 end

--- Return two sizes of a box: along an axis, and across it.
function lines.size_of(box, axis)
  if axis == 1 then return box.width, box.height end
  return box.height, box.width
end

local function distance(a, b) return max(abs(a[1] - b[1]), abs(a[2] - b[2])) end

local function between(a, b, share)
  return { a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share }
end

local function add_straight(line, point)
  local last = line[#line]
  if last and distance(last, point) < 0.01 then return end
  if last then
    line[#line + 1] = between(last, point, 1 / 3)
    line[#line + 1] = between(last, point, 2 / 3)
  end
  line[#line + 1] = point
end

local NEAR = 3 -- points: the greatest distance of a port of a box from its gate

--- Append the line `more` to a line, which may be empty. `axis` (1: x, 2: y) is the
-- axis across the arrows. If it is given, and `more` begins near the end of the line on
-- this axis, the start of `more` is moved to that end, so that a gate makes no bend.
function lines.join(line, more, axis)
  local last = line[#line]
  local shift = axis and last and last[axis] - more[1][axis] or 0
  for i, point in ipairs(more) do
    if axis and i <= 2 and abs(shift) < NEAR then
      point = { point[1], point[2] }
      point[axis] = point[axis] + shift
    end
    if i == 1 then add_straight(line, point) else line[#line + 1] = point end
  end
end

local function is_straight(a, b, c, d)
  local x, y = d[1] - a[1], d[2] - a[2]
  local function off(p) return abs(x * (p[2] - a[2]) - y * (p[1] - a[1])) end
  return off(b) + off(c) < 0.1 * distance(a, d)
end

local PIECES = 8 -- how many straight pieces replace a curve

--- Return points on a line, between which it is about straight: its start, and up to
-- PIECES points on each curve.
function lines.flat(line)
  local flat = { line[1] }
  for i = 1, #line - 3, 3 do
    local a, b, c, d = line[i], line[i + 1], line[i + 2], line[i + 3]
    for k = is_straight(a, b, c, d) and PIECES or 1, PIECES do
      local t, u = k / PIECES, 1 - k / PIECES
      local p, q, r, s = u * u * u, 3 * u * u * t, 3 * u * t * t, t * t * t
      flat[#flat + 1] = { p * a[1] + q * b[1] + r * c[1] + s * d[1],
        p * a[2] + q * b[2] + r * c[2] + s * d[2] }
    end
  end
  return flat
end

local FAR, BESIDE = 14, 6 -- points: distances between a line and its label

-- Returns how far the part of a piece that is between two limits on the other axis
-- reaches along an axis; nil if no part is.
local function far_between(a, b, low, high, axis)
  local other = 3 - axis
  if a[other] > b[other] then a, b = b, a end
  if b[other] < low or a[other] > high then return nil end
  local length = max(b[other] - a[other], 1e-9)
  local first, last = max(0, (low - a[other]) / length),
    min(1, (high - a[other]) / length)
  return max(between(a, b, first)[axis], between(a, b, last)[axis])
end

--- Move a label with the size of a box to its line if it is far from it. Graphviz bends
-- a line away from its label if there is room. `axis` is the axis across the arrows.
function lines.attract(at, box, line, axis)
  local width, depth = lines.size_of(box, axis)
  local side, half, other = at[axis] - width / 2, depth / 2 + BESIDE, 3 - axis
  local reach, last
  for _, point in ipairs(lines.flat(line)) do
    local far = last and far_between(last, point, at[other] - half, at[other] + half,
      axis)
    reach, last = far and max(reach or far, far) or reach, point
  end
  if reach and side - reach > FAR then at[axis] = at[axis] - (side - reach) + BESIDE end
end

--- Return a line moved by x and y; if `is_turned`, its points are in reverse order.
function lines.moved(line, x, y, is_turned)
  local moved = {}
  for i, point in ipairs(line) do
    moved[is_turned and #line + 1 - i or i] = { point[1] + x, point[2] + y }
  end
  return moved
end

return lines
