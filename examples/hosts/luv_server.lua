-- A host: a TCP server on luv, with a machine for each connection. A line is an event,
-- and is answered by the name of the leaf. After a minute the connection is closed.
--
--   lua examples/hosts/luv_server.lua [PORT]        from the top of the checkout
--   printf 'e_push\nstats\n' | nc -q 1 localhost 8091

package.path = "./?.lua;" .. package.path

local uv = require "luv"
local rfsm, rfsm_timeevent = require "rfsm", require "rfsm_timeevent"
local state, trans = rfsm.state, rfsm.trans
local machines, lines = 0, 0

rfsm_timeevent.set_gettime_hook(uv.hrtime) -- nanoseconds, monotonic

local model = state { info = false, -- the machines share its structure
  open = state { off = state {}, on = state {},
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "on", events = { "e_push" } },
    trans { src = "on", tgt = "off", events = { "e_push" } } },
  closed = state { final = true, entry = function(fsm)
    fsm.peer:close()
    fsm.alarm:close()
    machines = machines - 1
  end },
  trans { src = "initial", tgt = "open" },
  trans { src = "open", tgt = "closed", events = { "e_after(60)", "e_end" } },
}

local function advance(fsm, event)
  rfsm.send_events(fsm, event)
  rfsm.run(fsm)
  local seconds = rfsm_timeevent.next_deadline(fsm)
  if seconds then fsm.alarm:start(math.ceil(seconds * 1000), 0, fsm.wake) end
end

local function answer(fsm, line)
  lines = lines + 1
  if line ~= "stats" then advance(fsm, line) else collectgarbage() end
  return line ~= "stats" and rfsm.get_actleaf_fqn(fsm) or ("%d machines, %d lines, "
    .. "%.1f KiB each"):format(machines, lines, collectgarbage "count" / machines)
end

local server = uv.new_tcp()
assert(server:bind("127.0.0.1", tonumber(arg[1]) or 8091))
assert(server:listen(1024, function()
  local fsm, peer, rest = assert(rfsm.init(model)), uv.new_tcp(), ""
  machines, fsm.peer, fsm.alarm = machines + 1, peer, uv.new_timer()
  function fsm.wake() advance(fsm) end
  advance(fsm)
  server:accept(peer)
  peer:read_start(function(_, data)
    rest = rest .. (data or "")
    for line in rest:gmatch("([^\n]*)\n") do peer:write(answer(fsm, line) .. "\n") end
    rest = rest:match("[^\n]*$")
    if not data then advance(fsm, "e_end") end
  end)
end))
uv.run()
