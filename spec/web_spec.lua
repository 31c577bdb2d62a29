-- The page's server, over real sockets on loopback: requests, hostile ones among them,
-- and the messages that a page receives. Ports are the system's choice. Browsers are
-- in spec/browser/.

local helper = require "spec.helper"
local dkjson = require "dkjson"
local refusal = require("spec.support.commands").refusal
local http = require "spec.support.http"
local Painter = require "rfsm.web.picture"
local proto = require "rfsm.proto"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
local snapshot_file = require "rfsm.snapshot.file"
local subscriber = require "rfsm.observe.subscriber"
local follow = require "rfsm.proto.follow"
local web = require "rfsm.web"

local state, trans = rfsm.state, rfsm.trans

-- What several specs need -------------------------------------------------------

local LAMP = [[
local rfsm = require "rfsm"
return rfsm.state { emem = false, checkevents = false,
  off = rfsm.state { entry = function() print("dark") end },
  on = rfsm.state {
    dim = rfsm.state {}, bright = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "dim" },
    rfsm.trans { src = "dim", tgt = "bright", events = { "e_more" } },
    rfsm.trans { src = "bright", tgt = "dim", events = { "e_less" } },
  },
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_push" } },
  rfsm.trans { src = "on", tgt = "off", events = { "e_push" } },
}
]]

-- Messages of a host that are none.
local UNREADABLE = {
  { type = "rfsm_model" }, { type = "rfsm_model", graph = 7 },
  { type = "rfsm_model", graph = {} },
  { type = "rfsm_model", graph = { id = "root", type = "state", subnodes = { 3 } } },
  { type = "rfsm_model",
    graph = { id = "root", type = "state", transitions = { { src = "x" } } } },
}

local servers, now = {}, 0

local function opened(server)
  servers[#servers + 1] = server
  return server
end

-- Serves a chart in a file of its own; the clock is `now`.
local function open(text)
  local file = helper.file_with(text or LAMP)
  local options = { port = 0, clock = function() return now end }
  return opened(assert(web.open(file, options))), file
end

before_each(function() now = 0 end)

after_each(function()
  for i = #servers, 1, -1 do servers[i]:close() end
  helper.clear(servers)
  proto.uninstall()
  helper.remove_files()
end)

-- The texts of a log, oldest first.
local function texts_of(log)
  local texts = {}
  for i, entry in ipairs(log) do texts[i] = entry.kind .. ": " .. entry.text end
  return texts
end

-- Requests ------------------------------------------------------------------------

describe("the server", function()
  it("has one page, for this origin, with nothing from elsewhere", function()
    local server = open()
    local status, body, reply = http.request(server, "GET", "/?a=b")
    assert.equal(200, status)
    assert.matches("^<!doctype html>", body)
    assert.matches("default%-src 'none'; script%-src 'nonce%-" .. server.token .. "'",
      reply)
    assert.matches("\r\nX%-Content%-Type%-Options: nosniff\r\n", reply)
    assert.is_truthy(body:find('nonce="' .. server.token .. '"', 1, true))
    assert.is_nil(body:find("\n ") or body:find("\n//")) -- they were a tenth of it
    for link in body:gmatch("https?://[%w.]+") do
      assert.equal("http://www.w3.org", link) -- the name of SVG
    end
  end)

  -- A Lua zlib that packs a text to its length.
  local function pack(level, bits)
    return function(text, flush)
      return ("\31\139 %d %d %d %s"):format(#text, level, bits, flush)
    end
  end

  -- Returns what a server with this module replies to a request: the header fields of
  -- a compression, if the body is as long as told, and if it is the packed page.
  local function packing(zlib, path, accepted)
    local found
    helper.with(package.loaded, { zlib = zlib }, function()
      local server = open()
      local _, body, reply = http.request(server, "GET", path, { "Host: localhost",
        accepted and "Accept-Encoding: " .. accepted })
      found = { reply:match("\r\nContent%-Encoding: .-\r\nVary: .-\r\n") or "none",
        #body == tonumber(reply:match("\r\nContent%-Length: (%d+)\r\n")),
        body == ("\31\139 %d 6 31 finish"):format(#server.page) }
    end)
    return found
  end

  it("compresses what is long, if it can and the client takes that", function()
    local packed = { "\r\nContent-Encoding: gzip\r\nVary: Accept-Encoding\r\n", true,
      true }
    for _, accepted in ipairs { "gzip", "deflate, GZIP;q=0.5, br", "gzip ; q = 1" } do
      assert.same(packed, packing({ deflate = pack }, "/", accepted), accepted)
    end
    local plain = { "none", true, false }
    for _, accepted in ipairs { "", "br", "x-gzip", "gzip;q=0", "gzip; q=0.00, br" } do
      assert.same(plain, packing({ deflate = pack }, "/", accepted), accepted)
    end
    assert.same(plain, packing({ deflate = pack }, "/"))
    assert.same(plain, packing({ deflate = pack }, "/none", "gzip"))
    for _, zlib in ipairs { {}, { deflate = error }, { deflate = tostring },
      { deflate = function() return function() return "x" end end } } do
      assert.same(plain, packing(zlib, "/", "gzip"))
    end
  end)

  it("refuses what names it by a name of somebody else", function()
    local server = open()
    for host, expected in pairs { -- any order: each stands alone
      ["localhost:8044"] = 200, ["127.0.0.1"] = 200, ["[::1]:8044"] = 200,
      ["evil.example"] = 403, ["evil.example:8044"] = 403, ["localhost.evil"] = 403,
    } do
      assert.equal(expected, (http.request(server, "GET", "/", { "Host: " .. host })),
        host)
    end
    assert.equal(403, (http.request(server, "GET", "/", {})))
  end)

  it("refuses what a page of somebody else asks for, but a link", function()
    local server = open()
    for site, expected in pairs { -- any order: each stands alone
      ["cross-site"] = 403, ["same-site"] = 403, ["same-origin"] = 200, none = 200,
    } do
      local headers = { "Host: localhost", "Sec-Fetch-Site: " .. site }
      assert.equal(expected, (http.request(server, "GET", "/chart", headers)), site)
      assert.equal(200, (http.request(server, "GET", "/", headers)), site)
    end
  end)

  it("takes commands only with the token of its page", function()
    local server = open()
    local body = '{"command":"send","event":"e_push","run":true}'
    for _, token in ipairs { "", ("0"):rep(32), server.token .. "0" } do
      assert.equal(403, (http.request(server, "POST", "/command",
        { "Host: localhost", "X-Rfsm-Token: " .. token }, body)))
    end
    assert.equal(403, (http.request(server, "POST", "/command", nil, body)))
    local _, first = http.page(server)
    assert.equal("root.off", first.leaf)
  end)

  local long = ("x"):rep(9000)
  local REQUESTS = {
    { "no request", 400, "\r\n\r\n" },
    { "noise", 400, "\0\255\1\r\n\r\n" },
    { "another protocol", 400, "GET / RTSP/1.0\r\n\r\n" },
    { "a header without a name", 400, "GET / HTTP/1.1\r\n: x\r\n\r\n" },
    { "a folded header", 400, "GET / HTTP/1.1\r\nHost: localhost\r\n x\r\n\r\n" },
    { "two hosts", 400, "GET / HTTP/1.1\r\nHost: localhost\r\nHost: a.b\r\n\r\n" },
    { "a length below zero", 400,
      "POST /command HTTP/1.1\r\nContent-Length: -1\r\n\r\n" },
    { "a length that is none", 400,
      "POST /command HTTP/1.1\r\nContent-Length: 0x10\r\n\r\n" },
    { "two lengths", 400,
      "POST /command HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nxx" },
    { "chunks", 501, "POST /command HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n" },
    { "a body too long", 413,
      "POST /command HTTP/1.1\r\nContent-Length: 99999999999999999999\r\n\r\n" },
    { "a line too long", 431, "GET /" .. long .. " HTTP/1.1\r\n\r\n" },
    { "a head without an end", 431, "GET / HTTP/1.1\r\n" .. ("a: b\r\n"):rep(2000) },
    { "another method", 405, "PUT / HTTP/1.1\r\nHost: localhost\r\n\r\n" },
    { "a command by GET", 405, "GET /command HTTP/1.1\r\nHost: localhost\r\n\r\n" },
  }
  for _, path in ipairs { "/..", "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//",
    "/page.html", "/rfsm/web.lua", "/index.html", "/.", "http://localhost/" } do
    REQUESTS[#REQUESTS + 1] = { "the path " .. path, 404,
      "GET " .. path .. " HTTP/1.1\r\nHost: localhost\r\n\r\n" }
  end
  for _, case in ipairs(REQUESTS) do
    it("answers " .. case[1] .. " with " .. case[2] .. ", and goes on", function()
      local server = open()
      assert.equal(case[2], (http.talk(server, case[3])))
      assert.equal(200, (http.request(server, "GET", "/")))
    end)
  end

  local BODIES = { "", "{", "[]", "null", "7", '"run"', "{}", '{"command":7}',
    '{"command":"__index"}', '{"command":"nothing"}', '{"command":"send"}',
    '{"command":"send","event":{}}', '{"command":"send","event":99}',
    '{"command":"send","event":0.5}', '{"command":"send","event":-1}',
    '{"command":"wait","seconds":"1"}', '{"command":"wait","seconds":-1}',
    '{"command":"wait","seconds":1e9}', '{"command":"wait","seconds":1e999}',
    '{"command":"back","to":99}',
    '{"command":"back","to":"x"}', '{"command":"next"}', ("["):rep(10000) }
  for _, body in ipairs(BODIES) do
    it("refuses the command " .. body:sub(1, 40) .. " with a reason", function()
      local server = open()
      local status, reason = http.request(server, "POST", "/command",
        { "Host: localhost", "X-Rfsm-Token: " .. server.token }, body)
      assert.equal(400, status)
      assert.matches("^%l[^\n]+\n$", reason)
      assert.equal("root.off", select(2, http.page(server)).leaf)
    end)
  end

  it("answers a request that comes byte by byte, others meanwhile", function()
    local server = open()
    local tcp, text = http.connect(server),
      "GET /chart HTTP/1.1\r\nHost: localhost\r\n\r\n"
    for i = 1, #text do
      http.send(server, tcp, text:sub(i, i))
      server:step(0)
      if i % 20 == 0 then assert.equal(200, (http.request(server, "GET", "/"))) end
    end
    assert.matches("^HTTP/1.1 200 OK", http.receive_all(server, tcp))
  end)

  it("takes a head of 8 KiB, and no more", function()
    local server = open()
    for _, case in ipairs { { size = 8191, status = 200 },
      { size = 8192, status = 431 } } do
      local text = "GET / HTTP/1.1\r\nHost: localhost\r\nX: "
      text = text .. ("x"):rep(case.size - #text) .. "\r\n\r\n"
      assert.equal(case.status, (http.talk(server, text)), case.size)
    end
  end)

  it("drops a request that is not complete in time", function()
    local server = open()
    local tcp = http.connect(server)
    http.send(server, tcp, "GET / HTTP/1.1\r\nHos")
    now = 4
    assert.equal(200, (http.request(server, "GET", "/")))
    assert.is_nil(tcp:receive(1))
    now = 6
    assert.equal("", http.receive_all(server, tcp))
    assert.equal(0, #server.http.connections)
  end)

  it("drops who asks and does not read", function()
    local server = open()
    server.page = ("x"):rep(20000000)
    local tcp = http.connect(server)
    http.send(server, tcp, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert.equal("writing", http.until_done(server, function()
      local connection = server.http.connections[1]
      return connection and connection.phase ~= "reading" and connection.phase
    end))
    now = 31
    server:step(0)
    assert.equal(0, #server.http.connections)
    tcp:close()
  end)

  -- Brings a connection into a phase; returns it.
  local PHASES = {
    reading = function(server, tcp) http.send(server, tcp, "GET / HT") end,
    writing = function(server, tcp)
      server.page = ("x"):rep(20000000)
      http.send(server, tcp, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
    end,
    closing = function(server, tcp)
      http.send(server, tcp, "GET /none HTTP/1.1\r\nHost: localhost\r\n\r\n")
    end,
    stream = function(server, tcp)
      http.send(server, tcp, "GET /events?token=" .. server.token
        .. " HTTP/1.1\r\nHost: localhost\r\n\r\n")
      http.until_done(server, function() return http.streams(server) == 1 end)
      local connection = server.http.connections[1]
      connection.pending, connection.sent = ("x"):rep(20000000), 0
      server:step(0) -- takes as much as the buffers do
    end,
  }

  for phase, seconds in pairs { -- any order: each is a spec of its own
    reading = 5, writing = 30, closing = 2, stream = 30,
  } do
    it("waits " .. seconds .. " s for a connection that is " .. phase, function()
      local server = open()
      local tcp = http.connect(server)
      PHASES[phase](server, tcp)
      local connection = http.until_done(server, function()
        local first = server.http.connections[1]
        return first and first.phase == phase and first
      end)
      for _ = 1, 50 do server:step(0) end
      now = seconds
      server:step(0)
      assert.equal(connection, server.http.connections[1])
      now = seconds + 0.001
      server:step(0)
      assert.same({}, server.http.connections)
      tcp:close()
    end)
  end

  it("takes a body of 16 KiB, and no more", function()
    local server = open()
    for size, expected in pairs { [16384] = 400, [16385] = 413 } do -- any order
      assert.equal(expected, (http.request(server, "POST", "/command",
        { "Host: localhost", "X-Rfsm-Token: " .. server.token }, (" "):rep(size))))
    end
  end)

  it("accepts 50 connections at a time, and serves others in between", function()
    local server, clients = open(), {}
    for i = 1, 60 do clients[i] = http.connect(server) end
    server:step(0)
    assert.equal(50, #server.http.connections)
    server:step(0)
    assert.equal(60, #server.http.connections)
    for _, tcp in ipairs(clients) do tcp:close() end
    for _ = 1, 60 do server:step(0) end
    assert.equal(0, #server.http.connections)
  end)

  it("has 200 connections, pages among them, which stay", function()
    local server, clients = open(), {}
    local page = http.page(server)
    for i = 1, 205 do
      clients[i] = http.connect(server)
      server:step(0)
    end
    assert.equal(200, #server.http.connections)
    assert.equal("stream", server.http.connections[1].phase)
    assert.equal("root.on.dim", page:send("e_push").leaf)
    for _, tcp in ipairs(clients) do tcp:close() end
  end)

  it("has a picture once it is drawn, one for each set of folded states", function()
    local asked, svg = {}, nil
    helper.with(Painter, { ask = function(_, key, request)
      asked[#asked + 1] = key
      asked[#asked + 1] = table.concat(request().folded, " ")
      return svg
    end }, function()
      local server = open()
      assert.is_true(http.chart(server).has_picture)
      assert.equal(202, (http.request(server, "GET", "/picture.svg?machine=1")))
      svg = "<svg/>"
      local status, body = http.request(server, "GET",
        "/picture.svg?machine=1&folded=3,99")
      assert.same({ 200, "<svg/>" }, { status, body })
      svg = false
      assert.equal(404, (http.request(server, "GET", "/picture.svg?folded=")))
    end)
    assert.same({ "1 1 ", "", "1 1 3,99", "root.on", "1 1 ", "" }, asked)
  end)

  -- Asks for the picture until it is there; returns the last reply.
  local function picture_of(server)
    local status, body
    for _ = 1, 3000 do
      status, body = http.request(server, "GET", "/picture.svg")
      if status ~= 202 then break end
      require("socket").select(nil, nil, 0.01) -- another process draws it
    end
    return { status, body:sub(1, 5) }
  end

  for name, head in pairs { -- any order: each stands alone
    ["needs none"] = "", ["needs one"] = "local port = require 'no_such_module'\n",
  } do
    it("has a picture of a chart that is opened with stubs and " .. name, function()
      assert.same({ 200, "<?xml" }, picture_of(opened(assert(web.open(
        helper.file_with(head .. LAMP), { port = 0, stub = true })))))
    end)
  end

  it("asks for no picture before a page does, and draws none itself", function()
    local server = open()
    helper.with(Painter, { ask = error, start = error }, function()
      helper.with(require "rfsm.pictures.layout", { draw = error }, function()
        for _ = 1, 5 do server:step(0) end
        http.page(server)
        for _ = 1, 5 do server:step(0) end
      end)
    end)
    assert.same({}, server.painter.jobs)
  end)

  it("keeps one message for a page that does not read, then drops it", function()
    local server = open()
    local page, name = http.page(server), ("x"):rep(1900)
    page.tcp:setoption("recv-buffer-size", 4096)
    local connection = server.http.connections[1]
    for _ = 1, 400 do
      connection.cursor = nil -- as long after the last frame
      server.sources[1].view:note("output", name)
      server:step(0)
    end
    assert.is_true(connection.pending ~= "")
    assert.is_true(#connection.pending < 2e6)
    now = 31
    server:step(0)
    assert.equal(0, #server.http.connections)
    page.tcp:close()
  end)

  it("sends a heartbeat when nothing has changed for a while", function()
    local server = open()
    local page = http.page(server)
    now = 16
    assert.is_true(http.until_done(server, function()
      local data, _, partly = page.tcp:receive("*a")
      page.text = page.text .. (data or partly or "")
      return page.text:find(": beat\n\n", 1, true) ~= nil
    end))
  end)

  it("has room for a page after 1,000 connections that say nothing", function()
    local server = open()
    local _, first = http.page(server)
    local silent = {}
    for i = 1, 1000 do
      silent[i] = http.connect(server)
      server:step(0)
      if i > 300 then silent[i - 300]:close() end -- dropped already
    end
    assert.is_true(#server.http.connections <= 200)
    assert.equal("root.off", first.leaf)
    assert.equal("root.off", select(2, http.page(server)).leaf)
    for i = 701, 1000 do silent[i]:close() end
  end)

  -- The seconds that a step which may take 100 waits for requests.
  local function wait_of(server)
    local seconds
    helper.with(server.http, { step = function(_, timeout) seconds = timeout end },
      function() server:step(100) end)
    return seconds
  end

  it("leaves no descriptor to the process that draws", function()
    local server = open()
    http.page(server)
    repeat
      local status = http.request(server, "GET", "/picture.svg")
    until status ~= 202
    local names = {}
    for line in helper.text_of("for p in /proc/[0-9]*; do grep -q 'rfsm.web.picture' "
      .. "$p/cmdline 2>/dev/null && [ $(awk '{print $4}' $p/stat) = 1 ] && "
      .. "ls $p/fd; done"):gmatch("%d+") do
      names[line] = true
    end
    names["0"], names["1"], names["2"] = nil, nil, nil
    assert.same({}, names)
  end)

  it("waits until it has something to do: looks at the file", function()
    local server = open()
    assert.equal(0.5, wait_of(server))
    now = 0.25
    assert.equal(0.25, wait_of(server))
    now = 3
    assert.equal(0.5, wait_of(server)) -- it has looked
    server.sources[1].look_at = 2 -- should have been at it before
    server.sources[1].poll = function() end
    assert.equal(0, wait_of(server))
  end)

  it("waits for a frame only while a page is late", function()
    local server, at = open(), 0
    http.page(server)
    server.gettime = function() return at end
    server.http.connections[1].cursor.at = 0
    server.sources[1].view:touch()
    assert.equal(1 / 30, wait_of(server))
    at = 1
    assert.equal(0.5, wait_of(server))
    assert.equal(0.5, wait_of(server))
  end)

  it("answers with 500 and the reason if it fails itself, and goes on", function()
    local server = open()
    local function encode() error("no paper", 0) end
    helper.with(server.json, { encode = encode }, function()
      local status, body = http.request(server, "GET", "/chart")
      assert.same({ 500, "no paper\n" }, { status, body })
    end)
    assert.equal(200, (http.request(server, "GET", "/chart")))
  end)

  it("runs until its program ends", function()
    local server, waits = open(), {}
    helper.with(server, { step = function(_, timeout)
      waits[#waits + 1] = timeout
      if #waits == 3 then error("the end", 0) end
    end }, function()
      assert.same({ false, "the end" }, { pcall(server.run, server) })
    end)
    assert.same({ math.huge, math.huge, math.huge }, waits)
  end)

  it("frees its port when it is closed", function()
    local server = open()
    server:close()
    opened(assert(web.open(helper.file_with(LAMP), { port = server.port })))
  end)

  it("feeds no stream without the token", function()
    local server = open()
    for _, query in ipairs { "", "?token=", "?token=0", "?x=" .. server.token } do
      assert.equal(403, (http.request(server, "GET", "/events" .. query)))
    end
    assert.equal(0, http.streams(server))
  end)

  it("has room for one more page: the oldest silent one has to go", function()
    local server, pages = open(), {}
    for i = 1, 32 do pages[i] = http.page(server) end
    local stuck = server.http.connections[7]
    stuck.pending, stuck.sent, stuck.since = ("x"):rep(1e7), 0, now - 1
    pages[33] = http.page(server)
    assert.equal(32, http.streams(server))
    for i, page in ipairs(pages) do
      assert.equal(i ~= 7, server.http.connections[i > 7 and i - 1 or i] ~= stuck
        and i ~= 7)
      page.tcp:close()
    end
  end)

  it("goes on when a client resets its connection", function()
    local server = open()
    for _ = 1, 20 do
      local tcp = http.connect(server)
      tcp:setoption("linger", { on = true, timeout = 0 })
      tcp:send("GET /chart HTTP/1.1\r\nHost: localhost\r\n\r\n")
      tcp:close()
      server:step(0)
    end
    assert.equal(200, (http.request(server, "GET", "/")))
  end)
end)

-- Messages ----------------------------------------------------------------------------

describe("a page", function()
  it("is told the state, and what each command changes", function()
    local server = open()
    local page, first = http.page(server)
    local chart = http.chart(server)
    assert.same({ "root", "off" }, { chart.nodes[first.active[1] + 1].name,
      chart.nodes[first.active[2] + 1].name })
    assert.equal("done", first.mode)
    assert.same({ "output: dark", "step: root.initial → root.off" },
      texts_of(first.log))
    assert.same({ 2, 5 }, first.states)
    assert.same({ 1, 6 }, first.transitions)

    assert.equal(204, (http.command(server, { command = "send", event = "e_push",
      run = true })))
    local second = page:next()
    assert.equal("root.on.dim", second.leaf)
    assert.same({ "step: root.off → root.on.initial → root.on.dim" },
      texts_of(second.log))
    assert.same({ "e_push" }, second.log[1].events)
    assert.same({ 4, 5 }, second.states)
    assert.same({ 3, 6 }, second.transitions)
    assert.equal(2, #second.taken)
  end)

  it("is told which events would do something, and why one did nothing", function()
    local server = open()
    local page, first = http.page(server)
    local chart = http.chart(server)
    local texts = {}
    for i, number in ipairs(first.enabled) do
      texts[i] = chart.events[number + 1].text
    end
    assert.same({ "e_push" }, texts)
    local message = page:send("e_more")
    assert.same({ "lost: discarded" }, texts_of(message.log))
    assert.same({ "e_more" }, message.log[1].events)
    local status, why = http.command(server, { command = "why" })
    assert.equal(200, status)
    assert.matches("^no transition would be taken on e_more in root.off\n", why)
    assert.matches("%(off %-> on%): waits for e_push", why)
  end)

  it("sees the queue, steps, and goes back without a callback", function()
    local server = open()
    local page = http.page(server)
    assert.same({ "e_push" }, page:command("send", { event = "e_push" }).queue)
    local message = page:command "step"
    assert.same({ "root.on.dim", "e_done@root.on.dim" },
      { message.leaf, message.queue[1] })
    message = page:command "back"
    assert.same({ "root.off", "e_push", true },
      { message.leaf, message.queue[1], message.is_full })
    message = page:command "back"
    assert.same({ "root.off", nil, false },
      { message.leaf, message.queue[1], message.can_back })
    assert.same({ "output: dark", "step: root.initial → root.off" },
      texts_of(message.log))
    assert.equal(400, (http.command(server, { command = "back" })))
  end)

  -- What a page is told of the moments after the steps in a message, and of now.
  local function moments_of(message, chart)
    local moments, all = {}, {}
    for _, entry in ipairs(message.log) do
      if entry.active then all[#all + 1] = entry end
    end
    all[#all + 1] = message
    for i, about in ipairs(all) do
      local events = {}
      for j, number in ipairs(about.enabled) do
        events[j] = chart.events[number + 1].text
      end
      moments[i] = { about.leaf, table.concat(events, " "),
        table.concat(about.queue, " "), about.states[1], about.transitions[1],
        #about.taken, about.failures[2] or 0,
        about.timer and math.floor(about.timer) }
    end
    return moments
  end

  it("is told the moment after each step, as that of now", function()
    local server = open([[
      local rfsm = require "rfsm"
      require "rfsm_timeevent"
      return rfsm.state { err = false,
        off = rfsm.state {
          entry = function(fsm) rfsm.send_events(fsm, "e_on", "e_x") end },
        on = rfsm.state { entry = function() error("no power", 0) end },
        rfsm.trans { src = "initial", tgt = "off" },
        rfsm.trans { src = "off", tgt = "on", events = { "e_on" } },
        rfsm.trans { src = "on", tgt = "off", events = { "e_after(2)" } },
      }
    ]])
    local _, first = http.page(server)
    assert.same({
      { "root.off", "e_on", "e_on e_x e_done@root.off", 2, 1, 1, 0, false },
      { "root.on", "e_after(2)@root.on", "e_done@root.on", 3, 2, 1, 1, 2 },
      { "root.on", "e_after(2)@root.on", "", 3, 2, 2, 1, 2 },
    }, moments_of(first, http.chart(server)))
  end)

  it("is told the first 20 events of a queue, and how many more wait", function()
    local server = open((LAMP:gsub('print%("dark"%)', [[
      for i = 1, 30 do rfsm.send_events(fsm, "e_" .. i) end]]):gsub("function%(%)",
      "function(fsm)")))
    local _, first = http.page(server)
    local queue = first.log[1].queue
    assert.same({ 21, "e_1", "e_20", "11 more" },
      { #queue, queue[1], queue[20], queue[21] })
    assert.same({}, first.queue)
  end)

  it("goes back to any turn", function()
    local server = open()
    local page = http.page(server)
    for i = 1, 6 do
      assert.equal(i % 2 == 1 and "root.on.dim" or "root.off", page:send("e_push").leaf)
    end
    assert.equal("root.on.dim", page:command("back", { to = 3 }).leaf)
    assert.equal("root.on.bright", page:send("e_more").leaf)
    local message = page:command "reset"
    assert.same({ "root.off", true }, { message.leaf, message.can_back })
    assert.same({ "note: reset", "output: dark", "step: root.initial → root.off" },
      texts_of(message.log))
    assert.equal("root.on.bright", page:command("back").leaf)
  end)

  it("begins with a machine of a fleet, and goes back to its moves", function()
    local file, lamp = helper.file_with(""), helper.file_with(LAMP)
    local function at(leaf)
      local fsm = helper.init(rfsm.load(lamp))
      rfsm.place(fsm, fsm.on[leaf], "done", {})
      return snapshot.take(fsm)
    end
    local snap = at "bright"
    snap.fleet = { history = {
      { time = 0, event = "", from = "root.gone", to = "root.off" },
      { time = 0, event = "e_push", from = "root.off", to = "root.on.dim",
        snap = at "dim" },
      { time = 61, event = "e_more", from = "root.on.dim", to = "root.on.bright" } } }
    assert(snapshot_file.write(file, snap))
    local server = opened(assert(web.open(lamp, { port = 0, from = file,
      clock = function() return now end })))
    local page, first = http.page(server)
    assert.same({ "root.on.bright", false }, { first.leaf, first.live })
    assert.same({ "note: with the data of now, not those of this move",
      "note: 1970-01-01 00:00:00 e_push: root.off → root.on.dim",
      "note: 1970-01-01 00:01:01 e_more: root.on.dim → root.on.bright" },
      texts_of(first.log))
    assert.equal("root.on.dim", page:command("back").leaf)
    assert.equal("root.off", page:command("back", { to = 0 }).leaf)
    assert.equal("root.on.dim", page:send("e_push").leaf)
    helper.write(file, "{")
    assert.matches("^/%S+: no JSON: ", select(2, web.open(lamp, { from = file })))
  end)

  it("is not opened for a system", function()
    local file = helper.file_with('local rfsm = require "rfsm"\nreturn require '
      .. '"rfsm.system" { arm = rfsm.state { a = rfsm.state {}, rfsm.trans { src = '
      .. '"initial", tgt = "a" } } }\n')
    assert.matches("it is a system, which rfsm check, ", select(2, web.open(file, {
      port = 0 })), 1, true)
  end)

  it("is told the same as another page", function()
    local server = open()
    local one, two = http.page(server), http.page(server)
    http.command(server, { command = "send", event = "e_push", run = true })
    assert.same(one:next(), two:next())
  end)

  it("is told warnings and what the chart prints itself, which goes on", function()
    rawset(_G, "said", {})
    local server = open([[
      local rfsm = require "rfsm"
      local function note(...) said[#said + 1] = table.concat({ ... }, " ") end
      return rfsm.state { warn = note, err = note, info = note,
        a = rfsm.state { entry = function() error("no power", 0) end },
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "a", events = { "e_go", "e_go" } } }
    ]])
    local _, first = http.page(server)
    local texts = table.concat(texts_of(first.log), "\n")
    assert.matches("error: error executing entry of root.a: no power", texts)
    local said = table.concat(rawget(_G, "said"), "\n")
    rawset(_G, "said", nil)
    assert.matches("no power", said)
    assert.is_function(rawget(server.sources[1].view.fsm, "warn"))
  end)

  it("is told what is odd in the chart", function()
    local _, first = http.page(open([[
      local rfsm = require "rfsm"
      return rfsm.state { a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } }
    ]]))
    assert.same({ "warning: no outgoing transitions from node 'root.a'",
      "step: root.initial → root.a" }, texts_of(first.log))
  end)

  it("is told errors of callbacks, and the machine goes on", function()
    local server = open([[
      local rfsm = require "rfsm"
      return rfsm.state {
        a = rfsm.state {},
        b = rfsm.state { entry = function() error("no power", 0) end, final = true },
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
        post_step_hook = function(fsm)
          if fsm._act_leaf._id == "b" then error("no hook", 0) end
        end,
      }
    ]])
    local page = http.page(server)
    local message = page:send("e_go")
    assert.equal("root.b", message.leaf)
    assert.same({ "error: error executing entry of root.b: no power",
      "step: root.a → root.b", "error: no hook" }, texts_of(message.log))
    assert.equal(204, (http.command(server, { command = "run" })))
  end)

  it("asks what is known of a state, and stops where it wants", function()
    local server = open()
    local page, first = http.page(server)
    local function inspect(number)
      local status, body = http.command(server, { command = "inspect", node = number })
      return status == 200 and dkjson.decode(body) or status
    end
    local about = inspect(first.active[2])
    assert.same({ "root.off", { "entry" }, 1, 0, {} }, { about.fqn, about.callbacks,
      about.entered, about.failures, about.data })
    assert.matches(":3$", about.file)
    assert.same({ 400, 400, 400 }, { inspect(99), inspect("x"), inspect(-1) })
    assert.same({ "root.on.dim" },
      page:command("breakpoint", { at = "on.dim", on = true }).points)
    local message = page:send("e_push")
    assert.same({ "root.on.dim", "root.on.dim" }, { message.leaf, message.stopped })
    assert.same({ "e_done@root.on.dim" }, message.queue) -- the rest of the run waits
    assert.same({}, page:command("breakpoint", { at = "on.dim", on = false }).points)
    page:send("e_push")
    assert.is_false(page:send("e_push").stopped)
  end)

  it("stops at an event and at a transition, also when the chart was mended", function()
    local server, file = open()
    local page = http.page(server)
    local function stopped_at(at, event)
      page:command("breakpoint", { at = at, on = true })
      local stopped = page:send(event).stopped
      assert.same({}, page:command("breakpoint", { at = at }).points)
      return stopped
    end
    page:send("e_push")
    assert.equal("e_more", stopped_at("e_more", "e_more"))
    assert.equal("root.on.bright -> root.on.dim",
      stopped_at("on.bright -> on.dim", "e_less"))
    assert.is_false(stopped_at("e_less", "e_more"))
    local function refused(at)
      return select(2, http.command(server, { command = "breakpoint", at = at,
        on = true }))
    end
    assert.equal("breakpoint: state, event or transition (off -> on) expected, got "
      .. "'e_mor' (did you mean 'e_more'?)\n", refused("e_mor"))
    assert.equal("at: state, event or transition expected\n", refused(7))
    for _, at in ipairs { "off", "off", "on.bright" } do
      page:command("breakpoint", { at = at, on = true })
    end
    now = 5
    assert.is_true(page:command("run").clock >= 5)
    helper.write(file, (LAMP:gsub("bright", "light")))
    now = 6
    local message = page:next()
    assert.equal(0, message.clock) -- its state is gone: it begins anew
    assert.same({ "root.off" }, message.points)
    assert.same({ "warning: 2 state root.on.bright: is gone, and no breakpoint now" },
      { texts_of(message.log)[1] })
    assert.is_false(page:send("e_push").stopped)
    assert.equal("root.off", page:send("e_push").stopped)
  end)

  it("ends a run that has no end", function()
    local server = open([[
      local rfsm = require "rfsm"
      return rfsm.state {
        busy = rfsm.state { doo = function() while true do rfsm.yield(false) end end },
        rfsm.trans { src = "initial", tgt = "busy" },
      }
    ]])
    local page, first = http.page(server)
    assert.equal("note: not idle after 1000 steps", texts_of(first.log)[3])
    for _ = 1, 2 do assert.is_true(page:command("run").can_back) end
    assert.is_true(page:command("back").can_back)
    assert.is_false(page:command("back").can_back)
    for _, to in ipairs { 0, 1, -1, 0.5, "at", "go" } do
      assert.equal(400, (http.command(server, { command = "back", to = to })))
    end
  end)

  it("says why it cannot go back", function()
    local server = open([[
      local rfsm = require "rfsm"
      return rfsm.state { keep = { "f" }, f = print, a = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" } }
    ]])
    local page = http.page(server)
    assert.is_false(page:command("run").can_back)
    local status, reply = http.command(server, { command = "back" })
    assert.same({ 400, "root.f: a function cannot be saved\n" }, { status, reply })
  end)

  it("is told what could do something, and goes back past guards", function()
    local server = open([[
      local rfsm = require "rfsm"
      is_open = false
      local function guard() return is_open end
      return rfsm.state {
        a = rfsm.state {}, b = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "b", events = { "e_go" }, guard = guard },
        rfsm.trans { src = "b", tgt = "a", events = { "e_go" }, guard = guard },
      }
    ]])
    local page, first = http.page(server)
    assert.equal(1, #first.enabled)
    assert.equal("root.a", page:send("e_go").leaf)
    rawset(_G, "is_open", true)
    local there = page:send("e_go")
    assert.same({ "root.b", 1 }, { there.leaf, #there.enabled })
    assert.equal("root.a", page:command("back", { to = 0 }).leaf)
    local message = page:send("e_go")
    assert.equal("root.b", message.leaf)
    rawset(_G, "is_open", nil)
  end)

  it("has a clock: it goes on, stands still, and goes to the next timer", function()
    local server = open([[
      local rfsm = require "rfsm"
      require "rfsm_timeevent"
      return rfsm.state {
        red = rfsm.state {}, green = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "red" },
        rfsm.trans { src = "red", tgt = "green", events = { "e_after(2)" } },
        rfsm.trans { src = "green", tgt = "red", events = { "e_after(3)" } },
      }
    ]])
    local page, first = http.page(server)
    assert.is_true(first.live)
    assert.is_true(first.timer > 2 and first.timer < 2.001)
    now = 2.5
    local message = page:next()
    assert.equal("root.green", message.leaf)
    assert.is_false(page:command("clock", { live = false }).live)
    now = 100
    message = page:command("wait", { seconds = 1 })
    assert.equal("root.green", message.leaf)
    assert.is_true(message.clock > 3.4 and message.clock < 3.6)
    assert.equal("root.red", page:command("next").leaf)
    message = page:command "back"
    assert.equal("root.green", message.leaf)
    assert.is_true(message.clock > 3.4 and message.clock < 3.6)
    assert.equal("root.red", page:command("next").leaf)
    assert.equal("root.red", page:command("wait", { seconds = 5.5 }).leaf)
    page:command "back" -- both timers in one turn
    page:command("breakpoint", { at = "root.green", on = true })
    message = page:command("wait", { seconds = 9 })
    assert.same({ "root.green", true },
      { message.leaf, message.clock > 7 and message.clock < 7.6 })
    assert.is_true(page:command("clock", { live = true }).live)
    assert.is_false(page:command("back").live)
  end)

  it("shows regions", function()
    local server = opened(assert(web.open("examples/seqand.lua", { port = 0 })))
    local page, first = http.page(server)
    local chart, names = http.chart(server), {}
    for i, number in ipairs(first.active) do
      names[i] = chart.nodes[number + 1].fqn
    end
    assert.same({ "root", "root.working", "root.working.right",
      "root.working.right.open", "root.working.left", "root.working.left.open" }, names)
    local message = page:send("e_grasp")
    assert.equal("root.working.left.closed",
      chart.nodes[message.active[#message.active] + 1].fqn)
  end)
end)

it("random commands do what the same calls do, and back leads where it was", function()
  assert.is_nil(share.problem(require "spec.support.claims.web", 6))
end)

describe("a chart in a file", function()
  local BAD = LAMP:gsub('tgt = "off" }', 'tgt = "offf" }')
    :gsub("function%(%).-end", "7")

  it("with mistakes is a page with file and line, until it is mended", function()
    local server, file = open(BAD)
    local page, first = http.page(server)
    assert.is_nil(first.active)
    local chart = http.chart(server)
    assert.equal(file .. ":3: root.off.entry: function expected, got number 7",
      chart.problems[1])
    assert.equal(file .. ":10: ", chart.problems[2]:match("^.-:%d+: "))
    assert.equal(400, (http.command(server, { command = "run" })))
    helper.write(file, LAMP)
    now = 1
    assert.equal("root.off", page:next().leaf)
    assert.same({}, http.chart(server).problems)
  end)

  it("with mistakes sends a page one message, not one a frame", function()
    local server = open(BAD)
    local page, time = http.page(server), 1
    function server.gettime()
      time = time + 1
      return time
    end
    for _ = 1, 5 do server:step(0.001) end
    local _, problem, partly = page.tcp:receive("*a")
    assert.same({ "timeout", "" }, { problem, page.text .. partly })
  end)

  it("is loaded anew when it changes, and the machine stays where it was", function()
    local server, file = open()
    local page, first = http.page(server)
    assert.equal("root.on.dim", page:send("e_push").leaf)
    helper.write(file, (LAMP:gsub("bright", "glaring")))
    now = 1
    local message = page:next()
    assert.equal("root.on.dim", message.leaf)
    assert.is_true(message.version ~= first.version and message.is_full)
    assert.equal("root.on.glaring", page:send("e_more").leaf)
    helper.write(file, "return 7")
    now = 2
    assert.is_nil(page:next().active)
    assert.same({ "no valid rfsm in file '" .. file .. "' found. (a chart ends "
      .. "with: return rfsm.state{...})" },
      http.chart(server).problems)
    helper.write(file, LAMP)
    now = 3
    assert.equal("root.off", page:next().leaf) -- there is no root.on.glaring now
  end)

  it("keeps its state though data is of states that are gone", function()
    local server, file = open((LAMP:gsub("checkevents = false,",
      "%0 gone = rfsm.state { keep = { 'n' }, n = 1, final = true },")))
    local page = http.page(server)
    assert.equal("root.on.dim", page:send("e_push").leaf)
    helper.write(file, LAMP)
    now = 1
    assert.equal("root.on.dim", page:next().leaf)
  end)

  it("says what is wrong with its text", function()
    local server, file = open("return rfsm.state {")
    local problem = http.chart(server).problems[1]
    assert.equal(file .. ":1: ", problem:match("^.-:%d+: "))
  end)
end)

-- Machines of a program, and elsewhere ------------------------------------------------

-- (initial) --> off --e_push--> on --e_push--> off
local function lamp(fields)
  local model = state {
    info = false, off = state {}, on = state {},
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "on", events = { "e_push" } },
    trans { src = "on", tgt = "off", events = { "e_push" } },
  }
  for name, value in pairs(fields or {}) do model[name] = value end -- any order: a set
  return model
end

describe("rfsm.web.serve", function()
  it("hosts the page of a machine that its program drives", function()
    local traced = 0
    local fsm = rfsm.init(lamp { dbg = function() traced = traced + 1 end })
    local server = opened(web.serve(fsm, { port = 0, title = "lamp",
      allow_send = true, allow_why = true }))
    rfsm.run(fsm)
    local page, first = http.page(server)
    assert.equal("root.off", first.leaf)
    assert.is_true(traced > 0)
    assert.same({ "inspect", "send", "why" }, http.chart(server).commands)
    assert.same({ "e_push" }, page:command("send", { event = "e_push" }).queue)
    rfsm.run(fsm)
    assert.equal("root.on", page:next().leaf)
    rfsm.send_events(fsm, "e_nothing")
    rfsm.run(fsm)
    assert.same({ "lost: discarded" }, texts_of(page:next().log))
    local _, why = http.command(server, { command = "why" })
    assert.matches("^no transition would be taken on e_nothing", why)
    rfsm.reset(fsm)
    assert.equal("inactive", page:next().mode)
  end)

  -- Returns a machine whose guard empties a list of five readings.
  local function with_port()
    local readings = { 1, 2, 3, 4, 5 }
    local model = lamp()
    model[2].guard = function() return table.remove(readings, 1) == 3 end
    local fsm = rfsm.init(model)
    rfsm.run(fsm)
    return fsm, readings
  end

  it("calls no guard by itself, a page open or not", function()
    local fsm, readings = with_port()
    local server = opened(web.serve(fsm, { port = 0 }))
    for i = 1, 20 do
      if i == 10 then http.page(server) end
      rfsm.send_events(fsm, "e_other")
      rfsm.run(fsm)
      server:step(0)
    end
    assert.equal(5, #readings)
    assert.equal(400, (http.command(server, { command = "why" })))
    assert.equal(5, #readings)
  end)

  it("calls guards when a page asks why, if the host allows that", function()
    local fsm, readings = with_port()
    local server = opened(web.serve(fsm, { port = 0, allow_why = true }))
    http.page(server)
    rfsm.send_events(fsm, "e_push")
    rfsm.run(fsm)
    assert.equal(4, #readings)
    server:step(0)
    assert.matches("guard", select(2, http.command(server, { command = "why" })))
    assert.equal(3, #readings)
  end)

  it("shows a machine that is not entered yet", function()
    local _, first = http.page(opened(web.serve(rfsm.init(lamp()), { port = 0 })))
    assert.same({ false, "inactive", {}, { "e_init_fsm" }, { 0, 3 } }, { first.leaf,
      first.mode, first.active, first.queue, first.states })
  end)

  it("has an address for a browser, also of IPv6", function()
    local fsm = rfsm.init(lamp())
    for host, text in pairs { ["127.0.0.1"] = "127.0.0.1", ["::1"] = "[::1]" } do
      local ok, server = pcall(web.serve, fsm, { port = 0, host = host }) -- any order
      if ok then -- there may be no IPv6
        assert.equal(("http://%s:%d/"):format(text, server.port), server.url)
        server:close()
      end
    end
  end)

  it("takes no event unless the host allows it", function()
    local fsm = rfsm.init(lamp())
    local server = opened(web.serve(fsm, { port = 0 }))
    rfsm.run(fsm)
    assert.equal(400, (http.command(server, { command = "send", event = "e_push" })))
    assert.same({}, fsm._intq)
  end)

  -- What a program can see of the printers and hooks of its machine.
  local function outside_of(fsm)
    return { fsm.dbg, fsm._path_hooks, #fsm._pre_hooks, #fsm._post_hooks,
      #(fsm._reset_hooks or {}) }
  end

  -- A machine that is served, and what a program could see of it before.
  local function served()
    local fsm = rfsm.init(lamp())
    local before = outside_of(fsm)
    local server = opened(web.serve(fsm,
      { port = 0, clock = function() return now end }))
    rfsm.run(fsm)
    return fsm, server, before
  end

  it("leaves the machine alone while no page is open", function()
    local fsm, server, before = served()
    server:step(0)
    assert.same(before, outside_of(fsm))
    local page = http.page(server)
    assert.is_table(fsm._path_hooks)
    page.tcp:close()
    http.until_done(server, function() return http.streams(server) == 0 end)
    now = now + 1
    server:step(0)
    assert.is_table(fsm._path_hooks) -- a page that is loaded anew
    now = now + 5
    server:step(0)
    assert.same(before, outside_of(fsm))
  end)

  it("leaves the machine alone when its page does not read, until it does", function()
    local fsm, server, before = served()
    local page = http.page(server)
    local at = 0
    server.gettime = function() return at end
    for _ = 1, 1000 do -- until its buffers are full
      at = at + 1
      for _ = 1, 60 do server.sources[1].view:note("note", ("x"):rep(2000)) end
      server:step(0)
      if server.http.connections[1].pending ~= "" then break end
    end
    assert.is_true(server.http.connections[1].pending ~= "")
    for _ = 1, 2 do
      now = now + 5.1
      server:step(0)
    end
    assert.same(before, outside_of(fsm))
    assert.equal(1, http.streams(server))
    at = at + 1
    http.until_done(server, function()
      page.tcp:receive("*a")
      return fsm._path_hooks ~= before[2]
    end)
    at = at + 1
    helper.post_and_run(fsm, "e_push")
    page.text = ""
    assert.equal(fsm._act_leaf._fqn, page:next().leaf)
  end)

  it("changes nothing that the machine prints, also if it prints all", function()
    local lines = {}
    local function print_all(f)
      helper.with(_G, { print = function(...)
        lines[#lines + 1] = table.concat({ ... }, "\t")
      end }, f)
    end
    local plain, fsm = rfsm.init(lamp()), rfsm.init(lamp())
    plain.dbg, fsm.dbg = true, true
    print_all(function() rfsm.run(plain) end)
    local expected = lines
    lines = {}
    print_all(function()
      local server = opened(web.serve(fsm, { port = 0, history = true }))
      rfsm.run(fsm)
      server:close()
    end)
    assert.same(expected, lines)
    assert.is_true(rawget(fsm, "dbg"))
  end)

  it("gives back the printers when it is closed, but those set meanwhile", function()
    local fsm, own = rfsm.init(lamp { err = false }), function() end
    local err, warn = fsm.err, fsm.warn
    local server = web.serve(fsm, { port = 0 })
    assert.is_false(fsm.err == err)
    fsm.warn = own
    server:close()
    assert.same({ err, own }, { fsm.err, fsm.warn })
    assert.is_false(warn == own)
  end)

  it("notes failures while no page is open, each at its state", function()
    local model, said = lamp(), {}
    model.err = function(...) said[#said + 1] = { ... } end
    model.on.entry = function() error("no power", 0) end
    model[3].effect = function() error("no effect", 0) end
    local fsm = rfsm.init(model)
    local server = opened(web.serve(fsm, { port = 0 }))
    rfsm.run(fsm)
    for _ = 1, 4 do helper.post_and_run(fsm, "e_push") end
    assert.equal(4, #said)
    local _, first = http.page(server)
    local number = first.active[2] -- off
    local chart, failures = http.chart(server), {}
    for i = 1, #first.failures, 2 do
      failures[chart.nodes[first.failures[i] + 1].fqn] = first.failures[i + 1]
    end
    assert.same({ ["root.on"] = 4 }, failures)
    assert.equal("root.off", chart.nodes[number + 1].fqn)
    assert.equal(4, #first.log)
  end)

  it("has a tab for each of several machines", function()
    local left, right = rfsm.init(lamp()), rfsm.init(lamp())
    local before = outside_of(right)
    local server = opened(web.serve({ left, right },
      { port = 0, title = { "left" }, allow_send = true,
        clock = function() return now end }))
    rfsm.run(left)
    rfsm.run(right)
    assert.same({ "left", "machine 2" }, http.chart(server).machines)
    assert.same({ "left", "machine 2" },
      { http.chart(server).title, http.chart(server, 2).title })
    local one, first = http.page(server)
    assert.same({ "root.off", before }, { first.leaf, outside_of(right) })
    local two = http.page(server, 2)
    assert.same({ "e_push" }, two:command("send", { event = "e_push" }).queue)
    rfsm.run(right)
    assert.equal("root.on", two:next().leaf)
    assert.equal("root.off", rfsm.get_actleaf_fqn(left))
    helper.post_and_run(left, "e_push")
    assert.equal("root.on", one:next().leaf)
    two.tcp:close()
    http.until_done(server, function() return http.streams(server) == 1 end)
    for _ = 1, 2 do
      now = now + 5.1
      server:step(0)
    end
    assert.same(before, outside_of(right)) -- nobody looks at this one
    assert.is_table(left._path_hooks)
    assert.same({ 404, 404, 404 }, { (http.request(server, "GET", "/chart?machine=3")),
      (http.request(server, "GET", "/chart?machine=0")),
      (http.command(server, { command = "send", event = "e_push" }, 3)) })
  end)

  it("builds one message a frame, however much happens", function()
    local fsm, count = rfsm.init(lamp()), 0
    local server = opened(web.serve(fsm, { port = 0 }))
    rfsm.run(fsm)
    local page = http.page(server)
    local encode, at = server.json.encode, 0
    server.gettime = function() return at end
    helper.with(server.json, { encode = function(...)
      count = count + 1
      return encode(...)
    end }, function()
      for _ = 1, 1000 do
        at = at + 0.0001 -- 10,000 events a second
        helper.post_and_run(fsm, "e_push")
        server:step(0)
      end
    end)
    assert.is_true(count >= 2 and count <= 4, count)
    page:next()
    local message = page:next()
    assert.equal(60, #message.log)
    assert.is_true(message.skipped > 100)
  end)

  it("sets a global", function()
    assert.equal(web, rawget(_G, "rfsm_web"))
  end)

  it("raises an error that says what is wrong", function()
    local fsm = rfsm.init(lamp())
    local used = opened(web.serve(fsm, { port = 0 }))
    for text, options in pairs { -- any order: each stands alone
      ["port: whole number from 0 to 65535 expected, got -1"] = { port = -1 },
      ["unknown option 'prot' (did you mean 'port'?), expected: allow_send, "
        .. "allow_why, clock, from, history, host, machine, port, stub, title"] =
        { prot = 1 },
      ["allow_send: boolean expected, got 1"] = { allow_send = 1 },
      ["host: name or address expected, got string ''"] = { host = "" },
      ["cannot listen on 127.0.0.1, port " .. ("%d"):format(used.port)
        .. ": address already in use"] = { port = used.port },
    } do
      local ok, problem = pcall(web.serve, fsm, options)
      assert.same({ false, "rfsm.web.serve: " .. text },
        { ok, (problem:gsub("^.-:%d+: ", "")) })
    end
    assert.has_error(function() web.serve({ fsm, lamp() }, { port = 0 }) end,
      "rfsm.web.serve: initialised fsm expected, got state (rfsm.init makes one of a "
        .. "state)")
    assert.has_error(function() web.serve({}) end,
      "rfsm.web.serve: initialised fsm expected, got table")
  end)
end)

describe("a machine elsewhere", function()
  local function host(allow_send)
    local door = proto.install { port = 0, allow_send = allow_send }
    local fsm = rfsm.init(lamp())
    rfsm.run(fsm)
    return fsm, door
  end

  -- Has both go on until the page is told about a leaf.
  local function wait_for(server, fsm, page, leaf)
    for _ = 1, 200 do
      rfsm.run(fsm)
      server:step(0.001)
      local data, _, partly = page.tcp:receive("*a")
      page.text = page.text .. (data or partly or "")
      if page.text:find('"leaf":"' .. leaf .. '"', 1, true) then return true end
    end
  end

  it("is watched through rfsm.proto, and takes events if it wants", function()
    local fsm, door = host(true)
    local server = opened(assert(web.attach("127.0.0.1", door.port, { port = 0 })))
    assert.same({ "127.0.0.1:" .. ("%d"):format(door.port)
      .. ": no machine has answered yet" }, http.chart(server).problems)
    local page = http.page(server)
    assert.is_true(wait_for(server, fsm, page, "root.off"))
    local chart = http.chart(server)
    assert.same({ "send" }, chart.commands)
    assert.equal("off", chart.nodes[3].name)
    http.command(server, { command = "send", event = "e_push" })
    assert.is_true(wait_for(server, fsm, page, "root.on"))
    local other, first = http.page(server)
    assert.equal("root.off → root.on", first.log[#first.log].text)
    assert.equal(1, #first.taken)
    assert.equal("root.off", chart.nodes[chart.edges[first.taken[1] + 1].src + 1].fqn)
    local active = {}
    for i, number in ipairs(first.active) do active[i] = chart.nodes[number + 1].fqn end
    assert.same({ "root", "root.on" }, active)
    assert.same({ { 3, 3 }, { 1, 3 }, "done", {} },
      { first.states, first.transitions, first.mode, first.queue })
    other.tcp:close()
  end)

  it("has its events in words, though the protocol has none", function()
    local door = proto.install { port = 0 }
    local fsm = rfsm.init(lamp { third = state { final = true }, [4] = trans {
      src = "on", tgt = "third", events = { 7, true, "e_after(1.5)", "e_done", {} } } })
    local server = opened(assert(web.attach("127.0.0.1", door.port, { port = 0 })))
    assert.is_true(wait_for(server, fsm, http.page(server), "root.off"))
    local chart, labels, words = http.chart(server), {}, {}
    for i, edge in ipairs(chart.edges) do labels[i] = edge.label end
    for i, event in ipairs(chart.events) do words[i] = event.words end
    assert.same({ "", "e_push", "e_push", "7, true, after 1.5 s, done, table 1" },
      labels)
    assert.same({ "e_push", "7", "true", "after 1.5 s", "done", "table 1" }, words)
  end)

  it("is chosen by its number", function()
    local one, door = host(false)
    local model = lamp { third = state {} }
    model[4] = trans { src = "off", tgt = "third", events = { "e_third" } }
    local two = rfsm.init(model)
    rfsm.run(two)
    local server = opened(assert(web.attach("127.0.0.1", door.port,
      { port = 0, machine = 2 })))
    local page = http.page(server)
    for _ = 1, 20 do
      rfsm.run(one)
      server:step(0.001)
    end
    assert.is_true(wait_for(server, two, page, "root.off"))
    assert.is_truthy(http.chart(server).title:find(", machine 2", 1, true))
    assert.equal(5, #http.chart(server).nodes)
  end)

  it("is one of several at that port, each with a tab", function()
    local one, door = host(true)
    local two = rfsm.init(lamp { third = state {} })
    local server = opened(assert(web.attach("127.0.0.1", door.port, { port = 0 })))
    local first = http.page(server)
    assert.is_true(wait_for(server, one, first, "root.off"))
    rfsm.run(two)
    for _ = 1, 200 do
      rfsm.run(two)
      server:step(0.001)
      if server.sources[2] and server.sources[2].view.leaf then break end
    end
    local second, message = http.page(server, 2)
    assert.equal("root.off", message.leaf)
    local title = "127.0.0.1:" .. ("%d"):format(door.port)
    assert.same({ title, title .. ", machine 2" }, http.chart(server).machines)
    assert.same({ 4, 5 }, { #http.chart(server).nodes, #http.chart(server, 2).nodes })
    http.command(server, { command = "send", event = "e_push" }, 2)
    assert.is_true(wait_for(server, two, second, "root.on"))
    rfsm.run(one)
    assert.equal("root.off", rfsm.get_actleaf_fqn(one))
  end)

  it("goes on after a message that cannot be read", function()
    local messages, server = {}, nil
    helper.with(subscriber, { connect = function()
      return { address = "127.0.0.1:1",
        receive = function() return table.remove(messages, 1) end }
    end }, function()
      server = opened(assert(web.attach("127.0.0.1", 1, { port = 0 })))
    end)
    for _, message in ipairs(UNREADABLE) do
      messages[1] = message
      server:step(0)
      assert.same({ "127.0.0.1:1: unreadable message '" .. message.type .. "'" },
        http.chart(server).problems)
    end
  end)

  it("is printed by rfsm watch", function()
    local fsm, door = host(false)
    local pipe = io.popen(("LUA='%s' tools/rfsm-watch -n 2 127.0.0.1:%d 2>&1"):format(
      arg[-1], door.port))
    for _ = 1, 3000 do -- until it has subscribed
      rfsm.run(fsm)
      if door.subscribers[1] then break end
      require("socket").select(nil, nil, 0.001)
    end
    rfsm.run(fsm)
    rfsm.send_events(fsm, "e_push")
    rfsm.run(fsm)
    assert.equal("root.off (done)\nroot.on (done)\n", pipe:read("*a"))
    pipe:close()
  end)
end)

describe("rfsm.proto.follow", function()
  local GRAPH = { id = "root", type = "state", subnodes = {
    { id = "initial", type = "connector" }, { id = "off", type = "state" },
    { id = "on", type = "state", subnodes = { { id = "dim", type = "state" } } },
  } }

  -- A client that has received these messages.
  local function client(messages)
    return { receive = function() return table.remove(messages, 1) end,
      address = "robot:7", clock = function() return now end }
  end

  local function state_message(leaf, fsm)
    return { type = "rfsm_active_state", fsm = fsm or 1, act_leaf = leaf,
      act_leaf_state = "done" }
  end

  it("draws the tree and the log at a terminal", function()
    local screens = helper.printed(function()
      follow.run(client { { type = "rfsm_model", fsm = 1, graph = GRAPH },
        state_message "root.off", state_message "root.on.dim" },
        { number = 1, count = 2, is_terminal = true })
    end)
    assert.equal(3, #screens)
    local tree, log = screens[3]:match("^\27%[H\27%[J(.-)\n\n(.*)$")
    assert.equal("* root\n    off\n*   on\n*     dim", tree)
    assert.equal("root.off (done)\nroot.on.dim (done)", (log:gsub("%d+:%d+:%d+ ", "")))
  end)

  it("prints a line for each change of its machine in a pipe", function()
    assert.same({ "not active", "root.off (done)", "refused: subscribe: x" },
      helper.printed(function()
        follow.run(client { state_message(false), state_message "root.off",
          state_message("root.on", 2), { type = "new" }, state_message "root.off",
          { type = "rfsm_error", text = "subscribe: x" } },
          { number = 1, count = 3, is_terminal = false })
      end))
  end)

  it("goes on until it is interrupted, if it has no number of lines", function()
    local messages = { state_message "root.a", state_message "root.b",
      state_message "root.c" }
    local endless, ends = client(messages), nil
    endless.receive = function()
      return table.remove(messages, 1) or error("interrupted!", 0)
    end
    assert.same({ "root.a (done)", "root.b (done)", "root.c (done)" },
      helper.printed(function()
        ends = { pcall(follow.run, endless, { number = 1, is_terminal = false }) }
      end))
    assert.same({ false, "interrupted!" }, ends)
  end)

  it("says when it has heard nothing: at a terminal below the log", function()
    local screens, calls = helper.printed(function()
      local silent = client {}
      local calls = 0
      silent.receive = function()
        calls, now = calls + 1, now + 1
        return calls == 3 and state_message "root.off"
          or calls == 16 and state_message "root.on" or nil
      end
      follow.run(silent, { number = 1, count = 2, is_terminal = true })
    end)
    assert.is_nil(calls)
    local lines = {}
    for i, screen in ipairs(screens) do lines[i] = screen:match("[^\n]*$") end
    assert.equal("waiting for robot:7", lines[1])
    assert.matches("root.off %(done%)$", lines[3])
    assert.matches("root.off %(done%)$", lines[5]) -- 2 s later
    assert.equal("no answer since 3 s", lines[6])
    assert.equal("no answer since 12 s", lines[15])
    assert.matches("root.on %(done%)$", lines[16])
  end)

  it("says that once in a pipe, on stderr, and again behind a message", function()
    local said, calls, silent = {}, 0, client {}
    silent.receive = function()
      calls, now = calls + 1, now + 1
      return (calls == 6 or calls == 12) and state_message("root.s" .. calls) or nil
    end
    helper.with(io, { stderr = { write = function(_, ...)
      said[#said + 1] = table.concat({ ... })
    end } }, function()
      helper.printed(function()
        follow.run(silent, { number = 1, count = 2, is_terminal = false })
      end)
    end)
    assert.same({ "waiting for robot:7\n", "no answer since 3 s\n" }, said)
  end)

  it("shows the last ten lines of the log", function()
    local messages = {}
    for i = 1, 12 do messages[i] = state_message("root.s" .. i) end
    local screens = helper.printed(function()
      follow.run(client(messages), { number = 1, count = 12, is_terminal = true })
    end)
    local _, count = screens[12]:gsub("%(done%)", "")
    assert.equal(10, count)
    assert.is_truthy(screens[12]:find("root.s3 ", 1, true))
    assert.is_nil(screens[12]:find("root.s2 ", 1, true))
  end)

  it("goes on after a message that cannot be read", function()
    for _, message in ipairs(UNREADABLE) do
      assert.same({ "unreadable message '" .. message.type .. "'", "not active" },
        helper.printed(function()
          follow.run(client { message, state_message(false) },
            { number = 1, count = 2, is_terminal = false })
        end))
    end
  end)
end)

describe("the command line", function()
  local function run(command)
    return helper.output_of(("os.execute(%q)"):format("LUA='" .. arg[-1] .. "' tools/"
      .. command .. " 2>&1 | tail -1"))
  end

  local LAST_COMMAND = "   json                   Write charts as JSON."

  for command, expected in pairs { -- any order: each stands alone
    ["rfsm-web"] = refusal("rfsm web", "FILE or -a HOST:PORT expected"),
    ["rfsm-web --attach a:b:c"] = refusal("rfsm web", "HOST or HOST:PORT expected, got "
      .. "'a:b:c'"),
    ["rfsm-web --attach localhost:65536"] = refusal("rfsm web", "HOST or HOST:PORT "
      .. "expected, got 'localhost:65536'"),
    ["rfsm-web --port 65536 examples/on_off.lua"]
      = refusal("rfsm web", "-p: whole number from 0 to 65535 expected, got '65536'"),
    ["rfsm-web nothing.lua"] = "rfsm web: nothing.lua: No such file or directory",
    ["rfsm-web ."] = "rfsm web: .: Is a directory",
    ["rfsm examples/on_off.lua"] = "rfsm: 'examples/on_off.lua' is no command. To step "
      .. "through that chart, type: rfsm sim examples/on_off.lua",
    ["rfsm help nothing"] = refusal("rfsm", "no command is named 'nothing'"),
    ["rfsm"] = LAST_COMMAND, ["rfsm help"] = LAST_COMMAND,
    ["rfsm-watch a:b:c"] = refusal("rfsm watch", "HOST or HOST:PORT expected, got "
      .. "'a:b:c'"),
  } do
    it("refuses " .. command .. " in one line", function()
      assert.equal((expected:gsub("\n$", "")), run(command))
    end)
  end
end)
