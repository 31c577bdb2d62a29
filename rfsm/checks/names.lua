--- Names: events that nobody sends, or that look like a misspelt other one.
--
-- @module rfsm.checks.names
-- @license BSD-3-Clause

local rfsm = require "rfsm"

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

local MARKS = { [","] = "a comma", ["|"] = "a '|'" }

-- A name with a comma, bar or blank, but for word(a, b) and what follows @; and a list,
-- which no other table equals.
local function check_odd_events(tr, add)
  for _, event in ipairs(tr.events or {}) do
    local mark = type(event) == "string" and event:match("^[^(@]*"):match("[,|%s]")
    if mark then
      add("odd-event", tr, ("'%s' is one event with %s in its name"):format(event,
        MARKS[event:match("^[^(@]*"):match("[,|]")] or "a blank"))
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

-- Is `b` the word `a` without a letter inside of it, or with another one there, or with
-- two letters in reverse? A letter at the end or the start makes too many words that
-- are meant: close, closed; lock, block; so do letters in short words: load, lead.
local function is_edited(a, b)
  for i = 1, #a do
    local before, letter, behind = a:sub(1, i - 1), a:sub(i, i), a:sub(i + 1)
    local is_inside = i > 1 and i < #a
    if is_inside and (before .. behind == b or #a > 4 and #a == #b
        and before .. b:sub(i, i) .. behind == b)
      or before .. behind:sub(1, 1) .. letter .. behind:sub(2) == b then
      return true
    end
  end
  return false
end

-- Do two words look alike? Numbers and short words are meant to.
local function is_near(a, b)
  if a:lower() == b:lower() then return true end
  if #a < 4 or #b < 4 or a:find("%d") or b:find("%d") then return false end
  return is_edited(a, b) or is_edited(b, a)
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

-- Calls f(key) for the event without underscores, and for the same without each of its
-- letters. Two events that look alike have one of them in common.
local function each_key(event, f)
  local text = event:lower():gsub("[_%W]", "")
  f(text)
  for i = 1, #text do f(text:sub(1, i - 1) .. text:sub(i + 1)) end
end

-- Returns lists of positions of events, by their keys.
local function index_of(list)
  local index = {}
  for i, event in ipairs(list) do
    each_key(event, function(key)
      index[key] = index[key] or {}
      table.insert(index[key], i)
    end)
  end
  return index
end

-- Returns the first event that looks like event `i`, and that as many or more use.
local function find_similar(list, users, index, i)
  local least
  each_key(list[i], function(key)
    for _, j in ipairs(index[key]) do
      local is_rarer = #users[list[j]] > 1 or j < i
      if j ~= i and is_rarer and (not least or j < least)
        and is_misspelt(list[i], list[j]) then
        least = j
      end
    end
  end)
  return least and list[least]
end

-- An event that one transition uses, and a similar one.
local function check_typos(fsm, add)
  local list, users = usage_of(fsm)
  local index = index_of(list)
  for i, event in ipairs(list) do
    local other = not users[event][2] and find_similar(list, users, index, i)
    if other then
      add("typo", users[event][1], ("no other transition uses '%s' (did you mean "
        .. "'%s'?)"):format(event, other))
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
