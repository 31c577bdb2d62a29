--- Calls: calling functions that may fail, loading texts as programs, making machines
-- for tools, and writing arguments as texts.
--
-- @module rfsm.shared.calls
-- @license BSD-3-Clause

local rfsm = require "rfsm"

local error, ipairs, pcall = error, ipairs, pcall
local rawget, rawset, select = rawget, rawset, select
local concat = table.concat
local load = rawget(_G, "loadstring") or rawget(_G, "load")
local setfenv = rawget(_G, "setfenv")
local getupvalue = (rawget(_G, "debug") or {}).getupvalue

local calls = { is_apart = false } -- true while `init_apart` makes a machine

local function pass(ok, ...)
  if not ok and rfsm.is_interrupt((...)) then error((...), 0) end
  return ok, ...
end

--- Call a function as `pcall` does, but raise an interrupt, such as Control-C, again.
function calls.try(f, ...) return pass(pcall(f, ...)) end

--- Load a text as a program whose globals are the fields of a table, on each version of
-- Lua. Return the program as a function, or nil and the problem.
function calls.load(text, name, globals)
  local chunk, problem = load(text, name, "t", globals)
  if chunk and setfenv then setfenv(chunk, globals) end
  return chunk, problem
end

local function finish(undo, ok, ...)
  undo()
  if not ok then error((...), 0) end
  return ...
end

--- Return f(...). Call `undo()` when it has returned, or has raised an error.
function calls.finally(undo, f, ...) return finish(undo, pcall(f, ...)) end

--- Make a machine of a model for a tool, as `rfsm.init` does. If regions of the model
-- are machines, they are not used: the new machine gets new regions of the same models.
function calls.init_apart(model)
  local was_apart, make = calls.is_apart, rfsm.seqand and rfsm.seqand.init_apart
  calls.is_apart = true
  return calls.finally(function() calls.is_apart = was_apart end, make or rfsm.init,
    model)
end

local problems_in = {} -- the problems by the text that lists them

--- Raise a text that lists problems.
---@param text string
---@param problems string[]? what `calls.problems_of` returns for this text
function calls.fail(text, problems)
  problems_in[text] = problems
  error(text, 0)
end

--- Return the problems of a failure of `calls.fail`; nil for any other.
function calls.problems_of(failure) return problems_in[failure] end

local PRINTERS = { "dbg", "info", "warn", "err" }

--- Return make(model), such as rfsm.init(model), with the model's printers off.
---@param make fun(model: rfsm.Model): any, any, any
---@param model rfsm.Model
---@param warn? function|false a printer for warnings; default: they are not printed
function calls.silently(make, model, warn)
  local own = {}
  for _, name in ipairs(PRINTERS) do
    own[name] = rawget(model, name)
    if not rfsm.is_fsmobj(own[name]) then
      rawset(model, name, name == "warn" and warn or false)
    end
  end
  return calls.finally(function()
    for _, name in ipairs(PRINTERS) do rawset(model, name, own[name]) end
  end, make, model)
end

--- List the upvalues of a function, each with its name and value.
---@return { name: string, value: any }[]
function calls.upvalues_of(f)
  local list, i = {}, 1
  while getupvalue do
    local name, value = getupvalue(f, i)
    if not name then break end
    list[i], i = { name = name, value = value }, i + 1
  end
  return list
end

--- Return a text of several lines, such as a problem and a list below it, as one line.
function calls.line(text)
  return (text:gsub(":\n%s*", ": "):gsub("[\r\n]+%s*", "; "))
end

--- Return any values as one text, as a printer shows them.
function calls.text(separator, ...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = rfsm.text_of((select(i, ...))) end
  return concat(texts, separator)
end

return calls
