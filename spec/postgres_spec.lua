-- Machines in PostgreSQL: the real server, started here and stopped again.

local script = require "rfsm.postgres.script"
local helper = require "spec.helper"
local new_random = require "spec.support.random"
local postgres = require "rfsm.postgres"
local rfsm = require "rfsm"
local servers = require "spec.support.servers"
local share = require "spec.support.share"

local compile = rawget(_G, "loadstring") or load
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

teardown(servers.stop_all)
after_each(helper.remove_files)

local COUNTER = servers.COUNTER

describe("rfsm postgres", function()
  local function run(arguments)
    return servers.output_of("tools/rfsm postgres " .. arguments)
  end

  it("writes the SQL that any Lua makes", function()
    local file, chart = helper.file_with(""), "c=" .. helper.file_with(COUNTER)
    assert.equal("", run(chart .. " --history --notify --ids 20 -o " .. file))
    assert.is_true(helper.content(file) == script.sql({ chart }, { history = true,
      notify = true, ids = 20 }))
  end)

  it("quotes a chart that has quotes", function()
    local chart = helper.file_with("-- $rfsm$ $rfsm_$\nreturn rfsm.state {}")
    local text = script.sql { chart }
    assert.matches("LANGUAGE pllua AS $rfsm__$\n", text, 1, true)
    assert.equal(2, select(2, text:gsub("%$rfsm__%$", "")))
  end)

  it("writes the tables alone for clients", function()
    local file = helper.file_with("")
    assert.equal("", run("--client --history --notify -o " .. file))
    assert.is_true(helper.content(file) == script.tables { history = true,
      notify = true })
    assert.is_nil(script.tables():find("pllua"))
    assert.matches("^rfsm postgres: %-%-client: no charts and no ids expected, the "
      .. "client has them; see rfsm postgres %-%-help\n$", run("--client order.lua"))
    assert.matches("^rfsm postgres: a chart expected; ", run(""))
  end)

  -- Returns what is wrong with a chart.
  local function refusal(text)
    local file = helper.file_with(text)
    local ok, problem = pcall(script.sql, { file })
    return ok, problem:gsub(file:gsub("%p", "%%%0"), "C", 1)
  end

  it("refuses a chart that cannot run there", function()
    local chart = helper.file_with("local t = os.time()\nreturn rfsm.state {}")
    assert.equal("rfsm postgres: " .. chart .. ":1: 'os.time' does not exist in "
      .. "PostgreSQL\n", run(chart))
    for _, name in ipairs { "bit", "redis", "setfenv" } do -- Redis has them
      assert.same({ false, "C:2: '" .. name .. "' does not exist in PostgreSQL", 1 },
        { refusal("return rfsm.state { entry = function()\n"
          .. name .. "() end }") })
    end
    chart = helper.file_with("require 'lfs.none'\nreturn rfsm.state {}")
    assert.equal("rfsm postgres: " .. chart .. ":1: module 'lfs.none' is not there as "
      .. "plain Lua, so it cannot run in PostgreSQL\n", run(chart))
  end)
end)

-- The server has a Lua of its own. The client has this one: two drivers are enough.
if not (servers.HAS_STORMS or _VERSION == "Lua 5.4") then return end

local has_luasql, luasql = pcall(require, "luasql.postgres")

local missing = servers.no_postgres()
  or not has_luasql and "lua-sql-postgres is missing"
if missing then return it("runs in PostgreSQL", function() pending(missing) end) end

-- The other states do what they must not.
local LAMP = servers.lamp(0, [[
  endless = rfsm.state { entry = function()
    while true do pcall(function() end) end
  end },
  spoiled = rfsm.state { entry = function(fsm) fsm.owner = "\255" end },
  curious = rfsm.state { entry = function() return spi end },
  leaky = rfsm.state { entry = function() leak = 1 end },
  rfsm.trans { src = "off", tgt = "endless", events = { "e_loop" } },
  rfsm.trans { src = "off", tgt = "spoiled", events = { "e_spoil" } },
  rfsm.trans { src = "off", tgt = "curious", events = { "e_look" } },
  rfsm.trans { src = "off", tgt = "leaky", events = { "e_leak" } },
]])

-- waiting --at once--> done, which counts
local DUE = [[
return rfsm.state {
  keep = { "n" }, n = 0, waiting = rfsm.state {},
  done = rfsm.state { entry = function(fsm)
    fsm.n = fsm.n + 1
    fsm.emit("woken", { n = fsm.n })
  end },
  rfsm.trans { src = "initial", tgt = "waiting" },
  rfsm.trans { src = "waiting", tgt = "done", events = { "e_after(0.001)" } },
  rfsm.trans { src = "done", tgt = "done", events = { "e_again" } },
}]]

-- open --e_pay--> paid --5 s--> late --e_again--> open --e_note--> paid
local ORDER = [[
return rfsm.state {
  keep = { "id" }, open = rfsm.state {}, paid = rfsm.state {}, late = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "open" },
  rfsm.trans { src = "open", tgt = "paid", events = { "e_pay" } },
  rfsm.trans { src = "paid", tgt = "late", events = { "e_after(5)" } },
  rfsm.trans { src = "late", tgt = "open", events = { "e_again" } },
  rfsm.trans { src = "open", tgt = "paid", events = { rfsm.named "e_note" },
    effect = function(fsm, _, _, events)
      fsm.id = events[1].id
      fsm.emit("noted", events[1])
    end },
}]]

-- a --e_emit--> a, which emits its number; no transition takes e_nothing
local EMITTER = [[
return rfsm.state {
  keep = { "n" }, n = 0, a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "b", tgt = "a", events = { "e_nothing" } },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "internal", events = { "e_emit" },
    effect = function(fsm)
      fsm.n = fsm.n + 1
      fsm.emit("emitted", { n = fsm.n })
    end },
}]]

local EVENTS = servers.EVENTS or 500
local CLIENTS = servers.EVENTS and 20 or 10

local server

local has_usual_charts = false

local function load_charts(options, ...)
  has_usual_charts = false
  -- without the warning that machines of the test before have no chart any more
  assert.equal("", (server:sql((script.sql({ ... }, options)))
    :gsub("WARNING:  the machines of [^\n]*\n", "")))
end

setup(function() server = servers.postgres("-c fsync=off") end)

before_each(function()
  if has_usual_charts then return end
  server:sql("DROP SCHEMA IF EXISTS rfsm CASCADE")
  load_charts({ history = true }, "lamp=" .. helper.file_with(LAMP),
    "counter=" .. helper.file_with(COUNTER), "emitter=" .. helper.file_with(EMITTER))
  has_usual_charts = true
end)

local EMPTY = "TRUNCATE rfsm.machines, rfsm.out, rfsm.log, rfsm.history, rfsm.dead "
  .. "RESTART IDENTITY;\n"

-- All that a schema holds, as text.
local ALL = [[
SELECT json_agg(m) FROM rfsm.machines m; SELECT json_agg(o) FROM rfsm.out o;
SELECT json_agg(l) FROM rfsm.log l; SELECT json_agg(h) FROM rfsm.history h;
]]

-- Runs SQL with empty tables.
local function sql(text) return server:sql(EMPTY .. text) end

-- States in a ring. Effects keep values of all kinds, or set targets; a field holds the
-- text of what they found before.
local RANDOM = [[
local new_random = require "spec.support.random"
local encoding = require "rfsm.snapshot.encoding"
local VALUES = { 1, 0, -3, 1e15, 0.1 + 0.2, 2^53, 1/0, "text", "\"\\\n\t%%", true,
  false, { 1, { x = 2 } }, {}, { [2] = "b" }, { ["2"] = "b" }, { "%%n", "1" },
  { { {} } } }
local function text_of(value)
  if type(value) == "number" then return ("%%.17g"):format(value) end
  if type(value) ~= "table" then return tostring(value) end
  local parts = {}
  for i, key in ipairs(rfsm.sorted_keys(value)) do
    parts[i] = type(key) .. text_of(key) .. "=" .. text_of(value[key])
  end
  return "{" .. table.concat(parts, ",") .. "}"
end
local random = new_random(%d)
local function new_effect(name)
  local value, is_target = VALUES[random:below(19)], random:chance(10)
  return function(fsm, tr)
    fsm.found = text_of(fsm.x) .. text_of(fsm[name].n) .. text_of(tr.tgt._fqn)
    if is_target then tr.tgt = fsm.s1 end
    fsm.x, fsm[name].n = encoding.copy_of(value), (fsm[name].n or 0) + 1
  end
end
local count = 2 + random:below(3)
local model = { keep = { "x", "found" }, x = random:chance(50) and 5 or nil,
  rfsm.trans { src = "initial", tgt = "s1" } }
for i = 1, count do
  local name, to = "s" .. i, "s" .. i %% count + 1
  model[name] = rfsm.state { keep = { "n" }, n = random:chance(50) and i or nil }
  model[#model + 1] = rfsm.trans { src = name, tgt = to, effect = new_effect(name),
    events = { "e_next" } }
  model[#model + 1] = rfsm.trans { src = name, tgt = name, effect = new_effect(name),
    events = { "e_same" } }
end
return rfsm.state(model)
]]

local function connect_to(there)
  return luasql.postgres():connect("postgres", "postgres", "", there.folder)
end

-- Returns a client in this process.
local function connect(...)
  local charts = postgres.charts({ ... }, { history = true })
  local client = postgres.connect(charts, function() return connect_to(server) end)
  client.id = "id"
  return client
end

-- Starts a client in a process of its own.
local function beside_client(chart, file)
  return servers.beside(("%s spec/support/postgres_client.lua %s %s %s"):format(
    helper.interpreter(), server.folder, chart, file or ""))
end

describe("random charts", function()
  -- Runs 20 events on a chart without a server; returns what it comes to.
  local function run_here(file, events)
    local fsm, found = helper.init(rfsm.load(file)), {}
    rfsm.run(fsm)
    for i, event in ipairs(events) do
      helper.post_and_run(fsm, event)
      found[i] = fsm._act_leaf._fqn .. "|" .. fsm.found
    end
    return found
  end

  -- Sends events by SQL and by the client in turns; `is_client(i)` says which. Both
  -- name ids as the client does. Returns a state for each.
  local function run_there(client, key, chart, events, is_client)
    local found = {}
    for i = 0, #events do
      client.count = i
      local create, send = "rfsm.create('%s', '%s', id => 'id-%d')",
        "rfsm.send('%s', '%s', id => 'id-%d')"
      if not is_client(i) then
        client.query("SELECT " .. (i == 0 and create or send):format(key, events[i]
          or chart, i + 1))
      elseif i == 0 then
        assert(client:create(key, chart))
      else
        assert(client:send(key, events[i]))
      end
      local view = client:get(key)
      found[i] = view.leaf .. "|" .. tostring((view.data.root or {}).found)
    end
    return found
  end

  -- The same rows and history.
  local SAME = [[
SELECT count(*), sum((rows = 1)::int) FROM (SELECT chart, count(DISTINCT (state, mode,
  event, version, data, value)) AS rows FROM rfsm.machines GROUP BY chart) charts;
SELECT count(DISTINCT moves) FROM (SELECT string_agg(concat_ws(' ', substring(key,
  '[0-9]+'), event, src, tgt), ', ' ORDER BY substring(key, '[0-9]+'), id) AS moves
  FROM rfsm.history GROUP BY regexp_replace(key, '[0-9]+', '')) ways;]]

  it("go one way: without a server, in it, from a client, and in turns", function()
    local files, random, all_events = {}, new_random(28), {}
    local count = servers.HAS_STORMS and 10 or 3
    for i = 1, count do
      files[i] = ("r%d=%s"):format(i, helper.file_with(RANDOM:format(i)))
      local events = {}
      for j = 1, 20 do events[j] = random:chance(60) and "e_next" or "e_same" end
      all_events[i] = events
    end
    load_charts({ history = true }, unpack(files))
    local client = connect(unpack(files))
    for i, events in ipairs(all_events) do
      local expected, chart = run_here(files[i]:match("=(.*)"), events), "r" .. i
      for name, is_client in pairs { sql = function() return false end,
        client = function() return true end,
        turns = function(number) return number % 3 == 1 end } do
        local found = run_there(client, name .. i, chart, events, is_client)
        found[0] = nil
        assert.same(expected, found)
      end
    end
    assert.equal(("%d|%d\n1\n"):format(count, count), server:sql(SAME))
  end)

  it("do what one machine does whose host is punctual", function()
    assert.is_nil(share.problem(require "spec.support.claims.fleet_postgres", 60))
  end)
end)

describe("a client", function()
  before_each(function()
    has_usual_charts = false
    server:sql("DROP SCHEMA IF EXISTS rfsm CASCADE")
  end)

  local function make_tables()
    assert.equal("", server:sql(script.tables { history = true, notify = true }))
  end

  it("needs the tables", function()
    local client = connect("counter=" .. helper.file_with(COUNTER))
    assert.same({ nil, 'relation "rfsm.machines" does not exist', n = 2 },
      { n = 2, client:send("1", "e_tick") })
  end)

  it("needs no function of the server", function()
    make_tables()
    local client = connect("lamp=" .. helper.file_with(LAMP))
    assert.equal("root.off", client:create("1", "lamp", { owner = "me" }).leaf)
    assert.same({ "ENTRY error executing entry of root.on:  no bulb" },
      client:send("1", "e_on").errors)
    assert.same({ 1, 0 }, { client:wake() })
    assert.same({ nil, "a text is not valid in the server's encoding", n = 2 },
      { n = 2, client:send("1", "e_spoil") })
    assert.equal([[
lamp|root.off|done|(time)||{"root": {"owner": "me"}}
off|{"owner": "me", "times": 1}
off|{"owner": "me", "times": 1}
ENTRY error executing entry of root.on:  no bulb
||root.off
e_on (error)|root.off|root.on
(time)|root.on|root.off
]], server:sql([[
SELECT chart, state, mode, event, due, data FROM rfsm.machines;
SELECT what, data FROM rfsm.out;
SELECT error FROM rfsm.log;
SELECT event, src, tgt FROM rfsm.history ORDER BY id;]]))
  end)

  it("takes work and sends the answer at once, as doc/postgres.md shows", function()
    make_tables()
    server:sql("INSERT INTO rfsm.out (id, key, what) OVERRIDING SYSTEM VALUE "
      .. "VALUES (1000, 'later', 'pick')")
    local code = helper.content("doc/postgres.md"):match("\n```\n(local luasql.-)```")
    local printed = helper.printed(function()
      helper.with(package.loaded, { ["luasql.postgres"] = { postgres = function()
        return { connect = function() return connect_to(server) end }
      end } }, assert(compile(code)))
    end)
    local expected = {}
    for line in code:gmatch("%-%-> ([^\n]*)") do expected[#expected + 1] = line end
    assert.same(expected, printed)
    assert.equal("order:7\nlater\n", server:sql("SELECT key FROM rfsm.out ORDER BY id"))
  end)

  if not servers.HAS_STORMS then return end

  it("applies each event once beside others, also if the server is killed", function()
    make_tables()
    local chart, sent, found = "counter=" .. helper.file_with(COUNTER), {}, {}
    local client, random, lines = connect(chart), new_random(28), {}
    local machines = math.min(1000, EVENTS / 10)
    client:transaction(function()
      for i = 1, machines do client:create("m" .. i, "counter") end
    end)
    for i = 1, EVENTS do
      local key, number = "m" .. random:below(machines), i % CLIENTS + 1
      sent[key] = (sent[key] or 0) + 1
      lines[number] = lines[number] or {}
      table.insert(lines[number], ("%d %s e_tick\n"):format(i, key))
    end
    local ends = {}
    for i, list in ipairs(lines) do
      ends[i] = beside_client(chart, helper.file_with(table.concat(list)))
    end
    server:wait_for(("SELECT sum((data->'root'->>'n')::int) > %d FROM rfsm.machines")
      :format(math.floor(EVENTS / 3)))
    server:kill()
    server:launch()
    for _, finish in ipairs(ends) do assert.equal("", finish()) end
    for key, n in server:sql("SELECT key, data->'root'->'n' FROM rfsm.machines")
      :gmatch("(%S+)|(%d+)\n") do
      found[key] = n ~= "0" and tonumber(n) or nil
    end
    assert.same(sent, found)
  end)

  -- Makes a machine that has emitted, and its client.
  local function emitting()
    make_tables()
    local client = connect("emitter=" .. helper.file_with(EMITTER))
    assert(client:create("1", "emitter"))
    assert(client:send("1", "e_emit"))
    return client
  end

  it("takes entries that no other worker has, and ends each by done or fail", function()
    local client = emitting()
    assert.equal("2\n", server:sql "SELECT count(*) + 1 FROM rfsm.take(1, '0');")
    local entry = client:take({ lease = 0 })[1]
    assert.same({ id = "out-1", number = 1, machine = "1", what = "emitted",
      data = { n = 1 }, tries = 2 }, entry)
    assert.is_true(client:fail(entry, "no stock"))
    assert.equal("no stock\n", server:sql "SELECT error FROM rfsm.out;")
    assert.same({ nil, "rfsm.postgres.answer: dropped in root.a" },
      { client:answer(entry, "e_nothing") })
    assert.same({ 0, { "no mail" } }, { client:work(function(taken)
      assert(client:answer(taken, "e_emit"))
      error("no mail", 0)
    end, { lease = 0, tries = 3 }) })
    client:done({ number = 2 })
    assert.same({}, client:take({ tries = 3 }))
    assert.equal("no mail", client:dead()[1].error)
    assert.equal("rfsm.postgres.again: an entry or its number expected, got string "
      .. "'out-1'", select(2, pcall(client.again, client, client:dead()[1].id)))
    assert.is_true(client:again(1))
    assert.same({ 1, {} }, { client:work(function(taken)
      assert.equal("known", assert(client:answer(taken, "e_emit")).outcome)
    end) })
    assert.equal(2, client:get("1").data.root.n)
    assert.is_false(client:drop(1))
    assert.same({ false, "rfsm.postgres.take: tries: whole number from 1 to 1000 "
      .. "expected, got 0" },
      { false, (helper.refusal(client.take, client, { tries = 0 })) })
  end)

  it("wakes each machine once beside another", function()
    make_tables()
    local chart = "due=" .. helper.file_with(DUE)
    local client = connect(chart)
    client:transaction(function()
      for i = 1, EVENTS do client:create("m" .. i, "due") end
    end)
    local ends = { beside_client(chart), beside_client(chart) }
    for _, finish in ipairs(ends) do assert.equal("", finish()) end
    assert.equal(("%d|%d|t\n"):format(EVENTS, EVENTS), server:sql("SELECT count(*), "
      .. "count(DISTINCT key), bool_and(data = '{\"n\": 1}') FROM rfsm.out"))
  end)
end)

if not servers.HAS_STORMS then return end

describe("a machine in PostgreSQL", function()
  it("is a row that events change", function()
    assert.equal([[
root.off
WARNING:  1: ENTRY error executing entry of root.on:  no bulb
root.on
lamp|root.on|done|e_on (error)|t|{"root": {"owner": "me"}}
off|{"owner": "me", "times": 1}
ENTRY error executing entry of root.on:  no bulb
||root.off
e_on (error)|root.off|root.on
|root.on|
]], sql([[
SELECT rfsm.create('1', 'lamp', '{"owner": "me"}');
SELECT rfsm.send('1', 'e_on');
SELECT chart, state, mode, event, due <= since, data FROM rfsm.machines;
SELECT what, data FROM rfsm.out;
SELECT error FROM rfsm.log;
DELETE FROM rfsm.machines;
SELECT event, src, tgt FROM rfsm.history ORDER BY id;]]))
  end)

  it("takes each event with an id once", function()
    assert.equal("root.even\nroot.odd\nroot.odd\nroot.even\nroot.even\n2\n1\n", sql([[
SELECT rfsm.create('1', 'counter', id => 'made');
SELECT rfsm.send('1', 'e_tick', id => 'a');
SELECT rfsm.send('1', 'e_tick', 'a');
SELECT rfsm.send('1', ARRAY['e_tick'], id => 'b');
SELECT rfsm.create('1', 'counter', id => 'made');
SELECT data->'root'->>'n' FROM rfsm.machines;
SELECT count(*) FROM rfsm.machines;]]))
  end)

  it("shares no field that the chart does not keep, and no global", function()
    assert.equal([[
root.off
root.off
1
1
root.curious
root.leaky
global 'spi' does not exist in PostgreSQL
global 'leak' cannot be set in PostgreSQL
]], sql([[
SET client_min_messages = error;
SELECT rfsm.create('1', 'lamp');
SELECT rfsm.create('2', 'lamp');
SELECT data->'times' FROM rfsm.out;
SELECT rfsm.send('1', 'e_look');
SELECT rfsm.send('2', 'e_leak');
SELECT regexp_replace(error, '.*:[0-9]+: ', '') FROM rfsm.log ORDER BY id;]]))
  end)

  it("has no name of the host in scope, nor has a text that it loads", function()
    local no_spi, ways, expected = "global 'spi' does not exist in PostgreSQL", {}, {}
    for i, case in ipairs {
      { "spi", no_spi },
      { "answer", "global 'answer' does not exist in PostgreSQL" },
      { "host", "global 'host' does not exist in PostgreSQL" },
      { "self", "nil" },
      { "load('return spi')()", no_spi },
      { "load('return _ENV.spi')()", no_spi },
      { "load('return spi', 'x', 't', nil)()", no_spi },
      { "load(('return spi'):gmatch('.'))()", no_spi },
      { "load('return load(...)()')('return spi')", no_spi },
      { "coroutine.wrap(load('return spi'))()", no_spi },
      { "load('return require')()", "global 'require' does not exist in PostgreSQL" },
      { "load('leak = 1')()", "global 'leak' cannot be set in PostgreSQL" },
      { "select(2, load(string.dump(function() end), 'x', 'b'))",
        "attempt to load a binary chunk (mode is 't')" },
      { "select(2, load('return +', 'x'))", "unexpected symbol near '+'" },
      { "load('return x', 'x', 't', { x = 5 })()", "5" },
      { "load('return math.floor(...)')(2.5)", "2" },
      { "load('return debug')()", "global 'debug' does not exist in PostgreSQL" },
      { "getmetatable(load('return _ENV')())", "false" },
      { "pcall(setmetatable, load('return _ENV')(), {})", "false" },
      { "rawget(load('return _ENV')(), 'spi')", "nil" },
      { "rawget(_G, 'spi')", "nil" },
      { "rawget(_G, 'debug')", "nil" },
      { "getmetatable(cjson.encode({}))", "true" },
      { "getmetatable('')", "true" },
      { "(function(find) return find('pllua.' .. 'spi') end)(require)",
        "module 'pllua.spi' not found" },
    } do
      ways[i] = ("{ %q, function() return %s end },\n"):format(case[1], case[1])
      expected[i] = case[1] .. " -> " .. case[2] .. "\n"
    end
    load_charts({ history = true }, "ways=" .. helper.file_with([[
local ways = { ]] .. table.concat(ways) .. [[ }
return rfsm.state {
  keep = { "found" }, a = rfsm.state { entry = function(fsm)
    fsm.found = {}
    for i, way in ipairs(ways) do
      local answer = tostring(select(2, pcall(way[2]))):gsub("^.*:%d+: ", "")
      fsm.found[i] = way[1] .. " -> " .. answer
    end
  end }, rfsm.trans { src = "initial", tgt = "a" } }]]))
    assert.equal(table.concat(expected), sql([[
SELECT rfsm.create('1', 'ways') \gset
SELECT jsonb_array_elements_text(data->'root'->'found') FROM rfsm.machines;]]))
  end)

  it("is woken by one worker when its time has come", function()
    assert.equal([[
root.off
root.off
WARNING:  1: ENTRY error executing entry of root.on:  no bulb
root.on
WARNING:  2: ENTRY error executing entry of root.on:  no bulb
root.on
1
1
1|root.off|
2|root.off|
0
]], sql(([[
SELECT rfsm.create('1', 'lamp');
SELECT rfsm.create('2', 'lamp');
SELECT rfsm.send('1', 'e_on');
SELECT rfsm.send('2', 'e_on');
BEGIN;
SELECT rfsm.wake(1);
\! COMMAND
COMMIT;
SELECT key, state, due FROM rfsm.machines ORDER BY key;
SELECT rfsm.wake();]]):gsub("COMMAND", function()
      return server:command("psql", "-XAqt -c 'SELECT rfsm.wake()'")
    end)))
  end)

  it("is woken by a worker, which ends at half of a statement_timeout", function()
    assert.equal("root.off|3\n", sql([[
SET client_min_messages = error;
SELECT rfsm.create(i::text, 'lamp') FROM generate_series(1, 3) i \g /dev/null
SELECT rfsm.send(i::text, 'e_on') FROM generate_series(1, 3) i \g /dev/null
SET statement_timeout = 1500;
CALL rfsm.work(0.01);
SELECT state, count(*) FROM rfsm.machines GROUP BY state;]]))
  end)

  it("that never ends costs a worker one lease, and is held after three", function()
    load_charts({}, "endless=" .. helper.file_with(servers.ENDLESS))
    local hangs = "ERROR:  canceling statement due to statement timeout\n"
    assert.equal(hangs .. "bad|root.a|1\nm1|root.b|0\nm2|root.b|0\n" .. hangs .. hangs
      .. "t||3 calls that ran what is due have not ended: held until it is released\n"
      .. "rfsm_aside|1\n", sql([[
SET client_min_messages = error;
SELECT rfsm.create('bad', 'endless', '{"bad": true}') \g /dev/null
SELECT rfsm.create('m' || i, 'endless') FROM generate_series(1, 2) i \g /dev/null
SET statement_timeout = 1000;
CALL rfsm.work(0.01);
CALL rfsm.work(0.01);
SELECT key, state, leases FROM rfsm.machines ORDER BY key;
UPDATE rfsm.machines SET due = now() WHERE key = 'bad';
CALL rfsm.work(0.01);
UPDATE rfsm.machines SET due = now() WHERE key = 'bad';
CALL rfsm.work(0.01);
UPDATE rfsm.machines SET due = now() WHERE key = 'bad';
CALL rfsm.work(0.01);
SELECT (value->8)::text <> 'false', due, l.error FROM rfsm.machines m JOIN rfsm.log l
  USING (key) WHERE key = 'bad';
SELECT name, value FROM rfsm.stats() WHERE name = 'rfsm_aside';]]))
    has_usual_charts = false
  end)

  it("that never ends does not keep rfsm.wake from the others", function()
    load_charts({}, "endless=" .. helper.file_with(servers.ENDLESS))
    assert.equal([[
WARNING:  rfsm.wake: bad was cancelled, so nothing has run: call it again
0
bad|root.a|1|t
m1|root.a|0|f
m2|root.a|0|f
2
0
2|
0|3 calls that ran what is due have not ended: held until it is released
]], (sql([[
SET client_min_messages = error;
SELECT rfsm.create('bad', 'endless', '{"bad": true}') \g /dev/null
SELECT rfsm.create('m' || i, 'endless') FROM generate_series(1, 2) i \g /dev/null
RESET client_min_messages;
SET statement_timeout = 700;
SELECT rfsm.wake();
SELECT key, state, leases, due > now() + interval '5 s' FROM rfsm.machines ORDER BY key;
SELECT rfsm.wake();
SELECT rfsm.wake();
SET client_min_messages = error;
UPDATE rfsm.machines SET due = now() WHERE key = 'bad';
SELECT rfsm.wake() \g /dev/null
SELECT leases, (SELECT error FROM rfsm.log) FROM rfsm.machines WHERE key = 'bad';
UPDATE rfsm.machines SET due = now() WHERE key = 'bad';
SELECT rfsm.wake() \g /dev/null
SELECT leases, (SELECT error FROM rfsm.log) FROM rfsm.machines WHERE key = 'bad';]])))
    has_usual_charts = false
  end)

  it("waits for a minute if it cannot be woken", function()
    assert.equal([[
root.even
0
t
rfsm.tick: no chart is named 'gone' (there are 'counter', 'emitter', 'lamp')
]], sql([[
SELECT rfsm.create('1', 'counter');
UPDATE rfsm.machines SET value = jsonb_set(value, '{1}', '"gone"'), due = now();
SELECT rfsm.wake();
SELECT due > now() + interval '50 s' FROM rfsm.machines;
SELECT error FROM rfsm.log;]]))
  end)

  it("has at most 1000 lines in the log, also if it cannot be woken", function()
    assert.equal("1000|12\n1|1011\n1000|13\n", sql([[
SET client_min_messages = error;
SELECT rfsm.create('1', 'counter') \gset
INSERT INTO rfsm.log (key, error) SELECT '1', i FROM generate_series(1, 1010) i;
INSERT INTO rfsm.log (key, error) VALUES ('2', 'other');
UPDATE rfsm.machines SET value = jsonb_set(value, '{1}', '"gone"'), due = now();
SELECT rfsm.wake() \gset
SELECT count(*), min(id) FROM rfsm.log GROUP BY key ORDER BY key;
SELECT rfsm.create('1b', 'lamp') \gset
UPDATE rfsm.log SET key = '1b' WHERE key = '1';
SELECT rfsm.send('1b', 'e_look') \gset
SELECT count(*), min(id) FROM rfsm.log WHERE key = '1b';]]))
  end)

  it("gets events at a time, unless they are taken back", function()
    assert.equal("root.even\nroot.even\nt\nf\nroot.even\n1\nroot.odd|e_tick\n", sql([[
SELECT rfsm.create('1', 'counter');
SELECT rfsm.send_at('1', now() + interval '1 hour', 'e_tick', id => 'a');
SELECT rfsm.cancel('1', 'a');
SELECT rfsm.cancel('1', 'a');
SELECT rfsm.send_at('1', clock_timestamp() + interval '1 ms', 'e_tick', id => 'b');
SELECT pg_sleep(0.002) \gset
SELECT rfsm.wake();
SELECT state, event FROM rfsm.machines;]]))
  end)

  it("runs what is due before what is sent, and notes each move", function()
    load_charts({ history = true }, "order=" .. helper.file_with(ORDER))
    assert.equal([[
root.paid
root.open
root.paid|done|taken|0
e_pay|root.open|root.paid
(time)|root.paid|root.late
e_again|root.late|root.open
{"name":"e_note","id":1795422184068123,"x":0.1234567890123456}|root.open|root.paid
{"root": {"id": 1795422184068123}}
{"x": 0.1234567890123456, "id": 1795422184068123, "name": "e_note"}
t
known
dropped
e_pay|root.paid|root.paid
]], sql([[
SELECT rfsm.create('1', 'order') \gset
SELECT rfsm.send('1', 'e_pay');
UPDATE rfsm.machines SET due = due - interval '1 minute', value = jsonb_set(
  jsonb_set(value, '{3}', to_jsonb((value->>3)::int - 60)), '{5}',
  to_jsonb((value->>5)::float8 - 60));
SELECT rfsm.send_at('1', now() - interval '1 second', 'e_again', id => 'a');
SELECT state, mode, outcome, cardinality(errors) FROM rfsm.reply('1', ARRAY[
  '{"name":"e_note","id":1795422184068123,"x":0.1234567890123456}'], 'b');
SELECT event, src, tgt FROM rfsm.history ORDER BY id OFFSET 1;
SELECT data FROM rfsm.machines;
SELECT data FROM rfsm.out;
SELECT due IS NOT NULL FROM rfsm.machines;
SELECT outcome FROM rfsm.reply('1', ARRAY['e_pay'], 'b');
SELECT outcome FROM rfsm.reply('1', ARRAY['e_pay'], 'c');
SELECT event, src, tgt FROM rfsm.history ORDER BY id DESC LIMIT 1;]]))
    has_usual_charts = false
  end)

  it("shows what is kept as it is, however the machine is saved", function()
    load_charts({}, "kept=" .. helper.file_with [[
local region = rfsm.state { keep = { "n" }, n = 0,
  a = rfsm.state { entry = function(fsm) fsm.n = fsm.n + 1 end },
  rfsm.trans { src = "initial", tgt = "a" } }
return rfsm.state { keep = { "x" }, x = "[\"%n", w = rfsm.state {}, off = rfsm.state {},
  on = rfsm.seqand { l = region },
  rfsm.trans { src = "initial", tgt = "w" },
  rfsm.trans { src = "w", tgt = "off", events = { "e_0" } },
  rfsm.trans { src = "off", tgt = "on", events = { "e_1" } },
  rfsm.trans { src = "on", tgt = "off", events = { rfsm.named "e_x" },
    effect = function(fsm, _, _, events) fsm.x = events[1].x end } }]])
    assert.equal([[
{"root": {"x": "[\"%n"}, "root.on.l": {"n": 0}}
{"root": {"x": "[\"%n"}, "root.on.l": {"n": 1}}
{"root": {"x": [0.1, {"%n": "%t"}]}, "root.on.l": {"n": 1}}
{"root": {"x": {"1": true, "3": 0.30000000000000004}}, "root.on.l": {"n": 2}}
]], sql([[
SELECT rfsm.create('1', 'kept') \gset
SELECT data FROM rfsm.machines;
SELECT rfsm.send('1', 'e_0') \gset
SELECT rfsm.send('1', 'e_1') \gset
SELECT data FROM rfsm.machines;
SELECT rfsm.send('1', '{"name":"e_x","x":[0.1,{"%n":"%t"}]}') \gset
SELECT data FROM rfsm.machines;
SELECT rfsm.send('1', 'e_1') \gset
SELECT rfsm.send('1', '{"name":"e_x","x":{"1":true,"3":0.30000000000000004}}') \gset
SELECT data FROM rfsm.machines;]]))
    has_usual_charts = false
  end)

  it("reports why", function()
    assert.equal("root.trans[2] (off -> on) would be taken on e_on in root.off\n",
      sql([[
SELECT rfsm.create('1', 'lamp') \gset
SELECT * FROM rfsm.why('1', 'e_on') LIMIT 1;]]))
  end)

  it("reports its moves to those who listen", function()
    load_charts({ history = true, notify = true }, "lamp=" .. helper.file_with(LAMP),
      "counter=" .. helper.file_with(COUNTER))
    local output = sql([[
LISTEN rfsm;
SELECT rfsm.create('1', 'counter');
SELECT rfsm.send('1', 'e_tick');]])
    assert.matches('"rfsm" with payload "{"key" : "1", "chart" : "counter", '
      .. '"state" : "root.odd"}" received', output, 1, true)
  end)
end)

describe("an entry that a machine has emitted", function()
  it("is a worker's for a time, and gone when it is done", function()
    assert.equal([[
1|1|emitted|{"n": 1}|1
2|1|emitted|{"n": 2}|1
t
f
2|2
]], sql([[
SELECT rfsm.create('1', 'emitter') \gset
SELECT rfsm.send('1', 'e_emit') \gset
SELECT rfsm.send('1', 'e_emit') \gset
SELECT * FROM rfsm.take();
SELECT * FROM rfsm.take(5);
SELECT * FROM rfsm.take(5);
SELECT rfsm.done(1);
SELECT rfsm.done(1);
UPDATE rfsm.out SET due = now();
SELECT id, try FROM rfsm.take(5);]]))
  end)

  it("is dead when its tries are used up, and no worker gets it any more", function()
    assert.equal([[
t
1|1
1|2
1|3|no worker has finished it
2|3|no stock
0
]], sql([[
SELECT rfsm.create('1', 'emitter') \gset
SELECT rfsm.send('1', 'e_emit') \gset
INSERT INTO rfsm.out (key, what, tries, due) VALUES ('1', 'x', 3, now());
SELECT rfsm.fail(2, 'no stock');
SELECT id, try FROM rfsm.take(5, '0 s', 3);
SELECT id, try FROM rfsm.take(5, '0 s', 3);
SELECT count(*) FROM rfsm.take(5, '0 s', 3) \gset
SELECT count(*) FROM rfsm.take(5, '0 s', 3) \gset
SELECT id, tries, error FROM rfsm.dead ORDER BY id;
SELECT count(*) FROM rfsm.out;]]))
  end)
end)

describe("an operator", function()
  it("holds, releases, forces and ends machines", function()
    assert.equal([[
root.even (hold: no paper) by ann
root.even|t
root.even
kept
root.odd (release) by postgres
root.even (force) by bob
root.odd
root.odd
root.even
|root.even
(hold: no paper) by ann|root.even
e_tick (waits)|root.even
e_tick (waits)|root.even
(release) by postgres|root.even
e_tick|root.odd
(force) by bob|root.even
e_tick by ann|root.odd
e_tick by postgres|root.even
(remove) by ann|root.even|
t
f
0
]], sql([[
SELECT rfsm.create('1', 'counter') \gset
SELECT rfsm.hold('1', 'no paper', 'ann');
SELECT state, due IS NULL FROM rfsm.machines;
SELECT rfsm.send('1', 'e_tick');
SELECT outcome FROM rfsm.reply('1', ARRAY['e_tick'], 'x');
SELECT rfsm.cancel('1', 'x') \gset
SELECT rfsm.release('1');
SELECT rfsm.force('1', 'root.even', 'bob');
SELECT rfsm.send_by('1', 'e_tick', 'ann', 'y');
SELECT rfsm.send_by('1', 'e_tick', 'ann', 'y');
SELECT rfsm.send_by('1', 'e_tick');
SELECT rfsm.remove('1', 'ann') AS was_there \gset
SELECT event, tgt FROM rfsm.history WHERE tgt IS NOT NULL ORDER BY id;
SELECT event, src, tgt FROM rfsm.history WHERE tgt IS NULL;
SELECT :'was_there';
SELECT rfsm.remove('1');
SELECT count(*) FROM rfsm.machines;]]))
    assert.equal("ERROR:  rfsm.force: chart 'counter' has no leaf 'root.add' (did you "
      .. "mean 'root.odd'?)\n", sql([[
SELECT rfsm.create('1', 'counter') \gset
SELECT rfsm.force('1', 'root.add');]]))
  end)

  it("has numbers for Prometheus, counters too", function()
    local function metrics()
      return servers.output_of(("PGHOST=%s PGUSER=postgres %s tools/rfsm postgres "
        .. "--stats postgres"):format(server.folder, helper.interpreter()))
    end
    sql([[
SELECT rfsm.create('1', 'counter'), rfsm.create('2', 'lamp');
SELECT rfsm.create('3', 'emitter');]])
    local before = metrics()
    server:sql("SELECT rfsm.send('1', 'e_tick'), rfsm.send('2', 'e_off') \\gset")
    local text = metrics()
    local function raised(name)
      local pattern = "\nrfsm_" .. name .. "_total (%d+)"
      return text:match(pattern) - before:match(pattern)
    end
    assert.same({ 2, 1 }, { raised "events", raised "dropped" })
    assert.equal([[
# TYPE rfsm_aside gauge
rfsm_aside 0
# TYPE rfsm_dead gauge
rfsm_dead 0
# TYPE rfsm_dropped_total counter
rfsm_dropped_total N
# TYPE rfsm_entries gauge
rfsm_entries N
# TYPE rfsm_errors_total counter
rfsm_errors_total N
# TYPE rfsm_events_total counter
rfsm_events_total N
# TYPE rfsm_machines gauge
rfsm_machines{chart="counter",state="root.odd"} 1
rfsm_machines{chart="emitter",state="root.a"} 1
rfsm_machines{chart="lamp",state="root.off"} 1
# TYPE rfsm_oldest_entry_seconds gauge
rfsm_oldest_entry_seconds N
# TYPE rfsm_oldest_timer_seconds gauge
rfsm_oldest_timer_seconds N
# TYPE rfsm_overdue gauge
rfsm_overdue 0
# TYPE rfsm_timers gauge
rfsm_timers 0
# TYPE rfsm_version_machines gauge
rfsm_version_machines{chart="counter",version="V"} 1
rfsm_version_machines{chart="emitter",version="V"} 1
rfsm_version_machines{chart="lamp",version="V"} 1
]], (text:gsub("(_total) %d+", "%1 N"):gsub("(_seconds) [%d.]+", "%1 N")
      :gsub("(entries) %d+", "%1 N"):gsub('version="[%x-]+"', 'version="V"')))
  end)

  it("finds those that are held", function()
    assert.equal("2\n1 3\n2\n0\n", sql([[
SELECT count(rfsm.create(i::text, 'counter')) FROM generate_series(1, 3) i \g /dev/null
SELECT rfsm.send_at('3', now() + interval '1 h', 'e_tick', 'x') \g /dev/null
SELECT rfsm.hold('2', 'shelf 7') \g /dev/null
SELECT key FROM rfsm.machines WHERE rfsm.is_held(value);
SELECT string_agg(key, ' ' ORDER BY key) FROM rfsm.machines
  WHERE NOT rfsm.is_held(value);
SELECT rfsm.hold('3', 'shelf 8') \g /dev/null
SELECT key FROM rfsm.machines WHERE rfsm.is_held(value) AND 'shelf 7' =
  (SELECT g.value FROM rfsm.get(key) g WHERE g.name = 'held_because');
SELECT rfsm.release(key) FROM rfsm.machines WHERE rfsm.is_held(value) \g /dev/null
SELECT count(*) FROM rfsm.machines WHERE rfsm.is_held(value);]]))
  end)

  it("is told which machines a script leaves without a chart", function()
    sql "SELECT rfsm.create('1', 'counter'), rfsm.create('2', 'lamp');"
    local command = ("PGHOST=%s PGUSER=postgres %s tools/rfsm postgres --history "
      .. "--load postgres lamp=%s"):format(server.folder, helper.interpreter(),
      helper.file_with(COUNTER))
    has_usual_charts = false
    assert.equal("rfsm postgres: the machines of counter cannot run until it is "
      .. "loaded, too\n", servers.output_of(command))
  end)

  it("keeps a history for a time", function()
    assert.equal("2|2\n1|1\n", sql([[
SELECT rfsm.create('1', 'counter'), rfsm.send('1', 'e_tick') \gset
UPDATE rfsm.history SET at = at - interval '1 day' WHERE src IS NULL;
SELECT count(*), 2 FROM rfsm.history;
SELECT rfsm.trim('1 hour'), count(*) - 1 FROM rfsm.history;]]))
    assert.matches("PERFORM rfsm.trim('30 days');", script.sql({ "c="
      .. helper.file_with(COUNTER) }, { history = true, history_days = 30 }), 1, true)
  end)

  it("pulls a machine, and pushes what was repaired", function()
    local output = sql([[
SELECT rfsm.create('1', 'counter');
SELECT rfsm.pull('1') AS old \gset
SELECT rfsm.send('1', 'e_tick');
SELECT rfsm.push('1', :'old');
SELECT value AS now FROM rfsm.get('1') WHERE name = 'revision' \gset
SELECT rfsm.push('1', left(:'old', -9));
SELECT rfsm.push('1', :'old', :now, 'ann');
SELECT rfsm.set('1', 'n', '7', 'ann');
SELECT rfsm.set('1', 'm', '7');
SELECT event, src, tgt FROM rfsm.history ORDER BY id;
SELECT h->'snap'->'leaf', h->'snap'->'data'->'root'->2
  FROM jsonb_array_elements((rfsm.pull('1')::jsonb)->'fleet'->'history') h;]])
    assert.equal([[
root.even
root.odd
ERROR:  rfsm.push: the machine at '1' has moved on, its revision is not N any more: ]]
      .. [[pull it again, or set one field
ERROR:  rfsm.push: file (is it cut short?): a JSON object expected
root.even (push) by ann
root.even (set root.n: 0 -> 7) by ann
ERROR:  rfsm.set: no state of chart 'counter' keeps the field 'm'
||root.even
e_tick|root.even|root.odd
(push) by ann|root.odd|root.even
(set root.n: 0 -> 7) by ann|root.even|root.even
"root.even"|0
"root.odd"|1
"root.even"|0
"root.even"|7
]], (output:gsub("%d%d%d%d+", "N"):gsub(" %(did you mean.-%)", "")))
  end)

  it("sees what waits, the log, what is due, and the versions", function()
    assert.equal([[
held|yes
held_because|looked at
kept|[]
waiting|[{"events":["e_tick"],"id":"x"}]
ids|["one"]
t
0
0
counter|1
1
2|0
]], (sql([[
SELECT rfsm.create('1', 'counter', id => 'one') \gset
SELECT rfsm.create('2', 'counter') \gset
SELECT rfsm.hold('1', 'looked at') \gset
SELECT rfsm.send('1', 'e_tick', 'x') \gset
SELECT name, regexp_replace(value, ',"time":[0-9.]+', '') FROM rfsm.get('1')
  WHERE name IN ('held', 'held_because', 'kept', 'waiting', 'ids');
SELECT why ~ '^held for ' FROM rfsm.why('1', 'e_tick') why LIMIT 1;
SELECT count(*) FROM rfsm.log('1');
SELECT value FROM rfsm.stats() WHERE name = 'rfsm_aside';
SELECT chart, machines - 1 FROM rfsm.versions();
SELECT rfsm.send_at('2', now(), 'e_tick', 'y') \gset
UPDATE rfsm.machines SET due = now() WHERE key = '2';
SELECT count(*) FROM rfsm.due();
SELECT count(*), (SELECT count(*) FROM rfsm.find('counter', 'root', 10, '1 h'))
  FROM rfsm.find('counter', 'root');]])))
  end)

  it("warns of a chart or state that no machine can be in, and of kinds", function()
    assert.equal([[
WARNING:  rfsm.find: no machine of chart 'counter' is in 'ood' (did you ]]
      .. [[mean 'root.odd'?)
0
WARNING:  rfsm.find: no machine of chart 'conter' is in 'root' (did you mean 'counter'?)
0
2
ERROR:  rfsm.set: field 'root.n': a number expected, got the text "abc" (force => ]]
      .. "true sets it nevertheless)\n", sql [[
SELECT rfsm.create('1', 'counter') \gset
SELECT count(*) FROM rfsm.find('counter', 'ood');
SELECT count(*) FROM rfsm.find('conter', 'root');
SELECT * FROM rfsm.find('counter', 'root.odd');
SELECT rfsm.set('1', 'n', '"abc"', force => true) \gset
SELECT rfsm.set('1', 'n', '2') \gset
SELECT data->'root'->'n' FROM rfsm.machines;
SELECT rfsm.set('1', 'n', '"abc"');]])
  end)

  it("sends dead entries again, drops them, and reads numbers", function()
    assert.equal([[
rfsm_aside|||0
rfsm_dead|||2
rfsm_entries|||0
rfsm_machines|counter|root.even|1
rfsm_overdue|||1
rfsm_timers|||1
t
f
t
1|x
]], sql([[
SELECT rfsm.create('1', 'counter') \gset
UPDATE rfsm.machines SET due = now() - interval '2 minutes';
INSERT INTO rfsm.dead VALUES (7, now(), '1', 'x', NULL, 5, 'no'),
  (8, now(), '1', 'y', NULL, 5, 'no');
SELECT * FROM rfsm.stats();
SELECT rfsm.again(7);
SELECT rfsm.again(7);
SELECT rfsm.drop(8);
SELECT key, what FROM rfsm.out;]]))
  end)
end)

describe("a role that may use the schema", function()
  local FORGED = {
    "SELECT * FROM rfsm.machines", "SELECT * FROM rfsm.out", "SELECT * FROM rfsm.log",
    "SELECT * FROM rfsm.history", "SELECT * FROM rfsm.dead",
    "UPDATE rfsm.machines SET state = 'root.odd'", "DELETE FROM rfsm.machines",
    "INSERT INTO rfsm.out (key, what) VALUES ('1', 'pay')", "DELETE FROM rfsm.out",
    "INSERT INTO rfsm.machines SELECT * FROM rfsm.machines",
    "TRUNCATE rfsm.machines", "DROP TABLE rfsm.machines",
    "SELECT rfsm.call('rfsm_send', '1', ARRAY['e_tick'], NULL)",
    "SELECT rfsm.hold('1')", "SELECT rfsm.release('1')", "SELECT rfsm.remove('1')",
    "SELECT rfsm.force('1', 'root.odd')", "SELECT rfsm.drop(1)",
    "SELECT rfsm.metrics()", "SELECT rfsm.trim('1 day')",
    "SELECT rfsm.pull('1')", "SELECT rfsm.push('1', '')",
    "SELECT rfsm.set('1', '', '1')", "SELECT rfsm.send_by('1', 'e_tick')",
    "SELECT rfsm.take()", "SELECT rfsm.done(1)", "SELECT rfsm.fail(1, 'x')",
    "CREATE TABLE rfsm.x (y int)", "CREATE FUNCTION rfsm.f() RETURNS int LANGUAGE sql "
      .. "AS 'SELECT 1'",
    "ALTER FUNCTION rfsm.send(text, text, text) RESET ALL",
    "DO $$ BEGIN LOCK rfsm.machines; END $$",
  }

  it("sends, and forges or reads nothing", function()
    local output = sql([[
CREATE ROLE shop;
GRANT USAGE ON SCHEMA rfsm TO shop;
SELECT rfsm.create('1', 'counter') \gset
SET ROLE shop;
SELECT rfsm.send('1', 'e_tick');
SELECT outcome FROM rfsm.reply('1', ARRAY['e_tick']);
SELECT rfsm.create('2', 'counter');
SELECT rfsm.send_at('2', now(), 'e_tick', 'a');
SELECT rfsm.cancel('2', 'a');
SELECT rfsm.wake();
SELECT count(*) > 0 FROM rfsm.why('2', 'e_tick');
]] .. table.concat(FORGED, ";\n") .. ";")
    local replies = assert(output:match("^root.odd\ntaken\nroot.even\nroot.odd\nf\n"
      .. "0\nt\n(.*)$"), output)
    local others, count = replies:gsub("ERROR:  permission denied for [^\n]*\n", "")
    local rest, more = others:gsub("ERROR:  must be owner of [^\n]*\n", "")
    assert.same({ "", #FORGED }, { rest, count + more })
    sql("DROP OWNED BY shop; DROP ROLE shop")
  end)

  it("does not lend the owner's rights to names of its own", function()
    assert.equal("root.odd\n0\n", sql([[
CREATE SCHEMA trap;
CREATE FUNCTION trap.now() RETURNS timestamptz LANGUAGE plpgsql AS $$
BEGIN UPDATE rfsm.machines SET state = 'forged'; RETURN clock_timestamp(); END $$;
SELECT rfsm.create('1', 'counter') \gset
SET search_path = trap, pg_catalog;
CREATE TEMP TABLE machines (key text);
SELECT rfsm.send('1', 'e_tick');
SELECT rfsm.wake() \gset
SELECT count(*) FROM rfsm.machines WHERE state = 'forged';
SET client_min_messages = error;
DROP SCHEMA trap CASCADE;]]))
  end)
end)

describe("a worker", function()
  local WORKS = "SELECT count(*) = %d FROM pg_stat_activity "
    .. "WHERE application_name = 'working'"

  it("ends when its client was killed", function()
    sql("")
    local client = servers.program("env " .. server:command("psql", "-Xq -f "
      .. helper.file_with("SET application_name = 'working';\n"
        .. "CALL rfsm.work(0.01, '0.1 s');")))
    server:wait_for(WORKS:format(1))
    servers.output_of("kill -9 " .. client.id)
    client.id = nil
    server:wait_for(WORKS:format(0))
  end)

  it("tries again when a lock has passed, and puts no machine aside", function()
    sql("SELECT rfsm.create('1', 'lamp'), rfsm.send('1', 'e_on') \\gset")
    local waits = "(SELECT count(*) FROM pg_locks WHERE NOT granted)"
    local unlock = server:beside(([[
SET statement_timeout = 60000;
BEGIN;
LOCK TABLE rfsm.out; -- in which the machine will emit
DO $$ BEGIN
  WHILE %s = 0 LOOP PERFORM pg_sleep(0.01); END LOOP;
  WHILE %s > 0 LOOP PERFORM pg_sleep(0.01); END LOOP;
END $$;
COMMIT;]]):format(waits, waits))
    server:wait_for("SELECT count(*) > 0 FROM pg_locks WHERE granted "
      .. "AND relation = 'rfsm.out'::regclass AND mode = 'AccessExclusiveLock'")
    local finish = server:beside("SET lock_timeout = '200ms';\n"
      .. "SET application_name = 'working';\nCALL rfsm.work(0.2);")
    assert.equal("", unlock())
    server:wait_for("SELECT due IS NULL FROM rfsm.machines")
    assert.equal("root.off|f\n", server:sql("SELECT state, EXISTS(SELECT FROM rfsm.log "
      .. "WHERE error LIKE '%lock%') FROM rfsm.machines"))
    server:sql("SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
      .. "WHERE application_name = 'working'")
    finish()
  end)

  it("goes on after a conflict, and ends when its client is gone", function()
    local wait = server:beside([[
SET default_transaction_isolation = 'repeatable read';
SET application_name = 'working';
CALL rfsm.work(0.01, '0.1 s');]])
    sql("SELECT rfsm.create('1', 'counter')")
    server:wait_for("SELECT count(*) = 1 FROM pg_stat_activity "
      .. "WHERE application_name = 'working'")
    server:sql([[
BEGIN;
UPDATE rfsm.machines SET due = now();
SELECT pg_sleep(0.05);
COMMIT;]])
    server:wait_for("SELECT due IS NULL FROM rfsm.machines")
    assert.equal("0\n", server:sql("SELECT count(*) FROM rfsm.log"))
    server:sql("SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
      .. "WHERE application_name = 'working'")
    assert.matches("rfsm.work: %d machines were woken", wait())
  end)
end)

describe("a wrong call changes nothing:", function()
  -- Returns all that is there before some calls, their output, and all after them.
  local function calls(text)
    return sql("SELECT rfsm.create('1', 'lamp') \\gset\n" .. ALL .. "\\echo --\n"
      .. text .. "\\echo --\n" .. ALL):match("^(.-)%-%-\n(.-)%-%-\n(.*)$")
  end

  for name, case in pairs {
    ["an unknown event"] = { call = "rfsm.send('1', 'e_onn')",
      text = "rfsm.send: no transition of chart 'lamp' has the event 'e_onn' "
        .. "(did you mean 'e_on'?)" },
    ["no key"] = { call = "rfsm.send(NULL, 'e_on')",
      text = "rfsm.send: the key of a machine expected, got none" },
    ["data that is no JSON"] = { call = "rfsm.create('2', 'lamp', '{')",
      text = "invalid input syntax for type json at character 33" },
    ["a time that is none"] = {
      call = "rfsm.send_at('1', 'infinity', 'e_on', id => 'a')",
      text = "rfsm.send_at: seconds, or +seconds expected, got 'Infinity'" },
    ["text that is no UTF-8"] = { call = "rfsm.send('1', 'e_spoil')",
      text = "invalid byte sequence for encoding \"UTF8\": 0xff" },
    ["a callback without an end"] = { call = "rfsm.send('1', 'e_loop')",
      text = "canceling statement due to statement timeout", timeout = 200 },
  } do
    it(name, function()
      local before, answer, after = calls(("SET statement_timeout = %d;\nSELECT %s;\n"
        .. "RESET statement_timeout;\n"):format(case.timeout or 0, case.call))
      assert.equal("ERROR:  " .. case.text .. "\n", answer)
      assert.equal(before, after)
    end)
  end

  it("with the SQLSTATE of a text that is no UTF-8", function()
    assert.equal("root.off\nERROR:  22021\n", sql("SELECT rfsm.create('1', 'lamp');\n"
      .. "\\set VERBOSITY sqlstate\nSELECT rfsm.send('1', 'e_spoil');"))
  end)

  it("nor does what came before in its transaction", function()
    local before, answer, after = calls("BEGIN; SELECT rfsm.send('1', 'e_busy');\n"
      .. "SELECT rfsm.create('2', 'lamp'); SELECT rfsm.send('3', 'x');\nCOMMIT;\n")
    assert.equal("root.busy\nroot.off\nERROR:  rfsm.send: no machine is at '3' "
      .. "(rfsm.create makes one)\n", answer)
    assert.equal(before, after)
  end)

  it("and the session goes on", function()
    assert.equal("root.off\nERROR:  canceling statement due to statement timeout\n"
      .. "root.busy\n", sql([[
SELECT rfsm.create('1', 'lamp');
SET statement_timeout = 100;
SELECT rfsm.send('1', 'e_loop');
SET statement_timeout = 0;
SELECT rfsm.send('1', 'e_busy');]]))
  end)
end)

describe("a new version of a chart", function()
  local function tick(by, more)
    return "c=" .. helper.file_with(servers.counter(by, more))
  end

  -- Sends an event to a machine; returns its data, or the error.
  local function send(key)
    return server:sql(("SELECT rfsm.send('%s', 'e_tick') \\gset\nSELECT data->'root'->"
      .. "'n' FROM rfsm.machines WHERE key = '%s'"):format(key, key)):match("[^\n]*")
  end

  it("takes machines at their next event if it can, or leaves them", function()
    local old = tick(1)
    load_charts({ history = true }, old)
    sql("SELECT rfsm.create('1', 'c')")
    -- a state more, and no migration: machines of the old version stay
    load_charts({ history = true }, old, tick(10, "third = rfsm.state {}, "))
    server:sql("SELECT rfsm.create('2', 'c')")
    assert.same({ "1", "10" }, { send("1"), send("2") })
    -- with a function they move
    load_charts({ history = true }, old, tick(100, "third = rfsm.state {}, migrate = "
      .. "function(snap) snap.leaf = 'root.even' end, "))
    assert.equal("101", send("1"))
    -- of an unknown version there is nothing to run
    load_charts({ history = true }, tick(1, "fourth = rfsm.state {}, "))
    assert.matches("^ERROR:  rfsm.send: the machine at '1': rfsm.snapshot: the "
      .. "snapshot is of another chart: ", send("1"))
  end)

  it("is seen by sessions that are there", function()
    load_charts({ history = true }, tick(1))
    local library = helper.file_with((script.sql({ tick(10) },
      { history = true })))
    assert.equal("11\n", sql(([[
SELECT rfsm.create('1', 'c') \gset
SELECT rfsm.send('1', 'e_tick') \gset
\! COMMAND
SELECT rfsm.send('1', 'e_tick') \gset
SELECT data->'root'->'n' FROM rfsm.machines;]]):gsub("COMMAND", function()
      return server:command("psql", "-Xq -f " .. library)
    end)))
  end)
end)

describe("a schema that is loaded again", function()
  local BOTH = { history = true, notify = true }

  -- The triggers of rfsm.machines, in the order of their names; `what` is a column.
  local function triggers(what)
    return server:sql(("SELECT %s FROM pg_trigger WHERE tgrelid = 'rfsm.machines'::"
      .. "regclass ORDER BY tgname"):format(what))
  end

  local function load_counter(options)
    load_charts(options, "counter=" .. helper.file_with(COUNTER))
  end

  for name, options in pairs { ["with a trigger for each option"] = BOTH,
    ["without triggers"] = {} } do
    it("waits for no client in a transaction, " .. name, function()
      load_counter(options)
      local library = helper.file_with((script.sql({ "counter="
        .. helper.file_with(COUNTER) }, options)))
      assert.equal("root.even\nroot.odd\nroot.even\n", sql(([[
BEGIN;
SELECT rfsm.create('1', 'counter');
SELECT rfsm.send('1', 'e_tick');
SELECT FROM rfsm.log, rfsm.out;
\! PGOPTIONS='-c lock_timeout=2s' COMMAND
SELECT rfsm.send('1', 'e_tick');
COMMIT;]]):gsub("COMMAND", function()
        return server:command("psql", "-Xq -v ON_ERROR_STOP=1 -f " .. library)
      end)))
    end)
  end

  -- Returns what is printed while a file is loaded, and a transaction holds a table.
  local function load_beside(options, table_name, seconds)
    local library = helper.file_with((script.sql({ "counter="
      .. helper.file_with(COUNTER) }, options)))
    local wait = server:beside("BEGIN; SELECT FROM " .. table_name .. " LIMIT 1; "
      .. "SELECT pg_sleep(" .. seconds .. ")")
    server:wait_for("SELECT true FROM pg_locks WHERE relation = '" .. table_name
      .. "'::regclass AND pid <> pg_backend_pid() LIMIT 1")
    local output = servers.output_of(server:command("psql",
      "-Xq -v ON_ERROR_STOP=1 -v VERBOSITY=terse -f " .. library))
    server:sql("SELECT pg_cancel_backend(pid) FROM pg_stat_activity WHERE query LIKE "
      .. "'SELECT pg_sleep%'")
    wait()
    return (output:gsub("^psql:[^ ]+:%d+: ", ""):gsub("pid %d+", "pid N"))
  end

  it("waits a few times for a table that is to change, and names who holds it",
    function()
      load_counter {}
      assert.equal("", load_beside(BOTH, "rfsm.machines", 1))
      assert.equal("ERROR:  rfsm: nothing was loaded: other sessions hold tables that "
        .. "are to change (pid N); load again when their transactions have ended\n",
        load_beside({}, "rfsm.machines", 60))
      assert.equal("note_move\nnote_new\nnotify_move\nnotify_new\n", triggers "tgname")
      assert.equal("", load_beside(BOTH, "rfsm.machines", 60))
    end)

  it("keeps its triggers, also if its functions are found without a schema", function()
    load_counter(BOTH)
    local before = triggers "oid"
    load_counter(BOTH)
    assert.equal(before, triggers "oid")
    server:sql("ALTER ROLE postgres SET search_path = rfsm, public")
    load_counter(BOTH)
    server:sql("ALTER ROLE postgres RESET search_path")
    assert.equal(before, triggers "oid")
  end)

  it("has the triggers of its options, and those of others", function()
    load_counter(BOTH)
    server:sql("CREATE TRIGGER mine AFTER DELETE ON rfsm.machines FOR EACH ROW EXECUTE "
      .. "FUNCTION rfsm.note()")
    assert.equal("mine\nnote_move\nnote_new\nnotify_move\nnotify_new\n",
      triggers "tgname")
    load_counter { notify = true }
    assert.equal("mine\nnotify_move\nnotify_new\n", triggers "tgname")
    load_counter { history = true }
    assert.equal("mine\nnote_move\nnote_new\n", triggers "tgname")
    load_counter()
    assert.equal("mine\n", triggers "tgname")
  end)

  it("makes a trigger that is different anew", function()
    load_counter(BOTH)
    local before = triggers "pg_get_triggerdef(oid)"
    server:sql("DROP TRIGGER note_move ON rfsm.machines; CREATE TRIGGER note_move "
      .. "AFTER UPDATE ON rfsm.machines FOR EACH ROW EXECUTE FUNCTION rfsm.note()")
    load_counter(BOTH)
    assert.equal(before, triggers "pg_get_triggerdef(oid)")
  end)
end)

describe("many clients", function()
  local MACHINES = math.min(1000, EVENTS / 10)

  -- Clients wait until the gate has a row.
  local GATE = [[
DROP TABLE IF EXISTS gate;
CREATE TABLE gate (open boolean);
CREATE OR REPLACE FUNCTION pass() RETURNS text LANGUAGE plpgsql AS $$ BEGIN
  WHILE NOT EXISTS (SELECT FROM gate) LOOP PERFORM pg_sleep(0.01); END LOOP;
  RETURN 'passed';
END $$;
]]

  -- Has clients send ticks to machines, and calls a function when a third has come. The
  -- last third is sent after that. Returns how often each was to tick, how often it
  -- has, and the clients' errors.
  local function storm(other, between)
    other:sql((script.sql { "counter=" .. helper.file_with(COUNTER) }))
    other:sql(("SELECT rfsm.create('m' || i, 'counter') FROM generate_series(1, %d) i")
      :format(MACHINES))
    other:sql(GATE)
    local random, sent, found, lines = new_random(28), {}, {}, {}
    for i = 1, EVENTS do
      local key, client = "m" .. random:below(MACHINES), i % CLIENTS + 1
      sent[key] = (sent[key] or 0) + 1
      lines[client] = lines[client] or {}
      table.insert(lines[client], ("SELECT rfsm.send('%s', 'e_tick', id => '%d');")
        :format(key, i))
    end
    for _, list in ipairs(lines) do
      table.insert(list, math.floor(#list * 2 / 3), "SELECT pass();")
    end
    local finish = other:storm(lines)
    other:wait_for(("SELECT sum((data->'root'->>'n')::int) > %d FROM rfsm.machines")
      :format(math.floor(EVENTS / 3)))
    between()
    other:sql("INSERT INTO gate VALUES (true)")
    local errors = finish()
    for key, n in other:sql("SELECT key, data->'root'->'n' FROM rfsm.machines")
      :gmatch("(%S+)|(%d+)\n") do
      found[key] = n ~= "0" and tonumber(n) or nil
    end
    return sent, found, errors
  end

  it("apply each event once, also if the server is killed in between", function()
    sql("")
    local sent, found, errors = storm(server, function()
      server:kill()
      server:launch()
    end)
    assert.not_matches("gave up", errors)
    assert.same(sent, found)
  end)

  it("lose no event while a new version of the chart is loaded", function()
    sql("")
    local sent, found, errors = storm(server, function()
      load_charts({}, "counter=" .. helper.file_with(COUNTER), "counter="
        .. helper.file_with((COUNTER:gsub("even%f[%W]", "round"):gsub("n = 0,",
        "%0 rename = { ['root.even'] = 'root.round' },"))))
    end)
    assert.equal("", errors)
    assert.same(sent, found)
    assert.equal("root.odd\nroot.round\n", server:sql([[
SELECT rfsm.tick(key) FROM rfsm.machines \g /dev/null
SELECT state FROM rfsm.machines GROUP BY state, version ORDER BY state;]]))
  end)

  it("wake each machine once", function()
    load_charts({}, "due=" .. helper.file_with(DUE))
    sql(("SELECT rfsm.create('m' || i, 'due') FROM generate_series(1, %d) i")
      :format(EVENTS))
    local work = "DO $$ BEGIN WHILE EXISTS (SELECT FROM rfsm.machines WHERE due IS NOT "
      .. "NULL) LOOP PERFORM rfsm.wake(); COMMIT; END LOOP; END $$;"
    local workers = { server:beside(work), server:beside(work) }
    for _, finish in ipairs(workers) do assert.equal("", finish()) end
    assert.equal(("%d|%d|t\n"):format(EVENTS, EVENTS), server:sql("SELECT count(*), "
      .. "count(DISTINCT key), bool_and(data = '{\"n\": 1}') FROM rfsm.out"))
  end)
end)

describe("a call that begins before a new version of its chart is there", function()
  it("is answered by the new one", function()
    local old = "c=" .. helper.file_with(COUNTER)
    load_charts({}, old)
    sql("SELECT rfsm.create('1', 'c')")
    -- the call waits for the lock of the table until the machine has moved
    local library = script.sql { old, "c=" .. helper.file_with((COUNTER:gsub("odd",
      "uneven"):gsub("n = 0,", "%0 rename = { ['root.odd'] = 'root.uneven' },"))) }
    assert.equal("root.uneven\nroot.even\n2\n", server:sql(([[
BEGIN;
LOCK TABLE rfsm.machines;
\! COMMAND >OUTPUT 2>&1 &
DO $$ BEGIN
  WHILE NOT EXISTS (SELECT FROM pg_stat_activity WHERE wait_event_type = 'Lock') LOOP
    PERFORM pg_stat_clear_snapshot(), pg_sleep(0.01);
  END LOOP;
END $$;
\i LIBRARY
SELECT rfsm.send('1', 'e_tick');
COMMIT;
\! for i in $(seq 3000); do [ -s OUTPUT ] && break; sleep 0.01; done; cat OUTPUT
SELECT data->'root'->'n' FROM rfsm.machines;]]):gsub("%u%u%u+", {
      COMMAND = server:command("psql", "-XAqt -c \"SELECT rfsm.send('1', 'e_tick')\""),
      LIBRARY = helper.file_with((library:gsub("\nBEGIN;\n", "\n", 1)
        :gsub("\nCOMMIT;\n$", "\n"))), OUTPUT = helper.file_with("") })))
  end)
end)

describe("doc/postgres.md", function()
  before_each(function()
    load_charts({ history = true }, "order=examples/warehouse/order.lua",
      "lamp=" .. helper.file_with(LAMP))
  end)

  it("shows what its statements return", function()
    local blocks, expected, at = {}, {}, 1
    for block in helper.content("doc/postgres.md"):gmatch("\n```sql\n(.-)```") do
      blocks[#blocks + 1] = block
      for line in block:gmatch("%-%-> ([^\n]*)") do expected[#expected + 1] = line end
    end
    local output = sql(table.concat(blocks))
    for _, line in ipairs(expected) do
      local _, last = output:find(line, at, true)
      assert.is_truthy(last, line .. " expected in:\n" .. output:sub(at))
      at = last
    end
    assert.is_nil(output:find("ERROR:.*ERROR:"))
  end)

  it("names an index that its questions use", function()
    assert.matches("machines_state", server:sql([[
SET enable_seqscan = off; SET enable_bitmapscan = off;
EXPLAIN SELECT key FROM rfsm.machines WHERE chart = 'order' AND state = 'root.picking'
  AND since < now() - interval '1 hour';]]))
  end)

  it("names the rights that a caller needs", function()
    assert.equal("root.off\nroot.busy\n", sql([[
CREATE ROLE caller;
GRANT USAGE ON SCHEMA rfsm TO caller;
GRANT SELECT, INSERT, UPDATE ON rfsm.machines TO caller;
GRANT INSERT ON rfsm.log, rfsm.out, rfsm.history TO caller;
SET ROLE caller;
SELECT rfsm.create('1', 'lamp');
SELECT rfsm.send('1', 'e_busy');]]))
  end)
end)

describe("a backup", function()
  it("is read into a new database, as doc/postgres.md shows", function()
    local environment, bin = server:command("", ""):match("^(.*) (%S+)/ $")
    local block = helper.content("doc/postgres.md"):match("\n```\n(pg_dump .-)```")
    sql "SELECT rfsm.create('1', 'lamp'), rfsm.send('1', 'e_on', 'id') \\gset"
    local commands = helper.file_with(("export %s PATH=%s:$PATH\ncd $(mktemp -d)\n%s\n"
      .. "rm -r $PWD"):format(environment, bin, (block:gsub("shop", "postgres"))))
    assert.equal("CREATE EXTENSION\n", servers.output_of("sh -e " .. commands))
    assert.equal("1|root.on|known\n1\nroot.off\n2|2\n", server:sql([[
\c copy
SELECT key, state, (rfsm.reply(key, '{e_on}', 'id')).outcome FROM rfsm.machines;
SELECT rfsm.wake();
SELECT state FROM rfsm.machines;
SELECT count(*), max(id) FROM rfsm.out;]]))
    server:sql("DROP DATABASE copy")
  end)
end)

describe("the warehouse", function()
  -- Returns what has happened to each order, in the order of their numbers.
  local function by_order(output)
    local lines, trace = {}, {}
    output = output:gsub("{%d+}:", "")
    for number, text in output:gmatch("order:(%d+) +([^\n]*)") do
      lines[number] = (lines[number] or "") .. " " .. text
    end
    for i = 1, 12 do trace[i] = lines[("%d"):format(i)] or "none" end
    trace[#trace + 1] = output:match("[^\n]*\n$")
    return trace
  end

  it("does in PostgreSQL what it does in Redis", function()
    if servers.no_redis() then return pending(servers.no_redis()) end
    local there = servers.beside("LUA_INIT= PORT=$((20000 + $$ % 20000)) "
      .. "examples/warehouse/fleet.sh lua5.1")
    local here = servers.beside("LUA_INIT= examples/warehouse/postgres.sh lua5.3")
    local expected = by_order(there())
    assert.equal("9 shipped, 3 cancelled\n", expected[13])
    assert.same(expected, by_order(here()))
  end)
end)
