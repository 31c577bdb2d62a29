#!/bin/sh
# Sees to it that the programs a target needs are there.
#
#   tools/deps.sh sim    what the simulator needs
#   tools/deps.sh test   what the tests need
#   tools/deps.sh doc    what the pages of the API need
#   tools/deps.sh lua    prints the name of a Lua to run the tools with
#
# What is missing is installed from Debian's packages, when that may be done without
# asking; otherwise the line to type is printed and the status is 1.
set -u

# 5.3 comes first: Debian's colours for the terminal, lua-ansicolors, are not for 5.4.
any_lua() {
  for lua in lua5.3 lua5.4 lua luajit lua5.2 lua5.1; do
    command -v "$lua" >/dev/null 2>&1 && { echo "$lua"; return 0; }
  done
  return 1
}

has_module() { # has_module LUA MODULE
  "$1" -e "require '$2'" >/dev/null 2>&1
}

# Prints the packages that the simulator misses.
missing_for_sim() {
  lua=$(any_lua) || { echo "lua5.3 lua-argparse lua-ansicolors lua-readline"; return; }
  has_module "$lua" argparse || echo lua-argparse
}

# Prints the packages that the tests miss: a package and how to see that it is there.
missing_for_test() {
  for lua in lua5.1 luajit lua5.2 lua5.3 lua5.4; do
    command -v "$lua" >/dev/null 2>&1 || echo "$lua"
  done
  command -v busted >/dev/null 2>&1 || echo lua-busted
  command -v luacheck >/dev/null 2>&1 || echo lua-check
  has_module lua5.1 argparse || echo lua-argparse
  has_module lua5.1 ansicolors || echo lua-ansicolors
  has_module lua5.1 dkjson || echo lua-dkjson
  has_module lua5.1 socket || echo lua-socket
  has_module lua5.1 luv || echo lua-luv
  has_module lua5.1 readline || echo lua-readline
  command -v dot >/dev/null 2>&1 || echo graphviz
}

# Prints the package that the pages of the API miss.
missing_for_doc() {
  command -v ldoc >/dev/null 2>&1 || echo lua-ldoc
}

# Prints what to put before a command to run it as root; fails where that needs asking.
as_root() {
  [ "$(id -u)" = 0 ] && return 0
  command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null && echo "sudo -n"
}

# An update of apt's lists comes second: mostly they do, and then this takes a moment.
install_packages() {
  if ! command -v apt-get >/dev/null 2>&1 || ! root=$(as_root); then
    echo "missing; please type: sudo apt-get install $*" >&2
    return 1
  fi
  echo "installing: $*" >&2
  apt="$root env DEBIAN_FRONTEND=noninteractive apt-get -q"
  log=$(mktemp)
  {
    $apt install -y --no-install-recommends "$@" ||
      { $apt update && $apt install -y --no-install-recommends "$@"; }
  } >"$log" 2>&1 </dev/null || {
    cat "$log" >&2
    rm -f "$log"
    echo "could not install; please type: sudo apt-get install $*" >&2
    return 1
  }
  rm -f "$log"
}

case "${1:-}" in
  lua) any_lua ;;
  sim | test | doc)
    packages=$(missing_for_"$1")
    # One word, one package.
    # shellcheck disable=SC2086
    [ -z "$packages" ] || install_packages $packages
    ;;
  *) echo "usage: tools/deps.sh sim|test|doc|lua" >&2; exit 2 ;;
esac
