-- Systems: what callbacks emit, wires, moves, checks of a description, examples, and
-- the simulator.

local commands = require "spec.support.commands"
local charts = require "rfsm.shared.chart"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local system = require "rfsm.system"
local wires = require "rfsm.system.wires"
require "rfsm_seqand"

-- (initial) -> a, with more members.
local function chart(members)
  members.info, members.warn, members.a = false, false, members.a or rfsm.state {}
  members[#members + 1] = rfsm.trans { src = "initial", tgt = "a" }
  return rfsm.state(members)
end

-- A chart that emits these events when it is entered.
local function emitter(...)
  local list = { ... }
  return chart { a = rfsm.state { entry = function(fsm)
    for _, event in ipairs(list) do fsm.emit(event) end
  end } }
end

-- (initial) -> a --e_go--> b --e_go--> c
local function reader()
  return chart {
    b = rfsm.state {}, c = rfsm.state {},
    rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
    rfsm.trans { src = "b", tgt = "c", events = { "e_go" } },
  }
end

local function leaves(cell)
  local list = {}
  for i, name in ipairs(cell.names) do
    local leaf = rfsm.get_actleaf_fqn(cell.machines[name]) or "<none>"
    list[i] = name .. " " .. leaf:gsub("^root%.", "")
  end
  return table.concat(list, ", ")
end

-- A cell in which `from` emits events to the reader `to`, by a wire with these fields.
local function pair(wire, ...)
  wire.from, wire.event, wire.to = "from", "e_go", "to"
  return system { from = emitter(...), to = reader(), wires = { wire } }
end

describe("fsm.emit", function()
  it("does nothing in a plain program", function()
    local fsm = helper.init(emitter("e_x"))
    assert.is_true(rfsm.run(fsm))
    assert.equal("emit: name expected, got nil", helper.refusal(fsm.emit))
  end)

  it("calls a host, also from a region, in place of a field of the chart", function()
    local trace = {}
    local fsm = helper.init(chart {
      emit = function() error("the chart's own") end,
      a = rfsm.seqand { left = emitter("e_left"), entry = function(machine)
        machine.emit("e_own", 7)
      end },
    })
    rfsm.set_emit(fsm, function(name, data)
      trace[#trace + 1] = name .. " " .. tostring(data)
    end)
    rfsm.run(fsm)
    assert.same({ "e_own 7", "e_left nil" }, trace)
  end)

  it("calls the host also from regions that are merged later, at any depth", function()
    local names = {}
    local fsm = helper.init(chart { a = rfsm.seqand {
      left = chart { a = rfsm.state {} } } })
    rfsm.set_emit(fsm, function(name) names[#names + 1] = name end)
    local left = fsm.a.substates.left
    local region = chart { a = rfsm.seqand { inner = emitter("e_inner") } }
    assert(rfsm.fsm_merge(left, left, rfsm.seqand { region = region }, "par"))
    assert(rfsm.fsm_merge(left, left, rfsm.trans { src = "a", tgt = "par" }))
    rfsm.run(fsm)
    rfsm.run(fsm)
    assert.same({ "e_inner" }, names)
  end)

  it("leaves a state of that name alone", function()
    local fsm = helper.init(chart { emit = rfsm.state {} })
    rfsm.set_emit(fsm, print)
    assert.equal("root.emit", fsm.emit._fqn)
  end)

  it("needs a machine", function()
    assert.equal("rfsm.set_emit: initialised fsm expected, got nil",
      helper.refusal(rfsm.set_emit))
  end)
end)

describe("a wire", function()
  -- Puts events into a queue; returns it as text, and whether each was put.
  local function filled(wire, ...)
    local queue, is_put = {}, {}
    for i, event in ipairs { ... } do
      is_put[i] = tostring(wires.put(wire, queue, event))
    end
    return table.concat(queue, " "), table.concat(is_put, " ")
  end

  it("loses the new event when its buffer is full", function()
    assert.same({ "a b", "true true false" },
      { filled({ kind = "buffer", size = 2 }, "a", "b", "c") })
  end)

  it("keeps the newest event of kind data", function()
    assert.same({ "c", "true true true" },
      { filled({ kind = "data", size = 1 }, "a", "b", "c") })
  end)

  it("is read whole or one event at a time, in the order of the wires", function()
    local list = { { to = "x" }, { to = "y" }, { to = "x" }, { to = "x" } }
    local queues = { { 1, 2 }, { 3 }, {}, { 4, 5 } }
    local waiting = wires.waiting(list, queues, "x")
    assert.same({ 1, 4 }, waiting)
    local one, by_one = wires.take(list, queues, { 4 }, true)
    assert.same({ { 4 }, { list[4] } }, { one, by_one })
    local events, by = wires.take(list, queues, waiting)
    assert.same({ { 1, 2, 5 }, { {}, { 3 }, {}, {} } }, { events, queues })
    assert.same({ list[1], list[1], list[4] }, by)
    assert.same({ {}, {} }, { wires.take(list, queues, { 4 }, true) })
  end)

  it("carries a name, or a table with it and the data, which is a copy", function()
    local data = { force = { 3 } }
    local event = wires.event_of("e_x", data)
    assert.same({ name = "e_x", force = { 3 } }, event)
    assert.are_not.equal(data.force, event.force)
    assert.same({ "e_x", { name = "e_x", data = false } },
      { wires.event_of("e_x"), wires.event_of("e_x", false) })
  end)
end)

describe("a system", function()
  it("has its machines move by name, each a plain machine", function()
    local cell = pair({}, "e_go")
    assert.same({ "from", "to" }, cell.names)
    assert.is_false(cell:step())
    assert.equal("from a, to a", leaves(cell))
    assert.is_true(cell:run())
    assert.equal("from a, to b", leaves(cell))
    rfsm.send_events(cell.machines.to, "e_go")
    rfsm.run(cell.machines.to)
    assert.equal("from a, to c", leaves(cell))
  end)

  it("enters a machine before it reads its wires", function()
    local cell = pair({}, "e_go")
    cell:move("from")
    assert.same({ "e_go" }, cell.queues[1])
    cell:move("to")
    assert.same({ "e_go" }, cell.queues[1])
    local _, came, by = cell:move("to")
    assert.same({ "e_go" }, came)
    assert.equal(cell.wires[1], by[1])
  end)

  -- A cell as `pair` makes it, whose reader takes one event an iteration.
  local function one_by_one(...)
    local to = reader()
    to.read = "one"
    return system { from = emitter(...), to = to,
      wires = { { from = "from", event = "e_go", to = "to" } } }
  end

  it("loses an event of a set that is read in one iteration", function()
    local function ending(cell)
      for _ = 1, 3 do cell:move("from") end
      cell:run()
      return leaves(cell)
    end
    assert.equal("from a, to b", ending(pair({}, "e_go", "e_go")))
    assert.equal("from a, to c", ending(one_by_one("e_go", "e_go")))
  end)

  it("puts what a step emits one by one, and takes no step meanwhile", function()
    local cell = pair({}, "e_go", "e_other", "e_go", "e_go")
    cell:move("to")
    assert.is_false((cell:move("from")))
    assert.same({ { "e_go" }, { { wire = 1, event = "e_go" },
      { wire = 1, event = "e_go" } } }, { cell.queues[1], cell.unsent.from })
    cell:move("to")
    assert.equal("from a, to b", leaves(cell))
    local waiting = rfsm.check_events(cell.machines.from)
    assert.is_false((cell:move("from", { "e_late" })))
    assert.same({ { "e_go" }, 1, waiting + 1 }, { cell.queues[1], #cell.unsent.from,
      rfsm.check_events(cell.machines.from) })
    assert.is_false((cell:move("from")))
    assert.same({ { "e_go", "e_go" }, {} }, { cell.queues[1], cell.unsent.from })
    assert.is_true((cell:move("from")))
    cell:reset()
    cell:move("from")
    cell:reset()
    assert.same({}, cell.unsent.from)
  end)

  it("puts an event into one wire after the other, in their order", function()
    local cell = system { boss = emitter("e_go"), left = reader(), right = reader(),
      wires = { { from = "boss", event = "e_go", to = "right" },
        { from = "boss", event = "e_go", to = "left" } } }
    cell:move("boss")
    assert.same({ { "e_go" }, {} }, cell.queues)
    cell:move("boss")
    assert.same({ { "e_go" }, { "e_go" } }, cell.queues)
  end)

  it("keeps the order of a sender in a wire of several events", function()
    local to = chart { b = rfsm.state {}, c = rfsm.state {}, read = "one",
      rfsm.trans { src = "a", tgt = "b", events = { "e_go" } },
      rfsm.trans { src = "b", tgt = "c", events = { "e_stop" } } }
    local cell = system { from = emitter("e_go", "e_stop"), to = to,
      wires = { { from = "from", events = { "e_stop", "e_go" }, to = "to" } } }
    for _ = 1, 2 do cell:move("from") end
    assert.same({ "e_go", "e_stop" }, cell.queues[1])
    assert.is_true(cell:run())
    assert.equal("from a, to c", leaves(cell))
  end)

  it("reads one wire in a move if the machine takes one event", function()
    local function made()
      local to = chart { read = "one", rfsm.trans { src = "a", tgt = "a",
        events = { "e_x", "e_y", "e_z" } } }
      local cell = system { from = emitter("e_x", "e_y", "e_x"), to = to, wires = {
        { from = "from", event = "e_x", to = "to" },
        { from = "from", events = { "e_y", "e_z" }, to = "to" } } }
      for _ = 1, 2 do cell:move("to") end
      for _ = 1, 3 do cell:move("from") end
      return cell
    end
    local function came(cell, ...) return (select(2, cell:move("to", ...))) end
    local cell = made()
    local function came_alone(...)
      local list = came(cell, ...)
      cell:move("to", nil, false) -- takes e_done
      return list
    end
    assert.same({ "e_x" }, came_alone())
    assert.same({ "e_y" }, came_alone(nil, { from = "from", event = "e_z" }))
    assert.same({}, came_alone(nil, { from = "from", event = "e_z" }))
    assert.same({ "e_z" }, came_alone({ "e_z" }, false))
    assert.same({ "e_x" }, cell.queues[1])
    assert.equal("rfsm.system.move: no wire carries 'e_a' from 'from' to 'to'",
      helper.refusal(cell.move, cell, "to", nil, { from = "from", event = "e_a" }))
    local seen = {}
    for seed = 1, 20 do
      cell = made()
      cell:shuffle(seed * 99999989)
      seen[came(cell)[1]] = true
    end
    assert.same({ e_x = true, e_y = true }, seen)
  end)

  it("reads no wire while an event waits in a machine that takes one", function()
    local cell = one_by_one("e_go")
    cell:move("to")
    cell:move("from")
    rfsm.send_events(cell.machines.to, "e_own", "e_own")
    assert.same({}, (select(2, cell:move("to"))))
    assert.same({ "e_go" }, cell.queues[1])
  end)

  it("counts what a full buffer loses", function()
    local cell = pair({ size = 1 }, "e_go", "e_go", "e_go", "e_unnamed")
    cell:move("from")
    assert.same({ { { "e_go" } }, { 0 } }, { cell.queues, cell.lost })
    for _ = 1, 2 do cell:move("from") end
    assert.same({ { { "e_go" } }, { 2 } }, { cell.queues, cell.lost })
  end)

  it("gives events from outside behind those of the wires", function()
    local cell, seen = pair({}, "e_go"), {}
    rfsm.post_step_hook_add(cell.machines.to, function(_, events)
      seen = { events[#events - 1], events[#events] }
    end)
    cell:step()
    cell:move("to", { "e_other" })
    assert.same({ "e_go", "e_other" }, seen)
    assert.equal("rfsm.system.move: no machine is named 'too' (did you mean 'to'?)",
      helper.refusal(cell.move, cell, "too"))
    assert.equal("rfsm.system.move: list of events expected, got string 'e_go'",
      helper.refusal(cell.move, cell, "to", "e_go"))
  end)

  it("carries data to a reader with rfsm.named", function()
    local force
    local cell = system {
      arm = chart { a = rfsm.state { entry = function(fsm)
        fsm.emit("e_held", { force = 3 })
      end } },
      boss = chart { b = rfsm.state {},
        rfsm.trans { src = "a", tgt = "b", events = { rfsm.named "e_held" },
          effect = function(_, _, _, events)
            for _, event in ipairs(events) do
              force = type(event) == "table" and event.force or force
            end
          end } },
      wires = { { from = "arm", event = "e_held", to = "boss" } },
    }
    cell:run()
    assert.equal(3, force)
  end)

  it("moves in a random order that a seed gives, the same on each Lua", function()
    local order = {}
    local function noting(name)
      return chart { a = rfsm.state { entry = function()
        order[#order + 1] = name
      end } }
    end
    local cell = system { a = noting "a", b = noting "b", c = noting "c" }
    for seed = 1, 4 do
      cell:shuffle(seed)
      cell:step()
      cell:reset()
    end
    cell:shuffle()
    cell:step()
    assert.equal("b c a c a b c b a a b c a b c", table.concat(order, " "))
    assert.equal("rfsm.system.shuffle: number expected, got string 'x'",
      helper.refusal(cell.shuffle, cell, "x"))
  end)

  it("runs until nothing is left to do, or so many steps", function()
    local cell = system { a = chart { a = rfsm.state { doo = function()
      while true do rfsm.yield() end
    end } } }
    assert.is_false(cell:run(5))
    assert.equal("rfsm.system.run: number of steps expected, got string '5'",
      helper.refusal(cell.run, cell, "5"))
  end)

  it("is as at first after a reset", function()
    local cell = pair({ size = 1 }, "e_go", "e_go")
    cell:step()
    cell:reset()
    assert.equal("from <none>, to <none>", leaves(cell))
    assert.same({ { {} }, { 0 } }, { cell.queues, cell.lost })
  end)

  it("may have a chart twice", function()
    local model = reader()
    local cell = system { left = model, right = model }
    cell:run()
    cell:move("left", { "e_go" })
    assert.equal("left b, right a", leaves(cell))
    assert.is_true(system.is_system(cell))
    assert.is_false(system.is_system(model))
  end)
end)

-- The text of the error of a file with this content, in a folder with a chart arm.lua.
local function problems_of(text)
  local arm = helper.file_with([[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state { entry = function(fsm) fsm.emit "e_held" end },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "a", events = { "e_grasp" } },
}]])
  local file = helper.file_with((text:gsub("ARM", arm:match("[^/]*$"))))
  local ok, problem = pcall(function() return (system.load(file)) end)
  assert.is_false(ok)
  return (problem:gsub(file:gsub("%p", "%%%0"), "cell.lua"))
end

describe("a description of a system", function()
  after_each(helper.remove_files)

  it("keeps its problems when another one fails before they are told", function()
    local _, failure = pcall(system, { a = 1, b = 2 })
    pcall(system, { c = 3 })
    assert.equal("a: chart expected, got 1\nb: chart expected, got 2",
      helper.without_file(charts.reason("cell.lua", failure):gsub("\n[^\n]-:%d+: ",
        "\n")))
  end)

  it("is checked whole, each problem with its line", function()
    -- luacheck: push no max line length
    assert.equal([[
rfsm.system: the system has 12 problems
  cell.lua:5: two machines are named 'arm', the first one is lost (the second is in line 6)
  cell.lua:7: base: root.trans[1] (a -> bb): tgt 'bb': no state or connector is named 'bb' in 'root' (there is 'a')
  cell.lua:7: base: root: the root needs an initial transition (rfsm.trans{ src='initial', tgt=... })
  cell.lua:8: other: chart expected, got 5
  cell.lua:10: wires[1].to: no machine is named 'amr' (did you mean 'arm'?)
  cell.lua:11: wires[2].kind: 'buffer' or 'data' expected, got string 'bufer'
  cell.lua:11: wires[2].size: whole number from 1 expected, got 0
  cell.lua:11: wires[2].event: nothing in 'arm' emits 'e_hold' (did you mean 'e_held'?)
  cell.lua:11: wires[2].event: no transition of 'arm' has the event 'e_hold' (there is 'e_grasp')
  cell.lua:12: wires[3]: unknown option 'form' (did you mean 'from'?), expected: event, events, from, kind, size, to
  cell.lua:12: wires[3].from: name of a machine expected
  cell.lua:12: wires[3].size: data is one event, a buffer has a size]], problems_of [[
local rfsm = require "rfsm"
local system = require "rfsm.system"
local cell = { -- no wires = {
}
return system { arm = system.load "ARM",
  arm = system.load "ARM",
  base = rfsm.state { a = rfsm.state {}, rfsm.trans { src = "a", tgt = "bb" } },
  other = 5,
  wires = {
    { from = "arm", event = "e_held", to = "amr" },
    { from = "arm", event = "e_hold", to = "arm", kind = "bufer", size = 0 },
    { form = "arm", event = "e_held", to = "arm", kind = "data", size = 2 },
  },
}]])
    -- luacheck: pop
  end)

  it("names the file of a chart with mistakes", function()
    local bad = helper.file_with([[
local rfsm = require "rfsm"
return rfsm.state {
  a = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b" },
}]])
    assert.equal(([[
rfsm.system: the system has 1 problem
  %s:5: b: root.trans[2] (a -> b): tgt 'b': no state or connector is named 'b' ]]
      .. "in 'root' (there are 'a', 'initial')"):format(bad), problems_of(
      ("return require('rfsm.system') {\n  b = require('rfsm').load %q }"):format(bad)))
  end)

  it("may have wires that no text shows", function()
    assert.equal([[
rfsm.system: the system has 1 problem
  cell.lua: wires[2].to: no machine is named 'b' (there is 'a')]], problems_of [[
local list = {}
for i, name in ipairs { "a", "b" } do
  list[i] = { from = "a", event = "e_held", to = name }
  list[i].kind = "data"
end
local system = require "rfsm.system"
local chart = system.load "ARM"
chart.any = require("rfsm").trans { src = "a", tgt = "a" }
return system { a = chart, wires = list }]])
  end)

  it("is a table of charts with names", function()
    assert.equal("rfsm.system: table of machines expected, got nil",
      select(2, pcall(system, nil)))
    assert.equal("rfsm.system: table of machines expected, got state",
      select(2, pcall(system, reader())))
    local function list_of(given)
      local problem = select(2, pcall(system, given))
      return (problem:gsub("\n  [^%s]-system_spec.lua:? ?", "\n  "))
    end
    assert.equal("rfsm.system: the system has 1 problem\n"
      .. "  [1]: a machine has a name, as in { arm = system.load 'arm.lua' }",
      list_of { reader() })
    assert.equal("rfsm.system: the system has 2 problems\n"
      .. "  arm: chart expected, got string 'arm.lua' (did you mean system.load "
      .. "'arm.lua'?)\n  wire: chart expected, got table (did you mean 'wires'?)",
      list_of { arm = "arm.lua", wire = {} })
    assert.equal("rfsm.system: the system has 1 problem\n"
      .. "  wires: list expected, got 5", list_of { a = reader(), wires = 5 })
    assert.equal("rfsm.system: the system has 2 problems\n  wires[1]: table expected, "
      .. "got string 'a'\n  wires[x]: table expected, got 5",
      list_of { a = reader(), wires = { "a", x = 5 } })
    assert.equal("rfsm.system: the system has 1 problem\n"
      .. "  a system has at least one chart", list_of {})
  end)

  -- What is wrong with wires from `boss`, which emits e_go and e_x, to a reader.
  local function wrong(...)
    local ok, problem = pcall(system, { boss = emitter("e_go", "e_x"), arm = reader(),
      any = chart { rfsm.trans { src = "a", tgt = "a" } }, wires = { ... } })
    return ok or (problem:gsub("^[^\n]*", ""):gsub("\n  ", "\n"):sub(2)
      :gsub("%S-_spec%.lua: ", ""))
  end

  it("says where the number of events that are read at once went", function()
    assert.equal("wires[1].read: how many events 'arm' takes at once is said by its "
      .. "chart: read = \"one\" in the root, not by a wire", wrong({ from = "boss",
      event = "e_go", to = "arm", read = "all" }))
    assert.equal("wires[1].read: how many events 'a machine' takes at once is said by "
      .. "its chart: read = \"one\" in the root, not by a wire\n"
      .. "wires[1].to: name of a machine expected", wrong({ from = "boss",
      event = "e_go", read = 5 }))
  end)

  it("has one event or several in a wire, and each in one wire of a pair", function()
    local function between(wire)
      wire.from, wire.to = "boss", "any"
      return wire
    end
    assert.is_true(wrong(between { events = { "e_go", "e_x" } },
      { from = "boss", event = "e_go", to = "arm" }))
    assert.equal("wires[1].event: name of an event expected, or events = { ... }",
      wrong(between {}))
    assert.equal("wires[1].events: a wire has event or events, not both",
      wrong(between { event = "e_go", events = { "e_x" } }))
    assert.equal("wires[1].events: list of events expected, got table",
      wrong(between { events = {} }))
    assert.equal("wires[1].events: list of events expected, got string 'e_go'",
      wrong(between { events = "e_go" }))
    assert.equal("wires[1].events: [2]: name of an event expected, got 5",
      wrong(between { events = { "e_go", 5 } }))
    assert.equal("wires[1].events: [2]: 'e_go' is there twice",
      wrong(between { events = { "e_go", "e_go" } }))
    assert.equal("wires[2].event: wires[1] carries 'e_go' from 'boss' to 'any' already",
      wrong(between { events = { "e_x", "e_go" } }, between { event = "e_go" }))
    assert.equal("wires[1].event: no transition of 'arm' has the event 'e_x' (there is "
      .. "'e_go')", wrong({ from = "boss", events = { "e_go", "e_x" }, to = "arm" }))
  end)

  it("knows what each callback emits, by its text and by functions that it names",
    function()
      local function help(fsm) fsm.emit("e_help") end
      local function says(event)
        local member = chart {
          a = rfsm.state { exit = function(fsm) fsm.emit "e_exit" end,
            doo = function(fsm) fsm.emit 'e_doo' end,
            entry = function(fsm) help(fsm) end },
          rfsm.trans { src = "a", tgt = "a", events = { event, "e_go" },
            guard = function(tr) tr._fsm.emit("e_guard", 1) end,
            effect = function(fsm) fsm.emit("e_effect") end },
        }
        local ok, problem = pcall(system, { m = member,
          wires = { { from = "m", event = event, to = "m", kind = "buffer" } } })
        return ok or problem:match("wires%[1%].*")
      end
      for event in ("e_help e_exit e_doo e_guard e_effect"):gmatch("%S+") do
        assert.is_true(says(event))
      end
      assert.equal("wires[1].event: nothing in 'm' emits 'e_exits' (did you mean "
        .. "'e_exit'?)", says "e_exits")
    end)

  it("knows the names of predicates, and emit_event", function()
    local boss = chart { a = rfsm.state { entry = function(fsm)
      fsm.emit_event "e_start" -- of Orocos
    end }, rfsm.trans { src = "a", tgt = "a", events = { rfsm.named "e_held" } } }
    local ok, problem = pcall(system, { boss = boss, wires = {
      { from = "boss", event = "e_start", to = "boss" } } })
    assert.is_false(ok)
    assert.equal("wires[1].event: no transition of 'boss' has the event 'e_start' "
      .. "(there is 'e_held')", problem:match("wires%[1%].*"))
    local file = helper.file_with([[
local rfsm = require "rfsm"
return rfsm.state { info = false, a = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "a", events = { rfsm.named "e_held" } } }]])
    local _, err = commands.run("sim -q -e step -e 'se e_held' -e 'se e_hold' " .. file)
    assert.equal("no transition names the event 'e_hold' (did you mean 'e_held'?)\n",
      err)
  end)

  it("leaves events alone that a text cannot show", function()
    local name = "e_go"
    local cell = system {
      from = chart { a = rfsm.state { entry = function(fsm) fsm.emit(name) end } },
      any = chart { rfsm.trans { src = "a", tgt = "a",
        events = { function() return true end } } },
      wires = { { from = "from", event = "e_strange", to = "any" } },
    }
    assert.same({ "e_strange" }, cell.wires[1].events)
  end)
end)

describe("system.load", function()
  it("takes the name of a file that there is", function()
    assert.equal("rfsm.system.load: file name expected, got nil",
      helper.refusal(system.load))
    assert.matches("^rfsm.load: cannot open '?none.lua",
      select(2, pcall(system.load, "none.lua")))
  end)

  it("loads a system or a chart, beside the file that calls", function()
    local cell = system.load "examples/systems/stop/cell.lua"
    assert.same({ "arm", "base", "supervisor" }, cell.names)
    assert.equal("examples/systems/stop/cell.lua:12", cell.wires[1].location)
    assert.is_true(rfsm.is_state(system.load "examples/systems/stop/arm.lua"))
    local file = helper.file_with("return require('rfsm').state { info = false }")
    local program = helper.file_with(([[
local model = require("rfsm.system").load %q
local cell = require("rfsm.system") { a = model }
return cell.file]]):format(file:match("[^/]*$")))
    assert.equal(program, assert(loadfile(program))())
    helper.remove_files()
  end)
end)

-- The leaves of an example after a run, in the fixed order or a random one; `story` is
-- called after three steps.
local function leaves_of_run(name, seed, story)
  local cell = system.load("examples/systems/" .. name .. ".lua")
  cell:shuffle(seed)
  for _ = 1, story and 2 or 0 do cell:step() end
  if story then story(cell) end
  assert.is_true(cell:run(100))
  return leaves(cell)
end

local function stop(cell) cell:move("supervisor", { "e_stop" }) end

local GOALS = {
  zone = "left parked, right parked, zone empty",
  stop = "arm halted, base halted, supervisor stopped",
  protocol = "receiver full, sender sent",
}

describe("an example of a system", function()
  for _, name in ipairs { "zone", "stop", "protocol" } do
    local story = name == "stop" and stop or nil

    it("ends as it should in any order when it is mended: " .. name, function()
      for seed = 1, 30 do
        assert.equal(GOALS[name], leaves_of_run(name .. "/cell_mended", seed, story))
      end
    end)

    it("gets stuck in some order before: " .. name, function()
      local is_stuck = false
      for seed = 1, 30 do
        local ending = leaves_of_run(name .. "/cell", seed, story)
        is_stuck = is_stuck or ending ~= GOALS[name]
      end
      assert.is_true(is_stuck)
    end)
  end
end)

describe("rfsm sim of a system", function()
  -- What the commands print.
  local function said(file, ...)
    local texts = {}
    for i, line in ipairs { ... } do texts[i] = "-e '" .. line .. "'" end
    return commands.run(("sim -q %s examples/systems/%s.lua"):format(
      table.concat(texts, " "), file))
  end

  it("shows moves, machines, and what waits in wires", function()
    assert.equal([[
arm: root.ready
base: root.driving
supervisor: root.working
arm             root.ready
base            root.driving
supervisor      root.working
wires[1]        1 waiting (e_grasp from supervisor to arm)
supervisor gets e_stop from outside: root.stopping_base
arm             root.ready
base            root.driving
supervisor      root.stopping_base
wires[1]        1 waiting (e_grasp from supervisor to arm)
wires[2]        1 waiting (e_halt_base from supervisor to base)
]], (said("stop/cell", "step", "supervisor e_stop")))
  end)

  it("goes back over all machines and wires", function()
    local out = said("protocol/cell", "step", "receiver", "back", "run")
    assert.equal([[
sender          1 to send (e_item to receiver)
receiver        root.empty
sender          root.sending
wires[1]        1 waiting (e_item from sender to receiver)
sender          1 to send (e_item to receiver)
receiver gets e_item from sender: root.half
receiver gets e_item from sender: root.full
sender gets e_received from receiver, e_received from receiver: root.half
receiver        root.full
sender          root.half
]], (out:gsub("^.-wires%[2%][^\n]*\n", "")))
    assert.matches("back: nothing was done", (select(2, said("protocol/cell", "back"))))
    assert.matches("step: number expected, got string",
      (select(2, said("protocol/cell", "step x"))))
  end)

  it("takes the moves of a witness", function()
    local file = helper.file_with("receiver\nsender e_received\n")
    local out = commands.run("sim -q -e back --replay " .. file
      .. " examples/systems/protocol/cell.lua", { ["rfsm.system.sequence"] = {
        read = function(text)
          local moves = {}
          for machine, event in text:gmatch("(%w+) ?([%w_]*)\n") do
            moves[#moves + 1] = { machine = machine,
              events = { event ~= "" and event or nil } }
          end
          return moves
        end } })
    assert.equal([[
receiver: root.empty
sender gets e_received from outside: root.sending
receiver        root.empty
sender          root.sending
wires[1]        1 waiting (e_item from sender to receiver)
sender          1 to send (e_item to receiver)
receiver        root.empty
sender          <none>
]], out)
    helper.remove_files()
  end)

  it("lists its commands", function()
    assert.equal([[
  step [n]              each machine moves once, n times
  run                   until nothing is left to do
  show                  the machines, and what waits in wires
  back [n]              undo the last n lines that moved
  forward [n]           do them again
  reset                 as at the beginning
  quit                  end, as Control-D does
  help                  these lines
  receiver [events]     one machine moves, with events from outside
  sender [events]       one machine moves, with events from outside
Other lines are Lua: 'cell' is the system, cell.machines has the machines.
]], (said("protocol/cell", "help")))
  end)

  it("shows what a wire has lost, and all is as at first after a reset", function()
    local text = [[
local system = require "rfsm.system"
return system {
  receiver = system.load "CHECKOUT/examples/systems/protocol/receiver.lua",
  sender = system.load "CHECKOUT/examples/systems/protocol/sender.lua",
  wires = { { from = "sender", event = "e_item", to = "receiver", size = 1 } },
}]]
    text = text:gsub("CHECKOUT", helper.lines_of("pwd")[1])
    local out = commands.run("sim -q -e step -e sender -e back -e reset -e show "
      .. "-e quit -e step " .. helper.file_with(text))
    assert.equal([[
wires[1]        1 waiting, 1 lost (e_item from sender to receiver)
]], out:match("wires[^\n]*lost[^\n]*\n"))
    assert.equal([[
receiver        <none>
sender          <none>
receiver        <none>
sender          <none>
]], out:match(".*%(e_item[^(]*%)\n(.*)$"))
    helper.remove_files()
  end)

  it("does not go back if a machine cannot be saved", function()
    local file = helper.file_with([[
local rfsm = require "rfsm"
local function chart(x)
  return rfsm.state { info = false, keep = { "x" }, x = x, a = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "a" } }
end
return require("rfsm.system") { a = chart(1), b = chart(print) }]])
    local out, err = commands.run("sim -q -e step -e back " .. file)
    assert.matches("b               root.a\n$", out)
    assert.matches("back: .*cannot be saved", err)
    helper.remove_files()
  end)

  it("goes back with all machines and wires, or with none", function()
    -- each: a --e--> b --e_x--> a; a wire leads from the first machine to the second
    local file = helper.file_with([[
local rfsm = require "rfsm"
local function chart()
  return rfsm.state { info = false, warn = false, a = rfsm.state {}, b = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "a" },
    rfsm.trans { src = "a", tgt = "b", events = { "e" },
      effect = function(fsm) fsm.emit "e_x" end },
    rfsm.trans { src = "b", tgt = "a", events = { "e_x" } } }
end
return require("rfsm.system") { k = chart(), l = chart(), m = chart(),
  wires = { { from = "k", event = "e_x", to = "l" } } }]])
    local out, err, status = commands.run("sim -q -e step -e 'k e' -e 'l e' "
      .. "-e 'rfsm.fsm_merge(cell.machines.m, cell.machines.m, rfsm.state {}, [[new]])'"
      .. " -e print(pcall(back,2)) -e show -e back " .. file)
    assert.equal([[
false	back: rfsm.snapshot: the snapshot is of another chart:
  new: state root.new
k               root.b
l               root.b
m               root.a
]], out:match("(false.*)$"))
    assert.same({ "rfsm sim: back: rfsm.snapshot: the snapshot is of another chart\n",
      1 }, { err, status })
    helper.remove_files()
  end)

  it("stops a run that has no end", function()
    local file = helper.file_with([[
local rfsm = require "rfsm"
return require("rfsm.system") { a = rfsm.state { info = false, warn = false,
  a = rfsm.state { doo = function() while true do rfsm.yield() end end },
  rfsm.trans { src = "initial", tgt = "a" } } }]])
    assert.matches("stopped after 10,000 steps, 'run' goes on\n$",
      (commands.run("sim -q -e run " .. file)))
    helper.remove_files()
  end)

  it("refuses options of charts, files without moves, and undoes a reset", function()
    local _, err, status = commands.run("sim --dry examples/systems/stop/cell.lua")
    assert.equal("rfsm sim: --dry is for a chart, not for a system\n", err)
    assert.equal(2, status)
    _, err, status = commands.run("sim --replay none examples/systems/stop/cell.lua")
    assert.matches("none: No such file", err)
    assert.equal(2, status)
    local file = helper.file_with "\n"
    _, err, status = commands.run("sim -q --replay " .. file
      .. " examples/systems/stop/cell.lua")
    assert.same({ "rfsm sim: " .. file .. ": no line is a move\n", 1 }, { err, status })
    helper.remove_files()
    local out = said("protocol/cell", "sender", "reset", "back")
    assert.matches("sender          <none>\nreceiver        <none>\n"
      .. "sender          root.sending\nwires%[1%] .*\n$", out)
    out = said("protocol/cell", "step", "back", "forward")
    assert.matches("sender +<none>\nreceiver        root.empty\nsender          "
      .. "root.sending\nwires%[1%] [^\n]*\nsender +1 to send [^\n]*\n$", out)
  end)

  it("names the nearest event, and what is wrong with the file", function()
    assert.matches("no transition names the event 'e_stp' %(did you mean "
      .. "'e_stop'%?%)", (select(2, said("stop/cell", "supervisor e_stp"))))
    local file = helper.file_with([[
return require("rfsm.system") { a = 5, b = 6, wires = {} }]])
    local _, err, status = commands.run("sim " .. file)
    assert.equal(("rfsm sim: %s:1: a: chart expected, got 5\nrfsm sim: %s:1: b: chart "
      .. "expected, got 6\n")
      :gsub("%%s", file), err)
    assert.equal(1, status)
    helper.remove_files()
  end)
end)
