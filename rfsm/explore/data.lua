--- Data: the fields that an exploration follows, the callbacks that it calls for them,
--- and the rules for guards that it does not call.
--
-- The callbacks in the option `run` are called as in a machine. Each step begins with
-- the values of its configuration in the fields that the option `vars` names. All other
-- data that callbacks change are put back, and the verdict is then not known
-- (`rfsm.explore.memory`). If a guard is called, or its answer follows from a rule, the
-- exploration tries only this answer, and not the opposite.
--
-- @module rfsm.explore.data
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"
local instrument = require "rfsm.shared.instrument"
local match = require "rfsm.shared.match"
local memory = require "rfsm.explore.memory"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local replacements = require "rfsm.explore.replacements"
local syntax = require "rfsm.shared.syntax"
local writes = require "rfsm.shared.writes"

local coroutine, error, ipairs = coroutine, error, ipairs
local rawequal, rawget, rawset = rawequal, rawget, rawset
local table, type = table, type
local concat = table.concat

local data = {}

-- Options ...........................................................................

-- Is an option a list of at least one value, all of which a test accepts?
local function is_list_of(test, list)
  return type(list) == "table" and list[1] ~= nil and order.all(list, test)
end

local function is_callback(f) return type(f) == "function" or type(f) == "string" end

local function are_callbacks(list) return is_list_of(is_callback, list) end

--- Is the option a list of functions and names of callbacks?
data.check_functions = are_callbacks

--- Is the option a list of functions and names of callbacks, or a list of such lists?
function data.check_groups(list)
  return are_callbacks(list) or is_list_of(are_callbacks, list)
end

-- Is a value the range of a field: { least, most }, a list of texts, or "boolean"?
local function is_range(range)
  if range == "boolean" then return true end
  if type(range) == "table" and type(range[1]) == "number" then
    return type(range[2]) == "number" and range[1] <= range[2] and range[3] == nil
  end
  return is_list_of(opts.is_a "string", range)
end

--- Is `vars` right, such as { tries = { 0, 3 }, on = "boolean", gear = { "a", "b" } }?
data.check_vars = opts.each_field(function(name, range)
  if type(name) ~= "string" or name:find("^_") then
    return "name of a field expected, " .. opts.got(name)
  elseif not is_range(range) then
    return name .. ": { least, most }, list of texts or 'boolean' expected, "
      .. opts.got(range)
  end
end)

-- Values ............................................................................

local function is_inside(range, value)
  if range == "boolean" then return type(value) == "boolean" end
  if type(range[1]) == "string" then return match.has(range, value) end
  return type(value) == "number" and value >= range[1] and value <= range[2]
end

--- Return the values of the fields that `vars` names, in the order of the names, and a
--- text of the values. If the data cannot be followed, return nil and a text about it.
---@param self rfsm_checks.Subject
---@return any[]? values
---@return string text
function data.read(self)
  local values, texts = {}, {}
  if self.changed then return nil, self.changed end
  for i, name in ipairs(self.var_names) do
    local place = self.var_places[i]
    local value = rawget(place.home.of, place.key)
    if not is_inside(self.vars[name], value) then
      return nil, ("values of the field '%s' such as %s"):format(name,
        rfsm.text_of(value))
    end
    values[i], texts[i] = value, ("%q"):format(rfsm.text_of(value))
  end
  return values, concat(texts, ",")
end

--- Set the fields that `vars` names to a list of values that `read` has returned.
function data.put(self, values)
  for i, place in ipairs(self.var_places) do
    rawset(place.home.of, place.key, values[i])
  end
end

-- Restores the targets of transitions, except those that an extension changes. Returns
-- a text about the first one that a callback in `run` has changed.
local function put_targets_back(self)
  local text
  for _, entry in ipairs(self.transitions) do
    local tr = entry.tr
    local is_changed = not rawequal(tr.tgt, entry.tgt)
    if is_changed and not rfsm.targets(tr)[2] then
      tr.tgt, text = entry.tgt, text or "the target of " .. entry.path
    end
  end
  return text
end

--- Restore the data that callbacks of a step have changed, except fields in `vars`.
function data.put_back(self)
  local text = self.memory:put_back() or put_targets_back(self)
  self.is_touched = false
  self.changed = self.changed or text and text .. ", which vars does not name"
end

--- Set the fields that `vars` names back to the values with which the chart begins:
--- other subjects of the same model may share the tables.
function data.rest(self) data.put(self, self.first_values) end

-- Returns two lists: names of fields that `vars` has, that callbacks in `run` may read,
-- or that have these callbacks, and names of variables in them. If a callback computes
-- a key, the first list has a pattern that matches all names.
local function names_of_data(self)
  local names, variables, seen = {}, {}, {}
  for _, name in ipairs(instrument.CALLBACKS) do names[name] = true end
  for _, path in ipairs(self.var_names) do names[path:match("[%w_]+%]?$")] = true end
  for _, callback in ipairs(self.run_list) do
    writes.each(callback, function(text)
      for name in text:gmatch(writes.ANY) do names[name] = true end
      for _, name in ipairs(writes.names_in(text)) do variables[name] = true end
      if writes.reads_any(text) then names[writes.ANY] = true end
    end, seen)
  end
  return rfsm.sorted_keys(names), rfsm.sorted_keys(variables)
end

-- Counts the callbacks, except guards, that are not called. Lists the callbacks, guards
-- and step hooks too, that are not called and may write fields or variables that called
-- ones use.
local function note_others(self, named, names, variables, fsm)
  local function note(name, callback)
    if writes.may_write(callback, names) or writes.may_set(callback, variables) then
      table.insert(self.data_writers, name)
    end
  end
  for _, name in ipairs { "pre_step_hook", "post_step_hook" } do
    note(name, rfsm.model_of(fsm)[name])
  end
  for _, name in ipairs(rfsm.sorted_keys(named)) do
    local callback = named[name]
    if not self.runs[callback] then
      local is_guard = name:find("^guard ")
      self.idle_callbacks = self.idle_callbacks + (is_guard and 0 or 1)
      note(name, callback)
    end
  end
end

-- Appends how many examples there are of each event in `classes`.
local function add_examples(self, texts)
  for _, name in ipairs(rfsm.sorted_keys(self.classes)) do
    texts[#texts + 1] = opts.counted(#self.classes[name], "example") .. " of " .. name
  end
end

--- Return the premises of a verdict that are about guards, data and texts.
---@param self rfsm_checks.Subject
---@return string[] texts
function data.premises(self)
  local texts, count = match.joined({}, self.rule_texts), self.idle_callbacks
  if count > 0 then
    texts[#texts + 1] = opts.counted(count, "callback") .. " not run"
  end
  add_examples(self, texts)
  texts[#texts + 1] = self.memory and self.memory.is_cut and "not all data looked at"
    or nil
  texts[#texts + 1] = self.calls_unnamed and not self.data_names
    and "calls that no text names change no transition" or nil
  texts[#texts + 1] = self.shares_text and "callbacks of one line read together"
    .. (syntax.is_there and "" or " (luacheck is not installed)") or nil
  return texts
end

--- Find the fields of `vars` in a subject, and note their first values; raise an error
--- if a field does not exist or its first value is out of range.
function data.check_first(self)
  self.var_places, self.first_values, self.memory = {}, {}, false
  if not (self.var_names[1] or self.run_list[1]) then return end
  self.memory = memory.of(self)
  for i, path in ipairs(self.var_names) do
    local place = self.memory:place_of(path, self.names)
    self.var_places[i], place.home.followed[place.key] = place, true
  end
  local values, text = data.read(self)
  if not values then error("vars: the chart begins with " .. text, 0) end
  self.first_values = values
end

-- Guards ............................................................................

local function is_name_of(_, key) return type(key) == "string" end

-- Returns the callbacks of a list of functions and names; raises an error if the chart
-- does not have one of them.
local function found_in(named, list, field)
  local is_known, found, kind = {}, {}, field == "run" and "callback" or "guard"
  for name, callback in order.each(named) do -- any order: a set
    local is_right = field == "run" or name:find("^guard ")
    if is_right then is_known[name], is_known[callback] = callback, callback end
  end
  for i, item in ipairs(list) do
    found[i] = is_known[item]
    if not found[i] and type(item) == "string" then
      error(("%s: no %s '%s'%s"):format(field, kind, item,
        advice.nearest_name(item, rfsm.sorted_keys(is_known, is_name_of))), 0)
    elseif not found[i] then
      error(("%s: function %d is no %s of the chart"):format(field, i, kind), 0)
    end
  end
  return found
end

-- Adds the rules of one kind, such as "exclusive", to each guard that they name.
local function add_rules(self, kind, list, named)
  for _, items in ipairs(are_callbacks(list) and { list } or list or {}) do
    local group = found_in(named, items, kind)
    for _, guard in ipairs(group) do
      self.rules[guard] = self.rules[guard] or {}
      local rules = self.rules[guard]
      rules[#rules + 1] = { kind = kind, group = group }
    end
    self.rule_texts[#self.rule_texts + 1] = opts.counted(#group, "guard") .. " "
      .. (kind == "same" and "the same in a step" or kind)
  end
end

-- Adds the guards that get an example of `classes`, if they only read: their answer is
-- known.
local function add_guards(self, fsm)
  local transitions = order.is_empty(self.classes) and {} or match.transitions_of(fsm)
  for _, tr in ipairs(transitions) do
    local has_example = order.any(tr.events or {}, function(event)
      return self.is_example[event]
    end)
    if has_example and tr.guard and writes.only_reads(tr.guard)
      and not match.has(self.run_list, tr.guard) then
      self.run_list[#self.run_list + 1] = tr.guard
    end
  end
end

--- Read the options `vars` and `run`, and the options with rules for guards.
---@param self rfsm_checks.Subject
---@param options rfsm_checks.Options
---@param fsm rfsm.Machine
function data.read_options(self, options, fsm)
  local named = replacements.named(fsm)
  self.vars, self.var_names = options.vars or {}, rfsm.sorted_keys(options.vars or {})
  self.runs, self.rules, self.rule_texts, self.answers = {}, {}, {}, {}
  self.run_list = found_in(named, options.run or {}, "run")
  add_guards(self, fsm)
  for _, f in ipairs(self.run_list) do self.runs[f] = true end
  for _, kind in ipairs { "exclusive", "complementary", "same" } do
    add_rules(self, kind, options[kind], named)
  end
  self.idle_callbacks = 0
  if self.var_names[1] or self.run_list[1] then
    local names, variables = names_of_data(self)
    self.data_names = names
    note_others(self, named, names, variables, fsm)
  end
end

-- Returns the answer of a guard that follows from the answers of other guards in its
-- group: false if one is true; true if the rule is "complementary" and all are false;
-- otherwise nil.
local function find_answer(self, rule, guard)
  local are_false = rule.kind == "complementary"
  for _, other in ipairs(rule.kind ~= "same" and rule.group or {}) do
    if other ~= guard then
      if self.answers[other] then return false end
      are_false = are_false and self.answers[other] == false
    end
  end
  return are_false or nil
end

-- Returns the answer that a guard gave before in this step; else the answer that a rule
-- demands; else nil.
local function known_answer(self, guard)
  local answer = self.answers[guard]
  for _, rule in ipairs(self.rules[guard]) do
    if answer == nil then answer = find_answer(self, rule, guard) end
  end
  return answer
end

-- Returns the function that replaces a guard in `run`. Both answers are tried if the
-- guard fails, or reads data of an event that are not known.
local function new_called_guard(self, path, guard)
  local only_reads = writes.only_reads(guard)
  local reads_all, reads_one = writes.may_read(guard, 2, 2), writes.may_read(guard, 3)
  return function(tr, events, event)
    self.is_touched = self.is_touched or not only_reads or self.memory.has_made
    replacements.note_run(self)
    local ok, answer = calls.try(guard, tr, events, event)
    local part = self.transitions[self.number_of[tr]].part
    if not ok or reads_all and replacements.have_data(self, part.fsm)
      or reads_one and replacements.may_have_data(self, event) then
      self.free.guards = true
      return self:choose(path)
    end
    return self:choose(path, false, answer ~= false)
  end
end

--- Return the function that replaces a guard in a subject.
---@param self rfsm_checks.Subject
---@param path string of its transition
---@param guard function
---@return function
function data.new_guard(self, path, guard)
  if self.runs[guard] then
    return new_called_guard(self, path, guard)
  elseif not self.rules[guard] then
    return function() return self:choose(path) end
  end
  return function()
    local answer = self:choose(path, false, known_answer(self, guard))
    self.answers[guard] = answer
    return answer
  end
end

--- Return the function that replaces a doo of `run` in a subject. It runs the doo up to
--- its first yield. How the doo goes on is not followed: `free` runs instead.
---@param self rfsm_checks.Subject
---@param path string of its state
---@param doo function
---@param free function that runs in place of the doo after its first yield
---@return function
function data.new_doo(self, path, doo, free)
  return function(...)
    self.is_touched = true
    replacements.note_run(self)
    local thread = coroutine.create(doo)
    local ok = coroutine.resume(thread, ...)
    local is_dead = coroutine.status(thread) == "dead"
    if not (is_dead and ok) then
      self.changed = self.changed or ("how the doo %s goes on"):format(path)
    end
    if not is_dead then return free() end
    self:choose(path, true, true)
  end
end

return data
