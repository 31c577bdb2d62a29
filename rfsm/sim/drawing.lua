--- Draws the tree of states and the picture for the simulator.
--
-- @module rfsm.sim.drawing
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local files = require "rfsm.shared.files"
local location = require "rfsm.shared.location"
local rfsmpp = require "rfsmpp"

local ipairs, require, select = ipairs, require, select
local concat = table.concat

local drawing = {}

-- The tree: active states with their siblings ---------------------------------------

local MAX_SIBLINGS = 12

local add_state

-- Adds lines for children of a state: for the first ones, and for all active ones.
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
function drawing.tree(fsm)
  local lines = {}
  add_state(lines, { state = fsm }, "")
  return concat(lines, "\n")
end

-- The picture -----------------------------------------------------------------------

local FORMATS = { svg = true, png = true, pdf = true, dot = true }

--- Draw a machine with its active states into a file, in the format that the ending of
-- the file names. Return nil, or the problem in one line.
function drawing.draw(fsm, file)
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

return drawing
