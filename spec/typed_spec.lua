-- Events with data as a person types them, and all hosts that send them.

local LocalView = require "rfsm.web.local_view"
local View = require "rfsm.web.view"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local outline = require "rfsm.observe.outline"
local rfsm = require "rfsm"
local typed = require "rfsm.shared.typed"

local state, trans, named = rfsm.state, rfsm.trans, rfsm.named

describe("a typed event", function()
  for _, case in ipairs {
    { "e_x", "e_x" },
    { "e_after(5)@root.a", "e_after(5)@root.a" },
    { "e_paid{amount=12}", { name = "e_paid", amount = 12 } },
    { 'e_paid {"amount": 12, "by": {"id": 3}}',
      { name = "e_paid", amount = 12, by = { id = 3 } } },
    { '{"name":"e_paid","list":[1,[2],{"a":null}]}',
      { name = "e_paid", list = { 1, { 2 }, {} } } },
    { "e{}", { name = "e" } },
    { "e{1, 2; x = true, ['a b'] = -1.5e3, [7] = 'it'}",
      { name = "e", 1, 2, x = true, ["a b"] = -1500, [7] = "it" } },
    { "e{1 2}", nil, "data: ',' or '}' expected, got '2}'" },
    { [[e{'\u00fc\ud83d\ude00\10\\n"', "\""}]],
      { name = "e", "\195\188\240\159\152\128\n\\n\"", '"' } },
    { "e{a = os.exit()}", nil,
      "data: field 'a': a text in quotes, a number, true, false or a table expected, "
        .. "got 'os.exit()' (did you mean \"os.exit()\"?)" },
    { "e{code=1, customer=c1}", nil, "data: field 'customer': a text in quotes, a "
      .. "number, true, false or a table expected, got 'c1' (did you mean \"c1\"?)" },
    { "e{list={John Smith}}", nil, "data: a text in quotes, a number, true, false or a "
      .. "table expected, got 'John Smith}}'" },
    { "e{a = 1e999}", nil, "data: field 'a': a text in quotes, a number, true, false "
      .. "or a table expected, got '1e999'" },
    { "e{a = 12345678901234567890}", nil,
      "data: a whole number below 2^53 expected, got '12345678901234567890'" },
    { "e{a = -9007199254740991, b = 1e20}",
      { name = "e", a = -9007199254740991, b = 1e20 } },
    { "e{a = ", nil, "data: field 'a': a text in quotes, a number, true, false or a "
      .. "table expected, got the end" },
    { "e{a = 1}}", nil, "data: the end expected, got '}'" },
    { 'e{a = "b}', nil, "data: the end of a text in quotes expected, got 'b}'" },
    { "e{" .. ("{"):rep(9) .. ("}"):rep(10), nil,
      "data: at most 9 tables inside each other expected, got '}}}}}}}}}}'" },
    { "e{name = 'f'}", nil,
      "data: 'name' is the name of the event, not a field of its data" },
    { "{amount = 12}", nil, "data: a text 'name' expected, got none" },
  } do
    it("is a text, a table, or refused in one line: " .. case[1], function()
      local event, problem = typed.read(case[1])
      assert.same({ case[2], case[3] }, { event, problem })
    end)
  end

  for text, shown in pairs { -- any order: each stands alone
    ['{"name":"e_paid","amount":12}'] = "e_paid{amount=12}",
    ['{"x":"a } b","name":"e_x"} (waits)'] = 'e_x{x="a } b"} (waits)',
    ['e_a {"name":"e_b"} {"name":"e_c","n":{"m":1}}'] = "e_a e_b{} e_c{n={m=1}}",
    ["e_x{y"] = "e_x{y", ['{"name":7}'] = '{"name":7}', ["e_x"] = "e_x",
    ['(hold: {"name":"e_x"}) by ann'] = '(hold: {"name":"e_x"}) by ann',
  } do
    it("is shown in a history: " .. shown, function()
      assert.equal(shown, typed.shown(text))
    end)
  end

  it("is one word of a line", function()
    assert.same({ "e_a", "e_paid{a = 1, b = {2}}", "e_b {c=3}", "7" },
      typed.split " e_a, e_paid{a = 1, b = {2}} e_b {c=3} ,7")
  end)
end)

-- a -e_paid{..}-> b -e_x-> a
local function machine()
  local fsm = helper.init(state { info = false, warn = false,
    a = state {}, b = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { named "e_paid" } },
    trans { src = "b", tgt = "a", events = { "e_x" } } })
  rfsm.run(fsm)
  return fsm
end

local function clock() return 0 end

describe("the page", function()
  local paid = { name = "e_paid", amount = 12 }
  local local_view = LocalView.new(machine(), clock)
  local remote_view = View.create(View, marsh.jsontab(machine()), clock)

  for where, view in pairs { here = local_view, elsewhere = remote_view } do -- any
    it("sends a table for the button of a name, to a machine " .. where, function()
      assert.is_true(view.outline.events[1].has_data)
      assert.same({ name = "e_paid" }, (view:event_of { event = 0 }))
      assert.same(paid, (view:event_of { event = 0, data = '{"amount": 12}' }))
    end)

    it("sends data that are typed, to a machine " .. where, function()
      assert.same(paid, (view:event_of { event = "e_paid", data = "amount = 12" }))
      assert.same(paid, (view:event_of { event = "e_paid{amount=12}" }))
      assert.same({ "e_x", "e_x" }, { view:event_of { event = "e_x", data = " " },
        (view:event_of { event = 1, data = "" }) })
    end)
  end

  it("refuses data that cannot be read, in one line", function()
    local event, problem = local_view:event_of { event = 0, data = "amount 12" }
    assert.same({ nil, "data: a text in quotes, a number, true, false or a table "
      .. "expected, got 'amount 12'" }, { event, problem })
    assert.same({ nil, "data: text expected" },
      { local_view:event_of { event = 0, data = 7 } })
  end)

  it("has the cure for a text in place of a name, and the reverse", function()
    local lists = local_view.outline
    assert.equal("no transition names 'e_paid' (did you mean 'e_paid{}'?)",
      outline.hint_for(lists, "e_paid"))
    assert.equal("no transition names 'e_x{..}' (did you mean 'e_x'?)",
      outline.hint_for(lists, { name = "e_x" }))
    assert.is_nil(outline.hint_for(lists, { name = "e_paid", amount = 1 }))
  end)

  it("shows the data of an event in its log", function()
    assert.same({ "e_paid{amount=12}" }, local_view:texts_of { paid })
  end)
end)
