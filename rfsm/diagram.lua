--- The common part of all diagrams: identifiers, labels, the ends of arrows.
--
-- `rfsm.plantuml`, `rfsm.dot` and `rfsm.mermaid` draw a `Chart`, each in its language.
-- Their functions `encode` and `save` are made here.
--
-- @module rfsm.diagram
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local marsh = require "rfsm.marsh"

local error, io, ipairs, rawget, rawset = error, io, ipairs, rawget, rawset
local tostring, type = tostring, type
local concat = table.concat

local diagram = {}

--- A box, a diamond or the dot where a composite begins.
---@class rfsm.diagram.Node
---@field name string as in the model
---@field id string letters, digits and underscores; no other node has it
---@field kind "leaf"|"composite"|"connector"|"initial"
---@field parent? rfsm.diagram.Node absent at the root
---@field nodes rfsm.diagram.Node[] sorted by name
---@field arrows rfsm.diagram.Arrow[] those with both ends in this composite
---@field initial? rfsm.diagram.Node

--- A transition.
---@class rfsm.diagram.Arrow
---@field src rfsm.diagram.Node
---@field tgt rfsm.diagram.Node an `initial` where the transition stays inside
---@field events string "e1, e2"; empty for any
---@field is_internal? true nothing is left or entered
---@field label string events, "[guard]", "/ effect", "(internal)", if there are any

--- A machine, ready to be drawn.
---@class rfsm.diagram.Chart
---@field title? string
---@field root rfsm.diagram.Node
---@field arrows rfsm.diagram.Arrow[] those that begin or end at the root
---@field all rfsm.diagram.Arrow[] all arrows
---@field taken table<string, boolean> identifiers that are given

--- Return an identifier that nothing else in the drawing has.
---@param chart rfsm.diagram.Chart
---@param text string
---@return string id
function diagram.new_id(chart, text)
  local plain = text:gsub("[^%w]", "_")
  local id, count = plain, 1
  while chart.taken[id] do
    count = count + 1
    id = plain .. "_" .. count
  end
  chart.taken[id] = true
  return id
end

-- Texts fit for a picture: UTF-8, and no control characters but the line feed.
local function clean(text)
  text = marsh.utf8(text):gsub("\r\n?", "\n"):gsub("\t", " ")
  return (text:gsub("[%z\1-\9\11-\31\127]", "\239\191\189"))
end

local function kind_of(tab)
  if tab.type == "state" then return tab.subnodes and "composite" or "leaf" end
  return tab.id == "initial" and "initial" or "connector"
end

-- Reads a node and those in it; `by_fqn` gets them all.
local function read_node(chart, by_fqn, tab, parent, fqn)
  local node = {
    name = clean(tab.id), id = diagram.new_id(chart, fqn), kind = kind_of(tab),
    parent = parent, nodes = {}, arrows = {},
  }
  by_fqn[fqn] = node
  for i, subtab in ipairs(tab.subnodes or {}) do
    node.nodes[i] = read_node(chart, by_fqn, subtab, node, fqn .. "." .. subtab.id)
    if node.nodes[i].kind == "initial" then node.initial = node.nodes[i] end
  end
  return node
end

--- Is `node` somewhere inside of `composite`?
---@param node rfsm.diagram.Node
---@param composite rfsm.diagram.Node
---@return boolean
function diagram.is_inside(node, composite)
  local parent = node.parent
  while parent and parent ~= composite do parent = parent.parent end
  return parent ~= nil
end

local is_inside = diagram.is_inside

-- Returns the innermost composite that has both ends of an arrow in it; nil when one is
-- the root.
local function find_home(src, tgt)
  local home = src.parent
  while home and not is_inside(tgt, home) do home = home.parent end
  return home
end

local function label_of(tr, events)
  local parts = { events ~= "" and events or nil }
  if tr.guard then parts[#parts + 1] = "[guard]" end
  if tr.effect then parts[#parts + 1] = "/ effect" end
  if tr.internal then parts[#parts + 1] = "(internal)" end
  return concat(parts, " ")
end

-- A transition that enters a composite from outside ends at its border, one from inside
-- at its initial, which does not leave the composite.
local function read_arrow(by_fqn, tr, text_of)
  local src, tgt = by_fqn[tr.src], by_fqn[tr.tgt]
  if tgt.kind == "initial" and not is_inside(src, tgt.parent) then tgt = tgt.parent end
  local texts = {}
  for i = 1, #tr.events do texts[i] = clean(text_of(tr.events[i])) end
  local events = concat(texts, ", ")
  return {
    src = src, tgt = tgt, events = events, is_internal = tr.internal,
    label = label_of(tr, events),
  }
end

local function read_arrows(chart, by_fqn, tab, text_of)
  for _, tr in ipairs(tab.transitions or {}) do
    local arrow = read_arrow(by_fqn, tr, text_of)
    local home = find_home(arrow.src, arrow.tgt) or chart
    home.arrows[#home.arrows + 1] = arrow
    chart.all[#chart.all + 1] = arrow
  end
  for _, subtab in ipairs(tab.subnodes or {}) do
    read_arrows(chart, by_fqn, subtab, text_of)
  end
end

-- Reads a machine for the public function `name`; errors blame its caller.
local function read(fsm, name, title)
  rfsm.check_machine(fsm, name, 4)
  local kind = type(title)
  if kind ~= "nil" and kind ~= "string" and kind ~= "number" then
    error(name .. ": title: string expected, got " .. kind, 3)
  end
  local chart, by_fqn = { arrows = {}, all = {}, taken = {} }, {}
  chart.title = title and title ~= "" and clean(tostring(title)) or nil
  local tab = marsh.model2tab(fsm, true)
  chart.root = read_node(chart, by_fqn, tab, nil, "root")
  read_arrows(chart, by_fqn, tab, marsh.gen_event_text())
  return chart
end

--- Append a line, indented.
---@param lines string[]
---@param depth integer
---@param text string
function diagram.add(lines, depth, text)
  lines[#lines + 1] = ("  "):rep(depth) .. text
end

--- Write a text to a file.
---@param file string
---@param text string
---@return boolean is_written
---@return string? problem in one line
function diagram.write(file, text)
  local handle, problem = io.open(file, "wb")
  if not handle then return false, problem end
  local is_written, why = handle:write(text)
  local is_closed, why_not = handle:close()
  if is_written and is_closed then return true end
  return false, file .. ": " .. (why or why_not)
end

--- The module of a language; both functions want an initialised fsm.
---@class rfsm.diagram.Exporter
---@field encode fun(fsm: rfsm.Machine, title?: string): string the diagram as text
---@field save fun(fsm: rfsm.Machine, file: string, title?: string) writes it to a file

--- Make the module of a language.
---@param name string of the module
---@param global string its older name
---@param draw fun(chart: rfsm.diagram.Chart): string
---@return rfsm.diagram.Exporter exporter
function diagram.exporter(name, global, draw)
  local exporter = {}

  function exporter.encode(fsm, title)
    return (draw(read(fsm, name .. ".encode", title)))
  end

  function exporter.save(fsm, file, title)
    local chart, where = read(fsm, name .. ".save", title), name .. ".save: "
    if type(file) ~= "string" then
      error(where .. "file name expected, got " .. type(file), 2)
    end
    local ok, problem = diagram.write(file, draw(chart))
    if not ok then error(where .. problem, 2) end
  end

  if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, global, exporter) end
  return exporter
end

return diagram
