-- What draws the pictures of a page, in a process of its own.

local helper = require "spec.helper"
local marsh = require "rfsm.marsh"
local LocalView = require "rfsm.web.local_view"
local Painter = require "rfsm.web.picture"
local rfsm = require "rfsm"
require "socket" -- without it a pipe that is closed ends the program

local state, trans = rfsm.state, rfsm.trans

describe("a painter", function()
  local painter
  before_each(function() painter = Painter.new() end)
  after_each(function() painter:close() end)

  local function request(graph, folded)
    return function() return { graph = graph, folded = folded or {}, machine = 1 } end
  end

  -- Asks until it is drawn, for at most 30 s.
  local function drawn(key, ...)
    for _ = 1, 600 do
      local svg = painter:ask(key, ...)
      if svg ~= nil then return svg end
      os.execute("sleep 0.05") -- until the process has gone on
    end
  end

  local function is_there(name)
    local file = io.open(name)
    if file then file:close() end
    return file ~= nil
  end

  -- off, on{ dim }
  local function nested()
    return marsh.jsontab(helper.init(state { info = false, warn = false,
      off = state {}, trans { src = "initial", tgt = "off" },
      on = state { dim = state {}, trans { src = "initial", tgt = "dim" } },
      trans { src = "off", tgt = "on" } }), true)
  end

  it("draws what a description says, with composites folded, in one process", function()
    local svg = drawn("a", request(nested()))
    local pipe = painter.pipe
    assert.matches('id="root.off"', svg, 1, true)
    assert.matches('id="root.on.dim"', svg, 1, true)
    assert.matches("</svg>\n$", svg)
    local folded = drawn("b", request(nested(), { "root.on" }))
    assert.matches('id="root.on"', folded, 1, true)
    assert.is_nil(folded:find('id="root.on.dim"', 1, true))
    assert.equal(svg, painter:ask("a"))
    assert.is_true(pipe == painter.pipe and pipe ~= false)
    for _, job in ipairs(painter.jobs) do
      assert.same({ false, false },
        { is_there(job.input), is_there(job.input .. ".svg") })
    end
  end)

  it("passes any texts and numbers, and events by their words", function()
    local tab = helper.lamp()
    tab.subnodes[2].id, tab.subnodes[2].doc = 'a"\\b', "two\nlines\0\r"
    for _, tr in ipairs(tab.transitions) do
      tr.pn, tr.words, tr.events = 0.5, { "any thing" }, { "e_any" }
      tr.src, tr.tgt = "root.initial", 'root.a"\\b'
    end
    assert.matches(">any thing %(pn 0.5%)<", drawn("a", request(tab)))
  end)

  it("draws a machine of a page, with any events and priorities", function()
    local view = LocalView.new(helper.init(state { info = false, warn = false,
      a = state {}, trans { src = "initial", tgt = "a" },
      trans { src = "a", tgt = "a", events = { print, {}, rfsm.named "e_x", true },
        pn = 1 / 0 } }), os.clock)
    local svg = drawn("a", request(view.description))
    assert.matches("e_x, true<", svg)
    assert.matches(">%(pn inf%)<", svg)
  end)

  it("keeps the last pictures", function()
    for i = 1, 12 do painter:ask("key " .. i, request(helper.lamp())) end
    assert.equal(8, #painter.jobs)
    assert.equal("key 5", painter.jobs[1].key)
  end)

  it("has none without Graphviz, or if that fails", function()
    assert.is_false(drawn("a", request({ type = "no chart" })))
    local folder, popen = os.tmpname(), io.popen
    os.execute(("rm %s; mkdir %s; ln -s /bin/false %s/dot"):format(folder, folder,
      folder))
    painter:close()
    helper.with(io, { popen = function(command, mode)
      return popen("PATH=" .. folder .. ":$PATH; " .. command, mode)
    end }, function()
      assert.is_false(drawn("b", request(helper.lamp())))
    end)
    os.execute("rm -r " .. folder)
    helper.with(io, { popen = function() error("not supported", 0) end }, function()
      painter:close()
      assert.is_false(painter:ask("d", request(helper.lamp())))
    end)
  end)

  it("starts another process if the first has ended", function()
    local real, count = io.popen, 0
    local ended = { write = function() return nil, "Broken pipe" end }
    helper.with(io, { popen = function(command, mode)
      count = count + 1
      return count == 1 and ended or real(command, mode)
    end }, function()
      assert.matches("</svg>", drawn("b", request(helper.lamp())))
    end)
    assert.equal(2, count)
  end)
end)
