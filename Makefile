# make sim [lamp.lua]     open a chart in the simulator
# make test               lint and the specs on the newest Lua, in a minute
# make help               list the targets
#
# sim, fleet, fleet-postgres, test, test-all, test-web, test-site, test-hosts, doc, site, rocks and deb
# install missing Debian packages if you are root or have password-free sudo. Otherwise they print the
# command to type. site and test-site need npm.

MODEL    ?= examples/hello_world.lua
LUAS     ?= lua5.1 luajit lua5.2 lua5.3 lua5.4 tools/lua5.5
# found when a recipe runs it: an earlier line may have installed one
ifeq ($(LUA),)
LUA      := $$(tools/deps.sh lua $(LUAS))
unexport LUA
endif
BUSTED   ?= busted
N        ?= 100000
SEED     ?= 1
PREFIX   ?= /usr/local
LUADIRS  ?= $(foreach v,5.1 5.2 5.3 5.4 5.5,$(PREFIX)/share/lua/$(v))
STRIP    ?=
STRIPPED := rfsm/stripped
# the core with hints, time events, sequential AND states, the printed machine, strict, why
BUNDLE   ?= rfsm rfsm.fast rfsm.advice rfsm.tools rfsm.prepare rfsm.merge rfsm.always rfsm.fates rfsm_timeevent \
            rfsm.clock rfsm_seqand rfsmpp rfsm.strict rfsm_checks rfsm.observe.why \
            $(addprefix rfsm.shared.,alphabet calls location match order)
# and checks, exploration, written tests, history
ALL      ?= rfsm.history rfsm.checkevents rfsm.observe.coverage \
            rfsm.observe.watch_properties $(filter-out $(BUNDLE), \
            $(subst /,.,$(basename $(wildcard $(ROOMS:%=rfsm/%/*.lua)))))
ROOMS    := shared clock checks explore tests
DIST     ?= dist
ifneq ($(word 2,x$(DESTDIR)$(PREFIX)),)
$(error PREFIX and DESTDIR: no blanks expected, got '$(DESTDIR)$(PREFIX)')
endif
# the address of the repository, for rockspecs of releases: not yet known
URL      ?= git+https://example.org/rfsm.git
OUTER    := $(wildcard *.lua compat/*.lua)
INNER    := $(wildcard rfsm/*.lua)
DEEPER   := $(wildcard rfsm/*/*.lua)
PAGE     := rfsm/web/page.html
NAMES    := $(notdir $(OUTER)) $(addprefix rfsm/,$(notdir $(INNER))) $(DEEPER)
TOOLS    := $(wildcard tools/rfsm*)
EXAMPLES := $(wildcard examples/*.lua)
# in a variable, because make runs a line of a recipe with MAKE in it also with -n
LINT     := $(MAKE) --no-print-directory lint
FILES    := $(OUTER) $(INNER) $(DEEPER) $(EXAMPLES) $(wildcard spec/*.lua spec/*/*.lua bench/*.lua)

TARGETS  := all help help-all sim fleet fleet-postgres test check test-all test-web test-site test-hosts \
            lint fuzz torture mutants figures bench soak day examples doc site gallery functions \
            deps transcript house rockspec rocks dist deb size install uninstall clean
.DEFAULT_GOAL := all

# A word beside sim or size that is no target is the chart, as MODEL is.
CHARTS   := $(if $(filter sim size,$(MAKECMDGOALS)),$(filter-out $(TARGETS),$(MAKECMDGOALS)))
ifneq ($(CHARTS),)
override MODEL := $(CHARTS)
endif
# An example may be named without its folder.
CHART     = $(shell test -e '$(MODEL)' || test ! -e 'examples/$(MODEL)' || echo examples/)$(MODEL)

.PHONY: $(TARGETS) $(CHARTS)
$(CHARTS): ; @:

all: test               ## the same as test

help:                   ## this list
	@grep -hE '^[a-z][a-z%-]*:.* ## ' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## */\t/' | expand -t 16

help-all:               ## this list, and the targets for those who change the library
	@grep -hE '^[a-z][a-z%-]*:.* ###? ' $(MAKEFILE_LIST) | sed -E 's/:[^#]*###? */\t/' | expand -t 16

sim:                    ## open a chart in the simulator: make sim lamp.lua
	@tools/deps.sh sim
	@$(if $(filter file,$(origin LUA)),,LUA=$(LUA)) tools/rfsm sim "$(CHART)"

fleet:                  ## a warehouse whose orders are machines in a Redis server of its own
	@tools/deps.sh fleet
	@examples/warehouse/fleet.sh lua5.3

fleet-postgres:         ## the same warehouse in a PostgreSQL server of its own
	@tools/deps.sh postgres
	@examples/warehouse/postgres.sh lua5.3

test:                   ## lint, and the specs on the newest Lua, in a minute
	@tools/deps.sh test $(LUAS)
	@BUSTED="$(BUSTED)" LINT="$(LINT)" tools/test.sh --quick $(LUA)

check: test             ## the same as test

test-all:               ## lint, then every spec on each of LUAS
	@tools/deps.sh test-all $(LUAS)
	@SERVERS="$(SERVERS)" BUSTED="$(BUSTED)" LINT="$(LINT)" tools/test.sh $(LUAS)

test-web:               ## the page in headless Chromium, with LUA
	@tools/deps.sh web
	@AXE=$${AXE:-$$(tools/deps.sh axe)} $(BUSTED) --lua=$$(command -v $(LUA)) \
	  --pattern=page spec/browser

test-hosts:             ### the hosts in Neovim, LÖVE, on MQTT and luv, with LUA
	@tools/deps.sh hosts
	@$(BUSTED) --lua=$$(command -v $(LUA)) --pattern=hosts spec/hosts

test-site: site         ### the site in headless Chromium, with LUA
	@tools/deps.sh web
	@AXE=$${AXE:-$$(tools/deps.sh axe)} $(BUSTED) --lua=$$(command -v $(LUA)) \
	  --pattern=site spec/browser

lint:                   ### luacheck, and the syntax under the oldest Lua
	luacheck -q .
	@luac5.1 -p $(FILES) tools/rfsm

fuzz:                   ### compare core and oracle on N random charts from SEED, with LUA
	$(LUA) spec/support/fuzz.lua $(N) $(SEED)

torture: N = 1000
torture:                ### the claims (or CLAIM) on N random charts each, from SEED, with LUA
	@$(LUA) spec/support/torture.lua $(N) $(SEED) $(CLAIM)

mutants: N = 100
mutants: LUA = $(shell command -v luajit || command -v lua5.4)
mutants:                ### change ROOM's files N times from SEED: do its specs notice?
	@$(LUA) tools/mutants.lua "$(ROOM)" $(N) $(SEED)

figures:                ### renew the figures in CONTRIBUTING.md, or those with WORD, with LUA
	@$(LUA) tools/figures.lua "$(WORD)"

bench:                  ### run the measurements in bench/, with LUA
	$(LUA) bench/run.lua
	$(LUA) bench/latency.lua
	$(LUA) bench/growth.lua
	$(LUA) bench/scale.lua
	$(LUA) bench/extensions.lua

soak: MINUTES = 60
soak:                   ### a machine that two pages watch for MINUTES of its time, with LUA
	$(LUA) bench/soak.lua $(MINUTES)

day: ORDERS = 200
day: EVENTS = 12
day:                    ### a day of ORDERS with EVENTS each in both servers: nothing is lost
	$(LUA) bench/day.lua $(ORDERS) $(EVENTS)

examples:               ### load and initialise every example, with LUA
	@$(LUA) tools/try-examples.lua $(EXAMPLES)

$(LUAS:%=examples-with-%): examples-with-%:
	@why=$$($* -e '' 2>&1) || { echo "$*: skipped, $$why"; exit 0; }; \
	$(MAKE) --no-print-directory examples LUA=$*

examples-all: $(LUAS:%=examples-with-%)  ### the same on each of LUAS

transcript:             ### run the sessions in doc/sim.md again, with LUA
	@$(LUA) tools/transcript.lua doc/sim.md > doc/sim.md.new && mv doc/sim.md.new doc/sim.md

doc:                    ## out/: HTML pages of documents and API; warnings are errors
	@tools/deps.sh doc
	ldoc -c doc/config.ld --fatalwarnings -q .
	@mkdir -p out/gallery && cp -R doc/web out && cp LICENSE out/LICENSE.txt
	@cd out && rm topics/README.md.html && ls */*.html > pages
	@$(LUA) tools/site/pages.lua out $(sort $(wildcard doc/gallery/*.svg))

# From npm's packages, in a cache; files of a site that is there are replaced.
site:                   ## out/: those pages and the playground, for file: or any server
	@tools/deps.sh site
	@tools/site/build.sh out/playground.html $(LUA)
	@$(MAKE) --no-print-directory doc
	@du -sk out | sed 's/\([0-9]*\).*/out: \1 KiB/'

gallery:                ### doc/gallery/: pictures of the examples and of larger charts
	@set -e; export FONTCONFIG_FILE='$(CURDIR)/tools/fonts.conf'; \
	for f in $(EXAMPLES) doc/gallery/*.lua; do \
	  $(LUA) tools/rfsm viz $$f -o doc/gallery/$$(basename $$f .lua).svg; \
	done; \
	$(LUA) tools/walk.lua examples/lamp.lua e_switch e_more e_less e_switch > doc/gallery/walk.svg; \
	for n in loops recipe; do \
	  $(LUA) tools/rfsm viz --direction LR doc/gallery/$$n.lua -o doc/gallery/$${n}_lr.svg; \
	done

functions:              ### doc/functions.md: a line for each public function, with LUA
	$(LUA) tools/functions.lua > doc/functions.md.new && mv doc/functions.md.new doc/functions.md

deps:                   ## install the packages for sim, test and doc
	@tools/deps.sh sim
	@tools/deps.sh test-all $(LUAS)
	@tools/deps.sh doc

house:                  ### print the floors of the library, its rooms, and who requires whom
	@$(LUA) tools/house.lua

rockspec:               ### the lists of the dev rockspec; with VERSION, the rockspec of a release
	$(LUA) tools/rockspec.lua $(if $(VERSION),$(VERSION) $(URL) > rockspec/rfsm-$(VERSION)-1.rockspec)

dist:                   ## dist/rfsm.lua: one file to copy; rfsm-all.lua: with exploration; their hashes
	@mkdir -p $(DIST)
	@$(LUA) tools/dist.lua $(BUNDLE) > $(DIST)/rfsm.lua
	@$(LUA) tools/dist.lua $(BUNDLE) $(ALL) > $(DIST)/rfsm-all.lua
	@cd $(DIST) && sha256sum rfsm.lua rfsm-all.lua > SHA256SUMS
	@ls $(DIST)/rfsm.lua $(DIST)/rfsm-all.lua

deb:                    ## Debian packages of the last commit in DIST/deb, and what lintian says
	@tools/deps.sh deb
	@tools/packaging/deb.sh $(DIST)/deb

rocks:                  ### a rock of the last commit in DIST/rocks, for each Lua; luarocks test
	@tools/deps.sh rocks
	@tools/packaging/rocks.sh $(DIST)/rocks

size:                   ## the memory that a chart takes on a robot: make size lamp.lua
	@tools/rfsm size "$(CHART)"

install:                ## copy modules and tools below PREFIX; STRIP=1: as bytecode, STRIP=0: no bytecode
	@set -e; for d in $(LUADIRS:%=$(DESTDIR)%); do \
	  install -d $(addprefix $$d/,$(sort $(dir $(DEEPER)))); \
	  install -m 644 $(OUTER) $$d; \
	  install -m 644 $(INNER) $$d/rfsm; \
	  $(foreach d,$(sort $(dir $(DEEPER))),install -m 644 $(filter $d%,$(DEEPER) $(PAGE)) $$d/$d;) \
	  rm -rf $$d/$(STRIPPED); \
	  $(if $(filter 0,$(STRIP)),,$(if $(STRIP),$(STRIP_FILES),$(STRIP_COPIES));) \
	done
	install -d $(DESTDIR)$(PREFIX)/bin
	install -m 755 $(TOOLS) $(DESTDIR)$(PREFIX)/bin

# LuaJIT cannot read the bytecode of Lua 5.1, and looks into the same folder.
STRIP_FILES = luac=luac$${d\#\#*/}; \
	  if command -v $$luac >/dev/null; then \
	    for f in $(NAMES); do $$luac -s -o $$d/$$f $$d/$$f; done; \
	  else \
	    echo "$$d: source, there is no $$luac"; \
	  fi

# For robots: Lua 5.1 is that of Orocos. Components with a pool take these.
STRIP_COPIES = case $$d in *5.1) if command -v luac5.1 >/dev/null; then \
	    for f in $(NAMES); do \
	      install -d $$d/$(STRIPPED)/$$(dirname $$f); \
	      luac5.1 -s -o $$d/$(STRIPPED)/$$f $$d/$$f; \
	    done; \
	  fi;; esac

uninstall:              ## remove the files that install copied, and empty directories
	@for d in $(LUADIRS:%=$(DESTDIR)%); do \
	  (cd $$d 2>/dev/null && rm -rf $(NAMES) $(PAGE) $(STRIPPED)) || true; done
	@rm -f $(addprefix $(DESTDIR)$(PREFIX)/bin/,$(notdir $(TOOLS)))
	@rmdir $(foreach d,$(LUADIRS:%=$(DESTDIR)%),$(addprefix $(d)/,$(sort $(dir $(DEEPER))) rfsm)) 2>/dev/null || true
	@for d in $(LUADIRS) $(PREFIX)/share/lua $(OWN_DIRS); do \
	  rmdir $(DESTDIR)$$d 2>/dev/null || true; done

# In /usr and /usr/local these directories are the system's, also empty.
OWN_DIRS = $(if $(filter /usr /usr/local,$(DESTDIR)$(PREFIX)),,$(addprefix $(PREFIX)/,share bin) $(PREFIX))

clean:                  ## remove what the targets made
	rm -rf out dist
