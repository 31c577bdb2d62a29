# make sim [MODEL=file]   open a chart in the simulator
# make test               lint, then every spec on every interpreter
# make help               list the targets
#
# sim, test and doc install what they miss from Debian's packages when they may (root or
# sudo), and otherwise say the one line to type.

MODEL    ?= examples/hello_world.lua
LUAS     ?= lua5.1 luajit lua5.2 lua5.3 lua5.4
LUA      ?= $(firstword $(foreach l,lua5.4 lua lua5.3 luajit lua5.2 lua5.1,$(if $(shell command -v $(l) 2>/dev/null),$(l))) lua5.4)
BUSTED   ?= busted
N        ?= 100000
SEED     ?= 1
PREFIX   ?= /usr/local
LUADIRS  ?= $(foreach v,5.1 5.2 5.3 5.4 5.5,$(PREFIX)/share/lua/$(v))
MODULES  := $(wildcard rfsm*.lua)
DOTTED   := $(wildcard rfsm/*.lua)
TOOLS    := $(filter-out %.sh %.lua,$(wildcard tools/*))
EXAMPLES := $(wildcard examples/*.lua)
FILES    := $(MODULES) $(DOTTED) $(EXAMPLES) $(wildcard spec/*.lua spec/support/*.lua bench/*.lua)

.PHONY: all help sim test lint fuzz bench bench-profile examples doc deps install uninstall clean
.DEFAULT_GOAL := all

all: test               ## the same as test

help:                   ## this list
	@grep -hE '^[a-z][a-z%-]*:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## */\t/' | expand -t 16

sim:                    ## open MODEL in the simulator
	@tools/deps.sh sim
	@lua=$$(tools/deps.sh lua) && exec $$lua tools/rfsm-sim $(MODEL)

test:                   ## lint, then every spec on each of LUAS
	@tools/deps.sh test
	@$(MAKE) --no-print-directory lint
	@BUSTED="$(BUSTED)" tools/test.sh $(LUAS)

test-with-%:            ## test-with-luajit, ...: the specs on one interpreter
	@$(BUSTED) --lua=$$(command -v $*)

lint:                   ## luacheck, and the syntax under the oldest Lua
	luacheck -q .
	@luac5.1 -p $(FILES) $(TOOLS)

fuzz:                   ## compare core and oracle on N random charts from SEED, with LUA
	$(LUA) spec/support/fuzz.lua $(N) $(SEED)

bench:                  ## measure all there is in bench/, with LUA
	$(LUA) bench/run.lua
	$(LUA) bench/latency.lua
	$(LUA) bench/growth.lua
	$(LUA) bench/scale.lua
	$(LUA) bench/extensions.lua

bench-profile:          ## where the time goes: the hottest functions and lines, with LUA
	$(LUA) bench/profile.lua

examples:               ## load and initialise every example, with LUA
	@$(LUA) tools/try-examples.lua $(EXAMPLES)

doc:                    ## HTML pages of the API in out/; warnings are errors
	@tools/deps.sh doc
	ldoc --fatalwarnings -q .

deps:                   ## install what sim, test and doc need
	@tools/deps.sh sim
	@tools/deps.sh test
	@tools/deps.sh doc

install:                ## copy modules and tools below PREFIX, for each Lua
	@set -e; for d in $(LUADIRS); do \
	  install -d $(DESTDIR)$$d/rfsm; \
	  install -m 644 $(MODULES) $(DESTDIR)$$d; \
	  for f in $(DOTTED); do install -m 644 $$f $(DESTDIR)$$d/rfsm; done; \
	done
	install -d $(DESTDIR)$(PREFIX)/bin
	install -m 755 $(TOOLS) $(DESTDIR)$(PREFIX)/bin

uninstall:              ## remove what install copied
	@set -e; for d in $(LUADIRS); do \
	  for f in $(MODULES) $(DOTTED); do rm -f $(DESTDIR)$$d/$$f; done; \
	done
	rm -f $(addprefix $(DESTDIR)$(PREFIX)/bin/,$(notdir $(TOOLS)))

clean:                  ## remove what the targets made
	rm -rf out luacov.*.out
