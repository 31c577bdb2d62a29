--- Witnesses: the run that shows a finding, for the simulator and for pictures.
--
-- @module rfsm.checks.witness
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local rehearsal = require "rfsm.checks.rehearsal"

local error, ipairs, require, type = error, ipairs, require, type

local witness = {}

local function check_steps(steps, where)
  if type(steps) == "table" then return end
  error("rfsm_checks." .. where .. ": the witness of a finding expected, got "
    .. type(steps), 3)
end

--- Write a witness as a recording, which `rfsm sim --replay FILE --dry CHART` runs.
---@param model rfsm.State
---@param steps rfsm_checks.WitnessStep[] the field `witness` of a finding
---@param sink table|string list of records, or the name of a file
function witness.record_witness(model, steps, sink)
  check_steps(steps, "record_witness")
  local run = rehearsal.rehearsal(model)
  local fsm = run.puppet.parts[1].fsm
  local recorder = require("rfsm.record").record(fsm, sink)
  for _, step in ipairs(steps) do
    for i = 1, #step.values do rfsm.send_events(fsm, step.values[i]) end
    run:step(rehearsal.what_of(step))
  end
  recorder:stop()
end

--- List the transitions and leaves of a witness by path: the `trace` of a picture.
---@param steps rfsm_checks.WitnessStep[]
---@return string[] paths
function witness.path_of(steps)
  check_steps(steps, "path_of")
  local paths = {}
  for _, step in ipairs(steps) do
    for _, path in ipairs(step.taken) do paths[#paths + 1] = path end
    if step.taken[1] and step.leaf then paths[#paths + 1] = step.leaf end
  end
  return paths
end

return witness
