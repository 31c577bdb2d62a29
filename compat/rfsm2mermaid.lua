return require("rfsm.mermaid")
