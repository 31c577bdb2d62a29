--- Files and modules of a chart: they are found beside its file, from any directory.
--
-- In the code of a chart, `require`, `rfsm.load`, `dofile` and `loadfile` look in the
-- folder of the chart, then in its parent, then where they always do. The code of a
-- chart is its file and each file that was found so. If the chart is loaded with stubs,
-- a module or file that is not found becomes a stub, and so do the functions
-- `os.execute`, `os.exit` and `io.popen` for the code of the chart.
--
-- @module rfsm.shared.search
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local stubs = require "rfsm.shared.stubs"

local _G, error, io, ipairs, loadfile = _G, error, io, ipairs, loadfile
local os, package, pairs, rawget, rawset = os, package, pairs, rawget, rawset
local type = type
local getinfo = rawget(_G, "debug") and rawget(_G, "debug").getinfo
local insert = table.insert

local search = {}

--- The folders and stubs of a chart.
---@class rfsm.shared.World
---@field source string of its file
---@field folders string[] that are searched
---@field has_stubs boolean the chart is loaded with stubs
---@field insists boolean a global is a stub also where the code asks if it exists
---@field is_late boolean the loading took too long
---@field names string[] of the stubs, in the order in which they were needed
---@field stubs table<string, table> by name
---@field models rfsm.State[] of the machines that the code makes
---@field places table<integer, string> the lines of these models, if they are valid
---@field is_made table<rfsm.Machine, true> the machines that the code has made
---@field depth integer how many machines are being made, each as a region of the other
---@field is_halted boolean loading was ended at the first step of a machine
---@field number? integer of the machine that is wanted
local current = nil ---@type rfsm.shared.World? of the chart that is being loaded
local latest = nil ---@type rfsm.shared.World? of the chart that was loaded last

local world_of_source = {} -- worlds, by the sources of their code
local found = {} -- by module: true for a stub, false for one found beside the chart
local found_for = nil -- the folder of the chart for which these were found

-- Stubs -----------------------------------------------------------------------

--- Return the stub of a name in a world: the same each time.
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

-- Returns the path of a file. With stubs, a file without its folders is found, too,
-- since these may exist on a robot only.
local function find_file(world, name)
  local file = find(world, name)
  if file or not world.has_stubs or exists(name) then return file end
  return find(world, name:match("[^/]*$"))
end

local function adopt(world, file)
  world_of_source["@" .. file] = world
  return file
end

-- Returns the world of the code at a level of the stack; if that code belongs to none,
-- or was left by a tail call, the world of the chart that is being loaded.
local function world_at(level)
  local info = getinfo and getinfo(level + 1, "S")
  return info and world_of_source[info.source] or current
end

-- Functions that load a file ------------------------------------------------------

-- Replaces a function that loads a file by one that looks beside the chart first.
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

-- Replaces a function of Lua by one that calls a stub if a chart with stubs calls it.
-- If the caller is in no file (after a tail call, in `pcall`), the latest chart counts.
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

-- The searcher in front of Lua's own. Modules named rfsm... are this library's.
local function search_first(name)
  local world = not name:find("^rfsm") and world_at(3)
  return world and load_beside(world, name) or nil
end

-- The searcher behind Lua's own. A chart that calls `pcall(require, ...)` can do
-- without the module, and gets no stub.
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

-- Forgets stubs, and modules that were found beside a chart in another folder.
local function forget(folder)
  for name, is_stub in pairs(found) do -- any order: each stands alone
    if is_stub or found_for ~= folder then
      package.loaded[name], found[name] = nil, nil
    end
  end
  found_for = folder
end

-- Public functions ----------------------------------------------------------------

--- Begin to load a chart, whose code has this source; `search.leave` ends that.
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

--- Return the chart to which code with this source belongs; nil if there is none.
function search.world_of(source) return world_of_source[source] end

return search
