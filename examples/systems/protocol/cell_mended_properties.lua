-- What `rfsm check cell_mended.lua` judges. Entries are called to see what they emit.

local rfsm_checks = require "rfsm_checks"

local dry = { dry_run = true }

return {
  machines = { sender = dry, receiver = dry },
  properties = {
    ["all is received before it is sent"] = rfsm_checks.never { "sender: root.sent",
      "receiver: root.half" },
  },
}
