return require("rfsm.fleet")
