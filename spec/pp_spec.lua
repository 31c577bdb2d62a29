local helper = require "spec.helper"
local rfsm = require "rfsm"
local rfsmpp = require "rfsmpp"

local state, trans = rfsm.state, rfsm.trans

-- Debian has ansicolors for some of the interpreters only.
local has_ansicolors = pcall(require, "ansicolors")

-- Escape sequences written as <31>, <0> ...
local function visible(text)
  return (text:gsub("\27%[(%d+)m", "<%1>"))
end

-- What a dbg function with its own print function makes of records.
local function printed(ids, defshow, ...)
  local lines = {}
  local dbg = rfsmpp.gen_dbgcolor("arm", ids, defshow, function(line)
    lines[#lines + 1] = visible(line)
  end)
  for _, record in ipairs({ ... }) do dbg(record, "root.a") end
  return lines
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

-- Stands in for the package ansicolors: what it would write, as <green bright>.
local false_colours = {
  noReset = function(text) return (text:gsub("%%{(.-)}", "<%1>")) end,
}

-- Runs f(rfsmpp) with an rfsmpp that has been loaded in other surroundings: with
-- `colours` as the package ansicolors, on a terminal or not, with these variables.
local function in_surroundings(colours, is_terminal, variables, f)
  local loaded, getenv, global = package.loaded, os.getenv, rawget(_G, "rfsmpp")
  local real, unistd = loaded.ansicolors, loaded["posix.unistd"]
  local function restore()
    loaded.ansicolors, loaded["posix.unistd"] = real, unistd
    package.preload.ansicolors = nil
    rawset(os, "getenv", getenv)
    rawset(_G, "rfsmpp", global)
  end
  loaded.ansicolors = colours or nil
  package.preload.ansicolors = function() error("not installed") end
  loaded["posix.unistd"] = { isatty = function() return is_terminal and 1 or 0 end }
  rawset(os, "getenv", function(name) return variables[name] end)
  local ok, result = pcall(function() return f(dofile("rfsmpp.lua")) end)
  restore()
  if not ok then error(result, 0) end
  return result
end

local TERMINAL = { TERM = "xterm" }

local function line_of(pp) return pp.dbgcolorize("arm", "DOO", "root.a") end

local PLAIN = "arm:\tDOO                  root.a"

describe("colour", function()
  it("is there on a terminal, with the package ansicolors", function()
    assert.equal("<cyan bright>arm<reset>:\t<blue>DOO                 <reset> root.a",
      in_surroundings(false_colours, true, TERMINAL, line_of))
  end)

  it("is missing without the package", function()
    assert.equal(PLAIN, in_surroundings(nil, true, TERMINAL, line_of))
  end)

  it("is missing where the output is no terminal", function()
    assert.equal(PLAIN, in_surroundings(false_colours, false, TERMINAL, line_of))
  end)

  it("is missing when NO_COLOR is set", function()
    assert.equal(PLAIN, in_surroundings(false_colours, true,
      { TERM = "xterm", NO_COLOR = "1" }, line_of))
  end)

  it("is missing on a terminal that has none", function()
    local dumb = { TERM = "dumb" }
    assert.equal(PLAIN, in_surroundings(false_colours, true, dumb, line_of))
  end)

  it("is there for a print function, whatever the output", function()
    local plain = { NO_COLOR = "1" }
    local colours = in_surroundings(false_colours, false, plain, function(pp)
      local line
      pp.gen_dbgcolor("arm", nil, nil, function(text) line = text end)("ERROR")
      return line
    end)
    assert.equal("<cyan bright>arm<reset>:\t<red bright>ERROR               <reset>",
      colours)
  end)
end)

describe("dbgcolor", function()
  it("prints the line that dbgcolorize makes", function()
    local lines = helper.printed(function() rfsmpp.dbgcolor("arm", "DOO", "root.a") end)
    assert.same({ rfsmpp.dbgcolorize("arm", "DOO", "root.a") }, lines)
  end)
end)

describe("gen_dbgcolor", function()
  it("prints the name, the id in its colour and the arguments", function()
    local expected = {
      "<36><1>arm<0>:\t<32>STATE_ENTER         <0> root.a",
      "<36><1>arm<0>:\t<31>STATE_EXIT          <0> root.a",
      "<36><1>arm<0>:\t<33>EFFECT              <0> root.a",
      "<36><1>arm<0>:\t<34>DOO                 <0> root.a",
      "<36><1>arm<0>:\t<36>EXEC_PATH           <0> root.a",
      "<36><1>arm<0>:\t<31><1>ERROR               <0> root.a",
      "<36><1>arm<0>:\t<35>HIBERNATING         <0> root.a",
      "<36><1>arm<0>:\t<37><1>RAISED              <0> root.a",
      "<36><1>arm<0>:\t<33><1>TIMEEVENT           <0> root.a",
      "<36><1>arm<0>:\tCHECKING             root.a",
    }
    for i = 1, has_ansicolors and 0 or #expected do
      expected[i] = expected[i]:gsub("<%d+>", "")
    end
    assert.same(expected, printed(nil, nil, "STATE_ENTER", "STATE_EXIT", "EFFECT",
      "DOO", "EXEC_PATH", "ERROR", "HIBERNATING", "RAISED", "TIMEEVENT", "CHECKING"))
  end)

  it("prints what ids names, and nothing else when defshow is false", function()
    assert.equal(1, #printed({ DOO = true }, false, "DOO", "EFFECT"))
  end)

  it("prints what ids does not mention when defshow is true", function()
    assert.equal(2, #printed({ DOO = true }, true, "DOO", "EFFECT"))
    assert.equal(1, #printed({ DOO = false }, true, "DOO", "EFFECT"))
  end)

  it("prints what ids does not forbid when defshow is absent", function()
    assert.equal(1, #printed({ DOO = false }, nil, "DOO", "EFFECT"))
  end)

  it("prints plain text where no colour is wanted", function()
    local lines = helper.printed(function()
      rfsmpp.gen_dbgcolor("arm")("DOO", 1, nil, false)
    end)
    -- the specs run with their output in a file or pipe, or on a terminal
    assert.equal("arm:\tDOO                  1 nil false",
      (lines[1]:gsub("\27%[%d+m", "")))
  end)

  it("bears values that cannot be printed", function()
    local bad = setmetatable({}, { __tostring = function() error("no") end })
    local lines = {}
    rfsmpp.gen_dbgcolor("m", nil, true, function(line) lines[1] = line end)("X", bad)
    assert.matches("table$", lines[1])
  end)

  it("blames the caller for a print function that is none", function()
    local ok, problem = pcall(function()
      return (rfsmpp.gen_dbgcolor("m", {}, true, "print"))
    end)
    assert.is_false(ok)
    assert.matches("pp_spec.lua:%d+: rfsmpp.gen_dbgcolor: function expected, got "
      .. "string", problem)
  end)

  it("traces a machine", function()
    local lines = {}
    local fsm = machine()
    fsm.dbg = rfsmpp.gen_dbgcolor("m", { STATE_ENTER = true, STATE_EXIT = true }, false,
      function(line) lines[#lines + 1] = line:gsub("\27%[%d+m", "") end)
    rfsm.run(fsm)
    assert.same({
      "m:\tSTATE_ENTER          root", "m:\tSTATE_ENTER          root.a",
      "m:\tSTATE_ENTER          root.a.x",
    }, lines)
  end)
end)

describe("fsm2str", function()
  it("draws the states as a tree, sorted by name, with their modes", function()
    local tree = rfsmpp.fsm2str(machine()):gsub("\27%[%d+m", "")
    assert.equal("root[CS] inactive\n  a[CS] inactive\n    x[LS] inactive\n"
      .. "  b[LS] inactive", tree)
  end)

  it("shows what is active, done and inactive by colour", function()
    local fsm = machine()
    local function tree()
      return in_surroundings(false_colours, true, TERMINAL, function(pp)
        return pp.fsm2str(fsm)
      end)
    end
    rfsm.run(fsm)
    assert.equal("<green>root<reset>[CS]\n  <green>a<reset>[CS]\n"
      .. "    <yellow>x<reset>[LS]\n  <red>b<reset>[LS]", tree())
    helper.post_and_run(fsm, "e")
    assert.equal("<green>root<reset>[CS]\n  <red>a<reset>[CS]\n"
      .. "    <red>x<reset>[LS]\n  <green bright>b<reset>[LS]", tree())
  end)

  it("draws one line for a state, whatever its name", function()
    local fsm = helper.init(state {
      ["a\nb\27[1m"] = state {}, trans { src = "initial", tgt = "a\nb\27[1m" },
    })
    assert.equal("root[CS] inactive\n  a\\10b\\27[1m[LS] inactive",
      (rfsmpp.fsm2str(fsm):gsub("\27%[%d+m", "")))
  end)

  it("starts each line with the indent", function()
    local tree = rfsmpp.fsm2str(machine(), "| "):gsub("\27%[%d+m", "")
    assert.equal("| root[CS] inactive\n|   a[CS] inactive\n|     x[LS] inactive\n"
      .. "|   b[LS] inactive", tree)
  end)

  it("wants an initialised fsm", function()
    local ok, problem = pcall(function() return (rfsmpp.fsm2str(state {})) end)
    assert.is_false(ok)
    assert.matches("pp_spec.lua:%d+: rfsmpp.fsm2str: initialised fsm expected", problem)
  end)
end)

describe("the module", function()
  it("has its dotted name and its global", function()
    assert.equal(rfsmpp, require("rfsm.pp"))
    assert.equal(rfsmpp, rawget(_G, "rfsmpp"))
  end)
end)
