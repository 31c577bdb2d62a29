return require("rfsm_seqand")
