--- The common part of all diagrams: identifiers, labels, the ends of arrows.
--
-- `rfsm.plantuml`, `rfsm.dot` and `rfsm.mermaid` draw a `Chart`, each in its language.
-- A chart is made from a machine, or from a description as `rfsm.marsh` makes it.
-- The functions `encode` and `save` of the three modules are made here.
--
-- @module rfsm.pictures.diagram
-- @license BSD-3-Clause

local advice = require "rfsm.advice"
local choice = require "rfsm.pictures.choice"
local files = require "rfsm.shared.files"
local marsh = require "rfsm.marsh"
local opts = require "rfsm.shared.options"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local assert, error, ipairs, pcall = assert, error, ipairs, pcall
local rawget, rawset, select = rawget, rawset, select
local tonumber, tostring, type = tonumber, tostring, type
local concat, max, sort = table.concat, math.max, table.sort

local diagram = {}

--- The options of a picture. A string in place of this table is the title.
---@class rfsm.pictures.Options
---@field title? string
---@field foot? string a note below a picture
---@field active? string|string[] FQNs of active states; default: those of the machine
---@field depth? integer levels of states to draw; deeper states are left out
---@field folded? string[] FQNs of composites that are drawn without the nodes in them
---@field within? string FQN of a composite: only this one is drawn. An arrow that leads
-- out of it, or into it, ends at a box with the name of the state outside
---@field direction? "TB"|"LR" from top to bottom, or from left to right
---@field coverage? rfsm.pictures.Coverage
---@field trace? (string|rfsm.pictures.Step)[] steps of a run; a string is the FQN of a
-- state or the key of a transition
---@field sheet? string "a4", "slide", or width and height in points, such as "1200x800"
---@field like? string a former picture (SVG): the order of its nodes is kept

--- A step of a run: from a witness of `rfsm_checks.explore`, or from a recording.
---@class rfsm.pictures.Step
---@field taken? string[] keys of transitions
---@field leaf? string FQN of the active leaf after the step
---@field m? integer set if a region took the step; such a step is not drawn
---@field record? integer set in the first line of a recording only; it is not a step

--- How often a run entered each state, by FQN, and took each transition, by key.
---@class rfsm.pictures.Coverage
---@field states table<string, integer>
---@field transitions table<string, integer>

--- A state, a region, a connector or the dot where a composite begins.
---@class rfsm.pictures.Node
---@field name string as in the model
---@field fqn string
---@field id string letters, digits and underscores; no other node has it
---@field kind "leaf"|"composite"|"connector"|"initial"
---@field parent rfsm.pictures.Node
---@field depth integer number of composites around it
---@field index? integer position among the nodes of the parent
---@field nodes rfsm.pictures.Node[] its regions, or the nodes in it, `initial` first
---@field arrows rfsm.pictures.Arrow[] arrows whose `home` is this composite
---@field rows string[] lines below the name: "entry / f", internal transitions
---@field marks? string "•" for each callback that has no row
---@field at string file and line of callbacks
---@field mode? "active"|"done"
---@field mark? "covered"|"missed"|"traced"
---@field is_final? true
---@field is_region? true
---@field is_on_border? true an arrow leads from or to it across the frame around it
---@field has_loop? boolean an arrow leads from it to itself, or to a node in it
---@field is_cut? true a composite that is drawn without the nodes in it
---@field is_outside? true a state outside of the composite that is drawn
---@field is_linked? boolean another picture shows it if it is cut or outside
---@field row? integer its row, if its level is in rows, or was in a former picture; 0
-- if the level is turned
---@field least? string an attribute for Graphviz: the least width or height of its box

--- A transition.
---@class rfsm.pictures.Arrow
---@field key string such as "root.trans[2]"; of a bundle the keys of all, in lines
---@field src rfsm.pictures.Node
---@field tgt rfsm.pictures.Node an `initial` only if `src` is in its composite
---@field home rfsm.pictures.Node the innermost composite around both ends
---@field at string file and line of guard and effect
---@field parts string[] of the label: "e1, e2", "[guard]", "/ effect" and "(pn 1)", as
-- far as the transition has them; of a bundle one text, with a line for each transition
---@field mark? "covered"|"missed"|"traced"

--- All that is drawn of a machine.
---@class rfsm.pictures.Chart
---@field title? string
---@field foot? string
---@field direction string
---@field sheet rfsm.pictures.Size
---@field kind? "levels"|"plain"|"sheet" the layout of the former picture in the option
-- `like`
---@field root rfsm.pictures.Node
---@field top rfsm.pictures.Node a composite around the root
---@field nodes rfsm.pictures.Node[] all nodes, parents before children
---@field by_fqn table<string, rfsm.pictures.Node>
---@field all rfsm.pictures.Arrow[] all arrows
---@field taken table<string, boolean> identifiers that are in use
---@field folded table<string, boolean> FQNs of the composites in the option `folded`
---@field outside table<string, rfsm.pictures.Node> FQN -> a state outside
---@field has_links boolean other pictures show what is in folded composites

-- Text ------------------------------------------------------------------------

--- Return a new identifier in the chart: the letters and digits of a name, which are
--- the same in each locale, with a number if that is in use.
function diagram.new_id(chart, name)
  local plain, count = name:gsub("[^A-Za-z0-9]", "_"), 1
  local id = plain
  while chart.taken[id] do
    count = count + 1
    id = plain .. "_" .. count
  end
  chart.taken[id] = true
  return id
end

--- Return a text as UTF-8, in which line feeds are the only control characters.
function diagram.clean(text)
  if not text:find("[^ -~]") then return text end
  text = marsh.utf8(text):gsub("\r\n?", "\n"):gsub("\t", " ")
  return (text:gsub("[%z\1-\9\11-\31\127]", "\239\191\189"))
end

local clean = diagram.clean

local function length_of(text) return select(2, text:gsub("[^\128-\191]", "")) end

local CHARACTER = "[^\128-\191][\128-\191]*"

-- Appends a word to the last line if `can_join` and there is room, else as a new line.
-- A word that is wider than a line is broken.
local function add_word(lines, word, width, can_join)
  local last = lines[#lines]
  if can_join and last and length_of(last) + 1 + length_of(word) <= width then
    lines[#lines] = last .. " " .. word
    return
  end
  while length_of(word) > width do
    local head = word:match("^" .. CHARACTER:rep(width))
    head = head:match("^..+ ") or head:match("^.+[_./:,;(@-]") or head
    lines[#lines + 1], word = head:gsub(" $", ""), word:sub(#head + 1)
  end
  lines[#lines + 1] = word
end

-- Returns the words of a line. Spaces in parentheses, and the one of "/ effect", do not
-- end a word.
local function words_in(line)
  local words, depth = {}, 0
  for word in line:gmatch("[^ ]+") do
    if depth > 0 or words[#words] == "/" then
      words[#words] = words[#words] .. " " .. word
    else
      words[#words + 1] = word
    end
    local _, opened = word:gsub("%(", "")
    local _, closed = word:gsub("%)", "")
    depth = max(0, depth + opened - closed)
  end
  return words
end

-- Appends a line. If it is too long, its words are put into several lines.
local function add_line(lines, line, width, can_join)
  local is_short = length_of(line) <= width
  for i, word in ipairs(is_short and { line } or words_in(line)) do
    add_word(lines, word, width, i > 1 or is_short and can_join)
  end
end

--- Return texts in lines of at most `width` characters. A short text continues the line
-- of the text before it.
function diagram.wrap(texts, width)
  local lines = {}
  for _, text in ipairs(texts) do
    local can_join = true
    for line in (text .. "\n"):gmatch("([^\n]*)\n") do
      add_line(lines, line, width, can_join)
      can_join = false
    end
  end
  return lines
end

-- Descriptions, as pictures and pages read them --------------------------------

--- Return the nodes or regions in a node of a description.
function diagram.members(tab) return tab.regions or tab.subnodes or {} end

local members = diagram.members

--- Return the kind of a node in a description.
function diagram.kind_of(tab)
  if tab.type ~= "state" then return tab.id == "initial" and tab.id or "connector" end
  return members(tab)[1] and "composite" or "leaf"
end

--- Is a node a state? Any table that has the field `kind` of a node is accepted.
function diagram.is_state(node)
  return node.kind == "leaf" or node.kind == "composite"
end

local is_state = diagram.is_state

--- Call f(tr, key, words) for each transition in a description; `words` are the texts
-- of its events. `fqn` is the FQN of the described state, by default "root".
function diagram.each_transition(tab, text_of, f, fqn)
  fqn = fqn or "root"
  for i, tr in ipairs(tab.transitions or {}) do
    local words = { tr.always and "always" }
    for j, event in ipairs(tr.events) do
      words[j] = tr.words and tr.words[j] or marsh.words_of(text_of(event), tr.src)
    end
    f(tr, tr.key or ("%s.trans[%d]"):format(fqn, i), words)
  end
  for _, subtab in ipairs(members(tab)) do
    diagram.each_transition(subtab, text_of, f, fqn .. "." .. subtab.id)
  end
end

-- Nodes -----------------------------------------------------------------------

local HISTORY = { shallow = "(H)", deep = "(H*)" }

-- Returns the rows of a state, and a mark for each callback that has no row.
local function rows_of(tab)
  local rows, marks = { HISTORY[tab.history] }, ""
  rows[#rows + 1] = tab.doc and clean(tab.doc)
  for _, field in ipairs(tab.doc and {} or { "entry", "doo", "exit" }) do
    if tab[field] == marsh.UNKNOWN then
      marks = marks .. "•"
    elseif tab[field] then
      rows[#rows + 1] = field .. " / " .. clean(tab[field])
    end
  end
  for _, reaction in ipairs(tab.reactions or {}) do
    rows[#rows + 1] = clean(concat(reaction.words, ", ") .. " / " .. reaction.word)
  end
  return rows, marks ~= "" and marks or nil
end

local function at_of(tab) return clean(tab.at or "") end

local MODES = { active = "active", done = "done" }

-- Adds a node to the chart as the last one in a composite.
local function add_node(chart, parent, node)
  node.id, node.nodes, node.arrows = diagram.new_id(chart, node.fqn), {}, {}
  node.parent, node.depth, node.index = parent, parent.depth + 1, #parent.nodes + 1
  parent.nodes[node.index], chart.nodes[#chart.nodes + 1] = node, node
  return node
end

-- Adds a node of a description to the chart, and the nodes in it down to a depth.
local function read_node(chart, tab, parent, fqn, depth)
  local kind = diagram.kind_of(tab)
  local is_cut = kind == "composite" and (depth == 0 or chart.folded[fqn]) or nil
  local rows, marks = rows_of(tab)
  local node = add_node(chart, parent, {
    name = clean(tab.id), fqn = fqn, kind = is_cut and "leaf" or kind, is_cut = is_cut,
    is_linked = chart.has_links, rows = rows, marks = marks, at = at_of(tab),
    mode = MODES[tab.mode], is_final = tab.final,
  })
  chart.by_fqn[fqn] = node
  for _, subtab in ipairs(is_cut and {} or members(tab)) do
    local subnode = read_node(chart, subtab, node, fqn .. "." .. subtab.id, depth - 1)
    subnode.is_region = tab.regions and true
  end
  return node
end

-- Arrows ----------------------------------------------------------------------

--- Is `node` somewhere inside of `composite`?
function diagram.is_inside(node, composite)
  local parent = node.parent
  while parent and parent ~= composite do parent = parent.parent end
  return parent ~= nil
end

local is_inside = diagram.is_inside

-- Returns the node with an FQN; if it is not drawn, the innermost drawn node around it.
local function find_node(chart, fqn)
  while fqn and not chart.by_fqn[fqn] do fqn = fqn:match("^(.*)%.") end
  return chart.by_fqn[fqn]
end

--- Return the nodes in a composite that are, or contain, the ends of an arrow.
function diagram.ends_in(arrow, composite)
  local src, tgt = arrow.src, arrow.tgt
  while src.parent ~= composite do src = src.parent end
  while tgt.parent ~= composite do tgt = tgt.parent end
  return src, tgt
end

-- Returns the innermost composite that has both ends of an arrow in it.
local function home_of(src, tgt)
  local home = src.parent
  while not is_inside(tgt, home) do home = home.parent end
  return home
end

--- Does an arrow lead from a node to the same node, or to a node inside of it?
function diagram.is_loop(arrow)
  return arrow.src == arrow.tgt or is_inside(arrow.tgt, arrow.src)
end

local function parts_of(tr, words)
  local parts = {}
  local function add(text, format)
    if text and text ~= "" then parts[#parts + 1] = format:format(clean(text)) end
  end
  add(concat(words, ", "), "%s")
  add(tr.doc, "/ %s")
  if not tr.doc then
    add(tr.guard, "[%s]")
    add(tr.effect, "/ %s")
  end
  add(tr.pn and tr.pn ~= 0 and rfsm.text_of(tr.pn), "(pn %s)")
  return parts
end

-- Returns the node for a state outside of the drawn composite; the first call adds it.
local function outside_node(chart, fqn)
  fqn = fqn:gsub("%.initial$", "")
  local name = clean(fqn:gsub("^root%.", ""))
  chart.outside[fqn] = chart.outside[fqn] or add_node(chart, chart.root, { name = name,
    fqn = fqn, kind = "leaf", rows = {}, at = "", is_outside = true, is_linked = true })
  return chart.outside[fqn]
end

-- Returns the ends of a transition; nil if none of them is in the drawn composite.
local function ends_of(chart, tr)
  local src, tgt = find_node(chart, tr.src), find_node(chart, tr.tgt)
  if src and tgt then return src, tgt end
  assert(chart.root.fqn ~= "root", "a state is missing")
  local inner = src or tgt
  if not inner or inner == chart.root or inner.parent == chart.root
    and inner.kind == "initial" then return nil end
  return src or outside_node(chart, tr.src), tgt or outside_node(chart, tr.tgt)
end

-- Adds an arrow for a transition; an internal transition is a row in the box of its
-- state. Adds nothing if both ends are in one composite drawn without its nodes. If an
-- arrow leads from outside of a composite to its initial, it ends at the frame.
local function read_transition(chart, tr, key, words)
  local src, tgt = ends_of(chart, tr)
  if not src or src == tgt and src.fqn ~= tr.src then return end
  local parts = parts_of(tr, words)
  if tr.internal then
    src.rows[#src.rows + 1] = concat(parts, " ")
    return
  end
  local is_inner = tgt.kind ~= "initial" or is_inside(src, tgt.parent)
  chart.all[#chart.all + 1] = { key = key, src = src,
    tgt = is_inner and tgt or tgt.parent, parts = parts, at = at_of(tr) }
end

-- Bundles: arrows with equal ends become one, with a line for each in its label --

-- Is a list of arrows drawn as a bundle? Graphviz draws a loop through the labels of
-- the loops inside of it, so two of them are one already.
local function is_bundle(group)
  return #group > (group[1].src == group[1].tgt and 1 or 2)
end

-- Returns the bundle of some arrows. It is marked as missed only if all of them are.
local function bundle_of(arrows)
  local first, keys, texts, places, marks = arrows[1], {}, {}, {}, {}
  for i, arrow in ipairs(arrows) do
    keys[i], texts[i] = arrow.key, arrow.parts[1] and concat(arrow.parts, " ") or "-"
    places[#places + 1] = arrow.at ~= "" and arrow.at or nil
    marks[arrow.mark or ""] = arrow.mark
  end
  return { key = concat(keys, "\n"), keys = keys, src = first.src, tgt = first.tgt,
    parts = { concat(texts, "\n") }, at = concat(places, "\n"),
    mark = marks.traced or marks.covered or marks.missed }
end

-- Returns the arrows of a picture. A bundle is where its first arrow was.
local function tied(arrows)
  local groups, list = {}, {}
  local function pair_of(arrow) return arrow.src.id .. " " .. arrow.tgt.id end
  for _, arrow in ipairs(arrows) do order.append(groups, pair_of(arrow), arrow) end
  for _, arrow in ipairs(arrows) do
    local group = groups[pair_of(arrow)]
    if not is_bundle(group) then
      list[#list + 1] = arrow
    elseif group[1] == arrow then
      list[#list + 1] = bundle_of(group)
    end
  end
  return list
end

local function place_arrows(chart)
  chart.all = tied(chart.all)
  for _, arrow in ipairs(chart.all) do
    local src, tgt = arrow.src, arrow.tgt
    local home = home_of(src, tgt)
    arrow.home = home
    src.is_on_border = src.is_on_border or home ~= src.parent or nil
    tgt.is_on_border = tgt.is_on_border or home ~= tgt.parent or nil
    src.has_loop = src.has_loop or diagram.is_loop(arrow)
    home.arrows[#home.arrows + 1] = arrow
  end
end

-- Order of nodes, as in a former picture ----------------------------------------

local ENTITIES = { amp = "&", lt = "<", gt = ">", quot = '"', ["#45"] = "-",
  ["#39"] = "'" }

-- Returns the positions of the nodes in the text of an SVG, by FQN. A composite has the
-- position of the first node in it. Gives nodes the shapes that a former picture for a
-- sheet has noted in its classes.
local function read_picture(chart, svg)
  local numbers, count = {}, 0
  for id, kind, class in svg:gmatch('<g id="([^"]*)" class="(%l+)([^"]*)"') do
    local fqn = id:gsub("&(#?%w+);", ENTITIES)
    local node = chart.kind == "sheet" and chart.by_fqn[fqn]
    if node then node.row = tonumber(class:match(" row(%d+)")) end
    count = count + 1
    while kind == "node" and fqn and not numbers[fqn] do
      numbers[fqn], fqn = count, fqn:match("^(.*)%.")
    end
  end
  return numbers
end

-- Sorts the nodes of each composite as in a former picture. A new node stays behind the
-- node that precedes it now. Regions stay in the order in which they are stepped.
local function keep_order(chart, svg)
  chart.kind = svg:match('class="graph (%l+)"')
  local numbers, number_of = read_picture(chart, svg), {}
  for _, composite in ipairs(chart.nodes) do
    local number, nodes = 0, composite.nodes
    for _, node in ipairs(nodes) do
      number = not node.is_region and numbers[node.fqn] or number
      number_of[node] = number
    end
    sort(nodes, function(a, b)
      if number_of[a] ~= number_of[b] then return number_of[a] < number_of[b] end
      return a.index < b.index
    end)
    for i, node in ipairs(nodes) do node.index = i end
  end
end

-- Charts ----------------------------------------------------------------------

-- Returns the state for an FQN given by a user, or the drawn state that contains it.
local function find_state(chart, fqn, where)
  local node = find_node(chart, fqn)
  if node and is_state(node) and (node.fqn == fqn or node.is_cut) then return node end
  local names = {}
  for _, other in ipairs(chart.nodes) do
    names[#names + 1] = is_state(other) and other.fqn or nil
  end
  error(("%s: active: no state is named '%s'%s"):format(where, fqn,
    advice.nearest_name(fqn, names)), 5)
end

-- Marks the states in the option `active` as active, in place of the current ones.
local function mark_active(chart, active, where)
  for _, node in ipairs(chart.nodes) do node.mode = nil end
  for _, fqn in ipairs(type(active) == "table" and active or { active }) do
    local is_drawn = chart.root.fqn == "root" or find_node(chart, fqn)
    local node = is_drawn and find_state(chart, fqn, where)
    while node do node.mode, node = "active", node.parent end
  end
end

-- Returns a list: keys of the transitions that a step took, then the FQN of its leaf if
-- the leaf before the step, `leaf`, is another. Returns nil if the step is not drawn.
local function places_of(step, leaf)
  if type(step) == "string" then return { step } end
  if type(step) ~= "table" or step.m or step.record then return nil end
  local places = {}
  for i, key in ipairs(step.taken or {}) do places[i] = key end
  if step.leaf ~= leaf then places[#places + 1] = step.leaf or nil end
  return places
end

-- Returns a table from the FQN of a state or the key of a transition to the numbers of
-- the steps that entered or took it, such as "1, 4".
local function steps_of(trace)
  local steps, count, leaf = {}, 0, nil
  for _, step in ipairs(trace or {}) do
    local places = places_of(step, leaf)
    if places then
      count, leaf = count + 1, type(step) == "table" and step.leaf or leaf
    end
    for _, place in ipairs(places or {}) do
      steps[place] = steps[place] and steps[place] .. ", " .. count or count
    end
  end
  return steps
end

-- Adds a text to states and arrows: how often a run entered the state or took the
-- transition, and in which steps of a trace.
local function mark_run(chart, coverage, trace)
  local steps = steps_of(trace)
  local function mark(element, texts, key, counts)
    if counts then
      local count = tonumber(counts[key]) or 0
      texts[#texts + 1] = count > 0 and ("(%s×)"):format(rfsm.text_of(count))
        or "(never)"
      element.mark = count > 0 and "covered" or "missed"
    end
    texts[#texts + 1] = steps[key] and "(step " .. steps[key] .. ")"
    element.mark = steps[key] and "traced" or element.mark
  end
  for _, node in ipairs(chart.nodes) do
    if is_state(node) then
      mark(node, node.rows, node.fqn, coverage and coverage.states)
    end
  end
  for _, arrow in ipairs(chart.all) do
    mark(arrow, arrow.parts, arrow.key, coverage and coverage.transitions)
  end
end

local function is_a(kind, other)
  return function(x) return not x or type(x) == kind or type(x) == other end
end

-- For each option: a text of what is expected, the test of a value, and the default.
local OPTIONS = {
  title = { "string", is_a("string", "number") }, foot = { "string", is_a "string" },
  depth = { "number", is_a "number" },
  active = { "string", is_a("string", "table") },
  within = { "string", is_a "string" }, folded = { "list", is_a "table" },
  coverage = { "table", is_a "table" },
  trace = { "table", is_a "table" }, like = { "string", is_a "string" },
  direction = { "'TB' or 'LR'", function(x) return x == "TB" or x == "LR" end, "TB" },
  sheet = { "'a4', 'slide' or 'WIDTHxHEIGHT'", function(x)
    return type(x) == "string" and choice.size_of(x)
  end, "a4" },
}

local function is_description(value)
  return type(value) == "table" and type(value.id) == "string" and value.type == "state"
end

-- Returns what a description has at an FQN; nil if there is nothing.
local function part_of(tab, fqn)
  for id in fqn:gmatch("%.([^.]+)") do
    local found
    for _, member in ipairs(tab and members(tab) or {}) do
      found = member.id == id and member or found
    end
    tab = found
  end
  return tab
end

-- Reads a description; returns false if it lacks the state in the option `within`.
local function read_description(chart, tab, settings)
  local fqn = settings.within or "root"
  local top = part_of(tab, fqn)
  if not top then return false end
  for _, name in ipairs(settings.folded or {}) do chart.folded[name] = true end
  chart.root = read_node(chart, top, chart.top, fqn, settings.depth or 1 / 0)
  if settings.like then keep_order(chart, settings.like) end
  diagram.each_transition(tab, marsh.gen_event_text(), function(...)
    read_transition(chart, ...)
  end)
  return true
end

local function title_of(value)
  local title = clean(tostring(value or ""))
  return title ~= "" and title or nil
end

--- Return the chart of a machine or of a description. An error names the public
-- function `where`, and blames its caller.
function diagram.read(source, where, options)
  local is_read = is_description(source)
  if not is_read then rfsm.check_machine(source, where, 4) end
  local settings, problem = opts.read(OPTIONS,
    type(options) == "table" and options or { title = options })
  if not settings then error(where .. ": " .. problem, 3) end
  local chart = {
    title = title_of(settings.title), direction = settings.direction,
    foot = settings.foot, sheet = choice.size_of(settings.sheet),
    top = { kind = "top", nodes = {}, arrows = {}, depth = -1 },
    nodes = {}, all = {}, by_fqn = {}, taken = {}, folded = {},
    outside = {}, has_links = settings.within ~= nil,
  }
  local tab = is_read and source or marsh.model2tab(source, true)
  local ok, found = pcall(read_description, chart, tab, settings)
  if not ok then
    error(where .. ": description by rfsm.marsh expected, got another table", 3)
  elseif not found then
    error(("%s: within: no state is named '%s'"):format(where, settings.within), 3)
  end
  if settings.active then mark_active(chart, settings.active, where) end
  mark_run(chart, settings.coverage, settings.trace)
  place_arrows(chart)
  return chart
end

--- Return the label of an arrow.
function diagram.label_of(arrow)
  arrow.label_text = arrow.label_text or concat(diagram.wrap(arrow.parts, 28), "\n")
  return arrow.label_text
end

--- Append a line, indented by `depth` levels.
function diagram.add(lines, depth, text)
  lines[#lines + 1] = ("  "):rep(depth) .. text
end

--- The module for a diagram language. Both functions take an initialised fsm, or a
-- description. A string in place of the options is the title.
---@class rfsm.pictures.Exporter
---@field encode fun(fsm: rfsm.Machine, opts?: rfsm.pictures.Options|string): string
---@field save fun(fsm: rfsm.Machine, file: string, opts?: rfsm.pictures.Options|string)

--- Make the module for a diagram language. `draw(chart)` returns the text of a picture.
-- The module is also set as the global variable `global`, which older programs expect.
function diagram.exporter(name, global, draw)
  local exporter = {}

  -- These languages have no text below a picture, so the foot is put behind the title.
  local function text_of(chart)
    if chart.foot then
      chart.title = ("%s (%s)"):format(chart.title or chart.root.name,
        clean(chart.foot))
    end
    return (draw(chart))
  end

  function exporter.encode(fsm, options)
    return (text_of(diagram.read(fsm, name .. ".encode", options)))
  end

  function exporter.save(fsm, file, options)
    local chart = diagram.read(fsm, name .. ".save", options)
    opts.check_file(name .. ".save", file)
    local ok, problem = files.write(file, text_of(chart))
    if not ok then error(name .. ".save: " .. problem, 2) end
  end

  if not rawget(_G, "RFSM_NO_GLOBALS") then rawset(_G, global, exporter) end
  return exporter
end

return diagram
