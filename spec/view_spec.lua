-- What a page shows of a machine, without a server: the chart as lists, the log and
-- what is new in it, the events that could do something, pictures.

local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local outline = require "rfsm.observe.outline"
local rfsm = require "rfsm"
local View = require "rfsm.web.view"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local function names_of(numbers, list)
  local names = {}
  for i, number in ipairs(numbers) do names[i] = list[number + 1] end
  return names
end

describe("the outline of a chart", function()
  it("has nodes, edges and events with numbers from 0 on", function()
    local function guard() return true end
    local lists = outline.read(marsh.model2tab(helper.init(state {
      info = false, warn = false, a = state { b = state {}, fork = conn {},
        trans { src = "initial", tgt = "b" },
        trans { src = "b", tgt = "fork", events = { "e_x", 7 }, guard = guard },
        trans { src = "fork", tgt = "b", effect = function() print() end },
        trans { src = "b", tgt = "internal", events = { "e_done" } } },
      trans { src = "initial", tgt = "a" },
    }), true))
    local nodes = {}
    for i, node in ipairs(lists.nodes) do
      nodes[i] = { node.name, node.fqn, node.kind, node.parent }
    end
    assert.same({
      { "root", "root", "composite" }, { "initial", "root.initial", "initial", 0 },
      { "a", "root.a", "composite", 0 }, { "initial", "root.a.initial", "initial", 2 },
      { "b", "root.a.b", "leaf", 2 }, { "fork", "root.a.fork", "connector", 2 },
    }, nodes)
    local edges = {}
    for i, edge in ipairs(lists.edges) do
      edges[i] = { edge.key, edge.src, edge.tgt, (edge.label:gsub("%[.*%]", "[]")),
        table.concat(edge.events, " "), edge.is_internal }
    end
    assert.same({
      { "root.trans[1]", 1, 3, "", "" }, { "root.a.trans[1]", 3, 4, "", "" },
      { "root.a.trans[2]", 4, 5, "e_x, 7 []", "0 1" },
      { "root.a.trans[3]", 5, 4, "/ print()", "" },
      { "root.a.trans[4]", 4, 4, "done", "2", true },
    }, edges)
    assert.same({ { text = "e_x", words = "e_x", is_own = false },
      { text = "7", words = "7", is_own = false },
      { text = "e_done@root.a.b", words = "done", is_own = true } }, lists.events)
    assert.same({ "e_x", 7, "e_done@root.a.b" }, lists.values)
  end)

  it("has regions behind the states of their owner", function()
    local function region() return state { x = state {},
      trans { src = "initial", tgt = "x" } } end
    local lists = outline.read(marsh.model2tab(helper.init(state {
      info = false, warn = false, both = rfsm.seqand { left = helper.init(region()),
        right = helper.init(region()) },
      trans { src = "initial", tgt = "both" } }), true))
    local regions = {}
    for _, node in ipairs(lists.nodes) do
      if node.is_region then regions[#regions + 1] = { node.fqn, node.kind } end
    end
    assert.same({ { "root.both.left", "composite" },
      { "root.both.right", "composite" } }, regions)
    assert.equal("composite", lists.nodes[lists.number_of["root.both"] + 1].kind)
  end)

  it("lists the events that could do something, also behind connectors", function()
    local lists = outline.read(marsh.model2tab(helper.init(state {
      info = false, warn = false, a = state {}, b = state {}, c = state { d = state {},
        trans { src = "initial", tgt = "d", events = { "e_in" } } }, k = conn {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e_k" } },
      trans { src = "k", tgt = "k", events = { "e_loop" } },
      trans { src = "k", tgt = "b", events = { "e_b" } },
      trans { src = "a", tgt = "c", events = { "e_c" } },
      trans { src = "b", tgt = "a" },
    }), true))
    local events = {}
    for i, event in ipairs(lists.events) do events[i] = event.text end
    local function possible(fqn)
      local numbers, any = outline.possible(lists, { 0, lists.number_of[fqn] })
      return { names_of(numbers, events), any }
    end
    assert.same({ { "e_k", "e_loop", "e_b", "e_c", "e_in" }, false }, possible "root.a")
    assert.same({ {}, true }, possible "root.b")
    assert.same({ {}, false }, possible "root.c.d")
  end)
end)

describe("a view", function()
  local now = 0
  local Fake = setmetatable({}, { __index = View })
  Fake.__index = Fake
  function Fake.now()
    return { active = { 0, 2 }, leaf = "root.off", mode = "done", queue = {} }
  end

  local function new_view()
    return View.create(Fake, helper.lamp(), function() return now end)
  end

  local function numbers_of(message)
    local numbers = {}
    for i, entry in ipairs(message.log) do numbers[i] = entry.number end
    return { #numbers, numbers[1], numbers[#numbers], message.skipped }
  end

  it("tells a page that knows nothing all, and another one what is new", function()
    local view = new_view()
    view:see_nodes { 0, 2, 2 }
    view:see_edge(1)
    view:note("step", "a", { "e_push", 7 }, view:moment())
    local message, cursor = view:state(nil)
    assert.same({ true, { 0, 2 }, { 1 }, { 1 }, { 2, 3 }, { 1, 3 }, 0 },
      { message.is_full, message.seen_nodes, message.seen_edges, message.taken,
        message.states, message.transitions, message.skipped })
    assert.same({ { number = 1, at = 0, kind = "step", turn = 0, text = "a",
      active = { 0, 2 }, leaf = "root.off", mode = "done", queue = {}, taken = { 1 },
      states = { 2, 3 }, transitions = { 1, 3 }, enabled = { 0 }, any = false,
      failures = {}, events = { "e_push", "7" } } }, message.log)
    now = 2
    view:see_nodes { 3 }
    view:see_edge(2)
    view:note("note", "b")
    message = view:state(cursor)
    assert.same({ false, { 3 }, { 2 }, { 2 }, { 3, 3 }, { 2, 3 }, 0 },
      { message.is_full, message.seen_nodes, message.seen_edges, message.taken,
        message.states, message.transitions, message.skipped })
    assert.same({ { number = 2, at = 2, kind = "note", turn = 0, text = "b" } },
      message.log)
    message = view:state(cursor) -- another page
    assert.same({ { 3 }, { 2 } }, { message.seen_nodes, message.taken })
  end)

  it("counts its changes", function()
    local view = new_view()
    for i, change in ipairs { function() view:touch() end,
      function() view:note("note", "x") end, function() view:add_failure(2) end,
      function() view:go_back(0) end } do
      local before = view.revision
      change()
      assert.equal(i, view.revision > before and i)
    end
  end)

  it("sends 60 entries at a time, 500 to a new page, and says how many not", function()
    local view = new_view()
    view:note("note", "first")
    local _, cursor = view:state(nil)
    for i = 1, 160 do view:note("note", "text " .. i) end
    assert.same({ 60, 102, 161, 100 }, numbers_of(view:state(cursor)))
    assert.same({ 161, 1, 161, 0 }, numbers_of(view:state(nil)))
    for i = 1, 2000 do view:note("note", "text " .. i) end
    assert.same({ 500, 1662, 2161, 0 }, numbers_of(view:state(nil)))
    assert.is_true(#view.log < 1000 and #view.log >= 500)
    _, cursor = view:state(nil)
    assert.same({ 0, nil, nil, 0 }, numbers_of(view:state(cursor)))
  end)

  it("cuts long texts", function()
    local view = new_view()
    view:note("output", ("x"):rep(3000))
    assert.equal(2000, #view:state(nil).log[1].text)
  end)

  it("forgets what came behind a turn, and a page gets all again", function()
    local view = new_view()
    for turn = 0, 3 do
      view:begin_turn(turn)
      view:note("step", "turn " .. turn)
      view:see_edge(turn)
    end
    local _, cursor = view:state(nil)
    view:go_back(1)
    local message = view:state(cursor)
    assert.same({ true, "turn 0", "turn 1", nil }, { message.is_full,
      message.log[1].text, message.log[2].text, message.log[3] })
    assert.same({ {}, { 0, 1, 2, 3 }, 1 },
      { message.taken, message.seen_edges, view.turn })
  end)

  it("has the transitions of a turn until the next one, 60 at most", function()
    local view = new_view()
    view:see_edge(0)
    view:see_edge(1)
    assert.same({ 0, 1 }, view:state(nil).taken)
    assert.same({ 0, 1 }, view:state(nil).taken)
    view:see_edge(2)
    assert.same({ 2 }, view:state(nil).taken)
    for _ = 1, 100 do view:see_edge(1) end
    assert.equal(60, #view:state(nil).taken)
    view:see_edge(nil) -- one that is not in the chart
    assert.same({}, view:state(nil).taken)
  end)

  it("counts failures by node", function()
    local view = new_view()
    assert.same({}, view:state(nil).failures)
    for _, number in ipairs { 3, 0, 3 } do view:add_failure(number) end
    assert.same({ 0, 1, 3, 2 }, view:state(nil).failures)
  end)

  it("finds the event in a message", function()
    local view = new_view()
    assert.same({ "e_push", "e_x", "" }, { view:event_of { event = 0 },
      view:event_of { event = "e_x" }, view:event_of { event = "" } })
    for _, event in ipairs { -1, 1, 0.5, {}, true } do
      assert.is_nil(view:event_of { event = event })
    end
    assert.is_nil(view:event_of {})
  end)
end)
