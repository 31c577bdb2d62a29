-- The cost of being watched: a page that is closed, open, and one that does not read; a
-- recording; the way back in the simulator.
--
--   LUA bench/watching.lua
--
-- Needs luasocket and dkjson. Microseconds of processor time an event, best of ROUNDS.

package.path = "./?.lua;" .. package.path

local helper = require "spec.helper"
local measure = require "bench.measure"
local record = require "rfsm.record"
local rfsm = require "rfsm"
local socket = require "socket"
local web = require "rfsm.web"

local ROUNDS = measure.count("ROUNDS", 5)
local SECONDS = measure.setting("SECONDS", 0.1) -- per measurement

-- A function of n that sends an event, runs, and calls `after`.
local function running(fsm, after)
  return function(n)
    for _ = 1, n do
      rfsm.send_events(fsm, "e_push")
      rfsm.run(fsm)
      if after then after() end
    end
  end
end

-- Opens a stream.
local function open_page(server)
  local tcp = assert(socket.connect("127.0.0.1", server.port))
  tcp:settimeout(0)
  tcp:send("GET /events?token=" .. server.token
    .. " HTTP/1.1\r\nHost: localhost\r\n\r\n")
  for _ = 1, 20 do server:step(0.001) end
  return tcp
end

local function print_row(name, ...)
  local texts = {}
  for i, value in ipairs { ... } do texts[i] = ("%10.1f"):format(value) end
  print(("%-46s%s"):format(name, table.concat(texts)))
end

local function measure_page(count)
  local plain, fsm = helper.ring(count), helper.ring(count)
  local server = web.serve(fsm, { port = 0 })
  local step = function() server:step(0) end
  running(plain)(2 * count) -- each leaf is known then
  running(fsm)(2 * count)
  local closed = measure.best_in_turn({ running(plain), running(fsm, step),
    function(n) for _ = 1, n do server:step(0) end end }, ROUNDS, SECONDS)
  local page = open_page(server)
  local open = measure.best_in_turn({ running(fsm, function()
    server:step(0)
    page:receive("*a")
  end) }, ROUNDS, SECONDS)
  page:close()
  for _ = 1, 20 do server:step(0.001) end
  local frozen = open_page(server) -- until its buffers are full
  for _ = 1, 2000 do
    server:step(0.001)
    if server.http.connections[1].pending ~= "" then break end
    for _ = 1, 60 do server.sources[1].view:note("note", ("x"):rep(2000)) end
  end
  local clock = server.http.clock
  server.http.clock = function() return clock() + 6 end -- it has not read for so long
  for _ = 1, 2 do server:step(0) end
  server.http.clock = function() return clock() + 12 end
  server:step(0)
  local stuck = measure.best_in_turn({ running(fsm, step) }, ROUNDS, SECONDS)
  frozen:close()
  server:close()
  print_row(count .. " states", closed[1], closed[3], closed[2], open[1], stuck[1])
end

local function measure_record()
  local name, fsm = os.tmpname(), helper.ring(2)
  local recorder = record.record(fsm, name)
  local best = measure.best_in_turn({ running(fsm) }, ROUNDS, SECONDS)
  recorder:stop()
  local events, file = 1000, assert(io.open(name, "w"))
  recorder = record.record(fsm, file)
  local before = file:seek()
  running(fsm)(events)
  local bytes = (file:seek() - before) / events
  recorder:stop()
  file:close()
  os.remove(name)
  print_row("recording to a file: us, bytes an event", best[1], bytes)
end

print(measure.engine())
print(("%-46s%10s%10s%10s%10s%10s"):format("us", "event", "step(0)", "both",
  "page open", "frozen"))
for _, count in ipairs { 2, 20, 300, 1000 } do measure_page(count) end
measure_record()
