-- The drawn graph, parsed again from dot, PlantUML and Mermaid, has exactly the nodes,
-- the arrows and the nesting of the chart.

local diagram = require "rfsm.pictures.diagram"
local dot = require "rfsm.dot"
local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local pictures = require "spec.support.pictures"
local rfsm = require "rfsm"

-- What should be drawn: read from the description -----------------------------------

local function new_graph()
  return { parents = {}, names = {}, arrows = {}, seen = {} }
end

local function add_node(graph, id, parent, name)
  assert(not graph.parents[id], "two nodes have the id " .. id)
  graph.parents[id], graph.names[id] = parent or "", name
end

local function add_arrow(graph, src, tgt)
  graph.arrows[#graph.arrows + 1] = src .. " -> " .. tgt
end

local function new_id(graph, fqn)
  local plain = fqn:gsub("[^%w]", "_")
  local id, count = plain, 1
  while graph.seen[id] do
    count = count + 1
    id = plain .. "_" .. count
  end
  graph.seen[id] = true
  return id
end

local function is_inside(fqn, composite)
  return fqn:sub(1, #composite + 1) == composite .. "."
end

-- The graph of a description, the id of each FQN, and the transitions.
local function graph_of(tab)
  local graph, ids, transitions = new_graph(), {}, {}
  local function visit(node, fqn, parent)
    ids[fqn] = new_id(graph, fqn)
    add_node(graph, ids[fqn], parent and ids[parent],
      node.type == "state" and diagram.clean(node.id) or false)
    for _, tr in ipairs(node.transitions or {}) do
      if not tr.internal then transitions[#transitions + 1] = tr end
    end
    for _, field in ipairs { "subnodes", "regions" } do
      for _, subnode in ipairs(node[field] or {}) do
        visit(subnode, fqn .. "." .. subnode.id, fqn)
      end
    end
  end
  visit(tab, "root", nil)
  for _, tr in ipairs(pictures.drawn_arrows(transitions)) do
    local composite = tr.tgt:match("^(.*)%.initial$")
    local is_outer = composite and not is_inside(tr.src, composite)
    add_arrow(graph, ids[tr.src], ids[is_outer and composite or tr.tgt])
  end
  return graph, ids
end

-- Dot -------------------------------------------------------------------------------

-- Returns where the brackets that open at a position close.
local function bracket_end(text, position)
  local is_quoted = false
  while true do
    position = text:find('["\\%]<]', position + 1)
    local character = text:sub(position, position)
    if character == "\\" then
      position = position + 1
    elseif character == '"' then
      is_quoted = not is_quoted
    elseif character == "<" and not is_quoted then
      position = select(2, text:find("%b<>", position))
    elseif not is_quoted then
      return position
    end
  end
end

local function value_of(attributes, name)
  local value = attributes:match("[%[ ]" .. name .. "=([%w_]+)")
    or attributes:match("[%[ ]" .. name .. '="(.-[^\\])"')
  return value
end

-- The statements of a graph: what is in front of brackets, and what is in them.
local function statements_of(text)
  local list, position = {}, 1
  while true do
    local from, stop, head, mark = text:find("^[;%s]*([^\n%[{}]-)%s*([%[{}])", position)
    if not from then return list end
    position = stop + 1
    local attributes = ""
    if mark == "[" then
      local last = bracket_end(text, stop)
      attributes, position = text:sub(stop, last), last + 1
    end
    head = head:gsub('"', "") -- Graphviz quotes long identifiers
    list[#list + 1] = { head = head, mark = mark, attributes = attributes }
  end
end

-- Adds the arrows of edges, of which some are the two halves of one.
local function add_edges(graph, edges, order)
  for _, key in ipairs(order) do
    local edge = edges[key]
    assert(edge.src and edge.tgt, "half of an arrow is missing: " .. key)
    add_arrow(graph, edge.src, edge.tgt)
  end
end

local function read_edge(statement, edges, order, labels)
  local tail, head = statement.head:match("^([%w_]+)%S* %-> ([%w_]+)")
  local attributes = statement.attributes
  tail = (value_of(attributes, "ltail") or tail):gsub("^cluster_", "")
  head = (value_of(attributes, "lhead") or head):gsub("^cluster_", "")
  local key = value_of(attributes, "id")
  local whole, half = key:match("^(.*)/(%l+)$")
  key = whole and whole:gsub("/" .. half .. "\\n", "\\n") or key
  if not edges[key] then edges[key], order[#order + 1] = {}, key end
  local edge = edges[key]
  if not half then
    edge.src, edge.tgt = tail, head
    if attributes:find("dir=back", 1, true) then edge.src, edge.tgt = head, tail end
  else
    edge[half] = labels[tail] and head or tail
  end
end

local function read_dot(text)
  local graph, edges, order, labels, stack = new_graph(), {}, {}, {}, {}
  for _, statement in ipairs(statements_of(text:match("{(.*)$"))) do
    local head, attributes = statement.head, statement.attributes
    local cluster = head:match("^subgraph cluster_(.*)$")
    if cluster then
      add_node(graph, cluster, stack[#stack])
      stack[#stack + 1] = cluster
    elseif statement.mark == "}" then
      stack[#stack] = nil
    elseif head:find("->", 1, true) then
      read_edge(statement, edges, order, labels)
    elseif (value_of(attributes, "class") or ""):find("^transition") then
      labels[head] = true
    elseif attributes:find("class=", 1, true) and head ~= "graph" then
      add_node(graph, head, stack[#stack])
    end
  end
  add_edges(graph, edges, order)
  return graph
end

-- PlantUML and Mermaid: a statement a line ------------------------------------

-- Reads a text; `decode` gives a name as it was.
local function read_lines(text, decode)
  local graph, stack = new_graph(), {}
  for line in text:gmatch("[^\n]+") do
    local name, id = line:match('^ *state "(.*)" as ([%w_]+)')
    id = id or line:match("^ *state ([%w_]+) <<choice>>$")
    local src, tgt = line:match("^ *(%S+) %-%-> ([%w_]+)")
    if id then
      add_node(graph, id, stack[#stack], name and decode(name) or false)
      if line:sub(-1) == "{" then stack[#stack + 1] = id end
    elseif line:find("^ *}$") then
      stack[#stack] = nil
    elseif src then
      add_arrow(graph, src == "[*]" and "[*] in " .. (stack[#stack] or "") or src, tgt)
    end
  end
  return graph
end

local function plantuml_name(text)
  return (text:gsub("\\n", "\n"):gsub("<U%+(%x+)>", function(code)
    return string.char(tonumber(code, 16))
  end))
end

local function mermaid_name(text)
  return (text:gsub("<br>", "\n"):gsub("#(%d+);", function(code)
    return string.char(tonumber(code))
  end))
end

-- What a language draws in another way ----------------------------------------------

-- A copy of a graph in which ids may be others: rename(id, is_src) gives each.
local function renamed(graph, rename)
  local copy = new_graph()
  for id, parent in pairs(graph.parents) do -- any order: by id
    local new = rename(id)
    if new then add_node(copy, new, rename(parent) or "", graph.names[id]) end
  end
  for _, arrow in ipairs(graph.arrows) do
    local src, tgt = arrow:match("^(.*) %-> (.*)$")
    add_arrow(copy, rename(src, true), rename(tgt, false))
  end
  return copy
end

-- PlantUML: an initial is [*] of its composite, and the composite where it is a target.
local function as_plantuml(graph, is_initial)
  return renamed(graph, function(id, is_src)
    if not is_initial[id] then return id end
    if is_src then return "[*] in " .. graph.parents[id] end
    return is_src == false and graph.parents[id] or nil
  end)
end

-- Does no arrow lead to an initial, and all from it stay in its composite?
local function is_plain(graph, initial)
  for _, arrow in ipairs(graph.arrows) do
    local src, tgt = arrow:match("^(.*) %-> (.*)$")
    local parent = graph.parents[tgt]
    while parent and parent ~= graph.parents[initial] do
      parent = graph.parents[parent]
    end
    if tgt == initial or src == initial and not parent then return false end
  end
  return true
end

-- Mermaid: no frame for the root, a leaf where arrows use it; an initial is [*],
-- or a diamond behind one.
local function as_mermaid(graph, is_initial)
  local diamonds = {}
  for id in pairs(is_initial) do -- any order: by id
    diamonds[id] = not is_plain(graph, id)
  end
  local copy = renamed(graph, function(id, is_src)
    if id == "root" then return is_src ~= nil and "root_" or nil end
    if not is_initial[id] or diamonds[id] then return id end
    local parent = graph.parents[id]
    return is_src and "[*] in " .. (parent == "root" and "" or parent) or nil
  end)
  for id in pairs(diamonds) do -- any order: arrows are sorted
    local parent = graph.parents[id]
    if diamonds[id] then
      add_arrow(copy, "[*] in " .. (parent == "root" and "" or parent), id)
    end
  end
  return copy
end

-- Comparison ------------------------------------------------------------------------

-- Names without blanks behind them, which Mermaid cuts off.
local function text_of(graph, has_names)
  local lines = {}
  for id, parent in pairs(graph.parents) do -- any order: sorted below
    local name = has_names and graph.names[id]
    lines[#lines + 1] = ("%s in '%s'%s"):format(id, parent,
      name and " is " .. name:gsub(" +$", "") or "")
  end
  for _, arrow in ipairs(graph.arrows) do lines[#lines + 1] = arrow end
  table.sort(lines)
  return table.concat(lines, "\n")
end

-- The first lines in which two texts differ; nil if there are none.
local function difference(expected, found)
  if expected == found then return nil end
  local counts, list = {}, {}
  local function count(text, step)
    for line in text:gmatch("[^\n]+") do counts[line] = (counts[line] or 0) + step end
  end
  count(expected, 1)
  count(found, -1)
  for _, line in ipairs(rfsm.sorted_keys(counts)) do
    if counts[line] ~= 0 then
      list[#list + 1] = (counts[line] > 0 and "lacks " or "has ") .. line
    end
  end
  return table.concat(list, ", ", 1, math.min(#list, 5))
end

-- The real parsers: each prints again what it has parsed -----------------------------

-- Returns a graph as Graphviz has parsed it.
local function parsed_by_graphviz(text)
  local name = helper.write(os.tmpname(), text)
  local output = helper.text_of("nop '" .. name .. "'")
  os.remove(name)
  return (output:gsub("\\\n", ""):gsub("%s+", " "))
end

-- Returns diagrams as Mermaid has parsed them, which npm has installed in a folder.
local function parsed_by_mermaid(texts, folder)
  local names, outputs = {}, {}
  for i, text in ipairs(texts) do names[i] = helper.write(os.tmpname(), text) end
  local script = folder .. "/print.mjs"
  os.execute(("cp spec/support/mermaid.mjs '%s'"):format(script))
  local output = helper.text_of(("node '%s' --print %s"):format(script,
    table.concat(names, " ")))
  os.remove(script)
  for i, name in ipairs(names) do
    os.remove(name)
    local _, from = output:find("file " .. name .. "\n", 1, true)
    local to = from and output:find("file /", from, true)
    outputs[i] = from and output:sub(from, to and to - 1) or output
  end
  return outputs
end

-- The claim -------------------------------------------------------------------------

local function compare(language, expected, found, has_names)
  local problem = difference(text_of(expected, has_names), text_of(found, has_names))
  return problem and language .. " " .. problem
end

-- Returns what is wrong with the graphs of a description; nil if nothing is.
local function problem_of_dot(tab, graph, has_graphviz)
  local text = dot.encode(tab)
  local problem = compare("dot", graph, read_dot(text))
  if problem or not has_graphviz then return problem end
  local laid_out = assert(dot.layout(tab))
  return compare("layout", graph, read_dot(laid_out))
    or compare("parsed dot", graph, read_dot(parsed_by_graphviz(text)))
    or compare("parsed layout", graph, read_dot(parsed_by_graphviz(laid_out)))
end

-- Returns what is wrong with the pictures of a machine, nil if nothing is; the text for
-- Mermaid, and the graph that it should have.
local function problem_of(fsm, has_graphviz)
  local tab = marsh.model2tab(fsm, true)
  local graph, ids = graph_of(tab)
  local is_initial = {}
  for fqn, id in pairs(ids) do -- any order: a set
    is_initial[id] = fqn:find("%.initial$") and true or nil
  end
  local mermaid = as_mermaid(graph, is_initial)
  local text = require("rfsm.mermaid").encode(tab)
  local drawn = read_lines(text, mermaid_name)
  if drawn.parents.root_ then add_node(mermaid, "root_", "", "root") end
  return problem_of_dot(tab, graph, has_graphviz)
    or compare("PlantUML", as_plantuml(graph, is_initial),
      read_lines(require("rfsm.plantuml").encode(tab), plantuml_name), true)
    or compare("Mermaid", mermaid, drawn, true), text, mermaid
end

return {
  name = "pictures",

  --- Compares the pictures of `n` random charts from `seed` on. Returns how many, and
  -- what is wrong, if anything is.
  run = function(n, seed)
    local has_graphviz = dot.render("digraph { }", "dot") ~= nil
    local texts, graphs, folder = {}, {}, os.getenv("MERMAID")
    for i = 1, n do
      local number = seed + i - 1
      local model = number % 2 == 0 and pictures.wide_model(number)
        or pictures.model(number, 6)
      local fsm = assert(rfsm.init(model))
      local ok, problem, text, graph = pcall(problem_of, fsm, has_graphviz)
      if problem then return i, ("chart %d: %s"):format(seed + i - 1, problem) end
      assert(ok)
      texts[i], graphs[i] = text, graph
    end
    for i, output in ipairs(folder and parsed_by_mermaid(texts, folder) or {}) do
      local ok, problem = pcall(function()
        local found = read_lines(output, mermaid_name)
        return compare("parsed Mermaid", graphs[i], found, true)
      end)
      if problem then return i, ("chart %d: %s"):format(seed + i - 1, problem) end
      assert(ok)
    end
    return n
  end,
}
