--- Names of states and events for a person, and a hint for a misspelt name.
--
-- The state `root.open` of the region `left` in `root.arms` is called
-- `root.arms.left.open`.
--
-- @module rfsm.observe.names
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local alphabet = require "rfsm.shared.alphabet"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"

local ipairs, type = ipairs, type

local names = {}

--- List the events that are texts. Events with an @ are left out: machines make them.
function names.events(fsm)
  local is_text = {}
  for event in order.each(alphabet.of_all(fsm).set) do -- any order: sorted below
    local text = rfsm.event_name(event) or event
    is_text[text] = type(text) == "string" and not text:find("@", 1, true) or nil
  end
  return rfsm.sorted_keys(is_text)
end

--- Does a transition of a machine name an event? A predicate without a name, which may
-- accept any event, counts as well.
function names.is_event(fsm, event)
  local known = alphabet.of_all(fsm)
  if alphabet.has(known, event) or event == "e_init_fsm" then return true end
  return type(event) == "string"
    and (event:find("^e_done") or known.set[rfsm.named(event)]) ~= nil
end

--- Return the text of the event that a person has meant, who has sent a text in place
--- of an event with data, or the reverse; nil if the event is right.
function names.form_meant(fsm, event)
  local set, name = alphabet.of_all(fsm).set, rfsm.name_with_data(event)
  if name and set[name] and not set[rfsm.named(name)] then return name end
  local is_text = type(event) == "string" and not set[event]
  return is_text and set[rfsm.named(event)] and event .. "{}" or nil
end

--- Return a list of the names of states and connectors, and a table of nodes by name.
function names.nodes(fsm)
  local list, by_name = {}, {}
  for at, node in location.each(fsm, rfsm.is_nr_node) do
    local name = location.path(node, at.prefix)
    list[#list + 1], by_name[name] = name, node
  end
  return list, by_name
end

--- Return a hint with the first name in a list that ends in a path, and the number of
--- the others: ", did you mean a.b.hold (and 2 more)?"; nil if there is none.
function names.elsewhere(path, list)
  local tail, first, count = "." .. path, nil, 0
  for _, name in ipairs(list) do
    if name:sub(-#tail) == tail then first, count = first or name, count + 1 end
  end
  local more = count > 1 and (" (and %d more)"):format(count - 1) or ""
  return first and (", did you mean %s%s?"):format(first:gsub("^root%.", ""), more)
end

return names
