--- Sequence charts: the moves of a witness as lines of text, which can be read back, or
--- as a diagram of Mermaid.
--
-- @module rfsm.system.sequence
-- @license BSD-3-Clause

local subject = require "rfsm.explore.subject"
local verdict = require "rfsm.explore.verdict"

local ipairs = ipairs
local concat = table.concat

local sequence = {}

local HOLDS = "; sends nothing yet"

-- Returns the text of what a move does.
local function text_of(move)
  local sent = move.sent and ("sends %s to %s%s"):format(move.sent.event,
    move.sent.wire.to, move.sent.is_lost and " (lost)" or "")
  if move.is_put then return "still in its step, " .. sent end
  return subject.outcome(move.taken, move.leaf) .. verdict.choices_text(move)
    .. (sent and "; " .. sent or move.holds and HOLDS or "")
end

--- Return the moves of a witness as lines, one line for each move:
--- "2. arm gets e_go from base, e_x from outside: root.trans[2] -> root.b; sends ..."
---@param witness rfsm.system.Move[]
---@return string[] lines
function sequence.lines_of(witness)
  local lines = {}
  for i, move in ipairs(witness) do
    local got = {}
    for n, each in ipairs(move.read) do got[n] = each.event .. " from " .. each.from end
    for _, event in ipairs(move.events) do got[#got + 1] = event .. " from outside" end
    lines[i] = ("%d. %s%s: %s"):format(i, move.machine,
      got[1] and " gets " .. concat(got, ", ") or "", text_of(move))
  end
  return lines
end

--- Read the moves in a text. Each line that begins with a number and a point is a move.
---@param text string
---@return { machine: string, events: string[], wanted: table|false, holds: boolean }[]
-- moves the arguments of `cell:move`
function sequence.read(text)
  local moves = {}
  for head, rest in ("\n" .. text):gmatch("\n%s*%d+%. ([^\n]-): ([^\n]*)") do
    local machine, got = head:match("^(.-) gets (.*)$")
    local move = { machine = machine or head, events = {}, wanted = false,
      holds = rest:sub(-#HOLDS) == HOLDS }
    for item in ((got or ""):gsub("%b{}", "") .. ", "):gmatch("(.-), ") do
      local event, from = item:match("^(.*) from (.-)$")
      if from == "outside" then
        move.events[#move.events + 1] = event
      elseif from then
        move.wanted = move.wanted or { from = from, event = event }
      end
    end
    moves[#moves + 1] = move
  end
  return moves
end

--- Return a witness as a sequence diagram of Mermaid.
---@param names string[] machines, from left to right
---@param witness rfsm.system.Move[]
---@return string text
function sequence.mermaid(names, witness)
  local lines = { "sequenceDiagram" }
  local function add(text, ...) lines[#lines + 1] = "  " .. text:format(...) end
  for _, name in ipairs(names) do add("participant %s", name) end
  for _, move in ipairs(witness) do
    for _, event in ipairs(move.events) do
      add("Note left of %s: %s", move.machine, event)
    end
    if not move.is_put then
      add("Note over %s: %s", move.machine, move.leaf or "not entered")
    end
    local sent = move.sent
    if sent then
      add("%s%s%s: %s", move.machine, sent.is_lost and "-x" or "->>", sent.wire.to,
        sent.event)
    end
  end
  return concat(lines, "\n") .. "\n"
end

return sequence
