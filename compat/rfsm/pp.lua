return require("rfsmpp")
