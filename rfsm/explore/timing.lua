--- Timing: the order in which timers and the times of properties expire.
--
-- A clock runs for each active state with an e_after that has not come yet, for each
-- time of a property that a monitor measures, and for each event that is sent later. A
-- *zone* is the set of the values that all clocks may have when a step ends. A clock
-- has deadlines: the times at which its events come or the time of a property ends. A
-- *group* is a set of deadlines that are over when the next step begins, with the zone
-- of that moment. All deadlines of a group are equal, since the machine is stepped
-- between any two different ones. With a period, they are at most a period apart.
--
-- If timers are free, the clocks of events that are sent later are free, too: their
-- deadlines may be over at any time.
--
-- An e_every has a clock of its own, which goes back when its event has come. If a
-- machine takes events one by one, groups whose order is not known are left out.
--
-- A step takes no time. An e_at, or a timer whose seconds come from a function, has no
-- clock: its event may come at any time. Zones need no extrapolation, since a clock is
-- dropped when its last deadline is over, or goes back: so its deadlines bound it.
--
-- @module rfsm.explore.timing
-- @license BSD-3-Clause

local rfsm = require "rfsm"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local zones = require "rfsm.explore.zones"

local ipairs, math, setmetatable, table = ipairs, math, setmetatable, table
local ceil, concat, floor = math.ceil, table.concat, math.floor
local huge, max = math.huge, math.max

local timing = {}

--- The clocks of a walk.
---@class rfsm_checks.Timing
---@field subject rfsm_checks.Subject
---@field clocks rfsm_checks.Clock[]
---@field of table<table, rfsm_checks.Clock> clock of a property or delayed event
---@field pending integer most events that may wait to be sent
---@field is_timed boolean at least one clock is not free
---@field unit number all times are multiples of this number of nanoseconds
---@field period number|false longest time between two steps, in units; false: not given
---@field fired table<rfsm_checks.Occurrence, boolean> time events that have come
---@field is_cut boolean some groups were left out
---@field is_inexact boolean some times have too many units to be exact
---@field ranks table<rfsm_checks.Occurrence, integer> order of timers that come at once
---@field count integer number of ranks
---@field reads_one boolean a machine takes events one by one: their order counts
local Timing = {}
Timing.__index = Timing

--- A clock of a state, of a property, or of an event that is sent later. The clock of a
--- state runs once at a time, the other clocks may run several times at once.
---@class rfsm_checks.Clock
---@field number integer index in the list of clocks
---@field state? rfsm.State the state whose timers this clock measures
---@field judged? rfsm_checks.Judged the property whose time this clock measures
---@field later? rfsm_checks.Occurrence the event whose delay this clock measures
---@field is_free boolean|nil its deadline may be over at any time, or never
---@field is_shared boolean|nil of one of several properties: its deadline may be over
-- beside others at another time, so that no property waits for the steps of another
---@field is_repeated boolean|nil of an e_every: deadlines are multiples of the first
-- one, and the last of them is never over after one step
---@field deadlines number[] in rising order, in units
---@field events rfsm_checks.Occurrence[][] for each deadline, the events that come then

--- A clock that runs when a step has ended.
---@class rfsm_checks.Entry
---@field clock rfsm_checks.Clock
---@field passed integer how many of its deadlines are over

--- A set of deadlines that are over when the next step begins.
---@class rfsm_checks.Group
---@field number integer index in the list of groups
---@field over integer[] for each entry, how many more deadlines are over
---@field is_over boolean at least one deadline is over
---@field is_sure boolean if time goes on, no other group can come first
---@field ways integer how many groups can come first
---@field events rfsm_checks.Occurrence[] the events of these deadlines, in order
---@field zone number[] values of the clocks when the step begins
---@field bounds { [1]: integer, [2]: integer, [3]: number }[] bounds of this group on
-- the values: { i, j, bound }, see `rfsm.explore.zones`

-- Clocks ............................................................................

local BILLION = 1000000000
local MOST = 2 ^ 53 -- nanoseconds (104 days), below which numbers are exact
local MOST_UNITS = 2 ^ 50 -- so that bounds, which are twice as large, are exact, too

local function nanoseconds(seconds) return floor(seconds * BILLION + 0.5) end

-- Returns the nanoseconds of a timer; nil if they are unknown or too many. The fields
-- of `timer.event` are defined in `rfsm_timeevent`.
local function duration_of(timer)
  local event = timer.event
  if not event.is_relative or event.timeout then return nil end
  local duration = event.sec * BILLION + event.nsec
  return duration < MOST and duration or nil
end

-- Adds a clock to the list and returns it. Its deadlines are in nanoseconds.
local function add_clock(self, clock)
  clock.number = #self.clocks + 1
  self.clocks[clock.number] = clock
  return clock
end

local MANY_TIMES = 20 -- most times of an e_every that a clock counts between two steps

-- Adds the clock of an e_every, which is over `most` times between two steps at most.
-- Its event comes once then. Returns false if that is too often for a clock.
local function add_repeated(self, part, state, timer, duration)
  local most = max(ceil(1 + (self.period or 0) / duration) - 1, 1)
  if most > MANY_TIMES then return false end
  local deadlines, lists = {}, {}
  for i = 1, most + 1 do deadlines[i], lists[i] = i * duration, {} end
  lists[1][1] = self.subject:occurrence(part, timer.name)
  add_clock(self, { state = state, is_repeated = true, deadlines = deadlines,
    events = lists })
  return true
end

-- Adds the clocks of a state for the timers whose time is known: one for all of its
-- e_after.
local function add_state_clocks(self, part, state)
  local events = {} -- by deadline
  for _, timer in ipairs(state._timers or {}) do
    local duration = duration_of(timer)
    if duration then
      local occurrence = self.subject:occurrence(part, timer.name)
      self.count, self.ranks[occurrence] = self.count + 1, self.count
    end
    if duration and timer.event.is_repeated then
      part.timed[timer.name] = add_repeated(self, part, state, timer, duration)
    elseif duration then
      part.timed[timer.name] = true
      events[duration] = match.with(events[duration] or {},
        self.subject:occurrence(part, timer.name))
    end
  end
  local deadlines, lists = rfsm.sorted_keys(events), {}
  for i, duration in ipairs(deadlines) do lists[i] = events[duration] end
  if deadlines[1] then
    add_clock(self, { state = state, deadlines = deadlines, events = lists })
  end
end

-- Is there a time event without a clock?
local function has_free_timer(subject)
  for _, event in ipairs(subject.event_list) do
    local is_free = match.maker_of(event) == "timer"
    for _, part in ipairs(subject.parts) do
      is_free = is_free and not part.timed[event]
    end
    if is_free then return true end
  end
end

-- Adds the clock of events that are sent later.
local function add_later_clock(self, later, are_free)
  local duration = nanoseconds(later.after)
  local is_free = are_free or duration >= MOST
  if is_free then self.subject.free["sends with a delay"] = true end
  self.of[later] = add_clock(self, { later = later, is_free = is_free,
    deadlines = { is_free and 0 or duration }, events = { later.alone } })
end

local function add_clocks(self, list, are_free)
  for _, part in ipairs(are_free and {} or self.subject.parts) do
    for _, state in ipairs(rfsm.elements(part.fsm, rfsm.is_state)) do
      add_state_clocks(self, part, state)
    end
  end
  for _, judged in ipairs(list) do
    local seconds = judged.property.seconds
    self.of[judged] = seconds and add_clock(self, { judged = judged, events = { {} },
      deadlines = { nanoseconds(seconds) }, is_shared = list[2] ~= nil })
  end
  for _, later in ipairs(self.subject.later) do
    add_later_clock(self, later, are_free)
  end
end

local function greatest_divisor(a, b)
  while b > 0 do a, b = b, a % b end
  return a
end

-- Finds the greatest unit of which all times are multiples, and sets times in units.
local function set_unit(self)
  for _, clock in ipairs(self.clocks) do
    for _, deadline in ipairs(clock.deadlines) do
      self.unit = greatest_divisor(self.unit, deadline)
    end
  end
  if self.unit == 0 then self.unit = BILLION end
  local longest = 0
  for _, clock in ipairs(self.clocks) do
    self.is_timed = self.is_timed or not clock.is_free
    for i, deadline in ipairs(clock.deadlines) do
      clock.deadlines[i] = floor(deadline / self.unit)
      longest = max(longest, clock.deadlines[i])
    end
  end
  self.period = self.period and floor(self.period / self.unit)
  self.is_inexact = longest >= MOST_UNITS
end

--- Return the clocks that run as a text.
---@param entries rfsm_checks.Entry[]
---@return string
function timing.text_of(entries)
  local texts = {}
  for i, entry in ipairs(entries) do
    texts[i] = entry.clock.number .. "." .. entry.passed
  end
  return concat(texts, ",")
end

--- Return the clocks of a walk; false if there are none.
---@param walk rfsm_checks.Walk
---@param options { timers: string, period: number?, pending: integer }
---@return rfsm_checks.Timing|false
function timing.new(walk, options)
  local self = setmetatable({ subject = walk.subject, clocks = {}, of = {},
    period = options.period and nanoseconds(options.period) or false, fired = {},
    pending = options.pending, is_timed = false, is_cut = false, ranks = {}, count = 0,
    reads_one = order.any(walk.subject.parts, function(part)
      return part.reads_one
    end) }, Timing)
  self.unit = self.period or 0
  add_clocks(self, walk.monitors, options.timers == "free")
  walk.subject.free.timers = has_free_timer(walk.subject)
  if not self.clocks[1] then return false end
  set_unit(self)
  return self
end

-- Groups ............................................................................

local MANY_GROUPS = 200

-- Returns the bounds { i, j, bound } under which the next `over` deadlines of entry i
-- are over when a step begins. With a period, the step begins at most a period after
-- the first of these deadlines.
local function bounds_of(self, entry, i, over)
  if entry.clock.is_free then return {} end
  local deadlines, passed = entry.clock.deadlines, entry.passed
  local bounds, following = {}, deadlines[passed + over + 1]
  if over > 0 then
    bounds[1] = { 0, i, zones.below(-deadlines[passed + over]) }
    if self.period and not entry.clock.is_shared then
      bounds[2] = { i, 0, zones.at_most(deadlines[passed + 1] + self.period) }
    end
  end
  if following then bounds[#bounds + 1] = { i, 0, zones.at_most(following) } end
  return bounds
end

-- Returns the bound under which the next deadline of entry `one` is earlier (`bound` is
-- zones.below) or not later (zones.at_most) than the next deadline of entry `other`.
local function order_of(entries, one, other, bound)
  local longer = entries[other].clock.deadlines[entries[other].passed + 1]
    - entries[one].clock.deadlines[entries[one].passed + 1]
  return { other, one, bound(longer) }
end

local function bounded(zone, count, bounds)
  for _, bound in ipairs(bounds) do
    zone = zone and zones.bounded(zone, count, bound[1], bound[2], bound[3])
  end
  return zone
end

-- Returns x_i - x_j if the zone has one value for it; else nil.
local function difference(zone, count, i, j)
  local most, least = zone[i * (count + 1) + j + 1], zone[j * (count + 1) + i + 1]
  return most + least == 2 and floor(most / 2) or nil
end

-- Appends the events of an entry whose next `over` deadlines are over. Those of timers
-- have the time at which they come; the clock is ahead of the others by `ahead`.
local function append_events(list, entry, over, ahead)
  for n = entry.passed + 1, entry.passed + over do
    for _, event in ipairs(entry.clock.events[n]) do
      list[#list + 1] = entry.clock.state and { event = event,
        at = ahead and entry.clock.deadlines[n] - ahead or 0 } or event
    end
  end
end

-- Lists the events of the entries with these numbers whose deadlines are over, in the
-- order in which they come: those of timers by their deadlines, and equal ones by their
-- rank in the machine; then the others. The second result is false if the order of the
-- deadlines is not known.
local function events_of(self, entries, count, found, numbers)
  local timers, events, base, is_known = {}, {}, nil, true
  for _, i in ipairs(numbers) do
    local entry, ahead = entries[i], false
    if entry.clock.state and found.over[i] > 0 and self.period then
      base = base or i
      ahead = difference(found.zone, count, i, base)
      is_known = is_known and ahead ~= nil
    end
    append_events(entry.clock.state and timers or events, entry, found.over[i], ahead)
  end
  table.sort(timers, function(a, b)
    if a.at ~= b.at then return a.at < b.at end
    return self.ranks[a.event] < self.ranks[b.event]
  end)
  for i, timer in ipairs(timers) do table.insert(events, i, timer.event) end
  return events, is_known or not self.reads_one
end

-- Adds the group `found`. Its events come in the order of `numbers`, which are numbers
-- of entries. It is left out if their order is not known, and counts.
local function add_group(self, groups, entries, count, found, numbers)
  local events, is_known = events_of(self, entries, count, found, numbers)
  if not is_known then
    self.is_cut = true
    return
  end
  local group = { number = #groups + 1, over = found.over, is_over = false,
    events = events, zone = found.zone, bounds = found.bounds }
  for _, over in ipairs(found.over) do group.is_over = group.is_over or over > 0 end
  for _, event in ipairs(events) do self.fired[event] = true end
  groups[#groups + 1] = group
end

-- Adds a group for each order in which the events of the entries `rest` can follow the
-- events of the entries `numbers`. The events of `rest` were sent later. If two of them
-- come at the same time, they come in the order of sending.
local function add_orders(self, groups, entries, count, found, numbers, rest)
  if not rest[2] then
    return add_group(self, groups, entries, count, found, match.joined(numbers, rest))
  end
  for at, i in ipairs(rest) do
    local bounds, others = {}, {}
    for n, other in ipairs(rest) do
      if n ~= at then
        others[#others + 1] = other
        bounds[#bounds + 1] = order_of(entries, i, other,
          n > at and zones.at_most or zones.below)
      end
    end
    local zone = bounded(found.zone, count, bounds)
    if zone then
      local own = { over = found.over, zone = zone,
        bounds = match.joined(found.bounds, bounds) }
      add_orders(self, groups, entries, count, own, match.with(numbers, i), others)
    end
  end
end

-- Returns two lists of numbers of entries: entries whose events come in the order of
-- the list, and entries of sent events, which may come in any order. Without a period
-- the second list is empty: all events of a group come at one time.
local function numbers_of(self, entries, over)
  local numbers, sends = {}, {}
  for i, entry in ipairs(entries) do
    local clock = entry.clock
    local is_send = self.period and over[i] > 0 and clock.later and not clock.is_free
    local list = is_send and sends or numbers
    list[#list + 1] = i
  end
  return numbers, sends
end

-- Returns the unfinished group `found` with one more entry, of which the next `over`
-- deadlines are over. Returns nil if that is impossible.
local function extended(self, entries, count, found, over)
  local i, clock = #found.over + 1, entries[#found.over + 1].clock
  local bounds = bounds_of(self, entries[i], i, over)
  local is_apart = clock.is_free or clock.is_shared
  if over > 0 and found.first and not is_apart and not self.period then
    bounds[#bounds + 1] = order_of(entries, i, found.first, zones.at_most)
    bounds[#bounds + 1] = order_of(entries, found.first, i, zones.at_most)
  end
  local zone = bounded(found.zone, count, bounds)
  return zone and { over = match.with(found.over, over), zone = zone,
    bounds = match.joined(found.bounds, bounds),
    first = found.first or over > 0 and not is_apart and i or nil }
end

-- Adds all groups that begin with `found`, which has the first entries of a group.
local function add_groups(self, groups, entries, count, found)
  local entry = entries[#found.over + 1]
  if #groups >= MANY_GROUPS then
    self.is_cut = true
    return
  elseif not entry then
    return add_orders(self, groups, entries, count, found,
      numbers_of(self, entries, found.over))
  end
  local clock = entry.clock
  local last = #clock.deadlines - entry.passed - (clock.is_repeated and 1 or 0)
  for over = 0, self.period and last or 1 do
    local longer = extended(self, entries, count, found, over)
    if longer then add_groups(self, groups, entries, count, longer) end
  end
end

--- List the groups of deadlines that may be over when the next step begins. The first
--- group has no deadline that is over. While an event waits, the step is taken within a
--- period, so one more clock measures the time since the last step.
---@param conf rfsm_checks.Configuration
---@param is_driven boolean an event waits
---@return rfsm_checks.Group[]
function Timing:groups(conf, is_driven)
  local entries, groups, bounds = conf.context.entries, {}, {}
  local zone, count, sources = conf.zone, #entries, {}
  local is_soon = is_driven and self.period
  if is_soon then
    for i = 1, count do sources[i] = i end
    zone, count = zones.project(zone, count, match.with(sources, 0)), count + 1
    bounds[1] = { count, 0, zones.at_most(self.period) }
  end
  zone = bounded(zones.up(zone, count), count, bounds)
  add_groups(self, groups, entries, count, { over = {}, zone = zone, bounds = bounds })
  local ways = 0
  for _, entry in ipairs(entries) do
    if entry.clock.is_free then ways = huge end
  end
  for _, group in ipairs(groups) do
    if group.is_over then ways = ways + 1 end
    if is_soon then group.zone = zones.project(group.zone, count, sources) end
  end
  for _, group in ipairs(groups) do
    group.is_sure, group.ways = not group.is_over or ways == 1, ways
  end
  return groups
end

-- Steps .............................................................................

-- Returns the position of the first entry of a clock, or nil.
local function find_entry(entries, clock)
  for i, entry in ipairs(entries) do
    if entry.clock == clock then return i end
  end
end

-- Returns for the clock of a state how many of its deadlines are over, and its number
-- before the step, 0 for a new clock. Also returns by how much the clock of an e_every
-- goes back. Returns nil if the clock does not run.
local function passed_of(self, before, group, clock)
  if not clock.state or clock.state._mode == "inactive" then return nil end
  if self.subject.entered[clock.state] then return 0, 0, 0 end
  local i = find_entry(before, clock)
  if not i then return nil end
  local over = group.over[i]
  if clock.is_repeated then return 0, i, clock.deadlines[over] or 0 end
  local passed = before[i].passed + over
  if passed < #clock.deadlines then return passed, i, 0 end
end

-- Adds the clocks of the states that are active now.
local function add_states(self, before, group, entries, sources)
  for _, clock in ipairs(self.clocks) do
    local passed, source, back = passed_of(self, before, group, clock)
    if passed then
      entries[#entries + 1] = { clock = clock, passed = passed }
      sources[#sources + 1], sources.back[#entries] = source, back
    end
  end
end

-- Adds the clocks of events that wait to be sent: events from before the step that have
-- neither come nor been dropped, then events from the step. Returns their number.
local function add_pending(self, before, group, entries, sources)
  local own, count = self.subject, #entries
  for i, entry in ipairs(before) do
    local clock = entry.clock
    if clock.later and group.over[i] == 0 and not own.dropped[clock.later] then
      entries[#entries + 1] = entry
      sources[#sources + 1] = clock.is_free and 0 or i
    end
  end
  for _, later in ipairs(own.sent_later) do
    entries[#entries + 1] = { clock = self.of[later], passed = 0 }
    sources[#sources + 1] = 0
  end
  return #entries - count
end

-- Adds the clocks of a monitor: all that ran before, or if `numbers` is given, the
-- clocks with these numbers. A 0 in `numbers` is a new clock.
local function add_monitor(before, clock, numbers, entries, sources)
  local list = {}
  for i, entry in ipairs(before) do
    if entry.clock == clock then list[#list + 1] = i end
  end
  for n = 1, numbers and #numbers or #list do
    entries[#entries + 1] = { clock = clock, passed = 0 }
    sources[#sources + 1] = list[numbers and numbers[n] or n] or 0
  end
end

--- Return the clocks that run after the last step of the subject.
---@param try rfsm_checks.Try that step
---@param walk rfsm_checks.Walk
---@param clocks table<rfsm_checks.Judged, integer[]> numbers of the clocks of monitors,
-- from `monitors.look`
---@return rfsm_checks.Entry[]|nil entries nil if too many events wait to be sent
---@return integer[] sources for each clock its number before the step; 0: a new clock.
-- `sources.back[i]`, if there is one, is by how much it has gone back
---@return number[] zone the values that these clocks may have
function Timing:after(try, walk, clocks)
  local before, group = try.conf.context.entries, try.group
  local entries, sources = {}, { back = {} }
  add_states(self, before, group, entries, sources)
  if add_pending(self, before, group, entries, sources) > self.pending then
    return nil, sources
  end
  for _, judged in ipairs(walk.monitors) do
    local clock = self.of[judged]
    if clock then add_monitor(before, clock, clocks[judged], entries, sources) end
  end
  local zone = zones.project(group.zone, #before, sources)
  for i = 1, #sources do zone = zones.back(zone, #sources, i, sources.back[i] or 0) end
  return entries, sources, zone
end

-- Times of a run ....................................................................

-- Adds the bounds that the step with the number `now` sets on the times between steps.
-- Returns for each clock the number of the step in which it began; `back` has by how
-- much it has gone back since.
local function add_bounds(bounds, began, now, step)
  local began_then = { back = {} }
  local function of(i) return i == 0 and now or began[i] or now - 1 end
  local function back(i) return began.back and began.back[i] or 0 end
  if now > 1 then
    for _, bound in ipairs(step.group.bounds) do
      local i, j = bound[1], bound[2]
      bounds[#bounds + 1] = { of(j), of(i), zones.later(bound[3], back(i) - back(j)) }
    end
    bounds[#bounds + 1] = { now - 1, now, zones.at_most(0) }
  end
  for i, source in ipairs(step.sources) do
    began_then[i] = source == 0 and now or began[source]
    began_then.back[i] = (source == 0 and 0 or back(source))
      + (step.sources.back[i] or 0)
  end
  return began_then
end

local MILLISECOND = 1000000

-- Returns the number of parts into which a unit is divided, so that `count` steps fit
-- into a unit one part apart. The parts are milliseconds if these are small enough.
local function parts_of(count, unit)
  if unit % MILLISECOND == 0 and unit / MILLISECOND > count then
    return unit / MILLISECOND
  end
  local parts = 10
  while parts <= count do parts = parts * 10 end
  return parts
end

--- Return the earliest times of the steps of a run, in seconds; nil if there are none.
---@param steps { group: rfsm_checks.Group, sources: integer[] }[] from `Timing:after`
---@return number[]?
function Timing:times_of(steps)
  local at, parts, is_done = {}, parts_of(#steps, self.unit), false
  local bounds, began = {}, {}
  for i, step in ipairs(steps) do
    at[i], began = 0, add_bounds(bounds, began, i, step)
  end
  for _ = 0, #steps do
    is_done = true
    for _, bound in ipairs(bounds) do
      local least = floor(bound[3] / 2) * parts - (bound[3] % 2 == 0 and 1 or 0)
      if at[bound[1]] - least > at[bound[2]] then
        at[bound[2]], is_done = at[bound[1]] - least, false
      end
    end
    if is_done then break end
  end
  if not is_done or at[1] ~= 0 then return nil end
  for i = 1, #steps do at[i] = at[i] * self.unit / parts / BILLION end
  return at
end

return timing
