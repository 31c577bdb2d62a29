-- What the three diagrams have in common, and each of them.

local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local pictures = require "spec.support.pictures"
local rfsm = require "rfsm"

local seed = tonumber(os.getenv("SEED")) or 1

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local LANGUAGES = { "rfsm.plantuml", "rfsm.dot", "rfsm.mermaid" }

local function yes() return true end
local function callback() return yes end

local function contains(text, parts)
  for _, part in ipairs(parts) do assert.is_truthy(text:find(part, 1, true), part) end
end

-- off, on{ idle, moving } with a connector, a guard and an effect
local function lamp()
  return helper.init(state {
    off = state {}, k = conn {},
    on = state {
      idle = state {}, moving = state {},
      trans { src = "initial", tgt = "idle" },
      trans { src = "idle", tgt = "moving", events = { "e_go", "e_run" } },
      trans { src = "moving", tgt = "root.off", events = { "e_panic" } },
      trans { src = "moving", tgt = "initial", events = { "e_halt" } },
    },
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "k", events = { "e_switch" }, guard = yes },
    trans { src = "k", tgt = "on", effect = yes },
    trans { src = "on", tgt = "on", events = { "e_again" } },
    trans { src = "on", tgt = "on.moving", events = { "e_in" }, guard = yes,
      effect = yes },
    trans { src = "on", tgt = "off", events = { "e_switch" } },
  })
end

-- Those between its states, in PlantUML and in Mermaid.
local ARROWS = [[
  [*] --> root_off
  root_off --> root_k : e_switch [yes]
  root_k --> root_on : / yes
  root_on --> root_on : e_again
  root_on --> root_on_moving : e_in [yes] / yes
  root_on --> root_off : e_switch
  root_on_moving --> root_off : e_panic
]]

local function odd() return helper.init(pictures.odd()) end

-- Random machines: a function that returns the next one, and how many arrows it has.
local function random_machines()
  local next_seed = seed - 1
  return function()
    next_seed = next_seed + 1
    local fsm = rfsm.init(bare.model_of(charts.generate(next_seed),
      { entry = callback, doo = callback, guard = callback, effect = callback }))
    local arrows = {}
    rfsm.mapfsm(function(tr)
      arrows[#arrows + 1] = rfsm.target_of(tr) ~= "internal" and {
        src = tr.src._fqn, tgt = tr.tgt._fqn } or nil
    end, fsm, rfsm.is_trans)
    return fsm, #pictures.drawn_arrows(arrows)
  end
end

local content, file_with = helper.content, helper.file_with

after_each(helper.remove_files)

describe("a picture from left to right", function()
  for language, line in pairs { -- any order: each stands alone
    ["rfsm.plantuml"] = "left to right direction", ["rfsm.mermaid"] = "direction LR",
    ["rfsm.dot"] = "rankdir=LR",
  } do
    it("is one in " .. language, function()
      local encode = require(language).encode
      contains(encode(lamp(), { direction = "LR" }), { line })
      assert.is_nil(encode(lamp()):find(line, 1, true))
    end)
  end
end)

describe("gen_event_text", function()
  it("is the same on each Lua, and counts what has only an address", function()
    local text_of, t, f = marsh.gen_event_text(), {}, function() end
    local named = setmetatable({}, { __tostring = function() return "my event" end })
    local bad = setmetatable({}, { __tostring = function() error("no") end })
    local texts = {}
    for i, event in ipairs { 5, 2.0, 0.1, 1e100, "e_x", true, false, t, f, {}, print, t,
      -1 / math.huge, io.stdout, coroutine.create(f), named, bad } do
      texts[i] = text_of(event)
    end
    assert.same({ "5", "2", "0.1", "1e+100", "e_x", "true", "false", "table 1",
      "function 1", "table 2", "function 2", "table 1", "0", "userdata 1", "thread 1",
      "my event", "table 3" }, texts)
  end)
end)

describe("utf8", function()
  it("leaves UTF-8 as it is, and replaces each byte that is none", function()
    local mark = "\239\191\189"
    for text, expected in pairs { -- any order: each stands alone
      ["a \195\169 \230\151\165 \240\159\164\150 \0"] = false,
      ["a\255\192b"] = "a" .. mark .. mark .. "b",
      ["\237\160\128"] = mark .. mark .. mark, -- a surrogate
      ["\224\160"] = mark .. mark, -- cut off
      ["\195\169\169"] = "\195\169" .. mark,
      ["\240\143\191\191"] = mark:rep(4), -- longer than it need be
      ["\240\144\128\128"] = false,
      ["\244\144\128\128"] = mark:rep(4), -- beyond U+10FFFF
      ["\244\143\191\191"] = false,
      ["\224\159\191"] = mark:rep(3),
      ["\237\159\191"] = false,
    } do
      assert.equal(expected or text, marsh.utf8(text))
    end
  end)
end)

-- Returns the lines of a label as a language has them.
local function lines_by(before, between, after)
  return function(...)
    return before .. table.concat({ ... }, between) .. after
  end
end

local LABEL = {
  ["rfsm.plantuml"] = lines_by(" : ", "\\n", "\n"),
  ["rfsm.mermaid"] = lines_by(" : ", "<br>", "\n"),
  ["rfsm.dot"] = lines_by("", '<BR ALIGN="LEFT"/>', "<"),
}

for _, language in ipairs(LANGUAGES) do
  local exporter = require(language)

  describe(language, function()
    it("has no control character from a title or foot", function()
      local options = { title = "a\1b", foot = "c\127d" }
      assert.is_nil(exporter.encode(lamp(), options):find("[%z\1-\9\11-\31\127]"))
    end)

    it("writes the same text each time, whatever the events", function()
      local function machine()
        return helper.init(state {
          a = state {}, trans { src = "initial", tgt = "a" },
          trans { src = "a", tgt = "a",
            events = { {}, 5, 5.0, false } },
        })
      end
      local text = exporter.encode(machine())
      assert.equal(text, exporter.encode(machine()))
      contains(text, { "table 1, 5, 5, false" })
    end)

    it("gives each node an identifier of its own", function()
      local seen = {}
      for id in exporter.encode(odd()):gmatch("[^\n]* as ([%w_]+)") do
        assert.is_nil(seen[id])
        seen[id] = true
      end
    end)

    it("blames its caller for what is wrong", function()
      local function problem_of(function_name, ...)
        local arguments = { ... }
        local ok, problem = pcall(function()
          return (exporter[function_name](arguments[1], arguments[2]))
        end)
        assert.is_false(ok)
        return (problem:gsub("^%S*_spec.lua:%d+: " .. language .. ".", ""))
      end
      local expected = ": initialised fsm expected, got state (rfsm.init makes one "
        .. "of a state)"
      assert.equal("encode" .. expected, problem_of("encode", state {}))
      assert.equal("save" .. expected, problem_of("save", state {}, "x"))
      for problem, options in pairs { -- any order: each stands alone
        ["title: string expected, got boolean"] = true,
        ["depth: number expected, got string 'two'"] = { depth = "two" },
        ["active: string expected, got 7"] = { active = 7 },
        ["coverage: table expected, got string 'x'"] = { coverage = "x" },
        ["trace: table expected, got string 'x'"] = { trace = "x" },
        ["direction: 'TB' or 'LR' expected, got string 'UP'"] = { direction = "UP" },
        ["within: no state is named 'root.om'"] = { within = "root.om" },
        ["active: no state is named 'root.onn' (did you mean 'root.on'?)"] = {
          active = "root.onn" },
      } do
        assert.equal("encode: " .. problem, problem_of("encode", lamp(), options))
      end
      assert.equal("save: file name expected, got nil", problem_of("save", lamp()))
      assert.equal("save: /nowhere/x: No such file or directory",
        problem_of("save", lamp(), "/nowhere/x"))
      assert.equal("save: /dev/full: No space left on device",
        problem_of("save", lamp(), "/dev/full"))
    end)

    it("saves to a file", function()
      local file = file_with("")
      exporter.save(lamp(), file, "T")
      assert.equal(exporter.encode(lamp(), "T"), content(file))
    end)

    it("has a line for each of three or more arrows with equal ends", function()
      local model = state { a = state {}, b = state {}, c = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = "e_1", guard = yes, pn = 2 },
        trans { src = "a", tgt = "c", events = "e_c" },
        trans { src = "a", tgt = "b", events = "e_2" }, trans { src = "a", tgt = "b" },
        trans { src = "c", tgt = "b", events = "e_x" },
        trans { src = "c", tgt = "b", events = "e_y" } }
      local label = LABEL[language]
      contains(exporter.encode(helper.init(model)),
        { label("e_1 [yes] (pn 2)", "e_2", "-"), label("e_x"), label("e_y") })
    end)

    it("ties arrows that end at one folded composite, and two loops", function()
      local model = state { a = state {}, trans { src = "initial", tgt = "a" },
        m = state { x = state {}, y = state {}, trans { src = "initial", tgt = "x" } },
        trans { src = "a", tgt = "m.x", events = "e_1" },
        trans { src = "a", tgt = "m.y", events = "e_2" },
        trans { src = "a", tgt = "m", events = "e_3" } }
      for i = 1, 2 do
        model[#model + 1] = trans { src = "a", tgt = "a", events = "e_loop" .. i }
      end
      local label = LABEL[language]
      local text = exporter.encode(helper.init(model), { folded = { "root.m" } })
      contains(text, { label("e_1", "e_2", "e_3"), label("e_loop1", "e_loop2") })
    end)

    it("marks a bundle as missed only if all of its arrows are", function()
      if language ~= "rfsm.dot" then return end
      local model = state { a = state {}, b = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", events = "e_1" },
        trans { src = "a", tgt = "b", events = "e_2" },
        trans { src = "a", tgt = "b", events = "e_3" } }
      local function class_of(counts)
        local text = exporter.encode(helper.init(model),
          { coverage = { states = {}, transitions = counts } })
        return text:match('trans%[4%]/tgt", class="transition (%l+)"'), text
      end
      local class, text = class_of { ["root.trans[3]"] = 7 }
      assert.equal("covered", class)
      contains(text, { "e_1 (never)", "e_2 (7\195\151)" })
      assert.equal("missed", (class_of {}))
    end)

    it("draws a composite alone, and the states outside that arrows lead to", function()
      local model = state { off = state {}, k = conn {},
        m = state { x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
          trans { src = "x", tgt = "y", events = "e_in" },
          trans { src = "y", tgt = "root.off", events = "e_out" } },
        n = state { z = state {}, trans { src = "initial", tgt = "z" } },
        trans { src = "initial", tgt = "off" }, trans { src = "off", tgt = "m" },
        trans { src = "off", tgt = ".m.y", events = "e_into" },
        trans { src = ".m.y", tgt = "n", events = "e_n" },
        trans { src = "m", tgt = "off", events = "e_all" } }
      local text = exporter.encode(helper.init(model), { within = "root.m",
        active = { "root.m.x", "root.off" } })
      contains(text, { "e_in", "e_out", "e_into", "e_n", "root_m_x", "root_off",
        "root_n" })
      for _, part in ipairs { "root_k", "root_n_z", "e_all", "root_initial" } do
        assert.is_nil(text:find(part, 1, true), part)
      end
    end)

    it("lists internal transitions and callbacks in their state", function()
      local text = exporter.encode(helper.init(state {
        a = state { entry = yes }, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "internal", events = "e_tick", effect = yes },
      }))
      assert.matches("entry / yes.*e_tick / yes", text)
      assert.is_falsy(text:find("root_a %-%-?> root_a"))
    end)

    it("tells a transition that needs no event from one that any event triggers",
    function()
      local text = exporter.encode(helper.init(state {
        a = state {}, b = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "b", always = true, guard = yes },
        trans { src = "b", tgt = "a", guard = yes },
      }))
      local _, guards = text:gsub("yes", "")
      local _, words = text:gsub("always", "")
      assert.same({ 2, 1 }, { guards, words })
    end)

    it("draws a description as it draws its machine", function()
      local text = exporter.encode(lamp(), "T")
      assert.equal(text, exporter.encode(marsh.model2tab(lamp(), true), "T"))
    end)

    it("refuses a description that is none, in one line", function()
      for _, tab in ipairs {
        { id = "root", type = "state", subnodes = 7 },
        { id = "root", type = "state", subnodes = { { type = "state" } } },
        { id = "root", type = "state", entry = {} },
        { id = "root", type = "state", subnodes = {}, transitions = { { src = "a" } } },
        { id = "root", type = "state", subnodes = {}, transitions = {
          { src = "root", tgt = "nowhere", events = {} } } },
        { id = "root", type = "state", subnodes = {}, transitions = {
          { src = "root", tgt = "root", events = { "a" }, guard = {} } } },
      } do
        local ok, problem = pcall(function() return (exporter.encode(tab)) end)
        assert.is_false(ok)
        assert.equal(language .. ".encode: description by rfsm.marsh expected, got "
          .. "another table", (problem:gsub("^%S*_spec.lua:%d+: ", "")))
      end
    end)

    it("believes nothing of a description but texts", function()
      local text = exporter.encode { id = "root", type = "state", mode = '", URL="x',
        subnodes = { { id = "a", type = "state", subnodes = {} } },
        transitions = { { src = "root.a", tgt = "root.a", events = {} } } }
      assert.is_falsy(text:find("URL", 1, true))
    end)

    it("marks the states that are active, or that it is given", function()
      local fsm = lamp()
      local idle = exporter.encode(fsm)
      rfsm.run(fsm)
      local live = exporter.encode(fsm):gsub("state done", "state active")
      assert.not_equal(idle, live)
      assert.equal(live, exporter.encode(lamp(), { active = "root.off" }))
      assert.equal(idle, exporter.encode(fsm, { active = {} }))
    end)

    it("leaves out what is deeper than the depth", function()
      local text = exporter.encode(lamp(), { depth = 1 })
      assert.is_falsy(text:find("moving", 1, true))
      for _, event in ipairs { "e_go", "e_halt" } do
        assert.is_falsy(text:find(event, 1, true), event)
      end
      contains(text, { '"on', "e_panic", "e_again", "e_in" })
    end)

    it("says how often a run came to a place, and in which steps", function()
      local text = exporter.encode(lamp(), {
        coverage = { states = { ["root.off"] = 2 },
          transitions = { ["root.trans[2]"] = 3 } },
        trace = { { record = 1 }, "root.off", { taken = { "root.trans[2]" } },
          { m = 1, leaf = "root.on.idle" }, { leaf = "root.off" },
          { leaf = "root.off" } },
      })
      local plain = text:gsub("#(%d+);", function(n) return string.char(n) end)
      contains(plain, { "(2×)", "(step 1, 3)", "(never)", "(3×)", "(step 2)" })
    end)

    it("draws a machine of one state", function()
      contains(exporter.encode(helper.init(state {})), { '"root"' })
    end)

    it("draws 150 levels", function()
      local model = state {}
      for _ = 1, 150 do
        model = state { a = model, trans { src = "initial", tgt = "a" } }
      end
      local _, arrows = exporter.encode(helper.init(model)):gsub("%->", "")
      assert.equal(150, arrows)
    end)
  end)
end

describe("rfsm.plantuml", function()
  it("draws an arrow in the innermost composite that has both its ends", function()
    assert.equal([[
@startuml
title the lamp
state "root" as root {
  state "off" as root_off
  state root_k <<choice>>
  state "on" as root_on {
    state "idle" as root_on_idle
    state "moving" as root_on_moving
    [*] --> root_on_idle
    root_on_idle --> root_on_moving : e_go, e_run
    root_on_moving --> root_on : e_halt
  }
]] .. ARROWS .. [[
}
@enduml
]], require("rfsm.plantuml").encode(lamp(), "the lamp"))
  end)

  it("begins at the initial of a composite what a parent layers on it", function()
    local fsm = helper.init(state {
      m = state { x = state {}, initial = conn {} },
      trans { src = "initial", tgt = "m" }, trans { src = "m.initial", tgt = "m.x" },
    })
    assert.matches('    state "x" as root_m_x\n    %[%*%] %-%-> root_m_x\n  }',
      require("rfsm.plantuml").encode(fsm))
  end)

  it("writes what would be a command as a code", function()
    local text = require("rfsm.plantuml").encode(odd(), "a\n@enduml")
    contains(text, {
      "title a\\n@enduml\n", '"q<U+0022>q"', '"l1\\nl2"', '"<U+003C>b>"',
      '"<U+0025>d"', '"<U+0026>amp;"', '"-<U+002D>"', '"/<U+0027> \'/"',
      " : _<U+005F>\n", " : <U+0020>\n",
    })
    assert.is_falsy(text:find("\n@enduml\n.", 1, true))
  end)
end)

-- luacheck: push no max line length
describe("rfsm.dot", function()
  it("draws labels as nodes, and arrows that lead back backwards", function()
    assert.equal([=[
digraph "lamp" {
  graph [compound=true, fontname="Helvetica,Arial,sans-serif", fontsize=12, nodesep=0.3, ranksep=0.25]
  graph [rankdir=LR, style=rounded, color="#555555"]
  node [fontname="Helvetica,Arial,sans-serif", fontsize=12, color="#555555", fillcolor=white]
  node [shape=box, style="rounded,filled", height=0.4, margin="0.15,0.07"]
  edge [fontname="Helvetica,Arial,sans-serif", fontsize=10, color="#555555", arrowsize=0.7]
  subgraph cluster_root {
    graph [id="root", label="lamp", margin=4, style="rounded,filled", fillcolor="#F4F6F8", color="#555555", penwidth=1, class="state", color=none]
    root_initial [id="root.initial", shape=circle, label="", width=0.15, height=0.15, color="#222222", fillcolor="#222222", class="initial"]
    root_off [id="root.off", label="off", class="state"]
    subgraph cluster_root_on {
      graph [id="root.on", label="on", margin=10, style="rounded,filled", fillcolor="white", color="#555555", penwidth=1, class="state"]
      root_on_initial [id="root.on.initial", shape=circle, label="", width=0.15, height=0.15, color="#222222", fillcolor="#222222", class="initial"]
      root_on_bright [id="root.on.bright", label="bright", class="state"]
    }
    root_off_to_root_on [id="root.trans[2]", shape=plain, style="", fontsize=10, label=<<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0" CELLPADDING="0"><TR><TD CELLPADDING="4" BORDER="1" SIDES="B">e_on</TD></TR><TR><TD PORT="l" WIDTH="1" HEIGHT="1"></TD></TR></TABLE>>, class="transition"]
    root_on_to_root_off [id="root.trans[3]", shape=plain, style="", fontsize=10, label=<<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0" CELLPADDING="0"><TR><TD CELLPADDING="4" BORDER="1" SIDES="B">e_off</TD></TR><TR><TD PORT="l" WIDTH="1" HEIGHT="1"></TD></TR></TABLE>>, class="transition"]
    root_on_to_root_on [id="root.again", shape=plain, style="", fontsize=10, label=<<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="0" CELLPADDING="0"><TR><TD PORT="l" WIDTH="1" HEIGHT="1"></TD></TR><TR><TD CELLPADDING="4" BORDER="1" SIDES="TRB"> </TD></TR><TR><TD PORT="r" WIDTH="1" HEIGHT="1"></TD></TR></TABLE>>, class="transition"]
  }
  root_initial -> root_off [id="root.trans[1]", class="transition"]
  root_off -> root_off_to_root_on:l:w [id="root.trans[2]/src", class="transition", dir=none]
  root_off_to_root_on:l:e -> root_on_initial [id="root.trans[2]/tgt", class="transition", lhead=cluster_root_on]
  root_on_to_root_off:l:e -> root_on_initial [id="root.trans[3]/src", class="transition", lhead=cluster_root_on, dir=none]
  root_off -> root_on_to_root_off:l:w [id="root.trans[3]/tgt", class="transition", dir=back]
  root_on_bright -> root_on_to_root_on:l:w [id="root.again/src", class="transition", ltail=cluster_root_on, dir=none]
  root_on_bright -> root_on_to_root_on:r:w [id="root.again/tgt", class="transition", ltail=cluster_root_on, dir=back]
  root_on_initial -> root_on_bright [id="root.on.trans[1]", class="transition"]
}
]=], require("rfsm.dot").encode(helper.init(state {
      off = state {},
      on = state { bright = state {}, trans { src = "initial", tgt = "bright" } },
      trans { src = "initial", tgt = "off" },
      trans { src = "off", tgt = "on", events = { "e_on" } },
      trans { src = "on", tgt = "off", events = { "e_off" } },
      again = trans { src = "on", tgt = "on" },
    }), { title = "lamp", direction = "LR" }))
  end)
end)

-- luacheck: pop
describe("a picture by Graphviz", function()
  local dot = require "rfsm.dot"

  it("has a class, and a colour, for what is marked", function()
    local fsm = lamp()
    local options = {
      coverage = { states = { ["root.off"] = 1 },
        transitions = { ["root.trans[2]"] = 3 } },
      trace = { "root.trans[2]" }, active = "root.on.idle",
    }
    local laid_out = assert(dot.layout(fsm, options))
    for _, text in ipairs { dot.encode(fsm, options), laid_out } do
      assert.matches('"root.off"[^\n]*class="state covered"[^\n]', text)
      assert.matches('"root.on.moving"[^\n]*"state missed", color="#D55E00"', text)
      assert.matches('"root.on.idle"[^\n]*"state active missed", color="#0072B2"',
        text)
      assert.matches('"root.on.idle"[^\n]*fillcolor="#D6EAF8"', text)
      assert.matches('"root.trans%[2%]/?%l*"[^\n]*class="transition traced", '
        .. 'color="#D55E00", penwidth=2', text)
      assert.matches('"root.trans%[6%]/?%l*"[^\n]*class="transition missed"', text)
    end
  end)

  it("has room for frames, and for the labels of loops in them", function()
    local text = dot.encode(helper.init(state {
      a = state {}, m = state { x = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "x", events = "e" } }, b = state {}, c = state {},
      trans { src = "initial", tgt = "a" }, trans { src = "a", tgt = "m" },
      trans { src = "m", tgt = "b" }, trans { src = "b", tgt = "c" },
      trans { src = "m", tgt = "c", events = "e" },
    }))
    local lengths = {}
    for i, half in ipairs { "", "", "", "", "/src" } do
      local line = text:match('%[id="root.trans%[' .. i .. "%]" .. half .. '"[^\n]*')
      lengths[i] = line:match("minlen=(%d+)") or "1"
    end
    assert.same({ "1", "2", "3", "1", "2" }, lengths)
  end)

  it("takes little time in a chart of more than 500 nodes", function()
    local model = state { trans { src = "initial", tgt = "s1" } }
    for i = 1, 498 do model["s" .. i] = state {} end
    assert.is_nil(dot.encode(helper.init(model)):find("nslimit", 1, true) or nil)
    model.s499 = state {}
    assert.matches("\n  graph %[nslimit=1%]\n", dot.encode(helper.init(model)))
  end)

  it("leaves no file behind", function()
    local names, tmpname = {}, os.tmpname
    rawset(os, "tmpname", function()
      names[#names + 1] = tmpname()
      return names[#names]
    end)
    local picture = dot.render("digraph { a }", "svg")
    local nothing, problem = dot.render("digraph {", "svg")
    rawset(os, "tmpname", tmpname)
    assert.is_truthy(picture)
    assert.is_nil(nothing)
    assert.matches("^dot: Error: ", problem)
    assert.equal(6, #names)
    for _, name in ipairs(names) do assert.is_nil((io.open(name))) end
  end)

  it("has frames of two colours, in turn", function()
    local text = dot.encode(helper.init(state {
      a = state { b = state { c = state {}, trans { src = "initial", tgt = "c" } },
        trans { src = "initial", tgt = "b" } },
      trans { src = "initial", tgt = "a" },
    }))
    local colours = {}
    for colour in text:gmatch('margin=%d+[^\n]-fillcolor="([^"]*)"') do
      colours[#colours + 1] = colour
    end
    assert.same({ "#F4F6F8", "white", "#F4F6F8" }, colours)
  end)

  it("marks what is final, cut off or a region", function()
    local text = dot.encode(helper.init(state {
      a = state { b = state {}, trans { src = "initial", tgt = "b" } },
      c = state { final = true }, d = rfsm.seqand { left = state { info = false } },
      trans { src = "initial", tgt = "a" },
    }), { depth = 1 })
    assert.matches('"root.a", label="a …"', text)
    assert.matches('"root.c"[^\n]*peripheries=2', text)
    assert.is_falsy(text:find("left", 1, true))
    assert.matches('"root.d.left"[^\n]*class="state region"[^\n]*style="filled,dashed"',
      dot.encode(helper.init(state { d = rfsm.seqand { left = state { info = false } },
        trans { src = "initial", tgt = "d" } })))
  end)
end)

describe("rfsm.mermaid", function()
  local encode = require("rfsm.mermaid").encode

  it("draws composites, choices and arrows", function()
    assert.equal([[
---
title: "the \"lamp\""
---
stateDiagram-v2
  state "off" as root_off
  state root_k <<choice>>
  state "on" as root_on {
    state root_on_initial <<choice>>
    [*] --> root_on_initial
    state "idle" as root_on_idle
    state "moving" as root_on_moving
    root_on_initial --> root_on_idle
    root_on_idle --> root_on_moving : e_go, e_run
    root_on_moving --> root_on_initial : e_halt
  }
]] .. ARROWS, encode(lamp(), 'the "lamp"'))
  end)

  it("has a note for the rows of a composite, however few", function()
    local text = encode(helper.init(state {
      m = state { entry = yes, a = state {}, trans { src = "initial", tgt = "a" } },
      n = state { entry = yes, exit = yes, a = state {},
        trans { src = "initial", tgt = "a" } },
      o = state { a = state {}, trans { src = "initial", tgt = "a" } },
      trans { src = "initial", tgt = "m" },
    }))
    contains(text, { "\n  note right of root_m : entry / yes\n",
      "\n  note right of root_n : entry / yes<br>exit / yes\n" })
    assert.is_nil(text:find("note right of root_o", 1, true))
  end)

  it("draws the root as a box where an arrow begins at it", function()
    assert.equal([[
stateDiagram-v2
  state "root" as root_
  state "a" as root_a
  [*] --> root_a
  root_ --> root_a : e_reset
]], encode(helper.init(state {
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "root", tgt = "a", events = { "e_reset" } },
    })))
  end)

  -- What may stand in a line, and what it declares or uses.
  local SAFE = '[%w \128-\255%.,_/@%[%]%(%)#;<br>%-]*'
  local function check_line(line, declared, used)
    local id = line:match('^ *state "' .. SAFE .. '" as ([%w_]+) ?{?$')
      or line:match("^ *state ([%w_]+) <<choice>>$")
    if id then
      assert.is_nil(declared[id], id)
      declared[id] = true
      return line:sub(-1) == "{" and 1 or 0
    end
    if line:match("^ *}$") then return -1 end
    if line:match("^ *note right of [%w_]+ : " .. SAFE .. "$") then return 0 end
    if line:match("^ *[%w_]+ : " .. SAFE .. "$") then return 0 end
    local src, tgt = line:match("^ *(%S+) %-%-> ([%w_]+)$")
    if not src then
      src, tgt = line:match("^ *(%S+) %-%-> ([%w_]+) : " .. SAFE .. "$")
    end
    assert.is_truthy(src, line)
    if src ~= "[*]" then used[src] = true end
    used[tgt] = true
    return 0
  end

  local function check(text)
    local declared, used, depth = {}, {}, 0
    local body = text:gsub("^%-%-%-\n.-\n%-%-%-\n", "")
    assert.equal("stateDiagram-v2\n", body:sub(1, 16))
    for line in body:sub(17):gmatch("[^\n]+") do
      depth = depth + check_line(line, declared, used)
      assert.is_true(depth >= 0)
    end
    assert.equal(0, depth)
    for id in pairs(used) do assert.is_true(declared[id], id) end -- any order
  end

  it("keeps to the grammar with any names, and declares what it uses", function()
    check(encode(odd(), "T\n---\n"))
    check(encode(lamp(), "lamp"))
  end)

  it(("keeps to it with 100 random charts from seed %d"):format(seed), function()
    local next_machine = random_machines()
    for _ = 1, 100 do
      local fsm, count = next_machine()
      local text = encode(fsm)
      check(text)
      local arrows = text:gsub("%[%*%] %-%-> [%w_]*initial\n", "")
      assert.equal(count, select(2, arrows:gsub(" %-%-> ", "")))
      local plantuml = require("rfsm.plantuml").encode(fsm)
      assert.equal(count, select(2, plantuml:gsub(" %-%-> ", "")))
    end
  end)

  it("writes what means something to Mermaid, Markdown or HTML by number", function()
    local text = encode(odd())
    contains(text, {
      '"q#34;q"', '"l1<br>l2"', '"#60;b#62;"', '"a#58;b"', '"#37;#37; x"', '"#59;"',
      '"#38;amp#59;"', '"#45;#45;"', '"x#95;"', '"a_b"', '"#42;b#42;"', '"état"',
    })
  end)
end)

describe("a state in a picture by Graphviz", function()
  local function label_of(fields)
    fields.id, fields.type = "a", "state"
    local text = require("rfsm.dot").encode { id = "root", type = "state", subnodes = {
      fields }, transitions = {} }
    local label = text:match('id="root.a", label=(.-), class=')
    return (label:gsub("<[^<]->", " "):gsub(" +", " "))
  end

  it("has a mark for each callback that has no row", function()
    for expected, fields in pairs { -- any order: each stands alone
      ['"a"'] = {}, ['"a •"'] = { entry = ".." }, ['"a •••"'] = { entry = "..",
        doo = "..", exit = ".." },
      ["< a entry / f >"] = { entry = "f" }, ["< a • entry / f >"] = { entry = "f",
        exit = ".." }, ["< a •• (H) doo / g >"] = { entry = "..", doo = "g",
        exit = "..", history = "shallow" },
      ["< a what it is for >"] = { doc = "what it is for", entry = "..", exit = "f" },
    } do
      assert.equal(expected, label_of(fields))
    end
  end)

  it("has them if it is a composite, and if a run is shown", function()
    local function model()
      return state { entry = print, m = state { exit = print, entry = yes, x = state {},
        trans { src = "initial", tgt = "x" } }, trans { src = "initial", tgt = "m" } }
    end
    local text = require("rfsm.dot").encode(helper.init(model()),
      { coverage = { states = {}, transitions = {} } })
    contains(text, { ">m •<", ">root •<", ">x<" })
  end)
end)

describe("the root in a picture by Graphviz", function()
  -- m{ x }
  local function frames_of(options)
    local text = require("rfsm.dot").encode(helper.init(state {
      m = state { x = state {}, trans { src = "initial", tgt = "x" } },
      trans { src = "initial", tgt = "m" } }), options)
    local frames = {}
    local FRAME = 'margin=(%d+), [^\n]-fillcolor="(.-)"([^\n]*)'
    for margin, fill, rest in text:gmatch(FRAME) do
      local line = "" -- the last value of an attribute counts
      for color in rest:gmatch(' color=([^],]+)') do line = color end
      frames[#frames + 1] = ("%s %s %s"):format(margin, fill, line)
    end
    return frames
  end

  it("has a tint and its title, and no line, also while it is active", function()
    assert.same({ "4 #F4F6F8 none", '10 white "#555555"' }, frames_of "title")
    assert.same({ "4 #F4F6F8 none", '10 white "#0072B2"' },
      frames_of { active = "root.m" })
  end)
end)
