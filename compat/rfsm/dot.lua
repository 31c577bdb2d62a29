return require("rfsm2dot")
