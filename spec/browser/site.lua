-- The site in headless Chromium: `make test-site`. SHOTS=folder keeps screenshots
-- there, TIMES=1 prints the time to the first drawing.

local helper = require "spec.helper"
local http = require "rfsm.web.http"
local webdriver = require "spec.support.webdriver"

local FOLDER = io.popen("pwd"):read("*l") .. "/out/"

local server, driver, window

local function pump(seconds) server:step(seconds) end

-- Any web server: the files, and no more.
local function reply_to(request)
  local name = FOLDER .. request.path:sub(2)
  local handle = not name:find("..", 1, true) and io.open(name, "rb")
  if not handle then return { status = 404 } end
  local text = handle:read("*a")
  handle:close()
  return { type = name:find("%.html$") and "text/html" or "image/svg+xml", body = text }
end

local DRAWN = "now.active && document.querySelector('#view > svg .active')"

-- Opens the playground with a chart, or with what an address names.
local function visit(fragment, chart)
  window:open "about:blank"
  window:open("file://" .. FOLDER .. "playground.html" .. (fragment or ""))
  window:wait(DRAWN)
  if not chart then return end
  local file = helper.file_with(chart)
  window:call("POST", "/element/" .. window:find "#file" .. "/value", { text = file })
end

local function texts(selector) return window:texts(selector) end

-- Sets the cursor of the editor behind a text.
local function go_behind(text)
  window:run([[
    const content = document.querySelector(".cm-content"), text = arguments[0];
    const walk = document.createTreeWalker(content, NodeFilter.SHOW_TEXT);
    content.focus();
    for (let node; (node = walk.nextNode());) {
      const at = node.data.indexOf(text);
      if (at >= 0) return getSelection().collapse(node, at + text.length);
    }]], text)
end

-- The names of the examples that the playground offers.
local function example_names()
  return window:run [[return [...document.querySelectorAll("#examples option")]
    .map(option => option.value).filter(Boolean)]]
end

-- Waits until the log has a line with a text.
local function wait_for_line(text)
  window:wait(("[...document.querySelectorAll('#log tr')].some(e => "
    .. "e.textContent.includes(%q))"):format(text))
end

setup(function()
  server = assert(http.listen("127.0.0.1", 0, reply_to))
  driver = webdriver.start(pump)
  window = driver:window()
end)

teardown(function()
  driver:stop()
  server:close()
end)

before_each(function() window:resize(1440, 900) end)

after_each(helper.remove_files)

describe("the playground", function()
  for _, origin in ipairs { "file", "http" } do
    it("draws, checks, runs and shares a chart, from " .. origin .. ":", function()
      local base = origin == "file" and "file://" .. FOLDER
        or ("http://127.0.0.1:%d/"):format(server.port)
      window:open(base .. "playground.html")
      window:wait(DRAWN)
      window:wait "$('verdict').textContent == 'Checked: ok'"
      if os.getenv "TIMES" then
        print(("%s: first drawing after %.0f ms"):format(origin, window:run
          "return performance.getEntriesByName('drawn')[0].startTime"))
      end
      window:keep_shot("playground-" .. origin)

      go_behind '"bright"'
      window:type(webdriver.BACKSPACE .. 's"')
      window:wait "document.querySelector('#problems li')"
      assert.same({ "lamp.lua:15" }, texts "#problems code")
      assert.equal("1 problem", texts("#verdict")[1])
      assert.is_true(window:run [[ // the last picture stays beside it
        const problem = $("problems").getBoundingClientRect(), view = $("view");
        return view.querySelector("#root\\.off") != null && problem.left
          > view.getBoundingClientRect().right && problem.top < 200]])
      window:wait "document.querySelector('.cm-lint-marker-error')"
      window:keep_shot("playground-mistake-" .. origin)
      window:type(webdriver.BACKSPACE .. webdriver.BACKSPACE .. '"')
      window:wait(DRAWN .. " && document.querySelector('#problems').hidden")

      window:click "#events .enabled"
      window:wait "now.leaf == 'root.on.dim'"
      wait_for_line "light on"
      window:run "document.activeElement.blur()"
      window:type "3"
      window:wait "!document.querySelector('#why').hidden"
      window:type "w"
      window:wait "document.querySelector('#why li')"
      assert.equal(1, window:run "return withStates().length") -- since it was mended
      window:type "bb"
      window:wait "now.leaf == 'root.off'"
      window:click "[data-wait='10']"
      window:wait "now.clock >= 10"

      go_behind "-- print no note"
      window:type "s of mine"
      window:click "#share"
      window:wait "/link/.test($('verdict').textContent)"
      local link = window:run "return location.href"
      window:open "about:blank"
      window:open(link)
      window:wait(DRAWN)
      assert.matches("no notes of mine", window:run
        "return document.querySelector('.cm-content').innerText")
      assert.same({}, window:run
        "return performance.getEntriesByType('resource').map(e => e.name)"
        , "nothing is fetched")
    end)
  end

  it("works offline", function()
    window:chromium("Network.enable")
    window:chromium("Network.emulateNetworkConditions",
      { offline = true, latency = 0, downloadThroughput = 0, uploadThroughput = 0 })
    visit()
    window:chromium("Network.emulateNetworkConditions",
      { offline = false, latency = 0, downloadThroughput = -1, uploadThroughput = -1 })
  end)

  it("sends events with data, and says what is wrong with data", function()
    visit(nil, [[
      local rfsm = require "rfsm"
      return rfsm.state { open = rfsm.state {}, paid = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "open" },
        rfsm.trans { src = "open", tgt = "paid", events = { rfsm.named "e_paid" },
          guard = function(_, _, event) return event.amount == 12 end },
        rfsm.trans { src = "paid", tgt = "open", events = { "e_back" } } }
    ]])
    window:wait "now.leaf == 'root.open'"
    window:run "$('send').data.value = 'amount'"
    window:click "#events button"
    window:wait "!$('wrong').hidden"
    assert.same({ "data: a text in quotes, a number, true, false or a table expected, "
      .. "got 'amount'" }, texts "#wrong")
    for _, data in ipairs { "amount = 12", '{"amount": 12}' } do
      window:run("$('send').data.value = arguments[0]", data)
      window:click "#events button"
      window:wait "now.leaf == 'root.paid' && $('wrong').hidden"
      wait_for_line "e_paid{amount=12}"
      window:run "document.activeElement.blur()"
      window:type "b"
      window:wait "now.leaf == 'root.open'"
    end
  end)

  it("keeps the state while the chart is changed", function()
    visit()
    window:click "#events .enabled"
    window:wait "now.leaf == 'root.on.dim'"
    go_behind 'dim = state {'
    window:type " data = 42 "
    window:wait "chart.version && !now.can_back"
    assert.equal("root.on.dim", window:run "return now.leaf")
  end)

  it("opens a chart whose robot is not here, and says what is missing", function()
    visit(nil, [[
      local rfsm = require "rfsm"
      local camera = require "camera"
      return rfsm.state { a = rfsm.state { entry = function() camera.start() end },
        rfsm.trans { src = "initial", tgt = "a" } }
    ]])
    window:wait "now.leaf == 'root.a' && $('verdict').textContent == '1 warning'"
    assert.matches("stubbed: camera", window:run "return $('log').innerText")
  end)

  it("shows 60 columns of the chart, and the log beside it, at 1280 pixels", function()
    window:resize(1280, 800)
    visit(nil, ([[
      local rfsm = require "rfsm"
      return rfsm.state { a = rfsm.state { entry = function() print "here" end },
        rfsm.trans { src = "initial", tgt = "a" } }
--%s]]):format(("x"):rep(58)))
    wait_for_line "here"
    assert.is_true(window:run [[
      const lines = [...document.querySelectorAll(".cm-line")];
      return lines.at(-1).offsetHeight == lines[0].offsetHeight
        && $("log").getBoundingClientRect().bottom < 800]])
  end)

  it("keeps wide texts in their boxes", function()
    visit(nil, ([[
      local rfsm = require "rfsm"
      return rfsm.state { NAME = rfsm.state {},
        rfsm.trans { src = "initial", tgt = NAME } }
    ]]):gsub("NAME =", '["日本語の状態の名前"] ='):gsub("NAME", '"日本語の状態の名前"') .. "")
    window:wait("chart.nodes?.length == 3 && " .. DRAWN)
    assert.is_true(window:run [[
      const group = document.querySelector("#view .node.state");
      return group.querySelector("text").getComputedTextLength()
        <= group.querySelector("path").getBBox().width]])
  end)

  it("lets time go on", function()
    visit(nil, [[
      local rfsm = require "rfsm"
      require "rfsm_timeevent"
      return rfsm.state { a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_after(0.3)" } } }
    ]])
    window:wait "now.leaf == 'root.b' && now.clock >= 0.3"
  end)

  it("opens examples, and a file of one's own", function()
    visit "#example=ball_tracking.lua"
    assert.equal("ball_tracking.lua", window:run "return chart.title")
    window:run [[
      const select = document.querySelector("#examples");
      select.value = "compose.lua"; select.dispatchEvent(new Event("change"))]]
    window:wait("chart.title == 'compose.lua' && " .. DRAWN)
    visit(nil, [[
      local rfsm = require "rfsm"
      return rfsm.state { mine = rfsm.state {}, never = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "mine" } }
    ]])
    window:wait("now.leaf == 'root.mine' && " .. DRAWN)
    window:wait "$('verdict').textContent == '1 warning'"
  end)

  it("opens each example", function()
    visit()
    local names = example_names()
    assert.is_true(#names > 28)
    for _, name in ipairs(names) do
      window:run("location.hash = 'example=' + arguments[0]", name)
      window:wait(("chart.title == %q && !chart.problems.length && now.leaf")
        :format(name))
    end
  end)
end)

-- A chart whose entry of the state `b` is a piece of code.
local function chart_with(code)
  return ([[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state { entry = function()
%s
  end },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
  rfsm.trans { src = "b", tgt = "a", events = { "e_back" } },
}]]):format(code)
end

-- Enters `b` of such a chart.
local function send_go()
  window:wait "chart.nodes?.length == 4 && document.querySelector('#events .enabled')"
  window:click "#events .enabled"
end

describe("a chart of somebody else", function()
  local CASES = {
    { name = "in an entry", code = "while true do end" },
    { name = "and catch errors", code = "while true do pcall(error) end" },
    { name = "in a coroutine",
      code = "coroutine.wrap(function() while true do end end)()" },
  }
  for _, case in ipairs(CASES) do
    it("may loop " .. case.name .. ": it is interrupted at its line", function()
      visit(nil, chart_with(case.code))
      send_go()
      wait_for_line ":4: stopped after 3 s"
      window:wait "now.leaf == 'root.b'"
    end)
  end

  it("may loop while it is loaded", function()
    visit(nil, "while true do end")
    window:wait "document.querySelector('#problems li')"
    assert.matches("stopped after 3 s", texts("#problems li")[1]
      .. window:run "return $('problems').innerText")
  end)

  it("is ended when nothing else helps, and the page goes on", function()
    visit(nil, chart_with 'string.find(("a"):rep(40), (".-"):rep(40) .. "b")')
    send_go()
    window:wait "/no answer for 10 s/.test($('problems').innerText)"
    go_behind '"b"'
    window:run [[document.execCommand("selectAll");
      document.execCommand("insertText", false, "x")]]
    window:wait "/x/.test($('problems').innerText)"
  end)

  it("may take much memory, and is stopped", function()
    visit(nil, chart_with 'print(#("x"):rep(1e6):rep(600))')
    send_go()
    window:wait "/512 MiB/.test($('problems').innerText)"
  end)

  it("sees nothing of the browser, has no processes, and cannot lift its limits",
    function()
      visit(nil, chart_with [[
        print(("js %s, window %s, hook %s, popen %s, shell %s, exit %s, require %s")
          :format(js, window, debug.sethook, pcall(io.popen, "true"), os.execute(),
          pcall(os.exit), pcall(require, "js")))
        for key, value in pairs(debug.getregistry()) do
          if type(value) == "userdata" then print("has", key) end
        end]])
      send_go()
      wait_for_line("js nil, window nil, hook nil, popen false, shell false, "
        .. "exit false, require false")
    end)

  it("draws nothing but a picture", function()
    visit(nil, [[
      local Painter = require "rfsm.web.picture"
      function Painter:ask()
        return '<svg xmlns="http://www.w3.org/2000/svg" onload="window.evil = 1">'
          .. '<script>window.evil = 2</script><style>#title { display: none }</style>'
          .. '<image href="http://127.0.0.1:1/"/><a href="javascript:evil = 3">'
          .. '<text y="20" id="bait">x</text></a></svg>'
      end
    ]] .. chart_with "")
    window:wait "$('bait')"
    window:run "$('bait').dispatchEvent(new MouseEvent('click', { bubbles: true }))"
    assert.same({}, texts "#view script, #view style, #view image, #view a[href]")
    assert.equal("undefined", window:run "return typeof evil")
  end)

  it("reaches no network, even from a worker", function()
    window:open(("http://127.0.0.1:%d/playground.html"):format(server.port))
    window:wait(DRAWN)
    assert.same({ "refused", "refused", "refused" }, window:run_async [[
      const done = arguments[0], address = location.href, results = [];
      const take = text => { if (results.push(text) == 3) done(results); };
      fetch(address).then(() => take("reached"), () => take("refused"));
      const code = `fetch("${address}").then(() => postMessage("reached"),
        () => postMessage("refused"));
        try { importScripts("${address}"); postMessage("reached"); }
        catch { postMessage("refused"); }`;
      new Worker(URL.createObjectURL(new Blob([code]))).onmessage = m => take(m.data);
    ]])
  end)
end)

describe("the site", function()
  local PAGES = { "index.html", "gallery.html", "playground.html",
    "topics/tutorial.md.html", "topics/manual.md.html", "modules/rfsm.html",
    "examples/on_off.lua.html", "topics/web.md.html" }

  for _, page in ipairs(PAGES) do
    it("fits a phone, and nothing scrolls sideways: " .. page, function()
      window:resize(390, 844)
      window:open("file://" .. FOLDER .. page)
      if page:find("^playground") then window:wait(DRAWN) end
      window:keep_shot("phone-" .. page:gsub("/", "-"):gsub("%.html$", ""))
      assert.equal(390, window:run "return document.documentElement.scrollWidth")
      assert.same({}, window:run [[
        return [...document.querySelectorAll("pre, table, .cm-scroller")]
          .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.innerText)]])
    end)

    it("finds no fault by axe: " .. page, function()
      if not webdriver.AXE then return pending(webdriver.no_axe()) end
      window:open("file://" .. FOLDER .. page)
      if page:find("^playground") then window:wait(DRAWN) end
      assert.same({}, window:faults_by_axe())
    end)
  end

  -- Returns the text of each page, and the anchors in each file.
  local function read_site()
    local pages, anchors = {}, {}
    for _, file in ipairs(helper.lines_of "cd out && find * -type f") do
      anchors[file] = { [""] = true }
      if file:find("%.html$") then
        pages[file] = helper.content(FOLDER .. file):gsub("<script>.-</script>", "")
        for id in pages[file]:gmatch(' id="([^"]*)"') do anchors[file][id] = true end
      end
    end
    return pages, anchors
  end

  -- Does a link of a page lead to an anchor in a file of the site, or elsewhere?
  local function is_alive(link, page, anchors)
    local path, anchor = link:match("^([^#]*)#?(.*)$")
    local file = path == "" and page or (page:match("^.*/") or "") .. path
    file = file:gsub("^[^/]+/%.%./", "") -- there are no folders in folders
    return link:find("^%a+:") or anchors[file] and anchors[file][anchor]
  end

  it("has no link to a file or an anchor that is not there", function()
    visit()
    local pages, anchors = read_site()
    for _, name in ipairs(example_names()) do
      anchors["playground.html"]["example=" .. name] = true
    end
    local dead, count = {}, 0
    for page, text in pairs(pages) do -- any order: the list is empty
      count = count + 1
      for link in text:gmatch('%f[%w][hs]re?[fc]="([^"]*)"') do
        if not is_alive(link, page, anchors) then
          dead[#dead + 1] = page .. ": " .. link
        end
      end
    end
    assert.is_true(count > 80)
    assert.same({}, dead)
  end)

  it("begins with the README", function()
    window:open("file://" .. FOLDER .. "index.html")
    local headings = {}
    for title in helper.content("README.md"):gmatch("\n## ([^\n]*)") do
      headings[#headings + 1] = title
    end
    for _, title in ipairs { "Topics", "Examples", "Modules" } do
      headings[#headings + 1] = title
    end
    assert.same(headings, texts "main > h2")
    assert.matches("Statecharts in pure Lua", texts("main > p")[1])
    assert.is_true(window:run "return document.querySelector('img').naturalWidth > 0")
  end)

  for _, width in ipairs { 1280, 390 } do
    it("runs the first chart of the playground in its index, " .. width .. " wide",
      function()
        window:resize(width, 844)
        window:open("file://" .. FOLDER .. "index.html")
        window:run "document.querySelector('.live').scrollIntoView()"
        window:call("POST", "/frame", { id = 0 })
        window:wait(DRAWN)
        window:wait "now.leaf == 'root.off'"
        window:keep_shot("index-live-" .. width)
        assert.is_true(window:run("return document.documentElement.scrollWidth <= "
          .. "window.innerWidth"))
      end)
  end

  it("says in its index what each page is for", function()
    window:open("file://" .. FOLDER .. "index.html")
    assert.same({}, window:run [[
      return [...document.querySelectorAll("tr:has(> .name)")]
        .filter(e => e.lastChild.textContent.trim().length < 10)
        .map(e => e.innerText)]])
  end)

  it("has the functions of the core in three groups", function()
    window:open("file://" .. FOLDER .. "modules/rfsm.html")
    assert.same({ "Use a chart", "Ask about a chart or a machine", "Extend the core",
      "Tables" }, texts "h2.list")
  end)
end)

