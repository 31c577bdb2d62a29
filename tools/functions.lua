-- Prints doc/functions.md, a line for each public function:  LUA tools/functions.lua
--
-- The modules are those that doc/config.ld lists for the pages of the API. Each line is
-- the first sentence of a comment.

local files = require "rfsm.shared.files"

local function read(name) return assert(files.read(name)) end

-- Returns the files of modules, in the order of the pages.
local function files_of_pages()
  local list = {}
  for name in read("doc/config.ld"):match("\nfile = (%b{})"):gmatch("'%.%./([^']+)'") do
    list[#list + 1] = name
  end
  return list
end

-- Returns the first sentence of a comment, in one line.
local function sentence_of(comment)
  local text = comment:gsub("\n%-%-%-@.*", ""):gsub("\n%-%- @.*", "")
    :gsub("\n%-%-%-? ?", "\n")
    :gsub("^%-%-%- ?", "")
  text = (text:match("^(.-)\n\n") or text):gsub("%s+", " ")
  return (text:match("^(.-[^.][.?])%s%u") or text:gsub("%s+$", ""))
end

-- Appends the line of a function: "name(arguments)".
local function add(lines, name, arguments, comment)
  if lines[name] or comment:find("@package") then return end
  lines[name] = ("- `%s%s`: %s"):format(name, arguments, sentence_of(comment))
  lines[#lines + 1] = name
end

-- Returns "(fsm, hook)" for a type fun(fsm: rfsm.Machine, hook: function).
local function arguments_of(type)
  local names = {}
  for name, mark in (type:match("^fun(%b())") or "()"):sub(2, -2)
    :gmatch("([%w_.]+)(%??):") do
    names[#names + 1] = mark == "?" and "[" .. name .. "]" or name
  end
  return "(" .. table.concat(names, ", ") .. ")"
end

-- Returns the functions of a module in order, with the line of each.
local function lines_of(text)
  local lines = {}
  local BLOCK = "\n *(%-%-%-[^%-\n][^\n]*\n.-)\n *([^%-\n ][^\n]*)"
  for block, rest in text:gmatch(BLOCK) do
    local comment = block:gsub("\n +", "\n"):gsub("^.*\n\n", "")
    local name, arguments = rest:match("^function ([%w_]+[.:][%w_]+)(%b())")
    local field = rest:match("^([%w_]+%.[%w_]+) =")
    local kind = comment:match("@type ([^\n]*)") or ""
    if name then
      if (comment:match("@param %.%.%. (%S*)") or "nil") == "nil" then
        arguments = arguments:gsub(", %.%.%.", "")
      end
      add(lines, name, arguments, comment)
    elseif field and (kind:find("^fun") or kind:find("Constructor")) then
      add(lines, field, kind:find("^fun") and arguments_of(kind) or "{...}", comment)
    end
  end
  return lines
end

-- Appends functions that a module loads from others when they are first used.
local function add_elsewhere(lines, module, text)
  local list = text:match("\nlocal ELSEWHERE = (%b{})") or ""
  for name, from in list:gmatch('([%w_]+) = "([%w_.]+)"') do
    local others = lines_of(read(from:gsub("%.", "/") .. ".lua"))
    for _, other in ipairs(others) do
      if other:match("[%w_]+$") == name then
        lines[#lines + 1] = module .. "." .. name
        lines[module .. "." .. name] = others[other]:gsub("`[%w_]+%.",
          "`" .. module .. ".", 1)
      end
    end
  end
end

local function title_of(text)
  return sentence_of(text:match("^(%-%-%-.-\n)%-%-\n") or text:match("^[^\n]*\n"))
end

-- Returns { title, names } for the groups of the core's functions, as in the pages.
local function groups()
  local text, list = read("doc/config.ld"), {}
  local titles = text:match("local USE, ASK, EXTEND = ([^\n]*)")
  for title in titles:gmatch("'([^']*)'") do list[#list + 1] = { title = title } end
  local number = 0
  for names in text:gmatch("\ngroup%(%u+, %[%[(.-)%]%]%)") do
    number = number + 1
    list[number].names = " " .. names:gsub("%s+", " ") .. " "
  end
  list[#list + 1] = { title = "For extensions" }
  return list
end

-- Returns the text of the core's functions, in groups; the last takes the rest.
local function grouped(lines)
  local parts, is_listed = {}, {}
  for _, group in ipairs(groups()) do
    local own = { "### " .. group.title, "" }
    for _, name in ipairs(lines) do
      local word = name:gsub("^rfsm%.", " ") .. " "
      local is_own = not group.names or group.names:find(word, 1, true)
      if is_own and not is_listed[name] then
        own[#own + 1], is_listed[name] = lines[name], true
      end
    end
    if own[3] then parts[#parts + 1] = table.concat(own, "\n") end
  end
  return table.concat(parts, "\n\n")
end

local function listed(lines)
  local texts = {}
  for i, name in ipairs(lines) do texts[i] = lines[name] end
  return table.concat(texts, "\n")
end

local parts = { "# All functions\n\nOne line for each, from its comment. `make "
  .. "functions` makes this page, `make doc` pages\nwith arguments and results." }
for _, file in ipairs(files_of_pages()) do
  local module, text = file:gsub("%.lua$", ""):gsub("/", "."), read(file)
  local lines = lines_of(text)
  add_elsewhere(lines, module, text)
  if lines[1] then
    parts[#parts + 1] = ("## %s\n\n%s\n\n%s"):format(module, title_of(text),
      module == "rfsm" and grouped(lines) or listed(lines))
  end
end
print(table.concat(parts, "\n\n"))
