--- Snapshots in files.
--
-- A file is written beside the old one, which it then replaces: whoever reads it finds
-- the old snapshot or the new one, and never a part. A check sum tells damage.
--
-- @module rfsm.snapshot.file
-- @license BSD-3-Clause

local exact_json = require "rfsm.shared.exact_json"
local files = require "rfsm.shared.files"
local opts = require "rfsm.shared.options"
local rfsm = require "rfsm"
local sums = require "rfsm.shared.sums"

local ipairs, type = ipairs, type

local file = {}

-- The fields of a snapshot. Another one is damage that is older than the check sum.
local IS_FIELD = {}
for name in ("version chart leaf done queue data saved targets ext regions structure")
  :gmatch("%a+") do
  IS_FIELD[name] = true
end

--- Write a table as JSON with a check sum. Return true, or false and the problem.
function file.write(name, t)
  return files.replace(name, sums.add(exact_json.encode(t)) .. "\n")
end

--- Read the table that was written into a file; nil and the problem if the file cannot
--- be read, is no JSON object or has changed since.
function file.read(name)
  local text, problem = files.read(name)
  if not text then return nil, problem end
  local decode = opts.need("rfsm.snapshot", "dkjson").decode
  text, problem = sums.remove(text)
  if not text then return nil, name .. ": " .. problem end
  local value, after, why = decode(text, 1, nil)
  if why then return nil, name .. ": no JSON: " .. why end
  if type(value) ~= "table" or text:find("%S", after) then
    return nil, name .. ": a JSON object expected"
  end
  return value
end

--- Return a snapshot that was read from a file, without unknown fields; nil and the
--- problem if it is none.
function file.snapshot(name)
  local snap, problem = file.read(name)
  if not snap then return nil, problem end
  for _, field in ipairs(rfsm.sorted_keys(snap)) do
    if not IS_FIELD[field] then
      return nil, ("%s: a snapshot has no field '%s'"):format(name, rfsm.text_of(field))
    end
  end
  return snap
end

return file
