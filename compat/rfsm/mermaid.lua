return require("rfsm2mermaid")
