-- Where does an event spend its time?  LUA bench/profile.lua [WORKLOAD] [SECONDS]
--
-- Prints the hottest functions and lines of each workload of bench/run.lua, or of one,
-- sampled for SECONDS (1). On LuaJIT its own profiler takes time samples; elsewhere a
-- count hook counts instructions. The first lines say what that leaves out.

package.path = "./?.lua;" .. package.path

local measure = require "bench.measure"
local rfsm = require "rfsm"
local workloads = require "bench.workloads"

local ROWS = 10

-- Samplers --------------------------------------------------------------------
--
-- start(sample) has sample(source, line, line_defined, count, state) called.

local function time_sampler(profile)
  local sampler = { text = "samples of processor time, one a millisecond if it can\n"
    .. "bias: a sample falls on the line that begins next; C functions (pcall,\n"
    .. "resume) and the collector count for the line that called them; compiled code\n"
    .. "has a check at each line, so that its traces are not those of other runs" }
  function sampler.start(sample)
    profile.start("li1", function(thread, count, state)
      local info = debug.getinfo(thread, 0, "Sl")
      if info and info.what == "C" then info = debug.getinfo(thread, 1, "Sl") end
      if info then
        sample(info.short_src, info.currentline, info.linedefined, count, state)
      end
    end)
  end
  sampler.stop = profile.stop
  return sampler
end

-- Intervals vary (Lehmer's generator): a loop that takes as many instructions as a
-- fixed one would always be seen at the same line.
local function instruction_sampler()
  local sampler = { text = "samples of VM instructions, one in about 1,000\n"
    .. "bias: it says where instructions run, not time: C functions (pcall, resume),\n"
    .. "allocation and the collector weigh nothing; coroutines are not sampled" }
  local random = 1
  local function next_interval()
    random = random * 16807 % 2147483647
    return 500 + random % 1000
  end
  function sampler.start(sample)
    local function hook()
      local info = debug.getinfo(2, "Sl")
      sample(info.short_src, info.currentline, info.linedefined, 1)
      debug.sethook(hook, "", next_interval())
    end
    debug.sethook(hook, "", next_interval())
  end
  function sampler.stop() debug.sethook() end
  return sampler
end

local function find_sampler()
  local ok, profile = pcall(require, "jit.profile")
  if ok then return time_sampler(profile) end
  return instruction_sampler()
end

-- Collect ---------------------------------------------------------------------

local function bump(counts, key, by) counts[key] = (counts[key] or 0) + by end

-- Runs `subject` for `seconds`; returns the counts by function, line and VM state.
local function collect(sampler, subject, seconds)
  local profile = { total = 0, outside = 0, functions = {}, lines = {}, states = {} }
  sampler.start(function(source, line, line_defined, count, state)
    profile.total = profile.total + count
    if state then bump(profile.states, state, count) end
    if source:find("bench/", 1, true) then
      profile.outside = profile.outside + count
    else
      bump(profile.functions, source .. ":" .. line_defined, count)
      bump(profile.lines, source .. ":" .. line, count)
    end
  end)
  local chunk, start = 1, os.clock()
  while os.clock() - start < seconds do
    if measure.time(subject, chunk) < seconds / 20 then chunk = chunk * 2 end
  end
  sampler.stop()
  return profile
end

-- Print -----------------------------------------------------------------------

local sources = {}

-- Line `number` of a file, "" of what is no file.
local function source_line(file, number)
  if not sources[file] then
    sources[file] = {}
    local handle = io.open(file)
    for line in handle and handle:lines() or function() end do
      table.insert(sources[file], line)
    end
    if handle then handle:close() end
  end
  return sources[file][number] or ""
end

local function function_name(file, number)
  local line = source_line(file, number)
  return line:match("function%s+([%w_.:]+)")
    or line:match("([%w_.%[%]]+)%s*=%s*function")
    or number == 0 and "main chunk" or "anonymous"
end

local function line_text(file, number)
  return source_line(file, number):match("^%s*(.-)%s*$"):sub(1, 50)
end

-- The rows of `counts`, highest first; equal ones by place.
local function sorted(counts)
  local rows = {}
  for key, count in pairs(counts) do -- any order: sorted below
    local file, number = key:match("^(.*):(%-?%d+)$")
    rows[#rows + 1] = { file = file, number = tonumber(number), count = count }
  end
  table.sort(rows, function(a, b)
    if a.count ~= b.count then return a.count > b.count end
    if a.file ~= b.file then return a.file < b.file end
    return a.number < b.number
  end)
  return rows
end

local function print_rows(title, counts, total, text_of)
  print("   share  " .. title)
  local rows = sorted(counts)
  for i = 1, math.min(ROWS, #rows) do
    local row = rows[i]
    local place = ("%s:%d"):format(row.file:gsub("^%./", ""), row.number)
    print(("%6.1f %%  %-22s %s"):format(row.count / total * 100, place,
      text_of(row.file, row.number)))
  end
end

local STATES = { { "N", "compiled" }, { "I", "interpreted" }, { "C", "C code" },
  { "G", "collector" }, { "J", "the compiler itself" } }

local function print_states(states, total)
  local texts = {}
  for i, state in ipairs(STATES) do
    texts[i] = ("%s %.0f %%"):format(state[2], (states[state[1]] or 0) / total * 100)
  end
  print("the VM: " .. table.concat(texts, ", "))
end

local function print_profile(name, profile)
  local total = math.max(profile.total, 1)
  print(("\n%s: %d samples, %.1f %% outside the core"):format(name, profile.total,
    profile.outside / total * 100))
  if next(profile.states) then print_states(profile.states, total) end
  print_rows("function", profile.functions, total, function_name)
  print_rows("line", profile.lines, total, line_text)
end

-- Arguments -------------------------------------------------------------------

local function arguments()
  local names, seconds = {}, 1
  for i = 1, #arg do
    local number = tonumber(arg[i])
    if number then seconds = number else names[#names + 1] = arg[i] end
  end
  return measure.select(workloads, names), seconds
end

local selected, seconds = arguments()
local sampler = find_sampler()
print(("%s: %s"):format(measure.engine(), sampler.text))
for _, workload in ipairs(selected) do
  local subject = workload.make(rfsm)
  subject(1) -- what only the first call does is not what is asked
  print_profile(workload.name, collect(sampler, subject, seconds))
end
