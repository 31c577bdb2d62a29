--- Where lines meet boxes: beside loops, and beside the lines that cross a frame.
--
-- Graphviz ends a line anywhere at a box. These functions find what is wrong with that
-- in a level that has been laid out, and note ports for when it is laid out again.
--
-- @module rfsm.pictures.ends
-- @license BSD-3-Clause

local abs, ipairs = math.abs, ipairs
local sort = table.sort

local ends = {}

-- Calls a function with each end of a link at a node: the end, its point, a point of
-- the line between the ranks, and whether the line comes from above.
local function visit(link, f)
  local points, label, upper = link.points, link.label_at, link.upper
  if upper and upper.node then
    f(upper, link.head == "upper" and link.tip or points[1], label or points[4], false)
  end
  if link.lower.node then
    f(link.lower, link.head == "lower" and link.tip or points[#points],
      label or points[#points - 3], true)
  end
end

local function each_end(level, f)
  for _, link in ipairs(level.links) do
    if not link.is_loop then visit(link, f) end
  end
end

-- Frames: lines that end there, and lines that cross it -------------------------

-- Returns how far to the right a point is; how far down if the direction is LR.
local function across(level, point)
  return level.direction == "TB" and point[1] or -point[2]
end

-- Lists the sides of frames at which lines end, each with these ends.
local function sides_of(level)
  local list, by_key = {}, {}
  each_end(level, function(finish, point, middle, is_upper)
    local inner, box = finish.node.level, level.boxes[finish.node.index]
    if not inner then return end
    local key = finish.node.index * (is_upper and 1 or -1)
    if not by_key[key] then
      by_key[key] = { level = inner, is_upper = is_upper,
        length = level.direction == "TB" and box.width or box.height }
      list[#list + 1] = by_key[key]
    end
    local side = by_key[key]
    side[#side + 1] = { finish = finish, gate = finish.gate, at = across(level, point),
      middle = across(level, middle) }
  end)
  return list
end

-- Do a line that crosses a frame and one that ends at it change places on their way?
local function is_tangled(side)
  for _, one in ipairs(side) do
    for _, other in ipairs(one.gate and side or {}) do
      if not other.gate and not other.finish.foot
        and (one.at - other.at) * (one.middle - other.middle) < 0 then
        return true
      end
    end
  end
  return false
end

-- Returns where the largest gap between the gates at a side begins and ends. A gap in
-- which no line ends counts half.
local function largest_gap(side)
  local first, last, most, from, share = 0, 0, 0, 0, 0.5
  sort(side, function(a, b) return a.at < b.at end)
  for i = 1, #side + 1 do
    local one = side[i]
    if one and not one.gate then
      share = 1
    else
      local to = one and one.gate.offset or side.length
      if (to - from) * share > most then
        first, last, most = from, to, (to - from) * share
      end
      from, share = to, 0.5
    end
  end
  return first, last
end

-- Puts the lines that end at a frame into a gap between the gates, in their order.
local function place_feet(side)
  local first, last = largest_gap(side)
  local list, feet = {}, side.level.feet
  for _, one in ipairs(side) do
    if not one.gate then list[#list + 1] = one end
  end
  sort(list, function(a, b)
    if a.middle ~= b.middle then return a.middle < b.middle end
    return a.at < b.at
  end)
  for i, one in ipairs(list) do
    one.finish.foot = { id = "f" .. #feet + 1, is_upper = side.is_upper,
      offset = first + i * (last - first) / (#list + 1) }
    feet[#feet + 1] = one.finish.foot
  end
end

local function mend_frames(level)
  local has_mended = false
  for _, side in ipairs(sides_of(level)) do
    if is_tangled(side) then
      side.level.ordering = side.level.ordering or (side.is_upper and "in" or "out")
      place_feet(side)
      has_mended = true
    end
  end
  return has_mended
end

-- Loops -----------------------------------------------------------------------

-- Does a line end at the side of a box where the loops are?
local function meets_loops(level, box, point)
  if level.direction == "TB" then
    return point[1] > box.x + box.width / 2 - 3
      and abs(point[2] - box.y) < box.height / 2 - 3
  end
  return point[2] > box.y + box.height / 2 - 3
    and abs(point[1] - box.x) < box.width / 2 - 3
end

local function mend_loops(level)
  local has_mended = false
  each_end(level, function(finish, point)
    local node = finish.node
    if not node.loops or node.level or finish.is_pinned then return end
    if not meets_loops(level, level.boxes[node.index], point) then return end
    finish.is_pinned, has_mended = true, true
  end)
  return has_mended
end

--- Find ends of lines that should be elsewhere in a level that is laid out, and say
-- where; return if it must be laid out again.
function ends.mend(level) return mend_frames(level) or mend_loops(level) end

return ends
