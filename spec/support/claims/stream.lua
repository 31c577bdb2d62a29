-- The states that a stream tells of are those whose entries are called, in that order,
-- on random charts.

local driven = require "spec.support.driven"
local stream = require "rfsm.observe.stream"

local function case(seed)
  local called, told, run = {}, {}, driven.new(seed)
  function run.enter(fqn) called[#called + 1] = "entered " .. fqn end
  stream.follow(run.fsm, {
    entered = function(_, state) told[#told + 1] = "entered " .. state._fqn end,
  })
  for step = 1, 40 do
    driven.step(run)
    for i = 1, math.max(#called, #told) do
      if called[i] ~= told[i] then
        return ("step %d: called %s, told %s"):format(step, tostring(called[i]),
          tostring(told[i]))
      end
    end
    called, told = {}, {}
  end
end

return { name = "a stream and the callbacks", run = driven.claim(case) }
