-- A machine that a program has copied table by table, fresh and after so many uses that
-- straight code runs.

local helper = require "spec.helper"
local interrupts = require "spec.support.interrupts"
local rfsm = require "rfsm"
require "rfsm.history"
require "rfsm_seqand"
require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans

describe("a copy of all tables of a machine", function()
  local notes -- of each machine what it called

  local function note(fsm, text)
    while fsm._owner do fsm = fsm._owner end
    notes[fsm] = notes[fsm] or {}
    table.insert(notes[fsm], text)
  end

  local function noted(fsm, obj, what) note(fsm, what .. " " .. (obj._fqn or "")) end

  local function hook(text) return function(fsm) note(fsm, text) end end

  local function busy(members)
    members = members or {}
    members.entry, members.exit = noted, noted
    return state(members)
  end

  -- initial -> x --e--> y --e--> x
  local function flip_flop(fields)
    return busy { x = busy(), y = busy(), history = fields and fields.history,
      info = false, warn = false, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = { "e" }, effect = noted },
      trans { src = "y", tgt = "x", events = { "e" } } }
  end

  local function doo(fsm)
    while true do
      note(fsm, "doo")
      rfsm.yield(true)
    end
  end

  local CASES = {
    { what = "goes its own way" },
    { what = "has hooks", members = { pre_step_hook = hook "pre",
      post_step_hook = hook "post", getevents = function() return {} end } },
    { what = "has hooks of extensions", change = function(fsm)
      rfsm.entry_hook_add(fsm, fsm.b, hook "entry hook")
      rfsm.exit_hook_add(fsm, fsm.a, hook "exit hook")
      rfsm.post_step_hook_add(fsm, hook "post")
      rfsm.path_hook_add(fsm, hook "path")
    end },
    { what = "has a doo", members = { b = busy { doo = doo } } },
    { what = "has timers", members = {
      trans { src = "initial", tgt = "a" }, trans { src = "b", tgt = "a",
        events = { "back", "e_after(3)" } },
      trans { src = "a", tgt = "b", events = { "e", "e_after(5)" } } } },
    { what = "has composites", members = { b = flip_flop() } },
    { what = "has a history", members = { b = flip_flop { history = "deep" } } },
    { what = "has regions", members = { b = rfsm.seqand { left = flip_flop(),
      right = flip_flop() } } },
    { what = "has active regions", before = "e e", members = {
      b = rfsm.seqand { left = flip_flop(), right = flip_flop() } } },
  }

  local function play(fsm, move)
    if move == "tick" then
      local now = fsm.gettime() + 2
      fsm.gettime = function() return now, 0 end
    else
      rfsm.send_events(fsm, move)
    end
    rfsm.run(fsm)
    note(fsm, move .. ": " .. rfsm.get_actleaf_fqn(fsm))
  end

  -- A machine that was used so often, and has then seen the moves in `before`.
  local function new_machine(case, uses)
    local model = { info = false, a = busy(), b = busy(),
      trans { src = "initial", tgt = "a" },
      trans { src = "b", tgt = "a", events = { "back" }, effect = noted },
      trans { src = "a", tgt = "b", events = { "e" }, effect = noted },
      gettime = function() return 0, 0 end }
    for key, value in pairs(case.members or {}) do model[key] = value end -- any order
    local fsm = helper.init(state(model))
    if case.change then case.change(fsm) end
    for move in (("e e back "):rep(uses) .. (case.before or "")):gmatch("%a+") do
      play(fsm, move)
    end
    return fsm
  end

  local STORIES = { { "e", "e", "tick", "back", "tick", "e", "tick", "tick",
    "e" }, { "e", "tick", "tick", "e", "back", "back", "e", "e", "tick" } }

  -- Plays moves on a machine and on its copy in turn, then on machines that are alone.
  local function check(case, uses)
    local fsm, seen = new_machine(case, uses), {}
    local pair = { fsm, helper.copy_of(fsm) }
    notes = {}
    for i = 1, #STORIES[1] do
      for n = 1, 2 do play(pair[n], STORIES[n][i]) end
    end
    for n = 1, 2 do seen[n] = notes[pair[n]] end
    for n = 1, 2 do
      local alone = new_machine(case, uses)
      notes = {}
      for _, move in ipairs(STORIES[n]) do play(alone, move) end
      assert.same(notes[alone], seen[n])
    end
  end

  for _, case in ipairs(CASES) do
    for _, uses in ipairs { 0, 5, 25 } do
      it(("%s, after %d uses"):format(case.what, uses), function()
        notes = {}
        check(case, uses)
      end)
    end
  end

  it("whose step was cut short goes on as that does", function()
    notes = {}
    local fsm, at = new_machine({ members = { b = flip_flop() } }, 5), 0
    interrupts.without_jit(function()
      repeat
        at = at + 1
        play(fsm, "back")
        rfsm.send_events(fsm, "e")
        local is_reached = interrupts.raise(at, interrupts.VALUES[2], rfsm.step, fsm)
        local copy = helper.copy_of(fsm)
        notes = {}
        play(copy, "e")
        play(fsm, "e")
        assert.same(notes[fsm], notes[copy])
      until not is_reached
    end)
    assert.is_true(at > 100)
  end)
end)
