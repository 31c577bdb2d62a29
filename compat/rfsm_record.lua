return require("rfsm.record")
