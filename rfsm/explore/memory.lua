--- Memory: the data that callbacks of a subject can change, and how it is put back.
--
-- The option `run` of an exploration lists callbacks that are really called. The option
-- `vars` lists fields that are a part of configurations. No other data may change:
-- after a step that has called a callback in `run`, they are compared with their first
-- values, those before the exploration. The first difference is reported, and all first
-- values are put back.
--
-- A *home* is a table with data: an element of the chart, a table in an element, or
-- a table to which a callback in `run` refers. The fields of the engine are not
-- data. Nor are fields of extensions that no callback in `run` names. A *cell* is an
-- upvalue or a global variable that a callback in `run` names.
--
-- @module rfsm.explore.memory
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local advice = require "rfsm.advice"
local calls = require "rfsm.shared.calls"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"
local writes = require "rfsm.shared.writes"

local _G, error, getmetatable, ipairs = _G, error, getmetatable, ipairs
local rawequal, rawget = rawequal, rawget
local math, rawset, setmetatable, type = math, rawset, setmetatable, type
local package = rawget(_G, "package")
local setupvalue = (rawget(_G, "debug") or {}).setupvalue
local getupvalue = (rawget(_G, "debug") or {}).getupvalue

local memory = {}

--- The data that callbacks can change, with their first values: the homes are tables,
--- the cells are upvalues and globals.
---@class rfsm_checks.Memory
---@field homes rfsm_checks.Home[]
---@field cells { name: string, read: fun(): any, write: fun(x: any), value: any }[]
-- `value`: the first value
---@field places table<string, { home: rfsm_checks.Home, key: any }> fields of the
-- chart, by path
---@field seen table<any, true> tables and names of globals that were added or skipped
---@field names table<string, true> the fields that callbacks in `run` may use, or
-- `writes.ANY`
---@field most integer the greatest number of homes
---@field is_cut boolean there are more tables than `most`, and not all are homes
---@field has_made boolean a field that an extension has added is among `names`
local Memory = {}
Memory.__index = Memory

--- A table with data, and its first values, those before the exploration.
---@class rfsm_checks.Home
---@field of table the table itself
---@field name string path of the table: "on", "trans[2]"; empty for the machine
---@field kept table<any, any> the first values, by key
---@field followed table<any, true> keys of the fields that the option `vars` names, and
-- of those that are not compared

local MANY = 1000 -- greatest number of homes (tables with data) outside of the chart

-- Homes: tables with data ...........................................................

local function is_datum(key, value)
  return not rfsm.is_meta(key) and not rfsm.is_fsmobj(value)
end

local function path_to(name, key)
  if type(key) ~= "string" then return ("%s[%s]"):format(name, rfsm.text_of(key)) end
  return name == "" and key or name .. "." .. key
end

-- Has an extension put this field into an element, as a counter that no callback in
-- `run` names? The model of the element has no such field, or a value of another kind.
-- The extension changes a counter that one names, also in a step that runs none.
local function is_made(self, of, key, value)
  local model = rfsm.model_of(of)
  local given = model[key]
  local is_own = rawequal(model, of)
    or type(given) == type(value) and getmetatable(given) == getmetatable(value)
  local is_named = self.names[writes.ANY] or self.names[key]
  self.has_made = self.has_made or is_named and not is_own
  return not (is_own or is_named)
end

-- Notes a datum of a home. With `has_places`, the option `vars` may name it.
local function add_datum(self, home, key, value, is_left_out, has_places)
  if is_left_out then
    home.followed[key] = true
  else
    home.kept[key] = value
  end
  if has_places then
    self.places[path_to(home.name, key)] = { home = home, key = key }
  end
end

-- Adds a table and the tables in it to `homes`, whose fields are compared. With
-- `has_places`, the option `vars` may name the fields of these tables.
local function add_home(self, of, name, has_places)
  self.seen[of], self.is_cut = true, #self.homes == self.most
  if self.is_cut then return end
  local home, keys = { of = of, name = name, kept = {}, followed = {} }, {}
  self.homes[#self.homes + 1] = home
  for key, value in order.each(of) do -- any order: each stands alone
    local is_left_out = is_made(self, of, key, value)
    if is_datum(key, value) then
      add_datum(self, home, key, value, is_left_out, has_places)
    end
    local is_home = type(value) == "table" and not is_left_out
    if is_home and not rfsm.is_meta(key) then keys[key] = value end
  end
  for _, key in ipairs(rfsm.sorted_keys(keys)) do
    if not self.seen[keys[key]] then
      add_home(self, keys[key], path_to(name, key), has_places)
    end
  end
end

-- Cells: upvalues and global variables ..............................................

local LIBRARIES = { "_G", "bit", "bit32", "coroutine", "debug", "ffi", "io", "jit",
  "math", "os", "package", "string", "table", "utf8" }

-- Marks the tables of Lua and of this library as seen, so that they are not compared.
local function skip_libraries(self)
  local loaded = package and package.loaded or {}
  for _, name in ipairs(LIBRARIES) do self.seen[loaded[name] or name] = true end
  for name, module in order.each(loaded) do -- any order: marks a set
    if rfsm.text_of(name):find("^rfsm") then self.seen[module] = true end
  end
end

local function add_cell(self, name, read, write)
  local value = read()
  self.cells[#self.cells + 1] = { name = name, read = read, write = write,
    value = value }
  if type(value) == "table" and not self.seen[value] then
    add_home(self, value, name, false)
  end
end

-- Adds a cell for each upvalue and global that a function names.
local function add_cells(self, text, callback)
  for i, upvalue in ipairs(calls.upvalues_of(callback)) do
    add_cell(self, upvalue.name, function()
      local _, value = getupvalue(callback, i)
      return value
    end, function(value) setupvalue(callback, i, value) end)
  end
  for _, name in ipairs(writes.names_in(text)) do
    if not self.seen["global " .. name] then
      self.seen["global " .. name] = true
      add_cell(self, name, function() return rawget(_G, name) end,
        function(value) rawset(_G, name, value) end)
    end
  end
end

-- Compare ...........................................................................

local function is_same(a, b)
  return rawequal(a, b) or a ~= a and b ~= b -- NaN
end

-- Puts back the data of a home that `vars` does not name. Returns a text that names the
-- first field, in the order of keys, that had changed; nil if no such field had.
local function restore(home)
  local of, kept, changed = home.of, home.kept, {}
  for key, value in order.each(of) do -- any order: sorted below
    local is_own = kept[key] ~= nil or is_datum(key, value)
    if is_own and not is_same(value, kept[key]) then changed[key] = true end
  end
  for key in order.each(kept) do -- any order: sorted below
    if rawget(of, key) == nil then changed[key] = true end
  end
  if order.is_empty(changed) then return nil end
  for key in order.each(home.followed) do changed[key] = nil end -- any order
  local keys = rfsm.sorted_keys(changed)
  for _, key in ipairs(keys) do rawset(of, key, kept[key]) end
  return keys[1] ~= nil and ("the field '%s'"):format(path_to(home.name, keys[1]))
    or nil
end

--- Put back the data that `vars` does not name.
---@return string? text the name of the first datum that had changed; nil if none had
function Memory:put_back()
  local text
  for _, home in ipairs(self.homes) do
    local changed = restore(home)
    text = text or changed
  end
  for _, cell in ipairs(self.cells) do
    if not is_same(cell.read(), cell.value) then
      cell.write(cell.value)
      text = text or ("the variable '%s'"):format(cell.name)
    end
  end
  return text
end

-- Public functions ..................................................................

--- Return the place of a field by its path; raise an error if there is no such field.
---@param path string "tries", "on.n", "par.left.n"
---@param names table<string, rfsm.State> the states by path
---@return { home: rfsm_checks.Home, key: any }
function Memory:place_of(path, names)
  if self.places[path] then return self.places[path] end
  if names["root." .. path] then
    error(("vars: '%s' is a state (name a field of it, such as '%s.n')"):format(path,
      path), 0)
  end
  error(("vars: no field is named '%s'%s"):format(path,
    advice.nearest_name(path, rfsm.sorted_keys(self.places))), 0)
end

--- Collect the data that the callbacks listed in the option `run` can change.
---@param self rfsm_checks.Subject
---@return rfsm_checks.Memory
function memory.of(self)
  local own = setmetatable({ homes = {}, cells = {}, places = {}, seen = {},
    names = {}, most = math.huge, is_cut = false, has_made = false }, Memory)
  for _, name in ipairs(self.data_names) do own.names[name] = true end
  skip_libraries(own)
  local list = {}
  for _, part in ipairs(self.parts) do
    for _, obj in ipairs(rfsm.elements(part.fsm)) do
      own.seen[obj] = true
      list[#list + 1] = { obj, (location.path(obj, part.prefix):gsub("^root%.?", "")) }
    end
  end
  for _, pair in ipairs(list) do add_home(own, pair[1], pair[2], true) end
  own.most = #own.homes + MANY
  local seen = {}
  for _, callback in ipairs(self.run_list) do
    writes.each(callback, function(text, other) add_cells(own, text, other) end, seen)
  end
  return own
end

return memory
