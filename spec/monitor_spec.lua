-- The monitor state.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local monitor = require "rfsm.monitor"

local state, trans = rfsm.state, rfsm.trans

-- (initial) -> watch --e_low--> low --e_back--> watch
local function around(watch)
  return helper.init(state {
    watch = watch, low = state {},
    trans { src = "initial", tgt = "watch" },
    trans { src = "watch", tgt = "low", events = { "e_low" } },
    trans { src = "low", tgt = "watch", events = { "e_back" } },
  })
end

local function new_monitor(fields) return monitor.gen_monitor_state(fields) end

describe("gen_monitor_state", function()
  it("calls each function in each cycle, sorted by event", function()
    local trace, montab = {}, {}
    for _, event in ipairs { "e_c", "e_a", 10, "e_b", 9 } do
      montab[event] = function() trace[#trace + 1] = event end
    end
    local fsm = around(new_monitor { montab = montab })
    rfsm.step(fsm, 3)
    assert.same({ 9, 10, "e_a", "e_b", "e_c", 9, 10, "e_a", "e_b", "e_c" }, trace)
  end)

  it("calls them with the machine and the state", function()
    local name
    local fsm = around(new_monitor { montab = { e_low = function(machine, self)
      name = machine._fqn .. " " .. self._fqn
    end } })
    rfsm.step(fsm, 2)
    assert.equal("root root.watch", name)
  end)

  it("sends the event where a function returns a true value", function()
    local voltage = 12
    local function is_low() return voltage < 11 end
    local fsm = around(new_monitor { montab = { e_low = is_low } })
    rfsm.step(fsm, 5)
    assert.equal("root.watch", rfsm.get_actleaf_fqn(fsm))
    voltage = 10
    rfsm.run(fsm)
    assert.equal("root.low", rfsm.get_actleaf_fqn(fsm))
  end)

  it("is not idle", function()
    local fsm = around(new_monitor { montab = {} })
    assert.is_false(rfsm.step(fsm, 20))
  end)

  local function yes() return true end

  it("sends all events of a cycle", function()
    local fsm = around(new_monitor { montab = { e_x = yes, e_y = yes } })
    rfsm.step(fsm, 2)
    assert.same({ "e_x", "e_y" }, fsm._intq)
  end)

  for _, field in ipairs { "break_first", "breakfirst" } do
    it("sends only the first when " .. field .. " is set", function()
      local montab = { e_x = yes, e_y = yes }
      local fsm = around(new_monitor { montab = montab, [field] = true })
      rfsm.step(fsm, 2)
      assert.same({ "e_x" }, fsm._intq)
    end)
  end

  it("keeps entry, exit and the user's data", function()
    local trace = {}
    local function note(_, _, what) trace[#trace + 1] = what end
    local fsm = around(new_monitor {
      montab = { e_low = yes }, entry = note, exit = note, unit = "volt",
    })
    rfsm.run(fsm)
    assert.same({ "entry", "exit", "volt" }, { trace[1], trace[2], fsm.watch.unit })
  end)

  local CASES = {
    { "table expected, got nil", nil },
    { "montab: table of functions by event expected, got nil", {} },
    { "montab: function expected for event 'e_x', got boolean",
      { montab = { e_x = true } } },
    { "doo: is the state's own, and cannot be set", { montab = {}, doo = print } },
  }
  for _, case in ipairs(CASES) do
    it("blames the caller: " .. case[1], function()
      local _, text = pcall(function() return (monitor.gen_monitor_state(case[2])) end)
      local place, message = text:match("^(.-:%d+): (.*)$")
      assert.matches("monitor_spec.lua", place)
      assert.equal("rfsm.monitor.gen_monitor_state: " .. case[1], message)
    end)
  end
end)

describe("rfsm.monitor", function()
  it("has seqand, which is that of the core", function()
    assert.equal(rfsm.seqand, monitor.seqand)
  end)

  it("has no other field", function() assert.is_nil(monitor.seq) end)
end)
