-- Systems: what is found in the product of the machines, properties, premises,
-- witnesses and `rfsm check` of a system; and random systems against brute force.

local commands = require "spec.support.commands"
local helper = require "spec.helper"
local match = require "rfsm.shared.match"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local sequence = require "rfsm.system.sequence"
local share = require "spec.support.share"
local system = require "rfsm.system"
require "rfsm_timeevent"
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local after, never, from = rfsm_checks.after, rfsm_checks.never, rfsm_checks.from

local function emits(...)
  local list = { ... }
  return function(fsm)
    for _, event in ipairs(list) do fsm.emit(event) end
  end
end

local function go(src, tgt, event, ...)
  return rfsm.trans { src = src, tgt = tgt, events = { event },
    effect = ... and emits(...) or nil }
end

-- A silent chart of the states a, b and c that begins in a.
local function chart(...)
  return rfsm.state { info = false, warn = false,
    a = rfsm.state {}, b = rfsm.state {}, c = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "a" }, ... }
end

-- Such a chart that takes one event an iteration.
local function one_by_one(...)
  local model = chart(...)
  model.read = "one"
  return model
end

local DRY = { dry_run = true }

local function list_of(text)
  local list = {}
  for name in text:gmatch("[^,]+") do list[#list + 1] = name end
  return list
end

-- Explores a system of these charts: `wires` are texts "from event to", or tables. The
-- events of a wire that has several are joined by commas.
local function explored(charts, wires, options)
  local given, list = {}, {}
  options = options or {}
  options.machines = options.machines or {}
  for name, model in pairs(charts) do -- any order: each stands alone
    given[name], options.machines[name] = model, options.machines[name] or DRY
  end
  for i, wire in ipairs(wires) do
    if type(wire) == "string" then wire = { wire } end
    wire.from, wire.event, wire.to = wire[1]:match("(%S+) (%S+) (%S+)")
    if wire.event:find(",") then wire.events, wire.event = list_of(wire.event), nil end
    list[i] = wire
    wire[1] = nil
  end
  given.wires = list
  return system(given):explore(options), system(given)
end

-- Returns the findings as lines, without files.
local function lines_of(result)
  local lines = {}
  for i, finding in ipairs(result.findings) do
    lines[i] = finding.severity .. " " .. finding.place .. ": " .. finding.text
  end
  return lines
end

-- Two that ask each other: left a -e_go-> b -e_yes-> c, and so right, each by wires.
local function asking()
  return { left = chart(go("a", "b", "e_go", "e_ask"), go("b", "c", "e_yes"),
      go("a", "a", "e_ask", "e_yes")),
    right = chart(go("a", "b", "e_go", "e_ask"), go("b", "c", "e_yes"),
      go("a", "a", "e_ask", "e_yes")) },
    { "left e_ask right", "right e_ask left", "left e_yes right", "right e_yes left" }
end

describe("cell:explore", function()
  it("finds that machines wait for each other, with the run to it", function()
    local charts, wires = asking()
    local finding = explored(charts, wires).findings[1]
    assert.equal("left: root.b, right: root.b: nobody can go on any more",
      finding.place .. ": " .. finding.text)
    assert.equal("error deadlock", finding.severity .. " " .. finding.code)
    assert.same({
      "1. left: root.trans[1] -> root.a",
      "2. left gets e_go from outside: root.trans[2] -> root.b; sends e_ask to right",
      "3. right: root.trans[1] -> root.a",
      "4. right gets e_ask from left, e_go from outside: root.trans[2] -> root.b; "
        .. "sends e_ask to left",
      "5. left gets e_ask from right: no transition -> root.b",
    }, sequence.lines_of(finding.witness))
  end)

  it("finds who waits for a machine that has ended, but in no end", function()
    local function found(is_end)
      local server = chart(go("a", "b", "e_ask"), go("b", "a", "e_ask"))
      server.b.final = is_end
      return lines_of(explored({ server = server, client = chart(go("a", "b", "e_go",
        "e_ask")) }, { "client e_ask server" }))
    end
    assert.same({ "error client: root.b, server: root.b: nobody can go on any more" },
      found(nil))
    assert.same({}, found(true))
  end)

  it("takes an end by its name, and one that is declared", function()
    local left = chart(go("a", "b", "e_go"))
    left.b.final = true
    local charts = { left = left, right = chart(go("a", "DONE_END", "e_go", "e_x")) }
    charts.right.DONE_END = rfsm.state {}
    charts.left[3] = go("b", "b", "e_x")
    assert.same({}, lines_of(explored(charts, { "right e_x left" })))
  end)

  it("finds the event that a full buffer loses, but not that of data", function()
    local function charts()
      return { left = chart(go("a", "a", "e_go", "e_x")),
        right = chart(go("a", "a", "e_x")) }
    end
    local result = explored(charts(), { { "left e_x right", size = 1 } })
    assert.same({ "warning wires[1] (left e_x -> right): the buffer of 1 can be full, "
      .. "the new event is lost" }, lines_of(result))
    local witness = sequence.lines_of(result.findings[1].witness)
    assert.equal("3. left gets e_go from outside: root.trans[2] -> root.a; sends e_x "
      .. "to right (lost)", witness[3])
    assert.is_nil(witness[4])
    assert.same({}, lines_of(explored(charts(),
      { { "left e_x right", kind = "data" } })))
  end)

  it("finds events that are never taken, and wires that carry none", function()
    local left = chart(go("a", "b", "e_go", "e_x"), go("c", "a", "e_no", "e_y"))
    local right = chart(go("b", "a", "e_x"), go("a", "a", "e_y"))
    right.a.final = true
    assert.same({
      "warning wires[1] (left e_x -> right): 'right' never takes 'e_x'",
      "warning wires[2] (left e_y -> right): no event ever goes over it",
    }, lines_of(explored({ left = left, right = right }, { "left e_x right",
      "left e_y right" })))
  end)

  it("finds states that the chart alone reaches", function()
    local left = chart(go("a", "b", "e_go", "e_x"))
    local right = chart(go("a", "b", "e_x"), go("b", "c", "e_x"))
    right.c.final, right.b.final = true, true
    assert.same({ "warning right: root.c: active in no configuration of the system, "
      .. "though the chart alone reaches it" }, lines_of(explored({ left = left,
      right = right }, { "left e_x right" })))
    right.c.checks = { unreachable = "for a later supervisor" }
    assert.same({}, lines_of(explored({ left = left, right = right },
      { "left e_x right" })))
  end)

  -- Keeps e_x and e_y while in a, up to 64 events, and never sees e_y before e_x.
  local function deferring()
    local model = chart(go("a", "b", "e_go"), go("b", "c", "e_x"), go("b", "wrong",
      "e_y"))
    model.a.defer, model.wrong = { "e_x", "e_y" }, rfsm.state { final = true }
    model.c.final = true
    return model
  end

  -- Returns the lines of the findings, and how many steps the engine took beside those
  -- of the machines together.
  local function counted(charts, wires)
    local count, step = 0, rfsm.step
    local result = helper.with(rfsm, { step = function(...)
      count = count + 1
      return step(...)
    end }, function() return (explored(charts, wires)) end)
    return lines_of(result), count - result.steps
  end

  it("explores a chart alone in part, if it keeps many events", function()
    require "rfsm.defer"
    local left = rfsm.state { info = false, warn = false, a = rfsm.state {
      final = true, entry = function(fsm)
        for _, event in ipairs { "e_x", "e_y", "e_go" } do fsm.emit(event) end
      end }, rfsm.trans { src = "initial", tgt = "a" } }
    local wires = { "left e_x right", "left e_y right", "left e_go right" }
    local lines, count = counted({ left = left, right = deferring() }, wires)
    assert.same({ "warning wires[2] (left e_y -> right): 'right' never takes 'e_y'",
      "warning right: root.wrong: active in no configuration of the "
      .. "system, though the chart alone reaches it" }, lines)
    assert.is_true(count < 10000)
  end)

  it("explores no chart alone whose states were all active", function()
    local left = chart(go("a", "b", "e_go", "e_x"), go("b", "c", "e_go", "e_x"))
    local right = chart(go("a", "b", "e_x"), go("b", "c", "e_x"))
    left.c.final, right.b.final, right.c.final = true, true, true
    local lines, count = counted({ left = left, right = right }, { "left e_x right" })
    assert.same({ {}, 0 }, { lines, count })
  end)

  it("reads all that waits, or one, as the chart says", function()
    local function found(read)
      local left = chart(go("a", "b", "e_go", "e_x", "e_x"))
      local right = chart(go("a", "b", "e_x"), go("b", "c", "e_x"))
      right.read = read
      return explored({ left = left, right = right }, { "left e_x right" },
        { properties = { after("left: e_go").reach("right: root.c") } })
    end
    assert.is_false(found("some").properties[1].holds) -- user data
    assert.is_true(found("one").properties[1].holds)
    assert.is_false(found("all").properties[1].holds)
  end)

  -- In c right defers e_x, and in `a` its guard may refuse it: then nothing asks again.
  it("does not look again at what a machine keeps before the next path", function()
    require "rfsm.defer"
    for _, read in ipairs { "all", "one" } do
      for _, overlap in ipairs { true, false } do
        local left, right = chart(), chart(go("c", "a", "e_go"), go("a", "b", "e_x"))
        left.a.final, left.a.entry = true, emits("e_x")
        right[1].tgt, right.defer, right.read = "c", { "e_x" }, read
        right[3].guard, right.b.final = function() return true end, true
        local result = explored({ left = left, right = right }, { "left e_x right" },
          { overlap = overlap, machines = { right = { alphabet = { "e_go" } } },
            properties = { after("right: e_go").reach("right: root.b") } })
        assert.is_false(result.properties[1].holds)
      end
    end
  end)

  it("may refuse a transition that needs no event for ever", function()
    local function judged(guard)
      local left, right = chart(go("a", "b", "e_go", "e_x")), chart(go("a", "b", "e_x"))
      right[3] = rfsm.trans { src = "b", tgt = "c", always = true, guard = guard }
      return explored({ left = left, right = right }, { "left e_x right" }, {
        properties = { after("left: e_go").reach("right: root.c") } })
        .properties[1].holds
    end
    assert.is_true(judged(nil))
    assert.is_false(judged(function() return true end))
  end)

  -- left puts e_x and then e_y when it is entered; e_y is taken in b only.
  local function told(...) return { left = chart(...), right = chart(
    go("a", "b", "e_x"), go("b", "c", "e_y")) } end

  it("has other machines move between two events of a step", function()
    local charts = told()
    charts.left.a = rfsm.state { final = true, entry = emits("e_x", "e_y") }
    charts.right.c.final = true
    local result = explored(charts, { "left e_x right", "left e_y right" },
      { properties = { never "right: root.c" } })
    assert.is_false(result.properties[1].holds)
    assert.same({
      "1. left: root.trans[1] -> root.a; sends e_x to right",
      "2. right: root.trans[1] -> root.a",
      "3. right gets e_x from left: root.trans[2] -> root.b",
      "4. left: still in its step, sends e_y to right",
      "5. right gets e_y from left: root.trans[3] -> root.c",
    }, sequence.lines_of(result.findings[#result.findings].witness))
  end)

  -- Two that cross: each goes to b by an event from outside, and tells the other one,
  -- which goes to c if it is not in b yet.
  local function crossing()
    return { left = chart(go("a", "c", "e_right"), go("a", "b", "e_go", "e_left")),
      right = chart(go("a", "c", "e_left"), go("a", "b", "e_go", "e_right")) },
      { "left e_left right", "right e_right left" }
  end

  local function judged_crossing(overlap, most)
    local charts, wires = crossing()
    return explored(charts, wires, { overlap = overlap, configurations = most,
      properties = { never { "left: root.b", "right: root.b" } } })
  end

  it("has moves cross unless it is told that they do not", function()
    local plain = judged_crossing(false)
    assert.same({ true, false }, { plain.properties[1].holds, plain.crossing })
    assert.matches("b: holds if moves do not cross\npremises: ", tostring(plain), 1,
      true)
    local result, cell = judged_crossing()
    assert.is_false(result.properties[1].holds)
    assert.is_true(result.crossing > result.configurations)
    assert.equal(plain.configurations, result.configurations)
    assert.matches((" configurations, %d with moves that cross, "):format(
      result.crossing), tostring(result), 1, true)
    local lines = sequence.lines_of(result.findings[#result.findings].witness)
    assert.same({
      "1. left: root.trans[1] -> root.a",
      "2. left gets e_go from outside: root.trans[3] -> root.b; sends nothing yet",
      "3. right: root.trans[1] -> root.a",
      "4. right gets e_go from outside: root.trans[3] -> root.b; sends e_right to left",
    }, lines)
    for _, move in ipairs(sequence.read(table.concat(lines, "\n"))) do
      cell:move(move.machine, move.events, move.wanted, move.holds)
    end
    assert.same({ "root.b", "root.b", 1, 0 }, {
      rfsm.get_actleaf_fqn(cell.machines.left),
      rfsm.get_actleaf_fqn(cell.machines.right), #cell.unsent.left,
      #cell.unsent.right })
  end)

  it("says that moves do not cross, if they would need too many configurations",
    function()
      local most = judged_crossing(false).configurations
      local result = judged_crossing(nil, most)
      assert.same({ true, nil, false }, { result.properties[1].holds, result.bound,
        result.crossing })
      assert.matches("p: holds if moves do not cross\n", (tostring(result):gsub(
        "never left: root.b and right: root.b", "p")), 1, true)
      assert.matches("; not tried with moves that cross: what lies behind the bound on "
        .. "configurations; ", tostring(result), 1, true)
      result = judged_crossing(true, most)
      assert.same({ "configurations" }, { result.bound, result.properties[1].holds })
    end)

  it("has a step that emits nothing overlap nothing", function()
    local function count(overlap)
      return explored({ left = chart(go("a", "b", "e_go"), go("b", "a", "e_go", "e_z")),
        right = chart(go("a", "b", "e_x"), go("b", "a", "e_y")) }, {},
        { overlap = overlap })
    end
    local result = count(true)
    assert.equal(count(false).configurations, result.configurations)
    assert.equal(result.configurations, result.crossing)
  end)

  it("has the sender do nothing else until all events of a step are put", function()
    local left = chart(go("a", "b", "e_go", "e_x", "e_y"))
    assert.is_true(explored({ left = left, right = one_by_one(go("a", "b", "e_y"),
      go("a", "c", "e_x")) }, { "left e_x,e_y right" }, { properties = {
        never { "left: root.a", "right: root.c" }, never "right: root.b" } })
      .properties[2].holds)
    local back = chart(go("a", "b", "e_x", "e_back"))
    local sender = chart(go("a", "b", "e_go", "e_x", "e_y"), go("b", "c", "e_back",
      "e_z"))
    local taker = one_by_one(go("a", "b", "e_y"), go("a", "c", "e_z"))
    assert.is_true(explored({ left = sender, mid = back, right = taker },
      { "left e_x mid", "mid e_back left", "left e_y,e_z right" },
      { properties = { never "right: root.c" } }).properties[1].holds)
  end)

  it("puts an event into several wires one by one", function()
    local charts = { boss = chart(go("a", "b", "e_go", "e_x")),
      one = chart(go("a", "b", "e_x", "e_told")),
      two = chart(go("a", "b", "e_x"), go("a", "c", "e_told")) }
    local result = explored(charts, { "boss e_x one", "boss e_x two",
      "one e_told two" }, { properties = { never "two: root.c" } })
    assert.is_false(result.properties[1].holds) -- one tells two before the boss does
  end)

  it("keeps the order of a sender in one wire, not in two", function()
    local function holds(...)
      local charts = { left = chart(go("a", "b", "e_go", "e_x", "e_y")),
        right = one_by_one(go("a", "b", "e_x"), go("a", "c", "e_y")) }
      return explored(charts, { ... },
        { properties = { never "right: root.c" } }).properties[1].holds
    end
    assert.is_true(holds "left e_x,e_y right")
    assert.is_true(holds "left e_y,e_x right")
    assert.is_false(holds("left e_x right", "left e_y right"))
  end)

  it("has a machine that takes one event take those of each sender", function()
    local function charts(read)
      local to = chart(go("a", "b", "e_x"), go("a", "c", "e_y"), go("b", "c", "e_y"))
      to.read = read
      return { left = chart(go("a", "b", "e_go", "e_x")),
        other = chart(go("a", "b", "e_go", "e_y")), to = to }
    end
    local function holds(read, ...)
      return explored(charts(read), { "left e_x to", "other e_y to" },
        { properties = { ... } }).properties[1].holds
    end
    assert.is_false(holds("one", never { "to: root.c", "left: root.b" }))
    assert.is_true(holds("one", after("other: e_go").reach "to: root.c"))
    assert.is_false(holds(nil, after("other: e_go").reach "to: root.c"))
  end)

  it("neglects no wire of a machine that takes one event", function()
    local babbler = chart(rfsm.trans { src = "a", tgt = "a", events = { "e_done" },
      effect = emits "e_x" })
    local to = one_by_one(go("b", "c", "e_x"), go("c", "b", "e_x"),
      rfsm.trans { src = "a", tgt = "b", events = { "e_x" } })
    to.d = rfsm.state { final = true }
    for _, src in ipairs { "a", "b", "c" } do to[#to + 1] = go(src, "d", "e_stop") end
    local result = explored({ babbler = babbler, boss = chart(go("a", "b", "e_go",
      "e_stop")), to = to }, { { "babbler e_x to", size = 2 }, "boss e_stop to" },
      { properties = { after("boss: e_go").reach "to: root.d" } })
    assert.is_true(result.properties[1].holds)
  end)

  it("knows that a machine which goes on by itself, or was not entered, reads nothing",
    function()
      local function holds(...)
        local to = one_by_one(...)
        to.d = rfsm.state { final = true }
        to[#to + 1] = go("a", "d", "e_stop")
        return explored({ boss = chart(go("a", "b", "e_go", "e_stop")), to = to },
          { "boss e_stop to" }, { properties = {
            after("boss: e_go").reach "to: root.d" } }).properties[1].holds
      end
      assert.is_true(holds())
      assert.is_false(holds(go("a", "a", "e_done")))
      assert.is_true(holds(go("b", "b", "e_done")))
      local late = rfsm.state { info = false, warn = false, read = "one",
        a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a",
          events = { "e_stop" } } }
      assert.is_false(explored({ boss = chart(go("a", "b", "e_go", "e_stop")),
        to = late }, { "boss e_stop to" }, { properties = {
          after("boss: e_go").reach "to: root.a" } }).properties[1].holds)
    end)

  it("takes an event from outside alone, if the machine takes one", function()
    local right = one_by_one(go("a", "b", "e_x"), go("a", "c", "e_out"))
    local function holds(property)
      return explored({ left = chart(go("a", "b", "e_go", "e_x")), right = right },
        { "left e_x right" }, { properties = { property } }).properties[1].holds
    end
    assert.is_false(holds(never { "left: root.b", "right: root.c" }))
    assert.is_false(holds(never "right: root.b"))
  end)

  it("tells of each event of a wire", function()
    local left = chart(go("a", "b", "e_go", "e_x"), go("b", "c", "e_no", "e_y"))
    left[3].guard = function() return false end
    local right = chart(go("a", "b", "e_y"), go("c", "a", "e_x"))
    right.a.final, right.b.final, left.b.final = true, true, true
    local result = explored({ left = left, right = right }, { "left e_x,e_y right" },
      { machines = { left = { dry_run = true, alphabet = { "e_go" } } } })
    assert.same({
      "warning wires[1] (left e_x, e_y -> right): 'right' never takes 'e_x'",
      "warning wires[1] (left e_x, e_y -> right): no 'e_y' ever goes over it",
    }, { lines_of(result)[1], lines_of(result)[2] })
  end)

  it("explores machines apart that nothing joins", function()
    local function charts()
      return { left = chart(go("a", "b", "e_x"), go("b", "a", "e_x")),
        right = chart(go("a", "b", "e_x"), go("b", "a", "e_x")) }
    end
    assert.equal(6, explored(charts(), {}).configurations)
    assert.equal(9, explored(charts(), {}, { properties = {
      never { "left: root.c", "right: root.a" } } }).configurations)
    assert.equal(9, explored(charts(), {}, { properties = {
      never(function(active) return active "left: root.c" end) } }).configurations)
  end)

  it("knows by sends, or by a callback that is run, what is emitted", function()
    local function found(options)
      local effect = emits "e_x"
      local left = chart(rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
        effect = effect })
      options.run = options.run and { effect }
      return explored({ left = left, right = chart(go("a", "b", "e_x")) },
        { "left e_x right" }, { machines = { left = options },
          properties = { never "right: root.b" } })
    end
    assert.is_false(found({ run = true }).properties[1].holds)
    local function sends(...)
      return found { sends = { ["effect root.trans[2]"] = { ... } } }
    end
    assert.is_false(sends({ emit = "e_x" }).properties[1].holds)
    assert.is_true(sends().properties[1].holds)
    local unknown = found {}
    assert.is_nil(unknown.properties[1].holds)
    assert.same({ "left: events that the effect root.trans[2] may emit, which sends "
      .. "does not name" }, unknown.untried)
    assert.equal("emits", unknown.bound)
  end)

  it("gives an event with data to predicates alone", function()
    local function found(event)
      local left = chart(rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
        effect = function(fsm) fsm.emit("e_x", 7) end })
      return explored({ left = left, right = chart(go("a", "b", event)) },
        { "left e_x right" }, { properties = { never "right: root.b" } }).properties[1]
    end
    assert.is_true(found("e_x").holds)
    assert.is_false(found(rfsm.named "e_x").holds)
  end)

  it("knows an event with data by its name", function()
    local left = chart(rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
      effect = function(fsm) fsm.emit("e_x", 7) end })
    local right = chart(go("a", "b", rfsm.named "e_x"))
    local judged = explored({ left = left, right = right }, { "left e_x right" },
      { properties = { after("right: e_x").reach "right: root.b" } }).properties[1]
    assert.same({ true }, { judged.holds, judged.vacuous })
  end)

  it("has the data of a wire's events be the examples of their names", function()
    local function is_hot(_, _, event) return event.celsius > 80 end
    local right = chart(rfsm.trans { src = "a", tgt = "b", guard = is_hot,
      events = { rfsm.named "e_x" } })
    local left = chart(rfsm.trans { src = "a", tgt = "b", events = { "e_go" },
      effect = function(fsm) fsm.emit("e_x", { celsius = 90, unit = "C" }) end })
    local function found(...)
      local result, cell = explored({ left = left, right = right },
        { "left e_x right" }, { properties = { never "right: root.b" },
          machines = { right = { classes = { e_x = { ... } } } } })
      return result.properties[1].holds, result, cell
    end
    assert.is_true((found({ celsius = 20 })))
    local holds, result, cell = found({ celsius = 20 }, { celsius = 90, unit = "C" })
    assert.is_false(holds)
    assert.truthy(match.has(result.premises, "right: 2 examples of e_x"))
    local lines = sequence.lines_of(result.findings[#result.findings].witness)
    assert.equal('4. right gets e_x{celsius=90,unit="C"} from left: root.trans[2] -> '
      .. "root.b (root.trans[2] true)", lines[4])
    for _, move in ipairs(sequence.read(table.concat(lines, "\n"))) do
      cell:move(move.machine, move.events, move.wanted, move.holds)
    end
    assert.equal("root.b", rfsm.get_actleaf_fqn(cell.machines.right))
  end)

  it("has an event of a wire come from outside if the alphabet says so", function()
    local function holds(alphabet)
      return explored({ left = chart(go("b", "c", "e_go", "e_x")),
        right = chart(go("a", "b", "e_x")) }, { "left e_x right" },
        { machines = { right = { alphabet = alphabet } },
          properties = { never "right: root.b" } }).properties[1].holds
    end
    assert.is_true(holds())
    assert.is_false(holds { "e_x" })
  end)

  it("joins events of a wire and from outside on a path through connectors", function()
    local function holds(alphabet)
      local right = chart(go("a", "k", "e_x"), go("k", "l", "e_y"), go("l", "b", "e_z"))
      right.k, right.l = rfsm.conn {}, rfsm.conn {}
      return explored({ left = chart(go("a", "b", "e_go", "e_x")), right = right },
        { "left e_x right" }, { machines = { right = { alphabet = alphabet } },
          properties = { never "right: root.b" } }).properties[1].holds
    end
    assert.is_false(holds())
    assert.is_false(holds { "e_y", "e_z" })
    assert.is_true(holds { "e_y" })
  end)

  it("has timers expire any time, and knows no events that are sent later", function()
    local function found(item)
      local sends = { ["effect root.trans[3]"] = { item } }
      local left = chart(go("a", "b", "e_after(5)"), rfsm.trans { src = "b", tgt = "c",
        events = { "e_go" }, effect = function() end })
      return explored({ left = left, right = chart(go("a", "b", "e_x")) }, {},
        { machines = { left = { sends = sends } },
          properties = { never { "left: root.b", "right: root.b" } } })
    end
    assert.is_false(found("e_y").properties[1].holds)
    local late = found { "e_y", after = 1 }
    assert.same({ "left: events that are sent later" }, late.untried)
    assert.equal("pending", late.bound)
  end)

  it("says that a bound was hit", function()
    local charts, wires = asking()
    local result = explored(charts, wires, { configurations = 5, properties = {
      never "left: root.c" } })
    assert.is_nil(result.properties[1].holds)
    assert.matches("not tried: what lies behind the bound on configurations; what was "
      .. "not found is not known\n", tostring(result), 1, true)
    assert.equal("depth", explored(charts, wires, { depth = 2 }).bound)
  end)

  it("has no witness in which data that are not followed decide", function()
    local function is_below(tr) return tr._fsm.n < 3 end
    local function judged(first)
      local right = chart(go("a", "b", "e_x"), go("b", "c", "e_y"))
      right.n, right[first and 2 or 3].effect = 0, function(fsm) fsm.n = 3 end
      right[3].guard = is_below
      local result = explored({ left = chart(go("a", "b", "e_go", "e_x")),
        right = right }, { "left e_x right" }, {
        machines = { right = { vars = { n = { 0, 3 } }, run = { is_below } } },
        properties = { never "right: root.c" } })
      return result.properties[1].holds, result.untried[1]
    end
    local DATA =
      "right: data that the effect root.trans[%d] may write, which is not run"
    assert.same({ nil, DATA:format(2) }, { judged(true) })
    assert.same({ false, DATA:format(3) }, { judged(false) })
  end)

  it("looks at the clock inside of a step", function()
    local looks = 0
    local function clock()
      looks = looks + 1
      return looks
    end
    local right = chart(go("a", "b", "e_x"))
    for i = 1, 12 do
      right["k" .. i], right[#right + 1] = rfsm.conn {}, go("a", "k" .. i, "e_y")
      right[#right].guard = function() return true end
      right[#right + 1] = go("k" .. i, "c")
      right[#right].guard = right[#right - 1].guard
    end
    local result = helper.with(os, { clock = clock }, function()
      return (explored({ left = chart(go("a", "b", "e_go", "e_x")), right = right },
        { "left e_x right" }, { seconds = 12, properties = {
          never { "left: root.b", "right: root.b" } } }))
    end)
    assert.same({ nil, "seconds" }, { result.properties[1].holds, result.bound })
    assert.equal("right: what lies behind the bound on seconds", result.untried[1])
    assert.is_true(looks < 20)
  end)

  -- Returns where a real machine is when its timer has expired, and the verdict on it.
  local function never_b(wires, is_read, ...)
    local result, cell = explored({ left = chart(go("a", "b", "e_go", "e_x")),
      right = one_by_one(...) }, wires, { properties = { never "right: root.b" } })
    local right, now = cell.machines.right, 0
    right.gettime = function() return now, 0 end
    cell:move("right")
    for _ = 1, is_read and 3 or 0 do cell:move("right") end
    cell:move("left")
    cell:move("left", { "e_go" })
    now = 2
    for _ = 1, 4 do cell:move("right") end
    return { rfsm.get_actleaf_fqn(right), tostring(result.properties[1].holds) }
  end

  for _, event in ipairs { "e_every(1)", "e_after(1)" } do
    it("has " .. event .. " come while an event waits", function()
      assert.same({ "root.b", "false" }, never_b({}, false, go("a", "a", "e_done"),
        go("a", "b", event)))
    end)
  end

  it("has a time event come with an event of a wire", function()
    assert.same({ "root.b", "false" }, never_b({ "left e_x right" }, true,
      go("a", "c", "e_x"), go("a", "a", "e_after(1)"),
      go("c", "b", "e_after(1)@root.a"), go("c", "a", "e_done")))
  end)

  it("does not know what a time event does that comes twice", function()
    local function judged(event)
      local result = explored({ right = one_by_one(go("a", "a", "e_done"),
        go("a", "internal", event)) }, {}, { properties = { never "right: root.b" } })
      return { tostring(result.properties[1].holds), result.untried[1] }
    end
    assert.same({ "true" }, judged("e_every(1)"))
    assert.same({ "nil", "right: a time event that comes again while it waits" },
      judged("e_after(1)"))
  end)

  it("names its premises", function()
    local result = explored({ left = chart(go("a", "a", "e_go", "e_x")),
      right = one_by_one(rfsm.trans { src = "a", tgt = "b", events = { "e_x", "e_y" },
        guard = function() return false end }) },
      { { "left e_x right", size = 2 } },
      { machines = { right = { alphabet = { "e_y" } } } })
    assert.same({ "any order, any time", "one event from outside in a move",
      "moves cross: others move also between what a machine reads and the events that "
        .. "it emits then, which are put one by one",
      "a connection for each wire, all of them read at one moment",
      "right: guards free",
      "right: one event an iteration, none from outside while one waits",
      "right: no event outside of the alphabet",
      "wires[1] (left e_x -> right): buffer of 2" }, result.premises)
  end)
end)

-- Returns why a system is not explored.
local function refused(...)
  return (tostring(select(2, pcall(explored, ...))):gsub("^%S+:%d+: ", ""))
end

describe("a property of a system", function()
  local function judged(charts, wires, ...)
    local result, texts = explored(charts, wires, { properties = { ... } }), {}
    for i, each in ipairs(result.properties) do
      texts[i] = each.name .. ": " .. tostring(each.holds)
        .. (each.vacuous and ", " .. each.vacuous or "")
    end
    return texts, result
  end

  -- left: a -e_go-> b, emits e_x; right: a -e_x-> b -e_back-> a, and c -e_x-> c
  local function pair()
    return { left = chart(go("a", "b", "e_go", "e_x"), go("b", "a", "e_go", "e_x")),
      right = chart(go("a", "b", "e_x"), go("b", "a", "e_back")) }, { "left e_x right" }
  end

  it("names states and events of machines", function()
    local charts, wires = pair()
    assert.same({
      "after left: e_go reach right: root.b: true",
      "after right: e_back reach right: root.a: false",
      "always left: root: true",
      "from right: root.b can reach left: root.a: true",
      "never left: root.b and right: root.b: false",
      "never right: root.c: true",
    }, (judged(charts, wires, after("left: e_go").reach("right: root.b"),
      after("right: e_back").reach("right: root.a"), rfsm_checks.always("left: root"),
      from("right: root.b").can_reach("left: root.a"),
      never { "left: root.b", "right: root.b" }, never "right: root.c")))
  end)

  it("counts on each machine to move again and again, and on doos to end", function()
    -- left and right exchange e_x for ever; third takes e_stop when its doo has ended
    local left = chart(rfsm.trans { src = "a", tgt = "a", events = { "e_x" },
      effect = emits "e_y" }, go("a", "b", "e_go", "e_y", "e_stop"),
      go("b", "b", "e_x", "e_y"))
    local right = chart(go("a", "a", "e_y", "e_x"))
    local function third(guard)
      local model = chart(go("a", "b", "e_stop"), rfsm.trans { src = "b", tgt = "c",
        events = { "e_done" }, guard = guard })
      model.b.doo = function() rfsm.yield() end
      return model
    end
    local wires = { "left e_y right", "right e_x left", "left e_stop third" }
    local reach = after("left: e_go").reach("third: root.c")
    assert.same({ "after left: e_go reach third: root.c: true" },
      (judged({ left = left, right = right, third = third() }, wires, reach)))
    local texts, result = judged({ left = left, right = right,
      third = third(function() return true end) }, wires, reach)
    assert.same({ "after left: e_go reach third: root.c: false" }, texts)
    local witness = sequence.lines_of(result.findings[#result.findings].witness)
    assert.matches("third: no transition %-> root.b %(root.trans%[3%] false%)",
      witness[#witness])
  end)

  it("is judged at a moment within a step, too", function()
    local right = chart(go("a", "m", "e_x"))
    right.m = rfsm.state { rfsm.trans { src = "initial", tgt = "root.b" } }
    local charts = { left = chart(), right = right }
    local here, elsewhere = never { "right: root.m", "left: root.a" },
      never { "right: root.m", "left: root.b" }
    assert.same({ "never right: root.m and left: root.a: false",
      "never right: root.m and left: root.b: true" },
      (judged(charts, {}, here, elsewhere)))
  end)

  it("does not count on events from outside to stay away from the goal", function()
    local right = chart(go("a", "b", "e_x"), go("b", "d", "e_done"),
      go("d", "b", "e_back"), go("d", "c", "e_done"))
    right.d = rfsm.state {}
    assert.same({ "after right: e_x reach right: root.c: true" },
      (judged({ right = right }, {}, after("right: e_x").reach("right: root.c"))))
  end)

  it("shows the moves behind the event that do not lead to the goal", function()
    local charts, wires = pair()
    local _, result = judged(charts, wires, after("left: e_go").reach("left: root.c"))
    assert.same({ "1. left: root.trans[1] -> root.a",
      "2. left gets e_go from outside: root.trans[2] -> root.b; sends e_x to right",
    }, { unpack(sequence.lines_of(result.findings[#result.findings].witness), 1, 2) })
  end)

  it("shows the nearest place in which a run may stay, without events from outside",
    function()
      local function witness(...)
        local right = chart(go("a", "b", "e_x"), go("b", "d", "e_done"), ...)
        right.d = rfsm.state {}
        local _, result = judged({ right = right }, {},
          after("right: e_x").reach("right: root.c"))
        local last = result.findings[#result.findings]
        return { unpack(sequence.lines_of(last.witness), 2) }
      end
      local GETS_X = "2. right gets e_x from outside: root.trans[2] -> root.b"
      assert.same({ GETS_X, "3. right: root.trans[3] -> root.d",
        "4. right: root.trans[4] -> root.a" },
        witness(go("d", "a", "e_done"), rfsm.trans { src = "b", tgt = "a", pn = 1,
          events = { "e_quick" } }))
      assert.same({ GETS_X }, witness(go("d", "b", "e_done")))
    end)

  it("holds vacuously if its event never comes", function()
    local charts, wires = pair()
    charts.left[5] = go("a", "b", "e_y")
    charts.right[5] = go("c", "c", "e_z", "e_y")
    wires[2] = "right e_y left"
    assert.same({ "after left: e_y reach left: root.c: true, left: e_y never comes" },
      (judged(charts, wires, after("left: e_y").reach("left: root.c"))))
  end)

  it("is refused if it cannot be judged, or names what is not there", function()
    local function refusal(property)
      local charts, wires = pair()
      return (refused(charts, wires, { properties = { property } })
        :gsub("^spec/system_check_spec.lua:%d+: ", ""))
    end
    assert.equal("rfsm.system.explore: property 'left: root.a until left: root.b': it "
      .. "is not judged for a system, expected: never, always, from(...).can_reach or "
      .. "after(...).reach",
      refusal(rfsm_checks.until_("left: root.a", "left: root.b")))
    assert.equal("rfsm.system.explore: property 'never left: root.d': no "
      .. "state or flag is named 'root.d' (did you mean 'root.a'?)",
      refusal(never "left: root.d"))
    assert.equal("rfsm.system.explore: property 'never lef: root.a': no "
      .. "machine is named 'lef' (did you mean 'left'?)", refusal(never "lef: root.a"))
    assert.equal("rfsm.system.explore: property 'never root.a': 'root.a': "
      .. "expected as in 'arm: root.moving'", refusal(never "root.a"))
    assert.equal("rfsm.system.explore: property 'after left: e_og reach left: root.a': "
      .. "no transition of 'left' names the event 'e_og' (did you mean 'e_go'?)",
      refusal(after("left: e_og").reach("left: root.a")))
    assert.equal("rfsm.system.explore: property 'after e_go reach left: root.a': "
      .. "'e_go': expected as in 'arm: root.moving'",
      refusal(after("e_go").reach("left: root.a")))
  end)

  it("may be refused together with options of machines", function()
    local charts, wires = pair()
    assert.equal("rfsm.system.explore: no machine is named 'lft' (did you mean "
      .. "'left'?)", refused(charts, wires, { machines = { lft = {} } }))
    assert.equal("rfsm.system.explore: machines.left: dry_run: boolean expected, got 1",
      refused(charts, wires, { machines = { left = { dry_run = 1 } } }))
    assert.equal("rfsm.system.explore: machines.left: classes: no transition takes "
      .. "'e_go' with data", refused(charts, wires,
      { machines = { left = { classes = { e_go = { { n = 1 } } } } } }))
    assert.matches("machines.left: unknown option 'timers', expected: alphabet, ",
      refused(charts, wires, { machines = { left = { timers = "free" } } }), 1, true)
    assert.equal("rfsm.system.explore: unknown option 'timers', expected: "
      .. "configurations, depth, machines, overlap, progress, properties, seconds",
      refused(charts, wires, { timers = "free" }))
  end)
end)

describe("a witness of a system", function()
  it("is read again from its text, and drawn", function()
    local charts, wires = asking()
    local result, cell = explored(charts, wires)
    local witness = result.findings[1].witness
    local moves = sequence.read(table.concat(sequence.lines_of(witness), "\n"))
    for _, move in ipairs(moves) do
      cell:move(move.machine, move.events, move.wanted, move.holds)
    end
    assert.equal("root.b", rfsm.get_actleaf_fqn(cell.machines.left))
    assert.equal("root.b", rfsm.get_actleaf_fqn(cell.machines.right))
    assert.equal([[
sequenceDiagram
  participant left
  participant right
  Note over left: root.a
  Note left of left: e_go
  Note over left: root.b
  left->>right: e_ask
  Note over right: root.a
  Note left of right: e_go
  Note over right: root.b
  right->>left: e_ask
  Note over left: root.b
]], sequence.mermaid(cell.names, witness))
  end)
end)

describe("the line of a move", function()
  it("names the wire that is read, and may show data", function()
    assert.same({ { machine = "arm", events = { "e_y" }, holds = false,
      wanted = { from = "boss", event = "e_x" } } }, sequence.read(
      "1. arm gets e_x{a=1,b=2} from boss, e_y from outside: root.t -> root.b"))
  end)
end)

describe("rfsm check of a system", function()
  local FOLDER = "examples/systems/"

  local function checked(name, options)
    return commands.run(("check %s %s%s.lua"):format(options or "", FOLDER, name))
  end

  it("finds the defect of each example, whose witness is replayed", function()
    for name, last in pairs { -- any order: each stands alone
      zone = "left            root.parked\nright           root.asking\n"
        .. "zone            root.free",
      stop = "arm             root.ready\nbase            root.halted\n"
        .. "supervisor      root.stopping_arm",
      protocol = "receiver        root.half\nsender          root.half",
    } do
      local file = helper.file_with("")
      local out, _, status = checked(name .. "/cell", "--record " .. file)
      assert.equal(1, status)
      assert.matches("nobody can go on any more.-recorded in " .. file, out)
      local shown = commands.run(("sim -q -r %s -e show %s%s/cell.lua"):format(file,
        FOLDER, name))
      assert.equal(last, shown:sub(-#last - 1, -2))
      helper.remove_files()
    end
  end)

  it("proves each example when it is mended", function()
    for _, name in ipairs { "zone", "stop", "protocol" } do
      local out, _, status = checked(name .. "/cell_mended")
      assert.equal(0, status)
      assert.matches("cell_mended.lua: ok\n", out)
      assert.matches(": holds", out)
      assert.is_nil(out:match("does not hold"))
      assert.matches("premises: any order, any time", out, 1, true)
    end
  end)

  it("reads the declarations beside the charts, and over these those of the system",
    function()
      local file, written = helper.file_with "", {}
      local function write(name, text)
        written[#written + 1] = file .. name
        helper.write(file .. name, text)
      end
      for _, name in ipairs { "left", "right" } do
        write(name .. ".lua", [[local rfsm = require "rfsm"
          return rfsm.state { info = false, a = rfsm.state {},
            rfsm.trans { src = "initial", tgt = "a" },
            rfsm.trans { src = "a", tgt = "a", events = "e",
              guard = function() end } }]])
        write(name .. "_properties.lua",
          "return { alphabet = {}, exclusive = { 'guard root.trans[2]' } }")
      end
      write("cell.lua", ("return require 'rfsm.system' { left = rfsm.load %q, "
        .. "right = rfsm.load %q, wires = {} }"):format(file .. "left.lua",
        file .. "right.lua"))
      write("cell_properties.lua",
        "return { machines = { left = { alphabet = { 'e' } } } }")
      local out = commands.run("check " .. file .. "cell.lua")
      for _, name in ipairs(written) do os.remove(name) end
      assert.matches("; left: guards free; left: no event outside of the alphabet; "
        .. "left: 1 guard exclusive; right: guards free; right: 1 guard exclusive\n",
        out)
    end)

  -- Charts by name: one emits in its entry, the other takes this event.
  local function pair(entry, event)
    local emitter = rfsm.state { info = false, warn = false,
      a = rfsm.state { final = true, entry = entry },
      rfsm.trans { src = "initial", tgt = "a" } }
    local taker = rfsm.state { info = false, warn = false, a = rfsm.state {},
      b = rfsm.state { final = true }, rfsm.trans { src = "initial", tgt = "a" },
      go("a", "b", event) }
    return { one = emitter, other = taker }
  end

  local function findings_of(entry, event)
    local found = lines_of((explored(pair(entry, event), { "one e_ok other" }, {
      machines = { one = {} } })))
    for i = #found, 1, -1 do
      if not found[i]:find("emits") then table.remove(found, i) end
    end
    return found
  end

  it("compares what is emitted with what is taken, data and names", function()
    local function plain(fsm) fsm.emit "e_ok" end
    local function with_data(fsm) fsm.emit("e_ok", { n = 1 }) end
    local head = "warning wires[1] (one e_ok -> other): 'one' emits 'e_ok' "
    assert.same({}, findings_of(plain, "e_ok"))
    assert.same({}, findings_of(with_data, rfsm.named "e_ok"))
    assert.same({ head .. "with data, 'other' takes the text only (events = { rfsm."
      .. "named 'e_ok' })" }, findings_of(with_data, "e_ok"))
    assert.same({ head .. "without data, 'other' takes it with data only (events = { "
      .. "'e_ok' })" }, findings_of(plain, rfsm.named "e_ok"))
    assert.same({ "warning one: it emits 'e_okk', which no wire from it carries (did "
      .. "you mean 'e_ok'?)" }, findings_of(function(fsm)
      fsm.emit "e_ok"
      fsm.emit "e_okk"
    end, "e_ok"))
    local result = explored(pair(function(fsm)
      fsm.emit "e_ok"
      fsm.emit "e_light"
    end, "e_ok"), { "one e_ok other" }, { machines = { one = {} } })
    assert.matches("; one: 'e_light' goes nowhere, no wire from it carries it;",
      table.concat(result:summary(), "\n"))
  end)

  it("refuses a method that is called with a dot", function()
    local cell = system(pair(print, "e_ok"))
    for _, method in ipairs { "run", "step", "move", "reset", "shuffle", "explore" } do
      assert.error_matches(function() cell[method]() end, ("^rfsm.system.%s: system"
        .. " expected, got nil %%(cell:%s%%(%%.%%.%%.%%), with a colon%%)$"):format(
        method, method))
    end
  end)

  it("has no moves cross by an option of the command", function()
    assert.matches("cell_mended.lua: ok\n.*one arm is inside: holds if moves do not "
      .. "cross\n.*; moves do not cross: ", (checked("zone/cell_mended",
      "--no-overlap")))
    assert.matches("one arm is inside: holds\n.*; moves cross: ",
      (checked "zone/cell_mended"))
  end)

  it("draws the run, and explores nothing if it need not", function()
    local file = helper.file_with("") .. ".mmd"
    checked("zone/cell", "--record " .. file)
    assert.matches("^sequenceDiagram\n  participant left\n", helper.content(file))
    os.remove(file)
    assert.equal("examples/systems/zone/cell.lua: ok\n",
      (checked("zone/cell", "--static")))
  end)
end)

describe("systems of random charts", function()
  it("agree with random runs", function()
    local claim = dofile "spec/support/claims/system.lua"
    assert.is_nil(share.problem(claim, 60, true))
  end)
end)
