-- Data in an exploration: fields that callbacks set, and rules for guards.

local ab = require "spec.support.ab"
local claim = require "spec.support.claims.data"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local share = require "spec.support.share"

local writes = require "rfsm.shared.writes"

local load_text = rawget(_G, "loadstring") or load
local state = rfsm.state
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local never = rfsm_checks.never
local chart, go = ab.chart, ab.go

-- The first result of a property, and its line or witness.
local function verdict(model, property, options)
  options.properties = { p = property }
  local result = rfsm_checks.explore(model, options)
  local judged = result.properties[1]
  return judged.holds, tostring(result):match("\n(p: [^\n]*)"), result
end

-- The functions that a line of Lua returns.
local function functions_of(line) return { load_text(line)() } end

describe("functions in one line", function()
  local syntax = require "rfsm.shared.syntax"

  -- What tells them apart, and the line; it returns the functions in its order.
  local APART = {
    { "upvalues", "local f, g = {}, {} return function() return f end, "
      .. "function() return g end" },
    { "fields", "return function(tr) return tr.src.n == 0 end, "
      .. "function(fsm) fsm.tries = 3 end" },
    { "globals", "return function(x) may(x) end, function(x) send_after(x) end" },
    { "strings", "return function(x) x 'a' end, function(x) x 'b' end" },
    { "what one has more", "return function(x) return x.n end, "
      .. "function(x) return x.n, x.m end" },
    { "methods", "return function(x) return x:go() end, function(x) x:stop() end" },
  }
  for _, case in ipairs(syntax.is_there and APART or {}) do
    it("are told apart by " .. case[1], function()
      local texts = {}
      for i, f in ipairs(functions_of(case[2])) do
        local text, is_shared = writes.text_of(f)
        assert.is_false(is_shared)
        texts[i] = text
        assert.truthy(case[2]:find(text, 1, true))
        assert.matches("^function.*end$", text)
      end
      assert.not_equal(texts[1], texts[2])
      assert.is_true(#texts[1] + #texts[2] < #case[2])
    end)
  end

  -- A body, then the upvalues and the constants of a function with it. Outside of it
  -- `u` and `w` are local.
  local SCOPES = {
    { "return u, n", "u", "n" },
    { "local x = x; return x", "", "x" },
    { "local u = w; return u", "w", "" },
    { "local function f() return f end return f", "", "" },
    { "for i = u, a do w = i end return i", "u w", "a i" },
    { "for k, v in k(u) do return k, v end return v", "u", "k v" },
    { "repeat local u = g() until u", "", "g" },
    { "do local u = 1 end return u", "u", "" },
    { "local function f(x) return x, w, m end", "w", "m" },
    { "return { key = u, 's' }, u.field, u:go()", "u", "field go key s" },
  }
  for _, case in ipairs(syntax.is_there and SCOPES or {}) do
    it("have upvalues and constants: " .. case[1], function()
      local text = "local u, w = 1, 2 return function() " .. case[1] .. " end"
      local tree, functions = syntax.parse(text)
      assert.equal(functions[1].node, tree[2][1])
      assert.same({ case[2], case[3], text:match("function.*") }, {
        table.concat(rfsm.sorted_keys(functions[1].upvalues), " "),
        table.concat(rfsm.sorted_keys(functions[1].constants), " "),
        functions[1].text })
    end)
  end

  it("are not found in a text that cannot be parsed", function()
    assert.is_nil(syntax.parse("return function("))
  end)

  it("that nothing tells apart share their text", function()
    local line = "return function(x) x.n = 1 end, function(x) x.n = 2 end"
    for _, f in ipairs(functions_of(line)) do
      local text, is_shared = writes.text_of(f)
      assert.same({ line:sub(8), true }, { text, is_shared })
    end
    local twins = "return function(x) x.n = 1 end, function(x) x.n = 1 end"
    assert.equal(not syntax.is_there, (select(2, writes.text_of(
      functions_of(twins)[1]))))
  end)

  it("have no text of another one that names a local variable or nothing more",
    function()
    for _, second in ipairs { "x.y = x.n", "x['' .. 'n'] = 2", "x[''] = x.n" } do
      local first = "function(x) local y = x y.n = 1 end"
      local line = "return " .. first .. ", function(x) " .. second .. " end"
      local text, is_shared = writes.text_of(functions_of(line)[1])
      assert.is_true(is_shared or text == first)
    end
  end)

  -- (initial) -> a --e_x--> b --e_late--> a: guard and effect in one line
  local function model() return chart { n = 0,
    [2] = go("a", "b", "e_x", { guard = function(tr) return tr._fsm.n < 1 end, effect = function(fsm) fsm.m = 1 end }), -- luacheck: no max line length
  } end

  it("are read each for itself, or are a premise", function()
    local options = { vars = { n = { 0, 3 } }, run = { "guard root.trans[2]" },
      properties = { never { "root.a", "root.b" } } }
    local result = rfsm_checks.explore(model(), options)
    assert.is_nil(result.bound)
    assert.equal("one event a step; 1 callback not run", result.premises)
    helper.with(syntax, { is_there = false }, function()
      result = rfsm_checks.explore(model(), options)
      assert.matches("callbacks of one line read together %(luacheck is not "
        .. "installed%)", result.premises)
    end)
  end)
end)

describe("fields that are followed", function()
  local function count(fsm) fsm.tries = fsm.tries + 1 end
  local function reset(fsm) fsm.tries = 0 end
  local function has_tries(tr) return tr.src._parent.tries < 3 end

  -- a tries three times, then gives up.
  local function retrying(members)
    local all = { tries = 0, gone = state { final = true },
      [2] = go("a", "a", "e_x", { guard = has_tries, effect = count, pn = 1 }),
      [3] = go("b", "a", "e_x", { effect = reset }),
      [4] = go("a", "gone", "e_x"), [5] = go("a", "b", "e_b") }
    for key, value in pairs(members or {}) do all[key] = value end
    return chart(all)
  end

  local function options(range)
    return { vars = { tries = range or { 0, 3 } }, run = { count, reset, has_tries } }
  end

  it("tell configurations apart", function()
    local model = retrying()
    local holds, line = verdict(model, never "root.gone", options())
    assert.is_false(holds)
    assert.equal("p: does not hold [violated]", line)
    local _, _, result = verdict(model, never "root.gone", options())
    assert.equal(5, #result.properties[1].witness)
    assert.equal(0, model.tries)
    assert.is_false((verdict(retrying(), never "root.gone", {})))
  end)

  it("forbid what the guards forbid", function()
    local members = { [4] = go("a", "gone", "e_x", { guard = function(tr)
      return tr.src._parent.tries > 3
    end }) }
    local model = retrying(members)
    local own = options()
    own.run[4] = model[4].guard
    assert.is_true((verdict(model, never "root.gone", own)))
    assert.equal("p: holds (one event a step)",
      select(2, verdict(model, never "root.gone", own)))
  end)

  it("are not known outside of their range, and where others change", function()
    local _, line, result = verdict(retrying(), never "root.b.nothing" and
      never { "root.gone", "root.b" }, options { 0, 1 })
    assert.equal("p: not known", line)
    assert.equal("values", result.bound)
    assert.same({ "values of the field 'tries' such as 2" }, result.untried)
    local function other(fsm) fsm.other = true end
    local own = options()
    own.run[4] = other
    _, _, result = verdict(retrying { b = state { entry = other } },
      never { "root.gone", "root.b" }, own)
    assert.same({ "the field 'other', which vars does not name" }, result.untried)
  end)

  it("may be booleans and texts, and what callbacks send is sent", function()
    local function fast(fsm)
      fsm.gear, fsm.on = "fast", true
      rfsm.send_events(fsm, "e_y")
    end
    local function is_on(tr) return tr.src._parent.on end
    local model = chart { gear = "slow", on = false, c = state {},
      [2] = go("a", "b", "e_x", { effect = fast }),
      [4] = go("b", "c", "e_y", { guard = is_on }), [5] = go("a", "c", "e_z",
        { guard = is_on }), [6] = go("c", "b", "e_x") }
    local own = { vars = { gear = { "slow", "fast" }, on = "boolean" },
      run = { fast, is_on }, alphabet = { "e_x", "e_z" } }
    assert.is_false((verdict(model, never "root.c", own)))
    own.alphabet = { "e_z" }
    assert.is_true((verdict(model, never "root.c", own)))
  end)

  it("replay, with the answers that guards gave", function()
    local model = retrying()
    local _, _, result = verdict(model, never "root.gone", options())
    local records = {}
    rfsm_checks.record_witness(model, result.properties[1].witness, records)
    local fsm = assert(require("rfsm.record").replay(model, records, { dry = true }))
    assert.equal("root.gone", rfsm.get_actleaf_fqn(fsm))
  end)
end)

-- a counts e_x, and goes to bad on e_y from the third one on.
local function counting(effect, guard, members)
  local all = { n = 0, d = { n = 0 }, a = state { n = 0 }, bad = state {},
    [2] = go("a", "internal", "e_x", { effect = effect }),
    [3] = go("a", "bad", "e_y", { guard = guard }) }
  for key, value in pairs(members or {}) do all[key] = value end
  return chart(all)
end

-- Judges that bad is never reached. A witness is followed on a machine of its own.
local function judge(make, options)
  options.properties = { rfsm_checks.never "root.bad" }
  local result = rfsm_checks.explore(make(), options)
  local judged = result.properties[1]
  if judged.holds == false then
    local fsm = rfsm.init(make())
    for _, step in ipairs(judged.witness) do
      rfsm.send_events(fsm, unpack(step.values))
      rfsm.step(fsm)
    end
    assert.equal("root.bad", rfsm.get_actleaf_fqn(fsm))
  end
  return judged.holds, result.untried[1], result
end

describe("data anywhere", function()
  local upvalue
  local list = setmetatable({ n = 0 }, { __index = { none = true } })
  local PLACES = {
    ["a state"] = { path = "a.n", get = function(fsm) return fsm.a end },
    ["a table"] = { path = "d.n", get = function(fsm) return fsm.d end },
    ["a transition"] = { path = "trans[3].n", get = function(fsm) return fsm[3] end },
    ["the machine"] = { path = "n", get = function(fsm) return fsm end },
    ["an object"] = { path = "obj.n", get = function(fsm) return fsm.obj end },
  }

  for name, place in pairs(PLACES) do -- any order: each stands alone
    local get = place.get
    local function count(fsm) get(fsm).n = get(fsm).n + 1 end
    local function is_three(tr) return get(tr.src._parent).n >= 3 end
    local function make()
      list.n = 0
      local model = counting(count, is_three, { obj = list })
      model[3].n = 0
      return model
    end

    it(("in %s is followed"):format(name), function()
      local function is_at_three(tr) return get(tr.src._parent).n == 3 end
      local function count_to_three(fsm)
        if get(fsm).n < 3 then get(fsm).n = get(fsm).n + 1 end
      end
      local function make_bounded()
        local model = make()
        model[2].effect, model[3].guard = count_to_three, is_at_three
        return model
      end
      local holds = judge(make_bounded, { run = { "effect root.trans[2]",
        "guard root.trans[3]" }, vars = { [place.path] = { 0, 3 } } })
      assert.is_false(holds)
    end)

    it(("in %s that vars does not name leaves it open"):format(name), function()
      local holds, untried = judge(make, { run = { count, is_three } })
      assert.is_nil(holds)
      assert.equal(("the field '%s', which vars does not name"):format(place.path),
        untried)
      assert.equal(0, list.n)
    end)
  end

  it("in a region is followed", function()
    local function count(fsm) if fsm.n < 3 then fsm.n = fsm.n + 1 end end
    local function is_three(tr) return tr.src._parent.n >= 3 end
    local function make()
      require "rfsm_seqand"
      return state { info = false, warn = false, par = rfsm.seqand { r = state {
        info = false, warn = false, n = 0, a = state {}, bad = state {},
        go("initial", "a"), go("a", "internal", "e_x", { effect = count }),
        go("a", "bad", "e_y", { guard = is_three }) } }, go("initial", "par") }
    end
    local function verdict_of(options)
      options.run = { "effect root.par.r.trans[2]", is_three }
      options.properties = { never "root.par.r.bad" }
      return rfsm_checks.explore(make(), options)
    end
    local result = verdict_of {}
    assert.is_nil(result.properties[1].holds)
    assert.same({ "the field 'par.r.n', which vars does not name" }, result.untried)
    result = verdict_of { vars = { ["par.r.n"] = { 0, 3 } } }
    assert.is_false(result.properties[1].holds)
    local fsm = rfsm.init(make())
    for _, step in ipairs(result.properties[1].witness) do
      rfsm.send_events(fsm, unpack(step.values))
      rfsm.step(fsm)
    end
    assert.equal("root.bad", rfsm.get_actleaf_fqn(fsm.par.substates.r))
  end)

  it("in an upvalue or a global leaves it open, and is put back", function()
    upvalue, _G.verdict_count = 0, 0
    local function count() upvalue = upvalue + 1 end
    local function add() _G.verdict_count = _G.verdict_count + 1 end
    local function is_three() return upvalue + rawget(_G, "verdict_count") >= 3 end
    for _, case in ipairs { { count, "upvalue" }, { add, "verdict_count" } } do
      local holds, untried = judge(function() return counting(case[1], is_three) end,
        { run = { case[1], is_three } })
      assert.is_nil(holds)
      assert.equal(("the variable '%s', which vars does not name"):format(case[2]),
        untried)
      assert.equal(0, upvalue + _G.verdict_count)
    end
    _G.verdict_count = nil
  end)

  it("that a guard changes leaves it open, however it does that", function()
    local function set(fsm) fsm.n = fsm.n + 1 end
    local lib = { set = set }
    local GUARDS = {
      function(tr) tr.src._parent.n = 1 end,
      function(tr) set(tr.src._parent) return tr.src._parent.n >= 3 end,
      function(tr) lib.set(tr.src._parent) return tr.src._parent.n >= 3 end,
      function(tr) rawset(tr.src._parent, "n", 1) return true end,
    }
    for i, guard in ipairs(GUARDS) do
      local _, _, result = judge(function() return counting(nil, guard) end,
        { run = { guard } })
      assert.equal("the field 'n', which vars does not name",
        result.untried[#result.untried], i)
    end
  end)

  it("outside of the chart is looked at up to a bound", function()
    local many, other = {}, {}
    for i = 1, 1000 do many[i] = { {} } end
    for i = 1, 400 do other[i] = { {} } end
    local function is_set(tr) return tr.src._parent.n == many[1000][1].n end
    local function is_other(tr) return tr.src._parent.n == other[400][1].n end
    local _, _, result = judge(function() return counting(nil, is_set) end,
      { run = { is_set } })
    assert.matches("; not all data looked at$", result.premises)
    _, _, result = judge(function() return counting(nil, is_other) end,
      { run = { is_other } })
    assert.equal("one event a step", result.premises)
  end)

  it("that is added or taken away leaves it open", function()
    local function is_set(tr) return tr.src._parent.m ~= nil end
    local function set(fsm) fsm.m = 1 end
    local function unset(fsm) fsm.d.n = nil end
    local _, untried = judge(function() return counting(set, is_set) end,
      { run = { set, is_set } })
    assert.equal("the field 'm', which vars does not name", untried)
    _, untried = judge(function() return counting(unset, is_set) end,
      { run = { unset, is_set } })
    assert.equal("the field 'd.n', which vars does not name", untried)
  end)

  it("that changes with others is named first if its key is, on every Lua", function()
    local function set(fsm)
      local d = fsm.d
      d.f, d.e, d.d, d.c, d.b, d.n = 1, 1, 1, 1, 1, nil
    end
    local _, untried = judge(function() return counting(set) end, { run = { set } })
    assert.equal("the field 'd.b', which vars does not name", untried)
    local function clear(fsm)
      local d = fsm.d
      d.f, d.e, d.d, d.c, d.b = nil, nil, nil, nil, nil
    end
    _, untried = judge(function()
      return counting(clear, nil, { d = { f = 1, e = 1, d = 1, c = 1, b = 1 } })
    end, { run = { clear } })
    assert.equal("the field 'd.b', which vars does not name", untried)
  end)
end)

describe("callbacks that are not run", function()
  local field, others = "n", { insert = table.insert }
  local function is_three(tr) return tr.src._parent.n >= 3 end
  local shared = 0
  local function is_shared(tr) return shared + tr.src._parent.n >= 3 end
  local function set(fsm) fsm.n = 3 end
  local class = { __index = { set = set } }
  local deep = { object = setmetatable({}, class), list = { set = set } }
  local WRITERS = {
    set,
    function(fsm) deep.object:set(fsm) end,
    function(fsm) pcall(deep.list.set, fsm) end,
    function(fsm) deep["list"].set(fsm) end,
    function(fsm) fsm.n, others[tostring(1)] = 3, 1 end,
    function(fsm) fsm["n"] = 3 end,
    function(fsm) fsm[field] = 3 end,
    function(fsm) fsm["" .. "n"] = 3 end,
    function(fsm) rawset(fsm, "n", 3) end,
    function(fsm) fsm.m, fsm.n = 1, 3 end,
    function(fsm) fsm.n, fsm.m = 3, 1 end,
    function(fsm) set(fsm) end,
    function(fsm) others.insert(fsm.n, 3) end,
  }

  it("and may write data leave it open", function()
    for i, effect in ipairs(WRITERS) do
      local holds, _, result = judge(function() return counting(effect, is_three) end,
        { run = { is_three }, vars = { n = { 0, 3 } } })
      assert.is_nil(holds, i)
      assert.equal("data that the effect root.trans[2] may write, which is not run",
        result.untried[#result.untried])
    end
    local holds = judge(function() return counting(function() shared = 3 end, is_shared)
      end, { run = { is_shared } })
    assert.is_nil(holds)
  end)

  it("are entries, doos and free guards, too", function()
    for _, callback in ipairs { "entry", "exit", "doo" } do
      local holds, untried = judge(function()
        return counting(nil, is_three, { a = state { [callback] = set } })
      end, { run = { is_three } })
      assert.is_nil(holds)
      assert.matches("^data that the " .. callback .. " root%.a may write", untried)
    end
    local _, untried = judge(function()
      return counting(nil, is_three, { [4] = go("a", "b", "e_z", { guard = set }) })
    end, { run = { is_three } })
    assert.matches("^data that the guard root%.trans%[4%] may write", untried)
  end)

  it("are step hooks, and what replaces a callback that is called", function()
    local function replace(fsm) fsm[3].guard = nil end
    for name, members in pairs { -- any order: each stands alone
      ["post_step_hook"] = { post_step_hook = set },
      ["pre_step_hook"] = { pre_step_hook = set },
      ["entry root.a"] = { a = state { entry = replace } },
    } do
      local holds, untried = judge(function() return counting(nil, is_three, members)
        end, { run = { is_three } })
      assert.is_nil(holds)
      assert.equal("data that the " .. name .. " may write, which is not run", untried)
    end
  end)

  it("and write other things are a premise", function()
    local seen = {}
    local function note(_, _, events)
      local n = 3
      local own = { n = n, [1] = n }
      seen[events], own[n] = own, n == 3
      return seen
    end
    local holds, _, result = judge(function()
      return counting(note, is_three, { a = state { entry = note } })
    end, { run = { is_three } })
    assert.is_true(holds)
    assert.equal("one event a step; 2 callbacks not run", result.premises)
  end)

  it("and are named like a file of this library are read, too", function()
    local text = ("return function(fsm) fsm.n = 3 end")
    local core = debug.getinfo(rfsm.init, "S").source:match("^@(.*)%.lua$")
    for name, is_read in pairs { ["_robot.lua"] = true, ["_checks.lua"] = false,
      ["/x.lua"] = false } do -- any order: each stands alone
      local file = "@" .. core .. name
      local callback = assert(load_text(text, file))()
      assert.equal(not is_read, writes.is_known(callback))
    end
  end)

  it("do not set targets either", function()
    local key = "tgt"
    local EFFECTS = { function(_, tr) rawset(tr, "tgt", 1) end,
      function(_, tr) tr[key] = 1 end }
    for i = 1, 2 do
      local effect = EFFECTS[i]
      local _, untried = judge(function() return counting(effect, is_three) end,
        { run = { is_three } })
      assert.equal("transitions that the effect root.trans[2] may change or add",
        untried)
    end
  end)
end)

-- (initial) -> a --e_x--> b, whose effect is a part of this text; then to bad on e_y.
local TEXT = [[
local rfsm = require "rfsm"
return rfsm.state { info = false, warn = false, n = 0,
  a = rfsm.state {}, b = rfsm.state {}, bad = rfsm.state { final = true },
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_x" },
    effect = function(fsm) fsm.n = 3 end },
  rfsm.trans { src = "b", tgt = "bad", events = { "e_y" },
    guard = function(tr) return tr._fsm.n %s 3 end },
}]]

describe("a callback whose text is not known", function()
  local function load_as(text, name) return assert(load_text(text, name))() end

  local function stripped(text)
    return load_text(string.dump(assert(load_text(text)), true))()
  end

  local UNKNOWN = "what the effect root.trans[2] does, which no text shows, and "
    .. "%d more callbacks"

  -- The verdict on `never root.bad` if the guard is run, and what was not tried.
  local function judged(model, options)
    options = options or { vars = { n = { 0, 3 } }, run = { "guard root.trans[3]" } }
    options.properties = { never "root.bad" }
    local result = rfsm_checks.explore(model, options)
    return result.properties[1].holds, result.untried[#result.untried], result
  end

  it("may do anything, so that nothing holds", function()
    local text = TEXT:format ">="
    local MODELS = { ["=chart"] = load_as(text, "=chart"), named = load_as(text, "x"),
      ["@chart"] = load_as(text, "@no/chart.lua"), other = load_as(text, "@rfsm.lua"),
      dumped = stripped(text) }
    local keeps_text = _VERSION == "Lua 5.1" or _VERSION == "Lua 5.2" -- in string.dump
    if keeps_text and not rawget(_G, "jit") then MODELS.dumped = nil end
    for name, model in pairs(MODELS) do -- any order: each stands alone
      local holds, untried, result = judged(model)
      assert.same({ name, nil, UNKNOWN:format(1) }, { name, holds, untried })
      assert.equal("texts", result.bound)
      assert.equal("one event a step; 1 callback not run", result.premises)
    end
  end)

  it("shows what does not hold if it is run", function()
    local model = load_as(TEXT:format ">=", "=chart")
    local holds = judged(model, { vars = { n = { 0, 3 } },
      run = { "guard root.trans[3]", "effect root.trans[2]" } })
    assert.is_false(holds)
  end)

  it("is known if its chunk has its text for a name, or is that of stdin", function()
    local text = TEXT:format ">="
    writes.keep_text("=stdin", text)
    for _, name in ipairs { text, "=stdin" } do
      local _, untried = judged(load_as(text, name))
      assert.equal("data that the effect root.trans[2] may write, which is not run",
        untried)
    end
  end)

  it("may be called by another one, be a whole chunk, or be of C", function()
    local call = load_as("return function(fsm) fsm.n = 3 end", "=helper")
    local host = coroutine.wrap(function() end)
    local EFFECTS = { function(fsm) call(fsm) end, host,
      setmetatable({}, { __call = call }), assert(load_text("x = 1", "=chunk")) }
    for i, effect in ipairs(EFFECTS) do
      local _, untried = judged(counting(effect), {})
      assert.equal("what the effect root.trans[2] does, which no text shows",
        untried, i)
    end
  end)

  local set = function(fsm) fsm.n = 3 end

  it("is not known either if it calls what it does not name", function()
    local list, arm = { set }, { set = set }
    local EFFECTS = {
      function(fsm) fsm.set(fsm) end, function(fsm) fsm:set() end,
      function(_, tr) tr.set(tr) end, function(fsm) list[1](fsm) end,
      function(fsm) for _, f in ipairs(list) do f(fsm) end end,
      function(fsm) for _, f in ipairs(list) do pcall(f, fsm) end end,
      function(fsm) local own = arm own.set(fsm) end,
      function(fsm) local f = arm.set f "x" return fsm end,
      function(fsm) (fsm and arm).set(fsm) end,
      function(fsm) arm["s" .. "et"](fsm) end,
      function(fsm) require "rfsm.shared.code".of(fsm) end,
      setmetatable({ set = set }, { __call = function(own, fsm) own.set(fsm) end }),
    }
    for i, effect in ipairs(EFFECTS) do
      local model = counting(effect, nil, { [3] = go("a", "b", "e_y") })
      local holds, _, result = judged(model, { vars = { n = { 0, 3 } } })
      assert.same({ i, nil }, { i, holds })
      assert.matches("what the effect root.trans[2] does, which no text shows",
        table.concat(result.untried, "; "), 1, true)
      result = rfsm_checks.explore(model, {}) -- no data are followed
      assert.same({ i }, { i, result.untried[1] })
      assert.matches("; calls that no text names change no transition", result.premises)
    end
  end)

  it("is that of a class, too, if it is used", function()
    local class = {}
    local function is_three(tr) return tr._fsm.n >= 3 end
    for _, name in ipairs { "__call", "__index", "__newindex" } do
      class[name] = function(_, fsm) set(fsm) end
    end
    local arm = setmetatable({}, class)
    local EFFECTS = { function(fsm) arm(fsm) end,
      function(fsm) return fsm, arm.x end, function(fsm) arm.x = fsm end }
    for i, effect in ipairs(EFFECTS) do
      local holds, untried = judged(counting(effect, is_three), { run = { is_three },
        vars = { n = { 0, 3 } } })
      assert.same({ i, nil, "data that the effect root.trans[2] may write, which is "
        .. "not run" }, { i, holds, untried })
    end
  end)

  it("is harmless if it is of Lua or of this library, or calls C", function()
    local host = coroutine.wrap(function() end)
    local monitor = require "rfsm.monitor"
    local EFFECTS = { print, rfsm.prepare, function() host() end,
      function(fsm) fsm.d.n = #tostring(fsm) end,
      function(fsm, tr)
        local function double(x) return 2 * x end
        fsm.emit "e_told"
        print(("%d"):rep(double(2)), tr:type() .. " of " .. tostring(fsm):upper())
        print(string.format("%s", _G.no_robot and _G.no_robot.arm.move(fsm)))
      end,
      assert(load_text("\nlocal x = 1\nreturn x")),
      monitor.gen_monitor_state { montab = {} }.doo }
    for i, effect in ipairs(EFFECTS) do
      local model = counting(effect, nil, { [3] = go("a", "b", "e_y") })
      local holds, untried = judged(model, {})
      assert.same({ i, true }, { i, holds, untried })
    end
  end)
end)

describe("a run that data which are not followed may forbid", function()
  local function is_below(tr) return tr._fsm.n < 3 end
  local function set(fsm) fsm.n = 3 end

  -- (initial) -> a --e_x--> b --e_y--> bad, where the guard of the last one is run.
  local function verdict_of(members, property)
    local all = { n = 0, bad = state { final = true }, [2] = go("a", "b", "e_x"),
      [3] = go("b", "bad", "e_y", { guard = is_below }) }
    for key, value in pairs(members) do all[key] = value end
    local _, line, result = verdict(chart(all), property or never "root.bad",
      { vars = { n = { 0, 3 } }, run = { is_below } })
    local codes = {}
    for i, finding in ipairs(result.findings) do codes[i] = finding.code end
    return line:match("^p: [^%[(]*%w"), table.concat(codes, " ")
  end

  it("is no witness", function()
    local text = TEXT:format "<"
    local result = rfsm_checks.explore(assert(load_text(text, "=chart"))(), {
      vars = { n = { 0, 3 } }, run = { "guard root.trans[3]" },
      properties = { never "root.bad" } })
    assert.is_nil(result.properties[1].holds)
    local CASES = {
      { [2] = go("a", "b", "e_x", { effect = set }) }, { b = state { entry = set } },
      { a = state { exit = set } },
      { b = state { doo = set }, [3] = go("b", "bad", "e_done", { guard = is_below }) },
      { [2] = go("a", "b", "e_x", { guard = set }) },
    }
    for i, members in ipairs(CASES) do
      assert.same({ i, "p: not known", "" }, { i, verdict_of(members) })
    end
  end)

  it("is no witness of a dead end, or of what never comes", function()
    local function is_set(tr) return tr._fsm.n == 3 end
    local members = { [2] = go("a", "b", "e_x", { effect = set }),
      [3] = go("b", "a", "e_done", { guard = is_set }) }
    for _, property in ipairs { rfsm_checks.after("e_x").reach "root.a",
      rfsm_checks.after("e_x").leads_to "root.a" } do
      local _, line, result = verdict(chart { n = 0, [2] = members[2],
        [3] = members[3] }, property, { vars = { n = { 0, 3 } }, run = { is_set } })
      assert.same({ "p: not known", 0 }, { line, #result.findings })
    end
  end)

  it("is a witness if the guard is asked before, or is free", function()
    assert.same({ "p: does not hold", "violated" }, { verdict_of {
      bad = state { final = true, entry = set } } })
    assert.same({ "p: does not hold", "violated" }, { verdict_of { [3] = go("b", "bad",
      "e_y"), [2] = go("a", "b", "e_x", { effect = set }),
      [4] = go("b", "a", "e_z", { guard = is_below }) } })
  end)

  it("is no witness if a callback may have changed its transitions", function()
    local function retarget(fsm) fsm[3].tgt = fsm.a end
    local holds = verdict(chart { bad = state { final = true }, [3] = go("b", "bad",
      "e_y"), [2] = go("a", "b", "e_x", { effect = retarget }) }, never "root.bad", {})
    assert.is_nil(holds)
    holds = verdict(chart { bad = state { final = true }, [3] = go("b", "bad", "e_y",
      { effect = retarget }) }, never "root.bad", {})
    assert.is_false(holds)
  end)
end)

describe("a doo that is run", function()
  local function is_set(tr) return tr.src._parent.m == 1 end

  local function make(doo)
    return function()
      return chart { m = 0, a = state { doo = doo }, bad = state {},
        [2] = go("a", "bad", "e_y", { guard = is_set }),
        [3] = go("a", "b", "e_done") }
    end
  end

  it("ends, and its data are followed", function()
    local function set(fsm) fsm.m = 1 end
    assert.is_false((judge(make(set), { run = { "doo root.a", is_set },
      vars = { m = { 0, 1 } } })))
    local holds, untried = judge(make(set), { run = { set, is_set } })
    assert.is_nil(holds)
    assert.equal("the field 'm', which vars does not name", untried)
    local function unset(fsm) fsm.m = 0 end
    local is_never, _, result = judge(make(unset), { run = { unset, is_set } })
    assert.is_true(is_never)
    assert.equal("one event a step", result.premises)
  end)

  it("is not known to go on", function()
    local function wait(fsm)
      rfsm.yield(true)
      fsm.m = 1
    end
    local holds, untried = judge(make(wait), { run = { wait, is_set } })
    assert.is_nil(holds)
    assert.equal("how the doo root.a goes on", untried)
  end)
end)

describe("a callback that is run", function()
  local named = rfsm.named

  -- The verdict on `never root.bad` in a chart a --named "e_pay"--> bad, its premises,
  -- what was not tried, and whether bad is said to be unreachable.
  local function judged(members, options)
    local all = { n = 0, bad = state { final = true }, [3] = go("b", "a", "e_x"),
      [2] = go("a", "bad", named "e_pay", members[2]) }
    for key, value in pairs(members) do all[key] = key ~= 2 and value or all[2] end
    options.properties = { never "root.bad" }
    local result = rfsm_checks.explore(chart(all), options)
    local is_unreachable = false
    for _, finding in ipairs(result.findings) do
      is_unreachable = is_unreachable or finding.code == "unreachable"
        and finding.place == "root.bad"
    end
    return { result.properties[1].holds, is_unreachable, result.premises,
      result.untried[1] }
  end

  local Payment = {}
  function Payment:is_enough(events) return self and events[1].amount > 10 end

  it("is free if it is a guard that reads the data of events", function()
    local check = setmetatable({}, { __call = function(_, _, events)
      return type(events[1]) == "table"
    end })
    local GUARDS = {
      function(_, events) return events[1].amount > 10 end,
      function(_, events)
        return (type(events[1]) == "table" and events[1].amount or 0) > 10
      end,
      function(_, list)
        for _, event in ipairs(list) do
          if type(event) == "table" and event.amount > 10 then return true end
        end
        return false
      end,
      function(...) return type((select(2, ...))[1]) == "table" end,
      Payment.is_enough, check,
      function(_, events) return _G.no_robot.is_ready(events) end,
    }
    for i, guard in ipairs(GUARDS) do
      assert.same({ i, false, false, "one event a step; guards free" },
        { i, unpack(judged({ [2] = { guard = guard } },
          { run = { "guard root.trans[2]" } })) })
    end
  end)

  it("is free if it is a guard that fails away from its robot", function()
    local function is_ready() return rawget(_G, "no_robot").ready end
    local members = { [2] = { guard = is_ready } }
    assert.same({ false, false, "one event a step; guards free" },
      judged(members, { run = { is_ready } }))
  end)

  it("is known if it is a guard that reads names, or no events", function()
    local function never_now(tr) return tr._fsm.n > 10 end
    local function is_x(_, events) return events[1] == "e_x" end
    assert.same({ true, true, "one event a step" },
      judged({ [2] = { guard = never_now } }, { run = { never_now } }))
    local holds = verdict(chart { bad = state {}, [3] = go("b", "bad", "e_y",
      { guard = is_x }), [4] = go("bad", "a", "e_x") }, never "root.bad",
      { run = { is_x } })
    assert.is_true(holds)
    holds = verdict(chart { bad = state {}, [3] = go("b", "bad", nil,
      { guard = is_x }), [4] = go("bad", "a", "e_x") }, never "root.bad",
      { run = { is_x } })
    assert.is_false(holds)
  end)

  it("is known if it is an effect that reads no event, or one without data", function()
    local function is_ten(tr) return tr._fsm.n >= 10 end
    local function fill(fsm) fsm.n = 20 end
    local function fill_by(fsm, _, _, events)
      fsm.n = events[1] == "e_fill" and 20 or 0
    end
    for i, case in ipairs { { fill, named "e_pay" }, { fill_by, "e_fill" } } do
      local result = judged({ [2] = { guard = is_ten },
        [3] = go("a", "internal", case[2], { effect = case[1] }) },
        { run = { case[1], is_ten }, vars = { n = { 0, 20 } } })
      assert.same({ i, false }, { i, result[1], result[4] })
    end
  end)

  it("leaves it open if it is an effect or doo that reads data, or fails", function()
    local function is_ten(tr) return tr._fsm.n >= 10 end
    local function add(fsm, _, _, events) fsm.n = fsm.n + events[1].amount end
    local function add_one(fsm, _, _, events)
      fsm.n = type(events[1]) == "table" and events[1].amount or fsm.n
    end
    local function fail(fsm) fsm.n = rawget(_G, "no_robot").n end
    local FAILS, READS = "what the %s does, which fails here",
      "what the %s does with the data of an event"
    local CASES = {
      { "effect", add, FAILS }, { "effect", add_one, READS }, { "effect", fail, FAILS },
      { "entry", fail, FAILS }, { "doo", fail, "how the %s goes on" },
    }
    for i, case in ipairs(CASES) do
      local field, callback = case[1], case[2]
      local is_effect = field == "effect"
      local result = judged({
        a = state { [not is_effect and field or "x"] = callback },
        [2] = { guard = is_ten },
        [3] = go("a", "internal", named "e_pay", is_effect and { effect = callback }) },
        { run = { callback, is_ten }, vars = { n = { 0, 20 } } })
      assert.same({ i, nil, false, case[3]:format(is_effect and "effect root.trans[3]"
        or field .. " root.a") }, { i, result[1], result[2], result[4] })
    end
  end)

  it("is not known to send what it sends in a dry run, if that needs data", function()
    local function send(fsm, _, _, events)
      if events[1] and events[1].amount > 10 then rfsm.send_events(fsm, "e_paid") end
    end
    local function fail(fsm)
      rfsm.send_events(fsm, rawget(_G, "no_robot").ready and "e_paid")
    end
    local function emit(fsm, _, _, events) fsm.emit("e_paid", events[1].amount) end
    local function note(_, _, _, events) return events[1].amount end
    local function dry(effect, sends)
      return judged({ [2] = {}, bad = state {}, paid = state {},
        [3] = go("b", "a", "e_x", { effect = effect }),
        [4] = go("bad", "paid", "e_paid") }, { dry_run = true, alphabet = {},
        sends = sends })[4]
    end
    for i, effect in ipairs { send, fail, emit } do
      assert.same({ i, "events that the effect root.trans[3] may send, which a dry run "
        .. "does not show" }, { i, dry(effect) })
    end
    assert.is_nil(dry(note))
    assert.is_nil(dry(send, { ["effect root.trans[3]"] = { "e_paid" } }))
  end)
end)

describe("guards that stay free", function()
  local function yes() return true end
  local function left() return true end
  local function right() return true end

  -- a goes to k on e_x; from there to b if left, then to c if right.
  local function fork()
    return chart { k = rfsm.conn {}, c = state {}, d = state {},
      [2] = go("a", "k", "e_x", { guard = left }), [3] = go("k", "b", nil,
        { guard = right }), [4] = go("a", "c", "e_x", { guard = right, pn = -1 }),
      [5] = go("a", "d", "e_x", { pn = -2 }), [6] = go("d", "a", "e_x"),
      [7] = go("c", "a", "e_x"), [8] = go("b", "a", "e_x") }
  end
  local CASES = {
    { options = {}, b = false, c = false, d = false, text = "guards free" },
    { options = { exclusive = { left, right } }, b = true, c = false, d = false,
      text = "2 guards exclusive; guards free" },
    { options = { complementary = { { left, right } } }, b = true, c = false, d = false,
      text = "2 guards complementary; guards free" },
    { options = { same = { left } }, b = false, c = false, d = false,
      text = "1 guard the same in a step; guards free" },
  }
  for i, case in ipairs(CASES) do
    it(("are ruled (%d)"):format(i), function()
      for _, name in ipairs { "b", "c", "d" } do
        local options = {}
        for key, value in pairs(case.options) do options[key] = value end
        assert.equal(case[name], (verdict(fork(), never("root." .. name), options)))
      end
      case.options.properties = { p = rfsm_checks.always "root" }
      assert.equal("one event a step; " .. case.text,
        rfsm_checks.explore(fork(), case.options).premises)
    end)
  end

  it("are asked once, if they are the same", function()
    local model = chart { c = state {}, [2] = go("a", "b", "e_x", { guard = yes }),
      [4] = go("a", "c", "e_x", { guard = yes }), [5] = go("c", "a", "e_x") }
    assert.is_false((verdict(model, never "root.c", {})))
    assert.is_true((verdict(model, never "root.c", { same = { yes } })))
  end)

  local WRONG_RANGE = "rfsm_checks.explore: vars: tries: { least, most }, list of "
    .. "texts or 'boolean' expected, got table"

  it("refuse other options", function()
    local CASES_OF_ERRORS = {
      { options = { vars = { tries = 3 } }, text = "rfsm_checks.explore: vars: tries: "
        .. "{ least, most }, list of texts or 'boolean' expected, got 3" },
      { options = { vars = { tries = { "none", 3 } } }, text = WRONG_RANGE },
      { options = { vars = { tries = { 3, "many" } } }, text = WRONG_RANGE },
      { options = { vars = { tries = { 3 } } }, text = WRONG_RANGE },
      { options = { vars = { tries = { 3, 0 } } }, text = WRONG_RANGE },
      { options = { vars = { tries = { 0, 3, 6 } } }, text = WRONG_RANGE },
      { options = { vars = { "tries" } }, text = "rfsm_checks.explore: vars: name of a "
        .. "field expected, got 1" },
      { options = { vars = { tries = { 0, 3 } } }, text = "vars: no field is named "
        .. "'tries'" },
      { options = { vars = { a = { 0, 3 } } }, text = "vars: 'a' is a state (name a "
        .. "field of it, such as 'a.n')" },
      { options = { run = { 7 } }, text = "rfsm_checks.explore: run: list of callbacks "
        .. "expected, got table" },
      { options = { run = {} }, text = "rfsm_checks.explore: run: list of callbacks "
        .. "expected, got table" },
      { options = { run = { "entry root.b" } }, text = "run: no callback 'entry root.b'"
        .. " (did you mean 'entry root.a'?)" },
      { options = { run = { "x" } }, text = "run: no callback 'x' (there is "
        .. "'entry root.a')" },
      { options = { same = { "entry root.a" } }, text = "same: no guard "
        .. "'entry root.a'" },
      { options = { run = { yes } }, text = "run: function 1 is no callback of the "
        .. "chart" },
      { options = { same = { { yes }, { 7 } } }, text = "rfsm_checks.explore: same: "
        .. "list of guards expected, got table" },
      { options = { exclusive = { left, right } }, text = "exclusive: function 1 is no "
        .. "guard of the chart" },
    }
    for _, case in ipairs(CASES_OF_ERRORS) do
      local ok, text = pcall(rfsm_checks.explore, chart { a = state {
        entry = function() end } }, case.options)
      assert.is_false(ok)
      assert.equal(case.text, (helper.without_file(text):gsub("^%S+:%d+: ", "")))
    end
  end)
end)

describe(claim.name, function()
  it("holds for random charts", function()
    assert.is_nil(share.problem(claim, 30, true))
  end)
end)
