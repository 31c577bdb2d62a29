return require("rfsm.checkevents")
