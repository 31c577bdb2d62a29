-- Thirty steps, one after the other.
--
--   (initial) --> step 1 --e_done--> step 2 --e_done--> ... step 30

local rfsm = require "rfsm"

local STEPS = 30

local recipe = rfsm.state {
  doc = "thirty steps, one after the other",
  rfsm.trans { src = "initial", tgt = "step 1" },
}

for i = 1, STEPS do recipe["step " .. i] = rfsm.state { final = i == STEPS or nil } end
for i = 2, STEPS do
  recipe[#recipe + 1] = rfsm.trans { src = "step " .. i - 1, tgt = "step " .. i,
    events = { "e_done" } }
end

return recipe
