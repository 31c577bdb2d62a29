-- Machines and the ports of RTT: reading events, raising them, writing the active leaf.
-- On the stand-in in spec/support/rtt.lua, or in a rttlua.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rtt_helper = require "spec.support.rtt_helper" -- before rfsm.rtt

local rfsm_rtt = require "rfsm.rtt"
local timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local rtt, connected, struct = rtt_helper.rtt, rtt_helper.connected, rtt_helper.struct
local samples, write_all, refusal =
  rtt_helper.samples, rtt_helper.write_all, rtt_helper.refusal
local counting_variables = rtt_helper.counting_variables

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

before_each(rtt_helper.reset)
after_each(rtt_helper.reset)

-- (initial) -> a --e_go--> b --e_back--> a
local function chart(fields)
  local model = state {
    warn = false, info = false, a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e_go" } },
    trans { src = "b", tgt = "a", events = { "e_back" } },
  }
  for key, value in pairs(fields or {}) do model[key] = value end -- any order: a set
  return model
end

local function started(model)
  local fsm = helper.init(model)
  rfsm.run(fsm)
  return fsm
end

local function bytes_after_calls(f)
  collectgarbage()
  collectgarbage()
  collectgarbage("stop")
  for _ = 1, 10 do f() end
  local before = collectgarbage("count")
  for _ = 1, 1000 do f() end
  local grown = collectgarbage("count") - before
  collectgarbage("restart")
  return grown * 1024
end

-- Bytes that 1,000 calls of `f` leave, without the JIT, whose traces would count. The
-- least of some tries: Lua's stack may grow once.
local function bytes_grown(f)
  local jit = rawget(_G, "jit")
  if jit then
    jit.off()
    jit.flush()
  end
  for _ = 1, 100 do f() end
  local least = math.huge
  for _ = 1, 3 do least = math.min(least, bytes_after_calls(f)) end
  if jit then jit.on() end
  return least
end

-- Reading ----------------------------------------------------------------------

for _, name in ipairs { "gen_read_events", "gen_read_str_events" } do
  local generate = rfsm_rtt[name]

  describe(name, function()
    it("returns nothing as long as a port has no data", function()
      local into = connected("string")
      assert.same({}, generate(into)())
    end)

    it("drains a port, in order", function()
      local into, out = connected("string")
      local getevents = generate(into)
      write_all(out, "e_a", "e_b", "e_c")
      assert.same({ "e_a", "e_b", "e_c" }, getevents())
    end)

    it("takes no event twice: old data is none", function()
      local into, out = connected("string")
      local getevents = generate(into)
      out:write("e_a")
      getevents()
      assert.same({}, getevents())
      assert.same({ "OldData", "e_a" }, { into:read() })
    end)

    it("reads several ports in the order given", function()
      local first, out_first = connected("string")
      local second, out_second = connected("string")
      local getevents = generate(second, first)
      write_all(out_first, "e_1", "e_2")
      write_all(out_second, "e_3", "e_4")
      assert.same({ "e_3", "e_4", "e_1", "e_2" }, getevents())
    end)

    it("takes the latest of a port that is not buffered", function()
      local into, out = rtt_helper.input(), rtt_helper.output()
      out:connect(into)
      write_all(out, "e_a", "e_b")
      assert.same({ "e_b" }, generate(into)())
    end)

    it("keeps the empty string", function()
      local into, out = connected("string")
      out:write("")
      assert.same({ "" }, generate(into)())
    end)

    it("loses nothing when a port raises", function()
      local into, out = connected("string")
      local is_broken = true
      local broken = { read = function()
        if is_broken then error("no data today", 0) end
        return "NoData"
      end }
      local getevents = generate(into, broken)
      write_all(out, "e_a", "e_b")
      assert.is_false((pcall(getevents)))
      out:write("e_c")
      is_broken = false
      assert.same({ "e_a", "e_b", "e_c" }, getevents())
      assert.same({}, getevents())
    end)

    it("feeds a machine", function()
      local into, out = connected("string")
      local fsm = started(chart { getevents = generate(into) })
      out:write("e_go")
      rfsm.run(fsm)
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
      rfsm.run(fsm)
      write_all(out, "e_back", "e_other")
      rfsm.run(fsm)
      assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    end)

    it("makes no Variable after the first", function()
      local into, out = connected("string")
      local getevents
      assert.equal(1, counting_variables(function() getevents = generate(into) end))
      assert.equal(0, counting_variables(function()
        for _ = 1, 100 do
          write_all(out, "e_a", "e_b")
          getevents()
        end
      end))
    end)

    it("allocates nothing in the steady state #alloc", function()
      local into, out = connected("string")
      local getevents = generate(into)
      local grown = bytes_grown(function()
        out:write("e_a")
        out:write("e_b")
        getevents()
      end)
      assert.is_true(grown < 1000, grown .. " bytes in 1,000 calls")
    end)

    it("reads what looks like a port without RTT", function()
      local queue = { "e_a", "e_b" }
      local port = { read = function()
        if queue[1] then return "NewData", table.remove(queue, 1) end
        return "NoData", ""
      end }
      assert.same({ "e_a", "e_b" }, generate(port)())
    end)

    describe("refuses", function()
      local function refused(...) return refusal(generate, ...) end

      it("to read no port", function()
        assert.equal("rfsm.rtt." .. name .. ": at least one port expected, got none",
          refused())
      end)

      local wanted = name == "gen_read_events" and "input port"
        or "input port of type string"
      local CASES = {
        { "nil", function() return nil end, "nil" },
        { "a string", function() return "into" end, "string 'into'" },
        { "a number", function() return 3 end, "number 3" },
        { "a table", function() return {} end, "table" },
        { "an output port", rtt_helper.output,
          "an output port" },
        { "a component", rtt.getTC, type(rtt.getTC()) },
      }
      for _, case in ipairs(CASES) do
        it(case[1], function()
          assert.equal(("rfsm.rtt.%s: port 2: %s expected, got %s"):format(name, wanted,
            case[3]), refused((connected("string")), (case[2]())))
        end)
      end
    end)
  end)
end

describe("gen_read_events", function()
  it("makes numbers and booleans of the basic types", function()
    local numbers, out_numbers = connected("int")
    local flags, out_flags = connected("bool")
    local getevents = rfsm_rtt.gen_read_events(numbers, flags)
    write_all(out_numbers, 0, 7)
    write_all(out_flags, false, true)
    assert.same({ 0, 7, false, true }, getevents())
  end)

  it("makes numbers of wide integers", function()
    local into, out = connected("llong")
    local getevents = rfsm_rtt.gen_read_events(into)
    rfsm_rtt.gen_raise_event(out)(7, -2 ^ 40)
    assert.same({ 7, -2 ^ 40 }, getevents())
  end)

  it("gives each sample of another type a Variable of its own", function()
    local into, out = connected("ConnPolicy")
    local getevents = rfsm_rtt.gen_read_events(into)
    write_all(out, struct(1, 2), struct(3, 4))
    local first, second = unpack(getevents())
    out:write(struct(5, 6))
    getevents()
    assert.same({ 1, 2, 3, 4 }, { first.type, first.size, second.type, second.size })
  end)

  it("lets predicates of a chart look at such samples", function()
    local into, out = connected("ConnPolicy")
    local model = chart { getevents = rfsm_rtt.gen_read_events(into) }
    model[2].events = { function(event) return event.size > 1 end }
    local fsm = started(model)
    out:write(struct(0, 1))
    rfsm.run(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    out:write(struct(0, 2))
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("gen_read_str_events", function()
  it("refuses a port of another type", function()
    assert.equal("rfsm.rtt.gen_read_str_events: port 1: input port of type string "
      .. "expected, got one of type int",
      refusal(rfsm_rtt.gen_read_str_events, (connected("int"))))
  end)
end)

-- Raising ----------------------------------------------------------------------

describe("gen_raise_event", function()
  local into, out

  before_each(function() into, out = connected("string") end)

  it("writes each of several events: a port takes one", function()
    rfsm_rtt.gen_raise_event(out)("e_a", "e_b", "e_c")
    assert.same({ "e_a", "e_b", "e_c" }, samples(into))
  end)

  it("skips nil, and writes nothing for nothing", function()
    local raise_event = rfsm_rtt.gen_raise_event(out)
    raise_event()
    raise_event(nil, "e_a", nil)
    assert.same({ "e_a" }, samples(into))
  end)

  it("sends to the machine, too, if there is one", function()
    local fsm = started(chart())
    rfsm_rtt.gen_raise_event(out, fsm)("e_go", "e_x")
    assert.equal(2, rfsm.check_events(fsm))
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    assert.same({ "e_go", "e_x" }, samples(into))
  end)

  it("can be used by the machine's own programs", function()
    local model, raise_event = chart(), nil
    model.a.exit = function() raise_event("e_back") end
    local fsm = started(model)
    raise_event = rfsm_rtt.gen_raise_event(out, fsm)
    helper.post_and_run(fsm, "e_go")
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    assert.same({ "e_back" }, samples(into))
  end)

  -- Type of port, event, sample; the types of other typekits are not in every RTT.
  local ACCEPTED = {
    { "double", 0.5, 0.5 }, { "float", 0.5, 0.5 }, { "int", 3, 3 }, { "uint", 3, 3 },
    { "int8", 3, 3 }, { "uint8", 3, 3 }, { "int16", 3, 3 }, { "uint16", 3, 3 },
    { "int32", 3, 3 }, { "uint32", 3, 3 }, { "int64", 3, 3 }, { "uint64", 3, 3 },
    { "long", 3, 3 }, { "bool", false, false }, { "bool", 3, true },
    { "char", "e", "e" },
  }
  for _, case in ipairs(ACCEPTED) do
    local kind, event, sample = unpack(case)
    if pcall(rtt.Variable.new, kind) then
      it(("writes %s to a port of type %s"):format(tostring(event), kind), function()
        local numbers, port = connected(kind)
        rfsm_rtt.gen_raise_event(port)(event)
        assert.same({ sample }, samples(numbers))
      end)
    end
  end

  it("writes wide integers as numbers, without a warning", function()
    for _, kind in ipairs { "llong", "ullong" } do
      local numbers, port = connected(kind)
      rfsm_rtt.gen_raise_event(port)(3)
      assert.equal("3", samples(numbers)[1]:toString())
    end
    assert.same({}, rtt_helper.logged("Warning"))
  end)

  it("writes Variables of the port's type", function()
    local structs, out_structs = connected("ConnPolicy")
    rfsm_rtt.gen_raise_event(out_structs)(struct(1, 2))
    assert.equal(2, samples(structs)[1].size)
    local var = rtt.Variable.new("string")
    var:assign("e_a")
    rfsm_rtt.gen_raise_event(out)(var)
    assert.same({ "e_a" }, samples(into))
  end)

  it("makes no Variable after the first, and no garbage #alloc", function()
    local raise_event = rfsm_rtt.gen_raise_event(out)
    local function raise_two() raise_event("e_a", "e_b") end
    assert.equal(0, counting_variables(raise_two))
    local grown = bytes_grown(raise_two)
    assert.is_true(grown < 1000, grown .. " bytes in 1,000 calls")
  end)

  it("writes to what looks like a port without RTT", function()
    local written = {}
    local port = { write = function(_, value) written[#written + 1] = value end }
    rfsm_rtt.gen_raise_event(port)("e_a", 2)
    assert.same({ "e_a", 2 }, written)
  end)

  describe("refuses", function()
    it("what is no output port", function()
      assert.equal("rfsm.rtt.gen_raise_event: output port expected, got nil",
        refusal(rfsm_rtt.gen_raise_event))
      assert.equal("rfsm.rtt.gen_raise_event: output port expected, got an input port",
        refusal(rfsm_rtt.gen_raise_event, into))
    end)

    it("what is no machine", function()
      assert.equal("rfsm.rtt.gen_raise_event: initialised fsm expected, got state "
        .. "(rfsm.init makes one of a state)",
        refusal(rfsm_rtt.gen_raise_event, out, chart()))
      assert.equal("rfsm.rtt.gen_raise_event: initialised fsm expected, got boolean",
        refusal(rfsm_rtt.gen_raise_event, out, false))
    end)

    -- Type of port, event, text.
    local EVENTS = {
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
    }
    for _, case in ipairs(EVENTS) do
      it(("an event for a port of type %s: %s"):format(case[1], case[3]), function()
        local fsm, port = started(chart()), rtt_helper.output(case[1])
        assert.equal("rfsm.rtt.raise_event: event 1: " .. case[3],
          refusal(rfsm_rtt.gen_raise_event(port, fsm), case[2]))
        assert.equal(0, rfsm.check_events(fsm))
      end)
    end

    it("all events for one that is wrong", function()
      local fsm = started(chart())
      assert.equal("rfsm.rtt.raise_event: event 2: string expected, got number 2",
        refusal(rfsm_rtt.gen_raise_event(out, fsm), "e_go", 2))
      assert.same({}, samples(into))
      assert.equal(0, rfsm.check_events(fsm))
    end)
  end)
end)

-- Writing the active leaf --------------------------------------------------------

describe("gen_write_fqn", function()
  local into, out

  before_each(function() into, out = connected("string") end)

  local function hooked(model)
    local fsm = helper.init(model or chart())
    rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn(out))
    return fsm
  end

  it("writes <none> first", function()
    hooked()
    assert.same({ "<none>" }, samples(into))
  end)

  it("writes the name of the leaf on change only", function()
    local fsm = hooked()
    rfsm.run(fsm)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_unknown")
    helper.post_and_run(fsm, "e_go")
    rfsm.run(fsm)
    assert.same({ "<none>", "root.a", "root.b" }, samples(into))
  end)

  it("writes each leaf of a run", function()
    local fsm = hooked()
    rfsm.send_events(fsm, "e_x")
    rfsm.run(fsm)
    fsm.b.entry = function() rfsm.send_events(fsm, "e_back") end
    helper.post_and_run(fsm, "e_go")
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(into))
  end)

  it("writes nothing when a leaf is left and entered again in one step", function()
    local model = chart()
    model[4] = trans { src = "a", tgt = "a", events = { "e_again" } }
    local fsm = hooked(model)
    rfsm.run(fsm)
    helper.post_and_run(fsm, "e_again")
    assert.same({ "<none>", "root.a" }, samples(into))
  end)

  it("writes <none> at reset, once", function()
    local fsm = hooked()
    rfsm.run(fsm)
    rfsm.reset(fsm)
    rfsm.reset(fsm)
    rfsm.run(fsm)
    assert.same({ "<none>", "root.a", "<none>", "root.a" }, samples(into))
  end)

  it("works as the post_step_hook of a model, for each of its machines", function()
    local model = chart { post_step_hook = rfsm_rtt.gen_write_fqn(out) }
    local first, second = started(model), started(model)
    helper.post_and_run(second, "e_go")
    rfsm.run(first)
    rfsm.run(helper.init(second))
    assert.same({ "<none>", "root.a", "root.a", "root.b", "root.a" }, samples(into))
  end)

  it("keeps two ports of one machine apart", function()
    local other, out_other = connected("string")
    local fsm = hooked()
    rfsm.run(fsm)
    rfsm.post_step_hook_add(fsm, rfsm_rtt.gen_write_fqn(out_other))
    rfsm.run(fsm)
    assert.same({ "<none>", "root.a" }, samples(into))
    assert.same({ "<none>", "root.a" }, samples(other))
  end)

  it("is heard by who connects later and asks for the last sample", function()
    local fsm = hooked()
    rfsm.run(fsm)
    assert.same({ "root.a" }, samples(rtt_helper.listen("lua." .. out:info().name)))
  end)

  it("makes no Variable after the first, and no garbage #alloc", function()
    local fsm = hooked()
    rfsm.run(fsm)
    local function there_and_back()
      rfsm.send_events(fsm, "e_go")
      rfsm.step(fsm)
      rfsm.send_events(fsm, "e_back")
      rfsm.step(fsm)
    end
    there_and_back()
    assert.equal(0, counting_variables(there_and_back))
    local grown = bytes_grown(there_and_back)
    assert.is_true(grown < 1000, grown .. " bytes in 1,000 calls")
  end)

  describe("refuses", function()
    local function refused(...) return refusal(rfsm_rtt.gen_write_fqn, ...) end

    it("what is no output port of type string", function()
      local text = "rfsm.rtt.gen_write_fqn: output port of type string expected, got "
      assert.equal(text .. "nil", refused(nil))
      assert.equal(text .. "an input port", refused(into))
      assert.equal(text .. "one of type int", refused(rtt_helper.output("int")))
    end)

    it("to be called with anything but a machine", function()
      assert.equal("rfsm.rtt.write_fqn: initialised fsm expected, got nil",
        refusal(rfsm_rtt.gen_write_fqn(out)))
    end)
  end)
end)

describe("the clock of RTT", function()
  after_each(function() timeevent.set_gettime_hook(nil) end)

  it("serves time events", function()
    timeevent.set_gettime_hook(rtt.getTime)
    local model = chart()
    model[2].events = { "e_after(0.2)" }
    local fsm = started(model)
    rtt_helper.advance(0.1)
    rfsm.run(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    rtt_helper.advance(0.11)
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("the launchers", function()
  it("are fields of the module, loaded when they are used", function()
    package.loaded["rfsm.rtt_launch"] = nil
    local again = dofile "rfsm/rtt.lua"
    assert.is_nil(package.loaded["rfsm.rtt_launch"])
    assert.is_function(again.component_launch_rfsm)
    assert.is_function(again.service_launch_rfsm)
    assert.is_nil(again.others)
  end)
end)
