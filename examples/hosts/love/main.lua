-- A host: LÖVE. The guard of guard.lua, beside him his chart, drawn live by Graphviz.
--
--   love examples/hosts/love [SECONDS]         from the top of the checkout
--
-- The thief walks up and down; while a mouse button is down, he is where the mouse is.

package.path = "./?.lua;" .. package.path

local love = love -- luacheck: ignore 113
local rfsm, dot = require "rfsm", require "rfsm.dot"

local now, pictures, leaf = 0, {}, nil
local at = {
  guard = { x = 60, y = 200 }, thief = { x = 340, y = 200 }, trace = { x = 0, y = 0 },
  north = { x = 200, y = 60 }, east = { x = 300, y = 200 }, west = { x = 60, y = 340 },
}

local model = rfsm.load "examples/hosts/love/guard.lua"
function model.gettime() return math.floor(now), now % 1 * 1e9 end -- the game's time
function model.dbg(id, name) if id == "STATE_ENTER" then print(name) end end
local fsm = assert(rfsm.init(model))

local function distance(a, b) return math.sqrt((a.x - b.x) ^ 2 + (a.y - b.y) ^ 2) end

local function walk(who, x, y, step)
  local part = step / math.max(distance(who, { x = x, y = y }), step)
  who.x, who.y = who.x + (x - who.x) * part, who.y + (y - who.y) * part
end

love.window.setMode(800, 600)
rfsm.run(fsm)

function love.update(dt)
  now = now + dt
  if now > (tonumber(arg[2]) or math.huge) then love.event.quit() end
  local x, y = 340, 200 + 200 * math.sin(now)
  if love.mouse.isDown(1) then x, y = love.mouse.getPosition() end
  walk(at.thief, x, y, 300 * dt)
  local is_seen = distance(at.guard, at.thief) < 110
  if is_seen then at.trace.x, at.trace.y = at.thief.x, at.thief.y end
  local is_there = distance(at.guard, at[fsm.goal]) < 9
  rfsm.send_events(fsm, is_seen and "e_seen" or "e_lost", is_there and "e_there" or nil)
  rfsm.run(fsm)
  walk(at.guard, at[fsm.goal].x, at[fsm.goal].y, 100 * dt)
  leaf = rfsm.get_actleaf_fqn(fsm)
end

function love.draw()
  if not pictures[leaf] then -- once for each state: Graphviz takes longer than a frame
    local png = assert(dot.render(dot.encode(fsm), "png"))
    pictures[leaf] = love.graphics.newImage(love.filesystem.newFileData(png, "png"))
  end
  love.graphics.clear(1, 1, 1)
  love.graphics.draw(pictures[leaf], 400, 0, 0, 600 / pictures[leaf]:getHeight())
  for name, colour in pairs { guard = { 0, 0.4, 0.7 }, thief = { 0.8, 0.3, 0 } } do
    love.graphics.setColor(colour) -- any order: they are apart
    love.graphics.circle("fill", at[name].x, at[name].y, 9)
  end
  love.graphics.setColor(1, 1, 1)
end
