-- What an extension keeps and reacts to: said once by hooks, known to all who ask.

local alphabet = require "rfsm.shared.alphabet"
local helper = require "spec.helper"
local match = require "rfsm.shared.match"
local rfsm = require "rfsm"
local reactions = require "rfsm.explore.reactions"
local rfsm_checks = require "rfsm_checks"
local snapshot = require "rfsm.snapshot"
require "rfsm.await"
require "rfsm.history"
require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local send = helper.leaf_after

-- An extension: of a state with `coins = 3` the event e_paid comes with the third
-- e_coin. The state need not have a transition that names e_coin.

local function count_coins(fsm, events)
  local leaf = fsm._act_leaf
  for i = 1, leaf and leaf.coins and #events or 0 do
    if events[i] == "e_coin" then leaf._coins = leaf._coins + 1 end
  end
  if leaf and leaf.coins and leaf._coins >= leaf.coins then
    events[#events + 1], leaf._coins = "e_paid@" .. leaf._fqn, 0
  end
end

local function each_counter(fsm, f)
  for _, own in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    if own.coins then f(own) end
  end
end

local function save(fsm)
  local counts = {}
  each_counter(fsm, function(own) counts[own._fqn] = own._coins end)
  return counts
end

local function load(fsm, counts)
  each_counter(fsm, function(own) own._coins = counts and counts[own._fqn] or 0 end)
end

local function reacts(_, own) return own.coins and { "e_coin" } or nil end

local function prepare(fsm)
  each_counter(fsm, function(own) own._coins = 0 end)
  rfsm.pre_step_hook_add(fsm, count_coins)
  rfsm.reset_hook_add(fsm, load)
  rfsm.snapshot_hook_add(fsm, "coins", save, load, true)
  rfsm.reaction_hook_add(fsm, reacts)
end

local function make(event) return event:find("^e_paid@root") and "coins" or nil end

-- wait --e_paid@root.wait--> open --e_close--> wait
local function model()
  return state {
    info = false, warn = false, wait = state { coins = 3 }, open = state {},
    trans { src = "initial", tgt = "wait" },
    trans { src = "wait", tgt = "open", events = { "e_paid@root.wait" } },
    trans { src = "open", tgt = "wait", events = { "e_close" } },
  }
end

describe("an extension that counts an event and makes another", function()
  setup(function() -- in front: a strict machine adds to the list
    table.insert(rfsm.preproc, 1, prepare)
    table.insert(rfsm.makers, 1, make)
  end)

  teardown(function()
    table.remove(rfsm.preproc, 1)
    table.remove(rfsm.makers, 1)
  end)

  local function new_machine(root)
    local fsm = assert(rfsm.init(root or model()))
    rfsm.run(fsm)
    return fsm
  end

  it("is explored, with each count", function()
    local result = rfsm_checks.explore(model())
    assert.equal("7 configurations, 3 of 3 transitions taken, 17 steps run",
      tostring(result):match("^[^\n]*"))
    assert.is_nil(result.findings[1])
  end)

  it("is not explored where its hook does not say so", function()
    local add = rfsm.snapshot_hook_add
    finally(function() rfsm.snapshot_hook_add = add end)
    function rfsm.snapshot_hook_add(fsm, name) add(fsm, name, save, load) end
    assert.matches("1 of 3 transitions taken", tostring(rfsm_checks.explore(model())))
  end)

  it("is kept by snapshots", function()
    local fsm = new_machine()
    send(fsm, "e_coin")
    send(fsm, "e_coin")
    local other = new_machine()
    snapshot.put(other, snapshot.take(fsm))
    assert.equal("root.open", send(other, "e_coin"))
  end)

  it("has its event known to strict machines and checkevents", function()
    local warnings = {}
    local root = model()
    root.strict, root.checkevents = true, true
    function root.warn(text) warnings[#warnings + 1] = helper.without_file(text) end
    send(new_machine(root), "e_coin", "e_none")
    assert.equal(2, #warnings)
    for _, text in ipairs(warnings) do assert.matches("e_none", text) end
  end)

  it("has its event in the alphabet, once, in a region too", function()
    local fsm = new_machine(state {
      info = false, warn = false, p = rfsm.seqand { left = model(), right = model() },
      trans { src = "initial", tgt = "p" },
    })
    local known = alphabet.of_all(fsm)
    assert.same({ { "e_coin" }, { "e_paid@root.wait", "e_close" } },
      { known.reactions, known.list })
    assert.is_true(known.set.e_coin)
  end)

  it("is asked for by state, in the order of the hooks", function()
    local fsm = new_machine()
    rfsm.reaction_hook_add(fsm, function() return { "e_last" } end)
    assert.same({ { "e_coin", "e_last" }, { "e_last" } },
      { (rfsm.reactions(fsm, fsm.wait)), (rfsm.reactions(fsm, fsm.open)) })
  end)

  it("is shown with its word, if it has events", function()
    local fsm = new_machine()
    local function add(events, word)
      rfsm.reaction_hook_add(fsm, function() return events, word end)
    end
    add({ "e_a" }, "keep")
    add(nil, "defer")
    add({ "e_b" }, "count")
    local _, shown = rfsm.reactions(fsm, fsm.wait)
    assert.same({ { events = { "e_a" }, word = "keep" },
      { events = { "e_b" }, word = "count" } }, shown)
  end)

  it("may react to what a predicate accepts", function()
    local fsm = new_machine()
    local function is_five(event) return event == 5 end
    rfsm.reaction_hook_add(fsm, function() return { is_five } end)
    assert.same({ is_five }, alphabet.of(fsm).predicates)
  end)

  it("makes an event that does not come from outside", function()
    assert.same({ "coins", "engine", "timer", "await" }, {
      match.maker_of("e_paid@root.wait"), (match.maker_of("e_done@root.a")),
      (match.maker_of("e_at(3)@root.a")), match.maker_of("await(e_a)@root.a"),
    })
    assert.is_nil(match.maker_of("e_paid"))
    local _, fqn = match.maker_of("e_after(2)@root.a.b")
    assert.equal("root.a.b", fqn)
  end)
end)

describe("an extension that keeps an event for later", function()
  -- e_x that comes in a state with `holds` comes again when that was left.
  local function hold(fsm, events)
    local leaf = fsm._act_leaf
    for i = 1, #events do
      if leaf and leaf.holds and events[i] == "e_x" then fsm._held = true end
    end
    if leaf and not leaf.holds and fsm._held then
      events[#events + 1], fsm._held = "e_x", nil
    end
  end

  local function prepare_holding(fsm)
    rfsm.pre_step_hook_add(fsm, hold)
    rfsm.snapshot_hook_add(fsm, "holds", function() return fsm._held end,
      function(_, kept) fsm._held = kept end, true)
    rfsm.reaction_hook_add(fsm, function(_, own) return own.holds and { "e_x" } end)
  end

  setup(function() table.insert(rfsm.preproc, 1, prepare_holding) end)
  teardown(function() table.remove(rfsm.preproc, 1) end)

  -- busy --e_go--> idle --e_x--> got; the entry of busy sends e_x
  local function holding()
    return state { info = false, warn = false,
      busy = state { holds = true,
        entry = function(fsm) rfsm.send_events(fsm, "e_x") end },
      idle = state {}, got = state { final = true },
      trans { src = "initial", tgt = "busy" },
      trans { src = "busy", tgt = "idle", events = { "e_go" } },
      trans { src = "idle", tgt = "got", events = { "e_x" } },
    }
  end

  local OPTIONS = { sends = { ["entry root.busy"] = { "e_x" } }, alphabet = { "e_go" } }

  it("is explored on, though no event comes from outside", function()
    local fsm = assert(rfsm.init(holding()))
    rfsm.run(fsm)
    assert.equal("root.got", send(fsm, "e_go"))
    local result = rfsm_checks.explore(holding(), OPTIONS)
    assert.matches("3 of 3 transitions taken", tostring(result))
    assert.is_nil(result.findings[1])
  end)

  it("is not at rest where it has an event", function()
    OPTIONS.properties = { rfsm_checks.after("e_go").leads_to("root.got") }
    local verdict = rfsm_checks.explore(holding(), OPTIONS).properties[1]
    assert.is_true(verdict.holds)
    OPTIONS.properties = { rfsm_checks.after("e_go").leads_to("root.busy") }
    assert.is_false(rfsm_checks.explore(holding(), OPTIONS).properties[1].holds)
  end)
end)

describe("what exploration keeps of extensions", function()
  local kept = require "rfsm.explore.kept"

  -- Returns the text of a value that an extension keeps.
  local function text_of(fsm, value, numbers)
    fsm._snapshot_hooks = nil
    rfsm.snapshot_hook_add(fsm, "x", function() return value end, load, true)
    local _, text = kept.read(kept.of(fsm), fsm, numbers or {})
    return text
  end

  it("differs wherever the data does", function()
    local fsm, texts, is_there = assert(rfsm.init(model())), {}, {}
    local VALUES = { "1", 1, 1.5, true, "true", "nil", {}, { {} }, { "a", "b" },
      { "b", "a" }, { a = "b" }, { ["1"] = "x" }, { "x" }, "{}", { "a,2=1:b" } }
    for i = 1, #VALUES do
      texts[i] = text_of(fsm, VALUES[i])
      assert.is_nil(is_there[texts[i]], texts[i])
      is_there[texts[i]] = true
      assert.equal(texts[i], text_of(fsm, VALUES[i]))
    end
  end)

  it("tells events that are tables apart", function()
    local fsm, one, two = assert(rfsm.init(model())), {}, {}
    local numbers = { [one] = 1, [two] = 2 }
    assert.equal("{1:1=event 1}", (text_of(fsm, { ["1"] = one }, numbers)))
    assert.equal("{1=event 2}", (text_of(fsm, { two }, numbers)))
  end)

  it("is nothing where no extension says so", function()
    assert.is_false(kept.of(assert(rfsm.init(model()))))
  end)
end)

describe("rfsm.targets", function()
  local function fsm_with(history)
    return assert(rfsm.init(state {
      info = false, warn = false,
      on = state { history = history, a = state {}, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_b" } } },
      off = state {},
      trans { src = "initial", tgt = "off" },
      trans { src = "off", tgt = "on", events = { "e_on" } },
      trans { src = "on", tgt = "off", events = { "e_off" } },
    }))
  end

  local function names(fsm)
    local list = {}
    for i, node in ipairs(rfsm.targets(fsm[2])) do list[i] = node._fqn end
    return list
  end

  it("lists the target of a transition", function()
    assert.same({ "root.on.initial" }, names(fsm_with(nil)))
  end)

  it("lists every node of a composite with a history, the model's target first",
    function()
      local fsm = fsm_with("deep")
      rfsm.run(fsm)
      send(fsm, "e_on")
      send(fsm, "e_b")
      assert.equal("root.on.b", fsm[2].tgt._fqn)
      local list = names(fsm)
      assert.equal("root.on.initial", list[1])
      table.sort(list)
      assert.same({ "root.on", "root.on.a", "root.on.b", "root.on.initial",
        "root.on.initial" }, list)
    end)
end)

describe("the guard hook of an extension", function()
  local function hot(guard)
    return state { info = false, warn = false, a = state {}, b = state { final = true },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_x" }, guard = guard, is_hot = true } }
  end

  -- Says what an exploration finds while an extension forbids transitions that are hot.
  local function said(guard, options)
    local asked = 0
    local text = helper.with_preproc(function(fsm)
      for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
        if tr.is_hot then
          rfsm.guard_hook_add(fsm, tr, function() asked = asked + 1 return false end)
        end
      end
    end, function()
      options.properties = { p = rfsm_checks.never "root.b",
        q = rfsm_checks.after("e_x").reach "root.b" }
      return helper.without_file(tostring(rfsm_checks.explore(hot(guard), options)))
    end)
    assert.equal(0, asked)
    return text
  end

  it("is explored with both answers, and not asked", function()
    local function yes() return true end
    for _, case in ipairs { { nil, {} }, { yes, {} }, { yes, { run = { yes } } } } do
      local text = said(case[1], case[2])
      assert.matches("e_x %(root%.trans%[2%] true[^)]*%): root%.trans%[2%] %-> root%.b",
        text)
      assert.matches("e_x %(root%.trans%[2%] false%): no transition %-> root%.a", text)
    end
  end)
end)

describe("the sets of events that paths need", function()
  -- Connectors in a row, with two transitions from each to the next.
  local function row(count, events)
    local chart = { info = false, warn = false, a = state {}, z = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k1", events = { "e_a" } } }
    for i = 1, count do
      chart["k" .. i] = rfsm.conn {}
      for way = 1, 2 do
        chart[#chart + 1] = trans { src = "k" .. i, tgt = i < count and "k" .. i + 1
          or "z", events = events and { ("e_%d_%d"):format(i, way) } }
      end
    end
    local fsm = helper.init(state(chart))
    rfsm.run(fsm)
    return reactions.collect(fsm, fsm.a)
  end

  it("are found in one look at each transition, if these name no events", function()
    assert.same({ {}, false, 2 * 16 + 1 }, { row(16).sets, row(16).is_cut,
      row(16).count })
  end)

  it("are all found if they are few", function()
    assert.same({ 8, false }, { #row(3, true).sets, row(3, true).is_cut })
  end)

  it("are cut if they are many, however deep a path is", function()
    assert.same({ true, true, true }, { row(12, true).is_cut, row(30, true).is_cut,
      row(30, true).count <= 20001 })
  end)
end)
