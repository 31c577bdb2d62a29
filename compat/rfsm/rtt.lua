return require("rfsm_rtt")
