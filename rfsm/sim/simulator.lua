--- The simulator: steps through a chart by hand, with Lua at the prompt.
--
-- It is the command `rfsm sim`. Code at the prompt can use the machine `fsm` and the
-- commands that `help()` lists, and can read and set the globals of the chart.
-- `rfsm.sim.session` advances the machine, `rfsm.sim.commands` has the commands, and
-- `rfsm.sim.prompt` reads and evaluates lines.
--
-- @module rfsm.sim.simulator
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsmpp = require "rfsmpp"
local calls = require "rfsm.shared.calls"
local history = require "rfsm.sim.history"
local prompt = require "rfsm.sim.prompt"
local terminal = require "rfsm.sim.terminal"

local io, ipairs, print = io, ipairs, print
local complain = terminal.complain

local rfsm_sim = { VERSION = rfsm._VERSION:match("%S+$") }

-- Runs the texts of the option -e until one quits. Returns false if a text fails.
local function run_code(sim, texts)
  for _, text in ipairs(texts) do
    if sim.is_over then break end
    local ok, problem = prompt.evaluate(sim, text, "=(command line)")
    if not ok then
      complain("rfsm sim: " .. problem)
      return false
    end
  end
  return true
end

-- Runs the machine through a recording. Returns false if the recording cannot be read.
local function replay(sim, file)
  local ok, count, problem = calls.try(sim.replay or history.replay, sim, file)
  if not ok then
    complain("rfsm sim: " .. rfsm.text_of(count))
    return false
  end
  if problem then complain("rfsm sim: " .. file .. ": " .. problem) end
  if count > 0 then
    print(("replayed %d %s of %s"):format(count, sim.replay and "moves" or "iterations",
      file))
    sim:show()
  end
  return not problem or count > 0
end

-- Puts the machine where a file of a fleet has it. Returns false if that is wrong.
local function begin_from(sim, file)
  local ok, count, key = false, "--from is for a chart, not for a system", nil
  if not sim.cell then ok, count, key = calls.try(history.from, sim, file) end
  if not ok then
    complain("rfsm sim: " .. rfsm.text_of(count))
    return false
  end
  print(("%s: %d moves in its history%s"):format(key or file, count, count > 0
    and " ('back' goes there)" or ""))
  sim:show()
  return true
end

local function greet(sim, is_terminal)
  print("rFSM simulator v" .. rfsm_sim.VERSION
    .. ", type 'help()' to list available commands")
  if not is_terminal then return end
  if not sim.cell then
    print("'run' enters the machine, then 'events' lists what it would react to")
  end
  local advice = terminal.advice()
  if advice then print(advice) end
end

--- The options of `rfsm sim`.
---@class rfsm.sim.Options
---@field file string file of the chart
---@field execute? string[] Lua texts to run at the beginning
---@field from? string file of a machine in which to begin
---@field replay? string recording to replay at the beginning
---@field stub? boolean modules and globals that are missing do nothing
---@field dry? boolean call no functions of the chart; guards count as true
---@field quiet? boolean print no banner, and no infos about the chart
---@field interactive? boolean read commands after `execute`, too

-- Applies the options. Returns the exit status if there is to be no prompt.
local function prepare(sim, options)
  prompt.install(sim)
  if options.dry then sim:set_dry(true) end
  if options.from and not begin_from(sim, options.from) then return 2 end
  if options.replay and not replay(sim, options.replay) then return 1 end
  local code = options.execute or {}
  if not run_code(sim, code) then return 1 end
  return (sim.is_over or code[1] and not options.interactive) and 0
end

--- Open a chart, run the given code, and read commands from stdin. Return the exit
-- status: 1 if the chart, the code, or a line from a pipe is wrong, else 0.
---@param options rfsm.sim.Options
---@param open function opens the chart, as `session.open` does
function rfsm_sim.main(options, open)
  local is_terminal = terminal.is_terminal(0)
  rfsmpp.is_plain = not terminal.is_terminal(1)
  io.stdout:setvbuf("line")
  if is_terminal then terminal.catch_interrupts() end
  local sim, problems = open(options.file, is_terminal, options.stub,
    options.quiet)
  if not sim then
    for _, problem in ipairs(problems) do
      complain("rfsm sim: " .. problem:gsub("\n", "\nrfsm sim: "))
    end
    return 1
  end
  local status = prepare(sim, options)
  if status then return status end
  if not options.quiet then greet(sim, is_terminal) end
  local is_right = prompt.converse(sim)
  if is_terminal then print() end -- so that the shell's prompt is in a new line
  return (is_right or is_terminal) and 0 or 1
end

return rfsm_sim
