-- A field with a slip of the pen, or in another kind of element, is told with its place
-- and its name, and a word of the user's own is not.

local calls = require "rfsm.shared.calls"
local bare = require "spec.support.bare"
local charts = require "spec.support.charts"
local new_random = require "spec.support.random"
local location = require "rfsm.shared.location"
local rfsm = require "rfsm"
local run_seeds = require "spec.support.run_seeds"
local rfsm_checks = require "rfsm_checks"

local claim = { name = "misspelt and misplaced fields" }

for _, name in ipairs { "_timeevent", "_seqand", ".history", ".defer", ".preview" } do
  require("rfsm" .. name)
end

local function f() end
local NAMES = { "e_a" }

-- Fields, the kind of element that has them, and a right value.
local FIELDS = {
  { "entry", "state", f }, { "exit", "state", f }, { "timed", "state", true },
  { "final", "state", true }, { "keep", "state", NAMES }, { "defer", "state", NAMES },
  { "history", "composite", "deep" }, { "doo", "leaf", f },
  { "checks", "any", { typo = "it is" } },
  { "src", "transition", "a" }, { "tgt", "transition", "a" },
  { "events", "transition", NAMES }, { "pn", "transition", 2 },
  { "guard", "transition", f }, { "effect", "transition", f },
  { "always", "transition", true }, { "likely", "transition", f },
  { "dbg", "root", true }, { "info", "root", f }, { "warn", "root", f },
  { "err", "root", f }, { "read", "root", "one" }, { "strict", "root", true },
  { "getevents", "root", f }, { "gettime", "root", f }, { "idle_hook", "root", f },
  { "pre_step_hook", "root", f }, { "post_step_hook", "root", f },
  { "checkevents", "root", true }, { "rename", "root", { ["root.a"] = "root.b" } },
  { "idle_doo", "region", "auto" }, { "order", "region", { "x" } },
  { "step", "region", 2 }, { "run", "region", true }, { "seqanddbg", "region", true },
}

local function has(field, obj)
  local kind, is_region = field[2], rfsm.regions(obj)[1] ~= nil
  return kind == "any" or kind == rfsm.kind_of(obj) or kind == "region" and is_region
    or kind == "root" and rfsm.is_root(obj)
    or kind == "leaf" and rfsm.is_state(obj) and not is_region
    or kind == "composite" and rfsm.is_composite(obj)
end

-- A letter too few, too many, replaced, or in another place; a capital; an s.
local SLIPS = {
  function(word, i) return word:sub(1, i - 1) .. word:sub(i + 1) end,
  function(word, i) return word:sub(1, i) .. word:sub(i) end,
  function(word, i)
    return #word > 4 and not word:find("_") and word:sub(1, i - 1) .. "q"
      .. word:sub(i + 1) or word .. "s"
  end,
  function(word, i)
    return word:sub(1, i - 1) .. word:sub(i + 1, i + 1) .. word:sub(i, i)
      .. word:sub(i + 2)
  end,
  function(word, i) return word:sub(1, i - 1) .. word:sub(i):upper() end,
  function(word) return (word:gsub("_", "")) end,
}

local WORDS = { "label", "color", "limit", "count", "speed", "title", "picture", "x" }

-- A random chart that has a state with regions, too.
local function new_model(seed)
  local model = bare.model_of(charts.generate(seed), {})
  model.info, model.warn, model.err = nil, nil, nil
  model.regions = rfsm.seqand { x = rfsm.state { y = rfsm.state {},
    rfsm.trans { src = "initial", tgt = "y" } } }
  table.insert(model, rfsm.trans { src = "initial", tgt = "regions", pn = -99 })
  return model
end

-- Is there a finding of an element in which all these texts stand?
-- Does the chart hold an element itself? It need not hold an `initial`.
local function is_given(obj)
  return rfsm.is_trans(obj) or obj._id ~= "initial"
    or rawget(rfsm.model_of(obj._parent), "initial") ~= nil
end

-- Is there a finding about an element with this field?
local function is_told(model, path, field)
  for _, finding in ipairs(rfsm_checks.findings(model)) do
    local place = finding.place:gsub(" %(.* %-> .*%)$", "")
    if place == path and finding.text:find("'" .. field .. "'", 1, true)
      or place == path .. "." .. field then
      return true
    end
  end
  return false
end

-- Tries a field in an element, under its name or a wrong one, and a word of the user's.
local function try(model, obj, field, random, expect)
  local own, path, word = rfsm.model_of(obj), location.path(obj), field[1]
  local before, key = own[word], random:pick(SLIPS)(word, random:below(#word))
  if not has(field, obj) then key = word end
  local is_apart = key == word and before == nil or key ~= "" and own[key] == nil
  if is_apart and not (key == word and has(field, obj)) then
    own[word] = nil
    own[key] = field[3]
    expect(is_told(model, path, word), key, path)
    own[key] = nil
  end
  own[word] = before
  local mine, count = random:pick(WORDS), #rfsm_checks.findings(model)
  if own[mine] == nil and not rfsm.regions(obj)[1] then
    own[mine] = field[3]
    expect(#rfsm_checks.findings(model) == count, mine, path)
    own[mine] = nil
  end
end

local function compare(seed, list)
  local random, model = new_random(seed), new_model(seed)
  local fsm = calls.silently(rfsm.init, model)
  if not fsm then return false end
  local function expect(is_right, key, path)
    if not is_right then list[#list + 1] = ("%d: %s in %s"):format(seed, key, path) end
  end
  for _ = 1, 6 do
    local obj, field = random:pick(rfsm.elements(fsm)), random:pick(FIELDS)
    if is_given(obj) then try(model, obj, field, random, expect) end
  end
  return true
end

claim.run = run_seeds(compare)

return claim
