-- The text of user data is bounded, whoever prints it: three tables inside each other,
-- twenty fields of each, and each table once.

local breakpoints = require "rfsm.observe.breakpoints"
local helper = require "spec.helper"
local LocalView = require "rfsm.web.local_view"
local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
local rfsmpp = require "rfsmpp"

local state, trans = rfsm.state, rfsm.trans

-- Returns the first of `n` tables each of which has all of them.
local function acquainted(n)
  local tables = {}
  for i = 1, n do tables[i] = { name = "e_" .. i } end
  for _, t in ipairs(tables) do
    for i, other in ipairs(tables) do t[i] = other end
  end
  return tables[1]
end

local function nested(levels)
  local t = {}
  for _ = 1, levels do t = { t } end
  return t
end

local function wide(n)
  local t = {}
  for i = 1, n do t[i], t[("k%07d"):format(i)] = i, i end
  return t
end

-- Data that is too much for a line, by what is.
local MUCH = {
  ["tables that know each other"] = acquainted(12),
  ["many levels"] = nested(20000),
  ["many fields"] = wide(30000),
  ["many fields on each level"] = { wide(99), wide(99), x = { wide(99), wide(99) } },
}

-- Returns the text of a value without addresses.
local function text_of(value)
  return (rfsmpp.value_text(value):gsub("table: [%wx]+", "table"))
end

describe("the text of a value", function()
  for text, value in pairs { -- any order: each stands alone
    ["e_a"] = "e_a", ["7"] = 7, ["nil"] = false, ["{}"] = {},
    ['{ 1, "a", [true] = 2, x = { y = 2 } }'] = { 1, "a", x = { y = 2 }, [true] = 2 },
    ['{ [0.5] = 2, [7] = 1, ["a b"] = "c\\n\\"d\\"\\\\\\0" }'] =
      { ["a b"] = 'c\n"d"\\\0', [7] = 1, [0.5] = 2 },
    ["{ { { table } } }"] = { { { { 1 } } } },
    ["{ x = { y = { z = table } } }"] = { x = { y = { z = {} } } },
    ["{ [{ [{ [table] = 1 }] = 2 }] = 3 }"] = { [{ [{ [{}] = 1 }] = 2 }] = 3 },
  } do
    it("is " .. text, function()
      assert.equal(text, text_of(value or nil))
    end)
  end

  it("has a table once", function()
    local once, loop = { 1 }, {}
    loop.me = loop
    assert.equal("{ { 1 }, table, x = table }", text_of { once, once, x = once })
    assert.equal("{ me = table }", text_of(loop))
  end)

  it("has twenty fields of a table", function()
    local list, named = {}, {}
    for i = 1, 20 do list[i], named[("k%02d"):format(i)] = 0, 0 end
    local zeros, names = ("0, "):rep(19) .. "0", text_of(named)
    assert.equal("{ " .. zeros .. " }", text_of(list))
    list[21], list.x = 0, 0
    assert.equal("{ " .. zeros .. ", ... }", text_of(list))
    assert.matches("k20 = 0 }", names, 1, true)
    named.k21 = 0
    assert.equal(names:gsub(" }$", ", ... }"), text_of(named))
  end)

  it("of an element, or of what has a metatable, is its own", function()
    local fsm = helper.init(helper.chart("e"))
    local odd = setmetatable({}, { __tostring = function() return "odd" end })
    assert.equal("{ state root.a (inactive), odd }", text_of { fsm.a, odd })
  end)
end)

describe("too much data", function()
  -- (initial) -> a --[named e_1]--> b, with data in a
  local function machine(fields)
    local model = { warn = false, info = false, a = state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { rfsm.named "e_1" } } }
    for key, value in pairs(fields or {}) do model[key] = value end -- any order: a set
    return helper.started(state(model))
  end

  for title, data in pairs(MUCH) do -- any order: each stands alone
    -- Checks that texts are there, and none is long or different the next time.
    local function check(print_all)
      local text = table.concat(print_all(), "\n")
      assert.is_true(#text > 0 and #text < 100000, #text)
    end

    it("in a trace: " .. title, function()
      check(function()
        local lines = {}
        local fsm = machine()
        fsm.dbg = rfsmpp.gen_dbgcolor("arm", nil, true, function(line)
          lines[#lines + 1] = line
        end)
        helper.post_and_run(fsm, data)
        return lines
      end)
    end)

    it("on the page: " .. title, function()
      check(function()
        local fsm = machine()
        fsm.a.data = data
        local view, number = LocalView.new(fsm), 0
        while view:inspect(number).fqn ~= "root.a" do number = number + 1 end
        local data_of_a = view:inspect(number).data
        view:close()
        assert.matches("^data = { ", data_of_a[1])
        return data_of_a
      end)
    end)

    it("as an event at which the simulator stops: " .. title, function()
      local sim = { points = {} }
      breakpoints.add(sim, data)
      check(function() return { breakpoints.text(sim.points[1]) } end)
    end)

    it("in a warning of a strict machine: " .. title, function()
      local fsm = machine { strict = true }
      local lines, count = helper.said(fsm, "warn"), 0
      function fsm.post_step_hook()
        count = count + 1
        if count < 10100 then rfsm.send_events(fsm, data) end
      end
      rfsm.send_events(fsm, data)
      rfsm.run(fsm)
      check(function() return lines end)
      local text = rfsm.event_text(data, not data.name)
      assert.matches(("event '%s' comes again and again"):format(text), lines[#lines],
        1, true)
    end)

    it("in the steps of a property that is violated: " .. title, function()
      local fsm = machine()
      local lines = helper.said(fsm, "err")
      rfsm_checks.watch_properties(fsm, { rfsm_checks.never "root.b" })
      helper.post_and_run(fsm, data, { name = "e_1", celsius = 7 })
      check(function() return lines end)
      assert.matches("e_1{celsius=7}: root.a -> root.b", lines[1], 1, true)
    end)
  end
end)
