--- Names: events that nobody sends, or that look like a misspelt other one.
--
-- @module rfsm.checks.names
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"

local getmetatable, ipairs, table, type = getmetatable, ipairs, table, type

local names = {}

-- e_done@F of no leaf ............................................................

-- That of the source itself is left to the warning of `init`.
local function check_e_done(tr, leaves, add)
  for _, event in ipairs(tr.events or {}) do
    local fqn = type(event) == "string" and event:match("^e_done@(.*)$")
    if fqn and not leaves[fqn] then
      add("never-done", tr, "event '" .. event .. "' never comes, '" .. fqn
        .. "' is no leaf state of this machine")
    end
  end
end

-- Several events in one ..........................................................

-- A name with a comma, but for word(a, b), and a list, which no other table equals.
local function check_odd_events(tr, add)
  for _, event in ipairs(tr.events or {}) do
    if type(event) == "string" and event:find("^[^(]*,") then
      add("odd-event", tr, "'" .. event .. "' is one event with a comma in its name")
    elseif type(event) == "table" and not getmetatable(event)
      and type(event[1]) == "string" then
      add("odd-event", tr, "a list that holds '" .. event[1] .. "' is one event")
    end
  end
end

-- Misspelt events ................................................................

-- Splits e_pusch_button into its words.
local function words_of(event)
  local words = {}
  for word in event:gmatch("[^_%W]+") do words[#words + 1] = word end
  return words
end

-- Do two words look alike? Numbers and short words are meant to. A letter more at the
-- start or the end makes another word: lock, block; close, closed.
local function is_near(a, b)
  a, b = a:lower(), b:lower()
  if a == b then return true end
  if #a < 4 or #b < 4 or a:find("%d") or b:find("%d") then return false end
  local has_ends = a:byte() == b:byte() and a:byte(-1) == b:byte(-1)
  return (has_ends or #a == #b) and advice.is_near(a, b)
end

-- Do two events differ in one word, or in underscores, and look alike there?
local function is_misspelt(a, b)
  if #a > #b + 3 or #b > #a + 3 then return false end
  if a:lower():gsub("_", "") == b:lower():gsub("_", "") then return true end
  local words, others, differs = words_of(a), words_of(b), false
  if #words ~= #others then return false end
  for i, word in ipairs(words) do
    if word ~= others[i] then
      if differs or not is_near(word, others[i]) then return false end
      differs = true
    end
  end
  return differs
end

local function is_name(event)
  return type(event) == "string" and not event:find("[@%(,]")
end

-- Returns the names of events in order, and the transitions that use each.
local function usage_of(fsm)
  local list, users = {}, {}
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    for _, event in ipairs(tr.events or {}) do
      if is_name(event) then
        if not users[event] then list[#list + 1], users[event] = event, {} end
        table.insert(users[event], tr)
      end
    end
  end
  return list, users
end

-- An event that one transition uses, and a similar one that as many or more use.
local function check_typos(fsm, add)
  local list, users = usage_of(fsm)
  for i, event in ipairs(list) do
    for j, other in ipairs(list) do
      local is_rarer = #users[other] > 1 or j < i
      if i ~= j and not users[event][2] and is_rarer and is_misspelt(event, other) then
        add("typo", users[event][1], ("no other transition uses '%s' (did you mean "
          .. "'%s'?)"):format(event, other))
        break
      end
    end
  end
end

--- Find what is wrong with the events of transitions.
---@type rfsm_checks.Check
function names.check(fsm, add)
  local leaves = {}
  for _, leaf in ipairs(rfsm.elements(fsm, rfsm.is_leaf)) do
    leaves[leaf._fqn] = true
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    check_e_done(tr, leaves, add)
    check_odd_events(tr, add)
  end
  check_typos(fsm, add)
end

return names
