-- Do the specs notice a change?  LUA tools/mutants.lua ROOM [N [SEED]]
--
-- A room is a part of the library with its specs. N times (100), one token of the
-- room's files is changed at random, and the specs run under LUA, until one fails. A
-- line is printed for each change that no spec notices, then the share that was
-- noticed. A changed program that behaves the same counts as not noticed. Two rooms may
-- run at once: the changes are made in a copy of the tree.

package.path = "./?.lua;" .. package.path
local helper = require "spec.helper"
local new_random = require "spec.support.random"

local compile = rawget(_G, "loadstring") or load

-- A room: its name, its files, and its specs, the fast ones first.
local ROOMS = {
  { name = "core", files = { "rfsm.lua", "rfsm/always.lua" }, specs = { "transition",
    "doo", "check", "cheatsheet", "idioms", "contract", "live", "machine", "mistakes",
    "robust", "extensions", "fast", "completion", "alloc", "scale", "interrupt",
    "failing_programs", "strict", "alone", "timeevent", "always", "named", "fates",
    "locale", "folder", "reactions", "first_hour", "oracle", "house" } },
  { name = "fast", files = { "rfsm/fast.lua" },
    specs = { "transition", "fast", "completion", "live", "machine", "robust",
      "interrupt", "contract", "extensions", "alloc", "scale", "failing_programs",
      "house", "oracle" } },
  { name = "timeevent",
    files = { "rfsm_timeevent.lua", "rfsm/clock.lua", "rfsm/clock/*.lua" },
    specs = { "timeevent", "sends", "every", "elapsed", "alone" } },
  { name = "seqand", files = { "rfsm_seqand.lua" }, specs = { "seqand", "completion",
    "fates", "copy", "server_functions", "interrupt" } },
  { name = "await", files = { "rfsm/await.lua", "rfsm/emem.lua", "rfsm/monitor.lua",
    "rfsm/preview.lua", "rfsm/history.lua", "rfsm/defer.lua", "rfsm/faults.lua" },
    specs = { "await", "defer", "faults", "emem", "monitor", "preview", "history",
      "reactions", "fates", "interrupt", "snapshot" } },
  { name = "checks", files = { "rfsm_checks.lua", "rfsm/checks/*.lua",
    "rfsm/cli/review.lua", "rfsm/shared/location.lua", "rfsm/shared/match.lua" },
    specs = { "shared", "reactions", "checks", "alone", "source", "first_hour",
      "verdict", "alarms", "defer", "tools" } },
  { name = "explore", files = { "rfsm/explore/*.lua" },
    specs = { "reactions", "data", "property", "independence", "timing", "verdict",
      "explore", "observer", "tests", "system_check" } },
  { name = "tests", files = { "rfsm/tests/*.lua" },
    specs = { "tests", "tools", "timing", "data", "explore", "verdict" } },
  { name = "observe", files = { "rfsm/observe/*.lua" },
    specs = { "stream", "coverage", "why", "view", "property", "observer",
      "sim_session", "sim", "proto", "web" } },
  { name = "extensions", files = { "rfsm/fates.lua", "rfsm/strict.lua" },
    specs = { "fates", "strict", "always", "why", "interrupt", "first_hour" } },
  { name = "snapshot", files = { "rfsm/snapshot.lua", "rfsm/snapshot/*.lua" },
    specs = { "snapshot", "upgrade", "server_functions" } },
  { name = "record", files = { "rfsm/record.lua", "rfsm/record/*.lua" },
    specs = { "record", "stream" } },
  { name = "pictures", files = { "rfsm/dot.lua", "rfsm/mermaid.lua",
    "rfsm/plantuml.lua", "rfsm/json.lua", "rfsm/marsh.lua", "rfsm/pictures/*.lua" },
    specs = { "export", "diagram", "layout", "choice", "pictures" } },
  { name = "sim", files = { "rfsm/sim/*.lua" },
    specs = { "sim_terminal", "sim_session", "sim" } },
  { name = "web", files = { "rfsm/web.lua", "rfsm/web/*.lua" },
    specs = { "view", "painter", "web" } },
  { name = "proto", files = { "rfsm/proto.lua", "rfsm/proto/*.lua" },
    specs = { "proto", "web" } },
  { name = "redis", files = { "rfsm/redis.lua", "rfsm/redis/*.lua",
    "rfsm/server/*.lua", "rfsm/fleet.lua" },
    specs = { "connection", "client", "server_functions", "server_sandbox", "fleet",
      "redis" } },
  { name = "postgres", files = { "rfsm/postgres.lua", "rfsm/postgres/*.lua" },
    specs = { "postgres_client", "postgres" } },
  { name = "rtt", files = { "rfsm/rtt.lua", "rfsm/rtt/*.lua" },
    specs = { "rtt_standin", "rtt", "rtt_ports", "rtt_exception", "rtt_rttlib",
      "rtt_stripped", "rtt_own", "rtt_launch", "system_launch", "system_deployed" } },
  { name = "cli", files = { "rfsm/cli/*.lua" }, specs = { "cli", "system", "tools",
    "system_check", "project" } },
  { name = "system", files = { "rfsm/system.lua", "rfsm/system/*.lua",
    "rfsm/cli/side_by_side.lua" }, specs = { "system", "system_check" } },
  { name = "pp", files = { "rfsmpp.lua" }, specs = { "pp", "data_text", "event_text",
    "data" } },
  { name = "shared", files = { "rfsm/advice.lua", "rfsm/shared/*.lua" },
    specs = { "shared", "reactions", "stub", "mistakes", "first_hour", "checks",
      "stream", "data", "tests", "record", "verdict", "tools" } },
}

local function fail(message)
  io.stderr:write("mutants: ", message, "\n")
  os.exit(2)
end

-- Tokens: text, kind, and where they are --------------------------------------

local KEYWORDS = {}
for word in ([[and break do else elseif end false for function if in local nil not or
  repeat return then true until while]]):gmatch("%a+") do KEYWORDS[word] = true end

local PATTERNS = { -- the first that matches
  { "blank", "^%s+" },
  { "comment", "^%-%-%[(=*)%[.-%]%1%]" }, { "comment", "^%-%-[^\n]*" },
  { "long", "^%[(=*)%[.-%]%1%]" },
  { "name", "^[%a_][%w_]*" },
  { "number", "^0[xX]%x+" }, { "number", "^%d*%.?%d+[eE][+-]?%d+" },
  { "number", "^%d+%.%d+" }, { "number", "^%d+" },
  { "operator", "^%.%.%.?" }, { "operator", "^[=~<>]=" }, { "operator", "^." },
}

-- Returns the end of the string that begins at `from`.
local function end_of_string(text, from)
  local quote, at = text:sub(from, from), from + 1
  while true do
    at = text:find("[\\" .. quote .. "]", at)
    if text:sub(at, at) == quote then return at end
    at = at + 2
  end
end

local function match_token(text, from)
  if text:find("^[\"']", from) then return "string", end_of_string(text, from) end
  for _, pattern in ipairs(PATTERNS) do
    local _, to = text:find(pattern[2], from)
    if to then return pattern[1], to end
  end
end

-- Lists the tokens of a program: `kind`, `text`, `from`, `to`, `line`, and `is_first`
-- of its line.
local function tokens_of(text)
  local tokens, from, line, last_line = {}, 1, 1, 0
  while from <= #text do
    local kind, to = match_token(text, from)
    local piece = text:sub(from, to)
    if kind == "name" and KEYWORDS[piece] then kind = "keyword" end
    if kind ~= "blank" and kind ~= "comment" then
      tokens[#tokens + 1] = { kind = kind, text = piece, from = from, to = to,
        line = line, is_first = line ~= last_line }
      last_line = line
    end
    line = line + select(2, piece:gsub("\n", ""))
    from = to + 1
  end
  return tokens
end

-- Changes: for a token, calls add(from, to, what is there instead) -------------

local INSTEAD = {
  ["=="] = { "~=" }, ["~="] = { "==" }, ["<"] = { "<=", ">=" }, ["<="] = { "<", ">" },
  [">"] = { ">=", "<=" }, [">="] = { ">", "<" },
  ["+"] = { "-" }, ["-"] = { "+" }, ["*"] = { "/" }, ["/"] = { "*" }, ["%"] = { "*" },
  ["and"] = { "or" }, ["or"] = { "and" }, ["not"] = { "" },
  ["true"] = { "false" }, ["false"] = { "true" }, ["break"] = { "" },
}

local function replace(token, _, _, add)
  for _, other in ipairs(INSTEAD[token.text] or {}) do
    add(token.from, token.to, other)
  end
end

local function change_number(token, _, _, add)
  local number = token.kind == "number" and tonumber(token.text)
  if not number then return end
  add(token.from, token.to, ("%.14g"):format(number + 1))
  local less = ("%.14g"):format(number - 1)
  add(token.from, token.to, number < 1 and "(" .. less .. ")" or less)
end

-- Only words: what is printed would be most of the strings.
local function change_word(token, tokens, i, add)
  local word = token.kind == "string" and token.text:match("^.([%w_@.]+).$")
  if not word or tokens[i - 1] and tokens[i - 1].text == "require" then return end
  add(token.from, token.to, ("%q"):format(word .. "x"))
end

local function remove_line(token, _, _, add, text)
  if not token.is_first or token.kind ~= "name" and token.text ~= "return"
    and token.text ~= "if" then return end
  local last = (text:find("\n", token.from, true) or #text + 1) - 1
  add(token.from, last, "")
end

local BODIES = { ["if"] = "then", ["elseif"] = "then", ["while"] = "do" }

local function negate(token, tokens, i, add, text)
  local body = BODIES[token.text]
  if not body then return end
  for j = i + 1, #tokens do
    local other = tokens[j].text
    if other == "function" then return end
    if other == body then
      local from, to = tokens[i + 1].from, tokens[j - 1].to
      return add(from, to, "not (" .. text:sub(from, to) .. ")")
    end
  end
end

-- Is the "(" at i that of a call?
local function is_call(tokens, i)
  local before = tokens[i - 1]
  if not before or before.kind ~= "name" and not before.text:find("^[])]$") then
    return false
  end
  local j = i - 1
  while tokens[j] and (tokens[j].kind == "name" or tokens[j].text:find("^[.:]$")) do
    j = j - 1
  end
  return not (tokens[j] and tokens[j].text == "function")
end

local OPENS = { ["("] = 1, ["{"] = 1, ["["] = 1, [")"] = -1, ["}"] = -1, ["]"] = -1 }

-- Lists where arguments end, those of the call whose "(" is at i: two at most.
local function ends_of_arguments(tokens, i)
  local depth, ends = 1, {}
  for j = i + 1, #tokens do
    local other = tokens[j].text
    if other == "function" then break end
    depth = depth + (OPENS[other] or 0)
    if depth == 0 or depth == 1 and other == "," then ends[#ends + 1] = j end
    if depth == 0 or #ends == 2 then break end
  end
  return ends
end

local SYMMETRIC = { rawequal = true, max = true, min = true }

-- Swaps the first two arguments of a call, if that may make a difference.
local function swap_arguments(token, tokens, i, add, text)
  if token.text ~= "(" or not is_call(tokens, i) or SYMMETRIC[tokens[i - 1].text] then
    return
  end
  local ends = ends_of_arguments(tokens, i)
  if #ends < 2 then return end
  local from, to = tokens[i + 1].from, tokens[ends[2] - 1].to
  local first = text:sub(from, tokens[ends[1] - 1].to)
  local second = text:sub(tokens[ends[1] + 1].from, to)
  if first ~= second then add(from, to, second .. ", " .. first) end
end

local KINDS = { replace, change_number, change_word, remove_line, negate,
  swap_arguments }

-- Lists the places of a file that can be changed: `file`, `line`, `text` of the file,
-- `changes`.
local function sites_of(file, sites)
  local text = helper.content(file)
  local tokens = tokens_of(text)
  for i, token in ipairs(tokens) do
    local site = { file = file, line = token.line, text = text, changes = {} }
    for _, kind in ipairs(KINDS) do
      kind(token, tokens, i, function(from, to, other)
        site.changes[#site.changes + 1] = { from = from, to = to, other = other }
      end, text)
    end
    if site.changes[1] then sites[#sites + 1] = site end
  end
end

-- Returns a mutant at random: `file`, `line`, `text`. No place is taken twice.
local function draw(sites, random)
  while sites[1] do
    local site = table.remove(sites, random(#sites))
    local change = random:pick(site.changes)
    local text = site.text:sub(1, change.from - 1) .. change.other
      .. site.text:sub(change.to + 1)
    if compile(text) then return { file = site.file, line = site.line, text = text } end
  end
end

local function line_of(text, number)
  for line in (text .. "\n"):gmatch("([^\n]*)\n") do
    number = number - 1
    if number == 0 then return (line:gsub("^%s+", "")) end
  end
end

-- Runs ------------------------------------------------------------------------

local Copy = {}
Copy.__index = Copy

-- Copies the tree into a new folder.
local function new_copy(lua)
  local folder = helper.text_of("mktemp -d"):match("%S+")
  os.execute(("{ git ls-files -co --exclude-standard 2>/dev/null || find . -type f; } |"
    .. " tar -cf - -T - 2>/dev/null | tar -xf - -C '%s'"):format(folder))
  return setmetatable({ folder = folder, lua = lua }, Copy)
end

function Copy:remove() os.execute("rm -rf '" .. self.folder .. "'") end

-- Returns the exit code of a spec file, and what it printed.
function Copy:run(spec, limit)
  local text = helper.text_of(("cd '%s' && ulimit -v 4000000; timeout -k 1 %d %s"
    .. " --no-keep-going --lua='%s' %s 2>&1 </dev/null; echo \"exit $?\""):format(
    self.folder, limit, os.getenv("BUSTED") or "busted", self.lua, spec))
  local code = tonumber(text:match("exit (%d+)\n$"))
  if code == 130 then error("interrupted!", 0) end
  return code, text
end

-- Returns the specs with the seconds after which each is stopped. All must pass.
function Copy:measure(files)
  local specs = {}
  for i, file in ipairs(files) do
    local began = os.time()
    local code, text = self:run(file, 600)
    if code ~= 0 or not text:find("[1-9]%d* success") then
      error(("%s: must pass before a change\n%s"):format(file, text), 0)
    end
    specs[i] = { file = file, limit = 10 + 3 * (os.time() - began) }
  end
  return specs
end

-- Does a spec notice the mutant?
function Copy:notices(mutant, specs)
  local name = self.folder .. "/" .. mutant.file
  local text = helper.content(name)
  helper.write(name, mutant.text)
  local is_noticed = false
  for _, spec in ipairs(specs) do
    is_noticed = self:run(spec.file, spec.limit) ~= 0
    if is_noticed then break end
  end
  helper.write(name, text)
  return is_noticed
end

local function show(mutant)
  print(("%s:%d: %s -> %s"):format(mutant.file, mutant.line,
    line_of(helper.content(mutant.file), mutant.line),
    line_of(mutant.text, mutant.line)))
  io.stdout:flush()
end

-- The spec files of a room that are there.
local function specs_of(room)
  local files = {}
  for _, name in ipairs(room.specs) do
    local file = "spec/" .. name .. "_spec.lua"
    local handle = io.open(file)
    if handle then files[#files + 1] = file handle:close() end
  end
  return files
end

-- Prints the mutants that no spec notices, and the share of the others.
local function try(copy, room, sites, count, seed)
  local random, began = new_random(seed), os.time()
  local files = specs_of(room)
  print(("%s: %d places in %s, with %s"):format(room.name, #sites,
    table.concat(room.files, " "), table.concat(files, " ")))
  local specs = copy:measure(files)
  local tried, killed = 0, 0
  while tried < count do
    local mutant = draw(sites, random)
    if not mutant then break end
    tried = tried + 1
    if copy:notices(mutant, specs) then killed = killed + 1 else show(mutant) end
  end
  print(("%s: %d of %d mutants killed (%.0f %%), seed %d, %d s"):format(room.name,
    killed, tried, 100 * killed / math.max(tried, 1), seed, os.time() - began))
end

-- Command line ----------------------------------------------------------------

local function room_named(name)
  local names = {}
  for i, room in ipairs(ROOMS) do
    if room.name == name then return room end
    names[i] = room.name
  end
  fail(("ROOM: expected %s, got '%s'"):format(table.concat(names, ", "), name or ""))
end

local function number_of(text, name, default)
  local number = tonumber(text or default)
  if not number or number < 1 or number % 1 ~= 0 then
    fail(("%s: number from 1 on expected, got '%s'"):format(name, text))
  end
  return number
end

local room = room_named(arg[1])
local count, seed = number_of(arg[2], "N", 100), number_of(arg[3], "SEED", 1)
local sites = {}
local list = helper.text_of("ls " .. table.concat(room.files, " ") .. " 2>/dev/null")
for file in list:gmatch("%S+") do sites_of(file, sites) end

local copy = new_copy(helper.text_of("command -v '" .. arg[-1] .. "'"):match("[^\n]+"))
local is_done, problem = pcall(try, copy, room, sites, count, seed)
copy:remove()
if not is_done then fail(problem) end
