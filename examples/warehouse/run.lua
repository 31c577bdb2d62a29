-- A warehouse at work:  LUA examples/warehouse/run.lua URL [ORDERS]
--
-- Loads the chart of an order into a Redis server, takes orders, and is a worker that
-- does what they emit, and that wakes them. Any number of such workers may run.

package.path = "./?.lua;" .. package.path

local fleet = require "rfsm.fleet"
local redis = require "rfsm.redis"
local socket = require "socket"

local url, count = arg[1], tonumber(arg[2]) or 12
if not url then
  io.stderr:write("usage: run.lua redis://HOST:PORT [ORDERS]\n")
  os.exit(2)
end

local orders = fleet.connect(url, { name = "order", tags = 4 })
assert(orders:load((redis.bundle { "order=examples/warehouse/order.lua" })))

-- Take orders; each fourth is never paid.
local ITEMS = { "bolts", "nuts", "gears" }
for i = 1, count do
  assert(orders:create(i, "order", { item = ITEMS[i % 3 + 1] }))
  if i % 4 ~= 0 then assert(orders:send(i, "e_paid")) end
end

-- What a picker or a packer does. The shelf with gears is empty at first.
local ANSWERS = {
  pick = function(data)
    return data.item == "gears" and data.try == 1 and "e_empty" or "e_picked"
  end,
  pack = function() return "e_packed" end,
}

local function work(entry)
  local event = ANSWERS[entry.what](entry.data)
  print(("%-14s %s %s -> %s"):format(entry.machine, entry.what, entry.data.item, event))
  assert(orders:answer(entry, event))
end

local function summary()
  local leaves, is_over = {}, true
  for i = 1, count do
    local leaf = assert(orders:get(i)).leaf
    leaves[leaf] = (leaves[leaf] or 0) + 1
    is_over = is_over and (leaf == "root.shipped" or leaf == "root.cancelled")
  end
  return is_over, leaves
end

local is_over, leaves
repeat
  local done = orders:work("staff", "worker 1", work) + orders:wake()
  if done == 0 then socket.sleep(0.1) end
  is_over, leaves = summary()
until is_over

print(("%d shipped, %d cancelled"):format(leaves["root.shipped"] or 0,
  leaves["root.cancelled"] or 0))
