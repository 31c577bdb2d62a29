return require("rfsm.rtt")
