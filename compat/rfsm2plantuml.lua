return require("rfsm.plantuml")
