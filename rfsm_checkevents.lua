--- Switches the check for undeclared events on.
--
-- Each machine initialised afterwards warns of events that none of its transitions
-- names, unless its root says `checkevents = false`.
--
-- @module rfsm_checkevents
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rfsm_checks = require "rfsm_checks"

local rawget, rawset = rawget, rawset

local rfsm_checkevents = { watch = rfsm_checks.watch }

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  if not merged and fsm.checkevents ~= false then rfsm_checks.watch(fsm) end
end

if not rawget(_G, "RFSM_NO_GLOBALS") then
  rawset(_G, "rfsm_checkevents", rfsm_checkevents)
end

return rfsm_checkevents
