-- What `rfsm check cell_mended.lua` judges. Entries are called to see what they emit.

local rfsm_checks = require "rfsm_checks"

local dry = { dry_run = true }

return {
  machines = { supervisor = dry, arm = dry, base = dry },
  properties = {
    ["the stop arrives at the arm"] =
      rfsm_checks.after("supervisor: e_stop").reach "arm: root.halted",
    ["the stop arrives at the base"] =
      rfsm_checks.after("supervisor: e_stop").reach "base: root.halted",
  },
}
