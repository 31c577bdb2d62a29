--- Replacements: functions that an exploration calls in place of a chart's callbacks.
--
-- The replacement of an entry, exit or effect sets the flags and sends the events that
-- the options list for the callback's name: "entry root.a", "effect root.trans[2]".
--
-- @module rfsm.explore.replacements
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local instrument = require "rfsm.shared.instrument"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local reactions = require "rfsm.explore.reactions"
local writes = require "rfsm.shared.writes"

local error, getmetatable, ipairs = error, getmetatable, ipairs
local math, package, rawequal, rawget = math, package, rawequal, rawget
local table, type = table, type

local replacements = {}

-- Options ...........................................................................

local FLAG = { on = true, off = true }

local function problem_of_flag(name, flag)
  local where = rfsm.text_of(name)
  if type(flag) ~= "table" then
    return where .. ": table with the lists 'on' and 'off' expected, " .. opts.got(flag)
  end
  for _, field in ipairs(rfsm.sorted_keys(flag)) do
    if not FLAG[field] then
      return ("%s: no field '%s'%s"):format(where, rfsm.text_of(field),
        advice.nearest_name(rfsm.text_of(field), { "off", "on" }))
    elseif not opts.is_list(flag[field]) then
      return ("%s.%s: list of callbacks expected, %s"):format(where, field,
        opts.got(flag[field]))
    end
  end
  if not (flag.on and flag.on[1]) then
    return where .. ".on: callbacks or events that switch it on expected, got none"
  end
end

--- Is the option a table of flags: { motor = { on = {...}, off = {...} } }?
replacements.check_flags = opts.each_field(problem_of_flag)

-- Returns the kind of an item of `sends`: "after" for { "e_x", after = 2 }, "cancel"
-- for { cancel = "e_x" }, "emit" for { emit = "e_x" }; nil for a plain event.
local function kind_of(item)
  if type(item) ~= "table" or getmetatable(item) then return nil end
  if rawget(item, "after") ~= nil then return "after" end
  if rawget(item, 1) ~= nil then return nil end
  return rawget(item, "cancel") ~= nil and "cancel"
    or rawget(item, "emit") ~= nil and "emit" or nil
end

local function problem_of_later(where, item)
  local seconds = item.after
  if type(seconds) ~= "number" or not (seconds >= 0 and seconds < math.huge) then
    return where .. ".after: seconds, a finite number not below 0, expected, "
      .. opts.got(seconds)
  elseif item[1] == nil then
    return where .. ": event expected in front of 'after', got none"
  end
  for _, field in ipairs(rfsm.sorted_keys(item)) do
    if field ~= 1 and field ~= "after" then
      return ("%s: no field '%s' beside the event and 'after'"):format(where,
        rfsm.text_of(field))
    end
  end
end

local function problem_of_sends(name, list)
  local where = ("['%s']"):format(rfsm.text_of(name))
  if not opts.is_list(list) then
    return where .. ": list of events expected, " .. opts.got(list)
  end
  for i, item in ipairs(list) do
    local problem = kind_of(item) == "after"
      and problem_of_later(where .. "[" .. i .. "]", item)
    if problem then return problem end
  end
end

--- Is the option a table of lists of events: { ["entry root.a"] = { "e_x" } }?
--- { "e_x", after = 2 } sends the event later, { cancel = "e_x" } drops this event.
--- { emit = "e_x" } calls `fsm.emit`; { emit = "e_x", data = true } also passes data.
replacements.check_sends = opts.each_field(problem_of_sends)

-- Callbacks by name ................................................................

-- Calls f(name, callback, fsm, element, field) for each callback of a machine and its
-- regions. For a sequential AND state f gets the user's callbacks, not the extension's.
local function each_callback(fsm, f)
  for entry, obj in location.each(fsm) do
    local own = instrument.owner_of_callbacks(obj)
    local path = location.path(obj, entry.prefix)
    for _, field in ipairs(instrument.CALLBACKS) do
      local name = field .. " " .. path
      if rfsm.is_callable(own[field]) then
        f(name, own[field], entry.machine, obj, field)
      end
    end
  end
end

--- Return the callbacks of a machine and its regions, by name.
---@return table<string, function> named with keys such as "effect root.trans[2]"
function replacements.named(fsm)
  local named = {}
  each_callback(fsm, function(name, callback) named[name] = callback end)
  return named
end

local EMIT = "%f[%w_](emit[%w_]*)%s*%(?%s*([\"']?)([^\"'%s]*)[\"']?%s*(,?)"

-- Appends the events that the text of a callback emits; false stands for an event whose
-- name is not in the text. Those with data are added to a set.
local function add_emitted(text, list, with_data)
  for word, quote, name, comma in text:gmatch(EMIT) do
    local is_call = word == "emit" or word == "emit_event"
    if is_call then list[#list + 1] = quote ~= "" and name end
    if is_call and comma ~= "" then with_data[name] = true end
  end
end

local function may_emit(callback)
  local list = {}
  return writes.each(callback, function(text)
    add_emitted(text, list, {})
    return list[1] ~= nil
  end, {})
end

--- List the events that a machine and its regions emit, as the text of their callbacks
--- shows; nil if they may emit events that the text does not show.
---@return string[]?
---@return table<string, true> with_data those that the text emits with data
function replacements.emitted_by(fsm)
  local emitted, with_data, is_certain, seen = {}, {}, true, {}
  each_callback(fsm, function(_, callback)
    is_certain = is_certain and writes.text_of(callback) ~= nil
    writes.each(callback, function(text)
      add_emitted(text, emitted, with_data)
    end, seen)
  end)
  return is_certain and not match.has(emitted, false) and emitted or nil, with_data
end

-- Notes that the text of a callback is not known, or may be that of others, too. What a
-- call does that no text names matters where data are followed; else it is a premise.
local function note_text(self, name, callback)
  local _, is_shared = writes.text_of(callback)
  self.shares_text = self.shares_text or is_shared or false
  local calls_unnamed = writes.calls_unnamed(callback)
  if not writes.is_known(callback) or calls_unnamed and self.data_names then
    self.unknown[#self.unknown + 1] = name
  end
  self.calls_unnamed = self.calls_unnamed or calls_unnamed
end

-- Notes that a callback emits events, or sends some that the alphabet may not have.
local function note_senders(self, name, callback)
  if may_emit(callback) then self.emitters[#self.emitters + 1] = name end
  if self.alphabet and writes.may_call(callback, rfsm, "send_events") then
    self.unsure_senders[#self.unsure_senders + 1] = name
  end
end

--- Note what a callback may do that the exploration does not follow: it may add a
--- transition, or write the target of one; it may also emit, delay or cancel events,
--- unless the option `sends` lists the events of the callback. Without text it may do
--- anything.
function replacements.note_writer(self, name, callback)
  if not callback then return end
  local is_run = self.runs[callback]
  local is_listed = is_run or self.sends[name] or self.dry_sends[name]
  local function note(list) list[#list + 1] = name end
  note_text(self, name, callback)
  if writes.may_call(callback, rfsm, "fsm_merge")
    or not is_run and writes.may_write(callback, { "tgt" }) then
    note(self.writers)
  end
  if not is_listed then note_senders(self, name, callback) end
  if self.sends[name] and not is_run then return end
  local timeevent = package.loaded.rfsm_timeevent
  if writes.may_call(callback, timeevent, "send_after") then note(self.late_senders) end
  if writes.may_call(callback, timeevent, "cancel") then note(self.cancellers) end
end

--- Return a function that notes that a callback has run which may change what is not
--- followed, or send events later, and then calls `f`; `f` itself if it does neither.
---@param self rfsm_checks.Subject
---@param name string of the callback
---@param callback function|nil
---@param f function|nil the replacement of the callback
---@return function?
function replacements.marked(self, name, callback, f)
  local is_unknown = match.has(self.unknown, name) and not self.runs[callback]
  local kind = match.has(self.writers, name) and "targets"
    or (is_unknown or match.has(self.data_writers, name)) and "data"
  local sends_late = match.has(self.late_senders, name)
  if not (kind or sends_late) then return f end
  return function(...)
    self.unfollowed = self.unfollowed == "targets" and "targets" or kind
      or self.unfollowed
    self.sends_late = self.sends_late or sends_late
    if f then return f(...) end
  end
end

--- Note that a callback in `run` is called now.
function replacements.note_run(self)
  self.ran = self.unfollowed and "after" or self.ran or "before"
end

-- Replacements ......................................................................

-- Calls a callback. Returns the events that it sends to its machine, which are removed
-- from the queue, and the results of `calls.try`.
local function call_apart(callback, fsm, ...)
  local sent, first = {}, #fsm._intq + 1
  local ok, failure = calls.try(callback, fsm, ...)
  for i = first, #fsm._intq do sent[#sent + 1] = fsm._intq[i] end
  for i = #fsm._intq, first, -1 do fsm._intq[i] = nil end
  return sent, ok, failure
end

-- How error messages of Lua itself begin. The rest of a message depends on the Lua.
local OWN_WORDS = { "^attempt to ", "^bad argument ", "stack overflow",
  "^number .* has no integer", "^invalid " }

-- Returns ": " and the text of a failure without its location; "" for an error of the
-- interpreter, so that results are the same on every Lua.
local function text_of_failure(failure)
  local text = rfsm.text_of(failure):gsub("^.-:%d+: ", "")
  for _, words in ipairs(OWN_WORDS) do
    if text:find(words) then return "" end
  end
  return ": " .. text
end

-- Returns a function that calls the callback, and appends to `self.called` the name of
-- the callback, the events that it sends, and its failure.
local function new_call(self, name, callback)
  return function(...)
    local called = self.called
    called[#called + 1] = name
    local sent, ok, failure = call_apart(callback, ...)
    for i = 1, #sent do
      called[#called + 1] = "sends " .. rfsm.event_text(sent[i], true)
    end
    if not ok then
      called[#called + 1] = "fails" .. text_of_failure(failure)
    end
  end
end

local IS_DRY = { entry = true, exit = true, effect = true }

-- Is it not known what a callback sends, since it has failed in a dry run, or reads the
-- event, which a dry run does not have?
local function is_unsure(callback, ok)
  local may_send = may_emit(callback) or writes.may_call(callback, rfsm, "send_events")
  return may_send and not (ok and not writes.may_read(callback, replacements.EVENTS))
end

--- Call each entry, exit and effect of a machine once. The machine is used for nothing
--- else. Return the events that a callback sends and emits, by the callback's name.
function replacements.dry_run(self, fsm)
  local sent, emitted = {}, {}
  rfsm.set_emit(fsm, function(event, value)
    emitted[#emitted + 1] = { emit = event, data = value ~= nil }
  end)
  each_callback(fsm, function(name, callback, machine, obj, field)
    if not IS_DRY[field] then return end
    emitted = {}
    local list, ok = call_apart(callback, machine, obj, field, {})
    sent[name] = match.joined(list, emitted)
    if not self.sends[name] and is_unsure(callback, ok) then
      self.unsure_senders[#self.unsure_senders + 1] = name
    end
  end)
  return sent
end

-- Events with data ....................................................................

--- The number of the first argument of an entry, exit or effect that has to do with
--- the current events.
replacements.EVENTS = 4

--- May an event stand for one with data, or for an event that no transition names? A
--- text that the machine itself makes does not.
function replacements.may_have_data(self, event)
  local is_own = type(event) == "string" and self:maker_of(event)
  if is_own or self.is_example[event] then return false end
  if self.names_with_data[event] or event == reactions.OTHER then return true end
  for _, answers in order.each(self.answers) do -- any order: one is enough
    if type(answers) == "table" and answers[event] then return true end
  end
  return type(event) == "table" and getmetatable(event) == nil
    and type(event.name) == "string"
end

--- Are there current events whose data an exploration does not have?
---@param self rfsm_checks.Subject
---@param fsm rfsm.Machine
---@return boolean
function replacements.have_data(self, fsm)
  return order.any(fsm._curq, function(event)
    return replacements.may_have_data(self, event)
  end)
end

-- Calls a callback in `run`. If it fails, or reads data of an event, it is not known
-- what it does.
local function call_run(self, part, name, run, reads_event, ...)
  self.is_touched = true
  replacements.note_run(self)
  if not calls.try(run, ...) then
    self.changed = self.changed or ("what the %s does, which fails here"):format(name)
  elseif reads_event and replacements.have_data(self, part.fsm) then
    self.changed = self.changed
      or ("what the %s does with the data of an event"):format(name)
  end
end

--- Drop the delayed events of a machine or region; with `event`, only equal events.
function replacements.drop_later(self, part, event)
  local function is_dropped(later)
    return later.part == part and (event == nil or rawequal(later.event, event))
  end
  for _, later in ipairs(self.later) do
    if is_dropped(later) then self.dropped[later] = true end
  end
  for i = #self.sent_later, 1, -1 do
    if is_dropped(self.sent_later[i]) then table.remove(self.sent_later, i) end
  end
end

-- Returns a function f(fsm) for an item of `sends`: it sends, delays, cancels or emits.
local function new_send(self, part, item)
  local kind = kind_of(item)
  self.has_senders = self.has_senders or not kind or kind == "after"
  if kind == "after" then
    local later = self:new_occurrence(part, item[1], item.after)
    self.later[#self.later + 1] = later
    return function() self.sent_later[#self.sent_later + 1] = later end
  elseif kind == "cancel" then
    return function() replacements.drop_later(self, part, item.cancel) end
  elseif kind == "emit" then
    return function() self.emitted[#self.emitted + 1] = item end
  end
  return function(fsm)
    rfsm.send_events(fsm, item)
    self.sent[#self.sent + 1] = { prefix = part.prefix, event = item }
  end
end

-- Returns a function that calls `run`, if it is the callback of this name, then sets
-- flags, then sends events. Returns nil if there is nothing to do.
local function new_replacement(self, part, name, run, flags, events)
  if not (flags[1] or events[1] ~= nil or run) then return nil end
  if run then
    part.is_bound = true
    self.has_senders = self.has_senders or writes.may_call(run, rfsm, "send_events")
  end
  local sends, reads_event = {}, run and writes.may_read(run, replacements.EVENTS)
  for i, item in ipairs(events) do sends[i] = new_send(self, part, item) end
  return function(own, ...)
    if run then call_run(self, part, name, run, reads_event, own, ...) end
    for _, flag in ipairs(flags) do self.flags[flag.number] = flag.value end
    for _, send in ipairs(sends) do send(own) end
  end
end

--- Return the replacement of a callback, and note the callback's name. If the chart has
--- no such callback, the options may still name flags for it to set, or events to send.
---@param self rfsm_checks.Subject
---@param what "entry"|"exit"|"effect"
---@param path string
---@param part rfsm_checks.Part
---@param callback function|nil
---@return function? replacement nil if it has nothing to do
function replacements.new(self, what, path, part, callback)
  local name = what .. " " .. path
  self.callbacks[name] = part
  replacements.note_writer(self, name, callback)
  if self.calls_callbacks then
    local short = what == "effect" and what or what .. " " .. path:gsub("^root%.", "")
    return callback and new_call(self, short, callback)
  end
  local run = self.runs[callback or false] and callback
  local events = self.sends[name] or run and {}
    or self.dry_sends[name] or {}
  return replacements.marked(self, name, callback,
    new_replacement(self, part, name, run, self.flags_of[name] or {}, events))
end

-- Is it the name of a callback, such as "entry root.a", and not an event?
local function is_callback_name(name)
  return type(name) == "string" and name:find("^%l+ ") ~= nil
end

-- Notes that the replacements of the callbacks, or the events, in `names` set a flag to
-- a value. An event with data is given by its name.
local function set_flag(self, names, number, value)
  for _, name in ipairs(names or {}) do
    local of = is_callback_name(name) and self.flags_of or self.flags_of_event
    name = not is_callback_name(name) and rfsm.event_name(name) or name
    order.append(of, name, { number = number, value = value })
  end
end

--- Set the flags that an event switches.
---@param self rfsm_checks.Subject
---@param event any
function replacements.switch_flags(self, event)
  local name = rfsm.name_with_data(event) or event
  for _, flag in ipairs(self.flags_of_event[name] or {}) do
    self.flags[flag.number] = flag.value
  end
end

--- Number the flags of { motor = { on = { "entry root.a" }, off = { "e_off" } } }. List
--- the flags that each callback's replacement sets, and each event, by its name.
function replacements.read_flags(self, flags)
  for number, name in ipairs(rfsm.sorted_keys(flags)) do
    self.flag_numbers[name], self.flags[number] = number, "-"
    set_flag(self, flags[name].on, number, "+")
    set_flag(self, flags[name].off, number, "-")
  end
end

--- Raise an error if a flag has the name of a state, since a condition could mean both.
function replacements.check_flag_names(self)
  for _, name in ipairs(rfsm.sorted_keys(self.flag_numbers)) do
    if self.names[name] then
      error(("flags: '%s' is the path of a state, use another name"):format(name), 0)
    end
  end
end

--- Raise an error if a key of an option is not the name of a callback.
---@param self rfsm_checks.Subject
---@param named table<string, any>
---@param field string
function replacements.check_names(self, named, field)
  for _, name in ipairs(rfsm.sorted_keys(named)) do
    if not self.callbacks[name] then
      error(("%s: no callback '%s'%s"):format(field, rfsm.text_of(name),
        advice.nearest_name(rfsm.text_of(name), rfsm.sorted_keys(self.callbacks))), 0)
    end
  end
end

return replacements
