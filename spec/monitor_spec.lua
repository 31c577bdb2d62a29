-- The monitor state.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local monitor = require "rfsm.monitor"

local state, trans = rfsm.state, rfsm.trans
local gen = monitor.gen_monitor_state

-- (initial) -> watch --e_low--> low --e_back--> watch
local function around(fields)
  return helper.init(state {
    watch = gen(fields), low = state {},
    trans { src = "initial", tgt = "watch" },
    trans { src = "watch", tgt = "low", events = { "e_low" } },
    trans { src = "low", tgt = "watch", events = { "e_back" } },
  })
end

local function yes() return true end

describe("gen_monitor_state", function()
  it("calls each function in each cycle, sorted by event, and is not idle", function()
    local trace, montab = {}, {}
    for _, event in ipairs { "e_c", "e_a", 10, "e_b", 9 } do
      montab[event] = helper.noting(trace, event)
    end
    assert.is_false(rfsm.step(around { montab = montab }, 3))
    assert.same({ 9, 10, "e_a", "e_b", "e_c", 9, 10, "e_a", "e_b", "e_c" }, trace)
    assert.is_false(rfsm.step(around { montab = {} }, 20))
  end)

  it("calls them with the machine and the state, and sends the event if one is true",
    function()
      local name, voltage = nil, 12
      local fsm = around { montab = { e_low = function(machine, self)
        name = machine._fqn .. " " .. self._fqn
        return voltage < 11
      end } }
      rfsm.step(fsm, 5)
      assert.equal("root root.watch root.watch", name .. " "
        .. rfsm.get_actleaf_fqn(fsm))
      voltage = 10
      assert.equal("root.low", helper.leaf_after(fsm))
    end)

  for field, sent in pairs { -- any order: each is a spec of its own
    none = { "e_x", "e_y" }, break_first = { "e_x" }, breakfirst = { "e_x" },
  } do
    it("sends all events of a cycle, or the first, with the field " .. field, function()
      local fsm = around { montab = { e_x = yes, e_y = yes }, [field] = true }
      rfsm.step(fsm, 2)
      assert.same(sent, fsm._intq)
    end)
  end

  it("keeps entry, exit and the user's data", function()
    local trace = {}
    local fsm = around {
      montab = { e_low = yes }, unit = "volt",
      entry = helper.noting(trace, "entry"), exit = helper.noting(trace, "exit"),
    }
    rfsm.run(fsm)
    assert.same({ "entry", "exit", "volt" }, { trace[1], trace[2], fsm.watch.unit })
  end)

  it("blames the caller", function()
    for text, fields in pairs { -- any order: each stands alone
      ["montab: table of functions by event expected, got nil"] = {},
      ["montab: function expected for event 'e_x', got boolean"] =
        { montab = { e_x = true } },
      ["doo: is the state's own, and cannot be set"] = { montab = {}, doo = print },
    } do
      assert.equal("rfsm.monitor.gen_monitor_state: " .. text,
        helper.refusal(gen, fields))
    end
    assert.equal("rfsm.monitor.gen_monitor_state: table expected, got nil",
      helper.refusal(gen))
  end)
end)

it("rfsm.monitor has the seqand of the core, and no other field", function()
  assert.equal(rfsm.seqand, monitor.seqand)
  assert.is_nil(monitor.seq)
end)

it("monitor states agree with counting, on random charts", function()
  assert.is_nil(share.problem(require "spec.support.claims.monitor", 40))
end)
