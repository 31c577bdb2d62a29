-- The code of rFSM's cheatsheet as it stands there, its slips mended: missing commas,
-- names swapped in `local state, trans, conn`, `entry` written twice, an `end` out of
-- place. It uses the global `rfsm`, as charts in the wild do.

local helper = require "spec.helper"

require "rfsm"

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

  it("the complete example moves and stops", function()
    local globals, trace = noting("enable_robot", "disable_robot", "start_motor",
      "stop_motor", "compute_next_pos")
    require "rfsmpp"
    local model = run_block([[
local state, trans = rfsm.state, rfsm.trans
return rfsm.state {
    dbg=rfsmpp.gen_dbgcolor("sample-fsm", {}, false),
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
]], globals)
    local fsm = helper.started(model)
    helper.post_and_run(fsm, "e_start")
    helper.post_and_run(fsm, "e_stop")
    assert.same({ "enable_robot", "start_motor", "compute_next_pos", "stop_motor" },
      trace)
  end)
end)
