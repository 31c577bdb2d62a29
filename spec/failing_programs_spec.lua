-- A program that fails is reported, and the rest of the path runs as if it had not.
--
-- Along a path with many programs each one fails alone, and with each other one; core
-- and oracle must leave the same record: programs, err, warn and dbg in order, the
-- configuration, all modes, the queue, what reached the caller.

local runs = require "spec.support.runs"
local share = require "spec.support.share"

-- Charts: the paths of the workloads W2 and W4 ----------------------------------

local function new_chart()
  return {
    names = { "root" }, nodes = { root = { kind = "state", id = "root" } },
    transitions = {}, programs = { err = { false }, warn = { false } }, callables = {},
    positions = {},
  }
end

local function add_node(chart, parent, id, kind)
  local fqn = parent .. "." .. id
  chart.names[#chart.names + 1] = fqn
  chart.nodes[fqn] = { kind = kind, parent = parent, id = id }
  return fqn
end

-- Adds a leaf state; `programs` is a set of "entry" and "exit".
local function add_state(chart, parent, id, programs)
  local fqn = add_node(chart, parent, id, "state")
  local node = chart.nodes[fqn]
  node.is_leaf, node.entry, node.exit = true, programs.entry, programs.exit
  if node.entry then chart.programs["entry " .. fqn] = { false } end
  if node.exit then chart.programs["exit " .. fqn] = { false } end
  return fqn
end

-- Adds a transition written with names from the root, fields from `fields`.
local function add_transition(chart, owner, src, tgt, fields)
  local list, key = chart.transitions, 1
  for _, tr in ipairs(list) do
    if tr.owner == owner then key = key + 1 end
  end
  local tr = {
    src = src, tgt = tgt, src_ref = src, tgt_ref = tgt, owner = owner, key = key,
    pn = fields.pn, events = fields.events or {}, events_ref = fields.events,
    guard = fields.guard ~= nil, effect = fields.effect, index = #list + 1,
  }
  list[tr.index] = tr
  if tr.guard then chart.programs["guard " .. tr.index] = { fields.guard } end
  if tr.effect then chart.programs["effect " .. tr.index] = { false } end
  return tr.index
end

local function add_initial(chart, owner, tgt)
  local initial = add_node(chart, owner, "initial", "connector")
  local index = add_transition(chart, owner, initial, tgt, {})
  chart.transitions[index].src_ref = "initial"
end

-- A branch of `depth` states; returns the names, outermost first.
local function add_branch(chart, id, depth)
  local names, parent = {}, "root"
  for i = 1, depth do
    names[i] = add_state(chart, parent, i == 1 and id or "s",
      { entry = true, exit = true })
    if i > 1 then
      chart.nodes[parent].is_leaf = false
      add_initial(chart, parent, names[i])
    end
    parent = names[i]
  end
  return names
end

local OPS = {
  { "run" }, { "send", "e_b" }, { "step", 1 }, { "modes" }, { "send", "e_a", "e_x" },
  { "step", 3 }, { "modes" }, { "send", "e_b" }, { "run" }, { "modes" }, { "step", 2 },
}

-- Across two branches of six levels: six exits, six entries.
local function two_branches()
  local chart = new_chart()
  local a, b = add_branch(chart, "a", 6), add_branch(chart, "b", 6)
  add_initial(chart, "root", a[6])
  add_transition(chart, "root", a[6], b[6], { events = { "e_b" } })
  add_transition(chart, "root", b[6], a[6], { events = { "e_a" } })
  for i = 6, 1, -1 do chart.positions[#chart.positions + 1] = "exit " .. a[i] end
  for i = 1, 6 do chart.positions[#chart.positions + 1] = "entry " .. b[i] end
  return chart
end

-- Over four connectors: a guard and an effect each, an alternative with a guard each.
-- `other` is what the guards of the alternatives return, `pn` their priority.
local function four_connectors(other, pn)
  local chart = new_chart()
  local positions = chart.positions
  local a = add_state(chart, "root", "a", { entry = true, exit = true })
  local b = add_state(chart, "root", "b", { entry = true })
  local dead = add_state(chart, "root", "dead", { entry = true })
  add_initial(chart, "root", a)
  local k = { [5] = b }
  for i = 1, 4 do k[i] = add_node(chart, "root", "k" .. i, "connector") end
  local function note(what, index) positions[#positions + 1] = what .. " " .. index end
  note("effect", add_transition(chart, "root", a, k[1],
    { events = { "e_b" }, effect = true }))
  for i = 1, 4 do
    local index = add_transition(chart, "root", k[i], k[i + 1],
      { guard = false, effect = true })
    note("guard", index)
    note("effect", index)
    note("guard", add_transition(chart, "root", k[i], dead,
      { guard = { "return", other }, pn = pn }))
  end
  positions[#positions + 1] = "entry " .. b
  add_transition(chart, "root", b, a, { events = { "e_a" } })
  add_transition(chart, "root", dead, a, { events = { "e_a" } })
  return chart
end

local PATHS = {
  { name = "across two branches", make = two_branches, positions = 12 },
  { name = "over connectors whose alternatives are closed", positions = 14,
    make = function() return four_connectors(false, nil) end },
  { name = "over connectors whose alternatives are open", positions = 14,
    make = function() return four_connectors(true, nil) end },
  { name = "over connectors whose alternatives come second", positions = 14,
    make = function() return four_connectors(true, -1) end },
}

-- How it fails, and what is around ----------------------------------------------

local KINDS = {
  { name = "a string", action = { "raise", "no luck" } },
  { name = "a table", action = { "raise", { "no luck" } } },
  { name = "nil", action = { "raise" } },
  { name = "a string, from a callable table", action = { "raise", "no luck" },
    is_callable = true },
}

local function with_dbg(chart) chart.programs.dbg = { false } end

-- Two hooks on each state, those in `failing` fail.
local function add_hooks(chart, failing)
  for _, fqn in ipairs(chart.names) do
    if chart.nodes[fqn].kind == "state" then
      chart.nodes[fqn].hooks = 2
      for i = 1, 2 do
        for _, what in ipairs({ "entry_hook", "exit_hook" }) do
          local id = ("%s %d %s"):format(what, i, fqn)
          local is_failing = failing == true or failing and failing[id]
          chart.programs[id] = { is_failing and { "raise", id .. " failed" } or false }
        end
      end
    end
  end
end

-- Under the first one a program fails in each of the ways, under the others in one in
-- turn. Under those with `pairs` also two programs fail in one run.
local SURROUNDINGS = {
  { name = "dbg off", pairs = true, add = function() end },
  { name = "dbg on", add = with_dbg },
  { name = "hooks on each state", add = add_hooks },
  { name = "hooks on each state and dbg on", add = function(chart)
    with_dbg(chart)
    add_hooks(chart)
  end },
  { name = "hooks on each state that fail", pairs = true, add = function(chart)
    add_hooks(chart, true)
  end },
  { name = "an err that fails", add = function(chart)
    chart.programs.err = { { "raise", "err failed" } }
  end },
}

local function make_fail(chart, position, kind)
  chart.programs[position] = { kind.action }
  chart.callables[position] = kind.is_callable
end

-- Compare -----------------------------------------------------------------------

local function check(chart, what)
  chart.ops = OPS
  local at, expected, actual = runs.compare(chart)
  if not at then return end
  error(("%s: line %d: oracle '%s', core '%s'"):format(what, at, tostring(expected[at]),
    tostring(actual[at])), 0)
end

-- Compares with the programs at positions i and j failing (i may be j).
local function check_pair(path, surroundings, kind_i, kind_j, i, j)
  local chart = path.make()
  surroundings.add(chart)
  local first, second = chart.positions[i], chart.positions[j]
  make_fail(chart, first, kind_i)
  make_fail(chart, second, kind_j)
  check(chart, ("%s and %s, %s"):format(first, second, surroundings.name))
end

-- Compares with each two programs failing.
local function check_pairs(path, surroundings)
  for i = 1, path.positions do
    for j = i + 1, path.positions do
      if share.has(i + j) then
        check_pair(path, surroundings, KINDS[(i + j) % 4 + 1], KINDS[j % 4 + 1], i, j)
      end
    end
  end
end

-- Does the record of the oracle say that the program at `position` failed?
local function is_reported(path, position)
  local chart = path.make()
  make_fail(chart, position, KINDS[1])
  chart.ops = OPS
  local what, count = position:match("^%a+"), 0
  for _, line in ipairs(runs.on_oracle(chart)) do
    if line:find("^err " .. what:upper() .. " .* no luck$") then count = count + 1 end
  end
  return count > 0
end

-- Each chart is new code, which LuaJIT compiles for longer than it runs: off after the
-- first of the paths.
local jit = rawget(_G, "jit")
teardown(function() if jit then jit.on() end end)

describe("a program that fails", function()
  for _, path in ipairs(PATHS) do
    describe(path.name, function()
      teardown(function() if jit then jit.off() end end)

      it("is one of " .. path.positions, function()
        assert.equal(path.positions, #path.make().positions)
      end)

      for n, kind in ipairs(KINDS) do
        it("with " .. kind.name .. " changes nothing else", function()
          for s, surroundings in ipairs(SURROUNDINGS) do
            for i = 1, path.positions do
              if share.has(i) and (s == 1 or (s + i) % #KINDS == n - 1) then
                check_pair(path, surroundings, kind, kind, i, i)
              end
            end
          end
        end)
      end

      for _, surroundings in ipairs(SURROUNDINGS) do
        if surroundings.pairs then
          it("together with another changes nothing else, " .. surroundings.name,
            function() check_pairs(path, surroundings) end)
        end
      end
    end)
  end

  it("is reported wherever it runs", function()
    for _, path in ipairs({ PATHS[1], PATHS[2] }) do
      for i, position in ipairs(path.make().positions) do
        assert.is_true(is_reported(path, position), i .. ": " .. position)
      end
    end
  end)
end)

describe("a state hook that fails", function()
  local path = PATHS[1]

  -- The hook beside a position: exit_hook 1 F for exit F.
  local function hook_of(position)
    local what, fqn = position:match("^(%a+) (.*)$")
    return ("%s_hook 1 %s"):format(what, fqn)
  end

  local function check_hook(traced, i, j)
    local chart = path.make()
    local position, hook = chart.positions[i], hook_of(chart.positions[j])
    if traced then with_dbg(chart) end
    add_hooks(chart, { [hook] = true })
    make_fail(chart, position, KINDS[(i + j) % 4 + 1])
    check(chart, position .. " and " .. hook)
  end

  for _, traced in ipairs({ false, true }) do
    it("beside a program that fails changes nothing else, dbg "
      .. (traced and "on" or "off"), function()
      for i = 1, path.positions do
        for j = 1, path.positions do
          if share.has(i + j) then check_hook(traced, i, j) end
        end
      end
    end)
  end
end)
