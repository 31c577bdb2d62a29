local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsmpp = require "rfsmpp"

local state, trans = rfsm.state, rfsm.trans
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

-- Stand in for the package ansicolors, and for the older module of that name: what they
-- would write, as <green><bright>.
local function tag(names) return (names:gsub("(%a+) ?", "<%1>")) end

local PACKAGE = { noReset = function(text) return tag(text:match("%%{(.-)}")) end }

local OLDER = {}
for name in ("reset bright red green yellow blue magenta cyan white"):gmatch("%a+") do
  OLDER[name] = setmetatable({}, {
    __metatable = {}, __tostring = function() return tag(name) end,
  })
end

-- Runs f(rfsmpp) with an rfsmpp that was loaded with `colours` as the module ansicolors
-- and with these variables in the environment.
local function with(colours, variables, f)
  local result
  helper.with(package.loaded, { ansicolors = colours or false }, function()
    local preload = { ansicolors = function() error("not installed") end }
    helper.with(package.preload, preload, function()
      helper.with(os, { getenv = function(name) return variables[name] end }, function()
        helper.with(_G, { rfsmpp = rfsmpp }, function()
          result = f(dofile("rfsmpp.lua"))
        end)
      end)
    end)
  end)
  return result
end

local XTERM = { TERM = "xterm" }

-- The lines that a hook of gen_dbgcolor prints of one record, joined.
local function printed(pp, record, ...)
  local lines = {}
  local dbg = pp.gen_dbgcolor("arm", nil, nil, function(line)
    lines[#lines + 1] = line
  end)
  dbg(record, ...)
  return table.concat(lines, "\n")
end

-- initial -> a{ x } , b
local function machine()
  return helper.init(state {
    a = state { x = state {}, trans { src = "initial", tgt = "x" } },
    b = state { doo = function() rfsm.yield(true) end },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = "e" },
  })
end

describe("colour", function()
  local COLOURED = "<cyan><bright>arm:<reset>\t<blue>DOO                 <reset>root.a"
  local PLAIN = "arm:\tDOO                 root.a"

  for _, case in ipairs {
    { "comes from the package ansicolors", PACKAGE, XTERM, COLOURED },
    { "comes from the older module ansicolors", OLDER, XTERM, COLOURED },
    { "is missing without either", nil, XTERM, PLAIN },
    { "is missing if NO_COLOR is set", PACKAGE, { TERM = "xterm", NO_COLOR = "1" },
      PLAIN },
    { "is there if NO_COLOR is empty", PACKAGE, { TERM = "xterm", NO_COLOR = "" },
      COLOURED },
    { "is missing if TERM is dumb", PACKAGE, { TERM = "dumb" }, PLAIN },
    { "is missing if TERM is missing", PACKAGE, {}, PLAIN },
  } do
    it(case[1], function()
      assert.equal(case[4], with(case[2], case[3], function(pp)
        assert.equal(case[4], pp.dbgcolorize("arm", "DOO", "root.a"))
        return printed(pp, "DOO", "root.a")
      end))
    end)
  end

  it("of a dbg function is decided when it is made, without a process", function()
    local variables, text = { TERM = "xterm" }, nil
    local function fail() error("a process") end
    helper.with(io, { popen = fail }, function()
      helper.with(os, { execute = fail }, function()
        with(PACKAGE, variables, function(pp)
          local dbg = pp.gen_dbgcolor("arm", nil, nil, function(made) text = made end)
          variables.NO_COLOR = "1"
          dbg("DOO", "root.a")
        end)
      end)
    end)
    assert.equal(COLOURED, text)
  end)

  for id, colour in pairs { -- any order
    STATE_ENTER = "green", STATE_EXIT = "red", EFFECT = "yellow", DOO = "blue",
    EXEC_PATH = "cyan", ERROR = "red bright", HIBERNATING = "magenta",
    RAISED = "white bright", TIMEEVENT = "yellow bright", CHECKING = "",
  } do
    it("of " .. id .. " is " .. colour, function()
      local padded = id .. (" "):rep(20 - #id)
      local expected = colour == "" and padded or tag(colour) .. padded .. "<reset>"
      assert.equal("<cyan><bright>arm:<reset>\t" .. expected,
        with(PACKAGE, XTERM, function(pp) return printed(pp, id) end))
    end)
  end
end)

describe("a record", function()
  local bad = setmetatable({}, { __tostring = function() error("no") end })
  local loop = { 1 }
  loop[2] = loop
  local fsm = machine()

  for _, case in ipairs {
    { "1 nil false 0.5", n = 5, 1, nil, false, 0.5 },
    { 'e {1,"x",k={a=true}}', "e", { 1, "x", k = { a = true } } },
    { '{"a \\"b\\"\\nc",[3]=3,["a b"]=2,z=1}',
      { "a \"b\"\nc", [3] = 3, ["a b"] = 2, z = 1 } },
    { "root.b T={ src='root.a', tgt='root.b', events='e' }", fsm.b, fsm[2] },
    { "table", bad },
  } do
    it("shows its arguments: " .. case[1], function()
      local line = with(nil, {}, function(pp)
        return printed(pp, "X", unpack(case, 2, case.n or #case))
      end)
      assert.equal("arm:\tX" .. (" "):rep(19) .. case[1], line)
    end)
  end

  it("shows three tables inside each other, and twenty fields", function()
    local list = {}
    for i = 1, 21 do list[i] = i end
    local line = with(nil, {}, function(pp)
      return printed(pp, "X", { a = { { {} } } }, list)
    end)
    assert.matches("X                   {a={{table: [%w]+}}} {1,2,.*,20,...}$", line)
  end)

  it("shows a table that contains itself", function()
    local line = with(nil, {}, function(pp) return printed(pp, "X", loop) end)
    assert.matches("^arm:\tX                   {1,table: [%w]+}$", line)
  end)

  it("shows an event with data as all tools do, and other tables with their contents",
    function()
      local event, lines = { name = "e_paid", amount = 12 }, {}
      for i, id in ipairs { "RAISED", "WORD" } do
        lines[i] = with(nil, {}, function(pp) return printed(pp, id, event, { 1 }) end)
      end
      assert.same({ "arm:\tRAISED              e_paid{amount=12} {1}",
        'arm:\tWORD                {amount=12,name="e_paid"} {1}' }, lines)
    end)

  it("has no blank between a long id and its arguments, and no name if there is none",
    function()
      assert.equal(("I"):rep(25) .. "a b", with(nil, {}, function(pp)
        return pp.dbgcolorize(nil, ("I"):rep(25), "a", "b")
      end))
    end)

  it("is printed by dbgcolor", function()
    local lines = helper.printed(function() rfsmpp.dbgcolor("arm", "DOO", "root.a") end)
    assert.same({ rfsmpp.dbgcolorize("arm", "DOO", "root.a") }, lines)
  end)
end)

describe("gen_dbgcolor", function()
  for _, case in ipairs { -- ids, defshow, which of DOO and EFFECT are printed
    { nil, nil, "DOO EFFECT" }, { { DOO = true }, false, "DOO" },
    { { DOO = true }, true, "DOO EFFECT" }, { { DOO = false }, true, "EFFECT" },
    { { DOO = false }, nil, "EFFECT" }, { {}, false, "" },
  } do
    it(("prints '%s' with defshow %s"):format(case[3], tostring(case[2])), function()
      local ids = {}
      local dbg = rfsmpp.gen_dbgcolor("m", case[1], case[2], function(line)
        ids[#ids + 1] = line:match("DOO") or line:match("EFFECT")
      end)
      dbg("DOO")
      dbg("EFFECT")
      assert.equal(case[3], table.concat(ids, " "))
    end)
  end

  it("uses the print of the moment, and a name for a machine without", function()
    local lines = helper.printed(function() rfsmpp.gen_dbgcolor()("DOO") end)
    assert.matches("<unnamed SM>:", lines[1])
  end)

  it("blames the caller", function()
    assert.equal("rfsmpp.gen_dbgcolor: function expected, got string",
      helper.refusal(rfsmpp.gen_dbgcolor, "m", {}, true, "print"))
    assert.equal("rfsmpp.gen_dbgcolor: table of ids expected, got string",
      helper.refusal(rfsmpp.gen_dbgcolor, "m", "DOO"))
  end)

  it("traces a machine", function()
    local lines, fsm = {}, machine()
    fsm.dbg = rfsmpp.gen_dbgcolor("m", { STATE_ENTER = true }, false, function(line)
      lines[#lines + 1] = line:gsub("\27%[%d+m", "")
    end)
    rfsm.run(fsm)
    assert.same({
      "m:\tSTATE_ENTER         root", "m:\tSTATE_ENTER         root.a",
      "m:\tSTATE_ENTER         root.a.x",
    }, lines)
  end)
end)

describe("fsm2str", function()
  local function tree(fsm, depth, colours)
    return with(colours, XTERM, function(pp) return pp.fsm2str(fsm, depth) end)
  end

  it("draws the states as a tree, sorted by name, with their modes", function()
    assert.equal("root inactive\n    a[CS] inactive\n        x[LS] inactive\n"
      .. "    b[LS] inactive\n", tree(machine()))
  end)

  it("takes the depth of the states in the root", function()
    assert.equal("root inactive\na[CS] inactive\n    x[LS] inactive\nb[LS] inactive\n",
      tree(machine(), 0))
  end)

  it("shows active, done and inactive states by colour", function()
    local fsm = machine()
    rfsm.run(fsm)
    assert.equal("<green>root<reset>\n<green>a<reset>[CS]\n"
      .. "    <yellow>x<reset>[LS]\n<red>b<reset>[LS]\n", tree(fsm, 0, PACKAGE))
    helper.post_and_run(fsm, "e")
    assert.equal("<green>root<reset>\n<red>a<reset>[CS]\n    <red>x<reset>[LS]\n"
      .. "<green><bright>b<reset>[LS]\n", tree(fsm, 0, OLDER))
  end)

  it("draws one line for a state, whatever its name", function()
    local fsm = helper.init(state {
      ["a\nb\27[1m"] = state {}, trans { src = "initial", tgt = "a\nb\27[1m" },
    })
    assert.equal("root inactive\n    a\\10b\\27[1m[LS] inactive\n", tree(fsm))
  end)

  it("wants an initialised fsm", function()
    assert.matches("^rfsmpp.fsm2str: initialised fsm expected",
      helper.refusal(rfsmpp.fsm2str, state {}))
  end)
end)

it("the module has its dotted name and its global", function()
  assert.equal(rfsmpp, require("rfsm.pp"))
  assert.equal(rfsmpp, rawget(_G, "rfsmpp"))
end)
