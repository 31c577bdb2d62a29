-- Why the library catches errors: each call of pcall, by file, with its reasons. Who
-- adds one says here what may fail, and where the failure goes.
--
-- package    one that may be missing is looked for
-- user       code of the user: the failure is reported, with its place
-- input      a text or a chart from outside: the failure becomes a message
-- host       a function of the host, a file, or another program may fail
-- after      what has begun is undone or finished, then the error is raised again
-- interrupt  an interrupt is told apart from other errors, and raised again

local REASONS = {
  ["rfsm.lua"] = { 25, "user after package host" },
  ["rfsm_checks.lua"] = { 1, "user" },
  ["rfsm_seqand.lua"] = { 6, "user after input" },
  ["rfsm_timeevent.lua"] = { 2, "host user" },
  ["rfsmpp.lua"] = { 1, "package" },
  ["rfsm/cli/common.lua"] = { 2, "user interrupt" },
  ["rfsm/cli/fleet.lua"] = { 2, "host" },
  ["rfsm/cli/review.lua"] = { 1, "input" },
  ["rfsm/cli/viz.lua"] = { 2, "input" },
  ["rfsm/clock.lua"] = { 5, "host package" },
  ["rfsm/explore/observers.lua"] = { 1, "user" },
  ["rfsm/explore/properties.lua"] = { 2, "user" },
  ["rfsm/explore/subject.lua"] = { 1, "after" },
  ["rfsm/fast.lua"] = { 3, "user input after" },
  ["rfsm/fleet.lua"] = { 13, "host user" },
  ["rfsm/merge.lua"] = { 2, "user interrupt after" },
  ["rfsm/observe/breakpoints.lua"] = { 1, "input" },
  ["rfsm/observe/watch_properties.lua"] = { 2, "after user" },
  ["rfsm/pictures/diagram.lua"] = { 1, "input" },
  ["rfsm/postgres.lua"] = { 2, "host after" },
  ["rfsm/postgres/script.lua"] = { 1, "user" },
  ["rfsm/preview.lua"] = { 1, "user" },
  ["rfsm/proto.lua"] = { 3, "host input" },
  ["rfsm/record.lua"] = { 2, "after interrupt input" },
  ["rfsm/redis.lua"] = { 1, "input" },
  ["rfsm/redis/connection.lua"] = { 13, "host package" },
  ["rfsm/redis/store.lua"] = { 7, "host input" },
  ["rfsm/rtt.lua"] = { 6, "host" },
  ["rfsm/rtt/component.lua"] = { 6, "host package" },
  ["rfsm/rtt/hooks.lua"] = { 4, "host user" },
  ["rfsm/rtt/inputs.lua"] = { 1, "host after" },
  ["rfsm/rtt/launch.lua"] = { 11, "host after input" },
  ["rfsm/rtt/launch_system.lua"] = { 4, "host after" },
  ["rfsm/rtt/port.lua"] = { 4, "host" },
  ["rfsm/rtt/program.lua"] = { 2, "host" },
  ["rfsm/rtt/rttlib.lua"] = { 2, "package" },
  ["rfsm/rtt/update.lua"] = { 8, "host user after" },
  ["rfsm/rtt/wiring.lua"] = { 2, "host" },
  ["rfsm/server/charts.lua"] = { 2, "input" },
  ["rfsm/server/functions.lua"] = { 2, "input user" },
  ["rfsm/server/library.lua"] = { 2, "input" },
  ["rfsm/shared/calls.lua"] = { 2, "interrupt after" },
  ["rfsm/shared/chart.lua"] = { 3, "package input" },
  ["rfsm/shared/exact_json.lua"] = { 1, "input" },
  ["rfsm/shared/limit.lua"] = { 2, "input after" },
  ["rfsm/shared/syntax.lua"] = { 3, "package input host" },
  ["rfsm/shared/typed.lua"] = { 2, "input" },
  ["rfsm/sim/prompt.lua"] = { 3, "user" },
  ["rfsm/sim/session.lua"] = { 1, "after" },
  ["rfsm/sim/terminal.lua"] = { 5, "package after interrupt user" },
  ["rfsm/snapshot.lua"] = { 4, "after user" },
  ["rfsm/snapshot/encoding.lua"] = { 1, "input" },
  ["rfsm/system/product.lua"] = { 1, "input" },
  ["rfsm/system/report.lua"] = { 2, "input" },
  ["rfsm/web.lua"] = { 1, "input" },
  ["rfsm/web/driven.lua"] = { 2, "interrupt input" },
  ["rfsm/web/http.lua"] = { 1, "package" },
  ["rfsm/web/picture.lua"] = { 3, "host package" },
}

local helper = require "spec.helper"

-- Counts the calls in a file, without those in comments and texts.
local function count_calls(file)
  local count = 0
  for line in helper.content(file):gmatch("[^\n]+") do
    local code = line:gsub("%-%-.*", "")
    count = count + select(2, code:gsub("%f[%w_.:]x?pcall%(", ""))
  end
  return count
end

describe("an error that is caught", function()
  it("is one for which spec/pcall_spec.lua has a reason", function()
    local found, expected = {}, {}
    for file in io.popen("ls rfsm*.lua rfsm/*.lua rfsm/*/*.lua"):lines() do
      local count = count_calls(file)
      found[file] = count > 0 and count or nil
    end
    for file, case in pairs(REASONS) do expected[file] = case[1] end -- any order
    assert.same(expected, found)
  end)
end)
