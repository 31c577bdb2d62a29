std = "min"                -- only what every Lua from 5.1 on has
max_line_length = 88
max_cyclomatic_complexity = 12
include_files = { "**/*.lua", "tools/rfsm", "*.rockspec" }
exclude_files = { "out", "dist" }
files["spec"] = { std = "+busted" }
-- busted gives describe, it ... to the files that it loads itself
files["spec/support"] = { std = "min" }
-- the globals of robots
files["spec/support/robots"] = { ignore = { "11" } }
files["rockspec"] = { std = "+rockspec" }
