#!/bin/sh
# tools/test.sh LUA ...        the specs on each of these interpreters
# tools/test.sh --quick LUA    what a minute has room for
#
# Two spec files run at a time for each core, because some wait for what they started. A
# line is printed as an interpreter ends, after the output of its failures. The last line
# is the sum: "N passed, N failed, N pending". What is pending lacks a program or a
# package; each is listed before the sum. With PENDING=no they count as failures.
# On stderr, a line comes every 10 seconds: how many files are through, and the time that
# the rest will take. With LINT, that command runs beside the specs.
#
# With SERVERS=no, the files are left out that require the module that starts servers, or
# the stand-in for Orocos; with SERVERS=only, all others. A quick run has none of them, and
# a small share of what is the same on all interpreters. The line before its sum names what
# was not tried.
#
# Each spec file is a process of its own: collecting garbage stays cheap, and no file
# sees what another has loaded. It is stopped after LIMIT seconds (300) of the processor,
# whatever else the machine does meanwhile; if it waits, after ten times as long.
# FILES names other spec files than spec/*_spec.lua. RFSM_SHARE tells the specs which
# share of what is the same on all interpreters they have: see spec/support/share.lua.
set -u
cd "$(dirname "$0")/.." || exit 1
export FONTCONFIG_FILE="$PWD/tools/fonts.conf"

busted=${BUSTED:-busted} limit=${LIMIT:-300}
command -v timeout >/dev/null && timeout="timeout -k 5 ${limit}0" || timeout=

# Specs that require one of these take long.
SERVER_MODULES='spec\.support\.(servers|rtt)'
QUICK_SHARE=1/30

# These files need modules in C, which the Lua 5.5 in tools/ cannot load. Without its
# Python package it is skipped.
NEEDS_C='spec/(bench|documents|extensions|fleet|older|painter|project|proto|redis|web)_spec'

# This one is about LuaJIT's compiler.
NEEDS_JIT='spec/jit_spec'

# Prints a line "LUA FILE" for each spec file that an interpreter can run.
list_files() { # list_files LUA
  # shellcheck disable=SC2086
  files=$(ls ${FILES:-spec/*_spec.lua})
  # shellcheck disable=SC2086
  case $servers in
    no) files=$(grep -LE "$SERVER_MODULES" $files) ;;
    only) files=$(grep -lE "$SERVER_MODULES" $files) ;;
  esac
  if [ "$1" = tools/lua5.5 ]; then
    why=$("$1" -e '' 2>&1) || { echo "$1: skipped, $why" >&2; return 0; }
    files=$(echo "$files" | grep -vE "$NEEDS_C")
  fi
  case $1 in *luajit*) ;; *) files=$(echo "$files" | grep -v "$NEEDS_JIT") ;; esac
  [ -z "$files" ] || echo "$files" | sed "s|^|$1 |"
}

# Prints which files have not ended.
name_running() {
  for log in "$logs"/*/*_spec.lua; do
    [ ! -e "$log" ] || echo "did not end: ${log#"$logs"/}"
  done
}

# Adds up the closing lines of logs: "passed failed pending".
count() {
  cat /dev/null "$@" 2>/dev/null |
    sed -nE 's,^([0-9]+) success[a-z]* / ([0-9]+) fail.* / ([0-9]+) err.* / ([0-9]+) pend.*,\1 \2 \3 \4,p' |
    awk '{ passed += $1; failed += $2 + $3; pending += $4 }
      END { print passed + 0, failed + 0, pending + 0 }'
}

# Prints what is pending and why, once for all interpreters.
list_pending() { # list_pending LOG ...
  awk '/^Pending/ { getline; n = split(FILENAME, folders, "/")
    print "pending: " $0 " (" folders[n - 1] ")" }' "$@" | sort
}

# Prints what a quick run did not try.
name_rest() { # name_rest PENDING
  lack=
  [ "$1" = 0 ] || lack=", what lacks a package ($1)"
  # shellcheck disable=SC2086
  left=$(grep -lE "$SERVER_MODULES" ${FILES:-spec/*_spec.lua} | wc -l)
  echo "not tried: servers and Orocos ($left files), browsers, other Luas, most random" \
    "charts$lack: make test-all"
}

# Announces how many files are through, and the time that the rest will take, once a
# twentieth is: the first ones tell too little.
announce() { # announce LOGS
  logs=$1
  read -r all <"$logs/count"
  set -- "$logs"/*/*.done
  [ -e "$1" ] && done=$# || done=0
  time=$(($(date +%s) - $(cat "$logs/time"))) rest=
  [ $((done * 20)) -lt "$all" ] || rest=", about $((time * (all - done) / done)) s to go"
  echo "$done of $all files$rest" >&2
}

# Does that until the process ends. The pause ends with it, too: it has our stdout.
go_on_announcing() { # go_on_announcing LOGS PROCESS
  trap 'kill $pause 2>/dev/null; exit' TERM
  while kill -0 "$2" 2>/dev/null; do
    (announce "$1")
    sleep 10 &
    pause=$!
    wait "$pause"
  done
}

# Runs a file; the last one of an interpreter prints the line.
run_file() { # run_file LOGS LUA FILE
  logs=$1/${2##*/} log=$1/${2##*/}/${3##*/} options=
  [ "$2" = tools/lua5.5 ] && options="--filter-out=Graphviz --filter-out=at.a.terminal --filter-out=reads.XML"
  [ -d "$logs/began" ] || { mkdir "$logs/began" 2>/dev/null && date +%s >"$logs/time"; }
  read -r RFSM_SHARE <"$logs/share"
  export RFSM_SHARE
  (
    ulimit -t "$limit"
    exec $timeout $busted --lua="$(command -v "$2")" $options "$3"
  ) >"$log" 2>&1
  status=$? why=
  case $(grep -E '^[0-9]+ success' "$log") in
    "") why="used more than $limit s of the processor, did not end within ${limit}0 s, or crashed" ;;
    "0 successes / 0 failures / 0 errors / 0 pending"*) why="has no test" ;;
  esac
  if [ "$status" != 0 ] || [ -n "$why" ]; then
    [ -z "$why" ] || {
      echo "$2: $3 $why"
      echo "0 successes / 0 failures / 1 error / 0 pending"
    } >>"$log"
    echo "$2: $3 failed with RFSM_SHARE=$RFSM_SHARE" >>"$log"
    cat "$log"
  fi
  mv "$log" "$log.done"
  lua=$2
  read -r all <"$logs/count"
  set -- "$logs"/*.done
  [ $# = "$all" ] && mkdir "$logs/ended" 2>/dev/null || return 0
  time=$(($(date +%s) - $(cat "$logs/time")))
  # shellcheck disable=SC2046
  set -- $(count "$@")
  echo "$lua: $1 passed, $2 failed, $3 pending, $time s"
}

if [ "${1:-}" = --one ]; then
  run_file "$2" "$3" "$4"
  exit
fi

quick= servers=${SERVERS:-}
[ "${1:-}" = --quick ] && quick=yes servers=no && shift
logs=$(mktemp -d)
trap 'rm -rf "$logs"' EXIT
number=0
for lua in "$@"; do
  command -v "$lua" >/dev/null || { echo "$lua: not installed" >&2; exit 1; }
  own=$logs/${lua##*/} number=$((number + 1))
  mkdir "$own"
  if [ -n "$quick" ]; then echo "$QUICK_SHARE"; else echo "$number/$#"; fi >"$own/share"
  list_files "$lua" >"$own/files"
  grep -c . "$own/files" >"$own/count"
  cat "$own/files"
done >"$logs/files"
grep -c . "$logs/files" >"$logs/count"
date +%s >"$logs/time"
go_on_announcing "$logs" $$ &
announcer=$!
trap 'kill $announcer 2>/dev/null; rm -rf "$logs"' EXIT
trap 'name_running; exit 143' TERM
{ [ -z "${LINT:-}" ] || $LINT >"$logs/lint" 2>&1; echo $? >"$logs/lint-status"; } &
linter=$!
xargs -r -P "$(($(getconf _NPROCESSORS_ONLN || echo 2) * 2))" -n 2 "$0" --one "$logs" <"$logs/files"
wait "$linter"
read -r lint_status <"$logs/lint-status"
[ "$lint_status" = 0 ] || cat "$logs/lint"
[ -n "$quick" ] || list_pending "$logs"/*/*.done
# shellcheck disable=SC2046
set -- $(count "$logs"/*/*.done)
[ -z "$quick" ] || name_rest "$3"
echo "$1 passed, $2 failed, $3 pending"
[ "$lint_status" = 0 ] && [ "$2" = 0 ] && [ "$1" != 0 ] && { [ "$3" = 0 ] || [ "${PENDING:-}" != no ]; }
