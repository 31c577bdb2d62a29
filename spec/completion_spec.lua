-- Completion: composites and sequential AND states that are done.

local await = require "rfsm.await"
local interrupts = require "spec.support.interrupts"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local snapshot = require "rfsm.snapshot"
require "rfsm.emem"
require "rfsm_seqand"

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
local send = helper.moved

local function at(fsm) return rfsm.get_actleaf_fqn(fsm) end

-- Returns a machine that has run, and a list of its warnings, without their places.
local function new(members)
  local warned = {}
  local model = { info = false, warn = function(text)
    warned[#warned + 1] = text:gsub("^WARNING: ", ""):gsub("^[^ ]-:%d+: ", "")
  end }
  for key, value in pairs(members) do model[key] = value end -- any order: a copy
  local fsm = assert(rfsm.init(state(model)))
  rfsm.run(fsm)
  return fsm, warned
end

-- A region: x, then the final leaf e on an event.
local function region(event, members)
  local model = { info = false, warn = false, x = state {}, e = state { final = true },
    trans { src = "initial", tgt = "x" },
    trans { src = "x", tgt = "e", events = { event } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a copy
  return state(model)
end

-- A machine of c, the given composite or state, which e_done leaves.
local function around(c, members)
  local model = { c = c, z = state { final = true },
    trans { src = "initial", tgt = "c" },
    trans { src = "c", tgt = "z", events = { "e_done" } } }
  for key, value in pairs(members or {}) do model[key] = value end -- any order: a copy
  return new(model)
end

describe("a composite", function()
  it("is done by any final leaf right in it", function()
    for _, event in ipairs { "e_1", "e_2" } do
      local fsm, warned = around(region("e_1", { f = state { final = true },
        [3] = trans { src = "x", tgt = "f", events = { "e_2" } } }))
      assert.equal("root.z", at(send(fsm, event)))
      assert.same({}, warned)
    end
  end)

  it("is done when the doo of the leaf has ended, and not before", function()
    local is_over = false
    local fsm = around(region("e_1", { e = state { final = true, doo = function()
      while not is_over do rfsm.yield(true) end
    end } }))
    assert.equal("root.c.e", at(send(fsm, "e_1")))
    is_over = true
    assert.equal("root.z", at(send(fsm)))
  end)

  it("is not done if the doo fails, by a leaf further in, or by a state named final",
    function()
      for _, e in ipairs {
        state { final = true, doo = function() error("on purpose", 0) end },
        state { y = state { final = true }, trans { src = "initial", tgt = "y" } },
        state { final = state {}, trans { src = "initial", tgt = "final" } },
        state { final = "yes" },
      } do
        local fsm = around(region("e_1", { e = e }), { err = false })
        assert.matches("^root%.c%.e", at(send(fsm, "e_1")))
      end
    end)

  it("sends its e_done right after that of the leaf, only if it is waited for",
    function()
      for _, case in ipairs { { "c", "e_done@root.c.e, e_done@root.c" },
        { ".c.x", "e_done@root.c.e" } } do
        local seen = {}
        around(region("e_done"), { err = false, [2] = trans { src = case[1], tgt = "z",
          events = { "e_done" }, guard = function() return false end },
          pre_step_hook = function(_, events)
            for i = 2, #events + 1 do seen[#seen + 1] = events[i - 1] end
          end })
        assert.equal("e_init_fsm, e_done@root.c.x, " .. case[2],
          table.concat(seen, ", "))
      end
    end)

  it("of composites is done inside, then outside", function()
    local inner = state { i = region "e_1", y = state { final = true },
      trans { src = "initial", tgt = "i" },
      trans { src = "i", tgt = "y", events = { "e_done" } } }
    assert.equal("root.z", at(send(around(inner), "e_1")))
  end)

  it("may be the root, and be awaited", function()
    local fsm = new { x = state {}, e = state { final = true },
      trans { src = "initial", tgt = "x" }, trans { src = "root", tgt = ".x",
        events = { "e_done" } }, trans { src = "x", tgt = "e", events = { "e_1" } } }
    assert.equal("root.x", at(send(fsm, "e_1")))
    local awaiting, warned = around(region "e_1", { [2] = trans { src = "c", tgt = "z",
      events = { "await(e_done, e_2)" } } })
    assert.equal("root.c.e", at(send(awaiting, "e_1")))
    assert.equal("root.z", at(send(awaiting, "e_2")))
    assert.same({}, warned)
    assert.is_table(await)
  end)

  it("may be merged, and be compiled", function()
    local fsm = around(region("e_1", { [3] = trans { src = "e", tgt = "x",
      events = { "e_again" } } }), { [2] = trans { src = "c", tgt = "z",
      events = { "e_z" } }, [3] = trans { src = "z", tgt = "c",
      events = { "e_back" } } })
    for _ = 1, 9 do send(fsm, "e_1", "e_again") end
    assert.equal("root.c.e", at(send(fsm, "e_1")))
    assert.is_true(rfsm.fsm_merge(fsm, fsm, trans { src = "c", tgt = "z",
      events = { "e_done" } }))
    for _ = 1, 9 do
      send(send(fsm, "e_again"), "e_1")
      assert.equal("root.z", at(fsm))
      send(fsm, "e_back")
    end
  end)

  it("is traced", function()
    local trace = {}
    around(region("e_done"), { dbg = function(id, event)
      if id == "RAISED" then trace[#trace + 1] = event end
    end })
    assert.same({ "e_done@root.c.x", "e_done@root.c.e", "e_done@root.c",
      "e_done@root.z" }, trace)
  end)
end)

describe("an interrupt", function()
  it("loses no e_done of a composite", function()
    for instruction = 1, 600 do
      local fsm = around(region("e_1", { e = state { final = true, doo = function()
        rfsm.yield(true)
      end } }))
      send(fsm, "e_1")
      interrupts.raise(instruction, interrupts.VALUES[1], rfsm.step, fsm)
      rfsm.run(fsm)
      assert.equal("root.z", at(fsm))
      fsm = around(region "e_1")
      rfsm.send_events(fsm, "e_1")
      interrupts.raise(instruction, interrupts.VALUES[1], rfsm.run, fsm)
      rfsm.run(fsm)
      assert.equal("root.z", at(fsm))
    end
  end)

  it("loses no e_done of a sequential AND state", function()
    for instruction = 1, 2500, 7 do
      local fsm = around(rfsm.seqand { idle_doo = "auto", l = region "e_1" })
      rfsm.send_events(fsm, "e_1")
      interrupts.raise(instruction, interrupts.VALUES[1], rfsm.run, fsm)
      rfsm.run(fsm)
      assert.equal("root.z", at(fsm))
    end
  end)
end)

describe("a sequential AND state", function()
  local function joined(members, more)
    local fields = { idle_doo = "auto", l = region "e_l", r = region "e_r" }
    for key, value in pairs(members or {}) do fields[key] = value end -- any order
    return around(rfsm.seqand(fields), more)
  end

  it("is done when the last region is, whichever that is", function()
    for _, events in ipairs { { "e_l", "e_r" }, { "e_r", "e_l" } } do
      local fsm, warned = joined()
      assert.equal("root.c", at(send(fsm, events[1])))
      assert.equal("root.z", at(send(fsm, events[2])))
      assert.same({}, warned)
      assert.equal("root.z", at(send((joined()), unpack(events))))
    end
  end)

  for _, case in ipairs {
    { "in a composite of a region", region("e_l", { e = region("e_done") }) },
    { "that waits for its doo", region("e_l", { e = state { final = true,
      doo = function() while true do rfsm.yield(true) end end } }) },
  } do
    it("is not done by a final leaf " .. case[1], function()
      local fsm = joined { l = case[2] }
      assert.equal("root.c", at(send(send(fsm, "e_l"), "e_r")))
    end)
  end

  it("joins regions that join others", function()
    local inner = region("e_l", { e = state { final = true },
      x = rfsm.seqand { idle_doo = "auto", a = region "e_a", b = region "e_b" },
      [2] = trans { src = "x", tgt = "e", events = { "e_done" } } })
    local fsm = joined { l = inner }
    assert.equal("root.c", at(send(send(fsm, "e_r"), "e_a")))
    assert.equal("root.z", at(send(fsm, "e_b")))
  end)

  it("is done by a sequential AND state that is final", function()
    local last = rfsm.seqand { idle_doo = "auto", final = true, a = region "e_a" }
    local fsm = joined { l = region("e_l", { e = last, [3] = trans { src = "e",
      tgt = "x", events = { "e_done" }, guard = function() return false end } }) }
    assert.equal("root.c", at(send(send(fsm, "e_l"), "e_r")))
    assert.equal("root.z", at(send(fsm, "e_a")))
  end)

  it("goes on if no transition waits for e_done", function()
    local fsm = joined({}, { [2] = trans { src = "c", tgt = "z",
      events = { "e_z" } } })
    send(send(fsm, "e_l"), "e_r")
    assert.equal("active", rfsm.get_sta_mode(fsm.c))
  end)

  it("is joined in a copy of a machine that has joined it", function()
    local fsm = send(around(rfsm.seqand { a = region "e_a", b = region "e_b" }), "e_a")
    local copy = helper.copy_of(fsm)
    for _, machine in ipairs { fsm, copy } do
      assert.equal("root.z", at(send(machine, "e_b")))
    end
  end)

  it("is left alone when it is done", function()
    local fsm = joined({}, { [2] = trans { src = "c", tgt = "z", events = { "e_done" },
      guard = function() return false end } })
    send(send(fsm, "e_l"), "e_r")
    assert.equal("done", rfsm.get_sta_mode(fsm.c))
    for _ = 1, 5 do send(fsm, "e_l") end
    assert.equal(0, #fsm.c.substates.l._intq)
  end)

  it("is entered anew, with regions that begin anew", function()
    local fsm = joined({}, { [3] = trans { src = "z", tgt = "c",
      events = { "e_back" } } })
    for _ = 1, 3 do
      assert.equal("root.z", at(send(send(fsm, "e_l"), "e_r")))
      assert.equal("root.c", at(send(fsm, "e_back")))
    end
  end)

  it("is joined behind a snapshot", function()
    local fsm = send((joined()), "e_l")
    local other = assert(snapshot.restore(fsm, snapshot.take(fsm)))
    assert.equal("root.z", at(send(other, "e_r")))
  end)

  it("tells its parent machine to a callback of a region", function()
    local found = {}
    local l = region("e_l", { e = state { final = true, entry = function(own)
      local parent, name = rfsm.parent(own)
      found = { parent, name }
      rfsm.send_events(parent, "e_told")
    end } })
    local fsm = joined({ l = l }, { [3] = trans { src = "c", tgt = "z",
      events = { "e_told" } } })
    assert.equal("root.z", at(send(fsm, "e_l")))
    assert.same({ true, "l" }, { rawequal(found[1], fsm), found[2] })
    assert.is_nil((rfsm.parent(fsm)))
  end)

  it("is explored, and its pictures show what is final", function()
    local model = state { info = false, warn = false,
      c = rfsm.seqand { idle_doo = "auto", l = region "e_l", r = region "e_r" },
      z = state { final = true }, trans { src = "initial", tgt = "c" },
      trans { src = "c", tgt = "z", events = { "e_done" } } }
    local result = rfsm_checks.explore(model)
    assert.matches("^%d+ configurations, 6 of 6 transitions taken", tostring(result))
    local dot = require("rfsm.dot").encode(assert(rfsm.init(model)))
    local _, count = dot:gsub("peripheries=2", "")
    assert.equal(3, count)
  end)
end)

describe("e_done beside an internal transition that does not name it", function()
  local function entered(read)
    local fsm = assert(rfsm.init(state { info = false, warn = false, read = read,
      a = state {}, z = state { final = true },
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "internal",
        events = { "e_in" } }, trans { src = "a", tgt = "z", events = { "e_done" },
        guard = function() return false end } }))
    rfsm.step(fsm)
    return fsm
  end

  it("comes again, also if another one waits", function()
    local fsm = entered "one"
    rfsm.send_events(fsm, "e_done@root.a")
    fsm.pre_step_hook = function(_, events) events[2] = "e_in" end
    rfsm.step(fsm)
    assert.equal(2, rfsm.check_events(fsm))
  end)

  it("comes again each time", function()
    local fsm = entered "all"
    for _ = 1, 5 do
      rfsm.send_events(fsm, "e_in")
      rfsm.step(fsm)
      assert.equal(1, rfsm.check_events(fsm))
    end
  end)
end)

describe("e_done that never comes", function()
  local LEAF = state {}
  for _, case in ipairs {
    { "of a composite", region("e_1", { e = LEAF }),
      "root.trans[2] (c -> z): 'e_done' never fires here, no leaf right in 'root.c' is "
        .. "final (final = true)",
      "event 'e_done@root.c' never comes, no leaf right in 'root.c' is final "
        .. "(final = true)" },
    { "of regions", rfsm.seqand { l = region "e_1", r = region("e_1", { e = LEAF }) },
      "root.c: 'e_done' never fires here, no leaf right in the region 'r' is final "
        .. "(final = true)",
      "event 'e_done@root.c' never comes, no leaf right in its region 'r' is final "
        .. "(final = true)" },
    { "of a region that is a leaf", rfsm.seqand { l = state { final = true,
      info = false, warn = false } },
      "root.c: 'e_done' never fires here, no leaf right in the region 'l' is final "
        .. "(final = true)",
      "event 'e_done@root.c' never comes, no leaf right in its region 'l' is final "
        .. "(final = true)" },
  } do
    it(case[1] .. " is told", function()
      local _, warned = around(case[2])
      assert.same({ case[3] }, { warned[1] })
      local found = {}
      for _, finding in ipairs(rfsm_checks.findings(state { info = false, warn = false,
        c = case[2], z = state { final = true }, trans { src = "initial", tgt = "c" },
        trans { src = "c", tgt = "z", events = { "e_done" } } })) do
        if finding.code == "never-done" then found[#found + 1] = finding.text end
      end
      assert.same({ case[4] }, found)
    end)
  end

  it("of a connector is told as before", function()
    local _, warned = new { k = conn {}, a = state {}, trans { src = "initial",
      tgt = "a" }, trans { src = "a", tgt = "k", events = { "e" } },
      trans { src = "k", tgt = "a", events = { "e_done" } } }
    assert.same({ "root.trans[3] (k -> a): 'e_done' never fires here, 'root.k' is no "
      .. "leaf state" }, warned)
  end)

  for _, case in ipairs {
    { "in a composite", { c = region("e_1", { final = true }) },
      "root.c", "final = true in a composite says nothing (mark the leaf in it that "
        .. "ends it)" },
    { "in a connector", { c = conn { final = true } },
      "root.c", "a connector has no field 'final' (a state has it)" },
    { "in a transition", { c = state {}, [3] = trans { src = "c", tgt = "z",
      events = { "e_1" }, final = true } }, "root.trans[3] (c -> z)",
      "a transition has no field 'final' (a state has it)" },
    { "in a state that is left", { c = state { final = true } },
      "root.c", "final = true, but a transition leaves it (remove one of them)" },
  } do
    it("final " .. case[1] .. " is found", function()
      local model = { info = false, warn = false, z = state { final = true },
        trans { src = "initial", tgt = "c" },
        trans { src = "c", tgt = "z", events = { "e_z" } } }
      for key, value in pairs(case[2]) do model[key] = value end -- any order: a copy
      local found = {}
      for _, finding in ipairs(rfsm_checks.findings(state(model))) do
        if finding.text:find("final", 1, true) then
          found[#found + 1] = finding.place .. ": " .. finding.text
        end
      end
      assert.same({ case[3] .. ": " .. case[4] }, found)
    end)
  end

  it("final in a region that nothing reaches is found", function()
    local texts = rfsm_checks.check(state { info = false, warn = false,
      c = rfsm.seqand { l = region("e_1", { [2] = trans { src = "x", tgt = "x",
        events = { "e_1" } } }) }, z = state { final = true },
      trans { src = "initial", tgt = "c" },
      trans { src = "c", tgt = "z", events = { "e_done" } } })
    assert.matches("root%.c%.l: root%.e: unreachable, no path of transitions",
      table.concat(texts, "\n"))
  end)
end)
