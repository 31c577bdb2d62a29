-- Where the layout puts states, arrows and labels: small charts, laid out by Graphviz.

local claim = require "spec.support.claims.pictures"
local choice = require "rfsm.pictures.choice"
local diagram = require "rfsm.pictures.diagram"
local dot = require "rfsm.dot"
local helper = require "spec.helper"
local lines = require "rfsm.pictures.lines"
local looks = require "rfsm.pictures.looks"
local marsh = require "rfsm.marsh"
local Painter = require "rfsm.web.picture"
local pictures = require "spec.support.pictures"
local rfsm = require "rfsm"
local rows = require "rfsm.pictures.rows"
local share = require "spec.support.share"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local jobs, svgs = {}, {} -- the pictures of a block are drawn together

local function levels_always(levels) return levels end

-- Draws the layouts of our levels, whether or not they are the better ones.
local function draw_all()
  local graphs = helper.with(choice, { of = levels_always }, function()
    return pictures.layouts_of(jobs)
  end)
  for i, svg in ipairs(pictures.svgs_of(graphs)) do svgs[jobs[i].key] = svg end
  helper.clear(jobs)
end

-- Returns a function that returns the elements of the picture of a model by id, y
-- downward, and its size.
local function drawn(model, options)
  local key = {}
  jobs[#jobs + 1] = { fsm = helper.init(model), options = options, key = key }
  return function()
    if not svgs[key] then draw_all() end
    local svg = svgs[key]
    local width, height = svg:match('<svg width="(%d+)pt" height="(%d+)pt"')
    return pictures.shapes_of(svg), tonumber(width), tonumber(height)
  end
end

local function middle(box) return (box.left + box.right) / 2 end

-- s1 -e2-> s2 -e3-> ... s<count>
local function chain(count)
  local model = state { trans { src = "initial", tgt = "s1" } }
  for i = 1, count do model["s" .. i] = state {} end
  for i = 2, count do
    model[#model + 1] = trans { src = "s" .. i - 1, tgt = "s" .. i, events = "e" .. i }
  end
  return model
end

-- hub <-> leaf 1 ... leaf <count>, each with a loop if `has_loops`
local function star(count, has_loops)
  local model = state { hub = state {}, trans { src = "initial", tgt = "hub" } }
  for i = 1, count do
    model["leaf" .. i] = state {}
    model[#model + 1] = trans { src = "hub", tgt = "leaf" .. i, events = "e_" .. i }
    model[#model + 1] = trans { src = "leaf" .. i, tgt = "hub", events = "e_done" }
    model[#model + 1] = has_loops
      and trans { src = "leaf" .. i, tgt = "leaf" .. i, events = "e_hold" } or nil
  end
  return model
end

describe("a line", function()
  it("is joined to another by a straight part, or moved to it if it is near", function()
    local line = { { 0, 0 }, { 0, 1 }, { 0, 2 }, { 0, 3 } }
    lines.join(line, { { 2.9, 9 }, { 2.9, 10 }, { 5, 11 }, { 6, 12 } }, 1)
    assert.same({ { 0, 9 }, { 0, 10 }, { 5, 11 }, { 6, 12 } },
      { line[7], line[8], line[9], line[10] })
    lines.join(line, { { 6, 15 }, { 7, 15 } }, 2)
    assert.same({ { 6, 13 }, { 6, 14 }, { 6, 15 }, { 7, 15 } },
      { line[11], line[12], line[13], line[14] })
    local far = {}
    lines.join(far, { { 1, 1 } }, 1)
    lines.join(far, { { 1, 1 }, { 2, 2 } }, 1)
    assert.same({ { 1, 1 }, { 2, 2 } }, far)
  end)

  it("is moved, and turned", function()
    assert.same({ { 12, 23 }, { 11, 22 } },
      lines.moved({ { 1, 2 }, { 2, 3 } }, 10, 20, true))
    assert.same({ { 11, 22 }, { 12, 23 } },
      lines.moved({ { 1, 2 }, { 2, 3 } }, 10, 20, false))
  end)
end)

-- s1 ... s12 with 36 transitions, some of them loops
local function tangle()
  local model, seed = state { trans { src = "initial", tgt = "s1" } }, 1
  local function any_state()
    seed = seed * 16807 % 2147483647
    return "s" .. seed % 12 + 1
  end
  for i = 1, 12 do model["s" .. i] = state {} end
  for i = 1, 36 do
    local src = any_state()
    model[#model + 1] = trans { src = src, tgt = any_state(), events = "e_" .. i }
  end
  return model
end

-- Adds transitions to a model: { { "src", "tgt" }, ... }.
local function linked(model, pairs_of_names)
  for i, pair in ipairs(pairs_of_names) do
    model[#model + 1] = trans { src = pair[1], tgt = pair[2], events = "x" .. i }
  end
  return model
end

-- s1 -> ... -> s<count>, each but the first -> fault
local function line(count)
  local model = linked(chain(count), { { "s" .. count, "s4" }, { "fault", "s1" } })
  for i = 2, count do linked(model, { { "s" .. i, "fault" } }) end
  model.fault = state {}
  return model
end

describe("the arrows of a picture", function()
  for _, case in ipairs {
    { name = "a line of eight states", model = line(7), most = 0 },
    { name = "ten dense states", most = 2, model = linked(chain(10), {
      { "s10", "s1" }, { "s4", "s9" }, { "s8", "s3" }, { "s1", "s5" }, { "s1", "s6" },
      { "s1", "s3" }, { "s9", "s4" }, { "s2", "s5" }, { "s1", "s6" }, { "s5", "s1" },
    }) },
    { name = "a hub with five leaves", model = star(5), most = 0 },
    { name = "a hub with six leaves", model = star(6), most = 0 },
    { name = "a hub whose leaves have loops", model = star(8, true), most = 0 },
    { name = "a hub with fourteen leaves, to the right", model = star(14), most = 0,
      direction = "LR" },
  } do
    local picture = drawn(case.model, { direction = case.direction })

    it("cross seldom or never: " .. case.name, function()
      local count = pictures.crossings(picture())
      assert.is_true(count <= case.most, count)
    end)
  end
end)

describe("the shape of a picture", function()
  for direction, count in pairs { TB = 14, LR = 9 } do -- any order
    local picture = drawn(chain(count), { direction = direction })

    it("is one line below 1,000 pt, " .. direction, function()
      local shapes, axis = picture(), direction == "TB" and 1 or 2
      for i = 2, count do
        local function at(number)
          local box = shapes["root.s" .. number].box
          return axis == 1 and middle(box) or (box.top + box.bottom) / 2
        end
        assert.is_true(math.abs(at(i) - at(1)) < 1, i)
      end
    end)
  end

  local flat_line = drawn(line(5), { direction = "LR" })

  it("is not made higher if arrows run to the right", function()
    local _, width, height = flat_line()
    assert.is_true(width > 2 * height, width .. " x " .. height)
  end)

  for _, case in ipairs {
    { name = "30", model = chain(30) },
    { name = "300", model = chain(300) },
    { name = "30, to the right", model = chain(30), direction = "LR" },
  } do
    local picture = drawn(case.model, { direction = case.direction })

    it("is that of a page for a long chain of " .. case.name, function()
      local _, width, height = picture()
      assert.is_true(width / height > 0.65 and width / height < 2.1,
        width .. " x " .. height)
    end)
  end

  local large_star = drawn(star(14))

  it("is not wide for a star: half of the leaves are before the hub", function()
    local shapes, width, height = large_star()
    assert.is_true(width < 700 and height < 900, width .. " x " .. height)
    local hub, before = middle(shapes["root.hub"].box), 0
    for i = 1, 14 do
      before = before + (middle(shapes["root.leaf" .. i].box) < hub and 1 or 0)
    end
    assert.equal(7, before)
  end)

  local framed = star(8)
  framed.m = state { x = state {}, trans { src = "initial", tgt = "x" } }
  framed[#framed + 1] = trans { src = "hub", tgt = "m", events = "e_m" }
  framed[#framed + 1] = trans { src = ".m.x", tgt = "hub", events = "e_x" }
  local framed_star = drawn(framed)

  it("is wide for a star with a frame that an arrow crosses", function()
    local shapes = framed_star()
    for i = 1, 8 do
      local leaf = shapes["root.leaf" .. i].box
      assert.is_true(leaf.top > shapes["root.hub"].box.bottom, i)
    end
  end)

  local stars = { large_star, drawn(star(14), { direction = "LR" }) }

  it("has a hub so high that arrows end beside each other", function()
    for _, picture in ipairs(stars) do
      local shapes, tips = picture(), {}
      local box = shapes["root.hub"].box
      local height = box.bottom - box.top
      assert.is_true(height > 100 and height < 200, height)
      for i = 1, 14 do
        local tip = shapes["root.trans[" .. 2 * i + 1 .. "]"].tip
        local key = math.floor(tip[1] / 3) .. " " .. math.floor(tip[2] / 3)
        tips[key] = (tips[key] or 0) + 1
        assert.equal(1, tips[key], key)
      end
    end
  end)

  local tangled = drawn(tangle())

  it("has no margin around the root", function()
    local shapes, width, height = tangled()
    local box = shapes.root.box
    assert.is_true(width - (box.right - box.left) < 10)
    assert.is_true(height - (box.bottom - box.top) < 10)
  end)
end)

describe("rows", function()
  for _, case in ipairs {
    { direction = "TB", axis = 1, across = 2 },
    { direction = "LR", axis = 2, across = 1 },
  } do
    local axis, across = case.axis, case.across
    local model = linked(chain(30), { { "s3", "s2" }, { "s30", "s1" } })
    local picture = drawn(model, { direction = case.direction })
    local shapes, first_of_row

    local function at(i)
      local box = shapes["root.s" .. i].box
      return { middle(box), (box.top + box.bottom) / 2 }
    end

    before_each(function()
      shapes, first_of_row = picture(), {}
      for i = 2, 30 do
        first_of_row[i] = math.abs(at(i)[across] - at(i - 1)[across]) > 5 and i or nil
      end
    end)

    it("run to and fro, each beyond the one before it, " .. case.direction, function()
      local count, sign = 1, nil
      for i = 2, 30 do
        local step = at(i)[axis] - at(i - 1)[axis]
        if first_of_row[i] then
          assert.is_true(at(i)[across] > at(i - 1)[across])
          count, sign = count + 1, -sign
        else
          sign = sign or step / math.abs(step)
          assert.is_true(step * sign > 0, i)
        end
      end
      assert.is_true(count >= 4 and count <= 8, count)
    end)

    it("have straight arrows with labels beside them, " .. case.direction, function()
      local seen = {}
      for _, i in ipairs { 2, 3, 4, 5, 31 } do
        local arrow = shapes["root.trans[" .. i .. "]"]
        if i == 31 or not first_of_row[i] then
          local height = arrow.ends[1][across]
          assert.is_true(math.abs(arrow.tip[across] - height) < 0.1, i)
          local gap = (arrow.label[across] - height) * (axis == 1 and -1 or 1)
          assert.is_true(gap > 2, "the label of " .. i .. " is struck")
          seen[i] = height
        end
      end
      assert.is_true(math.abs(seen[3] - seen[31]) > 10)
    end)

    it("are not crossed by an arrow from the last one to the first, " .. case.direction,
      function()
        assert.equal(0, pictures.crossings(shapes))
      end)
  end

  it("have no nodes that are linked across others, by gates or at marks", function()
    local function level(links)
      local nodes = {}
      for i = 1, 6 do nodes[i] = { index = i, kind = "leaf" } end
      nodes[4].kind = "connector"
      local result = { direction = "TB", links = {}, composite = { nodes = nodes } }
      for i, pair in ipairs(links) do
        result.links[i] = { arrow = { size = { width = 0, height = 0 } },
          upper = { node = nodes[pair[1]], gate = pair.gate },
          lower = { node = nodes[pair[2]] } }
      end
      rows.prepare(result)
      return result.bounds
    end
    assert.same({}, level { { 1, 2 }, { 2, 3 }, { 3, 2 }, { 5, 6 } })
    assert.same({ [3] = 1 }, level { { 1, 2 }, { 1, 3 } })
    assert.same({ [2] = 1 }, level { { 1, 2, gate = {} } })
    assert.same({ [4] = 3 }, level { { 3, 4 }, { 5, 6 } })
  end)

  local frames = state { hub = state {}, trans { src = "initial", tgt = "hub" } }
  for i = 1, 7 do
    local src = i > 1 and ".m" .. i - 1 .. ".y" or "hub"
    frames["m" .. i] = state { x = state {}, y = state {},
      trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "y" } }
    frames[#frames + 1] = trans { src = src, tgt = "m" .. i }
  end
  local framed_chain = drawn(frames)

  it("make a chain of composites readable, whose arrows cross frames", function()
    local _, width, height = framed_chain()
    assert.is_true(math.max(math.min(510 / width, 757 / height),
      math.min(757 / width, 510 / height)) >= 0.7, width .. " x " .. height)
  end)
end)

describe("the sheet", function()
  -- areas with three units of six states each
  local function plant()
    local model = state { trans { src = "initial", tgt = "area1" } }
    for i = 1, 2 do
      local area = state { trans { src = "initial", tgt = "unit1" } }
      for k = 1, 3 do area["unit" .. k] = line(5) end
      linked(area, { { "unit1", "unit2" }, { "unit2", "unit3" } })
      model["area" .. i] = area
    end
    return linked(model, { { "area1", "area2" }, { "area2", "area1" } })
  end

  local pictures_for = {}
  for _, name in ipairs { "a4", "slide", "300x3000" } do
    pictures_for[name] = drawn(plant(), { sheet = name })
  end
  local tall = drawn(chain(12), { sheet = "300x3000" })

  it("gives a picture its shape", function()
    local ratios = {}
    for name, picture in pairs(pictures_for) do -- any order
      local _, width, height = picture()
      ratios[name] = width / height
    end
    assert.is_true(ratios.slide > 1.3, ratios.slide)
    assert.is_true(ratios["300x3000"] < 0.6, ratios["300x3000"])
    local _, width, height = tall()
    assert.is_true(width < 300 and height > 700, width .. " x " .. height)
  end)

  it("has equal composites in one shape", function()
    local shapes, sizes, count = pictures_for.a4(), {}, 0
    for i = 1, 2 do
      for k = 1, 3 do
        local box = shapes[("root.area%d.unit%d"):format(i, k)].box
        local size = ("%.0fx%.0f"):format(box.right - box.left, box.bottom - box.top)
        count, sizes[size] = count + (sizes[size] and 0 or 1), true
      end
    end
    assert.equal(1, count)
  end)

  -- The rows of states, by the number of the state; of a new one by its name.
  local function rows_of(graph)
    local found = {}
    for name, row in graph:gmatch('id="root.(%w+)"[^\n]- row(%d+)') do
      found[name] = tonumber(row)
    end
    return found
  end

  local function like(model, graph)
    return assert(dot.layout(helper.init(model),
      { like = graph and assert(dot.render(graph, "svg")) }))
  end

  it("has the rows of a former picture, also with a new state or arrow", function()
    local former = like(chain(30))
    local expected = rows_of(former)
    assert.equal(31, #rfsm.sorted_keys(expected))
    local model = linked(chain(30), { { "s30", "new" } })
    model.new = state {}
    local found = rows_of(like(model, former))
    assert.equal(expected.s30, found.new)
    found.new = nil
    assert.same(expected, found)
    assert.same(expected, rows_of(like(linked(chain(30), { { "s30", "s1" } }), former)))
    assert.not_same(expected, rows_of(like(chain(60), nil)))
  end)

  it("gives them up for larger text if theirs is too small to read", function()
    local former = assert(dot.layout(helper.init(chain(30)), { sheet = "3000x200" }))
    assert.matches("class=sheet", former)
    assert.same(rows_of(like(chain(30))), rows_of(like(chain(30), former)))
    assert.not_same(rows_of(former), rows_of(like(chain(30))))
  end)

  it("is one that is known", function()
    for _, name in ipairs { "a5", "10x", "0x10", 7 } do
      local ok, problem = pcall(dot.encode, helper.init(chain(1)), { sheet = name })
      assert.is_false(ok)
      assert.matches("rfsm.dot.encode: sheet: 'a4', 'slide' or 'WIDTHxHEIGHT' "
        .. "expected, got ", problem)
    end
  end)
end)

describe("a transition from a state to itself", function()
  -- a with three loops, b{ x } with one
  local function model()
    return state {
      a = state {}, b = state { x = state {}, trans { src = "initial", tgt = "x" } },
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b" },
      trans { src = "a", tgt = "a", events = "e_one" },
      trans { src = "a", tgt = "a", events = "e_two" }, trans { src = "a", tgt = "a" },
      trans { src = "b", tgt = "b", events = "e_outer" },
    }
  end

  for _, case in ipairs {
    { direction = "TB", side = "right", out = 1, axis = 2 },
    { direction = "LR", side = "top", out = -1, axis = 1 },
  } do
    local picture = drawn(model(), { direction = case.direction })

    it("is a loop at the " .. case.side .. ", one with all labels", function()
      local shapes = picture()
      local across = 3 - case.axis
      for name, key in pairs { a = "root.trans[4]", b = "root.trans[6]" } do -- any
        local arrow, side = shapes[key], shapes["root." .. name].box[case.side]
        assert.is_true(math.abs(arrow.ends[1][across] - side) < 1)
        assert.is_true(math.abs(arrow.tip[across] - side) < 1)
        local reach = 0
        for _, point in ipairs(arrow.path) do
          reach = math.max(reach, (point[across] - side) * case.out)
        end
        assert.is_true(reach > 5 and (arrow.label[across] - side) * case.out > reach)
      end
    end)
  end
end)

describe("regions", function()
  -- a region with count states
  local function region(count)
    local model = chain(count)
    model.info, model.warn = false, false
    return model
  end

  for _, case in ipairs {
    { direction = "TB", first = "top", last = "bottom" },
    { direction = "LR", first = "left", last = "right" },
  } do
    local picture = drawn(state { trans { src = "initial", tgt = "arms" },
      arms = rfsm.seqand { left = region(1), right = region(3) },
    }, { direction = case.direction })

    it("are as long as each other, with their names in the middle, " .. case.direction,
      function()
        local shapes = picture()
        local left, right = shapes["root.arms.left"], shapes["root.arms.right"]
        assert.same({ left.box[case.first], left.box[case.last] },
          { right.box[case.first], right.box[case.last] })
        for _, shape in ipairs { left, right } do
          assert.is_true(math.abs(shape.label[1] - middle(shape.box)) < 1)
        end
        local inner = shapes["root.arms.left.s1"].box
        assert.is_true(inner.top > left.label[2] and inner.bottom < left.box.bottom)
      end)
  end
end)

describe("an arrow across frames", function()
  -- a, m{ x, y } ; a -> m.y, m.y -> a, m -> m.y
  local function model()
    return state {
      a = state {}, m = state { entry = print, x = state {}, y = state {},
        trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "y" } },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = ".m.y", events = "e_in" },
      trans { src = ".m.y", tgt = "a", events = "e_out" },
      trans { src = "m", tgt = ".m.y", events = "e_again" },
    }
  end

  local pictures_of = { TB = drawn(model()), LR = drawn(model(), { direction = "LR" }) }

  for direction, case in pairs { -- any order
    TB = { side = "top", axis = 2, angle = 90 },
    LR = { side = "left", axis = 1, angle = 0 },
  } do
    it("crosses them at a right angle, and not the name, " .. direction, function()
      local shapes = pictures_of[direction]()
      local side = shapes["root.m"].box[case.side]
      for i = 2, 3 do
        local path, count = shapes["root.trans[" .. i .. "]"].path, 0
        for j = 4, #path - 3, 3 do
          if math.abs(path[j][case.axis] - side) < 1 then
            for step = -1, 1, 2 do
              local angle = math.abs(pictures.direction_at(path, j, step)) % 180
              angle = math.min(math.abs(angle - case.angle), 180 - angle + case.angle)
              assert.is_true(angle < 10, angle)
            end
            count = count + 1
          end
        end
        assert.is_true(count > 0)
      end
    end)
  end

  it("leaves the name in the middle of a frame that it does not cross", function()
    local text = assert(dot.layout(helper.init(state {
      a = state {}, b = state { x = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "x", events = "e_long_enough" } },
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b" },
    })))
    local count = 0
    local BOX = 'bb="([%d.]+),[%d.]+,([%d.]+),[%d.]+", lp="([%d.]+)'
    for left, right, x in text:gmatch(BOX) do
      assert.is_true(math.abs((left + right) / 2 - x) < 1)
      count = count + 1
    end
    assert.equal(2, count)
  end)

  for _, direction in ipairs { "TB", "LR" } do
    it("begins at the inner side of its source, if it leads into it, " .. direction,
      function()
        local shapes = pictures_of[direction]()
        local arrow, frame = shapes["root.trans[4]"], shapes["root.m"].box
        local first, axis = "top", 2
        if direction == "LR" then first, axis = "left", 1 end
        assert.is_true(math.abs(arrow.ends[1][axis] - frame[first]) < 1)
        assert.is_true(arrow.label[axis] > frame[first])
        for _, point in ipairs(arrow.path) do
          assert.is_true(point[axis] > frame[first] - 1)
        end
      end)
  end
end)

describe("a label", function()
  -- a -e_1 ... e_20-> b, b -(pn 1)-> a
  local function model(back)
    local result = state { a = state {}, b = state {},
      trans { src = "initial", tgt = "a" }, trans(back) }
    for i = 1, 20 do
      result[#result + 1] = trans { src = "a", tgt = "b", events = "e_" .. i }
    end
    return result
  end

  for _, case in ipairs {
    { text = "a priority", half = 18, back = { src = "b", tgt = "a", pn = 1 } },
    { text = "an event", half = 10, back = { src = "b", tgt = "a", events = "e_b" } },
  } do
    local picture = drawn(model(case.back))

    it("is at its arrow where the arrow is bent: " .. case.text, function()
      local arrow, least = picture()["root.trans[2]"], 1e9
      for _, point in ipairs(pictures.points_on(arrow.path)) do
        if math.abs(point[2] - arrow.label[2]) < 20 then
          least = math.min(least, arrow.label[1] - case.half - point[1])
        end
      end
      assert.is_true(least > 1 and least < 16, least)
    end)
  end

  it("stays where it is if it is near, at its side of the line", function()
    local function moved(x, y, height, axis)
      local at, path = { x, y }, { { 0, 0 }, { 0, 30 }, { 0, 60 }, { 0, 90 } }
      if axis == 2 then path = { { 0, 0 }, { 30, 0 }, { 60, 0 }, { 90, 0 } } end
      lines.attract(at, { width = 31, height = height }, path, axis)
      return ("%.1f %.1f"):format(at[1], at[2])
    end
    assert.equal("29.0 50.0", moved(29, 50, 12, 1))
    assert.equal("21.5 50.0", moved(60, 50, 12, 1))
    assert.equal("21.5 50.0", moved(60, 50, 24, 1))
    assert.equal("60.0 500.0", moved(60, 500, 12, 1)) -- the line is elsewhere
    assert.equal("50.0 18.0", moved(50, 60, 24, 2))
  end)

  it("is at its line between two points of a curve, too", function()
    local at = { 120, 178 }
    local path = { { 0, 0 }, { 20, 150 }, { 20, 250 }, { 0, 430 } }
    lines.attract(at, { width = 31, height = 12 }, path, 1)
    assert.is_true(at[1] > 30 and at[1] < 40, at[1])
  end)
end)

describe("dot.layout", function()
  it("tries no rows if a chart without composites fits its sheet at once", function()
    local count = 0
    local graph = assert(dot.layout(helper.init(star(14)), nil, function(text)
      count = count + select(2, text:gsub("digraph {", ""))
      return dot.render(text, "dot")
    end))
    assert.matches("class=levels", graph)
    assert.equal(4, count) -- by Graphviz alone, sizes, downward, to the right
  end)

  it("is the same text each time", function()
    local function text() return assert(dot.layout(helper.init(star(9)), "T")) end
    assert.equal(text(), text())
  end)

  it("blames its caller, and hands on a problem of Graphviz", function()
    local ok, problem = pcall(function() return (dot.layout(state {})) end)
    assert.is_false(ok)
    assert.matches("layout_spec.lua:%d+: rfsm.dot.layout: initialised fsm expected",
      problem)
    local render = dot.render
    for count = 0, 1 do -- the first runs succeed
      local runs = 0
      dot.render = function(text, format)
        runs = runs + 1
        if runs > count then return nil, "dot: no memory" end
        return render(text, format)
      end
      local model = linked(chain(24), { { "s1", "s1" } })
      local graph, why = dot.layout(helper.init(model))
      dot.render = render
      assert.same({ nil, "dot: no memory" }, { graph, why })
    end
  end)

  it("is made of levels if Graphviz cannot lay out the whole chart", function()
    local render, runs = dot.render, 0
    local graph = helper.with(dot, { render = function(...)
      runs = runs + 1
      if runs == 1 then return nil, "dot: no memory" end
      return render(...)
    end }, function() return dot.layout(helper.init(chain(3))) end)
    assert.matches("class=levels", graph)
  end)

  it("reads answers that leave out the usual height, as version 16 does", function()
    local render = dot.render
    local function layout_with(height) -- in place of 0.4 or 0.40278
      return helper.with(dot, { render = function(text, format)
        local BOX = "(\n\tn%d[^]]-\n\t\t)height=0%.4%d*,\n\t\t"
        return (render(text, format):gsub(BOX, height))
      end }, function() return assert(dot.layout(helper.init(chain(3)))) end)
    end
    assert.equal(layout_with "%1height=0.4,\n\t\t", layout_with "%1")
  end)

  it("is what a server draws", function()
    local tab = marsh.model2tab(helper.init(chain(3)), true)
    assert.equal(dot.render(assert(dot.layout(tab)), "svg"),
      Painter.draw({ graph = tab, folded = {} }))
  end)

  it("draws connectors with a ring where arrows cross their frame", function()
    local text = assert(dot.layout(helper.init(state {
      m = state { x = state {}, out = conn {}, inner = conn {}, way = conn {},
        trans { src = "way", tgt = "x" },
        trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "inner" },
        trans { src = "inner", tgt = "out" } },
      trans { src = "initial", tgt = "m" }, trans { src = ".m.out", tgt = "y" },
      y = state {}, trans { src = "y", tgt = ".m.way" },
    })))
    for _, name in ipairs { "out", "way" } do
      assert.matches("root_m_" .. name .. ' [^\n]*BGCOLOR="white"', text)
    end
    assert.matches('root_m_inner [^\n]*BGCOLOR="#555555"', text)
  end)
end)

describe("a number in a picture", function()
  it("has two digits at most, and one text on each Lua", function()
    for text, number in pairs { -- any order: each stands alone
      ["0.13"] = 0.125, ["0.38"] = 0.375, ["2.5"] = 2.5, ["100"] = 100, ["0"] = -0.001,
      ["-1.25"] = -1.254,
    } do
      assert.equal(text, looks.number_text(number))
    end
  end)
end)

describe("a text in lines", function()
  local function wrap(text, width) return diagram.wrap({ text }, width) end

  it("is not broken inside of a call if there is room elsewhere", function()
    assert.same({ "go()", "move(arm, 1)" }, wrap("go() move(arm, 1)", 13))
    assert.same({ "f(a, (b), c)", "g" }, wrap("f(a, (b), c) g", 12))
    assert.same({ "a) b", "c" }, wrap("a) b c", 4))
  end)

  it("goes on in the line before it if it is short, never if it is long", function()
    assert.same({ "go [x]" }, diagram.wrap({ "go", "[x]" }, 6))
    assert.same({ "go", "[x y", "z]" }, diagram.wrap({ "go", "[x y z]" }, 5))
  end)

  it("has a width in characters: 28 in a label, 40 in a row", function()
    local e = "\195\169"
    assert.equal(1, #diagram.wrap({ e:rep(14), e:rep(13) }, 28))
    assert.equal(2, #diagram.wrap({ e:rep(14), e:rep(14) }, 28))
    local function rows_of(length)
      return looks.state_label { name = "a", rows = { ("x"):rep(20) .. " "
        .. ("y"):rep(length - 21) } }
    end
    assert.matches("x y", rows_of(40))
    assert.not_matches("x y", rows_of(41))
  end)

  it("is broken inside of a call that is too long, at a space", function()
    assert.same({ "move(arm,", "leg)" }, wrap("move(arm, leg)", 10))
    assert.same({ "get_", "name" }, wrap("get_name", 6))
    assert.same({ "abcdef", "gh" }, wrap("abcdefgh", 6))
  end)

  it("has no line with nothing but the sign of an effect", function()
    assert.same({ "e_10", "/ send(fsm,", "e_rth)" },
      diagram.wrap({ "e_10", "/ send(fsm, e_rth)" }, 12))
    assert.same({ "/ abcd", "efgh" }, wrap("/ abcdefgh", 6))
  end)
end)

describe("the drawn graph", function()
  it("has the nodes, arrows and nesting of random charts", function()
    assert.is_nil(share.problem(claim, 6))
  end)
end)
