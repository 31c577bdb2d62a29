-- A machine is drawn as it is, whoever observes it: tools that replace its functions
-- for a while are not seen in descriptions and pictures.

local helper = require "spec.helper"
local instrument = require "rfsm.shared.instrument"
local LocalView = require "rfsm.web.local_view"
local marsh = require "rfsm.marsh"
local record = require "rfsm.record"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local snapshot = require "rfsm.snapshot"
local stream = require "rfsm.observe.stream"

local state, trans = rfsm.state, rfsm.trans

local function near() return true end

-- Tools that look at a machine, and replace some of its functions while they do. Each
-- is called with a machine, and may return a function that ends it.
local OBSERVERS = {
  coverage = function(fsm) rfsm_checks.coverage(fsm) end,
  ["a recording"] = function(fsm)
    local recorder = record.record(fsm, {})
    return function() recorder:stop() end
  end,
  ["a listener"] = function(fsm)
    local own = stream.follow(fsm, {
      guard = function(_, tr, guard, events) return guard(tr, events) end })
    return function() own:stop() end
  end,
  ["watched properties"] = function(fsm)
    rfsm_checks.watch_properties(fsm, { rfsm_checks.never "root.b" })
  end,
  ["a view"] = function(fsm)
    local view = LocalView.new(fsm)
    view:observe(true)
    return function() view:close() end
  end,
  ["dry mode"] = function(fsm)
    local changes = {}
    for _, at in ipairs(rfsm.machines(fsm)) do
      instrument.take_functions(changes, at.machine)
    end
    return function() instrument.give_back(changes) end
  end,
}

describe("a machine that is observed", function()
  local function hot() return true end

  -- A machine with callbacks everywhere, guards that are inherited, and a region.
  local function guarded()
    local function region()
      return state { x = state { doo = near }, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "x", events = { "e" }, guard = hot, effect = near } }
    end
    local base = trans { guard = hot }
    return helper.started(state {
      a = state { entry = near, exit = near, doo = near }, b = state {},
      par = rfsm.seqand { r = region(), entry = near, exit = near },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e" }, guard = hot, effect = near },
      base:new { src = "b", tgt = "par", events = { "e" } },
    })
  end

  -- Returns pictures of a machine, and what the checks find in it.
  local function pictures_of(fsm)
    local texts = { findings = table.concat(rfsm_checks.check(fsm), "\n") }
    for i, name in ipairs { "dot", "json", "mermaid", "plantuml" } do
      texts[i] = require("rfsm." .. name).encode(fsm)
    end
    return texts
  end

  local expected = pictures_of(guarded())

  for name, observe in pairs(OBSERVERS) do -- any order: each stands alone
    it("by " .. name .. " is drawn as it is, and when that has ended", function()
      local fsm = guarded()
      local finish = observe(fsm)
      assert.same(expected, pictures_of(fsm))
      observe(fsm)
      assert.same(expected, pictures_of(fsm))
      if finish then finish() end
      assert.same(expected, pictures_of(fsm))
    end)
  end

  it("has its own guards again when all have ended, in any order", function()
    local fsm = guarded()
    local first, second = OBSERVERS["a recording"](fsm), OBSERVERS["a listener"](fsm)
    local third = OBSERVERS["a recording"](fsm)
    second()
    first()
    third()
    assert.equal(hot, fsm[2].guard)
    assert.equal(hot, fsm[3].guard)
  end)

  it("is drawn with a guard that a program has set since", function()
    local fsm = guarded()
    local finish = OBSERVERS["a recording"](fsm)
    fsm[2].guard = near
    local tab = marsh.model2tab(fsm, true)
    assert.equal("near", tab.transitions[2].guard)
    finish()
    assert.equal(near, fsm[2].guard)
  end)
end)

describe("a field in which a program keeps an element", function()
  local function shown(fsm)
    local places = {}
    for i, at in ipairs(rfsm.elements(fsm)) do places[i] = rfsm.location_of(at) end
    places[#places + 1] = require("rfsm.json").encode(fsm)
    places[#places + 1] = require("rfsmpp").fsm2str(fsm)
    places[#places + 1] = snapshot.take(fsm).chart
    places[#places + 1] = rfsm.fsmobj_tochar(fsm.a)
    return places
  end

  it("makes it no member of the machine", function()
    local function chart()
      return state { info = false, warn = false, a = state {},
        c = state { x = state {}, trans { src = "initial", tgt = "x" } },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "c", events = { "e_b" } },
        trans { src = "c", tgt = "a", events = { "e_a" } } }
    end
    local fsm, other = helper.started(chart()), helper.init(chart())
    local expected = shown(fsm)
    fsm.last, fsm.other, fsm[9], fsm.tr = fsm.a, other, fsm.c, fsm[2]
    fsm.model = state {}
    fsm.a.back, fsm.a.me, fsm.a.root, fsm.c.last = fsm.c, fsm.a, fsm, fsm.c.x
    assert.same(expected, shown(fsm))
    local recorder = record.record(fsm, {})
    assert.equal("root.c.x", helper.leaf_after(fsm, "e_b"))
    recorder:stop()
  end)
end)
