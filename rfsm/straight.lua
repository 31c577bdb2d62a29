--- Straight code: what runs most, without a loop, without calls of its own.
--
-- `rfsm.quick` does without this file: it is slower then, and that is all. Text is
-- generated for a shape (how many states are left and entered, which of them by what
-- kind of transition), compiled once and bound to positions in the plan; no name of a
-- model is in it. Callbacks are read from the machine where they are called, and after
-- each one the text looks whether dbg has been switched on: then the core goes on.
--
-- @module rfsm.straight
-- @license BSD-3-Clause

local pcall, setmetatable, tostring, type = pcall, setmetatable, tostring, type
local huge = math.huge
local concat = table.concat
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local loadstring = rawget(_G, "loadstring") or rawget(_G, "load")

-- So many values are bound to one function: Lua 5.1 allows 60.
local MAX_VALUES = 50

-- Parameters: does a function take the events? ----------------------------------

local getinfo = rawget(_G, "debug") and rawget(_G, "debug").getinfo
local dump = rawget(string, "dump")

-- Lua 5.1 has no answer, but the binary form of a function does: in the header of 12
-- bytes the sizes of int and size_t are at 8 and 9, a 1 at 7 is for little endian; then
-- come the name of the source with its length, two ints, the number of upvalues, that
-- of parameters, and a byte that is not 0 for a vararg function.
local function read_dump(f)
  local ok, code = pcall(dump, f)
  if not ok or code:sub(1, 5) ~= "\27Lua\81" or code:byte(7) ~= 1 then return nil end
  local at, length = 13, 0
  for i = code:byte(9) - 1, 0, -1 do length = length * 256 + code:byte(at + i) end
  at = at + code:byte(9) + length + 2 * code:byte(8) + 1
  return code:byte(at), code:byte(at + 1) ~= 0
end

local function count_parameters(f)
  if type(f) ~= "function" then return huge end
  local info = getinfo and getinfo(f, "u") or {}
  local count, is_vararg = info.nparams, info.isvararg
  if not count then count, is_vararg = read_dump(f) end
  return is_vararg and huge or count or huge
end

-- How many parameters a function has, a great many where it is not known: one that has
-- none for the events cannot keep them.
local parameters_of = setmetatable({}, { __mode = "k", __index = function(notes, f)
  notes[f] = count_parameters(f)
  return notes[f]
end })

-- Text ---------------------------------------------------------------------------

-- What a text was compiled to, while anything that was made with it is in use.
local makers = setmetatable({}, { __mode = "v" })

-- Compiles `lines` to a function that gets the values by name.
local function make(chunkname, names, values, lines)
  local text = ("local %s = ...\n%s\n"):format(concat(names, ", "), concat(lines, "\n"))
  local maker = makers[text] or loadstring(text, "=rfsm " .. chunkname)
  makers[text] = maker
  return maker(unpack(values, 1, #names)), maker
end

local function bind(names, values, name, value)
  names[#names + 1] = name
  values[#names] = value
end

-- Segments: leave, effect, enter ---------------------------------------------------

local HOOKS = [[
  local entry_hooks, exit_hooks = fsm._entry_hooks, fsm._exit_hooks]]

-- The root, in which all fields that are set anew are noticed, has false instead of no
-- active child until the next one is entered.
local LEAVE = [[
  local s$n = s$m._parent
  s$m._mode = "inactive"
  s$n._actchild = $none
  local callback = s$m.exit
  if callback then
    callback(fsm, s$m, "exit")
    if fsm._is_traced then return resume(fsm) end
  end]]

local LEAVE_HOOKED = [[
  if exit_hooks and exit_hooks[s$m] then
    run_state_hooks(fsm, s$m, exit_hooks)
    if fsm._is_traced then return finish_leaving(fsm, s$m) end
  end]]

local FORGET_LEAF = [[
  fsm._act_leaf = false]]

local FORGET_DOO = [[
  if s0._doo_co then s0._doo_co = nil end]]

local EFFECT = [[
  fsm._from = false
  local callback = tr.effect
  if callback then
    if parameters_of[callback] > 3 then keep_events(fsm) end
    callback(fsm, tr, "effect", fsm._curq)
    if fsm._is_traced then return resume(fsm) end
  end]]

local ENTER = [[
  local s$n = nodes[i$n]
  s$n._mode = "active"
  s$m._actchild = s$n]]

local ENTER_HOOKED = [[
  if entry_hooks and entry_hooks[s$n] then run_state_hooks(fsm, s$n, entry_hooks) end]]

local ENTRY = [[
  local callback = s$n.entry
  if callback then
    callback(fsm, s$n, "entry")
    if fsm._is_traced then return resume(fsm) end
  end]]

local ENTRY_HOOKED = [[
  if fsm._is_traced then return resume(fsm) end]]

local COMPLETE = [[
  fsm._act_leaf = s$n
  if s$n.doo then
    s$n._doo_co = nil
  else
    local queue = fsm._intq
    s$n._mode = "done"
    queue[#queue + 1] = done_event
  end]]

-- Returns the function that takes the segment `def` from a state that is `exits` levels
-- below what stays active; nil where that is not for straight code.
local function make_segment(parts, def, exits, is_hooked)
  local entries, src, n, none = def.entries, def.src, exits, "nil"
  if exits + #entries > MAX_VALUES - 10 then return nil end
  local names = {
    "resume", "run_state_hooks", "finish_leaving", "keep_events", "parameters_of",
    "done_event",
  }
  local values = {
    parts.resume, parts.run_state_hooks, parts.finish_leaving, parts.keep_events,
    parameters_of, def.tgt.done_event,
  }
  local lines = { "return function(fsm, s0, tr)", "local nodes = fsm._nodes" }
  local function write(is_wanted, text, number)
    if not is_wanted then return end
    text = text:gsub("$(%l+)", { n = number, m = number - 1, none = none })
    lines[#lines + 1] = text
  end
  write(is_hooked, HOOKS, 0)
  for i = 1, exits do
    local is_leaf = i == 1 and src.kind == "state"
    if i == exits and def.lca.depth == 0 then none = "false" end
    write(true, LEAVE, i)
    write(is_hooked, LEAVE_HOOKED, i)
    write(is_leaf, FORGET_LEAF, i)
    write(is_leaf and (src.doo or not src.is_leaf), FORGET_DOO, i)
  end
  write(true, EFFECT, 0)
  for i = 1, #entries do
    n = n + 1
    bind(names, values, "i" .. n, entries[i].index)
    write(true, ENTER, n)
    write(is_hooked, ENTER_HOOKED, n)
    write(true, ENTRY, n)
    write(is_hooked, ENTRY_HOOKED, n)
  end
  write(not def.connector, COMPLETE, n)
  lines[#lines + 1] = "end"
  return (make("segment", names, values, lines))
end

-- A segment that starts at a composite: what it leaves depends on the active leaf.
local function make_dispatch(parts, def, is_hooked)
  local runs = {}
  return function(fsm, from, tr)
    local exits = from["_%def"].depth - def.lca.depth
    local run = runs[exits]
    if run == nil then
      run = make_segment(parts, def, exits, is_hooked) or parts.run_segment
      runs[exits] = run
    end
    return run(fsm, from, tr)
  end
end

local function segment(parts, def, is_hooked)
  local src = def.src
  if def.is_internal then return parts.run_segment end
  if src.kind == "state" and not src.is_leaf then
    return make_dispatch(parts, def, is_hooked)
  end
  local from = src.kind == "state" and src or src.parent
  return make_segment(parts, def, from.depth - def.lca.depth, is_hooked)
    or parts.run_segment
end

-- Searches: one guard after the other ------------------------------------------------

local ASK = [[
local tr = transitions[i$n]
local guard, ok, answer = tr.guard, true, nil
if guard then
  if parameters_of[guard] > 1 then keep_events(fsm) end
  ok, answer = pcall(guard, tr, events)
  if not ok then report_callback(fsm, "guard", tostring(tr), answer) end
end
if ok and answer ~= false then
local def, tgt = d$n, tr.tgt
if nodes[t$n] ~= tgt then
  def = enabled_with(fsm, def, tgt, events, $level)
else]]

local NOTE_WAY = [[
if w$level then
  x$level = x$level or { w$level }
  x$level[#x$level + 1] = def
else
  w$level = def
end]]

-- As in the core a connector counts as closed while it is being evaluated: a transition
-- may have got it as its target.
local BEGIN = [[
searched[c$n], ways[c$n] = number, false
local w$level, x$level = false, nil]]

local EVALUATED = [[
if x$level then warn_of_conflict(fsm, c$n, x$level) end
ways[c$n] = w$level
def = w$level and def]]

local Search = {}
Search.__index = Search

function Search:write(text, n, level)
  text = text:gsub("$(%l+)", { n = n, level = level })
  self.lines[#self.lines + 1] = text
end

function Search:bind(name, value) bind(self.names, self.values, name, value) end

-- Writes what a transition asks for that leaves an active state (level 0) or a
-- connector.
function Search:transition(def, level)
  local n = self.count + 1
  self.count = n
  self:bind("d" .. n, def)
  self:bind("i" .. n, def.index)
  self:bind("t" .. n, def.tgt.index)
  local is_asked = def.events and (level > 0 or def.has_predicate)
  self:write(is_asked and "if matches(d$n, events) then" or "do", n)
  self:write(ASK, n, level)
  if def.connector then self:connector(def.connector, level + 1, n) end
  self:write("end if def then")
  self:write(level == 0 and "do return def end" or NOTE_WAY, n, level)
  self:write("end end end")
end

-- Writes how the way out of a connector is found, in w<level>. One that is reached a
-- second time, which is to be evaluated once, is not for straight text.
function Search:connector(connector, level, n)
  local otrs = connector.otrs
  if self.seen[connector] or #self.values > MAX_VALUES or level > 12 then
    self.is_too_much = true
    return
  end
  self.seen[connector] = true
  self:bind("c" .. n, connector)
  self:write(BEGIN, n, level)
  local pn = nil
  self:write("do")
  for i = 1, #otrs do -- those of one priority are asked together, for conflicts
    if (otrs[i].pn or 0) ~= pn then self:write("end if not w$level then", n, level) end
    if otrs[i].connector == nil then self.parts.compile_transition(otrs[i]) end
    pn = otrs[i].pn or 0
    self:transition(otrs[i], level)
  end
  self:write("end")
  self:write(EVALUATED, n, level)
end

-- Returns a function that returns the first of the candidates that is enabled, or false
-- where there are too many.
local function search(parts, candidates)
  local self = setmetatable({
    parts = parts, count = 0, seen = {}, lines = {},
    names = {
      "pcall", "tostring", "parameters_of", "keep_events", "report_callback", "matches",
      "warn_of_conflict", "enabled_with",
    },
    values = {
      pcall, tostring, parameters_of, parts.keep_events, parts.report_callback,
      parts.matches, parts.warn_of_conflict, parts.enabled_with,
    },
  }, Search)
  for i = 1, #candidates do
    self:transition(candidates[i], 0)
    if self.is_too_much or #self.values > MAX_VALUES then return false end
  end
  if self.count == 0 then return false end
  return (make("search", self.names, self.values, {
    "return function(fsm, candidates, events)",
    "local transitions, nodes = fsm._transitions, fsm._nodes",
    "local searched, ways, number = fsm._searched, fsm._ways, fsm._search + 1",
    "fsm._search = number",
    concat(self.lines, "\n"),
    "end",
  }))
end

--- Make the straight code of one core.
---@param parts table functions of the core
---@return table code `segment(def, is_hooked)`, `search(candidates)`, `parameters_of`
return function(parts)
  return {
    parameters_of = parameters_of,
    segment = function(def, is_hooked) return segment(parts, def, is_hooked) end,
    search = function(candidates) return search(parts, candidates) end,
  }
end
