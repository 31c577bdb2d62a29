local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local rfsm = require "rfsm"
local json = require "rfsm.json"
local plantuml = require "rfsm.plantuml"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

after_each(helper.remove_files)

-- initial -> m{ initial -> x -> k } ; m.k -> b, x -e1,e2-> "a b"
local function machine()
  return helper.init(state {
    m = state {
      x = state {}, k = conn {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "k", events = { "e1", "e2" }, pn = 2 },
    },
    ["a b"] = state {}, a_b = state {},
    trans { src = "initial", tgt = "m" },
    trans { src = "m.k", tgt = "a b" },
    trans { src = "a b", tgt = "m", events = { "e_again" } },
  })
end

describe("model2tab", function()
  it("gives the structure as plain tables, nodes sorted by name", function()
    local function tr(src, tgt, events, pn)
      return { type = "transition", src = src, tgt = tgt, events = events, pn = pn }
    end
    assert.same({
      id = "root", type = "state",
      transitions = {
        tr("root.initial", "root.m.initial", {}), tr("root.m.k", "root.a b", {}),
        tr("root.a b", "root.m.initial", { "e_again" }),
      },
      subnodes = {
        { id = "a b", type = "state" }, { id = "a_b", type = "state" },
        { id = "initial", type = "connector" },
        {
          id = "m", type = "state",
          transitions = {
            tr("root.m.initial", "root.m.x", {}),
            tr("root.m.x", "root.m.k", { "e1", "e2" }, 2),
          },
          subnodes = {
            { id = "initial", type = "connector" }, { id = "k", type = "connector" },
            { id = "x", type = "state" },
          },
        },
      },
    }, marsh.model2tab(machine()))
  end)

  it("wants an initialised fsm", function()
    local ok, problem = pcall(function() return (marsh.model2tab(state {})) end)
    assert.is_false(ok)
    assert.matches("export_spec.lua:%d+: rfsm.marsh.model2tab: initialised fsm "
      .. "expected", problem)
  end)
end)

describe("actinfo2tab", function()
  it("gives three times false when nothing is active", function()
    assert.same({ false, false, false }, { marsh.actinfo2tab(machine()) })
  end)

  it("gives F and mode of the active leaf", function()
    local fsm = machine()
    rfsm.run(fsm)
    assert.same({ "root.m.x", "done", false }, { marsh.actinfo2tab(fsm) })
  end)
end)

describe("what wants an initialised fsm", function()
  it("raises for anything else, and blames the caller", function()
    for name, f in pairs({ -- any order: each stands alone
      ["rfsm.marsh.actinfo2tab"] = marsh.actinfo2tab,
      ["rfsm.marsh.jsontab"] = marsh.jsontab, ["rfsm.json.encode"] = json.encode,
    }) do
      local ok, problem = pcall(function() return (f(state {})) end)
      assert.is_false(ok)
      assert.matches("export_spec.lua:%d+: " .. name .. ": initialised fsm expected",
        problem)
    end
  end)
end)

describe("rfsm.json", function()
  it("gives the graph and what is active", function()
    local fsm = machine()
    rfsm.run(fsm)
    local decoded = require("dkjson").decode(json.encode(fsm))
    assert.equal(2, decoded.version)
    assert.equal("rfsm_model", decoded.type)
    assert.equal("root.m.x", decoded.active_leaf)
    assert.equal("done", decoded.active_leaf_state)
    assert.equal("root", decoded.graph.id)
    assert.equal(4, #decoded.graph.subnodes)
  end)

  it("writes empty lists as arrays", function()
    assert.matches('"events":%[%]', json.encode(machine()))
    local empty = helper.init(state { x = conn {}, initial = conn {} })
    assert.matches('"transitions":%[%]', json.encode(empty))
  end)

  it("writes the same text each time, internal transitions marked", function()
    assert.equal(json.encode(machine()), json.encode(machine()))
    assert.matches('"tgt":"root.a",\n *"events":%["e"%],\n *"internal":true',
      json.encode(helper.init(state {
        a = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "internal", events = "e" },
      })))
  end)

  it("writes events that JSON does not know as text", function()
    local event = setmetatable({}, { __tostring = function() return "an event" end })
    local fsm = helper.init(state {
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "a", events = { event, 7, true, 1 / 0 } },
    })
    assert.matches('"events":%["an event",7,true,"inf"%]', json.encode(fsm))
  end)
end)

describe("rfsm.json", function()
  local function encoded(events, pn)
    return json.encode(helper.init(state {
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "a", events = events, pn = pn },
    }))
  end

  it("writes numbers alike on each Lua, and so that none is lost", function()
    local text = encoded({ 5.0, 0.1, -2.5, 1e100, 2 ^ 53, 1 / 3, -1 / 0 }, 3.0)
    assert.is_truthy(text:find('"events":[5,0.1,-2.5,1e+100,9007199254740992,'
      .. '0.33333333333333331,"-inf"]', 1, true))
    assert.matches('"pn":3,\n', text)
    assert.matches('"pn":"inf",\n', encoded({}, 1 / 0))
  end)

  it("numbers events that have no text of their own", function()
    local f, t = function() end, {}
    assert.is_truthy(encoded({ f, t, print, f, false }):find('"events":["function 1",'
      .. '"table 1","function 2","function 1",false]', 1, true))
  end)

  it("is UTF-8 whatever the names", function()
    assert.matches('"events":%["\\ufffd","\195\169"%]',
      encoded { "\255", "\195\169" })
    local fsm = helper.init(state { ["\255"] = state {},
      trans { src = "initial", tgt = "\255" } })
    rfsm.run(fsm)
    assert.matches('"active_leaf":"root.\\ufffd"', json.encode(fsm))
  end)
end)

describe("rfsm.plantuml", function()
  it("draws composites, connectors and arrows with unique identifiers", function()
    assert.equal([[
@startuml
title T
state "root" as root {
  state "a b" as root_a_b
  state "a_b" as root_a_b_2
  state "m" as root_m {
    state root_m_k <<choice>>
    state "x" as root_m_x
    [*] --> root_m_x
    root_m_x --> root_m_k : e1, e2
  }
  [*] --> root_m
  root_m_k --> root_a_b
  root_a_b --> root_m : e_again
}
@enduml
]], plantuml.encode(machine(), "T"))
  end)

  it("points at a connector that a transition goes to from outside", function()
    local fsm = helper.init(state {
      out = state {}, m = state { k = conn {}, x = state {},
        trans { src = "initial", tgt = "x" }, trans { src = "k", tgt = "x" } },
      trans { src = "initial", tgt = "out" },
      trans { src = "out", tgt = ".m.k", events = { "e" } },
    })
    assert.matches("\n  root_out %-%-> root_m_k : e\n", plantuml.encode(fsm))
  end)

  it("saves to a file", function()
    local file = helper.file_with("")
    plantuml.save(machine(), file)
    assert.equal(plantuml.encode(machine()), helper.content(file))
  end)
end)
