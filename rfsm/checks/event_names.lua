--- Event names: finds e_done events that never come, odd names, and misspelt events.
--
-- @module rfsm.checks.event_names
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local instrument = require "rfsm.shared.instrument"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"

local getmetatable, ipairs, package = getmetatable, ipairs, package
local rawequal, rawget, table = rawequal, rawget, table
local tostring, type = tostring, type

local event_names = {}

-- e_done@F of no leaf ............................................................

-- Returns a hint for a name that is no FQN: "did you mean" the first leaf whose FQN
-- ends with the name. Returns an empty text if there is no such leaf.
local function leaf_meant(name, leaves)
  for _, fqn in ipairs(leaves) do
    if fqn:sub(-#name - 1) == "." .. name then
      return " (did you mean 'e_done@" .. fqn .. "'?)"
    end
  end
  return ""
end

-- Returns the place where a final leaf is missing.
local function place_of_final(state)
  local _, region = rfsm.can_be_done(state)
  return region ~= nil and ("its region '%s'"):format(rfsm.text_of(region))
    or "'" .. state._fqn .. "'"
end

-- Finds events e_done@F where F is no state that can be done. `rfsm.init` warns only if
-- the event is written as e_done, without @F.
local function check_e_done(tr, event, leaves, add)
  local fqn = type(event) == "string" and event:match("^e_done@(.*)$")
  local never_comes = fqn and not leaves[fqn]
  if never_comes and fqn == tr.src._fqn and rfsm.is_state(tr.src) then
    add("never-done", tr, ("event '%s' never comes, no leaf right in %s is final "
      .. "(final = true)"):format(event, place_of_final(tr.src)))
  elseif never_comes then
    add("never-done", tr, ("event '%s' never comes, '%s' is no %s of this machine%s")
      :format(event, fqn, fqn:find("^root") and "leaf state" or "FQN",
      leaf_meant(fqn, leaves)))
  end
end

-- e_fault where nothing fails ....................................................

-- Has a state, an element in it, or a transition from these a callback?
local function has_callback(fsm, state)
  return order.any(rfsm.elements(fsm, rfsm.is_fsmobj), function(element)
    return location.is_inside(rfsm.is_trans(element) and element.src or element, state)
      and order.any(instrument.CALLBACKS, function(field) return element[field] end)
  end)
end

-- Finds events e_fault that never come, because there is no callback that could fail.
local function check_e_fault(fsm, tr, event, add)
  local name = rfsm.event_name(event)
  if name == "e_fault@" .. tr.src._fqn and not has_callback(fsm, tr.src) then
    add("idle-reaction", tr, ("'%s' never comes, '%s' has no callback"):format(name,
      tr.src._fqn))
  end
end

-- Several events in one ..........................................................

local MARKS = { [","] = "a comma", ["|"] = "a '|'" }

-- Is the name of an event a sentence, such as a spoken command, and no list of events?
-- A sentence has blanks between words, and no word begins with e_.
local function is_sentence(event)
  return not event:find("|") and not event:find("%f[%w]e_") and not event:find("%s$")
    and event:find("%a%s+%a") ~= nil
end

-- Returns a text if the name of an event is odd: if it looks like a pattern, or has a
-- comma, bar or blank that is not in parentheses or after @.
local function oddness_of_name(event)
  local word, call = event:match("^[^(@]*"), advice.call_meant(event)
  if event:find("^%a[%w_]*%([^)]*$") then
    call = (" (did you mean '%s)'?)"):format(event)
  end
  if call ~= "" then
    return ("'%s' is the name of an event like any other%s"):format(event, call)
  elseif match.maker_of(event) or is_sentence(event) then
    return nil
  elseif word:find("[,|%s]") then
    return ("'%s' is one event with %s in its name%s"):format(event,
      MARKS[word:match("[,|]")] or "a blank", advice.event_meant(event))
  elseif word:find("%*") or word:find("^[!~]") then
    return ("'%s' is the name of one event, no pattern (a function in events accepts "
      .. "several; leave events out for any event)"):format(event)
  end
end

-- Returns a text if an event is a plain table with a list of names, or with a name. The
-- author may expect events with these names, but only the same table is equal to it.
local function oddness_of_table(event)
  if type(event[1]) == "string" then
    return "a list that holds '" .. event[1] .. "' is one event"
  elseif type(event.name) == "string" then
    return ("a table is equal to itself only (did you mean rfsm.named '%s'?)"):format(
      event.name)
  end
end

-- Returns a text if an event is a function of the library, such as `rfsm.named`: its
-- author has forgotten to call it.
local function oddness_of_function(event)
  for _, name in ipairs(rfsm.sorted_keys(package.loaded)) do
    local module = tostring(name):find("^rfsm") and package.loaded[name]
    local fields = type(module) == "table" and rfsm.sorted_keys(module) or {}
    for _, field in ipairs(fields) do
      if rawequal(rawget(module, field), event) then
        local text = name .. "." .. tostring(field)
        return ("%s is not called (did you mean %s(..)?)"):format(text, text)
      end
    end
  end
end

local function oddness_of(event)
  if event == "" then return "the name of an event is empty" end
  if type(event) == "string" then return oddness_of_name(event) end
  if type(event) == "function" then
    return not rfsm.event_name(event) and oddness_of_function(event) or nil
  elseif rfsm.is_fsmobj(event) then
    return ("a %s is no event (texts and rfsm.named are)"):format(rfsm.kind_of(event))
  end
  local is_plain = type(event) == "table" and not getmetatable(event)
  return is_plain and oddness_of_table(event) or nil
end

-- Returns a text if a predicate of `rfsm.named`, or an event with @, begins with a word
-- of an extension that is not loaded. `rfsm.init` tells the other ones.
local function unknown_word(event)
  local name = rfsm.event_name(event)
    or type(event) == "string" and event:match("^(.*)@")
  local is_known = name and advice.module_for(name)
  return is_known and advice.event(nil, name:match("^[%w_]+")) or ""
end

local function check_odd_event(tr, event, add)
  local text, unknown = oddness_of(event), unknown_word(event)
  if text then add("odd-event", tr, text) end
  if unknown ~= "" then add("unknown-word", tr, unknown) end
end

-- Misspelt events ................................................................

-- Calls f(shape) for each shape of an event. Two events with a shape in common look
-- alike. Shapes are: the event itself; the event without underscores and capitals; with
-- two adjacent letters of a word in alphabetical order; without one letter inside a
-- word of five or more letters. No shape leaves out letters at the ends of words
-- (close, closed; lock, block), in short words (load, lead) or beside digits, since
-- such names are usually meant to differ.
local function each_shape(event, f)
  f(advice.plain(event))
  for at, word in event:gmatch("()(%a+)") do
    local before, behind = event:sub(1, at - 1), event:sub(at + #word)
    local is_counted = event:find("^%d", at + #word) or event:sub(at - 1):find("^%d")
    if #word > 3 and not is_counted then
      f(event)
      for i = 1, #word - 1 do
        local head, pair = before .. word:sub(1, i - 1), word:sub(i, i + 1)
        if pair:byte(1) > pair:byte(2) then pair = pair:reverse() end
        f(head .. "<" .. pair .. ">" .. word:sub(i + 2) .. behind)
        if i > 1 and #word > 4 then f(head .. word:sub(i + 1) .. behind) end
      end
    end
  end
end

-- Returns a list of the names of events, and a table name -> transitions that use it.
local function usage_of(fsm)
  local list, users = {}, {}
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    for _, event in ipairs(tr.events or {}) do
      if type(event) == "string" and not event:find("[@%(,]") then
        if not users[event] then list[#list + 1], users[event] = event, {} end
        table.insert(users[event], tr)
      end
    end
  end
  return list, users
end

-- Returns a table shape -> list of the positions of the events with that shape.
local function index_of(list)
  local index = {}
  for i, event in ipairs(list) do
    each_shape(event, function(shape) order.append(index, shape, i) end)
  end
  return index
end

-- Has one name another letter in one place? Then both may be meant (packed, picked).
local function has_other_letter(a, b)
  a, b = advice.lower(a), advice.lower(b)
  local count = 0
  for i = 1, #a do
    if a:byte(i) ~= b:byte(i) then count = count + 1 end
  end
  return #a == #b and count == 1
end

-- Returns the first event that looks like event `i`, and that several transitions use
-- or that comes earlier in the list.
local function find_similar(list, users, index, i)
  local least
  each_shape(list[i], function(shape)
    for _, j in ipairs(index[shape]) do
      local is_rarer = #users[list[j]] > 1
        or j < i and not has_other_letter(list[i], list[j])
      if j ~= i and is_rarer and (not least or j < least) then least = j end
    end
  end)
  return least and list[least]
end

-- Returns the event of its source that the event of one transition looks like.
local function nearly_own(event, tr)
  local word = advice.plain(event)
  local is_fault = word == "efault" or word == "efaults"
  if is_fault and event ~= "e_fault" then return "e_fault" end
  return rfsm.is_leaf(tr.src) and (word == "done" or word == "edone") and "e_done"
end

-- Finds events that only one transition uses, and that look like another event.
local function check_typos(fsm, add)
  local list, users = usage_of(fsm)
  local index = index_of(list)
  for i, event in ipairs(list) do
    local is_alone = not users[event][2]
    local other = is_alone and (find_similar(list, users, index, i)
      or nearly_own(event, users[event][1]))
    if other then
      add("typo", users[event][1], ("no other transition uses '%s' (did you mean "
        .. "'%s'?)"):format(event, other))
    end
  end
end

-- Events of extensions ...........................................................

-- Returns the first transition of a state that always takes an event: it has no guard,
-- and leads to no connector.
local function taker_of(state, event)
  for _, tr in ipairs(state._otrs) do
    local is_open = not tr.guard and rfsm.is_state(tr.tgt)
    if is_open and match.names(tr, event) then return tr end
  end
end

-- Returns the hint for an event that no transition takes: another one, or the text or
-- predicate of the same name.
local function near_event(event, known)
  local name = rfsm.event_text(event)
  local has_data = type(event) == "string" and known.set[rfsm.named(name)]
  local other = has_data and "rfsm.named "
    or rfsm.event_name(event) and match.has(known.list, name) and "the text "
  if other then return (" (did you mean %s'%s'?)"):format(other, name) end
  return advice.nearest_name(name, known.list)
end

-- Finds events that an extension would keep for later, as `defer` does, although no
-- transition takes them, or although the same state takes them always.
local function check_reaction(state, reaction, known, add)
  for _, event in ipairs(reaction.events) do
    local tr, oddness = taker_of(state, event), oddness_of(event)
    if oddness then
      add("odd-event", state, oddness)
    elseif tr then
      add("idle-reaction", state, ("%s '%s' has no effect, %s takes it"):format(
        reaction.word, rfsm.event_text(event), rfsm.location_of(tr):match("root.*$")))
    elseif not match.may_be_taken(known.transitions, event) then
      add("idle-reaction", state, ("%s '%s', but no transition takes it%s"):format(
        reaction.word, rfsm.event_text(event), near_event(event, known)))
    end
  end
end

local function check_reactions(fsm, add)
  local known
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    local _, shown = rfsm.reactions(fsm, state)
    for _, reaction in ipairs(shown) do
      if not known then
        known = alphabet.of_all(fsm)
        known.transitions = match.transitions_of(fsm)
      end
      check_reaction(state, reaction, known, add)
    end
  end
end

--- Find odd and misspelt events of transitions, and e_done events that never come.
---@type rfsm_checks.Check
function event_names.check(fsm, add)
  local leaves = {}
  for _, state in ipairs(rfsm.elements(fsm, rfsm.can_be_done)) do
    leaves[state._fqn], leaves[#leaves + 1] = true, state._fqn
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    for _, event in ipairs(tr.events or {}) do
      check_e_done(tr, event, leaves, add)
      check_e_fault(fsm, tr, event, add)
      check_odd_event(tr, event, add)
    end
  end
  check_typos(fsm, add)
  check_reactions(fsm, add)
end

return event_names
