-- The functions that run inside Redis, with tables in place of it: arguments, what is
-- written, what is refused.

local charts_of = require "rfsm.server.charts"
local host_of = require "spec.support.server_host"
local helper = require "spec.helper"
local encoding = require "rfsm.snapshot.encoding"
local json = require "rfsm.server.codec"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local snapshot = require "rfsm.snapshot"
local share = require "spec.support.share"
local timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

after_each(helper.remove_files)

teardown(function() timeevent.set_gettime_hook(nil) end)

-- a --e_b, 7, after 5 s, or e_x and e_y--> b --e_a--> a; a --e_c--> c { d }, never idle
local function chart()
  return state {
    keep = { "n" }, n = 0, a = state {}, b = state { entry = function(fsm)
      fsm.n = fsm.n + 1
      fsm.emit("b", fsm.n)
    end },
    c = state { d = state { doo = function() while true do rfsm.yield() end end },
      trans { src = "initial", tgt = "d" } },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_b", "e_after(5)", 7 } },
    trans { src = "b", tgt = "a", events = { "e_a" } },
    trans { src = "a", tgt = "c", events = { "e_c" } },
    trans { src = "a", tgt = "b", events = { "await(e_x, e_y)" } },
    trans { src = "b", tgt = "b", events = { "e_bad" },
      effect = function(_, tr) tr._fsm.emit(5) end },
  }
end

local function any()
  return state { a = state {}, trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "a" } }
end

local clock, trace, f, host

-- Loads the library anew with these charts and options, for the machines of the host.
local function load_library(charts, options)
  package.loaded["rfsm.server.functions"] = nil
  f = require "rfsm.server.functions" (host, charts, options)
  package.loaded["rfsm.server.functions"] = nil
end

-- Loads the library with these options, and a machine m of the chart c.
local function open(options)
  clock, trace = { now = 1000 }, {}
  host = host_of.new(trace, clock)
  load_library({ { name = "c", make = chart },
    { name = "any", make = any } }, options)
  assert.same({ "root.a", "done", "taken" }, f.rfsm_create({ "m" }, { "c" }))
  for i = #trace, 1, -1 do trace[i] = nil end
end

-- Calls a function on m; returns the reply or the error.
local function call(name, ...)
  local reply = f["rfsm_" .. name]({ "m" }, { ... })
  return type(reply) == "table" and reply.err or reply
end

-- The names of what was written since the last time, in order.
local function written()
  local names = {}
  for i, line in ipairs(trace) do names[i] = line:match("^%S+") end
  for i = #trace, 1, -1 do trace[i] = nil end
  return table.concat(names, " ")
end

before_each(function() open() end)

describe("a call", function()
  it("writes what has changed, the machine after what may fail", function()
    call("send", "e_b")
    assert.equal("ZREM XADD SET SPUBLISH", written())
    call("send", "e_b") -- nothing happens
    assert.equal("SET", written())
    call("send", "e_a")
    assert.equal("ZADD SET SPUBLISH", written())
  end)

  it("notes the move in index and history, if the library has them", function()
    open { index = true, history = 5 }
    call("send", "e_b")
    local lines = table.concat(trace, "\n")
    assert.equal("ZREM XADD SET ZREM ZADD ZADD XADD SPUBLISH", written())
    assert.matches("ZREM {1=rfsm:in:{m},2=c\troot.a\tm}", lines, 1, true)
    assert.matches("ZADD {1=rfsm:in:{m},2=0,3=c\troot.b\tm}", lines, 1, true)
    assert.matches("XADD {1={m}:history,2=MAXLEN,3=5,4=*,5=event,6=e_b,7=from,8=root.a,"
      .. "9=to,10=root.b,11=snapshot,12=packed}", lines, 1, true)
    assert.matches("XADD {1=rfsm:out:{m},2=*,3=machine,4=m,5=what,6=b,7=data,8=",
      lines, 1, true)
    assert.matches("SPUBLISH {1=rfsm:{m}:m,2=root.b}", lines, 1, true)
  end)

  it("names what has moved a machine: events, those for later, or the time", function()
    open { history = 5 }
    local function moved_by(...)
      written()
      call(...)
      return table.concat(trace, "\n"):match("history.-event,6=(.-),7=")
    end
    assert.equal("e_b", moved_by("send", "e_b"))
    call("send", "e_a")
    clock.now = 1006
    assert.equal("(time)", moved_by("tick"))
    call("send_at", "+1", "e_a", "ID", "x")
    clock.now = 1008
    assert.equal("e_a", moved_by("send", "e_x", "e_b"))
    assert.matches("event,6=e_a,7=.*event,6=e_x e_b,7=", table.concat(trace, "\n"))
  end)

  it("marks a move whose entry has failed", function()
    open { history = 5 }
    load_library({ { name = "c", make = function()
      return state { a = state {}, b = state { entry = error },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_b" } } }
    end } }, { history = 5 })
    f.rfsm_create({ "n" }, { "c" })
    f.rfsm_send({ "n" }, { "e_b" })
    assert.matches("event,6=e_b (error),7=from,8=root.a,9=to,10=root.b",
      table.concat(trace, "\n"), 1, true)
  end)

  it("knows the latest 16 ids, and forgets the oldest", function()
    for i = 1, 17 do call("send", i % 2 == 1 and "e_b" or "e_a", "ID", "i" .. i) end
    written()
    call("send", "e_a", "ID", "i2")
    assert.equal("", written())
    call("send", "e_a", "ID", "i1")
    assert.equal("ZADD SET SPUBLISH", written())
  end)

  it("keeps ids for a time, at most so many", function()
    open { ids_for = 10, ids = 20 }
    for i = 1, 21 do call("send", i % 2 == 1 and "e_b" or "e_a", "ID", "i" .. i) end
    written()
    call("send", "e_a", "ID", "i2")
    assert.equal("", written())
    call("send", "e_a", "ID", "i1")
    assert.equal("ZADD SET SPUBLISH", written())
    clock.now = 1004
    call("send", "e_b", "ID", "now")
    assert.equal(40, #host.packs.unpack("m")[7])
    clock.now = 1014
    call("send", "e_a", "ID", "later")
    assert.same({ "now", 1004, "later", 1014 }, host.packs.unpack("m")[7])
  end)

  it("has a clock that stands still, and goes on with the next one", function()
    assert.equal("1005.000000", call("get")[16])
    clock.now = 1002.5
    call("send", "e_b", "ID", "1")
    call("send", "e_a")
    assert.equal("1007.500000", call("get")[16])
    clock.now = 1003.25
    call("send", "e_x")
    assert.equal("1007.500000", call("get")[16])
  end)

  it("goes on at once with a machine that is never idle", function()
    assert.same({ "root.c.d", "active", "taken" }, call("send", "e_c"))
    local view = call("get")
    assert.same({ "leaf", "root.c.d", "mode", "active", "configuration",
      "root root.c root.c.d", "queue", "[]", "due", "1000.000000" },
      { view[5], view[6], view[7], view[8], view[9], view[10], view[13], view[14],
        view[15], view[16] })
  end)

  it("takes any event if a transition has none", function()
    f.rfsm_create({ "x" }, { "any" })
    assert.same({ "root.a", "done", "taken" }, f.rfsm_send({ "x" }, { "whatever" }))
  end)

  it("knows the events that an await waits for, and numbers by their text", function()
    call("send", "e_x")
    assert.same({ "root.b", "done", "taken" }, call("send", "e_y"))
    call("send", "e_a")
    assert.same({ "root.b", "done", "taken" }, call("send", "7"))
  end)
end)

describe("a machine that cannot be entered", function()
  it("is inactive, also when its id is known", function()
    local function locked()
      return state { a = state {}, trans { src = "initial", tgt = "a",
        guard = function() return false end } }
    end
    load_library { { name = "l", make = locked } }
    local reply = f.rfsm_create({ "l" }, { "l", "ID", "1" })
    assert.same({ "", "inactive" }, { reply[1], reply[2] })
    assert.same({ "", "inactive", "known" },
      f.rfsm_create({ "l" }, { "l", "ID", "1" }))
    local view = f.rfsm_get({ "l" })
    assert.same({ "", "inactive", "" }, { view[6], view[8], view[10] })
  end)
end)

describe("a name that is emitted", function()
  it("is a text", function()
    call("send", "e_b")
    local reply = call("send", "e_bad")
    assert.matches("EFFECT.*emit: name expected, got number$", reply[3])
  end)
end)

describe("a call is refused, and nothing is written:", function()
  for _, case in ipairs {
    { name = "send", args = {},
      text = "an event expected, got none" },
    { name = "send", args = { ("x"):rep(257) },
      text = "event 1: at most 256 bytes expected, got 257" },
    { name = "send", args = { "e_b", ("x"):rep(257) },
      text = "event 2: at most 256 bytes expected, got 257" },
    { name = "send", args = { "e_b", "ID", "" },
      text = "ID: 1 to 64 bytes expected, got 0" },
    { name = "send", args = { "e_b", "ID", ("x"):rep(65) },
      text = "ID: 1 to 64 bytes expected, got 65" },
    { name = "send_at", args = { "1", "e_b" },
      text = "a time, events and ID id expected" },
    { name = "send_at", args = { "1", "ID", "x" },
      text = "a time, events and ID id expected" },
    { name = "send_at", args = { "+x", "e_b", "ID", "x" },
      text = "seconds, or +seconds expected, got '+x'" },
    { name = "send_at", args = { "1e3", "e_b", "ID", "x" },
      text = "seconds, or +seconds expected, got '1e3'" },
    { name = "why", args = {},
      text = "one event expected, got 0" },
    { name = "why", args = { "e_a", "e_b" },
      text = "one event expected, got 2" },
    { name = "wake", args = { "0" },
      text = "a whole number from 1 to 10000 expected, got '0'" },
    { name = "wake", args = { "10001" },
      text = "a whole number from 1 to 10000 expected, got '10001'" },
    { name = "wake", args = { "1.5" },
      text = "a whole number from 1 to 10000 expected, got '1.5'" },
    { name = "wake", args = { "x" },
      text = "a whole number from 1 to 10000 expected, got 'x'" },
    { name = "due", args = { "x" },
      text = "a number expected" },
    { name = "due", args = { "1", "x" },
      text = "a number expected" },
    { name = "create", args = { "c" },
      text = "something is at 'm'" },
    { name = "create", args = {},
      text = "no chart is named '' (there are 'any', 'c')" },
    { name = "create", args = { "d" },
      text = "no chart is named 'd' (there are 'any', 'c')" },
    { name = "find", args = { "c", "root" },
      text = "the library was made without --index" },
    { name = "history", args = {},
      text = "the library was made without --history" },
  } do
    it(case.name .. ": " .. case.text:sub(1, 60), function()
      assert.equal("ERR rfsm_" .. case.name .. ": " .. case.text,
        call(case.name, unpack(case.args)))
      assert.equal("", written())
    end)
  end

  it("an event that no transition has", function()
    assert.matches("^ERR rfsm_send: no transition of chart 'c' has the event 'e_z'",
      call("send", "e_z"))
  end)

  for _, case in ipairs {
    { keys = {}, text = "the key of a machine expected, got none" },
    { keys = { "a}b" }, text = "key 'a}b': a key without braces, or with a hash tag "
      .. "expected" },
    { keys = { "{}b" }, text = "key '{}b': a key without braces, or with a hash tag "
      .. "expected" },
    { keys = { "rfsm:x" }, text = "key 'rfsm:x': rfsm:*, *:log and *:history are no "
      .. "keys of machines" },
    { keys = { "m:log" }, text = "key 'm:log': rfsm:*, *:log and *:history are no "
      .. "keys of machines" },
    { keys = { "m:history" }, text = "key 'm:history': rfsm:*, *:log and *:history are "
      .. "no keys of machines" },
    { keys = { "nobody" }, text = "no machine is at 'nobody' (rfsm_create makes one)" },
  } do
    it(case.text, function()
      assert.equal("ERR rfsm_send: " .. case.text,
        f.rfsm_send(case.keys, { "e_b" }).err)
    end)
  end

  it("names are cut after 80 bytes", function()
    assert.equal("ERR rfsm_send: no machine is at '" .. ("k"):rep(80)
      .. "' (rfsm_create makes one)", f.rfsm_send({ ("k"):rep(200) }, { "e_b" }).err)
  end)

  it("takes as much as may be", function()
    assert.same({ "root.b", "done", "taken" }, call("send", "e_b", "ID", ("x"):rep(64)))
  end)

  it("a machine that is too large", function()
    function host.packs.pack() return ("x"):rep(1048577) end
    assert.equal("ERR rfsm_send: a machine takes at most 1048576 bytes, this one "
      .. "1048577", call("send", "e_b"))
    assert.equal("", written())
    function host.packs.pack() return ("x"):rep(1048576) end
    assert.same({ "root.b", "done", "taken" }, call("send", "e_b"))
  end)

  it("data that is too large, or no object", function()
    local function create(data) return f.rfsm_create({ "n" }, { "c", data }).err end
    assert.equal("ERR rfsm_create: data: at most 65536 bytes expected, got 65537",
      create(("x"):rep(65537)))
    assert.is_nil(create('{"n":5' .. (" "):rep(65529) .. "}"))
    assert.equal("ERR rfsm_create: data.n: at most 9 tables inside each other "
      .. "expected", f.rfsm_create({ "o" }, { "c", '{"n":' .. ('{"x":'):rep(14) .. 5
        .. ("}"):rep(15) }).err)
    assert.equal("ERR rfsm_create: data: the root of the chart does not keep 'colour' "
      .. "(there is 'n')",
      f.rfsm_create({ "o" }, { "c", '{"colour":1}' }).err)
    assert.equal("ERR rfsm_create: field 'n': a number expected, got the text \"x\"",
      f.rfsm_create({ "o" }, { "c", '{"n":"x"}' }).err)
    assert.equal("ERR rfsm_create: data: a JSON object expected",
      f.rfsm_create({ "o" }, { "c", "5" }).err)
    assert.equal("ERR rfsm_create: data: the number -9007199254740993: whole numbers "
      .. "below 2^53 expected",
      f.rfsm_create({ "o" }, { "c", '{"n":[-9007199254740993]}' }).err)
  end)

  it("an event for later, if 100 are waiting", function()
    for i = 1, 100 do
      assert.same({ "root.a", "done", "kept" },
        call("send_at", "2000", "e_b", "ID", "i" .. i))
    end
    written()
    assert.equal("ERR rfsm_send_at: at most 100 events may wait",
      call("send_at", "2000", "e_b", "ID", "more"))
    assert.equal("", written())
  end)

  it("a write that the user has no right for, before any", function()
    function host.redis.acl_check_cmd(name) return name ~= "SPUBLISH" end
    assert.equal("ERR rfsm_send: no right to do SPUBLISH rfsm:{m}:m",
      call("send", "e_b"))
    assert.equal("", written())
  end)

  it("a callback that raises does not undo the call", function()
    call("send", "e_b")
    written()
    local reply = call("send", "e_bad")
    assert.equal(4, #reply)
    assert.same({ "root.b", "done", "taken" }, { reply[1], reply[2], reply[4] })
    assert.equal("XADD XADD SET", written())
  end)
end)

describe("an event for later", function()
  it("comes at its time, in the order of times, then of arrival", function()
    call("send_at", "+3", "e_a", "ID", "z")
    call("send_at", "1003", "e_b", "ID", "y")
    call("send_at", "1001.5", "e_b", "ID", "x")
    assert.equal("1001.500000", call("get")[16])
    clock.now = 1001.5
    assert.same({ "root.b", "done", "taken" }, call("tick"))
    clock.now = 1003
    assert.same({ "root.b", "done", "taken" }, call("tick"))
    assert.equal('{"root":{"n":2}}', call("get")[12])
  end)

  it("is known by its id before and after", function()
    call("send_at", "+3", "e_b", "ID", "x")
    written()
    assert.same({ "root.a", "done", "known" }, call("send_at", "+9", "e_b", "ID", "x"))
    assert.same({ "root.a", "done", "known" }, call("send", "e_b", "ID", "x"))
    assert.equal("", written())
    clock.now = 1003
    assert.same({ "root.b", "done", "taken" }, call("tick"))
    written()
    assert.same({ "root.b", "done", "known" }, call("send_at", "+9", "e_a", "ID", "x"))
    assert.equal("", written())
  end)

  it("is taken back by its id alone", function()
    call("send_at", "+3", "e_b", "ID", "x")
    call("send_at", "+4", "e_b", "ID", "y")
    assert.same({ 0, 1, 0 }, { call("cancel", "z"), call("cancel", "x"),
      call("cancel", "x") })
    assert.equal("1004.000000", call("get")[16])
    assert.equal(0, call("cancel"))
  end)

  it("takes no room once it has come", function()
    call("send_at", "+3", "e_b", "ID", "x")
    assert.same({ { 1003, "x", "e_b" } }, host.packs.unpack("m")[8])
    clock.now = 1003
    call("tick")
    assert.is_nil(host.packs.unpack("m")[8])
  end)

  it("is noted in the log if the chart does not know it any more", function()
    call("send_at", "+1", "e_b", "ID", "x")
    local values = host.packs.unpack("m")
    values[8][1][3] = "e_gone"
    function host.packs.unpack() return encoding.copy_of(values) end
    clock.now = 1001
    local reply = call("tick")
    assert.matches("^rfsm_send_at: no transition of chart 'c' has the event 'e_gone'",
      reply[3])
    assert.same({ "root.a", "done" }, { reply[1], reply[2] })
    assert.matches("XADD {1={m}:log,2=MAXLEN,3=~,4=1000,5=*,6=error,7=rfsm_send_at: ",
      table.concat(trace, "\n"), 1, true)
  end)
end)

describe("what is due", function()
  -- live { a --e_go--> b --1.5 s--> c --e_again--> b }, with a reminder after a second
  local function reminded()
    local function log(text) return function(fsm) fsm.log = fsm.log .. text end end
    return state {
      keep = { "log" }, log = "",
      live = state {
        a = state {}, b = state {}, c = state { entry = log "c" },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_go" } },
        trans { src = "b", tgt = "c", events = { "e_after(1.5)" } },
        trans { src = "c", tgt = "b", events = { "e_again" } },
      },
      trans { src = "initial", tgt = "live" },
      trans { src = "live", tgt = "internal", events = { "e_after(1)" },
        effect = log "." },
    }
  end

  local function every(seconds)
    return function()
      return state { keep = { "n" }, n = 0, a = state {},
        b = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "a", events = { "e_after(" .. seconds .. ")" },
          effect = function(fsm) fsm.n = fsm.n + 1 end },
        trans { src = "a", tgt = "b", events = { "e_stop" } } }
    end
  end

  local function endless()
    return state { a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "a", events = { "e_after(0)" } },
      trans { src = "a", tgt = "b", events = { "e_stop" } } }
  end

  -- live { a --0.5 s--> b --0.5 s--> c --e_go--> d }, with a reminder after a second
  local function in_step()
    return state {
      live = state { a = state {}, b = state {}, c = state {}, d = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_after(0.5)" } },
        trans { src = "b", tgt = "c", events = { "e_after(0.5)" } },
        trans { src = "c", tgt = "d", events = { "e_go" } } },
      trans { src = "initial", tgt = "live" },
      trans { src = "live", tgt = "internal", events = { "e_after(1)" } } }
  end

  before_each(function()
    load_library({ { name = "fast", make = every(0.01) },
      { name = "faster", make = every(0.001) }, { name = "endless", make = endless },
      { name = "r", make = reminded }, { name = "s", make = in_step } },
      { history = 9 })
  end)

  local function data_of(key) return f.rfsm_get({ key })[12] end

  it("runs before what is sent, which is not lost", function()
    f.rfsm_create({ "r" }, { "r" })
    clock.now = 1001.5
    assert.same({ "root.live.b", "done", "taken" }, f.rfsm_send({ "r" }, { "e_go" }))
    assert.equal('{"root":{"log":"."}}', data_of "r")
  end)

  it("runs each at its time, so that timers follow each other", function()
    f.rfsm_create({ "r" }, { "r" })
    f.rfsm_send_at({ "r" }, { "1000.25", "e_go", "ID", "1" })
    f.rfsm_send_at({ "r" }, { "1002", "e_again", "ID", "2" })
    written()
    clock.now = 1002.5
    assert.same({ "root.live.b", "done", "taken" }, f.rfsm_tick({ "r" }))
    assert.equal('{"root":{"log":".c"}}', data_of "r")
    assert.equal("1003.500000", f.rfsm_get({ "r" })[16])
    local lines = {}
    for by, from, to in table.concat(trace, "\n")
      :gmatch("event,6=(%S-),7=from,8=(%S-),9=to,10=(%S-),11=") do
      lines[#lines + 1] = by .. " " .. from .. " " .. to
    end
    assert.same({ "e_go root.live.a root.live.b", "(time) root.live.b root.live.c",
      "e_again root.live.c root.live.b" }, lines)
  end)

  it("is all timers of a time, then the events for that time", function()
    f.rfsm_create({ "s" }, { "s" })
    f.rfsm_send_at({ "s" }, { "1001", "e_go", "ID", "1" })
    clock.now = 1001.5
    assert.same({ "root.live.d", "done", "taken" }, f.rfsm_tick({ "s" }))
  end)

  it("is bounded: what is sent waits meanwhile, in order", function()
    f.rfsm_create({ "q" }, { "fast" })
    clock.now = 1009.9921875
    assert.same({ "root.a", "done", "kept" },
      f.rfsm_send({ "q" }, { "e_stop", "ID", "1" }))
    assert.same({ "root.a", "done", "known" },
      f.rfsm_send({ "q" }, { "e_stop", "ID", "1" }))
    assert.equal('{"root":{"n":200}}', data_of "q")
    local due = tonumber(f.rfsm_get({ "q" })[16])
    assert.is_true(due > 1002 and due < 1002.1)
    for _ = 1, 4 do f.rfsm_tick({ "q" }) end
    assert.same({ "root.b", "done", "known" },
      f.rfsm_send({ "q" }, { "e_stop", "ID", "1" }))
    assert.equal('{"root":{"n":999}}', data_of "q")
  end)

  it("is not skipped if 200 steps take a fifth of a second", function()
    f.rfsm_create({ "q" }, { "faster" })
    clock.now = 1009
    for i = 1, 2 do
      f.rfsm_tick({ "q" })
      assert.equal(('{"root":{"n":%d}}'):format(200 * i), data_of "q")
      local due = tonumber(f.rfsm_get({ "q" })[16])
      assert.is_true(due > 1000 + 0.2 * i and due < 1000.01 + 0.2 * i)
    end
  end)

  it("is skipped if it is faster than the server", function()
    f.rfsm_create({ "q" }, { "endless" })
    clock.now = 1010
    assert.same({ "root.a", "done", "kept" }, f.rfsm_send({ "q" }, { "e_stop" }))
    clock.now = 1010.001
    f.rfsm_tick({ "q" }) -- the timers of the time for which it waits
    assert.same({ "root.b", "done", "taken" }, f.rfsm_tick({ "q" }))
  end)
end)

describe("an event with data", function()
  -- a --e_paid with an amount above 10--> b; others go to a doo that waits for e_note
  local function paid()
    return state { keep = { "amount", "note" },
      a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { rfsm.named "e_paid" },
        guard = function(_, events) return events[1].amount > 10 end,
        effect = function(fsm, _, _, events)
          fsm.amount, fsm.note = events[1].amount, events[1].note
          fsm.emit("paid", events[1])
        end },
      trans { src = "b", tgt = "a", events = { "e_back" } } }
  end

  before_each(function()
    load_library({ { name = "p", make = paid } },
      { history = 5 })
    f.rfsm_create({ "p" }, { "p" })
    written()
  end)

  local function send(...) return f.rfsm_send({ "p" }, { ... }) end

  it("reaches guards and effects, history and stream", function()
    assert.same({ "root.a", "done", "dropped" }, send '{"name":"e_paid","amount":7}')
    local text = '{"name":"e_paid","amount":9007199254740991,'
      .. '"note":{"a":[1,null],"b":{}}}'
    assert.same({ "root.b", "done", "taken" }, send(text))
    assert.equal('{"root":{"amount":9007199254740991,"note":{"a":[1],"b":{}}}}',
      f.rfsm_get({ "p" })[12])
    local lines = table.concat(trace, "\n")
    assert.is_truthy(lines:find("event,6=" .. text .. ",7=", 1, true))
    assert.is_truthy(lines:find('event,6={"name":"e_paid","amount":7},7=', 1, true))
    assert.is_truthy(lines:find('8={"amount":9007199254740991,"name":"e_paid",'
      .. '"note":{"a":[1],"b":{}}}', 1, true))
  end)

  it("is in the history with an error where it moved nothing", function()
    assert.equal("dropped", send('{"name":"e_paid"}')[4])
    assert.matches('event,6={"name":"e_paid"} (error),7=from,8=root.a,9=to,10=root.a',
      table.concat(trace, "\n"), 1, true)
  end)

  it("may come later", function()
    f.rfsm_send_at({ "p" }, { "+5", '{"name":"e_paid","amount":12}', "ID", "x" })
    clock.now = 1005
    assert.same({ "root.b", "done", "taken" }, f.rfsm_tick({ "p" }))
    assert.equal('{"root":{"amount":12}}', f.rfsm_get({ "p" })[12])
  end)

  it("shows why it would do nothing", function()
    assert.matches("its guard returns false",
      f.rfsm_why({ "p" }, { '{"name":"e_paid","amount":1}' })[2])
  end)

  for text, problem in pairs {
    ['{"name":"e_payd"}'] = "no transition of chart 'p' has the event 'e_payd' "
      .. "(did you mean '{\"name\":\"e_paid\"}'?)",
    ["e_paid"] = "no transition of chart 'p' has the event 'e_paid' "
      .. "(did you mean '{\"name\":\"e_paid\"}'?)",
    ['{"name":"e_back"}'] = "chart 'p' takes the event 'e_back' without data "
      .. "(with data it needs rfsm.named)",
    ['{"name":5}'] = "event 1: an object with a text 'name' expected",
    ["{name}"] = "event 1: a JSON object expected, got 'name' in it",
    ['{"name":"e_paid","id":9007199254740993}'] = "event 1: the number "
      .. "9007199254740993: whole numbers below 2^53 expected",
    ['{"name":"e_paid","id":1e999}'] = "event 1: the number 1e999: whole numbers below "
      .. "2^53 expected",
    ['{"name":"e_paid","x":"' .. ("x"):rep(8170) .. '"}'] = "event 1: at most 8192 "
      .. "bytes expected, got 8194",
    ['{"name":"e_paid","x":' .. ("["):rep(14) .. ("]"):rep(14) .. "}"] = "event 1.x: "
      .. "at most 9 tables inside each other expected",
  } do
    it("is refused: " .. text:sub(1, 40), function()
      assert.equal("ERR rfsm_send: " .. problem, send(text).err)
      assert.equal("", written())
    end)
  end
end)

it("notes a deferred event that another one has brought back, and who sends", function()
  require "rfsm.defer"
  load_library({ { name = "d", make = function()
    return state { a = state { defer = { "e_x" } }, b = state {}, c = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b" } },
      trans { src = "b", tgt = "c", events = { "e_x" } } }
  end } }, { history = 5 })
  f.rfsm_create({ "d" }, { "d" })
  for i = #trace, 1, -1 do trace[i] = nil end
  f.rfsm_send({ "d" }, { "e_x", "BY", "ann", "ID", "1" })
  assert.same({ "root.c", "done", "taken" }, f.rfsm_send({ "d" }, { "e_b" }))
  local lines = {}
  for by in table.concat(trace, "\n"):gmatch("event,6=(.-),7=from") do
    lines[#lines + 1] = by
  end
  assert.same({ "e_x by ann", "e_b (recalled: e_x)" }, lines)
end)

it("notes what a timer has moved in a region, not one that moved nothing", function()
  require "rfsm_seqand"
  load_library({ { name = "r", make = function()
    return state {
      work = rfsm.seqand {
        pump = state { waiting = state {}, pumping = state {}, filled = state {},
          trans { src = "initial", tgt = "waiting" },
          trans { src = "waiting", tgt = "pumping", events = { "e_after(1)" } },
          trans { src = "pumping", tgt = "filled", events = { "e_after(1)" } } },
        watch = state { looks = state {},
          trans { src = "initial", tgt = "looks" },
          trans { src = "looks", tgt = "internal", events = { "e_every(0.5)" } } } },
      trans { src = "initial", tgt = "work" } }
  end } }, { history = 5 })
  f.rfsm_create({ "r" }, { "r" })
  for i = #trace, 1, -1 do trace[i] = nil end
  clock.now = 1002.75
  assert.same({ "root.work", "active", "taken" }, f.rfsm_tick({ "r" }, {}))
  local moves = {}
  for move in table.concat(trace, "\n"):gmatch("event,6=(.-),11=") do
    moves[#moves + 1] = move
  end
  local move = "(time),7=from,8=root.work,9=to,10=root.work"
  assert.same({ move, move }, moves)
end)

it("does what one machine does whose host is punctual", function()
  assert.is_nil(share.problem(require "spec.support.claims.fleet", 60))
end)

describe("the last field of a reply", function()
  it("is what became of the events", function()
    assert.equal("kept", call("send", "e_x")[3], "an await has it")
    assert.equal("dropped", call("send", "e_x")[3], "has it already")
    assert.equal("dropped", call("send", "e_a")[3])
    assert.equal("taken", call("send", "e_y")[3])
    assert.equal("kept", call("send_at", "+1", "e_a", "ID", "x")[3])
  end)

  it("is not deceived by timers that run on", function()
    clock.now = 1002.296875
    assert.equal("dropped", call("send", "e_a")[3])
    clock.now = 1004.90625
    assert.equal("dropped", call("send", "e_a")[3])
  end)

  it("is dropped if the same call may come again", function()
    assert.equal("dropped", call("send", "e_a", "ID", "early")[3])
    call("send", "e_b")
    assert.same({ "root.a", "done", "taken" }, call("send", "e_a", "ID", "early"))
    assert.same({ "root.a", "done", "known" }, call("send", "e_a", "ID", "early"))
  end)
end)

describe("an event that a machine keeps", function()
  it("is told in the log if no transition of the new version takes it, once", function()
    local function worker(name)
      return function()
        require "rfsm.defer"
        return state { rename = {}, busy = state { defer = { rfsm.named(name) } },
          idle = state {}, trans { src = "initial", tgt = "busy" },
          trans { src = "busy", tgt = "idle", events = { "e_free" } },
          trans { src = "idle", tgt = "busy", events = { rfsm.named(name) } } }
      end
    end
    local old, new = { name = "w", make = worker "e_job" },
      { name = "w", make = worker "e_task" }
    load_library { old }
    f.rfsm_create({ "w" }, { "w" })
    assert.same({ "root.busy", "done", "kept" },
      f.rfsm_send({ "w" }, { '{"name":"e_job","k":7}' }))
    load_library { old, new }
    assert.same({ "root.busy", "done", "rfsm.snapshot: the event 'e_job' waits, but no "
      .. "transition of the chart takes it", "kept" },
      f.rfsm_send({ "w" }, { '{"name":"e_task","k":8}' }))
    assert.same({ "root.busy", "done", "taken" }, f.rfsm_send({ "w" }, { "e_free" }))
  end)
end)

describe("JSON that only some decoders take", function()
  for _, odd in ipairs { "NaN", "nan", "-Infinity", "0x10", "01", "+1", "1.",
    "\\u0000" } do
    it("is refused: " .. odd, function()
      open()
      load_library { { name = "c", make = chart } }
      local value = odd:find("u", 1, true) == 2 and '"' .. odd .. '"' or odd
      assert.equal("ERR rfsm_create: data: a JSON object expected, got '" .. odd
        .. "' in it", f.rfsm_create({ "k" }, { "c", '{"n":' .. value .. "}" }).err)
    end)
  end

  it("is not what a text contains", function()
    load_library { { name = "c", make = function()
      local model = chart()
      model.n = nil
      return model
    end } }
    for _, text in ipairs { "NaN", "0x10", '\\"NaN', "\\\\u0000", "-1.5e+10",
      "9007199254740992", '",9007199254740991,1.5e300,"' } do
      f.rfsm_remove({ "k" })
      local reply = f.rfsm_create({ "k" .. #text }, { "c", '{"n":["' .. text
        .. '",-1.5e+10,true,null,0]}' })
      assert.equal("root.a", reply[1])
    end
  end)
end)

describe("what waits in a machine", function()
  -- Returns what rfsm_get says, by name.
  local function view()
    local list, found = call("get"), {}
    for i = 1, #list, 2 do found[list[i]] = list[i + 1] end
    return found
  end

  it("is shown: events for later, those of a held machine, and ids", function()
    call("send", "e_b", "ID", "one")
    call("send_at", "+9", "e_a", "ID", "two")
    clock.now = 1003
    call("hold", "looked at")
    clock.now = 1004
    call("send", "e_a", "e_b", "ID", "three")
    local found = view()
    assert.same({ '[{"events":["e_a"],"id":"two","time":1009}]',
      '[{"events":["e_a","e_b"],"id":"three","time":1004}]', '["one"]', "[]", "yes",
      "1003.000000", "looked at", "1004.000000" },
      { found.later, found.waiting, found.ids,
      found.kept, found.held, found.held_since, found.held_because, found.due })
    call("release")
    found = view()
    assert.same({ "[]", '["one","three"]', "", "", "" }, { found.waiting, found.ids,
      found.held, found.held_since, found.held_because })
  end)

  it("is shown: events that it has deferred, also in regions", function()
    require "rfsm.defer"
    require "rfsm_seqand"
    local function region()
      return state { info = false, warn = false, x = state { defer = { "e_x" } },
        trans { src = "initial", tgt = "x" }, trans { src = "x", tgt = "x",
          events = { "e_go" } } }
    end
    load_library { { name = "c", make = function()
      return state { a = require("rfsm_seqand").seqand {
        defer = { rfsm.named "e_job" }, left = region() },
        b = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_b" } },
        trans { src = "b", tgt = "a", events = { rfsm.named "e_job", "e_x" } } }
    end } }
    host.packs.unpack("m") -- of the chart before
    f.rfsm_remove({ "m" })
    f.rfsm_create({ "m2" }, { "c" })
    f.rfsm_send({ "m2" }, { '{"name":"e_job","k":1}' })
    f.rfsm_send({ "m2" }, { "e_x" })
    local list = f.rfsm_get({ "m2" })
    for i = 1, #list, 2 do
      if list[i] == "kept" then
        assert.equal('[{"k":1,"name":"e_job"},"e_x"]', list[i + 1])
      end
    end
  end)

  it("is explained: a held machine moves only when it is released", function()
    call("hold")
    clock.now = 1012
    assert.same({ "held for 12 s: events wait until it is released; then:",
      "root.trans[2] (a -> b) would be taken on e_b in root.a" },
      { call("why", "e_b")[1], call("why", "e_b")[2] })
  end)
end)

describe("a machine that is moved to the newest version", function()
  it("is woken in time for a shorter timer there", function()
    local function waiting(seconds)
      return { name = "w", make = function()
        return state { rename = {}, keep = { "n" }, n = 0, a = state {}, b = state {},
          trans { src = "initial", tgt = "a" },
          trans { src = "a", tgt = "b", events = { ("e_after(%d)"):format(seconds) } } }
      end }
    end
    load_library { waiting(60) }
    f.rfsm_create({ "w" }, { "w" })
    clock.now = 1005
    load_library { waiting(60), waiting(8) }
    assert.same({ "root.a", "done", "(move) by ann" },
      f.rfsm_move({ "w" }, { "BY", "ann" }))
    assert.same({ "root.a", "done", "(move: it was the newest)" },
      f.rfsm_move({ "w" }))
    assert.equal(1008, math.floor(host.packs.unpack("w")[6] + 0.5))
    clock.now = 1009
    assert.same({ "root.b", "done", "taken" }, f.rfsm_tick({ "w" }, { "due" }))
  end)

  it("has its new name at once, also without a step", function()
    local function load_versions(...)
      local charts = {}
      for i, leaf in ipairs { ... } do
        charts[i] = { name = "n", make = function()
          return state { rename = { ["root.a"] = "root." .. leaf }, [leaf] = state {},
            trans { src = "initial", tgt = leaf },
            trans { src = leaf, tgt = leaf, events = { "e_x" } } }
        end }
      end
      load_library(charts, { history = 9 })
    end
    clock, trace = { now = 1000 }, {}
    host = host_of.new(trace, clock)
    load_versions "a"
    for _, key in ipairs { "held", "later" } do f.rfsm_create({ key }, { "n" }) end
    f.rfsm_hold({ "held" })
    load_versions("a", "z")
    written()
    assert.equal("root.z", f.rfsm_send({ "held" }, { "e_x" })[1])
    assert.equal("root.z",
      f.rfsm_send_at({ "later" }, { "+9", "e_x", "ID", "1" })[1])
    assert.equal(2, select(2, table.concat(trace, "\n"):gsub(
      "event,6=%(move%),7=from,8=root.a,9=to,10=root.z", "")))
  end)
end)

describe("machines that are due", function()
  -- Has Redis find these keys due, the first one first, until another time is added for
  -- them. `leases` has how often each was leased before.
  local function with_due(keys, leases)
    local outer, counts = host.redis.call, leases or {}
    local function forget(key)
      for i, due in ipairs(keys) do
        if due == key then table.remove(keys, i) end
      end
    end
    function host.redis.call(name, key, ...)
      local arguments = { ... }
      if name == "ZRANGEBYSCORE" then return { keys[1] } end
      if name == "ZCOUNT" then return #keys end
      if key == "rfsm:due:{m}" then forget(arguments[#arguments]) end
      local reply = outer(name, key, ...)
      if name ~= "ZINCRBY" then return reply end
      counts[arguments[2]] = (counts[arguments[2]] or 0) + arguments[1]
      return counts[arguments[2]]
    end
  end

  it("are leased in one call, and run by the next, at its time", function()
    f.rfsm_create({ "k" }, { "c" })
    clock.now = 1006
    with_due { "m", "k", "gone" }
    written()
    assert.same({ 0, 0, 3 }, call("wake"))
    assert.same({ "ZINCRBY {1=rfsm:lease:{m},2=1,3=m}",
      "ZADD {1=rfsm:due:{m},2=1016.000000,3=m}" }, trace)
    written()
    assert.same({ 1, 0, 2 }, call("wake"))
    assert.equal("ZREM XADD SET SPUBLISH ZREM ZREM ZINCRBY ZADD", written())
    assert.same({ 1, 0, 1 }, call("wake"))
    assert.same({ 1, 0, 0 }, call("wake"))
    assert.same({ 0, 0, 0 }, call("wake"))
  end)

  it("are not run if another call has done so meanwhile", function()
    clock.now = 1006
    with_due { "m" }
    call("wake")
    call("send", "e_x")
    call("send", "e_a")
    written()
    assert.same({ 1, 0, 0 }, call("wake"))
    assert.equal("ZADD SET ZREM ZREM", written())
  end)

  it("are held after three leases that came to no end, with the reason", function()
    clock.now = 1006
    with_due({ "m", "k" }, { m = 3 })
    written()
    assert.same({ 0, 1, 1 }, call("wake"))
    assert.matches("XADD {1={m}:log,2=MAXLEN,3=~,4=1000,5=*,6=error,7=3 calls that ran "
      .. "what is due have not ended: held until it is released}",
      table.concat(trace, "\n"), 1, true)
    assert.equal("ZINCRBY ZREM XADD SET ZREM ZINCRBY", written())
    assert.equal("kept", call("send", "e_b")[3])
    assert.same({ "root.b", "done", "(release)" }, call("release"))
  end)

  it("wait a minute if they cannot be run, with the reason in their log", function()
    with_due { "bad", "m" }
    local outer = host.redis.call
    function host.redis.call(name, key, ...)
      if name == "GET" and key == "bad" then error({ err = "ERR spoiled" }, 0) end
      return outer(name, key, ...)
    end
    assert.same({ 0, 0, 2 }, call("wake"))
    assert.same({ 0, 1, 1 }, call("wake"))
    assert.same({ 1, 0, 0 }, call("wake"))
    local lines = table.concat(trace, "\n")
    assert.matches("ZADD {1=rfsm:due:{m},2=1060.000000,3=bad}", lines, 1, true)
    assert.matches("ZINCRBY {1=rfsm:aside:{m},2=1,3=bad}", lines, 1, true)
    assert.matches("XADD {1={bad}:log,2=MAXLEN,3=~,4=1000,5=*,6=error,"
      .. "7=rfsm_wake: ERR spoiled}", lines, 1, true)
  end)

  it("wait from now on, whatever the time in their value", function()
    with_due { "m" }
    local value = host.packs.unpack("m")
    value[3].chart = "another"
    function host.packs.unpack() return encoding.copy_of(value) end
    clock.now = 1010
    call("wake")
    assert.same({ 0, 1, 0 }, call("wake"))
    assert.matches("ZADD {1=rfsm:due:{m},2=1070.000000,3=m}", table.concat(trace, "\n"),
      1, true)
  end)

  it("are left if another node of the cluster has them", function()
    with_due { "bad" }
    local outer = host.redis.call
    function host.redis.call(name, key, ...)
      if name == "GET" then error({ err = "ERR access to a non local key" }, 0) end
      return outer(name, key, ...)
    end
    call("wake")
    written()
    assert.same({ 0, 0, 0 }, call("wake"))
    assert.equal("", written())
  end)

  it("are none", function()
    with_due {}
    assert.same({ 0, 0, 0 }, call("wake"))
  end)
end)

describe("what an operator asks", function()
  -- Has Redis give these answers, by command; returns what was asked.
  local function answering(answers)
    local asked, outer = {}, host.redis.call
    function host.redis.call(name, ...)
      if answers[name] == nil then return outer(name, ...) end
      asked[#asked + 1] = name .. " " .. table.concat({ ... }, " ")
      local answer = answers[name]
      return type(answer) == "table" and answer.each and table.remove(answer.each, 1)
        or answer
    end
    return asked
  end

  it("is the index: the state itself, then those in it", function()
    open { index = true }
    local asked = answering { EXISTS = 1, ZRANGEBYLEX = { each = { { "c\troot.a\tk1" },
      { "c\troot.a.b\tk2", "c\troot.a.c\tk3" } } } }
    assert.same({ "k1", "k2", "k3" }, call("find", "c", "root.a"))
    assert.same({ "ZRANGEBYLEX rfsm:in:{m} [c\troot.a\t (c\troot.a\n LIMIT 0 100",
      "EXISTS k1", "ZRANGEBYLEX rfsm:in:{m} [c\troot.a. (c\troot.a/ LIMIT 0 99",
      "EXISTS k2", "EXISTS k3" }, asked)
    asked = answering { ZRANGEBYLEX = { each = { { "c\troot.a\tk1" }, {} } } }
    assert.same({ "k1" }, call("find", "c", "root.a", "1"))
    assert.matches("LIMIT 0 1$", asked[1])
    assert.equal("ERR rfsm_find: a chart and a state expected", call("find", "c"))
    assert.equal("ERR rfsm_find: a whole number from 1 to 100000 expected, got "
      .. "'100001'", call("find", "c", "root", "100001"))
    assert.is_table(call("find", "c", "root", "100000"))
  end)

  it("is the index without machines that are gone, as many as are asked for", function()
    open { index = true }
    local asked = answering { EXISTS = { each = { 1, 0, 0, 1 } }, ZRANGEBYLEX = { each =
      { { "c\troot.a\tk1", "c\troot.a\tk2" }, { "c\troot.a\tk3", "c\troot.a\tk4" },
        {} } } }
    assert.same({ "k1", "k4" }, call("find", "c", "root.a", "2"))
    assert.equal("ZRANGEBYLEX rfsm:in:{m} (c\troot.a\tk2 (c\troot.a\n LIMIT 0 2",
      asked[4])
  end)

  it("is the index as it is while a slot moves to another node", function()
    open { index = true }
    local outer = host.redis.call
    function host.redis.call(name, ...)
      if name == "EXISTS" then error({ err = "ERR access to a non local key" }, 0) end
      return name == "ZRANGEBYLEX" and { "c\troot.a\tk1" } or outer(name, ...)
    end
    assert.same({ "k1" }, call("find", "c", "root.a", "1"))
  end)

  it("is how many machines there are in each state", function()
    open { index = true }
    local asked = answering { EXISTS = 1, ZRANGEBYLEX = { each = { { "c\troot.a\tk1" },
      { "c\troot.b\tk2" }, {}, { "c\troot.a\tk1" }, { "c\troot.b\tk2",
        "c\troot.b\tk3" } } }, ZCARD = 4, XLEN = 5, ZCOUNT = 3,
      XRANGE = { { "990500-0", {} } }, ZRANGE = { "k1", "997.25" } }
    call("send", "e_a")
    for i = #asked, 1, -1 do asked[i] = nil end
    local reply = call("stats")
    local counters = table.concat(table.remove(reply), " ")
    assert.same({ { "c", "root.a", 1, "c", "root.b", 2 }, 4, 4, 5, 3, 5, "9.500",
      "2.750" }, reply)
    for _, name in ipairs { "dropped", "errors", "events" } do
      assert.matches("rfsm_" .. name .. "_total c %d+", counters)
    end
    assert.same({ "ZRANGEBYLEX rfsm:in:{m} [ + LIMIT 0 1",
      "ZRANGEBYLEX rfsm:in:{m} [c\troot.a\n + LIMIT 0 1",
      "ZRANGEBYLEX rfsm:in:{m} [c\troot.b\n + LIMIT 0 1",
      "ZRANGEBYLEX rfsm:in:{m} [c\troot.a\t (c\troot.a\n LIMIT 0 1000", "EXISTS k1",
      "ZRANGEBYLEX rfsm:in:{m} [c\troot.b\t (c\troot.b\n LIMIT 0 1000", "EXISTS k2",
      "EXISTS k3", "ZCARD rfsm:due:{m}", "ZCARD rfsm:aside:{m}", "XLEN rfsm:out:{m}",
      "ZCOUNT rfsm:due:{m} -inf 940.000000", "XLEN rfsm:dead:{m}",
      "XRANGE rfsm:out:{m} - + COUNT 1", "ZRANGE rfsm:due:{m} 0 0 WITHSCORES" }, asked)
    open()
    answering { ZCARD = 4, XLEN = 5, ZCOUNT = 3, XRANGE = {}, ZRANGE = {} }
    assert.same({ {}, 4, 4, 5, 3, 5, "0", "0.000" }, { unpack(call("stats"), 1, 8) })
  end)

  it("is the history, the newest first", function()
    open { history = 3 }
    local asked = answering { XREVRANGE = { { "1500-0", { "event", "e", "from", "f",
      "to", "t" } }, { "2-1", { "event", "", "from", "", "to", "x" } } } }
    assert.same({ "1.500", "e", "f", "t", "0.002", "", "", "x" }, call("history"))
    call("history", "10000")
    assert.same({ "XREVRANGE {m}:history + - COUNT 10",
      "XREVRANGE {m}:history + - COUNT 10000" }, asked)
    assert.equal("ERR rfsm_history: a whole number from 1 to 10000 expected, got "
      .. "'10001'", call("history", "10001"))
  end)

  it("is which machines are due", function()
    local asked = answering { ZRANGEBYSCORE = { "k" } }
    assert.same({ "k" }, call("due"))
    call("due", "7", "12.5")
    assert.same({ "ZRANGEBYSCORE rfsm:due:{m} -inf 1000.000000 LIMIT 0 100",
      "ZRANGEBYSCORE rfsm:due:{m} -inf 12.500000 LIMIT 0 7" }, asked)
  end)

  it("is the queue of a machine that is not idle", function()
    local function busy()
      return state { trans { src = "initial", tgt = "a" },
        a = state { doo = function(fsm)
          while true do
            rfsm.send_events(fsm, { name = "e_tick", n = 1 })
            rfsm.yield()
          end
        end } }
    end
    load_library { { name = "busy", make = busy } }
    f.rfsm_create({ "q" }, { "busy" })
    assert.equal('[{"n":1,"name":"e_tick"}]', f.rfsm_get({ "q" })[14])
  end)

  it("is why an event does nothing", function()
    assert.same("root.trans[2] (a -> b) would be taken on e_b in root.a",
      call("why", "e_b")[1])
    assert.equal("", written())
  end)
end)

describe("a machine that is held", function()
  it("rests until it is released, then does all in order", function()
    open { history = 9 }
    call("send_at", "+2", "e_b", "ID", "x")
    assert.same({ "root.a", "done", "(hold: new arm) by ann" },
      call("hold", "new arm", "BY", "ann"))
    assert.equal("ERR rfsm_hold: the machine at 'm' is held already", call("hold"))
    assert.same({ "due", "1002.000000", "held", "yes" },
      { unpack(call("get"), 15, 18) })
    clock.now = 1001
    assert.same({ "root.a", "done", "kept" }, call("send", "e_bad", "ID", "y"))
    clock.now = 1007
    assert.same({ "root.a", "done", "kept" }, call("tick"))
    assert.same({ "root.a", "done", "known" }, call("send", "e_bad", "ID", "y"))
    assert.same({ "root.a", "done", "kept" }, call("send", "e_a", "ID", "z"))
    assert.same({ "root.a", "done", "(release) by bob" }, call("release", "BY", "bob"))
    assert.equal('{"root":{"n":1}}', call("get")[12])
    local events = {}
    call("send", "e_x")
    for by in table.concat(trace, "\n"):gmatch("event,6=(.-),7=") do
      events[#events + 1] = by
    end
    assert.same({ "(hold: new arm) by ann", "e_bad (waits)", "e_a (waits)",
      "(release) by bob", "e_bad", "e_b", "e_a", "e_x" }, events)
    assert.equal("ERR rfsm_release: the machine at 'm' is not held", call("release"))
  end)

  it("has a reason and a name in one line, and cuts no character", function()
    open { history = 9 }
    for _, case in ipairs {
      { "", "", "(hold)" },
      { "no\narm", "ann\t", "(hold: no arm) by ann " },
      { ("x"):rep(99), ("\195\169"):rep(99), "(hold: " .. ("x"):rep(99) .. ") by "
        .. ("\195\169"):rep(40) },
      { "\195\169", "x" .. ("\195\169"):rep(99), "(hold: \195\169) by x"
        .. ("\195\169"):rep(39) },
    } do
      assert.same({ "root.a", "done", case[3] }, call("hold", case[1], "BY", case[2]))
      assert.equal((case[1]:gsub("\n", " ")), call("get")[22])
      call("release")
    end
  end)

  it("does all in the order of the calls, if the clock goes back", function()
    open { history = 9 }
    call("hold")
    call("send_at", "+4", "e_x", "ID", "later")
    for i, event in ipairs { "e_b", "e_a", "e_bad" } do
      clock.now = 1003 - i / 2
      assert.same({ "root.a", "done", "kept" }, call("send", event))
    end
    clock.now = 1001
    written()
    assert.same({ "root.a", "done", "(release)" }, call("release"))
    clock.now = 1004
    call("tick")
    local events = {}
    for by in table.concat(trace, "\n"):gmatch("event,6=(e%S-),7=") do
      events[#events + 1] = by
    end
    assert.same({ "e_b", "e_a", "e_bad", "e_x" }, events)
  end)

  -- a, whose timer is due, with a callback that is not to be called: in a server it
  -- might never end
  local function bad(more)
    return function()
      local model = { keep = { "n" }, n = 0, a = state {}, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_after(1)", "e_go" },
          effect = function(fsm) fsm.emit("called", fsm.n) end } }
      for name, value in pairs(more or {}) do model[name] = value end
      return state(model)
    end
  end

  local function library(...) load_library { ... } end

  it("has not run what was due, and does so when it is released", function()
    library { name = "bad", make = bad() }
    f.rfsm_create({ "w" }, { "bad" })
    clock.now = 1002
    written()
    assert.same({ "root.a", "done", "(hold)" }, f.rfsm_hold({ "w" }))
    assert.equal("ZREM SET", written())
    assert.same({ "root.a", "done", "kept" }, f.rfsm_send({ "w" }, { "e_go" }))
    assert.same({ "root.a", "done", "kept" }, f.rfsm_tick({ "w" }))
    assert.equal("root.a", f.rfsm_get({ "w" })[6])
    assert.not_matches("XADD", written())
    assert.same({ "root.b", "done", "(release)" }, f.rfsm_release({ "w" }))
    assert.equal("ZREM XADD XADD SET SPUBLISH", written())
  end)

  it("is forced elsewhere, or goes on in a new version of its chart", function()
    library { name = "bad", make = bad() }
    for _, key in ipairs { "w", "x" } do f.rfsm_create({ key }, { "bad" }) end
    clock.now = 1002
    for _, key in ipairs { "w", "x" } do f.rfsm_hold({ key }) end
    written()
    assert.same({ "root.b", "done", "(force) by ann" },
      f.rfsm_force({ "w" }, { "root.b", "BY", "ann" }))
    assert.equal("yes", f.rfsm_get({ "w" })[18])
    assert.same({ "root.b", "done", "(release)" }, f.rfsm_release({ "w" }))
    assert.equal("ZREM XADD SET SPUBLISH XADD SET", written())
    library({ name = "bad", make = bad() }, { name = "bad", make = bad { rename = {},
      [2] = trans { src = "a", tgt = "b", events = { "e_after(1.5)", "e_go" } } } })
    assert.same({ "root.b", "done", "(release)" }, f.rfsm_release({ "x" }))
    assert.equal("ZREM XADD SET SPUBLISH", written())
  end)

  it("needs no chart to be held, shown and removed", function()
    local calls = 0
    local function count() calls = calls + 1 error "not to be called" end
    library { name = "bad", make = bad { save = function() return 1 end,
      load = function() end } }
    f.rfsm_create({ "w" }, { "bad" })
    f.rfsm_send({ "w" }, { "e_go" })
    f.rfsm_create({ "x" }, { "bad" })
    library { name = "bad", make = bad { save = count, load = count, migrate = count,
      rename = {}, c = state {} } }
    assert.same({ "root.b", "done", "(hold)" }, f.rfsm_hold({ "w" }))
    library()
    assert.same({ "root.a", "done", "(hold)" }, f.rfsm_hold({ "x" }))
    assert.same({ "held", "yes" }, { unpack(f.rfsm_get({ "x" }), 17, 18) })
    assert.equal("ERR rfsm_release: no chart is named 'bad'",
      f.rfsm_release({ "x" }).err)
    assert.equal("yes", f.rfsm_get({ "x" })[18])
    assert.equal(0, calls)
  end)

  it("stays held if its release fails", function()
    library { name = "bad", make = bad() }
    f.rfsm_create({ "w" }, { "bad" })
    clock.now = 1002
    f.rfsm_hold({ "w" })
    host.redis.acl_check_cmd = function() return false end
    assert.matches("^ERR rfsm_release: no right to do ", f.rfsm_release({ "w" }).err)
    assert.equal("yes", f.rfsm_get({ "w" })[18])
  end)

  it("loses events for later that are taken back, though they are due", function()
    library { name = "bad", make = bad() }
    f.rfsm_create({ "w" }, { "bad" })
    f.rfsm_send_at({ "w" }, { "+0.5", "e_go", "ID", "x" })
    clock.now = 1000.75
    f.rfsm_hold({ "w" })
    assert.equal(1, f.rfsm_cancel({ "w" }, { "x" }))
    written()
    assert.same({ "root.a", "done", "(release)" }, f.rfsm_release({ "w" }))
    assert.equal("ZADD XADD SET", written())
    assert.equal("1001.000000", f.rfsm_get({ "w" })[16])
  end)

  it("goes on where it was, if it was not idle when it was held", function()
    library { name = "long", make = function()
      return state { keep = { "n" }, n = 0, a = state {}, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_stop" } },
        trans { src = "a", tgt = "internal", events = { "e_more" },
          effect = function(fsm)
            fsm.n = fsm.n + 1
            if fsm.n < 1500 then rfsm.send_events(fsm, "e_more") end
          end } }
    end }
    f.rfsm_create({ "w" }, { "long" })
    f.rfsm_send({ "w" }, { "e_more" })
    assert.same({ "root.a", "done", "(hold)" }, f.rfsm_hold({ "w" }))
    clock.now = 1001
    assert.same({ "root.a", "done", "kept" }, f.rfsm_send({ "w" }, { "e_stop" }))
    f.rfsm_tick({ "w" })
    assert.same({ "root.b", "done", "(release)" }, f.rfsm_release({ "w" }))
    assert.equal('{"root":{"n":1500}}', f.rfsm_get({ "w" })[12])
  end)

  it("keeps its timers until then", function()
    clock.now = 1001
    call("hold")
    clock.now = 1003
    assert.same({ "root.a", "done", "(release)" }, call("release"))
    assert.equal("1005.000000", call("get")[16])
  end)
end)

describe("a machine that is forced", function()
  it("is in the state, with its timers, and no callback has run", function()
    open { history = 9 }
    call("send", "e_b")
    assert.equal("", call("get")[16])
    clock.now = 1003
    written()
    assert.same({ "root.a", "done", "(force)" }, call("force", "root.a"))
    assert.equal("1008.000000", call("get")[16])
    assert.equal('{"root":{"n":1}}', call("get")[12])
    assert.matches("event,6=(force),7=from,8=root.b,9=to,10=root.a",
      table.concat(trace, "\n"), 1, true)
    call("force", "root.b")
    assert.equal("", call("get")[16])
  end)

  it("keeps what it has deferred, its histories, and what it sends later", function()
    require "rfsm.defer"
    require "rfsm.history"
    local job = rfsm.named "e_job"
    local function region()
      return state { keep = { "at" }, at = "", l = state { defer = { job } },
        m = state {}, trans { src = "initial", tgt = "l" },
        trans { src = "m", tgt = "internal", events = { job },
          effect = function(fsm, _, _, _, event) fsm.at = event.at end } }
    end
    load_library({ { name = "keeps", make = function()
      return state { info = false, warn = false, emem = true,
        a = state { defer = { job }, entry = function(fsm)
          timeevent.send_after(fsm, 5, "e_w")
        end },
        w = state { history = "deep", w1 = state {}, w2 = state {},
          trans { src = "initial", tgt = "w1" },
          trans { src = "w1", tgt = "w2", events = { "e_2" } } },
        par = rfsm.seqand { left = region(), right = region() },
        trans { src = "initial", tgt = "w" }, trans { src = "w", tgt = "a",
          events = { "e_a" } },
        trans { src = "a", tgt = "w", events = { "e_w" } },
        trans { src = "a", tgt = "par", events = { job } } }
    end } })
    f.rfsm_create({ "k" }, { "keeps" })
    f.rfsm_send({ "k" }, { "e_2" })
    f.rfsm_send({ "k" }, { "e_a" })
    f.rfsm_force({ "k" }, { "root.a" })
    assert.equal("root.w.w2", f.rfsm_send({ "k" }, { "e_w" })[1])
    f.rfsm_send({ "k" }, { "e_a" })
    f.rfsm_force({ "k" }, { "root.par.left.l" })
    f.rfsm_send({ "k" }, { '{"name":"e_job","at":1}' })
    f.rfsm_force({ "k" }, { "root.par.left.m" })
    assert.equal('[{"at":1,"name":"e_job"}]', f.rfsm_get({ "k" })[26]) -- of the right
    assert.matches('"root.par.left":{"at":1}', f.rfsm_get({ "k" })[12], 1, true)
    f.rfsm_force({ "k" }, { "root.a" })
    assert.equal("[]", f.rfsm_get({ "k" })[26])
    clock.now = 1006
    assert.equal("root.w.w2", f.rfsm_tick({ "k" })[1])
  end)

  it("needs the name of a leaf", function()
    assert.equal("ERR rfsm_force: chart 'c' has no leaf 'root.d' (did you mean "
      .. "'root.a'?)", call("force", "root.d"))
    assert.matches("has no leaf 'root.c'", call("force", "root.c"))
    assert.equal("", written())
    load_library({ { name = "deep", make = function()
      local function pair()
        return { a = state {}, b = state { final = true },
          trans { src = "initial", tgt = "a" } }
      end
      return state { trans { src = "initial", tgt = "c" }, c = state(pair()),
        trans { src = "s", tgt = "c", events = { "e_done" } },
        s = rfsm.seqand { left = state(pair()), right = state(pair()) } }
    end } }, { history = 9 })
    f.rfsm_create({ "d" }, { "deep" })
    assert.equal("ERR rfsm_force: chart 'deep' has no leaf 'root.c' (did you "
      .. "mean 'root.c.a'?)", f.rfsm_force({ "d" }, { "root.c" }).err)
    f.rfsm_force({ "d" }, { "root.s.left.b" })
    assert.matches("event,6=(force root.s.left.b),7=from,8=root.c.a,9=to,10=root.s",
      table.concat(trace, "\n"), 1, true)
    written()
    assert.equal("root.c.a",
      f.rfsm_force({ "d" }, { "root.s.right.b", "BY", "ann" })[1])
    assert.matches("event,6=(force root.s.right.b) by ann,7=from,8=root.s,9=to,"
      .. "10=root.c.a", table.concat(trace, "\n"), 1, true)
  end)
end)

describe("values of the version before", function()
  local codec = require "rfsm.server.codec"

  local function with_value(text)
    local unpack_value = host.packs.unpack
    function host.packs.unpack(key)
      host.packs.unpack = unpack_value
      unpack_value(key)
      return codec.decode(text)
    end
  end

  it("go on: timers, awaits, ids, events that come later", function()
    with_value('["rfsm","c",{"version":2,"chart":"6e3c8444031-2c59b6","done":true,'
      .. '"leaf":"root.a","data":{"root":["%t","n",0]},"ext":{"timers":'
      .. '{"e_after(5)@root.a":5},"await":{"await(e_x, e_y)@root.a":{"e_x":true}}}},'
      .. '1000,0,1002,["1","2"],[[1002,"9","e_y"],[1003,"8","e_a"]]]')
    clock.now = 1004
    assert.same({ "root.a", "done", "taken" }, call("tick"))
    assert.equal('{"root":{"n":1}}', call("get")[12])
    for _, id in ipairs { "1", "2", "9", "8" } do
      assert.equal("known", call("send", "e_b", "ID", id)[3])
    end
    assert.equal("1008.000000", call("get")[16])
  end)

  it("go on: without anything but a state", function()
    with_value('["rfsm","c",{"version":2,"chart":"6e3c8444031-2c59b6","done":true,'
      .. '"leaf":"root.b","data":{"root":["%t","n",1]}}]')
    assert.same({ "root.a", "done", "taken" }, call("send", "e_a"))
  end)

  it("go on: a machine that is held without a time", function()
    local function held()
      with_value('["rfsm","c",{"version":2,"chart":"6e3c8444031-2c59b6","done":true,'
        .. '"leaf":"root.b","data":{"root":["%t","n",1]}},false,false,false,false,'
        .. '[[999,"","e_a"]],true]')
    end
    held()
    assert.equal("yes", call("get")[18])
    held()
    assert.same({ "root.b", "done", "kept" }, call("send", "e_b"))
    assert.same({ "root.b", "done", "(release)" }, call("release"))
    assert.equal('{"root":{"n":2}}', call("get")[12]) -- b, a, b
  end)
end)

describe("a callback that changes what the machines of a chart share", function()
  -- a --e_1--> b --e_1--> p { x --e_1--> y } --e_2--> a; in a e_bad calls `bad` as an
  -- effect, and e_ask as a guard that forbids
  local function model(bad)
    return function()
      local function note(text)
        return function(fsm) fsm.emit(text, { fsm.more ~= nil, fsm[8] ~= nil }) end
      end
      return state { a = state { exit = note "a" }, b = state { entry = note "b" },
        c = state {},
        p = rfsm.seqand { idle_doo = "auto", left = state { x = state {},
          y = state { entry = note "y" }, trans { src = "initial", tgt = "x" },
          trans { src = "x", tgt = "y", events = { "e_1" } } } },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_1" } },
        trans { src = "b", tgt = "p", events = { "e_1" } },
        trans { src = "p", tgt = "a", events = { "e_2" } },
        trans { src = "a", tgt = "a", events = { "e_bad" }, effect = bad },
        trans { src = "a", tgt = "c", events = { "e_ask" }, guard = function(tr)
          bad(tr._fsm, tr)
          return false
        end },
        trans { src = "c", tgt = "a", events = { "e_2" } } }
    end
  end

  local function library(bad)
    clock, trace = { now = 1000 }, {}
    host = host_of.new(trace, clock)
    load_library { { name = "v", make = model(bad) } }
    for _, key in ipairs { "w", "x" } do f.rfsm_create({ key }, { "v" }) end
    written()
  end

  -- What x does, and what is written meanwhile, as one text.
  local function run_other()
    written()
    local replies = {}
    for _, event in ipairs { "e_1", "e_2", "e_1", "e_1", "e_2", "e_1" } do
      local reply = f.rfsm_send({ "x" }, { event })
      replies[#replies + 1] = reply.err or table.concat(reply, " ", 1, 2)
    end
    return table.concat(replies, "\n") .. "\n" .. table.concat(trace, "\n")
  end

  -- Does x what it does if no callback changes anything?
  local function check_others()
    local got = run_other()
    library(function() end)
    assert.equal(run_other(), got)
  end

  local function merge(fsm, ...) return rfsm.fsm_merge(fsm, fsm, ...) end

  local function clear(_, events) events[1] = nil end

  for _, case in ipairs {
    { "merges a state", "fsm_merge", function(fsm)
      return merge(fsm, state {}, "more")
    end },
    { "merges a connector", "fsm_merge", function(fsm)
      return merge(fsm, rfsm.conn {}, "more")
    end },
    { "merges a transition with a timer", "fsm_merge", function(fsm)
      return merge(fsm,
        trans { src = "a", tgt = "c", events = { "e_1", "e_after(1)" } })
    end },
    { "merges into a region", "fsm_merge", function(fsm)
      return merge(rfsm.regions(fsm.p)[1], state {}, "more")
    end },
    { "adds a step hook", "pre_step_hook_add", function(fsm)
      return rfsm.pre_step_hook_add(fsm, clear, "before")
    end },
    { "adds a step hook to a region", "post_step_hook_add", function(fsm)
      return rfsm.post_step_hook_add(rfsm.regions(fsm.p)[1], clear)
    end },
    { "adds a hook to a state", "exit_hook_add", function(fsm)
      return rfsm.exit_hook_add(fsm, fsm.a, function() fsm.emit "hook" end)
    end },
    { "removes a hook", "post_step_hook_rm", function(fsm)
      return rfsm.post_step_hook_rm(fsm, fsm._post_hooks[1])
    end },
  } do
    local what, name, bad = unpack(case)
    it(what .. " is refused by name, and nothing is changed", function()
      local answers, reason = {}, "rfsm." .. name .. ": the machines of a fleet share "
        .. "their chart, so a callback cannot change it"
      library(function(fsm) answers[#answers + 1] = { bad(fsm) } end)
      assert.same({ "root.a", "done", reason, "taken" },
        f.rfsm_send({ "w" }, { "e_bad" }))
      assert.same({ "root.a", "done", reason, "dropped" },
        f.rfsm_send({ "w" }, { "e_ask" }))
      f.rfsm_why({ "w" }, { "e_ask" })
      for _, answer in ipairs(answers) do assert.same({ false, reason }, answer) end
      assert.is_true(#answers >= 3)
      assert.equal("root.b", f.rfsm_send({ "w" }, { "e_1" })[1])
      check_others()
    end)
  end

  it("writes elements into the tree is not seen by other machines", function()
    library(function(fsm)
      fsm.more, fsm[8] = state {}, trans { src = "a", tgt = "c", events = { "e_1" } }
      fsm.a.more = rfsm.conn {}
    end)
    f.rfsm_send({ "w" }, { "e_bad" })
    check_others()
  end)

  for text, target in pairs {
    ["string 'c'"] = "c", ["state"] = state {}, ["nil"] = false,
  } do
    it("sets a target that is no node of the machine fails: " .. text, function()
      library(function(fsm) fsm[2].tgt = target or nil end)
      local reply = f.rfsm_send({ "w" }, { "e_bad" })
      assert.matches("^ERR rfsm_send: .*rfsm.snapshot.take: .*root.trans%[2%] "
        .. "%(a %-> b%): tgt: state or connector of the machine expected, got "
        .. text .. "$", reply.err)
      assert.equal("root.b", f.rfsm_send({ "w" }, { "e_1" })[1])
      check_others()
    end)
  end

  it("sends events later for the first time is no such callback", function()
    library(function(fsm) timeevent.send_after(fsm, 5, "e_1") end)
    f.rfsm_send({ "w" }, { "e_bad" })
    clock.now = 1006
    assert.same({ "root.b", "done", "taken" }, f.rfsm_tick({ "w" }))
  end)

  it("merges into a machine that it has made itself is no such callback", function()
    local answer
    library(function()
      local own = rfsm.init(state { a = state {}, trans { src = "initial", tgt = "a" },
        info = false, warn = false })
      answer = rfsm.fsm_merge(own, own, state {}, "b")
    end)
    assert.equal("taken", f.rfsm_send({ "w" }, { "e_bad" })[3])
    assert.is_true(answer)
    assert.error_matches(function() rfsm.fsm_merge(nil) end,
      "rfsm.fsm_merge: initialised fsm expected, got nil")
  end)
end)

describe("versions of a chart", function()
  local function version(by, more)
    return function()
      return state { keep = { "n" }, n = 0, a = state {}, b = more,
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "a", events = { "e" },
          effect = function(fsm) fsm.n = fsm.n + by end } }
    end
  end

  local function library(...)
    local list = {}
    for i, make in ipairs { ... } do list[i] = { name = "v", make = make } end
    load_library(list)
  end

  it("take the machines that they can take, the newest first", function()
    local function n_after(event)
      f.rfsm_send({ "w" }, { event })
      return tonumber(f.rfsm_get({ "w" })[12]:match('"n":(%d+)'))
    end
    library(version(1))
    f.rfsm_create({ "w" }, { "v" })
    assert.equal(1, n_after("e"))
    library(version(1), version(10))
    assert.equal(11, n_after("e"), "the same structure moves")
    library(version(100), version(1, state {}))
    assert.equal(111, n_after("e"), "another one does not")
    library(version(1, state {}))
    assert.matches("^ERR rfsm_send: the machine at 'w': rfsm.snapshot: the snapshot is "
      .. "of another chart: ", f.rfsm_send({ "w" }, { "e" }).err)
  end)

  it("have a target that a callback has changed in its machine alone", function()
    library(function()
      return state { a = state {}, b = state {}, c = state {},
        go = trans { src = "a", tgt = "b", events = { "e_go" } },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "a", events = { "e_turn" },
          effect = function(fsm) fsm.go.tgt = fsm.c end },
      }
    end)
    for _, key in ipairs { "w", "x" } do f.rfsm_create({ key }, { "v" }) end
    f.rfsm_send({ "w" }, { "e_turn" })
    f.rfsm_why({ "w" }, { "e_go" }) -- puts the machine, and does not save it
    assert.equal("root.b", f.rfsm_send({ "x" }, { "e_go" })[1])
    assert.equal("root.c", f.rfsm_send({ "w" }, { "e_go" })[1])
  end)

  -- open --e_pay--> paid, with the reminder `timer` in open or around it, and what
  -- `more` adds; `log` notes what is taken, in order
  local function order(timer, more)
    return function()
      local function note(text) return function(fsm) fsm.log = fsm.log .. text end end
      local model = state { keep = { "log" }, log = "", rename = {},
        live = state { open = state {}, paid = state {},
          trans { src = "initial", tgt = "open" },
          trans { src = "open", tgt = "paid", events = { "e_pay" },
            effect = note "pay " } },
        trans { src = "initial", tgt = "live" } }
      local reminder = trans { src = "open", tgt = "internal", events = { timer },
        effect = note "remind " }
      if timer then table.insert(model.live, 1, reminder) end
      if more then more(model, note) end
      return model
    end
  end

  local function with_region(seconds)
    return order(nil, function(model, note)
      model.live = rfsm.seqand { idle_doo = "auto", bell = state {
        open = state {}, paid = state {}, trans { src = "initial", tgt = "open" },
        trans { src = "open", tgt = "internal",
          events = { "e_after(" .. seconds .. ")" },
          effect = function(fsm) note "remind "(fsm._owner) end },
        trans { src = "open", tgt = "paid", events = { "e_pay" },
          effect = function(fsm) note "pay "(fsm._owner) end } } }
    end)
  end

  local function around(seconds)
    return order(nil, function(model, note)
      table.insert(model, 1, trans { src = "live", tgt = "internal",
        events = { "e_after(" .. seconds .. ")" }, effect = note "remind " })
    end)
  end

  describe("whose timers differ: what is due in the new one runs first", function()
    local CASES = {
      { "a shorter timer", order "e_after(60)", order "e_after(0.25)", true },
      { "a longer timer", order "e_after(0.25)", order "e_after(60)", false },
      { "a new timer", order "e_after(60)", order("e_after(60)", function(model, note)
        table.insert(model.live, 1, trans { src = "open", tgt = "internal",
          events = { "e_after(0.25)" }, effect = note "remind " })
      end), true },
      { "no timer", order "e_after(0.25)", order(), false },
      { "a shorter timer around", around(60), around(0.25), true },
      { "a time that is over, in place of a timer", order "e_after(60)",
        order "e_at(1000.25)", true },
      { "a time that is over, in a machine that nothing woke", order(),
        order "e_at(999)", true },
      { "a shorter timer in a region", with_region(60), with_region(0.25), true },
      { "a longer timer in a region", with_region(0.25), with_region(60), false },
    }

    for _, case in ipairs(CASES) do
      local name, old, new, is_due = unpack(case)
      it("with " .. name, function()
        library(old)
        f.rfsm_create({ "w" }, { "v" })
        library(old, new)
        clock.now = 1000.5
        local reply = f.rfsm_send({ "w" }, { "e_pay", "ID", "p" })
        assert.equal("taken", reply[#reply])
        local log = (is_due and "remind " or "") .. "pay "
        assert.equal('{"root":{"log":"' .. log .. '"}}', f.rfsm_get({ "w" })[12])
      end)
    end

    it("also when waiting events are taken back, or a worker wakes it", function()
      for _, verb in ipairs { "cancel", "tick" } do
        library(order "e_after(60)")
        f.rfsm_create({ verb }, { "v" })
        f.rfsm_send_at({ verb }, { "+50", "e_pay", "ID", "p" })
        library(order "e_after(60)", order("e_after(0.25)", function(model, note)
          table.insert(model.live, 1, trans { src = "open", tgt = "internal",
            events = { "e_after(0.375)" }, effect = note "again " })
        end))
        clock.now = clock.now + 0.5
        f["rfsm_" .. verb]({ verb }, { "p" })
        assert.equal('{"root":{"log":"remind again "}}', f.rfsm_get({ verb })[12])
      end
    end)
  end)

  it("are found by the charts of regions, too, if the newest is refused", function()
    local function no_rename(make)
      return function()
        local model = make()
        model.rename = nil
        return model
      end
    end
    local old, new = no_rename(with_region(60)), no_rename(with_region(0.25))
    library(old)
    f.rfsm_create({ "w" }, { "v" })
    library(old, new)
    clock.now = 1000.5
    assert.same({ "root.live", "active", "taken" }, f.rfsm_send({ "w" }, { "e_pay" }))
    assert.equal('{"root":{"log":"pay "}}', f.rfsm_get({ "w" })[12])
  end)

  it("give back whatever a callback changes, in any element", function()
    local function show(fsm)
      fsm.emit("fields", { fsm.a.limit or "nil", fsm.a.list and #fsm.a.list or "nil",
        fsm.b.more or "nil", fsm[2].weight, #fsm[2].events, fsm.a.hit or "nil" })
    end
    library(function()
      return state { b = state {}, a = state { limit = 5, list = { 1, 2 } },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "a", weight = 1, events = { "e_turn" },
          effect = function(fsm, tr)
            tr.weight, fsm.b.more, fsm.a.list[3] = tr.weight + 1, 7, 3
            tr.events[2], fsm.a.hit = "e_more", true
            show(fsm)
            fsm.a.limit, fsm.a.list = nil, nil
            show(fsm)
            fsm.a.limit, fsm.a.list = nil, { 9 }
            show(fsm)
            tr.effect, tr.tgt, fsm.a.entry = print, fsm.b, print
          end },
      }
    end)
    for _, key in ipairs { "w", "x" } do
      f.rfsm_create({ key }, { "v" })
      f.rfsm_send({ key }, { "e_turn" })
      assert.matches('%[5,3,7,2,2,true%].*%["nil","nil",7,2,2,true%].*'
        .. '%["nil",1,7,2,2,true%]', table.concat(trace, " "))
      for i = #trace, 1, -1 do trace[i] = nil end
    end
  end)

  -- A chart whose callbacks change fields that are not kept, in any element; `random`
  -- decides which, and with what. Each entry tells what it sees.
  local function changing(random)
    local model = { keep = { "n" }, n = 0, cfg = { k = 1 }, limit = 1,
      trans { src = "initial", tgt = "s1" } }
    local set = {
      function(obj, key) obj[key] = nil end,
      function(obj, key) obj[key] = random(9) end,
      function(obj, key) obj[key] = { random(9) } end,
      function(obj) if type(obj.list) == "table" then obj.list[2] = random(9) end end,
      function(_, _, fsm, name) fsm[5].tgt = fsm[name] end,
    }
    local function change(fsm)
      local name = "s" .. random(4)
      local obj = random:pick { fsm, fsm[name], fsm[random(9) + 1], fsm[name].x or fsm }
      local key = random:pick { "limit", "list", "weight", "fresh" }
      random:pick(set)(obj, key, fsm, name)
      fsm.n = fsm.n + 1
    end
    local function show(fsm, self)
      change(fsm)
      fsm.emit("seen", { fsm.limit or false, fsm.cfg.k, self.limit or false,
        type(self.list) == "table" and self.list[2] or false, fsm.s2.fresh or false,
        fsm[3].weight or false, fsm[5].tgt._fqn, self.events and 1 or 0 })
    end
    for i = 1, 2 do
      model["s" .. i] = state { limit = i, list = { 1, 2 }, entry = show }
      model["s" .. i + 2] = state { limit = i, list = { 1, 2 }, entry = show,
        history = "deep", x = state { list = {} }, y = state {},
        trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_3" } } }
    end
    for i = 2, 10 do
      model[i] = trans { src = "s" .. i % 4 + 1, tgt = "s" .. (i * 3) % 4 + 1,
        weight = i, events = { "e_" .. i % 3 + 1, i % 4 == 0 and "e_after(5)" or nil },
        effect = i % 2 == 0 and change or nil }
    end
    return state(model)
  end

  -- Returns all that random calls reply and write.
  local function story_of(seed, compares)
    local random, lines = new_random(seed), {}
    charts_of.compares = compares
    clock, trace = { now = 1000 }, {}
    host = host_of.new(trace, clock)
    load_library({ { name = "v", make = function() return changing(random) end } },
      { history = true, index = true })
    for i = 1, 3 do f.rfsm_create({ "m" .. i }, { "v" }) end
    for _ = 1, 60 do
      clock.now = clock.now + random(4)
      local key, event = "m" .. random(3), "e_" .. random(3)
      local name = random:pick { "send", "send", "send", "tick", "get", "force" }
      local reply = f["rfsm_" .. name]({ key }, { name == "force" and "root.s1"
        or name == "send" and event or nil })
      lines[#lines + 1] = host_of.sorted(reply)
    end
    charts_of.compares = rawget(_G, "jit") ~= nil
    return table.concat(lines, "\n") .. table.concat(trace, "\n")
  end

  it("write the same whether changes are noted or all fields compared", function()
    require "rfsm.history"
    if rawget(_G, "jit") then return end -- there only the second way works
    for seed = share.seed(20), share.seed(20) + share.count(20) - 1 do
      assert.equal(story_of(seed, true), story_of(seed, false), "seed " .. seed)
    end
  end)

  it("cost what is active, however large the chart is", function()
    if rawget(_G, "jit") then return end -- there all fields are compared
    require "rfsm.history"
    local function instructions(count)
      local key = "n" .. count
      library(function()
        local model = { keep = { "n" }, n = 0, trans { src = "initial", tgt = "s1" } }
        for i = 1, count do
          model["s" .. i] = state { history = i > 3 and "deep" or nil,
            entry = function(fsm) fsm.n = fsm.n + 1 end,
            x = i > 3 and state {} or nil,
            i > 3 and trans { src = "initial", tgt = "x" } or nil }
          model[i + 1] = trans { src = "s" .. i, tgt = "s" .. i % 3 + 1,
            events = { "e_next", "e_after(60)" }, effect = function() end }
        end
        return state(model)
      end)
      f.rfsm_create({ key }, { "v" })
      for _ = 1, 12 do f.rfsm_send({ key }, { "e_next" }) end
      local found = 0
      debug.sethook(function() found = found + 1 end, "", 1)
      for _ = 1, 12 do f.rfsm_send({ key }, { "e_next" }) end
      debug.sethook()
      return found
    end
    local few = instructions(10)
    assert.is_true(instructions(300) < 1.05 * few)
  end)

  it("that fail are reported with their name", function()
    library(function() error("no chart", 0) end)
    assert.equal("ERR rfsm_create: chart 'v': no chart",
      f.rfsm_create({ "w" }, { "v" }).err)
    library(function()
      return state { a = state {}, trans { src = "a", tgt = "x" } }
    end)
    assert.matches("^ERR rfsm_create: chart 'v': .*tgt 'x'",
      f.rfsm_create({ "w" }, { "v" }).err)
  end)
end)

describe("the desk", function()
  -- a --e_b, after 5 s--> b --e_a--> a
  local function plain()
    return state { keep = { "count" }, count = 0, a = state {}, b = state {
      entry = function(fsm) fsm.count = fsm.count + 1 end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b", "e_after(5)" } },
      trans { src = "b", tgt = "a", events = { "e_a" } } }
  end

  -- a --e_b--> b { left: x --e_y, after 3 s--> y, right: u --e_v--> v } --10 s--> a
  local function regions()
    return state { a = state {},
      b = rfsm.seqand {
        left = state { keep = { "list" }, x = state {}, y = state {},
          trans { src = "initial", tgt = "x" },
          trans { src = "x", tgt = "y", events = { "e_y", "e_after(3)" } } },
        right = state { u = state {}, v = state {},
          trans { src = "initial", tgt = "u" },
          trans { src = "u", tgt = "v", events = { "e_v" } } } },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_b" } },
      trans { src = "b", tgt = "a", events = { "e_after(10)" } } }
  end

  local function library(options)
    clock, trace = { now = 1000 }, {}
    host = host_of.new(trace, clock)
    load_library({ { name = "c", make = plain }, { name = "r", make = regions },
      { name = "any", make = any } }, options)
    f.rfsm_create({ "m" }, { "c" })
    written()
  end

  before_each(function() library() end)

  local function pull(key)
    local text = f.rfsm_pull({ key })
    return text, json.decode(text)
  end

  local function refusal(name, ...)
    local before = f.rfsm_pull({ "m" })
    written()
    local reply = f["rfsm_" .. name]({ "m" }, { ... })
    assert.equal("", written())
    assert.equal(before, f.rfsm_pull({ "m" }))
    return reply.err
  end

  it("pulls a machine, and puts it back as it was", function()
    call("send", "e_b")
    local text, file = pull "m"
    assert.same({ machine = "m", chart = "c", revision = file.fleet.revision },
      file.fleet)
    assert.equal(("%d"):format(file.fleet.revision), f.rfsm_get({ "m" })[24])
    assert.equal("root.b", file.leaf)
    assert.equal("(push)", call("push", text)[3])
    assert.same(file.data, select(2, pull "m").data)
    local name = helper.file_with(text)
    assert.equal("root.b", rfsm.get_actleaf_fqn(assert(snapshot.load(
      plain(), name))))
  end)

  it("pushes what a person has changed, to a machine that has not moved", function()
    local old, file = pull "m"
    file.sum, file.data.root.count = nil, 7
    local text = json.encode(file)
    call("send", "e_b")
    assert.matches("^ERR rfsm_push: the machine at 'm' has moved on, its revision is "
      .. "not %d+ any more: pull it again, or set one field$", refusal("push", old))
    local revision = ("%d"):format(select(2, pull "m").fleet.revision)
    assert.same({ "root.a", "done", "(push) by ann" },
      call("push", text, revision, "BY", "ann"))
    assert.equal(7, select(2, pull "m").data.root.count)
    call("send", "e_b")
    assert.equal(8, select(2, pull "m").data.root.count)
    f.rfsm_create({ "k" }, { "c" })
    assert.equal("ERR rfsm_push: the file has the machine at 'm' (to put it into 'k', "
      .. "give its revision)", f.rfsm_push({ "k" }, { text }).err)
    local own = ("%d"):format(select(2, pull "k").fleet.revision)
    assert.same({ "root.a", "done", "(push)" }, f.rfsm_push({ "k" }, { text, own }))
  end)

  it("has timers that go on, or begin when the simulator has saved the file", function()
    clock.now = 1002
    local text, file = pull "m"
    assert.same({ 1000, 0 }, file.fleet.time)
    clock.now = 1004
    call("push", text)
    assert.equal("1005.000000", call("get")[16])
    file.fleet.time, file.sum = nil, nil
    file.fleet.revision = select(2, pull "m").fleet.revision
    call("push", json.encode(file))
    assert.equal("1009.000000", call("get")[16])
    clock.now = 1009
    assert.same({ "root.b", "done", "taken" }, call("tick"))
  end)

  it("runs events that wait in a file when the machine is woken", function()
    local _, file = pull "m"
    file.sum, file.queue = nil, { "e_b" }
    assert.same({ "root.a", "done", "(push)" }, call("push", json.encode(file)))
    assert.same({ "root.b", "done", "taken" }, call("tick", "due"))
  end)

  it("refuses a file that is cut, damaged or of another chart", function()
    local text, file = pull "m"
    f.rfsm_create({ "r" }, { "any" })
    local other = f.rfsm_pull({ "r" })
    file.sum = nil
    local function changed(field, value)
      local copy = json.decode(json.encode(file))
      copy[field] = value
      return json.encode(copy)
    end
    for problem, wrong in pairs { -- any order: each stands alone
      ["file (is it cut short?): a JSON object expected"] = text:sub(1, 60),
      ["file: the check sum is wrong: the text has changed since it was written (a "
        .. "person who changes the file removes its field 'sum')"] =
        text:gsub('"count":0', '"count":1') .. "",
      ["file: a machine that was pulled expected"] = '{"version":2}',
      ["the file has a machine of chart 'any', the one at 'm' is of 'c'"] = other,
      ["file: rfsm.snapshot: leaf: no state is 'root.q'"] = changed("leaf", "root.q"),
      ["file: rfsm.snapshot: data: no state 'root' keeps a field 'q'"] =
        changed("data", { root = { q = 1 } }),
      ["file: rfsm.snapshot: no snapshot has a field 'sun'"] = changed("sun", "1"),
      ["file: rfsm.snapshot: chart: string expected, got number"] = changed("chart", 5),
      ["file: rfsm.snapshot: regions: table expected, got number"] =
        changed("regions", 5),
    } do
      assert.equal("ERR rfsm_push: " .. problem, refusal("push", wrong))
    end
    for _, time in pairs { 5, { "1", "2" }, { 1 } } do -- any order
      file.fleet.time = time
      assert.equal("ERR rfsm_push: file: a machine that was pulled expected",
        refusal("push", json.encode(file)))
    end
    assert.equal("ERR rfsm_push: no machine is at 'z' (rfsm_create makes one)",
      f.rfsm_push({ "z" }, { text }).err)
  end)

  it("sets fields that states keep, and says who did it", function()
    assert.same({ "root.a", "done", "(set root.count: 0 -> 7) by ann" },
      call("set", "count", "7", "BY", "ann"))
    assert.matches("XADD .*{m}:log.*=%(set root.count: 0 %-> 7%) by ann",
      table.concat(trace, "\n"))
    assert.equal(7, select(2, pull "m").data.root.count)
    for text, value in pairs { ['"x"'] = "x", ["[1,2]"] = { 1, 2 }, ["true"] = true,
      ["null"] = { "%z" } } do -- any order: each stands alone
      call("set", "root.count", text, "force", "BY", "ann")
      assert.same(value, select(2, pull "m").data.root.count)
    end
    call("set", "count", "1")
    call("set", "count") -- no value takes the field away
    assert.same({ "%z" }, select(2, pull "m").data.root.count)
    library { history = 10 }
    trace[1] = nil
    call("set", "count", '1', "BY", "ann")
    assert.matches("{m}:history.*,5=event,6=%(set root.count: 0 %-> 1%) by ann,7=from,",
      table.concat(trace, "\n"))
  end)

  it("refuses to set what is not kept, or no value", function()
    assert.equal("ERR rfsm_set: no state of chart 'c' keeps the field 'cont' (did you "
      .. "mean 'root.count'?)", refusal("set", "cont", "7"))
    assert.equal("ERR rfsm_set: value: JSON expected, got 'x' in it",
      refusal("set", "count", "x"))
    assert.equal("ERR rfsm_set: value: one value expected",
      refusal("set", "count", '1,"other":2'))
  end)

  it("refuses a value of another kind than the field has", function()
    local function of_kind(kind, got)
      return ("ERR rfsm_set: field 'root.count': %s expected, got %s (--force "
        .. "sets it nevertheless)"):format(kind, got)
    end
    assert.equal(of_kind("a number", 'the text "80"'), refusal("set", "count", '"80"'))
    assert.equal(of_kind("a number", "true"), refusal("set", "count", "true", "BY",
      "ann"))
    assert.equal(of_kind("a number", "a table"), refusal("set", "count", "[1]"))
    assert.same({ "root.a", "done", '(set root.count: 0 -> "abc", forced) by ann' },
      call("set", "count", '"abc"', "force", "BY", "ann"))
    call("set", "count", '"abd"') -- as it is now
    call("set", "count", "4")     -- as it is at first
    assert.equal(4, select(2, pull "m").data.root.count)
  end)

  it("forces and sets in regions", function()
    f.rfsm_create({ "r" }, { "r" })
    assert.equal("root.b", f.rfsm_force({ "r" }, { "root.b.left.y" })[1])
    local _, file = pull "r"
    assert.same({ "root.y", "root.u" }, { file.regions["root.b.left"].leaf,
      file.regions["root.b.right"].leaf })
    f.rfsm_send({ "r" }, { "e_v" })
    assert.equal("root.b.left.y root.b.right.v", f.rfsm_get({ "r" })[34])
    f.rfsm_force({ "r" }, { "root.b.left.x" }) -- the region beside it stays
    _, file = pull "r"
    assert.same({ "root.x", "root.v" }, { file.regions["root.b.left"].leaf,
      file.regions["root.b.right"].leaf })
    assert.equal("1003.000000", f.rfsm_get({ "r" })[16]) -- e_after(3)
    f.rfsm_set({ "r" }, { "root.b.left.list", "5" })
    assert.same({ list = 5 }, select(2, pull "r").regions["root.b.left"].data.root)
    assert.matches("has no leaf 'root.b.left.z' %(did you mean 'root.b.left",
      f.rfsm_force({ "r" }, { "root.b.left.z" }).err)
    assert.equal("root.a", f.rfsm_force({ "r" }, { "root.a" })[1])
    assert.equal("", f.rfsm_get({ "r" })[34])
  end)
end)
