--- A machine as JSON.
--
-- This module needs the package `dkjson`.
--
-- @module rfsm.json
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local opts = require "rfsm.shared.options"
local marsh = require "rfsm.marsh"

local error, rawget, rawset = error, rawget, rawset

local json = {}

local KEY_ORDER = {
  "version", "type", "id", "doc", "mode", "final", "history", "entry", "doo", "exit",
  "reactions", "word", "key", "src", "tgt", "pn", "events", "words", "with_data",
  "guard", "effect", "always", "internal", "transitions",
  "subnodes", "regions", "graph", "active_leaf", "active_leaf_state",
}

local function find_dkjson() return opts.need("rfsm.json", "dkjson") end

--- Return the full description of a machine, and its active leaf, as JSON.
--
-- A list is always an array, even if it is empty. Keys have a fixed order.
--
-- @raise when `fsm` was not initialised, or dkjson is missing
---@param fsm rfsm.Machine
---@return string json
---@nodiscard
function json.encode(fsm)
  rfsm.check_machine(fsm, "rfsm.json.encode")
  local leaf, mode = marsh.actinfo2tab(fsm)
  return find_dkjson().encode({
    version = 2, type = "rfsm_model",
    graph = marsh.jsontab(fsm, true),
    active_leaf = leaf and marsh.utf8(leaf), active_leaf_state = mode,
  }, { indent = true, keyorder = KEY_ORDER })
end

--- Return the values in a text of JSON or of JSON lines. An incomplete last line is
-- left out.
-- @raise if the text is no JSON, or dkjson is missing
---@param text string
---@return any[] values
---@nodiscard
function json.decode_all(text)
  local decode, values, position = find_dkjson().decode, {}, 1
  while text:find("%S", position) do
    local value, after, problem = decode(text, position)
    if problem then
      local begins = text:find("%S", position)
      if values[1] ~= nil and not text:find("\n", begins, true) then break end
      error("no JSON: " .. problem, 0)
    end
    values[#values + 1], position = value, after
  end
  return values
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm2json", json) end

return json
