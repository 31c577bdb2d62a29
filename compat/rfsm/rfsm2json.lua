return require("rfsm.json")
