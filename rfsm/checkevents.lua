return require("rfsm_checks").watch_all()
