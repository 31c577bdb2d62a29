#!/bin/sh
# Runs the specs on each interpreter named, two interpreters at a time. A line is printed
# as each ends, after the output of its failures. The last line is the sum:
# "N passed, N failed".
#
# Each spec file is a process of its own: collecting garbage stays cheap, and no file
# sees what another has loaded. It is stopped after LIMIT seconds (300).
set -u
cd "$(dirname "$0")/.." || exit 1

busted=${BUSTED:-busted} limit=${LIMIT:-300}
command -v timeout >/dev/null && timeout="timeout -k 5 $limit" || timeout=

# These files need modules in C, which the Lua 5.5 in tools/ cannot load. It is skipped if
# its Python package is missing.
NEEDS_C='spec/(bench|extensions|project|proto|web)_spec'

# Adds up the closing lines of a log: "passed failed".
count() {
  sed -nE 's/^([0-9]+) success[a-z]* \/ ([0-9]+) failures? \/ ([0-9]+) errors? .*/\1 \2 \3/p' \
    "$1" | awk '{ passed += $1; failed += $2 + $3 } END { print passed + 0, failed + 0 }'
}

run_one() { # run_one LUA LOG
  lua=$(command -v "$1") || { echo "$1: not installed"; return 1; }
  files=$(ls spec/*_spec.lua) options=
  if [ "$1" = tools/lua5.5 ]; then
    why=$("$1" -e '' 2>&1) || { echo "$1: skipped, $why"; return 0; }
    files=$(echo "$files" | grep -vE "$NEEDS_C")
    options="--filter-out=Graphviz --filter-out=misses"
  fi
  began=$(date +%s)
  : >"$2"
  for file in $files; do
    if ! $timeout $busted --lua="$lua" $options "$file" >"$2.one" 2>&1; then
      grep -qE '^[0-9]+ success' "$2.one" || {
        echo "$1: $file did not end within $limit s, or crashed"
        echo "0 successes / 0 failures / 1 error / 0 pending"
      } >>"$2.one"
      cat "$2.one"
    fi
    cat "$2.one" >>"$2"
  done
  # shellcheck disable=SC2046
  set -- "$1" $(count "$2")
  echo "$1: $2 passed, $3 failed, $(($(date +%s) - began)) s"
}

if [ "${1:-}" = --one ]; then
  run_one "$2" "$3/$(basename "$2")"
  exit
fi

logs=$(mktemp -d)
trap 'rm -rf "$logs" "$logs.all"' EXIT
printf '%s\n' "$@" | xargs -P 2 -I '{}' "$0" --one '{}' "$logs" || {
  echo "an interpreter could not be run"
  exit 1
}
rm -f "$logs"/*.one
cat /dev/null "$logs"/* >"$logs.all" 2>/dev/null
# shellcheck disable=SC2046
set -- $(count "$logs.all")
echo "$1 passed, $2 failed"
[ "$2" = 0 ] && [ "$1" != 0 ]
