--- JSON for clients of a server: decoded by dkjson, encoded by `exact_json`.
--
-- @module rfsm.server.codec
-- @license BSD-3-Clause

local exact_json = require "rfsm.shared.exact_json"
local opts = require "rfsm.shared.options"

local codec = { encode = exact_json.encode }

--- Return the value of a JSON text, in tables without metatables; nil if it is no JSON.
function codec.decode(text)
  return (opts.need("rfsm.server", "dkjson").decode(text, 1, nil, nil, nil))
end

return codec
