-- Prints a moving picture of a machine:  LUA tools/walk.lua CHART EVENT ... > FILE.svg
--
-- Each event is sent to the machine of the chart, and run. The picture that Graphviz
-- makes of it shows the active states one after the other, with the event, and what the
-- chart has printed, below. The colours are those of `rfsm viz --active`.

package.path = "./?.lua;" .. package.path

local dot = require "rfsm.dot"
local rfsm = require "rfsm"

local SECONDS = 2 -- for each event
local LOOKS = { "fill", "stroke", "stroke-width" }
local printed = {}

-- Returns the picture of a machine, by Graphviz.
local function picture_of(fsm, title)
  local looks = { title = title }
  return assert(dot.render(dot.layout(fsm, looks) or dot.encode(fsm, looks), "svg"))
end

-- Runs the machine; returns its picture and the lines below it.
local function frame_of(fsm, title, event)
  printed = {}
  if event then rfsm.send_events(fsm, event) end
  rfsm.run(fsm)
  return { svg = picture_of(fsm, title), event = event or "run",
    text = table.concat(printed, ", ") }
end

-- Returns the first path of a state in a picture, and its looks.
local function path_of(svg, id)
  local _, last = svg:find('<g id="' .. id .. '"', 1, true)
  local path = last and svg:match("<path[^>]*/>", last)
  local looks = { ["stroke-width"] = "1" }
  for name, value in (path or ""):gmatch('([%w-]+)="([^"]*)"') do
    looks[name] = value
  end
  return path, looks
end

-- Returns an element that gives an attribute a value for each frame; "" if all are one.
local function animate(name, values)
  local is_one = true
  for _, value in ipairs(values) do is_one = is_one and value == values[1] end
  if is_one then return "" end
  return ('<animate attributeName="%s" dur="%ds" repeatCount="indefinite" '
    .. 'calcMode="discrete" values="%s"/>'):format(name, #values * SECONDS,
    table.concat(values, ";"))
end

-- Returns the path of a state with the looks that it has in the frames.
local function moving_path(frames, id)
  local elements = ""
  for _, name in ipairs(LOOKS) do
    local values = {}
    for i, frame in ipairs(frames) do
      values[i] = select(2, path_of(frame.svg, id))[name]
    end
    elements = elements .. animate(name, values)
  end
  local path = path_of(frames[1].svg, id)
  return path, path:gsub("/>$", function() return ">" .. elements .. "</path>" end)
end

local function escape(text)
  return (text:gsub("[&<>]", { ["&"] = "&amp;", ["<"] = "&lt;", [">"] = "&gt;" }))
end

-- Returns the lines below the picture: of each frame, at its time.
local function captions(frames, width, height)
  local texts = {}
  for i, frame in ipairs(frames) do
    local values = {}
    for n = 1, #frames do values[n] = n == i and "inline" or "none" end
    texts[i] = ('<g display="%s" text-anchor="middle" font-family="Helvetica,Arial,'
      .. 'sans-serif"><text x="%d" y="%d" font-size="13" fill="#0072b2">%s</text>'
      .. '<text x="%d" y="%d" font-size="11">%s</text>%s</g>'):format(values[1],
      math.floor(width / 2), height + 16, escape(frame.event), math.floor(width / 2),
      height + 32, escape(frame.text), animate("display", values))
  end
  return table.concat(texts, "\n")
end

local file = arg[1]
local model = rfsm.load(file)
local show = print
print = function(text) printed[#printed + 1] = text end -- luacheck: ignore 121
local title = file:match("([^/]+)%.lua$")
local fsm = assert(rfsm.init(model))
local frames = { frame_of(fsm, title) }
for i = 2, #arg do frames[i] = frame_of(fsm, title, arg[i]) end

local svg = frames[1].svg
local width, height = svg:match('viewBox="0.00 0.00 ([%d.]+) ([%d.]+)"')
for _, state in ipairs(rfsm.elements(fsm, rfsm.is_state)) do
  local path, moving = moving_path(frames, state._fqn)
  local first, last = svg:find(path, 1, true)
  svg = svg:sub(1, first - 1) .. moving .. svg:sub(last + 1)
end
local tall = height + 44
svg = svg:gsub('height="[%d.]+pt"', ('height="%dpt"'):format(tall), 1)
  :gsub('viewBox="[^"]*"', ('viewBox="0 0 %d %d"'):format(width, tall), 1)
  :gsub("</svg>", function()
    return ('<rect y="%d" width="%d" height="44" fill="white"/>\n'):format(height,
      width) .. captions(frames, tonumber(width), tonumber(height)) .. "\n</svg>"
  end)
show((svg:gsub("\n$", "")))
