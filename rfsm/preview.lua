--- Preview: prepares the states that are likely to be entered next.
--
-- Once this module is loaded, a transition may have a function `likely(fsm)`. After
-- each iteration this function is called for the transitions of all active states below
-- the root. If `likely` returns a true value and the target of the transition has a
-- function `prepare(fsm)`, `prepare` is called.
--
-- @module rfsm.preview
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local ipairs, pcall, rawget, rawset = ipairs, pcall, rawget, rawset
local tostring, type = tostring, type

local rfsm_preview = {}

-- Calls owner[what](fsm) and returns the result. An error is reported to `err`.
local function try(fsm, owner, what)
  local ok, result = pcall(owner[what], fsm)
  if ok then return result end
  rfsm.report(fsm, "err", "PREVIEW", ("error executing %s of %s: "):format(what,
    owner._fqn or tostring(owner)), result)
end

-- Calls `prepare` of a target, or `prepare` of its parent if the target is an `initial`
-- connector without this function.
local function prepare_target(fsm, target)
  if not target.prepare and rfsm.is_conn(target) and target._id == "initial" then
    target = target._parent
  end
  if target.prepare and not rfsm.is_fsmobj(target.prepare) then
    try(fsm, target, "prepare")
  end
end

-- Calls `likely` of all transitions from active states. Runs after every iteration.
local function preview(fsm)
  local state = fsm._actchild
  while state do
    for i = 1, #state._otrs do
      local tr = state._otrs[i]
      if tr.likely and try(fsm, tr, "likely") then
        prepare_target(fsm, tr.tgt)
      end
    end
    state = state._actchild
  end
end

rfsm.preproc[#rfsm.preproc + 1] = function(fsm, merged)
  local problems = {}
  for _, tr in ipairs(rfsm.elements(merged or fsm, rfsm.is_trans)) do
    if tr.likely and not rfsm.is_callable(tr.likely) then
      problems[#problems + 1] = rfsm.location_of(tr, "likely")
        .. ": function expected, got " .. type(tr.likely)
    elseif tr.likely and not fsm._has_preview then
      fsm._has_preview = true
      rfsm.post_step_hook_add(fsm, preview)
    end
  end
  return problems
end

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_preview", rfsm_preview) end

return rfsm_preview
