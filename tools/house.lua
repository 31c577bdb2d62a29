-- The floors of the house: LUA tools/house.lua prints them, their rooms with their
-- lines of Lua, and the arrows from each room to those that it requires.
--
-- A room is a file, and the folder of its name. A name of a module in a string counts
-- as required, also in a table of modules that are loaded later. Comments do not count,
-- nor do texts in long brackets, which are programs of their own. Files of one line,
-- which give a module another name, are in no room.
--
-- spec/floors_spec.lua says what must hold.

local files = require "rfsm.shared.files"

local house = {}

-- From the ground up. A room requires those below it, and of its own floor. A file in
-- rfsm/ that is not listed, and has no folder, is an extension.
house.FLOORS = {
  { name = "engine", "engine" },
  { name = "extensions", "shared", "clock", "timeevent", "seqand", "pp" },
  { name = "rooms", "marsh", "pictures", "snapshot", "record", "checks", "explore",
    "observe", "tests", "rfsm_checks", "server", "system" }, -- and the exporters
  { name = "hosts", "rtt", "proto", "redis", "postgres", "sim", "web" },
  { name = "command", "cli" },
}

for _, exporter in ipairs(require("rfsm.cli.exporters").list) do
  table.insert(house.FLOORS[3], exporter.name)
end

-- Files whose room is not their name.
local ROOM_OF = {
  ["rfsm.lua"] = "engine", ["rfsm/fast.lua"] = "engine", ["rfsm/advice.lua"] = "engine",
  ["rfsm/tools.lua"] = "engine", ["rfsm/merge.lua"] = "engine",
  ["rfsm/prepare.lua"] = "engine", ["rfsm/fates.lua"] = "engine",
  ["rfsm/always.lua"] = "engine",
  ["rfsm_checks.lua"] = "rfsm_checks", -- the public face of several rooms
  ["rfsm/fleet.lua"] = "redis", -- the clients of its functions
}

--- Return the room of a file, such as "sim" of rfsm/sim/prompt.lua.
function house.room_of(file)
  return ROOM_OF[file] or file:match("^rfsm/([%w_]+)")
    or file:match("^rfsm_?([%w_]+)%.lua$")
end

--- Return the number of the floor of a room; nil if it has none.
function house.floor_of(room)
  for number, floor in ipairs(house.FLOORS) do
    for _, name in ipairs(floor) do
      if name == room then return number end
    end
  end
end

local function lines_of(command)
  local lines, pipe = {}, assert(io.popen(command))
  for line in pipe:lines() do lines[#lines + 1] = line end
  pipe:close()
  return lines
end

-- What strings and comments begin with, and the pattern of the whole.
local PIECES = {
  { "^%-%-%[(=*)%[", "^%-%-%[(=*)%[.-%]%1%]" }, { "^%-%-", "^%-%-[^\n]*" },
  { "^%[(=*)%[", "^%[(=*)%[.-%]%1%]" },
}

-- Returns the end of a string that begins at `from`.
local function end_of_string(text, from)
  local quote, at = text:sub(from, from), from + 1
  while text:sub(at, at) ~= quote do
    at = at + (text:sub(at, at) == "\\" and 2 or 1)
  end
  return at
end

local function end_of_piece(text, from)
  for _, piece in ipairs(PIECES) do
    if text:find(piece[1], from) then return (select(2, text:find(piece[2], from))) end
  end
  return from
end

--- List the short strings of a program.
function house.strings_of(text)
  local strings, at = {}, 1
  while true do
    local from = text:find("[\"'%-%[]", at)
    if not from then return strings end
    local is_string = text:find("^[\"']", from)
    local to = is_string and end_of_string(text, from) or end_of_piece(text, from)
    if is_string then strings[#strings + 1] = text:sub(from + 1, to - 1) end
    at = to + 1
  end
end

-- Returns the module to which a file of one line gives another name; nil for others.
local function target_of(text)
  return text:match('^return require%("([^"]*)"%)[^\n]*\n$')
end

local FILES = "ls rfsm*.lua rfsm/*.lua rfsm/*/*.lua compat/*.lua"

--- Read the tree: its files, { file, room, floor, lines, names }, and the file of each
--- module's name. `names` are the names of modules in a file, without its own.
function house.read()
  local entries, file_of, aliases = {}, {}, {}
  for _, file in ipairs(lines_of(FILES)) do
    local text = assert(files.read(file))
    local name = file:gsub("^compat/", ""):gsub("%.lua$", ""):gsub("/", ".")
    local target = target_of(text)
    if target then
      aliases[#aliases + 1] = { name = name, target = target }
    else
      file_of[name] = file
      local room = house.room_of(file)
      if file == "rfsm/" .. room .. ".lua" and not house.floor_of(room) then
        table.insert(house.FLOORS[2], room)
      end
      entries[#entries + 1] = { file = file, room = house.room_of(file), text = text,
        lines = select(2, text:gsub("\n", "")) }
    end
  end
  for _, alias in ipairs(aliases) do file_of[alias.name] = file_of[alias.target] end
  for _, entry in ipairs(entries) do
    entry.names, entry.floor = {}, house.floor_of(entry.room)
    for _, name in ipairs(house.strings_of(entry.text)) do
      local is_other = file_of[name] and file_of[name] ~= entry.file
      if is_other then entry.names[#entry.names + 1] = name end
    end
  end
  return entries, file_of
end

--- List the arrows between files: { from, to, name }, where both are entries.
function house.arrows(entries, file_of)
  local entry_of, arrows = {}, {}
  for _, entry in ipairs(entries) do entry_of[entry.file] = entry end
  for _, entry in ipairs(entries) do
    for _, name in ipairs(entry.names) do
      arrows[#arrows + 1] = { from = entry, to = entry_of[file_of[name]], name = name }
    end
  end
  return arrows
end

--- Return the rooms that each room requires, as lists by name, in the order of floors.
function house.rooms_below(arrows)
  local has, below = {}, {}
  for _, arrow in ipairs(arrows) do
    local from, to = arrow.from.room, arrow.to.room
    has[from] = has[from] or {}
    if from ~= to then has[from][to] = true end
  end
  for room, targets in pairs(has) do -- any order: each stands alone
    below[room] = {}
    for _, floor in ipairs(house.FLOORS) do
      for _, name in ipairs(floor) do
        if targets[name] then below[room][#below[room] + 1] = name end
      end
    end
  end
  return below
end

-- Prints the floors, the highest first.
local function print_house()
  local entries, file_of = house.read()
  local below, lines, total = house.rooms_below(house.arrows(entries, file_of)), {}, 0
  for _, entry in ipairs(entries) do
    lines[entry.room] = (lines[entry.room] or 0) + entry.lines
    total = total + entry.lines
  end
  for number = #house.FLOORS, 1, -1 do
    local floor = house.FLOORS[number]
    print(("%d %s"):format(number, floor.name))
    for i = #floor, 1, -1 do
      local room = floor[i]
      if lines[room] then
        print(("  %-12s%6d  -> %s"):format(room, lines[room],
          table.concat(below[room] or {}, " ")))
      end
    end
  end
  print(("%d lines"):format(total))
end

if arg and arg[0] and arg[0]:find("tools/house%.lua$") then print_house() end

return house
