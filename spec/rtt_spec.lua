-- Machines in RTT-Lua, on the stand-in for RTT in spec/support/rtt.lua: ports,
-- services, components; what is refused, and that nothing is left then.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local rtt = require "spec.support.rtt"

package.loaded.rtt = rtt

local rfsm_rtt = require "rfsm_rtt"
local timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local standin = rtt.standin

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- What the specs share ---------------------------------------------------------

local BUFFER = 1

local function policy(size, kind)
  local cp = rtt.Variable("ConnPolicy")
  cp.type, cp.size, cp.init = kind or BUFFER, size, true
  return cp
end

-- An input port and the output port that feeds it, through a buffer.
local function connected(kind, size)
  local into, out = rtt.InputPort(kind, "into"), rtt.OutputPort(kind, "out")
  assert(out:connect(into, policy(size or 16)))
  return into, out
end

local function write_all(port, ...)
  for i = 1, select("#", ...) do port:write((select(i, ...))) end
end

-- The new samples of a port.
local function samples(port)
  local values = {}
  local status, value = port:read()
  while status == "NewData" do
    values[#values + 1] = value
    status, value = port:read()
  end
  return values
end

-- Text of the error that f raises, which must blame the caller: this file.
local function refusal(f, ...)
  local arguments, n = { ... }, select("#", ...)
  local ok, problem = pcall(function() f(unpack(arguments, 1, n)) end)
  if ok then return "accepted" end
  local text = tostring(problem):match("^[^:\n]*rtt_spec%.lua:%d+: (.*)$")
  return text or "blames another: " .. tostring(problem)
end

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

local function counting_variables(f)
  local before = standin.variables
  f()
  return standin.variables - before
end

local function bytes_after_calls(f)
  collectgarbage()
  collectgarbage()
  collectgarbage("stop")
  f()
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

before_each(function()
  standin.reset()
  standin.add_type("Pose", { x = "double", y = "double" })
end)

local function pose(x, y)
  local var = rtt.Variable("Pose")
  var.x, var.y = x, y
  return var
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
      local into, out = rtt.InputPort("string"), rtt.OutputPort("string")
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
      local broken = connected("string")
      local getevents = generate(into, broken)
      write_all(out, "e_a", "e_b")
      broken:delete()
      assert.is_false((pcall(getevents)))
      out:write("e_c")
      broken.is_deleted = false
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
        assert.equal("rfsm_rtt." .. name .. ": at least one port expected, got none",
          refused())
      end)

      local wanted = name == "gen_read_events" and "input port"
        or "input port of type string"
      local CASES = {
        { "nil", function() return nil end, "nil" },
        { "a string", function() return "into" end, "string 'into'" },
        { "a number", function() return 3 end, "number 3" },
        { "a table", function() return {} end, "table" },
        { "an output port", function() return rtt.OutputPort("string") end,
          "an output port" },
        { "a component", function() return rtt.getTC() end, "table" },
      }
      for _, case in ipairs(CASES) do
        it(case[1], function()
          assert.equal(("rfsm_rtt.%s: port 2: %s expected, got %s"):format(name, wanted,
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

  it("gives each sample of another type a Variable of its own", function()
    local into, out = connected("Pose")
    local getevents = rfsm_rtt.gen_read_events(into)
    write_all(out, pose(1, 2), pose(3, 4))
    local first, second = unpack(getevents())
    out:write(pose(5, 6))
    getevents()
    assert.same({ 1, 2, 3, 4 }, { first.x, first.y, second.x, second.y })
  end)

  it("lets predicates of a chart look at such samples", function()
    local into, out = connected("Pose")
    local model = chart { getevents = rfsm_rtt.gen_read_events(into) }
    model[2].events = { function(event) return event.x > 1 end }
    local fsm = started(model)
    out:write(pose(1, 0))
    rfsm.run(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    out:write(pose(2, 0))
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)

describe("gen_read_str_events", function()
  it("refuses a port of another type", function()
    assert.equal("rfsm_rtt.gen_read_str_events: port 1: input port of type string "
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

  it("writes numbers, booleans and Variables to ports that take them", function()
    local numbers, out_numbers = connected("double")
    local flags, out_flags = connected("bool")
    local poses, out_poses = connected("Pose")
    rfsm_rtt.gen_raise_event(out_numbers)(0.5)
    rfsm_rtt.gen_raise_event(out_flags)(false)
    rfsm_rtt.gen_raise_event(out_poses)(pose(1, 2))
    assert.same({ 0.5 }, samples(numbers))
    assert.same({ false }, samples(flags))
    assert.equal(2, samples(poses)[1].y)
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
      assert.equal("rfsm_rtt.gen_raise_event: output port expected, got nil",
        refusal(rfsm_rtt.gen_raise_event))
      assert.equal("rfsm_rtt.gen_raise_event: output port expected, got an input port",
        refusal(rfsm_rtt.gen_raise_event, into))
    end)

    it("what is no machine", function()
      assert.equal("rfsm_rtt.gen_raise_event: machine (the result of rfsm.init) "
        .. "expected, got table", refusal(rfsm_rtt.gen_raise_event, out, chart()))
      assert.equal("rfsm_rtt.gen_raise_event: machine (the result of rfsm.init) "
        .. "expected, got boolean", refusal(rfsm_rtt.gen_raise_event, out, false))
    end)

    -- Type of port, event, text.
    local EVENTS = {
      { "string", 3, "string expected, got number 3" },
      { "string", true, "string expected, got boolean" },
      { "int", "e_a", "number expected, got string 'e_a'" },
      { "bool", {}, "boolean expected, got table" },
      { "Pose", "e_a", "Variable of type Pose expected, got string 'e_a'" },
      { "Pose", rtt.Variable("int"),
        "Variable of type Pose expected, got one of type int" },
    }
    for _, case in ipairs(EVENTS) do
      it(("an event for a port of type %s: %s"):format(case[1], case[3]), function()
        local fsm, port = started(chart()), rtt.OutputPort(case[1])
        assert.equal("rfsm_rtt.raise_event: event 1: " .. case[3],
          refusal(rfsm_rtt.gen_raise_event(port, fsm), case[2]))
        assert.equal(0, rfsm.check_events(fsm))
      end)
    end

    it("all events for one that is wrong", function()
      local fsm = started(chart())
      assert.equal("rfsm_rtt.raise_event: event 2: string expected, got number 2",
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
    local late = rtt.InputPort("string")
    out:connect(late, policy(4))
    assert.same({ "root.a" }, samples(late))
  end)

  it("makes no Variable after the first, and no garbage #alloc", function()
    -- the hook alone: for a machine with hooks the core makes a list in each step
    local hook, fsm = rfsm_rtt.gen_write_fqn(out), started(chart())
    local function there_and_back()
      fsm._act_leaf = fsm.b
      hook(fsm)
      fsm._act_leaf = fsm.a
      hook(fsm)
    end
    there_and_back()
    assert.equal(0, counting_variables(there_and_back))
    local grown = bytes_grown(there_and_back)
    assert.is_true(grown < 1000, grown .. " bytes in 1,000 calls")
  end)

  describe("refuses", function()
    local function refused(...) return refusal(rfsm_rtt.gen_write_fqn, ...) end

    it("what is no output port of type string", function()
      local text = "rfsm_rtt.gen_write_fqn: output port of type string expected, got "
      assert.equal(text .. "nil", refused(nil))
      assert.equal(text .. "an input port", refused(into))
      assert.equal(text .. "one of type int", refused(rtt.OutputPort("int")))
    end)

    it("to be called with anything but a machine", function()
      assert.equal("rfsm_rtt.write_fqn: machine expected, got nil",
        refusal(rfsm_rtt.gen_write_fqn(out)))
    end)
  end)
end)

describe("the clock of RTT", function()
  after_each(function() timeevent.set_gettime_hook(nil) end)

  it("serves time events, to the nanosecond", function()
    timeevent.set_gettime_hook(rtt.getTime)
    local model = chart()
    model[2].events = { "e_after(1.5)" }
    local fsm = started(model)
    standin.advance(1.5)
    rfsm.run(fsm)
    assert.equal("root.a", rfsm.get_actleaf_fqn(fsm))
    standin.advance(1e-9)
    rfsm.run(fsm)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)

-- Launching: what services and components share ----------------------------------

local made -- names of files

local function file_with(text)
  local name = os.tmpname()
  made[#made + 1] = name
  local file = assert(io.open(name, "w"))
  file:write(text)
  file:close()
  return name
end

before_each(function() made = {} end)

after_each(function()
  for _, name in ipairs(made) do os.remove(name) end
end)

-- The chart of above as a file, with more fields of the root.
local function chart_file(fields)
  return file_with([[
local rfsm = require "rfsm"
return rfsm.state {
  ]] .. (fields or "") .. [[
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
  rfsm.trans { src = "b", tgt = "a", events = { "e_back" } },
}
]])
end

local deployer

-- Lines of the log that hold `text`.
local function logged(text)
  local lines = {}
  for _, line in ipairs(standin.log) do
    if line:find(text, 1, true) then lines[#lines + 1] = line end
  end
  return lines
end

-- Connects ports to those of a component: what to write to, what to read from.
local function wire(component, events_name)
  local events, names = rtt.OutputPort("string"), rtt.InputPort("string")
  if events_name ~= false then
    assert(events:connect(component:getPort(events_name or "rFSM_events"), policy(16)))
  end
  assert(names:connect(component:getPort("rFSM_cur_fqn"), policy(16)))
  return events, names
end

-- A value of another Lua, as text: what its print says.
local function evaluate(exec_str, expression)
  local lines = helper.printed(function()
    exec_str("print(" .. expression .. ")")
  end)
  return lines[1]
end

-- Charts that cannot be launched: what they are, their text, what is said.
local WRONG_CHARTS = {
  { "is no chart", "return 3", "rfsm.load: no valid rfsm in file '%s' found." },
  { "raises", "error('no hardware', 0)", "no hardware" },
  { "raises a table", "error(setmetatable({}, { __tostring = function() "
    .. "return 'a table' end }))", "a table" },
  { "has problems", [[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state { entry = 3 },
  rfsm.trans { src = "initial", tgt = "aa" },
}]], "rfsm.init: the model has 2 problems\n"
    .. "  root.a.entry: function expected, got number 3\n"
    .. "  root.trans[1]: tgt 'aa': no state or connector is named 'aa' in 'root' "
    .. "(did you mean 'a'?)" },
  { "has one problem", [[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a", pn = "high" },
}]], "rfsm.init: the model has 1 problem\n"
    .. "  root.trans[1].pn: number expected, got string 'high'" },
}

-- Arguments that are wrong in `env`, and what is said.
local WRONG_ENVS = {
  { "env.go: string, number, boolean or a table of these expected, got function",
    function() return { go = print } end },
  { "env.t.x.2: string, number, boolean or a table of these expected, got thread",
    function()
      return { t = { x = { 1, coroutine.create(function() end) } } }
    end },
  { "env: names expected as keys, got number 1", function() return { "speed" } end },
  { "env: strings or numbers expected as keys, got boolean", function()
    return { [true] = 1 }
  end },
  { "env.t.t: a table that contains itself", function()
    local t = {}
    t.t = t
    return { t = t }
  end },
}

local ENV = {
  speed = 3.5, name = "it's\n\"quoted\" \\ 100%", is_fast = true, is_slow = false,
  list = { 1, 2, { x = { "y" } } }, count = 3, many = 1e300, never = math.huge,
}

local ENV_TEXT = "speed, name, is_fast, is_slow, list[2], list[3].x[1], count, many, "
  .. "never == math.huge"

local function env_values()
  return table.concat({
    "3.5", "it's\n\"quoted\" \\ 100%", "true", "false", "2", "y", "3",
    tostring(1e300), "true",
  }, " ")
end

-- Services ---------------------------------------------------------------------

describe("service_launch_rfsm", function()
  local host, exec_str

  before_each(function()
    deployer = rtt.getTC():getPeer("Deployer")
    deployer:import("ocl")
    deployer:loadComponent("arm", "OCL::HelloWorld")
    deployer:loadService("arm", "Lua")
    host = deployer:getPeer("arm")
    exec_str = host:provides("Lua"):getOperation("exec_str")
    host:start()
    standin.spin()
  end)

  local function update()
    host:trigger()
    standin.spin()
  end

  it("runs the machine at each update of its component", function()
    assert.is_true(rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true))
    local events, names = wire(host)
    assert.same({ "<none>" }, samples(names))
    update()
    assert.same({ "root.a" }, samples(names))
    events:write("e_go")
    assert.same({}, samples(names))
    update()
    assert.same({ "root.b" }, samples(names))
    write_all(events, "e_none", "e_back")
    update()
    update()
    assert.same({ "root.a" }, samples(names))
  end)

  it("does not let events trigger the component", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local events, names = wire(host)
    update()
    samples(names)
    events:write("e_go")
    standin.spin()
    assert.same({}, samples(names))
  end)

  it("leaves updates to the caller without eehook", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str)
    local _, names = wire(host)
    update()
    assert.same({ "<none>" }, samples(names))
    assert.equal("true", evaluate(exec_str, "rfsm_update()"))
    assert.same({ "root.a" }, samples(names))
  end)

  it("makes the machine a global of the service, and none here", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    assert.equal("true", evaluate(exec_str, "rfsm.is_initialized_root(fsm)"))
    for _, name in ipairs { "fsm", "rfsm_update", "rfsm_eehook" } do
      assert.is_nil(rawget(_G, name))
    end
  end)

  it("keeps the hook when garbage is collected", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local _, names = wire(host)
    collectgarbage()
    collectgarbage()
    update()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("lets the hook be disabled", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local events, names = wire(host)
    update()
    exec_str("rfsm_eehook:disable()")
    events:write("e_go")
    update()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("keeps the hook when a printer raises, and logs that", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    local events, names = wire(host)
    update()
    exec_str("fsm.dbg = function() error('no paper', 0) end")
    events:write("e_go")
    update()
    exec_str("fsm.dbg = false")
    events:write("e_back")
    update()
    assert.same({ "Error: rfsm_rtt: no paper" }, logged("no paper"))
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(names))
  end)

  it("lets the machine print to RTT's log", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
    exec_str("fsm.a.entry = function() error({}, 0) end")
    exec_str("fsm.warn('oil', 3, nil)")
    update()
    assert.same({ "Info: INFO: created undeclared connector root.initial" },
      logged("INFO"))
    assert.same({ "Warning: oil 3 nil" }, logged("oil"))
    assert.equal(1, #logged("Error: ENTRY error executing entry of root.a:  table"))
  end)

  it("leaves the printers of a chart alone", function()
    rfsm_rtt.service_launch_rfsm(chart_file("info = false, warn = print, err = print,"),
      exec_str, true)
    assert.same({}, standin.log)
    assert.equal("true", evaluate(exec_str, "fsm.warn == print and fsm.err == print"))
  end)

  it("defines env first, whatever is in it", function()
    rfsm_rtt.service_launch_rfsm(chart_file("data = { speed, name },"), exec_str, false,
      ENV)
    assert.equal(env_values(), evaluate(exec_str, ENV_TEXT))
    assert.equal("3.5", evaluate(exec_str, "fsm.data[1]"))
  end)

  it("sets no global of a module's name when env says so", function()
    rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true,
      { RFSM_NO_GLOBALS = true })
    assert.equal("nil nil true", evaluate(exec_str, "rfsm, rfsm_rtt, fsm ~= nil"))
  end)

  it("leaves events to a chart that has a getevents", function()
    rfsm_rtt.service_launch_rfsm(chart_file("getevents = function() return mail end,"),
      exec_str, true)
    assert.same({ "rFSM_cur_fqn" }, host:getPortNames())
    local _, names = wire(host, false)
    update()
    exec_str("mail = { 'e_go' }")
    update()
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
  end)

  it("finds the modules where the caller does", function()
    local before = package.path
    exec_str("package.path = '/nowhere/?.lua'")
    rfsm_rtt.service_launch_rfsm(file_with("return rfsm.state { a = rfsm.state {}, "
      .. "rfsm.trans { src = 'initial', tgt = 'a' } }"), exec_str)
    assert.equal("/nowhere/?.lua;" .. before, evaluate(exec_str, "package.path"))
  end)

  it("accepts a function in the place of the operation", function()
    local lua = require("spec.support.lua_state").new()
    lua.globals.rtt = rtt
    rfsm_rtt.service_launch_rfsm(chart_file(), function(code) assert(lua:run(code)) end)
    assert.equal("table", type(lua.globals.fsm))
  end)

  it("keeps two services apart", function()
    deployer:loadComponent("leg", "OCL::HelloWorld")
    deployer:loadService("leg", "Lua")
    local leg, chart_name = deployer:getPeer("leg"), chart_file()
    leg:start()
    rfsm_rtt.service_launch_rfsm(chart_name, exec_str, true)
    rfsm_rtt.service_launch_rfsm(chart_name,
      leg:provides("Lua"):getOperation("exec_str"), true)
    local events, names = wire(host)
    local _, names_of_leg = wire(leg)
    update()
    leg:trigger()
    events:write("e_go")
    update()
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    assert.same({ "<none>", "root.a" }, samples(names_of_leg))
  end)

  describe("refuses", function()
    local function refused(...)
      return refusal(rfsm_rtt.service_launch_rfsm, ...)
    end

    -- What the service and its component have, before and after.
    local function nothing_left()
      assert.same({}, host:getPortNames())
      assert.equal("nil nil nil nil",
        evaluate(exec_str, "fsm, rfsm_update, rfsm_eehook, speed"))
    end

    it("what is no file name", function()
      assert.equal("rfsm_rtt.service_launch_rfsm: file: file name expected, got nil",
        refused(nil, exec_str))
    end)

    it("a file that is not there", function()
      assert.equal("rfsm_rtt.service_launch_rfsm: file '/nowhere/x.lua': No such file "
        .. "or directory", refused("/nowhere/x.lua", exec_str))
    end)

    it("a file that is no Lua", function()
      local name = file_with("return {")
      local text = refused(name, exec_str)
      assert.equal("rfsm_rtt.service_launch_rfsm: file '" .. name .. "': ",
        text:match("^(.-': )"))
      assert.is_truthy(text:find(":1: ", 1, true))
      assert.same({}, standin.log)
    end)

    it("what is no operation", function()
      assert.equal("rfsm_rtt.service_launch_rfsm: exec_str: the operation exec_str "
        .. "expected, got nil (component:provides(\"Lua\"):getOperation(\"exec_str\") "
        .. "would be right)", refused(chart_file(), nil))
    end)

    it("an eehook that is no boolean", function()
      assert.equal("rfsm_rtt.service_launch_rfsm: eehook: boolean expected, got string "
        .. "'updateHook'", refused(chart_file(), exec_str, "updateHook"))
    end)

    it("an env that is no table", function()
      assert.equal("rfsm_rtt.service_launch_rfsm: env: table expected, got number 3",
        refused(chart_file(), exec_str, true, 3))
    end)

    for _, case in ipairs(WRONG_ENVS) do
      it("an env with " .. case[1], function()
        assert.equal("rfsm_rtt.service_launch_rfsm: " .. case[1],
          refused(chart_file(), exec_str, true, case[2]()))
        nothing_left()
      end)
    end

    for _, case in ipairs(WRONG_CHARTS) do
      it("a chart that " .. case[1], function()
        local name = file_with(case[2])
        local text = case[3]:gsub("%%s", (name:gsub("%%", "%%%%")))
        assert.equal("rfsm_rtt.service_launch_rfsm: " .. text,
          refused(name, exec_str, true, { speed = 3 }))
        nothing_left()
      end)
    end

    it("a port name that is in use, and leaves that port connected", function()
      local own, feed = rtt.InputPort("string"), rtt.OutputPort("string")
      host:addPort(own, "rFSM_events")
      feed:connect(own)
      assert.equal("rfsm_rtt.service_launch_rfsm: 'arm' has a port 'rFSM_events' "
        .. "already", refused(chart_file(), exec_str, true))
      assert.same({ "rFSM_events" }, host:getPortNames())
      assert.is_true(own:connected())
    end)

    it("a second machine in one service, and leaves the first alone", function()
      rfsm_rtt.service_launch_rfsm(chart_file(), exec_str, true)
      local _, names = wire(host)
      assert.equal("rfsm_rtt.service_launch_rfsm: a machine was launched here before, "
        .. "it is the global 'fsm'", refused(chart_file(), exec_str, true))
      update()
      assert.same({ "<none>", "root.a" }, samples(names))
    end)

    it("a Lua without RTT", function()
      local lua = require("spec.support.lua_state").new()
      local function execute(code) return (lua:run(code)) end
      assert.equal("rfsm_rtt.service_launch_rfsm: module 'rtt' is not there, this is "
        .. "no Lua of RTT", refused(chart_file(), execute))
      assert.is_nil(lua.globals.fsm)
    end)

    it("a Lua in which the hook cannot be made, and takes all back", function()
      exec_str("fsm = 'mine' rtt.EEHook = function() "
        .. "return { enable = function() error('no engine', 0) end } end")
      assert.equal("rfsm_rtt.service_launch_rfsm: no engine",
        refused(chart_file(), exec_str, true, { speed = 3 }))
      assert.same({}, host:getPortNames())
      assert.equal("mine nil nil nil",
        evaluate(exec_str, "fsm, rfsm_update, rfsm_eehook, speed"))
    end)

    it("an operation that fails and says nothing", function()
      assert.equal("rfsm_rtt.service_launch_rfsm: the other Lua reports a failure, "
        .. "RTT's log says which", refused(chart_file(), function() return false end))
    end)

    it("an operation that raises", function()
      assert.equal("rfsm_rtt.service_launch_rfsm: no connection",
        refused(chart_file(), function() error("no connection", 0) end))
    end)
  end)

  it("leaves no file behind", function()
    local names, real = {}, os.tmpname
    rawset(os, "tmpname", function()
      names[#names + 1] = real()
      return names[#names]
    end)
    pcall(rfsm_rtt.service_launch_rfsm, chart_file(), exec_str, true)
    pcall(rfsm_rtt.service_launch_rfsm, chart_file(), exec_str, true)
    rawset(os, "tmpname", real)
    assert.equal(4, #names) -- two charts, two reports
    assert.is_nil(io.open(names[2]))
    assert.is_nil(io.open(names[4]))
  end)
end)

-- Components -------------------------------------------------------------------

describe("component_launch_rfsm", function()
  before_each(function()
    deployer = rtt.getTC():getPeer("Deployer")
    deployer:import("ocl")
  end)

  -- Launches with these fields and the usual ones.
  local function launched(fields)
    local args = { name = "arm", deployer = deployer }
    for key, value in pairs(fields or {}) do args[key] = value end -- any order: a set
    args.fsmfile = args.fsmfile or chart_file()
    return rfsm_rtt.component_launch_rfsm(args)
  end

  it("loads and configures a component, and does not start it", function()
    local arm = launched()
    assert.equal("Stopped", arm:getState())
    assert.same({ "arm" }, deployer:getPeers())
    assert.same({ "rFSM_cur_fqn", "rFSM_events" }, arm:getPortNames())
    local _, names = wire(arm)
    standin.spin()
    assert.same({ "<none>" }, samples(names))
  end)

  it("enters the machine when it is started", function()
    local arm = launched()
    local _, names = wire(arm)
    assert.is_true(arm:start())
    standin.spin()
    assert.same({ "<none>", "root.a" }, samples(names))
  end)

  it("runs the machine when an event comes", function()
    local arm = launched()
    local events, names = wire(arm)
    arm:start()
    standin.spin()
    events:write("e_go")
    standin.spin()
    write_all(events, "e_back", "e_none")
    standin.spin()
    assert.same({ "<none>", "root.a", "root.b", "root.a" }, samples(names))
  end)

  it("runs it until nothing is left to do", function()
    local arm = launched { fsmfile = file_with [[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {}, c = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_done" } },
  rfsm.trans { src = "b", tgt = "c", events = { "e_done" } },
}]] }
    local _, names = wire(arm)
    arm:start()
    standin.spin()
    assert.same({ "<none>", "root.a", "root.b", "root.c" }, samples(names))
  end)

  it("runs with the period that the deployer gives it", function()
    local arm = launched()
    local events, names = wire(arm)
    assert.is_true(deployer:setActivity("arm", 0.01, 0, 0))
    arm:start()
    standin.advance(0.01)
    assert.same({ "<none>", "root.a" }, samples(names))
    events:write("e_go")
    standin.advance(0.009)
    assert.same({}, samples(names))
    standin.advance(0.001)
    assert.same({ "root.b" }, samples(names))
  end)

  it("lets time events pass on RTT's clock", function()
    local arm = launched {
      prefile = file_with("require('rfsm_timeevent').set_gettime_hook(rtt.getTime)"),
      fsmfile = file_with [[
return rfsm.state {
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(0.1)" } },
}]] }
    local _, names = wire(arm)
    deployer:setActivity("arm", 0.01, 0, 0)
    arm:start()
    standin.advance(0.11)
    assert.same({ "<none>", "root.a" }, samples(names))
    standin.advance(0.01)
    assert.same({ "root.b" }, samples(names))
  end)

  describe("with sync", function()
    it("is not triggered by events", function()
      local arm = launched { sync = true }
      local events, names = wire(arm)
      arm:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a" }, samples(names))
    end)

    it("takes one step at each update, however busy a doo is", function()
      local arm = launched { sync = true, fsmfile = file_with [[
return rfsm.state {
  a = rfsm.state { doo = function(fsm)
    for i = 1, 3 do
      fsm.cycles = i
      rfsm.yield()
    end
  end },
  b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_done" } },
}]] }
      local _, names = wire(arm)
      deployer:setActivity("arm", 0.01, 0, 0)
      arm:start()
      local cycles = {}
      for i = 1, 4 do
        standin.advance(0.01)
        cycles[i] = evaluate(arm:getOperation("exec_str"), "fsm.cycles")
      end
      assert.same({ "nil", "1", "2", "3" }, cycles)
      standin.advance(0.02)
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)

    it("serves a component that another one executes", function()
      local arm = launched { sync = true }
      local events, names = wire(arm)
      deployer:setSlaveActivity("arm", 0)
      arm:start()
      assert.is_true(arm:update())
      events:write("e_go")
      assert.is_true(arm:update())
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)
  end)

  describe("with ev_inport", function()
    it("as a name reads events from a port of that name", function()
      local arm = launched { ev_inport = "commands" }
      assert.same({ "rFSM_cur_fqn", "commands" }, arm:getPortNames())
      local events, names = wire(arm, "commands")
      arm:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
    end)

    it("false has no port for events", function()
      assert.same({ "rFSM_cur_fqn" }, launched { ev_inport = false }:getPortNames())
    end)

    it("not given leaves events to a chart that has a getevents", function()
      local arm = launched { fsmfile = chart_file "getevents = function() end," }
      assert.same({ "rFSM_cur_fqn" }, arm:getPortNames())
    end)

    it("true has the port, and the chart's getevents is asked first", function()
      local arm = launched { ev_inport = true, fsmfile = file_with [[
return rfsm.state {
  getevents = function()
    local events = mail
    mail = nil
    return events
  end,
  dbg = function(id, event) if id == "RAISED" then print(event) end end,
  a = rfsm.state { doo = function() while true do rfsm.yield(true) end end },
  rfsm.trans { src = "initial", tgt = "a" },
}]] }
      local events = wire(arm)
      arm:start()
      standin.spin()
      arm:getOperation("exec_str")("mail = { 'e_1', nil, 'e_3' }")
      local lines = helper.printed(function()
        write_all(events, "e_4", "e_5")
        standin.spin()
      end)
      assert.equal("e_1", lines[1])
      assert.same({ "e_4", "e_5" }, { lines[#lines - 1], lines[#lines] })
    end)
  end)

  describe("with further files", function()
    it("runs prefile before the chart, postfile after, and env before all", function()
      local arm = launched {
        env = { words = "env" }, prefile = file_with "words = words .. ' prefile'",
        postfile = file_with "words = words .. ' postfile ' .. fsm.words",
        fsmfile = chart_file "words = words .. ' chart',",
      }
      assert.equal("env prefile postfile env prefile chart",
        evaluate(arm:getOperation("exec_str"), "words"))
    end)

    it("lets postfile set up the machine", function()
      local arm = launched { postfile = file_with [[
fsm.b.entry = function() print("in b") end
]] }
      local events = wire(arm)
      arm:start()
      standin.spin()
      events:write("e_go")
      assert.same({ "in b" }, helper.printed(standin.spin))
    end)

    it("lets them define further hooks of the component", function()
      local prefile = file_with "function startHook() return false end"
      local arm = launched { prefile = prefile }
      assert.is_false(arm:start())
    end)
  end)

  it("finds the deployer itself, or by the name of a peer", function()
    local args = { name = "arm", fsmfile = chart_file() }
    assert.equal("arm", rfsm_rtt.component_launch_rfsm(args):getName())
    args.name, args.deployer = "leg", "Deployer"
    assert.equal("leg", rfsm_rtt.component_launch_rfsm(args):getName())
  end)

  it("loads a component of the type asked for", function()
    local types, real = {}, deployer.operations.loadComponent.f
    deployer.operations.loadComponent.f = function(name, luatype)
      types[#types + 1] = luatype
      return real(name, luatype)
    end
    launched()
    launched { name = "leg", luatype = "OCL::LuaTLSFComponent" }
    assert.same({ "OCL::LuaComponent", "OCL::LuaTLSFComponent" }, types)
  end)

  it("touches no global here", function()
    launched { env = { speed = 3 } }
    for _, name in ipairs { "fsm", "updateHook", "configureHook", "cleanupHook",
      "speed" } do
      assert.is_nil(rawget(_G, name))
    end
  end)

  it("logs what a printer raises, and goes on", function()
    local arm = launched()
    local events, names = wire(arm)
    arm:start()
    standin.spin()
    arm:getOperation("exec_str")("fsm.dbg = function() error('no paper', 0) end")
    events:write("e_go")
    standin.spin()
    assert.same({ "Error: rfsm_rtt: no paper" }, logged("no paper"))
    assert.same({ "<none>", "root.a", "root.b" }, samples(names))
  end)

  describe("a component launched so", function()
    it("goes on where it was when it is stopped and started", function()
      local arm = launched()
      local events, names = wire(arm)
      arm:start()
      standin.spin()
      arm:stop()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a" }, samples(names))
      arm:start()
      standin.spin()
      assert.same({ "root.b" }, samples(names))
    end)

    it("has no ports and no machine after cleanup", function()
      local arm = launched()
      arm:cleanup()
      assert.same({}, arm:getPortNames())
      assert.equal("nil", evaluate(arm:getOperation("exec_str"), "fsm"))
    end)

    it("has a fresh machine when it is configured again", function()
      local arm = launched()
      local events = wire(arm)
      arm:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      arm:stop()
      arm:cleanup()
      assert.is_true(arm:configure())
      local _, names = wire(arm)
      arm:start()
      standin.spin()
      assert.same({ "<none>", "root.a" }, samples(names))
    end)

    it("has one set of ports when it is configured twice in a row", function()
      local arm = launched()
      assert.is_true(arm:configure())
      assert.same({ "rFSM_cur_fqn", "rFSM_events" }, arm:getPortNames())
      assert.same({}, logged("Warning: 'addPort'"))
    end)

    it("is not configured again when its chart has gone wrong meanwhile", function()
      local name = chart_file()
      local arm = launched { fsmfile = name }
      local file = assert(io.open(name, "w"))
      file:write("error('edited', 0)")
      file:close()
      assert.is_false(arm:configure())
      assert.equal("PreOperational", arm:getState())
      assert.same({ "Error: rfsm_rtt: edited" }, logged("edited"))
      assert.same({}, arm:getPortNames())
    end)

    it("leaves a model that others use as it was", function()
      local arm = launched {
        prefile = file_with [[
package.preload.model = package.preload.model or function()
  return rfsm.state { a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" } }
end]],
        fsmfile = file_with "return require 'model'",
      }
      local exec_str = arm:getOperation("exec_str")
      assert.equal("nil nil nil", evaluate(exec_str,
        "require('model').err, require('model').warn, require('model').info"))
      arm:configure()
      exec_str("fsm.a.entry = function() error('no oil', 0) end")
      arm:start()
      standin.spin()
      assert.equal(1, #logged("no oil"))
    end)

    it("bears a clean-up of its ports by others", function()
      local arm = launched { postfile = file_with [[
function cleanupHook() -- as rttlib.tc_cleanup does
  local component = rtt.getTC()
  for _, name in ipairs(component:getPortNames()) do
    local port = component:getPort(name)
    component:removePort(name)
    port:delete()
  end
end]] }
      arm:cleanup()
      assert.same({}, arm:getPortNames())
      assert.is_true(arm:configure())
      assert.same({ "rFSM_cur_fqn", "rFSM_events" }, arm:getPortNames())
      assert.same({}, logged("Error"))
    end)

    it("does nothing in updates when its configureHook was replaced", function()
      local arm = launched()
      arm:cleanup()
      arm:getOperation("exec_str")("function configureHook() return true end")
      arm:configure()
      arm:start()
      standin.spin()
      assert.same({}, logged("Error"))
    end)

    it("can be unloaded, and its name used again", function()
      launched()
      assert.is_true(deployer:unloadComponent("arm"))
      assert.equal("Stopped", launched():getState())
    end)

    it("shares nothing with another one of the same chart", function()
      local name = chart_file()
      local arm = launched { fsmfile = name }
      local leg = launched { fsmfile = name, name = "leg" }
      local events, names = wire(arm)
      local _, names_of_leg = wire(leg)
      arm:start()
      leg:start()
      standin.spin()
      events:write("e_go")
      standin.spin()
      assert.same({ "<none>", "root.a", "root.b" }, samples(names))
      assert.same({ "<none>", "root.a" }, samples(names_of_leg))
    end)

    it("makes no Variable in the steady state", function()
      local arm = launched()
      local events = wire(arm)
      arm:start()
      standin.spin()
      assert.equal(0, counting_variables(function()
        for _ = 1, 10 do
          write_all(events, "e_go", "e_none")
          standin.spin()
          events:write("e_back")
          standin.spin()
        end
      end))
    end)
  end)

  describe("refuses", function()
    -- The text, with what every text begins with taken off; and nothing is left.
    local function refused(args)
      local before = deployer:getPeers()
      local text = refusal(rfsm_rtt.component_launch_rfsm, args)
      assert.same(before, deployer:getPeers())
      return (text:gsub("^rfsm_rtt%.component_launch_rfsm: ", ""))
    end

    local function refused_with(fields)
      local args = { name = "arm", deployer = deployer, fsmfile = chart_file() }
      for key, value in pairs(fields) do args[key] = value end -- any order: a set
      local text = refused(args)
      assert.same({}, deployer:getPeers())
      return text
    end

    it("what is no table", function()
      assert.equal("table expected, got nil", refused(nil))
      assert.equal("table expected, got string 'arm'", refused("arm"))
    end)

    it("fields that are missing", function()
      assert.equal("name: string expected, got nil", refused {})
      assert.equal("fsmfile: file name expected, got nil", refused { name = "arm" })
    end)

    local FIELDS = {
      { { name = "" }, "name: string expected, got string ''" },
      { { name = 3 }, "name: string expected, got number 3" },
      { { fsm_file = "x" }, "unknown field 'fsm_file' (did you mean 'fsmfile'?)" },
      { { evinport = "x", zzzzzz = 1 },
        "unknown field 'evinport' (did you mean 'ev_inport'?)" },
      { { "arm" }, "unknown field '1'" },
      { { luatype = true }, "luatype: string expected, got boolean" },
      { { sync = "yes" }, "sync: boolean expected, got string 'yes'" },
      { { ev_inport = 3 }, "ev_inport: name for a port, or boolean, expected, got "
        .. "number 3" },
      { { ev_inport = "rFSM_cur_fqn" }, "ev_inport: name for a port, or boolean, "
        .. "expected, got string 'rFSM_cur_fqn'" },
      { { prefile = 1 }, "prefile: file name expected, got number 1" },
      { { fsmfile = "/nowhere/x.lua" },
        "fsmfile '/nowhere/x.lua': No such file or directory" },
      { { prefile = "/nowhere/x.lua" },
        "prefile '/nowhere/x.lua': No such file or directory" },
      { { postfile = "/nowhere/x.lua" },
        "postfile '/nowhere/x.lua': No such file or directory" },
      { { env = 3 }, "env: table expected, got number 3" },
      { { deployer = 3 }, "deployer: a component with the operation loadComponent "
        .. "expected, got number 3" },
      { { deployer = {} }, "deployer: a component with the operation loadComponent "
        .. "expected, got table" },
      { { deployer = "Deplyer" }, "deployer: 'lua' has no peer 'Deplyer' (did you mean "
        .. "'Deployer'?)" },
    }
    for _, case in ipairs(FIELDS) do
      it("fields that are wrong: " .. case[2], function()
        assert.equal(case[2], refused_with(case[1]))
        assert.same({}, standin.log)
      end)
    end

    for _, case in ipairs(WRONG_ENVS) do
      it("an env with " .. case[1], function()
        assert.equal(case[1], refused_with { env = case[2]() })
      end)
    end

    for _, case in ipairs(WRONG_CHARTS) do
      it("a chart that " .. case[1], function()
        local name = file_with(case[2])
        local text = case[3]:gsub("%%s", (name:gsub("%%", "%%%%")))
        assert.equal("'arm': " .. text, refused_with { fsmfile = name })
        assert.equal(1, #logged("Error"))
      end)
    end

    it("a prefile or postfile that raises", function()
      assert.equal("'arm': no gripper",
        refused_with { prefile = file_with "error('no gripper', 0)" })
      assert.equal("'arm': no gripper",
        refused_with { postfile = file_with "error('no gripper', 0)" })
    end)

    it("a port name that prefile has used", function()
      assert.equal("'arm': 'arm' has a port 'rFSM_events' already",
        refused_with { prefile = file_with
          "rtt.getTC():addPort(rtt.InputPort('string'), 'rFSM_events')" })
    end)

    it("a name that a component has, and leaves that one alone", function()
      local arm = launched()
      assert.equal("'arm': the deployer has a component of this name already",
        refused { name = "arm", deployer = deployer, fsmfile = chart_file() })
      assert.same({ "arm" }, deployer:getPeers())
      assert.is_true(arm:start())
    end)

    it("a type that the deployer does not know", function()
      assert.equal("'arm': the deployer does not load a component of type 'OCL::Lua' "
        .. "(is 'ocl' imported?), RTT's log says why",
        refused_with { luatype = "OCL::Lua" })
    end)

    it("a type without Lua", function()
      assert.equal("'arm': it has no operation exec_str, a luatype with Lua in it "
        .. "expected", refused_with { luatype = "OCL::HelloWorld" })
    end)

    it("a deployer that loads what is no peer then", function()
      deployer.operations.loadComponent.f = function() return true end
      assert.equal("'arm': the deployer loads it, but is no peer of it (and the "
        .. "deployer does not unload the component)", refused_with {})
    end)

    it("a component that does not configure, for reasons of its own", function()
      local real = deployer.operations.loadComponent.f
      deployer.operations.loadComponent.f = function(...)
        real(...)
        rawset(deployer:getPeer("arm"), "configure", function() return false end)
        return true
      end
      assert.equal("'arm': the other Lua reports a failure, RTT's log says which",
        refused_with {})
    end)
  end)
end)

-- Without RTT --------------------------------------------------------------------

describe("without RTT", function()
  before_each(function() package.loaded.rtt = nil end)
  after_each(function() package.loaded.rtt = rtt end)

  it("the search for a deployer says what is missing", function()
    assert.equal("rfsm_rtt.component_launch_rfsm: deployer: to look for a peer "
      .. "'Deployer' takes RTT, but module 'rtt' is not there",
      refusal(rfsm_rtt.component_launch_rfsm, { name = "arm", fsmfile = chart_file() }))
  end)

  it("a launch into this very Lua says what is missing", function()
    local load_text = rawget(_G, "loadstring") or rawget(_G, "load")
    assert.equal("rfsm_rtt.service_launch_rfsm: module 'rtt' is not there, this is no "
      .. "Lua of RTT", refusal(rfsm_rtt.service_launch_rfsm, chart_file(),
      function(code) assert(load_text(code))() end))
    assert.is_nil(rawget(_G, "fsm"))
  end)

  it("the global rtt of a rttlua serves as well", function()
    rawset(_G, "rtt", rtt)
    local into, out = connected("string")
    out:write("e_a")
    local variables = counting_variables(function()
      assert.same({ "e_a" }, rfsm_rtt.gen_read_events(into)())
    end)
    rawset(_G, "rtt", nil)
    assert.equal(1, variables)
  end)
end)

describe("examples/hosts/rtt_host.lua", function()
  -- Runs it with these modules named rtt; returns what it printed.
  local function output_with(module)
    local path = package.path
    package.loaded.rtt = module
    local lines = helper.printed(function() dofile("examples/hosts/rtt_host.lua") end)
    package.loaded.rtt, package.path = rtt, path
    return lines
  end

  local EXPECTED = {
    "fingers open", "gripper: <none>", "gripper: root.open",
    "fingers closing", "gripper: root.closing",
    "motor holds", "gripper: root.holding",
    "motor off", "fingers open", "gripper: root.open",
  }

  it("launches a component and drives it through ports", function()
    assert.same(EXPECTED, output_with(rtt))
  end)

  it("leaves no component and no port", function()
    output_with(rtt)
    assert.same({}, rtt.getTC():getPortNames())
    assert.same({}, rtt.getTC():getPeer("Deployer"):getPeers())
  end)

  it("says so when it runs on the stand-in", function()
    local lines = output_with(nil)
    assert.equal("RTT is not here, its stand-in is used: spec/support/rtt.lua",
      table.remove(lines, 1))
    assert.same(EXPECTED, lines)
  end)
end)

-- The stand-in ---------------------------------------------------------------------
--
-- What it has in common with the real one and a careless user of RTT would not expect.

describe("the stand-in for RTT", function()
  it("returns a value with NoData and OldData, and only a status for a Variable",
    function()
      local into, out = connected("string")
      assert.same({ "NoData", "" }, { into:read() })
      local var = rtt.Variable("string", "before")
      assert.same({ "NoData" }, { into:read(var) })
      assert.equal("before", var:tolua())
      out:write("e_a")
      assert.same({ "NewData" }, { into:read(var) })
      assert.equal("e_a", var:tolua())
      assert.same({ "OldData", "e_a" }, { into:read() })
    end)

  it("reads nothing into a Variable of another type, and logs that", function()
    local into, out = connected("string")
    out:write("e_a")
    assert.equal("NoData", into:read(rtt.Variable("int")))
    assert.equal(1, #logged("incompatible"))
  end)

  it("writes the first argument only", function()
    local into, out = connected("string")
    out:write("e_a", "e_b")
    assert.same({ "e_a" }, samples(into))
  end)

  it("copies what is written", function()
    local into, out = connected("Pose")
    local var = pose(1, 2)
    out:write(var)
    var.x = 3
    assert.equal(1, samples(into)[1].x)
  end)

  it("keeps the last sample without a buffer, the first ones in a full one", function()
    local out, data = rtt.OutputPort("string"), rtt.InputPort("string")
    local buffer, ring = rtt.InputPort("string"), rtt.InputPort("string")
    out:connect(data)
    out:connect(buffer, policy(2))
    out:connect(ring, policy(2, 2))
    write_all(out, "e_a", "e_b", "e_c")
    assert.same({ "e_c" }, samples(data))
    assert.same({ "e_a", "e_b" }, samples(buffer))
    assert.same({ "e_b", "e_c" }, samples(ring))
  end)

  it("replaces and disconnects a port whose name is used again", function()
    local component = rtt.getTC()
    local into, out = connected("string")
    component:addPort(into, "events")
    component:addPort(rtt.InputPort("string"), "events")
    assert.is_false(out:connected())
    assert.same({ "events" }, component:getPortNames())
    assert.equal(1, #logged("name already in use"))
  end)

  it("returns false when code fails, and logs why", function()
    local tc = rtt.getTC():getPeer("Deployer")
    tc:import("ocl")
    tc:loadComponent("arm", "OCL::LuaComponent")
    local exec_str = tc:getPeer("arm"):getOperation("exec_str")
    assert.is_true(exec_str("x = 1"))
    assert.is_false(exec_str("error('boom', 0)"))
    assert.is_false(exec_str("x ="))
    assert.same({ "Error: LuaComponent 'arm': boom" }, logged("boom"))
  end)

  describe("in a component", function()
    local arm, exec_str

    before_each(function()
      deployer = rtt.getTC():getPeer("Deployer")
      deployer:import("ocl")
      deployer:loadComponent("arm", "OCL::LuaComponent")
      arm = deployer:getPeer("arm")
      exec_str = arm:getOperation("exec_str")
    end)

    it("removes a hook that does not return true", function()
      exec_str("n = 0 function count() n = n + 1 end hook = rtt.EEHook('count') "
        .. "hook:enable()")
      for _ = 1, 3 do
        arm:trigger()
        standin.spin()
      end
      assert.equal("1", evaluate(exec_str, "n"))
    end)

    it("collects a hook that nobody holds", function()
      exec_str("n = 0 function count() n = n + 1 return true end "
        .. "rtt.EEHook('count'):enable()")
      collectgarbage()
      collectgarbage()
      arm:trigger()
      standin.spin()
      assert.equal("0", evaluate(exec_str, "n"))
    end)

    it("wants a boolean of configureHook", function()
      exec_str("function configureHook() end")
      assert.is_false(arm:configure())
      assert.same({ "Error: LuaComponent 'arm': configureHook must return a bool but "
        .. "returned a nil" }, logged("configureHook"))
    end)

    it("keeps its Lua to itself", function()
      exec_str("rfsm = 3 string.rep = 3 package.loaded.io = 3")
      assert.is_function(string.rep)
      assert.equal(io, package.loaded.io)
      assert.equal("arm", evaluate(exec_str, "rtt.getTC():getName()"))
    end)

    it("does not change the activity of one that runs", function()
      arm:configure()
      arm:start()
      assert.is_false(deployer:setActivity("arm", 0.1, 0, 0))
      assert.is_false(deployer:unloadComponent("arm"))
    end)

    it("has properties", function()
      arm:addProperty(rtt.Property("double", "speed", "in m/s"))
      arm:getProperty("speed"):set(2)
      assert.same({ "speed" }, arm:getPropertyNames())
      assert.equal(2, arm:getProperty("speed"):get())
    end)
  end)

  it("raises for what is not there", function()
    local tc = rtt.getTC()
    for _, f in ipairs {
      function() tc:getPeer("nobody") end, function() tc:getPort("none") end,
      function() tc:getOperation("none") end, function() tc:noSuchOperation() end,
      function() tc:provides("Lua"):getOperation("exec_str") end,
      function() rtt.Variable("nonsense") end, function() rtt.InputPort("nonsense") end,
    } do
      assert.is_false((pcall(f)))
    end
  end)
end)
