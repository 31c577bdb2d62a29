-- A host: Neovim. A Lua file is checked a moment after it was saved, and `:Commit`
-- commits it if it is clean. The status line shows the state.
--
--   nvim -S examples/hosts/neovim.lua FILE.lua        from anywhere

local vim = vim -- luacheck: ignore 113
package.path = vim.fn.expand "<sfile>:p:h:h:h" .. "/?.lua;" .. package.path
local rfsm, rfsm_timeevent = require "rfsm", require "rfsm_timeevent"
local state, trans, api = rfsm.state, rfsm.trans, vim.api

rfsm_timeevent.set_gettime_hook(vim.loop.hrtime) -- nanoseconds, monotonic

local alarm, buffer, advance = vim.loop.new_timer(), api.nvim_get_current_buf(), nil

local function check(fsm)
  local text = table.concat(api.nvim_buf_get_lines(buffer, 0, -1, true), "\n")
  local line, message = (select(2, load(text, "=")) or ""):match(":(%d+): (.*)")
  vim.diagnostic.set(api.nvim_create_namespace "review", buffer,
    line and { { lnum = line - 1, col = 0, message = message } } or {})
  rfsm.send_events(fsm, line and "e_wrong" or "e_clean")
end

local function commit() -- the job ends in a later turn of the event loop
  vim.fn.jobstart({ "git", "commit", "-qm", "Reviewed", vim.fn.expand "%:t" }, {
    cwd = vim.fn.expand "%:p:h",
    on_exit = function(_, code) advance(code == 0 and "e_committed" or "e_failed") end,
  })
end

local fsm = assert(rfsm.init(state { info = false,
  editing = state {},
  saved = state {
    settling = state {}, checking = state { entry = check }, clean = state {},
    committing = state { entry = commit }, committed = state { final = true },
    trans { src = "initial", tgt = "settling" },
    trans { src = "settling", tgt = "checking", events = { "e_after(0.2)" } },
    trans { src = "checking", tgt = "clean", events = { "e_clean" } },
    trans { src = "clean", tgt = "committing", events = { "Commit" } },
    trans { src = "committing", tgt = "committed", events = { "e_committed" } },
    trans { src = "committing", tgt = "clean", events = { "e_failed" } },
  },
  trans { src = "initial", tgt = "editing" },
  trans { src = "editing", tgt = "saved", events = { "BufWritePost" } },
  trans { src = "saved", tgt = "editing",
    events = { "TextChanged", "TextChangedI", "e_wrong" } },
}))

function advance(event)
  rfsm.send_events(fsm, event)
  rfsm.run(fsm)
  vim.o.statusline = "%f %= " .. rfsm.get_actleaf_fqn(fsm)
  local seconds = rfsm_timeevent.next_deadline(fsm)
  if not seconds then return alarm:stop() end
  alarm:start(math.ceil(seconds * 1000), 0, vim.schedule_wrap(advance))
end

api.nvim_create_user_command("Commit", function() advance "Commit" end, {})
api.nvim_create_autocmd({ "BufWritePost", "TextChanged", "TextChangedI" }, {
  buffer = buffer, callback = function(autocommand) advance(autocommand.event) end })
advance()
