-- Events with data in every tool: the charts of the README and those of
-- spec/support/event, what each tool prints or draws of them, and the verdicts.

local LocalView = require "rfsm.web.local_view"
local checks = require "rfsm_checks"
local codec = require "rfsm.server.codec"
local commands = require "spec.support.commands"
local helper = require "spec.helper"
local host_of = require "spec.support.server_host"
local names = require "rfsm.observe.names"
local record = require "rfsm.record"
local rfsm = require "rfsm"
local rfsmpp = require "rfsmpp"
local rewind = require "rfsm.observe.rewind"
local snapshot = require "rfsm.snapshot"
local timeevent = require "rfsm_timeevent"

local FOLDER = "spec/support/event/"

teardown(function() timeevent.set_gettime_hook(nil) end)
after_each(helper.remove_files)

-- Charts ------------------------------------------------------------------------------

-- Returns the file of a chart of the README.
local function of_readme(name)
  local code = helper.content("README.md"):match("%-%- " .. name .. "%.lua\n(.-)\n```")
  local file = helper.file_with(code)
  return file
end

local function coin(cents) return { name = "e_coin", cents = cents } end

-- `sends` has the events of each step of a run, `shows` what each tool has to show:
-- parts of its text, in this order.
local CHARTS = {
  lamp = { open = function() return of_readme "lamp" end,
    sends = { { "e_switch" }, { "e_more", "e_x" }, { "e_switch" } },
    shows = {
      check = { ": ok (0 properties judged)\n", "6 of 6 transitions taken" },
      coverage = { "states 5 of 5, transitions 5 of 6, guard outcomes 0 of 0" },
      diff = { "new: root.off -> root.on.initial on e_flip" },
      dot = { ">e_more<", ">e_switch" },
      enabled = { "e_switch" },
      fleet = { "would be taken on e_switch in root.off", "root.on.dim,2=done,3=taken",
        "has the event 'e_x' (there are 'e_less', 'e_more', 'e_switch')" },
      json = { '"events":["e_more"]', '"words":["e_more"]' },
      mermaid = { "root_on_dim --> root_on_bright : e_more" },
      names = { "e_less e_more e_switch" },
      page = { "e_switch", "root.on.initial \226\134\146 root.on.dim e_switch",
        "root.on.bright e_more, e_x" },
      plantuml = { "root_on_dim --> root_on_bright : e_more" },
      record = { '"events":["e_more","e_x"]', "\nroot.off" },
      rewind = { "root.off" },
      sim = { "would be taken on e_switch in root.off", "queue:  e_more, e_x",
        "   3  e_more, e_x" },
      size = { "4 states, 6 transitions" },
      snapshot = { '"queue":["e_switch"]' },
      strict = { "no transition names the event 'e_x'" },
      tests = { 'run:step { "e_more"' },
      trace = { "RAISED              e_more", "RAISED              e_x" },
      viz = { ">e_more<" },
      why = { "root.trans[2] (off -> on) would be taken on e_switch in root.off" },
    } },
  heater = { open = function() return of_readme "heater" end,
    sends = { { { name = "e_reading", celsius = 25 } }, { "e_reading" },
      { { name = "e_reading", celsius = 18 } } },
    shows = {
      check = { ": ok (0 properties judged)\n", "2 of 2 transitions taken" },
      coverage = { "states 3 of 3, transitions 2 of 2, guard outcomes 2 of 2" },
      diff = { "new: root.off -> root.on on e_value{..}",
        "gone: root.off -> root.on on e_reading{..}" },
      dot = { ">e_reading<BR ALIGN=\"LEFT\"/>[event.celsius &lt;" },
      enabled = { "e_reading" },
      fleet = { "no transition would be taken on e_reading{celsius=25} in root.off",
        "its guard returns false", "root.off,2=done,3=dropped",
        "has the event 'e_reading' (did you mean '{\"name\":\"e_reading\"}'?)",
        "would be taken on e_reading{celsius=18}", "root.on,2=done,3=taken" },
      json = { '"events":["e_reading"]', '"words":["e_reading"]',
        '"with_data":["e_reading"]' },
      mermaid = { "root_off --> root_on : e_reading" },
      names = { "e_reading" },
      page = { "e_reading", "root.off \226\134\146 root.on e_reading{celsius=18}",
        "lost: discarded e_reading{celsius=25}, e_reading" },
      plantuml = { "root_off --> root_on : e_reading" },
      record = { '"events":[{"celsius":25,"name":"e_reading"}],"guards":[2,false]',
        '"events":["e_reading"]', '"guards":[2,true],"leaf":"root.on"', "\nroot.on" },
      rewind = { "root.on" },
      sim = { "no transition would be taken on e_reading{celsius=25} in root.off",
        "queue:  e_reading{celsius=25}", "waits for e_reading",
        "would be taken on e_reading{celsius=18}" },
      size = { "2 states, 2 transitions" },
      snapshot = { '"queue":[{"celsius":25,"name":"e_reading"}]' },
      strict = { "the event 'e_reading' (did you mean { name = 'e_reading' }?)" },
      tests = { 'run:step { { name = "e_reading" }, guards = {' },
      trace = { "RAISED              e_reading{celsius=25}",
        "events: e_reading" },
      viz = { ">e_reading<" },
      why = { "no transition would be taken on e_reading{celsius=25} in root.off",
        "its guard returns false", "no transition would be taken on e_reading in" },
    } },
  abc = { open = function() return FOLDER .. "abc.lua" end,
    sends = { { coin(100) }, { "e_cancel" }, { "e_coin" }, { "e_stop" } },
    shows = {
      check = { ": ok (0 properties judged)\n", "4 of 4 transitions taken" },
      coverage = { "states 4 of 4, transitions 4 of 4, guard outcomes 0 of 0" },
      diff = { "new: root.a -> root.b on e_token{..}",
        "gone: root.a -> root.b on e_coin{..}" },
      dot = { ">e_coin<", ">e_cancel<", ">e_stop<" },
      enabled = { "e_stop\ne_coin" },
      fleet = { "would be taken on e_coin{cents=100} in root.a",
        "root.b,2=done,3=taken",
        "has the event 'e_coin' (did you mean '{\"name\":\"e_coin\"}'?)" },
      json = { '"events":["e_coin"]', '"with_data":["e_coin"]',
        '"events":["e_cancel"]' },
      mermaid = { "root_a --> root_b : e_coin" },
      names = { "e_cancel e_coin e_stop" },
      page = { "e_coin\ne_cancel\ne_stop",
        "root.a \226\134\146 root.b e_coin{cents=100}",
        "lost: discarded e_coin" },
      plantuml = { "root_a --> root_b : e_coin" },
      record = { '"events":[{"cents":100,"name":"e_coin"}],"leaf":"root.b"',
        '"events":["e_coin"]', "\nroot.c" },
      rewind = { "root.c" },
      sim = { "would be taken on e_coin{cents=100} in root.a",
        "queue:  e_coin{cents=100}", "no transition would be taken on e_coin in root.a",
        "waits for e_coin" },
      size = { "3 states, 4 transitions" },
      snapshot = { '"queue":[{"cents":100,"name":"e_coin"}]' },
      strict = { "the event 'e_coin' (did you mean { name = 'e_coin' }?)" },
      tests = { 'assert.equal("a -e_coin-> b", run:step { { name = "e_coin" } })' },
      trace = { "RAISED              e_coin{cents=100}", "events='e_coin' }" },
      viz = { ">e_coin<" },
      why = { "root.trans[2] (a -> b) would be taken on e_coin{cents=100} in root.a",
        "no transition would be taken on e_coin in root.a" },
    } },
  vending = { open = function() return FOLDER .. "vending.lua" end,
    sends = { { coin(100), coin(50) }, { { name = "e_choose", drink = "tea" } },
      { { name = "e_choose", drink = "cola" } }, { "e_dropped" } },
    shows = {
      check = { ": ok (0 properties judged)\n", "7 of 7 transitions taken" },
      coverage = { "states 4 of 5, transitions 5 of 7, guard outcomes 2 of 2" },
      diff = { "new: root.idle -> root.paying on e_token{..}",
        "new: root.paying -> internal on e_token{..}" },
      dot = { ">e_coin / add<", ">e_choose [is_paid]<", ">e_cancel, after 30 s<" },
      enabled = { "e_coin" },
      fleet = { "would be taken on e_coin{cents=100} in root.idle",
        "would be taken on e_coin{cents=50} in root.paying",
        'no transition would be taken on e_choose{drink="tea"}',
        "its guard returns false", "root.delivering,2=done,3=taken" },
      json = { '"events":["e_coin"]', '"with_data":["e_coin"]',
        '"words":["e_cancel","after 30 s"]' },
      mermaid = { "root_paying : e_coin / add", "root_idle --> root_paying : e_coin" },
      names = { "e_cancel e_choose e_coin e_dropped" },
      page = { "e_coin", "e_choose", "root.idle \226\134\146 root.paying "
        .. "e_coin{cents=100}", 'root.delivering e_choose{drink="cola"}' },
      plantuml = { "root_idle --> root_paying : e_coin / add" },
      record = { '"events":[{"cents":50,"name":"e_coin"}]',
        '"events":[{"drink":"cola","name":"e_choose"}],"guards":[4,true]',
        "\nroot.idle" },
      rewind = { "root.idle" },
      sim = { "queue:  e_coin{cents=100}, e_coin{cents=50}", "its guard returns false",
        'would be taken on e_choose{drink="cola"} in root.paying' },
      size = { "4 states, 7 transitions" },
      snapshot = { '"queue":[{"cents":100,"name":"e_coin"}]' },
      strict = { "" },
      tests = { '"idle -e_coin-> paying", run:step { { name = "e_coin" } })',
        "after = 30.001", '"paying -e_coin-> internal"' },
      trace = { "RAISED              e_coin{cents=100}",
        'RAISED              e_choose{drink="cola"}' },
      viz = { ">e_coin / add<", ">e_choose [is_paid]<" },
      why = { "root.trans[2] (idle -> paying) would be taken on e_coin{cents=100}",
        'no transition would be taken on e_choose{drink="tea"} in root.idle' },
    } },
}

local function model_of(chart)
  if chart.model then return chart.model end
  local made = nil
  local file = chart.open()
  helper.with(rfsm, { init = function(model) made = model return false end },
    function()
      local ok, model = pcall(dofile, file)
      made = ok and model or made
    end)
  return made
end

-- Returns a machine of a chart that has done nothing, without a word.
local function machine_of(chart)
  local model = model_of(chart)
  model.warn, model.info, model.err = false, false, false
  return assert(rfsm.init(model))
end

-- Sends the events of the chart, and runs the machine after each handful.
local function drive(fsm, chart)
  rfsm.run(fsm)
  for _, events in ipairs(chart.sends) do
    for _, event in ipairs(events) do rfsm.send_events(fsm, event) end
    rfsm.run(fsm)
  end
end

-- Tools -------------------------------------------------------------------------------

-- Each returns what the tool shows of a chart.
local TOOLS = {}

for _, name in ipairs { "dot", "mermaid", "plantuml", "json" } do
  TOOLS[name] = function(chart)
    return require("rfsm." .. name).encode(machine_of(chart))
  end
end

function TOOLS.viz(chart)
  return (commands.run("viz -T svg -o - " .. chart.open()))
end

function TOOLS.check(chart) return (commands.run("check -a -x " .. chart.open())) end

function TOOLS.tests(chart)
  return (commands.run("check --tests busted " .. chart.open()))
end

function TOOLS.size(chart) return (commands.run("size " .. chart.open())) end
local RENAMED = { e_coin = "e_token", e_reading = "e_value", e_switch = "e_flip" }

function TOOLS.diff(chart)
  local file = chart.open()
  local other = helper.file_with((helper.content(file):gsub("e_%l+", RENAMED)))
  return (commands.run("snapshot diff " .. file .. " " .. other))
end

function TOOLS.why(chart)
  local fsm, texts = machine_of(chart), {}
  rfsm.run(fsm)
  for _, events in ipairs(chart.sends) do
    texts[#texts + 1] = select(2, checks.why(fsm, events[1]))
  end
  return table.concat(texts, "\n")
end

function TOOLS.enabled(chart)
  local fsm = machine_of(chart)
  rfsm.run(fsm)
  return (select(2, checks.enabled(fsm)))
end

function TOOLS.names(chart)
  return table.concat(names.events(machine_of(chart)), " ")
end

function TOOLS.trace(chart)
  local fsm, lines = machine_of(chart), {}
  fsm.dbg = rfsmpp.gen_dbgcolor("m", {}, true, function(line)
    lines[#lines + 1] = line:gsub("\27%[%d+m", "")
  end)
  drive(fsm, chart)
  return table.concat(lines, "\n")
end

function TOOLS.strict(chart)
  local model = model_of(chart)
  local said = {}
  model.info, model.err, model.strict = false, false, true
  model.warn = function(...) said[#said + 1] = table.concat(helper.texts(...), " ") end
  drive(assert(rfsm.init(model)), chart)
  model.strict = nil
  return table.concat(said, "\n")
end

function TOOLS.page(chart)
  local fsm, lines = machine_of(chart), {}
  local view = LocalView.new(fsm, function() return 0 end)
  view:observe(true)
  drive(fsm, chart)
  view:settle()
  for i, about in ipairs(view:chart().events) do lines[i] = about.words end
  for _, entry in ipairs(view:state().log) do
    lines[#lines + 1] = entry.kind .. ": " .. entry.text .. " "
      .. table.concat(entry.events or {}, ", ")
  end
  return table.concat(lines, "\n")
end

function TOOLS.record(chart)
  local fsm, file = machine_of(chart), helper.file_with("")
  local recorder = record.record(fsm, file)
  drive(fsm, chart)
  recorder:stop()
  local again, problem = record.replay(model_of(chart), file)
  return helper.content(file) .. (again and rfsm.get_actleaf_fqn(again) or problem)
end

function TOOLS.coverage(chart)
  local fsm = machine_of(chart)
  local counts = checks.coverage(fsm)
  drive(fsm, chart)
  return tostring(counts)
end

function TOOLS.snapshot(chart)
  local fsm = machine_of(chart)
  rfsm.run(fsm)
  rfsm.send_events(fsm, chart.sends[1][1])
  return require("rfsm.shared.exact_json").encode(snapshot.take(fsm))
end

function TOOLS.rewind(chart)
  local fsm = machine_of(chart)
  local own = rewind.new(fsm)
  own:note()
  drive(fsm, chart)
  own:note()
  own:go(1)
  drive(fsm, chart)
  return rfsm.get_actleaf_fqn(fsm)
end

function TOOLS.fleet(chart)
  local trace, clock = {}, { now = 1000 }
  package.loaded["rfsm.server.functions"] = nil
  local f = require "rfsm.server.functions" (host_of.new(trace, clock),
    { { name = "c", make = function() return model_of(chart) end } }, { history = 9 })
  package.loaded["rfsm.server.functions"] = nil
  local lines = { host_of.sorted(f.rfsm_create({ "m" }, { "c" })) }
  for _, events in ipairs(chart.sends) do
    for _, event in ipairs(events) do
      local text = type(event) == "table" and codec.encode(event) or event
      lines[#lines + 1] = host_of.sorted(f.rfsm_why({ "m" }, { text }))
      lines[#lines + 1] = host_of.sorted(f.rfsm_send({ "m" }, { text }))
    end
  end
  return table.concat(lines, "\n")
end

function TOOLS.sim(chart)
  local words = { "run", "events" }
  for _, events in ipairs(chart.sends) do
    local texts = {}
    for i, event in ipairs(events) do texts[i] = rfsm.event_text(event, true) end
    words[#words + 1] = "why " .. texts[1]
    words[#words + 1] = "se " .. table.concat(texts, " ")
    words[#words + 1] = "run"
  end
  words[#words + 1] = "history"
  return helper.text_of(("%s tools/rfsm sim -q %s 2>&1 <%s"):format(arg[-1],
    chart.open(), helper.file_with(table.concat(words, "\n") .. "\n")))
end

-- Texts of events that no tool may show.
local PRIVATE = { "predicate", "function: ", "table: 0x", "function %d", "table %d" }

-- Checks that a text has all parts, in this order, and no private text of an event.
local function check_text(text, parts)
  local at = 1
  for _, part in ipairs(parts) do
    local first, last = text:find(part, at, true)
    assert.is_truthy(first, ("'%s' expected in\n%s"):format(part, text))
    at = last
  end
  for _, pattern in ipairs(PRIVATE) do assert.is_nil(text:match(pattern), text) end
end

for _, name in ipairs(rfsm.sorted_keys(CHARTS)) do
  describe("the chart " .. name, function()
    for _, tool in ipairs(rfsm.sorted_keys(TOOLS)) do
      it("is shown by its events: " .. tool, function()
        local text
        helper.printed(function() text = TOOLS[tool](CHARTS[name]) end)
        check_text(text, CHARTS[name].shows[tool])
      end)
    end
  end)
end

describe("the system cell", function()
  it("is judged with the data that its arm emits", function()
    local out = commands.run("check -a -x " .. FOLDER .. "cell.lua")
    check_text(out, { "never sup: root.failed: does not hold [violated]",
      "1. arm: root.trans[1] -> root.ready",
      "2. sup: root.trans[1] -> root.asking; sends e_grasp to arm",
      "3. arm gets e_grasp from sup: root.trans[2] -> root.empty; sends e_lost to sup",
      "4. sup gets e_lost from arm: root.trans[3] -> root.failed",
      "6 configurations", "never sup: root.holding: holds" })
  end)

  it("shows them in the simulator, and takes them there", function()
    local out = helper.text_of(("%s tools/rfsm sim -q %scell.lua 2>&1 <%s"):format(
      arg[-1], FOLDER, helper.file_with("step\nsup e_lost{n=3}\nreset\nrun\n")))
    check_text(out, { "1 waiting (e_grasp from sup to arm)",
      "sup gets e_lost{n=3} from outside: root.failed",
      "sup gets e_lost{n=1} from arm: root.failed" })
  end)
end)
