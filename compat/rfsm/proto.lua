return require("rfsm_proto")
