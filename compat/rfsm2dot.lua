return require("rfsm.dot")
