--- Preview: prepares the states that are likely to be entered next.
--
-- Once this module is loaded, a transition may have a function `likely(fsm)`. After
-- each iteration it is called for the transitions of all active states below the root.
-- If it returns a true value, `prepare(fsm)` of the target is called, if there is one.
--
-- @module rfsm.preview
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local getmetatable, pcall, print, rawget, rawset = getmetatable, pcall, print, rawget,
  rawset
local tostring, type = tostring, type
local actchild_get = rfsm.actchild_get

local rfsm_preview = {}

local function complain(fsm, program, owner, failure)
  local printer = fsm.err
  if printer == true then printer = print end
  if not printer then return end
  printer("PREVIEW", ("error executing %s of %s: "):format(program, owner), failure)
end

-- What a transition leads to: a composite is entered at its `initial` connector.
local function find_prepare(tr)
  local target = tr.tgt
  local prepare = target.prepare
  if not prepare and rfsm.is_conn(target) and target._id == "initial" then
    target = target._parent
    prepare = target.prepare
  end
  return prepare, target
end

local function preview_transition(fsm, tr)
  local ok, answer = pcall(tr.likely, fsm)
  if not ok then return complain(fsm, "likely", tostring(tr), answer) end
  if not answer then return end
  local prepare, target = find_prepare(tr)
  if not prepare then return end
  local is_prepared, failure = pcall(prepare, fsm)
  if not is_prepared then complain(fsm, "prepare", target._fqn, failure) end
end

local function preview(fsm)
  local state = actchild_get(fsm)
  while state do
    local otrs = state._otrs
    for i = 1, otrs and #otrs or 0 do
      if otrs[i].likely then preview_transition(fsm, otrs[i]) end
    end
    state = actchild_get(state)
  end
end

local function is_callable(value)
  if type(value) == "function" then return true end
  local class = getmetatable(value)
  return type(class) == "table" and rawget(class, "__call") ~= nil
end

local function place_of(tr)
  local key = type(tr._id) == "number" and ("trans[%d]"):format(tr._id) or tr._id
  return tr._parent._fqn .. "." .. key
end

local function prepare_transition(fsm, tr, problems)
  if not tr.likely then return end
  if not is_callable(tr.likely) then
    problems[#problems + 1] = place_of(tr) .. ".likely: function expected, got "
      .. type(tr.likely)
  elseif not fsm._preview then
    fsm._preview = true
    rfsm.post_step_hook_add(fsm, preview)
  end
end

local function prepare_model(fsm, merged)
  local obj, problems = merged or fsm, {}
  if rfsm.is_trans(obj) then
    prepare_transition(fsm, obj, problems)
  elseif rfsm.is_state(obj) then
    rfsm.mapfsm(function(tr) prepare_transition(fsm, tr, problems) end, obj,
      rfsm.is_trans)
  end
  return problems
end

rfsm.preproc[#rfsm.preproc + 1] = prepare_model

if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, "rfsm_preview", rfsm_preview) end

return rfsm_preview
