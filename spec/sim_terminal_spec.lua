-- The simulator's terminal with stand-ins for luv, readline and the debug hook:
-- Control-C comes, and the hook is called, where a case wants it.

local helper = require "spec.helper"

local compile = rawget(_G, "loadstring") or load

local function missing() error("none", 0) end

-- Calls f() while modules are replaced; false: the module cannot be loaded.
local function with_modules(modules, f)
  local loaded, preload = {}, {}
  for name, module in pairs(modules) do -- any order: distinct keys
    loaded[name], preload[name] = module, not module and missing
  end
  return helper.with(package.loaded, loaded, function()
    return helper.with(package.preload, preload, f)
  end)
end

-- A luv that calls the handler when it is run. The program goes on as soon as it is
-- stopped.
local function new_luv(world)
  local is_key, handlers, typed = nil, {}, nil
  local signal, poll = {}, {}
  function world.type_control_c() typed = "sigint" end
  function world.type_control_z() typed = "sigtstp" end
  function signal.start(_, name, handler)
    world.note("signal " .. name)
    handlers[name] = handler
  end
  function poll.start(_, kind, f) world.note("start " .. kind) is_key = f end
  function poll.stop() world.note("stop") is_key = nil end
  return {
    new_signal = function() return signal end,
    new_poll = function(descriptor) world.note("watch " .. descriptor) return poll end,
    run = function(mode)
      if world.in_run then world.in_run() end
      if mode == "once" and world.next_key() then is_key() end
      assert(mode == "once" or mode == "nowait", mode)
      if typed then handlers[typed]() end
      typed = nil
    end,
    loop_mode = function() return world.mode end,
    os_getpid = function() return 7 end,
    kill = function(process, name)
      world.note(("kill %d, %s"):format(process, name))
      handlers.sigcont()
    end,
  }
end

-- A readline that gets the keys of `world`; Enter ends the line.
local function new_readline(world)
  local readline, line, finish = {}, "", nil
  function readline.set_options(options)
    world.note("file " .. options.histfile)
    world.note("adds lines itself: " .. tostring(options.auto_add))
  end
  function readline.set_complete_function(f) world.tab = f end
  function readline.set_completion_append_character(text)
    world.note("appends '" .. text .. "'")
  end
  function readline.add_history(text) world.note("keep " .. text) end
  function readline.readline(prompt)
    world.note("whole line " .. prompt)
    return world.line
  end
  function readline.handler_install(prompt, f)
    world.note("install " .. prompt)
    line, finish = "", f
  end
  function readline.handler_remove() world.note("remove") end
  function readline.read_char()
    world.in_key()
    local key = world.key
    if key == "Enter" then return finish(line) end
    if key == "Control-D" then return finish(nil) end
    line = line .. key
  end
  if world.has_no_keys then readline.handler_install = nil end
  return readline
end

-- The modules that `world` has; those missing are false.
local function modules_of(world)
  return { luv = world.counts and new_luv(world) or false,
    readline = world.readline and new_readline(world) or false }
end

-- Loads the terminal; `world` notes what it calls.
local function load_terminal(world)
  local jit = { off = function() world.note("jit off") end }
  local function sethook(hook, mask, period)
    world.hook = hook
    world.note(("hook '%s' %d"):format(mask, period))
  end
  return helper.with(_G, {
    print = function(...) world.note(table.concat({ "print", ... }, " ")) end,
    jit = world.jit and jit or false,
  }, function()
    return helper.with(debug, { sethook = not world.has_no_hooks and sethook or false },
      assert(loadfile("./rfsm/sim/terminal.lua")))
  end)
end

-- Loads the terminal anew, with what `world` has: `counts` (luv), `readline`,
-- `jit`, `home`, `keys`. Returns it with the world, which gets `trace` and `hook`.
local function open(world)
  world.trace, world.in_key = {}, world.in_key or function() end
  function world.note(text) world.trace[#world.trace + 1] = text end
  function world.next_key()
    world.key = assert(table.remove(world.keys, 1), "no key is left")
    if world.key == "Control-C" then world.type_control_c() end
    if world.key == "Control-Z" then world.type_control_z() end
    return not world.key:find("^Control%-[CZ]") and world.key ~= "nothing"
  end
  local modules = modules_of(world)
  function world.within(f) return with_modules(modules, f) end
  return helper.with(os, { getenv = function() return world.home end },
    function() return load_terminal(world) end), world
end

-- A terminal that catches Control-C, and an empty trace.
local function catching(world)
  world.counts = true
  local terminal = open(world)
  world.within(terminal.catch_interrupts)
  world.trace = {}
  return terminal
end

-- Calls f from a function of another source, without a tail call.
local function from(source, f)
  local call = assert(compile("local f = ... local ok = f() return ok", source))
  return function() return (call(f)) end
end

local INTERRUPTED = "/charts/door.lua:1: interrupted!"

-- Is the error raised if the hook is called in a callback?
local function raised_in(world)
  local ok, problem = pcall(from("@/charts/door.lua", world.hook))
  return not ok and problem
end

describe("Control-C", function()
  for _, case in ipairs {
    { counts = true, expected = { "signal sigint", "signal sigtstp",
      "signal sigcont", "hook '' 10000" } },
    { counts = true, jit = true, expected = { "signal sigint", "signal sigtstp",
      "signal sigcont", "hook '' 10000", "jit off" } },
    { expected = {} },
    { counts = true, has_no_hooks = true, expected = {} },
  } do
    it(("is caught once by %s%s%s"):format(case.counts and "luv" or "nothing",
      case.jit and ", with a JIT" or "", case.has_no_hooks and ", no hooks" or ""),
      function()
        local terminal, world = open(case)
        world.within(terminal.catch_interrupts)
        world.within(terminal.catch_interrupts)
        assert.same(case.expected, world.trace)
        assert.equal(case.expected[1] ~= nil, terminal.is_caught())
        assert.is_false(terminal.is_interrupted())
      end)
  end

  it("is noticed once, however often it was typed", function()
    local world = {}
    local terminal = catching(world)
    world.type_control_c()
    world.type_control_c()
    assert.is_true(terminal.is_interrupted())
    assert.is_false(terminal.is_interrupted())
  end)

  it("runs no loop in the loop of a chart, whose callbacks would meet", function()
    local world = { mode = "default" }
    local terminal = catching(world)
    world.type_control_c()
    assert.is_false(terminal.is_interrupted())
    world.mode = nil
    assert.is_true(terminal.is_interrupted())
  end)

  it("raises an error in the code that runs, at its line, once", function()
    local world = {}
    catching(world)
    assert.is_false(raised_in(world))
    world.type_control_c()
    assert.equal(INTERRUPTED, raised_in(world))
    assert.same({ "print" }, world.trace)
    assert.is_false(raised_in(world))
  end)

  it("looks again when the hook was taken, but not if nothing counts", function()
    local world, none = {}, {}
    catching(world).settle()
    assert.same({ "hook '' 10000" }, world.trace)
    open(none).settle()
    assert.same({}, none.trace)
  end)

  it("does not end the code that looks for it", function()
    local world, raised = {}, {}
    catching(world)
    function world.in_run() raised[#raised + 1] = raised_in(world) end
    world.type_control_c()
    assert.equal(INTERRUPTED, raised_in(world))
    assert.same({ false }, raised)
    assert.is_false(raised_in(world))
  end)

  it("ends a callback in a coroutine, whose hook is set first", function()
    local world = {}
    local callback = catching(world).interruptible(function(...) return ... end)
    assert.same({ 1, 2 }, { callback(1, 2) })
    assert.same({ "hook '' 10000" }, world.trace)
  end)
end)

describe("a terminal", function()
  for _, case in ipairs {
    { result = true, is_one = true }, { result = 0, is_one = true },
    { result = 256, is_one = false }, { is_one = false },
  } do
    it(("is asked for: test returns %s"):format(tostring(case.result)), function()
      local command
      assert.equal(case.is_one, helper.with(os, { execute = function(text)
        command = text
        return case.result
      end }, function() return (open {}).is_terminal(1) end))
      assert.equal("test -t 1", command)
    end)
  end

  for _, case in ipairs {
    { advice = "for line editing and the Tab key, for more than one Control-C (on "
      .. "Debian): apt-get install lua-readline lua-luv" },
    { readline = true, advice = "for more than one Control-C (on Debian): apt-get "
      .. "install lua-luv" },
    { counts = true, advice = "for line editing and the Tab key (on Debian): apt-get "
      .. "install lua-readline" },
    { counts = true, readline = true },
  } do
    it("names missing packages: " .. (case.advice or "none"), function()
      local terminal, world = open(case)
      world.within(terminal.catch_interrupts)
      assert.equal(case.advice, world.within(terminal.advice))
    end)
  end
end)

-- Reads a line with the terminals given, after which io.read returns `line`.
local function read_line(terminal, world, terminals, line)
  terminal.is_terminal = function(descriptor) return terminals[descriptor] end
  local read = world.within(function()
    return terminal.new_reader(world.complete or function() end)
  end)
  return helper.with(io, {
    write = function(text) world.note("write " .. text) end,
    flush = function() world.note("flush") end,
    read = function()
      world.note("read")
      if world.is_interrupted then world.type_control_c() end
      if world.is_stopped then
        world.is_stopped = false
        world.type_control_z()
        return nil
      end
      return line
    end,
    popen = function(command)
      world.note(command)
      return { read = function() return "500:5:bf" end, close = function() end }
    end,
  }, function()
    return helper.with(os, { execute = world.note }, function()
      return { terminal.read(read, "> ") }
    end)
  end)
end

describe("a line", function()
  local BOTH, STDIN, STDOUT = { [0] = true, true }, { [0] = true }, { true }

  for _, case in ipairs {
    { does = "from a pipe has no prompt", terminals = STDOUT, line = "x",
      result = { "x", false }, expected = { "read" } },
    { does = "has a prompt without readline", terminals = BOTH, line = "x",
      result = { "x", false }, expected = { "write > ", "flush", "read" } },
    { does = "has a prompt if stdout is a file", terminals = STDIN, line = "x",
      readline = true, result = { "x", false },
      expected = { "write > ", "flush", "read" } },
    { does = "is dropped by Control-C", terminals = STDIN, is_interrupted = true,
      result = { false, false }, expected = { "write > ", "flush", "read", "print" } },
    { does = "drops the lines before if Control-C was before it", terminals = STDIN,
      line = "x", is_interrupted = true,
      result = { "x", true }, expected = { "write > ", "flush", "read" } },
    { does = "is asked for again after Control-Z", terminals = STDIN, line = "x",
      is_stopped = true, result = { "x", false }, expected = { "write > ", "flush",
        "read", "kill 7, sigstop", "write > ", "flush", "read" } },
    { does = "is the end of the input", terminals = STDIN,
      result = { nil, false }, expected = { "write > ", "flush", "read" } },
  } do
    it(case.does, function()
      local result = read_line(catching(case), case, case.terminals, case.line)
      assert.same({ case.result[1], case.result[2] }, { result[1], result[2] })
      assert.same(case.expected, case.trace)
    end)
  end
end)

describe("reading", function()
  for _, case in ipairs {
    { does = "returns a line", line = "x", result = { true, "x", false } },
    { does = "drops the lines before on an interrupt",
      problem = "stdin:1: interrupted!", result = { true, false, true } },
    { does = "raises any other error as it is", problem = "no line",
      result = { false, "no line" } },
  } do
    it(case.does, function()
      local terminal = open {}
      assert.same(case.result, { pcall(terminal.read, function(prompt)
        assert.equal(">> ", prompt)
        if case.problem then error(case.problem, 0) end
        return case.line
      end, ">> ") })
    end)
  end

  it("lets Control-C end code again, also after an error", function()
    local world = {}
    local terminal = catching(world)
    terminal.read(function()
      world.type_control_c()
      error(raised_in(world), 0)
    end, "> ")
    world.type_control_c()
    assert.equal(INTERRUPTED, raised_in(world))
  end)
end)

describe("a line of readline", function()
  -- Reads a line in a new home folder: the result, the trace behind the settings, and
  -- the file of lines.
  local function edited(world)
    local home = helper.file_with("")
    local name = home .. ".d/.rfsm_sim_history"
    os.execute("mkdir " .. home .. ".d")
    helper.write(name, "one\n")
    world.readline = true
    world.home = world.has_no_home and "/no/folder" or home .. ".d"
    local terminal = world.counts and catching(world) or open(world)
    local result = read_line(terminal, world, { [0] = true, true })
    local file = io.open(name)
    local lines = file:read("*a"):match("^one\n(.*)")
    file:close()
    os.execute("rm -r " .. home .. ".d")
    assert.same({ "file " .. world.home .. "/.rfsm_sim_history",
      "adds lines itself: false" }, { world.trace[1], world.trace[2] })
    local trace = table.concat(world.trace, ", ", 3):gsub("^stty %-g 2>/dev/null, ", "")
    return result, trace, lines, terminal
  end

  after_each(helper.remove_files)

  for _, case in ipairs {
    { does = "is read key by key, and kept", counts = true,
      keys = { "o", "nothing", "n", "Enter" }, result = { "on", false }, lines = "on\n",
      expected = "install > , watch 0, start r, stop, start r, stop, start r, stop, "
        .. "start r, stop, remove, keep on" },
    { does = "is kept if there is no folder for it", counts = true,
      has_no_home = true, keys = { "o", "Enter" }, result = { "o", false }, lines = "",
      expected = "install > , watch 0, start r, stop, start r, stop, remove, keep o" },
    { does = "begins anew after Control-Z, with the modes of the shell in between",
      counts = true, keys = { "o", "Control-Z", "n", "Enter" },
      result = { "n", false }, lines = "n\n",
      expected = "install > , watch 0, start r, stop, start r, stty 500:5:bf "
        .. "2>/dev/null, kill 7, sigstop, stop, stty -icanon -echo 2>/dev/null, "
        .. "install > , start r, stop, start r, stop, remove, keep n" },
    { does = "is not kept if it is blank", counts = true, keys = { " ", "Enter" },
      result = { " ", false }, lines = "",
      expected = "install > , watch 0, start r, stop, start r, stop, remove" },
    { does = "is the end of the input", counts = true, keys = { "Control-D" },
      result = { nil, false }, lines = "",
      expected = "install > , watch 0, start r, stop, remove" },
    { does = "is dropped by Control-C", counts = true, keys = { "o", "Control-C" },
      result = { false, false }, lines = "",
      expected = "install > , watch 0, start r, stop, start r, stop, print" },
    { does = "is read at once by a readline without keys", counts = true,
      has_no_keys = true, line = "on", result = { "on", false }, lines = "on\n",
      expected = "whole line > , keep on" },
    { does = "is read at once if Control-C is not caught", line = "on",
      result = { "on", false }, lines = "on\n", expected = "whole line > , keep on" },
  } do
    it(case.does, function()
      local result, trace, lines = edited(case)
      assert.same({ case.result[1], case.result[2] }, { result[1], result[2] })
      assert.equal(case.expected, trace)
      assert.equal(case.lines, lines)
    end)
  end

  it("is not left by an error of the hook, also while a key is read", function()
    local raised, world = nil, { counts = true, keys = { "o", "Enter" } }
    function world.in_key()
      if world.key ~= "o" then return end
      world.type_control_c()
      raised = raised_in(world)
    end
    assert.same({ false, false }, (edited(world)))
    assert.is_false(raised)
    world.type_control_c()
    assert.equal(INTERRUPTED, raised_in(world))
  end)

  it("is not left while it waits for a key", function()
    local raised, world = {}, { counts = true, readline = true,
      keys = { "o", "Control-C" } }
    local terminal = catching(world)
    local next_key = world.next_key
    function world.next_key()
      local has_key = next_key()
      raised[#raised + 1] = raised_in(world)
      return has_key
    end
    assert.same({ false, false }, read_line(terminal, world, { [0] = true, true }))
    assert.same({ false, false }, raised)
  end)

  it("is completed by the Tab key; a completion that fails has no words", function()
    local asked = {}
    local world = { line = "x", complete = function(word, before)
      asked[#asked + 1] = before .. "|" .. word
      if word == "" then error("none") end
      return { word .. "ot" }
    end }
    edited(world)
    assert.same({ "spot" }, world.tab("breakpoint sp", 12, 13))
    assert.same({}, world.tab("ser ", 5, 4))
    assert.same({ "breakpoint |sp", "ser |" }, asked)
    assert.equal("appends ''", world.trace[#world.trace])
  end)
end)
