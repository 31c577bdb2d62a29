local checks = require "rfsm_checks"

return { machines = { sup = { dry_run = true, alphabet = {} },
    arm = { dry_run = true, alphabet = {} } },
  properties = { checks.never "sup: root.holding", checks.never "sup: root.failed" } }
