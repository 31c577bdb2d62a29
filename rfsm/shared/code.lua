--- Replaces comments and strings in a Lua text by blanks, so that only code is left.
--
-- Only `rfsm.checks.source` needs more: it parses callbacks, with luacheck.
--
-- @module rfsm.shared.code
-- @license BSD-3-Clause

local ipairs, select = ipairs, select
local concat, huge = table.concat, math.huge

local code = {}

local function blank(text) return (text:gsub("[^\n]", " ")) end

-- Returns the position of the end of the string or comment that begins at a position.
local function end_of_token(text, at)
  local level = text:match("^%-%-%[(=*)%[", at) or text:match("^%[(=*)%[", at)
  if level then
    return select(2, text:find("]" .. level .. "]", at, true)) or #text
  elseif text:sub(at, at + 1) == "--" then
    return (text:find("\n", at, true) or #text + 1) - 1
  end
  local quote = text:sub(at, at)
  repeat
    at = text:find("[\\" .. quote .. "\n]", at + 1) or #text
    local is_escaped = text:sub(at, at) == "\\"
    if is_escaped then at = at + 1 end
  until at >= #text or text:find("^[" .. quote .. "\n]", at) and not is_escaped
  return at
end

-- Patterns for the beginning of a comment, a long string and a quoted string.
local OPENINGS = { "%-%-", "%[=*%[", "[\"']" }

--- Return a text with blanks in place of comments and strings, so that each line keeps
--- its number. If `strings` is true, strings stay; a text stands for each of them.
---@param text string
---@param strings? string|true
---@return string code
function code.of(text, strings)
  local parts, at, next_ones = {}, 1, {}
  while true do
    local from, is_comment = #text + 1
    for i, opening in ipairs(OPENINGS) do
      if (next_ones[i] or 0) < at then next_ones[i] = text:find(opening, at) or huge end
      if next_ones[i] < from then from, is_comment = next_ones[i], i == 1 end
    end
    if from > #text then break end
    local last = end_of_token(text, from)
    local token = text:sub(from, last)
    local kept = not is_comment and (strings == true and token or strings)
    parts[#parts + 1] = text:sub(at, from - 1) .. (kept or blank(token))
    at = last + 1
  end
  parts[#parts + 1] = text:sub(at)
  return concat(parts)
end

return code
