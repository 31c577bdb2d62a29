-- An error that no callback raised, such as Control-C in a terminal, may strike at any
-- VM instruction of the engine. Here it does so on each kind of machine: the share of
-- this Lua. It reaches the caller as itself. After that the machine goes on: one
-- callback may be missing, none is called twice or out of order, no event is lost.

local compiling = require "spec.support.compiling"
local helper = require "spec.helper"
local interrupts = require "spec.support.interrupts"
local rfsm = require "rfsm"
local share = require "spec.support.share"

-- Kinds of machines -------------------------------------------------------------------

-- Adds `text` and the first event to a trace. An iteration without events is left out:
-- an interrupt may come when a step is over, and then there is one more.
local function noting_events(trace, text)
  return function(_, events)
    if events[1] ~= nil then trace[#trace + 1] = text .. " " .. tostring(events[1]) end
  end
end

-- Records that are no part of a path may come again.
local REPEATED = { TRANSITION = true, CHECKING = true, HIBERNATING = true, DOO = true,
  RAISED = true }

-- A region: initial -> x --e_g--> y
local function region(core, trace, name)
  local function busy(state)
    return core.state { entry = helper.noting(trace, name .. " enters " .. state),
      exit = helper.noting(trace, name .. " leaves " .. state) }
  end
  return core.state { x = busy "x", y = busy "y", core.trans { src = "initial",
    tgt = "x" }, core.trans { src = "x", tgt = "y", events = { "e_g" } } }
end

-- fields(core, trace, world) returns more members of the root; change(fsm, trace, core,
-- world) is called with the machine. `lost`: at so many instructions, right behind the
-- user's function, its answer is lost; the regions' step hook is a callback, too.
local KINDS = {
  ["a plain machine"] = {},
  ["state hooks"] = { change = function(fsm, trace, core)
    for i, state in ipairs { fsm.a.b, fsm.d, fsm.d } do
      core.entry_hook_add(fsm, state, helper.noting(trace, "entry hook " .. i))
      core.exit_hook_add(fsm, state, helper.noting(trace, "exit hook " .. i))
    end
  end },
  ["step hooks"] = { change = function(fsm, trace, core)
    fsm.pre_step_hook = noting_events(trace, "pre")
    fsm.post_step_hook = noting_events(trace, "post")
    core.pre_step_hook_add(fsm, noting_events(trace, "pre 2"))
    core.post_step_hook_add(fsm, noting_events(trace, "post 2"), "before")
  end },
  ["path hooks"] = { change = function(fsm, trace, core)
    for i = 1, 2 do
      core.path_hook_add(fsm, function(_, path) trace[#trace + 1] = #path .. i end)
    end
  end },
  getevents = { lost = 5, change = function(fsm, trace, _, world)
    fsm.getevents = function()
      local event = world.event
      trace[#trace + 1], world.event = event and "getevents", nil
      return { event }
    end
    fsm.d.e.doo = nil
    function world.send(event) world.event = event end
  end },
  ["callbacks that fail"] = { failing = true },
  ["a doo that fails"] = { lost = 5, stories = { { "e_k" }, { "e_k", "e_other" } },
    fields = function(core)
      return { done = core.trans { src = "d.e", tgt = "a", events = { "e_done" } } }
    end, change = function(fsm, trace, core)
      fsm.d.e.doo = function()
        trace[#trace + 1] = "doo"
        core.yield(true)
        error("on purpose", 0)
      end
    end },
  dbg = { fields = function(_, trace)
    return { dbg = function(id, text)
      if not REPEATED[id] then trace[#trace + 1] = id .. " " .. text end
    end }
  end },
  timers = { module = "rfsm_timeevent", stories = { { "e_k" }, { "e_k", "+2" },
    { "e_k", "+4" }, { "e_k", "e_back" } }, fields = function(core, _, world)
    return { gettime = function() return world.now, 0 end, timeout = core.trans {
      src = "d", tgt = "a", events = { "e_after(3)", "e_after(99)" } } }
  end, change = function(fsm) fsm.d.e.doo = nil end },
  regions = { module = "rfsm_seqand", lost = 40, stories = { { "e_f" },
    { "e_f", "e_g" }, { "e_f", "e_k" } }, fields = function(core, trace)
    return { f = core.seqand { left = region(core, trace, "left"),
        right = region(core, trace, "right") },
      to = core.trans { src = "a.b.c", tgt = "f", events = { "e_f" } },
      from = core.trans { src = "f", tgt = "a", events = { "e_k" } } }
  end },
}

-- initial --> a.b.c --e_k--> k --> d.e (doo) --e_back--> a, d --e_straight--> a.b.c,
-- a.b.c --e_stay--> internal. The last move of each story is interrupted.
local STORIES = { {}, { "e_other" }, { "e_k" }, { "e_stay" }, { "e_k", "e_other" },
  { "e_k", "e_back" }, { "e_k", "e_straight" } }

local function new_model(core, kind, trace)
  local trans = core.trans
  local function callback(text)
    return function()
      trace[#trace + 1] = text
      if kind.failing then error("on purpose", 0) end
    end
  end
  local function busy(name, members)
    members.entry, members.exit = callback("enter " .. name), callback("leave " .. name)
    return core.state(members)
  end
  return {
    info = false, warn = false, k = core.conn {},
    a = busy("a", {
      b = busy("b", { c = busy("c", {}), trans { src = "initial", tgt = "c" } }),
      trans { src = "initial", tgt = "b" },
    }),
    d = busy("d", {
      e = busy("e", { doo = function()
        for i = 1, 3 do
          trace[#trace + 1] = "doo " .. i
          core.yield(i == 2)
        end
      end }),
      trans { src = "initial", tgt = "e" },
    }),
    trans { src = "initial", tgt = "a" },
    trans { src = "a.b.c", tgt = "k", events = { "e_k" }, effect = callback "to k" },
    trans { src = "k", tgt = "d", guard = function() end, effect = callback "to d" },
    trans { src = "d", tgt = "a", events = { "e_back" } },
    trans { src = "d", tgt = "root.a.b.c", events = { "e_straight" } },
    trans { src = "a.b.c", tgt = "internal", events = { "e_stay" },
      effect = callback "stay" },
  }
end

-- A world is a machine of a kind, its trace, its clock and who sends its events.
local function new_world(core, kind)
  local trace = {}
  local world = { core = core, trace = trace, now = 0 }
  local model = new_model(core, kind, trace)
  for key, value in pairs(kind.fields and kind.fields(core, trace, world) or {}) do
    model[key] = value -- any order: a set
  end
  function model.err(id, _, failure)
    trace[#trace + 1] = " " .. id .. " failed: " .. tostring(failure)
  end
  world.fsm = core.init(core.state(model))
  world.states = core.elements(world.fsm, core.is_state)
  function world.send(event) core.send_events(world.fsm, event) end
  if kind.change then kind.change(world.fsm, trace, core, world) end
  return world
end

local function finish(world)
  for _ = 1, 3 do world.core.run(world.fsm) end
  return world
end

-- Sends an event, or lets time pass: "+2".
local function play(world, move)
  local seconds = tonumber(move:match("^%+(.*)"))
  if seconds then world.now = world.now + seconds else world.send(move) end
end

-- Brings a machine to where the last move of a story is to be made.
local function begin(world, story)
  world.core.reset(world.fsm)
  helper.clear(world.trace)
  if story[1] then world.core.run(world.fsm) end
  for i, move in ipairs(story) do
    helper.clear(world.trace)
    play(world, move)
    if i < #story then world.core.run(world.fsm) end
  end
  return world
end

-- How the machines were used before they are interrupted. A path that is used often is
-- compiled.
local USES = {
  { name = "in use", count = 5, every = 1, is_kept = true },
  { name = "prepared", count = 0, every = 11, is_kept = true, is_prepared = true },
  { name = "new", count = 0, every = 23 },
  { name = "compiled just then", count = 3, every = 61 },
}

local function used(core, kind, use, story)
  local world = new_world(core, kind)
  if use.is_prepared then core.prepare(world.fsm) end
  for _ = 1, use.count do finish(begin(world, story)) end
  return world
end

-- Lists of the lines of the machine and of each region.
local function by_machine(trace)
  local lists = { left = {}, right = {}, root = {} }
  for _, line in ipairs(trace) do
    local list = lists[line:match("^%a+")] or lists.root
    list[#list + 1] = line
  end
  return lists
end

-- Returns what is wrong with the lists after an interrupt; and if a line is missing.
local function difference(expected, got)
  local is_missing, wrong = false, nil
  for name, lines in pairs(expected) do -- any order: one difference only
    local at, what = interrupts.missing(lines, got[name])
    wrong = wrong or what or is_missing and at and "two are missing"
    is_missing = is_missing or at ~= nil
  end
  return wrong, is_missing
end

-- The modes of all states, and the leaf.
local function position_of(world)
  local texts = { tostring(world.core.get_actleaf_fqn(world.fsm)) }
  for i, state in ipairs(world.states) do texts[i + 1] = state._mode end
  return table.concat(texts, " ")
end

-- What is wrong with a machine that was interrupted and went on; nil when nothing is.
local function problem_of(world, expected, is_raised)
  local wrong, is_missing = difference(expected.lists, by_machine(world.trace))
  if wrong then return wrong end
  if world.fsm._intq[1] ~= nil then return "an event is pending" end
  if position_of(world) ~= expected.position then return "it is elsewhere" end
  return is_missing and not is_raised and "not the same without an interrupt"
end

-- Interrupts a machine at an instruction and lets it go on. Returns whether there is
-- such an instruction, and what is wrong then.
local function interrupt(world, advance, at, expected)
  local value = interrupts.VALUES[at % 3 + 1]
  local is_reached, is_raised, ok, failure =
    interrupts.raise(at, value, world.core[advance], world.fsm)
  if is_raised and (ok or not rawequal(failure, value)) then
    return true, "it does not reach the caller"
  end
  if at % 2 == 0 then -- as an extension does before it works
    world.core.check_between_steps(world.fsm, "this spec")
  end
  return is_reached, problem_of(finish(world), expected, is_raised)
end

-- Interrupts the last move of a story everywhere.
local function interrupt_everywhere(core, kind, use, story, advance)
  local world, lost = used(core, kind, use, story), 0
  local every, at = share.every(use.every)
  finish(begin(world, story))
  local expected = { lists = by_machine(world.trace), position = position_of(world) }
  repeat
    world = use.is_kept and world or used(core, kind, use, story)
    local is_reached, wrong = interrupt(begin(world, story), advance, at, expected)
    if wrong and lost < (kind.lost or 0) then lost, wrong = lost + 1, nil end
    if wrong then
      error(("%s, %s, instruction %d: %s"):format(table.concat(story, " "), advance, at,
        wrong))
    end
    at = at + every
  until not is_reached
  if at < 20 then error("the machine does nothing") end
end

local function check(core, kind, use)
  if kind.module then require(kind.module) end
  for _, story in ipairs(kind.stories or STORIES) do
    for _, advance in ipairs { "run", "step" } do
      interrupt_everywhere(core, kind, use, story, advance)
    end
  end
end

describe("an interrupt", function()
  for _, name in ipairs(rfsm.sorted_keys(KINDS)) do
    for _, use in ipairs(USES) do
      it(("leaves a machine that goes on: %s, %s"):format(name, use.name), function()
        interrupts.without_jit(check, rfsm, KINDS[name], use)
      end)
    end

    for _, missing in ipairs { "rfsm.fast", "debug" } do
      it(("leaves a machine that goes on: %s, without %s"):format(name, missing),
        function()
          compiling.without(missing, function(core)
            interrupts.without_jit(check, core, KINDS[name], USES[2])
          end)
        end)
    end
  end

  local function in_b(fields)
    local model = { info = false, warn = false, err = false, a = rfsm.state {},
      b = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
      rfsm.trans { src = "a", tgt = "b", events = { "e" } } }
    for key, value in pairs(fields) do model[key] = value end -- any order: a set
    return rfsm.init(rfsm.state(model))
  end

  -- Interrupts the first step of a machine anywhere, where a second one refuses its
  -- events, too. Returns which events are pending then: the sets that come about.
  local function sets_of_pending(fields)
    local sets, at = {}, 0
    repeat
      local fsm, set = in_b(fields), {}
      rfsm.send_events(fsm, "e_1", "e_2")
      at = at + 1
      local is_reached = interrupts.raise(at, interrupts.VALUES[2], rfsm.step, fsm)
      pcall(rfsm.step, fsm)
      for _, event in ipairs(fsm._intq) do set[event] = true end
      sets[table.concat(rfsm.sorted_keys(set), " ")] = true
    until not is_reached
    return rfsm.sorted_keys(sets)
  end

  it("loses no event of an iteration that is refused", function()
    interrupts.without_jit(function()
      local function no() return false end
      assert.same({ "e_1 e_2 e_init_fsm" }, sets_of_pending {
        rfsm.trans { src = "initial", tgt = "a", guard = no } })
      assert.same({ "e_1 e_2 e_init_fsm", "e_done@root.a" }, -- it may not be called
        sets_of_pending { pre_step_hook = function() error("on purpose", 0) end })
    end)
  end)

  -- Interrupts act(world) at each instruction, also in extensions. Returns what
  -- see(world) returns then: each text once.
  local function outcomes(make, act, see)
    local texts, at, is_reached = {}, 0, true
    interrupts.without_jit(function()
      while is_reached do
        local world = make()
        at = at + 1
        is_reached = interrupts.raise_anywhere(at, interrupts.VALUES[1], act, world)
        texts[see(world)] = true
      end
    end)
    assert.is_true(at > 40)
    return rfsm.sorted_keys(texts)
  end

  local function advance(fsm)
    for _ = 1, 6 do pcall(rfsm.step, fsm) end
    return fsm
  end

  it("takes no event twice where a hook fails, or events are sent between", function()
    local function new()
      local world, model = { most = 0 }, { read = "one", info = false, warn = false }
      model.a, model[1] = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" }
      model[2] = rfsm.trans { src = "a", tgt = "a", events = { "e_x", "e_y", "e_z" },
        effect = function(_, _, _, _, event)
          world[event] = (world[event] or 0) + 1
          world.most = math.max(world.most, world[event])
        end }
      world.fsm = assert(rfsm.init(rfsm.state(model)))
      rfsm.run(world.fsm)
      rfsm.send_events(world.fsm, "e_x", "e_y")
      return world
    end
    local function fail_once(world)
      world.fsm.pre_step_hook = function()
        if world.has_failed then return end
        world.has_failed = true
        error("on purpose", 0)
      end
      pcall(rfsm.step, world.fsm)
      rfsm.send_events(world.fsm, "e_z")
    end
    local function see(world)
      advance(world.fsm)
      return world.most > 1 and "twice" or "once"
    end
    for at = 4, 24, 4 do -- the first interrupt, which comes before others are tried
      local function cut_before()
        local world = new()
        interrupts.raise_anywhere(at, interrupts.VALUES[1], rfsm.step, world.fsm)
        rfsm.send_events(world.fsm, "e_z")
        return world
      end
      local function step(world) rfsm.step(world.fsm) end
      assert.same({ "once" }, outcomes(cut_before, step, see))
    end
    assert.same({ "once" }, outcomes(new, fail_once, see))
  end)

  -- initial --> a --e--> b, which is done, or when c in it is; e_done is counted.
  local function done_in(fields)
    local world = { count = 0 }
    world.fsm = in_b { read = "one", b = rfsm.state(fields), done = rfsm.trans {
      src = "b", tgt = "internal", events = { "e_done" },
      effect = function() world.count = world.count + 1 end } }
    rfsm.run(world.fsm)
    rfsm.send_events(world.fsm, "e")
    return world
  end

  it("queues e_done once, also if one event is taken at a time", function()
    local function twice(world) for _ = 1, 2 do rfsm.step(world.fsm) end end
    local function see(world)
      advance(world.fsm)
      return world.count > 1 and "twice" or "once"
    end
    for _, fields in ipairs { {}, { doo = function() end },
      { c = rfsm.state { final = true }, rfsm.trans { src = "initial", tgt = "c" } },
      { c = rfsm.state { final = true, doo = function() end },
        rfsm.trans { src = "initial", tgt = "c" } } } do
      local function new() return done_in(fields) end
      assert.same({ "once" }, outcomes(new, twice, see))
    end
  end)

  it("in exit_state, called by an effect, keeps the event of the entry", function()
    local function see(world)
      advance(world.fsm)
      return tostring(world.got)
    end
    local function new()
      local world = { got = "not called" }
      world.fsm = in_b { b = rfsm.state { entry = function(_, _, _, event)
        world.got = event
      end } }
      rfsm.run(world.fsm)
      world.fsm[2].effect = function(fsm) rfsm.exit_state(fsm, fsm) end
      rfsm.send_events(world.fsm, "e")
      return world
    end
    assert.same({ "e", "not called" }, outcomes(new, function(world)
      rfsm.step(world.fsm)
    end, see))
  end)

  it("leaves the failure of a doo one: it has not ended", function()
    local told
    local function new()
      local world = { fsm = in_b { a = rfsm.state { doo = function()
        error("on purpose", 0)
      end } } }
      told = {}
      world.fsm.err = function() told.err = true end
      rfsm.watch_hook_add(world.fsm, "ended", function() told.ended = true end)
      for i = 1, 2 do
        rfsm.watch_hook_add(world.fsm, "failed", function() told["f" .. i] = true end)
      end
      rfsm.step(world.fsm)
      return world
    end
    local texts = outcomes(new, function(world) rfsm.step(world.fsm) end,
      function(world)
        advance(world.fsm)
        return table.concat(rfsm.sorted_keys(told), " ")
      end)
    -- one at most is not told; "" and "ended" where the answer of the doo is lost
    assert.same({ "", "ended", "err f1", "err f1 f2", "err f2", "f1 f2" }, texts)
  end)

  it("adds events of getevents once, whoever asks for them", function()
    local function new(read)
      local world = { lists = {}, seen = {} }
      world.fsm = in_b { read = read,
        getevents = function() return table.remove(world.lists) end }
      rfsm.post_step_hook_add(world.fsm, function(_, events)
        for _, event in ipairs(events) do world.seen[#world.seen + 1] = event end
      end)
      rfsm.run(world.fsm)
      world.lists, world.seen = { { "e_1", "e_2" } }, {}
      return world
    end
    for _, read in ipairs { "all", "one" } do
      assert.same({ "", "e_1 e_2" }, outcomes(function() return new(read) end,
        function(world) rfsm.check_events(world.fsm) end, function(world)
          advance(world.fsm)
          return table.concat(world.seen, " ")
        end))
    end
  end)

  it("of fsm_merge leaves no half of an element", function()
    local merges = { t = { rfsm.trans { src = "a", tgt = "b", events = { "e_x" } } },
      c = { rfsm.state { rfsm.trans { src = "initial", tgt = "nowhere" } }, "b" } }
    for id, merge in pairs(merges) do -- any order: each stands alone
      local function new()
        local fsm = in_b {}
        rfsm.run(fsm)
        rfsm.send_events(fsm, "e_x")
        rfsm.run(fsm)
        return fsm
      end
      local texts = outcomes(new, function(fsm)
        rfsm.fsm_merge(fsm, merge[2] and fsm[merge[2]] or fsm, merge[1], id)
      end, function(fsm)
        local is_there = rawget(fsm, "t") ~= nil
        rfsm.send_events(fsm, "e_x")
        local is_taken = rfsm.get_actleaf_fqn(advance(fsm)) == "root.b"
        rfsm.send_events(fsm, "e")
        return ("%s %s %d"):format(tostring(is_there == is_taken),
          tostring(rfsm.get_actleaf_fqn(advance(fsm))), #fsm._nodes)
      end)
      assert.same({ "true root.b 4" }, texts)
    end
  end)

  -- a --e--> b; c is merged, and b --e--> c then
  it("of fsm_merge leaves the machine with the element, or as it was", function()
    local MANY, at, is_reached = 1e5, 0, true
    interrupts.without_jit(function()
      while is_reached do
        local fsm, value = in_b {}, interrupts.VALUES[at % 3 + 1]
        at = at + 7
        local c = rfsm.state { x = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "x" } }
        is_reached = interrupts.raise(at, value, rfsm.fsm_merge, fsm, fsm, c, "c")
        local is_there = fsm.c ~= nil
        assert.equal(not is_there, rfsm.fsm_merge(fsm, fsm, rfsm.state {}, "c"))
        rfsm.fsm_merge(fsm, fsm, rfsm.trans { src = "b", tgt = "c", events = { "e" } })
        for _, event in ipairs { "e_init_fsm", "e", "e" } do
          rfsm.send_events(fsm, event)
          assert.is_false(interrupts.raise(MANY, value, rfsm.run, fsm))
        end
        assert.equal(is_there and "root.c.x" or "root.c", rfsm.get_actleaf_fqn(fsm))
      end
    end)
    assert.is_true(at > 500)
  end)

  it("of a callback is its failure, but Control-C reaches the caller", function()
    local failures = {}
    local function forever() while true do helper.clear {} end end
    for i, value in ipairs(interrupts.VALUES) do
      local fsm = in_b { b = rfsm.state { entry = forever } }
      rfsm.run(fsm)
      fsm.err = function(_, _, failure) failures[#failures + 1] = failure end
      rfsm.send_events(fsm, "e")
      interrupts.without_jit(function()
        local _, _, ok, failure =
          interrupts.raise_anywhere(50000, value, rfsm.run, fsm)
        assert.same({ i ~= 1, i == 1 and value or nil }, { ok, failure })
      end)
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    end
    assert.same({ interrupts.VALUES[2], interrupts.VALUES[3] }, failures)
  end)

  -- Names whose files are loaded when they are first read, and what makes use of them:
  -- a model that comes to root.b, by a function if there is one.
  local FIRST_USES = {
    check_always = function(core)
      return { a = core.state {}, b = core.state {},
        core.trans { src = "initial", tgt = "a" },
        core.trans { src = "a", tgt = "b", always = true } }
    end,
    seqand = function(core)
      return { core.trans { src = "initial", tgt = "b" },
        b = core.seqand { r = core.state { info = false, warn = false,
          x = core.state {}, core.trans { src = "initial", tgt = "x" } } } }
    end,
    begin_in = function(core)
      return { b = core.state {}, core.trans { src = "initial", tgt = "b" } },
        function(fsm) core.begin_in(fsm, "root.b", "begin_in") end
    end,
  }

  local function machine_of(core, model, run)
    model.info, model.warn = false, false
    local fsm = assert(core.init(core.state(model)))
    if run then run(fsm) else core.run(fsm) end
    return fsm
  end

  -- Other files that are loaded when they are first needed: functions that return one
  -- that needs the file, and what this one returns.
  local FIRST_NEEDS = {
    ["rfsm.clock.snapshots"] = { function(core)
      require "rfsm_timeevent"
      local snapshot = require "rfsm.snapshot"
      local fsm = machine_of(core, { a = core.state {}, gettime = function()
        return 7, 0
      end, core.trans { src = "initial", tgt = "a" },
        core.trans { src = "a", tgt = "a", events = { "e_after(2)" } } })
      return function() return snapshot.take(fsm).ext.timers["e_after(2)@root.a"] end
    end, 2 },
    ["rfsm.explore.properties"] = { function()
      local checks = require "rfsm_checks"
      return function() return type(checks.never) end
    end, "function" },
    ["rfsm.explore.verdict"] = { function(core)
      local explore = require("rfsm.explore.explore").explore
      local model = core.state { info = false, a = core.state { final = true },
        core.trans { src = "initial", tgt = "a" } }
      return function() return #explore(model).findings end
    end, 0 },
    ["a package that a module needs"] = { function()
      local opts = require "rfsm.shared.options"
      return function() return opts.need("rfsm.web", "posix.time").CLOCK_MONOTONIC end
    end, 1 },
    ["rfsm.clock.simulated"] = { function()
      local clock = require "rfsm.clock"
      return function() return type(clock.simulated) end
    end, "function" },
    ["rfsm.fast"] = { function(core)
      local fsm = machine_of(core, { a = core.state {},
        core.trans { src = "initial", tgt = "a" } })
      return function()
        core.prepare(fsm)
        return type(package.loaded["rfsm.fast"])
      end
    end, "function" },
    ["posix.time"] = { function()
      local clock = require "rfsm.clock"
      return function() return (clock.read({}, true)) end
    end, 42 },
  }

  -- A clock of another package, which takes some time to be loaded.
  local function load_posix()
    for _ = 1, 50 do helper.clear {} end
    return { CLOCK_MONOTONIC = 1, clock_gettime = function()
      return { tv_sec = 42, tv_nsec = 0 }
    end }
  end

  -- Calls f(at, core) with later and later places, each with a core loaded anew, until
  -- f returns that there is no such place. Returns the last place.
  local function at_each_place(f)
    local at, is_reached = 0, true
    while is_reached do
      at = at + 3 + math.floor(at / 20)
      compiling.anew(function() is_reached = f(at, require "rfsm") end)
    end
    return at
  end

  -- Lua 5.1 would refuse to load a file again whose load an error has cut short.
  for name, use in pairs(FIRST_USES) do -- any order: each stands alone
    it("of the first read of " .. name .. " leaves it to the next one", function()
      local was_cut = false
      local last = at_each_place(function(at, core)
        local is_reached, is_cut
        interrupts.without_jit(function()
          is_reached, is_cut = interrupts.raise_anywhere(at, "interrupted!",
            function() return core[name] end)
        end)
        was_cut = was_cut or is_cut
        assert.equal("root.b", core.get_actleaf_fqn(machine_of(core, use(core))))
        return is_reached
      end)
      assert.is_true(was_cut and last > 50)
    end)
  end

  for name, need in pairs(FIRST_NEEDS) do -- any order: each stands alone
    it("of the load of " .. name .. " leaves it to the next use", function()
      local loaded, preload = package.loaded, package.preload
      local posix, load = loaded["posix.time"], preload["posix.time"]
      preload["posix.time"] = load_posix
      local last = at_each_place(function(at, core)
        loaded["posix.time"] = nil
        local use, is_reached, is_cut, ok, failure = need[1](core), nil, nil, nil, nil
        interrupts.without_jit(function()
          is_reached, is_cut, ok, failure = interrupts.raise_anywhere(at,
            "interrupted!", use)
        end)
        assert.same({ not is_cut, is_cut and "interrupted!" or nil }, { ok, failure })
        assert.equal(need[2], use())
        return is_reached
      end)
      loaded["posix.time"], preload["posix.time"] = posix, load
      assert.is_true(last > 50)
    end)
  end
end)
