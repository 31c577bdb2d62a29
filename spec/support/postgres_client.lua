-- A client of PostgreSQL in a process of its own:
--
--    LUA spec/support/postgres_client.lua FOLDER CHART FILE
--
-- Sends what the lines of a file name: the id of an event, a machine, the event.
-- Without a file it wakes machines until none is due.

package.path = "./?.lua;" .. package.path

local luasql = require "luasql.postgres"
local postgres = require "rfsm.postgres"

local folder, chart, file = arg[1], arg[2], arg[3]
local charts, has_begun, client = postgres.charts { chart }, false, nil
for _ = 1, 1000 do -- the server may not be there at the moment
  has_begun, client = pcall(postgres.connect, charts, function()
    return luasql.postgres():connect("postgres", "postgres", "", folder)
  end, { patience = 60 })
  if has_begun then break end
  require("socket").sleep(0.05)
end
assert(has_begun, client)

if file then
  for line in io.lines(file) do
    local id, key, event = line:match("^(%S+) (%S+) (%S+)$")
    assert(client:send_once(id, key, event))
  end
else
  local count
  repeat count = client:wake() until count == 0
end
