-- The hosts of examples/hosts/ that need a program of their own, started for real:
-- `make test-hosts`. What is not installed is pending.

local helper = require "spec.helper"
local has_socket, socket = pcall(require, "socket")
local servers = require "spec.support.servers"

local lines_of, start = helper.lines_of, servers.program

-- Asks until the answer is found, for a minute at most.
local function wait_for(what, ask, ...)
  local began, answer = os.time(), ""
  while os.time() - began < 60 do
    answer = ask(...)
    if answer:find(what, 1, true) then return end
    socket.select(nil, nil, 0.01)
  end
  error(("'%s' has not come, but '%s'"):format(what, answer), 0)
end

local function output_of(command)
  return table.concat(lines_of(command .. " 2>&1"), "\n")
end

-- Describes a host, if its programs and modules are here.
local function host(name, programs, modules, f)
  describe(name, function()
    local missing = has_socket and {} or { "luasocket" }
    for _, program in ipairs(programs) do
      local path = lines_of("command -v " .. program)[1]
      missing[#missing + 1] = not path and program or nil
    end
    for _, module in ipairs(modules) do
      if not pcall(require, module) then missing[#missing + 1] = module end
    end
    after_each(servers.stop_all)
    if missing[1] then
      assert(os.getenv "PENDING" ~= "no", "missing: " .. table.concat(missing, ", "))
      return pending(name .. ": missing are " .. table.concat(missing, ", "))
    end
    f()
  end)
end

local LUA = "'" .. helper.interpreter() .. "' examples/hosts/"

host("the host in Neovim", { "nvim", "git" }, {}, function()
  it("checks what was saved, and commits it", function()
    local folder = os.tmpname()
    os.execute(("rm %s && git init -q %s && cd %s && git config user.name n && "
      .. "git config user.email e@example.org && touch a.lua && git add a.lua"):format(
      folder, folder, folder))
    local server = ("nvim --server %s/socket --remote-"):format(folder)
    local function send(keys) output_of(server .. "send '" .. keys .. "'") end
    local function ask(what) return output_of(server .. "expr '" .. what .. "'") end
    start(("nvim --headless --clean --listen %s/socket -S examples/hosts/neovim.lua "
      .. "%s/a.lua"):format(folder, folder))
    wait_for("root.editing", ask, "&statusline")
    send "ireturn 1 +<Esc>:w<CR>"
    wait_for("unexpected symbol", ask, 'luaeval("vim.inspect(vim.diagnostic.get(0))")')
    wait_for("root.editing", ask, "&statusline")
    send "A 1<Esc>:w<CR>"
    wait_for("root.saved.clean", ask, "&statusline")
    send ":Commit<CR>"
    wait_for("root.saved.committed", ask, "&statusline")
    assert.equal("Reviewed", output_of("git -C " .. folder .. " log --format=%s"))
    send "A -- more<Esc>"
    wait_for("root.editing", ask, "&statusline")
    os.execute("rm -r " .. folder)
  end)
end)

host("the host in LÖVE", { "love", "Xvfb", "dot", "stdbuf" }, {}, function()
  it("comes back to the leg of the round that the guard had left", function()
    local screen = start "sh -c 'exec Xvfb -displayfd 1 -screen 0 800x600x24'"
    wait_for("\n", screen.log, screen)
    local game = start(("env DISPLAY=:%s LIBGL_ALWAYS_SOFTWARE=1 SDL_AUDIODRIVER=dummy "
      .. "stdbuf -oL love examples/hosts/love 60"):format(screen:log():match("%d+\n")
      :match("%d+")))
    wait_for("root.patrol.east\nroot.hunt\nroot.search\nroot.patrol\n"
      .. "root.patrol.east\n", game.log, game)
    assert.is_nil(game:log():find "Error")
  end)
end)

host("the host on MQTT", { "mosquitto", "mosquitto_sub" }, { "luv" }, function()
  it("reads topics, keeps its state, comes back, and has a last will", function()
    local port = servers.free_port()
    local function state()
      return output_of("timeout 1 mosquitto_sub -t heating/state -C 1 -p " .. port)
    end
    local function send(topic, text)
      output_of(("mosquitto_pub -p %s -t heating/%s -m %s"):format(port, topic, text))
    end
    local here = start(LUA .. "mqtt_host.lua " .. port)
    for _ = 1, 2 do -- the broker comes later, and goes for a time
      local broker = start("mosquitto -p " .. port)
      wait_for("off", state)
      wait_for("heating", function()
        send("room", "17.5")
        return state()
      end)
      send("window", "open")
      wait_for("airing", state)
      send("window", "shut")
      wait_for("off", state)
      broker:kill()
    end
    start("mosquitto -p " .. port)
    wait_for("off", state)
    here:kill()
    wait_for("offline", state)
  end)
end)

host("the server on luv", {}, { "luv" }, function()
  it("has a thousand connections, with a machine each", function()
    local port, peers = servers.free_port(), {}
    start(LUA .. "luv_server.lua " .. port)
    wait_for("yes", function()
      peers[1] = peers[1] or socket.connect("127.0.0.1", port)
      return peers[1] and "yes" or "no"
    end)
    for i = 2, 1000 do peers[i] = assert(socket.connect("127.0.0.1", port)) end
    for _, leaf in ipairs { "root.open.on", "root.open.off", "root.open.on" } do
      for _, peer in ipairs(peers) do peer:send "e_push\n" end
      for _, peer in ipairs(peers) do assert.equal(leaf, (peer:receive "*l")) end
    end
    for i = 2, 1000 do peers[i]:close() end
    wait_for("1 machines, ", function()
      peers[1]:send "stats\n"
      return " " .. peers[1]:receive "*l"
    end)
  end)
end)
