return require("rfsm_preview")
