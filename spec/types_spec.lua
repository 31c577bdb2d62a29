-- The annotations, which the editor reads: each class exists, no parameter is missing,
-- and each field of a model is known.

local advice = require "rfsm.advice"
local helper = require "spec.helper"

local FILES = helper.files("rfsm*.lua", "rfsm/*.lua", "rfsm/*/*.lua")

-- Calls f(place, comment, code) for each block of comment lines, with the line of code
-- behind it. `comment` has a line for each line of the block.
local function each_block(f)
  for _, file in ipairs(FILES) do
    local block, number = {}, 0
    for line in (helper.content(file) .. "\n"):gmatch("(.-)\n") do
      number = number + 1
      if line:find("^%s*%-%-") then
        block[#block + 1] = line:match("^%s*(.*)$")
      else
        if block[1] then f(file .. ":" .. number, block, line) end
        block = {}
      end
    end
  end
end

local TYPED = { param = true, ["return"] = true, field = true, type = true,
  class = true, alias = true, overload = true }

-- Returns the text behind a tag without the names in it that are no types.
local function types_in(tag, rest)
  local text = rest:gsub("`[^`]*`", "")
  if tag == "class" or tag == "alias" then return text end
  -- behind the type there is a comment, in which a name is a function: rfsm.init
  return (text:gsub("rfsm[%w_.]*%.[%l_]+%f[^%w_.]", ""))
end

describe("annotations", function()
  local known, used = {}, {}
  each_block(function(place, comment)
    for _, line in ipairs(comment) do
      local tag, rest = line:match("^%-%-%-@(%l+)%s+(.*)$")
      if tag == "class" or tag == "alias" then known[rest:match("^[%w_.]+")] = true end
      local types = TYPED[tag] and types_in(tag, rest) or ""
      for name in types:gmatch("rfsm[%w_]*%.[%w_.]*%w") do
        used[#used + 1] = { name = name, place = place }
      end
    end
  end)

  it("name classes that exist", function()
    local unknown = {}
    for _, use in ipairs(used) do
      if not known[use.name] then
        unknown[#unknown + 1] = use.place .. ": " .. use.name
      end
    end
    assert.is_true(#used > 500)
    assert.same({}, unknown)
  end)

  it("name all parameters of a function, in their order, or none", function()
    local wrong, count = {}, 0
    each_block(function(place, comment, code)
      local wanted, found = {}, {}
      local arguments = code:match("^%s*function [%w_.:]+(%b())")
        or code:match("^%s*local function [%w_]+(%b())")
        or code:match("^%s*return function(%b())") or "()"
      for name in arguments:sub(2, -2):gmatch("[%w_.]+") do
        if name ~= "_" then wanted[#wanted + 1] = name end
      end
      for _, line in ipairs(comment) do
        found[#found + 1] = line:match("^%-%-%-@param ([%w_.]+)")
      end
      wanted, found = table.concat(wanted, ", "), table.concat(found, ", ")
      count = count + (found ~= "" and 1 or 0)
      if found ~= "" and arguments ~= "()" and found ~= wanted then
        wrong[#wrong + 1] = ("%s: (%s) in place of (%s)"):format(place, found, wanted)
      end
    end)
    assert.is_true(count > 300)
    assert.same({}, wrong)
  end)
end)

-- Returns the fields of a class, as annotations have them, with those of its parents.
local function fields_of(class)
  local fields = {}
  each_block(function(_, comment)
    local is_in, parent = false, nil
    for _, line in ipairs(comment) do
      local name, above = line:match("^%-%-%-@class ([%w_.]+)%s*:?%s*([%w_.]*)")
      if name then is_in, parent = name == class, above ~= "" and above or nil end
      local field = is_in and line:match("^%-%-%-@field ([%w_]+)")
      if field then fields[field] = true end
      if name and is_in and parent then
        for other in pairs(fields_of(parent)) do fields[other] = true end -- any order
      end
    end
  end)
  return fields
end

describe("the types of a model", function()
  local FIELDS = {
    ["rfsm.State"] = [[entry exit doo final history defer timed prepare keep save load
      checks getevents dbg info warn err idle_hook pre_step_hook post_step_hook read
      gettime strict properties]],
    ["rfsm.Edge"] = "src tgt events guard effect pn always likely checks",
    ["rfsm_seqand.Fields"] = "order step run idle_doo seqanddbg entry exit",
    ["rfsm.Machine"] = "entry final emit _act_leaf _intq _curq",
  }
  for class, text in pairs(FIELDS) do -- any order: each is a test
    it("have the fields of " .. class, function()
      local fields = fields_of(class)
      for field in text:gmatch("%S+") do assert.is_true(fields[field], field) end
    end)
  end

  it("have the fields that extensions read", function()
    for kind, class in pairs { state = "rfsm.State", transition = "rfsm.Edge" } do
      local fields = fields_of(class)
      for field in pairs(advice.extension_fields[kind]) do -- any order: each alone
        assert.is_true(fields[field], field)
      end
    end
  end)

  it("have each function of the library, or hide it", function()
    local fields, hidden = fields_of "rfsm", {}
    each_block(function(_, comment, code)
      local name = code:match("^%s*function rfsm%.([%w_]+)%(")
        or code:match("^%s*rfsm%.([%w_]+) = ")
      if name then
        fields[name] = true
        for _, line in ipairs(comment) do
          hidden[name] = hidden[name] or line:find("^%-%-%-@package") ~= nil
        end
      end
    end)
    local page, rfsm = helper.content("doc/functions.md"), require "rfsm"
    for name, value in pairs(rfsm) do -- any order: each stands alone
      local is_hook = name:find("_hook_rm$")
      if type(value) == "function" and not is_hook then
        assert.is_true(fields[name], name)
        local is_listed = page:find("`rfsm." .. name .. "(", 1, true) ~= nil
        assert.is_false(is_listed and hidden[name] or false, name)
      end
    end
    assert.is_true(hidden.follow_fates and hidden.begin_in)
  end)

  it("are in the file of make dist, too", function()
    local text = helper.text_of(("'%s' tools/dist.lua rfsm"):format(arg[-1]))
    for _, class in ipairs { "State", "Edge", "Machine", "Guard" } do
      assert.matches("\n%-%-%-@%l+ rfsm%." .. class .. "[ \n]", text)
    end
  end)
end)
