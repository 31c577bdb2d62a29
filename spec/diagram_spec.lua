-- What the three diagrams have in common, and each of them.

local charts = require "spec.support.charts"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local rfsm = require "rfsm"
local runs = require "spec.support.runs"

local seed = tonumber(os.getenv("SEED")) or 1

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local LANGUAGES = { "rfsm.plantuml", "rfsm.dot", "rfsm.mermaid" }

local function yes() return true end

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

local ODD_NAMES = {
  "a b", "a_b", "a-b", "end", 'q"q', "q'q", "l1\nl2", "<b>", "<<choice>>", "[*]", "a:b",
  "}", "{", "#", "%d", "%% x", "&amp;", "1", " ", "--", "état", "日本", "\255\254", "\1",
  "tab\t", "note", "graph", "x_", "*b*", "//i//", "__", "~",
  "`c`", ";", "$x", "|", "/' '/",
}

-- One leaf for each odd name, and an arrow with that text as event from the first.
local function odd()
  local model = state { root = state {}, trans { src = "initial", tgt = "root" } }
  for _, name in ipairs(ODD_NAMES) do
    if name ~= "__" then model[name] = state {} end
    model[#model + 1] = trans { src = "root", tgt = "root", events = { name } }
  end
  return helper.init(model)
end

-- Random machines: a function that returns the next one, and how many arrows it has.
local function random_machines()
  local next_seed = seed - 1
  return function()
    next_seed = next_seed + 1
    local model = runs.model_of { chart = charts.generate(next_seed), trace = {},
      counts = {} }
    model.err, model.warn, model.info = false, false, false
    local fsm = rfsm.init(model)
    return fsm, #rfsm.mapfsm(function(tr) return tr end, fsm, rfsm.is_trans)
  end
end

local content, file_with = helper.content, helper.file_with

after_each(helper.remove_files)

-- What Graphviz says to a text on stderr, and the picture.
local function graphviz(text)
  local file, log = file_with(text), file_with("")
  local pipe = io.popen("dot -Tsvg '" .. file .. "' 2>'" .. log .. "'")
  local picture = pipe:read("*a")
  pipe:close()
  return content(log), picture
end

describe("gen_event_text", function()
  it("is the same on each Lua, and counts what has only an address", function()
    local text_of, t, f = marsh.gen_event_text(), {}, function() end
    local named = setmetatable({}, { __tostring = function() return "my event" end })
    local bad = setmetatable({}, { __tostring = function() error("no") end })
    local texts = {}
    for i, event in ipairs { 5, 2.0, 0.1, 1e100, "e_x", true, false, t, f, {}, print, t,
      io.stdout, coroutine.create(f), named, bad } do
      texts[i] = text_of(event)
    end
    assert.same({ "5", "2", "0.1", "1e+100", "e_x", "true", "false", "table 1",
      "function 1", "table 2", "function 2", "table 1", "userdata 1", "thread 1",
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
    } do
      assert.equal(expected or text, marsh.utf8(text))
    end
  end)
end)

describe("model2tab", function()
  it("tells of guards and effects when asked to", function()
    local transitions = marsh.model2tab(lamp(), true).transitions
    assert.same({ true, nil }, { transitions[2].guard, transitions[2].effect })
    assert.same({ nil, true }, { transitions[3].guard, transitions[3].effect })
    assert.is_nil(marsh.model2tab(lamp()).transitions[2].guard)
  end)
end)

for _, language in ipairs(LANGUAGES) do
  local exporter = require(language)

  describe(language, function()
    it("writes the same text each time, whatever the events", function()
      local function machine()
        return helper.init(state {
          a = state {}, trans { src = "initial", tgt = "a" },
          trans { src = "a", tgt = "a",
            events = { function() end, {}, 5, 5.0, false } },
        })
      end
      local text = exporter.encode(machine())
      assert.equal(text, exporter.encode(machine()))
      assert.is_truthy(text:find("function 1, table 1, 5, 5, false", 1, true))
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
      assert.equal("encode: title: string expected, got table",
        problem_of("encode", lamp(), {}))
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

    it("marks a transition that is internal", function()
      local text = exporter.encode(helper.init(state {
        a = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "internal", events = "e_tick" },
      }))
      assert.is_truthy(text:find("e_tick (internal)", 1, true))
      assert.is_truthy(text:find("root_a %-%-?> root_a"))
    end)

    it("draws a machine of one state", function()
      local text = exporter.encode(helper.init(state {}))
      assert.is_truthy(text:find('"root"', 1, true))
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
  state root_k <<choice>>
  state "off" as root_off
  state "on" as root_on {
    state "idle" as root_on_idle
    state "moving" as root_on_moving
    [*] --> root_on_idle
    root_on_idle --> root_on_moving : e_go, e_run
    root_on_moving --> root_on : e_halt
  }
  [*] --> root_off
  root_off --> root_k : e_switch
  root_k --> root_on
  root_on --> root_on : e_again
  root_on --> root_on_moving : e_in
  root_on --> root_off : e_switch
  root_on_moving --> root_off : e_panic
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
    for _, expected in ipairs {
      "title a\\n@enduml\n", '"q<U+0022>q"', '"l1\\nl2"', '"<U+003C>b>"',
      '"<U+0025>d"', '"<U+0026>amp;"', '"-<U+002D>"', '"/<U+0027> \'/"',
      " : _<U+005F>\n",
    } do
      assert.is_truthy(text:find(expected, 1, true),
        expected)
    end
    assert.is_falsy(text:find("\n@enduml\n.", 1, true))
  end)
end)

-- luacheck: push no max line length
describe("rfsm.dot", function()
  local encode = require("rfsm.dot").encode

  it("draws composites as clusters and their arrows at the border", function()
    assert.equal([=[
digraph "the lamp" {
  compound=true
  fontname="Helvetica"
  node [shape=box, style=rounded, fontname="Helvetica"]
  edge [fontname="Helvetica", fontsize=11]
  label="the lamp" labelloc=t
  subgraph cluster_root {
    label="root" style=rounded
    root_initial [shape=point, width=0.15]
    root_k [shape=diamond, style="", width=0.25, height=0.25, label="", fontsize=11, xlabel="k"]
    root_off [label="off"]
    subgraph cluster_root_on {
      label="on" style=rounded
      root_on_idle [label="idle"]
      root_on_initial [shape=point, width=0.15]
      root_on_moving [label="moving"]
    }
    root_on_loop [shape=point, width=0.02]
    root_on_loop_2 [shape=point, width=0.02]
  }
  root_initial -> root_off
  root_off -> root_k [label="e_switch [guard]"]
  root_k -> root_on_initial [label="/ effect", lhead=cluster_root_on]
  root_on_initial -> root_on_loop [label="e_again", ltail=cluster_root_on, arrowhead=none]
  root_on_loop -> root_on_initial [lhead=cluster_root_on]
  root_on_initial -> root_on_loop_2 [label="e_in [guard] / effect", ltail=cluster_root_on, arrowhead=none]
  root_on_loop_2 -> root_on_moving
  root_on_initial -> root_off [label="e_switch", ltail=cluster_root_on]
  root_on_initial -> root_on_idle
  root_on_idle -> root_on_moving [label="e_go, e_run"]
  root_on_moving -> root_off [label="e_panic"]
  root_on_moving -> root_on_initial [label="e_halt"]
}
]=], encode(lamp(), "the lamp"))
  end)

  it("is drawn by Graphviz without a word", function()
    local said, picture = graphviz(encode(lamp(), "the lamp"))
    assert.equal("", said)
    for _, text in ipairs { "the lamp", "e_go, e_run", "moving", "cluster_root_on" } do
      assert.is_truthy(picture:find(text, 1, true), text)
    end
  end)

  it("is drawn by Graphviz with any names, as they are", function()
    local said, picture = graphviz(encode(odd(), 'T "x" \\ & <i>\nnew'))
    assert.equal("", said)
    for _, text in ipairs { "q&quot;q", "&lt;b&gt;", "&amp;amp;", "%d", "état",
      "&lt;&lt;choice&gt;&gt;", "|", "T &quot;x&quot; \\ &amp; &lt;i&gt;" } do
      assert.is_truthy(picture:find(">" .. text .. "<", 1, true), text)
    end
  end)

  local function check(text)
    local said, picture = graphviz(text)
    assert.equal("", said)
    assert.equal("</svg>\n", picture:sub(-7))
  end

  -- One at a time: Graphviz 2.43 frees twice what some graphs leave to the next one.
  it(("is drawn by Graphviz for 10 random charts from seed %d"):format(seed), function()
    local next_machine = random_machines()
    for _ = 1, 10 do check(encode((next_machine()))) end
  end)

  it("is drawn by Graphviz for each example", function()
    for file in io.popen("ls examples/*.lua"):lines() do
      local text
      helper.printed(function() text = encode(helper.init(rfsm.load(file)), file) end)
      check(text)
    end
  end)
end)

-- luacheck: pop
describe("rfsm.mermaid", function()
  local encode = require("rfsm.mermaid").encode

  it("draws composites, choices and arrows", function()
    assert.equal([[
---
title: "the \"lamp\""
---
stateDiagram-v2
  state root_k <<choice>>
  state "off" as root_off
  state "on" as root_on {
    state "idle" as root_on_idle
    state root_on_initial <<choice>>
    [*] --> root_on_initial
    state "moving" as root_on_moving
    root_on_initial --> root_on_idle
    root_on_idle --> root_on_moving : e_go, e_run
    root_on_moving --> root_on_initial : e_halt
  }
  [*] --> root_off
  root_off --> root_k : e_switch [guard]
  root_k --> root_on : / effect
  root_on --> root_on : e_again
  root_on --> root_on_moving : e_in [guard] / effect
  root_on --> root_off : e_switch
  root_on_moving --> root_off : e_panic
]], encode(lamp(), 'the "lamp"'))
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

  it("wrote the picture in the README, of the chart in the README", function()
    local readme = assert(io.open("README.md"))
    local text = readme:read("*a")
    readme:close()
    local chart = text:match("```lua\n(.-)```")
    local load = rawget(_G, "loadstring") or load
    assert.equal(text:match("```mermaid\n(.-)```"), encode(helper.init(load(chart)())))
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
    for _, expected in ipairs {
      '"q#34;q"', '"l1<br>l2"', '"#60;b#62;"', '"a#58;b"', '"#37;#37; x"', '"#59;"',
      '"#38;amp#59;"', '"#45;#45;"', '"x#95;"', '"a_b"', '"#42;b#42;"', '"état"',
    } do
      assert.is_truthy(text:find(expected, 1, true),
        expected)
    end
  end)
end)
