return require("rfsm_checks")
