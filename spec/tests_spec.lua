-- Tests made from charts: they pass, take what can be taken, and notice mutants.

local explore = require "rfsm.explore.explore"
local outside_events = require("spec.support.claims.explore").outside_events
local helper = require "spec.helper"
local mutate = require "spec.support.mutate"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"
local tests = require "rfsm.tests.tests"
require "rfsm_timeevent"
require "rfsm.await"

local load_text = rawget(_G, "loadstring") or rawget(_G, "load")
local state, trans = rfsm.state, rfsm.trans
local PRINT = rawget(_G, "print") -- before a rehearsal replaces it

-- Loads a chart silently; machines inside of it print when they are made.
local function load_chart(file)
  local model
  helper.printed(function() model = rfsm.load(file) end)
  model.info, model.warn, model.err = false, false, false
  return model
end

-- Does a rehearsal of the model do what the tests expect of the chart?
local function passes(result, load, callbacks)
  local options = { callbacks = callbacks or false }
  for _, planned in ipairs(result.runs) do
    local ok, run = pcall(rfsm_checks.rehearsal, load(), options)
    if not ok then return false end
    mutate.negate(run)
    for _, step in ipairs(planned.steps) do
      local is_known, text = pcall(run.step, run, step.what)
      if not is_known or text ~= step.result then return false end
    end
  end
  return true
end

-- All that an exploration sees of a model on some events: every step, by what it starts
-- from. Returns the events of the chart, too.
local function seen_in(model, alphabet)
  local seen = {}
  local walked = explore.walk(model, { alphabet = alphabet }, function(walk)
    local function text_of(number)
      local stand = walk:configuration(number)[1]
      return (stand.leaf and stand.leaf._fqn or "none") .. stand.mode .. #stand.waiting
    end
    function walk.look(_, from, tgt, _, label)
      local paths = walk.subject:paths_of()
      local asked = table.concat(walk.subject.askers, ",", 1, walk.subject.asked)
      seen[table.concat({ text_of(from), label():match(":(.*)"), asked,
        table.concat(paths, ","), text_of(tgt) }, " ")] = true
    end
  end)
  return seen, outside_events(walked.subject)
end

-- Does a mutant react to the events of the chart as the chart does?
local function is_equivalent(mutant, seen, alphabet)
  if mutant.kind == "negated" then return false end
  local ok, own = pcall(seen_in, mutant.model(), alphabet)
  if not ok then return false end
  for key in pairs(own) do if not seen[key] then return false end end
  for key in pairs(seen) do if not own[key] then return false end end
  return true
end

-- Returns how many mutants there are, but for equivalent ones, how many were killed,
-- and the others.
local function kill(load, result)
  local count, killed, alive = 0, 0, {}
  local _, alphabet = seen_in(load())
  local seen = seen_in(load(), alphabet)
  for _, mutant in ipairs(mutate.all(load)) do
    local is_killed = not passes(result, mutant.model)
    if is_killed or not is_equivalent(mutant, seen, alphabet) then
      count = count + 1
      if is_killed then killed = killed + 1 end
      if not is_killed then alive[#alive + 1] = mutant.kind .. " " .. mutant.at end
    end
  end
  return count, killed, alive
end

-- Runs the text of a spec.
local function run_spec(text, file)
  local chunk, real = assert(load_text(text, "=" .. file)), {}
  local function call(_, f) f() end
  local stand_ins = { describe = call, it = call, assert = assert }
  for name, value in pairs(stand_ins) do -- any order: each stands alone
    real[name] = rawget(_G, name)
    rawset(_G, name, value)
  end
  local ok, problem = pcall(helper.printed, chunk)
  for name in pairs(stand_ins) do rawset(_G, name, real[name]) end -- likewise
  assert.is_true(ok, problem)
end

local function example_files()
  return share.of(helper.lines_of("ls examples/*.lua"))
end

describe("tests of an example", function()
  local known = {} -- file -> tests, so that each is tried once, in any order of specs

  -- Tests an example: `taken`, `text`, `result`, and what `kill` returns.
  local function try(file)
    if known[file] then return known[file] end
    local function load() return load_chart(file) end
    local own = {}
    helper.printed(function() own.text, own.result = tests.busted(file, load()) end)
    own.taken = rfsm_checks.explore(load()).taken
    own.count, own.killed, own.alive = kill(load, own.result)
    known[file] = own
    return own
  end

  for _, file in ipairs(example_files()) do
    it("pass, take every transition and kill mutants: " .. file, function()
      local own = try(file)
      assert.equal(own.taken, own.result.taken)
      run_spec(own.text, file)
      assert.is_true(passes(own.result, function()
        return mutate.reorder(load_chart(file))
      end))
      assert.is_true(own.killed >= 0.9 * own.count, table.concat(own.alive, ", "))
    end)
  end

  it("kill nine in ten mutants of all of them", function()
    local all, all_killed = 0, 0
    for _, file in ipairs(example_files()) do
      local own = try(file)
      all, all_killed = all + own.count, all_killed + own.killed
    end
    assert.is_true(all > 10 * #example_files())
    assert.is_true(all_killed >= 0.9 * all)
    if os.getenv("SHOW") then print(all_killed .. " of " .. all .. " killed") end
  end)
end)

local LAMP = [[
local rfsm = require "rfsm"
local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
local function yes() return true end
return state { info = false, warn = false,
  off = state {}, warm = state { doo = yes }, k = conn {},
  on = state { low = state {}, high = state {},
    trans { src = "initial", tgt = "low" },
    trans { src = "low", tgt = "high", events = { "e_more", 7 }, pn = 1 },
    trans { src = "low", tgt = "high", events = { "e_boost" }, guard = yes },
    trans { src = "high", tgt = "low", events = { "e_after(2.5)" } },
  },
  trans { src = "initial", tgt = "off" },
  trans { src = "off", tgt = "warm", events = { "e_on" } },
  trans { src = "warm", tgt = "k", events = { "e_done" } },
  trans { src = "k", tgt = "on", guard = yes, pn = 1 },
  trans { src = "k", tgt = "off" },
  trans { src = "on", tgt = "off", events = { "e_off" } },
  trans { src = "on", tgt = "internal", events = { "e_ping" }, pn = -1 },
}
]]

local LAMP_SPEC = [=[
-- Runs of lamp.lua that take 11 of its 11 transitions, in 33 steps.
--
-- Callbacks of the chart do not run.
-- `guards` has the answers of guards, `ends` and `goes_on` states whose doo does so;
-- `after` lets that many seconds go by. What is asked and not mentioned is part of the
-- result.

require "rfsm_timeevent"
local rehearsal = require("rfsm_checks").rehearsal

local here = debug.getinfo(1, "S").source:match("^@(.*/)") or ""
local FILE = here .. "../lamp.lua"
local OPTIONS = { callbacks = false }

-- rfsm check --tests: what stands from here ...
describe("lamp.lua", function()
  it("goes to off, warm, on.low, on.high, off, warm, off ... on.high", function()
    local run = rehearsal(FILE, OPTIONS)
    assert.equal("initial --> off", run:step())
    assert.equal("stays in off", run:step())
    assert.equal("stays in off", run:step { "e_unknown" })
    assert.equal("stays in off", run:step { "e_off" })
    assert.equal("off -e_on-> warm", run:step { "e_on" })
    assert.equal("stays in warm", run:step { goes_on = { "warm" } })
    assert.equal("stays in warm", run:step { "e_unknown" })
    assert.equal("stays in warm", run:step { "e_on" })
    assert.equal("stays in warm", run:step { ends = { "warm" } })
    assert.equal("warm -e_done-> k, k --> on, on.initial --> on.low",
      run:step { guards = { ["k --> on"] = true } })
    assert.equal("stays in on.low", run:step())
    assert.equal("stays in on.low", run:step { "e_unknown" })
    assert.equal("stays in on.low", run:step { "e_on" })
    assert.equal("on.low -7, e_more-> on.high", run:step { "e_more" })
    assert.equal("stays in on.high", run:step())
    assert.equal("stays in on.high", run:step { "e_unknown" })
    assert.equal("stays in on.high", run:step { "e_on" })
    assert.equal("on -e_off-> off", run:step { "e_off" })
    assert.equal("off -e_on-> warm", run:step { "e_on" })
    assert.equal("stays in warm", run:step { ends = { "warm" } })
    assert.equal("warm -e_done-> k, k --> off",
      run:step { guards = { ["k --> on"] = false } })
    assert.equal("off -e_on-> warm", run:step { "e_on" })
    assert.equal("stays in warm", run:step { ends = { "warm" } })
    assert.equal("warm -e_done-> k, k --> on, on.initial --> on.low",
      run:step { guards = { ["k --> on"] = true } })
    assert.equal("on.low -7, e_more-> on.high", run:step { 7 })
    assert.equal("on -e_ping-> internal", run:step { "e_ping" })
    assert.equal("on.high -e_after(2.5)-> on.low", run:step { after = 2.501 })
    assert.equal("on.low -e_boost-> on.high",
      run:step { "e_boost", guards = { ["on.low -e_boost-> on.high"] = true } })
    assert.equal("on -e_off-> off", run:step { "e_off", "e_ping" })
    assert.equal("off -e_on-> warm", run:step { "e_on" })
    assert.equal("stays in warm", run:step { ends = { "warm" } })
    assert.equal("warm -e_done-> k, k --> on, on.initial --> on.low",
      run:step { guards = { ["k --> on"] = true } })
    assert.equal("on.low -7, e_more-> on.high", run:step { "e_more", "e_boost" })
  end)
end)
-- rfsm check --tests: ... to here is written anew.
]=]

describe("the spec of a chart", function()
  it("has no event to stay in a leaf that any event leaves", function()
    local text = tests.busted("lamp.lua", state { warn = false, info = false,
      a = state { doo = function() end }, b = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "b" },
      trans { src = "b", tgt = "a", events = { "e_x" } } }, {}, "lamp_spec.lua")
    assert.matches('assert.equal%("stays in b", run:step { "e_unknown" }%)', text)
    assert.is_nil(text:find("stays in a", 1, true))
  end)

  it("shows which of two enabled transitions is taken, also if it names no event",
    function()
    local text = tests.busted("lamp.lua", state { warn = false, info = false,
      a = state {}, b = state {}, c = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", guard = function() end, pn = 1 },
      trans { src = "a", tgt = "c", events = { "e_x" } },
      trans { src = "b", tgt = "a", events = { "e_back" } } })
    for _, step in ipairs {
      '("a --> b", run:step { guards = { ["a --> b"] = true } })',
      '("a --> b", run:step { "e_x", guards = { ["a --> b"] = true } })',
      '("a -e_x-> c", run:step { "e_x", guards = { ["a --> b"] = false } })',
    } do
      assert.is_truthy(text:find(step, 1, true), step)
    end
  end)

  it("has steps of events, time, guards and doos, and such that change nothing",
    function()
    local text, result = tests.busted("lamp.lua", rfsm.load_str(LAMP), {},
      "spec/lamp_spec.lua")
    assert.equal(LAMP_SPEC, text)
    assert.same({ 11, 11, 0 }, { result.taken, result.transitions, result.skipped })
    assert.equal(select(2, text:gsub("run:step", "")), result.steps)
  end)
end)

describe("the name of a run", function()
  -- Returns the name of a run from the first to the last of these leaves.
  local function name_of(leaves, loop)
    local model = state { warn = false, info = false, loop,
      trans { src = "initial", tgt = leaves[1] } }
    for i, name in ipairs(leaves) do
      model[name] = state {}
      if i > 1 then
        model[#model + 1] = trans { src = leaves[i - 1], tgt = name,
          events = { "e_" .. i } }
      end
    end
    return tests.busted("chain.lua", model):match('it%("goes to (.-)", function')
  end

  local LONG = ("m"):rep(60)
  for _, case in ipairs {
    { leaves = { "a" }, name = "a" },
    { leaves = { "a", ("m"):rep(52), "z" } },
    { leaves = { "a", ("m"):rep(53), "z" }, name = "a ... z" },
    { leaves = { "a", "b", "c", ("m"):rep(40), ("n"):rep(9), "z" },
      name = "a, b, c, " .. ("m"):rep(40) .. " ... z" },
    { leaves = { "a", "b", LONG, "y", "z" }, name = "a, b ... z" },
    { leaves = { LONG, "z" } },
    { leaves = { LONG, "b", "z" }, name = LONG .. " ... z" },
  } do
    local expected = case.name or table.concat(case.leaves, ", ")
    it("is that of its leaves: " .. expected:gsub("m+", "m.."), function()
      assert.equal(expected, name_of(case.leaves))
    end)
  end

  it("has a leaf once that is not left", function()
    assert.equal("a, b", name_of({ "a", "b" },
      trans { src = "a", tgt = "internal", events = { "e_x" } }))
    assert.equal("a, b", name_of({ "a", "b" },
      trans { src = "a", tgt = "a", events = { "e_x" } }))
  end)
end)

describe("tests that run callbacks", function()
  it("hold the order of callbacks and what they print", function()
    local file = "examples/on_off.lua"
    local text = tests.busted(file, load_chart(file), { callbacks = true })
    assert.matches("in 7 steps%.\n%-%-\n%-%- Entries, exits and effects run, in the "
      .. "order that is behind the colon%.\n%-%- The field `fakes` of OPTIONS has what "
      .. "they find as globals%.\n%-%- `guards` has", text)
    assert.matches("local OPTIONS = { callbacks = true }\n", text)
    assert.matches('it%("goes to off, on, off", function', text)
    assert.matches('assert.equal%("off %-e_push%-> on: entry on, print%(bright%)", '
      .. 'run:step { "e_push" }%)', text)
    run_spec(text, file)
  end)

  it("notice callbacks that are swapped", function()
    local function load() return load_chart("examples/on_off.lua") end
    local result = tests.plan(load(), { callbacks = true })
    assert.is_true(passes(result, load, true))
    assert.is_false(passes(result, function()
      local model = load()
      model.on.entry, model.off.entry = model.off.entry, model.on.entry
      return model
    end, true))
  end)
end)

describe("tests that are written again", function()
  it("open the chart as the command did", function()
    local function options_of(options)
      local text = tests.busted("lamp.lua", load_chart("examples/on_off.lua"), options)
      return text:match("local OPTIONS = ([^\n]*)")
    end
    assert.equal("{ callbacks = false, stub = true }", options_of { stub = true })
    assert.equal("{ callbacks = false, machine = 2 }", options_of { machine = 2 })
    assert.equal("{ callbacks = true, stub = true, machine = 1 }",
      options_of { callbacks = true, stub = true, machine = 1 })
  end)

  it("keep what stands around the marks, and name the chart as the spec sees it",
    function()
    local file, load = "examples/on_off.lua", function()
      return load_chart("examples/on_off.lua")
    end
    local text = tests.busted(file, load(), {}, "spec/lamps/on_off_spec.lua")
    assert.matches('\nlocal FILE = here .. "../../examples/on_off.lua"\n', text)
    assert.matches('"../on_off.lua"', (tests.busted(file, load(), {},
      "examples/spec/on_off_spec.lua")))
    for output, said in pairs { -- any order: each stands alone
      ["../on_off_spec.lua"] = "examples/on_off.lua",
      ["/tmp/on_off_spec.lua"] = "examples/on_off.lua",
      ["-"] = "examples/on_off.lua",
    } do
      assert.matches('\nlocal FILE = "' .. said .. '"\n',
        (tests.busted(file, load(), {}, output)))
    end
    assert.matches('\nlocal FILE = "examples/on_off.lua"\n',
      (tests.busted(file, load())))
    assert.matches('\nlocal FILE = "/charts/on_off.lua"\n',
      (tests.busted("/charts/on_off.lua", load(), {}, "spec/on_off_spec.lua")))
    local changed = text:gsub("on %-e_switch%-> off", "nonsense")
    local own = "-- mine\n" .. changed .. "-- more\n"
    local again = tests.busted(file, load(), {}, "spec/lamps/on_off_spec.lua", own)
    assert.equal("-- mine\n" .. text .. "-- more\n", again)
    local ok, problem = pcall(tests.busted, file, load(), {}, "on_off_spec.lua",
      "nothing marked")
    assert.is_false(ok)
    assert.equal("the output has no marks of an earlier call: it is kept", problem)
  end)
end)

describe("a rehearsal", function()
  after_each(helper.remove_files)

  local function busy()
    return state { info = false, warn = false,
      a = state { doo = function() error("called") end }, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_done" } },
      trans { src = "b", tgt = "a", events = { "e_after(2)" },
        guard = function() error("called") end },
    }
  end

  it("steps a chart without its callbacks", function()
    local run = rfsm_checks.rehearsal(busy())
    assert.equal("initial --> a", run:step())
    assert.equal("stays in a", run:step { goes_on = { "a" } })
    assert.equal("stays in a, (a was asked)", run:step())
    assert.equal("stays in a", run:step { ends = { "a" } })
    assert.equal("a -e_done-> b", run:step())
    assert.equal("stays in b",
      run:step { after = 3, guards = { ["b -e_after(2)-> a"] = false } })
    assert.equal("stays in b, (b -e_after(2)-> a was not asked)",
      run:step { "e_x", guards = { ["b -e_after(2)-> a"] = false } })
  end)

  it("has one answer for a guard or doo of which a witness has several", function()
    local run, guard = rfsm_checks.rehearsal(busy()), "b -e_after(2)-> a"
    for _, case in ipairs {
      { true, true, answer = true }, { true, false, answer = false },
      { false, true, answer = false },
    } do
      local choices = {}
      for i, answer in ipairs(case) do
        choices[i] = { who = "root.trans[3]", answer = answer }
      end
      assert.same({ guards = { [guard] = case.answer }, ends = {}, goes_on = {} },
        run:answers_of { choices = choices })
    end
    assert.same({ guards = {}, ends = { "a" }, goes_on = {} }, run:answers_of {
      choices = { { who = "root.a", is_doo = true, answer = true } } })
  end)

  it("runs callbacks against fakes, and holds their order, if it shall", function()
    local model = rfsm.load_str [[
      local rfsm = require "rfsm"
      local state, trans = rfsm.state, rfsm.trans
      local function fail() error("called") end
      return state { info = false, warn = false, err = false,
        a = state { exit = function() print("off", 2, {}) end },
        b = state { doo = fail, entry = function(fsm)
          rfsm.send_events(fsm, "e_sent")
          error("broken")
        end },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = { "e_x" }, guard = fail,
          effect = function(_, _, what) return crane.left:start(what) end },
        trans { src = "b", tgt = "a", events = { "e_sent" } } }
    ]]
    local run = rfsm_checks.rehearsal(model, { callbacks = true })
    assert.equal("initial --> a", run:step())
    assert.equal("a -e_x-> b: exit a, print(off, 2, table), effect, "
      .. "crane.left.start(crane.left, effect), entry b, sends e_sent, fails: broken",
      run:step { "e_x", guards = { ["a -e_x-> b"] = true } })
    assert.equal("stays in b", run:step { goes_on = { "b" } })
    assert.equal(PRINT, rawget(_G, "print"))
    assert.is_nil(rawget(_G, "crane"))
    local seen = {}
    run = rfsm_checks.rehearsal(model, { callbacks = true, fakes = {
      print = function(text) seen[1] = text end,
      crane = { left = { start = function() seen[2] = "started" end } } } })
    run:step()
    assert.equal("a -e_x-> b: exit a, effect, entry b, sends e_sent, fails: broken",
      run:step { "e_x", guards = { ["a -e_x-> b"] = true } })
    assert.same({ "off", "started" }, seen)
  end)

  it("takes events of regions by their paths", function()
    local function region()
      return state { info = false, warn = false, x = state {}, y = state {},
        trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e_x" } } }
    end
    local run = rfsm_checks.rehearsal(state { info = false, warn = false,
      p = rfsm.seqand { left = region(), right = region() },
      trans { src = "initial", tgt = "p" } })
    assert.equal("initial --> p, p.left.initial --> p.left.x, p.right.initial --> "
      .. "p.right.x", run:step())
    assert.equal("p.right.x -e_x-> p.right.y",
      run:step { "e_none", inside = { ["root.p.right"] = { "e_x" } } })
  end)

  it("has fakes that count as 0, are texts, and end a loop", function()
    local run = rfsm_checks.rehearsal(rfsm.load_str [[
      local rfsm = require "rfsm"
      return rfsm.state { info = false, warn = false,
        a = rfsm.state { entry = function()
          for _ in crane.all() do crane.count() end
          crane.move(crane.height + 1, "to " .. crane.name)
        end },
        rfsm.trans { src = "initial", tgt = "a" } }
    ]], { callbacks = true })
    assert.equal("initial --> a: entry a, crane.all(), crane.move(0, to crane.name)",
      run:step())
  end)

  it("passes on an interrupt, and takes the fakes back", function()
    local run = rfsm_checks.rehearsal(state { info = false, warn = false,
      a = state { entry = function() error("interrupted!", 0) end },
      trans { src = "initial", tgt = "a" } },
      { callbacks = true, fakes = { lamp = 1 } })
    local ok, text = pcall(run.step, run)
    assert.same({ false, "interrupted!" }, { ok, text })
    assert.is_nil(rawget(_G, "lamp"))
  end)

  it("refuses options that are wrong", function()
    local _, text = pcall(function()
      return (rfsm_checks.rehearsal(busy(), { callback = true }))
    end)
    assert.matches("tests_spec.lua:%d+: rfsm_checks.rehearsal: unknown option "
      .. "'callback' %(did you mean 'callbacks'%?%), expected: callbacks, fakes, "
      .. "machine, stub$", text)
  end)

  it("refuses names of what is not there", function()
    local run = rfsm_checks.rehearsal(busy())
    local ok, text = pcall(function() return (run:step { ends = { "c" } }) end)
    assert.is_false(ok)
    assert.matches("tests_spec.lua:%d+: rfsm_checks.rehearsal: no transition or state "
      .. "is named 'c'", text)
  end)

  it("has names without positions", function()
    local run = rfsm_checks.rehearsal(state { info = false, warn = false,
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "root", tgt = "a", events = { "e_y", "e_x" } },
      trans { src = "root", tgt = "a", events = { "e_x", "e_y" }, pn = -1 },
      trans { src = "a", tgt = "internal", events = { "e_z" } } })
    run:step()
    assert.equal("root -e_x, e_y-> a", run:step { "e_x" })
    assert.equal("a -e_z-> internal", run:step { "e_z" })
    local names = {}
    for i, entry in ipairs(run.subject.transitions) do names[i] = entry.name end
    assert.equal("root -e_x, e_y-> a #2", names[3])
  end)

  it("lets time go by", function()
    local run = rfsm_checks.rehearsal(busy())
    run:step()
    run:step { ends = { "a" } }
    run:step()
    assert.equal("stays in b", run:step { after = 1 })
    assert.equal("b -e_after(2)-> a",
      run:step { after = 1.5, guards = { ["b -e_after(2)-> a"] = true } })
  end)

  it("opens the machine of a program that an option names", function()
    local file = helper.file_with [[
      local rfsm = require "rfsm"
      local function make(name)
        return rfsm.init(rfsm.state { info = false, warn = false,
          [name] = rfsm.state {}, rfsm.trans { src = "initial", tgt = name } })
      end
      make "a"
      make "b"
    ]]
    assert.equal("initial --> a", rfsm_checks.rehearsal(file, { machine = 1 }):step())
    assert.equal("initial --> b", rfsm_checks.rehearsal(file, { machine = 2 }):step())
  end)

  it("blames the caller for what is no chart", function()
    local _, text = pcall(function() return (rfsm_checks.rehearsal(7)) end)
    assert.matches("tests_spec.lua:%d+: rfsm_checks.rehearsal: file or state expected, "
      .. "got number", text)
  end)

  it("blames the caller for what is no witness", function()
    local _, text = pcall(function() return (rfsm_checks.path_of(nil)) end)
    assert.matches("tests_spec.lua:%d+: rfsm_checks.path_of: the witness of a finding "
      .. "expected, got nil", text)
    _, text = pcall(function() rfsm_checks.record_witness(state {}, 7, {}) end)
    assert.matches("tests_spec.lua:%d+: rfsm_checks.record_witness: the witness of a "
      .. "finding expected, got number", text)
  end)
end)
