-- The whole program of a Lua component of Orocos RTT. Name this file in the property
-- `lua_file`. The property `lua_string` may set the global `rfsm_launch`, a table with
-- the fields of the launch. Without this table the chart is the file NAME.lua in the
-- current folder, where NAME is the name of the component.
--
--   gripper.lua_file = "/usr/local/share/lua/5.1/rfsm/rtt/program.lua"
--   gripper.lua_string = "rfsm_launch = { fsmfile = 'charts/gripper.lua' }"
--
-- OCL ignores a failure of this file, and takes a missing configureHook for success. So
-- this file only defines that hook, which does everything.

local source = debug.getinfo(1, "S").source

-- Returns rfsm.rtt, which is found beside this file.
local function library(fields)
  local folder = source:match("^@(.*)rfsm[/\\]rtt[/\\]program%.lua$")
  if folder and not package.loaded.rfsm then
    package.path = folder .. "?.lua;" .. folder .. "compat/?.lua;" .. package.path
    if type(fields) == "table" and fields.stripped ~= nil then
      rawset(_G, "RFSM_STRIPPED", fields.stripped)
    end
  end
  return require("rfsm.rtt")
end

local function launch()
  local fields = rawget(_G, "rfsm_launch")
    or { fsmfile = rawget(_G, "rtt").getTC():getName() .. ".lua" }
  return library(fields).launch(fields)
end

-- Executed before the component is configured, this file makes the ports that can be
-- connected then. The configureHook reports what is wrong with them.
local fields = rawget(_G, "rfsm_launch")
if type(fields) == "table" and fields.ports ~= nil then
  pcall(function() library(fields).ports(fields.ports) end)
end

rawset(_G, "configureHook", function()
  local ok, why = pcall(launch)
  if not ok then error(tostring(why), 0) end -- an error that is no text mutes RTT's log
  return true
end)
