-- What `rfsm.init` does with the problems it found. Their texts are in mistakes_spec.

local advice = require "rfsm.advice"
local helper = require "spec.helper"
local rfsm = require "rfsm"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn
local to_a = { src = "initial", tgt = "a" }

-- A chart  initial -> a  with more members; silent, so that only the result speaks.
local function chart(members)
  local model = { err = false, warn = false, info = false, a = state {}, trans(to_a) }
  for key, value in pairs(members) do model[key] = value end -- any order: a set
  return state(model)
end

-- Without the file and line, which are those of this file.
local function without_place(lines)
  for i = 1, #lines do lines[i] = lines[i]:gsub("spec/check_spec.lua:%d+: ", "") end
  return lines
end

local function problems_of(model)
  local fsm, _, problems = rfsm.init(model)
  assert.is_false(fsm)
  return without_place(problems)
end

local function warnings_of(model)
  local said = {}
  model.warn = function(text)
    if not text:find("no outgoing", 1, true) then said[#said + 1] = text end
  end
  assert.is_table((rfsm.init(model)))
  return without_place(said)
end

local function noop() end

describe("a problem", function()
  it("has the line of the constructor in front, in a file of any name", function()
    local name = helper.file_with("\n\nreturn {\n  require 'rfsm'.trans {} }\n")
    local tr = dofile(name)[1]
    helper.remove_files()
    assert.equal(name .. ":4: root.trans[2]: tgt is missing, the name of a state or "
      .. "connector expected", select(3, rfsm.init(chart { [2] = tr }))[2])
  end)

  it("is in the text that assert shows, and in the list behind it", function()
    local fsm, text, list = rfsm.init(chart { b = "no state", [2] = trans {} })
    assert.is_false(fsm)
    assert.equal("rfsm.init: the model has 2 problems\n  "
      .. table.concat(list, "\n  "), text)
  end)
end)

describe("a reference", function()
  it("to a table that stands twice at the same distance is a problem", function()
    local twin = state {}
    assert.same({
      "root.trans[2]: tgt: the table given stands in several places, use a name",
    }, problems_of(chart { b = twin, c = twin, [2] = trans { src = "a", tgt = twin } }))
  end)

  it("may have a per cent sign in it", function()
    assert.same({ "root.trans[2] (a -> 50%d): tgt '50%d': no state or connector is "
      .. "named '50%d' in 'root' (there are 'a', 'initial')" },
      problems_of(chart { [2] = trans { src = "a", tgt = "50%d" } }))
  end)

  it("that leads nowhere hides what is wrong with its e_done", function()
    local a = state {}
    local ok, problems, warnings = rfsm.verify_early(state {
      a = a, trans { src = "initial", tgt = "a" },
      trans { src = a, tgt = "b", events = { "e", "e_done" } },
    })
    assert.same({ false, { "root.trans[2]: tgt 'b': no state or connector is named 'b' "
      .. "in 'root' (there are 'a', 'initial')" }, {} },
      { ok, without_place(problems), warnings })
  end)
end)

describe("a name", function()
  it("of a transition is none of the engine's, and no field of a state", function()
    local tr = { src = "root.a", tgt = "root.a", events = { "e" } }
    assert.same({
      "root._parent (root.a -> root.a): the name of a transition must not start with "
        .. "'_'",
      "root.a.exit (root.a -> root.a): a transition cannot have this name, it is a "
        .. "field of every state",
    }, problems_of(chart { _parent = trans(tr), a = state { exit = trans(tr) } }))
  end)
end)

describe("nothing is wrong", function()
  local function to_x(fields)
    fields.src, fields.tgt = "initial", "x"
    return trans(fields)
  end

  local CASES = {
    ["a name of a field of the root deeper down"] = { m = state { err = state {} } },
    ["names as their author likes"] = {
      ["a b"] = state {}, ["end"] = state {}, type = state {}, root = state {} },
    ["a callback that can be called"] = {
      b = state { entry = setmetatable({}, { __call = noop }) } },
    ["false, which counts as absent"] = {
      b = state { entry = false, exit = false, doo = false },
      m = state { x = state {}, doo = false, to_x {} },
      [2] = trans { src = "a", tgt = "b", effect = false, pn = false,
        events = false },
      getevents = false, idle_hook = false, pre_step_hook = false,
      post_step_hook = false, dbg = false },
    ["initial transitions one of which is always open"] = {
      m = state { x = state {}, to_x { guard = noop, pn = 1 }, to_x {} } },
    ["a field where the right one is, or that is no function"] = {
      b = state { entry = noop, enter = noop, exec = noop, edit = noop, exits = 1 } },
  }
  for _, what in ipairs(rfsm.sorted_keys(CASES)) do
    it("with " .. what, function()
      assert.same({}, warnings_of(chart(CASES[what])))
    end)
  end
end)

describe("init", function()
  -- Five mistakes in five places.
  local function five_problems()
    return chart {
      b = state { entry = 1 },
      [10] = trans { src = "a", tgt = "nowhere_near" },
      [2] = trans { src = "a", tgt = "a", pn = "x" },
      m = state { initial = state {} },
      ["q.r"] = conn {},
    }
  end

  local FIVE = {
    "root.b.entry: function expected, got number 1",
    "root.m.initial: connector expected, got state",
    "root.q.r: the name of a connector must not be empty, contain '.' or '\\' or start "
      .. "with '_'",
    "root.trans[2].pn (a -> a): number expected, got string 'x'",
    "root.trans[10] (a -> nowhere_near): tgt 'nowhere_near': no state or connector is "
      .. "named 'nowhere_near' in 'root' (there are 'a', 'b', 'initial', 'm', 'q.r')",
  }

  it("reports five problems together, sorted by place", function()
    assert.same(FIVE, problems_of(five_problems()))
  end)

  it("hands them to err in one text", function()
    local said = {}
    local model = five_problems()
    model.err = function(...) said[#said + 1] = { ... } end
    rfsm.init(model)
    assert.same({ { without_place({ said[1][1] })[1] } }, {
      { "rfsm.init: the model has 5 problems\n  " .. table.concat(FIVE, "\n  ") },
    })
  end)

  it("counts a single problem as one", function()
    local said
    local model = chart { b = state { exit = 1 } }
    model.err = function(text) said = text end
    rfsm.init(model)
    assert.matches("^rfsm.init: the model has 1 problem\n  spec/check_spec.lua:%d+: "
      .. "root.b.exit: function expected, got number 1$", said)
  end)

  it("raises only for what is no state, and blames the caller", function()
    local ok, problem = pcall(function() return (rfsm.init(nil)) end)
    assert.is_false(ok)
    assert.matches("check_spec.lua:%d+: invalid fsm model passed to rfsm.init: state "
      .. "expected, got nil$", problem)
  end)

  it("tells of each connector it created", function()
    local said = {}
    local m = state { x = state {}, trans { src = "initial", tgt = "x" } }
    local model = chart { m = m }
    model.info = function(text) said[#said + 1] = text end
    rfsm.init(model)
    assert.same({
      "INFO: created undeclared connector root.initial",
      "INFO: created undeclared connector root.m.initial",
    }, said)
  end)

  it("leaves the model as it was", function()
    local model = chart { b = state { data = { 1, { 2 } } } }
    rfsm.init(model)
    assert.is_nil(model.initial)
    assert.is_nil(rawget(model, "_fqn"))
    assert.same({ 1, { 2 } }, model.b.data)
    assert.equal("initial", to_a.src)
  end)

  it("counts what a preproc function finds among the problems", function()
    helper.with_preproc(function() return { "root.a: not to my taste" } end, function()
      assert.same({ "root.a: not to my taste" }, problems_of(chart {}))
    end)
  end)

  it("does without hints where rfsm/advice.lua is missing, and says so", function()
    assert.equal("rfsm.init: the model has 1 problem|  root.trans[2] (a -> dimm): tgt "
      .. "'dimm': unknown name|"
      .. "  (no hints: rfsm/advice.lua is not installed)",
      (helper.output_of([[
        package.path = "./?.lua;" .. package.path
        package.preload["rfsm.advice"] = function()
          error("module 'rfsm.advice' not found")
        end
        local rfsm = require "rfsm"
        rfsm.init(rfsm.state {
          info = false, err = true, a = rfsm.state {}, dim = rfsm.state {},
          rfsm.trans { src = "initial", tgt = "a" },
          rfsm.trans { src = "a", tgt = "dimm" },
        })
      ]]):gsub("\n", "|"):gsub("  %S+:%d+: ", "  ")))
    helper.remove_files()
  end)
end)

describe("a transition inside a leaf", function()
  it("is dropped if its ends are wrong", function()
    local fsm = assert(rfsm.init(chart { warn = false,
      c = state { trans { src = "a", tgt = "nowhere" } } }))
    assert.is_nil(rawget(fsm.c, 1))
  end)
end)

describe("an initial that nothing leaves", function()
  local TEXT = ": no transition leaves it (rfsm.trans{ src='initial', tgt=... })"

  -- (initial) -> a --e--> on.x, and more members; `on` has such an `initial`.
  local function entered_inside(members)
    members.on = state { initial = conn {}, x = state {}, y = state {} }
    members[2] = trans { src = "a", tgt = "on.x", events = "e" }
    return chart(members)
  end

  it("is a warning if nothing enters the composite by it", function()
    local model = entered_inside {
      [3] = trans { src = "on.x", tgt = "on.y", events = "e" },
      [4] = trans { src = "on", tgt = "a", events = "e_off" },
    }
    assert.same({ "WARNING: root.on.initial" .. TEXT }, warnings_of(model))
    local fsm = helper.started(model)
    assert.equal("root.on.x", helper.leaf_after(fsm, "e"))
    assert.equal("root.on.y", helper.leaf_after(fsm, "e"))
    assert.equal("root.a", helper.leaf_after(fsm, "e_off"))
  end)

  it("is a problem if a transition enters by it, once for all of them", function()
    for _, tgt in ipairs { "on", "on.initial" } do
      assert.same({ "root.on.initial" .. TEXT }, problems_of(entered_inside {
        [3] = trans { src = "a", tgt = tgt, events = "e_on" },
        [4] = trans { src = "on.x", tgt = tgt, events = "e_again" },
      }))
    end
  end)

  it("is a problem if another initial leads to it", function()
    local inner = state { initial = conn {}, x = state {} }
    local out = state { inner = inner, trans { src = "initial", tgt = "inner" } }
    assert.same({ "root.out.inner.initial" .. TEXT }, problems_of(chart { out = out }))
  end)

  it("is a problem in the root, which is always entered by it", function()
    assert.same({ "root.initial" .. TEXT }, problems_of(state {
      err = false, initial = conn {}, a = state {} }))
  end)

  it("refuses a transition that is merged, until one leaves it", function()
    local fsm = helper.started(entered_inside {})
    local to_on = trans { src = "a", tgt = "on", events = "e_on" }
    local _, reason = rfsm.fsm_merge(fsm, fsm, to_on)
    assert.matches("root.on.initial" .. TEXT, reason, 1, true)
    assert(rfsm.fsm_merge(fsm, fsm.on, trans { src = "initial", tgt = "y" }))
    assert(rfsm.fsm_merge(fsm, fsm, to_on))
    assert.equal("root.on.y", helper.leaf_after(fsm, "e_on"))
  end)

  it("is no way in for a target that a preproc function sets", function()
    local function aim(fsm) fsm[2].tgt = fsm.on end
    helper.with_preproc(aim, function()
      assert.same({ "root.trans[2] (a -> on.x): tgt: the composite has no initial "
        .. "transition" }, problems_of(entered_inside {}))
    end)
  end)
end)

describe("the warning of a node that nothing leaves", function()
  local function dead_ends_of(members)
    local said = {}
    local model = { info = false, warn = function(text) said[#said + 1] = text end,
      on = state { x = state {}, y = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "y", events = { "e" } } }, off = state {},
      trans { src = "initial", tgt = "on" },
      trans { src = "off", tgt = "on", events = { "e_on" } } }
    for key, value in pairs(members) do model[key] = value end -- any order
    assert.is_table((rfsm.init(state(model))))
    return (table.concat(said, "; "):gsub("WARNING: no outgoing transitions from ", ""))
  end

  it("is given of a leaf in a composite that nothing leaves", function()
    assert.equal("node 'root.on'; node 'root.on.y'", dead_ends_of {})
  end)

  it("is not given of a leaf in a composite that can be left", function()
    assert.equal("", dead_ends_of {
      [3] = trans { src = "on", tgt = "off", events = { "e_off" } } })
    assert.equal("", dead_ends_of {
      [3] = trans { src = "root", tgt = "off", events = { "e_off" } } })
  end)

  it("is given of a leaf beside another one that leaves the composite", function()
    assert.equal("node 'root.on.y'", dead_ends_of {
      [3] = trans { src = "root.on.x", tgt = "off", events = { "e_off" } } })
  end)

  it("is given of a connector in a composite that can be left", function()
    assert.equal("node 'root.on.y'", dead_ends_of { on = state { x = state {},
      y = rfsm.conn {}, trans { src = "initial", tgt = "x" },
      trans { src = "x", tgt = "y", events = { "e" } } },
      [3] = trans { src = "on", tgt = "off", events = { "e_off" } } })
  end)
end)

describe("verify_early", function()
  it("returns problems and warnings without making a machine", function()
    local ok, problems, warnings = rfsm.verify_early(chart {
      b = state { exit = 1, event = print },
      [2] = trans { src = "a", tgt = "a", event = "e" },
    })
    assert.is_false(ok)
    assert.same({ "root.b.exit: function expected, got number 1" },
      without_place(problems))
    assert.same({
      "root.trans[2] (a -> a): a transition has no field 'event' (did you mean "
        .. "'events'?)",
    }, without_place(warnings))
  end)
end)

describe("a field that is nearly one of an extension, or `always`,", function()
  it("is told with the right name, if the extension would take the value", function()
    local _, _, warnings = rfsm.verify_early(state {
      m = state { histroy = "deep", x = state { deffer = {}, defers = { "e_x" } },
        z = state { deferred = {}, postponed = "data" },
        y = state { deffer = "data", histroy = "deep", time = {}, histry = {} },
        trans { src = "initial", tgt = "x" } },
      trans { src = "initial", tgt = "m" },
      trans { src = "m", tgt = "m", events = "e", likley = function() end },
      trans { src = "m", tgt = "m", alway = true },
    })
    assert.same({
      "root.m.x: a state has no field 'defers' (did you mean 'defer'?)",
      "root.m.x: a state has no field 'deffer' (did you mean 'defer'?)",
      "root.m.z: a state has no field 'deferred' (did you mean 'defer'?)",
      "root.m: a state has no field 'histroy' (did you mean 'history'?)",
      "root.trans[2] (m -> m): a transition has no field 'likley' (did you mean "
        .. "'likely'?)",
      "root.trans[3] (m -> m): a transition has no field 'alway' (did you mean "
        .. "'always'?)",
    }, without_place(warnings))
  end)

  it("is told if `always` is an event", function()
    local lines = {}
    rfsm.init(state { info = false, warn = function(line) lines[#lines + 1] = line end,
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "a", events = { "always" } } })
    assert.same({ "root.trans[2].events (a -> a): 'always' comes only if it is sent "
      .. "(needs no event: always = true beside src and tgt)" },
      without_place({ (lines[1]:gsub("^WARNING: ", "")) }))
  end)
end)

describe("a field of an extension that is not loaded", function()
  it("is told with its module, if the extension would take the value", function()
    assert.equal([[
root.m.x: a state has no field 'defer' (require "rfsm.defer")
root.m: a state has no field 'history' (require "rfsm.history")
root.trans[2] (m -> m): a transition has no field 'likely' (require "rfsm.preview")]],
      (helper.output_of([[
local rfsm = require "rfsm"
local state, trans = rfsm.state, rfsm.trans
local _, _, warnings = rfsm.verify_early(state {
  m = state { history = "deep", x = state { defer = { "e_x" }, history = "deep" },
    trans { src = "initial", tgt = "x" } },
  data = state { history = {}, defer = {}, likely = print, label = "history",
    y = state { history = "long", defer = "e_x" },
    trans { src = "initial", tgt = "y" } },
  trans { src = "initial", tgt = "m", likely = 5 },
  trans { src = "m", tgt = "m", events = "e_x", likely = function() end },
})
print((table.concat(warnings, "\n"):gsub("[^\n]-:%d+: ", "")))]])))
  end)

  it("is named in the head of that module", function()
    for _, kind in ipairs { "state", "transition", "connector" } do
      for field, entry in pairs(advice.extension_fields[kind]) do -- any order
        local text = helper.content("rfsm" .. entry.name:gsub("%.", "/") .. ".lua")
        local head = text:match("^.-@module")
        assert.matches("`" .. field .. "%f[%W]", head)
      end
    end
  end)
end)
