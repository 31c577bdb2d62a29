return require("rfsm_emem")
