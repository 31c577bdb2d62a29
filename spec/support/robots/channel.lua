-- Two channels of a valve block, copies of one state.
local rfsm = require "rfsm"
local utils = require "table_utils"

local channel = rfsm.state {
  shut = rfsm.state { entry = function() valve(0) end },
  flowing = rfsm.state { entry = function() valve(1) end },
  rfsm.trans { src = "initial", tgt = "shut" },
  rfsm.trans { src = "shut", tgt = "flowing", events = { "e_flow" } },
  rfsm.trans { src = "flowing", tgt = "shut", events = { "e_shut" } },
}

return rfsm.state {
  water = utils.deepcopy(channel),
  soap = utils.deepcopy(channel),
  rfsm.trans { src = "initial", tgt = "water" },
  rfsm.trans { src = "water", tgt = "soap", events = { "e_next" } },
  rfsm.trans { src = "soap", tgt = "water.flowing", events = { "e_rinse" } },
}
