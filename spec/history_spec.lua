-- History: composites that are entered where they were left. The claim "history" of
-- spec/support/claims compares random charts with a model.

local helper = require "spec.helper"
local claim = require "spec.support.claims.history"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
require "rfsm.history"

local conn, state, trans = rfsm.conn, rfsm.state, rfsm.trans

-- (initial) -> off --e_p--> on[ (initial) -> a --e_n--> b[ c --e_n--> d ] ] --e_p-->
-- off
local function chart(history, members)
  local model = {
    info = false, warn = false, off = state {},
    on = state { history = history, a = state {},
      b = state { c = state {}, d = state {},
        trans { src = "initial", tgt = "c" },
        trans { src = "c", tgt = "d", events = "e_n" } },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = "e_n" },
      trans { src = "b", tgt = "initial", events = "e_inside" } },
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "on", events = "e_p" },
    trans { src = "on", tgt = "off", events = "e_p" },
    trans { src = "on", tgt = "on", events = "e_self" },
  }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a set
  return state(model)
end

-- A change of the chart, and the story that a machine of it goes: see helper.story.
local STORIES = {
  { "without a value enters its initial", nil, "=off e_p=a e_n=c e_p=off e_p=a" },
  { "that is shallow enters the substate that was active last", "shallow",
    "=off e_p=a e_n=c e_n=d e_p=off e_p=c e_n=d e_self=c" },
  { "that is deep enters the leaf that was active last", "deep",
    "=off e_p=a e_p=off e_p=a e_n=c e_n=d e_p=off e_p=d e_self=d" },
  { "begins anew after a transition inside that leads to the initial", "deep",
    "=off e_p=a e_n=c e_inside=a e_p=off e_p=a" },
  { "that is deep asks no shallow one in it", "deep",
    "=off e_p=a e_n=c e_n=d e_p=off e_p=d",
    function(m) m.on.b.history = "shallow" end },
  { "that is shallow asks a deep one in it", "shallow",
    "=off e_p=a e_n=c e_n=d e_p=off e_p=d", function(m) m.on.b.history = "deep" end },
  { "begins anew when it came to its end", "deep",
    "=off e_p=a e_n=c e_n=d e_p=off e_p=c",
    function(m) m.on.b.d.final = true end },
  { "cannot begin anew without an initial", "deep", "=off e_p=a e_x=e e_p=off e_p=e",
    function(m)
      m.on.f = state { e = state { final = true } }
      m.on[4] = trans { src = "a", tgt = ".f.e", events = "e_x" }
    end },
  { "is entered likewise through connectors", "deep",
    "=off e_p=a e_n=c e_n=d e_p=off e_k=d", function(m)
      m.k = conn {}
      m[5] = trans { src = "off", tgt = "k", events = "e_k" }
      m[6] = trans { src = "k", tgt = "on" }
    end },
  { "of the name of a state in it is that state", nil,
    "=off e_p=a e_h=history e_p=off e_p=a", function(m)
      m.on.history = state {}
      m.on[4] = trans { src = "a", tgt = "history", events = "e_h" }
    end },
}

describe("a composite with a history", function()
  for _, case in ipairs(STORIES) do
    local name, history, story, change = case[1], case[2], case[3], case[4]
    it(name, function()
      local model = chart(history)
      if change then change(model) end
      assert.equal(story, helper.story(helper.init(model), story))
    end)
  end

  it("runs neither guard nor effect of its initial transition then", function()
    local model = chart "deep"
    model.on[1].guard, model.on[1].effect = function() return true end, false
    local trace, fsm = helper.traced(model)
    helper.story(fsm, "=off e_p=a e_p=off")
    fsm.on[1].guard = function() error("asked") end
    helper.clear(trace)
    helper.post_and_run(fsm, "e_p")
    assert.same({ "exit root.off", "effect root.off->root.on.a", "entry root.on",
      "entry root.on.a" }, trace)
  end)

  it("leaves a transition alone that a program leads elsewhere", function()
    local fsm = helper.init(chart "deep")
    helper.story(fsm, "=off e_p=a e_p=off")
    fsm[2].tgt = fsm.on.b.c
    assert.equal("e_p=c", helper.story(fsm, "e_p=c"))
    fsm[2].tgt = fsm.off
    local story = "e_n=d e_p=off e_p=off"
    assert.equal(story, helper.story(fsm, story))
  end)

  it("remembers for each machine by itself, until it is reset", function()
    local model = chart "deep"
    local fsm, other = helper.init(model), helper.init(model)
    helper.story(fsm, "=off e_p=a e_n=c e_p=off")
    assert.equal("=off e_p=a", helper.story(other, "=off e_p=a"))
    assert.equal("e_p=c", helper.story(fsm, "e_p=c"))
    rfsm.reset(fsm)
    assert.equal("=off e_p=a", helper.story(fsm, "=off e_p=a"))
  end)

  it("remembers in a region as long as the state of the regions is active", function()
    local fsm = helper.init(state {
      info = false, warn = false, out = state {},
      par = rfsm.seqand { run = true, x = chart "deep" },
      trans { src = "initial", tgt = "par" },
      trans { src = "par", tgt = "out", events = "e_out" },
      trans { src = "out", tgt = "par", events = "e_in" },
    })
    helper.story(fsm, "=par e_p=par e_n=par e_p=par e_p=par")
    local region = rfsm.regions(fsm.par)[1]
    assert.equal("root.on.b.c", rfsm.get_actleaf_fqn(region))
    helper.story(fsm, "e_out=out e_in=par e_p=par")
    assert.equal("root.on.a", rfsm.get_actleaf_fqn(region))
  end)

  it("takes part in a merge", function()
    local fsm = helper.init(chart "deep")
    helper.story(fsm, "=off e_p=a")
    assert(rfsm.fsm_merge(fsm, fsm.on, state {}, "x"))
    assert(rfsm.fsm_merge(fsm, fsm.on, trans { src = "a", tgt = "x", events = "e_x" }))
    assert(rfsm.fsm_merge(fsm, fsm, trans { src = "off", tgt = "on", events = "e_y" }))
    local story = "e_x=x e_p=off e_p=x e_p=off e_y=x"
    assert.equal(story, helper.story(fsm, story))
  end)

  it("remembers in a snapshot, also in another machine", function()
    local fsm = helper.init(chart "deep")
    helper.story(fsm, "=off e_p=a e_n=c e_n=d e_p=off")
    local other = assert(snapshot.restore(chart "deep", snapshot.take(fsm)))
    assert.equal("e_p=d", helper.story(other, "e_p=d"))
  end)

  it("is in pictures and why what it is, wherever the machine was", function()
    local fsm, plantuml = helper.started(chart "deep"), require "rfsm.plantuml"
    local before = plantuml.encode(fsm)
    assert.matches("root_on : (H*)", before, 1, true)
    assert.matches("root_off --> root_on : e_p", before, 1, true)
    helper.story(fsm, "e_p=a e_n=c e_p=off")
    assert.equal(before, plantuml.encode(fsm))
    local path = rfsm.node_find_enabled(fsm, fsm.off, { "e_p" })
    assert.equal(fsm.on.b.c, path.nextl[1].next.node)
    local other = plantuml.encode(helper.init(chart "shallow"))
    assert.matches("root_on : (H)", other, 1, true)
  end)

  it("is explored with what it remembers", function()
    local explore = require("rfsm_checks").explore
    -- not entered, off and three leaves; off with each thing that it can remember
    assert.equal(1 + 1 + 3, explore(chart()).configurations)
    assert.equal(1 + 3 + 3, explore(chart "shallow").configurations)
    assert.equal(1 + 4 + 3, explore(chart "deep").configurations)
    assert.equal(0, #explore(chart "deep").findings)
  end)

  it("is explored with what it needs when it remembers nothing", function()
    local model = chart("deep", { trans { src = "initial", tgt = ".on.a" } })
    model.on.a.final = true -- as all that is in it: then it begins anew
    model.on[1].events = { "e_x" }
    local found = require("rfsm_checks").explore(model)
    assert.equal(found.transitions, found.taken)
  end)
end)

local PROBLEMS = {
  { "shalow", "'shallow' or 'deep' expected, got string 'shalow' (did you mean "
    .. "'shallow'?)" },
  { true, "'shallow' or 'deep' expected, got boolean (there are 'shallow', 'deep')" },
  { "deep", "only a composite can have a history", "a" },
  { "shallow", "'shallow' enters 'root.on.b' by its initial transition, there is none "
    .. "(did you mean 'deep'?)", "on", function(model)
      model.on.b[1].src, model.on[2].tgt = "c", ".b.c"
    end },
}

describe("the history of a state", function()
  for _, case in ipairs(PROBLEMS) do
    it("is refused if " .. case[2]:match("^[^(]*"), function()
      local value, text, name, change = case[1], case[2], case[3] or "on", case[4]
      local model = chart()
      if change then change(model) end
      local owner = name == "a" and model.on.a or model.on
      owner.history, model.err = value, false
      local _, problem = rfsm.init(model)
      assert.equal("rfsm.init: the model has 1 problem\n  root.on."
        .. (name == "a" and "a." or "") .. "history: " .. text,
        helper.without_file(problem))
    end)
  end
end)

it("history is as its model says #random", function()
  assert.is_nil(share.problem(claim, 100))
end)
