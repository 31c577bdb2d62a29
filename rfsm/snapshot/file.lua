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
local sums = require "rfsm.shared.sums"

local type = type

local file = {}

--- Write a table as JSON with a check sum. Return true, or false and the problem.
function file.write(name, t)
  return files.replace(name, sums.add(exact_json.encode(t)) .. "\n")
end

--- Read the table that was written into a file; nil and the problem if the file cannot
--- be read, is no JSON object or has changed since. Damage of the name of the check sum
--- makes a field that the reader has to refuse.
function file.read(name)
  local text, problem = files.read(name)
  if not text then return nil, problem end
  local decode = opts.need("rfsm.snapshot", "dkjson").decode
  text, problem = sums.remove(text)
  if not text then return nil, name .. ": " .. problem end
  local value, after, why = decode(text)
  if why then return nil, name .. ": no JSON: " .. why end
  if type(value) ~= "table" or text:find("%S", after) then
    return nil, name .. ": a JSON object expected"
  end
  return value
end

return file
