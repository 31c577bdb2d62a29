-- The core, loaded anew: with another compiler of texts, or without a module.

local compiling = {}

-- Returns the names of the modules of rfsm that are loaded.
local function loaded_names()
  local names = {}
  for name in pairs(package.loaded) do -- any order: a set
    if name:find("^rfsm") then names[#names + 1] = name end
  end
  return names
end

--- Runs f() where no module of rfsm is loaded. Afterwards those of before are back.
function compiling.anew(f)
  local loaded, global = {}, rawget(_G, "rfsm")
  for _, name in ipairs(loaded_names()) do
    loaded[name], package.loaded[name] = package.loaded[name], nil
  end
  local ok, problem = pcall(f)
  for _, name in ipairs(loaded_names()) do package.loaded[name] = nil end
  for name, module in pairs(loaded) do package.loaded[name] = module end -- a set
  rawset(_G, "rfsm", global)
  if not ok then error(problem, 0) end
end

--- Runs f(core) with a core that compiles texts with `compiler`, or has no compiler.
function compiling.with(compiler, f)
  local real = { load = rawget(_G, "load"), loadstring = rawget(_G, "loadstring") }
  compiling.anew(function()
    rawset(_G, "load", compiler)
    rawset(_G, "loadstring", compiler)
    local ok, core = pcall(dofile, "rfsm.lua")
    rawset(_G, "load", real.load)
    rawset(_G, "loadstring", real.loadstring)
    if not ok then error(core, 0) end
    f(core)
  end)
end

--- Runs f(core) with a core for which the library or module `name` is missing.
function compiling.without(name, f)
  local library, preload = rawget(_G, name), package.preload[name]
  rawset(_G, name, nil)
  package.preload[name] = function() error("module '" .. name .. "' not found", 0) end
  local ok, problem = pcall(compiling.anew, function() f(require "rfsm") end)
  rawset(_G, name, library)
  package.preload[name] = preload
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
