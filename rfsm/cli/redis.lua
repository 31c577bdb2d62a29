--- `rfsm redis`: bundle charts as a library of Redis functions.
--
-- @module rfsm.cli.redis
-- @license BSD-3-Clause

local chart = require "rfsm.shared.chart"
local common = require "rfsm.cli.common"

local redis = {
  summary = "Bundle charts as a library of Redis functions.",
  epilog = "The name of a chart is that of its file; NAME=FILE gives another one. Of "
    .. "charts with one name the last is the newest.",
}

function redis.add_arguments(command)
  command:argument("files", "Lua files that return a chart"):args("+")
    :argname("[NAME=]FILE")
  command:option("-o --output", "file to write; - is stdout"):argname("FILE")
  command:option("-l --load", "load the library into this server"):argname("URL")
end

function redis.run(options)
  local ok, text = common.with_streams(io.stderr, require("rfsm.redis").bundle,
    options.files)
  if not ok then common.fail(chart.first_line(text)) end
  if options.load then
    local connected, fleet = pcall(require("rfsm.fleet").connect, options.load)
    if not connected then common.fail(chart.first_line(fleet)) end
    common.try(fleet:load(text))
  end
  if options.output or not options.load then
    common.write(options.output or "-", text)
  end
end

return redis
