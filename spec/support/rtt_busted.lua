-- Runs the specs in SPECS in a rttlua, on the real RTT:
--
--   SPECS="spec/rtt_spec.lua spec/rtt_own_spec.lua" rttlua spec/support/rtt_busted.lua

local arguments = { [0] = "busted", "--ignore-lua" }
for name in (os.getenv("SPECS") or "spec/rtt_spec.lua"):gmatch("%S+") do
  arguments[#arguments + 1] = name
end
rawset(_G, "arg", arguments)

require "busted.runner"({ standalone = false })
