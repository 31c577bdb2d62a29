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
-- once and bound to numbers of the plan; no name of a model is in it. Callbacks are
-- read where they are called. After each of them the text looks whether dbg has been
-- switched on: then the core goes on. An error is found on the stack: where there is no
-- `debug`, the core does without this file.
--
-- @module rfsm.fast
-- @license BSD-3-Clause

local error, ipairs, pairs, pcall, rawequal = error, ipairs, pairs, pcall, rawequal
local rawget, rawset, select, setmetatable = rawget, rawset, select, setmetatable
local type, xpcall = type, xpcall
local concat, insert = table.concat, table.insert
local coroutine = rawget(_G, "coroutine")
local jit = rawget(_G, "jit")
local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local debug = rawget(_G, "debug") or {}
local getinfo, getlocal = debug.getinfo, debug.getlocal

local NONE = {}

-- What `pcall` returns for an error that is nil: nil, but for Lua 5.5.
local NO_ERROR = select(2, pcall(error))

-- So many values are bound to one function: Lua 5.1 allows 60.
local MAX_VALUES = 50

-- So many connectors of a path are looked up without a loop.
local MAX_LOOKUPS = 8

-- So many segments are taken without a search.
local MAX_SEGMENTS = 5

-- So many paths through connectors are prepared for one transition.
local MAX_PATHS = 100

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

--- What texts of one kind have in common.
---@class rfsm.fast.Kit
---@field chunkname string
---@field loadstring fun(text: string, chunkname: string): function?
---@field names string[] of the values that all texts may use
---@field values any[]
---@field makers table<string, rfsm.fast.Maker> what texts were compiled to

--- Makes a kit; `values` has names and values in turn.
---@return rfsm.fast.Kit
local function new_kit(chunkname, loadstring, values)
  local kit = {
    chunkname = "=rfsm " .. chunkname, loadstring = loadstring, names = {}, values = {},
    makers = setmetatable({}, { __mode = "v" }),
  }
  for i = 1, #values, 2 do
    kit.names[#kit.names + 1] = values[i]
    kit.values[#kit.names] = values[i + 1]
  end
  return kit
end

--- What a text was compiled to.
---@class rfsm.fast.Maker
---@field make fun(...): function returns a function with these values bound to it
---@field call_lines table<integer, true> the lines in which it calls callbacks

--- A text that is being written.
---@class rfsm.fast.Text
---@field kit rfsm.fast.Kit
---@field names string[] of the values that are bound to it alone
---@field values any[]
---@field lines string[]
---@field call_lines table<integer, true> the lines in which a callback is called

local Text = {}
Text.__index = Text

local function new_text(kit)
  return setmetatable({
    kit = kit, names = {}, values = {}, lines = {}, call_lines = {},
  }, Text)
end

function Text:bind(name, value)
  self.names[#self.names + 1] = name
  self.values[#self.names] = value
end

-- Has it more values than a function may have?
function Text:is_full() return #self.kit.names + #self.names > MAX_VALUES end

-- Writes the lines of a block, in which $x stands for places.x. The lines that call a
-- callback begin with "callback(".
function Text:write(block, places)
  for raw in block:gmatch("[^\n]+") do
    local line = raw:gsub("^%s+", ""):gsub("$(%l+)", places or NONE)
    self.lines[#self.lines + 1] = for_jit(line)
    -- two lines come before the first
    if line:find("^callback%(") then self.call_lines[#self.lines + 2] = true end
  end
end

-- Functions that were compiled, and their makers, which are known as long as one of
-- their functions is in use.
---@type table<function, rfsm.fast.Maker>
local maker_of = setmetatable({}, { __mode = "k" })

-- Compiles a text to a function that gets the values by name. Texts with the same lines
-- are compiled once.
function Text:compile()
  local kit = self.kit
  local source = ("local %s = ...\nreturn function(%s)\n%s\nend"):format(
    concat(kit.names, ", "), concat(self.names, ", "), concat(self.lines, "\n"))
  local maker = kit.makers[source]
  if not maker then
    local chunk = kit.loadstring(source, kit.chunkname)
    maker = {
      make = chunk(unpack(kit.values, 1, #kit.names)), call_lines = self.call_lines,
    }
    kit.makers[source] = maker
  end
  local f = maker.make(unpack(self.values, 1, #self.names))
  maker_of[f] = maker
  return f
end

-- Take: a segment, and the unconditional ones behind it ------------------------------
--
-- The calls are numbered as in the core. The number is noted before each call, so that
-- the core can go on behind it, whatever happens. A function that takes a path returns
-- nil; LENT if a callback got the list of events and may keep it; SEARCH if nothing has
-- been done, since it has to be searched anew; REST if no path was taken, and the core
-- is to go on with the phase; QUIET if there is no event that anything waits for.

local LENT, SEARCH, REST, QUIET = 1, 2, 3, 4

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

-- The active child of the root stays a raw field, or its metatable were asked.
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
  if not borrowers[callback] then lent = LENT end
  end]]

local ENTER_HOOKED = [[
  $b = nodes[i$action]
  if fsm._entry_hooks and fsm._entry_hooks[$b] then
  calls.count = $action
  enter(fsm, $b, d$action)
  if fsm.dbg ~= silent then return resume(fsm) end
  else]]

local ENTER = [[
  $b = nodes[i$action]
  $b._mode = "active"
  $link
  callback = $b.entry
  if callback then
  calls.begun = $number
  callback(fsm, $b, "entry")
  if fsm.dbg ~= silent then return resume(fsm) end
  end]]

-- The root has a metatable, which would be asked about a field that is absent.
local LINK, LINK_TO_ROOT = "s%d._actchild = s%d", 'rawset(s%d, "_actchild", s%d)'

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
---@field number integer of the action
---@field ACTION integer how far apart the numbers of actions are, as in the core
---@field SEGMENT integer the same of segments
---@field at integer how many states have been left or entered: s0 and s1 in turn
---@field is_hooked boolean states may have hooks

local Path = {}
Path.__index = Path

-- The next action begins.
function Path:act() self.number = self.number + self.ACTION end

-- Writes a block for the action: $a is the state at which the path is, $b the next one.
function Path:write(block, k, link)
  local at = self.at % 2
  self.text:write(block, {
    a = "s" .. at, b = "s" .. (1 - at), k = k, link = link,
    action = ("%d"):format(self.number), number = ("%d"):format(self.number + 1),
  })
end

-- Binds a value under a name with the number `k`.
function Path:bind(name, k, value) self.text:bind(name .. k, value) end

-- Writes how the states are left, from one `exits` levels below what stays active.
function Path:leave(def, exits)
  local src = def.src
  for i = 1, exits do
    local is_leaf = i == 1 and src.kind == "state"
    self:act()
    if self.is_hooked then self:write(LEAVE_HOOKED) end
    self:write(LEAVE)
    if self.is_hooked then self:write("end") end
    if is_leaf then self:write(FORGET_LEAF) end
    if is_leaf and (src.doo or not src.is_leaf) then self:write(FORGET_DOO) end
    self.at = self.at + 1
  end
end

-- Writes how the states are entered, the outermost first.
function Path:enter(def)
  local entries = def.entries
  for i = 1, #entries do
    self:act()
    self:bind("i", ("%d"):format(self.number), entries[i].index)
    if self.is_hooked then
      self:bind("d", ("%d"):format(self.number), entries[i])
      self:write(ENTER_HOOKED)
    end
    local link = entries[i].depth == 1 and LINK_TO_ROOT or LINK
    self:write(ENTER, nil, link:format(self.at % 2, (self.at + 1) % 2))
    if i == #entries and not def.connector then self:write(COMPLETE) end
    if self.is_hooked then self:write("end") end
    self.at = self.at + 1
  end
end

-- Writes a segment. The actions are those of `take_segment` in the core.
function Path:segment(def, exits)
  local SEGMENT = self.SEGMENT
  self.number = self.number - self.number % SEGMENT + SEGMENT
  if not def.is_internal then self:act() end -- a record
  self:leave(def, exits)
  self:act() -- a record
  self:act()
  self:write(EFFECT)
  if not def.is_internal then self:act() end -- a record
  self:enter(def)
end

-- Writes whether each segment is still the one that was compiled, and has no guard.
function Path:check(path)
  for k, def in ipairs(path) do
    self:bind("tx", k, def.tgt.index)
    self:write(CHECK, "x" .. k)
    if k > 1 then
      self:bind("cx", k, path[k - 1].connector)
      self:bind("dx", k, def)
    end
  end
  for k = 2, #path do self:write(NOTE_WAY, "x" .. k) end
end

-- Search: one guard after the other ------------------------------------------------

local SEARCH_BEGIN = [[
  return function(fsm)
  fsm._phase = "search"
  local transitions, nodes, ways = fsm._transitions, fsm._nodes, fsm._ways
  local events, s0, lent = fsm._curq, fsm._from, nil]]

local SEARCH_END = [[
  if fsm._plan ~= plan then return SEARCH end
  return take_found(fsm, s0, nil, lent)
  end]]

local ASK = [[
  local tr = transitions[i$n]
  local guard, ok, answer = tr.guard, true, nil
  if guard then
  if not borrowers[guard] then lent = LENT end
  ok, answer = pcall(guard, tr, events)
  if not ok then refuse(fsm, tr, guard, answer) end
  end
  if ok and answer ~= false then
  local def, tgt = d$n, tr.tgt
  if nodes[t$n] ~= tgt then
  ways, lent = renew(fsm, connectors), LENT
  def = enabled_with(fsm, def, tgt, events, $level)
  else]]

-- A guard may have merged something, moved the machine or switched dbg on.
local TAKE_FOUND = [[
  if fsm._plan ~= plan then return SEARCH end
  if fsm._act_leaf ~= s0 or fsm.dbg ~= silent or def ~= d$n then
  return take_found(fsm, s0, def, lent)
  end
  fsm._path = def
  return r$n(fsm) or lent]]

local TAKE_WAY = [[
  if fsm._plan ~= plan then return SEARCH end
  return take_found(fsm, s0, def, lent)]]

local NOTE_FOUND = [[
  if w$level then
  x$level = x$level or { w$level }
  x$level[#x$level + 1] = def
  else
  w$level = def
  end]]

-- As in the core a connector counts as not enabled while it is being evaluated: a
-- transition may have got it as its target.
-- It may also have been evaluated already, through such a transition.
local EVALUATE = [[
  local w$level, x$level = ways[c$n], nil
  if w$level == nil then
  w$level = false
  ways[c$n] = false]]

local EVALUATED = [[
  if x$level then warn_of_conflict(fsm, c$n, x$level) end
  ways[c$n] = w$level
  end
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
  if level == 0 and not def.connector then text:bind("r" .. n, self.run_of(def)) end
  local found = def.connector and TAKE_WAY or TAKE_FOUND
  text:write(level == 0 and "do\n" .. found .. "\nend" or NOTE_FOUND, places)
  text:write("end\nend\nend")
end

-- Writes how the way out of a connector is found, in w<level>. One that is reached a
-- second time, which is to be evaluated once, is not for straight text.
function Search:connector(connector, level, n)
  local otrs, text, pn = connector.otrs, self.text, nil
  local places = { n = n, level = level }
  if self.seen[connector] or text:is_full() then
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
    self.compile_transition(otrs[i])
    self:transition(otrs[i], level)
  end
  text:write("end")
  text:write(EVALUATED, places)
end

-- What may be triggered --------------------------------------------------------------

local OTHER = {} -- stands for all events that the machine does not know

local function has_predicate(def)
  for i = 1, def.events and #def.events or 0 do
    if type(def.events[i]) == "function" then return true end
  end
  return false
end

-- How many states a transition leaves, from a state of that depth.
local function exits_of(def, depth)
  return def.is_internal and 0 or depth - def.lca.depth
end

-- Take: functions of paths -----------------------------------------------------------

-- Makes the function that compiles a path.
local function new_run_maker(core, take_plainly)
  local kit = new_kit("path", core.loadstring, {
    "silent", core.silent, "resume", take_plainly, "leave", core.leave,
    "enter", core.enter, "call", core.call, "LENT", LENT, "SEARCH", SEARCH,
    "rawget", rawget, "rawset", rawset, "borrowers", core.borrowers,
  })

  -- Returns the function that takes the segments of `path` from a state `exits` levels
  -- below what stays active; with a check if the path has not been searched. Nil if
  -- that is too much for one function.
  return function(path, exits, is_hooked, is_checked)
    local text = new_text(kit)
    local own = setmetatable({
      text = text, number = core.FIRST.take, at = 0, is_hooked = is_hooked,
      ACTION = core.ACTION, SEGMENT = core.SEGMENT,
    }, Path)
    text:bind("done_event", path[#path].tgt.done_event)
    text:write(BEGIN)
    for k, def in ipairs(path) do own:bind("ix", k, def.index) end
    if is_checked then own:check(path) end
    own:write(TAKE)
    for k, def in ipairs(path) do
      if k > 1 then exits = path[k - 1].connector.parent.depth - def.lca.depth end
      if path[2] or not is_checked then own:write(SEGMENT_BEGIN, "x" .. k) end
      own:segment(def, exits)
      if text:is_full() then return nil end
    end
    text:write("return lent\nend")
    return text:compile()
  end
end

-- Lists the segments of the path that a search has found: `ways` are those out of its
-- connectors.
local function path_of(def, ways)
  local path = { def }
  while def.connector do
    def = ways[def.connector]
    path[#path + 1] = def
  end
  return path
end

-- Makes the function that returns the function of a path. They are kept in a tree: by
-- the levels that are left, then by the transitions behind the first one. A machine
-- that was prepared compiles no more. Without a loop up to MAX_LOOKUPS connectors, for
-- LuaJIT.
local function new_run_lookup(core, make_run, take_plainly)
  local function note_run(first, ways, exits, is_hooked)
    local name, path = is_hooked and "hooked_runs" or "runs", path_of(first, ways)
    first[name] = first[name] or {}
    first[name][exits] = first[name][exits] or { run = false }
    local at = first[name][exits]
    for i = 2, #path do
      at[path[i]] = at[path[i]] or { run = false }
      at = at[path[i]]
    end
    at.run = at.run or make_run(path, exits, is_hooked, false) or take_plainly
    return at.run
  end

  local lookup = new_text(new_kit("lookup", core.loadstring, {
    "note_run", note_run, "take_plainly", take_plainly,
  }))
  lookup:write [[
    return function(first, ways, exits, is_hooked, is_prepared)
    local runs, connector, way = first.runs, first.connector, nil
    if is_hooked then runs = first.hooked_runs end
    local at = runs and runs[exits] ]]
  for _ = 1, MAX_LOOKUPS do
    lookup:write [[
      if at and connector then
      way = ways[connector]
      at, connector = at[way], way.connector]]
  end
  lookup:write(("end\n"):rep(MAX_LOOKUPS))
  lookup:write [[
    if at and not connector and at.run then return at.run end
    if is_prepared and not at then return take_plainly end
    return note_run(first, ways, exits, is_hooked)
    end]]
  return lookup:compile()
end

-- Calls f() for each path through `def`, at most `left` of them; `ways` has the ways
-- out of its connectors then. Returns how many are left.
local function each_path(core, def, ways, f, left)
  local connector = core.compile_transition(def).connector
  if left < 1 then return 0 end
  if not connector then
    f()
    return left - 1
  end
  for _, out in ipairs(ways[connector] == nil and connector.otrs or NONE) do
    ways[connector] = out
    left = each_path(core, out, ways, f, left)
    ways[connector] = nil
  end
  return left
end

-- Makes the part that takes paths; returns what the others use.
local function new_takes(core)
  local silent, FIRST = core.silent, core.FIRST

  -- In place of a function that is too large, or goes on where one was left.
  local function take_plainly(fsm)
    fsm._phase = "take"
    core.take(fsm)
    return LENT
  end

  local make_run = new_run_maker(core, take_plainly)
  local run_of = new_run_lookup(core, make_run, take_plainly)

  -- Takes the path that the machine has noted; returns what its function returns.
  local function take(fsm)
    local def, state = fsm._path, fsm._from
    if def.kind == "state" or fsm.dbg ~= silent or fsm._calls.begun > FIRST.take
      or state._actchild or state._mode == "inactive" then
      core.take(fsm)
      return LENT
    end
    local run = run_of(def, fsm._ways, exits_of(def, state["_%def"].depth),
      fsm._is_hooked, fsm._is_prepared)
    return run(fsm)
  end

  -- Compiles the paths through a transition from a leaf.
  local function prepare_paths(def, leaf, is_hooked)
    local ways = {}
    each_path(core, def, ways, function()
      run_of(def, ways, exits_of(def, leaf.depth), is_hooked)
    end, MAX_PATHS)
  end

  return {
    make_run = make_run, prepare_paths = prepare_paths, take = take,
    take_plainly = take_plainly,
  }
end

-- Choose: candidates and functions for each leaf and event ---------------------------
--
-- leaf.choices[event] lists what an event may trigger while the leaf is active, in
-- order. leaf.quick[event] is false if that is nothing; otherwise `run` searches and
-- takes the path. leaf.hooked has the same for machines with hooks.

-- Lists the transitions that each event may trigger while the leaf is active, in
-- order. OTHER stands for the events that none of them names.
local function list_choices(core, leaf)
  local choices, lists = { [OTHER] = {} }, {}
  lists[1] = choices[OTHER]
  local function add(list, def)
    if list[#list] ~= def then list[#list + 1] = def end
  end
  local function add_def(def)
    if not def.events or has_predicate(def) then
      for _, list in ipairs(lists) do add(list, def) end
      return
    end
    for _, event in ipairs(def.events) do
      if not choices[event] then
        choices[event] = core.append({}, choices[OTHER])
        lists[#lists + 1] = choices[event]
      end
      add(choices[event], def)
    end
  end
  for _, node in ipairs(core.line_to(leaf)) do
    for _, def in ipairs(node.otrs) do add_def(core.compile_transition(def)) end
  end
  return choices
end

-- Notes what a run reads of a leaf. `ignored`: the leaf's e_done if no transition
-- uses it, else NaN, which equals no event. It may be interrupted anywhere.
local function prepare_leaf(core, leaf)
  local choices = list_choices(core, leaf)
  local done = choices[leaf.done_event] or choices[OTHER]
  leaf.choices = choices
  leaf.ignored = done[1] and 0 / 0 or leaf.done_event
  leaf.hooked = {}
  leaf.quick = {} -- last: it is looked at first
end

-- Returns the candidates of an event.
local function choice_of(core, leaf, event)
  if not leaf.quick then prepare_leaf(core, leaf) end
  return leaf.choices[event] or leaf.choices[OTHER]
end

-- Lists the segments of a path that is taken whenever its first one is, if no guard or
-- other target has been set since: each connector has a single transition, without
-- events and guard. Nil if the path is another one, or too long.
local function straight_path(core, def)
  local path = { core.compile_transition(def) }
  while def.connector do
    local otrs = def.connector.otrs
    if #otrs ~= 1 or #path == MAX_SEGMENTS then return nil end
    def = otrs[1]
    if def.events or def.guard then return nil end
    path[#path + 1] = core.compile_transition(def)
  end
  return path
end

-- Makes the function that goes on behind a search, with what it has found in the leaf,
-- which may be nothing.
local function new_take_found(core, take)
  return function(fsm, leaf, def, lent)
    core.decide(fsm, leaf, def)
    if fsm._phase ~= "take" then return REST end
    fsm._calls.count = core.FIRST.take
    return take(fsm) or lent
  end
end

-- Makes the function that compiles a search.
local function new_search_maker(core, takes, take_found)
  local kit = new_kit("search", core.loadstring, {
    "pcall", pcall, "refuse", core.refuse_guard, "matches", core.matches,
    "renew", renew, "warn_of_conflict", core.warn_of_conflict,
    "enabled_with", core.enabled_with, "rawget", rawget, "rawset", rawset,
    "borrowers", core.borrowers, "LENT", LENT, "SEARCH", SEARCH,
    "take_found", take_found, "silent", core.silent,
  })

  -- Returns a function that takes the path of the first of the candidates that is
  -- enabled; nil if that is too much for one function.
  return function(plan, depth, candidates, is_hooked)
    local text = new_text(kit)
    local own = setmetatable({
      text = text, count = 0, seen = {}, connectors = {}, is_predicate = {},
      compile_transition = core.compile_transition,
      run_of = function(def)
        return takes.make_run({ def }, exits_of(def, depth), is_hooked, false)
          or takes.take_plainly
      end,
    }, Search)
    text:bind("plan", plan)
    text:bind("connectors", own.connectors)
    text:write(SEARCH_BEGIN)
    local head = #text.lines
    for _, def in ipairs(candidates) do
      own.is_predicate[def] = has_predicate(def)
      own:transition(def, 0)
      if own.is_too_much or text:is_full() then return nil end
    end
    for i, connector in ipairs(own.connectors) do
      text:bind("C" .. i, connector)
      insert(text.lines, head + i, ("ways[C%d] = nil"):format(i))
    end
    text:write(SEARCH_END)
    return text:compile()
  end
end

-- Makes the function that knows what an event leads to.
local function new_quick_of(core, make_run, make_search)
  -- In place of a function that is too large, or that was not prepared.
  local GIVEN_UP = { run = function() return SEARCH end, def = false }

  -- Makes the function for an event.
  local function make_quick(plan, leaf, event, is_hooked)
    local candidates = choice_of(core, leaf, event)
    local def = candidates[1]
    if not def then return false end
    local is_alone = not (candidates[2] or def.guard or has_predicate(def))
    local path = is_alone and straight_path(core, def)
    local run = path and make_run(path, exits_of(def, leaf.depth), is_hooked, true)
      or make_search(plan, leaf.depth, candidates, is_hooked)
    return run and { run = run, def = def } or GIVEN_UP
  end

  -- Returns what is known of that event; false if nothing waits for it.
  return function(fsm, leaf, event, is_hooked)
    if not leaf.quick then prepare_leaf(core, leaf) end
    local known = is_hooked and leaf.hooked or leaf.quick
    if not leaf.choices[event] then event = OTHER end
    local quick = known[event]
    if quick == nil then
      if fsm._is_prepared then return GIVEN_UP end
      quick = make_quick(fsm._plan, leaf, event, is_hooked)
      known[event] = quick
    end
    return quick
  end
end

-- Makes the function that searches for several events.
local function new_choose(core)
  -- Returns the candidates of all events, nil if there are several lists of them.
  local function common_choice(leaf, events)
    local common = NONE
    for i = 1, #events do
      local candidates = choice_of(core, leaf, events[i])
      if candidates[1] and candidates ~= common then
        if common ~= NONE then return nil end
        common = candidates
      end
    end
    return common
  end

  -- Returns the first candidate of the events that is enabled.
  local function choose(fsm, events)
    local plan = fsm._plan
    local common = common_choice(fsm._act_leaf["_%def"], events)
    if not common or fsm.dbg ~= core.silent then return core.choose(fsm, events) end
    if common == NONE then return nil end
    fsm._ways = {}
    for i = 1, #common do
      local def = common[i]
      local found = (not has_predicate(def) or core.matches(def, events))
        and core.enabled(fsm, def, events, 0)
      if fsm._plan ~= plan then return choose(fsm, events) end
      if found then return found end
    end
  end

  return choose
end

-- Makes the function that compiles what would be compiled while the machine runs. A
-- path that has not been foreseen is taken by the core then.
local function new_prepare(core, prepare_paths, quick_of)
  local function prepare_run(fsm, leaf)
    local is_hooked = fsm._is_hooked
    if not leaf.quick then prepare_leaf(core, leaf) end
    for event, candidates in pairs(leaf.choices) do -- any order: each stands alone
      quick_of(fsm, leaf, event, is_hooked)
      for _, def in ipairs(candidates) do prepare_paths(def, leaf, is_hooked) end
    end
  end

  core.interpret(prepare_run)

  return function(fsm)
    fsm._is_prepared = false
    for _, leaf in ipairs(fsm._plan.nodes) do
      if leaf.is_leaf then prepare_run(fsm, leaf) end
    end
    fsm._is_prepared = true
  end
end

-- Iterate ----------------------------------------------------------------------------

local resume_coroutine = coroutine and coroutine.resume
local status, DOO = coroutine and coroutine.status, "doo"

-- Calls f(fsm) in protected mode. Lua 5.1 passes no arguments.
local function protect_51(f, fsm, handler)
  fsm._run = f
  return xpcall(fsm._act, handler)
end

local function protect(f, fsm, handler) return xpcall(f, handler, fsm) end

if not xpcall(rawequal, type, 1, 1) then protect = protect_51 end

-- Calls the hooks of a list, the first with the number `count` + 1. A hook is the
-- eighth local, as in the function of a path.
local CALL_HOOKS = [[
  return function(fsm, hooks, slot, count)
  local calls, i, size, callback = fsm._calls, 1, #hooks, nil
  while i <= size do
  callback = hooks[i]
  if callback == OWN then callback = fsm[slot] end
  if callback then
  count = count + 1
  calls.begun = count
  callback(fsm, fsm._curq)
  end
  i = i + 1
  end
  end]]

local function clear(list)
  for i = #list, 1, -1 do list[i] = nil end
end

-- The events of the last iteration are used again for the next one, unless a callback
-- may have kept them.
local function end_iteration(fsm, is_lent)
  local events = fsm._curq
  if is_lent then
    fsm._curq = {}
  else
    if events[3] ~= nil then clear(events) end
    events[2] = nil
    events[1] = nil
  end
  fsm._phase = "idle"
end

-- Makes the functions of an iteration without events.
local function new_doo_cycle(core)
  local handler, plain, resumed = core.handler, core.iterate, core.FIRST.resume + 1
  local doos = {}

  -- Notes that the doo has been resumed, with these results.
  function doos.note_resumed(calls, ok, idle)
    calls.ok, calls.result, calls.more = true, ok, idle
    calls.begun, calls.noted = resumed, resumed
  end

  -- Resumes a doo that has been started before. `note_cycle` reads the locals; `DOO` is
  -- read where `ok` will be, which is therefore a boolean only after the call.
  function doos.cycle(fsm)
    local leaf = fsm._from
    local co = leaf._doo_co
    fsm._phase = DOO
    local ok, idle = resume_coroutine(co, fsm, leaf, "doo")
    if ok and status(co) ~= "dead" then
      fsm._outcome = idle and "idle" or "counted"
      fsm._phase = "after"
    else
      doos.note_resumed(fsm._calls, ok, idle)
    end
  end

  local cycle = doos.cycle

  -- A doo cycle, or none if the doo is over.
  function doos.iterate_quietly(fsm, leaf, events)
    if events[1] ~= nil then events[1] = nil end
    local co = leaf._doo_co
    if leaf._mode == "done" and not co then return true, true end
    fsm._from = leaf
    fsm._calls.begun = 0
    if not co then
      fsm._phase = "doo"
      return plain(fsm)
    end
    local ok, failure = protect(cycle, fsm, handler)
    if not ok then error(failure, 0) end
    if fsm._phase ~= "after" or not fsm._is_usual then return plain(fsm) end
    fsm._phase = "idle"
    return true, fsm._outcome == "idle" and fsm._intq[1] == nil
      and fsm._act_leaf ~= false
  end

  return doos
end

-- Makes the function for the phases "collect" and "before".
local function new_collect(core, call_hooks)
  local no_events, OWN_ONLY, FIRST = core.no_events, core.OWN_ONLY, core.FIRST
  local append, BEFORE = core.append, FIRST.before

  -- Joins the events of getevents to those of the iteration, in a list that is used
  -- again. `_spare` is a third one: no callback ever gets it.
  local function join_events(fsm, events, intq)
    fsm._calls.count = FIRST.collect
    local more, failure = core.ask_getevents(fsm, core.call)
    if not more then core.give_up(fsm, failure) end
    if #more == 0 then return end
    local list = fsm._spare
    if not list or list == events or list == intq then list = {} end
    clear(list)
    fsm._joined = append(append(list, events), more)
    fsm._spare = events
  end

  return function(fsm, pre)
    local intq, events = fsm._curq, fsm._intq
    fsm._phase = "collect"
    fsm._curq = events
    fsm._intq = intq
    if fsm.getevents ~= no_events then join_events(fsm, events, intq) end
    if fsm._joined then fsm._curq = fsm._joined end
    fsm._joined = false
    if not pre and fsm._pre_hooks == OWN_ONLY then return end
    fsm._phase = "before"
    call_hooks(fsm, fsm._pre_hooks, "pre_step_hook", BEFORE)
  end
end

-- Makes the function that takes the path that one event leads straight to, if there is
-- such. It returns what the function of the path returns, or what is to be done.
local function new_take_quick(core, quick_of)
  local silent = core.silent
  return function(fsm)
    local leaf, events = fsm._act_leaf, fsm._curq
    if not leaf or fsm.dbg ~= silent then return SEARCH end
    local leaf_def, event, next_event = leaf["_%def"], events[1], events[2]
    if event == leaf_def.ignored then event, next_event = next_event, events[3] end
    if event == nil then return QUIET end
    if next_event ~= nil then return SEARCH end
    local path = leaf_def.hooked and leaf_def.hooked[event]
    if path == nil then path = quick_of(fsm, leaf_def, event, true) end
    if not path then
      core.decide(fsm, leaf, nil)
      return REST
    end
    fsm._path = path.def
    fsm._from = leaf
    return path.run(fsm)
  end
end

-- Makes the function for the phases of an iteration in a machine with getevents or
-- hooks.
local function new_go_through(core, quick_of)
  local OWN_ONLY, AFTER, borrowers = core.OWN_ONLY, core.FIRST.after, core.borrowers
  local hooks = new_text(new_kit("hooks", core.loadstring, { "OWN", OWN_ONLY[1] }))
  hooks:write(CALL_HOOKS)
  local call_hooks = hooks:compile()
  local collect = new_collect(core, call_hooks)
  local take_quick = new_take_quick(core, quick_of)

  -- Does a hook of this iteration get the list of events, and may keep it?
  local function lends(fsm, pre, post)
    return fsm._lends_events or pre and not borrowers[pre]
      or post and not borrowers[post]
  end

  -- Does what is left after `take_quick`, up to the phase "after". Returns whether a
  -- callback may keep the events.
  local function take_rest(fsm, result)
    if result ~= REST then fsm._phase = "search" end
    if fsm._phase ~= "after" then core.go_on(fsm, "after") end
    return result ~= QUIET and LENT
  end

  -- The phase "after".
  local function finish(fsm, post)
    if fsm._joined or fsm._reset_wanted then
      fsm._calls.count = AFTER
      core.call_post_hooks(fsm)
    elseif post or fsm._post_hooks ~= OWN_ONLY then
      call_hooks(fsm, fsm._post_hooks, "post_step_hook", AFTER)
    end
  end

  -- Returns whether the iteration counts, and nothing else is left to be done.
  return function(fsm)
    local calls, pre = fsm._calls, fsm.pre_step_hook
    if fsm._phase ~= "begin" or fsm._curq[1] ~= nil then
      core.go_on(fsm)
      return false
    end
    calls.begun = 0
    calls.noted = 0
    collect(fsm, pre)
    local lent = take_quick(fsm)
    if lent == nil or lent == LENT then
      fsm._outcome = "counted"
      fsm._phase = "after"
    else
      lent = take_rest(fsm, lent)
      if fsm._phase == "idle" then return false end -- it could not be entered
    end
    local post = fsm.post_step_hook
    finish(fsm, post)
    end_iteration(fsm, lent or lends(fsm, pre, post))
    return fsm._outcome == "counted" and not (fsm._failure or fsm._reset_wanted)
  end
end

-- Makes the function for an iteration of a machine that has hooks or a getevents, is
-- being traced, entered or reset, or whose iteration was cut short.
local function new_iterate_unusual(core, go_through)
  local handler, plain, GO_ON = core.handler, core.iterate, core.GO_ON
  return function(fsm, after_free)
    fsm._is_usual = not fsm._is_hooked
    if not fsm._is_hooked or fsm._phase ~= "idle" or fsm._reset_wanted then
      return plain(fsm, after_free)
    end
    fsm._after_free = after_free
    fsm._phase = "begin"
    local ok, is_counted = protect(go_through, fsm, handler)
    if ok and is_counted then return true, false end
    if ok then return core.results_of(fsm, fsm._outcome) end
    if is_counted ~= GO_ON then error(is_counted, 0) end
    return plain(fsm, after_free)
  end
end

-- Makes the function that goes on where a path was not just taken: a search is needed,
-- a callback or the engine failed, or there is more to do at the end.
local function new_iterate_rest(core)
  local plain, GO_ON = core.iterate, core.GO_ON
  return function(fsm, ok, result)
    if not ok and result ~= GO_ON then error(result, 0) end
    if not ok then return plain(fsm) end
    if result ~= SEARCH and result ~= REST then
      fsm._outcome = "counted"
      fsm._phase = "after"
    end
    if fsm._phase ~= "after" or not fsm._is_usual then return plain(fsm) end
    end_iteration(fsm, true)
    return fsm._outcome == "counted", false
  end
end

-- Makes the function for one iteration. What is written out is one event, apart from an
-- e_done that nothing waits for, and nobody who traces or has hung in hooks.
local function new_iterate(core, quick_of, iterate_quietly, iterate_unusual)
  local handler, plain, silent = core.handler, core.iterate, core.silent
  local iterate_rest = new_iterate_rest(core)

  return function(fsm, after_free) -- luacheck: ignore 561 (so long for speed)
    local leaf = fsm._act_leaf
    if not (leaf and fsm._is_usual) or fsm.dbg ~= silent then
      return iterate_unusual(fsm, after_free)
    end
    local events, leaf_def = fsm._intq, leaf["_%def"]
    local event, next_event, quick = events[1], events[2], leaf_def.quick
    if event == leaf_def.ignored then event, next_event = next_event, events[3] end
    if event == nil then
      return iterate_quietly(fsm, leaf, events)
    elseif next_event ~= nil or after_free then
      return plain(fsm, after_free)
    end
    local path, spare = quick and quick[event], fsm._curq
    if path == nil then path = quick_of(fsm, leaf_def, event, false) end
    if not path then -- nothing waits for it
      events[2] = nil
      events[1] = nil
      return false, false
    end
    fsm._calls.begun = 0
    fsm._after_free = false
    fsm._phase = "begin"
    fsm._curq = events
    fsm._intq = spare
    fsm._path = path.def
    fsm._from = leaf
    local ok, result = protect(path.run, fsm, handler)
    if not (ok and fsm._is_usual) then
      return iterate_rest(fsm, ok, result)
    elseif result == nil then
      events[2] = nil
      events[1] = nil
    elseif result == LENT then
      fsm._curq = {}
    else
      return iterate_rest(fsm, ok, result)
    end
    fsm._phase = "idle"
    return true, false
  end
end

-- What the core asks for -------------------------------------------------------------

-- Makes the function that is told of an error while a function of this file ran.
local function new_note_failure(core, doos)
  -- `cycle` was cut short. Has it resumed the doo? Then the results are noted.
  local function note_cycle(level)
    local values = {}
    for i = 1, 5 do
      local _, value = getlocal(level, i)
      values[i] = value
    end
    if type(values[4]) == "boolean" then
      doos.note_resumed(values[1]._calls, values[4], values[5])
    end
  end

  -- An error comes from a function that takes a segment, or from a callback that it has
  -- called. The latter is noted as the result of the call; returns true then.
  return function(f, level, failure)
    if f == doos.cycle then note_cycle(level + 1) end
    local maker = maker_of[f]
    if not (maker and maker.call_lines[getinfo(level, "l").currentline]) then
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
    if failure == nil then failure = NO_ERROR end
    calls.ok, calls.result, calls.noted = false, failure, calls.begun
    return true
  end
end

-- Makes the function that knows the functions which take a path of a machine: those of
-- this file whose first parameter is the machine, and that may be what is left on the
-- stack, since generated text ends in tail calls.
local function new_is_taking(functions)
  return function(f, level, fsm)
    if not (maker_of[f] or functions[f]) then return false end
    local _, value = getlocal(level, FSM)
    return rawequal(value, fsm)
  end
end

--- Replace the functions of an engine.
---@param engine table the functions that are replaced
---@param core table the functions of the core
return function(engine, core)
  if not core.loadstring then return end -- no text can be compiled
  local takes, doos = new_takes(core), new_doo_cycle(core)
  local take_found = new_take_found(core, takes.take)
  local quick_of = new_quick_of(core, takes.make_run,
    new_search_maker(core, takes, take_found))
  local go_through = new_go_through(core, quick_of)
  engine.choose, engine.take = new_choose(core), takes.take
  engine.prepare = new_prepare(core, takes.prepare_paths, quick_of)
  engine.iterate = new_iterate(core, quick_of, doos.iterate_quietly,
    new_iterate_unusual(core, go_through))
  engine.note_failure = new_note_failure(core, doos)
  engine.is_taking = new_is_taking {
    [go_through] = true, [take_found] = true, [takes.take_plainly] = true,
  }
end
