--- Fast: paths and searches as generated functions without loops.
--
-- The core also runs without this file: then `perform` does the actions in the list of
-- a path one by one. Here the list becomes one function, which also notes positions, so
-- that the core can go on behind each callback if the path is cut short, or if a
-- callback switches dbg on. Actions that only trace are left out. The candidates of a
-- search become one function, too.
--
-- The text of a function depends on a shape: how many states are left and entered, and
-- where connectors are. It names no element, so it is compiled once for all such paths.
--
-- @module rfsm.fast
-- @license BSD-3-Clause

local ipairs, pairs = ipairs, pairs
local concat = table.concat
local jit, unpack = rawget(_G, "jit"), rawget(table, "unpack") or rawget(_G, "unpack")
local MAX_VALUES = 50 -- most values of a function; Lua 5.1 allows 60 upvalues

-- Returns an empty text. Its function gets `values` in the parameters `names`.
local function new_text() return { lines = {}, names = {}, values = {} } end

local function bind(text, name, value)
  text.names[#text.names + 1] = name
  text.values[#text.names] = value
end

-- LuaJIT looks for a metamethod if a field is absent. It compiles `rawget` and `rawset`
-- to instructions, so these replace accesses to fields that may be absent.
local function for_jit(line)
  if not jit then return line end
  line = line:gsub("= (s[01])%.(e%w+)$", '= rawget(%1, "%2")')
  line = line:gsub("tr%.([eg]%w+)", 'rawget(tr, "%1")')
  line = line:gsub("(s[01])%.(_?doo[_co]*) then", 'rawget(%1, "%2") then')
  return (line:gsub("^([sf]%w+)%.(_[%w_]+) = (.+)$", 'rawset(%1, "%2", %3)'))
end

-- Appends the lines of a block. `places` has the texts that replace the block's $words.
local function add(text, block, places)
  for line in block:gmatch("[^\n]+") do
    local filled = line:gsub("$(%l+)", places):gsub("$(%l+)", places) -- nested $words
    if filled ~= "" then text.lines[#text.lines + 1] = for_jit(filled) end
  end
end

-- Paths -------------------------------------------------------------------------------
--
-- $a is the state that the path has come to, $b the next state, $at the position of the
-- action, $k the number of the segment. CHECK fails if a guard or target has changed.

local HEAD = [[
return function(fsm, is_chosen)
local nodes, s0, s1, f, tr = fsm._nodes, fsm._act_leaf, nil, nil, $tr
if not is_chosen then]]
local CHECK = [[
$fetch
if tr.guard or nodes[t$k] ~= tr.tgt then return false end]]
local BEGIN = [[
end
fsm._path = path
fsm._at = 0
fsm._phase = "take"]]
local CALL = [[
if f then
fsm._at = $at
local ok, e = pcall(f, fsm, $args)
if not ok then failed(fsm, "$what", $owner, f, e) end
if fsm.dbg ~= silent then return perform(fsm) end
end]]
local HOOKS = [[
if fsm.$hooks and fsm.$hooks[$owner] then
call_hooks(fsm, fsm.$hooks[$owner], $owner, $at)
if fsm.dbg ~= silent then return perform(fsm) end
end]]
local SHOW = [[
if fsm._path_hooks then
show_path(fsm, path, $at)
if fsm.dbg ~= silent then return perform(fsm) end
end]]
local LEAVE = [[
$b = $a._parent
$a._mode = "inactive"
$b._actchild = nil
f = $a.exit
]]
local LEAVE_LEAF = [[
fsm._act_leaf = false
if $a._doo_co then $a._doo_co = nil end]]
local EFFECT = [[
$fetch
f = tr.effect
if f and not borrowers[f] then fsm._is_lent = true end
]]
local ACTIVE = [[
$b = nodes[i$i]
$b._mode = "active"
$link]]
local LEAF = [[
fsm._act_leaf = $b
if not $b.doo then
f = fsm._intq
f[#f + 1] = done_event
$b._mode = "done"
end]]

-- The root has a metatable, which `rawset` does not ask about the absent field.
local LINK, LINK_TO_ROOT = "$a._actchild = $b", 'rawset($a, "_actchild", $b)'

-- Appends a block. `text.at` counts states left or entered; they alternate in s0, s1.
local function write(text, block, more)
  local places = text.places
  places.a, places.b = "s" .. text.at % 2, "s" .. (text.at + 1) % 2
  for key, value in pairs(more or {}) do places[key] = value end -- any order: a set
  add(text, block, places)
end

local function write_hooks(text, field, owner)
  if text.is_hooked then write(text, HOOKS, { hooks = field, owner = owner }) end
end

-- Returns, for each action of the core, the function that writes its text.
local function new_writers(core)
  return {
    [core.show_path] = function(text) write(text, text.is_hooked and SHOW or "") end,
    [core.leave] = function(text)
      write(text, LEAVE .. CALL, { what = "exit", owner = "$a", args = '$a, "exit"' })
    end,
    [core.run_exit_hooks] = function(text) write_hooks(text, "_exit_hooks", "$a") end,
    [core.be_left] = function(text, state)
      if state.is_leaf then write(text, LEAVE_LEAF) end
      text.at = text.at + 1
    end,
    [core.run_effect] = function(text)
      write(text, EFFECT .. CALL, { what = "effect", owner = "tr",
        args = 'tr, "effect", fsm._curq' })
      text.places.k = text.places.k + 1
    end,
    [core.become_active] = function(text, state)
      local i = #text.names
      bind(text, "i" .. i, state.index)
      write(text, ACTIVE, { i = i, link = state.depth == 1 and LINK_TO_ROOT or LINK })
      write_hooks(text, "_entry_hooks", "$b")
    end,
    [core.enter] = function(text, state)
      write(text, "f = $b.entry\n" .. CALL,
        { what = "entry", owner = "$b", args = '$b, "entry"' })
      if state.is_leaf then
        bind(text, "done_event", state.done_event)
        write(text, LEAF)
      end
      text.at = text.at + 1
    end,
  }
end

-- Returns the text of a path's function; nil or false if the core has to perform it.
local function write_path(writers, path, is_hooked)
  local text = new_text()
  local fetch = path.segments[2] and "tr = fsm._transitions[x$k]" -- else HEAD does it
  text.places = { fetch = fetch or "", tr = fetch and "nil" or "fsm._transitions[x1]" }
  text.is_hooked, text.at = is_hooked, 0
  bind(text, "path", path)
  write(text, HEAD)
  for k, def in ipairs(path.segments) do
    bind(text, "x" .. k, def.index)
    bind(text, "t" .. k, def.tgt.index)
    write(text, CHECK, { k = k })
  end
  write(text, BEGIN)
  text.places.k = 1
  for at, action in ipairs(path.actions) do
    text.places.at = at
    if writers[action] then writers[action](text, path.args[at]) end
    if #text.names > MAX_VALUES then return nil end
  end
  write(text, "return true\nend")
  return not path.entered and text
end

-- Searches ----------------------------------------------------------------------------
--
-- Level 0 asks the candidates one by one. Each further level asks the ways out of a
-- connector. On level $k, w$k is the way found, x$k is the list of ways in conflict.

local FIND = [[
return function(fsm, list, events)
local transitions, nodes, ways = fsm._transitions, fsm._nodes, fsm._ways
local plan, number, tr, def, note = fsm._plan, fsm._search, nil, nil, nil]]
local ASK = [[
def = nil
if $may then
tr = transitions[i$n]
local guard, ok, answer = tr.guard, true, nil
if guard then
if not borrowers[guard] then fsm._is_lent = true end
ok, answer = pcall(guard, tr, events)
if not ok then answer = refuse_guard(fsm, tr, guard, answer) end
end
if answer ~= false then
def = d$n
if nodes[t$n] ~= tr.tgt then def = lead(fsm, retarget(fsm, def, tr.tgt), events)]]
local GO_ON = [[
else
note = ways[c$n] or note_of(fsm, c$n)
if note.search == number then
if not note.way then def = nil end
else
note.search, note.way = number, false
local w$k, x$k = nil, nil]]
local GO_BACK = [[
if x$k then warn_of_conflict(fsm, x$k) end
ways[c$n].way = w$k or false
def = w$k and d$n
end]]
local FOUND = [[
if def and w$k then
x$k = x$k or { w$k }
x$k[#x$k + 1] = def
end
w$k = w$k or def]]
local CHOSEN = [[
if def then return def end
if fsm._plan ~= plan then return nil end]]

-- Returns the condition for asking a connector's `way`; `first` is its first way out.
local function condition(way, first)
  local may = way.events and "matches(d$n, events)" or "true"
  if (way.pn or 0) == (first.pn or 0) then return may end
  return "(not w$k or (w$k.pn or 0) == (d$n.pn or 0)) and " .. may
end

-- Writes the lines that ask a transition on level `k`, and ways out of its connector.
-- If a connector is reached twice, the search is too long for one function.
local function write_ask(text, core, def, k, may)
  local n, connector = #text.names, core.compile_transition(def).connector
  local places = { n = n, k = k, may = may }
  text.is_too_much = text.is_too_much or text[connector] or n > MAX_VALUES
  if text.is_too_much then return end
  bind(text, "d" .. n, def)
  bind(text, "i" .. n, def.index)
  bind(text, "t" .. n, def.tgt.index)
  add(text, ASK, places)
  if connector then
    text[connector], places.k = true, k + 1
    bind(text, "c" .. n, connector)
    add(text, GO_ON, places)
    for _, way in ipairs(connector.otrs) do
      write_ask(text, core, way, k + 1, condition(way, connector.otrs[1]))
      add(text, FOUND, places)
    end
    add(text, GO_BACK, places)
  end
  add(text, "end\nend\nend", places)
end

-- Returns the text of a function that asks each candidate; false if it is too long.
local function write_find(core, list)
  local text = new_text()
  add(text, FIND, {})
  for _, def in ipairs(list) do
    write_ask(text, core, def, 0, def.is_asked and "matches(d$n, events)" or "true")
    add(text, CHOSEN, {})
  end
  add(text, "end", {})
  return not text.is_too_much and text
end

--- Return three functions that make functions: `run` of a path, `run_hooked` of a path
--- with hooks, `find` of a list of candidates. They return nil if a text is too long.
---@param core table functions of the core, by name
return function(core)
  local names, values = { "pcall", "rawget", "rawset" }, { pcall, rawget, rawset }
  for name, value in pairs(core) do -- any order: they are bound by name
    names[#names + 1], values[#names + 1] = name, value
  end
  local head = "local " .. concat(names, ", ") .. " = ...\n"
  local writers, makers = new_writers(core), setmetatable({}, { __mode = "v" })
  local maker_of = setmetatable({}, { __mode = "k" }) -- a function keeps its maker

  -- Returns the function of a text; nil if there is no text, or it does not compile.
  local function compile(text)
    if not text then return nil end
    local source = head .. ("return function(%s)\n%s\nend"):format(
      concat(text.names, ", "), concat(text.lines, "\n"))
    if not makers[source] then
      local ok, chunk = pcall(core.loadstring, source, "=rfsm text") -- it may raise
      if not (ok and chunk) then return nil end
      makers[source] = chunk(unpack(values, 1, #names))
    end
    local f = makers[source](unpack(text.values, 1, #text.names))
    maker_of[f] = makers[source]
    return f
  end

  return {
    run = function(path) return compile(write_path(writers, path, false)) end,
    run_hooked = function(path) return compile(write_path(writers, path, true)) end,
    find = function(list) return compile(write_find(core, list)) end,
  }
end
