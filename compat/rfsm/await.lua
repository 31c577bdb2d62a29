return require("rfsm_await")
