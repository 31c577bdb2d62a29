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

-- (initial) -> a --e_leave--> out --e_enter--> a;  a --event, or e_none--> found
local function around(a, event)
  return state {
    warn = false, info = false, a = a, out = state {}, found = state {},
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "out", events = { "e_leave" } },
    trans { src = "out", tgt = "a", events = { "e_enter" } },
    trans { src = "a", tgt = "found", events = { event or "e_none" } },
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

local function send_x(fsm) helper.post_and_run(fsm, "e_x") end

-- For each extension: a model, what gives it something to remember while a is active,
-- and what it remembers.
local EXTENSIONS = {
  timeevent = {
    model = function() return around(state {}, "e_after(10)") end,
    use = function(fsm)
      now = now + 6
      rfsm.run(fsm)
    end,
    memory = function(fsm) return timeevent.next_deadline(fsm) < 5 end,
  },
  seqand = {
    model = function()
      return around(rfsm.seqand { idle_doo = "auto", s = inner_machine() })
    end,
    use = send_x,
    memory = function(fsm) return rfsm.get_actleaf_fqn(fsm.a.substates.s) end,
  },
  ext = {
    model = function()
      return around(rfsm_ext.gen_monitor_state {
        entry = function(_, self) self.seen = 0 end,
        montab = { e_third = function(_, self)
          self.seen = self.seen + 1
          return false
        end },
      }, "e_third")
    end,
    use = function(fsm) rfsm.step(fsm, 5) end,
    memory = function(fsm) return fsm.a.seen > 2 end,
    advance = function(fsm) rfsm.step(fsm, 2) end,
  },
  emem = {
    model = function() return around(state {}) end,
    use = send_x, memory = function(fsm) return fsm.a.emem.e_x or 0 end,
  },
  await = {
    model = function() return around(state {}, "await(e_x, e_y)") end,
    use = send_x, memory = function(fsm) return helper.leaf_after(fsm, "e_y") end,
  },
  proto = {
    model = function() return around(inner_machine()) end,
    use = function(fsm) converse(fsm, '{"type":"event","event":"e_x"}') end,
    memory = function(fsm)
      return converse(fsm, '{"type":"subscribe"}'):match('"act_leaf":"([^"]*)"')
    end,
  },
  preview = {
    model = function()
      local model = around(state {})
      model[4].likely = function(fsm) return fsm.is_near end
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
      local function connected()
        local into, out = rtt.InputPort.new("string"), rtt.OutputPort.new("string")
        out:connect(into)
        return into, out
      end
      local events, feed = connected()
      local names, out = connected()
      local model = around(inner_machine())
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

local function started(extension, model)
  local fsm = helper.init(model or extension.model())
  advance(extension, fsm)
  return fsm
end

local function used(extension, model)
  local fsm = started(extension, model)
  extension.use(fsm)
  return fsm
end

local function forgetting(extension, fsm)
  if extension.forget then extension.forget(fsm) end
  advance(extension, fsm)
  return fsm
end

-- Each returns a machine that must remember nothing.
local FORGETS = {
  ["when the state is left and entered again"] = function(extension)
    local fsm = used(extension)
    for _, event in ipairs { "e_leave", "e_enter" } do
      rfsm.send_events(fsm, event)
      rfsm.step(fsm)
    end
    return forgetting(extension, fsm)
  end,
  ["at reset"] = function(extension)
    local fsm = used(extension)
    rfsm.reset(fsm)
    return forgetting(extension, fsm)
  end,
  ["in a second instance of the model"] = function(extension)
    local model = extension.model()
    local second = helper.init(model)
    used(extension, model)
    advance(extension, second)
    return second
  end,
  ["in an instance made of the first"] = function(extension)
    return started(extension, used(extension))
  end,
}

for name, extension in pairs(EXTENSIONS) do -- any order: each stands alone
  describe("rfsm_" .. name, function()
    it("remembers something, as long as its state is active", function()
      assert.not_equal(extension.memory(started(extension)),
        extension.memory(used(extension)))
    end)

    for when, forget in pairs(FORGETS) do -- any order: as above
      it("has forgotten it " .. when, function()
        local fsm = forget(extension)
        assert.equal(extension.memory(started(extension)), extension.memory(fsm))
      end)
    end
  end)
end

-- What the check for undeclared events knows is the structure of its machine: it lasts
-- when states are left, and at reset, but is of no other machine.
describe("rfsm_checks", function()
  local function complaints_of(fsm)
    local lines = helper.said(fsm, "warn")
    helper.post_and_run(fsm, "e_new", "e_none", "e_other")
    return lines
  end

  local function chart()
    local model = around(state {})
    model.checkevents = true
    return model
  end

  local function merged(model)
    local fsm = helper.started(model)
    assert(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "out",
      events = { "e_new" } }))
    return fsm
  end

  local OTHER = "WARNING: undeclared event e_other received"
  local NEW = "WARNING: undeclared event e_new received"

  it("knows what was merged, also when states are left, and after reset", function()
    local fsm = merged(chart())
    helper.post_and_run(fsm, "e_leave")
    helper.post_and_run(fsm, "e_enter")
    assert.same({ OTHER }, complaints_of(fsm))
    rfsm.reset(fsm)
    rfsm.run(fsm)
    assert.same({ OTHER }, complaints_of(fsm))
  end)

  it("shares nothing with other instances", function()
    local model = chart()
    local second = helper.started(model)
    merged(model)
    assert.same({ NEW, OTHER }, complaints_of(second))
    assert.same({ NEW, OTHER }, complaints_of(helper.started(merged(chart()))))
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

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local UNUSED = { "rfsm_seqand", "rfsm.monitor", "rfsm.await",
  "rfsm.preview", "rfsm_checks", "rfsm.proto", "rfsm.rtt", "rfsmpp", "rfsm.marsh",
  "rfsm.json", "rfsm.plantuml", "rfsm.dot", "rfsm.mermaid" }

describe("a chart that uses no extension", function()
  it("gets no hook and no field when all of them are loaded", function()
    assert.equal("|", added_by(UNUSED))
  end)

  it("gets what loads a snapshot when rfsm_timeevent is loaded", function()
    assert.equal("|_snapshot_hooks", added_by { "rfsm_timeevent" })
  end)

  -- These two are for every machine: loading them is using them.
  it("gets what it counts with when rfsm.emem is loaded", function()
    assert.equal("pre_step_hook_add reset_hook_add exit_hook_add exit_hook_add "
      .. "exit_hook_add|_emem _exit_hooks _reset_hooks _snapshot_hooks emem "
      .. "emem emem", added_by { "rfsm.emem" })
  end)

  it("gets the check when rfsm.checkevents is loaded", function()
    assert.equal("pre_step_hook_add|_checks",
      added_by { "rfsm.checkevents" })
  end)

  it("gets neither when it says so", function()
    assert.equal("|", added_by({ "rfsm.emem", "rfsm.checkevents" }, true))
  end)
end)

describe("an extension may ask", function()
  local model = state {
    info = false, warn = false, a = state {}, b = state { c = state {},
      trans { src = "initial", tgt = "c" } },
    trans { src = "initial", tgt = "a" },
    trans { src = "a", tgt = "b", events = { "e" } },
    trans { src = "b.c", tgt = "internal", events = { "e" } },
    trans { src = "b.c", tgt = "b.c", events = { "e_again" } },
  }

  it("for the model of a machine and its elements", function()
    local fsm = assert(rfsm.init(model))
    assert.equal(model, rfsm.model_of(fsm))
    assert.equal(model.b.c, rfsm.model_of(fsm.b.c))
    assert.equal(model[2], rfsm.model_of(fsm[2]))
    for _, value in ipairs({ model, model.a, {}, "text", setmetatable({}, {}) }) do
      assert.equal(value, rfsm.model_of(value))
    end
  end)

  it("for what machines of the same structure share, until one is merged", function()
    local first, second = assert(rfsm.init(model)), assert(rfsm.init(model))
    local structure = rfsm.structure_of(first)
    assert.equal(structure, rfsm.structure_of(second))
    assert.equal(structure, rfsm.structure_of(rfsm.init(second)))
    assert(rfsm.fsm_merge(second, second, state {}, "d"))
    assert.equal(structure, rfsm.structure_of(first))
    assert.not_equal(structure, rfsm.structure_of(second))
  end)

  it("for that also if callbacks know their machine, which is collected", function()
    local weak = setmetatable({}, { __mode = "k" })
    for i = 1, 20 do
      local fsm
      fsm = assert(rfsm.init(state { info = false, warn = false, number = i,
        entry = function() rfsm.send_events(fsm, "e") end }))
      weak[rfsm.structure_of(fsm) and fsm] = true
    end
    collectgarbage()
    collectgarbage()
    local count = 0
    for _ in pairs(weak) do count = count + 1 end -- any order: counted
    assert.is_true(count <= 1, count .. " machines are left")
  end)

  it("for the target that the model names, whatever it is now", function()
    local fsm, names = assert(rfsm.init(model)), {}
    fsm[2].tgt = fsm.a
    for i = 1, 4 do names[i] = rfsm.target_of(fsm[i]) end
    assert.same({ "root.a", "root.b.initial", "internal", "root.b.c" }, names)
    assert.is_true(rfsm.fsm_merge(fsm, fsm, state {}, "new"))
    assert.equal("root.b.initial", rfsm.target_of(fsm[2]))
  end)

  it("for the hooks that keep something, in order", function()
    local fsm = assert(rfsm.init(state {
      info = false, warn = false, checkevents = false, emem = false, a = state {},
      trans { src = "initial", tgt = "a" },
    }))
    local function save() end
    local function load() end
    local own = #rfsm.snapshot_hooks(fsm) -- of extensions that are loaded
    for _, name in ipairs({ "one", "two" }) do
      rfsm.snapshot_hook_add(fsm, name, save, load)
    end
    assert.same({ { name = "one", save = save, load = load },
      { name = "two", save = save, load = load } },
      { unpack(rfsm.snapshot_hooks(fsm), own + 1) })
  end)

  it("whether a root wants more warnings", function()
    local getenv = os.getenv
    finally(function() os.getenv = getenv end) -- luacheck: ignore 122
    local CASES = {
      { env = nil, strict = nil, expected = false },
      { env = nil, strict = true, expected = true },
      { env = "1", strict = nil, expected = true },
      { env = "1", strict = false, expected = false },
      { env = "0", strict = nil, expected = false },
    }
    for _, case in ipairs(CASES) do
      os.getenv = function() return case.env end -- luacheck: ignore 122
      assert.equal(case.expected, rfsm.is_strict(state { strict = case.strict }))
    end
  end)
end)

describe("a path hook", function()
  -- initial --1--> a --2--> k --3--> b.initial --b1--> b.x, b --4--> a,
  -- b.x --b2--> internal. Number 0 has the text of 2 and is tried first, in vain.
  local function machine(uses, change)
    local trace = {}
    local function no() return false end
    local fsm = helper.init(state { checkevents = false, emem = false, err = false,
      a = state { exit = helper.noting(trace, "exit") }, k = rfsm.conn {},
      b = state { x = state {}, trans { src = "initial", tgt = "x" },
        trans { src = "x", tgt = "internal", events = { "i" },
          effect = helper.noting(trace, "effect") } },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "k", events = { "e" } },
      trans { src = "k", tgt = "b" },
      trans { src = "b", tgt = "a", events = { "e" } },
      [0] = trans { src = "a", tgt = "k", events = { "e" }, guard = no },
    })
    if change then change(fsm) end
    for _ = 1, uses do
      for _, event in ipairs { "e", "i", "e" } do helper.post_and_run(fsm, event) end
    end
    rfsm.reset(fsm)
    helper.clear(trace)
    return fsm, trace
  end

  -- Names transitions by where they are in the machine.
  local function names(fsm, path)
    local texts = {}
    for i, tr in ipairs(path) do
      for name, owner in pairs { [""] = fsm, b = fsm.b } do -- any order: one has it
        for n = 0, 5 do
          if rawequal(owner[n], tr) then texts[i] = name .. n end
        end
      end
    end
    return table.concat(texts, " ")
  end

  local CASES = {
    ["a new machine"] = { uses = 0 },
    ["a machine in use"] = { uses = 9 },
    ["a prepared machine"] = { uses = 0, change = rfsm.prepare },
    ["a machine with dbg"] = { uses = 9, change = function(fsm)
      fsm.dbg = function() end
    end },
  }
  for _, name in ipairs(rfsm.sorted_keys(CASES)) do
    it("is called before each path is taken, with its transitions: " .. name, function()
      local fsm, trace = machine(CASES[name].uses, CASES[name].change)
      rfsm.path_hook_add(fsm, function(of, path)
        assert(rawequal(of, fsm))
        trace[#trace + 1] = names(fsm, path)
      end)
      for _, event in ipairs { "e_init_fsm", "e", "i", "other", "e" } do
        helper.post_and_run(fsm, event)
      end
      assert.same({ "1", "2 3 b1", "exit", "b2", "effect", "4" }, trace)
    end)
  end

  it("gets a list that it may keep", function()
    local fsm, kept = machine(0), {}
    rfsm.path_hook_add(fsm, function(_, path) kept[#kept + 1] = path end)
    for _ = 1, 12 do helper.post_and_run(fsm, "e") end
    for i, path in ipairs(kept) do
      assert.equal(i == 1 and "1" or i % 2 == 0 and "2 3 b1" or "4", names(fsm, path))
      for j = 1, i - 1 do assert.is_false(rawequal(path, kept[j])) end
    end
    assert.equal(12, #kept)
  end)

  it("that fails is told when the iteration is over; the path is taken", function()
    for _, uses in ipairs { 0, 9 } do
      local fsm, trace = machine(uses)
      rfsm.run(fsm)
      rfsm.path_hook_add(fsm, function() error("no path", 0) end)
      rfsm.path_hook_add(fsm, helper.noting(trace, "second"))
      rfsm.send_events(fsm, "e")
      assert.same({ false, "no path" }, { pcall(rfsm.step, fsm) })
      assert.same({ "second", "exit" }, trace)
      assert.equal("root.b.x", rfsm.get_actleaf_fqn(fsm))
    end
  end)

  it("may be added and removed in a run, which counts from the next path on", function()
    for _, uses in ipairs { 0, 9 } do
      local fsm, trace = machine(uses)
      local second = helper.noting(trace, "second")
      rfsm.run(fsm)
      fsm.a.exit = function() rfsm.path_hook_add(fsm, second) end
      rfsm.path_hook_add(fsm, function()
        local is_removed = rfsm.path_hook_rm(fsm, second)
        trace[#trace + 1] = "first removes: " .. tostring(is_removed)
      end)
      for _, event in ipairs { "e", "i", "i" } do helper.post_and_run(fsm, event) end
      assert.same({ "first removes: false", "first removes: true", "second", "effect",
        "first removes: false", "effect" }, trace)
    end
  end)
end)

describe("took_path", function()
  -- a --e--> b --e--> a; "wait" is what nothing waits for
  local function flip_flop(fields)
    local model = { a = state {}, b = state {}, emem = false, checkevents = false,
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e" } },
      trans { src = "b", tgt = "a", events = { "e" } } }
    for name, value in pairs(fields or {}) do model[name] = value end -- any order
    return helper.init(state(model))
  end

  for _, uses in ipairs { 0, 9 } do
    it("tells once that a path was taken, after " .. uses .. " uses", function()
      local fsm, seen = flip_flop(), {}
      for _ = 1, uses do helper.post_and_run(fsm, "e") end
      rfsm.reset(fsm)
      rfsm.took_path(fsm)
      for i, event in ipairs { "e_init_fsm", "wait", "e", "wait" } do
        helper.post_and_run(fsm, event)
        seen[2 * i - 1], seen[2 * i] = rfsm.took_path(fsm), rfsm.took_path(fsm)
      end
      assert.same({ true, false, false, false, true, false, false, false }, seen)
    end)
  end

  it("tells of none before the first step", function()
    assert.is_false(rfsm.took_path(flip_flop()))
  end)

  it("tells of a path before an element was merged, not before a snapshot is put",
    function()
      local fsm = flip_flop()
      rfsm.run(fsm)
      assert(rfsm.fsm_merge(fsm, fsm, trans { src = "a", tgt = "b" }))
      assert.is_true(rfsm.took_path(fsm))
      helper.post_and_run(fsm, "e")
      rfsm.place(fsm, fsm.a, "done", {})
      assert.is_false(rfsm.took_path(fsm))
    end)

  it("is true in a callback of the path, which goes on all the same", function()
    local seen, fsm = {}, nil
    fsm = flip_flop { dbg = function() end, b = state { entry = function()
      seen[#seen + 1] = rfsm.took_path(fsm)
    end } }
    rfsm.run(fsm)
    rfsm.took_path(fsm)
    helper.post_and_run(fsm, "e")
    assert.same({ { true }, "root.b", true },
      { seen, rfsm.get_actleaf_fqn(fsm), rfsm.took_path(fsm) })
  end)
end)

describe("a watch hook", function()
  -- a --e--> b (its entry, the guard in front of it and the doo of c fail) --e--> c
  local function watched()
    local trace = {}
    local fsm = helper.init(state {
      checkevents = false, emem = false, err = false,
      a = state {}, b = state { entry = function() error("no b", 0) end },
      c = state { doo = function() rfsm.yield(true) error("no c", 0) end },
      d = state { doo = function() rfsm.yield(true) end },
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", pn = 1, events = { "e" },
        guard = function() error("no guard", 0) end },
      trans { src = "a", tgt = "b", events = { "e" } },
      trans { src = "b", tgt = "c", events = { "e" } },
      trans { src = "c", tgt = "d", events = { "e" } },
    })
    local hooks = {}
    for _, what in ipairs { "sent", "failed", "resumed", "ended", "merged" } do
      hooks[what] = function(machine, ...)
        assert(rawequal(machine, fsm))
        local words = { what }
        for i = 1, select("#", ...) do words[i + 1] = tostring((select(i, ...))) end
        trace[#trace + 1] = table.concat(words, " "):gsub("T={ src='root%.", "{")
          :gsub("', tgt='root%.", " ")
      end
      rfsm.watch_hook_add(fsm, what, hooks[what])
    end
    return fsm, trace, hooks
  end

  it("is told of events, failures and doos, in order", function()
    local fsm, trace = watched()
    for _, event in ipairs { false, "e", "e", "e" } do
      rfsm.send_events(fsm, event or nil)
      rfsm.run(fsm)
      rfsm.run(fsm)
    end
    assert.same({
      "sent nil", "sent e", "failed {a b', pn=1, events='e' } guard no guard",
      "failed state root.b (active) entry no b", "sent e",
      "resumed state root.c (active)", "resumed state root.c (active)",
      "failed state root.c (done) doo no c", "sent e",
      "resumed state root.d (active)", "resumed state root.d (active)",
      "ended state root.d (done)",
    }, trace)
  end)

  it("is told of what is merged, and of nothing once it is removed", function()
    local fsm, trace, hooks = watched()
    assert(rfsm.fsm_merge(fsm, fsm, state { final = true }, "z"))
    assert.same({ "merged state root.z (inactive)" }, trace)
    for what, hook in pairs(hooks) do -- any order: all of them
      assert.same({ false, true, false }, { rfsm.watch_hook_rm(fsm, "other", hook),
        rfsm.watch_hook_rm(fsm, what, hook), rfsm.watch_hook_rm(fsm, what, hook) })
    end
    rfsm.send_events(fsm, "e")
    rfsm.run(fsm)
    assert.equal(1, #trace)
  end)

  it("that fails is told at the iteration's end, and the machine goes on", function()
    local fsm = watched()
    rfsm.run(fsm)
    rfsm.watch_hook_add(fsm, "failed", function() error("no watch", 0) end)
    rfsm.send_events(fsm, "e")
    assert.same({ false, "no watch" }, { pcall(rfsm.step, fsm) })
    assert.equal("root.b", rfsm.get_actleaf_fqn(fsm))
  end)

  it("is for something that there is", function()
    assert.equal("rfsm.watch_hook_add: 'sent', 'failed', 'failed_inside', 'resumed', "
      .. "'ended', 'merged' or 'discarded' expected, got string 'send'",
      helper.refusal(rfsm.watch_hook_add, watched(), "send", print))
  end)

  it("may ask if the machine is idle, in a step hook beside it", function()
    local fsm, trace = watched(), {}
    rfsm.post_step_hook_add(fsm, function()
      trace[#trace + 1] = ("%s %s"):format(rfsm.get_actleaf_fqn(fsm),
        tostring(rfsm.is_idle(fsm)))
    end)
    rfsm.run(fsm)
    rfsm.send_events(fsm, "e")
    rfsm.run(fsm)
    assert.same({ "root.a false", "root.a false", "root.a true", "root.b false",
      "root.b false", "root.b true" }, trace)
  end)
end)
