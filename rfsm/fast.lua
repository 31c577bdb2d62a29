--- Fast: the same iterations in fewer instructions.
--
-- The core does without this file. It is slower then, and that is all: the functions
-- here replace those of the same names in the core, which are their specification, and
-- leave to them whatever is unusual.
--
--   choose   notes per leaf and event which transitions come into question; guards and
--            connectors are asked by generated text
--   take     runs a segment by generated text, without a loop
--   iterate  an event that leads straight to a leaf, an event that nothing waits for,
--            and no event at all
--
-- Text is generated for a shape: how many states are left and entered. It is compiled
-- once and bound to numbers of the plan; no name of a model is in it. Callbacks are read
-- where they are called. After each of them the text looks whether dbg has been switched
-- on: then the core goes on.
--
-- @module rfsm.fast
-- @license BSD-3-Clause

local error, ipairs, pairs, pcall, rawequal = error, ipairs, pairs, pcall, rawequal
local rawget, rawset, select, setmetatable = rawget, rawset, select, setmetatable
local type, xpcall = type, xpcall
local concat, insert = table.concat, table.insert
local coroutine, debug = rawget(_G, "coroutine"), rawget(_G, "debug")
local jit = rawget(_G, "jit")
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local NONE = {}

-- So many values are bound to one function: Lua 5.1 allows 60.
local MAX_VALUES = 50

-- Text ---------------------------------------------------------------------------

-- LuaJIT looks for a metamethod at each access that may find none. There, `rawget` and
-- `rawset` are instructions.
local function for_jit(line)
  if type(jit) ~= "table" then return line end
  line = line:gsub("= (s[01])%.(e%w+)$", '= rawget(%1, "%2")')
  line = line:gsub("tr%.([eg]%w+)", 'rawget(tr, "%1")')
  line = line:gsub("(s[01])%.(_?doo[_co]*) then", 'rawget(%1, "%2") then')
  return (line:gsub("^([sf]%w+)%.(_[%w_]+) = (.+)$", 'rawset(%1, "%2", %3)'))
end

--- A text that is being written.
---@class rfsm.fast.Text
---@field names string[] of the values that are bound to it
---@field values any[]
---@field lines string[]
---@field call_lines table<integer, true> numbers of the lines in which a callback is called

local Text = {}
Text.__index = Text

local function new_text(values)
  local text = setmetatable({
    names = {}, values = {}, lines = {}, call_lines = {},
  }, Text)
  for i = 1, #values, 2 do text:bind(values[i], values[i + 1]) end
  return text
end

function Text:bind(name, value)
  self.names[#self.names + 1] = name
  self.values[#self.names] = value
end

-- Writes the lines of a block, in which $x stands for places.x. The lines that call a
-- callback begin with "callback(".
function Text:write(block, places)
  for line in block:gmatch("[^\n]+") do
    line = line:gsub("^%s+", ""):gsub("$(%l+)", places or NONE)
    self.lines[#self.lines + 1] = for_jit(line)
    -- the first line has the names
    if line:find("^callback%(") then self.call_lines[#self.lines + 1] = true end
  end
end

-- What texts were compiled to, while anything that was made with it is in use.
local makers = setmetatable({}, { __mode = "v" })

-- The lines with calls in the functions that take a segment.
local call_lines_of = setmetatable({}, { __mode = "k" })

-- Compiles a text to a function that gets the values by name.
function Text:compile(loadstring, chunkname)
  local source = ("local %s = ...\n%s\n"):format(concat(self.names, ", "),
    concat(self.lines, "\n"))
  local maker = makers[source] or loadstring(source, "=rfsm " .. chunkname)
  makers[source] = maker
  return maker(unpack(self.values, 1, #self.names))
end

-- Take: a segment, and the unconditional ones behind it ------------------------------
--
-- The calls are numbered as in the core. The number is noted before each call, so that
-- the core can go on behind it, whatever happens. A function that takes a path returns
-- nil; LENT if a callback got the list of events, which it may keep; SEARCH if nothing
-- has been done, since a search is needed.

local LENT, SEARCH = 1, 2

-- The numbers of locals in these functions; NEXT is where a called function is.
local FSM, CALLBACK, NEXT = 1, 8, 9

local BEGIN = [[
  return function(fsm)
  local nodes, calls, s0, tr, s1, lent, callback = fsm._nodes, fsm._calls, fsm._from]]

-- A guard, or another target, wants a search.
local CHECK = [[
  tr = fsm._transitions[i$k]
  if tr.guard or nodes[t$k] ~= tr.tgt then return SEARCH end]]

local NOTE_WAY = [[
  fsm._ways[c$k] = d$k]]

local TAKE = [[
  calls.begun = 0
  fsm._phase = "take"]]

local SEGMENT_BEGIN = [[
  tr = fsm._transitions[i$k] ]]

local LEAVE_HOOKED = [[
  if fsm._exit_hooks and fsm._exit_hooks[$a] then
  calls.count = $action
  leave(call, fsm, $a)
  $b = $a._parent
  if fsm.dbg ~= silent then return resume(fsm) end
  else]]

local LEAVE = [[
  $b = $a._parent
  $a._mode = "inactive"
  $b._actchild = nil
  callback = $a.exit
  if callback then
  calls.begun = $number
  callback(fsm, $a, "exit")
  if fsm.dbg ~= silent then return resume(fsm) end
  end]]

local FORGET_LEAF = [[
  fsm._act_leaf = false]]

local FORGET_DOO = [[
  if $a._doo_co then $a._doo_co = nil end]]

local EFFECT = [[
  callback = tr.effect
  if callback then
  calls.begun = $number
  callback(fsm, tr, "effect", fsm._curq)
  if fsm.dbg ~= silent then return resume(fsm) end
  lent = LENT
  end]]

local ENTER_HOOKED = [[
  $b = nodes[i$k]
  if fsm._entry_hooks and fsm._entry_hooks[$b] then
  calls.count = $action
  enter(fsm, $b, d$k)
  if fsm.dbg ~= silent then return resume(fsm) end
  else]]

local ENTER = [[
  $b = nodes[i$k]
  $b._mode = "active"
  $a._actchild = $b
  callback = $b.entry
  if callback then
  calls.begun = $number
  callback(fsm, $b, "entry")
  if fsm.dbg ~= silent then return resume(fsm) end
  end]]

local COMPLETE = [[
  fsm._act_leaf = $b
  if not $b.doo then
  callback = fsm._intq
  $b._mode = "done"
  callback[#callback + 1] = done_event
  end]]

--- What the writer of a segment knows.
---@class rfsm.fast.Path
---@field text rfsm.fast.Text
---@field base integer number of the segment
---@field at integer how many states have been left or entered: s0 and s1 in turn
---@field count integer how many values with a number have been bound
---@field is_hooked boolean states may have hooks

local Path = {}
Path.__index = Path

-- Writes a block for the action with that number in the segment.
function Path:write(block, action, k)
  local number, at = self.base + (action or 0), self.at % 2
  self.text:write(block, {
    a = "s" .. at, b = "s" .. (1 - at), k = k, action = ("%d"):format(number),
    number = ("%d"):format(number + 1),
  })
end

-- Binds a value under a name with the number `k`.
function Path:bind(name, k, value) self.text:bind(name .. k, value) end

-- Writes the segment `def` from a state `exits` levels below what stays active.
function Path:segment(def, exits, ACTION)
  local src, entries = def.src, def.entries
  local actions = def.is_internal and 0 or 1
  for i = 1, exits do
    local is_leaf = i == 1 and src.kind == "state"
    actions = actions + 1
    if self.is_hooked then self:write(LEAVE_HOOKED, actions * ACTION) end
    self:write(LEAVE, actions * ACTION)
    if self.is_hooked then self:write("end") end
    if is_leaf then self:write(FORGET_LEAF) end
    if is_leaf and (src.doo or not src.is_leaf) then self:write(FORGET_DOO) end
    self.at = self.at + 1
  end
  self:write(EFFECT, (actions + 2) * ACTION)
  actions = actions + 3
  for i = 1, #entries do
    self.count = self.count + 1
    actions = actions + 1
    self:bind("i", self.count, entries[i].index)
    if self.is_hooked then
      self:bind("d", self.count, entries[i])
      self:write(ENTER_HOOKED, actions * ACTION, self.count)
    end
    local is_last = i == #entries and not def.connector
    self:write(ENTER, actions * ACTION, self.count)
    if is_last then self:write(COMPLETE) end
    if self.is_hooked then self:write("end") end
    self.at = self.at + 1
  end
end

-- Search: one guard after the other ------------------------------------------------

local ASK = [[
  local tr = transitions[i$n]
  local guard, ok, answer = tr.guard, true, nil
  if guard then
  ok, answer = pcall(guard, tr, events)
  if not ok then refuse(fsm, tr, guard, answer) end
  end
  if ok and answer ~= false then
  local def, tgt = d$n, tr.tgt
  if nodes[t$n] ~= tgt then
  ways = renew(fsm, connectors)
  def = enabled_with(fsm, def, tgt, events, $level)
  else]]

local NOTE_FOUND = [[
  if w$level then
  x$level = x$level or { w$level }
  x$level[#x$level + 1] = def
  else
  w$level = def
  end]]

-- As in the core a connector counts as not enabled while it is being evaluated: a
-- transition may have got it as its target.
local EVALUATE = [[
  ways[c$n] = false
  local w$level, x$level = false, nil]]

local EVALUATED = [[
  if x$level then warn_of_conflict(fsm, c$n, x$level) end
  ways[c$n] = w$level
  def = w$level and def]]

-- Returns the table of ways of a search that finds a changed target: only those that
-- this search has found.
local function renew(fsm, connectors)
  local old, new = fsm._ways, {}
  for i = 1, #connectors do new[connectors[i]] = old[connectors[i]] end
  fsm._ways = new
  return new
end

local Search = {}
Search.__index = Search

-- Writes what a transition asks for that leaves an active state (level 0) or a
-- connector.
function Search:transition(def, level)
  local n = self.count + 1
  self.count = n
  local text, places = self.text, { n = n, level = level }
  text:bind("d" .. n, def)
  text:bind("i" .. n, def.index)
  text:bind("t" .. n, def.tgt.index)
  local is_asked = def.events and (level > 0 or self.is_predicate[def])
  text:write(is_asked and "if matches(d$n, events) then" or "do", places)
  text:write(ASK, places)
  if def.connector then self:connector(def.connector, level + 1, n) end
  text:write("end\nif def then")
  text:write(level == 0 and "do return def end" or NOTE_FOUND, places)
  text:write("end\nend\nend")
end

-- Writes how the way out of a connector is found, in w<level>. One that is reached a
-- second time, which is to be evaluated once, is not for straight text.
function Search:connector(connector, level, n)
  local otrs, text, pn = connector.otrs, self.text, nil
  local places = { n = n, level = level }
  if self.seen[connector] or #text.values > MAX_VALUES or level > 12 then
    self.is_too_much = true
    return
  end
  self.seen[connector] = true
  self.connectors[#self.connectors + 1] = connector
  text:bind("c" .. n, connector)
  text:write(EVALUATE, places)
  text:write("do")
  for i = 1, #otrs do -- those of one priority are asked together, for conflicts
    if (otrs[i].pn or 0) ~= pn then text:write("end\nif not w$level then", places) end
    pn = otrs[i].pn or 0
    self.prepare(otrs[i])
    self:transition(otrs[i], level)
  end
  text:write("end")
  text:write(EVALUATED, places)
end

-- The parts that replace those of the core -------------------------------------------

local OTHER = {} -- stands for all events that the machine does not know

local function has_predicate(def)
  for i = 1, def.events and #def.events or 0 do
    if type(def.events[i]) == "function" then return true end
  end
  return false
end

-- May one event alone trigger it?
local function is_candidate(def, event)
  local events = def.events
  if not events or has_predicate(def) then return true end
  for i = 1, #events do
    if rawequal(events[i], event) then return true end
  end
  return false
end

--- Replace the functions of an engine.
---@param engine table the functions that are replaced
---@param core table the functions of the core
return function(engine, core)
  local ACTION, SEGMENT, silent = core.ACTION, core.SEGMENT, core.silent
  local handler, plain, GO_ON = core.handler, core.iterate, core.GO_ON
  local no_events, FIRST, OWN_ONLY = core.no_events, core.FIRST, core.OWN_ONLY
  local loadstring = core.loadstring

  local function prepare_transition(def)
    if def.connector == nil then core.compile_transition(def) end
    return def
  end

  -- In place of a function that is too large.
  local function take_plainly(fsm)
    fsm._calls.begun = 0
    fsm._phase = "take"
    core.take(fsm)
    return LENT
  end

  local function resume(fsm)
    core.take(fsm)
    return LENT
  end

  -- Returns the transition that a path through `def` always takes next: the only one
  -- of its connector, without events. Its guard is looked at in the run.
  local function behind(def)
    local connector = def.connector
    local otrs = connector and connector.otrs
    if otrs and #otrs == 1 and not otrs[1].events then
      return prepare_transition(otrs[1])
    end
  end

  -- Lists the segments of a path that is taken whenever its first one is, if no guard
  -- or other target has been set; nil where that is not so.
  local function straight_path(def)
    local path, seen = { prepare_transition(def) }, {}
    while def.connector do
      def = behind(def)
      if not def or seen[def] or #path > 4 then return nil end
      seen[def] = true
      path[#path + 1] = def
    end
    return path
  end

  local VALUES = {
    "silent", silent, "resume", resume, "leave", core.leave, "enter", core.enter,
    "call", core.call, "LENT", LENT, "SEARCH", SEARCH, "rawget", rawget, "rawset", rawset,
  }

  -- Returns the function that takes the segments of `path` from a state `exits` levels
  -- below what stays active; with a check if the path has not been searched. Nil if that
  -- is too much for one function.
  local function make_run(path, exits, is_hooked, is_checked)
    local text = new_text(VALUES)
    local own = setmetatable({
      text = text, base = SEGMENT, at = 0, count = 0, is_hooked = is_hooked,
    }, Path)
    text:bind("done_event", path[#path].tgt.done_event)
    text:write(BEGIN)
    for k, def in ipairs(path) do own:bind("i", "x" .. k, def.index) end
    for k = 1, is_checked and #path or 0 do
      own:bind("t", "x" .. k, path[k].tgt.index)
      own:write(CHECK, 0, "x" .. k)
      if k > 1 then
        own:bind("c", "x" .. k, path[k - 1].connector)
        own:bind("d", "x" .. k, path[k])
      end
    end
    for k = 2, is_checked and #path or 0 do own:write(NOTE_WAY, 0, "x" .. k) end
    own:write(TAKE)
    for k, def in ipairs(path) do
      if k > 1 then exits = path[k - 1].connector.parent.depth - def.lca.depth end
      own.base = own.base + SEGMENT
      if k > 1 or #path > 1 or not is_checked then own:write(SEGMENT_BEGIN, 0, "x" .. k) end
      own:segment(def, exits, ACTION)
      if #text.values > MAX_VALUES then return nil end
    end
    text:write("return lent\nend")
    local run = text:compile(loadstring, "path")
    call_lines_of[run] = text.call_lines
    return run
  end

  local function exits_of(def, state)
    return def.is_internal and 0 or state["_%def"].depth - def.lca.depth
  end

  -- Makes the function for the path that a search has found.
  local function note_run(fsm, at, def, exits)
    local path = { def }
    while def.connector do
      def = fsm._ways[def.connector]
      path[#path + 1] = def
    end
    at.run = make_run(path, exits, fsm._is_hooked, false) or take_plainly
    return at.run
  end

  -- Returns the function for the path that a search has found. They are kept in a tree:
  -- by the levels that are left, then by the transitions behind the first one.
  local function run_of(fsm, def, state)
    local first, ways, exits = def, fsm._ways, exits_of(def, state)
    local name = fsm._is_hooked and "hooked_runs" or "runs"
    if not def[name] then def[name] = {} end
    local at = def[name][exits]
    if not at then
      at = { run = false }
      first[name][exits] = at
    end
    while def.connector do
      def = ways[def.connector]
      if not at[def] then at[def] = { run = false } end
      at = at[def]
    end
    return at.run or note_run(fsm, at, first, exits)
  end

  -- Takes the path that the machine has noted.
  local function take(fsm)
    local def, state = fsm._path, fsm._from
    if def.kind == "state" or fsm.dbg ~= silent or fsm._calls.begun > SEGMENT
      or state._actchild or state._mode == "inactive" then
      return core.take(fsm)
    end
    run_of(fsm, def, state)(fsm)
  end

  -- Choose: candidates per leaf and event ..........................................
  --
  -- leaf.choices[event] lists what an event may trigger while the leaf is active, in
  -- order. leaf.quick[event] is false if that is nothing, and { run, def, index } if it
  -- is one straight path.

  -- Returns a function that returns the first of the candidates that is enabled; false
  -- if that is too much for one function.
  local function make_search(candidates)
    local self = setmetatable({
      count = 0, seen = {}, connectors = {}, is_predicate = {},
      prepare = prepare_transition,
      text = new_text {
        "pcall", pcall, "refuse", core.refuse_guard, "matches", core.matches, "renew",
        renew, "warn_of_conflict", core.warn_of_conflict, "enabled_with",
        core.enabled_with, "rawget", rawget, "rawset", rawset,
      },
    }, Search)
    local text = self.text
    text:bind("connectors", self.connectors)
    text:write("return function(fsm, events)\n"
      .. "local transitions, nodes, ways = fsm._transitions, fsm._nodes, fsm._ways")
    local head = #text.lines
    for i = 1, #candidates do
      self.is_predicate[candidates[i]] = has_predicate(candidates[i])
      self:transition(candidates[i], 0)
      if self.is_too_much or #text.values > MAX_VALUES then return false end
    end
    for i = 1, #self.connectors do
      text:bind("C" .. i, self.connectors[i])
      head = head + 1
      insert(text.lines, head, ("ways[C%d] = nil"):format(i))
    end
    text:write("end")
    return text:compile(loadstring, "search")
  end

  -- Returns the first candidate that is enabled.
  local function find_listed(fsm, events, candidates)
    fsm._ways = {}
    for i = 1, #candidates do
      local def = candidates[i]
      local found = (not has_predicate(def) or core.matches(def, events))
        and core.enabled(fsm, def, events, 0)
      if found then return found end
    end
  end

  local function list_candidates(leaf, event)
    local candidates, line = { search = false }, core.line_to(leaf)
    for i = 1, #line do
      for _, def in ipairs(line[i].otrs) do
        if is_candidate(def, event) then
          candidates[#candidates + 1] = prepare_transition(def)
        end
      end
    end
    return candidates
  end

  -- Notes the straight path of the only candidate.
  local function note_quick(leaf, event, candidates)
    local def = candidates[1]
    if not def then
      leaf.quick[event] = false
    elseif not (candidates[2] or has_predicate(def) or def.is_internal) then
      local path = straight_path(def)
      local run = path and make_run(path, leaf.depth - def.lca.depth, false, true)
      if run then
        leaf.quick[event] = {
          run = run, def = def, index = def.index, hooked = nil, path = path,
        }
      end
    end
  end

  -- Returns the function that takes a path in a machine with hooks of states.
  local function hooked_run(quick, leaf)
    if quick.hooked == nil then
      quick.hooked = make_run(quick.path, leaf.depth - quick.def.lca.depth, true, true)
        or take_plainly
    end
    return quick.hooked
  end

  local function note_choice(leaf, event)
    local candidates = list_candidates(leaf, event)
    leaf.choices[event] = candidates
    if candidates[1] then candidates.search = make_search(candidates) end
    note_quick(leaf, event, candidates)
    return candidates
  end

  -- What a run reads of a leaf. `ignored` is its e_done if that leads nowhere, as it
  -- mostly does; NaN is no event.
  local function prepare_leaf(leaf)
    leaf.choices, leaf.quick = {}, {}
    local leads_somewhere = note_choice(leaf, leaf.done_event)[1] ~= nil
    leaf.ignored = leads_somewhere and 0 / 0 or leaf.done_event
    note_choice(leaf, OTHER)
  end

  local function choice_of(fsm, leaf, event)
    if not leaf.choices then prepare_leaf(leaf) end
    local choice = leaf.choices[event]
    if choice then return choice end
    if not fsm._plan.events[event] then return leaf.choices[OTHER] end
    return note_choice(leaf, event)
  end

  -- Returns the candidates of all events, nil if there are several lists of them.
  local function common_choice(fsm, leaf, events)
    local common = NONE
    for i = 1, #events do
      local candidates = choice_of(fsm, leaf, events[i])
      if candidates[1] and candidates ~= common then
        if common ~= NONE then return nil end
        common = candidates
      end
    end
    return common
  end

  local function choose(fsm, events)
    if events[1] == nil then return nil end
    if fsm.dbg ~= silent then return core.choose(fsm, events) end
    local plan = fsm._plan
    local candidates = common_choice(fsm, fsm._act_leaf["_%def"], events)
    if not candidates then return core.choose(fsm, events) end
    if not candidates[1] then return nil end
    local def = (candidates.search or find_listed)(fsm, events, candidates)
    if fsm._plan ~= plan then return choose(fsm, events) end
    return def
  end

  -- Iterate ........................................................................

  local resume_coroutine = coroutine and coroutine.resume
  local status, DOO = coroutine and coroutine.status, "doo"

  local has_arguments = xpcall(function(x) error(x) end, type, 1) == false
    and select(2, xpcall(function(x) error(x, 0) end, type, 1)) == "number"

  -- Calls f(fsm) in protected mode. Lua 5.1 passes no arguments.
  local function protect_51(f, fsm)
    fsm._run = f
    return xpcall(fsm._act, handler)
  end

  local function protect(f, fsm) return xpcall(f, handler, fsm) end

  if not has_arguments then protect = protect_51 end

  -- Resumes a doo that has been started before. `note_cycle` reads the locals; `DOO` is
  -- read where `ok` will be, which is therefore a boolean only after the call.
  local function cycle(fsm)
    local leaf = fsm._from
    local co = leaf._doo_co
    fsm._phase = DOO
    local ok, idle = resume_coroutine(co, fsm, leaf, "doo")
    if ok and status(co) ~= "dead" then return idle and "idle" or "counted" end
    local calls = fsm._calls
    calls.ok, calls.result, calls.more, calls.noted = true, ok, idle, FIRST.doo + 1
    calls.begun = FIRST.doo + 1
    return nil
  end

  -- A doo cycle, or none if the doo is over.
  local function iterate_quietly(fsm, leaf, events)
    if events[1] ~= nil then events[1] = nil end
    local co = leaf._doo_co
    if leaf._mode == "done" and not co then return true, true end
    fsm._from = leaf
    fsm._calls.begun = 0
    if not co then
      fsm._phase = "doo"
      return plain(fsm, false)
    end
    local ok, outcome = protect(cycle, fsm)
    if not ok then error(outcome, 0) end
    if outcome and not (fsm._reset_wanted or fsm._failure) then
      fsm._phase = "idle"
      return true, outcome == "idle" and fsm._intq[1] == nil and fsm._act_leaf ~= false
    elseif outcome then
      fsm._outcome = outcome
      fsm._phase = "after"
    end
    return plain(fsm, false)
  end

  -- The events are the current ones. Where it is not that simple the core goes on.
  local function iterate_choosing(fsm, after_free, leaf, candidates)
    local plan, search = fsm._plan, candidates and candidates.search
    fsm._calls.begun, fsm._after_free = 0, after_free
    fsm._phase = "search"
    if not search then return plain(fsm, after_free) end
    local def = search(fsm, fsm._curq, candidates)
    if fsm._plan ~= plan then return plain(fsm, after_free) end
    core.decide(fsm, leaf, def)
    if fsm._phase == "take" and fsm.dbg == silent and rawequal(fsm._from, leaf) then
      local ok, result = protect(run_of(fsm, def, leaf), fsm)
      if not ok and result ~= GO_ON then error(result, 0) end
      if not ok then return plain(fsm, after_free) end
      fsm._outcome = "counted"
      fsm._phase = "after"
    end
    if fsm._phase ~= "after" or fsm._reset_wanted or fsm._failure then
      return plain(fsm, after_free)
    end
    fsm._curq = {}
    fsm._phase = "idle"
    return fsm._outcome == "counted", false
  end

  -- Goes on where a path was not just taken: a search is needed, a callback or the
  -- engine failed, or there is more to do at the end.
  local function iterate_rest(fsm, after_free, ok, result)
    if not ok and result ~= GO_ON then error(result, 0) end
    if ok and result == SEARCH then
      local leaf, event = fsm._from, fsm._curq[1]
      local leaf_def = leaf["_%def"]
      if event == leaf_def.ignored then event = fsm._curq[2] end
      return iterate_choosing(fsm, after_free, leaf, leaf_def.choices[event])
    end
    if ok then
      fsm._outcome = "counted"
      fsm._phase = "after"
    end
    return plain(fsm, after_free)
  end

  -- The phases of an iteration in a machine with getevents or step hooks.
  local function go_through(fsm)
    local calls = fsm._calls
    if fsm._phase ~= "collect" then return core.go_on(fsm) end -- it was cut short
    calls.count = 0
    core.collect(fsm)
    if fsm._joined or fsm.pre_step_hook or fsm._pre_hooks ~= OWN_ONLY then
      calls.count = FIRST.before
      core.before(fsm)
    else
      fsm._phase = "search"
    end
    local leaf, events = fsm._act_leaf, fsm._curq
    local leaf_def, event, next_event = leaf and leaf["_%def"], events[1], events[2]
    local quick = leaf and leaf_def.quick
    if not quick then return core.go_on(fsm) end
    if event == leaf_def.ignored then event, next_event = next_event, events[3] end
    local path = next_event == nil and quick[event]
    if not path or fsm.dbg ~= silent then return core.go_on(fsm) end
    fsm._path = path.def
    fsm._from = leaf
    local run = fsm._is_hooked and hooked_run(path, leaf_def) or path.run
    if run(fsm) == SEARCH then return core.go_on(fsm) end
    fsm._outcome = "counted"
    fsm._phase = "after"
    calls.count = FIRST.after
    core.after(fsm)
  end

  local function iterate_hooked(fsm, after_free)
    local calls = fsm._calls
    calls.begun, calls.noted, fsm._after_free = 0, 0, after_free
    fsm._phase = "collect"
    return plain(fsm, after_free, go_through)
  end

  -- One iteration. What is written out is one event, apart from an e_done that nothing
  -- waits for, and nobody who traces or has hung in hooks.
  local function iterate(fsm, after_free) -- luacheck: ignore 561 (as it is, for speed)
    local leaf, spare = fsm._act_leaf, fsm._curq
    if fsm.getevents ~= no_events or fsm.pre_step_hook or fsm.post_step_hook
      or fsm._has_step_hooks then
      return iterate_hooked(fsm, after_free)
    elseif not leaf or fsm.dbg ~= silent or fsm._reset_wanted or spare[1] ~= nil then
      return plain(fsm, after_free)
    end
    local events, leaf_def = fsm._intq, leaf["_%def"]
    local event, next_event = events[1], events[2]
    local quick = leaf_def.quick
    if not quick then
      prepare_leaf(leaf_def)
      quick = leaf_def.quick
    end
    if event == leaf_def.ignored then event, next_event = next_event, events[3] end
    if next_event ~= nil then
      return plain(fsm, after_free)
    elseif event == nil then
      return iterate_quietly(fsm, leaf, events)
    end
    local path = quick[event]
    if not path then
      if path == nil and not fsm._plan.events[event] then path = quick[OTHER] end
      if path == false and not after_free then -- nothing waits for it
        events[2] = nil
        events[1] = nil
        return false, false
      end
      fsm._curq = events
      fsm._intq = spare
      return iterate_choosing(fsm, after_free, leaf, leaf_def.choices[event])
    end
    fsm._curq = events
    fsm._intq = spare
    fsm._path = path.def
    fsm._from = leaf
    local run = fsm._is_hooked and hooked_run(path, leaf_def) or path.run
    local ok, result
    if has_arguments then
      ok, result = xpcall(run, handler, fsm)
    else
      fsm._run = run
      ok, result = xpcall(fsm._act, handler)
    end
    if result ~= nil or not ok or fsm._reset_wanted or fsm._failure then
      if result ~= LENT or not ok or fsm._reset_wanted or fsm._failure then
        return iterate_rest(fsm, after_free, ok, result)
      end
      fsm._curq = {}
    else
      events[2] = nil
      events[1] = nil
    end
    fsm._phase = "idle"
    return true, false
  end

  -- What the core asks for .........................................................

  local getinfo, getlocal = debug and debug.getinfo, debug and debug.getlocal

  -- `cycle` was cut short. Has it resumed the doo? Then the results are noted.
  local function note_cycle(level)
    local values = {}
    for i = 1, 5 do
      local _, value = getlocal(level + 1, i)
      values[i] = value
    end
    local fsm, ok = values[1], values[4]
    local calls = fsm._calls
    if fsm._phase ~= "doo" or type(ok) ~= "boolean" then return false end
    calls.ok, calls.result, calls.more, calls.noted = true, ok, values[5], FIRST.doo + 1
    calls.begun = FIRST.doo + 1
    return false
  end

  -- An error comes from a function that takes a segment, or from a callback that it has
  -- called. The latter is noted as the result of the call; returns true then.
  local function note_failure(f, level, failure)
    if f == cycle then return note_cycle(level) end
    local call_lines = call_lines_of[f]
    if not call_lines or not call_lines[getinfo(level, "l").currentline] then
      return false
    end
    local _, fsm = getlocal(level, FSM)
    local _, callback = getlocal(level, CALLBACK)
    local is_called = getlocal(level, NEXT) == nil
    local calls = fsm._calls
    if not is_called and core.is_callable(callback) then
      calls.begun = calls.begun - 1
      return false
    end
    calls.ok, calls.result, calls.noted = false, failure, calls.begun
    return true
  end

  local function is_taking(f, level, fsm)
    if not (call_lines_of[f] or f == cycle or f == iterate_choosing) then
      return false
    end
    local _, value = getlocal(level, FSM)
    return rawequal(value, fsm)
  end

  -- Compiles what would be compiled while machines of a plan run.
  local function prepare(plan)
    for _, leaf in ipairs(plan.nodes) do
      if leaf.is_leaf then
        if not leaf.choices then prepare_leaf(leaf) end
        for event in pairs(plan.events) do -- any order: each stands alone
          if not leaf.choices[event] then note_choice(leaf, event) end
        end
      end
    end
    for _, def in ipairs(plan.transitions) do
      if def.src.kind == "connector" then
        for _, is_hooked in ipairs { false, true } do
          run_of(def, def.src.parent.depth - def.lca.depth, is_hooked)
        end
      end
    end
  end

  engine.choose, engine.iterate, engine.take = choose, iterate, take
  engine.prepare, engine.note_failure, engine.is_taking = prepare, note_failure,
    is_taking
end
