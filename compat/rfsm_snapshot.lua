return require("rfsm.snapshot")
