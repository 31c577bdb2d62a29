--- JSON for clients of a server: read by the package dkjson, written exactly.
--
-- @module rfsm.server.codec
-- @license BSD-3-Clause

local exact_json = require "rfsm.shared.exact_json"
local opts = require "rfsm.shared.options"

local codec = { encode = exact_json.encode }

--- Return what a text of JSON stands for, in tables without metatables; else nil.
function codec.decode(text)
  return (opts.need("rfsm.server", "dkjson").decode(text, 1, nil, nil, nil))
end

return codec
