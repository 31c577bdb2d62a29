-- The page in headless Chromium: `make test-web`. The server lives in this process and
-- goes on while the browser is asked something. SHOTS=folder keeps screenshots there.

local dot = require "rfsm.dot"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local Painter = require "rfsm.web.picture"
local proto = require "rfsm.proto"
local rfsm = require "rfsm"
local socket = require "socket"
local web = require "rfsm.web"
local webdriver = require "spec.support.webdriver"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local CHART = "examples/ball_tracking.lua"

local servers, driver, window = {}, nil, nil
local host -- a machine that runs meanwhile

local function pump(seconds)
  if not servers[1] then return socket.select(nil, nil, seconds) end
  for _, server in ipairs(servers) do server:step(seconds / #servers) end
  if host then rfsm.run(host) end
end

local function keep(server)
  servers[#servers + 1] = server
  return server
end

local function open(file, port)
  return keep(assert(web.open(file, { port = port or 0 })))
end

-- On a port that the system gives to no connection: it stays free when the server is
-- gone.
local function open_below_ephemeral(file)
  local any = web.open(file, { port = 0 })
  any:close()
  for port = 18000 + any.port % 1000, 20000 do -- not the same for two of these specs
    local server = web.open(file, { port = port })
    if server then return keep(server) end
  end
end

local function close_all()
  for i = #servers, 1, -1 do servers[i]:close() end
  helper.clear(servers)
end

-- Opens the page of a chart and waits until its machine is shown.
local function visit(file)
  local server = open(file)
  window:open(server.url)
  window:wait "now.active && marks.nodes.length && document.querySelector('.active')"
  return server
end

local function visit_picture(file)
  local server = visit(file)
  window:wait "document.querySelector('#view > svg .active')"
  return server
end

-- Has the page draw boxes, as without Graphviz. A picture that came later would take
-- their place.
local function show_boxes()
  window:wait "!chart.has_picture || document.querySelector('#view > svg')"
  window:run "chart.has_picture = false; draw()"
  window:wait "document.querySelector('#boxes .active')"
end

-- The names of the leaves that are lit in the diagram.
local LIT = [[
  [...document.querySelectorAll(".leaf.active b, .node.state.active > text")]
    .map(e => e.textContent).filter(t => !t.includes("/"))]]

local function lit() return window:run("return " .. LIT) end

local function prefer(scheme)
  window:chromium("Emulation.setEmulatedMedia",
    { features = { { name = "prefers-color-scheme", value = scheme } } })
end

local function texts(selector) return window:texts(selector) end

setup(function()
  driver = webdriver.start(pump)
  window = driver:window()
end)

teardown(function() driver:stop() end)

before_each(function() window:resize(1280, 860) end)

after_each(function()
  window:chromium("Emulation.setEmulatedMedia", { features = {} })
  close_all()
  host = nil
  proto.uninstall()
  helper.remove_files()
end)

-- Composites in composites, side by side: never are all of them active.
local NESTED = [[
local rfsm = require "rfsm"
local seqand = require "rfsm_seqand"
local state, trans = rfsm.state, rfsm.trans

local function nest(depth)
  if depth == 0 then return state { entry = print } end
  return state { entry = print, info = false, warn = false,
    way = rfsm.conn {}, inner = nest(depth - 1),
    trans { src = "initial", tgt = "way" }, trans { src = "way", tgt = "inner" },
    trans { src = "inner", tgt = "inner", events = { "e_again" } } }
end

return state { a = nest(3), b = nest(3), c = seqand { l = nest(1), r = nest(1) },
  trans { src = "initial", tgt = "a" },
  trans { src = "a", tgt = "b", events = { "e_b" } },
  trans { src = "b", tgt = "c", events = { "e_c" } } }
]]

describe("the page", function()
  it("shows where the machine stands, lights it, and marks its events", function()
    visit_picture(CHART)
    window:keep_shot "idle"
    assert.same({ "searching" }, lit())
    assert.equal("none", window:run [[ // the outer frame of a final state
      return getComputedStyle(document.getElementById("root.fatal")
        .querySelectorAll("path")[1]).fill]])
    assert.same({ "e_stop", "e_ball" }, texts "#events .enabled")
    assert.same({ "e_setup_failed", "e_stop", "e_start", "e_ball", "e_lost" },
      texts "#events button")
    window:click "#events .enabled:nth-of-type(5)"
    window:wait "now.leaf == 'root.operational.tracking'"
    assert.same({ "tracking" }, lit())
    assert.same({ "tracking" }, texts "#path b")
    assert.same({ "e_stop", "e_lost" }, texts "#events .enabled")
    assert.equal("root.operational.searching → root.operational.tracking",
      texts("tr.step td:nth-child(3)")[1])
  end)

  it("is driven by keys, says why nothing happened, and goes back", function()
    visit_picture(CHART)
    window:type "452"
    window:wait "now.leaf == 'root.stopped' && document.querySelector('.edge.taken')"
    window:keep_shot "events"
    assert.same({ "stopped" }, lit())
    window:type "5"
    window:wait "!document.querySelector('#why').hidden"
    assert.same({}, texts "#why li")
    window:type "w"
    window:wait "document.querySelector('#why li')"
    window:keep_shot "why"
    assert.matches("waits for e_start", table.concat(texts "#why li"))
    window:type "b"
    window:wait "document.querySelector('#why').hidden"
    window:type "bb"
    window:wait "now.leaf == 'root.operational.tracking'"
    window:type "0"
    window:wait "document.querySelector('#sure').open"
    window:type "\n"
    window:wait "now.leaf == 'root.operational.searching'"
    assert.is_true(window:run "return now.can_back")
    assert.is_true(#texts "#log tr" > 6) -- the log goes on
    window:type "/lo"
    assert.same({ "e_lost" }, texts "#events button")
    window:type "\n/e_nothing\n"
    window:wait "document.querySelector('tr.lost')"
  end)

  it("queues events, steps through them, and goes back to a line of the log", function()
    visit(CHART)
    window:click "#auto input"
    window:type "42"
    window:wait "document.querySelectorAll('#queue span:not(.none)').length == 2"
    window:type "s"
    window:wait "now.leaf == 'root.stopped'" -- the outer transition is taken
    window:type "r"
    window:wait "now.queue.length == 0"
    window:click "tr:last-child button"
    window:wait "!now.can_back"
    assert.same({ "searching" }, lit())
  end)

  it("sends events with data, as fields, Lua table or JSON; bad data is one line there",
    function()
      visit(helper.file_with [[
        local rfsm = require "rfsm"
        return rfsm.state { read = "one",
          open = rfsm.state {}, paid = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "open" },
          rfsm.trans { src = "open", tgt = "paid", events = { rfsm.named "e_paid" },
            guard = function(_, _, event) return event.amount == 12 end },
          rfsm.trans { src = "paid", tgt = "open", events = { "e_back" } },
        }
      ]])
      local function send(event, data)
        window:run("$('send').event.value = arguments[0], "
          .. "$('send').data.value = arguments[1]", event or "", data)
        window:click(event and "#send button" or "#events button:nth-of-type(1)")
      end
      assert.same({ "e_paid", "e_back" }, texts "#events button")
      for _, case in ipairs { { nil, "amount = 12" }, { nil, "{ amount = 12 }" },
        { nil, '{"amount": 12}' }, { "e_paid", '"amount": 12' },
        { "e_paid{amount=12}", "" }, { '{"name": "e_paid", "amount": 12}', "" } } do
        send(case[1], case[2])
        window:wait "now.leaf == 'root.paid'"
        send("e_back", "")
        window:wait "now.leaf == 'root.open'"
      end
      assert.same({ "e_back", "e_init_fsm", "e_paid{amount=12}" }, window:run [[
        return [...new Set([...document.querySelectorAll("tr.step td:nth-child(2)")]
          .map(e => e.textContent))].sort()]])
      for data, problem in pairs { -- any order: each stands alone
        ["amount"] = "data: a text in quotes, a number, true, false or a table "
          .. "expected, got 'amount'",
        ['{"amount": 12'] = "data: ',' or '}' expected, got the end",
      } do
        send(nil, data)
        window:wait("!$('wrong').hidden && $('wrong').textContent.includes(\"data: \")")
        assert.same({ problem }, texts "#wrong")
        assert.equal("root.open", window:run "return now.leaf")
      end
      send(nil, "amount = 11")
      window:wait "document.querySelector('tr.lost')"
      assert.same({ true, { "e_paid{amount=11}" } }, { window:run
        "return $('wrong').hidden", texts "#lost" })
      window:type "w"
      window:wait "document.querySelector('#why li')"
      assert.matches("its guard returns false", table.concat(texts "#why li"))
      window:click "#auto input"
      send(nil, "amount = 12")
      window:wait "now.queue.length == 1"
      assert.same({ "e_paid{amount=12}" }, texts "#queue span")
    end)

  it("shows an error of a callback", function()
    local file = helper.file_with [[
      local rfsm = require "rfsm"
      return rfsm.state {
        off = rfsm.state {},
        on = rfsm.state { entry = function() error("no power", 0) end },
        rfsm.trans { src = "initial", tgt = "off" },
        rfsm.trans { src = "off", tgt = "on", events = { "e_push" } },
        rfsm.trans { src = "on", tgt = "off", events = { "e_push" } },
      }
    ]]
    visit(file)
    window:type "1"
    -- rows may be drawn anew between two looks
    window:wait("[...document.querySelectorAll('tr.error td:nth-child(3)')].some("
      .. "d => d.textContent.trim() == 'error executing entry of root.on: no power')")
  end)

  it("draws boxes of its own when there is no picture", function()
    visit "examples/seqand.lua"
    show_boxes()
    window:keep_shot "boxes"
    assert.same({ "open", "open" }, lit())
    assert.equal(2, window:run "return document.querySelectorAll('.region').length")
    window:click "#events .enabled:nth-of-type(3)"
    window:wait "now.log.some(entry => entry.events?.includes('e_grasp'))"
    assert.same({ "closed", "closed" }, lit())
    assert.equal(2, window:run "return document.querySelectorAll('path.taken').length")
  end)

  it("lets no text of a chart become a part of itself", function()
    local file = helper.file_with [[
      local rfsm = require "rfsm"
      local name = "<img src=x onerror='alert(1)'>"
      return rfsm.state {
        [name] = rfsm.state { entry = function() print("<script>1</script>") end },
        b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = name },
        rfsm.trans { src = name, tgt = "b", events = { "</button><b id=evil>" } },
        rfsm.trans { src = "b", tgt = name, events = { "&amp;" } },
      }
    ]]
    visit(file)
    show_boxes()
    window:type "1"
    window:wait "now.leaf == 'root.b'"
    assert.same({}, texts "img, #evil")
  end)

  it("comes compressed where the server can: chart and picture, too", function()
    if not pcall(require, "zlib") then return pending("lua-zlib is missing") end
    visit_picture(helper.file_with(NESTED))
    assert.same({}, window:run [[
      return [...performance.getEntriesByType("navigation"),
        ...performance.getEntriesByType("resource")].filter(e =>
          e.decodedBodySize > 1400 && e.encodedBodySize > e.decodedBodySize / 2.5)
        .map(e => e.name)]])
    assert.is_true(window:run [[
      return performance.getEntriesByType("navigation")[0].decodedBodySize > 5e4]])
  end)

  it("shows two browsers the same", function()
    local server = visit(CHART)
    local other = driver:window()
    other:open(server.url)
    other:wait "document.querySelector('.active')"
    window:type "4"
    other:wait "now.leaf == 'root.operational.tracking'"
    other:type "2"
    window:wait "now.leaf == 'root.stopped'"
    other:close()
  end)

  it("says that the server is gone, and goes on when it is back", function()
    local port = open_below_ephemeral(CHART).port
    window:open(servers[1].url)
    window:wait "document.querySelector('.active')"
    window:run "window.isOld = true"
    close_all()
    window:wait "document.body.classList.contains('gone')"
    window:keep_shot "gone"
    open(CHART, port)
    window:wait "!window.isOld && document.querySelector('.active')"
    window:type "4"
    window:wait "now.leaf == 'root.operational.tracking'" -- with the new token
  end)

  it("shows the mistakes of a chart, until they are mended", function()
    local file = helper.file_with [[
local rfsm = require "rfsm"

return rfsm.state {
  off = rfsm.state {},
  on = rfsm.state { entry = "led" },
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "onn", events = { "e_push" } },
  rfsm.trans { src = "on", tgt = "off", events = { "e_push" }, guard = true },
}
]]
    local server = open(file)
    window:open(server.url)
    window:wait "document.querySelectorAll('#problems li').length == 3"
    window:keep_shot "error"
    assert.same({ file .. ":5", file .. ":7", file .. ":8" }, texts "#problems code")
    local mended = helper.content(file):gsub('entry = "led"', "")
      :gsub('"onn"', '"on"'):gsub(", guard = true", "")
    local handle = assert(io.open(file, "wb"))
    handle:write(mended)
    handle:close()
    window:wait "document.querySelector('.active')"
    assert.same({ "off" }, lit())
  end)

  it("fits a phone, and has a dark side", function()
    visit_picture(CHART)
    window:type "45"
    prefer "dark"
    window:wait "now.turn != 0 && document.querySelector('.edge.taken')"
    window:keep_shot "dark"
    assert.equal("rgb(18, 22, 26)", window:run [[
      return getComputedStyle(document.documentElement).backgroundColor]])
    window:chromium("Emulation.setEmulatedMedia", { features = {} })
    window:resize(390, 844)
    window:keep_shot "phone"
    assert.equal(390, window:run "return document.documentElement.scrollWidth")
    for _, height in ipairs(window:run [[
      return [...document.querySelectorAll("#drive button, #events button")]
        .filter(e => !e.hidden).map(e => e.offsetHeight)]]) do
      assert.is_true(height >= 44) -- a finger's breadth
    end
  end)

  it("shows why a command was refused", function()
    visit(CHART)
    window:run "command('back', { to: 99 })"
    window:wait "!document.querySelector('#refused').hidden"
    assert.same({ "there is no such turn" }, texts "#refused")
  end)

  it("names its buttons, and can be used with the keyboard alone", function()
    visit(CHART)
    assert.equal(0, window:run [[
      return [...document.querySelectorAll("button, input")]
        .filter(e => !e.innerText.trim() && !e.ariaLabel && !e.closest("label"))
        .length]])
    window:type "?"
    window:wait "document.querySelector('#keys').open"
    window:type "\n"
    window:wait "!document.querySelector('#keys').open"
  end)

  it("has file and line of callbacks as a tooltip, and the nearest event", function()
    visit_picture(CHART)
    assert.matches("^entry ball_tracking.lua:%d+$", window:run [[
      return document.getElementById("root.setup").querySelector("title").textContent]])
    assert.same({}, texts "#view a")
    window:type "/e_stopp\n"
    window:wait "!document.querySelector('#refused').hidden"
    assert.same({ "no transition names 'e_stopp' (did you mean 'e_stop'?)" },
      texts "#refused")
  end)

  it("shows a machine elsewhere", function()
    local door = proto.install { port = 0, allow_send = true }
    host = rfsm.init(rfsm.load "examples/on_off.lua")
    local server = keep(assert(web.attach("127.0.0.1", door.port, { port = 0 })))
    window:open(server.url)
    window:wait "document.querySelector('.active') && chart.has_picture"
    assert.same({ "off" }, lit())
    assert.same({}, texts "[data-do=step]")
    window:type "1"
    window:wait "now.leaf == 'root.on'"
  end)
end)

-- Ten composites of ten composites of ten leaves.
local LARGE = [[
local rfsm = require "rfsm"

local function composite(depth, prefix)
  local model = {}
  for i = 0, 9 do
    model["s" .. i] = depth > 1 and composite(depth - 1, prefix .. i) or rfsm.state {}
    model[#model + 1] = rfsm.trans { src = "s" .. i, tgt = "s" .. (i + 1) % 10,
      events = { "e_" .. prefix .. i } }
  end
  model[#model + 1] = rfsm.trans { src = "initial", tgt = "s0" }
  return rfsm.state(model)
end

return composite(3, "")
]]

-- Sends events; returns the milliseconds from each click to the frame in which the new
-- leaf is lit.
local function measure(count)
  local times = window:run_async("const count = " .. count .. [==[,
    done = arguments[0], times = [];
    const isLit = leaf => marks.nodes[chart.nodes.findIndex(n => n.fqn == leaf)]
      ?.[0]?.classList.contains("active");
    const click = () => {
      const before = now.leaf, began = performance.now();
      const look = () => {
        const isSame = now.leaf == before || !isLit(now.leaf);
        if (isSame) return requestAnimationFrame(look);
        times.push(performance.now() - began);
        if (times.length < count) click(); else done(times);
      };
      chart.buttons[now.enabled[times.length % now.enabled.length]].click();
      look();
    };
    click();
  ]==])
  table.sort(times)
  return times
end

-- A machine of a program, whose page is open.
local function visit_served(fsm, options)
  options = options or {}
  options.port = 0
  local server = keep(web.serve(fsm, options))
  window:open(server.url)
  window:wait "now.active && marks.nodes.length && document.querySelector('.active')"
  return server
end

describe("the diagram", function()
  local function width()
    return window:run [[
      return $("view").firstElementChild.getBoundingClientRect().width]]
  end

  -- What is seen where the picture will be: the text, how many states of the tree, and
  -- if the active one is in view.
  local PANEL = [=[
    const isSeen = e => {
      const r = e.getBoundingClientRect();
      const at = document.elementFromPoint(r.x + 3, r.y + 3);
      return r.width > 2 && (e.contains(at) || e == at);
    };
    const items = [...document.querySelectorAll("#tree [role=treeitem] > span")];
    const active = $("tree").querySelectorAll("[aria-selected=true] > span");
    return [isSeen($("drawing")) && $("drawing").textContent,
      items.filter(isSeen).length,
      active.length ? isSeen([...active].at(-1)) : "none"]]=]

  for name, case in pairs { -- any order: each stands alone
    ["2 states"] = { fsm = function() return helper.ring(2) end, least = 3 },
    ["500 states"] = { fsm = function() return helper.ring(500) end, least = 10,
      leaf = 400 },
  } do
    it("is a tree with the active state until there is a picture: " .. name, function()
      local fsm, svg = case.fsm(), nil
      rfsm.run(fsm)
      for _ = 2, case.leaf or 1 do helper.post_and_run(fsm, "e_push") end
      helper.with(Painter, { ask = function() return svg end }, function()
        window:open(keep(web.serve(fsm, { port = 0 })).url)
        window:wait "document.querySelector('#tree [aria-selected=true]')"
        local found = window:run(PANEL)
        assert.same({ "Drawing ..", true, true },
          { found[1], found[2] >= case.least, found[3] })
        window:keep_shot("drawing-" .. name)
        assert.same({}, window:faint_words()[2])
        svg = "<svg xmlns='http://www.w3.org/2000/svg' width='9pt' height='9pt'/>"
        window:wait "document.querySelector('#view > svg')"
        assert.same({ false, 0 }, { unpack(window:run(PANEL), 1, 2) })
      end)
    end)
  end

  it("is asked for with the size of its panel, in points", function()
    visit_picture(CHART)
    assert.same({ true, true }, window:run [=[
      const { name } = performance.getEntriesByType("resource")
        .findLast(e => e.name.includes("picture.svg"));
      const [width, height] = new URL(name).searchParams.get("sheet").split("x");
      return [Math.abs(width / 0.75 - $("view").clientWidth) < 1,
        Math.abs(height / 0.75 - $("view").clientHeight) < 1]]=])
  end)

  it("is drawn by the page at once if there is no picture", function()
    helper.with(Painter, { ask = function() return false end }, function()
      visit(CHART)
      window:wait "document.querySelector('#boxes .active')"
      assert.same({ false, 0 }, { unpack(window:run(PANEL), 1, 2) })
    end)
  end)

  for name, size in pairs { -- any order: each stands alone
    ["a zoom of 200 %"] = { 640, 400 }, ["a phone"] = { 390, 844 },
    ["a phone on its side"] = { 844, 390 }, ["a low window"] = { 1280, 440 },
  } do
    it("has half of the window, with nothing above it: " .. name, function()
      window:resize(unpack(size))
      visit_picture "doc/gallery/factory.lua"
      window:run "$('view').scrollIntoView({ block: 'center' })"
      window:keep_shot("half-" .. size[1])
      local seen = window:run [=[ // the part of the height in which all is of it
        const view = $("view"), { x, width } = view.getBoundingClientRect();
        const isOfIt = y => [0.25, 0.5, 0.9, 0.96].every(part =>
          view.contains(document.elementFromPoint(x + part * width, y)));
        const heights = [...Array(100).keys()].map(i => (i + 0.5) / 100 * innerHeight);
        return heights.filter(isOfIt).length / 100]=]
      assert.is_true(seen >= 0.5, seen)
      assert.equal(size[1], window:run "return document.documentElement.scrollWidth")
    end)
  end

  it("fits, is zoomed by wheel, fingers and buttons, and dragged", function()
    visit(helper.file_with(LARGE))
    show_boxes()
    local function fits()
      return window:run [[
        const v = $("view"), r = v.firstElementChild.getBoundingClientRect();
        return r.width <= v.clientWidth && r.height <= v.clientHeight]]
    end
    assert.is_false(fits())
    window:click "#fit"
    assert.is_true(fits())
    window:keep_shot "large-fit"
    local before = width()
    window:run [[
      const r = $("view").getBoundingClientRect();
      $("view").dispatchEvent(new WheelEvent("wheel", { deltaY: -800,
        clientX: r.x + 100, clientY: r.y + 100, cancelable: true }))]]
    assert.is_true(width() > 2 * before)
    window:run [[
      const view = $("view"), finger = (x, identifier) => new Touch({ identifier,
        target: view, clientX: x, clientY: 300 });
      for (const x of [400, 500]) view.dispatchEvent(new TouchEvent("touchmove", {
        touches: [finger(300, 1), finger(x, 2)], cancelable: true }));]]
    assert.is_true(width() > 5 * before)
    local x = window:run [[
      const view = $("view"), send = (kind, x, target) => target.dispatchEvent(
        new PointerEvent(kind, { clientX: x, clientY: 300, movementX: -50,
          bubbles: true }));
      view.scrollLeft = 200;
      send("pointerdown", 400, view); send("pointermove", 350, window);
      send("pointerup", 350, window);
      return view.scrollLeft]]
    assert.equal(250, x)
    window:click "#fit"
    assert.is_true(math.abs(width() - before) < 1)
    window:click "#fit"
    assert.is_false(fits())
  end)

  it("hides what is not beside the active state, and shows what is found", function()
    visit_picture(helper.file_with(LARGE))
    window:keep_shot "large"
    local count = window:run "return folded.size"
    assert.is_true(count > 80 and count < 111, count)
    assert.same({}, window:run [[
      return [...folded].filter(i => marks.nodes.some((list, j) =>
        list.length && upFrom(j).slice(1).includes(i)))]])
    window:type "fs5.s3.s7\n"
    window:wait "!$('about').hidden && $('view').querySelector('.chosen')"
    assert.equal("root.s5.s3.s7", texts("#about dd")[1])
    assert.is_true(window:run "return folded.size" < count)
    assert.is_true(window:run [[
      const a = document.querySelector("#view .chosen").getBoundingClientRect();
      const v = $("view").getBoundingClientRect();
      return a.left >= v.left && a.right <= v.right && a.top >= v.top
        && a.bottom <= v.bottom]])
    local number = window:run [[
      return chart.nodes.findIndex(node => node.fqn == "root.s5.s3")]]
    window:run [[
      document.getElementById("root.s5.s3").querySelector("text")
        .dispatchEvent(new MouseEvent("click", { bubbles: true }))]]
    window:wait(("folded.has(%d) && marks.nodes[%d][0].matches('.is-folded')")
      :format(number, number))
    window:run [[
      document.getElementById("root.s5.s3").querySelector("text")
        .dispatchEvent(new MouseEvent("click", { bubbles: true }))]]
    window:wait "document.getElementById('root.s5.s3.s7')"
  end)

  -- Returns the least size of a text in the diagram that is in view, in pixels, and
  -- whether the active leaf is in view.
  local function looks()
    local found = window:run [=[
      const v = $("view").getBoundingClientRect(), leaf = marks.nodes[
        seenOf(now.active.at(-1))][0].getBoundingClientRect();
      const sizes = [...document.querySelectorAll("#view svg text")]
        .map(e => parseFloat(getComputedStyle(e).fontSize) * e.getScreenCTM().a);
      return [Math.min(...sizes), leaf.left >= v.left - 1 && leaf.right <= v.right + 1
        && leaf.top >= v.top - 1 && leaf.bottom <= v.bottom + 1]]=]
    return found[1], found[2]
  end

  for _, count in ipairs { 100, 300 } do
    it("opens readable, and keeps the active leaf in view: " .. count, function()
      local model = rfsm.state { info = false, warn = false }
      local groups = count / 10
      for g = 0, groups - 1 do
        local group = rfsm.state { rfsm.trans { src = "initial", tgt = "s0" } }
        for i = 0, 9 do
          group["s" .. i] = rfsm.state {}
          group[#group + 1] = rfsm.trans { src = "s" .. i, tgt = "s" .. (i + 3) % 10,
            events = { "e_next" } }
        end
        model["g" .. g] = group
        model[#model + 1] = rfsm.trans { src = "g" .. g, tgt = ("g%d"):format(
          (g + 1) % groups), events = { "e_jump" } }
      end
      model[#model + 1] = rfsm.trans { src = "initial", tgt = "g0" }
      local fsm = helper.init(model)
      rfsm.run(fsm)
      visit_served(fsm)
      window:wait "document.querySelector('#view > svg .active')"
      window:keep_shot("states" .. count)
      local size, is_in_view = looks()
      assert.is_true(size >= 9 and is_in_view, size)
      assert.is_false(window:run "return $('map').hidden")
      for i = 1, 50 do
        helper.post_and_run(fsm, i % 7 == 0 and "e_jump" or "e_next")
        window:wait(("now.leaf == %q && !isDrawing && active.has(now.active.at(-1))"
          .. " && marks.nodes[now.active.at(-1)]?.length"):format(
          (marsh.actinfo2tab(fsm))))
        size, is_in_view = looks()
        assert.is_true(size >= 9 and is_in_view, i)
      end
    end)
  end

  -- Ten groups of ten states. e_next goes on within a group, e_jump to the next group.
  local function groups()
    local model = rfsm.state { info = false, warn = false,
      rfsm.trans { src = "initial", tgt = "g0" } }
    for g = 0, 9 do
      local group = rfsm.state { rfsm.trans { src = "initial", tgt = "s0" } }
      for i = 0, 9 do
        group["s" .. i] = rfsm.state {}
        group[#group + 1] = rfsm.trans { src = "s" .. i, tgt = "s" .. (i + 1) % 10,
          events = { "e_next" } }
      end
      model["g" .. g] = group
      model[#model + 1] = rfsm.trans { src = "g" .. g, tgt = "g" .. (g + 1) % 10,
        events = { "e_jump" } }
    end
    local fsm = helper.init(model)
    rfsm.run(fsm)
    return fsm
  end

  for _, case in ipairs {
    { each = 1, state = "root.g0" }, { each = 20, state = "root.g0" },
    { each = 1, state = "root", event = "e_jump" },
    { each = 20, state = "root", event = "e_jump" },
    { each = 20, state = "root.g0", boxes = true },
  } do
    it(("follows %s while the machine is fast, then the leaf; %d changes a look%s")
      :format(case.state, case.each, case.boxes and ", boxes" or ""), function()
      local fsm = groups()
      visit_served(fsm)
      window:wait "document.querySelector('#view > svg .active')"
      if case.boxes then show_boxes() end
      local state, is_in_view
      for i = 1, 400 do
        for _ = 1, case.each do
          helper.post_and_run(fsm, i % 5 == 0 and case.event or "e_next")
        end
        state, is_in_view = unpack(window:run [=[
          const v = $("view").getBoundingClientRect();
          const leaf = drawnOf(now.active.at(-1)).getBoundingClientRect();
          return [chart.nodes[followed.state].fqn, leaf.left >= v.left - 2
            && leaf.right <= v.right + 2 && leaf.top >= v.top - 2
            && leaf.bottom <= v.bottom + 2]]=])
        assert.is_true(is_in_view, i)
        if i > 40 and state == case.state then break end
      end
      assert.equal(case.state, state)
      window:keep_shot("fast-" .. case.each .. case.state)
      window:wait "followed.state == now.active.at(-1) && !isDrawing"
      assert.is_true(select(2, looks()))
    end)
  end

  it("is where it was put while the machine is fast", function()
    local fsm = groups()
    visit_served(fsm)
    window:wait "document.querySelector('#view > svg .active')"
    window:click "#larger"
    local before = width()
    for _ = 1, 40 do
      helper.post_and_run(fsm, "e_next")
      window:run "return 1"
    end
    assert.equal(before, width())
  end)

  it("follows the region that has changed", function()
    local function region(name)
      local model = rfsm.state { rfsm.trans { src = "initial", tgt = "s0" } }
      for i = 0, 19 do
        model["s" .. i] = rfsm.state {}
        model[#model + 1] = rfsm.trans { src = "s" .. i, tgt = "s" .. (i + 1) % 20,
          events = { "e_" .. name } }
      end
      return helper.init(model)
    end
    local fsm = helper.init(rfsm.state { both = require "rfsm_seqand" {
      left = region "left", right = region "right" },
      rfsm.trans { src = "initial", tgt = "both" } })
    rfsm.run(fsm)
    visit_served(fsm)
    window:wait "document.querySelector('#view > svg .active')"
    for _, name in ipairs { "left", "right", "left" } do
      helper.post_and_run(fsm, "e_" .. name)
      window:wait(("chart.nodes[followed.state].fqn.startsWith('root.both.%s.')")
        :format(name))
    end
  end)

  it("describes a state: callbacks, line, data, how often it was entered", function()
    local file = helper.file_with [[
local rfsm = require "rfsm"
return rfsm.state {
  off = rfsm.state { n = 42, entry = function() error("no power", 0) end },
  on = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_push" } },
  rfsm.trans { src = "on", tgt = "off", events = { "e_push" } },
}
]]
    visit_picture(file)
    window:type "11"
    window:wait "document.querySelector('.failed')"
    window:run [[ // a click in the picture
      document.getElementById("root.off").querySelector("text")
        .dispatchEvent(new MouseEvent("click", { bubbles: true }))]]
    window:wait "!document.querySelector('#about').hidden"
    assert.same({ "root.off", "entry", file .. ":3", "2 times", "2 times", "n = 42" },
      texts "#about dd")
    window:keep_shot "state"
  end)

  it("stops where the page wants it", function()
    visit(CHART)
    window:run "choose(chart.nodes.findIndex(n => n.fqn == 'root.stopped'))"
    window:wait "!document.querySelector('#about').hidden"
    window:click "#stop input"
    window:wait "now.points.length == 1"
    window:type "2"
    window:wait "now.stopped == 'root.stopped' && !$('refused').hidden"
    assert.same({ "stopped at root.stopped" }, texts "#refused")
    window:run [[
      const form = document.querySelector("#points form");
      form.at.value = "e_start";
      form.requestSubmit()]]
    window:wait "now.points.length == 2"
    assert.same({ "root.stopped ×", "e_start ×" }, texts "#points button:not(form *)")
    window:type "3"
    window:wait "now.stopped == 'e_start'"
    window:click "#points .chips button"
    window:wait "now.points.length == 1"
  end)
end)

describe("a text of the picture", function()
  local DEEP = ".inner.inner.inner"

  it("has a contrast of 4.5:1 to what is behind it, light and dark", function()
    visit_picture(helper.file_with(NESTED))
    for i, case in ipairs {
      { leaf = "root.a" .. DEEP, taken = "path" },
      { event = "e_again", leaf = "root.a" .. DEEP, taken = "text" },
      { event = "e_b", leaf = "root.b" .. DEEP, taken = "text" },
      { event = "e_c", leaf = "root.c", taken = "text" },
    } do
      if case.event then window:run("send(arguments[0])", case.event) end
      window:wait(("now.leaf == %q && document.querySelector('.edge.taken %s')")
        :format(case.leaf, case.taken))
      for _, coverage in ipairs { "", "-coverage" } do
        for _, scheme in ipairs { "light", "dark" } do
          local name = ("nested-%d%s-%s"):format(i, coverage, scheme)
          prefer(scheme)
          window:keep_shot(name)
          assert.same({ 44, {} }, window:faint_texts(), name)
        end
        window:click "#coverage"
      end
    end
  end)
end)

describe("a picture in a file", function()
  -- Draws an SVG as a README does. Returns the luminance of its darkest, of its median
  -- and of its lightest point, and how many points are blue, and how many orange.
  local PIXELS = [==[
    const [svg, done] = arguments, image = new Image();
    image.onload = () => {
      const { width, height } = image, lights = [], counts = [0, 0];
      const canvas = Object.assign(document.createElement("canvas"), { width, height });
      const pen = canvas.getContext("2d");
      pen.drawImage(image, 0, 0);
      const { data } = pen.getImageData(0, 0, width, height);
      for (let i = 0; i < data.length; i += 4) {
        const [r, g, b] = data.slice(i, i + 3);
        lights.push(0.2126 * r + 0.7152 * g + 0.0722 * b);
        if (b - r > 60) counts[0]++; else if (r - b > 60) counts[1]++;
      }
      lights.sort((a, b) => a - b);
      done([lights[0], lights[lights.length >> 1], lights.at(-1), ...counts]);
    };
    image.src = "data:image/svg+xml;base64," + btoa(svg)]==]

  local function picture()
    local fsm = helper.init(rfsm.state { a = rfsm.state {}, b = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_go" } } })
    local looks = { active = { "root.b" } }
    return assert(dot.render(assert(dot.layout(fsm, looks)), "svg"))
  end

  local PICTURES = {
    chart = picture, -- what is active is blue
    graph = function()
      return assert(dot.render('digraph { a [color="#D55E00", penwidth=9] }', "svg"))
    end,
    ["moving picture of the README"] = function()
      return helper.content "doc/gallery/walk.svg"
    end,
  }

  for name, svg_of in pairs(PICTURES) do -- any order: each stands alone
    it("is dark where its page is, in the same hues: " .. name, function()
      window:open "data:text/html,<body>"
      prefer "light"
      local dark, common, light, blue, orange = unpack(window:run_async(PIXELS,
        svg_of()))
      assert.same({ true, true, true, true, name == "graph" },
        { dark < 30, common > 230, light > 250, blue + orange > 100, orange > blue })
      prefer "dark"
      local new = window:run_async(PIXELS, svg_of())
      assert.same({ true, true, true, name == "graph" },
        { new[1] < 30, new[2] < 40, new[3] > 220, new[5] > new[4] })
      assert.is_true(math.abs(new[4] + new[5] - blue - orange) < 0.2 * (blue + orange))
    end)
  end

  it("leaves a document alone that has it inside", function()
    prefer "dark"
    window:open "data:text/html,<body>"
    window:run("document.body.innerHTML = arguments[0]", picture())
    assert.same({ "none", "none", "none" }, window:run [[
      return ["html", "body", "svg"]
        .map(name => getComputedStyle(document.querySelector(name)).filter)]])
  end)
end)

describe("a text of the page", function()
  it("has a contrast of 4.5:1 to what is behind it, light and dark", function()
    visit_picture(CHART)
    window:run "send('e_nothing')"
    window:type "45"
    window:wait "document.querySelector('tr.lost') && document.querySelector('tr.step')"
    window:run "$('coverage').click(); describe(1); $('keys').showModal()"
    for _, view in ipairs { "picture", "boxes" } do
      for _, scheme in ipairs { "light", "dark" } do
        prefer(scheme)
        local found = window:faint_words()
        assert.is_true(found[1] > 60, found[1])
        assert.same({}, found[2], view .. ", " .. scheme)
      end
      show_boxes()
    end
  end)
end)

describe("the history", function()
  it("shows the states behind a step, and now again", function()
    visit_picture(CHART)
    window:type "452"
    window:wait "now.leaf == 'root.stopped'"
    assert.equal(4, window:run "return +$('scrub').max")
    window:run "$('scrub').value = 2; $('scrub').oninput()"
    assert.same({ "tracking" }, lit())
    assert.is_false(window:run "return $('to-now').hidden")
    window:keep_shot "history"
    assert.matches("^%d+%.%d+ s +root.operational.tracking +e_ball", window:run
      "return $('scrub').getAttribute('aria-valuetext')")
    assert.same({ "setup", "searching", "tracking", "stopped" }, window:run
      "return [...$('legend').children].map(e => e.textContent)")
    window:click "#to-now"
    assert.same({ "stopped" }, lit())
  end)

  -- Returns the colour of the bar of the innermost state at the right end.
  local function colour_now()
    return window:run [[
      const canvas = $("time-line"), ratio = devicePixelRatio;
      const y = (TOP + canvas.clientHeight - AXIS) / 2 * ratio;
      return [...canvas.getContext("2d").getImageData(canvas.width - 4 * ratio, y, 1, 1)
        .data].join(" ")]]
  end

  it("shows what is now, before anything has happened, too", function()
    local fsm = helper.ring(3)
    rfsm.run(fsm)
    visit_served(fsm)
    window:wait "document.querySelectorAll('#legend span').length == 1"
    local before = colour_now()
    assert.not_equal("0 0 0 0", before)
    helper.post_and_run(fsm, "e_push")
    window:wait "now.leaf == 'root.s2' && withStates().length == 1"
    assert.not_equal(before, colour_now())
  end)

  -- Returns the names in the legend, and their colours.
  local function legend()
    return unpack(window:run [=[
      const items = [...$("legend").children];
      return [items.map(e => e.textContent),
        items.map(e => getComputedStyle(e.firstChild).backgroundColor)]]=])
  end

  it("has names that are as short as no other in its legend", function()
    local function unit()
      return rfsm.state { wait = rfsm.state {}, run = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "wait" },
        rfsm.trans { src = "wait", tgt = "run", events = { "e_run" } } }
    end
    local fsm = helper.init(rfsm.state {
      a = rfsm.state { u1 = unit(), u2 = unit(),
        rfsm.trans { src = "initial", tgt = "u1" },
        rfsm.trans { src = "u1", tgt = "u2", events = { "e_unit" } } },
      b = rfsm.state { u1 = unit(), rfsm.trans { src = "initial", tgt = "u1" } },
      rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e_area" } },
    })
    rfsm.run(fsm)
    visit_served(fsm, { history = true })
    helper.post_and_run(fsm, "e_run")
    window:wait "$('legend').textContent == 'run'"
    helper.post_and_run(fsm, "e_unit")
    window:wait "now.leaf.endsWith('u2.wait') && $('legend').childElementCount == 2"
    assert.same({ "run", "wait" }, (legend()))
    helper.post_and_run(fsm, "e_run")
    window:wait "$('legend').childElementCount == 3"
    assert.same({ "u1.run", "wait", "u2.run" }, (legend()))
    helper.post_and_run(fsm, "e_area")
    helper.post_and_run(fsm, "e_run")
    window:wait "$('legend').childElementCount == 5"
    assert.same({ "a.u1.run", "u2.wait", "u2.run", "u1.wait", "b.u1.run" }, (legend()))
  end)

  -- The least distance in CIELAB of two colours of a list, for all who see colours and
  -- for those blind to red, green or blue (Machado, Oliveira, Fernandes 2009).
  local LEAST = [=[
    const SIGHTS = [[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
      [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998]],
      [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881]],
      [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900]]];
    const XYZ = [[0.433953, 0.376219, 0.189828], [0.212673, 0.715152, 0.072175],
      [0.017758, 0.109477, 0.872766]]; // of white: 1, 1, 1
    const times = (matrix, [a, b, c]) =>
      matrix.map(row => row[0] * a + row[1] * b + row[2] * c);
    const root = v => v > 0.008856 ? Math.cbrt(v) : 7.787 * v + 16 / 116;
    const lab = (colour, sight) => {
      const linear = colour.match(/\d+/g).map(v => v / 255)
        .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
      const seen = times(sight, linear).map(v => Math.min(1, Math.max(0, v)));
      const [x, y, z] = times(XYZ, seen).map(root);
      return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
    };
    const list = arguments[0];
    return Math.min(...SIGHTS.flatMap(sight => list.flatMap((a, i) => list.slice(0, i)
      .map(b => Math.hypot(...lab(a, sight).map((v, j) => v - lab(b, sight)[j]))))))]=]

  for _, scheme in ipairs { "light", "dark" } do
    it("has distinct colours for all eyes, which stay: " .. scheme, function()
      prefer(scheme)
      local fsm = helper.ring(40)
      rfsm.run(fsm)
      visit_served(fsm)
      local before
      for count = 2, 40 do
        helper.post_and_run(fsm, "e_push")
        if count == 10 then
          window:wait "$('legend').childElementCount == 9"
          before = select(2, legend())
        elseif count == 11 then
          window:wait "$('legend').childElementCount == 10"
          local colours = select(2, legend())
          assert.same(before, { unpack(colours, 1, 9) })
        end
      end
      window:wait "now.leaf == 'root.s40' && withStates().length == 39"
      local names, colours = legend()
      table.sort(names)
      assert.same({ "s29", "s30", "s31", "s32", "s33", "s34", "s35", "s36", "s37",
        "s38", "s39", "s40" }, names)
      local least = window:run(LEAST, unpack { colours })
      assert.is_true(least > 19, least)
    end)
  end

  it("has the leaves of all regions in its legend", function()
    visit "examples/seqand.lua"
    window:wait "$('legend').childElementCount == 2"
    assert.same({ "right.open", "left.open" }, (legend()))
    window:run "return send('e_grasp')"
    window:wait "$('legend').childElementCount == 4"
  end)

  it("has a contrast of 4.5:1 in each bar, light and dark", function()
    for _, scheme in ipairs { "light", "dark" } do
      prefer(scheme)
      visit(CHART)
      assert.same({}, window:run [[
        const pen = document.createElement("canvas").getContext("2d");
        const luminance = ([r, g, b]) => [r, g, b].map(v => v / 255)
          .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
          .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
        const of = colour => {
          pen.fillStyle = colour;
          pen.fillRect(0, 0, 1, 1);
          return luminance(pen.getImageData(0, 0, 1, 1).data);
        };
        const text = of(isDark.matches ? "#000" : "#fff"), faint = [];
        for (let i = 0; i < 400; i++) {
          const list = [of(colourOf(i)), text].sort((a, b) => b - a);
          if ((list[0] + 0.05) / (list[1] + 0.05) < 4.5) faint.push(i);
        }
        return faint]])
    end
  end)
end)

-- What the page shows of its moment: the path, the lit leaf, the enabled events, the
-- queue, the coverage, the first row of the log, the time.
local SHOWN = [=[
  const texts = (selector, not) => [...document.querySelectorAll(selector)]
    .filter(e => e.checkVisibility() && !e.matches(not || "none"))
    .map(e => (e.firstChild ?? e).textContent);
  const names = selector => texts(selector).filter(text => !text.includes("/"));
  return { path: texts("#path > *", "#mode").filter(t => !"›‖".includes(t)).join("."),
    lit: names(".node.state.active > text"), enabled: texts("#events .enabled"),
    queue: texts("#queue span"), states: texts("#states")[0],
    log: texts("#log td:nth-child(3)")[0], failed: names(".failed > text"),
    why: texts("#why h2").length,
    said: $("said").textContent.replace(/[\d.]+ s/, "0 s") }]=]

describe("a moment of the past", function()
  local STOVE = [[
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans
return state { info = false, warn = false, err = false,
  off = state {}, hot = state { entry = function() error("no gas", 0) end },
  on = state { entry = function(fsm) rfsm.send_events(fsm, "e_warm") end },
  trans { src = "initial", tgt = "off" },
  trans { src = "off", tgt = "on", events = { "e_on" } },
  trans { src = "on", tgt = "hot", events = { "e_heat" } },
  trans { src = "hot", tgt = "off", events = { "e_off" } } }
]]

  -- Looks at the step before the last `count` ones.
  local function look_back(count)
    window:run("$('scrub').value -= arguments[0]; $('scrub').oninput()", count)
  end

  it("is all that the page shows", function()
    visit_picture(helper.file_with(STOVE))
    window:type "12"
    window:wait "now.leaf == 'root.hot'"
    window:run "return send('e_heat')"
    window:wait "!$('why').hidden && document.querySelector('#diagram .failed')"
    look_back(1)
    assert.same({ path = "root.on", lit = { "on" }, enabled = { "e_heat" },
      queue = { "e_warm", "e_done@root.on" }, states = "3 of 4",
      log = "root.off → root.on", failed = {}, why = 0, said = "at 0 s in root.on" },
      window:run(SHOWN))
    window:wait "document.querySelector('.edge.taken')"
    look_back(1)
    assert.same({ path = "root.off", lit = { "off" }, enabled = { "e_on" },
      queue = { "e_done@root.off" }, states = "2 of 4", log = "root.initial → root.off",
      failed = {}, why = 0, said = "at 0 s in root.off" }, window:run(SHOWN))
    window:keep_shot "past"
    window:click "#to-now"
    assert.same({ path = "root.hot", lit = { "hot" }, enabled = { "e_off" },
      queue = { "empty" }, states = "4 of 4", log = "discarded", failed = { "hot" },
      why = 1, said = "in root.hot" }, window:run(SHOWN))
  end)

  it("is the time of the clock and of the next timer", function()
    visit_picture(helper.file_with [[
local rfsm = require "rfsm"
require "rfsm_timeevent"
return rfsm.state { info = false, red = rfsm.state {}, green = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "red" },
  rfsm.trans { src = "red", tgt = "green", events = { "e_after(2)" } },
  rfsm.trans { src = "green", tgt = "red", events = { "e_after(3)" } } }
]])
    window:click "#live"
    window:wait "!now.live"
    window:click "[data-do=next]"
    window:wait "now.leaf == 'root.green'"
    window:click "[data-wait='1']"
    window:wait "$('timer').textContent.startsWith('next timer in 2.0')"
    look_back(1)
    assert.same({ "0.000 s", "next timer in 2.000 s" },
      window:run "return [$('clock').textContent, $('timer').textContent]")
  end)

  it("has the states of all regions", function()
    visit_picture "examples/seqand.lua"
    window:run "return send('e_grasp')"
    window:wait(LIT .. ".join() == 'closed,closed'")
    look_back(2)
    assert.same({ "open", "open" }, lit())
    assert.same({ "open", "open" }, texts "#path b")
  end)

  for name, act in pairs { -- any order: each stands alone
    event = function() window:type "2" end, button = function() window:type "r" end,
    typed = function() window:type "/e_heatt\n" end,
    line = function() window:click "#log tr:not([hidden]) button" end,
  } do
    it("ends with a command, and the page says so: " .. name, function()
      visit_picture(helper.file_with(STOVE))
      window:type "12"
      window:wait "now.leaf == 'root.hot'"
      look_back(1)
      assert.equal("on", texts("#path b")[1])
      act()
      window:wait "!past && document.querySelector('#to-now').hidden"
      assert.equal("The page shows now again. Commands go to the machine as it is now.",
        window:run "return $('refused').innerText.split('\\n')[0]")
      if name == "typed" then
        window:wait "$('refused').innerText.includes(\"did you mean 'e_heat'\")"
      end
      window:wait "$('path').innerText.includes(now.leaf.split('.').at(-1))"
    end)
  end

  it("stays, in the bar and in the log, however fast the machine goes on", function()
    local fsm = helper.ring(5)
    rfsm.run(fsm)
    visit_served(fsm)
    for _ = 1, 6 do helper.post_and_run(fsm, "e_push") end
    window:wait "withStates().length == 6"
    window:wait "document.querySelector('#view > svg .active')"
    look_back(2)
    local before = window:run(SHOWN)
    assert.same({ "root.s5", { "s5" } }, { before.path, before.lit })
    for i = 1, 3000 do
      helper.post_and_run(fsm, "e_push")
      if i % 100 == 0 then window:run "return 1" end -- and the page gets a message
    end
    window:wait "$('past-text').textContent.endsWith('Now is 3000 entries later')"
    assert.same(before, window:run(SHOWN))
    assert.same({ true, true }, window:run [=[
      return [drawnSteps().includes(past), [...$("log").querySelectorAll("tr")]
        .find(e => !e.hidden).dataset.number == past.number]]=])
    window:click "#to-now"
    window:wait "document.querySelector('#path b').textContent == now.leaf.slice(5)"
    assert.equal(fsm._act_leaf._fqn, window:run "return now.leaf")
    assert.is_true(window:run "return steps.at(-1).number == 3006")
  end)
end)

describe("a keyboard", function()
  it("reaches the events before the log, and the tree before the diagram", function()
    visit(CHART)
    local order = window:run [=[
      const all = [...document.querySelectorAll("button, input, [tabindex]")]
        .filter(e => e.offsetParent && e.tabIndex == 0);
      const at = selector => all.findIndex(e => e.matches(selector));
      return [at("#events button"), at("[role=treeitem]"), at("#view"), at("#log"),
        all.filter(e => e.matches("#log button")).length]]=]
    assert.is_true(order[1] < order[2] and order[2] < order[3] and order[3] < order[4])
    assert.is_true(order[1] < 12)
    assert.equal(1, order[5])
  end)

  it("walks the tree of states", function()
    visit_picture(CHART) -- that draws the tree once more
    window:run "document.querySelector('[role=treeitem]').focus()"
    window:run [[
      for (const key of ["ArrowDown", "ArrowDown", "Enter"]) document.activeElement
        .dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }))]]
    window:wait "!document.querySelector('#about').hidden"
    assert.matches("^root%.", texts("#about dd")[1])
    window:wait "document.querySelector('#tree [aria-selected=true]')"
  end)

  -- Presses the key of a name at what has the focus; returns the text there.
  local function press(key)
    return window:run([=[
      const event = new KeyboardEvent("keydown",
        { key: arguments[0], bubbles: true, cancelable: true });
      document.activeElement.dispatchEvent(event);
      return (document.activeElement.querySelector(":scope > span")
        ?? document.activeElement).firstChild.textContent]=], key)
  end

  -- The tab stops in an element.
  local function stops_in(selector)
    return window:run([[
      return [...document.querySelector(arguments[0]).querySelectorAll("button, li")]
        .filter(e => e.tabIndex == 0 && e.checkVisibility())
        .map(e => (e.querySelector(":scope > span") ?? e).firstChild.textContent)]],
      selector)
  end

  it("has one tab stop for all events, and arrow keys among them", function()
    local model = rfsm.state { info = false, a = rfsm.state {},
      rfsm.trans { src = "initial", tgt = "a" } }
    for i = 1, 31 do
      model[#model + 1] = rfsm.trans { src = "a", tgt = "a",
        events = { ("e_%02d"):format(i) } }
    end
    local fsm = helper.init(model)
    rfsm.run(fsm)
    visit_served(fsm, { allow_send = true })
    assert.same({ "e_01" }, stops_in "#events")
    assert.same({ "toolbar", "Events" },
      window:run "return [$('events').role, $('events').ariaLabel]")
    window:run "$('events').firstElementChild.focus()"
    local seen = {}
    for i, key in ipairs { "ArrowRight", "ArrowDown", "ArrowLeft", "End", "ArrowRight",
      "ArrowUp", "Home", "ArrowLeft" } do
      seen[i] = press(key)
    end
    assert.same({ "e_02", "e_03", "e_02", "e_31", "e_31", "e_30", "e_01", "e_01" },
      seen)
    press "End"
    assert.same({ "e_31" }, stops_in "#events")
    window:type "\n"
    host = fsm
    window:wait "now.log.some(entry => entry.events?.includes('e_31'))"
    assert.same({ "e_31" }, stops_in "#events")
    window:run "$('send').event.value = 'e_1'; filterEvents()"
    window:wait "document.querySelector('#events button[tabindex=\"0\"]:not([hidden])')"
    assert.same({ "e_10" }, stops_in "#events")
  end)

  it("has one tab stop for each other list of buttons, too", function()
    visit(CHART)
    for _, at in ipairs { "stopped", "setup", "e_start" } do
      window:run("return command('breakpoint', { at: arguments[0], on: true })", at)
    end
    window:wait "document.querySelectorAll('#points .chips button').length == 3"
    window:type "452"
    window:wait "document.querySelectorAll('#log button').length > 3"
    for _, selector in ipairs { "#points .chips", "#log", "#tree" } do
      assert.equal(1, #stops_in(selector), selector)
    end
    window:run "document.querySelector('#points .chips button').focus()"
    assert.equal("root.setup ×", press "ArrowRight")
    window:run "document.querySelector('#log button').focus()"
    press "End"
    window:type "4" -- a new row comes above
    window:wait "$('log').querySelector('tr.lost')"
    assert.same({ true, 1 }, window:run [[
      const stops = [...$("log").querySelectorAll("button[tabindex='0']")];
      return [stops[0] == document.activeElement, stops.length] ]])
  end)

  it("has one tab stop for the tabs of machines", function()
    visit_served({ helper.ring(2), helper.ring(3), helper.ring(4) },
      { title = { "left", "middle", "right" } })
    assert.same({ "left" }, stops_in "#machines")
    window:run "$('machines').firstElementChild.focus()"
    assert.equal("middle", press "ArrowRight")
    window:type "\n"
    window:wait "chart.title == 'middle' && now.active"
    assert.equal(1, #stops_in "#machines")
  end)

  it("finds no fault by axe", function()
    if not webdriver.AXE then return pending(webdriver.no_axe()) end
    visit_picture(CHART)
    window:type "452"
    window:wait "now.leaf == 'root.stopped'"
    assert.same({}, window:faults_by_axe())
  end)

  it("sends nothing when its keys are off", function()
    visit(CHART)
    window:type "?"
    window:wait "document.querySelector('#keys').open"
    window:click "#use-keys"
    window:type "\n"
    window:run "document.querySelector('#keys').close()"
    window:type "4r0"
    assert.equal("root.operational.searching", window:run "return now.leaf")
    assert.is_false(window:run "return document.querySelector('#sure').open")
    window:run "localStorage.clear()"
  end)
end)

describe("two machines", function()
  it("have a tab each", function()
    local left, right = helper.ring(2), helper.ring(3)
    local server = visit_served({ left, right }, { title = { "left", "right" } })
    assert.same({ "left", "right" }, texts "#machines button")
    window:click "#machines button:nth-of-type(2)"
    window:wait "now.active && chart.title == 'right' && chart.nodes.length == 5"
    helper.post_and_run(right, "e_push")
    window:wait(LIT .. ".includes('s2')")
    assert.same({ "s2" }, lit())
    window:keep_shot "machines"
    window:open(server.url .. "?machine=2")
    window:wait "now.leaf == 'root.s2' && document.querySelector('.active')"
    window:click "#machines button:nth-of-type(1)"
    window:wait "now.leaf == 'root.s1' && chart.nodes.length == 4"
  end)
end)

describe("a machine that is fast", function()
  it("is followed at 10,000 events a second, a frozen page beside", function()
    local fsm = helper.ring(2)
    local server = visit_served(fsm)
    local frozen = assert(socket.connect("127.0.0.1", server.port))
    frozen:send("GET /events?token=" .. server.token .. " HTTP/1.1\r\n"
      .. "Host: localhost\r\n\r\n")
    local sent, began, worst = 0, socket.gettime(), 0
    while socket.gettime() < began + 3 do
      local due = (socket.gettime() - began) * 10000
      for _ = 1, math.min(due - sent, 100) do
        rfsm.send_events(fsm, "e_push")
        rfsm.run(fsm)
        sent = sent + 1
      end
      local before = socket.gettime()
      server:step(0)
      worst = math.max(worst, socket.gettime() - before)
    end
    window:wait("now.log.at(-1).number >= " .. sent)
    if os.getenv "TIMES" then
      print(("%d events in 3 s, longest step of the server %.1f ms"):format(sent,
        worst * 1e3))
    end
    assert.is_true(window:run "return $('log').querySelectorAll('tr').length <= 500")
    frozen:close()
  end)
end)

describe("a machine with 1,000 states", function()
  for _, view in ipairs { "boxes", "picture" } do
    it("is lit after each event, as " .. view .. "; TIMES=1 prints ms", function()
      visit(helper.file_with(LARGE))
      if view == "boxes" then show_boxes() end
      window:wait("document.querySelector('#view > "
        .. (view == "boxes" and "div" or "svg") .. " .active')")
      local count = os.getenv "TIMES" and 21 or 3
      local times = measure(count)
      assert.equal(count, #times)
      if os.getenv "TIMES" then
        print(("event to lit state, %s: %.0f ms median, %.0f ms at most"):format(view,
          times[11], times[count]))
      end
    end)
  end
end)
