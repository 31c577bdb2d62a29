-- Pictures of random charts, with regions and odd names, by the real tools.

local diagram = require "rfsm.pictures.diagram"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local new_random = require "spec.support.random"
local pictures = require "spec.support.pictures"
local rfsm = require "rfsm"
local robots = require "spec.support.robot_charts"
local share = require "spec.support.share"

local content, file_with = helper.content, helper.file_with
local COUNT = share.count(6) -- random charts
local seed = share.seed(COUNT)

after_each(helper.remove_files)

-- Reads the output of a command, and its messages.
local function run(command)
  local log = file_with("")
  return helper.text_of(command .. " 2>'" .. log .. "'"), content(log)
end

local dot = require "rfsm.dot"

-- The picture of a graph, which Graphviz draws without a word.
local function svg_of(graph)
  local picture, messages = run("dot -Tsvg '" .. file_with(graph) .. "'")
  assert.equal("", messages)
  assert.equal("</svg>\n", picture:sub(-7))
  return picture
end

local function random_machine(number) return helper.init(pictures.model(number, 6)) end

local function wide_machine(number) return helper.init(pictures.wide_model(number)) end

-- The nodes by FQN, and the transitions that are arrows, of a full description.
local function elements_of(tab, fqn, nodes, arrows)
  nodes[fqn] = tab
  for _, tr in ipairs(tab.transitions or {}) do
    if not tr.internal then arrows[#arrows + 1] = tr end
  end
  for _, list in ipairs { tab.subnodes or {}, tab.regions or {} } do
    for _, subtab in ipairs(list) do
      elements_of(subtab, fqn .. "." .. subtab.id, nodes, arrows)
    end
  end
  return nodes, arrows
end

local function contains(composite, fqn)
  return fqn:sub(1, #composite + 1) == composite .. "."
end

local function is_composite(tab)
  return tab.subnodes ~= nil or tab.regions ~= nil
end

-- Names as they are in ids.
local function id_of(fqn) return (diagram.clean(fqn):gsub("\n", "\\n")) end

-- The composites whose frames are around a point.
local function frames_around(point, shapes, nodes)
  local x, y = point[1], point[2]
  return rfsm.sorted_keys(nodes, function(tab, fqn)
    local frame = shapes[id_of(fqn)].box
    return is_composite(tab) and x > frame.left and x < frame.right and y > frame.top
      and y < frame.bottom
  end)
end

-- The end of an arrow: of a composite that is entered from outside, its frame.
local function target_of(tr)
  local composite = tr.tgt:match("^(.*)%.initial$")
  return composite and not contains(composite, tr.src) and composite or tr.tgt
end

-- The composites around the label of a transition, which is in its source if it leads
-- into it, and if the picture is not Graphviz's own.
local function composites_around(tr, nodes, is_plain)
  return rfsm.sorted_keys(nodes, function(tab, fqn)
    return is_composite(tab) and contains(fqn, target_of(tr))
      and (contains(fqn, tr.src) or fqn == tr.src and not is_plain)
  end)
end

-- How far a point is from the border of a box.
local function distance_to(box, point)
  local x, y = point[1], point[2]
  local across = math.max(box.left - x, x - box.right)
  local along = math.max(box.top - y, y - box.bottom)
  if across < 0 and along < 0 then return -math.max(across, along) end
  return math.max(across, along)
end

-- Points between the end of an arrow and what it belongs to: the text of a connector is
-- beside its mark, states have round corners.
local TOUCH = { state = 4, connector = 8 }

local function is_deep_in(box, point)
  local x, y = point[1], point[2]
  return x > box.left + 3 and x < box.right - 3 and y > box.top + 3
    and y < box.bottom - 3
end

-- Lists the leaves that the label or the line of an arrow covers.
local function covered_by(tr, shapes, nodes)
  local arrow, list = shapes[id_of(tr.key)], {}
  local points = { arrow.label }
  for _, part in ipairs(arrow.parts) do
    for _, point in ipairs(pictures.points_on(part)) do points[#points + 1] = point end
  end
  for fqn, tab in pairs(nodes) do -- any order: a set
    local is_other = fqn ~= tr.src and fqn ~= tr.tgt and tab.type == "state"
      and not is_composite(tab)
    for _, point in ipairs(is_other and points or {}) do
      if is_deep_in(shapes[id_of(fqn)].box, point) then
        list[#list + 1] = tr.key .. " covers " .. fqn
        break
      end
    end
  end
  return list
end

local FEW = 3 -- leaves that are covered: Graphviz does so in one of 100 charts

local function check_clear(arrows, shapes, nodes)
  local list = {}
  for _, tr in ipairs(arrows) do
    for _, text in ipairs(covered_by(tr, shapes, nodes)) do list[#list + 1] = text end
  end
  assert.is_true(#list <= FEW, table.concat(list, ", "))
end

local function check_arrow(tr, shapes, nodes, is_plain)
  local arrow, tgt = shapes[id_of(tr.key)], target_of(tr)
  if arrow.label then
    assert.same(composites_around(tr, nodes, is_plain),
      frames_around(arrow.label, shapes, nodes), tr.key)
  end
  assert.is_true(distance_to(shapes[id_of(tr.src)].box, arrow.ends[1])
    <= TOUCH[nodes[tr.src].type], tr.key .. " begins at " .. tr.src)
  assert.is_true(distance_to(shapes[id_of(tgt)].box, arrow.tip)
    <= TOUCH[nodes[tgt].type], tr.key .. " ends at " .. tgt)
  for _, part in ipairs(arrow.parts) do
    assert.is_true(pictures.sharpest_bend(part) < 10, tr.key .. " is smooth")
  end
end

local function is_apart(a, b)
  return a.right <= b.left or b.right <= a.left or a.bottom <= b.top
    or b.bottom <= a.top
end

-- Checks that what is in a composite is inside of its frame, and that nothing in it
-- covers anything else.
local function check_members(composite, fqn, shapes)
  local frame, boxes = shapes[id_of(fqn)].box, {}
  for _, list in ipairs { composite.subnodes or {}, composite.regions or {} } do
    for _, node in ipairs(list) do
      local box = shapes[id_of(fqn .. "." .. node.id)].box
      assert.is_true(box.left > frame.left and box.right < frame.right
        and box.top > frame.top and box.bottom < frame.bottom, node.id .. " is outside")
      for _, other in ipairs(boxes) do
        assert.is_true(is_apart(box, other), node.id .. " covers another state")
      end
      boxes[#boxes + 1] = box
    end
  end
end

-- Regions are from left to right, in the order in which they are stepped; those with
-- states in them have one height.
local function check_regions(state, fqn, shapes)
  local right, frame = -1 / 0, nil
  for _, region in ipairs(state.regions or {}) do
    local box = shapes[id_of(fqn .. "." .. region.id)].box
    assert.is_true(box.left > right, region.id .. " is beside another region")
    right = box.right
    if is_composite(region) then
      frame = frame or box
      assert.same({ frame.top, frame.bottom }, { box.top, box.bottom })
    end
  end
end

describe("Graphviz", function()
  it(("puts random charts from %d on where they belong"):format(seed), function()
    local jobs = {}
    for number = seed, seed + COUNT - 1 do
      for _, fsm in ipairs { random_machine(number), wide_machine(number) } do
        for _, direction in ipairs { "TB", "LR" } do
          jobs[#jobs + 1] = { fsm = fsm, options = { direction = direction } }
        end
      end
    end
    for i, graph in ipairs(pictures.layouts_of(jobs)) do
      local shapes, job = pictures.shapes_of(svg_of(graph)), jobs[i]
      local nodes, arrows = elements_of(marsh.model2tab(job.fsm, true), "root", {}, {})
      for fqn, tab in pairs(nodes) do -- any order
        assert.is_truthy(shapes[id_of(fqn)], fqn)
        check_members(tab, fqn, shapes)
        if job.options.direction == "TB" and graph:find("class=levels", 1, true) then
          check_regions(tab, fqn, shapes)
        end
      end
      local is_plain = graph:find("class=plain", 1, true)
      for _, tr in ipairs(arrows) do check_arrow(tr, shapes, nodes, is_plain) end
      check_clear(arrows, shapes, nodes)
    end
  end)

  it("draws a graph without positions, too", function()
    for number = seed, seed + COUNT - 1 do
      svg_of(dot.encode(random_machine(number)))
    end
  end)

  it("shows any names as they are", function()
    local picture = svg_of(assert(dot.layout(helper.init(pictures.odd()),
      'T "x" \\ & <i>\nnew')))
    for _, text in ipairs { "q&quot;q", "&lt;b&gt;", "&amp;amp;", "%d", "état",
      "&lt;&lt;choice&gt;&gt;", "|", "T &quot;x&quot; \\ &amp; &lt;i&gt;", "new" } do
      assert.is_truthy(picture:find(">" .. text .. "<", 1, true), text)
    end
  end)
end)

-- The machine of a chart, which prints nothing.
local function quiet_machine(path)
  local fsm
  helper.printed(function() fsm = helper.init(rfsm.load(path)) end)
  return fsm
end

-- The size of a text of 10 pt on a page of A4 with margins, at most 7.
local function text_on_paper(svg)
  local width, height = svg:match('<svg width="(%d+)pt" height="(%d+)pt"')
  local function fits(across, along)
    return math.min(across / width, along / height)
  end
  return math.min(7, 10 * math.max(fits(523, 770), fits(770, 523)))
end

describe("a picture", function()
  local list = {}
  for path in io.popen("ls examples/*.lua"):lines() do
    list[#list + 1] = { name = path, fsm = quiet_machine(path) }
  end
  for _, robot in ipairs(robots) do
    list[#list + 1] = { name = robot.name, fsm = helper.init(robots.model(robot)) }
  end
  local own, plain = share.of(list), {}
  for i, job in ipairs(own) do plain[i] = dot.encode(job.fsm) end
  local svgs, others = pictures.svgs_of(pictures.layouts_of(own)),
    pictures.svgs_of(plain)

  for i, job in ipairs(own) do
    it("is no worse than by plain Graphviz: " .. job.name, function()
      local shapes, tab = pictures.shapes_of(svgs[i]), marsh.model2tab(job.fsm, true)
      local count, others_count = pictures.crossings(shapes),
        pictures.crossings(pictures.shapes_of(others[i]))
      assert.is_true(count <= others_count, count .. " > " .. others_count)
      assert.is_true(text_on_paper(svgs[i]) >= text_on_paper(others[i]))
      local nodes, arrows = elements_of(tab, "root", {}, {})
      for _, tr in ipairs(arrows) do
        assert.same({}, covered_by(tr, shapes, nodes))
      end
    end)
  end
end)

-- s1 -> ... s9 with random transitions; `edit` adds one more.
local function nine_states(number, edit)
  local model, random = rfsm.state { info = false, warn = false }, new_random(number)
  for i = 1, 9 do
    model["s" .. i] = rfsm.state {}
    model[i] = rfsm.trans { src = i > 1 and "s" .. i - 1 or "initial", tgt = "s" .. i }
  end
  local function add(any)
    model[#model + 1] = rfsm.trans { src = "s" .. any(9), tgt = "s" .. any(9),
      events = { "e_" .. #model } }
  end
  for _ = 1, 4 + number % 4 do add(random) end
  if edit then add(new_random(1000 * number + edit)) end
  return helper.init(model)
end

-- How far states are from where they were, at most: 90 % of them.
local function movement(distances)
  table.sort(distances)
  return distances[math.floor(#distances * 0.9)]
end

local function add_distances(list, before, after)
  before, after = pictures.shapes_of(before), pictures.shapes_of(after)
  for i = 1, 9 do
    local a, b = before["root.s" .. i].box, after["root.s" .. i].box
    local x, y = (a.left + a.right - b.left - b.right) / 2,
      (a.top + a.bottom - b.top - b.bottom) / 2
    list[#list + 1] = math.sqrt(x * x + y * y)
  end
end

local function kind_of(svg) return svg:match('class="graph (%l+)"') end

describe("a picture like a former one", function()
  it("moves no further than by plain Graphviz when a transition is added", function()
    local jobs, plain, edits = {}, {}, {}
    for number = 13, 24 do
      jobs[#jobs + 1] = { fsm = nine_states(number) }
    end
    local former = pictures.svgs_of(pictures.layouts_of(jobs))
    for i, job in ipairs(jobs) do
      plain[#plain + 1] = dot.encode(job.fsm)
      for edit = 1, 3 do
        local fsm = nine_states(12 + i, edit)
        plain[#plain + 1] = dot.encode(fsm)
        edits[#edits + 1] = { fsm = fsm, options = { like = former[i] } }
      end
    end
    local others, own = pictures.svgs_of(plain),
      pictures.svgs_of(pictures.layouts_of(edits))
    local moved, others_moved, turned = {}, {}, 0
    for i, svg in ipairs(own) do
      local first = math.floor((i - 1) / 3) + 1
      add_distances(moved, former[first], svg)
      add_distances(others_moved, others[4 * first - 3], others[i + first])
      turned = turned + (kind_of(svg) ~= kind_of(former[first]) and 1 or 0)
    end
    assert.is_true(movement(moved) <= movement(others_moved))
    assert.is_true(turned <= 2, turned)
  end)

  -- a{ c, d }, b
  local function model(texts)
    local root = rfsm.state { info = false, warn = false, b = rfsm.state {},
      a = rfsm.state { c = rfsm.state {}, d = rfsm.state {},
        rfsm.trans { src = "initial", tgt = texts[1] } } }
    for i = 2, #texts, 2 do
      root[#root + 1] = rfsm.trans { src = texts[i], tgt = texts[i + 1] }
    end
    return root
  end

  local function order_of(machine, like)
    local names = {}
    for name in dot.encode(machine, { like = like }):gmatch('\n +root_([%w_]+) %[') do
      names[#names + 1] = name
    end
    return table.concat(names, " ")
  end

  it("has its order of nodes; a new one comes behind what is before it", function()
    local before = helper.init(model { "c", "initial", "a", "a", "b", ".a.c", ".a.d" })
    local svg = assert(dot.render(assert(dot.layout(before)), "svg"))
    local changed = model { "d", "initial", "b", "b", "a", ".a.d", "n", ".a.c", ".a.d" }
    changed.n = rfsm.state {}
    local after = helper.init(changed)
    assert.equal("initial b a_initial a_d a_c n", order_of(after))
    assert.equal("initial a_initial a_c a_d n b", order_of(after, svg))
    assert.equal(order_of(after), order_of(after, "<svg/>"))
  end)

  it("reads names as they are in an SVG, and keeps regions", function()
    local root = rfsm.state { info = false, warn = false,
      rfsm.trans { src = "initial", tgt = "a-<&>" } }
    root["a-<&>"], root.b = rfsm.state {}, rfsm.seqand { y = rfsm.state {},
      x = rfsm.state {} }
    local text = order_of(helper.init(root))
    local like = '<g id="root.b.y" class="node"/><g id="root.b.x" class="node"/>'
      .. '<g id="root.a&#45;&lt;&amp;&gt;" class="node"/>'
    assert.equal("initial a____ b_x b_y", text)
    assert.equal("initial b_x b_y a____", order_of(helper.init(root), like))
  end)
end)

-- Is Graphviz here the one that has drawn the gallery, with the same fonts?
local function is_of_gallery()
  local graph = file_with('digraph { node [shape=plain, fontname="Helvetica,Arial,'
    .. 'sans-serif", fontsize=12] n [label="The quick brown fox jumps"] }')
  local width = run("dot -Tplain '" .. graph .. "'"):match("node n %S+ %S+ (%S+)")
  local _, version = run("dot -V")
  return width == "2.2222" and version:find(" 2.43.0 ", 1, true) ~= nil
end

-- The ids in the picture of a machine, and those that Graphviz has given in a file.
local function compare_ids(fsm, file)
  local expected, found = {}, pictures.shapes_of(content(file))
  local nodes, arrows = elements_of(marsh.model2tab(fsm, true), "root", {}, {})
  for fqn in pairs(nodes) do expected[id_of(fqn)] = true end -- any order
  for _, tr in ipairs(arrows) do
    local key = id_of(tr.key)
    expected[key] = true
    for _, part in ipairs(found[key .. "/src"] and { "/src", "/tgt" } or {}) do
      expected[key .. part] = true
    end
  end
  for id in pairs(expected) do assert.is_truthy(found[id], file .. " lacks " .. id) end
  for id in pairs(found) do -- any order
    assert.is_truthy(expected[id], file .. " has " .. id)
  end
end

-- The lines of a picture in a fixed order: Graphviz draws frames in that of addresses.
local function lines_of(svg)
  local lines = {}
  for line in svg:gmatch("[^\n]+") do lines[#lines + 1] = line end
  table.sort(lines)
  return table.concat(lines, "\n")
end

-- The pictures of doc/gallery: their machines, and the options of their drawing.
local function gallery()
  local list = {}
  for path in io.popen("ls examples/*.lua doc/gallery/*.lua"):lines() do
    local name = path:match("([^/]+)%.lua$")
    list[#list + 1] = { name = name, fsm = quiet_machine(path),
      options = { title = name } }
  end
  for _, name in ipairs { "loops", "recipe" } do
    list[#list + 1] = { name = name .. "_lr",
      fsm = quiet_machine("doc/gallery/" .. name .. ".lua"),
      options = { title = name, direction = "LR" } }
  end
  return list
end

describe("doc/gallery", function()
  local list = gallery()

  it("has the pictures of its charts, drawn anew", function()
    if not is_of_gallery() then
      return pending("not the Graphviz, or the fonts, of make test")
    end
    local own = share.of(list)
    local svgs = pictures.svgs_of(pictures.layouts_of(own))
    for i, job in ipairs(own) do
      local file = "doc/gallery/" .. job.name .. ".svg"
      assert.is_true(lines_of(svgs[i]) == lines_of(content(file)),
        file .. ": make gallery")
    end
  end)

  for _, job in ipairs(list) do
    it("shows each element of " .. job.name .. ", and is linked", function()
      local name = job.name .. ".svg"
      compare_ids(job.fsm, "doc/gallery/" .. name)
      assert.is_truthy(content("doc/gallery/README.md"):find("(" .. name .. ")", 1,
        true))
    end)
  end
end)

-- Saves random charts, and one of odd names, in a language; returns the folder.
local function save_all(language, ending)
  local folder = os.tmpname()
  os.remove(folder)
  os.execute("mkdir '" .. folder .. "'")
  local encode = require("rfsm." .. language).encode
  local function save(name, fsm)
    local file = assert(io.open(("%s/%s.%s"):format(folder, name, ending), "wb"))
    file:write(encode(fsm, { title = 'T "x" \\ & <i>\nnew', direction = "LR" }))
    file:close()
  end
  for number = seed, seed + 19 do save(number, random_machine(number)) end
  save("odd", helper.init(pictures.odd()))
  return folder
end

-- Runs a command, with the files of a language for FILES, if `program` is installed.
local function parse(program, command, language, ending)
  if run("command -v " .. program) == "" then
    return pending(program .. " is not installed")
  end
  local folder = save_all(language, ending)
  local text, messages = run((command:gsub("FILES", folder .. "/*." .. ending)))
  os.execute("rm -r '" .. folder .. "'")
  return text .. messages
end

-- The texts are the same on each Lua, so that one of them is enough for a slow program.
describe("PlantUML", function()
  if rawget(_G, "jit") or _VERSION ~= "Lua 5.1" then return end

  it("finds no mistake in random charts, or with any names", function()
    local said = parse("plantuml", "plantuml -checkonly -stdrpt:1 FILES", "plantuml",
      "puml")
    assert.equal("", said or "")
  end)
end)

describe("Mermaid", function()
  it("finds no mistake in random charts, or with any names", function()
    local folder = os.getenv("MERMAID")
    if not folder then
      return pending("MERMAID: no folder in which npm has installed mermaid and jsdom")
    end
    local said = parse("node", ("cp spec/support/mermaid.mjs '%s' && node "
      .. "'%s/mermaid.mjs' FILES"):format(folder, folder), "mermaid", "mmd")
    assert.equal("21 parsed\n", said or "21 parsed\n")
  end)
end)
