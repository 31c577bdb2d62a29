-- Loads and initialises each chart named on the command line; the first that is wrong
-- ends it with status 1.

package.path = "./?.lua;" .. package.path

local rfsm = require "rfsm"

local function fail(file, text)
  io.stderr:write(file, ": ", tostring(text), "\n")
  os.exit(1)
end

for _, file in ipairs(arg) do
  local ok, model = pcall(rfsm.load, file)
  if not ok then fail(file, model) end
  model.info, model.warn = false, false
  if not rfsm.init(model) then fail(file, "not valid") end
  print("ok " .. file)
end
