--- Large charts in several pictures: an overview, and a picture for each composite.
--
-- An overview has composites without the states in them. These, and the states outside
-- to which arrows lead, are links to the picture in which they are drawn.
--
-- @module rfsm.cli.pages
-- @license BSD-3-Clause

local diagram = require "rfsm.pictures.diagram"
local dot = require "rfsm.dot"
local files = require "rfsm.shared.files"
local looks = require "rfsm.pictures.looks"
local programs = require "rfsm.shared.programs"

local assert, ipairs, pairs, tonumber = assert, ipairs, pairs, tonumber
local concat, os = table.concat, os

local pages = {}

--- A picture.
---@class rfsm.cli.Page
---@field fqn string of the composite in it
---@field file string name of the file
---@field graph string

local MANY, READABLE = 60, 7 -- states in one picture; points of text

local function count_states(tab)
  local count = 0
  for _, member in ipairs(diagram.members(tab)) do
    count = count + (member.type == "state" and 1 or 0) + count_states(member)
  end
  return count
end

local function composites_in(tab)
  local list = {}
  for _, member in ipairs(diagram.members(tab)) do
    list[#list + 1] = diagram.kind_of(member) == "composite" and member or nil
  end
  return list
end

-- Returns a graph of a composite; nil and the problem, or the size of its text.
local function draw(tab, fqn, options, folded)
  local own = { within = fqn, folded = folded }
  for name, value in pairs(options) do own[name] = value end -- any order
  if fqn ~= "root" then own.title = options.title .. fqn:sub(5) end
  return dot.layout(tab, own)
end

-- Adds a picture of a composite; pictures of the composites in it if it is too large.
local function add(list, whole, tab, fqn, options)
  local kids, graph, problem, text = composites_in(tab), nil, nil, 0
  local is_large = kids[1] and count_states(tab) > MANY
  if not is_large then graph, problem, text = draw(whole, fqn, options) end
  is_large = is_large or kids[1] and graph and text < READABLE
  if is_large then
    local folded = {}
    for i, kid in ipairs(kids) do folded[i] = fqn .. "." .. kid.id end
    graph, problem = draw(whole, fqn, options, folded)
  end
  if not graph then error(problem, 0) end
  list[#list + 1] = { fqn = fqn, graph = graph }
  for _, kid in ipairs(is_large and kids or {}) do
    add(list, whole, kid, fqn .. "." .. kid.id, options)
  end
end

-- Returns the page that shows a state: the one of the innermost composite around it.
local function page_of(list, fqn)
  local best = list[1]
  for _, page in ipairs(list) do
    local is_around = (fqn .. "."):sub(1, #page.fqn + 1) == page.fqn .. "."
    if is_around and #page.fqn > #best.fqn then best = page end
  end
  return best
end

--- Return the pictures of a description; raise the problem if Graphviz fails. `ending`
-- is that of the names of files. The option `title` has to be given.
---@return rfsm.cli.Page[]
function pages.of(tab, options, ending)
  local list, addresses = {}, {}
  add(list, tab, tab, "root", options)
  for i, page in ipairs(list) do
    page.file = ("%02d-%s.%s"):format(i, page.fqn:gsub("[^A-Za-z0-9]+", "_"), ending)
  end
  local function visit(inner, fqn)
    addresses[looks.quoted(looks.URL .. fqn)] = page_of(list, fqn).file
    for _, member in ipairs(diagram.members(inner)) do
      visit(member, fqn .. "." .. member.id)
    end
  end
  visit(tab, "root")
  for _, page in ipairs(list) do
    page.graph = page.graph:gsub('URL=("[^"]*")', function(address)
      return 'URL="' .. addresses[address] .. '"'
    end)
  end
  return list
end

-- One PDF ---------------------------------------------------------------------

-- Prints a PDF, also as text. It repairs PDFs that Graphviz made with links.
local QPDF = "qpdf --no-warn --warning-exit-0 "
local HINT = "one PDF of all pages needs qpdf (on Debian: apt-get install qpdf)"

-- Returns the text of a PDF with links to pages in place of links to their files, whose
-- names begin with the number of the page.
local function linked(text)
  local objects = {}
  for page, object in text:gmatch("\n%%%% Page (%d+)\n%%%%[^\n]*\n(%d+) 0 obj\n") do
    objects[tonumber(page)] = object
  end
  return (text:gsub("/S /URI%s+/Type /Action%s+/URI %((%d+)[^\n]*%)", function(page)
    return "/S /GoTo /Type /Action /D [ " .. objects[tonumber(page)] .. " 0 R /Fit ]"
  end))
end

--- Join the PDFs of pages. Return one PDF, or nil and the problem.
function pages.join(pictures)
  local names = {}
  for i, picture in ipairs(pictures) do
    names[i] = os.tmpname()
    assert(files.write(names[i], picture))
  end
  local text, problem = programs.filter(QPDF .. "--empty --pages " .. concat(names, " ")
    .. " -- --qdf --object-streams=disable -", "", HINT)
  for _, name in ipairs(names) do os.remove(name) end
  if not text then return nil, problem end
  return programs.filter(QPDF .. "%s -", linked(text), HINT)
end

return pages
