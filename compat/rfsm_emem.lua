return require("rfsm.emem")
