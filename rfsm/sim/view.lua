--- Values, the tree of states, and the picture in the simulator.
--
-- @module rfsm.sim.view
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local files = require "rfsm.shared.files"
local location = require "rfsm.checks.location"
local rfsmpp = require "rfsmpp"

local getmetatable, io, ipairs, print = getmetatable, io, ipairs, print
local require, select, type = require, select, type
local concat = table.concat
local text_of = rfsm.text_of

local view = {}

--- Write a line to stderr, after the text in stdout.
function view.complain(text)
  io.stdout:flush()
  io.stderr:write(text, "\n")
end

-- Values --------------------------------------------------------------------------

local MAX_SHOWN, MAX_DEPTH = 20, 3 -- entries of a table, tables inside each other

local show

local function show_table(t, depth)
  local texts, is_item = {}, {}
  for i = 1, #t do texts[i], is_item[i] = show(t[i], depth + 1), true end
  for _, key in ipairs(rfsm.sorted_keys(t)) do
    local name = type(key) == "string" and key or "[" .. show(key, depth + 1) .. "]"
    if not is_item[key] then
      texts[#texts + 1] = name .. " = " .. show(t[key], depth + 1)
    end
  end
  if #texts > MAX_SHOWN then texts = { concat(texts, ", ", 1, MAX_SHOWN), "..." } end
  return texts[1] and "{ " .. concat(texts, ", ") .. " }" or "{}"
end

-- Returns a value as a person reads it; `depth` counts the tables around it.
function show(value, depth)
  if type(value) == "string" and depth > 0 then return ("%q"):format(value) end
  if rfsm.is_node(value) then return text_of(value) end
  if type(value) ~= "table" or getmetatable(value) or depth >= MAX_DEPTH then
    return text_of(value)
  end
  return show_table(value, depth)
end

--- Return a value as a person reads it.
function view.value(value) return show(value, 0) end

--- Print values in one line, if there are any.
function view.print_values(...)
  local texts = {}
  for i = 1, select("#", ...) do texts[i] = show(select(i, ...), 0) end
  if texts[1] then print(concat(texts, "\t")) end
end

-- The tree: active states with their siblings ---------------------------------------

local MAX_SIBLINGS = 12

local add_state

-- Adds the active states of a list, and some inactive ones.
local function add_children(lines, children, indent)
  local hidden = 0
  for i, child in ipairs(children) do
    if i <= MAX_SIBLINGS or child.state._mode ~= "inactive" then
      add_state(lines, child, indent)
    else
      hidden = hidden + 1
    end
  end
  if hidden > 0 then
    lines[#lines + 1] = indent .. "  and " .. hidden .. " more"
  end
end

local function children_of(state)
  local children = {}
  rfsm.mapfsm(function(child)
    if child ~= state then children[#children + 1] = { state = child } end
  end, state, rfsm.is_state, 1)
  for _, region in ipairs(location.regions_of(state)) do
    children[#children + 1] = { state = region.machine, name = region.name }
  end
  return children
end

function add_state(lines, child, indent)
  local state, name = child.state, (child.name or child.state._id):gsub("%c", "?")
  local is_active, children = state._mode ~= "inactive", children_of(state)
  local note = is_active and state._mode == "done" and " (done)" or ""
  if not is_active and children[1] then note = " ..." end
  name = is_active and rfsmpp.paint("green bright", "* " .. name) or "  " .. name
  lines[#lines + 1] = indent .. name .. note
  if is_active then add_children(lines, children, indent .. "  ") end
end

--- Draw the active states and their siblings as a tree.
function view.tree(fsm)
  local lines = {}
  add_state(lines, { state = fsm }, "")
  return concat(lines, "\n")
end

-- The picture -----------------------------------------------------------------------

local FORMATS = { svg = true, png = true, pdf = true, dot = true }

--- Draw a machine with its active states into a file, in the format of its ending;
-- return the problem in one line if there is one.
function view.draw(fsm, file)
  local dot, format = require "rfsm.dot", (file:match("%.(%w+)$") or ""):lower()
  if not FORMATS[format] then
    return "file.svg, .png, .pdf or .dot expected, got '" .. file .. "'"
  end
  local picture, problem = format == "dot" and dot.encode(fsm) or nil, nil
  if not picture then
    picture, problem = dot.render(dot.layout(fsm) or dot.encode(fsm), format)
  end
  if picture then problem = select(2, files.write(file, picture)) end
  return problem
end

return view
