-- Recordings of random runs: replayed, also dry, they give the same trace; a file holds
-- what a list holds; of a file that is cut anywhere, the whole lines count.

local helper = require "spec.helper"
local json = require "dkjson"
local kept = require "spec.support.kept"
local new_random = require "spec.support.random"
local record = require "rfsm.record"
local journal = require "rfsm.record.journal"
local tracks = require "rfsm.record.track"

-- Returns the first text that says how two values differ as JSON; nil if they do not.
local function difference(what, expected, got)
  local text = json.encode(expected)
  if not tracks.same(json.decode(text), got) then
    return what .. ":\n" .. text .. "\n" .. json.encode(got)
  end
end

-- Checks a file that is cut after `length` bytes, and recorded into again.
local function check_cut(name, text, length, sink)
  local count = select(2, text:sub(1, length):gsub("\n", ""))
  helper.write(name, text:sub(1, length))
  local is_whole = text:sub(length, length) == "\n"
  if count > 0 then
    local list, about = record.read(name)
    local whole = {}
    for i = 1, #list do whole[i] = sink[i] end
    if #list < count or about.is_cut ~= (not is_whole and #list == count) then
      return ("cut after %d bytes: %d lines, %d records"):format(length, count, #list)
    end
    local problem = difference("cut", whole, list)
    if problem then return problem end
  end
  local file = assert(journal.open(name))
  file:write(text)
  file:close()
  return difference("a run behind a cut one", sink, (record.read(name)))
end

local function check(seed, name)
  local lines, watch = kept.watcher()
  local sink = {}
  local stream = assert(io.open(name, "wb"))
  kept.run(seed, function(machine)
    watch(machine)
    local write = journal.writer(stream)
    record.record(machine, function(rec)
      sink[#sink + 1] = rec
      write(rec)
    end)
  end, nil, "all")
  stream:close()
  local read = record.read(name)
  local problem = difference("file", sink, read)
  for _, is_dry in ipairs { true, false } do
    local again, watch_again = kept.watcher()
    local ok, why = record.replay(kept.model(seed, "all"), is_dry and read or sink,
      { dry = is_dry, watch = watch_again })
    problem = problem or not ok and why
      or difference(is_dry and "dry" or "replayed", lines, again)
  end
  local text = helper.content(name)
  local length = new_random(seed):below(#text)
  return problem or check_cut(name, text, length, sink)
end

return {
  name = "record",
  run = function(n, seed)
    local name = os.tmpname()
    for i = 1, n do
      local problem = check(seed + i - 1, name)
      if problem then
        os.remove(name)
        return i, ("seed %d: %s"):format(seed + i - 1, problem)
      end
    end
    os.remove(name)
    return n
  end,
}
