-- Snapshots: a machine saved between two steps goes on as if nothing had been.
--
-- RFSM_N=10000 makes the random parts longer. RFSM_LUAS names further interpreters.

local helper = require "spec.helper"
local json = require "dkjson"
local kept = require "spec.support.kept"
local new_random = require "spec.support.random"
local rfsm = require "rfsm"
local share = require "spec.support.share"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"

local state, trans = rfsm.state, rfsm.trans
local N = tonumber(os.getenv("RFSM_N")) or share.count(30)
local FIRST = share.seed(N)

after_each(helper.remove_files)

local function through_json(value) return (json.decode((json.encode(value)))) end

local mp = helper.package "MessagePack"

local function through_message_pack(value) return mp.unpack(mp.pack(value)) end

local THROUGH = { JSON = through_json,
  MessagePack = mp and through_message_pack or nil }

-- (initial) -> off --e_on--> on { (initial) -> low --e_up--> high },  on --e_off--> off
local function lamp(fields)
  local model = {
    info = false, warn = false, emem = false, off = state {},
    on = state {
      keep = { "count" }, count = 0,
      entry = function(_, self) self.count = self.count + 1 end,
      low = state {}, high = state {},
      trans { src = "initial", tgt = "low" },
      trans { src = "low", tgt = "high", events = { "e_up" } },
    },
    trans { src = "initial", tgt = "off" },
    trans { src = "off", tgt = "on", events = { "e_on" } },
    trans { src = "on", tgt = "off", events = { "e_off" } },
  }
  for key, value in pairs(fields or {}) do model[key] = value end
  return state(model)
end

local function lit()
  local fsm = helper.init(lamp())
  helper.post_and_run(fsm, "e_on", "e_other")
  rfsm.run(fsm)
  helper.post_and_run(fsm, "e_on")
  helper.post_and_run(fsm, "e_up")
  rfsm.send_events(fsm, "e_off", 7, true)
  return fsm
end

describe("a snapshot", function()
  it("holds where the machine stands, its queue and the data that it keeps", function()
    local snap = snapshot.take(lit())
    assert.same({
      version = 2, chart = snap.chart, leaf = "root.on.high", done = true,
      queue = { "e_off", 7, true }, data = { ["root.on"] = { count = 1 } },
    }, snap)
    assert.matches("^%x+%-%x+$", snap.chart)
    assert.equal(18, #snap.chart)
  end)

  it("knows how many events come before getevents is asked again", function()
    local asked = 0
    local function model()
      return state { info = false, warn = false, emem = false, read = "one",
        getevents = function()
          asked = asked + 1
          return { "e_x", "e_x", "e_x" }
        end, a = state {}, trans { src = "initial", tgt = "a" } }
    end
    local fsm = helper.init(model())
    rfsm.step(fsm) -- enters with e_init_fsm, three wait behind e_done
    local snap = snapshot.take(fsm)
    assert.equal(4, snap.unread)
    local other = assert(snapshot.restore(model(), through_json(snap)))
    for _, machine in ipairs { fsm, other } do
      asked = 0
      rfsm.step(machine) -- two iterations
      assert.equal(0, asked)
      assert.equal(2, snapshot.take(machine).unread)
    end
    snap.queue = nil -- as if a migration had dropped them
    other = assert(snapshot.restore(model(), snap))
    assert.is_nil(snapshot.take(other).unread)
    rfsm.step(other)
    assert.equal(1, asked)
  end)

  it("is the same text on each Lua, also in years", function()
    local fsm = helper.init(state { info = false, warn = false, emem = false,
      keep = { "count" }, count = 0, a = state {}, b = state {},
      trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "b", events = { "e_x" }, pn = 2 } })
    rfsm.run(fsm)
    assert.equal('{"chart":"729c0dbaf94-c862a3",'
      .. '"data":{"root":{"count":0}},"done":true,"leaf":"root.a","version":2}',
      snapshot.encode(snapshot.take(fsm)))
  end)

  it("of a machine that was not entered is empty", function()
    local model = lamp()
    model.on.count = nil
    local snap = snapshot.take(helper.init(model))
    assert.same({ version = 2, chart = snap.chart }, snap)
    local again = assert(snapshot.restore(lamp(), snap))
    rfsm.run(again)
    assert.equal("root.off", rfsm.get_actleaf_fqn(again))
  end)

  it("restores a machine without running anything", function()
    local trace = {}
    local function note(what) return function() trace[#trace + 1] = what end end
    local model = lamp { entry = note "root" }
    model.on.high.entry, model.on.entry = note "high", note "on"
    local fsm = assert(snapshot.restore(model, through_json(snapshot.take(lit()))))
    assert.same({}, trace)
    assert.same({ "root", "root.on", "root.on.high" }, rfsm.get_active_conf(fsm))
    assert.equal("done", rfsm.get_sta_mode(fsm.on.high))
    assert.equal(1, fsm.on.count)
    rfsm.run(fsm)
    assert.equal("root.off", rfsm.get_actleaf_fqn(fsm))
  end)

  it("restores a machine that runs the entries if asked", function()
    local names = {}
    local model = lamp()
    local function note(_, self, what) names[#names + 1] = what .. " " .. self._fqn end
    model.entry, model.on.entry, model.on.high.entry = note, note, note
    local snap = snapshot.take(lit())
    assert(snapshot.restore(model, snap, { entries = true }))
    assert.same({ "entry root", "entry root.on", "entry root.on.high" }, names)
  end)

  it("is put into a machine that stands elsewhere", function()
    local fsm = helper.init(lamp())
    rfsm.run(fsm)
    assert.is_true(snapshot.put(fsm, snapshot.take(lit())))
    assert.same(snapshot.take(lit()), snapshot.take(fsm))
  end)

  it("has what save returned, and load gets it", function()
    local model = lamp {
      save = function(fsm) return { fsm.secret } end,
      load = function(fsm, self, value) fsm.secret, self.loaded = value[1], true end,
    }
    local fsm = helper.init(model)
    fsm.secret = 42
    local again = assert(snapshot.restore(model, through_json(snapshot.take(fsm))))
    assert.same({ 42, true }, { again.secret, again.loaded })
  end)

  it("takes no substate for what a state keeps", function()
    local model = state { info = false, warn = false, emem = false, data = {},
      keep = state {}, save = state {}, a = state { keep = { "x" }, x = 1, save = {},
        load = true }, trans { src = "initial", tgt = "keep" } }
    local snap = snapshot.take(helper.started(model))
    assert.same({ "root.keep", { ["root.a"] = { x = 1 } } }, { snap.leaf, snap.data })
    assert(snapshot.restore(model, snap))
  end)

  it("holds targets that a program has set", function()
    local fsm = helper.init(lamp())
    fsm.on[1].tgt = fsm.on.high
    local again = assert(snapshot.restore(lamp(), snapshot.take(fsm)))
    assert.equal(again.on.high, again.on[1].tgt)
    assert.is_true(snapshot.put(again, snapshot.take(helper.init(lamp()))))
    assert.equal(again.on.low, again.on[1].tgt)
    snapshot.put_data(again, snapshot.take_data(fsm))
    assert.equal(again.on.high, again.on[1].tgt)
  end)

  it("of a machine with 20 states takes at most 200 bytes as MessagePack", function()
    if not mp then return pending("lua-messagepack is missing") end
    local model = state { info = false, warn = false, emem = false,
      keep = { "order", "count" }, order = "A-4711", count = 12 }
    for i = 1, 4 do
      local group = state { trans { src = "initial", tgt = "station1" } }
      for j = 1, 4 do group["station" .. j] = state {} end
      model["area" .. i] = group
      model[i] = trans { src = i == 1 and "initial" or "area" .. i - 1,
        tgt = "area" .. i, events = i > 1 and { "e_next" } or nil }
    end
    local fsm = helper.init(model)
    helper.post_and_run(fsm, "e_next")
    helper.post_and_run(fsm, "e_next")
    rfsm.send_events(fsm, "e_next", "e_stop")
    assert.equal("root.area2.station1", rfsm.get_actleaf_fqn(fsm))
    assert.is_true(#mp.pack(snapshot.take(fsm)) <= 200)
  end)
end)

describe("data that a chart keeps", function()
  local VALUES = {
    { 1, 2.5, -0.1, 1e300, 2 ^ 53, 123456789012345678, 0.1 + 0.2 },
    { huge = math.huge, low = -math.huge }, {}, { {}, { {} } }, { n = 3 }, { "%t", 1 },
    { [5] = "sparse", x = true, [true] = false, [2.5] = "half" }, "a\0b\"\n\255",
    "%n", { "%n", "7" }, false,
  }

  it("comes back as it was, also through JSON and MessagePack", function()
    for _, through in pairs(THROUGH) do
      for _, value in ipairs(VALUES) do
        local fsm = helper.init(lamp())
        fsm.on.count = value
        local again = assert(snapshot.restore(lamp(), through(snapshot.take(fsm))))
        assert.same(value, again.on.count)
      end
    end
  end)

  it("keeps integers and floats apart", function()
    local math_type = rawget(math, "type")
    if not math_type then return end
    local fsm = helper.init(lamp())
    fsm.on.count = { 3, 3 / 1, 123456789012345678, -0.0 }
    local again = assert(snapshot.restore(lamp(), through_json(snapshot.take(fsm))))
    local types = {}
    for i, number in ipairs(again.on.count) do types[i] = math_type(number) end
    assert.same({ "integer", "float", "integer", "float" }, types)
  end)
end)

-- Raises what take says of a machine with this value in its data, or as an event.
local function refusal(f)
  local fsm = helper.init(lamp())
  f(fsm)
  local ok, text = pcall(snapshot.take, fsm)
  assert.is_false(ok)
  return (text:gsub("^.-rfsm.snapshot.take: ", ""):gsub("spec/[%w_]+%.lua:%d+: ", ""))
end

describe("an event with data", function()
  it("is kept by value in the queue", function()
    local fsm, event = rfsm.init(lamp()), { name = "e_on", at = { 1, { x = 0.5 } } }
    rfsm.run(fsm)
    rfsm.send_events(fsm, event, "e_off")
    local snap = snapshot.take(fsm)
    event.at = nil
    local other = assert(snapshot.restore(lamp(), snap))
    assert.same({ { name = "e_on", at = { 1, { x = 0.5 } } }, "e_off" }, other._intq)
    snap.queue[1].name = 5
    assert.matches("queue%[1%]: event expected, got table",
      (select(2, snapshot.restore(lamp(), snap))))
  end)
end)

describe("an event with data that is sent, deferred and kept at once", function()
  it("is kept by value in each place", function()
    require "rfsm.defer"
    local function model()
      return state { info = false, warn = false, keep = { "last" },
        a = state { defer = { rfsm.named "e_x" } },
        trans { src = "initial", tgt = "a" },
        trans { src = "a", tgt = "initial", events = { rfsm.named "e_y" } } }
    end
    local fsm, event = helper.started(model()), { name = "e_x", by = { id = 3 } }
    helper.post_and_run(fsm, event, event)
    timeevent.send_after(fsm, 5, event, "first")
    timeevent.send_after(fsm, 6, event)
    rfsm.send_events(fsm, event, event)
    fsm.last = event
    local snap = snapshot.take(fsm)
    event.by.id = 4
    local other = assert(snapshot.restore(model(), snap))
    local same = { name = "e_x", by = { id = 3 } }
    local list = other._deferred.list
    assert.same({ same, same, last = same, same, same }, { other._intq[1],
      other._intq[2], list[1], list[2], last = other.last })
    assert.same({ same, same, same, same }, rfsm.waiting(other))
    assert.same(snap.queue, snapshot.take(other).queue)
  end)
end)

describe("take names what cannot be saved:", function()
  local shared = {}
  local deep = {}
  for _ = 1, 20 do deep = { deep } end
  for text, f in pairs {
    ["queue[2]: an event that is a function cannot be saved, only text, number, "
      .. "boolean, or a plain table with a text 'name'"] = function(fsm)
      rfsm.send_events(fsm, print)
    end,
    ["queue[3]: an event that is a userdata cannot be saved, only text, number, "
      .. "boolean, or a plain table with a text 'name'"] = function(fsm)
      rfsm.send_events(fsm, { name = "e", at = 1 }, io.stdout)
    end,
    ["root waiting[1]: an event that is a table cannot be saved, only text, number, "
      .. "boolean, or a plain table with a text 'name'"] = function(fsm)
      timeevent.send_after(fsm, 5, { "e_on" })
      timeevent.send_after(fsm, 6, "e_on")
    end,
    ["queue[2].by: this table stands elsewhere in the data, too, and can only be saved "
      .. "once"] = function(fsm)
      local event = { name = "e" }
      event.by = event
      rfsm.send_events(fsm, event)
    end,
    ["root.on.count.list[2]: a function cannot be saved"] = function(fsm)
      fsm.on.count = { list = { 1, print } }
    end,
    ["root.on.count: a table with a metatable cannot be saved"] = function(fsm)
      fsm.on.count = setmetatable({}, {})
    end,
    ["root.on.count: a key that is a table cannot be saved"] = function(fsm)
      fsm.on.count = { [shared] = 1 }
    end,
    ["root.on.count[2]: this table stands elsewhere in the data, too, and can only "
      .. "be saved once"] = function(fsm) fsm.on.count = { shared, shared } end,
    ["root.on.count: at most 9 tables inside each other expected"] = function(fsm)
      fsm.on.count = deep
    end,
    ["save of root.on: no disk"] = function(fsm)
      fsm.on.save = function() error("no disk", 0) end
      fsm.on.load = print
    end,
    ["root.on: 'save' and 'load' expected, got only one of them"] = function(fsm)
      fsm.on.save = print
    end,
    ["root.on.keep[1]: name of a field with data expected, got 'entry'"] = function(fsm)
      fsm.on.keep = { "entry" }
    end,
    ["root mine: table expected, got number 7"] = function(fsm)
      rfsm.snapshot_hook_add(fsm, "mine", function() return 7 end, print)
    end,
    ["root.on.keep: list of names expected, got a table with keys"] = function(fsm)
      fsm.on.keep = { count = true }
    end,
    ["root.on.keep: list of names expected, got number"] = function(fsm)
      fsm.on.keep = 7
    end,
  } do
    it(text, function() assert.equal(text, refusal(f)) end)
  end

  it("a step under way", function()
    local fsm, text
    fsm = helper.init(lamp { entry = function()
      text = select(2, pcall(snapshot.take, fsm))
    end })
    rfsm.run(fsm)
    assert.matches("rfsm.snapshot.take: the machine is in the middle of a step", text)
  end)
end)

describe("a snapshot of another chart", function()
  local function other()
    local model = lamp()
    model.on.high, model.on.full = nil, state {}
    model.on[2].tgt = "full"
    return model
  end

  local snap

  before_each(function() snap = snapshot.take(lit(), { structure = true }) end)

  it("is refused with the list of what differs", function()
    local expected = {
      "new: root.on.low -> root.on.full on e_up", "new: state root.on.full",
      "gone: root.on.low -> root.on.high on e_up", "gone: state root.on.high",
    }
    local fsm, text, list = snapshot.restore(other(), snap)
    assert.is_false(fsm)
    assert.same(expected, list)
    assert.equal("rfsm.snapshot: the snapshot is of another chart:\n  "
      .. table.concat(expected, "\n  "), text)
    assert.same(expected, select(3, snapshot.restore(other(), snapshot.take(lit()),
      { old = lamp() })))
  end)

  it("is refused with what is missing if no more is known", function()
    local bare = snapshot.take(lit())
    bare.chart = "00000000000"
    assert.same({ "gone: state root.on.high",
      "the snapshot holds no structure, that is all that is known (the chart of its "
        .. "time is needed: sim and web take that file, a library both under one name, "
        .. "NAME=OLD.lua NAME=NEW.lua; in Lua restore(model, snap, { old = "
        .. "model_of_then }))" },
      select(3, snapshot.restore(other(), bare)))
  end)

  it("is compared by the structure in it where its chart is not known", function()
    snap.chart = "00000000000"
    table.insert(snap.structure, "field old of root")
    local _, _, list = snapshot.restore(other(), snap)
    assert.same({ "new: root.on.low -> root.on.full on e_up",
      "new: state root.on.full", "gone: root.on.low -> root.on.high on e_up",
      "gone: state root.on.high", "gone: field old of root" }, list)
  end)

  it("is told of fields that only the new chart keeps", function()
    local function plain(keep)
      return state { info = false, warn = false, keep = keep, n = 1, a = state {},
        trans { src = "initial", tgt = "a" } }
    end
    local list
    assert(snapshot.restore(plain { "n" }, snapshot.take(helper.started(plain())),
      { migrate = function(_, difference) list = difference end }))
    assert.same({ "new: field n of root" }, list)
  end)

  it("moves by a table of new names", function()
    local fsm = assert(snapshot.restore(other(), snap,
      { rename = { ["root.on.high"] = "root.on.full" } }))
    assert.equal("root.on.full", rfsm.get_actleaf_fqn(fsm))
    assert.equal(1, fsm.on.count)
  end)

  it("moves by a function, which may refuse", function()
    local fsm = assert(snapshot.restore(other(), snap, { migrate = function(old, list)
      assert.equal(4, #list)
      old.leaf = "root.on.low"
    end }))
    assert.equal("root.on.low", rfsm.get_actleaf_fqn(fsm))
    assert.equal("rfsm.snapshot: migrate refused the snapshot of another chart:",
      select(2, snapshot.restore(other(), snap,
        { migrate = function() return false end })):match("[^\n]*"))
  end)
end)

describe("a snapshot that is wrong", function()
  local good = snapshot.take(lit())

  local function with(field, value)
    local snap = through_json(good)
    snap[field] = value
    return snap
  end

  for _, case in ipairs {
    { "no table", "text", "snapshot expected, got string" },
    { "no version", with("version", nil),
      "snapshot of format 2 expected, got none" },
    { "version 3", with("version", 3),
      "snapshot of format 2 expected, got format 3" },
    { "a composite", with("leaf", "root.on"), "leaf: 'root.on' is a composite" },
    { "no such leaf", with("leaf", "root.x"), "leaf: no state is 'root.x'" },
    { "a leaf of another type", with("leaf", 7), "leaf: string expected, got number" },
    { "an event that is a table", with("queue", { {} }),
      "queue[1]: event expected, got table" },
    { "a field too many", with("entry", "x"), "no snapshot has a field 'entry'" },
    { "data that nobody keeps", with("data", { ["root.on"] = { entry = 1 } }),
      "data: no state 'root.on' keeps a field 'entry'" },
    { "data of no state", with("data", { ["root.x"] = { a = 1 } }),
      "data: no state 'root.x' keeps a field 'a'" },
    { "an extension that is not there", with("ext", { timers = {} }),
      "ext: no extension of the machine is named 'timers'" },
    { "targets that are none", with("targets", { "root", 1, "root.x" }),
      "targets: a transition and a node expected, got '1' in 'root', 'root.x'" },
  } do
    it("is refused: " .. case[1], function()
      local fsm = helper.init(lamp())
      rfsm.run(fsm)
      local before = snapshot.take(fsm)
      assert.same({ false, "rfsm.snapshot: " .. case[3] },
        { snapshot.put(fsm, case[2]) })
      assert.same(before, snapshot.take(fsm))
    end)
  end

  -- Changes, cuts or replaces something in a copy of a snapshot.
  local JUNK = { 0, -1, 1e308, 0 / 0, "", "root", "%t", "%p", true, {}, { {} },
    { "%p", 7 }, { "%n", "x" }, { "%t", {} } }

  local function spoil(value, random)
    if type(value) ~= "table" or random(4) == 1 then return random:pick(JUNK) end
    local key = rfsm.sorted_keys(value)[random(4)]
    if key == nil then
      value[JUNK[random(3) + 4]] = random:pick(JUNK)
    else
      value[key] = random(5) == 1 and nil or spoil(value[key], random)
    end
    return value
  end

  local function bytes(random, count)
    local list = {}
    for i = 1, count do list[i] = string.char(random(256) - 1) end
    return table.concat(list)
  end

  local function unpacked(text)
    local ok, value = pcall(mp.unpack, text)
    return ok and value or nil
  end

  -- Each returns a snapshot that is wrong, if the encoder takes it.
  local HOSTILE = {
    function(snap, random)
      for _ = 1, random(3) do snap = spoil(snap, random) end
      return snap
    end,
    function(snap, random)
      snap.version = random:pick { 3, 0, "1", 1.5, {} }
      return snap
    end,
    function(snap, random)
      local text = json.encode(snap)
      return (json.decode(text:sub(1, random(#text))))
    end,
  }

  if mp then
    HOSTILE[4] = function(snap, random)
      local text = mp.pack(snap)
      local from = random(#text)
      return unpacked(text:sub(1, from - 1) .. bytes(random, random(3))
        .. text:sub(from + random(3)))
    end
    HOSTILE[5] = function(_, random) return unpacked(bytes(random, random(200))) end
  end

  it("never raises, and leaves no machine half restored", function()
    local random, machines, texts, refused = new_random(FIRST), {}, {}, 0
    for i = 1, N * 10 do
      local seed = FIRST + i % (N + 10)
      if not machines[seed] then
        texts[seed] = json.encode((kept.begin(seed, kept.length(seed))))
        machines[seed] = rfsm.init(kept.model(seed))
      end
      local fsm = machines[seed]
      local snap = random:pick(HOSTILE)(json.decode(texts[seed]), random)
      local before = snapshot.take(fsm)
      local ok, problem = snapshot.put(fsm, snap)
      if i % 20 == 0 then -- a new machine takes it, or not, as well
        assert.equal(ok, snapshot.restore(kept.model(seed), snap) and true)
      end
      if ok then
        rfsm.step(fsm, 3)
        assert(snapshot.put(fsm, json.decode(texts[seed])))
      else
        refused = refused + 1
        assert.matches("^rfsm.snapshot: ", problem)
        assert.is_nil(problem:find("rfsm/%w+%.lua:%d") or problem:find("attempt to"),
          problem)
        assert.same(before, snapshot.take(fsm), problem)
      end
    end
    assert.is_true(refused > N * 5)
  end)
end)

describe("a file of a snapshot", function()
  local function saved(file)
    local fsm = lit()
    assert.is_true(snapshot.save(fsm, file))
    return helper.content(file), snapshot.take(fsm)
  end

  it("has the machine", function()
    local file = helper.file_with("what was there before")
    local text, snap = saved(file)
    assert.equal(snapshot.encode(snap):sub(1, -2), text:match('^(.*),"sum":"%x+"}\n$'))
    assert.same(snap, snapshot.take(assert(snapshot.load(lamp(), file))))
    assert.is_nil(io.open(file .. ".part"))
    helper.write(file, snapshot.encode(snap)) -- of an older release
    assert.same(snap, snapshot.take(assert(snapshot.load(lamp(), file))))
    local other = state { info = false, warn = false, err = false, a = state {} }
    assert.is_false((snapshot.load(other, file)))
  end)

  it("that is damaged is not taken, whatever bit or end is wrong", function()
    local file, model = helper.file_with(""), lamp()
    local text = saved(file):sub(1, -2)
    local function is_refused(changed)
      helper.write(file, changed)
      local fsm, problem = snapshot.load(model, file)
      assert.is_false(fsm)
      assert.equal("rfsm.snapshot: " .. file, problem:match("^rfsm.snapshot: [^:]*"))
    end
    for at = 1, #text do
      local byte, bit = text:byte(at), 2 ^ (at % 8)
      byte = byte + (byte % (2 * bit) < bit and bit or -bit)
      is_refused(text:sub(1, at - 1) .. string.char(byte) .. text:sub(at + 1))
      is_refused(text:sub(1, at - 1))
    end
  end)

  it("that cannot be written or read is told in one line", function()
    local fsm = helper.init(lamp())
    assert.same({ false, "rfsm.snapshot: /nowhere/m.json.part: No such file or "
      .. "directory" }, { snapshot.save(fsm, "/nowhere/m.json") })
    assert.same({ false, "rfsm.snapshot: /nowhere/m.json: No such file or directory" },
      { snapshot.load(lamp(), "/nowhere/m.json") })
    assert.equal("rfsm.snapshot.load: state expected, got nil",
      helper.refusal(snapshot.load, nil, "m"))
    assert.equal("rfsm.snapshot.load: file name expected, got nil",
      helper.refusal(snapshot.load, lamp()))
    assert.equal("rfsm.snapshot.save: file name expected, got boolean",
      helper.refusal(snapshot.save, fsm, true))
    assert.equal("rfsm.snapshot.take: unknown option 'strcture' (did you mean "
      .. "'structure'?), expected: structure",
      helper.refusal(snapshot.take, fsm, { strcture = true }))
    fsm.on.count = print
    local file = helper.file_with("old")
    assert.equal("rfsm.snapshot.save: root.on.count: a function cannot be saved",
      helper.refusal(snapshot.save, fsm, file))
    assert.equal("old", helper.content(file))
  end)
end)

describe("a machine restored in the middle of a random run", function()
  local function each_case(f)
    for seed = FIRST, FIRST + N - 1 do
      local at = seed * 31 % (kept.length(seed) + 1)
      local snap, trace = kept.begin(seed, at)
      f(seed, at, snap, trace)
    end
  end

  for name, through in pairs(THROUGH) do
    it("has the same trace from there on, through " .. name, function()
      each_case(function(seed, at, snap, trace)
        assert.same(trace, kept.go_on(seed, at, through(snap)), "seed " .. seed)
      end)
    end)
  end

  it("has it in other processes, on other interpreters", function()
    local lines = {}
    each_case(function(seed, at, snap, trace)
      lines[#lines + 1] = json.encode { seed = seed, at = at, snapshot = snap,
        digest = kept.digest(trace) }
    end)
    local file = helper.file_with(table.concat(lines, "\n") .. "\n")
    for lua in (os.getenv("RFSM_LUAS") or "lua5.1 lua5.4"):gmatch("%S+") do
      assert.equal(N .. " passed\n", helper.text_of(
        ("%s spec/support/kept.lua <%s 2>&1"):format(lua, file)), lua)
    end
  end)
end)
