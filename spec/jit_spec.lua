-- LuaJIT compiles the loop of a host that drives a machine. A loop that it gives up is
-- marked in its bytecode, and interpreted from then on.

local rfsm = require "rfsm"

local jit = rawget(_G, "jit")
if type(jit) ~= "table" then return end -- the other interpreters compile nothing

local util, vmdef = require "jit.util", require "jit.vmdef"

local state, trans = rfsm.state, rfsm.trans
local send_events, step, run = rfsm.send_events, rfsm.step, rfsm.run

local count = 0
local function callback() count = count + 1 end

-- A branch of `depth` states.
local function branch(depth)
  local member = state { entry = callback, exit = callback }
  if depth > 1 then
    member.s, member[1] = branch(depth - 1), trans { src = "initial", tgt = "s" }
  end
  return member
end

-- a and b, `depth` states deep.
local function new_machine(depth)
  local down = (".s"):rep(depth - 1)
  local fsm = rfsm.init(state {
    info = false, warn = false, a = branch(depth), b = branch(depth),
    trans { src = "initial", tgt = "a" },
    trans { src = "root.a" .. down, tgt = "root.b" .. down, events = { "e_b" } },
    trans { src = "root.b" .. down, tgt = "root.a" .. down, events = { "e_a" } },
  })
  run(fsm)
  rfsm.prepare(fsm)
  return fsm
end

local LOOPS = {
  ["one event"] = function(fsm, n)
    for i = 1, n do
      send_events(fsm, i % 2 == 1 and "e_b" or "e_a")
      step(fsm)
    end
  end,
  ["two events"] = function(fsm, n)
    for _ = 1, n do
      send_events(fsm, "e_b")
      step(fsm)
      send_events(fsm, "e_a")
      step(fsm)
    end
  end,
  ["run"] = function(fsm, n)
    for i = 1, n do
      send_events(fsm, i % 2 == 1 and "e_b" or "e_a")
      run(fsm)
    end
  end,
  ["random events"] = function(fsm, n)
    local random = 1
    for _ = 1, n do
      random = random * 16807 % 2147483647
      send_events(fsm, random % 2 == 1 and "e_b" or "e_a")
      step(fsm)
    end
  end,
}

-- Returns the names of the instructions of a function that stand for a given up loop.
local function given_up(f)
  local names, pc = {}, 0
  local instruction = util.funcbc(f, pc)
  while instruction do
    local at = instruction % 256 * 6 + 1
    local name = vmdef.bcnames:sub(at, at + 5):gsub(" ", "")
    if name:find "^I[FLT][OIU]" then names[#names + 1] = name end
    pc = pc + 1
    instruction = util.funcbc(f, pc)
  end
  return names
end

describe("LuaJIT does not give up a loop, or what it calls, with", function()
  for _, name in ipairs(rfsm.sorted_keys(LOOPS)) do
    for _, depth in ipairs { 1, 6 } do
      it(("%s, states %d deep"):format(name, depth), function()
        jit.flush()
        LOOPS[name](new_machine(depth), 100000)
        -- "PHI shuffling too complex": what the loop calls is compiled all the same
        if name ~= "run" then assert.same({}, given_up(LOOPS[name])) end
        for _, f in ipairs { send_events, step, run } do
          assert.same({}, given_up(f))
        end
      end)
    end
  end
end)

-- Returns the functions of the library in which LuaJIT compiles a traversal by `next`
-- while f() runs, as a set of places.
local function traversals(f)
  local found, last = {}, nil
  local function record(_, func, pc)
    local is_next = func == next
    if pc >= 0 then
      local at = util.funcbc(func, pc) % 256 * 6 + 1
      last, is_next = func, vmdef.bcnames:sub(at, at + 5) == "ITERN "
    end
    local info = is_next and util.funcinfo(last)
    local is_own = info and info.source:find("rfsm", 1, true)
      and not info.source:find("spec/", 1, true)
    if is_own then found[info.source .. ":" .. info.linedefined] = true end
  end
  jit.flush()
  jit.attach(record, "record")
  local ok, problem = pcall(f)
  jit.attach(record)
  assert.is_true(ok, problem)
  return rfsm.sorted_keys(found)
end

-- Machine code of LuaJIT 2.1.0-beta3 may lose half of a pointer that `next` returns.
describe("LuaJIT compiles no traversal in what makes and runs", function()
  for _, name in ipairs { "timeevent", "defer", "seqand", "observers" } do
    it("the machines of the claim " .. name, function()
      local claim = require("spec.support.claims." .. name)
      assert.same({}, traversals(function() claim.run(20, 7) end))
    end)
  end
end)
