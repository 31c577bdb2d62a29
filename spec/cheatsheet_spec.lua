-- The code of rFSM's cheatsheet as it stands there, its slips mended: missing commas,
-- names swapped in `local state, trans, conn`, `entry` written twice, an `end` out of
-- place. It uses the global `rfsm`, as charts in the wild do. Behind that is each
-- sentence of the cheatsheet that a program can check.

local helper = require "spec.helper"
local rfsm = require "rfsm"

-- Runs a block of the cheatsheet with these globals besides the usual ones.
local function run_block(text, globals)
  local env = setmetatable(globals or {}, { __index = _G })
  local setfenv = rawget(_G, "setfenv")
  if not setfenv then return assert(load(text, "=cheatsheet", "t", env))() end
  return setfenv(assert(loadstring(text, "=cheatsheet")), env)() -- luacheck: ignore 113
end

-- Notes which of the functions that a block leaves to the reader were called.
local function noting(...)
  local trace, globals = {}, {}
  for _, name in ipairs({ ... }) do
    globals[name] = function() trace[#trace + 1] = name end
  end
  return globals, trace
end

describe("the cheatsheet's block on", function()
  local global_rfsm = rawget(_G, "rfsm") or require "rfsm"

  it("models returns the toplevel state", function()
    assert.is_true(global_rfsm.is_state(run_block "return rfsm.state {\n}"))
  end)

  it("states runs entry and exit", function()
    local globals, trace = noting("do_this", "do_that")
    local model = run_block([[
return rfsm.state {
  s = rfsm.state {
    entry=function() do_this() end,
    exit=function() do_that() end,

    substate1=rfsm.state{},
    rfsm.transition{ src='initial', tgt='substate1' },
  },
  rest = rfsm.state{},
  rfsm.trans{ src='initial', tgt='s' },
  rfsm.trans{ src='s', tgt='rest', events={ 'e' } },
}
]], globals)
    helper.post_and_run(helper.started(model), "e")
    assert.same({ "do_this", "do_that" }, trace)
  end)

  it("transitions takes each of its events", function()
    for _, event in ipairs({ "e_1", "e_2" }) do
      local fsm = helper.started(run_block [[
return rfsm.state {
  stateX=rfsm.state{}, stateY=rfsm.state{},
  rfsm.trans{ src='initial', tgt='stateX' }, -- short form
rfsm.transition{ src='stateX', tgt='stateY',
    events={"e_1", "e_2"} },
}
]])
      assert.equal("root.stateY", helper.leaf_after(fsm, event))
    end
  end)

  it("connectors has a long and a short form", function()
    assert.is_true(global_rfsm.is_conn(run_block "return rfsm.connector{ }"))
    assert.is_true(global_rfsm.is_conn(run_block "return rfsm.conn{} -- short form"))
  end)

  it("loading and advancing drives a machine", function()
    local globals = { filename = "examples/hello_world.lua", N = 2 }
    globals.event1, globals.event2 = "e_restart", "e_other"
    local lines = helper.printed(function()
      run_block([[
model=rfsm.load(filename)
model.info = false
fsm = rfsm.init(model)
rfsm.step(fsm)
rfsm.step(fsm, N)
rfsm.run(fsm)
rfsm.send_events(fsm, event1, event2)
]], globals)
    end)
    assert.same({ "hello", "world" }, lines)
    assert.same({ "e_restart", "e_other" }, globals.fsm._intq)
  end)

  it("tracing shows entries and exits", function()
    local lines = helper.printed(function()
      run_block([[
require "rfsmpp"
fsm.dbg=rfsmpp.gen_dbgcolor("fsmX",
    { STATE_ENTER=true,
      STATE_EXIT=true }, false)
rfsm.run(fsm)
]], { fsm = helper.init(global_rfsm.load("examples/on_off.lua")) })
    end)
    for i = 1, #lines do lines[i] = lines[i]:gsub("\27%[%d+m", "") end
    assert.same({
      "fsmX:\tSTATE_ENTER         root", "dark",
      "fsmX:\tSTATE_ENTER         root.off",
    }, lines)
  end)

  it("time events takes a transition after three seconds", function()
    local now = 100
    local model = run_block([[
require "rfsm_timeevent"
rfsm_timeevent.set_gettime_hook(gettime_func)
return rfsm.state {
    trans{ src="sA", tgt="sB", events={ "e_after(3)" } },
    sA=rfsm.state{}, sB=rfsm.state{},
    trans{ src="initial", tgt="sA" },
}
]], { trans = global_rfsm.trans, gettime_func = function() return now, 0 end })
    local fsm = helper.started(model)
    for _, case in ipairs { { 103, "root.sA" }, { 104, "root.sB" } } do
      now = case[1]
      assert.equal(case[2], helper.leaf_after(fsm))
    end
    require("rfsm_timeevent").set_gettime_hook(nil)
  end)

  it("the clock of Lua returns seconds and nanoseconds", function()
    local globals = {}
    run_block("function gettime() return os.time(), 0 end", globals)
    local seconds, nanoseconds = globals.gettime()
    assert.is_number(seconds)
    assert.equal(0, nanoseconds)
  end)

  it("the sequential AND state steps its machines in order", function()
    local globals = {}
    local lines = helper.printed(function()
      run_block([[
function sub(name)
  return rfsm.state { info=false, warn=false,
    on=rfsm.state{ entry=function() print(name) end },
    rfsm.trans{ src='initial', tgt='on' } }
end
seqAND = rfsm.seqand {
    subfsm1=rfsm.init(sub("one")),
    subfsm2=rfsm.init(sub("two")),
    order={ "subfsm2" },
}
fsm = rfsm.init(rfsm.state { info=false, warn=false, both=seqAND,
  rfsm.trans{ src='initial', tgt='both' } })
rfsm.run(fsm)
]], globals)
    end)
    assert.same({ "two", "one" }, lines)
  end)

  -- The functions that the example leaves to the reader are in front.
  local EXAMPLE = [[
for _, name in ipairs { "enable_robot", "disable_robot", "start_motor", "stop_motor",
  "compute_next_pos" } do
  _G[name] = function() print(name) end
end
local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
return rfsm.state {
    dbg=rfsmpp.gen_dbgcolor("sample-fsm"),
    entry=function() enable_robot() end,
    exit=function() disable_robot() end,

    stopped = state{},

    moving = state {
        entry=function() start_motor() end,
        exit=function() stop_motor() end,

        doo = function()
            while true do
                compute_next_pos()
                rfsm.yield(true)
            end
        end,
    },
    trans{ src="initial", tgt="stopped" },
    trans{ src="stopped", tgt="moving", events={"e_start"} },
    trans{ src="moving", tgt="stopped", events={"e_stop"} },
}
]]

  it("the complete example moves and stops", function()
    local rfsmpp = require "rfsmpp"
    local dbg, records = rfsmpp.gen_dbgcolor("sample-fsm", { EFFECT = false }), {}
    local trace = helper.printed(function()
      local fsm = helper.init(run_block(EXAMPLE, { rfsmpp = {
        gen_dbgcolor = function()
          return function(id, ...)
            records[id] = true
            if id == "EFFECT" then dbg(id, ...) end -- which is off
          end
        end,
      } }))
      rfsm.run(fsm)
      helper.post_and_run(fsm, "e_start")
      helper.post_and_run(fsm, "e_stop")
    end)
    assert.same({ "enable_robot", "start_motor", "compute_next_pos", "stop_motor" },
      trace)
    for id in ("STATE_ENTER STATE_EXIT EFFECT DOO EXEC_PATH HIBERNATING RAISED")
      :gmatch("%S+") do
      assert.is_true(records[id], id)
    end
  end)

  describe("the complete example in a file", function()
    after_each(helper.remove_files)

    local function lines_of(command, input)
      return helper.lines_of(("printf '%s' | TERM=dumb LUA=%s tools/rfsm %s 2>&1")
        :format(input or "", helper.interpreter(), command))
    end

    it("passes every command, which gives it rfsmpp", function()
      local file = helper.file_with(EXAMPLE)
      assert.same({ file .. ": ok (0 properties judged)" }, lines_of("check " .. file))
      assert.matches("nothing moves$",
        lines_of("snapshot diff " .. file .. " " .. file)[1])
      for command, expected in pairs { -- any order: each stands alone
        json = '"id":"moving"', plantuml = 'state "moving" as root_moving',
        dot = "stopped", mermaid = "moving", viz = "moving",
        ["check --tests busted"] = "e_stop",
      } do
        local lines = lines_of(command .. " -o - " .. file)
        assert.is_truthy(table.concat(lines, "\n"):find(expected, 1, true), command)
      end
    end)

    it("runs in the simulator, and prints as in the original", function()
      local lines = lines_of("sim -q " .. helper.file_with(EXAMPLE),
        'run()\\nser("e_start")\\n')
      local records = {}
      for _, line in ipairs(lines) do
        local id, rest = line:match("^sample%-fsm:%s+(%S+) +(.*)$")
        local is_text = id == "STATE_ENTER" or id == "STATE_EXIT" or id == "EXEC_PATH"
          or id == "RAISED"
        if is_text then records[#records + 1] = id .. " " .. rest end
        if line:find("^%l+_%l+") or line:find("^active") then
          records[#records + 1] = line
        end
      end
      assert.same({
        "enable_robot", "STATE_ENTER root",
        "EXEC_PATH root.initial[c]->root.stopped[LS]", "RAISED e_done@root.stopped",
        "STATE_ENTER root.stopped", "active: root.stopped(done)",
        "RAISED e_start", "EXEC_PATH root.stopped[LS]->root.moving[LS]",
        "STATE_EXIT root.stopped", "start_motor", "STATE_ENTER root.moving",
        "compute_next_pos", "active: root.moving(active)",
      }, records)
    end)
  end)
end)

-- Sentences -------------------------------------------------------------------------

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

-- (initial) -> a --e_x--> b, with more members
local function chart(members) return helper.chart({ "e_x" }, members) end

-- A model with a composite: (initial) -> a, c[ (initial) -> p, q ]
local function nested(tr, inner)
  local c = { p = state {}, q = state {}, trans { src = "initial", tgt = "p" } }
  for key, value in pairs(inner or {}) do c[key] = value end -- any order: a set
  return state { warn = false, info = false, err = false, a = state {}, c = state(c),
    trans { src = "initial", tgt = "a" }, tr }
end

describe("the cheatsheet says of models that", function()
  after_each(helper.remove_files)

  it("a model is contained in a file that returns the toplevel state", function()
    local file = helper.file_with("return require('rfsm').state { name = 'top' }")
    assert.equal("top", rfsm.load(file).name)
    assert.is_false((pcall(rfsm.load, helper.file_with("return {}"))))
  end)

  it("getevents is executed during step and run, index part only", function()
    for _, advance in ipairs { rfsm.step, rfsm.run } do
      local fsm = helper.started(chart())
      local events = { "e_y", "e_x", other = "e_back" }
      fsm.getevents = function()
        local list = events
        events = {}
        return list
      end
      advance(fsm)
      assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
    end
  end)

  it("log functions get several parameters", function()
    local counts = {}
    local function log(name)
      return function(...)
        counts[name] = math.max(counts[name] or 0, select("#", ...))
      end
    end
    local model = chart { dbg = log("dbg"), info = log("info"), err = log("err") }
    model.a.entry = function() error("no") end
    helper.started(model)
    assert.is_true(counts.dbg > 2)
    assert.same({ 1, 3 }, { counts.info, counts.err })
  end)

  it("forgetting the commas is an error, which names the line", function()
    local file = helper.file_with("return rfsm.state {\n  a = rfsm.state {}\n"
      .. "  rfsm.trans { src = 'initial', tgt = 'a' } }")
    local _, text = pcall(rfsm.load, file)
    assert.matches(":3: '}' expected %(to close '{' at line 1%) near 'rfsm'", text)
  end)

  it("entry, exit and doo get the machine, the state and a word", function()
    local calls = {}
    local function note(fsm, self, what)
      calls[#calls + 1] = fsm._id .. " " .. self._id .. " " .. what
    end
    local fsm = helper.started(chart { a = state { entry = note, exit = note,
      doo = note } })
    helper.post_and_run(fsm, "e_x")
    assert.same({ "root a entry", "root a doo", "root a exit" }, calls)
  end)

  it("a doo is only permitted for leaf states", function()
    local _, text = rfsm.init(nested(nil, { doo = function() end }))
    assert.matches("root.c.doo: only a leaf state can have a doo", text)
  end)

  it("a state with substates is composite, any other is a leaf", function()
    local fsm = helper.init(nested())
    assert.same({ true, false, false, true }, { rfsm.is_composite(fsm.c),
      rfsm.is_leaf(fsm.c), rfsm.is_composite(fsm.a), rfsm.is_leaf(fsm.a) })
  end)

  it("a composite on which a transition ends must have an initial one", function()
    local model = nested(trans { src = "a", tgt = "c", events = { "e" } })
    assert.is_truthy(rfsm.init(model))
    model.c[1] = nil
    local _, text = rfsm.init(model)
    assert.matches("the composite has no initial transition", text)
  end)
end)

describe("the cheatsheet says of transitions that", function()
  it("trans and transition, conn and connector are the same", function()
    assert.equal(rfsm.transition, rfsm.trans)
    assert.equal(rfsm.connector, rfsm.conn)
  end)

  it("a guard inhibits if it returns false, and enables if it returns true", function()
    for _, is_open in ipairs { true, false } do
      local model = chart()
      model[2].guard = function() return is_open end
      assert.equal(is_open and "root.b" or "root.a",
        helper.leaf_after(helper.started(model), "e_x"))
    end
  end)

  it("the effect is executed when a transition is taken", function()
    local trace, fsm = helper.traced(chart())
    rfsm.run(fsm)
    helper.clear(trace)
    helper.post_and_run(fsm, "e_other")
    helper.post_and_run(fsm, "e_x")
    assert.same({ "exit root.a", "effect root.a->root.b", "entry root.b" }, trace)
  end)

  it("larger priority numbers take priority", function()
    for _, pn in ipairs { -1, 1 } do
      local fsm = helper.started(chart { c = state {},
        [4] = trans { src = "a", tgt = "c", events = { "e_x" }, pn = pn } })
      assert.equal(pn > 0 and "root.c" or "root.b", helper.leaf_after(fsm, "e_x"))
    end
  end)

  for _, ref in ipairs { "root.c.q", "c.q", ".c.q", "..c.q" } do
    it("a reference is absolute or relative, and may cross borders: " .. ref, function()
      local model = nested(trans { src = "a", tgt = ref, events = { "e" } })
      model[3] = trans { src = ref, tgt = "a", events = { "e_back" } }
      assert.equal("e=q e_back=a", helper.story(helper.started(model), "e=q e_back=a"))
    end)
  end

  it("a reference is local", function()
    local model = nested(trans { src = "a", tgt = "c", events = { "e" } },
      { [2] = trans { src = "p", tgt = "q", events = { "e" } } })
    assert.equal("e=p e=q", helper.story(helper.started(model), "e=p e=q"))
  end)

  it("parent states may layer transitions on top of deeper ones", function()
    local model = nested(trans { src = "a", tgt = "c", events = { "e" } })
    model[3] = trans { src = "..c.p", tgt = "..c.q", events = { "e_deep" } }
    assert.equal("e=p e_deep=q", helper.story(helper.started(model), "e=p e_deep=q"))
  end)

  it("connectors chain transitions, and are never active", function()
    local seen = {}
    local model = chart { k = conn {}, j = conn {},
      [4] = trans { src = "a", tgt = "k", events = { "e_k" } },
      [5] = trans { src = "k", tgt = "j" }, [6] = trans { src = "j", tgt = "b" },
      post_step_hook = function(fsm) seen[rfsm.get_actleaf_fqn(fsm)] = true end }
    local trace = {}
    for i = 4, 6 do model[i].effect = helper.noting(trace, model[i].tgt) end
    assert.equal("root.b", helper.leaf_after(helper.started(model), "e_k"))
    assert.same({ ["root.a"] = true, ["root.b"] = true }, seen)
    assert.same({ "k", "j", "b" }, trace)
  end)

  it("connectors are entry and exit points of composite states", function()
    local model = nested(trans { src = "a", tgt = "c.enter", events = { "e_in" } }, {
      enter = conn {}, leave = conn {}, trans { src = "initial", tgt = "p" },
      trans { src = "enter", tgt = "q" },
      trans { src = "q", tgt = "leave", events = { "e_out" } } })
    model[3] = trans { src = "c.leave", tgt = "a" }
    local story = "e_in=q e_out=a"
    assert.equal(story, helper.story(helper.started(model), story))
  end)
end)

it("the packages that the cheatsheet's tools need come with a rock, rtp is named",
  function()
    local rock = {}
    local text = helper.content("rockspec/rfsm-dev-1.rockspec")
    run_block(text .. "\nrock.dependencies = dependencies\n"
      .. "rock.test_dependencies = test_dependencies", { rock = rock })
    local needed = table.concat(rock.dependencies, " ")
    for _, name in ipairs { "argparse", "ansicolors" } do
      assert.matches(name, needed)
    end
    assert.matches("luacheck", table.concat(rock.test_dependencies, " "))
    for _, page in ipairs { "README.md", "doc/manual.md", "doc/timeevent.md" } do
      assert.is_truthy(helper.content(page):find("%f[%w]rtp%f[%W]"), page)
    end
  end)

describe("the cheatsheet says of advancing that", function()
  -- Notes the cycles of a doo that is idle at its end, and each transition.
  local function busy(trace)
    local model = chart()
    model.a.doo = function()
      for i = 1, 3 do
        trace[#trace + 1] = "doo " .. i
        rfsm.yield(false)
      end
      while true do rfsm.yield(true) end
    end
    model[1].effect = helper.noting(trace, "enter")
    model[2].effect = helper.noting(trace, "leave")
    return helper.init(model)
  end

  it("init validates and instantiates: the model makes many machines", function()
    local model = chart()
    local first, second = helper.started(model), helper.started(model)
    helper.post_and_run(first, "e_x")
    assert.same({ "root.b", "root.a" }, { rfsm.get_actleaf_fqn(first),
      rfsm.get_actleaf_fqn(second) })
    model.err, model[1] = false, trans { src = "initial", tgt = "nowhere" }
    assert.is_false((rfsm.init(model)))
  end)

  it("step executes at most one transition or doo cycle, and N of them", function()
    local trace = {}
    local fsm = busy(trace)
    local counts = {}
    for i, n in ipairs { 1, 1, 2 } do
      rfsm.step(fsm, n)
      counts[i] = #trace
    end
    assert.same({ 1, 2, 4 }, counts)
  end)

  it("run steps until there are no events and no active doo", function()
    local trace = {}
    local fsm = busy(trace)
    assert.is_true(rfsm.run(fsm))
    assert.same({ "enter", "doo 1", "doo 2", "doo 3" }, trace)
  end)

  it("send_events puts events into the queue, in order", function()
    local fsm = helper.started(chart())
    rfsm.send_events(fsm, "e_1", "e_2")
    rfsm.send_events(fsm, "e_3")
    assert.same({ "e_1", "e_2", "e_3" }, fsm._intq)
  end)

  it("a step gets events, searches from root to leaf, takes or runs the doo, and "
    .. "discards the events", function()
    local trace = {}
    local function guard(name)
      return function()
        trace[#trace + 1] = name
        return false
      end
    end
    local model = nested(nil, { p = state { doo = function()
      while true do
        trace[#trace + 1] = "doo"
        rfsm.yield(true)
      end
    end } })
    model[1] = trans { src = "initial", tgt = "c" }
    for i, src in ipairs { "root", "c", ".c.p" } do
      model[i + 1] = trans { src = src, tgt = "a", events = { "e" },
        guard = guard(src:match("%a+$")) }
    end
    model.getevents = helper.noting(trace, "getevents")
    local fsm = helper.init(model)
    rfsm.step(fsm)
    helper.clear(trace)
    rfsm.send_events(fsm, "e")
    rfsm.step(fsm)
    assert.same({ "getevents", "root", "c", "p", "getevents", "doo", "getevents" },
      trace)
    assert.same({}, fsm._intq)
  end)

  it("the events of a step are discarded, whatever may use them later", function()
    local fsm = helper.started(chart())
    assert.equal("e_back=a e_x=b =b", helper.story(fsm, "e_back=a e_x=b =b"))
  end)

  it("exactly one leaf is active after each step", function()
    local fsm = helper.init(nested(trans { src = "a", tgt = "c", events = { "e" } }))
    for _ = 1, 3 do
      rfsm.step(fsm)
      local active = rfsm.elements(fsm, function(obj)
        return rfsm.is_leaf(obj) and rfsm.get_sta_mode(obj) ~= "inactive"
      end)
      assert.equal(1, #active)
      rfsm.send_events(fsm, "e")
    end
  end)
end)

describe("the cheatsheet says of tracing that", function()
  it("there are nine ids, each of which is shown or not", function()
    local ids = {}
    for id in ("STATE_ENTER STATE_EXIT EFFECT DOO EXEC_PATH ERROR HIBERNATING RAISED "
      .. "TIMEEVENT"):gmatch("%S+") do ids[#ids + 1] = id end
    for _, only in ipairs(ids) do
      local shown = {}
      local dbg = require("rfsmpp").gen_dbgcolor("fsmX", { [only] = true }, false,
        function(...) shown[#shown + 1] = table.concat({ ... }) end)
      for _, id in ipairs(ids) do dbg(id, "text") end
      assert.equal(1, #shown)
      assert.matches(only, shown[1])
    end
  end)
end)

describe("the cheatsheet says of time events that", function()
  local timeevent = require "rfsm_timeevent"

  after_each(function() timeevent.set_gettime_hook(nil) end)

  it("rfsm.timeevent is the module", function()
    assert.equal(timeevent, require "rfsm.timeevent")
  end)

  it("rtp.clock.gettime, which wants an id, and rtt.getTime are clocks", function()
    local now
    local rtp = { clock = { gettime = function(id)
      if type(id) ~= "string" then error("string expected, got no value") end
      return now, 0
    end } }
    local rtt = { getTime = function() return now, 0 end }
    for _, clock in ipairs { rtp.clock.gettime, rtt.getTime } do
      now = 1
      timeevent.set_gettime_hook(clock)
      local fsm = helper.started(helper.chart { "e_after(3)" })
      assert.equal("+4=a +5=b",
        helper.story(fsm, "+4=a +5=b", function(time) now = tonumber(time) end))
    end
  end)

  it("the clock returns seconds and nanoseconds, and is looked at by steps only",
    function()
      local now, reads = { 5, 999999999 }, 0
      timeevent.set_gettime_hook(function()
        reads = reads + 1
        return now[1], now[2]
      end)
      local fsm = helper.started(helper.chart { "e_after(3)" })
      local ids = helper.said(fsm, "dbg", "TIMEEVENT")
      now, reads = { 8, 999999999 }, 0
      assert.equal("root.a", helper.leaf_after(fsm))
      now, reads = { 9, 0 }, 0
      assert.equal(0, reads)
      assert.equal("root.b", helper.leaf_after(fsm))
      assert.same({ "TIMEEVENT e_after(3)@root.a" }, ids)
    end)
end)

describe("the cheatsheet says of sequential AND states that", function()
  after_each(helper.remove_files)

  local SUB = [[
return rfsm.state { info = false, warn = false, on = rfsm.state {
    doo = function(fsm)
      for i = 1, 4 do
        fsm.note(i)
        rfsm.yield(false)
      end
    end },
  off = rfsm.state {}, rfsm.trans { src = "initial", tgt = "on" },
  rfsm.trans { src = "on", tgt = "off", events = { "e_off" } } }
]]

  -- A machine with the regions sub1 and sub2, the list in which they note their cycles,
  -- and the handles of both.
  local function new(fields)
    local trace, file = {}, helper.file_with(SUB)
    for i = 1, 2 do
      local sub = rfsm.init(rfsm.load(file))
      sub.note = function(cycle) trace[#trace + 1] = i .. ":" .. cycle end
      fields["sub" .. i] = sub
    end
    local fsm = helper.init(state { both = rfsm.seqand(fields), info = fields.info,
      trans { src = "initial", tgt = "both" } })
    return fsm, trace, fields.sub1, fields.sub2
  end

  -- The fields, and the cycles in the entry and in the doo.
  for _, case in ipairs {
    { it = "step is 1, the substates are serialised inside the doo", fields = {},
      trace = "| 1:1 2:1 |" },
    { it = "order is that of execution, others follow", fields = { order = { "sub2" } },
      trace = "| 2:1 1:1 |" },
    { it = "step is the number of steps to advance each time", fields = { step = 3 },
      trace = "1:1 1:2 2:1 2:2 | 1:3 1:4 2:3 2:4 |" },
    { it = "run runs them instead", fields = { run = true },
      trace = "1:1 1:2 1:3 1:4 2:1 2:2 2:3 2:4 | |" },
  } do
    it(case.it, function()
      local fsm, trace = new(case.fields)
      rfsm.step(fsm)
      trace[#trace + 1] = "|"
      rfsm.step(fsm)
      trace[#trace + 1] = "|"
      assert.equal(case.trace, table.concat(trace, " "))
    end)
  end

  it("idle.doo is the flag that its yield returns", function()
    for _, idle in ipairs { true, false } do
      local fsm = new { ["idle.doo"] = idle }
      rfsm.step(fsm)
      assert.equal(idle, rfsm.step(fsm))
    end
  end)

  it("andseqdbg prints debug info, also if info is off", function()
    for _, info in ipairs { true, false } do
      local function lines_with(flag)
        local text = table.concat(helper.printed(function()
          rfsm.step((new { andseqdbg = flag, info = info }))
        end), "\n")
        local lines = {}
        for line in text:gmatch("SEQAND[^\n]*") do lines[#lines + 1] = line end
        return lines
      end
      assert.same({ "SEQAND root.both: order sub1, sub2",
        "SEQAND root.both: sub1 advanced to root.on",
        "SEQAND root.both: sub2 advanced to root.on" }, lines_with(true))
      assert.same({}, lines_with(false))
    end
  end)

  it("the substates are the initialised machines themselves", function()
    local fsm, _, sub1, sub2 = new {}
    rfsm.run(fsm)
    rfsm.send_events(sub2, "e_off")
    rfsm.run(fsm)
    assert.same({ "root.on", "root.off" }, { rfsm.get_actleaf_fqn(sub1),
      rfsm.get_actleaf_fqn(sub2) })
  end)
end)
