-- A machine that is watched for long: its memory and that of its pages do not grow.
--
--   LUA bench/soak.lua [MINUTES]
--
-- MINUTES (60) of machine time at 1,000 events a second, as fast as they are handled,
-- with two pages: browsers, if chromium and chromedriver are there, and plain streams
-- otherwise. A line is printed ten times. The status is 1 if the least memory in the
-- last three of these lines is above the most in the first three by a tenth.
--
-- Needs luasocket and dkjson.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"
local socket = require "socket"
local web = require "rfsm.web"
local webdriver = require "spec.support.webdriver"

local PAGES, RATE = 2, 1000 -- events a second of machine time
local MINUTES = tonumber(arg[1] or 60) or measure.fail("number of minutes expected")

local seconds = 0 -- of machine time
local fsm = assert(rfsm.init(rfsm.state {
  info = false, warn = false, gettime = function() return seconds, 0 end,
  off = rfsm.state {}, on = rfsm.state {},
  rfsm.trans { src = "initial", tgt = "off" },
  rfsm.trans { src = "off", tgt = "on", events = { "e_push" } },
  rfsm.trans { src = "on", tgt = "off", events = { "e_push" } },
}))
rfsm.run(fsm)
local server = web.serve(fsm, { port = 0 })

-- Pages: each has `heap()`, bytes that it takes, and `read()`, if nobody else does ---

-- A page that only reads.
local function new_stream()
  local tcp = assert(socket.connect("127.0.0.1", server.port))
  tcp:settimeout(0)
  tcp:send("GET /events?token=" .. server.token
    .. " HTTP/1.1\r\nHost: localhost\r\n\r\n")
  return { heap = function() return 0 end, read = function() tcp:receive("*a") end }
end

local function new_browser(driver)
  local window = driver:window()
  window:open(server.url)
  window:wait "now.active && document.querySelector('.active')"
  return { read = function() end, heap = function()
    window:chromium("HeapProfiler.collectGarbage", {})
    return window:run "return performance.memory.usedJSHeapSize"
  end }
end

local function start_driver()
  local is_there = webdriver.is_there()
  return is_there and webdriver.start(function(timeout) server:step(timeout) end)
end

local driver, pages = start_driver(), {}
for i = 1, PAGES do pages[i] = driver and new_browser(driver) or new_stream() end

-- Returns KiB of this process, and of each page.
local function memory()
  collectgarbage()
  collectgarbage()
  local figures = { collectgarbage("count") }
  for _, page in ipairs(pages) do figures[#figures + 1] = page.heap() / 1024 end
  return figures
end

local function run_for(minutes)
  for n = 1, minutes * 60 * RATE do
    seconds = seconds + 1 / RATE
    rfsm.send_events(fsm, "e_push")
    rfsm.run(fsm)
    server:step(0)
    if n % 100 == 0 then
      for _, page in ipairs(pages) do page.read() end
    end
  end
end

-- Runs for a tenth of the time; returns the memory then.
local function run_part(part)
  run_for(MINUTES / 10)
  local figures, texts = memory(), {}
  for i, figure in ipairs(figures) do texts[i] = ("%7.0f KiB"):format(figure) end
  print(("%5.1f min %9d events %s  connections %d"):format(MINUTES * part / 10,
    MINUTES * part / 10 * 60 * RATE, table.concat(texts), #server.http.connections))
  io.stdout:flush()
  return figures
end

print(("%s, %d pages, %s"):format(measure.engine(), PAGES,
  driver and "Chromium" or "plain streams"))
local parts = {}
for part = 1, 10 do parts[part] = run_part(part) end
if driver then driver:stop() end

local function has_grown(column)
  local function at(part) return parts[part][column] end
  return math.min(at(8), at(9), at(10)) > 1.1 * math.max(at(1), at(2), at(3))
end

for column = 1, 1 + PAGES do
  if has_grown(column) then measure.fail("memory has grown") end
end
