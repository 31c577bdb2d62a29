return require("rfsm.web")
