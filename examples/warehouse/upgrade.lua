-- A new version of orders while the warehouse works:
--
--    LUA examples/warehouse/upgrade.lua URL [ORDERS]
--
-- Prints first what `rfsm redis --diff` says: what will happen to orders in each state.
-- Then it loads both versions. An order moves at its next event; those that wait for
-- none are moved at the end.

package.path = "./?.lua;" .. package.path

local fleet = require "rfsm.fleet"
local redis = require "rfsm.redis"

local OLD, NEW = "examples/warehouse/order.lua", "examples/warehouse/next/order.lua"

local url, count = arg[1], tonumber(arg[2]) or 40
if not url then
  io.stderr:write("usage: upgrade.lua redis://HOST:PORT [ORDERS]\n")
  os.exit(2)
end

local orders = fleet.connect(url, { name = "order", tags = 4 })
assert(orders:load((redis.bundle { "order=" .. OLD })))
for i = 1, count do
  assert(orders:create(i, "order", { item = "bolts" }))
  if i % 4 ~= 0 then assert(orders:send(i, "e_paid")) end
end

local ANSWERS = { pick = "e_picked", pack = "e_packed" }

-- Does a part of what orders have emitted, as workers do it all the time.
local function work(limit)
  local done = 0
  orders:work("staff", "worker 1", function(entry)
    done = done + 1
    assert(orders:send_once(entry.id, entry.machine, ANSWERS[entry.what]))
  end, { count = limit })
  orders:wake()
  return done
end

-- Returns how many orders are of each version, and in each state.
local function summary()
  local versions, leaves = {}, {}
  for i = 1, count do
    local view = assert(orders:get(i))
    versions[view.version] = (versions[view.version] or 0) + 1
    leaves[view.leaf] = (leaves[view.leaf] or 0) + 1
  end
  return versions, leaves
end

work(math.ceil(count / 8))
work(math.ceil(count / 16))
local old = next((summary()))

local diff = assert(io.popen(("tools/rfsm redis order=%s order=%s --diff"):format(OLD,
  NEW)))
io.write(diff:read("*a"))
diff:close()

assert(orders:load((redis.bundle { "order=" .. OLD, "order=" .. NEW })))
repeat until work(count) == 0

local versions = summary()
print(("%d of %d orders have moved at their next event"):format(count
  - (versions[old] or 0), count))
for i = 1, count do assert(orders:tick(i)) end

local leaves
versions, leaves = summary()
print(("%d are left; %d shipped, %d received"):format(versions[old] or 0,
  leaves["root.shipped"] or 0, leaves["root.received"] or 0))
for i = 1, count do assert(assert(orders:get(i)).data.root.parcels == 1) end
