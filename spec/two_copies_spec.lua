-- Two copies of the library in one process: after `package.loaded` was cleared (busted,
-- hot reload), or from two trees. What belongs to the other copy is told by name.

local helper = require "spec.helper"

after_each(helper.remove_files)

-- What each program begins with. `other` is the first copy, `rfsm` the second one.
local HEAD = [[
local other, other_te = require "rfsm", require "rfsm_timeevent"
require "rfsm.history"
local other_seqand = require "rfsm_seqand"
local function forget(pattern)
  for name in pairs(package.loaded) do
    if name:find(pattern) then package.loaded[name] = nil end
  end
end
forget "%s"
local rfsm = require "rfsm"
assert(rfsm ~= other)
local function say(text) print((text:gsub("%%S-:%%d+: ", ""))) end
local function model(copy, event, members)
  local t = { info = false, warn = say, err = say, a = copy.state {}, b = copy.state {},
    copy.trans { src = "initial", tgt = "a" },
    copy.trans { src = "a", tgt = "b", events = { event } },
    copy.trans { src = "b", tgt = "a", events = { "e_back" } } }
  for key, value in pairs(members or {}) do t[key] = value end
  return copy.state(t)
end
]]

local ALL, CORE = "^rfsm", "^rfsm$"

local function output_of(pattern, text)
  return helper.output_of(HEAD:format(pattern) .. text)
end

local EVENT = "WARNING: root.trans[2].events (a -> b): "
local FOREIGN = "it belongs to another copy of rfsm (give the model, not the machine)"

for pattern, what in pairs { [ALL] = "a library", [CORE] = "a core" } do -- any order
  describe(what .. " that is loaded again", function()
    it("warns of a time event of the other copy", function()
      assert.equal(EVENT .. "'e_after(1)' belongs to another copy of rfsm, it never "
        .. "comes", output_of(pattern, [[
        require "rfsm_timeevent"
        rfsm.init(model(rfsm, other_te.e_after(1))) ]]))
    end)

    it("warns of a text that only the other copy knows, with the cure", function()
      assert.equal(EVENT .. "no loaded extension knows 'e_after(1)' (require "
        .. '"rfsm_timeevent")', output_of(pattern, [[
        rfsm.init(model(rfsm, "e_after(1)")) ]]))
    end)

    it("has timers when they are required again", function()
      assert.equal("root.b", output_of(pattern, [[
        require "rfsm_timeevent"
        local now = 0
        local fsm = rfsm.init(model(rfsm, "e_after(1)", { gettime = function()
          now = now + 2
          return now, 0
        end }))
        rfsm.run(fsm)
        rfsm.run(fsm)
        print(rfsm.get_actleaf_fqn(fsm)) ]]))
    end)

    it("refuses the regions of the other copy", function()
      assert.equal("rfsm.init: the model has 1 problem\n  root.c.substates: it belongs "
        .. "to another copy of rfsm", output_of(pattern, [[
        rfsm.init(model(rfsm, "e", {
          c = other_seqand.new { x = model(other, "e") },
          t = rfsm.trans { src = "b", tgt = "c" },
          u = rfsm.trans { src = "c", tgt = "a" } })) ]]))
    end)

    it("refuses a machine of the other copy, and one in a model", function()
      assert.equal("rfsm.init: the model has 1 problem\n  root: " .. FOREIGN
        .. "\nrfsm.init: the model has 1 problem\n  root.c: " .. FOREIGN,
        output_of(pattern, [[
        local machine = other.init(model(other, "e"))
        assert(rfsm.init(machine) == false)
        assert(rfsm.init(model(rfsm, "e", { c = machine })) == false) ]]))
    end)

    it("refuses to check or watch a machine of the other copy", function()
      assert.equal("root: " .. FOREIGN .. "\nrfsm.strict.watch: initialised "
        .. "fsm expected, got state of another copy of rfsm", output_of(pattern, [[
        local machine = other.init(model(other, "e"))
        print(require "rfsm_checks".check(machine)[1])
        print(select(2, pcall(require "rfsm.strict".watch, machine))) ]]))
    end)

    it("refuses to run a machine of the other copy, which its own copy runs", function()
      assert.equal("rfsm.run: initialised fsm expected, got state of another copy of "
        .. "rfsm\nroot.a", output_of(pattern, [[
        local machine = other.init(model(other, "e"))
        print(select(2, pcall(rfsm.run, machine)))
        other.run(machine)
        print(other.get_actleaf_fqn(machine)) ]]))
    end)

    it("runs models of the other copy", function()
      assert.equal("root.b", output_of(pattern, [[
        local fsm = rfsm.init(model(other, "e"))
        rfsm.run(fsm)
        rfsm.send_events(fsm, "e")
        rfsm.run(fsm)
        print(rfsm.get_actleaf_fqn(fsm)) ]]))
    end)
  end)
end

describe("a first core", function()
  it("forgets no module that was loaded before it", function()
    assert.equal("true", helper.output_of([[
      local files = require "rfsm.shared.files"
      require "rfsm"
      print(require "rfsm.shared.files" == files) ]]))
  end)
end)
