--- Hints for messages: the field, name or event that was probably meant.
--
-- The core loads this file when it needs the first hint. Without the file, problems are
-- reported without hints, and some warnings are missing. Each function returns a text,
-- which is empty if there is no hint.
--
-- @module rfsm.advice
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local getmetatable, ipairs, pairs = getmetatable, ipairs, pairs
local rawequal, rawget, type = rawequal, rawget, type
local floor, min = math.floor, math.min
local concat, sort = table.concat, table.sort

local advice = {}

-- Returns how many letters must be inserted, dropped, replaced, or swapped with the
-- next one, to turn `a` into `b`.
local function edit_distance(a, b)
  local before, row = {}, {}
  for j = 0, #b do row[j] = j end
  for i = 1, #a do
    local last, first, second = row, a:byte(i - 1), a:byte(i)
    row = { [0] = i }
    for j = 1, #b do
      local cost = second == b:byte(j) and 0 or 1
      row[j] = min(last[j] + 1, row[j - 1] + 1, last[j - 1] + cost)
      local is_swapped = first == b:byte(j) and second == b:byte(j - 1)
      if is_swapped and before[j - 2] then row[j] = min(row[j], before[j - 2] + 1) end
    end
    before = last
  end
  return row[#b]
end

-- Fields ------------------------------------------------------------------------

local FIELDS = {
  state = { "entry", "exit", "doo" },
  root = {
    "entry", "exit", "doo", "getevents", "idle_hook", "pre_step_hook", "post_step_hook",
    "dbg", "info", "warn", "err",
  },
  transition = { "src", "tgt", "events", "guard", "effect", "pn" },
  connector = {},
}

-- Names of the fields in other libraries, in lower case and without underscores.
local ALIASES = {
  state = {
    enter = "entry", onentry = "entry", onenter = "entry", onexit = "exit",
    leave = "exit", onleave = "exit", ["do"] = "doo", during = "doo", activity = "doo",
    doactivity = "doo", prehook = "pre_step_hook", posthook = "post_step_hook",
  },
  transition = {
    source = "src", from = "src", target = "tgt", to = "tgt", dst = "tgt", dest = "tgt",
    on = "events", trigger = "events", triggers = "events", condition = "guard",
    cond = "guard", when = "guard", action = "effect", actions = "effect",
    priority = "pn", prio = "pn",
  },
  connector = {},
}
ALIASES.root = ALIASES.state

local function plain(word) return (word:lower():gsub("_", "")) end

--- Are two words the same but for case and underscores, for one letter too many or too
--- few, or for two letters in reverse? A replaced letter makes a different word, as in
--- exit and edit.
function advice.is_near(a, b)
  a, b = plain(a), plain(b)
  if #a ~= #b then return edit_distance(a, b) == 1 end
  for i = 1, #a - 1 do
    local first, second = a:sub(i, i), a:sub(i + 1, i + 1)
    if a:sub(1, i - 1) .. second .. first .. a:sub(i + 2) == b then return true end
  end
  return a == b
end

--- Return the field that was probably meant; "" if there is none, or `key` is right.
---@param key string the key in the model
function advice.field_meant(kind, key)
  for _, field in ipairs(FIELDS[kind]) do
    local is_alias = ALIASES[kind][plain(key)] == field
    if key == field then return "" end
    if is_alias or advice.is_near(key, field) then return field end
  end
  return ""
end

--- Return the hint that the model has another word for a field that is missing.
---@param model table a transition of a model
---@return string hint " (there is 'from', did you mean 'src'?)"
function advice.other_word(model, field)
  local words = {}
  for key in pairs(model) do -- any order: sorted below
    if type(key) == "string" and advice.field_meant("transition", key) == field then
      words[#words + 1] = key
    end
  end
  sort(words)
  if not words[1] then return "" end
  return (" (there is '%s', did you mean '%s'?)"):format(words[1], field)
end

--- Return the hint for a field `events` that is a table, but no list.
---@return string hint " ('guard' belongs beside events)"
function advice.list(events)
  for _, field in ipairs(FIELDS.transition) do
    if events[field] ~= nil then return " ('" .. field .. "' belongs beside events)" end
  end
  local word = events.e_after ~= nil and "e_after" or events.e_at ~= nil and "e_at"
  if not word then return "" end
  return (" (did you mean { '%s(%s)' }?)"):format(word, rfsm.text_of(events[word]))
end

-- Names -------------------------------------------------------------------------

local function find_nearest(name, names)
  local nearest, least = nil, min(#name, floor((#name + 1) / 3) + 1)
  for _, candidate in ipairs(names) do
    if type(candidate) == "string" then
      local distance = edit_distance(name:lower(), candidate:lower())
      if distance < least then nearest, least = candidate, distance end
    end
  end
  return nearest
end

--- Return the hint for a name that does not exist.
---@param names any[] the names that exist
---@return string hint " (did you mean 'on'?)", or all of them if they are few
function advice.nearest_name(name, names)
  -- `initial` is a right name also in a composite that has none yet
  local nearest = find_nearest(name, names)
    or name ~= "initial" and find_nearest(name, { "initial" })
  if nearest then return " (did you mean '" .. nearest .. "'?)" end
  if #names == 0 or #names > 6 then return "" end
  local verb = #names == 1 and "is" or "are"
  return " (there " .. verb .. " '" .. concat(names, "', '") .. "')"
end

-- Names of nodes in other libraries that rfsm does not have, and hints for them.
local NO_NODES = {
  final = " (an end is a state with final = true)",
  history = " (did you mean the field history = 'shallow' of the composite?)",
  any = " (for each of its states: a transition of the composite around them)",
}
NO_NODES["[*]"], NO_NODES["end"], NO_NODES.H = NO_NODES.final, NO_NODES.final,
  NO_NODES.history
NO_NODES["*"] = NO_NODES.any

-- Returns the first FQN that ends in a path. The path may have '/' in place of '.'.
local function find_elsewhere(path, all)
  local tail, found = "." .. path:gsub("[/\\]+", "."):gsub("^%.+", ""), {}
  for _, other in ipairs(all) do
    local fqn = other.depth > 0 and other.id ~= "initial" and other.fqn or ""
    if fqn:sub(-#tail) == tail then found[#found + 1] = fqn end
  end
  sort(found)
  return found[1]
end

--- Return the hint for a node that does not exist in a composite.
---@param def rfsm.Def the composite
---@param all rfsm.Def[] the nodes of the machine, one of which may be meant
---@param path string the path in the model, which contains `name`
---@return string hint " (did you mean 'root.on'?)"
function advice.nearest_node(name, def, all, path)
  local elsewhere, names = find_elsewhere(path, all), {}
  if elsewhere then return " (did you mean '" .. elsewhere .. "'?)" end
  if rawget(def.model, "substates") then
    return " (a region is a machine of its own: no transition leads into or out of it)"
  elseif NO_NODES[name] then
    return NO_NODES[name]
  end
  for member, other in pairs(def.members) do -- any order: sorted below
    local is_named = type(member) == "string" and other.kind ~= "transition"
    if is_named then names[#names + 1] = member end
  end
  sort(names)
  return advice.nearest_name(name, names)
end

--- Return the hint for a state that does not exist in a machine.
---@return string hint " (did you mean 'root.on'?)"
function advice.state_name(fsm, name)
  local names = {}
  for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
    names[#names + 1] = state._fqn
    if state._id == name then return " (did you mean '" .. state._fqn .. "'?)" end
  end
  return advice.nearest_name(name, names)
end

-- Names of functions in other libraries, and the functions of rfsm with this purpose.
local FUNCTIONS = {
  choice = "conn", junction = "conn", fork = "seqand", join = "seqand",
  parallel = "seqand", region = "seqand", orthogonal = "seqand", post = "send_events",
  send = "send_events", fire = "send_events", emit = "send_events", new = "init",
  create = "init", update = "step", tick = "step", start = "run",
  current_state = "get_actleaf_fqn", get_state = "get_actleaf_fqn",
}

local TO_STATES = { "goto", "set_state", "change_state", "transition_to", "enter" }

--- Return the hint for a function that the library does not have.
---@return string hint " (did you mean rfsm.send_events?)"
function advice.function_meant(name)
  for _, word in ipairs(TO_STATES) do
    if plain(name):find(plain(word), 1, true) == 1 then
      return " (a machine moves by its transitions: send an event)"
    end
  end
  local meant = FUNCTIONS[name] or find_nearest(name, rfsm.sorted_keys(rfsm))
  return meant and " (did you mean rfsm." .. meant .. "?)" or ""
end

-- Events ------------------------------------------------------------------------

-- The extensions that know events such as e_after(1), by the word in front of "(". The
-- list is needed because an extension that is not loaded cannot declare its events.
local MODULE_OF = {
  e_after = "rfsm_timeevent", e_at = "rfsm_timeevent", await = "rfsm_await",
}

--- Return the module that knows an event such as e_after(1); nil if there is none.
function advice.module_for(event)
  return type(event) == "string" and MODULE_OF[event:match("^[%w_]+%f[(]")] or nil
end

--- Return the hint for an event with a blank, comma or bar in its name.
---@return string hint " (did you mean 'e_after(2)'?)"
function advice.event_meant(event)
  local meant = event:match("^%s*(.-)%s*$")
  local word, rest = meant:match("^([%w_]+)%s+%(?(.-)%)?$")
  if MODULE_OF[word] then meant = word .. "(" .. rest .. ")" end
  local is_one = not meant:match("^[^(@]*"):find("[,|%s]")
  return is_one and (" (did you mean '%s'?)"):format(meant) or ""
end

--- Return the hint for an event that looks like a call: the module that knows it.
---@param word string the event up to its parenthesis
---@return string? hint " (require \"rfsm_timeevent\")"; nil if the module is loaded
function advice.module_of(word)
  local module = MODULE_OF[word]
  local loaded = (rawget(_G, "package") or {}).loaded or {}
  if module and loaded[module] then return nil end
  if module then return (" (require %q)"):format(module) end
  for _, known in ipairs(rfsm.sorted_keys(MODULE_OF)) do
    if advice.is_near(word, known) then
      return (" (did you mean '%s(...)'?)"):format(known)
    end
  end
  return ""
end

-- Mistakes: models that are valid, but probably not what was meant -----------------

-- Names of tables that other libraries have for states and transitions.
local LISTS = { states = true, substates = true, transitions = true, children = true }

-- Returns the warning about a plain table that was probably meant to be a state or a
-- transition.
local function unmarked(t, key)
  if rawget(t, "src") ~= nil and rawget(t, "tgt") ~= nil then
    return "a plain table that has 'src' and 'tgt' is ignored (did you mean "
      .. "rfsm.trans{...}?)"
  end
  for _, value in pairs(t) do -- any order: one element decides
    if rfsm.is_fsmobj(value) then
      return "a plain table that contains states or transitions is ignored ("
        .. (LISTS[key] and "they stand in the state itself)"
        or key == "regions" and "did you mean rfsm.seqand{...}?)"
        or "did you mean rfsm.state{...}?)")
    end
  end
  return ""
end

-- Returns the warning about a table in a state that names events and targets, such as
-- on = { e_go = "b" }, if the first target is a sibling of the state.
local function unwritten(def, key, value)
  local event = def.kind == "state" and def.parent ~= def
    and (key == "on" or key == "transitions") and rfsm.sorted_keys(value)[1]
  local tgt = event and value[event]
  if type(tgt) ~= "string" or not rfsm.is_node(def.parent.model[tgt]) then return "" end
  return ("a state has no field '%s' (beside it: rfsm.trans{ src = '%s', tgt = '%s', "
    .. "events = { '%s' } })"):format(key, def.id, tgt, rfsm.text_of(event))
end

local WAITS = { timeout = true, after = true, delay = true }

-- Returns the warning about a field that looks like the event of a transition without
-- `events`.
local function unnamed(def, key, value)
  local model = def.model
  if model.events or not (model.src and model.tgt) then return "" end
  if type(key) == "number" and type(value) == "string" then
    return ("'%s' stands beside the events, any event triggers it (events = { '%s' })")
      :format(value, value)
  elseif WAITS[key] and type(value) == "number" then
    return ("a transition has no field '%s', any event triggers it (events = { "
      .. "'e_after(%s)' })"):format(key, rfsm.text_of(value))
  end
  return ""
end

-- Returns the warning about a field whose name is a wrong word for a field of rfsm.
local function misspelt(def, key, value)
  if def.kind ~= "transition" and not rfsm.is_callable(value) then return "" end
  local meant = def.kind == "transition" and key == "event" and "events"
    or advice.field_meant(def.parent == def and "root" or def.kind, key)
  if meant == "" or def.model[meant] ~= nil then return "" end
  return ("a %s has no field '%s' (did you mean '%s'?)"):format(def.kind, key, meant)
end

local IS_CALLBACK = {
  entry = true, exit = true, doo = true, guard = true, effect = true,
}

-- Returns the warning about a constructor that is not called, or about a plain table
-- where a state, transition or connector was probably meant.
local function unmade(def, key, value)
  for _, name in ipairs({ "state", "trans", "conn" }) do
    if rawequal(value, rfsm[name]) then
      return ("rfsm.%s is not called (rfsm.%s{...})"):format(name, name)
    end
  end
  if type(value) ~= "table" or getmetatable(value) ~= nil then return "" end
  local text = unmarked(value, key)
  return text ~= "" and text or unwritten(def, key, value)
end

--- Return the warning about a field that is valid as user data, but was probably meant
-- as a field of rfsm or an element. Return the field's name, too, if messages show it.
---@param def rfsm.Def the element that has the field
---@return string text
---@return string? field
function advice.datum(def, key, value)
  local field, text = rfsm.text_of(key), unmade(def, key, value)
  if text ~= "" then
    return text, field
  elseif def.kind == "connector" and IS_CALLBACK[key] then
    return ("a connector has no %s, this one is ignored"):format(key), field
  elseif def.kind == "transition" and unnamed(def, key, value) ~= "" then
    return unnamed(def, key, value)
  elseif type(key) == "string" and not rfsm.is_meta(key) then
    return misspelt(def, key, value)
  end
  return ""
end

--- Return the hint that plain tables in a leaf were probably meant to be states.
---@param model rfsm.State a state with transitions and without states
---@return string hint " ('a', 'b' are plain: did you mean rfsm.state{...}?)"
function advice.plain_states(model)
  local is_plain, names = {}, {}
  for _, tr in pairs(model) do -- any order: sorted below
    for _, name in ipairs(rfsm.is_trans(tr) and { tr.src, tr.tgt } or {}) do
      local value = type(name) == "string" and rawget(model, name)
      is_plain[name] = type(value) == "table" and getmetatable(value) == nil or nil
    end
  end
  for name in pairs(is_plain) do names[#names + 1] = name end -- sorted below
  sort(names)
  if not names[1] then return "" end
  return (" ('%s' %s plain: did you mean rfsm.state{...}?)"):format(
    concat(names, "', '"), names[2] and "are" or "is")
end

--- Return the hint that a composite without `initial` was meant to have regions.
function advice.regions(model)
  local is_meant = model.parallel == true or model.type == "parallel"
  return is_meant and " (did you mean rfsm.seqand{...}?)" or ""
end

--- Return the warning of an `initial` all of whose transitions have events or a guard:
--- its composite cannot be entered while none of them is enabled.
function advice.initial(def)
  for _, tr in ipairs(def.otrs) do
    if not (tr.events or tr.guard) then return "" end
  end
  return ("each transition from here has events or a guard, '%s' cannot be entered "
    .. "while none of them is enabled"):format(def.parent.fqn)
end

--- Return the warning of an event such as e_after(1) that no loaded extension knows. A
--- loaded extension warns of its events itself.
function advice.event(_, event)
  local word = event:match("^([%w_]+)%(.*%)$")
  local hint = word and advice.module_of(word)
  if not hint then return "" end
  return ("no loaded extension knows '%s'%s"):format(event, hint), "events"
end

return advice
