--- The common part of all diagrams: identifiers, labels, the ends of arrows.
--
-- `rfsm.plantuml`, `rfsm.dot` and `rfsm.mermaid` draw a `Chart`, each in its language.
-- It is made of the full description of a machine by `rfsm.marsh`, or of one that came
-- from elsewhere. Their functions `encode` and `save` are made here.
--
-- @module rfsm.diagram
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local marsh = require "rfsm.marsh"

local error, io, ipairs, pairs, rawget, rawset = error, io, ipairs, pairs, rawget, rawset
local select, tostring, type = select, tostring, type
local concat = table.concat

local diagram = {}

--- What may be said of a picture. A string in its place is the title.
---@class rfsm.diagram.Options
---@field title? string
---@field active? string|string[] FQNs of active states; else those of a live machine
---@field depth? integer levels to draw; deeper ones are left out
---@field direction? "TB"|"LR" from top to bottom, or from left to right

--- A state, a region, a connector or the dot where a composite begins.
---@class rfsm.diagram.Node
---@field name string as in the model
---@field fqn string
---@field id string letters, digits and underscores; no other node has it
---@field kind "leaf"|"composite"|"connector"|"initial"
---@field parent? rfsm.diagram.Node absent at the root
---@field nodes rfsm.diagram.Node[] regions, too
---@field arrows rfsm.diagram.Arrow[] those with both ends in this composite
---@field initial? rfsm.diagram.Node
---@field rows string[] "entry / f", internal transitions and the like
---@field mode? "active"|"done"
---@field is_final? true
---@field is_region? true
---@field is_cut? true there are nodes in it that are not drawn

--- A transition.
---@class rfsm.diagram.Arrow
---@field key string such as "root.trans[2]"
---@field src rfsm.diagram.Node
---@field tgt rfsm.diagram.Node an `initial` where the transition stays inside
---@field home? rfsm.diagram.Node the innermost composite around both ends
---@field parts string[] "e1, e2", "[guard]", "/ effect", "(pn 1)", if there are any

--- A machine, ready to be drawn.
---@class rfsm.diagram.Chart
---@field title? string
---@field direction string
---@field root rfsm.diagram.Node
---@field arrows rfsm.diagram.Arrow[] those that begin or end at the root
---@field all rfsm.diagram.Arrow[] all arrows
---@field taken table<string, boolean> identifiers that are given

-- Text --------------------------------------------------------------------------

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

local function length_of(text) return select(2, text:gsub("[^\128-\191]", "")) end

local WIDTH = 28 -- characters of a line
local AS_LONG_AS_A_LINE = "^" .. ("[^\128-\191][\128-\191]*"):rep(WIDTH)

-- Appends a word to lines: to the last one if there is room for it.
local function add_word(lines, word, can_join)
  local last = lines[#lines]
  if can_join and last and length_of(last) + 1 + length_of(word) <= WIDTH then
    lines[#lines] = last .. " " .. word
    return
  end
  while length_of(word) > WIDTH do
    local head = word:match(AS_LONG_AS_A_LINE)
    head = head:match("^.+[_./:,;(@-]") or head
    lines[#lines + 1], word = head, word:sub(#head + 1)
  end
  lines[#lines + 1] = word
end

--- Return texts in short lines. A text stays in one line if it fits.
---@param texts string[]
---@return string[] lines
function diagram.wrap(texts)
  local lines = {}
  for _, text in ipairs(texts) do
    for line in (text .. "\n"):gmatch("([^\n]*)\n") do
      if length_of(line) <= WIDTH then
        add_word(lines, line, true)
      else
        local is_first = true
        for word in line:gmatch("[^ ]+") do
          add_word(lines, word, not is_first)
          is_first = false
        end
      end
    end
  end
  return lines
end

-- Nodes ---------------------------------------------------------------------------

local function kind_of(tab)
  if tab.type ~= "state" then return tab.id == "initial" and tab.id or "connector" end
  return (tab.subnodes or tab.regions) and "composite" or "leaf"
end

local function rows_of(tab)
  local rows = {}
  if tab.doc then return { clean(tab.doc) } end
  for _, field in ipairs { "entry", "doo", "exit" } do
    if tab[field] then rows[#rows + 1] = field .. " / " .. clean(tab[field]) end
  end
  return rows
end

-- Reads a node and those in it, to a depth; `by_fqn` gets them all.
local function read_node(chart, tab, parent, fqn, depth)
  local kind = kind_of(tab)
  local node = {
    name = clean(tab.id), fqn = fqn, id = diagram.new_id(chart, fqn), parent = parent,
    kind = depth > 0 and kind or kind == "composite" and "leaf" or kind, tab = tab,
    nodes = {}, arrows = {}, rows = rows_of(tab), mode = tab.mode, is_final = tab.final,
    is_cut = depth == 0 and kind == "composite" or nil,
  }
  chart.by_fqn[fqn] = node
  local function read_list(list)
    for _, subtab in ipairs(depth > 0 and list or {}) do
      local subnode = read_node(chart, subtab, node, fqn .. "." .. subtab.id, depth - 1)
      node.nodes[#node.nodes + 1] = subnode
      if subnode.kind == "initial" then node.initial = subnode end
    end
  end
  read_list(tab.subnodes)
  read_list(tab.regions)
  for i = 1, tab.regions and #node.nodes or 0 do node.nodes[i].is_region = true end
  return node
end

-- Arrows --------------------------------------------------------------------------

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

-- Returns the node for an FQN, or the drawn one that contains it.
local function find_node(chart, fqn)
  while not chart.by_fqn[fqn] do fqn = fqn:match("^(.*)%.") end
  return chart.by_fqn[fqn]
end

-- Returns the innermost composite that has both ends of an arrow in it; nil if one is
-- the root.
local function find_home(src, tgt)
  local home = src.parent
  while home and not is_inside(tgt, home) do home = home.parent end
  return home
end

local function words_of(tr, text_of)
  local words = {}
  for i, event in ipairs(tr.events) do
    words[i] = clean(tr.words and tr.words[i] or marsh.words_of(text_of(event), tr.src))
  end
  return concat(words, ", ")
end

local function parts_of(tr, text_of)
  local events, parts = words_of(tr, text_of), {}
  local function add(text, format)
    if text and text ~= "" then parts[#parts + 1] = format:format(clean(text)) end
  end
  add(events, "%s")
  add(tr.doc, "/ %s")
  if not tr.doc then
    add(tr.guard, "[%s]")
    add(tr.effect, "/ %s")
  end
  add(tr.pn and tr.pn ~= 0 and rfsm.text_of(tr.pn), "(pn %s)")
  return parts
end

local function add_arrow(chart, arrow)
  local home = find_home(arrow.src, arrow.tgt)
  arrow.home = home
  local arrows = (home or chart).arrows
  arrows[#arrows + 1] = arrow
  chart.all[#chart.all + 1] = arrow
end

-- Reads a transition. One that enters a composite from outside ends at its border, one
-- from inside at its initial, which does not leave the composite.
local function read_transition(chart, tr, key, text_of)
  local src, tgt = find_node(chart, tr.src), find_node(chart, tr.tgt)
  local parts = parts_of(tr, text_of)
  if tr.internal then
    src.rows[#src.rows + 1] = concat(parts, " ")
  elseif src ~= tgt or not src.is_cut or tr.src == src.fqn then
    if tgt.kind == "initial" and not is_inside(src, tgt.parent) then tgt = tgt.parent end
    add_arrow(chart, { key = tr.key or key, src = src, tgt = tgt, parts = parts })
  end
end

local function read_transitions(chart, node, text_of)
  for i, tr in ipairs(not node.is_cut and node.tab.transitions or {}) do
    read_transition(chart, tr, ("%s.trans[%d]"):format(node.fqn, i), text_of)
  end
  for _, subnode in ipairs(node.nodes) do read_transitions(chart, subnode, text_of) end
  node.tab = nil
end

-- Charts --------------------------------------------------------------------------

-- Marks the states that an option names in place of those of the machine.
local function mark_active(chart, active)
  for _, node in pairs(chart.by_fqn) do node.mode = nil end -- any order
  for _, fqn in ipairs(type(active) == "table" and active or { active }) do
    local node = find_node(chart, fqn)
    while node do node.mode, node = "active", node.parent end
  end
end

local function options_of(options, where)
  local kind = type(options)
  if kind == "table" then return options end
  if kind == "nil" or kind == "string" or kind == "number" then
    return { title = options }
  end
  error(where .. ": title: string expected, got " .. kind, 4)
end

local function is_description(value)
  return type(value) == "table" and rawget(value, "type") == "state"
end

-- Reads a machine or a description for the public function `where`, whose caller is
-- blamed for errors.
local function read(source, where, options)
  if not is_description(source) then rfsm.check_machine(source, where, 4) end
  options = options_of(options, where)
  local title = options.title
  local chart = { arrows = {}, all = {}, taken = {}, by_fqn = {} }
  chart.title = title and title ~= "" and clean(tostring(title)) or nil
  chart.direction = options.direction or "TB"
  local tab = is_description(source) and source or marsh.model2tab(source, true)
  chart.root = read_node(chart, tab, nil, "root", options.depth or 1 / 0)
  read_transitions(chart, chart.root, marsh.gen_event_text())
  if options.active then mark_active(chart, options.active) end
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

--- The module of a language. Both functions take an initialised fsm, or a description.
---@class rfsm.diagram.Exporter
---@field encode fun(fsm: rfsm.Machine, options?: rfsm.diagram.Options): string
---@field save fun(fsm: rfsm.Machine, file: string, options?: rfsm.diagram.Options)

--- Make the module of a language.
---@param name string of the module
---@param global string its older name
---@param draw fun(chart: rfsm.diagram.Chart): string
---@return rfsm.diagram.Exporter exporter
function diagram.exporter(name, global, draw)
  local exporter = {}

  function exporter.encode(fsm, options)
    return (draw(read(fsm, name .. ".encode", options)))
  end

  function exporter.save(fsm, file, options)
    local chart, where = read(fsm, name .. ".save", options), name .. ".save: "
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
