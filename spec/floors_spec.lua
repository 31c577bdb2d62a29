-- The floors of the house: who may require whom. tools/house.lua reads it.

local helper = require "spec.helper"
local house = require "tools.house"

local files, file_of = house.read()
local arrows = house.arrows(files, file_of)

-- Names above that the engine has: fields that are loaded when they are read, or by a
-- field of the chart, and words in hints.
local KNOWN_ABOVE = {
  ["rfsm.lua rfsm_seqand"] = true, ["rfsm.lua rfsmpp"] = true,
  ["rfsm.lua rfsm.strict"] = true, ["rfsm/advice.lua rfsm_timeevent"] = true,
  ["rfsm/advice.lua rfsm.await"] = true, ["rfsm/advice.lua rfsm.faults"] = true,
}

-- Lists the arrows for which `pred` holds, as "rfsm/a.lua -> rfsm.b".
local function arrows_where(pred)
  local found = {}
  for _, arrow in ipairs(arrows) do
    if pred(arrow.from, arrow.to, arrow.name) then
      found[#found + 1] = arrow.from.file .. " -> " .. arrow.name
    end
  end
  return found
end

-- Rooms on the floor of extensions that are none.
local NO_EXTENSION = { shared = true, clock = true }

local function is_extension(entry)
  return entry.floor == 2 and not NO_EXTENSION[entry.room]
end

-- Lists the rooms that come back to themselves, each with the rooms of its way.
local function circles()
  local below, found = house.rooms_below(arrows), {}
  local function follow(room, goal, way, is_seen)
    for _, next_room in ipairs(below[room] or {}) do
      local further = way .. " -> " .. next_room
      if next_room == goal then
        found[#found + 1] = further
      elseif not is_seen[next_room]
        and house.floor_of(next_room) == house.floor_of(goal) then
        is_seen[next_room] = true
        follow(next_room, goal, further, is_seen)
      end
    end
  end
  for _, floor in ipairs(house.FLOORS) do
    for _, room in ipairs(floor) do follow(room, room, room, {}) end
  end
  return found
end

describe("tools/house.lua", function()
  it("reads strings, but neither comments nor texts in long brackets", function()
    local strings = house.strings_of([==[
local a = require "one" -- require "no"
--[[ require "no" ]] local b = f('two', "th\"ree")
local text = [=[ require "no" ]=] .. t["four"] .. "five." .. name
]==])
    assert.same({ "one", "two", 'th\\"ree', "four", "five." }, strings)
  end)

  it("knows modules by each of their names", function()
    for name, file in pairs { ["rfsm.emem"] = "rfsm/emem.lua",
      rfsm_emem = "rfsm/emem.lua", ["rfsm.seqand"] = "rfsm_seqand.lua",
      ["rfsm.cli.check"] = "rfsm/cli/check.lua" } do
      assert.equal(file, file_of[name])
    end
  end)

  it("prints each floor with its rooms", function()
    local lines = helper.lines_of(arg[-1] .. " tools/house.lua")
    assert.equal("5 command", lines[1])
    assert.matches("^  cli +%d+  %-> .*web", lines[2])
    assert.matches("^%d+ lines$", lines[#lines])
  end)
end)

describe("the house", function()
  it("has each file in a room of a floor", function()
    for _, entry in ipairs(files) do assert.is_truthy(entry.floor, entry.file) end
  end)

  it("has no arrow up", function()
    assert.same({}, arrows_where(function(from, to, name)
      return from.floor < to.floor and not KNOWN_ABOVE[from.file .. " " .. name]
    end))
  end)

  it("has no circle between the rooms of a floor", function()
    assert.same({}, circles())
  end)

  it("has no extension that requires another", function()
    assert.same({}, arrows_where(function(from, to)
      return is_extension(from) and is_extension(to) and from.room ~= to.room
    end))
  end)

  it("has no product that requires another", function()
    assert.same({}, arrows_where(function(from, to)
      return from.floor == 4 and to.floor == 4 and from.room ~= to.room
    end))
  end)

  it("has rfsm_checks required by no room below the hosts", function()
    assert.same({}, arrows_where(function(from, to)
      return to.file == "rfsm_checks.lua" and from.floor < 4
    end))
  end)

  it("has no two parts of one name", function()
    local by_name, twice = {}, {}
    for _, entry in ipairs(files) do
      local name = entry.file:match("^rfsm/[^/]*/([^/]*)%.lua$")
      if name and by_name[name] then
        twice[#twice + 1] = by_name[name] .. ", " .. entry.file
      end
      if name then by_name[name] = entry.file end
    end
    assert.same({}, twice)
  end)
end)
