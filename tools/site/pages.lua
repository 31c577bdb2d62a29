-- Completes the pages that ldoc has made: pages.lua OUT PICTURE.svg ...
--
-- Adds the gallery, the description of each example in the index, the playground and
-- links to it if OUT/playground.html is there.

local out = table.remove(arg, 1)

local function read(name)
  local handle = io.open(name, "rb")
  local text = handle and handle:read("*a")
  if handle then handle:close() end
  return text
end

local function write(name, text)
  local handle = assert(io.open(name, "wb"))
  handle:write(text)
  handle:close()
end

-- Puts a text in place of a mark, as it stands.
local function put(page, mark, text)
  return (page:gsub(mark, function() return text end))
end

local CODES = { ["&"] = "&amp;", ["<"] = "&lt;", [">"] = "&gt;" }

-- Returns the first sentence of the comment at the start of a file, as HTML.
local function brief(text)
  local comment, sentence = ("\n" .. text):gsub("\n/%* ?", "\n-- ")
    :gsub("\n %* ?", "\n-- "), ""
  for line in comment:gmatch("\n%-%- ?([^\n]*)") do
    if line == "" then break end
    if not line:find("^%S+%.lua$") then sentence = sentence .. line .. " " end
  end
  if sentence == "" then return "The chart of the introduction." end
  return (sentence:match("^(.-[^.]%.)%s") or sentence):gsub("[&<>]", CODES)
end

local has_playground = read(out .. "/playground.html") ~= nil

-- Returns a link that opens a chart in the playground; "" without one.
local function link_to(name, up)
  if not has_playground then return "" end
  return ('<p><a href="%splayground.html#example=%s">Open in the playground</a></p>\n')
    :format(up, name)
end

-- The picture of each chart, below the text of doc/gallery/README.md about it.
local function gallery(shell)
  local parts = { "<h1>Gallery</h1>\n<p>The charts of the examples, and some that are "
    .. "hard to draw, as <code>rfsm viz</code> draws them.</p>\n" }
  for _, file in ipairs(arg) do
    local name = file:match("([%w_]+)%.svg$")
    -- _lr: from left to right; walk: the chart of the README moves
    local chart = name:gsub("_lr$", ""):gsub("^walk$", "lamp") .. ".lua"
    local text = read("examples/" .. chart) or read("doc/gallery/" .. chart)
    parts[#parts + 1] = ('<h2 id="NAME">NAME</h2>\n<p>%s</p>\n%s'
      .. '<p><a href="gallery/NAME.svg">'
      .. '<img src="gallery/NAME.svg" alt="the chart NAME" loading="lazy"></a></p>\n')
      :gsub("NAME", name):format(brief(text), link_to(chart, ""))
    write(out .. "/gallery/" .. name .. ".svg", read(file))
  end
  write(out .. "/gallery.html", put(shell, "<main>.*</main>",
    "<main>\n" .. table.concat(parts) .. "</main>"))
end

-- Completes a page: `up` leads to the folder of the index.
local function complete(page, up)
  page = page:gsub("<!%-%-example (%S+)%-%->", function(name)
    return read("examples/" .. name) and link_to(name, up) or ""
  end)
  page = page:gsub("<!%-%-brief (%S+)%-%->", function(name)
    for _, folder in ipairs { "", "hosts/", "hosts/love/", "warehouse/" } do
      local text = read("examples/" .. folder .. name)
      if text then return brief(text) end
    end
  end)
  local more = ('<a href="%sgallery.html">Gallery</a>\n'):format(up)
  if has_playground then
    more = more .. ('<a href="%splayground.html">Playground</a>\n'):format(up)
  end
  return put(page, "</nav>", more .. "</nav>")
end

-- The playground with its first chart, below the moving picture of the index.
local LIVE = '<iframe class="live" src="playground.html" loading="lazy" '
  .. 'title="The playground: a chart to change and to run"></iframe>\n'

-- Puts the playground into the index.
local function with_playground(page)
  if not has_playground then return page end
  return (page:gsub('(<img src="gallery/walk%.svg"[^>]*></p>\n)', function(picture)
    return picture .. LIVE
  end))
end

local index = with_playground(complete(read(out .. "/index.html"), ""))
gallery(index)
write(out .. "/index.html", index)
for line in io.lines(out .. "/pages") do
  local name = out .. "/" .. line
  write(name, complete(read(name), "../"))
end
os.remove(out .. "/pages")
