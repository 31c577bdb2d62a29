-- A host: runs examples/timeevent.lua in luv's event loop, and sleeps exactly until the
-- next timer can fire. Nothing is polled; between two timers the process is idle.
--
--   lua examples/hosts/luv_host.lua [SECONDS]     from the top of the checkout
--
-- A button is pressed once a second; the host ends after SECONDS (3).

package.path = "./?.lua;" .. package.path

local is_there, uv = pcall(require, "luv")
if not is_there then
  print("this host needs luv; please install it (Debian: apt-get install lua-luv)")
  return
end

local rfsm = require "rfsm"
local rfsm_timeevent = require "rfsm_timeevent"

rfsm_timeevent.set_gettime_hook(uv.hrtime) -- nanoseconds in one number, monotonic

local fsm = assert(rfsm.init(rfsm.load("examples/timeevent.lua")))
local alarm, wakeups = uv.new_timer(), 0

-- Advances the machine, then sets the alarm for its next timer.
local function advance()
  wakeups = wakeups + 1
  rfsm.run(fsm)
  local seconds = rfsm_timeevent.next_deadline(fsm)
  alarm:stop()
  if not seconds then return end
  uv.update_time()
  alarm:start(math.ceil(seconds * 1000), 0, advance)
end

local button = uv.new_timer()
button:start(500, 1000, function()
  rfsm.send_events(fsm, "e_button")
  advance()
end)

local stop = uv.new_timer()
stop:start((tonumber(arg[1]) or 3) * 1000, 0, function()
  print(("woken %d times"):format(wakeups))
  uv.stop()
end)

advance()
uv.run()
