--- Find the files and modules of a chart beside its file, from any current directory.
--
-- In the code of a chart, `require`, `rfsm.load`, `dofile` and `loadfile` look in the
-- folder of the chart, then in its parent, then where they always do. The code of a
-- chart is its file, and each file that was found in these folders. If the chart is
-- loaded with stubs, its code gets a stub for a module or file that is not found, and
-- stubs in place of the functions `os.execute`, `os.exit` and `io.popen`.
--
-- @module rfsm.shared.search
-- @license BSD-3-Clause

local order = require "rfsm.shared.order"
local rfsm = require "rfsm"
local stubs = require "rfsm.shared.stubs"

local _G, error, io, ipairs, loadfile = _G, error, io, ipairs, loadfile
local os, package, rawget, rawset = os, package, rawget, rawset
local type = type
local getinfo = rawget(_G, "debug") and rawget(_G, "debug").getinfo
local insert = table.insert

local search = {}

--- A world: what belongs to one loaded chart, such as its folders, stubs and machines.
---@class rfsm.shared.World
---@field source string the `source` of functions in its file, as debug.getinfo has it
---@field folders string[] folders in which files are looked for
---@field has_stubs boolean the chart is loaded with stubs
---@field insists boolean an absent global is a stub also if the code tests for it
---@field is_late boolean the loading took too long
---@field names string[] names of the stubs, in the order in which they were needed
---@field stubs table<string, table> stubs, by name
---@field models rfsm.State[] models of the machines that the code makes
---@field places table<integer, string> file and line of each valid model
---@field is_made table<rfsm.Machine, true> the machines that the code has made
---@field depth integer how many machines are being made now, nested as regions
---@field is_halted boolean loading was ended at the first step of a machine
---@field number? integer which of the machines is to be loaded
local current = nil ---@type rfsm.shared.World? of the chart that is being loaded
local latest = nil ---@type rfsm.shared.World? of the chart that was loaded last

local world_of_source = {} -- worlds, by the sources of their code
local found = {} -- module -> true if it is a stub, false if a file beside the chart
local found_for = nil -- the folder of the chart for which modules in `found` were found

-- Stubs -----------------------------------------------------------------------

--- Return the stub of a name in the world of a chart, the same stub at each call.
function search.stub(world, name)
  if not world.stubs[name] then
    world.names[#world.names + 1] = name
    world.stubs[name] = stubs.new(name)
  end
  return world.stubs[name]
end

-- Files -----------------------------------------------------------------------

--- Does a file exist?
function search.exists(name)
  local handle = io.open(name)
  return handle ~= nil and handle:close() ~= nil
end

local exists = search.exists

-- Returns the parent of a folder; both end with a slash, or are "".
local function parent_of(folder)
  local parent, last = folder:match("^(.-)([^/]+)/$")
  if parent and last ~= "." and last ~= ".." then return parent end
  return folder .. "../"
end

local function find(world, name)
  if name:find("^/") then return exists(name) and name or nil end
  for _, folder in ipairs(world.folders) do
    if exists(folder .. name) then return folder .. name end
  end
end

-- Returns the path of a file. With stubs, the file is also looked for without its
-- folders, since these may exist only on a robot.
local function find_file(world, name)
  local file = find(world, name)
  if file or not world.has_stubs or exists(name) then return file end
  return find(world, name:match("[^/]*$"))
end

local function adopt(world, file)
  world_of_source["@" .. file] = world
  return file
end

-- Returns the world to which the code at a level of the stack belongs. If it belongs to
-- none, or is not known after a tail call, returns the world that is being loaded.
local function world_at(level)
  local info = getinfo and getinfo(level + 1, "S")
  return info and world_of_source[info.source] or current
end

-- Functions that load a file ------------------------------------------------------

-- Replaces a function that loads a file: the new one looks beside the chart first.
local function wrap(owner, key, new_stub)
  local plain = owner[key]
  rawset(owner, key, function(file, ...)
    local world = world_at(2)
    local name = world and (stubs.name_of(file) or file)
    if type(name) ~= "string" then return plain(file, ...) end
    local path = find_file(world, name:match('"([^"]*)"%)$') or name)
    if path then return plain(adopt(world, path), ...) end
    local is_chart = world.source == "@" .. name
    if is_chart or not world.has_stubs or exists(name) then return plain(file, ...) end
    if name == file then search.stub(world, name) end
    return new_stub(name)
  end)
end

-- Functions that act on the system --------------------------------------------------

-- Replaces a function of Lua: if the code of a chart with stubs calls it, a stub is
-- called. A caller that is not known (tail call, `pcall`) is taken for the last chart.
local function hold_back(owner, key, name)
  local plain = rawget(owner, key)
  rawset(owner, key, plain and function(...)
    local info = getinfo and getinfo(2, "S")
    local is_unknown = not info or info.source:find("^=")
    local world = world_at(2) or is_unknown and latest
    if not (world and world.has_stubs) then return plain(...) end
    return search.stub(world, name)(...)
  end)
end

-- Modules -------------------------------------------------------------------------

local function load_beside(world, name)
  local file = name:gsub("%.", "/")
  local path = find(world, file .. ".lua") or find(world, file .. "/init.lua")
  if not path then return nil end
  found[name] = false
  local chunk, problem = loadfile(adopt(world, path))
  return chunk or error(problem, 0)
end

-- The searcher before the searchers of Lua. It leaves modules of this library to them.
local function search_first(name)
  local world = not name:find("^rfsm") and world_at(3)
  return world and load_beside(world, name) or nil
end

-- The searcher after the searchers of Lua. It returns no stub to a chart that calls
-- `pcall(require, ...)`, since such a chart can do without the module.
local function search_last(name)
  local world = world_at(3)
  local loader = world and load_beside(world, name)
  if loader or not (world and world.has_stubs) then return loader end
  local info = getinfo(3, "S")
  if not world_of_source[info.source] then return nil end
  found[name] = true
  return function() return search.stub(world, name) end
end

local is_installed = false

local function install()
  if is_installed or not package then return end
  is_installed = true
  local searchers = rawget(package, "searchers") or rawget(package, "loaders")
  insert(searchers, 2, search_first)
  searchers[#searchers + 1] = search_last
  wrap(rfsm, "load", stubs.new_state)
  wrap(_G, "dofile", stubs.new)
  wrap(_G, "loadfile", stubs.new)
  hold_back(os, "execute", "os.execute")
  hold_back(os, "exit", "os.exit")
  hold_back(io, "popen", "io.popen")
end

-- Forgets stubs, and modules that were found beside a chart in another folder, so that
-- `require` looks for them again.
local function forget(folder)
  for name, is_stub in order.each(found) do -- any order: each stands alone
    if is_stub or found_for ~= folder then
      package.loaded[name], found[name] = nil, nil
    end
  end
  found_for = folder
end

-- Public functions ----------------------------------------------------------------

--- Begin to load a chart, and return its world. `search.leave` ends the loading.
---@param file string
---@param source string the `source` that debug.getinfo has for functions in the file
---@param has_stubs? boolean
function search.enter(file, source, has_stubs)
  install()
  stubs.forget()
  local folder = file:match("^.*/") or ""
  forget(folder)
  current = {
    source = source, folders = { folder, parent_of(folder) },
    has_stubs = has_stubs or false, insists = false, is_late = false,
    names = {}, stubs = {}, models = {}, places = {}, is_made = {}, depth = 0,
    is_halted = false,
  }
  world_of_source[source], latest = current, current
  return current
end

--- End the loading of a chart.
function search.leave() current = nil end

--- Return the world of the chart to which code with this source belongs, or nil.
function search.world_of(source) return world_of_source[source] end

return search
