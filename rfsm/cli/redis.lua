--- `rfsm redis`: bundle charts as a library of Redis functions.
--
-- @module rfsm.cli.redis
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local rfsm = require "rfsm"
local ask, connect = require("rfsm.cli.fleet").ask, require("rfsm.cli.fleet").connect

local redis = {
  summary = "Bundle charts as a library of Redis functions.",
  epilog = common.CHART_NAMES,
}

function redis.add_arguments(command)
  common.add_charts(command, "URL", "load the library into this server")
  command:flag("--index", "machines can be found by their state")
  common.add_number(command, "--history", "keep so many moves of each machine",
    common.SIZE)
  command:flag("--diff", "report what new versions mean for saved machines")
  command:option("--stats", "print the numbers of machines there, for Prometheus")
    :argname("URL")
end

-- Reports on each chart that has two versions. Returns whether all saved machines can
-- move to the next version.
local function compare(files)
  local latest, is_safe, count = {}, true, 0
  for _, argument in ipairs(files) do
    local name, file = require("rfsm.redis").name_of(argument)
    if latest[name] then
      common.write("-", ("%s: %s -> %s\n"):format(name, latest[name], file))
      is_safe = require("rfsm.cli.snapshot").compare(latest[name], file) and is_safe
      count = count + 1
    end
    latest[name] = file
  end
  if count == 0 then common.fail("--diff: two versions of a chart expected", 2) end
  return is_safe
end

-- Loads a library. Tells of a chart that the library before had, and this one has not:
-- it may be left out by mistake.
local function load(text, url)
  local fleet = connect(url)
  local before = fleet:charts() or {}
  common.try(fleet:load(text))
  local after = fleet:charts() or {}
  for _, name in ipairs(rfsm.sorted_keys(before)) do
    if not after[name] then
      common.warn("the machines of " .. name
        .. " cannot run until it is loaded, too")
    end
  end
end

function redis.run(options, parser)
  if options.stats then
    local fleet = connect(options.stats)
    common.write("-", ask(fleet.stats, fleet))
    return
  end
  if options.diff then return compare(options.files) and 0 or 1 end
  local text = common.library_of(require("rfsm.redis").bundle, options, parser,
    { index = options.index, history = options.history })
  common.deliver(text, options, load)
end

return redis
