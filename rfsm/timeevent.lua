return require("rfsm_timeevent")
