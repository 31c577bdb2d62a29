return require("rfsm.preview")
