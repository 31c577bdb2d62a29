-- A chart of 300 states, made by functions: a factory with lines of stations.
--
--   factory: (initial) --> closed --e_open--> waiting --e_order_N--> line N
--   line:    (initial) --> station 1 --e_next--> ... --e_next--> out
--   station: (initial) --> empty --e_part--> work --e_error--> fault --e_reset--> empty
--   work:    (initial) --> load --> run --> check --> unload
--
-- Each line leaves by its connector `out`, back to waiting.

local rfsm = require "rfsm"
require "rfsm_timeevent"

local state, trans, conn = rfsm.state, rfsm.trans, rfsm.conn

local LINES, STATIONS = 8, 4

local function new_work()
  return state {
    load = state {}, run = state {}, check = state {}, unload = state {},
    trans { src = "initial", tgt = "load" },
    trans { src = "load", tgt = "run", events = { "e_done" } },
    trans { src = "run", tgt = "check", events = { "e_after(20)" } },
    trans { src = "check", tgt = "run", events = { "e_again" }, pn = 1 },
    trans { src = "check", tgt = "unload", events = { "e_good", "e_bad" } },
  }
end

local function new_station()
  return state {
    empty = state {}, work = new_work(), paused = state {}, fault = state {},
    trans { src = "initial", tgt = "empty" },
    trans { src = "empty", tgt = "work", events = { "e_part" } },
    trans { src = "work", tgt = "paused", events = { "e_pause" } },
    trans { src = "paused", tgt = "work", events = { "e_resume" } },
    trans { src = ".work.unload", tgt = "empty", events = { "e_taken" } },
    trans { src = "work", tgt = "fault", events = { "e_error" } },
    trans { src = "fault", tgt = "empty", events = { "e_reset" } },
  }
end

local function new_line()
  local line = state {
    out = conn {}, trans { src = "initial", tgt = "station 1" },
    trans { src = "station " .. STATIONS, tgt = "out", events = { "e_next" } },
  }
  for i = 1, STATIONS do line["station " .. i] = new_station() end
  for i = 2, STATIONS do
    line[#line + 1] = trans { src = "station " .. i - 1, tgt = "station " .. i,
      events = { "e_next" } }
  end
  return line
end

local factory = state {
  closed = state {}, waiting = state {}, stopped = state {},
  trans { src = "initial", tgt = "closed" },
  trans { src = "closed", tgt = "waiting", events = { "e_open" } },
  trans { src = "waiting", tgt = "stopped", events = { "e_stop" } },
  trans { src = "stopped", tgt = "closed", events = { "e_close" } },
}

for i = 1, LINES do
  factory["line " .. i] = new_line()
  factory[#factory + 1] = trans { src = "waiting", tgt = "line " .. i,
    events = { "e_order_" .. i } }
  factory[#factory + 1] = trans { src = ".line " .. i .. ".out", tgt = "waiting" }
end

return factory
