-- Random datagrams that rfsm.proto should not fall for: the same seed gives the same
-- ones on every Lua. Built with `..`: in Lua 5.1 "%s" ends at a zero byte.

local new_random = require "spec.support.random"

local datagrams = {}

local char, rep = string.char, string.rep

local TYPES = {
  '"subscribe"', '"unsubscribe"', '"heartbeat"', '"model"', '"event"', '"rfsm_error"',
}
local FIELDS = { "type", "fsm", "part", "event", "version", "cnt", "text", "" }
local VALUES = {
  "null", "true", "false", "0", "-1", "1.5", "2", "1e308", "-1e999", "1e999", "01",
  "1.2.3", "nan", '""', '"e_x"', '"\\u0000"', '"\\ud800"', "[]", "{}", "[[]]",
  '{"a":{}}', '{"__index":1}', "/* */1", "//", "\0",
}

local function pick(random, list) return list[random(#list)] end

local function field(random)
  return '"' .. pick(random, FIELDS) .. '":' .. pick(random, VALUES)
end

local KINDS = {}

function KINDS.noise(random)
  local bytes = {}
  for i = 1, random(60) - 1 do bytes[i] = char(random(256) - 1) end
  return table.concat(bytes)
end

-- Right but for the values of its fields.
function KINDS.wrong(random)
  return '{"type":' .. pick(random, TYPES) .. "," .. field(random) .. ","
    .. field(random) .. "}"
end

function KINDS.any(random)
  return "{" .. field(random) .. "," .. field(random) .. "}"
end

function KINDS.cut(random)
  local text = KINDS.wrong(random)
  return text:sub(1, random(#text) - 1)
end

function KINDS.changed(random)
  local text = KINDS.wrong(random)
  local at = random(#text)
  return text:sub(1, at - 1) .. char(random(256) - 1) .. text:sub(at + 1)
end

function KINDS.deep(random)
  local text = pick(random, { "[", '{"a":', '[{"a":[', '{"type":', '"\\"[' })
  return '{"type":"event","event":' .. rep(text, random(400))
end

-- Closed again, and what is deep is in a string or a comment.
function KINDS.hidden(random)
  local n = random(400)
  return '{"type":"event","fsm":7,"event":' .. pick(random, { '"', '/*"*/', '"\\"' })
    .. rep("[", n) .. rep("]", n) .. pick(random, { '"', '/*"*/', '\\""' }) .. "}"
end

function KINDS.huge(random)
  return '{"type":"event","event":' .. pick(random, { "", "-" })
    .. rep(pick(random, { "9", "1e9", "0." }), random(600)) .. ',"fsm":'
    .. rep("7", random(600)) .. "}"
end

function KINDS.long(random)
  return '{"type":"heartbeat","text":"' .. rep("x", 4000 + random(400)) .. '"}'
end

-- Rare ones first; what is common costs little.
local ORDER = {
  "deep", "hidden", "huge", "long", "noise", "noise", "noise", "wrong", "wrong",
  "wrong", "any", "any", "cut", "cut", "changed", "changed",
}

--- Returns a function that returns another datagram at each call.
function datagrams.generator(seed)
  local random = new_random(seed)
  return function() return KINDS[ORDER[random(#ORDER)]](random) end
end

return datagrams
