return require("rfsm2json")
