return require("rfsm_checkevents")
