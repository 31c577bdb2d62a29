-- Models that are hard to draw: random ones of depth 6 with regions, and odd names.

local dot = require "rfsm.dot"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local pictures = {}

--- Names that mean something to Lua, Graphviz, PlantUML, Mermaid, Markdown or HTML.
pictures.ODD_NAMES = {
  "a b", "a_b", "a-b", "end", 'q"q', "q'q", "l1\nl2", "<b>", "<<choice>>", "[*]", "a:b",
  "}", "{", "#", "%d", "%% x", "&amp;", "1", " ", "--", "état", "日本", "\255\254", "\1",
  "tab\t", "note", "graph", "x_", "*b*", "//i//", "__", "~", "state", "subgraph",
  "`c`", ";", "$x", "|", "/' '/", "||", "[H]", "direction", "class", "root", "<br>",
  "a -> b", ("long "):rep(12), ("endless"):rep(12), "</TABLE>", "@enduml", "]]>",
}

local function add_transitions(model, nodes, random)
  local events, odd = {}, pictures.ODD_NAMES
  for i = 1, random(3) - 1 do events[i] = odd[random(#odd)] end
  local src, tgt = nodes[random(#nodes)], nodes[random(#nodes)]
  model[#model + 1] = rfsm.trans {
    src = src, tgt = rfsm.is_state(src) and random(12) == 1 and "internal" or tgt,
    events = events, pn = random(4) == 1 and random(3) or nil,
    guard = random(4) == 1 and function() return tgt ~= nil end or nil,
    effect = random(4) == 1 and print or nil,
  }
end

local new_state

-- Adds states, of which some are composites, and connectors; lists all nodes.
local function add_members(model, nodes, random, depth)
  local first
  for _ = 1, random(3) do
    local name = pictures.ODD_NAMES[random(#pictures.ODD_NAMES)]
    if not model[name] and name:sub(1, 1) ~= "_" then
      local node = first and random(5) == 1 and rfsm.conn {}
        or new_state(nodes, random, depth - 1)
      model[name], first = node, first or node
      nodes[#nodes + 1] = node
    end
  end
  model[1] = first and rfsm.trans { src = "initial", tgt = first } or nil
end

function new_state(nodes, random, depth)
  if depth > 0 and random(8) == 1 then
    return rfsm.seqand { left = pictures.model(random(1000), depth - 1),
      ["a b"] = pictures.model(random(1000), depth - 1) }
  end
  local model = rfsm.state { entry = random(3) == 1 and print or nil }
  if depth > 0 and random(2) == 1 then add_members(model, nodes, random, depth) end
  return model
end

--- The random model of a seed.
function pictures.model(seed, depth)
  local random, nodes, model = new_random(seed), {}, rfsm.state {}
  model.err, model.warn, model.info = false, false, false
  add_members(model, nodes, random, depth)
  for _ = 1, nodes[1] and random(2 * #nodes) or 0 do
    add_transitions(model, nodes, random)
  end
  return model
end

local function any_name(random) return "s" .. random(9) .. ("_x"):rep(random(4) - 1) end

local function any_node(random, is_first)
  if random(8) == 1 and not is_first then return rfsm.conn {} end
  return rfsm.state { entry = random(4) == 1 and print or nil }
end

local function add_arrow(model, names, random, event)
  local src, tgt = random:pick(names), random:pick(names)
  model[#model + 1] = rfsm.trans { src = src, tgt = random(4) == 1 and src or tgt,
    events = { event }, guard = random(3) == 1 and print or nil }
end

-- A level of many states: a chain, with arrows across, loops, and composites in it, to
-- and from whose states arrows lead, too. Returns their names.
local function add_wide_level(model, random, most, add_level)
  local names, ends = {}, {}
  for i = 1, 1 + random(most) do
    names[i] = any_name(random) .. i
    model[names[i]] = any_node(random, i == 1)
    ends[#ends + 1] = names[i]
    if add_level and random(5) == 1 and rfsm.is_state(model[names[i]]) then
      for _, name in ipairs(add_level(model[names[i]], random, 11)) do
        ends[#ends + 1] = "." .. names[i] .. "." .. name
      end
    end
    model[#model + 1] = rfsm.trans { src = names[i - 1] or "initial", tgt = names[i],
      events = i > 1 and { any_name(random) } or nil }
  end
  for i = 1, random(#names) - 1 do add_arrow(model, ends, random, "e_" .. i) end
  return names
end

--- The random model of a seed with many states beside each other.
function pictures.wide_model(seed)
  local model = rfsm.state { warn = false, info = false, entry = seed % 2 == 0 and print
    or nil }
  add_wide_level(model, new_random(seed), 13, add_wide_level)
  return model
end

--- A model with an odd name at each of many leaves, and as the event of arrows.
function pictures.odd()
  local model = rfsm.state { root = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "root" } }
  for _, name in ipairs(pictures.ODD_NAMES) do
    if name:sub(1, 1) ~= "_" then model[name] = rfsm.state {} end
    model[#model + 1] = rfsm.trans { src = "root", tgt = model[name] or "a b",
      events = { name } }
  end
  return model
end

--- The transitions in a list that have arrows of their own: the first of three or more
-- with equal ends, or of two loops, stands for all of them.
function pictures.drawn_arrows(transitions)
  local counts, seen, list = {}, {}, {}
  local function ends_of(tr) return tr.src .. "\0" .. tr.tgt end
  for _, tr in ipairs(transitions) do
    counts[ends_of(tr)] = (counts[ends_of(tr)] or 0) + 1
  end
  for _, tr in ipairs(transitions) do
    local ends = ends_of(tr)
    local is_loop = tr.src == tr.tgt or tr.src .. ".initial" == tr.tgt
    local is_bundle = counts[ends] > (is_loop and 1 or 2)
    if not (is_bundle and seen[ends]) then list[#list + 1] = tr end
    seen[ends] = true
  end
  return list
end

-- Drawing: many charts with few runs of Graphviz, whose start takes longest -----------

-- Can only a new process lay a graph out the same each time? Graphviz visits clusters
-- in the order of the addresses of their names, and goes on with layout=nop2.
local function is_alone(text)
  local _, count = text:gsub("subgraph cluster", "")
  return not text:find("layout=nop2", 1, true)
    and (count > 2 or text:find("class=plain", 1, true) ~= nil)
end

-- Calls f(texts, numbers) for lists of texts: those of one process, and their numbers.
local function each_batch(texts, f)
  local batch, numbers = {}, {}
  for i, text in ipairs(texts) do
    if is_alone(text) then
      f({ text }, { i })
    else
      batch[#batch + 1], numbers[#numbers + 1] = text, i
    end
  end
  if batch[1] then f(batch, numbers) end
end

-- Has Graphviz work on several lists of graphs; returns an answer for each.
local function answers_to(requests)
  local answers = {}
  each_batch(requests, function(texts, numbers)
    local next_graph = assert(dot.render(table.concat(texts), "dot")):gmatch(
      "digraph.-\n}\n")
    for i, text in ipairs(texts) do
      local graphs, _, count = {}, text:gsub("%f[^\n%z]digraph {\n", "")
      for j = 1, count do graphs[j] = next_graph() end
      answers[numbers[i]] = table.concat(graphs)
    end
  end)
  return answers
end

--- The layout of each of several machines: { fsm, options of dot.layout }.
function pictures.layouts_of(list)
  local graphs, works, answers = {}, {}, {}
  for i, job in ipairs(list) do
    works[i] = coroutine.wrap(function()
      graphs[i] = dot.layout(job.fsm, job.options, coroutine.yield)
    end)
  end
  while works[1] do
    local waiting, requests = {}, {}
    for i, work in ipairs(works) do
      local request = work(answers[i])
      if request then waiting[#waiting + 1], requests[#waiting + 1] = work, request end
    end
    works, answers = waiting, requests[1] and answers_to(requests)
  end
  return graphs
end

--- The picture of each of several graphs.
function pictures.svgs_of(graphs)
  local svgs = {}
  each_batch(graphs, function(texts, numbers)
    local text, i = assert(dot.render(table.concat(texts), "svg")), 0
    for svg in text:gmatch("<%?xml.-</svg>\n") do
      i = i + 1
      svgs[numbers[i]] = svg:gsub('id="page%d+,%d+_graph0"', 'id="graph0"', 1)
    end
  end)
  return svgs
end

-- The points of an attribute: { { x, y }, ... }.
local function points_in(text)
  local points = {}
  for x, y in text:gmatch("(%-?[%d.]+),(%-?[%d.]+)") do
    points[#points + 1] = { tonumber(x), tonumber(y) }
  end
  return points
end

local function box_of(points)
  local box = { left = 1e9, right = -1e9, top = 1e9, bottom = -1e9 }
  for _, point in ipairs(points) do
    box.left, box.right = math.min(box.left, point[1]), math.max(box.right, point[1])
    box.top, box.bottom = math.min(box.top, point[2]), math.max(box.bottom, point[2])
  end
  return box
end

local ENTITIES = { amp = "&", lt = "<", gt = ">", quot = '"', ["#45"] = "-",
  ["#39"] = "'" }

-- All points of an element, then those of its line and of its last polygon.
local function all_points_in(body)
  local all, path, head = {}, body:match(' d="([^"]*)"'), nil
  for points in body:gmatch('points="([^"]*)"') do head = points_in(points) end
  path = path and points_in(path)
  for _, list in ipairs { path or {}, head or {} } do
    for _, point in ipairs(list) do all[#all + 1] = point end
  end
  local cx, cy, rx = body:match('<ellipse [^>]*cx="(%S+)" cy="(%S+)" rx="(%S+)"')
  if cx then all = { { cx - rx, cy - rx }, { cx + rx, cy + rx } } end
  return all, path, head
end

-- The keys in the id of an element: a bundle has several.
local function keys_in(id)
  local keys = {}
  id = id:gsub("&(#?%w+);", ENTITIES):gsub("(](/?%l*))\\n", "%1\1")
  for key in id:gmatch("[^\1]+") do keys[#keys + 1] = key end
  return keys
end

local function distance_to(box, point)
  local x, y = point[1], point[2]
  return math.max(box.left - x, x - box.right, 0)
    + math.max(box.top - y, y - box.bottom, 0)
end

-- Gives the label of an arrow that Graphviz alone has laid out the ends and the two
-- parts of the arrow.
local function join(shapes)
  for id, first in pairs(shapes) do -- any order: each arrow alone
    local key = id:match("^(.*)/src$")
    local label, last = shapes[key or false], shapes[(key or "") .. "/tgt"]
    if last then
      local from, to = first.ends[1], first.ends[2]
      label.parts = { first.path, last.path }
      label.tip = last.tip
      local is_turned = distance_to(label.box, from) < distance_to(label.box, to)
      label.ends = { is_turned and to or from }
    end
  end
  return shapes
end

-- Returns the ends of a line, that at the base of the arrowhead second. Graphviz draws
-- some lines from their target.
local function ends_of(path, head)
  local first, last = path[1], path[#path]
  local function distance(point)
    return math.abs(point[1] - (head[1][1] + head[3][1]) / 2)
      + math.abs(point[2] - (head[1][2] + head[3][2]) / 2)
  end
  local is_turned = head and distance(first) < distance(last)
  return is_turned and { last, first } or { first, last }
end

--- The elements of a picture by id, each with a box; edges also with their ends, the
-- tip of its arrowhead, and the position of its label. A bundle is there by each key.
function pictures.shapes_of(svg)
  local shapes = {}
  svg = svg:gsub('<g id="a_[^>]*><a [^>]*>\n', ""):gsub("</a>\n</g>\n", "")
  for id, body in svg:gmatch('<g id="([^"]*)" class="%l+ [^"]*">(.-)</g>') do
    local all, path, head = all_points_in(body)
    local x, y = body:match('<text [^>]*x="(%-?[%d.]+)" y="(%-?[%d.]+)"')
    local shape = { box = box_of(all), path = path, parts = { path },
      ends = path and ends_of(path, head), tip = head and head[2],
      label = x and { tonumber(x), tonumber(y) } }
    for _, key in ipairs(keys_in(id)) do shapes[key] = shape end
  end
  return join(shapes)
end

--- The direction, in degrees, in which a line leaves a point: to the next point, or to
-- the one before it if `step` is -1, which is not at the same place.
function pictures.direction_at(path, i, step)
  local from, j = path[i], i + step
  while path[j + step] and math.abs(path[j][1] - from[1])
    + math.abs(path[j][2] - from[2]) < 0.1 do
    j = j + step
  end
  local y, x = (path[j][2] - from[2]) * step, (path[j][1] - from[1]) * step
  local angle = math.deg(math.acos(x / math.max(1e-9, math.sqrt(x * x + y * y))))
  return y < 0 and -angle or angle
end

local function between(a, b, share)
  return { a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share }
end

--- Points of a line, about one for each 10 % of each curve in it.
function pictures.points_on(path)
  local points = {}
  for i = 1, #path - 3, 3 do
    for share = 0, 1, 0.1 do
      local a, b, c, d = path[i], path[i + 1], path[i + 2], path[i + 3]
      local first = between(between(a, b, share), between(b, c, share), share)
      local second = between(between(b, c, share), between(c, d, share), share)
      points[#points + 1] = between(first, second, share)
    end
  end
  return points
end

-- At which side of the line from `a` to `b` is `c`? Above 0, below 0, or on it.
local function side_of(a, b, c)
  return (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
end

local function count_crossings(path, other)
  local count = 0
  for i = 2, #path do
    local a, b = path[i - 1], path[i]
    for j = 2, #other do
      local c, d = other[j - 1], other[j]
      if side_of(a, b, c) * side_of(a, b, d) < 0
        and side_of(c, d, a) * side_of(c, d, b) < 0 then count = count + 1 end
    end
  end
  return count
end

--- How often the arrows of a picture cross each other.
function pictures.crossings(shapes)
  local paths, count = {}, 0
  for _, shape in pairs(shapes) do -- any order: each pair is counted
    local path = shape.path and pictures.points_on(shape.path)
    for _, other in ipairs(path and paths or {}) do
      count = count + count_crossings(path, other)
    end
    paths[#paths + 1] = path
  end
  return count
end

--- The largest angle, in degrees, between two curves of a line where they meet.
function pictures.sharpest_bend(path)
  local sharpest = 0
  for i = 4, #path - 3, 3 do
    local bend = math.abs(pictures.direction_at(path, i, -1)
      - pictures.direction_at(path, i, 1))
    sharpest = math.max(sharpest, math.min(bend, 360 - bend))
  end
  return sharpest
end

return pictures
