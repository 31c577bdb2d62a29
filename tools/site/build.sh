#!/bin/sh
# Builds the playground: build.sh TARGET LUA. The npm packages of package-lock.json are
# kept in the user's cache.
set -eu
target=$1 lua=${2:-}
cd "$(dirname "$0")/../.."

fail() { echo "make site: $*" >&2; exit 1; }

for program in node npm; do
  command -v $program >/dev/null || fail "$program is missing (on Debian: apt-get install npm)"
done
[ -n "$lua" ] || fail "a Lua is missing (on Debian: apt-get install lua5.4)"
dkjson=$("$lua" -e 'for template in package.path:gmatch("[^;]+") do
  local name = template:gsub("%?", "dkjson")
  if io.open(name) then print(name) break end
end')
[ -n "$dkjson" ] || fail "dkjson is missing (on Debian: apt-get install lua-dkjson)"

cache=${XDG_CACHE_HOME:-${HOME:-/tmp}/.cache}/rfsm
packages=$cache/site-$(cksum <tools/site/package-lock.json | cut -d' ' -f1)
if [ ! -d "$packages" ]; then
  mkdir -p "$cache"
  new=$(mktemp -d "$cache/new-XXXXXX")
  trap 'rm -rf "$new"' EXIT
  cp tools/site/package.json tools/site/package-lock.json tools/site/.npmrc "$new"
  (cd "$new" && timeout 300 npm ci --ignore-scripts --no-audit --no-fund) >"$new/log" 2>&1 </dev/null ||
    fail "npm cannot fetch the packages of tools/site/package-lock.json: $(
      sed -n 's/^npm \(error\|ERR!\) //p' "$new/log" | grep -m1 ' .* ')"
  mv "$new" "$packages"
fi

mkdir -p "$(dirname "$target")"
NODE_PATH=$packages/node_modules node tools/site/playground.mjs "$target" "$dkjson"
