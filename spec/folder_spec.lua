-- The library in a folder of a program: `require "libs.rfsm"`, and nothing on the path.

local helper = require "spec.helper"
local share = require "spec.support.share"

after_each(helper.remove_files)

local folder = os.tmpname()

-- What no program loads: types for the editor.
local NO_MODULES = { ["rfsm.shared.types"] = true }

-- All modules by their names below libs/, those in compat/ with their flat names, too.
local function all_modules()
  local names = {}
  for _, file in ipairs(helper.lines_of("ls rfsm*.lua rfsm/*.lua rfsm/*/*.lua "
    .. "compat/*.lua")) do
    local name = file:gsub("^compat/", ""):gsub("%.lua$", ""):gsub("/", ".")
    if not NO_MODULES[name] then names[#names + 1] = name end
  end
  return names
end

-- What each program below begins with: its path is the folder of the program alone.
-- Packages in C and those of Debian may be missing; modules of the library may not.
local HEAD = [[
package.path, package.cpath = "%s/?.lua", ""
local function forget()
  local searchers = package.searchers or package.loaders
  for i = #searchers, 1, -1 do
    if searchers[i] == searchers.rfsm then table.remove(searchers, i) end
  end
  searchers.rfsm = nil
  for _, t in ipairs { package.loaded, package.preload, _G } do
    for name in pairs(t) do
      if type(name) == "string" and name:find "rfsm" then t[name] = nil end
    end
  end
end
local function try(f, ...)
  local ok, problem = pcall(f, ...)
  if ok then return problem end
  problem = tostring(problem)
  local is_missing = problem:find "module '[^']*' not found"
  if is_missing and not problem:find "module '[^']*rfsm" then return end
  print((problem:match "[^\n]*"))
end
]]

local function output_of(text)
  return helper.output_of(HEAD:format(folder) .. text .. "\nprint 'done'")
end

-- A machine with a timer, with which a program shows that the library works.
local USE = [[
local now = 0
local fsm = assert(rfsm.init(rfsm.state { info = false, warn = false,
  gettime = function() now = now + 1 return now, 0 end,
  a = rfsm.state {}, b = rfsm.state {}, rfsm.trans { src = "initial", tgt = "a" },
  rfsm.trans { src = "a", tgt = "b", events = { "e_after(0.5)" } } }))
for _ = 1, 3 do rfsm.run(fsm) end
print(rfsm.get_actleaf_fqn(fsm))
]]

describe("a library in a folder of the program", function()
  setup(function()
    os.remove(folder)
    os.execute(("mkdir -p '%s/libs' '%s/top/libs' && cp -r rfsm*.lua rfsm compat "
      .. "'%s/libs' && cp rfsm*.lua '%s/top/libs'"):gsub("%%s", folder))
  end)

  teardown(function() os.execute("rm -r '" .. folder .. "'") end)

  it("loads every module, one copy, by its name with and without the folder", function()
    assert.equal("done", output_of(([[
      for name in ("%s"):gmatch("%%S+") do
        for _, first in ipairs { "", "libs." } do
          forget()
          require "libs.rfsm"
          local module = try(require, first .. name)
          local other = module and require("libs." .. name)
          if module and (require(name) ~= module or other ~= module) then
            print(first .. name .. " is there twice")
          end
        end
      end ]]):format(table.concat(share.of(all_modules()), " "))))
  end)

  for _, place in ipairs { "libs.", "libs/", "top.libs." } do
    it("loads its modules at the top first, as " .. place, function()
      assert.equal("done", output_of(([[
        for name in ("rfsm_timeevent rfsm_seqand rfsm_checks rfsmpp"):gmatch "%S+" do
          forget()
          local module, rfsm = require("%s" .. name), require "%srfsm"
          assert(rfsm == package.loaded.rfsm and rfsm.state, name)
          assert(module == require(name) and module ~= true, name)
          assert(rfsm.seqand == require "rfsm_seqand")
          assert(rfsm.pp == require "%srfsmpp")
        end ]]):gsub("%%s", place)))
    end)
  end

  it("runs timers, whatever is loaded first", function()
    local both = 'require "libs.rfsm_timeevent" local rfsm = require "libs.rfsm"\n'
    assert.equal("root.b\ndone", output_of(both .. USE))
    assert.equal("root.b\ndone",
      output_of('rfsm = require "libs.rfsm"\nrequire "libs.rfsm_timeevent"\n' .. USE))
    assert.equal("root.b\ndone",
      output_of('rfsm = require "libs.rfsm" require "rfsm.timeevent"\n' .. USE))
  end)

  it("is found beside a core that was run by dofile", function()
    assert.equal("root.b\ndone", output_of(([[
      local rfsm = dofile "%s/libs/rfsm.lua"
      require "rfsm_timeevent"
      assert(require "rfsm_emem" == require "rfsm.emem") ]]):format(folder) .. USE))
  end)

  it("comes before another one that is installed", function()
    assert.equal("one\nroot.b\ndone", output_of(([[
      package.path = package.path .. ";%s/top/libs/?.lua"
      local handle = io.open("%s/top/libs/rfsm_timeevent.lua", "w")
      handle:write("print 'another one'")
      handle:close()
      local rfsm = require "libs.rfsm"
      require "rfsm_timeevent"
      print "one" ]]):gsub("%%s", folder) .. USE))
  end)

  it("is found by other searchers, such as those of an archive", function()
    assert.equal("root.b\ndone", output_of(([[
      package.path = ""
      local searchers = package.searchers or package.loaders
      table.insert(searchers, 2, function(name)
        local file = io.open("%s/" .. name:gsub("%%.", "/") .. ".lua")
        if not file then return "\n\tnot in the archive" end
        local text = file:read "*a"
        file:close()
        return (loadstring or load)(text, "=archive:" .. name)
      end)
      require "libs.rfsm_timeevent"
      local rfsm = require "libs.rfsm"
      assert(rfsm.seqand and require "rfsm.history" == require "libs.rfsm.history")
    ]]):format(folder) .. USE))
  end)

  it("is found in a bundle, which has the modules in package.preload", function()
    assert.equal("root.b\ndone", output_of([[
      local at = package.path:match "^(.*)%?"
      for _, name in ipairs { "rfsm", "rfsm_timeevent" } do
        local file = assert(io.open(at .. "libs/" .. name .. ".lua"))
        local chunk = assert((loadstring or load)(file:read "*a", "=bundle"))
        file:close()
        package.preload["libs." .. name] = chunk
      end
      package.path = ""
      local rfsm = require "libs.rfsm"
      require "rfsm_timeevent"
      ]] .. USE))
  end)

  it("reports a module that is nowhere as usual", function()
    assert.matches("^module 'rfsm.nothing' not found", output_of([[
      require "libs.rfsm"
      local _, problem = pcall(require, "rfsm.nothing")
      print((problem:gsub("^[^']-(module)", "%1"))) ]]))
  end)
end)
