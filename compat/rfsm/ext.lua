return require("rfsm_ext")
