--- `rfsm snapshot diff OLD NEW`: reports what a new chart means for saved machines.
--
-- @module rfsm.cli.snapshot
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"

local command = {
  summary = "Report what a new chart means for saved machines.",
  epilog = "Ends with status 1 if machines in some state would not move.",
}

function command.add_arguments(parser)
  parser:argument("action", "diff: compare two versions"):choices { "diff" }
  parser:argument("old", "Lua file of the chart that machines have"):argname("OLD")
  parser:argument("new", "Lua file of the new version"):argname("NEW")
end

--- Print the report on two chart files; return whether all saved machines can move to
-- the new chart.
function command.compare(old, new)
  require "rfsm_timeevent"
  require "rfsm.await"
  local diff, models = require "rfsm.snapshot.diff", {}
  for i, file in ipairs { old, new } do
    common.read(file)
    models[i] = common.try(common.load_model(file))
  end
  local difference, fates = common.call(new, diff.compare, models[1], models[2])
  local text, is_safe = diff.report(difference, fates)
  common.write("-", text)
  return is_safe
end

function command.run(options)
  return command.compare(options.old, options.new) and 0 or 1
end

return command
