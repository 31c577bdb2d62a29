-- What `rfsm check cell_mended.lua` judges. Entries are called to see what they emit.

local rfsm_checks = require "rfsm_checks"

local dry = { dry_run = true }

return {
  machines = { left = dry, right = dry, zone = dry },
  properties = {
    ["one arm is inside"] = rfsm_checks.never { "left: root.inside",
      "right: root.inside" },
  },
}
