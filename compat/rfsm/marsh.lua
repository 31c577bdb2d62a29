return require("rfsm_marsh")
