--- The charts of a library. Each version of a chart has one machine, into which each
--- call puts the snapshot of a saved machine.
--
-- @module rfsm.server.charts
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local alphabet = require "rfsm.shared.alphabet"
local calls = require "rfsm.shared.calls"
local encoding = require "rfsm.snapshot.encoding"
local exact_json = require "rfsm.shared.exact_json"
local location = require "rfsm.shared.location"
local migrate = require "rfsm.snapshot.migrate"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"
local shape = require "rfsm.snapshot.shape"
local snapshot = require "rfsm.snapshot"

local getmetatable, ipairs = getmetatable, ipairs
local pcall, rawequal, rawget, rawset = pcall, rawequal, rawget, rawset
local setmetatable, type = setmetatable, type
local abs, concat = math.abs, table.concat
local copy_of, fail, is_meta, text_of = encoding.copy_of, encoding.fail, rfsm.is_meta,
  rfsm.text_of
local took_path = rfsm.took_path

local MAX_EVENT, MAX_NAMED = 256, 8192 -- bytes of an event: without data, with data

local charts = {}

-- The function by which the host decodes JSON.
local decode

-- Machines of charts ---------------------------------------------------------------

--- One version of a chart.
---@class rfsm.server.Chart
---@field name string
---@field make fun(): rfsm.State
---@field fsm rfsm.Machine|nil its machine, made at the first call
---@field blank rfsm.snapshot.Snapshot the snapshot of a new machine
---@field options rfsm.snapshot.Options for snapshots that are put into the machine
---@field fields rfsm.server.Field[] the first values of fields; each call restores them
---@field regions rfsm.Machine[] the regions of the machine
---@field events table<string, any> the events that transitions name, by their texts
---@field named table<string, true> names of events with data
---@field takes_all boolean any event may be sent, since a transition has no list of
--- events, or has a predicate for which no event name is known

local function note_events(chart, fsm)
  local known = alphabet.of_all(fsm)
  chart.events, chart.named, chart.takes_all = {}, {}, known.takes_any
  for _, list in ipairs { known.list, known.reactions } do
    for _, event in ipairs(list) do
      local text = text_of(event)
      if #text <= MAX_EVENT then chart.events[text] = event end
    end
  end
  for _, predicate in ipairs(known.predicates) do
    local name = rfsm.event_name(predicate)
    if name then chart.named[name] = true else chart.takes_all = true end
  end
end

-- `emitted`: what callbacks have emitted in this call, each as { name, data } (texts).
-- `printed`: the errors that the machine has printed in this call.
local emitted, printed = {}, {}

local function emit(what, data)
  emitted[#emitted + 1] = { what, data ~= nil and charts.json_of(data) or "" }
end

local function collect_print(...)
  printed[#printed + 1] = calls.text(" ", ...)
end

-- The machines that run saved machines, and their regions.
local is_shared = setmetatable({}, { __mode = "k" })

-- Hooks that an extension may add when a callback uses it for the first time.
local MAY_BE_LATE = { source_hook_add = true, reset_hook_add = true,
  reaction_hook_add = true, waiting_hook_add = true }

-- Replaces a function that changes a machine for good: for a shared machine it does
-- nothing, and the reason is reported.
local function refuse_for_shared(name)
  local own, where = rfsm[name], "rfsm." .. name
  local reason = where .. ": the machines of a fleet share their chart, so a callback "
    .. "cannot change it"
  rfsm[name] = function(fsm, ...)
    rfsm.check_machine(fsm, where)
    if not is_shared[fsm] then return own(fsm, ...) end
    rfsm.report(fsm, "err", reason)
    return false, reason
  end
end

refuse_for_shared "fsm_merge"
for _, name in ipairs(rfsm.sorted_keys(rfsm)) do
  local is_change = name:find("_hook_add$") or name:find("_hook_rm$")
  if is_change and not MAY_BE_LATE[name] then refuse_for_shared(name) end
end

-- The machine of a chart runs one saved machine after the other. A callback may change
-- fields that snapshots do not save. `clean` undoes such changes before each call. Its
-- cost follows the number of changes: an element below a root has a metatable of its
-- own, which has the first values of the fields, so that each assignment is noted. A
-- root has few fields, which are compared.

-- `changed` lists elements and their fields that were set, in turns.
local changed = {}

--- An element below a root.
---@class rfsm.server.Element
---@field others table<any, true> fields that are not noted: those that snapshots save
---@field first table what is read in place of absent fields: their first values
---@field plain table the first values that are plain tables, which are copied when read
---@field moved table<any, { value: any, place: table }> first values and where they are
---@field noted? integer[] of a transition: the list for changed targets
---@field number? integer the position of the transition for this list
local element_of = setmetatable({}, { __mode = "k" }) ---@type rfsm.server.Element[]

-- Sets a field of an element. Nil may be the new value, so the first one has to go.
local function set_field(obj, key, value)
  rawset(obj, key, value)
  local own = element_of[obj]
  if own.others[key] or is_meta(key) then return end
  local moved = own.moved[key]
  if moved then rawset(moved.place, key, nil) end
  if key == "tgt" and own.noted then
    own.noted[#own.noted + 1] = own.number
  else
    changed[#changed + 1], changed[#changed + 2] = obj, key
  end
end

-- Gives a field of an element its first value back.
local function reset_field(obj, key)
  local own = element_of[obj]
  local moved = own and own.moved[key]
  rawset(obj, key, nil)
  if moved then rawset(moved.place, key, moved.value) end
end

-- Returns what is read in place of absent fields of an element. Inherited are those of
-- its class.
local function first_values(obj, own, inherited)
  local first, plain = {}, own.plain
  for key, moved in order.each(own.moved) do -- any order: each stands alone
    moved.place = type(moved.value) == "table" and getmetatable(moved.value) == nil
      and plain or first
    moved.place[key] = moved.value
    rawset(obj, key, nil)
  end
  for _, name in ipairs(rfsm.is_trans(obj) and { "guard", "effect" } or {}) do
    if first[name] == nil then first[name] = inherited[name] end
  end
  if order.is_empty(plain) then return setmetatable(first, { __index = inherited }) end
  return setmetatable(first, { __index = function(_, key)
    if plain[key] == nil then return inherited[key] end
    obj[key] = copy_of(own.moved[key].value)
    return rawget(obj, key)
  end })
end

-- Gives an element a metatable of its own, to which the fields in `moved` go.
local function watch_element(obj, moved, others)
  local class = getmetatable(obj)
  local own = { others = others, plain = {}, moved = moved }
  element_of[obj] = own
  own.first = first_values(obj, own, class.__index)
  local watched = { __index = own.first, __newindex = set_field }
  for key, value in order.each(class) do -- any order: a copy
    if watched[key] == nil then watched[key] = value end
  end
  setmetatable(obj, watched)
end

-- Has the machine of a region, or the outermost one, note each target that is set, so
-- that a snapshot need not compare all of them.
local function watch_targets(fsm)
  local own = shape.of(fsm)
  own.noted = {}
  function own.forget(number)
    reset_field(own.transitions[number], "tgt")
  end
  for i, tr in ipairs(own.transitions) do
    local element = element_of[tr]
    element.noted, element.number = own.noted, i
    element.moved.tgt = { value = tr.tgt, place = element.first }
    element.first.tgt, element.others.tgt = tr.tgt, nil
    rawset(tr, "tgt", nil)
  end
end

-- `known_of` has for each root the set of the fields that it had at first.
local known_of = setmetatable({}, { __mode = "k" })

-- Changes the metatable of machines so that new fields of a root are put in `changed`.
local function watch_root(class)
  if rawget(class, "is_watched") then return end
  local set = class.__newindex or rawset
  class.is_watched = true
  function class.__newindex(obj, key, value)
    set(obj, key, value)
    local known = known_of[obj]
    if known and not (known[key] or is_meta(key)) then
      changed[#changed + 1], changed[#changed + 2] = obj, key
    end
  end
end

--- The first value of a field of an element. If the value is a plain table, a copy is
-- stored, since callbacks may change the table in the element.
---@class rfsm.server.Field
---@field obj table
---@field key any
---@field value any

-- Calls f(key, value) for each field of an element that snapshots do not save. Returns
-- the set of all others.
local function each_field(obj, f)
  local others, is_kept = { _actchild = true }, { keep = true }
  for _, name in ipairs(obj.keep or {}) do is_kept[name] = true end
  for key, value in order.each(obj) do -- any order: each stands alone
    if is_meta(key) or rfsm.is_fsmobj(value) or is_kept[key] then
      others[key] = true
    else
      f(key, value)
    end
  end
  for name in order.each(is_kept) do others[name] = true end -- any order: a set
  return others
end

-- Has the fields of an element compared in each call.
local function compare_fields(fields, obj)
  local names = {}
  known_of[obj] = each_field(obj, function(key, value)
    names[#names + 1] = key
    fields[#fields + 1] = { obj = obj, key = key, value = copy_of(value) }
  end)
  for _, name in ipairs(names) do known_of[obj][name] = true end
  watch_root(getmetatable(obj))
end

--- Are the fields of all elements compared in each call? The code that is written for
--- LuaJIT reads callbacks by `rawget`, so it is so there. Specs compare the two ways.
charts.compares = rawget(_G, "jit") ~= nil

-- Notes the fields of the elements of a machine.
local function note_fields(fields, fsm)
  for _, obj in ipairs(rfsm.elements(fsm)) do
    if charts.compares or rfsm.is_root(obj) then
      compare_fields(fields, obj)
    else
      local moved = {}
      local others = each_field(obj, function(key, value)
        moved[key] = { value = copy_of(value) }
      end)
      watch_element(obj, moved, others)
    end
  end
  if not charts.compares then watch_targets(fsm) end
end

-- Gives the fields of all elements their first values back. This runs in each call.
local function clean(chart)
  for i = #changed, 2, -2 do
    reset_field(changed[i - 1], changed[i])
    changed[i - 1], changed[i] = nil, nil
  end
  local fields = chart.fields
  for i = 1, #fields do
    local field = fields[i]
    local obj, key, value = field.obj, field.key, field.value
    if obj[key] ~= value then rawset(obj, key, copy_of(value)) end
  end
end

-- JSON ------------------------------------------------------------------------------

--- Return data as JSON. Keys that are numbers become texts, as do infinity and NaN.
function charts.json_of(data) return exact_json.encode(encoding.to_json(data)) end

local WORDS = { ["true"] = true, ["false"] = true, ["null"] = true }

-- Returns the number that a word of JSON is; nil if it is none.
local function number_of(word)
  local whole, rest = word:match("^%-?(%d+)(.*)$")
  if not whole or whole:find("^0%d") then return nil end
  rest = rest:gsub("^%.%d+", "")
  return (rest == "" or rest:find("^[eE][+-]?%d+$")) and rfsm.number_of(word) or nil
end

-- Returns the first word in a text that not each decoder of JSON reads the same, and
-- the number that it is: NaN, 0x10, 1e999, a whole number from 2^53 on, a zero byte.
local function find_odd(text)
  text = text:gsub("\\\\", "")
  if text:find("\\u0000", 1, true) then return "\\u0000" end
  for word in text:gsub("\\.", ""):gsub('"[^"]*"', " "):gmatch("[%w.+-]+") do
    local number = number_of(word)
    local is_exact = number and number - number == 0
      and (word:find("[.eE]") or abs(number) < 2 ^ 53)
    if not (is_exact or WORDS[word]) then return word, number end
  end
end

--- Decode a JSON object. It has what the host's decoder returns for null.
---@param owner string the name of the object in messages
---@param text string
---@param what? string what a message expects
function charts.decode_json(owner, text, what)
  local is_whole = text:find("}%s*$") -- some decoders raise what pcall does not catch
  local ok, data = pcall(decode, is_whole and text or "0")
  local odd, number = find_odd(text)
  if not ok or odd and not number or type(data) ~= "table" then
    fail("%s: %s expected%s", owner, what or "a JSON object",
      is_whole and odd and (", got '%s' in it"):format(odd) or "")
  elseif odd then
    fail("%s: the number %s: whole numbers below 2^53 expected", owner, odd)
  end
  return data
end

--- Decode a JSON object and return it as a table. Fields that are null are left out.
---@param owner string the name of the object in messages
---@param text string
---@param most integer the greatest length of `text` in bytes
---@param what? string what a message expects
function charts.read_json(owner, text, most, what)
  if #text > most then
    fail("%s: at most %d bytes expected, got %d", owner, most, #text)
  end
  local data = charts.decode_json(owner, text, what)
  local about = { owner = owner, base = 0, seen = {} }
  return encoding.unpack(encoding.pack(data, about, 0), 0)
end

--- Return the data in a snapshot as a JSON object, by the paths of states.
function charts.data_of(snap)
  local data = {}
  migrate.each_part(snap, function(part, prefix)
    for fqn, fields in order.each(part.data or {}) do -- any order: a copy
      data[prefix .. fqn:sub(5)] = encoding.unpack(fields, 0)
    end
  end)
  return charts.json_of(data)
end

-- Machines --------------------------------------------------------------------------

--- Make the machine of a chart if there is none yet; return the chart.
function charts.open(chart)
  if chart.fsm then return chart end
  local ok, model = pcall(chart.make)
  if not ok then fail("chart '%s': %s", chart.name, text_of(model)) end
  model.info, model.warn, model.err = false, false, collect_print
  local fsm, _, problems = rfsm.init(model)
  if not fsm then fail("chart '%s': %s", chart.name, problems[1]) end
  rfsm.set_emit(fsm, emit)
  chart.blank = snapshot.take(fsm)
  note_events(chart, fsm)
  chart.options = { migrate = fsm.migrate, rename = fsm.rename, trusted = true }
  chart.fields, chart.regions = {}, {}
  for i, at in ipairs(rfsm.machines(fsm)) do
    chart.regions[i - 1] = i > 1 and at.machine or nil
    is_shared[at.machine] = true
    note_fields(chart.fields, at.machine)
  end
  chart.fsm = fsm
  return chart
end

--- Is a snapshot of this version of a chart? The charts of regions count, too.
function charts.is_of(chart, snap)
  local is_same = snap.chart == chart.blank.chart and not snap.regions
  return is_same or not migrate.changes(chart.fsm, snap)
end

--- Put a snapshot into the machine of a chart. It is checked if it `is_foreign`.
function charts.put(chart, snap, is_foreign)
  clean(chart)
  chart.options.trusted = not is_foreign
  return snapshot.put(chart.fsm, snap, chart.options)
end

--- Step the machine of a chart until it is idle, at most `steps` times. Return whether
--- it is idle, and whether a path was taken. If an error ends the step, the next call
--- makes a new machine.
function charts.step(chart, steps)
  local fsm, regions = chart.fsm, chart.regions
  chart.fsm = nil
  local is_idle = rfsm.step(fsm, steps)
  local is_taken = took_path(fsm)
  for i = 1, #regions do is_taken = took_path(regions[i]) or is_taken end
  chart.fsm = fsm
  return is_idle, is_taken
end

-- Returns the texts of the events that a machine and its regions keep.
local function waiting_in(chart)
  local texts = {}
  for i = 0, #chart.regions do
    for _, event in ipairs(rfsm.waiting(chart.regions[i] or chart.fsm)) do
      texts[#texts + 1] = rfsm.event_text(event, true)
    end
  end
  return texts
end

-- Returns the active leaves of the regions.
local function leaves_in(chart)
  local leaves = {}
  for i, region in ipairs(chart.regions) do leaves[i] = region._act_leaf end
  return leaves
end

--- Do the same as `charts.step`. Return also whether a region is in another leaf, and
--- what a history has of the events that the machine kept before and keeps no longer:
--- " (recalled: e_a, e_b)".
function charts.step_noting(chart, steps)
  local before = waiting_in(chart)
  local leaves, has_moved = leaves_in(chart), false
  local is_idle, is_taken = charts.step(chart, steps)
  for i, leaf in ipairs(leaves_in(chart)) do
    has_moved = has_moved or leaf ~= leaves[i]
  end
  local gone = before[1] and migrate.missing(before, waiting_in(chart)) or before
  return is_idle, is_taken, has_moved,
    gone[1] and " (recalled: " .. concat(gone, ", ") .. ")"
end

-- Returns a table: path of a leaf, also of one in a region -> the leaf, and the machine
-- that has it, as `rfsm.machines` lists it.
local function leaves_of(fsm)
  local leaves = {}
  for at, leaf in location.each(fsm, rfsm.is_leaf) do
    leaves[location.path(leaf, at.prefix)] = { at = at, leaf = leaf }
  end
  return leaves
end

-- Calls the hooks with which extensions follow the states from the root to a leaf.
local function call_hooks(fsm, hooks, leaf)
  rfsm.map_from_to(fsm, function(_, state)
    for _, hook in ipairs(hooks and hooks[state] or {}) do hook(fsm, state) end
  end, fsm, leaf)
end

-- Puts one machine into a leaf, which resets the regions in this machine. Extensions
-- see states left and entered, so deferred events and histories stay.
local function force_into(fsm, leaf)
  for _, at in ipairs(rfsm.machines(fsm)) do
    if rawequal(at.owner, fsm) then rfsm.reset(at.machine) end
  end
  if fsm._act_leaf then call_hooks(fsm, fsm._exit_hooks, fsm._act_leaf) end
  rfsm.set_sta_mode(leaf, leaf.doo and "active" or "done")
  fsm._intq, fsm._unread = leaf.doo and {} or { "e_done@" .. leaf._fqn }, 0
  call_hooks(fsm, fsm._entry_hooks, leaf)
end

-- Puts the machine around a region into the state that runs the region, if it is not
-- there.
local function force_around(machines, at)
  if not at.owner or rawequal(at.owner._act_leaf, at.state) then return end
  for _, other in ipairs(machines) do
    if rawequal(other.machine, at.owner) then
      force_around(machines, other)
      force_into(other.machine, at.state)
    end
  end
end

-- Returns the leaves one of which may be meant by a path: those in that composite.
local function leaves_meant(leaves, path)
  local all, inside = rfsm.sorted_keys(leaves), {}
  for _, name in ipairs(all) do
    if name:sub(1, #path + 1) == path .. "." then inside[#inside + 1] = name end
  end
  return inside[1] and inside or all
end

--- Put the machine of a chart into a leaf and arm the timers there, as if the leaf had
--- been entered, but call no callback. Regions are reset. If the leaf is in a region,
--- the other regions beside it stay as they are, or begin anew. Return the text for the
--- history, which has the leaf if the leaf of the machine does not tell it.
function charts.force(chart, path)
  local leaves = leaves_of(chart.fsm)
  local found = leaves[path] or fail("chart '%s' has no leaf '%s'%s", chart.name, path,
    advice.nearest_path(path, leaves_meant(leaves, path)))
  force_around(rfsm.machines(chart.fsm), found.at)
  force_into(found.at.machine, found.leaf)
  return found.at.owner and ("(force %s)"):format(path) or "(force)"
end

--- Return the text of an error in one line. Errors of Redis are tables.
function charts.reason_of(failure)
  local text = type(failure) == "table" and rawget(failure, "err")
  return calls.line(text or encoding.reason(failure))
end

--- Add a line to the errors of this call.
charts.note = collect_print

--- Return what callbacks have emitted in this call, and its errors.
function charts.effects() return emitted, printed end

--- Forget emitted texts and errors, so that a call begins with empty lists.
function charts.forget_effects() emitted, printed = {}, {} end

-- Events ----------------------------------------------------------------------------

-- Returns the events that a chart knows, written as a client sends them.
local function known_events(chart)
  local texts = rfsm.sorted_keys(chart.events)
  for _, name in ipairs(rfsm.sorted_keys(chart.named)) do
    texts[#texts + 1] = ('{"name":"%s"}'):format(name)
  end
  return texts
end

local function refuse(chart, shown, like)
  fail("no transition of chart '%s' has the event '%s'%s", chart.name, shown,
    advice.nearest_name(like, known_events(chart)))
end

-- Returns an event that carries data.
local function named_event(chart, number, text)
  local event = charts.read_json("event " .. number, text, MAX_NAMED)
  local name = event.name
  if type(name) ~= "string" then
    fail("event %d: an object with a text 'name' expected", number)
  end
  if not (chart.named[name] or chart.takes_all) then
    if chart.events[name] ~= nil then
      fail("chart '%s' takes the event '%s' without data (with data it needs "
        .. "rfsm.named)", chart.name, name)
    end
    refuse(chart, name, ('{"name":"%s"}'):format(name))
  end
  return event
end

local function plain_event(chart, number, text)
  if #text > MAX_EVENT then
    fail("event %d: at most %d bytes expected, got %d", number, MAX_EVENT, #text)
  end
  local event = chart.events[text]
  if event ~= nil then return event end
  if not chart.takes_all then
    refuse(chart, text, chart.named[text] and ('{"name":"%s"}'):format(text) or text)
  end
  return text
end

--- Return the events that a list of texts means. A JSON object is an event with data.
function charts.events(chart, texts)
  local events = {}
  for i, text in ipairs(texts) do
    local read = text:byte() == 123 and named_event or plain_event -- "{"
    events[i] = read(chart, i, text)
  end
  return events
end

--- Set the function by which the host decodes JSON.
function charts.use(host_decode) decode = host_decode end

return charts
