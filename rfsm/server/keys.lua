--- The keys of machines in Redis, and the keys of their timers, streams and index.
-- All keys with the same hash tag are in one slot of a cluster.
--
-- @module rfsm.server.keys
-- @license BSD-3-Clause

local encoding = require "rfsm.snapshot.encoding"

local tostring = tostring
local fail = encoding.fail

local keys = {}

--- Return a text as one line.
function keys.line(text) return (text:gsub("[\1-\31\127]", " ")) end

-- The last character of a text in UTF-8.
local LAST = "[^\128-\191]?[\128-\191]*$"

--- Return a name or a key as one line for a message: at most 80 bytes of it. PostgreSQL
-- would refuse a part of a character.
function keys.shown(text)
  text = tostring(text)
  return keys.line(#text > 80 and text:sub(1, 81):gsub(LAST, "", 1) or text)
end

local shown = keys.shown

local last_key, last_tag

--- Return the hash tag of a key: the text in braces, or the whole key.
function keys.tag(key)
  if key == last_key and key then return last_tag end
  if not key then fail("a key expected, got none") end
  local tag = key:match("{([^}]+)}") or not key:find("[{}]") and key
  if not tag or key:match("{([^}]*)}") == "" then
    fail("key '%s': a key without braces, or with a hash tag expected", shown(key))
  end
  last_key, last_tag = key, tag
  return tag
end

--- Return the key of the machine, which is the first key of a call. Other keys are in
-- the call only because a cluster has to know all keys that are written.
function keys.machine(list)
  local key = list[1] or fail("the key of a machine expected, got none")
  if key:find("^rfsm:") or key:find(":log$") or key:find(":history$") then
    fail("key '%s': rfsm:*, *:log and *:history are no keys of machines", shown(key))
  end
  keys.tag(key)
  return key
end

local function of_tag(kind)
  return function(key) return "rfsm:" .. kind .. ":{" .. keys.tag(key) .. "}" end
end

--- Each returns the key of a sorted set or a stream. All machines with the hash tag of
-- the given key share it.
keys.due, keys.out, keys.index = of_tag "due", of_tag "out", of_tag "in"
keys.aside, keys.dead, keys.since = of_tag "aside", of_tag "dead", of_tag "since"
keys.lease = of_tag "lease"

local function of_machine(suffix)
  return function(key)
    return (key:find("{", 1, true) and key or "{" .. key .. "}") .. suffix
  end
end

--- Each returns the key of a stream of one machine, from the key of the machine.
keys.log, keys.history = of_machine ":log", of_machine ":history"

--- Return the channel on which the active leaf of a machine is published.
function keys.channel(key) return "rfsm:{" .. keys.tag(key) .. "}:" .. key end

-- A tab separates the parts of a member. No name has a backslash, so \t stands for one.
local function with_tabs(text) return (text:gsub("\\t", "\t")) end

--- Return the beginning of an entry of the index: the chart and a state.
function keys.head(chart, state)
  return chart:gsub("\t", "\\t") .. "\t" .. state:gsub("\t", "\\t")
end

--- Return an entry of the index: the chart, its active leaf, the key of the machine.
function keys.member(chart, leaf, key) return keys.head(chart, leaf) .. "\t" .. key end

--- Return the chart and the state of an entry, or of its beginning.
function keys.read_head(member)
  local chart, leaf = member:match("^([^\t]*)\t([^\t]*)")
  return with_tabs(chart), with_tabs(leaf)
end

return keys
