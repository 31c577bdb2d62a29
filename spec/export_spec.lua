local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local rfsm = require "rfsm"
local json = require "rfsm.json"
local plantuml = require "rfsm.plantuml"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

after_each(helper.remove_files)

-- initial -> m{ initial -> x -> k } ; m.k -> b, x -e1,e2-> "a b"
local function machine()
  return helper.init(state {
    m = state {
      x = state {}, k = conn {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "k", events = { "e1", "e2" }, pn = 2 },
    },
    ["a b"] = state {}, a_b = state {},
    trans { src = "initial", tgt = "m" },
    trans { src = "m.k", tgt = "a b" },
    trans { src = "a b", tgt = "m", events = { "e_again" } },
  })
end

describe("model2tab", function()
  it("gives the structure as plain tables, in the order of a walk", function()
    local function tr(src, tgt, events, pn)
      return { type = "transition", src = src, tgt = tgt, events = events, pn = pn }
    end
    assert.same({
      id = "root", type = "state",
      transitions = {
        tr("root.initial", "root.m.initial", {}), tr("root.m.k", "root.a b", {}),
        tr("root.a b", "root.m.initial", { "e_again" }),
      },
      subnodes = {
        { id = "initial", type = "connector" },
        {
          id = "m", type = "state",
          transitions = {
            tr("root.m.initial", "root.m.x", {}),
            tr("root.m.x", "root.m.k", { "e1", "e2" }, 2),
          },
          subnodes = {
            { id = "initial", type = "connector" }, { id = "x", type = "state" },
            { id = "k", type = "connector" },
          },
        },
        { id = "a b", type = "state" }, { id = "a_b", type = "state" },
      },
    }, marsh.model2tab(machine()))
  end)
end)

-- The ids of the nodes in a composite, in order.
local function order_of(model)
  local ids = {}
  for i, node in ipairs(marsh.model2tab(helper.init(model)).subnodes) do
    ids[i] = node.id
  end
  return table.concat(ids, " ")
end

describe("the order of nodes", function()
  it("is that of a walk from initial, nearest first", function()
    assert.equal("initial z y x w", order_of(state {
      w = state {}, x = state {}, y = state {}, z = state {},
      trans { src = "initial", tgt = "z" },
      trans { src = "x", tgt = "w" }, trans { src = "y", tgt = "z" },
      trans { src = "z", tgt = "y" }, trans { src = "z", tgt = "x" },
    }))
  end)

  it("puts behind it what is entered from outside, then the others by name", function()
    local fsm = helper.init(state {
      m = state {
        a = state {}, b = state {}, c = state {}, d = state {}, e = conn {},
        trans { src = "initial", tgt = "d" }, trans { src = "e", tgt = "c" },
      },
      out = state {}, trans { src = "initial", tgt = "m" },
      trans { src = "m", tgt = "out" }, trans { src = "out", tgt = ".m.e" },
    })
    local ids = {}
    for i, node in ipairs(marsh.model2tab(fsm).subnodes[2].subnodes) do
      ids[i] = node.id
    end
    assert.same({ "initial", "d", "e", "c", "a", "b" }, ids)
  end)

  it("is the same when LuaJIT has compiled the walk", function()
    local model, expected = state { trans { src = "initial", tgt = "s1" } }, {
      "initial" }
    for i = 1, 100 do
      model["s" .. i], expected[i + 1] = state {}, "s" .. i
      model[#model + 1] = i > 1 and trans { src = "s" .. i - 1, tgt = "s" .. i } or nil
    end
    expected = table.concat(expected, " ")
    for _ = 1, 10 do assert.equal(expected, order_of(model)) end
  end)

  it("takes a transition between inner nodes for one of the composites", function()
    assert.equal("initial q p", order_of(state {
      p = state { x = state {}, trans { src = "initial", tgt = "x" } },
      q = state { y = state {}, trans { src = "initial", tgt = "y" } },
      trans { src = "initial", tgt = "q" }, trans { src = ".q.y", tgt = ".p.x" },
    }))
  end)
end)

local function near() return true end

local function says(text) return function() return text end end

-- The text of a callback.
local function text_of(f)
  return marsh.model2tab(helper.init(state { entry = f }), true).entry
end

describe("the text of a callback", function()
  it("is its name, or what it was made by", function()
    assert.equal("near", text_of(near))
    assert.equal('says("hello")', text_of(says("hello")))
    assert.equal("says(2)", text_of(says(2)))
  end)

  -- The text of the function that a chunk returns.
  local function text_in(chunk, name)
    local load = rawget(_G, "loadstring") or load
    return text_of(assert(load(chunk, name))())
  end

  it("is its body if that is one short line", function()
    local distance = 1
    assert.equal("distance > 0", text_of(function() return distance > 0 end))
    assert.equal("near() near()", text_of(function() near() near() end))
    assert.equal("near()", text_of(function()
      near() -- enough
    end))
    assert.equal("far(1)", text_in("return function()\n  return far(1);\nend"))
    local forty = ("x"):rep(38) .. "()"
    assert.equal(forty, text_in("return function() " .. forty .. " end"))
    assert.equal("x" .. forty, text_in("return function() x = x" .. forty .. " end"))
    assert.equal("x == 'end'", text_in("return ({ guard = function() return x == "
      .. "'end' end or print, x = 'end' }).guard"))
    assert.equal("..", text_in("return function()\n-- nothing()\nend"))
    assert.equal("..", text_in("return function()\nlocal a =\n1 return a\nend"))
    assert.equal("..", text_in("return function() return function() end end"))
  end)

  it("is the body of its field in a line with several functions", function()
    local load = rawget(_G, "loadstring") or load
    for entry, text in pairs { -- any order: each stands alone
      ["function() a() end"] = "a()", ["function(fsm) return weekend end"] = "weekend",
      ["function() if a then b() end end"] = "if a then b() end",
      ["function() end"] = "..",
      ["function() f(function() end) end"] = "f(function() end)",
      ["function() say('the end') end"] = "say('the end')",
      ["function() a() end, x = { entry = function() b() end }"] = "..",
    } do
      local chunk = "local state = ...\nreturn state { entry = " .. entry
        .. ", exit = function() last() end }"
      local tab = marsh.model2tab(helper.init(load(chunk)(state)), true)
      assert.same({ text, "last()" }, { tab.entry, tab.exit })
    end
  end)

  it("is shown of charts in other files, too", function()
    local sub = helper.file_with("return require 'rfsm'.state {\n entry = function() "
      .. "sub() end,\n exit = function()\n  one()\n  two()\n end }")
    local fsm = helper.init(state { a = rfsm.load(sub), entry = near,
      trans { src = "initial", tgt = "a" } })
    local a = marsh.model2tab(fsm, true).subnodes[2]
    helper.remove_files()
    local file = sub:match("[^/]*$")
    assert.same({ "sub()", "one(), two()",
      ("entry %s:2, exit %s:3"):format(file, file) }, { a.entry, a.exit, a.at })
  end)

  it("is the comment behind its head, or the line of it in front", function()
    local two = "\n  near()\n  near()\nend"
    for text, chunk in pairs { -- any order: each stands alone
      ["opens the valve"] = "--- opens the valve \nreturn function()" .. two,
      ["shut: it leaks"] = "-- not this\nreturn function() -- shut: it leaks" .. two,
      [("x"):rep(60)] = "-- " .. ("x"):rep(60) .. "\nreturn function()" .. two,
    } do
      assert.equal(text, text_in(chunk))
    end
    for _, chunk in ipairs { "-- " .. ("x"):rep(61) .. "\n", "-- a\n\n", "-----\n" } do
      assert.equal("near()", text_in(chunk .. "return function()" .. two))
    end
  end)

  it("is the calls in its body, in short", function()
    for body, text in pairs { -- any order: each stands alone
      ["motor.stop()\nself.log:put(1, f(2))"] = "motor.stop(), self.log:put(..)",
      ["say 'x'\nmove { far() }\nprint(\"a()\")"] = "say(..), move(..), print(..)",
      ["for _, x in ipairs {} do a() end\nb()"] = "ipairs(..), a(), b()",
      ["if (not a()) then\nreturn (b()) end"] = "a(), b()",
      ["a() a()\na() b()\na()"] = "a(), b(), a()",
      ["x = 1 -- a()\nb()"] = "b()", ["x = 1\ny = x"] = "..",
      ["x = \"off()\"\ny = 'off()'\nput(\")\", ')')\nb()"] = "put(..), b()",
      [("one_call()\ntwo_calls()\n"):rep(3)]
        = "one_call(), two_calls(), one_call(), ..",
    } do
      assert.equal(text, text_in("return function(fsm)\n" .. body .. "\nend"))
    end
  end)

  it("is not what is behind its end", function()
    assert.equal("..", text_in("return function() end, tostring(1)"))
    assert.equal("a(), b()", text_in("return function()\na()\nif x then b() end\n"
      .. "end, tostring(1)"))
  end)

  it("is .. otherwise, with file and line beside it", function()
    assert.equal("..", text_of(function() end))
    local load = rawget(_G, "loadstring") or load
    local a = load("return function()\nend, function() end", "@lib/a.lua")
    local _, second = a()
    local tab = marsh.model2tab(helper.init(state {
      entry = second, exit = load("return\nfunction()\nend", "@lib\\b.lua")(),
      x = state { entry = load("return function()\nend", "=c")(), exit = (a()) },
      trans { src = "initial", tgt = "x" },
    }), true)
    assert.same({ "..", "..", "entry a.lua:2, exit b.lua:2",
      "entry c:1, exit a.lua:1" },
      { tab.entry, tab.exit, tab.at, tab.subnodes[2].at })
  end)

  it("needs neither io nor os", function()
    assert.equal("..\ntrue\ntrue", helper.output_of([[
      io, os = nil, nil
      local rfsm = require "rfsm"
      local fsm = rfsm.init(rfsm.state { info = false, entry = function() go() end })
      print(require("rfsm.marsh").model2tab(fsm, true).entry)
      print(#require("rfsm.dot").encode(fsm) > 0)
      print(#require("rfsm.mermaid").encode(fsm) > 0)
    ]]))
  end)

  it("is in the source that a host reads", function()
    local read = marsh.read_source
    marsh.read_source = function(name)
      return name == "chart" and "-- opens it\nreturn function()\n\n\nend" or nil
    end
    local text = text_in("\nreturn function()\n\n\nend", "=chart")
    local other = text_in("\nreturn function()\n\n\nend", "@other")
    marsh.read_source = read
    assert.same({ "opens it", ".." }, { text, other })
    assert.is_nil(read("/nowhere/x.lua"))
  end)

  it("is its type if there is no more to find", function()
    assert.equal("..", text_of(print))
    assert.equal("table", text_of(setmetatable({}, { __call = near })))
  end)
end)

describe("the full description", function()
  it("has the events in words", function()
    require "rfsm_timeevent"
    require "rfsm.await"
    local function words(events)
      return marsh.model2tab(helper.init(state {
        a = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "a", events = events },
      }), true).transitions[2].words
    end
    assert.same({ "done", "after 0.5 s", "at 20 s", "e_go", "e_done@root.b" },
      words { "e_done", "e_after(0.5)", "e_at(20)", "e_go", "e_done@root.b" })
    assert.same({ "await(e_a, e_b)", "near", "table 1", "7", ".." },
      words { "await(e_a, e_b)", near, {}, 7, rawequal })
    local after = require("rfsm_timeevent").e_after
    assert.same({ "after 3 s", "after x" }, words { after(3), after(near, "x") })
  end)

  it("has callbacks, docs, priorities and keys", function()
    local tab = marsh.model2tab(helper.init(state {
      a = state { entry = near, doo = near, exit = near, doc = "all" },
      trans { src = "initial", tgt = "a" },
      go = trans { src = "a", tgt = "internal", guard = near, effect = near, pn = 2,
        events = "e", doc = "why" },
      b = state { final = true },
    }), true)
    local a = tab.subnodes[2]
    assert.matches("^entry export_spec.lua:%d+, exit export_.*, doo export_", a.at)
    assert.same({ id = "a", type = "state", entry = "near", doo = "near",
      exit = "near", doc = "all", at = a.at }, a)
    assert.same({ id = "b", type = "state", final = true }, tab.subnodes[3])
    local line = a.at:match("%d+")
    assert.same({ type = "transition", src = "root.a", tgt = "root.a", events = { "e" },
      words = { "e" }, guard = "near", effect = "near", pn = 2, internal = true,
      key = "root.go", doc = "why",
      at = ("guard export_spec.lua:%s, effect export_spec.lua:%s"):format(line, line),
    }, tab.transitions[2])
    assert.equal("root.trans[1]", tab.transitions[1].key)
  end)

  it("has the history of a state if rfsm.history is there, as far as it is a text",
    function()
      assert.equal("nil nil\ndeep nil", helper.output_of([[
        local rfsm, marsh = require "rfsm", require "rfsm.marsh"
        local function histories()
          local function inner(history)
            return rfsm.state { history = history, x = rfsm.state {},
              rfsm.trans { src = "initial", tgt = "x" } }
          end
          local tab = marsh.model2tab(rfsm.init(rfsm.state { info = false, warn = false,
            err = false, a = inner "deep", b = inner(nil),
            rfsm.trans { src = "initial", tgt = "a" } }), true)
          return tostring(tab.subnodes[2].history) .. " "
            .. tostring(tab.subnodes[3].history)
        end
        print(histories())
        require "rfsm.history"
        print(histories())
      ]]))
    end)

  local function arm()
    return state { open = state {}, trans { src = "initial", tgt = "open" },
      info = false, warn = false }
  end

  it("has the regions of a sequential AND state, with FQNs of their own", function()
    local fsm = helper.init(state {
      arms = rfsm.seqand { left = arm(), right = arm(), order = { "right" },
        exit = near },
      trans { src = "initial", tgt = "arms" },
    })
    rfsm.step(fsm)
    local arms = marsh.model2tab(fsm, true).subnodes[2]
    assert.same({ "arms", "near", "active" }, { arms.id, arms.exit, arms.mode })
    assert.is_nil(arms.entry)
    assert.is_nil(arms.doo)
    assert.same({ id = "right", type = "state", mode = "active",
      subnodes = { { id = "initial", type = "connector" },
        { id = "open", type = "state", mode = "done" } },
      transitions = { { type = "transition", src = "root.arms.right.initial",
        tgt = "root.arms.right.open", events = {}, words = {},
        key = "root.arms.right.trans[1]" } } }, arms.regions[1])
    assert.equal("left", arms.regions[2].id)
    assert.is_nil(marsh.model2tab(fsm).subnodes[2].regions)
  end)
end)

describe("actinfo2tab", function()
  it("gives three times false when nothing is active", function()
    assert.same({ false, false, false }, { marsh.actinfo2tab(machine()) })
  end)

  it("gives F and mode of the active leaf", function()
    local fsm = machine()
    rfsm.run(fsm)
    assert.same({ "root.m.x", "done", false }, { marsh.actinfo2tab(fsm) })
  end)
end)

describe("what wants an initialised fsm", function()
  it("raises for anything else, and blames the caller", function()
    for name, f in pairs({ -- any order: each stands alone
      ["rfsm.marsh.model2tab"] = marsh.model2tab,
      ["rfsm.marsh.actinfo2tab"] = marsh.actinfo2tab,
      ["rfsm.marsh.jsontab"] = marsh.jsontab, ["rfsm.json.encode"] = json.encode,
    }) do
      local ok, problem = pcall(function() return (f(state {})) end)
      assert.is_false(ok)
      assert.matches("export_spec.lua:%d+: " .. name .. ": initialised fsm expected",
        problem)
    end
  end)
end)

describe("rfsm.json", function()
  it("gives the graph and what is active", function()
    local fsm = machine()
    rfsm.run(fsm)
    local decoded = require("dkjson").decode(json.encode(fsm))
    assert.equal(2, decoded.version)
    assert.equal("rfsm_model", decoded.type)
    assert.equal("root.m.x", decoded.active_leaf)
    assert.equal("done", decoded.active_leaf_state)
    assert.equal("root", decoded.graph.id)
    assert.equal(4, #decoded.graph.subnodes)
  end)

  it("gives the full description", function()
    local graph = require("dkjson").decode(json.encode(helper.init(state {
      entry = near, arms = rfsm.seqand { left = state {} },
      trans { src = "initial", tgt = "arms", guard = near },
    }))).graph
    assert.same({ "near", "near", "left" }, { graph.entry, graph.transitions[1].guard,
      graph.subnodes[2].regions[1].id })
  end)

  it("writes empty lists as arrays", function()
    assert.matches('"events":%[%]', json.encode(machine()))
    local empty = helper.init(state {
      a = state {}, x = state { y = state {} }, trans { src = "initial", tgt = "a" },
    })
    assert.matches('"transitions":%[%]', json.encode(empty))
  end)

  it("writes the same text each time, internal transitions marked", function()
    assert.equal(json.encode(machine()), json.encode(machine()))
    assert.matches('"events":%["e"%],\n *"words":%["e"%],\n *"internal":true',
      json.encode(helper.init(state {
        a = state {}, trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "internal", events = "e" },
      })))
  end)

  it("writes events that JSON does not know as text", function()
    local event = setmetatable({}, { __tostring = function() return "an event" end })
    local fsm = helper.init(state {
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "a", events = { event, 7, true, 1 / 0 } },
    })
    assert.matches('"events":%["an event",7,true,"inf"%]', json.encode(fsm))
  end)
end)

describe("an object in JSON", function()
  it("has its keys in a fixed order", function()
    local text = json.encode(helper.init(state {
      a = state { doc = "first", final = true },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "internal", events = "e_x", pn = 2,
        guard = function() end, effect = function() end },
      trans { src = "a", tgt = "a", always = true, guard = function() end },
    }))
    assert.matches('"words":%[%],\n *"guard":"%.%.",\n *"always":true', text)
    local keys, last = {}, text:match('{([^{}]*"key":"root%.trans%[2%]"[^{}]*)}')
    for key in last:gmatch('"(%l+)":') do keys[#keys + 1] = key end
    assert.equal("type key src tgt pn events words guard effect internal at",
      table.concat(keys, " "))
    assert.matches('"id":"a",%s*"doc":"first",%s*"final":true', text)
  end)
end)

describe("decode_all", function()
  it("gives the values of a text, without a last line that was cut off", function()
    assert.same({ { a = 1 } }, json.decode_all('{"a":1}'))
    assert.same({ 1, "b", { 2 } }, json.decode_all('1 "b"\n[2]\n'))
    assert.same({ 1 }, json.decode_all('1\n{"a":'))
    assert.same({}, json.decode_all(" \n"))
  end)

  it("raises an error in one line if there is more behind what is none", function()
    for _, text in ipairs { "x", "1\nx\n2", '{"a":' } do
      local ok, problem = pcall(json.decode_all, text)
      assert.is_false(ok)
      assert.matches("^no JSON: [^\n]+$", problem)
    end
  end)
end)

describe("rfsm.json", function()
  local function encoded(events, pn)
    return json.encode(helper.init(state {
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "a", events = events, pn = pn },
    }))
  end

  it("writes numbers alike on each Lua, and so that none is lost", function()
    local text = encoded({ 5.0, 0.1, -2.5, 1e100, 2 ^ 53, 1 / 3, -1 / 0 }, 3.0)
    assert.is_truthy(text:find('"events":[5,0.1,-2.5,1e+100,9007199254740992,'
      .. '0.3333333333333333,"-inf"]', 1, true))
    assert.matches('"pn":3,\n', text)
    assert.matches('"pn":"inf",\n', encoded({}, 1 / 0))
  end)

  it("numbers events that have no text of their own", function()
    local f, t = function() end, {}
    assert.is_truthy(encoded({ f, t, print, f, false }):find('"events":["function 1",'
      .. '"table 1","function 2","function 1",false]', 1, true))
  end)

  it("is UTF-8 whatever the names", function()
    assert.matches('"events":%["\\ufffd","\195\169"%]',
      encoded { "\255", "\195\169" })
    local fsm = helper.init(state { ["\255"] = state {},
      trans { src = "initial", tgt = "\255" } })
    rfsm.run(fsm)
    assert.matches('"active_leaf":"root.\\ufffd"', json.encode(fsm))
  end)
end)

describe("rfsm.json", function()
  it("writes keys in one order", function()
    local ORDER, position = { "id", "type", "doc", "mode", "final", "entry", "doo",
      "exit", "key", "src", "tgt", "pn", "events", "words", "guard", "effect",
      "internal", "transitions", "subnodes", "regions" }, {}
    for i, key in ipairs(ORDER) do position[key] = i end
    local fsm = helper.init(state {
      a = state { entry = near, exit = near, doo = near }, doc = "all keys",
      entry = near, exit = near,
      b = state { final = true, doc = "end" },
      c = rfsm.seqand { left = state { info = false } },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = "e", guard = near, effect = near, pn = 1 },
      trans { src = "a", tgt = "internal", events = "e" },
    })
    rfsm.run(fsm)
    local last, seen = {}, {}
    for indent, key in require("rfsm.json").encode(fsm):gmatch('\n( *)["%]}]?(%w*)') do
      local here = last[#indent]
      if key == "" then
        last[#indent + 2] = nil -- an object or a list ends
      elseif position[key] then
        assert.is_true((not here or position[key] > here) or key == "id"
          or key == "type", key)
        last[#indent], seen[key] = position[key], true
      end
    end
    for _, key in ipairs(ORDER) do
      if key ~= "type" then assert.is_true(seen[key], key) end
    end
  end)
end)

describe("rfsm.plantuml", function()
  it("draws composites, connectors and arrows with unique identifiers", function()
    assert.equal([[
@startuml
title T
state "root" as root {
  state "m" as root_m {
    state "x" as root_m_x
    state root_m_k <<choice>>
    [*] --> root_m_x
    root_m_x --> root_m_k : e1, e2 (pn 2)
  }
  state "a b" as root_a_b
  state "a_b" as root_a_b_2
  [*] --> root_m
  root_m_k --> root_a_b
  root_a_b --> root_m : e_again
}
@enduml
]], plantuml.encode(machine(), "T"))
  end)

  it("points at a connector that a transition goes to from outside", function()
    local fsm = helper.init(state {
      out = state {}, m = state { k = conn {}, x = state {},
        trans { src = "initial", tgt = "x" }, trans { src = "k", tgt = "x" } },
      trans { src = "initial", tgt = "out" },
      trans { src = "out", tgt = ".m.k", events = { "e" } },
    })
    assert.matches("\n  root_out %-%-> root_m_k : e\n", plantuml.encode(fsm))
  end)
end)
