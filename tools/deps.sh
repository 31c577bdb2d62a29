#!/bin/sh
# Sees to it that the programs a target needs are there.
#
#   tools/deps.sh sim    what the simulator needs
#   tools/deps.sh test   what the tests need
#   tools/deps.sh lua    prints the name of a Lua to run the tools with
#
# What is missing is installed from Debian's packages, when that may be done without
# asking; otherwise the line to type is printed and the status is 1.
set -u

any_lua() {
  for lua in lua5.4 lua lua5.3 luajit lua5.2 lua5.1; do
    command -v "$lua" >/dev/null 2>&1 && { echo "$lua"; return 0; }
  done
  return 1
}

has_module() { # has_module LUA MODULE
  "$1" -e "require '$2'" >/dev/null 2>&1
}

# Prints the packages that the simulator misses.
missing_for_sim() {
  lua=$(any_lua) || { echo "lua5.4 lua-argparse lua-ansicolors lua-readline"; return; }
  has_module "$lua" argparse || echo lua-argparse
}

# Prints the packages that the tests miss: a package and how to see that it is there.
missing_for_test() {
  for lua in lua5.1 luajit lua5.2 lua5.3 lua5.4; do
    command -v "$lua" >/dev/null 2>&1 || echo "$lua"
  done
  command -v busted >/dev/null 2>&1 || echo lua-busted
  command -v luacheck >/dev/null 2>&1 || echo lua-check
  command -v luac5.1 >/dev/null 2>&1 || echo lua5.1
  has_module lua5.1 argparse || echo lua-argparse
  has_module lua5.1 ansicolors || echo lua-ansicolors
  has_module lua5.1 dkjson || echo lua-dkjson
  has_module lua5.1 socket || echo lua-socket
  has_module lua5.1 luv || echo lua-luv
}

install_packages() {
  as_root=
  if [ "$(id -u)" != 0 ]; then
    as_root="sudo -n"
    command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null || as_root=none
  fi
  if [ "$as_root" = none ] || ! command -v apt-get >/dev/null 2>&1; then
    echo "missing; please type: sudo apt-get install $*" >&2
    exit 1
  fi
  echo "installing: $*" >&2
  export DEBIAN_FRONTEND=noninteractive
  log=$(mktemp)
  $as_root apt-get install -y -q "$@" >"$log" 2>&1 </dev/null ||
    { $as_root apt-get update -q && $as_root apt-get install -y -q "$@"; } \
      >"$log" 2>&1 </dev/null ||
    { cat "$log" >&2; rm -f "$log"; echo "could not install: $*" >&2; exit 1; }
  rm -f "$log"
}

case "${1:-}" in
  lua) any_lua ;;
  sim | test)
    packages=$(missing_for_"$1")
    # One word, one package.
    # shellcheck disable=SC2086
    [ -z "$packages" ] || install_packages $packages
    ;;
  *) echo "usage: tools/deps.sh sim|test|lua" >&2; exit 2 ;;
esac
