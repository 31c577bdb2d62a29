-- The sentences of an engineer in examples/press: each holds of the press, and a defect
-- breaks it. doc/patterns.md has them, too.

local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"
require "rfsm_timeevent"

local trans = rfsm.trans

-- The press, and its declarations with only one property.
local function press() return rfsm.load "examples/press/press.lua" end

local function declared(name)
  local options = dofile "examples/press/press_properties.lua"
  options.properties = { [name] = assert(options.properties[name], name) }
  return options
end

-- What breaks a sentence, and the leaves of the run that shows it.
local BROKEN = {
  ["nothing moves while the door is open"] = { function(model)
    model[2].tgt, model[2].src = "closed.braking", "closed.braking"
  end, "on.moving" },
  ["after a stop it stands still within 0.5 s"] = { function(model)
    model.closed[7].events = { "e_after(0.6)" }
  end, "braking" },
  ["it grips only if a part was seen since the last release"] = { function(model)
    model.closed.on[9] = trans { src = "moving", tgt = "gripping",
      events = { "e_grip" } }
  end, "gripping" },
  ["each request is answered before the next"] = { function(model)
    model.closed.on[9] = trans { src = "asked", tgt = "asked",
      events = { "e_request" } }
  end, "asked" },
  ["the horn sounds for 1 s at least before it moves"] = { function(model)
    model.closed.on[3].events = { "e_after(0.9)" }
  end, "moving" },
  ["it is homed before it moves"] = { function(model)
    model.closed[2].tgt = "on"
  end, "moving" },
  ["there is always a way back to ready"] = { function(model)
    model.lost = rfsm.state { final = true }
    model.closed[9] = trans { src = "braking", tgt = "root.lost", events = { "e_x" } }
  end, "lost" },
  ["homing is tried again at most once in 2 s"] = { function(model)
    model.closed[3].events = { "e_after(1.5)" }
  end, "homing" },
  ["after power off it is not on until power comes"] = { function(model)
    model[4].src = "closed.on"
  end, "on.ready" },
  ["a reset resumes at ready"] = { function(model)
    model.closed[8].tgt = ".on.moving"
  end, "on.moving" },
  ["it stands only after it has braked, each time"] = { function(model)
    model.closed[9] = trans { src = "on", tgt = "stopped", events = { "e_halt" } }
  end, "stopped" },
  ["it is always in one of these states"] = { function(model)
    model.closed.lost = rfsm.state {}
    model.closed[9] = trans { src = "homing", tgt = "lost", events = { "e_x" } }
    model.closed[10] = trans { src = "lost", tgt = "off", events = { "e_x" } }
  end, "lost" },
  ["no start is obeyed while it is homing"] = { function(model)
    model.closed[9] = trans { src = "homing", tgt = ".on.horn",
      events = { "e_start" } }
  end, "on.horn" },
  ["above 80 degrees it brakes"] = { function(model)
    model.closed[6].guard = function(_, _, event) return event.celsius > 100 end
  end, "on" },
  ["after a stop nothing moves until a reset"] = { function(model)
    model.closed[5].src = ".on.ready" -- while the horn sounds it is not heard
  end, "moving" },
  ["it is still unless power comes"] = { function(model)
    model.closed[9] = trans { src = "off", tgt = "braking", events = { "e_test" } }
  end, "braking" },
}

describe("the sentence", function()
  local NAMES = dofile("examples/press/press_properties.lua").properties

  it("is one of sixteen, each with a defect that breaks it", function()
    assert.same(rfsm.sorted_keys(NAMES), rfsm.sorted_keys(BROKEN))
    assert.equal(16, #rfsm.sorted_keys(NAMES))
  end)

  for _, name in ipairs(rfsm.sorted_keys(NAMES)) do
    it(("'%s' holds, and is broken by a defect"):format(name), function()
      local model = press()
      local judged = rfsm_checks.explore(model, declared(name)).properties[1]
      assert.same({ true }, { judged.holds, judged.vacuous }, tostring(judged))
      model = press()
      BROKEN[name][1](model)
      judged = rfsm_checks.explore(model, declared(name)).properties[1]
      assert.is_false(judged.holds, tostring(judged))
      assert.matches(BROKEN[name][2], judged.witness[#judged.witness].leaf, 1, true)
      local text, lines = tostring(judged):gsub("\n", "\n")
      assert.is_true(lines <= 2, text)
    end)
  end
end)

describe("a verdict", function()
  it("has three lines at most: the verdict, the run, the premises", function()
    local name = "after power off it is not on until power comes"
    local model = press()
    local judged = rfsm_checks.explore(model, declared(name)).properties[1]
    assert.equal(name .. ": holds\n  (one event a step; stepped between any two "
      .. "deadlines; steps take no time; 2 examples of e_heat)", tostring(judged))
    BROKEN[name][1](model)
    judged = rfsm_checks.explore(model, declared(name)).properties[1]
    assert.equal(name .. ": does not hold\n  closed.off -e_power-> closed.homing "
      .. "-e_power_off-> closed.homing -e_homed-> closed.on.ready",
      (tostring(judged):gsub("\n[^\n]*$", "")))
  end)
end)
