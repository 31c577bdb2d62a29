return require("rfsm.marsh")
