--- Code: a text of Lua in which comments and strings are blank.
--
-- The library has no other scanner of Lua; `rfsm.checks.source` has luacheck parse
-- callbacks, if that is installed.
--
-- @module rfsm.shared.code
-- @license BSD-3-Clause

local ipairs, select = ipairs, select
local concat = table.concat

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

--- Return a text with blanks in place of comments, and of strings unless `has_strings`.
--- Each line keeps its number.
---@param text string
---@param has_strings? boolean
---@return string code
function code.of(text, has_strings)
  local parts, at = {}, 1
  while true do
    local from = text:find("[\"']", at)
    local comment, long = text:find("--", at, true), text:find("%[=*%[", at)
    for _, other in ipairs { comment or false, long or false } do
      if other and (not from or other < from) then from = other end
    end
    if not from then break end
    local last = end_of_token(text, from)
    local token = text:sub(from, last)
    local stays = has_strings and from ~= comment
    parts[#parts + 1] = text:sub(at, from - 1) .. (stays and token or blank(token))
    at = last + 1
  end
  parts[#parts + 1] = text:sub(at)
  return concat(parts)
end

return code
