--- `rfsm json`, `plantuml`, `dot` and `mermaid`: write each chart to a file.
--
-- @module rfsm.cli.encoders
-- @license BSD-3-Clause

local common = require "rfsm.cli.common"

local concat = table.concat

local function new_encoder(name, language, ending)
  local encoder = {
    summary = "Write charts as " .. language .. ".",
    epilog = "The result for a.lua is a." .. ending .. ".",
  }

  function encoder.add_arguments(command)
    common.add_files(command)
    common.add_stub(command)
    common.add_machine(command)
    command:option("-o --output", "one file for all results; - is stdout")
      :argname("FILE")
  end

  function encoder.run(options)
    local texts = common.encode_all(options, require("rfsm." .. name).encode)
    if options.output then return common.write(options.output, concat(texts)) end
    for i, file in ipairs(options.files) do
      local output = file == "-" and "-" or file:gsub("%.lua$", "") .. "." .. ending
      common.write(output, texts[i])
    end
  end

  return encoder
end

return {
  json = new_encoder("json", "JSON", "json"),
  plantuml = new_encoder("plantuml", "PlantUML diagrams", "puml"),
  dot = new_encoder("dot", "Graphviz graphs", "dot"),
  mermaid = new_encoder("mermaid", "Mermaid diagrams", "mmd"),
}
