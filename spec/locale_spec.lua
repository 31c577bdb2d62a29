-- A host that has set a locale: decimal commas, and names sorted as in a dictionary.
-- What is written and read there is the same as in the C locale.

local exporters = require "rfsm.cli.exporters"
local helper = require "spec.helper"
local rfsm = require "rfsm"

after_each(helper.remove_files)

local has_dot = helper.lines_of("command -v dot")[1] ~= nil
local has_dkjson = helper.package("dkjson") ~= nil
local has_argparse = helper.package("argparse") ~= nil

local COMMA = "de_DE" -- a locale with a decimal comma

-- What each program below begins with; its first line sets the locale.
local HEAD = [[
package.path = package.path .. ";./compat/?.lua;/usr/share/lua/5.3/?.lua"
local rfsm, te = require "rfsm", require "rfsm_timeevent"
require "rfsm.history" require "rfsm.defer" require "rfsm.await"
local checks = require "rfsm_checks"
local state, trans = rfsm.state, rfsm.trans
local clock = require("rfsm.clock").simulated()
local function model()
  return state { info = false, warn = print, err = print, gettime = clock,
    keep = { "x", "list" }, x = 0.25, list = { 1.5, Ab = 1e-7, aa = -2.125, a_b = 0.1 },
    Ab = state {}, aa = state {}, a_b = state { Z = state {}, y = state {},
      trans { src = "initial", tgt = "Z" },
      trans { src = "Z", tgt = "y", events = { "e_after(2.5)", "e_Y" } } },
    B = state { final = true }, c = state {},
    trans { src = "initial", tgt = "aa" },
    trans { src = "aa", tgt = "Ab", events = { "e_after(0.5)", 1.5 }, pn = 0.5 },
    trans { src = "Ab", tgt = "a_b", events = { te.e_after(0.0625) } },
    trans { src = "a_b", tgt = "c", events = { "e_x", "e_Z", rfsm.named "e_data" } },
    y = trans { src = "c", tgt = "B", events = { "e_at(1.5e2)" } },
    Z = trans { src = "c", tgt = "aa", events = { "e_after(7.25)" } },
  }
end
local fsm = assert(rfsm.init(model()))
rfsm.run(fsm)
clock:advance(0.25)
rfsm.run(fsm)
]]

local CASES = {
  { "numbers", [[
    for _, n in ipairs { 0.5, -0.125, 1e300, 1e-7, 3, 2^53, -1/0, 0/0 } do
      print(rfsm.text_of(n), rfsm.number_text(n), rfsm.number_text(n, "%.2f"))
    end
    for _, text in ipairs { "0.5", "-1.5e-3", " 2 ", "0,5", "1.5x", "", ".", "7", "nan",
      "inf", "0b101", "0x1b" } do
      local n = rfsm.number_of(text)
      print(text, n and rfsm.number_text(n))
    end
    print(rfsm.number_of(nil), rfsm.number_of({}), rfsm.number_of(4) == 4) ]] },
  { "the order of names", [[
    local t = { b = 1, B = 2, a = 3, ["a-b"] = 4, ab = 5, _ = 6, [1.5] = 7 }
    for _, key in ipairs(rfsm.sorted_keys(t)) do io.write(rfsm.text_of(key), " ") end
    for _, node in ipairs(rfsm.elements(fsm, rfsm.is_node)) do print(node._fqn) end
    for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do print(tr) end ]] },
  { "problems of a model, in order", [[
    local parts = {}
    for name in ("b B a-b ab Z y"):gmatch("%S+") do
      parts[name] = state { doo = 0.5, trans { src = "Bx", tgt = name } }
    end
    print(select(2, rfsm.init(state(parts)))) ]] },
  { "timers", [[
    local function leaf(seconds)
      clock:advance(seconds)
      rfsm.run(fsm)
      print(rfsm.get_actleaf_fqn(fsm), rfsm.number_text(te.next_deadline(fsm) or 0))
    end
    leaf(0.2) leaf(0.1) leaf(0.0625) leaf(0.001)
    te.send_after(fsm, 0.75, "e_data", { name = "e_data" })
    leaf(0.74) leaf(0.02)
    for _, x in ipairs { 0.5, 1e-3 } do print(te.e_after(x), te.e_at(x)) end
    for _, text in ipairs { "1e-3", "1.5E+2", "0,5", ".25" } do
      print(rfsm.init(state { info = false, warn = print, err = print, a = state {},
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "a", events = "e_after(" .. text .. ")" } }) ~= false)
    end ]] },
  { "a clock that returns fractions", [[
    local _, problem = pcall(te.e_after, -0.5)
    print((problem:gsub("^.-: ", "")))
    local other = model()
    other.gettime = function() return 12.5 end
    rfsm.run(rfsm.init(other)) ]] },
  { "a snapshot, and what is put back", [[
    local snapshot = require "rfsm.snapshot"
    rfsm.send_events(fsm, 0.5, { name = "e_data", 0.75 })
    local text = snapshot.encode(snapshot.take(fsm))
    print(text)
    local other = assert(snapshot.restore(model(),
      require("rfsm.server.codec").decode(text)))
    print(snapshot.encode(snapshot.take(other)) == text)
    print(snapshot.encode(snapshot.structure(model()))) ]], needs = has_dkjson },
  { "a recording, its replay, the spec made of it", [[
    local record, file = require "rfsm.record", os.tmpname()
    local fsm = assert(rfsm.init(model()))
    local recorder = record.record(fsm, file)
    rfsm.run(fsm)
    clock:advance(0.75)
    rfsm.run(fsm)
    te.send_after(fsm, 0.5, 1.5)
    rfsm.send_events(fsm, { name = "e_data", v = 0.125 }, 2.5)
    rfsm.run(fsm)
    recorder:stop()
    local handle = io.open(file)
    print((handle:read("*a"):gsub('"file":"[^"]*"', "")))
    handle:close()
    print(record.replay(model(), file))
    print((record.to_spec(file, { chart = "x.lua" }):gsub(file, "FILE")))
    os.remove(file) ]], needs = has_dkjson },
  { "an exploration and its witnesses", [[
    print(checks.explore(model(), { properties = {
      B = checks.after(1.5).reach("root.B").within(0.5),
      a = checks.never("root.c"), ["a-b"] = checks.never("root.Ab"),
      checks.at_most(1, "e_x").within(2.5) } })) ]] },
  { "the tests of a chart, and its findings", [[
    local file = os.tmpname()
    local handle = io.open(file, "w")
    handle:write("local s, t = rfsm.state, rfsm.trans\n"
      .. "return s { a = s {}, b = s {}, t { src = 'initial', tgt = 'a' }, "
      .. "t { src = 'a', tgt = 'b', events = 'e_after(2.5)', pn = 0.5 }, "
      .. "t { src = 'b', tgt = 'a', events = 'e_after(0.125)' } }")
    handle:close()
    print(require("rfsm.tests.tests").busted("c.lua", rfsm.load(file), {}, "c_spec"))
    os.remove(file)
    for _, found in ipairs(checks.findings(model())) do print(found) end ]] },
  { "what strict and why say", [[
    local other = model()
    other.strict, other.err = true, false
    local fsm = assert(rfsm.init(other))
    rfsm.run(fsm)
    rfsm.send_events(fsm, "1.5", 2.25, { 0.5 })
    rfsm.run(fsm)
    print(select(2, checks.why(fsm, 1.5)))
    print(select(2, checks.enabled(fsm))) ]] },
  { "the picture", [[
    local dot = require "rfsm.dot"
    local fsm = assert(rfsm.init(model()))
    print(dot.encode(fsm))
    print(dot.render(assert(dot.layout(fsm)), "svg")) ]], needs = has_dot },
}

for _, exporter in ipairs(exporters.list) do
  CASES[#CASES + 1] = { "rfsm " .. exporter.name,
    ("print(require('rfsm.%s').encode(fsm))"):format(exporter.name) }
end

local SIM = { "clock 0.125", "run", "watch 0.5 + 0.25", "clock 0.375", "se 0.75",
  "clock 0.25", "next", "why 1.5", "history", "breakpoint b if 0.5 > 0.25", "quit" }

if has_argparse then
  CASES[#CASES + 1] = { "the simulator", ([[
    local file, words = os.tmpname(), os.tmpname()
    for name, text in pairs { [file] = "return rfsm.state { a = rfsm.state {}, "
      .. "b = rfsm.state {}, rfsm.trans { src = 'initial', tgt = 'a' }, "
      .. "rfsm.trans { src = 'a', tgt = 'b', events = 'e_after(0.5)' } }",
      [words] = %q } do
      local handle = io.open(name, "w")
      handle:write(text)
      handle:close()
    end
    io.input(words)
    arg = { [0] = "rfsm" }
    print(require("rfsm.cli.main").main { "sim", "-q", file })
    os.remove(file) os.remove(words)
  ]]):format(table.concat(SIM, "\n") .. "\n") }
end

local MISSING = "no such locale, and no package locales"

local CATEGORIES = "IDENTIFICATION CTYPE TIME NUMERIC MONETARY MESSAGES PAPER NAME "
  .. "ADDRESS TELEPHONE MEASUREMENT COLLATE"

-- Makes a locale in a folder of its own; returns how a program finds it, or nil. What
-- the system has needs no folder. The order of words takes the most time to make, and
-- matters to COMMA only.
local function find_locale(name, folder, half, charset)
  charset = charset or "UTF-8"
  local full, source = name .. "." .. charset, folder .. "/" .. name
  helper.write(source, "escape_char /\n" .. CATEGORIES:gsub("(%S+) ?", function(part)
    local from = part == "COLLATE" and name ~= COMMA and "POSIX" or name
    return ("LC_%s\ncopy \"%s\"\nEND LC_%s\n"):format(part, from, part)
  end))
  os.execute(("localedef -i '%s' -f %s '%s/%s' >/dev/null 2>&1"):format(source,
    charset, folder, full))
  local variables = "LC_ALL=C LOCPATH=" .. folder
  for _, found in ipairs { variables, "LC_ALL=C" } do
    local text = helper.output_of(("print(os.setlocale '%s' ~= nil, (('%%.1f')"
      .. ":format(0.5)))"):format(full), found)
    local is_jit = rawget(_G, "jit") ~= nil -- it writes points in each locale
    if text == "true\t" .. (is_jit and "0.5" or half) then return found, full end
  end
end

describe("a host with the locale", function()
  local folder = os.tmpname()
  os.remove(folder)
  os.execute("mkdir " .. folder)

  teardown(function() os.execute("rm -rf " .. folder) end)

  it("ps_AF, whose point has two bytes, writes and reads numbers", function()
    local variables, name = find_locale("ps_AF", folder, "0\217\1715")
    if not variables then return pending(MISSING) end
    assert.equal("0.5 0.25 0.5 true", helper.output_of(([[
      local rfsm = require "rfsm"
      assert(os.setlocale "%s")
      local half, quarter = rfsm.number_of "0.5", rfsm.number_of "2.5e-1"
      print(rfsm.text_of(half) .. " " .. rfsm.number_text(quarter, "%%.2f") .. " "
        .. require("rfsm.shared.exact_json").encode(half) .. " "
        .. tostring(half + half == 1)) ]]):format(name), variables))
  end)

  -- As UTF-8 the capital has two bytes, and `upper` leaves i alone; as ISO-8859-9 one.
  local function check_turkish(charset)
    local variables, name = find_locale("tr_TR", folder, "0,5", charset)
    if not variables then return pending(MISSING) end
    local expected = "EXIT EFFECT exit (did you mean 'ii'?) typo root___"
    assert.equal(expected, helper.output_of(([[
      assert(os.setlocale "%s")
      local rfsm, ids = require "rfsm", {}
      local advice, typos = require "rfsm.advice", {}
      require("rfsm.checks.event_names").check(rfsm.init(rfsm.state { info = false,
        a = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "a", events = { "e_init", "e_INIT" } } }),
        function(code) typos[#typos + 1] = code end)
      local fsm = rfsm.init(rfsm.state { info = false, warn = false,
        err = function(id) ids[#ids + 1] = id end,
        a = rfsm.state { exit = error }, ["\196\177"] = rfsm.state {},
        rfsm.trans { src = "initial", tgt = "a" },
        rfsm.trans { src = "a", tgt = "a", events = "e", effect = error } })
      rfsm.run(fsm)
      rfsm.send_events(fsm, "e")
      rfsm.run(fsm)
      print(table.concat(ids, " ") .. " "
        .. advice.field_meant("state", "EXIT") .. advice.did_you_mean("II", { "ii" })
        .. " " .. table.concat(typos) .. " "
        .. require("rfsm.plantuml").encode(fsm):match "as (root_[^a ]%%S*)")
      ]]):format(name), variables))
  end

  it("tr_TR, where i has another capital, has the ids of errors", function()
    check_turkish "UTF-8"
    check_turkish "ISO-8859-9"
  end)

  local variables, name = find_locale(COMMA, folder, "0,5")
  if not variables then return it(COMMA, function() pending(MISSING) end) end

  for _, case in ipairs(CASES) do
    if case.needs ~= false then
      it(COMMA .. " has the same " .. case[1], function()
        local function output(own)
          local text = helper.output_of(("assert(os.setlocale '%s')\n"):format(own)
            .. HEAD .. case[2], variables)
          text = text:gsub('"sum":"%x+"', "") -- of a line with the file's name
          return (text:gsub("0x%x+", ""):gsub("/tmp/[%w_]+", ""))
        end
        local expected = output("C")
        assert.is_nil(expected:find("stack traceback", 1, true), expected)
        assert.equal(expected, output(name))
      end)
    end
  end
end)

describe("a number as text", function()
  it("has the digits that a format asks for", function()
    assert.same({ "0.5", "0.50", "1e-07" }, { rfsm.number_text(0.5),
      rfsm.number_text(0.5, "%.2f"), rfsm.number_text(1e-7, "%g") })
  end)

  it("is read if it is one, with a point", function()
    assert.same({ 0.5, -1500, 4 }, { rfsm.number_of("0.5"), rfsm.number_of("-1.5e3"),
      rfsm.number_of(4) })
    for _, text in ipairs { "0,5", "a", "", "1.2.3" } do
      assert.is_nil(rfsm.number_of(text))
    end
    assert.is_nil(rfsm.number_of(nil))
    assert.is_nil(rfsm.number_of({}))
  end)
end)
