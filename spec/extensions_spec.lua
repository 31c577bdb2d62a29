-- Rules for all extensions: no state leaks, and an unused one costs nothing.

local helper = require "spec.helper"
local rfsm = require "rfsm"

local state, trans = rfsm.state, rfsm.trans

after_each(helper.remove_files)

local function requires(names)
  local lines = { "package.path = './?.lua;' .. package.path", "require 'rfsm'" }
  for _, name in ipairs(names) do lines[#lines + 1] = ("require '%s'"):format(name) end
  return table.concat(lines, "\n") .. "\n"
end

-- State that must not leak -----------------------------------------------------

local rtt = require "spec.support.rtt"

package.loaded.rtt = rtt

local timeevent = require "rfsm_timeevent"
local proto = require "rfsm.proto"
local rfsm_ext = require "rfsm.monitor"
local socket = require "socket"
local rfsm_rtt = require "rfsm.rtt"
require "rfsm.await"
require "rfsm_checks"
require "rfsm.emem"
require "rfsm.preview"

local now = 0
timeevent.set_gettime_hook(function() return now, 0 end)

-- (initial) -> a --e_leave--> out --e_enter--> a;  a --events--> found
local function around(a, tr)
  tr.src, tr.tgt = "a", "found"
  return state {
    warn = false, info = false, a = a, out = state {}, found = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "out", events = { "e_leave" } },
    trans { src = "out", tgt = "a", events = { "e_enter" } },
    trans(tr),
  }
end

local function inner_machine()
  return state {
    warn = false, info = false, p = state {}, q = state {},
    trans { src = "initial", tgt = "p" },
    trans { src = "p", tgt = "q", events = { "e_x" } },
  }
end

-- Sends a message to a machine over UDP and runs it; returns the last answer.
local function converse(fsm, text)
  local server = proto.install { fsm = fsm, port = 0, allow_send = true }
  local udp, last = socket.udp4(), nil
  udp:setpeername(server.host, server.port)
  udp:settimeout(0)
  udp:send(text)
  socket.select({ server.udp }, nil, 5) -- it has arrived
  rfsm.run(fsm)
  for answer in function() return (udp:receive()) end do last = answer end
  udp:close()
  server:close()
  return last
end

-- For each extension: a model, what gives it something to remember while a is active,
-- and what it remembers.
local EXTENSIONS = {
  timeevent = {
    model = function() return around(state {}, { events = { "e_after(10)" } }) end,
    use = function(fsm)
      now = now + 6
      rfsm.run(fsm)
    end,
    memory = function(fsm) return timeevent.next_deadline(fsm) < 5 end,
  },
  seqand = {
    model = function()
      return around(rfsm.seqand { idle_doo = "auto", s = inner_machine() },
        { events = { "e_none" } })
    end,
    use = function(fsm) helper.post_and_run(fsm, "e_x") end,
    memory = function(fsm) return rfsm.get_actleaf_fqn(fsm.a.substates.s) end,
  },
  ext = {
    model = function()
      return around(rfsm_ext.gen_monitor_state { count = { 0 },
        montab = { e_third = function(_, self)
          self.seen = (self.seen or 0) + 1
          return false
        end }, entry = function(_, self) self.seen = 0 end },
        { events = { "e_third" } })
    end,
    use = function(fsm) rfsm.step(fsm, 5) end,
    memory = function(fsm) return fsm.a.seen > 2 end,
    advance = function(fsm) rfsm.step(fsm, 2) end,
  },
  emem = {
    model = function() return around(state {}, { events = { "e_none" } }) end,
    use = function(fsm) helper.post_and_run(fsm, "e_x") end,
    memory = function(fsm) return fsm.a.emem.e_x or 0 end,
  },
  await = {
    model = function() return around(state {}, { events = { "await(e_x, e_y)" } }) end,
    use = function(fsm) helper.post_and_run(fsm, "e_x") end,
    memory = function(fsm)
      helper.post_and_run(fsm, "e_y")
      return fsm._act_leaf._id
    end,
  },
  proto = {
    model = function() return around(inner_machine(), { events = { "e_none" } }) end,
    use = function(fsm) converse(fsm, '{"type":"event","event":"e_x"}') end,
    memory = function(fsm)
      return converse(fsm, '{"type":"subscribe"}'):match('"act_leaf":"([^"]*)"')
    end,
  },
  preview = {
    model = function()
      local model = around(state {}, { events = { "e_none" },
        likely = function(fsm) return fsm.is_near end })
      model.found.prepare = function(fsm) fsm.is_prepared = true end
      return model
    end,
    use = function(fsm)
      fsm.is_near = true
      rfsm.run(fsm)
      fsm.is_near = false
    end,
    memory = function(fsm)
      local answer = fsm.is_prepared or false
      fsm.is_prepared = false
      rfsm.run(fsm)
      return tostring(answer) .. tostring(fsm.is_prepared)
    end,
    forget = function(fsm) fsm.is_prepared = false end,
  },
  rtt = {
    model = function()
      local feed, events = rtt.OutputPort.new("string"), rtt.InputPort.new("string")
      local out, names = rtt.OutputPort.new("string"), rtt.InputPort.new("string")
      feed:connect(events)
      out:connect(names)
      local model = around(inner_machine(), { events = { "e_none" } })
      model.getevents = rfsm_rtt.gen_read_str_events(events)
      model.post_step_hook = rfsm_rtt.gen_write_fqn(out)
      model.feed, model.names = feed, names
      return model
    end,
    use = function(fsm)
      fsm.feed:write("e_x")
      rfsm.run(fsm)
    end,
    memory = function(fsm) return (select(2, fsm.names:read())) end,
  },
}

local function advance(extension, fsm)
  return (extension.advance or rfsm.run)(fsm)
end

local ORDER = {}
for name in pairs(EXTENSIONS) do ORDER[#ORDER + 1] = name end -- any order: sorted
table.sort(ORDER)

for _, name in ipairs(ORDER) do
  local extension = EXTENSIONS[name]

  local function started(model)
    local fsm = helper.init(model or extension.model())
    advance(extension, fsm)
    return fsm
  end

  -- What a machine remembers that was never used.
  local function fresh_memory() return extension.memory(started()) end

  local function used(model)
    local fsm = started(model)
    extension.use(fsm)
    return fsm
  end

  describe("rfsm_" .. name, function()
    it("remembers something, as long as its state is active", function()
      assert.not_equal(fresh_memory(), extension.memory(used()))
    end)

    it("forgets it when the state is left and entered again", function()
      local fsm = used()
      rfsm.send_events(fsm, "e_leave")
      rfsm.step(fsm)
      rfsm.send_events(fsm, "e_enter")
      rfsm.step(fsm)
      if extension.forget then extension.forget(fsm) end
      advance(extension, fsm)
      assert.equal(fresh_memory(), extension.memory(fsm))
    end)

    it("forgets it at reset", function()
      local fsm = used()
      rfsm.reset(fsm)
      if extension.forget then extension.forget(fsm) end
      advance(extension, fsm)
      assert.equal(fresh_memory(), extension.memory(fsm))
    end)

    it("shares nothing with a second instance of the model", function()
      local model = extension.model()
      local second = helper.init(model)
      used(model)
      advance(extension, second)
      assert.equal(fresh_memory(), extension.memory(second))
    end)

    it("shares nothing with an instance made of the first", function()
      local first = used()
      local second = helper.init(first)
      advance(extension, second)
      assert.equal(fresh_memory(), extension.memory(second))
    end)
  end)
end

-- What the check for undeclared events knows is the structure of its machine: it lasts
-- when states are left, and at reset, but is of no other machine.
describe("rfsm_checks", function()
  local function complaints_of(fsm)
    local lines = {}
    fsm.warn = function(text) lines[#lines + 1] = text end
    helper.post_and_run(fsm, "e_new", "e_none", "e_other")
    return lines
  end

  local function watched(model)
    local fsm = helper.init(model)
    rfsm.run(fsm)
    return fsm
  end

  local function chart()
    local model = around(state {}, { events = { "e_none" } })
    model.checkevents = true
    return model
  end

  local function merged(model)
    local fsm = watched(model)
    assert(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "out",
      events = { "e_new" } }))
    return fsm
  end

  local OTHER = "WARNING: undeclared event e_other received"
  local NEW = "WARNING: undeclared event e_new received"

  it("knows what was merged, also when states are left", function()
    local fsm = merged(chart())
    helper.post_and_run(fsm, "e_leave")
    helper.post_and_run(fsm, "e_enter")
    assert.same({ OTHER }, complaints_of(fsm))
  end)

  it("knows it after reset", function()
    local fsm = merged(chart())
    rfsm.reset(fsm)
    assert.same({ OTHER }, complaints_of(fsm))
  end)

  it("shares nothing with a second instance of the model", function()
    local model = chart()
    local second = watched(model)
    merged(model)
    assert.same({ NEW, OTHER }, complaints_of(second))
  end)

  it("shares nothing with an instance made of the first", function()
    assert.same({ NEW, OTHER }, complaints_of(watched(merged(chart()))))
  end)
end)

-- No cost when unused ----------------------------------------------------------

-- Loads modules in a child; a chart that uses none; prints what hooks are added to it.
local COUNT = [[
local rfsm = require "rfsm"
local added = {}
for _, name in ipairs { "pre_step_hook_add", "post_step_hook_add", "reset_hook_add",
  "entry_hook_add", "exit_hook_add" } do
  local real = rfsm[name]
  rfsm[name] = function(...)
    added[#added + 1] = name
    return real(...)
  end
end
local fsm = rfsm.init(rfsm.state {
  warn = false, info = false, emem = off, checkevents = off,
  a = rfsm.state {}, b = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_x" } },
})
local fields = {}
for _, obj in ipairs { fsm, fsm.a, fsm.b, fsm[2] } do
  for key in pairs(obj) do
    if not known[key] and obj[key] then fields[#fields + 1] = tostring(key) end
  end
end
table.sort(fields)
print(table.concat(added, " ") .. "|" .. table.concat(fields, " "))
]]

-- The same chart before anything was loaded: the fields of the core alone.
local KNOWN = [[
local bare = require "rfsm"
local known = {}
local machine = bare.init(bare.state {
  warn = false, info = false, a = bare.state {}, b = bare.state {},
  bare.trans { src = "initial", tgt = "a" },
  bare.trans { src = "a", tgt = "b", events = { "e_x" } },
})
for _, obj in ipairs { machine, machine.a, machine.b, machine[2] } do
  for key in pairs(obj) do known[key] = true end
end
]]

-- `off`: the chart says that it does without the two that are for all.
local function added_by(names, off)
  local switch = off and "local off = false\n" or "local off = nil\n"
  return helper.output_of(requires {} .. KNOWN .. requires(names) .. switch .. COUNT)
end

local UNUSED = { "rfsm_timeevent", "rfsm_seqand", "rfsm.monitor", "rfsm.await",
  "rfsm.preview", "rfsm_checks", "rfsm.proto", "rfsm.rtt", "rfsmpp", "rfsm.marsh",
  "rfsm.json", "rfsm.plantuml", "rfsm.dot", "rfsm.mermaid" }

describe("a chart that uses no extension", function()
  for _, name in ipairs(UNUSED) do
    it("gets no hook and no field when " .. name .. " is loaded", function()
      assert.equal("|", added_by { name })
    end)
  end

  it("gets none when all of them are loaded", function()
    assert.equal("|", added_by(UNUSED))
  end)

  -- These two are for every machine: loading them is using them.
  it("gets what it counts with when rfsm.emem is loaded", function()
    assert.equal("exit_hook_add pre_step_hook_add reset_hook_add exit_hook_add "
      .. "exit_hook_add|_exit_hooks _has_emem _is_hooked _pre_hooks _reset_hooks "
      .. "_snapshot_hooks emem emem emem", added_by { "rfsm.emem" })
  end)

  it("gets the check when rfsm.checkevents is loaded", function()
    assert.equal("pre_step_hook_add|_checks _is_hooked _pre_hooks",
      added_by { "rfsm.checkevents" })
  end)

  it("gets neither when it says so", function()
    assert.equal("|", added_by({ "rfsm.emem", "rfsm.checkevents" }, true))
  end)
end)
