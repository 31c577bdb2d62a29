-- Makes a chart on which core and oracle differ as small as can be, and writes it.

local shrink = {}

-- A copy of plain tables; functions and marked objects are shared.
local function copy_of(value)
  if type(value) ~= "table" or getmetatable(value) then return value end
  local copy = {}
  for k, v in pairs(value) do copy[k] = copy_of(v) end -- any order: a copy
  return copy
end

local function sorted_keys(t)
  local keys = {}
  for key in pairs(t) do keys[#keys + 1] = key end
  table.sort(keys)
  return keys
end

-- True when nothing refers to the node any more.
local function is_unused(chart, fqn)
  for _, tr in ipairs(chart.transitions) do
    if tr.src == fqn or tr.tgt == fqn or tr.owner == fqn then return false end
  end
  for _, other in ipairs(chart.names) do
    if chart.nodes[other].parent == fqn then return false end
  end
  for _, merge in ipairs(chart.merges) do
    if merge.node.parent == fqn then return false end
    for _, tr in ipairs(merge.transitions) do
      if tr.src == fqn or tr.tgt == fqn then return false end
    end
  end
  return fqn ~= "root"
end

local function remove_node(chart, i)
  local fqn = chart.names[i]
  if not is_unused(chart, fqn) then return false end
  local parent = chart.nodes[fqn].parent
  table.remove(chart.names, i)
  chart.nodes[fqn] = nil
  local is_leaf = true
  for _, other in ipairs(chart.names) do
    if chart.nodes[other].parent == parent then is_leaf = false end
  end
  chart.nodes[parent].is_leaf = is_leaf
end

local function remove_program(chart, id)
  local what, name = id:match("^(%S+) (.*)$")
  if chart.nodes[name] then chart.nodes[name][what] = false end
  for _, tr in ipairs(chart.transitions) do
    if tostring(tr.index) == name then tr[what] = false end
  end
  if id ~= "err" and id ~= "warn" then chart.programs[id] = nil end
end

local function simplify_transition(chart, i, field)
  chart.transitions[i][field] = nil
end

-- All the small changes that could be tried, each a function of a chart's copy.
local function changes_of(chart)
  local list = {}
  local function try(f, ...)
    local arguments = { ... }
    list[#list + 1] = function(copy) return f(copy, arguments[1], arguments[2]) end
  end
  for i = #chart.ops, 1, -1 do
    try(function(copy, at) table.remove(copy.ops, at) end, i)
  end
  for i = #chart.transitions, 1, -1 do
    try(function(copy, at) table.remove(copy.transitions, at) end, i)
    if chart.transitions[i].pn then try(simplify_transition, i, "pn") end
  end
  for _, id in ipairs(sorted_keys(chart.programs)) do
    try(remove_program, id)
    for i = #chart.programs[id], 2, -1 do
      try(function(copy, name, at) table.remove(copy.programs[name], at) end, id, i)
    end
  end
  for i = #chart.names, 1, -1 do try(remove_node, i) end
  return list
end

-- Makes each change that keeps `differs` true, until none does.
function shrink.smallest(chart, differs)
  local is_smaller
  repeat
    is_smaller = false
    for _, change in ipairs(changes_of(chart)) do
      local candidate = copy_of(chart)
      local ok, answer = pcall(change, candidate)
      if ok and answer ~= false then
        local ran, is_different = pcall(differs, candidate)
        if ran and is_different and not shrink.is_same(candidate, chart) then
          chart, is_smaller = candidate, true
          break
        end
      end
    end
  until not is_smaller
  return chart
end

--- Do two charts look alike? Compares what to_lua would write.
function shrink.is_same(a, b) return shrink.to_lua(a) == shrink.to_lua(b) end

-- Writing ---------------------------------------------------------------------

local function literal(value)
  if type(value) == "string" then return ("%q"):format(value) end
  if type(value) == "function" then return "has_2" end
  if type(value) ~= "table" then return tostring(value) end
  if getmetatable(value) then return value.name end
  local texts = {}
  for i = 1, #value do texts[i] = literal(value[i]) end
  for _, key in ipairs({ "action", "idle", "is_return" }) do
    if value[key] ~= nil then
      texts[#texts + 1] = key .. " = " .. literal(value[key])
    end
  end
  return "{ " .. table.concat(texts, ", ") .. " }"
end

local function program_text(chart, id)
  return ("program(%q, %s)"):format(id, literal(chart.programs[id] or {}))
end

local function add_fields(lines, indent, fields)
  for _, field in ipairs(fields) do
    if field[2] then
      lines[#lines + 1] = ("%s%s = %s,"):format(indent, field[1], field[2])
    end
  end
end

local function add_transition(lines, chart, indent, tr)
  local key = type(tr.key) == "string" and tr.key .. " = " or ""
  lines[#lines + 1] = indent .. key .. "rfsm.trans {"
  add_fields(lines, indent .. "  ", {
    { "src", literal(tr.src_ref) }, { "tgt", literal(tr.tgt_ref) },
    { "events", tr.events_ref and literal(tr.events_ref) },
    { "pn", tr.pn and tostring(tr.pn) },
    { "guard", tr.guard and program_text(chart, "guard " .. tr.index) },
    { "effect", tr.effect and program_text(chart, "effect " .. tr.index) },
  })
  lines[#lines + 1] = indent .. "},"
end

-- A merge, as the calls that make it.
local function merge_lines(chart, merge)
  local node = merge.node
  local entry = node.entry and "entry = " .. program_text(chart, "entry " .. merge.fqn)
  local lines = { ("rfsm.fsm_merge(fsm, fsm%s, rfsm.state { %s }, %q)"):format(
    node.parent:sub(5), entry or "", node.id) }
  for _, tr in ipairs(merge.transitions) do
    lines[#lines + 1] = "rfsm.fsm_merge(fsm, fsm,"
    add_transition(lines, chart, "  ", setmetatable({ key = false }, { __index = tr }))
    lines[#lines] = ("  }, %q)"):format(tr.key)
  end
  return table.concat(lines, "\n")
end

local function add_members(lines, chart, indent, fqn)
  local node = chart.nodes[fqn]
  for _, what in ipairs({ "entry", "exit", "doo" }) do
    local id = what .. " " .. fqn
    add_fields(lines, indent, { { what, node[what] and program_text(chart, id) } })
  end
  for _, name in ipairs(chart.names) do
    local child = chart.nodes[name]
    if child.parent == fqn and (child.id ~= "initial" or child.is_declared) then
      local kind = child.kind == "state" and "state" or "conn"
      lines[#lines + 1] = ("%s%s = rfsm.%s {"):format(indent, child.id, kind)
      add_members(lines, chart, indent .. "  ", name)
      lines[#lines + 1] = indent .. "},"
    end
  end
  for _, tr in ipairs(chart.transitions) do
    if tr.owner == fqn then add_transition(lines, chart, indent, tr) end
  end
end

--- The chart and its operations as Lua; `program` is whatever the spec makes of it.
function shrink.to_lua(chart)
  local lines = { "local model = rfsm.state {" }
  for _, id in ipairs({ "getevents", "pre_hook", "post_hook", "idle_hook", "dbg" }) do
    local field = id:gsub("_hook", "_step_hook"):gsub("idle_step", "idle")
    local text = chart.programs[id] and program_text(chart, id)
    add_fields(lines, "  ", { { field, text } })
  end
  add_members(lines, chart, "  ", "root")
  lines[#lines + 1] = "}"
  lines[#lines + 1] = "local fsm = rfsm.init(model)"
  for _, op in ipairs(chart.ops) do
    local name = op[1] == "send" and "send_events" or op[1]
    local arguments = { "fsm" }
    for i = 2, #op do arguments[i] = literal(op[i]) end
    lines[#lines + 1] = name == "merge" and merge_lines(chart, chart.merges[op[2]])
      or ("rfsm.%s(%s)"):format(name, table.concat(arguments, ", "))
  end
  return table.concat(lines, "\n")
end

return shrink
