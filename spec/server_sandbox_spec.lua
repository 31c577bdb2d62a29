-- What of a chart cannot run in Redis, found while it is bundled.

local code = require "rfsm.shared.code"
local helper = require "spec.helper"
local limit = require "rfsm.shared.limit"
local redis = require "rfsm.redis"
local sandbox = require "rfsm.server.sandbox"

after_each(helper.remove_files)

describe("the code of a text", function()
  for _, case in ipairs {
    { text = "a = 'x' b", code = "a =     b" },
    { text = 'a = "x\'y" b', code = "a =       b" },
    { text = [[a = "x\"y" b]], code = "a =        b" },
    { text = [[a = "x\\" b]], code = "a =       b" },
    { text = [[a = "" b]], code = "a =    b" },
    { text = "a = 'x\nb", code = "a =   \nb" },
    { text = "a -- x 'y'\nb", code = "a         \nb" },
    { text = "a -- x", code = "a     " },
    { text = "a --[[ x\n]] b", code = "a       \n   b" },
    { text = "a --[==[ x ]] ]=] ]==] b", code = "a" .. (" "):rep(22) .. "b" },
    { text = "a [[ x ' ]] b", code = "a           b" },
    { text = "a [=[ x ]] ]=] b", code = "a              b" },
    { text = "a [[ x", code = "a     " },
    { text = "a 'x", code = "a   " },
    { text = "a[b[1]] -- c", code = "a[b[1]]     " },
    { text = "a['b'] 'c'", code = "a[   ]    " },
    { text = "a - b 'c' -- d\ne", code = "a - b         \ne" },
  } do
    it("has blanks for strings and comments: " .. case.text:gsub("\n", " "), function()
      assert.equal(case.code, code.of(case.text))
    end)
  end

  it("has its strings, if they are to stay", function()
    assert.equal("a 'b -- c'     \n[[e -- f]]      ",
      code.of("a 'b -- c' -- d\n[[e -- f]]--[[ g", true))
  end)
end)

describe("a loop without an end", function()
  local lines = sandbox.endless

  for _, text in ipairs { "while true do end", "while 1 do x = x + 1 end",
    "while (true) do if a then b() end end", "repeat x() until false",
    "repeat x() until (false)", "for i = 1, math.huge do x() end",
    "while true do for i = 1, 3 do x() end end",
    "while true do repeat x() until y end", "while true do function f() end end",
    "while true do x = 'break' end", "repeat while a do b() end until false",
    "while true do if a then b() elseif c then d() end end" } do
    it("is found: " .. text, function() assert.same({ 2 }, lines("\n" .. text)) end)
  end

  for _, text in ipairs { "while true do break end", "while x do end",
    "while truely do end", "while 10 do end", "repeat x() until y",
    "repeat x() until falsely", "while true do return x end",
    "while true do rfsm.yield() end", "while true do error('x') end",
    "for i = 1, 10 do end", "for i = 1, math.hugely do end", "xrepeat() y = false",
    "while true do if a then break end end", "awhile = true do end",
    "local t = { ['repeat'] = 1 } x = false", "while true do",
    "while true do local f = function() end break end",
    "while true do if a then b() end break end",
    "while true do do x() end break end", "while true do repeat x() until y break end",
    "while true do for i = 1, 2 do x() end return end" } do
    it("is none: " .. text, function() assert.same({}, lines(text)) end)
  end

  it("is named by its line, in order", function()
    assert.same({ 1, 2, 4 }, lines("repeat until false\nwhile true do end\n\n"
      .. "for i = 1, math.huge do end"))
  end)
end)

describe("a module that a text requires", function()
  it("is found with its line, if it is named in a call", function()
    assert.same({ { name = "a", line = 1 }, { name = "b.c-d_1", line = 2 },
      { name = "e", line = 3 } }, sandbox.required("require 'a' -- require 'x'\n"
      .. "local b = require(\"b.c-d_1\")\nrequire( 'e' ) arequire 'y' require(z)\n"
      .. "s = \"require 'w'\""))
  end)
end)

describe("a chart in the sandbox", function()
  local CHART = "return rfsm.state { a = rfsm.state {}, rfsm.trans { src = 'initial', "
    .. "tgt = 'a' } }"

  for _, text in ipairs { "local t = os.clock()", "local t = { os = 1 } t.io = 2",
    "local t = {} function t:debug() end t:debug()", "local io = {} io.open = 1",
    "local x, os = 1, {} os.time = 1", "-- os.time", "local t = 'os.time'",
    "local aos, osa, o = 1", "local t = { package = 1 }",
    "local b = bit.band(1, 2) cjson.encode {} cmsgpack.pack {} struct.pack() "
      .. "redis.log(1)", "rfsm_timeevent.e_after(1)", "local t = _G.rfsm",
    "assert(_VERSION and getmetatable and setmetatable and rawget and rawset)",
    "local f = function() os.clock() end", "local rfsm = rfsm" } do
    it("is loaded: " .. text, function()
      assert.same({ true }, { (sandbox.load(text .. "\n" .. CHART, "f.lua")) ~= nil })
    end)
  end

  for text, problem in pairs {
    ["local t = os.time()"] = "f.lua:1: 'os.time' does not exist in Redis",
    ["local t = os"] = "f.lua:1: 'os' does not exist in Redis",
    ["local t = os . getenv 'x'"] = "f.lua:1: 'os.getenv' does not exist in Redis",
    ["\n\nio.write(os.time())"] = "f.lua:3: 'io.write' does not exist in Redis",
    ["os.time() io.write()"] = "f.lua:1: 'os.time' does not exist in Redis",
    ["local f = function() debug.getinfo(1) end"] =
      "f.lua:1: 'debug.getinfo' does not exist in Redis",
    ["local p = package.path"] = "f.lua:1: 'package.path' does not exist in Redis",
    ["dofile 'x'"] = "f.lua:1: 'dofile' does not exist in Redis",
    ["loadfile(x)"] = "f.lua:1: 'loadfile' does not exist in Redis",
    ["getfenv(0)"] = "f.lua:1: 'getfenv' does not exist in Redis",
    ["if os.time() == 1 then end"] = "f.lua:1: 'os.time' does not exist in Redis",
    ["if io == nil then end"] = "f.lua:1: 'io' does not exist in Redis",
    ["\nlocal x = nothing"] = "f.lua:2: global 'nothing' does not exist in Redis",
    ["x = 1"] = "f.lua:1: global 'x' cannot be set in Redis",
    ["x ="] = "f.lua:2: unexpected symbol near 'return'",
    ["do return 5 end"] = "f.lua: a state expected, got number",
    ["error({}, 0)"] = "a table",
  } do
    it("is refused: " .. text:gsub("\n", " "), function()
      local model, found = sandbox.load(text .. "\n" .. CHART, "f.lua")
      assert.is_nil(model)
      if problem == "a table" then
        assert.matches("^table: ", found)
      elseif problem:find("unexpected") then
        assert.matches("^f.lua:%d: unexpected symbol near '?<?return", found)
      else
        assert.equal(problem, found)
      end
    end)
  end
end)

describe("a bundle", function()
  for argument, expected in pairs {
    ["lamp.lua"] = { "lamp", "lamp.lua" },
    ["a/b/lamp.lua"] = { "lamp", "a/b/lamp.lua" },
    ["x=a/lamp.lua"] = { "x", "a/lamp.lua" }, ["lamp"] = { "lamp", "lamp" },
    ["a.b-c=d"] = { "a.b-c", "d" }, ["a/b=c.lua"] = { "b=c", "a/b=c.lua" },
  } do
    it("names a chart: " .. argument, function()
      assert.same(expected, { redis.name_of(argument) })
    end)
  end

  it("is a library with the charts in order, and the options", function()
    local file = helper.file_with("#!/usr/bin/lua\nreturn rfsm.state { "
      .. "a = rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' } }")
    local text, warnings = redis.bundle({ "one=" .. file, "two=" .. file },
      { index = true, history = 7, ids = 8, ids_for = 9 })
    assert.same({}, warnings)
    assert.matches("^#!lua name=rfsm\n", text)
    assert.is_truthy(text:find("charts, { index = true, history = 7, ids = 8, "
      .. "ids_for = 9 }", 1, true))
    assert.is_true(text:find('name = "one"', 1, true) < text:find('name = "two"', 1,
      true))
    assert.is_truthy((redis.bundle { "one=" .. file }):find("charts, { index = nil, "
      .. "history = nil, ids = nil, ids_for = nil }", 1, true))
    local _, count = text:gsub('bundled%["rfsm"%] =', "")
    assert.equal(1, count)
  end)

  it("has what a chart may get without a require, each module once", function()
    local text = redis.bundle { helper.file_with("return rfsm.state { a = "
      .. "rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' } }") }
    for _, name in ipairs { "rfsm", "rfsm_timeevent", "rfsm_seqand", "rfsm.strict",
      "rfsm.emem", "rfsm.monitor", "rfsm.preview", "rfsm.await", "rfsm.advice",
      "rfsm.redis.store", "rfsm.server.functions" } do
      local _, count = text:gsub('bundled%["' .. name:gsub("%.", "%%.") .. '"%] =', "")
      assert.equal(1, count, name)
    end
    assert.is_nil(text:find('bundled["rfsm.fleet"]', 1, true))
  end)

  it("has a flat name of rFSM also if no folder has that file", function()
    local file = helper.file_with("require 'rfsm_await'\nreturn rfsm.state { a = "
      .. "rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' } }")
    local text = helper.with(package, { path = "./?.lua" }, function()
      return helper.with(package.loaded, { rfsm_await = true }, function()
        return (redis.bundle { file })
      end)
    end)
    assert.is_truthy(text:find('bundled["rfsm_await"] =', 1, true))
    local compile = rawget(_G, "loadstring") or load
    assert.is_function(compile((text:gsub("^#[^\n]*", ""))))
  end)

  it("runs no chart with other globals than those of the server", function()
    local file = helper.file_with("local os = rawget(_G, 'o' .. 's')\n"
      .. "if os.exit then error 'out' end\n"
      .. "return rfsm.state { a = rfsm.state {}, rfsm.trans { src = 'initial', "
      .. "tgt = 'a' } }")
    assert.same({}, (select(2, redis.bundle { file })))
  end)

  for what, case in pairs {
    ["no end"] = { text = "\nlocal n = 0 while n >= 0 do n = n + 1 end",
      problem = "^FILE:2: loading takes more than 0.2 s, is there a loop" },
    ["no model"] = { text = "return rfsm.state { a = rfsm.state {}, rfsm.trans { src = "
      .. "'a', tgt = 'b' } }",
      problem = "^FILE:1: root.trans%[1%] .*: tgt 'b': no state" },
    ["data that cannot be saved"] = { text = "return rfsm.state { keep = { 'f' }, f = "
      .. "print, a = rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' } }",
      problem = "^FILE: rfsm.snapshot.take: root.f: a function cannot be saved$" },
    ["a wrong name"] = { text = "return rfsm.state { keep = { 'entry' }, "
      .. "a = rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' } }",
      problem = "^FILE: rfsm.snapshot.take: .*root.keep%[1%]: name" },
    ["an error"] = { text = "error('no', 0)", problem = "^FILE: no$" },
  } do
    it("is refused if a chart has " .. what, function()
      local file, seconds = helper.file_with(case.text), limit.SECONDS
      limit.SECONDS = 0.2
      local ok, problem = pcall(redis.bundle, { file })
      limit.SECONDS = seconds
      assert.is_false(ok)
      assert.matches(case.problem, (problem:gsub(file:gsub("%p", "%%%0"), "FILE")))
    end)
  end
end)

-- Each is an error or nil if it leads to nothing that a server lacks.
local WAYS_OUT = {
  "load('return os.exit')()",
  "load('return _ENV.os.exit')()",
  "load('return _G.os.exit')()",
  "load(('return os.exit'):gmatch('.'))()",
  "load('return os.exit', 'x', 't', nil)()",
  "load('return load(...)()')('return os.exit')",
  "coroutine.wrap(load('return os.exit'))()",
  "(load(string.dump(function() return print end), 'x', 'b'))",
  "_G['loadstring']('return os.exit')()",
  "_G['getfenv'](0)",
  "_G['getfenv'](print)",
  "_G['setfenv'](1, {})",
  "rawget(_G, 'os').exit",
  "rawget(_G, 'io')",
  "rawget(_G, 'debug').getupvalue(setmetatable, 1)",
  "rawget(_G, 'package').loaded",
  "rawget(_G, 'require')('os')",
  "rawget(_G, 'require')('debug').getupvalue(setmetatable, 1)",
  "rawget(_G, 'require')('_G')",
  "rawget(_G, 'require')('ffi')",
  "rawget(_G, 'jit').util",
  "getmetatable(_G).__index",
  "getmetatable(setmetatable(_G, {}))",
  "getmetatable('').__index.os",
}

describe("a way out of the sandbox", function()
  -- Returns the ways that a function finds.
  local function found_by(is_open)
    local found = {}
    for _, way in ipairs(WAYS_OUT) do
      if is_open(("local function find() return %s end"):format(way)) then
        found[#found + 1] = way
      end
    end
    return found
  end

  for _, server in ipairs { "Redis", "PostgreSQL" } do
    it("is not there when a chart is loaded for " .. server, function()
      assert.same({}, found_by(function(text)
        local _, problem = sandbox.load(text .. [[
 local ok, value = pcall(find) error(ok and value ~= nil and "out" or "in", 0)]],
          "f.lua", server)
        assert.matches("^in$", problem == "out" and "in" or problem)
        return problem == "out"
      end))
    end)

    it("is not there when a client runs the library of " .. server, function()
      assert.same({}, found_by(function(text)
        local result = {}
        sandbox.run(text .. " local ok, value = pcall(find) "
          .. "cjson.is_out = ok and value ~= nil", { cjson = result }, server)
        return result.is_out
      end))
    end)
  end

  it("would be found", function()
    local open = { "rawget(_G, 'print')", "load('return print')()" }
    for _, way in ipairs(open) do
      local result = {}
      sandbox.run("cjson.value = " .. way, { cjson = result })
      assert.equal(print, result.value)
    end
  end)
end)
