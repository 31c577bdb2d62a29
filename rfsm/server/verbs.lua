--- The verbs of a fleet in both servers: FCALL rfsm_NAME in Redis, rfsm.NAME in
--- PostgreSQL, `rfsm fleet URL NAME`.
--
-- @module rfsm.server.verbs
-- @license BSD-3-Clause

local ipairs = ipairs

--- A verb.
---@class rfsm.server.Verb
---@field name string
---@field reads? true it changes nothing
---@field many? true it is about many machines, and PostgreSQL has a statement for it
---@field sql? string[] PostgreSQL: parameters after `key`, type of the result, and the
--- arguments `args` and `id` for `rfsm.call` (NULL, NULL if absent); how the result is
--- made, if its type does not tell it
---@field more_sql? string[] the same for other parameters
---@field usage? string its arguments in the command; those in brackets may be absent
---@field bulk? true the command takes filters in place of KEY, for many machines
---@field by? true in PostgreSQL only an operator may call it; if it writes, its
--- arguments may end with `BY who`

-- What PostgreSQL has for a verb that writes and tells what was done: who does it is
-- the last parameter.
local function written(parameters, arguments)
  return { parameters .. ", who text DEFAULT session_user", "text",
    arguments .. " || ARRAY['BY', who], NULL", "what" }
end

local verbs = {
  { name = "create", sql = { ", chart text, data jsonb DEFAULT '{}', id text DEFAULT "
    .. "NULL", "text", "ARRAY[chart, coalesce(data, '{}')::text], id" },
    usage = "KEY CHART [FIELD=VALUE...]" },
  { name = "send", sql = { ", event text, id text DEFAULT NULL", "text",
    "ARRAY[event], id" }, more_sql = { ", events text[], id text DEFAULT NULL", "text",
    "events, id" }, usage = "KEY EVENT [ID]" },
  { name = "send_at", sql = { ", at timestamptz, event text, id text", "text",
    "ARRAY[extract(epoch FROM at)::text, event], id" } },
  { name = "cancel", sql = { ", id text", "boolean", "ARRAY[id], NULL" },
    usage = "KEY ID" },
  { name = "why", reads = true, sql = { ", event text", "SETOF text",
    "ARRAY[event], NULL" }, usage = "KEY EVENT" },
  { name = "get", reads = true, sql = { "", "TABLE (name text, value text)" },
    usage = "KEY", by = true },
  { name = "tick", sql = { "", "text" }, usage = "KEY", bulk = true },
  { name = "move", sql = written("", "'{}'"), usage = "KEY", by = true, bulk = true },
  { name = "hold", sql = written(", reason text DEFAULT ''",
    "ARRAY[coalesce(reason, '')]"), usage = "KEY [WHY]", by = true, bulk = true },
  { name = "release", sql = written("", "'{}'"), usage = "KEY", by = true,
    bulk = true },
  { name = "force", sql = written(", state text", "ARRAY[state]"),
    usage = "KEY STATE", by = true, bulk = true },
  { name = "remove", sql = { ", who text DEFAULT session_user", "boolean",
    "ARRAY['BY', who], NULL" }, usage = "KEY", by = true, bulk = true },
  { name = "pull", reads = true, sql = { "", "text" }, usage = "KEY [FILE]",
    by = true },
  { name = "push", sql = written(", file text, if_version bigint DEFAULT NULL",
    "ARRAY[file, coalesce(if_version::text, '')]"), usage = "KEY FILE", by = true },
  { name = "set", sql = { ", field text, value jsonb, who text DEFAULT session_user, "
    .. "force boolean DEFAULT false", "text", "ARRAY[field, coalesce(value::text, ''), "
    .. "CASE WHEN force THEN 'force' ELSE '' END, 'BY', who], NULL", "what" },
    usage = "KEY FIELD=VALUE", by = true },
  { name = "log", reads = true, many = true, usage = "KEY [N]" },
  { name = "history", reads = true, many = true, usage = "KEY [N]" },
  { name = "wake", many = true },
  { name = "reindex", many = true, usage = "" },
  { name = "due", reads = true, many = true, usage = "[LIMIT [TIME]]" },
  { name = "find", reads = true, many = true,
    usage = "CHART STATE [LIMIT [SECONDS]]" },
  { name = "charts", reads = true, many = true, usage = "" },
  { name = "versions", reads = true, many = true, usage = "" },
  { name = "select", reads = true, many = true },
  { name = "stats", reads = true, many = true },
}

--- Call f(verb) for each verb; return the list of what it returns, without nil.
function verbs.map(f)
  local list = {}
  for _, verb in ipairs(verbs) do list[#list + 1] = f(verb) end
  return list
end

return verbs
