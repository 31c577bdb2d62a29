#!/bin/sh
# Starts a PostgreSQL server of its own, in a new folder, for the warehouse, and stops
# it again.
#
#   examples/warehouse/postgres.sh LUA [ORDERS]
set -eu
cd "$(dirname "$0")/../.."

bin=$(ls -d /usr/lib/postgresql/*/bin | tail -n 1)
folder=$(mktemp -d)
as_user= # the server refuses to run as root
if [ "$(id -u)" = 0 ]; then
  as_user="runuser -u postgres --"
  chown postgres "$folder"
fi

server() { # a program of the server, and its arguments
  program=$1
  shift
  (cd "$folder" && $as_user "$bin/$program" -D "$folder/data" "$@" >/dev/null)
}

trap 'server pg_ctl -m immediate stop || true; rm -rf "$folder"' EXIT
server initdb -N -A trust -U postgres
server pg_ctl -w -l "$folder/log" -o "-k $folder -c listen_addresses=''" start
export PGHOST="$folder" PGUSER=postgres

"$1" tools/rfsm postgres order=examples/warehouse/order.lua --history | psql -Xq
psql -XAqt -v orders="${2:-12}" -f examples/warehouse/postgres.sql 2>&1 |
  sed 's/^psql:[^ ]* INFO:  //'
