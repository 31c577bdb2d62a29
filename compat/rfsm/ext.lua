return require("rfsm.monitor")
