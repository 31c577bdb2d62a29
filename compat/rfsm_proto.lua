return require("rfsm.proto")
