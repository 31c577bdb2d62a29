-- An error that no function of the user raised, such as Control-C in a terminal, may
-- strike at any VM instruction of the engine. Here it does so at each in turn, or at
-- each 7th if the machine is traced: the share of this Lua. It reaches the caller as
-- itself. After that the machine goes on, and each callback is called once and in
-- order, as in a machine that is left alone.

local rfsm = require "rfsm"
local share = require "spec.support.share"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local INTERRUPT = setmetatable({}, { __tostring = function() return "a limit" end })
local LIMIT = 1e6 -- instructions: more than any of these runs needs

-- A chart whose callbacks note their calls in `trace`; without a trace it has none.
-- a.b.c --e_k--> k --> d.e (doo) --e_back--> a, d --e_straight--> a.b.c,
-- a.b.c --e_stay--> internal
local function new_machine(trace, fields)
  local function callback(text)
    return trace and function() trace[#trace + 1] = text end
  end
  local function busy(name, members)
    members.entry, members.exit = callback("entry " .. name), callback("exit " .. name)
    return state(members)
  end
  local model = {
    info = false, warn = false, err = function() end,
    a = busy("a", {
      b = busy("b", { c = busy("c", {}), trans { src = "initial", tgt = "c" } }),
      trans { src = "initial", tgt = "b" },
    }),
    d = busy("d", {
      e = busy("e", { doo = function()
        for i = 1, 4 do
          if trace then trace[#trace + 1] = "doo " .. i end
          rfsm.yield(i == 4)
        end
      end }),
      trans { src = "initial", tgt = "e" },
    }),
    k = conn {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a.b.c", tgt = "k", events = "e_k", effect = callback "effect k" },
    trans { src = "k", tgt = "d", guard = trace and function() end,
      effect = callback "effect d" },
    trans { src = "d", tgt = "a", events = "e_back" },
    trans { src = "d", tgt = "root.a.b.c", events = "e_straight" },
    trans { src = "a.b.c", tgt = "internal", events = "e_stay",
      effect = callback "effect stay" },
  }
  for name, value in pairs(fields or {}) do model[name] = value end -- any order: a set
  return assert(rfsm.init(state(model)))
end

-- Has `f` called the function that a hook interrupts, or the one that has called that?
local function is_called_by(f)
  for level = 4, 7 do
    local info = debug.getinfo(level, "f")
    if info and info.func == f then return true end
  end
  return false
end

-- Calls f(fsm) and raises INTERRUPT in the engine after `at` VM instructions, but not
-- while another error is handled: there is one at a time. Returns false if f was
-- through before, else what reached the caller.
local function interrupt(at, f, fsm)
  local is_hit = false
  local function hook()
    if is_hit then return debug.sethook() end
    if not debug.getinfo(2, "S").short_src:find("^%.?/?rfsm")
      or is_called_by(error) then
      return debug.sethook(hook, "", 1)
    end
    debug.sethook()
    is_hit = true
    error(INTERRUPT, 0)
  end
  local _, failure = pcall(function()
    debug.sethook(hook, "", at)
    f(fsm)
    debug.sethook()
  end)
  debug.sethook()
  return is_hit and failure
end

-- What is wrong with a machine of these states between two steps; nil when nothing is.
local function defect(fsm, states)
  local active = {}
  for _, fqn in ipairs(rfsm.get_active_conf(fsm)) do active[fqn] = true end
  local leaf = rfsm.get_actleaf_fqn(fsm)
  if not leaf or not active[leaf] then return "the active leaf is no active state" end
  for _, s in ipairs(states) do
    local mode = rfsm.get_sta_mode(s)
    if (mode ~= "inactive") ~= (active[s._fqn] or false) then
      return s._fqn .. " is " .. mode
    end
  end
end

local function twice(fsm) rfsm.step(fsm, 2) end

-- Where a machine is before it is interrupted.
local function in_a(fsm)
  rfsm.reset(fsm)
  rfsm.run(fsm)
end

local function in_d(fsm)
  in_a(fsm)
  rfsm.send_events(fsm, "e_k")
  rfsm.step(fsm)
end

local function in_doo(fsm)
  in_d(fsm)
  rfsm.step(fsm)
end

local function nothing() end

-- Hooks note only events: an interrupt may come when an iteration is over, and the next
-- one has none then.
local function noting_events(trace, text)
  return function(_, events)
    if events[1] ~= nil then
      trace[#trace + 1] = text .. " " .. table.concat(events, " ")
    end
  end
end

local REPEATED = { TRANSITION = true, CHECKING = true, HIBERNATING = true }

-- What is added to a machine that notes its callbacks.
local ADDITIONS = {
  hooks = function(fsm, trace)
    fsm.pre_step_hook = noting_events(trace, "pre")
    rfsm.pre_step_hook_add(fsm, noting_events(trace, "pre 2"))
    fsm.post_step_hook = noting_events(trace, "post")
  end,
  ["an added post step hook"] = function(fsm, trace)
    rfsm.post_step_hook_add(fsm, noting_events(trace, "post"))
  end,
  ["state hooks"] = function(fsm, trace)
    for _, s in ipairs { fsm.a.b, fsm.d } do
      rfsm.entry_hook_add(fsm, s, function() trace[#trace + 1] = "hook" end)
      rfsm.exit_hook_add(fsm, s, function() trace[#trace + 1] = "exit hook" end)
    end
  end,
  ["a getevents"] = function(fsm, trace)
    fsm.getevents = function()
      if not fsm.is_waiting then return {} end
      fsm.is_waiting = false
      trace[#trace + 1] = "getevents"
      return { "e_more" }
    end
  end,
  dbg = function(fsm, trace)
    fsm.dbg = function(id, text)
      if not REPEATED[id] then trace[#trace + 1] = id .. " " .. text end
    end
  end,
}

local CASES = {
  { name = "at the first entry", from = rfsm.reset, advance = rfsm.run },
  { name = "of a bare step at the first entry", from = rfsm.reset },
  { name = "on a path over a connector", from = in_a, event = "e_k",
    advance = rfsm.run },
  { name = "of a bare step", from = in_a, event = "e_k" },
  { name = "of two steps", from = in_a, event = "e_k", advance = twice },
  { name = "on an internal transition", from = in_a, event = "e_stay" },
  { name = "out of a composite", from = in_d, event = "e_back" },
  { name = "of one segment", from = in_d, event = "e_straight" },
  { name = "in the first cycle of a doo", from = in_d, is_cycle = true },
  { name = "in another cycle", from = in_doo, is_cycle = true },
  { name = "of two cycles", from = in_doo, advance = twice },
  { name = "on an event that nothing waits for", from = in_d, event = "e_other" },
}
-- A doo whose second cycle ends it.
for name, ending in pairs { -- any order: each stands alone
  fails = function() error("on purpose", 0) end, ["is the last one"] = nothing,
} do
  for _, addition in ipairs { "none", "dbg" } do
    CASES[#CASES + 1] = { name = ("in a cycle that %s, with %s"):format(name, addition),
      from = in_doo, is_cycle = true, addition = function(fsm, trace)
        fsm.err = function(_, text) trace[#trace + 1] = text end
        fsm.d.e.doo = function()
          rfsm.yield()
          ending()
        end
        if addition == "dbg" then ADDITIONS.dbg(fsm, trace) end
      end }
  end
end
CASES[#CASES + 1] = { name = "in the first cycle of a doo, with dbg", from = in_d,
  is_cycle = true, addition = ADDITIONS.dbg }

for _, addition in ipairs(rfsm.sorted_keys(ADDITIONS)) do
  for _, event in ipairs { "e_k", "e_straight", "e_other" } do
    CASES[#CASES + 1] = { name = ("with %s, on %s"):format(addition, event),
      from = event == "e_straight" and in_d or in_a, event = event,
      addition = ADDITIONS[addition], every = addition == "dbg" and 7 or 1 }
  end
end

-- Brings the machine where the case begins.
local function begin(case, fsm, trace)
  fsm.is_waiting = false
  case.from(fsm)
  fsm.is_waiting = true
  if case.event then rfsm.send_events(fsm, case.event) end
  for i = #trace, 1, -1 do trace[i] = nil end
end

-- Lets the machine go on, which must end by itself, and returns where it is then. A doo
-- shows its cycle only if the iteration alone is finished.
local function finish(fsm, trace, is_cycle)
  local is_over = is_cycle and (trace[1] or fsm.d.e._mode == "done")
  if not (is_over and fsm._phase == "idle") then
    assert(not interrupt(LIMIT, is_cycle and rfsm.step or rfsm.run, fsm),
      "it does not end")
  end
  return ("%s%s, %d events, %s"):format(is_cycle and fsm.d.e._mode .. " " or "",
    rfsm.get_actleaf_fqn(fsm), #fsm._intq, table.concat(trace, ", "))
end

-- Interrupts the case everywhere and lets the machine go on.
local function check_everywhere(case, has_callbacks)
  local trace, advance = {}, case.advance or rfsm.step
  local fsm = new_machine(has_callbacks and trace)
  local states = rfsm.elements(fsm, rfsm.is_state)
  if case.addition then case.addition(fsm, trace) end
  for _ = 1, 10 do -- loads and compiles what is needed
    begin(case, fsm, trace)
    finish(fsm, trace)
  end
  begin(case, fsm, trace)
  advance(fsm)
  local expected, failure = finish(fsm, trace, case.is_cycle), true
  local every, at = share.every(case.every or 1)
  at = at - every
  while failure do
    at = at + every
    begin(case, fsm, trace)
    failure = interrupt(at, advance, fsm)
    local where = ("at instruction %d"):format(at)
    if failure then assert.equal(INTERRUPT, failure, where) end
    assert.equal(expected, finish(fsm, trace, case.is_cycle), where)
    assert.is_nil(defect(fsm, states), where)
  end
  assert.is_true(at > 20)
end

local function with_interpreter(f, ...)
  local jit = rawget(_G, "jit")
  if not jit then return f(...) end
  jit.off()
  jit.flush()
  local ok, problem = pcall(f, ...)
  jit.on()
  if not ok then error(problem, 0) end
end

describe("an interrupt", function()
  for _, case in ipairs(CASES) do
    it("leaves a machine that calls each callback once, " .. case.name, function()
      with_interpreter(check_everywhere, case, true)
    end)
  end

  for i = 1, 4 do
    it("leaves a machine without callbacks that goes on, " .. CASES[i].name, function()
      with_interpreter(check_everywhere, CASES[i], false)
    end)
  end

  -- An iteration that ends early: its events stay pending.
  local REFUSALS = {
    { name = "an entry that is refused", from = rfsm.reset, addition = function(fsm)
      fsm[1].guard = function() return false end
    end, pending = "e_init_fsm, e_1, e_2, e_3" },
    { name = "a pre step hook that fails", from = in_a, addition = function(fsm)
      rfsm.pre_step_hook_add(fsm, function(_, events)
        if events[2] == "e_2" then error("on purpose", 0) end
      end)
    end, pending = "e_1, e_2, e_3" },
  }
  for _, case in ipairs(REFUSALS) do
    it("loses and repeats no event at " .. case.name, function()
      local fsm, failure, at = new_machine(), true, 0
      rfsm.run(fsm)
      with_interpreter(function()
        while failure do
          at = at + 1
          case.from(fsm)
          if at == 1 then case.addition(fsm) end
          rfsm.send_events(fsm, "e_1", "e_2", "e_3")
          failure = interrupt(at, rfsm.step, fsm)
          if fsm._phase ~= "idle" then pcall(rfsm.step, fsm) end
          assert.equal(case.pending, table.concat(fsm._intq, ", "))
        end
      end)
    end)
  end

  it("is followed by the rest of the step before an extension works", function()
    local trace = {}
    local fsm = new_machine(trace)
    local case = { from = in_a, event = "e_k" }
    with_interpreter(function()
      for at = 1, 2000, 11 do
        begin(case, fsm, trace)
        if not interrupt(at, rfsm.step, fsm) then break end
        local is_under_way = fsm._phase ~= "idle"
        rfsm.check_between_steps(fsm, "an extension")
        if is_under_way then assert.equal("root.d.e", rfsm.get_actleaf_fqn(fsm)) end
      end
    end)
  end)

  it("of an entry that never ends reaches the caller", function()
    local fsm = assert(rfsm.init(state {
      info = false, warn = false, a = state {}, b = state { entry = function()
        while true do nothing() end
      end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = "e" },
    }))
    rfsm.run(fsm)
    rfsm.send_events(fsm, "e")
    with_interpreter(function()
      local ok, failure = pcall(function()
        debug.sethook(function()
          debug.sethook()
          error("interrupted!", 0)
        end, "", 50000)
        rfsm.run(fsm)
      end)
      assert.same({ false, "interrupted!" }, { ok, failure })
    end)
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)
end)
