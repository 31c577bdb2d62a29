--- The desk of an operator: a machine as a file, and repairs in its data.
--
-- `rfsm_pull` returns a file: the snapshot, and in its field `fleet` the machine's key,
-- chart, revision and history. `rfsm_push` puts such a file back. It is in the format
-- of `rfsm.snapshot.save`, so `rfsm.snapshot.load` reads it.
--
-- @module rfsm.server.desk
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local charts = require "rfsm.server.charts"
local encoding = require "rfsm.snapshot.encoding"
local exact_json = require "rfsm.shared.exact_json"
local keys_of = require "rfsm.server.keys"
local location = require "rfsm.shared.location"
local migrate = require "rfsm.snapshot.migrate"
local rfsm = require "rfsm"
local sums = require "rfsm.shared.sums"
local times = require "rfsm.server.times"

local ipairs, next, pairs, type = ipairs, next, pairs, type
local insert = table.insert
local fail, shown = encoding.fail, keys_of.shown

local MAX_VALUE, MAX_FILE = 65536, 2097152 -- bytes
local MAX_HISTORY = 1000

local desk = {}

--- Return a number that is another one as soon as the saved list of a machine is.
function desk.revision_of(list)
  return sums.of(exact_json.encode(list))
end

-- Returns an argument that may be absent; a server without nil has an empty text.
local function optional(text) return text ~= "" and text or nil end

-- Pull -----------------------------------------------------------------------------

-- Returns the moves in a history in the order of time. The newest have their snapshots,
-- as many as fit into `room` bytes.
local function history_of(items, room)
  local moves = {}
  for i = 1, #items, 5 do
    local snap = items[i + 4]
    room = room - (snap and #exact_json.encode(snap) or 0)
    insert(moves, 1, { time = rfsm.number_of(items[i]), event = items[i + 1],
      from = items[i + 2], to = items[i + 3], snap = room > 0 and snap or nil })
  end
  return moves
end

-- Push -----------------------------------------------------------------------------

-- Is it a time in a file: none, or a list of seconds and nanoseconds?
local function is_time(time)
  return time == nil or type(time) == "table" and type(time[1]) == "number"
    and type(time[2]) == "number"
end

-- Returns the snapshot in the text of a file, and what the file tells of its machine.
local function read_file(text)
  if #text > MAX_FILE then
    fail("file: at most %d bytes expected, got %d", MAX_FILE, #text)
  end
  local whole, problem = sums.remove(text)
  if not whole then
    fail("file: %s (a person who changes the file removes its field 'sum')", problem)
  end
  local snap = charts.decode_json("file (is it cut short?)", whole)
  local about = snap.fleet
  snap.fleet = nil
  if type(about) ~= "table" or type(snap.version) ~= "number"
    or not is_time(about.time) then
    fail("file: a machine that was pulled expected")
  end
  local checked, wrong = encoding.attempt(migrate.checked, snap)
  return checked or fail("file: rfsm.snapshot: %s", wrong), about
end

-- Checks that a file is of the machine at a key, and that the machine has not moved on
-- since it was pulled.
local function check(key, list, about, revision)
  if about.chart ~= list[2] then
    fail("the file has a machine of chart '%s', the one at '%s' is of '%s'",
      shown(about.chart), shown(key), shown(list[2]))
  end
  if about.machine ~= key and not revision then
    fail("the file has the machine at '%s' (to put it into '%s', give its revision)",
      shown(about.machine), shown(key))
  end
  local expected = revision or about.revision
  if rfsm.number_of(expected) ~= desk.revision_of(list) then
    fail("the machine at '%s' has moved on, its revision is not %s any more: pull it "
      .. "again, or set one field", shown(key), shown(expected))
  end
end

-- Set ------------------------------------------------------------------------------

-- Returns a table: the path of each kept field -> the path, its state and its name.
local function kept_fields(fsm)
  local fields = {}
  for at, state in location.each(fsm, rfsm.is_state) do
    for _, name in ipairs(type(state.keep) == "table" and state.keep or {}) do
      local path = location.path(state, at.prefix) .. "." .. rfsm.text_of(name)
      fields[path] = { path = path, state = state, name = name, prefix = at.prefix }
    end
  end
  return fields
end

-- Returns a kept field. A name without a path is a field of the root.
local function find_field(chart, text)
  local fields = kept_fields(chart.fsm)
  local found = fields[text] or fields["root." .. text]
  if found then return found end
  fail("no state of chart '%s' keeps the field '%s'%s", chart.name, shown(text),
    advice.nearest_path(shown(text), rfsm.sorted_keys(fields)))
end

-- Returns the value in a JSON text; nil for null or an absent text.
local function value_of(text)
  if not text then return nil end
  local data = charts.read_json("value", '{"value":' .. text .. "}", MAX_VALUE, "JSON")
  local value = data.value
  data.value = nil
  if next(data) ~= nil then fail("value: one value expected") end
  return value
end

-- Returns the value of a field as a text for the history.
local function text_of(value)
  return value == nil and "null" or shown(charts.json_of(value))
end

local KINDS = { boolean = "true or false", number = "a number", string = "a text",
  table = "a table" }

-- Returns the value that a field has in a new machine; nil if it has none.
local function first_value(chart, field)
  local part = migrate.part_of(chart.blank, field.prefix)
  local data = part.data and part.data[field.state._fqn]
  return data and encoding.unpack(data, 0)[field.name]
end

--- Refuse a value for a kept field if it is of another kind than the field has in a new
-- machine (`first`) and now (`own`). Any field may be taken away.
function desk.check_kind(name, value, first, own, hint)
  if first == nil then first = own end
  if value == nil or first == nil or type(value) == type(first)
    or type(value) == type(own) then
    return
  end
  local got = type(value) == "table" and "a table"
    or (type(value) == "string" and "the text " or "") .. text_of(value)
  fail("field '%s': %s expected, got %s%s", shown(name), KINDS[type(first)], got, hint)
end

-- Functions ------------------------------------------------------------------------

--- Add the functions of the desk. `own` has the functions of `rfsm.server.functions`
-- that load, note and save machines.
function desk.add(functions, own)
  -- rfsm_pull KEY: returns the text of a file.
  function functions.rfsm_pull(keys)
    local key = own.key_of(keys)
    local list = own.read(key)
    local file = {}
    for name, value in pairs(list[own.SNAP]) do file[name] = value end -- any order
    local time = list[own.SEC] and { list[own.SEC], list[own.NSEC] }
    file.fleet = { machine = key, chart = list[own.NAME], time = time or nil,
      revision = desk.revision_of(list),
      history = own.history and history_of(own.history(key, MAX_HISTORY),
        MAX_FILE / 2 - #exact_json.encode(file)) }
    return sums.add(exact_json.encode(file)) .. "\n"
  end

  -- rfsm_push KEY file [revision] [BY who]: puts the machine of a file at a key. Its
  -- timers count from the time that the file tells, else from now.
  function functions.rfsm_push(keys, args)
    local key, by = own.key_of(keys), own.take_by(args)
    local snap, about = read_file(args[1] or "")
    local list = own.read(key)
    check(key, list, about, optional(args[2]))
    local time = about.time or { false }
    times.set(time[1], time[2])
    local machine = own.place_at(key, list, snap)
    machine.is_idle = snap.queue == nil
    own.note(machine, "(push)" .. by)
    machine.outcome = "kept"
    return own.save(machine)
  end

  -- rfsm_set KEY field value ["force"] [BY who]: gives a kept field a value, in JSON.
  -- With "force" it may be of another kind.
  function functions.rfsm_set(keys, args)
    local key, by = own.key_of(keys), own.take_by(args)
    local value = value_of(optional(args[2]))
    local machine = own.load_machine(key, own.read(key))
    local field = find_field(machine.chart, args[1] or "")
    local before = field.state[field.name]
    local is_forced = args[3] == "force"
    if not is_forced then
      desk.check_kind(field.path, value, first_value(machine.chart, field), before,
        (" (%s sets it nevertheless)"):format(own.FORCE))
    end
    field.state[field.name] = value
    own.note(machine, ("(set %s: %s -> %s%s)%s"):format(shown(field.path),
      text_of(before), text_of(value), is_forced and ", forced" or "", by))
    machine.outcome = "kept"
    return own.save(machine)
  end
end

return desk
