-- A monitor state asks its functions in order, once a cycle, and sends the events of
-- those that answer with a true value: all of them, or the first one.

local driven = require "spec.support.driven"
local monitor = require "rfsm.monitor"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"

local EVENTS = { 1, 2, 10, "a", "b", "b2" } -- in their order
local ANSWERS = { true, 1, "yes", false }

-- Makes the functions of a monitor. Each notes its event, and that it is sent.
local function new_table(random, asked, sent, is_first_only)
  local montab = {}
  for _, event in ipairs(EVENTS) do
    montab[event] = random:chance(60) and function()
      local answer = random:pick(ANSWERS)
      asked[#asked + 1] = event
      if answer and not (is_first_only and sent.now[1]) then
        sent.now[#sent.now + 1] = event
      end
      return answer
    end or nil
  end
  return montab
end

-- Returns the events that are asked in a cycle.
local function asked_in(montab, sent, is_first_only)
  local list = {}
  for _, event in ipairs(EVENTS) do
    if montab[event] then list[#list + 1] = event end
    if is_first_only and event == sent[1] then break end
  end
  return list
end

local function text_of(list)
  local texts = {}
  for i = 1, #list do texts[i] = tostring(list[i]) end
  return table.concat(texts, " ")
end

return { name = "monitor and counting", run = driven.claim(function(seed)
  local random, asked, sent = new_random(seed), {}, { now = {} }
  local is_first_only = random:chance(50)
  local montab = new_table(random, asked, sent, is_first_only)
  local fsm = rfsm.init(rfsm.state { info = false, warn = false,
    m = monitor.gen_monitor_state { montab = montab, break_first = is_first_only },
    rfsm.trans { src = "initial", tgt = "m" } })
  rfsm.step(fsm)
  for cycle = 1, 10 do
    while asked[1] do table.remove(asked) end
    sent.now = {}
    local idle = rfsm.step(fsm)
    local expected = asked_in(montab, sent.now, is_first_only)
    local found = ("idle %s, sent %s, asked %s"):format(tostring(idle),
      text_of(fsm._intq), text_of(asked))
    local right = ("idle false, sent %s, asked %s"):format(text_of(sent.now),
      text_of(expected))
    if found ~= right then
      return ("cycle %d: %s, expected: %s"):format(cycle, found, right)
    end
    fsm._intq = {}
  end
end) }
