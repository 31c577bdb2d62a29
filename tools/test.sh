#!/bin/sh
# Runs the specs on each interpreter named, two at a time, and prints each run whole, in
# the order given. The last line counts: "N passed, N failed".
set -u

busted=${BUSTED:-busted}
logs=$(mktemp -d)
trap 'rm -rf "$logs"' EXIT

run() { # run LUA: specs to a file of their own
  $busted --lua="$(command -v "$1")" >"$logs/$1" 2>&1
  echo $? >"$logs/$1.status"
}

for lua in "$@"; do
  command -v "$lua" >/dev/null 2>&1 || { echo "$lua: not installed" >&2; exit 1; }
done

running=0
for lua in "$@"; do
  run "$lua" &
  running=$((running + 1))
  [ $((running % 2)) = 0 ] && wait
done
wait

passed=0 failed=0
for lua in "$@"; do
  closing=$(grep -E '[0-9]+ success(es)? / ' "$logs/$lua" | tail -n 1)
  status=$(cat "$logs/$lua.status")
  if [ "$status" != 0 ] || [ -z "$closing" ]; then cat "$logs/$lua"; fi
  echo "$lua: ${closing:-no closing line, status $status}"
  good=$(echo "$closing" | sed -n 's/^\([0-9]*\) success.*/\1/p')
  bad=$(echo "$closing" |
    sed -n 's/.* \/ \([0-9]*\) failures\{0,1\} \/ \([0-9]*\) error.*/\1 + \2/p')
  bad=$((${bad:-1}))
  [ "$status" != 0 ] && [ "$bad" = 0 ] && bad=1
  passed=$((passed + ${good:-0})) failed=$((failed + bad))
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ] && [ "$passed" != 0 ]
