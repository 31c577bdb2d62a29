-- The sender, but it takes one event an iteration.

local system = require "rfsm.system"

local sender = system.load "sender.lua"
sender.read = "one"
return sender
