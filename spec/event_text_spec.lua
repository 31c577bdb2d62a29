-- The text of an event: one function, and all tools that show events.

local helper = require "spec.helper"
local rfsm = require "rfsm"
local checks = require "rfsm_checks"
local location = require "rfsm.shared.location"
local migrate = require "rfsm.snapshot.migrate"
local shape = require "rfsm.snapshot.shape"
local snapshot = require "rfsm.snapshot"
require "rfsm.defer"

local state, trans, conn, named = rfsm.state, rfsm.trans, rfsm.conn, rfsm.named

local paid, cyclic = named "e_paid", { name = "e_c" }
cyclic.self = cyclic

local refusing = setmetatable({}, { __tostring = function() error "no" end,
  __index = function() error "no" end })

describe("the text of an event", function()
  for _, case in ipairs {
    { "a text", "e_x", "e_x", "e_x" },
    { "a number", 1.5, "1.5", "1.5" },
    { "a name that a transition waits for", paid, "e_paid", "e_paid{..}" },
    { "an event with data", { name = "e_paid", amount = 12, by = { id = 3 } }, "e_paid",
      "e_paid{amount=12,by={id=3}}" },
    { "an event without data", { name = "e_paid" }, "e_paid", "e_paid{}" },
    { "a list", { "e_a", "e_b" }, "a table", '{ "e_a", "e_b" }' },
    { "a name that is no text", { name = 5 }, "a table", "{ name = 5 }" },
    { "a predicate", function() end, "a predicate", "a predicate" },
    { "a table that refuses", refusing, "a table", "a table" },
    { "NaN inside", { name = "e_n", x = 0 / 0 }, "e_n", "e_n{x=nan}" },
    { "a cycle", cyclic, "e_c", "e_c{self={..}}" },
    { "deep data", { name = "e_d", t = { { { 1 } } } }, "e_d", "e_d{t={{{..}}}}" },
    { "a long text", { name = "e_l", s = ("\195\188"):rep(60) }, "e_l",
      'e_l{s="' .. ("\195\188"):rep(11) .. '.."}' },
    { "many fields", { name = "e_m", a = ("a"):rep(24), b = ("b"):rep(24),
      c = ("c"):rep(24) }, "e_m", 'e_m{a="' .. ("a"):rep(24) .. '",b="'
        .. ("b"):rep(24) .. '",..}' },
    { "data of just 80 bytes", { name = "e_m", a = ("a"):rep(24), b = ("b"):rep(24),
      c = ("c"):rep(16) }, "e_m", 'e_m{a="' .. ("a"):rep(24) .. '",b="'
        .. ("b"):rep(24) .. '",c="' .. ("c"):rep(16) .. '"}' },
    { "a text as of an address", "table: 0x1", "table: 0x1", "table: 0x1" },
    { "the name of a type", "string", "string", "string" },
    { "a class with a name", setmetatable({}, { __name = "Coin" }), "a table",
      "a table" },
    { "a file", io.stdout, "a userdata", "a userdata" },
    { "a key that is too long", { name = "e_k", [("k"):rep(99)] = 1 }, "e_k",
      "e_k{..}" },
  } do
    it("is bounded and without an address for " .. case[1], function()
      assert.same({ case[3], case[4] },
        { rfsm.event_text(case[2]), rfsm.event_text(case[2], true) })
    end)
  end
end)

-- a -e_paid{..}-> b -e_paid{..}, e_x-> a, over a connector
local function chart(name)
  return state { info = false, warn = false,
    a = state {}, b = state {}, k = conn {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "k", events = { named(name) } },
    trans { src = "k", tgt = "b" },
    trans { src = "b", tgt = "a", events = { named(name), "e_x" } } }
end

local function machine(name)
  local fsm = helper.init(chart(name or "e_paid"))
  rfsm.run(fsm)
  return fsm
end

describe("an event with data", function()
  for _, exporter in ipairs { "dot", "mermaid", "plantuml", "json" } do
    it("is drawn by its name: " .. exporter, function()
      local text = require("rfsm." .. exporter).encode(machine())
      assert.is_truthy(text:find("e_paid", 1, true))
      assert.is_nil(text:find("predicate", 1, true) or text:find("function", 1, true))
    end)
  end

  for _, exporter in ipairs { "dot", "mermaid", "plantuml" } do
    it("is a row of the state that defers it: " .. exporter, function()
      local fsm = helper.init(state { info = false, warn = false,
        a = state { defer = { "e_job", named "e_paid" } }, b = state { doc = "free",
          defer = { "e_x" } },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_go" } } })
      local text = require("rfsm." .. exporter).encode(fsm)
      assert.is_truthy(text:find("e_job, e_paid / defer", 1, true))
      assert.is_truthy(text:find("e_x / defer", 1, true))
      assert.is_truthy(require("rfsm.json").encode(fsm):find(
        '"reactions":%[{%s*"word":"defer",%s*"words":%["e_job","e_paid"%]%s*}%]'))
    end)
  end

  it("is named by why, with the data that are sent", function()
    local _, text = checks.why(machine(), { name = "e_other", n = 1 })
    assert.equal("no transition would be taken on e_other{n=1} in root.a\n"
      .. "  root.trans[2] (a -> k): waits for e_paid{..}", (helper.without_file(text)))
  end)

  it("is among the enabled events", function()
    local list, text = checks.enabled(machine())
    assert.same({ named "e_paid", any = false }, list)
    assert.equal("e_paid", text)
  end)

  it("is enabled if there is a way through connectors, whatever guards say", function()
    local function enabled(events)
      local model = chart "e_paid"
      model[2].guard, model[3].events = function() return false end, events
      local fsm = helper.init(model)
      rfsm.run(fsm)
      return (checks.enabled(fsm))
    end
    assert.same({ any = false }, enabled { "e_paid" })
    assert.same({ named "e_paid", any = false },
      enabled { "e_x", named "e_paid" })
  end)

  it("is in the names of transitions", function()
    local tr = machine().a._otrs[1]
    local entries = { { tr = tr, prefix = "root" } }
    location.add_names(entries)
    assert.equal("a -e_paid-> k", entries[1].name)
  end)

  it("makes a difference for the comparison of charts", function()
    local _, _, list = snapshot.restore(chart "e_bought", snapshot.take(machine()))
    assert.same({ "new: root.a -> root.k on e_bought{..}",
      "new: root.b -> root.a on e_bought{..}, e_x",
      "gone: root.a -> root.k on e_paid{..}",
      "gone: root.b -> root.a on e_paid{..}, e_x" }, list)
  end)

  it("does not keep an older snapshot from being taken", function()
    local snap = snapshot.take(machine())
    snap.chart = "71aac70058f"
    assert.is_nil((migrate.changes(machine(), snap)))
    assert.equal("root.a", rfsm.get_actleaf_fqn(snapshot.restore(chart "e_paid", snap)))
  end)

  it("is found in a line of the structure by its name", function()
    local lines = shape.structure(chart "e_paid")
    local found = {}
    for _, line in ipairs(lines) do
      if shape.has_event(line, "e_paid") then found[#found + 1] = line end
    end
    assert.same({ "root.a -> root.k on e_paid{..}",
      "root.b -> root.a on e_paid{..}, e_x" }, found)
  end)
end)
