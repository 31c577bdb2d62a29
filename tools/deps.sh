#!/bin/sh
# Makes sure that the programs for a target are installed.
#
#   tools/deps.sh sim           for the simulator
#   tools/deps.sh test LUA ...  for the tests, on the last of these that is installed
#   tools/deps.sh test-all LUA ...  for all tests, on each of these
#   tools/deps.sh web           for the tests of the page in a browser
#   tools/deps.sh hosts         for the tests of the hosts in examples/hosts/
#   tools/deps.sh doc           for the pages of the API
#   tools/deps.sh site          for these pages and the playground, beside npm
#   tools/deps.sh deb           for Debian packages
#   tools/deps.sh rocks         for rocks
#   tools/deps.sh fleet         for machines in Redis, with lua5.3
#   tools/deps.sh postgres      for machines in PostgreSQL, with lua5.3
#   tools/deps.sh lua LUA ...   prints the last of these that is installed
#   tools/deps.sh axe           prints the file of axe-core, which npm fetches once
#
# Missing Debian packages are installed if you are root or have password-free sudo.
# Otherwise the command to type is printed, and the status is 1.
set -u

has_module() { # has_module LUA MODULE
  "$1" -e "require '$2'" >/dev/null 2>&1
}

# The tool starts if there are a Lua and argparse. With readline it edits lines, with
# luv Control-C works any number of times, with dkjson it records: they are wanted for
# the Lua that is there.
missing_for_sim() {
  code='for _, m in ipairs { "argparse", "readline", "luv", "dkjson" } do
    if not pcall(require, m) then print("lua-" .. m) end
  end'
  for module in readline argparse _G; do # as tools/rfsm
    for lua in ${LUA:-lua5.5 lua5.4 lua5.3 lua luajit lua5.2 lua5.1}; do
      has_module "$lua" "$module" || continue
      "$lua" -e "$code"
      return
    done
  done
  echo "lua5.4 lua-argparse lua-ansicolors lua-readline lua-luv lua-dkjson"
}

missing_for_specs() { # missing_for_specs LUA
  command -v busted >/dev/null 2>&1 || echo lua-busted
  command -v luacheck >/dev/null 2>&1 || echo lua-check
  has_module "$1" argparse || echo lua-argparse
  has_module "$1" dkjson || echo lua-dkjson
  has_module "$1" socket || echo lua-socket
  has_module "$1" lxp || echo lua-expat
  command -v dot >/dev/null 2>&1 || echo graphviz
}

missing_for_test() { # missing_for_test LUA ...
  lua=$(find_lua "$@" 2>/dev/null)
  [ "$lua" != false ] || { lua=lua5.4 && echo "$lua"; }
  missing_for_specs "$lua"
}

# Interpreters in a folder of their own, such as tools/lua5.5, are not Debian's.
missing_for_test_all() { # missing_for_test_all LUA ...
  for lua in "$@"; do
    case $lua in */*) continue ;; esac
    command -v "$lua" >/dev/null 2>&1 || echo "$lua"
  done
  command -v luac5.1 >/dev/null 2>&1 || echo lua5.1
  missing_for_specs lua5.1
  has_module lua5.1 ansicolors || echo lua-ansicolors
  has_module lua5.1 luv || echo lua-luv
  has_module lua5.1 posix || echo lua-posix
  has_module lua5.1 readline || echo lua-readline
  has_module lua5.1 MessagePack || echo lua-messagepack
  has_module lua5.1 redis || echo lua-redis
  has_module lua5.1 luasql.postgres || echo lua-sql-postgres
  command -v redis-server >/dev/null 2>&1 || echo redis-server
  command -v qpdf >/dev/null 2>&1 || echo qpdf
  command -v tmux >/dev/null 2>&1 || echo tmux
  [ -e /usr/share/i18n/locales/de_DE ] || echo locales # with a decimal comma
}

missing_for_fleet() {
  command -v lua5.3 >/dev/null 2>&1 || echo lua5.3
  has_module lua5.3 dkjson || echo lua-dkjson
  has_module lua5.3 redis || echo lua-redis
  has_module lua5.3 socket || echo lua-socket
  command -v redis-server >/dev/null 2>&1 || echo redis-server
}

missing_for_postgres() {
  command -v lua5.3 >/dev/null 2>&1 || echo lua5.3
  has_module lua5.3 argparse || echo lua-argparse
  ls /usr/share/postgresql/*/extension/pllua.control >/dev/null 2>&1 ||
    echo '^postgresql-[0-9]+-pllua$' # Debian 12 has 15, Debian 13 has 17
}

missing_for_web() {
  command -v busted >/dev/null 2>&1 || echo lua-busted
  has_module lua5.1 dkjson || echo lua-dkjson
  has_module lua5.1 socket || echo lua-socket
  has_module lua5.1 zlib || echo lua-zlib
  command -v dot >/dev/null 2>&1 || echo graphviz
  command -v chromium >/dev/null 2>&1 || echo chromium
  command -v chromedriver >/dev/null 2>&1 || echo chromium-driver
}

missing_for_hosts() {
  command -v busted >/dev/null 2>&1 || echo lua-busted
  has_module lua5.1 luv || echo lua-luv
  has_module lua5.1 socket || echo lua-socket
  command -v dot >/dev/null 2>&1 || echo graphviz
  command -v git >/dev/null 2>&1 || echo git
  command -v love >/dev/null 2>&1 || echo love libgl1-mesa-dri
  command -v Xvfb >/dev/null 2>&1 || echo xvfb
  command -v mosquitto >/dev/null 2>&1 || echo mosquitto
  command -v mosquitto_sub >/dev/null 2>&1 || echo mosquitto-clients
  command -v nvim >/dev/null 2>&1 || echo neovim
}

missing_for_deb() {
  command -v git >/dev/null 2>&1 || echo git
  dpkg -s build-essential >/dev/null 2>&1 || echo build-essential # dpkg-buildpackage asks
  command -v dpkg-buildpackage >/dev/null 2>&1 || echo dpkg-dev
  command -v dh >/dev/null 2>&1 || echo debhelper
  command -v help2man >/dev/null 2>&1 || echo help2man
  command -v lintian >/dev/null 2>&1 || echo lintian
  command -v lua5.3 >/dev/null 2>&1 || echo lua5.3
  has_module lua5.3 argparse || echo lua-argparse
  has_module lua5.3 dkjson || echo lua-dkjson
}

missing_for_doc() {
  command -v ldoc >/dev/null 2>&1 || echo lua-ldoc
  has_module lua5.2 discount || has_module lua5.1 discount || echo lua-discount
}

missing_for_site() {
  missing_for_doc
  has_module "$(find_lua lua5.1 luajit lua5.2 lua5.3 lua5.4 2>/dev/null)" dkjson ||
    echo lua-dkjson
}

# LuaRocks wants the headers of each Lua, also for modules in Lua.
missing_for_rocks() {
  command -v git >/dev/null 2>&1 || echo git
  command -v luarocks >/dev/null 2>&1 || echo luarocks
  for version in 5.1 5.2 5.3 5.4; do
    command -v lua$version >/dev/null 2>&1 || echo lua$version
    [ -e /usr/include/lua$version/lua.h ] || echo liblua$version-dev
  done
  command -v luajit >/dev/null 2>&1 || echo luajit
  command -v busted >/dev/null 2>&1 || echo lua-busted
  has_module lua5.1 argparse || echo lua-argparse
}

# Prints the last interpreter that is installed, of those that are not in a folder of
# their own. If there is none, prints a command that fails, so that a recipe ends there.
find_lua() { # find_lua LUA ...
  found=
  for lua in "$@"; do
    case $lua in */*) continue ;; esac
    command -v "$lua" >/dev/null 2>&1 && found=$lua
  done
  [ -n "$found" ] || echo "no Lua is installed; please type: sudo apt-get install lua5.4" >&2
  echo "${found:-false}"
}

# Prints the prefix of commands that need root; fails if sudo would ask for a password.
as_root() {
  [ "$(id -u)" = 0 ] && return 0
  command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null && echo "sudo -n"
}

# apt's lists are updated only if they do not suffice: mostly they do.
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

# Prints the name of axe.min.js, in a folder that is kept. Status 1 if npm has it not.
find_axe() {
  version=4.14.1
  folder=${XDG_CACHE_HOME:-${HOME:-/tmp}/.cache}/rfsm/axe-core-$version
  if [ ! -s "$folder/axe.min.js" ]; then
    new=$(mktemp -d)
    (cd "$new" && timeout 60 npm pack --silent "axe-core@$version" &&
      tar -xzf "axe-core-$version.tgz" package/axe.min.js package/LICENSE &&
      mkdir -p "$folder" && mv package/LICENSE package/axe.min.js "$folder") \
      >/dev/null 2>&1 </dev/null
    rm -rf "$new"
  fi
  [ -s "$folder/axe.min.js" ] && echo "$folder/axe.min.js"
}

case "${1:-}" in
  axe) find_axe ;;
  lua) shift && find_lua "$@" ;;
  sim | test | test-all | web | hosts | doc | site | deb | rocks | fleet | postgres)
    target=$1
    [ "$target" != test-all ] || target=test_all
    shift
    packages=$(missing_for_"$target" "$@")
    # One word, one package.
    # shellcheck disable=SC2086
    [ -z "$packages" ] || install_packages $packages ||
      { [ "$target" = sim ] && "$(dirname "$0")/rfsm" --version >/dev/null 2>&1; }
    ;;
  *)
    echo "usage: tools/deps.sh sim|web|hosts|axe|doc|site|deb|rocks|fleet|postgres" >&2
    echo "       tools/deps.sh test|test-all|lua LUA ..." >&2
    exit 2
    ;;
esac
