-- A Lua of its own inside this one, as each component of RTT-Lua has it: globals,
-- loaded modules and package.path are its own; what other Luas have is not in reach.

local setfenv = rawget(_G, "setfenv")
local load_text = rawget(_G, "loadstring") or rawget(_G, "load")

local FUNCTIONS = {
  "assert", "collectgarbage", "error", "getmetatable", "ipairs", "next", "pairs",
  "pcall", "rawequal", "rawget", "rawlen", "rawset", "select", "setmetatable",
  "tonumber", "tostring", "type", "unpack", "xpcall", "_VERSION",
}
local LIBRARIES = {
  "bit", "bit32", "coroutine", "debug", "io", "jit", "math", "os", "string", "table",
  "utf8",
}

-- Stands in for an exception of C++, which goes through Lua without a trace: no pcall
-- catches it, and a coroutine that it went through is never resumed again.
local EXCEPTION = {}

local function pass(ok, problem, ...)
  if not ok and problem == EXCEPTION then error(EXCEPTION, 0) end
  return ok, problem, ...
end

local function let_exceptions_pass(globals)
  local passed, threads = setmetatable({}, { __mode = "k" }), globals.coroutine
  local resume, status = threads.resume, threads.status
  function globals.pcall(...) return pass(pcall(...)) end
  function globals.xpcall(...) return pass(xpcall(...)) end
  function threads.resume(thread, ...)
    if passed[thread] then return false, "cannot resume non-suspended coroutine" end
    passed[thread] = true
    return (function(...)
      passed[thread] = (...) == false and select(2, ...) == EXCEPTION or nil
      return pass(...)
    end)(resume(thread, ...))
  end
  function threads.status(thread)
    return passed[thread] and coroutine.running() ~= thread and "normal"
      or status(thread)
  end
end

---@class LuaState
---@field globals table
local LuaState = {}
LuaState.__index = LuaState

-- Compiles a text whose globals are those of `globals`; nil and why when it is wrong.
local function compile(globals, text, name, mode)
  local chunk, problem = load_text(text, name, mode or "t", globals)
  if chunk and setfenv then setfenv(chunk, globals) end
  return chunk, problem
end

local compiled = {} -- name and text of a file -> its bytecode, for the next state

local function load_file(globals, name)
  local file, problem = io.open(name)
  if not file then return nil, "cannot open " .. problem end
  local text = file:read("*a")
  file:close()
  local key = name .. "\n" .. text
  if compiled[key] then return compile(globals, compiled[key], "@" .. name, "b") end
  local chunk, why = compile(globals, text, "@" .. name)
  compiled[key] = chunk and string.dump(chunk)
  return chunk, why
end

-- Returns the file of a module, or nil and the text of the error.
local function find_module(package, name)
  local tried = {}
  for template in package.path:gmatch("[^;]+") do
    local path = template:gsub("%?", (name:gsub("%.", "/")))
    local file = io.open(path)
    if file then
      file:close()
      return path
    end
    tried[#tried + 1] = "\n\tno file '" .. path .. "'"
  end
  return nil, "module '" .. name .. "' not found:" .. table.concat(tried)
end

local function require_in(globals, name)
  local package = globals.package
  if package.loaded[name] ~= nil then return package.loaded[name] end
  local loader, extra = package.preload[name], nil
  if not loader then
    local path, problem = find_module(package, name)
    if not path then error(problem, 3) end
    loader, extra = assert(load_file(globals, path)), path
  end
  local value = loader(name, extra)
  if value ~= nil then package.loaded[name] = value end
  if package.loaded[name] == nil then package.loaded[name] = true end
  return package.loaded[name]
end

local function copy(t)
  local result = {}
  for key, value in pairs(t) do result[key] = value end -- any order: a copy
  return result
end

local function add_libraries(globals)
  globals._G = globals
  globals.package = {
    path = package.path, cpath = package.cpath, config = package.config, preload = {},
    loaded = { _G = globals },
  }
  for _, name in ipairs(FUNCTIONS) do globals[name] = rawget(_G, name) end
  for _, name in ipairs(LIBRARIES) do
    local library = rawget(_G, name)
    globals[name] = library and copy(library)
    globals.package.loaded[name] = globals[name]
  end
end

local function add_loaders(globals)
  function globals.print(...) rawget(_G, "print")(...) end -- specs replace it
  function globals.require(name) return (require_in(globals, name)) end
  function globals.loadfile(name) return load_file(globals, name) end
  function globals.dofile(name) return assert(load_file(globals, name))() end
  if setfenv then -- Lua 5.1
    function globals.loadstring(text, name)
      return compile(globals, text, name, "bt")
    end
  else
    function globals.load(text, name, mode, env)
      return compile(env or globals, text, name, mode or "bt")
    end
  end
end

--- Runs a text; returns whether that went well, and why not.
function LuaState:run(text, name)
  local chunk, problem = compile(self.globals, text, name or text)
  if not chunk then return false, problem end
  return pcall(chunk)
end

--- Runs a file, likewise.
function LuaState:run_file(name)
  local chunk, problem = load_file(self.globals, name)
  if not chunk then return false, problem end
  return pcall(chunk)
end

--- Calls a global function, likewise; returns its first result when it went well.
function LuaState:call(name) return pcall(self.globals[name]) end

local lua_state = { EXCEPTION = EXCEPTION }

--- A fresh Lua; with `has_exceptions` those of C++ go through it.
---@param has_exceptions? boolean
---@return LuaState
function lua_state.new(has_exceptions)
  local state = setmetatable({ globals = {} }, LuaState)
  add_libraries(state.globals)
  if has_exceptions then let_exceptions_pass(state.globals) end
  add_loaders(state.globals)
  return state
end

return lua_state
