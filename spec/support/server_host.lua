-- Redis in a table, for the functions that run inside.

local codec = require "rfsm.server.codec"
local encoding = require "rfsm.snapshot.encoding"
local rfsm = require "rfsm"
local store = require "rfsm.redis.store"

local host = {}

-- Returns data as a text in which the order of keys is always the same.
function host.sorted(value)
  if type(value) ~= "table" then
    return type(value) == "number" and ("%.9g"):format(value) or tostring(value)
  end
  local parts = {}
  for i, key in ipairs(rfsm.sorted_keys(value)) do
    parts[i] = tostring(key) .. "=" .. host.sorted(value[key])
  end
  return "{" .. table.concat(parts, ",") .. "}"
end

-- Returns what Redis has for libraries, and what packs: values stay tables.
local function new_redis(trace, clock)
  local values, packed = {}, nil
  local commands = {
    GET = function(key) return values[key] and key or false end,
    EXISTS = function(key) return values[key] and 1 or 0 end,
    TIME = function()
      local seconds = math.floor(clock.now)
      return { ("%.0f"):format(seconds), ("%.0f"):format((clock.now - seconds) * 1e6) }
    end,
    TYPE = function() return { ok = "none" } end,
    ZRANGEBYLEX = function() return {} end,
    SET = function(key)
      values[key] = packed
      trace[#trace + 1] = "SET " .. host.sorted(packed)
    end,
  }
  return {
    call = function(name, ...)
      if commands[name] then return commands[name](...) end
      trace[#trace + 1] = name .. " " .. host.sorted { ... }
    end,
    acl_check_cmd = function() return true end,
    error_reply = function(text) return { err = text } end,
  }, {
    pack = function(list)
      if list[1] == "rfsm" then packed = encoding.copy_of(list) end -- not a snapshot
      return "packed"
    end,
    unpack = function(key) return encoding.copy_of(values[key]) end,
  }
end

-- Returns a host that notes what is written in `trace`; `clock.now` is its time. Its
-- `redis` and `packs` may be changed.
function host.new(trace, clock)
  local redis, packs = new_redis(trace, clock)
  local made = store({ error_reply = redis.error_reply,
    call = function(...) return redis.call(...) end,
    acl_check_cmd = function(...) return redis.acl_check_cmd(...) end,
  }, { decode = codec.decode }, packs)
  made.redis, made.packs = redis, packs
  return made
end

return host
