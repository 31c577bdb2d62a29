-- Prints the live heap in KiB after loading each module in turn, from source and from
-- stripped bytecode:  LUA tools/size.lua MODULE...
--
-- With -p (plain) or -s (stripped) in front it prints one list of numbers.

package.path = "./?.lua;./compat/?.lua;" .. package.path

local version = _VERSION:match("[%d.]+$")

-- Lua 5.1 and 5.2 strip nothing: their compiler does.
local function load_stripped(file)
  if rawget(_G, "jit") or version > "5.2" then
    local text = string.dump(assert(loadfile(file)), true)
    return assert((rawget(_G, "loadstring") or load)(text, "=?"))
  end
  local output = os.tmpname()
  os.execute(("luac%s -s -o '%s' '%s'"):format(version, output, file))
  local chunk = assert(loadfile(output))
  os.remove(output)
  return chunk
end

local function search(name)
  for _, folder in ipairs { "./", "./compat/" } do
    local file = folder .. name:gsub("%.", "/") .. ".lua"
    local handle = io.open(file)
    if handle then
      handle:close()
      return load_stripped(file)
    end
  end
end

local function kib()
  collectgarbage()
  collectgarbage()
  return collectgarbage("count")
end

-- Prints a number a module: what loading it has added.
local function measure(names)
  local before = kib()
  for _, name in ipairs(names) do
    local ok = pcall(require, name)
    local after = kib()
    print(ok and ("%.1f"):format(after - before) or "-")
    before = after
  end
end

local mode = table.remove(arg, 1)
if mode == "-p" then return measure(arg) end
if mode == "-s" then
  local searchers = rawget(package, "searchers") or rawget(package, "loaders")
  table.insert(searchers, 2, search)
  return measure(arg)
end
table.insert(arg, 1, mode)

local function list(option)
  local pipe = io.popen(("%s tools/size.lua %s %s"):format(arg[-1], option,
    table.concat(arg, " ")))
  return pipe:lines()
end

local plain, stripped, sum, stripped_sum = list "-p", list "-s", 0, 0
print(("%-18s %8s %9s"):format("KiB, " .. (rawget(_G, "jit") and "LuaJIT" or _VERSION),
  "source", "stripped"))
for _, name in ipairs(arg) do
  local a, b = plain(), stripped()
  sum, stripped_sum = sum + (tonumber(a) or 0), stripped_sum + (tonumber(b) or 0)
  print(("%-18s %8s %9s"):format(name, a, b))
end
print(("%-18s %8.1f %9.1f"):format("together", sum, stripped_sum))
