return require("rfsm")
