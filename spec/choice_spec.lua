-- Which of two layouts is drawn.

local choice = require "rfsm.pictures.choice"
local lines = require "rfsm.pictures.lines"

-- A straight line, as Graphviz has it.
local function line(x, y, x2, y2)
  local function point(share)
    return { x + (x2 - x) * share, y + (y2 - y) * share }
  end
  return { points = { point(0), point(1 / 3), point(2 / 3), point(1) } }
end

-- A layout with a number of crossings.
local function layout(kind, crossings, height)
  local list = { line(0, 100, 300, 100), line(-10, 50, 10, 50) }
  for i = 1, crossings do list[2 + i] = line(-10 + i, 41, -10 + i, 61) end
  return { kind = kind, width = 100, height = height or 100, lines = list }
end

local A4 = choice.size_of "a4"

describe("choice", function()
  it("counts crossings", function()
    for count = 0, 3 do
      assert.equal(count, choice.count_crossings(layout("plain", count).lines))
    end
    local curve = { points = { { 0, 0 }, { 0, 100 }, { 100, 100 }, { 100, 0 } } }
    assert.equal(4, choice.count_crossings { curve, line(-10, 50, 110, 50),
      line(-10, 80, 110, 80), line(51, 0, 51, 70), line(51, 70, 51, 80) })
    local itself = { points = { { 0, 0 }, { 300, 100 }, { -200, 100 }, { 100, 0 } } }
    assert.equal(0, choice.count_crossings { itself })
  end)

  for _, case in ipairs {
    { "of fewer crossings", { 1 }, { 2 }, "levels" },
    { "of fewer crossings, plain", { 2 }, { 1 }, "plain" },
    { "of our levels if both are alike", { 0 }, { 0 }, "levels" },
    { "that is readable", { 0 }, { 0, 2000 }, "levels" },
    { "that is readable, crossings or not", { 0, 2000 }, { 9 }, "plain" },
    { "with fewer crossings, if both are readable", { 0, 1000 }, { 1 }, "levels" },
    { "of the former kind", { 1 }, { 0 }, "levels", "levels" },
    { "of the former kind, plain", { 0 }, { 2 }, "plain", "plain" },
    { "that is much better", { 3 }, { 0 }, "plain", "levels" },
    { "that is much better, levels", { 0 }, { 3 }, "levels", "plain" },
  } do
    it("takes the layout " .. case[1], function()
      local levels = layout("levels", case[2][1], case[2][2])
      local plain = layout("plain", case[3][1], case[3][2])
      assert.equal(case[4], choice.of(levels, plain, case[5], A4).kind)
    end)
  end

  it("takes a straight curve for one piece, and a bent one for eight", function()
    local function count(...) return #lines.flat { { 10, 10 }, ... } - 1 end
    assert.equal(1, count({ 20, 30 }, { 30, 50 }, { 40, 70 }))
    assert.equal(8, count({ 20, 30 }, { 31, 50 }, { 40, 70 }))
    assert.equal(8, count({ 21, 30 }, { 30, 50 }, { 40, 70 }))
  end)

  local SIZE = choice.size_of("1000x1000")

  local function shape(crossings, height)
    return { crossings = crossings, width = 100, height = height }
  end

  it("keeps the shape of a former picture, unless another is much better", function()
    for _, case in ipairs {
      { shape(3, 2000), 1, 1750, true }, { shape(4, 2000), 1, 1750, false },
      { shape(0, 2000), 0, 1730, false }, { shape(0, 2000), 9, 3000, true },
    } do
      assert.equal(case[4],
        choice.keeps(case[1], shape(0, case[3]), SIZE, case[2]), case[3])
    end
  end)

  it("takes the shape with the largest text of those with few crossings", function()
    local shapes = { shape(2, 1800), shape(3, 1000), shape(1, 1500), shape(0, 1600) }
    local function best(height, most)
      return choice.for_sheet(shapes, shape(0, height), SIZE, most)
    end
    assert.equal(shapes[2], best(2000, 2))
    assert.equal(shapes[4], best(2000, 0))
    assert.equal(shapes[2], best(2000, 3))
    assert.is_nil(best(1601, 0)) -- it has to be 2 % larger
  end)

  it("takes two crossings more for a fifth more of text, if it is too small", function()
    local large = shape(2, 1000)
    local function best(height)
      return choice.for_sheet({ shape(0, height), large }, shape(0, 2000), SIZE, 0)
    end
    assert.equal(large, best(1430))
    assert.equal(1420, best(1420).height) -- it is readable
    large.height = 1200
    assert.equal(1430, best(1430).height)
    large.height, large.crossings = 1000, 3
    assert.equal(1430, best(1430).height)
  end)
end)
