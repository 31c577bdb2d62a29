-- Which of some layouts is drawn.

local choice = require "rfsm.pictures.choice"
local lines = require "rfsm.pictures.lines"

-- A straight line, as Graphviz has it.
local function line(x, y, x2, y2)
  local function point(share)
    return { x + (x2 - x) * share, y + (y2 - y) * share }
  end
  return { points = { point(0), point(1 / 3), point(2 / 3), point(1) } }
end

-- A layout: its number of crossings, and its height.
local function layout(crossings, height)
  return { crossings = crossings, width = 100, height = height or 100 }
end

local function crossings_of(one) return one.crossings end

-- Lines with a number of crossings.
local function crossed(crossings)
  local list = { line(0, 100, 300, 100), line(-10, 50, 10, 50) }
  for i = 1, crossings do list[2 + i] = line(-10 + i, 41, -10 + i, 61) end
  return list
end

local A4 = choice.size_of "a4"

describe("choice", function()
  it("counts crossings", function()
    for count = 0, 3 do
      assert.equal(count, choice.count_crossings(crossed(count)))
    end
    local curve = { points = { { 0, 0 }, { 0, 100 }, { 100, 100 }, { 100, 0 } } }
    assert.equal(4, choice.count_crossings { curve, line(-10, 50, 110, 50),
      line(-10, 80, 110, 80), line(51, 0, 51, 70), line(51, 70, 51, 80) })
    local itself = { points = { { 0, 0 }, { 300, 100 }, { -200, 100 }, { 100, 0 } } }
    assert.equal(0, choice.count_crossings { itself })
  end)

  for _, case in ipairs { -- levels, plain, the better one, the former one
    { "of fewer crossings", layout(1), layout(2), 1 },
    { "of fewer crossings, plain", layout(2), layout(1), 2 },
    { "that comes first, if both are alike", layout(0), layout(0), 1 },
    { "that is readable", layout(0), layout(0, 2000), 1 },
    { "that is readable, with crossings", layout(0, 2000), layout(2), 2 },
    { "with fewer crossings, if both are readable", layout(0, 1000), layout(1), 1 },
    { "without many crossings, readable or not", layout(0, 2000), layout(3), 1 },
    { "of the former picture", layout(1), layout(0), 1, 1 },
    { "of the former picture, plain", layout(0), layout(2), 2, 2 },
    { "that is much better than the former one", layout(3), layout(0), 2, 1 },
    { "that is much better than the former one, levels", layout(0), layout(3), 1, 2 },
  } do
    it("takes the layout " .. case[1], function()
      local layouts = { case[2], case[3] }
      assert.equal(layouts[case[4]],
        choice.best(layouts, crossings_of, A4, layouts[case[5]]))
    end)
  end

  it("takes a straight curve for one piece, and a bent one for eight", function()
    local function count(...) return #lines.flat { { 10, 10 }, ... } - 1 end
    assert.equal(1, count({ 20, 30 }, { 30, 50 }, { 40, 70 }))
    assert.equal(8, count({ 20, 30 }, { 31, 50 }, { 40, 70 }))
    assert.equal(8, count({ 21, 30 }, { 30, 50 }, { 40, 70 }))
  end)

  local SIZE = choice.size_of("1000x1000")

  it("takes a crossing more for text that is 7 % larger, if it is too small", function()
    local function best(...)
      return choice.best({ layout(0, 2000), layout(9, 2000), ... }, crossings_of, SIZE)
    end
    assert.equal(2000, best(layout(1, 1875)).height)
    assert.equal(1855, best(layout(1, 1855)).height)
    assert.equal(1600, best(layout(1, 1855), layout(2, 1600)).height)
    assert.equal(1855, best(layout(1, 1855), layout(3, 1000)).height)
    assert.equal(1420, best(layout(0, 1420), layout(0, 1000)).height) -- it is readable
  end)

  it("counts crossings only where they matter", function()
    local shapes, counted = { layout(0), layout(1), layout(0, 2000), layout(0, 90) }, {}
    local function count(one)
      counted[one.height] = true
      return one.crossings
    end
    assert.equal(shapes[1], choice.best(shapes, count, SIZE))
    assert.same({ [100] = true }, counted)
  end)
end)
