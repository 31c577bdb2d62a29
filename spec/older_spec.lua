-- Fleets of older releases: what today's library does with their tables and keys. The
-- files in spec/support/older are of these releases, with machines in them: o:1 and o:2
-- are paid and overdue, o:2 has an event for later, o:3 is open.

local helper = require "spec.helper"
local redis = require "rfsm.redis"
local script = require "rfsm.postgres.script"
local servers = require "spec.support.servers"

teardown(servers.stop_all)
after_each(helper.remove_files)

local OLDER, CHART = "spec/support/older/", "order=spec/support/older/order.lua"
local RELEASES = { "c370481", "cb842e9a" }

describe("a schema of PostgreSQL", function()
  if not servers.HAS_STORMS then return end -- the server has a Lua of its own
  local missing = servers.no_postgres()
  if missing then
    return it("of an older release goes on", function() pending(missing) end)
  end

  local server
  setup(function() server = servers.postgres("-c fsync=off") end)
  before_each(function() server:sql("DROP SCHEMA IF EXISTS rfsm CASCADE") end)

  local function load(options)
    options = options or { history = true, notify = true }
    return server:sql((script.sql({ CHART }, options)))
  end

  local function load_older(release)
    assert.equal("", server:sql(helper.content(OLDER .. release .. ".sql"))
      :gsub("%d+\n", ""))
  end

  for _, release in ipairs(RELEASES) do
    it("of " .. release .. " goes on, with its machines, timers and entries", function()
      load_older(release)
      assert.equal("", load())
      assert.equal("2\n", server:sql "SELECT rfsm.wake();")
      assert.equal("o:1|root.late|\no:2|root.late|2100-01-01\no:3|root.open|\n",
        server:sql "SELECT key, state, due::date FROM rfsm.machines ORDER BY key;")
      assert.equal("root.late\nroot.open\nroot.paid\n", server:sql [[
        SELECT rfsm.send('o:1', 'e_pay', id => 'id1'); -- it is known
        SELECT rfsm.send('o:1', 'e_ship');
        SELECT rfsm.send('o:3', 'e_pay');]])
      assert.equal("1|o:1|pick|1\n2|o:2|pick|1\n3|o:3|pick|1\n",
        server:sql "SELECT id, key, what, try FROM rfsm.take(9);")
      assert.equal("t\nt\n", server:sql "SELECT rfsm.done(1), rfsm.done(2);"
        :gsub("|", "\n"))
      assert.equal("|root.paid\nroot.paid|root.late\nroot.late|root.open\n", server:sql(
        "SELECT src, tgt FROM rfsm.history WHERE key = 'o:1' ORDER BY id;"))
    end)

    it("of " .. release .. " takes clients without PL/Lua", function()
      load_older(release)
      assert.equal("", server:sql(script.tables { history = true }))
      assert.equal("1\n", server:sql "SELECT count(*) FROM rfsm.take();")
    end)
  end

  it("that is new and one that was altered are the same", function()
    local function columns()
      return server:sql([[
        SELECT c.relname, attname, format_type(atttypid, atttypmod), attnotnull,
          pg_get_expr(adbin, adrelid)
        FROM pg_class c JOIN pg_attribute a ON a.attrelid = c.oid AND attnum > 0
          LEFT JOIN pg_attrdef d ON adrelid = c.oid AND adnum = attnum
        WHERE relnamespace = 'rfsm'::regnamespace AND relkind IN ('r', 'i')
        ORDER BY 1, 2;
        SELECT oid::regprocedure::text FROM pg_proc
        WHERE pronamespace = 'rfsm'::regnamespace ORDER BY 1;
        SELECT obj_description('rfsm'::regnamespace);]])
    end
    assert.equal("", load())
    local new = columns()
    for _, release in ipairs(RELEASES) do
      server:sql("DROP SCHEMA rfsm CASCADE")
      load_older(release)
      assert.equal("", load())
      assert.equal("", load()) -- and once more
      assert.equal(new, columns())
    end
  end)

  it("of a newer release is left alone, with one line and status 2", function()
    assert.equal("", load())
    local function count()
      return server:sql("SELECT count(*) FROM pg_proc WHERE pronamespace = "
        .. "'rfsm'::regnamespace;")
    end
    local before = count()
    local version = server:sql("SELECT substring(obj_description('rfsm'::regnamespace, "
      .. "'pg_namespace') FROM '[0-9]+$');")
    server:sql("COMMENT ON SCHEMA rfsm IS 'rfsm schema 99'; DROP FUNCTION rfsm.wake;")
    local function load_it()
      return servers.output_of(("{ PGHOST=%s PGUSER=postgres tools/rfsm postgres %s "
        .. "--history --notify --load postgres; echo $?; }"):format(server.folder,
        CHART))
    end
    assert.equal(("rfsm postgres: rfsm: nothing was loaded: the schema is of version "
      .. "99, this script knows %d (load one of the rfsm that made it)\n2\n"):format(
      version), load_it())
    assert.equal(tostring(tonumber(before) - 1) .. "\n", count())
    server:sql("DROP SCHEMA rfsm CASCADE")
    assert.equal("0\n", load_it())
    assert.equal(before, count())
  end)
end)

describe("the keys of Redis", function()
  local missing = servers.no_redis()
  if missing then
    return it("of an older release go on", function() pending(missing) end)
  end

  local server, machines
  setup(function() server = servers.redis() end)

  for _, release in ipairs(RELEASES) do
    it("of " .. release .. " go on, with timers, index and entries", function()
      server:cli("FLUSHALL")
      server:cli("<" .. OLDER .. release .. ".redis")
      machines = require("rfsm.fleet").connect(server:url(), { name = "o", tags = 2 })
      assert(machines:load((redis.bundle({ CHART }, { index = true, history = 50 }))))
      assert.equal(2, (machines:wake()))
      assert.equal("root.late", machines:get("o:{1}:1").leaf)
      assert.equal(4102444800, machines:get("o:{1}:2").due)
      assert.equal("known", machines:send_once("id1", "o:{1}:1", "e_pay").outcome)
      assert.equal("root.open", machines:send("o:{1}:1", "e_ship").leaf)
      assert.same({ "o:{1}:1", "o:{1}:3" }, machines:find("order", "root.open"))
      local seen = {}
      assert.equal(2, (machines:work("g", "w", function(entry)
        seen[#seen + 1] = entry.machine .. " " .. entry.what .. " " .. entry.data.item
      end)))
      assert.same({ "o:{1}:1 pick i1", "o:{1}:2 pick i2" }, seen)
      assert.equal("root.late", machines:history("o:{1}:1")[1].from)
    end)
  end
end)
