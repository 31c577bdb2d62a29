return require("rfsm2plantuml")
