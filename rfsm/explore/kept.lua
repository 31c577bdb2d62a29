--- Kept data: the data of extensions, and the targets that extensions change. Like the
--- active states and the queue, they decide which transitions a machine takes.
--
-- @module rfsm.explore.kept
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, rawequal, type = ipairs, rawequal, type
local concat = table.concat

local kept = {}

--- The places where the kept data of a machine are.
---@class rfsm_checks.Kept
---@field hooks table[] snapshot hooks whose data is explored
---@field transitions rfsm.Transition[] transitions that may have several targets

--- Find the kept data of a machine; return false if there are none.
---@param fsm rfsm.Machine
---@return rfsm_checks.Kept|false
function kept.of(fsm)
  local own = { hooks = {}, transitions = {} }
  for _, hook in ipairs(rfsm.snapshot_hooks(fsm)) do
    if hook.is_explored then own.hooks[#own.hooks + 1] = hook end
  end
  for _, tr in ipairs(rfsm.elements(fsm, rfsm.is_trans)) do
    if rfsm.targets(tr)[2] then own.transitions[#own.transitions + 1] = tr end
  end
  return (own.hooks[1] or own.transitions[1]) and own or false
end

-- Returns plain data as a text. An event that is a table or function is replaced by its
-- number.
local function text_of(value, event_numbers)
  local kind = type(value)
  if kind == "string" then return #value .. ":" .. value end
  if kind == "number" then return rfsm.number_text(value, "%.17g") end
  if value ~= nil and event_numbers[value] then
    return "event " .. event_numbers[value]
  elseif kind ~= "table" then
    return rfsm.text_of(value)
  end
  local texts = {}
  for i, key in ipairs(rfsm.sorted_keys(value)) do
    texts[i] = text_of(key, event_numbers) .. "=" .. text_of(value[key], event_numbers)
  end
  return "{" .. concat(texts, ",") .. "}"
end

--- Return the kept data as they are now, and the data as a text.
---@param own rfsm_checks.Kept
---@param fsm rfsm.Machine
---@param event_numbers table<any, integer>
---@return any[] values the field `is_data` is true if an extension has data
---@return string key the text
function kept.read(own, fsm, event_numbers)
  local values, texts, n = {}, {}, #own.hooks
  for i, hook in ipairs(own.hooks) do
    values[i] = hook.save(fsm, true)
    values.is_data = values.is_data or values[i] ~= nil
    texts[i] = text_of(values[i], event_numbers)
  end
  for i, tr in ipairs(own.transitions) do
    values[n + i], texts[n + i] = tr.tgt, tr.tgt._fqn
  end
  return values, concat(texts, ",")
end

-- The last argument of `load` of a snapshot hook (see rfsm/snapshot.lua). It says that
-- the chart has not changed.
local UNCHANGED = { entries = false, has_changed = false, is_migrated = false,
  is_new = function() return false end }

--- Put the result of `kept.read` back into a machine.
function kept.put(own, fsm, values)
  for i, hook in ipairs(own.hooks) do hook.load(fsm, values[i], UNCHANGED) end
  for i, tr in ipairs(own.transitions) do
    local tgt = values[#own.hooks + i]
    if not rawequal(tr.tgt, tgt) then tr.tgt = tgt end
  end
end

return kept
