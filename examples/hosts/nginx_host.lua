-- A host: a machine in a worker of nginx, with Lua by OpenResty or by Debian's module.
-- Requests send events; timers of nginx wake the machine when one of its own is due.
--
-- nginx.conf beside this file starts it.

local rfsm = require "rfsm"
local rfsm_timeevent = require "rfsm_timeevent"

local ngx = rawget(_G, "ngx")

local host = {}

local fsm ---@type rfsm.Machine
local alarm = math.huge -- when nginx wakes the machine

rfsm_timeevent.set_gettime_hook(function()
  ngx.update_time()
  local sec = math.floor(ngx.now())
  return sec, (ngx.now() - sec) * 1e9
end)

-- Advances the machine. A timer of nginx cannot be taken back: a new one is set only if
-- it is earlier.
local function advance(is_ending)
  if is_ending then return end -- the worker is about to exit
  rfsm.run(fsm)
  local seconds = rfsm_timeevent.next_deadline(fsm)
  if not seconds or ngx.now() + seconds >= alarm then return end
  alarm = ngx.now() + seconds
  ngx.timer.at(math.ceil(seconds * 1000) / 1000, function(...)
    alarm = math.huge
    advance(...)
  end)
end

--- Make the machine of this worker.
function host.start(chart)
  fsm = assert(rfsm.init(rfsm.load(chart)))
  advance()
end

--- Answer a request: send the event in its body, if there is one.
function host.answer()
  ngx.req.read_body()
  local event = ngx.req.get_body_data()
  if event then
    rfsm.send_events(fsm, event)
    advance()
  end
  ngx.say(rfsm.get_actleaf_fqn(fsm))
end

return host
