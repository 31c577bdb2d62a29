return require("rfsm.await")
