return require("rfsm.watch")
