-- The modules at the top, copied into an empty folder.

local helper = require "spec.helper"

local MODULES = { "rfsm", "rfsmpp", "rfsm_timeevent", "rfsm_seqand", "rfsm_checks" }

local folder

-- Runs a text in a fresh Lua that finds the modules with these names, and no others.
local function output_with(names, text)
  for _, name in ipairs(names) do
    os.execute(("cp %s.lua '%s'"):format(name, folder))
  end
  text = ("package.path, package.cpath = '%s/?.lua', ''\n%s"):format(folder, text)
  return helper.output_of(text)
end

describe("in an empty folder", function()
  before_each(function()
    folder = os.tmpname()
    os.remove(folder)
    os.execute("mkdir " .. folder)
  end)

  after_each(function() os.execute("rm -r " .. folder) end)

  it("the five modules work beside each other", function()
    assert.equal([[
root.par
root.on
WARNING: undeclared event e_other received
root active
    off[LS] done
    par[LS] inactive

rfsm_checks.explore: module 'rfsm.explore.explore' is not installed]],
      (output_with(MODULES, [[
local rfsm, rfsmpp = require "rfsm", require "rfsmpp"
local timeevent, checks = require "rfsm_timeevent", require "rfsm_checks"
local arm = rfsm.state { info = false, warn = false, on = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "on" } }
local now = 5
timeevent.set_gettime_hook(function() return now, 0 end)
local fsm = rfsm.init(rfsm.state { info = false, warn = print, checkevents = true,
  par = rfsm.seqand { left = arm }, off = rfsm.state { final = true },
  rfsm.trans { src = "initial", tgt = "par" },
  rfsm.trans { src = "par", tgt = "off", events = { "e_after(3)" } } })
rfsm.run(fsm)
print(rfsm.get_actleaf_fqn(fsm))
print(rfsm.get_actleaf_fqn(fsm.par.substates.left))
now = 9
rfsm.send_events(fsm, "e_other")
rfsm.run(fsm)
print((rfsmpp.fsm2str(fsm):gsub("\27%[%d+m", "")))
local _, problem = pcall(function() return checks.explore end)
print((tostring(problem):gsub("^.-:%d+: ", "")))
]])))
  end)

  it("each works beside rfsm.lua", function()
    for i = 2, #MODULES do
      assert.equal("table", output_with({ "rfsm", MODULES[i] },
        ("print(type(require '%s'))"):format(MODULES[i])))
    end
  end)

  it("rfsm.lua says by name which file is missing", function()
    assert.equal([[
root.b
rfsm.is_in: rfsm/tools.lua is not installed beside rfsm.lua
rfsm.prepare: rfsm/prepare.lua is not installed beside rfsm.lua
rfsm.fsm_merge: rfsm/merge.lua is not installed beside rfsm.lua
rfsm.follow_fates: rfsm/fates.lua is not installed beside rfsm.lua
rfsm.check_always: rfsm/always.lua is not installed beside rfsm.lua
nil]], output_with({ "rfsm" }, [[
local rfsm = require "rfsm"
local fsm = assert(rfsm.init(rfsm.state { info = false, warn = false,
  a = rfsm.state {}, b = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = "e_go" } }))
rfsm.send_events(fsm, "e_go")
rfsm.run(fsm)
rfsm.send_events(fsm, "e_go")
rfsm.run(fsm)
print(rfsm.get_actleaf_fqn(fsm))
local function try(f, ...)
  print((tostring(select(2, pcall(f, ...))):gsub("^.-:%d+: ", "")))
end
try(rfsm.is_in, fsm, "root.b")
try(rfsm.prepare, fsm)
try(rfsm.fsm_merge, fsm, fsm, rfsm.state {}, "c")
try(rfsm.watch_hook_add, fsm, "discarded", print)
try(rfsm.init, rfsm.state { a = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "a", always = true } })
print(rfsm.no_such_function)
]]))
  end)

  it("rfsm_timeevent reads os.time", function()
    assert.equal("true true", output_with({ "rfsm", "rfsm_timeevent" }, [[
local rfsm, timeevent = require "rfsm", require "rfsm_timeevent"
local fsm = rfsm.init(rfsm.state { info = false, warn = false, a = rfsm.state {},
  b = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(100)" } },
  rfsm.trans { src = "a", tgt = "b", events = { "e_at(" .. os.time() + 50 .. ")" } } })
rfsm.run(fsm)
local left = timeevent.next_deadline(fsm)
local is_near = left > 40 and left <= 51
timeevent.set_gettime_hook(function() return os.time() + 60, 0 end)
rfsm.run(fsm)
print(tostring(is_near) .. " " .. tostring(rfsm.get_actleaf_fqn(fsm) == "root.b"))
]]))
  end)

  it("rfsm_checks raises the error of a part that is there and fails", function()
    assert.equal("no memory; module 'rfsm.other' not found", output_with({ "rfsm",
      "rfsm_checks" }, [[
local checks = require "rfsm_checks"
local function problem_of(name, module, text)
  package.preload[module] = function() error(text, 0) end
  local _, problem = pcall(function() return checks[name] end)
  return tostring(problem):match("^[^\n]*")
end
print(problem_of("explore", "rfsm.explore.explore", "no memory") .. "; "
  .. problem_of("why", "rfsm.observe.why", "module 'rfsm.other' not found"))
]]))
  end)

  it("rfsm_checks.check returns what init finds", function()
    local expected = "root.trans[1] (initial -> b): tgt 'b': unknown name"
    assert.equal(expected, output_with({ "rfsm", "rfsm_checks" }, [[
local rfsm, checks = require "rfsm", require "rfsm_checks"
local model = rfsm.state { a = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "b" } }
print((table.concat(checks.check(model), "|"):gsub("^.-:%d+: ", "")))
]]))
  end)
end)
