--- Data: fields of a machine that an exploration follows, functions that it calls for
--- them, and what is known of guards that stay free.
--
-- The functions in `run` are called as in a machine; each step begins with the values
-- of its configuration in the fields `vars`. An answer that is known, of a guard that
-- is called or by a rule, counts as a choice that has no other side.
--
-- @module rfsm.explore.data
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local calls = require "rfsm.shared.calls"
local match = require "rfsm.shared.match"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"

local error, ipairs = error, ipairs
local rawequal, type = rawequal, type
local concat = table.concat

local data = {}

-- Options ...........................................................................

local function is_functions(list)
  if type(list) ~= "table" or list[1] == nil then return false end
  for _, f in ipairs(list) do
    if type(f) ~= "function" then return false end
  end
  return true
end

--- Is it a list of functions?
function data.check_functions(list) return is_functions(list) end

--- Is it a list of functions, or a list of such lists?
function data.check_groups(list)
  if is_functions(list) then return true end
  if type(list) ~= "table" or list[1] == nil then return false end
  for _, group in ipairs(list) do
    if not is_functions(group) then return false end
  end
  return true
end

-- Is it { least, most }, a list of texts, or "boolean"?
local function is_range(range)
  if range == "boolean" then return true end
  if type(range) ~= "table" or range[1] == nil then return false end
  if type(range[1]) == "number" then
    return type(range[2]) == "number" and range[1] <= range[2] and range[3] == nil
  end
  for _, text in ipairs(range) do
    if type(text) ~= "string" then return false end
  end
  return true
end

--- Is it { tries = { 0, 3 }, armed = "boolean", gear = { "slow", "fast" } }?
---@return boolean is_right
---@return string? problem
function data.check_vars(vars)
  if type(vars) ~= "table" then return false end
  for _, name in ipairs(rfsm.sorted_keys(vars)) do
    if type(name) ~= "string" or name:find("^_") then
      return false, "name of a field expected, " .. opts.got(name)
    elseif not is_range(vars[name]) then
      return false, name .. ": { least, most }, list of texts or 'boolean' expected, "
        .. opts.got(vars[name])
    end
  end
  return true
end

-- Values ............................................................................

local function is_inside(range, value)
  if range == "boolean" then return type(value) == "boolean" end
  if type(range[1]) == "string" then return match.has(range, value) end
  return type(value) == "number" and value >= range[1] and value <= range[2]
end

-- Returns the fields that a machine has of its own, but for those of `vars`.
local function other_fields(self)
  local fields = {}
  for name, value in order.each(self.parts[1].fsm) do -- any order: a copy
    local is_own = type(name) == "string" and not name:find("^_")
    if is_own and not self.vars[name] then fields[name] = value end
  end
  return fields
end

-- Returns the name of a field that has changed since the beginning, though `vars` does
-- not name it.
local function find_other(self)
  local fields = other_fields(self)
  for _, list in ipairs { fields, self.other_fields } do
    for _, name in ipairs(rfsm.sorted_keys(list)) do
      if not rawequal(fields[name], self.other_fields[name]) then return name end
    end
  end
end

--- Return the values of the fields, in the order of their names, and a text of them;
--- nil and what there is that is not followed.
---@param self rfsm_checks.Subject
---@return any[]? values
---@return string text
function data.read(self)
  local values, texts, fsm = {}, {}, self.parts[1].fsm
  local other = not order.is_empty(self.runs) and find_other(self)
  if other then
    return nil, ("the field '%s', which vars does not name"):format(other)
  end
  for i, name in ipairs(self.var_names) do
    local value = fsm[name]
    if not is_inside(self.vars[name], value) then
      return nil, ("values of the field '%s' such as %s"):format(name,
        rfsm.text_of(value))
    end
    values[i], texts[i] = value, ("%q"):format(rfsm.text_of(value))
  end
  return values, concat(texts, ",")
end

--- Set the fields.
function data.put(self, values)
  for i, name in ipairs(self.var_names) do self.parts[1].fsm[name] = values[i] end
end

--- Raise an error if a field has no value to begin with, or another one.
function data.check_first(self)
  self.other_fields = other_fields(self)
  local values, text = data.read(self)
  if not values then error("vars: the chart begins with " .. text, 0) end
end

-- Guards ............................................................................

-- Notes the rules for guards: the groups that each is in.
local function add_rules(self, kind, list)
  for _, group in ipairs(is_functions(list) and { list } or list or {}) do
    for _, guard in ipairs(group) do
      self.rules[guard] = self.rules[guard] or {}
      local rules = self.rules[guard]
      rules[#rules + 1] = { kind = kind, group = group }
    end
    self.rule_texts[#self.rule_texts + 1] = ("%d %s %s"):format(#group,
      #group == 1 and "guard" or "guards", kind == "same" and "the same in a step"
      or kind)
  end
end

--- Read the options.
---@param self rfsm_checks.Subject
---@param options rfsm_checks.Options
function data.read_options(self, options)
  self.vars, self.var_names = options.vars or {}, rfsm.sorted_keys(options.vars or {})
  self.runs, self.rules, self.rule_texts, self.answers = {}, {}, {}, {}
  self.is_met = {}
  for _, f in ipairs(options.run or {}) do self.runs[f] = true end
  for _, kind in ipairs { "exclusive", "complementary", "same" } do
    add_rules(self, kind, options[kind])
  end
end

--- Raise an error for a function in the options that the chart does not have.
function data.check_met(self, options)
  for _, field in ipairs { "run", "exclusive", "complementary", "same" } do
    local list = options[field]
    for _, group in ipairs(is_functions(list) and { list } or list or {}) do
      for i, f in ipairs(group) do
        if not self.is_met[f] then
          error(("%s: function %d is no %s of the chart"):format(field, i,
            field == "run" and "callback" or "guard"), 0)
        end
      end
    end
  end
end

-- Returns the answer that follows from those of the other guards in a group, or nil:
-- one of them is true, or all are false.
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

-- Returns the answer of a guard that is known in this step, or nil.
local function known_answer(self, guard)
  local answer = self.answers[guard]
  for _, rule in ipairs(self.rules[guard]) do
    if answer == nil then answer = find_answer(self, rule, guard) end
  end
  return answer
end

--- Return what a subject has in place of a guard.
---@param self rfsm_checks.Subject
---@param path string of its transition
---@param guard function
---@return function
function data.new_guard(self, path, guard)
  self.is_met[guard] = true
  if self.runs[guard] then
    return function(...)
      local ok, answer = calls.try(guard, ...)
      return self:choose(path, false, ok and answer ~= false)
    end
  elseif not self.rules[guard] then
    return function() return self:choose(path) end
  end
  return function()
    local answer = self:choose(path, false, known_answer(self, guard))
    self.answers[guard] = answer
    return answer
  end
end

return data
