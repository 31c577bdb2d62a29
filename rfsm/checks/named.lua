--- Named: states and transitions in the words of a person: "off -e_switch-> on".
--
-- A name has no position in it, so that tests stay right if a chart is reordered.
--
-- @module rfsm.checks.named
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local place = require "rfsm.checks.place"

local ipairs, type = ipairs, type
local concat, sort = table.concat, table.sort

local named = {}

--- Return the name of a node: its FQN without "root.". A composite stands for its
--- `initial` as a target.
---@param node rfsm.State|rfsm.Connector
---@param prefix string of its machine
---@param is_target? boolean
---@return string name
function named.node(node, prefix, is_target)
  if is_target and rfsm.is_conn(node) and node._id == "initial" then
    node = node._parent
  end
  local path = place.path(node, prefix)
  return path ~= "root" and path:gsub("^root%.", "") or path
end

-- Returns the text of an event without the FQN of its source behind @.
local function event_text(event, tr)
  if type(event) == "function" then return "a predicate" end
  local text, behind = rfsm.text_of(event), "@" .. tr.src._fqn
  return text:sub(-#behind) == behind and text:sub(1, -#behind - 1) or text
end

local function transition_name(tr, prefix)
  local texts = {}
  for i, event in ipairs(tr.events or {}) do texts[i] = event_text(event, tr) end
  sort(texts)
  return named.node(tr.src, prefix) .. " -" .. concat(texts, ", ") .. "-> "
    .. (tr._is_internal and "internal" or named.node(tr.tgt, prefix, true))
end

--- Give each transition of a puppet its name, in the field `name`. Of several between
--- the same states on the same events, the second in order has " #2" behind it.
---@param entries { tr: rfsm.Transition, prefix: string, name: string }[]
function named.add(entries)
  for _, entry in ipairs(entries) do
    local name = transition_name(entry.tr, entry.prefix)
    local rank = 1
    for _, other in ipairs(entry.tr.src._otrs) do
      if other == entry.tr then break end
      if transition_name(other, entry.prefix) == name then rank = rank + 1 end
    end
    entry.name = rank > 1 and name .. " #" .. rank or name
  end
end

return named
