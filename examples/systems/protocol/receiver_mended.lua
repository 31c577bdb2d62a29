-- The receiver, but it takes one event an iteration.

local system = require "rfsm.system"

local receiver = system.load "receiver.lua"
receiver.read = "one"
return receiver
