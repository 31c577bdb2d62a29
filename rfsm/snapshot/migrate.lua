--- Migration: checks the format of a snapshot, and changes the snapshot of one chart so
-- that it fits another. Data is lost only if the user's function `migrate` removes it.
--
-- A *part* of a snapshot has the data of one machine: the outermost one, or a region.
--
-- @module rfsm.snapshot.migrate
-- @license BSD-3-Clause

local shape = require "rfsm.snapshot.shape"
local location = require "rfsm.shared.location"
local order = require "rfsm.shared.order"
local encoding = require "rfsm.snapshot.encoding"
local rfsm = require "rfsm"

local each, error, ipairs = order.each, error, ipairs
local rawequal, select, type = rawequal, select, type
local concat = table.concat
local fail, text_of = encoding.fail, rfsm.text_of

local migrate, NONE = { VERSION = 2 }, {}

-- Shape -----------------------------------------------------------------------------

-- The types of the fields of a part. A whole snapshot has the fields of `WHOLE`, too.
local PART = {
  chart = "string", leaf = "string", done = "boolean", queue = "table", data = "table",
  unread = "number", saved = "table", targets = "table", ext = "table",
}

local WHOLE = { version = "number", regions = "table", structure = "table" }
for field, kind in each(PART) do WHOLE[field] = kind end -- any order: a copy

local function copy_fields(t)
  local copy = {}
  for key, value in each(t) do -- any order: a copy
    if not encoding.is_null(value) then copy[key] = value end
  end
  return copy
end

local function check_fields(snap, fields, where)
  local wrong = nil
  for field, value in each(snap) do -- any order: the first by name is reported
    if type(value) ~= fields[field] then
      wrong = wrong or {}
      wrong[field] = true
    end
  end
  if not wrong then return end
  local field = rfsm.sorted_keys(wrong)[1]
  if not fields[field] then
    fail("%sno snapshot has a field '%s'", where, text_of(field))
  end
  fail("%s%s: %s expected, got %s", where, field, fields[field], type(snap[field]))
end

--- Return a copy of a snapshot, in which fields with null of JSON are absent. Raise an
--- error if a field has a wrong name or type.
function migrate.checked(snap)
  if type(snap) ~= "table" then fail("snapshot expected, got %s", type(snap)) end
  snap = copy_fields(snap)
  if snap.version ~= migrate.VERSION then
    fail("snapshot of format %d expected, got %s", migrate.VERSION,
      snap.version == nil and "none" or "format " .. text_of(snap.version))
  end
  if not snap.chart then fail("chart: string expected, got nil") end
  check_fields(snap, WHOLE, "")
  snap.regions = snap.regions and copy_fields(snap.regions)
  for prefix, part in each(snap.regions or NONE) do -- any order: each is independent
    if type(part) ~= "table" then
      fail("regions: table expected for '%s', got %s", text_of(prefix), type(part))
    end
    part = copy_fields(part)
    snap.regions[prefix] = part
    check_fields(part, PART, text_of(prefix) .. ": ")
  end
  return snap
end

-- Parts: a machine and its regions --------------------------------------------------

--- Return the part of a snapshot for the machine at a prefix: "root", "root.arms.left".
function migrate.part_of(snap, prefix)
  if prefix == "root" then return snap end
  return (snap.regions or NONE)[prefix] or NONE
end

--- Call f(part, prefix) for each part of a snapshot, that of the machine first.
function migrate.each_part(snap, f)
  f(snap, "root")
  for _, prefix in ipairs(rfsm.sorted_keys(snap.regions or NONE)) do
    f(snap.regions[prefix], prefix)
  end
end

-- Returns how the chart of a machine differs from the chart of a part: "kept" if only
-- the kept fields differ, "structure" if the structure does, nil if they are the same.
local function change_of(machine, part)
  local name = part.chart
  local chart = name and shape.of(machine).chart
  if not name or name == chart.name or name == chart.name_before then return nil end
  local structure = name:match("^[^-]*")
  local is_kept = structure == chart.structure or structure == chart.structure_before
  return is_kept and "kept" or "structure"
end

-- What would be lost ----------------------------------------------------------------

local function note_data(list, chart, part, prefix)
  for _, fqn in ipairs(rfsm.sorted_keys(part.data or NONE)) do
    local keeper = chart.keeper[fqn]
    local fields = encoding.unpack(part.data[fqn], 2)
    for _, name in ipairs(type(fields) == "table" and rfsm.sorted_keys(fields) or {}) do
      if not (keeper and keeper.kept[name]) then
        list[#list + 1] = "field " .. text_of(name) .. " of " .. prefix
          .. text_of(fqn):sub(5)
      end
    end
  end
  for _, fqn in ipairs(rfsm.sorted_keys(part.saved or NONE)) do
    if not (chart.keeper[fqn] and chart.keeper[fqn].has_load) then
      list[#list + 1] = "what save of " .. prefix .. text_of(fqn):sub(5) .. " returned"
    end
  end
end

-- Adds the active leaf of a part and its changed targets, if the chart lacks them. If
-- the old chart is not known, nobody can tell which transition has a number now.
local function note_places(list, machine, part, prefix, is_unknown)
  local targets = part.targets or NONE
  if part.leaf and not shape.find_state(machine, part.leaf) then
    list[#list + 1] = "state " .. prefix .. part.leaf:sub(5)
  end
  for i = 1, #targets, 3 do
    local tr, _, id = shape.target_at(machine, targets, i)
    if not tr or is_unknown and type(id) == "number" then
      list[#list + 1] = ("target %s of transition %s in %s"):format(
        text_of(targets[i + 2]), text_of(id), text_of(targets[i]))
    end
  end
end

-- Extensions whose data belong to elements of the chart. If such an element is gone,
-- its data is not needed. The extensions are named here, since a chart without such
-- elements may not load the extension, and then has no hook of it.
local FOLLOWERS = { timers = true, emem = true, await = true }

local function note_extensions(list, machine, part, prefix)
  local is_known = {}
  for _, hook in ipairs(rfsm.snapshot_hooks(machine)) do is_known[hook.name] = true end
  for _, name in ipairs(rfsm.sorted_keys(part.ext or NONE)) do
    if not (is_known[name] or FOLLOWERS[name]) then
      list[#list + 1] = ("what extension %s kept of %s"):format(text_of(name), prefix)
    end
  end
end

--- List the states, targets, regions and data of a snapshot that a machine cannot take,
-- since its chart lacks them. `is_unknown` says that it had another, unknown structure.
function migrate.lost(fsm, snap, is_unknown)
  local list, is_known = {}, {}
  for _, at in ipairs(shape.of(fsm).places) do
    local machine, prefix = at.machine, at.prefix
    local part = migrate.part_of(snap, prefix)
    is_known[prefix] = true
    note_places(list, machine, part, prefix, is_unknown)
    note_data(list, shape.of(machine).chart, part, prefix)
    note_extensions(list, machine, part, prefix)
  end
  for _, prefix in ipairs(rfsm.sorted_keys(snap.regions or NONE)) do
    if not is_known[prefix] then list[#list + 1] = "region " .. text_of(prefix) end
  end
  return list
end

-- New names -------------------------------------------------------------------------

--- Return an FQN with new names, given a table of old and new FQNs. The text may also
-- be the FQN of a state inside a renamed one, or an event such as e_done@root.a.
function migrate.renamed(text, rename)
  local event, fqn = text:match("^(.*@)(root.*)$")
  local head, tail = fqn or text, ""
  while head do
    if rename[head] then return (event or "") .. rename[head] .. tail end
    local above, name = head:match("^(.*)(%.[^.]*)$")
    head, tail = above, (name or "") .. tail
  end
  return text
end

local renamed_text = migrate.renamed

-- Refuses a second value for a name: nobody knows which of them counts.
local function check_single(values, name)
  if values[name] ~= nil then
    fail("rename: two with data become %s (only the option 'migrate' can join them)",
      text_of(name))
  end
end

-- Returns a copy of a value with new names in keys and values. Only `depth` levels of
-- tables are changed; deeper values stay as they are.
local function renamed(value, rename, depth)
  if depth == 0 then return value end
  if type(value) == "string" then return renamed_text(value, rename) end
  if type(value) ~= "table" then return value end
  local copy = {}
  for key, inner in each(value) do -- any order: no two become one
    local new = renamed(key, rename, 1)
    check_single(copy, new)
    copy[new] = renamed(inner, rename, depth - 1)
  end
  return copy
end

-- The fields of a snapshot that have names of states, with the depth for `renamed`.
local NAMED = { leaf = 1, queue = 2, targets = 2, ext = 20, data = 1, saved = 1 }

local function rename_part(part, rename)
  local copy = {}
  for field, value in each(part) do -- any order: each is independent
    copy[field] = renamed(value, rename, NAMED[field] or 0)
  end
  return copy
end

-- Returns two results for a region: a table old -> new FQN of its renamed states, where
-- each FQN begins with root, and the new prefix of the region.
local function inside(rename, prefix)
  local inner, new_prefix = {}, renamed_text(prefix, rename)
  for old, new in each(rename) do -- any order: each is independent
    if old:sub(1, #prefix + 1) == prefix .. "."
      and new:sub(1, #new_prefix + 1) == new_prefix .. "." then
      inner["root" .. old:sub(#prefix + 1)] = "root" .. new:sub(#new_prefix + 1)
    end
  end
  return inner, new_prefix
end

local function rename_states(snap, rename)
  local copy = rename_part(snap, rename)
  copy.regions = snap.regions and {}
  for prefix, part in each(snap.regions or NONE) do -- any order: each is independent
    local inner, new_prefix = inside(rename, prefix)
    check_single(copy.regions, new_prefix)
    copy.regions[new_prefix] = rename_part(part, inner)
  end
  return copy
end

-- Move a snapshot from another chart ------------------------------------------------

--- List the values of a list that another list has not, or has less often.
function migrate.missing(list, other)
  local counts, found = {}, {}
  for _, value in ipairs(other) do counts[value] = (counts[value] or 0) + 1 end
  for _, value in ipairs(list) do
    counts[value] = (counts[value] or 0) - 1
    if counts[value] < 0 then found[#found + 1] = value end
  end
  return found
end

--- List the lines that only one of two structures has. If they have the same lines, the
-- list says that their order differs.
function migrate.difference(old, new)
  local list, gone = migrate.missing(new, old), migrate.missing(old, new)
  for i, line in ipairs(list) do list[i] = "new: " .. line end
  for _, line in ipairs(gone) do list[#list + 1] = "gone: " .. line end
  if not list[1] then list[1] = "the order of the transitions" end
  return list
end

-- Returns the structure of a snapshot's chart as lines. A part that does not name its
-- chart has the present chart. Returns nil if a named chart is not known.
local function known_lines(fsm, snap, options)
  if options.old then return shape.structure(options.old) end
  if snap.structure then return snap.structure end
  local lines = {}
  for _, at in ipairs(shape.of(fsm).places) do
    local name = migrate.part_of(snap, at.prefix).chart
    local chart = not name and shape.of(at.machine).chart or shape.named(name)
    if not chart then return nil end
    shape.append(lines, at.prefix, chart)
  end
  return lines
end

local UNKNOWN = " (the chart of its time is needed: sim and web take that file, a "
  .. "library both under one name, NAME=OLD.lua NAME=NEW.lua; in Lua restore(model, "
  .. "snap, { old = model_of_then }))"

local function missing(lost)
  local list = {}
  for i, text in ipairs(lost) do list[i] = "gone: " .. text end
  list[#list + 1] = "the snapshot holds no structure, that is all that is known"
    .. UNKNOWN
  return list
end

-- Returns a function f(prefix, event): did the machine at this prefix have no such
-- event in the old chart? It returns true if the old chart is not known.
local function new_events(old, rename)
  return function(prefix, event)
    local head = prefix == "root" and "" or prefix .. ": "
    for _, line in ipairs(old) do
      if line:sub(1, #head) == head then
        line = line:gsub("@(root[^,%s]*)", function(fqn)
          return "@" .. renamed_text(fqn, rename)
        end)
        if shape.has_event(line, event) then return false end
      end
    end
    return true
  end
end

-- What `refuse` says of a snapshot that nothing adapts to another structure, and of one
-- that does not fit after that.
migrate.FOREIGN = "the snapshot is of another chart"
local LOST = "the snapshot holds what the chart lacks"

local function refuse(what, list)
  error({ text = what .. ":\n  " .. concat(list, "\n  "), difference = list,
    what = what }, 0)
end

-- Returns a copy of a snapshot, at any depth, for the user's `migrate` to change.
local function copy_all(value)
  if type(value) ~= "table" or encoding.is_null(value) then return value end
  local copy = {}
  for key, inner in each(value) do copy[key] = copy_all(inner) end -- any order: a copy
  return copy
end

-- Unpacks the data of states, so that `migrate` gets the values as callbacks see them.
-- Fields saved as nil become absent. Returns a list of these fields, each as a list
-- { prefix, FQN, name }.
local function unpack_kept(snap)
  local nils = {}
  migrate.each_part(snap, function(part, prefix)
    for fqn, packed in each(part.data or NONE) do -- any order: each is independent
      local fields = encoding.unpack(packed, 2)
      part.data[fqn] = fields
      for name, value in each(type(fields) == "table" and fields or NONE) do
        if rawequal(value, encoding.NIL) then
          nils[#nils + 1], fields[name] = { prefix, fqn, name }, nil
        end
      end
    end
    for fqn, packed in each(part.saved or NONE) do -- any order
      part.saved[fqn] = encoding.unpack(packed, 2)
    end
  end)
  return nils
end

local function pack_all(values, owner)
  for fqn, value in each(values or NONE) do -- any order: each is independent
    values[fqn] = encoding.pack(value, { owner = owner .. text_of(fqn):sub(5),
      seen = false }, 0)
  end
end

-- Packs the data of states again. Each field in the list `nils` is saved as nil again,
-- unless `migrate` has set it or the new chart does not keep it.
local function pack_kept(fsm, snap, nils)
  local chart_at = {}
  for _, at in ipairs(shape.of(fsm).places) do
    chart_at[at.prefix] = shape.of(at.machine).chart
  end
  for _, field in ipairs(nils) do
    local prefix, fqn, name = field[1], field[2], field[3]
    local fields = (migrate.part_of(snap, prefix).data or NONE)[fqn]
    local keeper = chart_at[prefix] and chart_at[prefix].keeper[fqn]
    if fields and fields[name] == nil and keeper and keeper.kept[name] then
      fields[name] = encoding.NIL
    end
  end
  migrate.each_part(snap, function(part, prefix)
    pack_all(part.data, "data of " .. prefix)
    pack_all(part.saved, "what save returned of " .. prefix)
  end)
end

local function call_migrate(fsm, snap, list, options)
  local nils = unpack_kept(snap)
  local moved = options.migrate(snap, list)
  if moved == false then
    refuse("migrate refused the snapshot of another chart", list)
  end
  local is_same = moved == nil or rawequal(moved, snap)
  moved = migrate.checked(is_same and snap or moved)
  if is_same then pack_kept(fsm, moved, nils) end
  return moved
end

-- Compares a snapshot with the charts of a machine and its regions. Returns the gravest
-- change ("structure", "kept" or nil), and a table prefix -> change.
function migrate.changes(fsm, snap)
  local most, by_prefix, count = nil, {}, 0
  for _ in each(snap.regions or NONE) do count = count + 1 end -- any order: counted
  for _, at in ipairs(shape.of(fsm).places) do
    local part = migrate.part_of(snap, at.prefix)
    local change = change_of(at.machine, part)
    by_prefix[at.prefix] = change
    if change == "structure" or not most then most = change end
    if part ~= NONE and part ~= snap then count = count - 1 end
  end
  return most or count > 0 and "kept" or nil, by_prefix
end

local changes = migrate.changes

-- Returns the lines of the transitions of each composite, by its place, with new names:
-- the numbered members of a composite are the first ones behind its line.
local function transitions_in(lines, rename)
  local head, new_head, inner, list, by_place = "", "", rename, {}, {}
  local function renamed_word(word) return renamed_text(word, inner) end
  for _, line in ipairs(lines) do
    local begun = line:match("^(.-)state root$")
    if begun and begun ~= "" then -- a region
      inner, new_head = inside(rename, begun:sub(1, -3))
      head, new_head = begun, new_head .. ": "
    end
    local text = line:sub(#head + 1):gsub("[^%s,]+", renamed_word)
    local fqn = text:match("^state (.*)$")
    list = fqn and {} or list
    if fqn then by_place[new_head .. fqn] = list end
    if text:find(" -> ", 1, true) then list[#list + 1] = text end
  end
  return by_place
end

-- Returns the number that the transition of an old line has in a new list; nil if it is
-- gone. Another event does not make it another transition.
local function number_in(list, line, number)
  if list[number] == line then return number end
  for i, text in ipairs(list) do
    if text == line then return i end
  end
  local ends = "^.- %-> %S*"
  return (list[number] or ""):match(ends) == line:match(ends) and number or nil
end

-- A changed target is kept by the number of its transition, which another chart may
-- have given to another one. Returns the targets with the new numbers.
local function follow(targets, head, before, after)
  local list = {}
  for i = 1, targets and #targets or 0, 3 do
    local fqn, id, node = targets[i], targets[i + 1], targets[i + 2]
    local line = (before[head .. text_of(fqn)] or NONE)[id]
    if line then id = number_in(after[head .. text_of(fqn)] or NONE, line, id) end
    local n = #list
    if id ~= nil then list[n + 1], list[n + 2], list[n + 3] = fqn, id, node end
  end
  return list[1] and list
end

-- Gives the targets in a snapshot the numbers that they have in the present chart.
local function follow_transitions(fsm, snap, old, rename)
  local before, after = transitions_in(old, rename),
    transitions_in(shape.lines_of(fsm), NONE)
  migrate.each_part(snap, function(part, prefix)
    part.targets = follow(part.targets, location.prefix(prefix), before, after)
  end)
end

local function check_lost(fsm, snap, is_unknown)
  local lost = migrate.lost(fsm, snap, is_unknown)
  if lost[1] then refuse(LOST .. (is_unknown and UNKNOWN or ""), lost) end
end

-- Fits a snapshot of another chart to a machine. Returns the results of `migrate.to`.
local function adapt(fsm, snap, options, most)
  local old = known_lines(fsm, snap, options)
  local list = old and migrate.difference(old, shape.lines_of(fsm))
    or missing(migrate.lost(fsm, snap))
  if most == "structure" and not (options.rename or options.migrate) then
    refuse(migrate.FOREIGN, list)
  end
  local rename, before = options.rename or NONE, old or NONE
  snap = rename_states(copy_all(snap), rename)
  follow_transitions(fsm, snap, before, rename)
  if options.migrate then snap = call_migrate(fsm, snap, list, options) end
  check_lost(fsm, snap, not old and most == "structure")
  return snap, select(2, changes(fsm, snap)), new_events(before, rename)
end

--- Return a copy of a snapshot that fits the chart of a machine. Raises an error if a
-- field is wrong, or if the snapshot is of another chart and cannot be changed to fit;
-- the error lists the differences, or the data that would be lost.
---@return rfsm.snapshot.Snapshot snap
---@return table<string, string>? changes "kept" or "structure" by prefix; nil if the
-- snapshot is of the same chart
---@return fun(prefix: string, event: string)? is_new is the event new in this machine?
function migrate.to(fsm, snap, options)
  local given = migrate.checked(snap)
  local most = changes(fsm, given)
  if most then return adapt(fsm, given, options, most) end
  return given
end

return migrate
