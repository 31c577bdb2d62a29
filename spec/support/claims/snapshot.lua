-- A snapshot that is taken at any point, put anywhere and taken again is the same one,
-- and the machine that it makes goes on as the first one did.

local driven = require "spec.support.driven"
local json = require "dkjson"
local kept = require "spec.support.kept"
local rfsm = require "rfsm"

-- Returns a text of plain data in which the order of keys is always the same.
local function sorted(value)
  if type(value) ~= "table" then return type(value) .. tostring(value) end
  local parts = {}
  for i, key in ipairs(rfsm.sorted_keys(value)) do
    parts[i] = tostring(key) .. "=" .. sorted(value[key])
  end
  return "{" .. table.concat(parts, ",") .. "}"
end

-- Returns what is wrong with one case: a new machine, and one that is at the end of its
-- run, go on from a snapshot.
local function run_case(seed)
  local at = seed * 31 % (kept.length(seed) + 1)
  local snap, trace = kept.begin(seed, at)
  local expected, lines = sorted(snap), table.concat(trace, "\n")
  snap = json.decode((json.encode(snap)))
  for _, fsm in ipairs { false, kept.run(seed, function() end) } do
    local other, again = kept.go_on(seed, at, snap, fsm)
    if sorted(again) ~= expected then return "taken again it is another one" end
    if table.concat(other, "\n") ~= lines then return "the machine goes another way" end
  end
end

return { name = "snapshots anywhere", run = driven.claim(run_case) }
