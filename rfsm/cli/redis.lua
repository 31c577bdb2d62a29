--- `rfsm redis`: bundle charts as a library of Redis functions.
--
-- @module rfsm.cli.redis
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"
local fleets = require "rfsm.cli.fleet"
local opts = require "rfsm.shared.options"

local ask, connect = fleets.ask, fleets.connect

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

local GONE = "%s of %s cannot run until it is loaded, too"
local OLDER = "%s of %s: version %s is not loaded, those that do not fit the newest "
  .. "one cannot run until both are: rfsm redis %s=OLD.lua %s=NEW.lua ... --load %s"

-- Tells of machines whose chart, or its version, a library has not: it may be left out
-- by mistake.
local function warn_of_gone(fleet, url)
  local charts = fleet:charts() or {}
  for _, one in ipairs(fleet:versions() or {}) do
    local name = one.chart
    if one.known == "gone" then
      common.warn((charts[name] and OLDER or GONE):format(
        opts.counted(one.count, "machine"), name, one.version, name, name, url))
    end
  end
end

-- Loads a library. Tells what the one before could, and this one cannot.
local function load(text, url, options)
  local fleet = connect(url)
  local before = { history = fleet:ask("rfsm_history", "{0}"),
    index = fleet:ask("rfsm_find", "{0}", "", "") }
  common.try(fleet:load(text))
  for _, name in ipairs { "history", "index" } do
    if before[name] and not options[name] then
      common.warn(("the library before was made with --%s, this one is not"):format(
        name))
    end
  end
  warn_of_gone(fleet, url)
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
