-- The core, loaded anew with another compiler of texts.

local rfsm = require "rfsm"

local compiling = {}

--- Runs f(core) with a core that compiles texts with `compiler`, or has no compiler.
function compiling.with(compiler, f)
  local real = { load = rawget(_G, "load"), loadstring = rawget(_G, "loadstring") }
  package.loaded.rfsm = nil
  rawset(_G, "load", compiler)
  rawset(_G, "loadstring", compiler)
  local ok, problem = pcall(function()
    local core = dofile "rfsm.lua"
    rawset(_G, "load", real.load)
    rawset(_G, "loadstring", real.loadstring)
    f(core)
  end)
  rawset(_G, "load", real.load)
  rawset(_G, "loadstring", real.loadstring)
  package.loaded.rfsm = rfsm
  rawset(_G, "rfsm", rfsm)
  if not ok then error(problem, 0) end
end

local setfenv = rawget(_G, "setfenv")
local load = rawget(_G, "loadstring") or rawget(_G, "load")

--- Compiles a text that must use no global.
function compiling.strictly(text, name)
  local no_globals = setmetatable({}, {
    __index = function(_, key) error("a global is read: " .. tostring(key)) end,
    __newindex = function(_, key) error("a global is set: " .. tostring(key)) end,
  })
  if not setfenv then return load(text, name, "t", no_globals) end
  local chunk, problem = load(text, name)
  return chunk and setfenv(chunk, no_globals), problem
end

return compiling
