-- Machines and the ports of RTT: reading events, raising them, writing the active leaf.
-- On the stand-in in spec/support/rtt.lua, or in a rttlua.

local helper = require "spec.helper"
local measure = require "bench.measure"
local rfsm = require "rfsm"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rfsm_rtt = require "rfsm.rtt"

local trans, started, leaf_after = rfsm.trans, helper.started, helper.leaf_after
local rtt, connected, struct = rtt_helper.rtt, rtt_helper.connected, rtt_helper.policy
local samples, write_all, refusal =
  rtt_helper.samples, rtt_helper.write_all, helper.refusal
local counting_variables, leaves = rtt_helper.counting_variables, rtt_helper.leaves

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

local function chart(fields) return helper.chart({ "e_go" }, fields) end

-- 1,000 calls of `f` leave no garbage, and make no Variable. Without the JIT, whose
-- traces would count; the least of some tries, since Lua's stack may grow once.
local function is_free(f)
  local jit, least = rawget(_G, "jit"), math.huge
  if jit then
    jit.off()
    jit.flush()
  end
  for _ = 1, 100 do f() end
  for _ = 1, 3 do
    least = math.min(least, measure.bytes_grown(function(n)
      for _ = 1, n do f() end
    end, 1000))
  end
  if jit then jit.on() end
  assert.is_true(least < 1000, least .. " bytes in 1,000 calls")
  assert.equal(0, counting_variables(f))
end

-- Reading ----------------------------------------------------------------------

for _, name in ipairs { "gen_read_events", "gen_read_str_events" } do
  local generate = rfsm_rtt[name]

  describe(name, function()
    it("drains ports in the order given, old data and no data are no events", function()
      local first, out_first = connected("string")
      local second, out_second = connected("string")
      local getevents = generate(second, first)
      assert.same({}, getevents())
      write_all(out_first, "e_1", "e_2", "")
      write_all(out_second, "e_3", "e_4")
      assert.same({ "e_3", "e_4", "e_1", "e_2", "" }, getevents())
      assert.same({}, getevents())
      assert.same({ "OldData", "e_4" }, { second:read() })
    end)

    it("takes the latest of a port that is not buffered", function()
      local into, out = rtt_helper.input(), rtt_helper.output()
      out:connect(into)
      write_all(out, "e_a", "e_b")
      assert.same({ "e_b" }, generate(into)())
    end)

    it("loses nothing when a port raises", function()
      local into, out = connected("string")
      local is_broken = false
      local getevents = generate(into, { read = function()
        if is_broken then error("no data today", 0) end
        return "NoData"
      end })
      assert.same({}, getevents())
      is_broken = true
      write_all(out, "e_a", "e_b")
      assert.is_false((pcall(getevents)))
      out:write("e_c")
      is_broken = false
      assert.same({ "e_a", "e_b", "e_c" }, getevents())
      assert.same({}, getevents())
    end)

    -- Events e_1, e_2, ... as one text.
    local function numbered(from, to)
      local names = {}
      for i = from, to do names[#names + 1] = "e_" .. i end
      return table.concat(names, " ")
    end

    local function write_numbered(out, to)
      for i = 1, to do out:write("e_" .. i) end
    end

    it("reads at most 64 samples of each port in a call, the rest in the next ones",
      function()
        local before, out_before = connected("string")
        local flooded, out_flooded = connected("string", struct(200))
        local behind, out_behind = connected("string")
        local getevents = generate(before, flooded, behind)
        out_before:write("e_before")
        write_numbered(out_flooded, 150)
        out_behind:write("e_behind")
        assert.equal("e_before " .. numbered(1, 64) .. " e_behind",
          table.concat(getevents(), " "))
        assert.equal(numbered(65, 128), table.concat(getevents(), " "))
        assert.equal(numbered(129, 150), table.concat(getevents(), " "))
        assert.same({}, getevents())
      end)

    it("keeps no more than 64 of each port as long as another one raises", function()
      local flooded, out_flooded = connected("string", struct(200))
      local is_broken = true
      local getevents = generate(flooded, { read = function()
        if is_broken then error("no data today", 0) end
        return "NoData"
      end })
      write_numbered(out_flooded, 150)
      for _ = 1, 3 do assert.is_false((pcall(getevents))) end
      is_broken = false
      assert.equal(numbered(1, 64), table.concat(getevents(), " "))
      assert.equal(numbered(65, 128), table.concat(getevents(), " "))
    end)

    it("feeds a machine", function()
      local into, out = connected("string")
      local fsm = started(chart { getevents = generate(into) })
      out:write("e_go")
      assert.equal("root.b", leaf_after(fsm))
      rfsm.run(fsm)
      write_all(out, "e_back", "e_other")
      assert.equal("root.a", leaf_after(fsm))
    end)

    it("makes one Variable, and no garbage in the steady state #alloc", function()
      local into, out = connected("string")
      local getevents
      assert.equal(1, counting_variables(function() getevents = generate(into) end))
      is_free(function()
        out:write("e_a")
        out:write("e_b")
        getevents()
      end)
    end)

    it("reads what looks like a port without RTT", function()
      local queue = { "e_a", "e_b" }
      local port = { read = function()
        if queue[1] then return "NewData", table.remove(queue, 1) end
        return "NoData", ""
      end }
      assert.same({ "e_a", "e_b" }, generate(port)())
    end)

    it("refuses to read no port", function()
      assert.equal("rfsm.rtt." .. name .. ": at least one port expected, got none",
        refusal(generate))
    end)

    local wanted = name == "gen_read_events" and "input port"
      or "input port of type string"
    for got, make in pairs { -- any order: each is a spec of its own
      ["one of type int"] = name == "gen_read_str_events"
        and function() return rtt_helper.input("int") end or nil,
      ["nil"] = function() return nil end,
      ["string 'into'"] = function() return "into" end,
      ["number 3"] = function() return 3 end, table = function() return {} end,
      ["an output port"] = rtt_helper.output, [type(rtt.getTC())] = rtt.getTC,
    } do
      it("refuses " .. got, function()
        assert.equal(("rfsm.rtt.%s: port 2: %s expected, got %s"):format(name, wanted,
          got), refusal(generate, (connected("string")), (make())))
      end)
    end
  end)
end

describe("gen_read_events", function()
  it("gives each sample of another type a Variable of its own, also for predicates",
    function()
      local into, out = connected("ConnPolicy")
      local getevents = rfsm_rtt.gen_read_events(into)
      write_all(out, struct(2, 1), struct(4, 3))
      local first, second = unpack(getevents())
      out:write(struct(6, 5))
      getevents()
      assert.same({ 1, 2, 3, 4 }, { first.type, first.size, second.type, second.size })
      local model = chart { getevents = getevents }
      model[2].events = { function(event) return event.size > 1 end }
      local fsm = started(model)
      for _, case in ipairs { { 1, "root.a" }, { 2, "root.b" } } do
        out:write(struct(case[1]))
        assert.equal(case[2], leaf_after(fsm))
      end
    end)
end)

-- Raising ----------------------------------------------------------------------

describe("gen_raise_event", function()
  local into, out

  before_each(function() into, out = connected("string") end)

  it("writes each of several events, skips nil, writes nothing for nothing", function()
    local raise_event = rfsm_rtt.gen_raise_event(out)
    raise_event()
    raise_event("e_a", nil, "e_b", "e_c", nil)
    assert.same({ "e_a", "e_b", "e_c" }, samples(into))
  end)

  it("sends to the machine, too, if there is one, also from its own callbacks",
    function()
      local fsm = started(chart())
      local raise_event = rfsm_rtt.gen_raise_event(out, fsm)
      raise_event("e_go", "e_x")
      assert.equal(2, rfsm.check_events(fsm))
      fsm.b.entry = function() raise_event("e_back") end
      assert.equal("root.a", leaf_after(fsm))
      assert.same({ "e_go", "e_x", "e_back" }, samples(into))
    end)

  -- Type of port, event, sample; the types of other typekits are not in every RTT.
  local ACCEPTED = {
    { "double", 0.5 }, { "float", 0.5 }, { "bool", false }, { "bool", 3, true },
    { "char", "e" }, { "llong", -2 ^ 40 }, { "ullong", 2 ^ 40 },
  }
  for kind in ("int uint int8 uint8 int16 uint16 int32 uint32 int64 uint64 long")
    :gmatch("%S+") do ACCEPTED[#ACCEPTED + 1] = { kind, 3 } end
  for _, case in ipairs(ACCEPTED) do
    local kind, event, sample = unpack(case, 1, 3)
    if sample == nil then sample = event end
    if pcall(rtt.Variable.new, kind) then
      it(("writes %s to a port of type %s, where it is read"):format(tostring(event),
        kind), function()
        local numbers, port = connected(kind)
        rfsm_rtt.gen_raise_event(port)(event, event)
        assert.same({ sample, sample }, rfsm_rtt.gen_read_events(numbers)())
        assert.same({}, rtt_helper.logged("Warning"))
      end)
    end
  end

  it("writes Variables of the port's type", function()
    local structs, out_structs = connected("ConnPolicy")
    rfsm_rtt.gen_raise_event(out_structs)(struct(2, 1))
    assert.equal(2, samples(structs)[1].size)
    rfsm_rtt.gen_raise_event(out)(rtt.Variable.new("string", "e_a"))
    assert.same({ "e_a" }, samples(into))
  end)

  it("makes no Variable after the first, and no garbage #alloc", function()
    local raise_event = rfsm_rtt.gen_raise_event(out)
    is_free(function() raise_event("e_a", "e_b") end)
  end)

  it("writes to what looks like a port without RTT", function()
    local written = {}
    local port = { write = function(_, value) written[#written + 1] = value end }
    rfsm_rtt.gen_raise_event(port)("e_a", 2)
    assert.same({ "e_a", 2 }, written)
  end)

  it("refuses what is no output port or machine", function()
    local where = "rfsm.rtt.gen_raise_event: "
    for _, case in ipairs {
      { "output port expected, got nil" },
      { "output port expected, got an input port", into },
      { "initialised fsm expected, got state (rfsm.init makes one of a state)", out,
        chart() },
      { "initialised fsm expected, got boolean", out, false },
    } do
      assert.equal(where .. case[1],
        refusal(rfsm_rtt.gen_raise_event, unpack(case, 2, 3)))
    end
  end)

  -- Type of port, event, text.
  for _, case in ipairs {
    { "string", 3, "string expected, got number 3" },
    { "string", true, "string expected, got boolean" },
    { "int", "e_a", "number expected, got string 'e_a'" },
    { "bool", {}, "boolean expected, got table" },
    { "string", {}, "string expected, got table" },
    { "llong", "3", "number expected, got string '3'" },
    { "ConnPolicy", "e_a", "Variable of type ConnPolicy expected, got string 'e_a'" },
    { "ConnPolicy", rtt.Variable.new("int"),
      "Variable of type ConnPolicy expected, got a Variable of type int" },
    { "string", rtt.Variable.new("int"),
      "string expected, got a Variable of type int" },
  } do
    it(("refuses an event for a port of type %s: %s"):format(case[1], case[3]),
      function()
        local fsm, port = started(chart()), rtt_helper.output(case[1])
        assert.equal("rfsm.rtt.raise_event: event 1: " .. case[3],
          refusal(rfsm_rtt.gen_raise_event(port, fsm), case[2]))
        assert.equal(0, rfsm.check_events(fsm))
      end)
  end

  it("refuses all events for one that is wrong", function()
    local fsm = started(chart())
    assert.equal("rfsm.rtt.raise_event: event 2: string expected, got number 2",
      refusal(rfsm_rtt.gen_raise_event(out, fsm), "e_go", 2))
    assert.same({ {}, 0 }, { samples(into), rfsm.check_events(fsm) })
  end)
end)

-- Writing the active leaf --------------------------------------------------------

describe("gen_write_fqn", function()
  local into, out

  before_each(function() into, out = connected("string") end)

  local function hooked(model)
    local fsm = helper.init(model or chart())
    rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn(out))
    assert.equal("<none>", leaves(into))
    return fsm
  end

  it("writes <none> first, then the name of the leaf on change only", function()
    local model = chart()
    model[4] = trans { src = "a", tgt = "a", events = { "e_again" } }
    local fsm = hooked(model)
    rfsm.run(fsm)
    rfsm.run(fsm)
    for _, event in ipairs { "e_unknown", "e_again", "e_go" } do
      helper.post_and_run(fsm, event)
    end
    rfsm.run(fsm)
    assert.equal("a b", leaves(into))
  end)

  it("writes each leaf of a run, and <none> at reset, once", function()
    local fsm = hooked()
    fsm.b.entry = function() rfsm.send_events(fsm, "e_back") end
    helper.post_and_run(fsm, "e_x")
    helper.post_and_run(fsm, "e_go")
    rfsm.reset(fsm)
    rfsm.reset(fsm)
    rfsm.run(fsm)
    assert.equal("a b a <none> a", leaves(into))
  end)

  it("works as the post_step_hook of a model, for each of its machines", function()
    local model = chart { post_step_hook = rfsm_rtt.gen_write_fqn(out) }
    local first, second = started(model), started(model)
    helper.post_and_run(second, "e_go")
    rfsm.run(first)
    rfsm.run(helper.init(second))
    assert.equal("<none> a a b a", leaves(into))
  end)

  it("keeps two ports of one machine apart", function()
    local other, out_other = connected("string")
    local fsm = hooked()
    rfsm.run(fsm)
    rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn(out_other))
    rfsm.run(fsm)
    assert.equal("a", leaves(into))
    assert.equal("<none> a", leaves(other))
  end)

  it("is heard by who connects later and asks for the last sample", function()
    rfsm.run(hooked())
    assert.equal("a", leaves(rtt_helper.listen("lua." .. out:info().name)))
  end)

  it("makes no Variable after the first, and no garbage #alloc", function()
    local fsm = hooked()
    rfsm.run(fsm)
    is_free(function()
      rfsm.send_events(fsm, "e_go")
      rfsm.step(fsm)
      rfsm.send_events(fsm, "e_back")
      rfsm.step(fsm)
    end)
  end)

  it("refuses what is no output port of type string, and to hook what is no machine",
    function()
      local function refused(port) return refusal(rfsm_rtt.gen_write_fqn, port) end
      local text = "rfsm.rtt.gen_write_fqn: output port of type string expected, got "
      assert.equal(text .. "nil", refused(nil))
      assert.equal(text .. "an input port", refused(into))
      assert.equal(text .. "one of type int", refused(rtt_helper.output("int")))
      assert.equal("rfsm.rtt.write_fqn: initialised fsm expected, got nil",
        refusal(rfsm_rtt.gen_write_fqn(out)))
    end)
end)

it("the launchers are fields of the module, loaded when they are used", function()
  package.loaded["rfsm.rtt.launch"] = nil
  local again = dofile "rfsm/rtt.lua"
  assert.is_nil(package.loaded["rfsm.rtt.launch"])
  assert.is_function(again.component_launch_rfsm)
  assert.is_function(again.service_launch_rfsm)
  assert.is_nil(again.others)
end)

describe("the memory of a component", function()
  local update = require "rfsm.rtt.update"

  local function none() return { assign = function() end } end

  -- Runs f while this Lua seems to have a pool of 100 KiB.
  local function in_pool(pool, f)
    local function stats()
      pool.asked = (pool.asked or 0) + 1
      return pool.used * 1024, pool.most * 1024, 100 * 1024
    end
    return helper.with(_G, { tlsf = { stats = stats } }, f)
  end

  it("is in the attributes: what is alive after a collection, and the most", function()
    local values, pool = {}, { used = 40, most = 50 }
    local function variable(name)
      return { assign = function(_, value) values[name] = value end }
    end
    in_pool(pool, function()
      local meter = update.new_meter { variables = { rfsm_live = variable "live",
        rfsm_peak = variable "peak" } }
      for i, case in ipairs {
        { most = 50, peak = 50, is_new = true }, { most = 60, peak = 60 },
        { most = 60, collects = true, is_new = true }, { most = 55 },
      } do
        pool.most = case.most
        if case.collects then
          collectgarbage()
          collectgarbage() -- a finalizer is called at the end of a cycle, or soon
        end
        meter()
        local live = values.live or collectgarbage("count")
        assert.is_true(math.abs(live - collectgarbage("count")) < 50, i)
        assert.same({ case.is_new or false, case.peak },
          { values.live ~= nil, values.peak }, i)
        values.live, values.peak = nil, nil
      end
    end)
  end)

  it("is collected when nine tenths of the rest of the pool are in use", function()
    local pool = { used = 40, most = 50 }
    in_pool(pool, function()
      local meter = update.new_meter { variables = { rfsm_live = none(),
        rfsm_peak = none() } }
      for _, case in ipairs { { used = 40, asked = 1 }, { used = 94, asked = 1 },
        { used = 94.1, asked = 2 } } do
        pool.used, pool.asked = case.used, 0
        meter()
        assert.equal(case.asked, pool.asked)
      end
    end)
  end)

  -- Since 5.4 the collector is set in another way.
  it("has little room for garbage when a tenth of the pool is left", function()
    if _VERSION > "Lua 5.3" then return end
    local usual = collectgarbage("setstepmul", 200)
    local advice = package.loaded["rfsm.advice"]
    for used, stepmul in pairs { [90] = 300, [91] = 10000 } do -- any order
      local launch = { fsm = helper.init(rfsm.state { a = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" } }), fsmfile = "a.lua", stepmul = 300,
        component = { getName = function() return "arm" end },
        log = function() end, meter = function() end }
      collectgarbage("setstepmul", 10000)
      in_pool({ used = used, most = used }, function() update.finish(launch) end)
      assert.equal(stepmul, collectgarbage("setstepmul", 200))
    end
    collectgarbage("setstepmul", usual)
    package.loaded["rfsm.advice"] = advice
  end)

  it("is collected when a text that is logged says that there was none", function()
    local log = update.new_log { logl = function() end,
      getTime = function() return 0 end }
    collectgarbage("stop")
    for _, case in ipairs {
      { texts = { "a", "b" }, is_kept = true },
      { texts = { "not enough memory", "b" }, is_kept = false },
      { texts = { "a", "x.lua:1: not enough memory" }, is_kept = false },
      { texts = { "a", {} }, is_kept = true },
    } do
      local weak = setmetatable({ {} }, { __mode = "v" })
      log("Error", case.texts[1], case.texts[2])
      assert.equal(case.is_kept, weak[1] ~= nil)
    end
    collectgarbage("restart")
  end)
end)

describe("a launch that fails", function()
  it("is undone when its garbage is collected", function()
    local weak, is_collected = setmetatable({ {} }, { __mode = "v" }), false
    local launch = { where = "launch of 'x.lua': ", undo = function()
      is_collected = weak[1] == nil
    end }
    collectgarbage("stop")
    assert.equal("launch of 'x.lua': no leg", select(2,
      pcall(require("rfsm.rtt.update").fail, launch, "no leg")))
    collectgarbage("restart")
    assert.is_true(is_collected)
  end)
end)

describe("the log of a launched machine", function()
  local update = require "rfsm.rtt.update"
  local now, lines, log, flush

  before_each(function()
    now, lines = 7, {}
    log, flush = update.new_log { getTime = function() return now, 0 end,
      logl = function(level, text) lines[#lines + 1] = level .. " " .. text end }
  end)

  it("has any values as text, and each new line at once", function()
    log("Error", "a", nil, 3)
    log("Warning", "a nil 3")
    log("Error", "b")
    assert.same({ "Error a nil 3", "Warning a nil 3", "Error b" }, lines)
  end)

  it("has a line that comes again once a second, with the number of times", function()
    for _ = 1, 5 do
      log("Error", "away")
      flush()
    end
    log("Info", "once")
    now = 8
    flush()
    flush()
    for _ = 1, 3 do log("Error", "away") end
    now = 9
    log("Error", "away")
    now = 10
    flush()
    assert.same({ "Error away", "Info once", "Error away (4 times)",
      "Error away (4 times)" }, lines)
  end)

  it("forgets the oldest of 16 lines, and writes it if it came again", function()
    log("Error", "first")
    log("Error", "first")
    for i = 1, 16 do log("Error", "other " .. i) end
    assert.equal("Error first", lines[17])
    log("Error", "other 16")
    assert.equal(18, #lines)
  end)
end)
