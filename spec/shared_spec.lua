-- What several products share: calls, the alphabet of a machine, traversals.

local rfsm = require "rfsm"
require "rfsm.await"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local calls = require "rfsm.shared.calls"
local order = require "rfsm.shared.order"

local state, trans = rfsm.state, rfsm.trans

describe("a protected call", function()
  it("returns all results", function()
    assert.same({ true, 1, nil, 3, n = 4 }, (function(...)
      return { n = select("#", ...), ... }
    end)(calls.try(function(...) return ... end, 1, nil, 3)))
  end)

  it("returns any failure", function()
    local failure = {}
    local ok, found = calls.try(error, failure)
    assert.is_false(ok)
    assert.equal(failure, found)
    local _, none = calls.try(error) -- Lua 5.5 has a text in place of nil
    assert.is_true(none == nil or none == "<no error object>")
  end)

  it("lets an interrupt through as itself", function()
    local function interrupted() error("x.lua:7: interrupted!", 0) end
    assert.same({ false, "x.lua:7: interrupted!" },
      { pcall(calls.try, interrupted) })
  end)
end)

describe("the text of arguments", function()
  it("has each of them, nil included", function()
    assert.equal("1, nil, x, 2.5, false, nil",
      calls.text(", ", 1.0, nil, "x", 2.5, false, nil))
    assert.equal("", calls.text(", "))
  end)
end)

describe("the alphabet of a machine", function()
  local function is_odd(event) return event == "odd" end
  local object = setmetatable({}, { __eq = function() error("compared") end })

  local function machine(region)
    return assert(rfsm.init(state { warn = false, info = false, initial = rfsm.conn {},
      a = region and rfsm.seqand { arm = region } or state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_2", "await(e_x, e_1)", is_odd } },
      trans { src = "b", tgt = "a", events = { object, "e_2", 7 } },
    }))
  end

  it("has events in the order of the tree, those awaited, and predicates", function()
    local known = alphabet.of(machine())
    assert.same({ "e_2", "await(e_x, e_1)@root.a", object, 7 }, known.list)
    assert.same({ "e_x", "e_1" }, known.awaited)
    assert.same({ is_odd }, known.predicates)
    for _, event in ipairs { "e_2", "e_x", "e_1", 7, is_odd, object } do
      assert.is_true(known.set[event])
    end
    assert.is_nil(known.set.e_3)
    assert.is_false(known.takes_any)
  end)

  it("knows whether any event will do", function()
    local fsm = assert(rfsm.init(state { warn = false, info = false, a = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "a" } }))
    assert.is_true(alphabet.of(fsm).takes_any)
  end)

  it("has events of regions where they are asked for", function()
    local fsm = machine(state { c = state {}, initial = rfsm.conn {},
      trans { src = "initial", tgt = "c" },
      trans { src = "c", tgt = "c", events = { "e_inner" } } })
    assert.is_nil(alphabet.of(fsm).set.e_inner)
    assert.is_true(alphabet.of_all(fsm).set.e_inner)
    assert.is_true(alphabet.of_all(fsm).set.e_2)
  end)
end)

describe("a traversal", function()
  it("has all keys once, with their values", function()
    local t, seen = { 1, 2, x = 3, [false] = 4 }, {}
    for key, value in order.each(t) do
      assert.is_nil(seen[key])
      seen[key] = value
    end
    assert.same(t, seen)
  end)
end)

describe("two words", function()
  local CASES = {
    { "events", "Events", true }, { "on_exit", "onexit", true }, -- case, underscores
    { "guard", "gard", true }, { "gard", "guard", true }, { "doo", "dooo", true },
    { "entry", "enrty", true }, { "exit", "edit", false }, { "entry", "en", false },
    { "abcd", "badc", false }, { "", "a", true }, { "", "", true },
  }
  for _, case in ipairs(CASES) do
    local first, second, is_near = case[1], case[2], case[3]
    it(("'%s' and '%s' look %s"):format(first, second,
      is_near and "alike" or "different"), function()
      assert.equal(is_near, advice.is_near(first, second))
    end)
  end
end)
