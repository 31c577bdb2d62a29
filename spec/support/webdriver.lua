-- A browser for specs: Chromium, driven through chromedriver (the WebDriver protocol).
--
-- Both run as processes of this one. While a command is under way, `pump` is called
-- again and again, so that the page's server can live in the same process.

local dkjson = require "dkjson"
local helper = require "spec.helper"
local socket = require "socket"

local webdriver = {}

local ARGUMENTS = {
  "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
  "--disable-background-networking", "--disable-component-update", "--disable-sync",
  "--disable-dev-shm-usage", "--hide-scrollbars",
}
local PATIENCE = 60 -- seconds for a command, on a machine with much to do

local AXE = os.getenv "AXE"

--- The file of axe-core, if there is one.
webdriver.AXE = AXE ~= "" and AXE or nil

--- Returns why there is none; with PENDING=no that is an error.
function webdriver.no_axe()
  assert(os.getenv "PENDING" ~= "no", "npm cannot fetch axe-core")
  return "npm cannot fetch axe-core, and AXE=axe.min.js is not set"
end

local Driver = {}
Driver.__index = Driver

--- Are both programs here?
function webdriver.is_there()
  local ok = os.execute("{ command -v chromedriver && command -v chromium; } "
    .. ">/dev/null 2>&1")
  return ok == true or ok == 0
end

-- Reads from a socket until the reply is complete; returns its body.
local function read_reply(driver, tcp)
  local received, deadline = "", socket.gettime() + PATIENCE
  while socket.gettime() < deadline do
    local data, problem, partly = tcp:receive(65536)
    received = received .. (data or partly)
    local head, body = received:match("^(.-)\r\n\r\n(.*)$")
    local length = head and tonumber(head:lower():match("content%-length:%s*(%d+)"))
    if length and #body >= length then return body end
    if problem == "closed" then return body end
    driver.pump(0.002)
  end
  error("the browser does not answer", 0)
end

local function request(driver, method, path, message)
  local tcp = assert(socket.connect("127.0.0.1", driver.port))
  local body = message and dkjson.encode(message) or ""
  assert(tcp:send(("%s %s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nContent-Type: "
    .. "application/json\r\nContent-Length: %d\r\nConnection: close\r\n\r\n%s"):format(
    method, path, driver.port, #body, body)))
  tcp:settimeout(0)
  local text = read_reply(driver, tcp)
  tcp:close()
  local value = (dkjson.decode(text, 1, nil) or {}).value
  if type(value) == "table" and value.error then
    error(value.error .. ": " .. tostring(value.message):match("[^\n]*"), 0)
  end
  return value
end

--- A window of a browser of its own.
local Window = {}
Window.__index = Window

local OBJECT = { __jsontype = "object" }

function Window:call(method, path, message)
  return request(self.driver, method, "/session/" .. self.id .. path,
    message or method == "POST" and setmetatable({}, OBJECT) or nil)
end

function Window:open(url) self:call("POST", "/url", { url = url }) end

--- Run a function body in the page; returns what it returns.
function Window:run(script, ...)
  return self:call("POST", "/execute/sync", { script = script,
    args = setmetatable({ ... }, { __jsontype = "array" }) })
end

--- The same for one that calls its last argument with the result.
function Window:run_async(script, ...)
  return self:call("POST", "/execute/async", { script = script,
    args = setmetatable({ ... }, { __jsontype = "array" }) })
end

--- Returns the faults that axe-core finds in the page.
function Window:faults_by_axe()
  self:run(helper.content(webdriver.AXE) .. "\nwindow.axe = axe;")
  return self:run_async [[
    const done = arguments[0];
    axe.run().then(r => done(r.violations.map(v => v.id + ": "
      + v.nodes.map(n => n.target.join(" ")).join(", "))))]]
end

local COLOURS = [=[
  const rgba = color => color.match(/[\d.]+/g).map(Number);
  const over = ([r, g, b, a = 1], opacity, behind) =>
    [r, g, b].map((value, i) => value * a * opacity + behind[i] * (1 - a * opacity));
  const luminance = rgb => rgb.map(value => value / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const contrast = (a, b) => {
    const [dark, light] = [luminance(a), luminance(b)].sort((x, y) => x - y);
    return (light + 0.05) / (dark + 0.05);
  };
  const chain = e => e ? [...chain(e.parentElement), e] : [];
  const opacity = e =>
    chain(e).reduce((product, one) => product * getComputedStyle(one).opacity, 1);
  const backOf = element => chain(element).reduce((behind, e) =>
    over(rgba(getComputedStyle(e).backgroundColor), 1, behind), [255, 255, 255]);
]=]

-- Behind a text are the fills of the shapes before it in the SVG, each painted over the
-- one before, and the backgrounds of the elements around the SVG.
local FAINT = COLOURS .. [=[
  const svg = document.querySelector("#view > svg");
  const card = backOf(svg);
  const shapes = [...svg.querySelectorAll("path, polygon, ellipse")]
    .filter(e => getComputedStyle(e).fill != "none");
  const isBehind = (e, text, point) => e.isPointInFill(point
    .matrixTransform(text.getScreenCTM()).matrixTransform(e.getScreenCTM().inverse()))
    && e.compareDocumentPosition(text) & Node.DOCUMENT_POSITION_FOLLOWING;
  const paint = (behind, e) => {
    const { fill, fillOpacity } = getComputedStyle(e);
    return over(rgba(fill), opacity(e) * fillOpacity, behind);
  };
  const worst = text => {
    const { x, y, width, height } = text.getBBox();
    return Math.min(...[0.02, 0.5, 0.98].map(part => {
      const point = new DOMPoint(x + part * width, y + height / 2);
      const behind = shapes.filter(e => isBehind(e, text, point))
        .reduce(paint, card);
      return contrast(paint(behind, text), behind);
    }));
  };
  const texts = [...svg.querySelectorAll("text")];
  return [texts.length, texts.map(e => [e.textContent, worst(e)])
    .filter(([, c]) => !(c >= 4.5)).map(([text, c]) => `${text}: ${c.toFixed(2)}`)]]=]

--- Returns how many texts the picture has, and those whose contrast to what is painted
-- behind them is below 4.5:1, each with its contrast.
function Window:faint_texts() return self:run(FAINT) end

-- A disabled button need not be read.
local FAINT_WORDS = COLOURS .. [=[
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const list = [];
  let count = 0;
  for (let text; text = walker.nextNode();) {
    const e = text.parentElement;
    if (!text.data.trim() || !e.checkVisibility()) continue;
    if (e.closest("svg, :disabled, script")) continue;
    const behind = backOf(e), { color } = getComputedStyle(e);
    const ratio = contrast(over(rgba(color), opacity(e), behind), behind);
    count++;
    if (!(ratio >= 4.5)) list.push(`${text.data.trim()}: ${ratio.toFixed(2)}`);
  }
  return [count, list]]=]

--- Returns the same for the texts of the page that are not in its picture.
function Window:faint_words() return self:run(FAINT_WORDS) end

--- Wait until an expression is true in the page.
function Window:wait(expression)
  local deadline = socket.gettime() + PATIENCE
  while socket.gettime() < deadline do
    local ok, is_true = pcall(self.run, self, "return Boolean(" .. expression .. ")")
    if ok and is_true then return end
  end
  error("still not true: " .. expression .. "\n"
    .. self:run("return document.body.innerText"), 2)
end

--- Return the id of the first element that a CSS selector finds.
function Window:find(selector)
  local _, id = next(self:call("POST", "/element",
    { using = "css selector", value = selector }))
  return id -- its only field
end

--- Click the first element that a CSS selector finds. One that is drawn anew meanwhile
-- is found again.
function Window:click(selector)
  local deadline = socket.gettime() + PATIENCE
  repeat
    local ok, problem = pcall(function()
      self:call("POST", "/element/" .. self:find(selector) .. "/click")
    end)
    if ok then return end
    local is_soon = problem:find("stale element", 1, true)
      or problem:find("no such element", 1, true)
    if not is_soon or socket.gettime() > deadline then error(problem, 2) end
  until false
end

webdriver.BACKSPACE = "\238\128\131"

--- Type keys at what has the focus.
function Window:type(keys)
  local actions = {}
  for key in keys:gmatch("[%z\1-\127\194-\244][\128-\191]*") do
    actions[#actions + 1] = { type = "keyDown", value = key }
    actions[#actions + 1] = { type = "keyUp", value = key }
  end
  self:call("POST", "/actions",
    { actions = { { type = "key", id = "keys", actions = actions } } })
end

--- Send a command of Chromium's own protocol.
function Window:chromium(command, parameters)
  return self:call("POST", "/goog/cdp/execute",
    { cmd = command, params = setmetatable(parameters or {}, OBJECT) })
end

function Window:resize(width, height)
  self:chromium("Emulation.setDeviceMetricsOverride",
    { width = width, height = height, deviceScaleFactor = 1, mobile = false })
end

--- Return a screenshot as PNG.
function Window:screenshot()
  return (require("mime").unb64(self:call("GET", "/screenshot")))
end

--- Keep a screenshot in the folder that SHOTS names, if it does.
function Window:keep_shot(name)
  local folder = os.getenv "SHOTS"
  if not folder then return end
  local handle = assert(io.open(folder .. "/" .. name .. ".png", "wb"))
  handle:write(self:screenshot())
  handle:close()
end

--- Return the texts of the elements that a CSS selector finds, but for hidden ones.
function Window:texts(selector)
  return self:run([[return [...document.querySelectorAll(arguments[0])]
    .filter(e => !e.hidden).map(e => e.firstChild.textContent)]], selector)
end

function Window:close()
  if not self.is_closed then self:call("DELETE", "") end
  self.is_closed = true
end

--- Open a window.
function Driver:window()
  local value = request(self, "POST", "/session", {
    capabilities = { alwaysMatch = {
      browserName = "chrome",
      timeouts = { script = PATIENCE * 1000 },
      ["goog:chromeOptions"] = { args = ARGUMENTS },
    } },
  })
  local window = setmetatable({ driver = self, id = value.sessionId }, Window)
  self.windows[#self.windows + 1] = window
  return window
end

--- End the browser.
function Driver:stop()
  for _, window in ipairs(self.windows) do pcall(window.close, window) end
  os.execute("kill " .. self.pid .. " 2>/dev/null")
  self.output:close()
end

--- Start a driver. `pump(seconds)` is called while it waits.
function webdriver.start(pump)
  local output = assert(io.popen("chromedriver --port=0 2>&1 & echo $!"))
  local pid, port = output:read("*l"), nil
  for line in output:lines() do
    port = tonumber(line:match("started successfully on port (%d+)"))
    if port then break end
  end
  assert(port, "chromedriver did not start")
  return setmetatable({
    pid = pid, port = port, output = output, windows = {}, pump = pump,
  }, Driver)
end

return webdriver
