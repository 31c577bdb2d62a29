-- Data in an exploration: fields that callbacks set, and rules for guards.

local ab = require "spec.support.ab"
local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"

local state = rfsm.state
local never = rfsm_checks.never
local chart, go = ab.chart, ab.go

-- The first result of a property, and its line or witness.
local function verdict(model, property, options)
  options.properties = { p = property }
  local result = rfsm_checks.explore(model, options)
  local judged = result.properties[1]
  return judged.holds, tostring(result):match("\n(p: [^\n]*)"), result
end

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
      { options = { vars = { tries = { 0, 3 } } }, text = "vars: the chart begins with "
        .. "values of the field 'tries' such as nil" },
      { options = { run = { "f" } }, text = "rfsm_checks.explore: run: list of "
        .. "functions expected, got table" },
      { options = { run = {} }, text = "rfsm_checks.explore: run: list of functions "
        .. "expected, got table" },
      { options = { run = { yes } }, text = "run: function 1 is no callback of the "
        .. "chart" },
      { options = { same = { { yes }, { 7 } } }, text = "rfsm_checks.explore: same: "
        .. "list of guards expected, got table" },
      { options = { exclusive = { left, right } }, text = "exclusive: function 1 is no "
        .. "guard of the chart" },
    }
    for _, case in ipairs(CASES_OF_ERRORS) do
      local ok, text = pcall(rfsm_checks.explore, chart(), case.options)
      assert.is_false(ok)
      assert.equal(case.text, (helper.without_file(text):gsub("^%S+:%d+: ", "")))
    end
  end)
end)
