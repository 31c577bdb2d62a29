--- The description of a chart that snapshots use: its structure as lines of text, the
-- states with kept data, and the first values of the kept fields.
--
-- @module rfsm.snapshot.shape
-- @license BSD-3-Clause

local calls = require "rfsm.shared.calls"
local encoding = require "rfsm.snapshot.encoding"
local location = require "rfsm.shared.location"
local match = require "rfsm.shared.match"
local order = require "rfsm.shared.order"
local rfsm = require "rfsm"

local ipairs, rawget, setmetatable, type = ipairs, rawget, setmetatable, type
local floor = math.floor
local concat, sort = table.concat, table.sort
local fail, is_scalar, text_of = encoding.fail, encoding.is_scalar, rfsm.text_of

local shape = {}

-- Lines: one for each element -------------------------------------------------------

-- Returns an event or predicate as a text. Once it had no names of events with data.
local function event_text_before(event)
  return is_scalar(event) and text_of(event) or "a " .. type(event)
end

local function event_text(event)
  local name = rfsm.event_name(event) or rfsm.name_with_data(event)
  return name and rfsm.event_text(rfsm.named(name), true) or event_text_before(event)
end

local function texts_of(events, text) return concat(order.map(events, text), ", ") end

local function line_of(obj, text)
  if rfsm.is_conn(obj) then return "connector " .. obj._fqn end
  if rfsm.is_state(obj) then return "state " .. obj._fqn end
  return ("%s -> %s%s%s"):format(obj.src._fqn, rfsm.target_of(obj),
    obj.events[1] ~= nil and " on " .. texts_of(obj.events, text) or "",
    obj.pn and " pn " .. text_of(obj.pn) or "")
end

local NONE = {}

-- Returns the list `defer` of a state, from its model; an empty list if it has none.
local function deferred(state)
  local list = rfsm.model_of(state).defer
  return type(list) == "table" and not rfsm.is_fsmobj(list) and list or NONE
end

--- Does a transition of a machine or its regions take an event, or does an extension
-- wait for it? A state that defers it does not count.
function shape.wants(fsm, event)
  for at, obj in location.each(fsm) do
    local is_wanted = rfsm.is_trans(obj)
      and (match.begins_on_any(obj) or match.takes(obj.events or NONE, event))
      or rfsm.is_state(obj) and not match.takes(deferred(obj), event)
      and match.has(rfsm.reactions(at.machine, obj), event)
    if is_wanted then return true end
  end
  return false
end

--- List the events that a state defers, as samples, except those that only a predicate
-- describes.
function shape.samples(state)
  local events = {}
  for _, event in ipairs(deferred(state)) do
    local name = rfsm.event_name(event)
    events[#events + 1] = name and { name = name }
      or type(event) ~= "function" and event or nil
  end
  return events
end

--- Does `line` describe a transition that has `event`, a text, among its events?
function shape.has_event(line, event)
  local events = line:match(" on (.*)$")
  if not events then return false end
  local function has(list)
    list = ", " .. list .. ","
    return list:find(", " .. event .. ",", 1, true)
      or list:find(", " .. event .. "{..},", 1, true)
  end
  return (has(events) or has((events:gsub(" pn %S+$", "")))) ~= nil
end

-- Returns a hash of lines. Its numbers are below 2^44, so that doubles multiply them by
-- 257 exactly.
local function fingerprint_of(lines)
  local hash = 7
  for _, line in ipairs(lines) do
    for i = 1, #line do hash = (hash * 257 + line:byte(i)) % 17592186044399 end
    hash = (hash * 257 + 10) % 17592186044399
  end
  return ("%05x%06x"):format(floor(hash / 16777216), hash % 16777216)
end

-- Keepers: the states with data that snapshots save ---------------------------------

local RESERVED = {
  entry = true, exit = true, doo = true, keep = true, save = true, load = true,
  getevents = true, dbg = true, info = true, warn = true, err = true, idle_hook = true,
  pre_step_hook = true, post_step_hook = true,
}

-- Returns the list of names in the field `keep` of a state; an empty list if `keep` is
-- a substate.
local function kept_names(state)
  local names = state.keep
  if names == nil or rfsm.is_node(names) then return {} end
  if type(names) ~= "table" then
    fail("%s: list of names expected, got %s", rfsm.location_of(state, "keep"),
      type(names))
  end
  local list = {}
  for i, name in ipairs(names) do
    if type(name) ~= "string" or rfsm.is_meta(name) or RESERVED[name]
      or rfsm.is_fsmobj(state[name]) then
      fail("%s: name of a field with data expected, got %s",
        rfsm.location_of(state, "keep[" .. i .. "]"),
        type(name) == "string" and "'" .. name .. "'" or type(name))
    end
    list[i] = name
  end
  if #rfsm.sorted_keys(names) > #list then
    fail("%s: list of names expected, got a table with keys",
      rfsm.location_of(state, "keep"))
  end
  return list
end

--- A state with data that snapshots save.
---@class rfsm.snapshot.Keeper
---@field fqn string
---@field names string[] names of the fields that are saved
---@field kept table<string, true> the names as a set
---@field sorted string[] the names in order, each once
---@field first table<string, any> the first values of the fields
---@field has_load boolean the state has functions `save` and `load`

local function keeper_of(state)
  local saves, loads = type(state.save) == "function", type(state.load) == "function"
  if saves ~= loads then
    fail("%s: 'save' and 'load' expected, got only one of them",
      rfsm.location_of(state))
  end
  local names, model = kept_names(state), rfsm.model_of(state)
  if not (saves or names[1]) then return nil end
  local kept, first = {}, {}
  for _, name in ipairs(names) do
    kept[name], first[name] = true, encoding.copy_of(model[name])
  end
  return { fqn = state._fqn, names = names, kept = kept, first = first,
    sorted = rfsm.sorted_keys(kept), has_load = saves }
end

-- Charts: what is known of a structure ----------------------------------------------

--- The description of a structure that several machines may share.
---@class rfsm.snapshot.Chart
---@field lines string[] a line for each state, connector and transition
---@field fields string[] a line for each kept field, `save` and region
---@field structure string fingerprint of `lines`
---@field name string `structure`, with the fingerprint of `fields` if there are any
---@field structure_before string|false `structure` as it was before names of events
--- with data, and deferred events, were in `lines`; false: it is the same
---@field name_before string|false `name` as it was then
---@field keepers rfsm.snapshot.Keeper[]
---@field keeper table<string, rfsm.snapshot.Keeper> the keepers by the FQN of the state
---@field defers table<string, any[]> the lists `defer` by the FQN of the state
---@field has_load boolean some state has functions `save` and `load`
---@field has_regions boolean
---@field leaves table<string, true> set of the FQNs of leaves
---@field nodes table[] { fqn, id, parent }; `parent` is an FQN; parents come first
---@field transitions table[] { id, parent, target }; `parent` and `target` are FQNs

-- The descriptions in use: by the table that `rfsm.structure_of` returns, and by name.
local charts = setmetatable({}, { __mode = "k" })
local by_name = setmetatable({}, { __mode = "v" })

-- The latest descriptions are kept even if no machine uses them.
local count, MAX_LATEST = 0, 64
shape.latest = {}

local function add_keeper(self, state)
  local keeper = keeper_of(state)
  if not keeper then return end
  self.keepers[#self.keepers + 1], self.keeper[keeper.fqn] = keeper, keeper
  self.has_load = self.has_load or keeper.has_load
  for _, name in ipairs(keeper.names) do
    self.fields[#self.fields + 1] = "field " .. name .. " of " .. keeper.fqn
  end
  if keeper.has_load then
    self.fields[#self.fields + 1] = "save and load of " .. keeper.fqn
  end
end

local function add_element(self, obj)
  local element = { fqn = obj._fqn, id = obj._id, parent = obj._parent._fqn }
  if rfsm.is_trans(obj) then
    element.target = rfsm.target_of(obj)
    if element.target == "internal" then element.target = obj.src._fqn end
    self.transitions[#self.transitions + 1] = element
    return
  end
  if not rfsm.is_root(obj) then self.nodes[#self.nodes + 1] = element end
  if rfsm.is_leaf(obj) then self.leaves[obj._fqn] = true end
  if rfsm.is_state(obj) then add_keeper(self, obj) end
end

-- Sets the fingerprints of a chart from its lines, and from those of before.
local function set_names(self, before)
  local fields = self.fields[1] and "-" .. fingerprint_of(self.fields):sub(-6) or ""
  self.structure = fingerprint_of(self.lines)
  self.name = self.structure .. fields
  if concat(before, "\n") == concat(self.lines, "\n") then return end
  self.structure_before = fingerprint_of(before)
  self.name_before = self.structure_before .. fields
end

local function describe(fsm, key)
  local places = rfsm.machines(fsm)
  local self = { lines = {}, fields = {}, structure = false, name = false,
    structure_before = false, name_before = false, keepers = {}, keeper = {},
    has_load = false, has_regions = places[2] ~= nil, leaves = {}, nodes = {},
    transitions = {}, defers = {} }
  local before = {}
  for i, obj in ipairs(rfsm.elements(fsm)) do
    before[i] = line_of(obj, event_text_before)
    self.lines[#self.lines + 1] = line_of(obj, event_text)
    if rfsm.is_state(obj) and deferred(obj)[1] ~= nil then
      self.defers[obj._fqn] = encoding.copy_of(deferred(obj))
      self.lines[#self.lines + 1] = obj._fqn .. " defers " .. texts_of(deferred(obj),
        event_text)
    end
    add_element(self, obj)
  end
  for _, at in ipairs(places) do
    if at.owner == fsm then self.fields[#self.fields + 1] = "region " .. at.prefix end
  end
  sort(self.fields, rfsm.text_before)
  set_names(self, before)
  charts[key], by_name[self.name] = self, self
  by_name[self.name_before or self.name] = self
  count = count % MAX_LATEST + 1
  shape.latest[count] = self
  return self
end

-- Does a state keep what the description says? Its model may have changed since then.
local function is_described(self, state)
  local keeper, model = self.keeper[state._fqn], rfsm.model_of(state)
  local defers = self.defers[state._fqn] or NONE
  if model.defer ~= nil and not match.are_equal(deferred(state), defers) then
    return false
  end
  if not keeper then
    local keeps = model.keep ~= nil and kept_names(state)[1] ~= nil
    return not keeps and type(state.save) ~= "function"
  end
  for _, name in ipairs(keeper.names) do
    if not match.are_equal(model[name], keeper.first[name]) then return false end
  end
  return match.are_equal(kept_names(state), keeper.names)
    and keeper.has_load == (type(state.save) == "function")
end

-- Is the description of a structure that of a machine, whose nodes are given by FQN?
local function is_of(self, nodes)
  for _, node in order.each(nodes) do -- any order: one difference decides
    if rfsm.is_state(node) and not is_described(self, node) then return false end
  end
  return true
end

--- Return the description with a name (the field `chart` of a snapshot), or nil.
function shape.named(name) return by_name[name] end

-- Machines --------------------------------------------------------------------------

--- The field `_kept` of a machine: data for its snapshots, valid until the structure of
--- the machine changes.
---@class rfsm.snapshot.Own
---@field key table the data are valid as long as `rfsm.structure_of` returns this table
---@field chart rfsm.snapshot.Chart
---@field places rfsm.Place[] the machine, and its regions at any depth
---@field states rfsm.State[] the state of each keeper
---@field nodes table<string, table> states and connectors of the machine by FQN
---@field transitions rfsm.Transition[]
---@field targets table[] the target that each transition has in the model
---@field noted? integer[] positions in `transitions` of those whose target was set;
--- nil: any target may have been set
---@field forget? fun(number: integer) gives such a transition its first target
---@field path rfsm.snapshot.Path a table that each call of `take` reuses

--- Return the `rfsm.snapshot.Own` of a machine; make a new one if the structure
-- changed.
function shape.of(fsm)
  local own = fsm._kept
  if own and own.key == fsm._structure then return own end
  local key = rfsm.structure_of(fsm)
  local known, nodes = charts[key] or describe(fsm, key), { [fsm._fqn] = fsm }
  own = { key = key, chart = known, places = { { machine = fsm, prefix = "root" } },
    states = {}, nodes = nodes, transitions = {}, targets = {},
    path = { owner = "", keeper = false, prefix = "root", seen = false } }
  if known.has_regions then own.places = rfsm.machines(fsm) end
  for _, at in ipairs(known.nodes) do nodes[at.fqn] = nodes[at.parent][at.id] end
  if not is_of(known, nodes) then
    known = describe(fsm, key)
    own.chart = known
  end
  for i, keeper in ipairs(known.keepers) do own.states[i] = nodes[keeper.fqn] end
  for i, at in ipairs(known.transitions) do
    own.transitions[i], own.targets[i] = nodes[at.parent][at.id], nodes[at.target]
  end
  fsm._kept = own
  return own
end

--- Append the lines of `chart` to a list, with the prefix of a region in front.
function shape.append(list, prefix, chart)
  local head = prefix == "root" and "" or prefix .. ": "
  for _, line in ipairs(chart.lines) do list[#list + 1] = head .. line end
  for _, line in ipairs(chart.fields) do list[#list + 1] = head .. line end
end

--- Return the structure of a machine and its regions as lines.
function shape.lines_of(fsm)
  local list = {}
  for _, at in ipairs(shape.of(fsm).places) do
    shape.append(list, at.prefix, shape.of(at.machine).chart)
  end
  return list
end

--- Return the structure of a model or machine as lines; an empty list if the model has
-- problems. If the argument is a list of lines already, it is returned.
function shape.structure(model)
  if not rfsm.is_state(model) then return model end
  local fsm = rfsm.is_initialized_root(model) and model or calls.init_apart(model)
  return fsm and shape.lines_of(fsm) or {}
end

--- Return the state that an FQN names; nil if there is none.
function shape.find_state(fsm, fqn)
  local node = shape.of(fsm).nodes[fqn]
  return rfsm.is_state(node) and node or nil
end

--- Read the entry at position `i` of a list of changed targets. Return the transition,
--- the target, and the id of the transition. If the machine does not have both, the
--- transition is nil.
function shape.target_at(fsm, list, i)
  local state, id = shape.find_state(fsm, list[i]), encoding.unpack(list[i + 1], 2)
  local tr = state and is_scalar(id) and rawget(state, id)
  local node = shape.of(fsm).nodes[list[i + 2]]
  return rfsm.is_trans(tr) and node and tr or nil, node, id
end

return shape
