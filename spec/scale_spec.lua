local helper = require "spec.helper"
local measure = require "bench.measure"
local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

-- root.s.s.s ..., `levels` deep, each composite with an initial transition.
local function nested(levels)
  local model = state {}
  for _ = 1, levels do
    model = state { s = model, trans { src = "initial", tgt = "s" } }
  end
  return model
end

-- A ring of `size` leaves.
local function ring(size)
  local model = state { trans { src = "initial", tgt = "s1" } }
  local function program() end
  for i = 1, size do
    model["s" .. i] = state { entry = program, exit = program }
    model[i + 1] = trans {
      src = "s" .. i, tgt = "s" .. i % size + 1, events = { "e_" .. i },
    }
  end
  return model
end

describe("a machine", function()
  it("keeps at most seven times the memory of its model", function()
    local ours = measure.bytes_kept(function() return helper.init(ring(1000)) end, 2)
    local copy = measure.bytes_kept(function() return ring(1000) end, 2)
    -- the model is kept as well
    assert.is_true(ours / copy < 1 + 7, ("%.2f times"):format(ours / copy - 1))
  end)

  -- What is made while it runs, such as paths, hangs on the machine.
  it("of 20 states keeps at most 30 KiB, after each was active 80 KiB", function()
    local model = ring(20)
    local first = helper.init(model)
    local fresh = measure.bytes_kept(function() return helper.init(model) end, 20)
    local used = measure.bytes_kept(function()
      local fsm = helper.init(model)
      rfsm.run(fsm)
      for i = 1, 20 do helper.post_and_run(fsm, "e_" .. i) end
      return fsm
    end, 20)
    assert.is_true(fresh <= 30 * 1024, ("%.0f bytes"):format(fresh))
    assert.is_true(used <= 80 * 1024, ("%.0f bytes"):format(used))
    assert.equal("root", first._fqn)
  end)

  it("nests 200 levels deep", function()
    local trace, fsm = helper.traced(nested(200))
    rfsm.run(fsm)
    assert.equal(201, #rfsm.get_active_conf(fsm))
    helper.clear(trace)
    rfsm.exit_state(fsm, fsm)
    assert.equal(200, #trace)
    assert.equal("exit root" .. (".s"):rep(200), trace[1])
  end)

  it("nests 1,500 levels deep, with a path from connector to connector", function()
    local fsm = helper.init(nested(1500))
    rfsm.run(fsm)
    assert.equal(1501, #rfsm.get_active_conf(fsm))
    local length, path = 0, rfsm.node_find_enabled(fsm, fsm.initial, { "e" })
    while path.nextl do
      length, path = length + 1, path.nextl[1].next
    end
    assert.equal(1500, length)
    rfsm.reset(fsm)
    fsm.initial._parent.s[1].guard = function() return false end
    assert.is_false(rfsm.node_find_enabled(fsm, fsm.initial, { "e" }))
  end)

  it("runs 200,000 doo cycles in one call without growing", function()
    local left = 200000
    local fsm = helper.init(state {
      a = state {
        doo = function()
          while left > 0 do
            left = left - 1
            rfsm.yield()
          end
        end,
      },
      trans { src = "initial", tgt = "a" },
    })
    rfsm.step(fsm, 20000) -- LuaJIT: what it compiles counts as memory
    collectgarbage()
    collectgarbage()
    local before = collectgarbage("count")
    assert.is_true(rfsm.run(fsm))
    collectgarbage()
    collectgarbage()
    assert.equal(0, left)
    assert.is_true(collectgarbage("count") - before < 64)
  end)

  it("takes an event storm in one step", function()
    local fsm = helper.init(state {
      a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = "e_last" },
    })
    rfsm.run(fsm)
    for i = 1, 100000 do rfsm.send_events(fsm, i) end
    helper.post_and_run(fsm, "e_last")
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("copies a long linked list of the user's data without recursion", function()
    local list
    for _ = 1, 100000 do list = { next = list } end
    local fsm = helper.init(state { list = list })
    local length, node = 0, fsm.list
    while node do
      length, node = length + 1, node.next
    end
    assert.equal(100000, length)
  end)
end)
