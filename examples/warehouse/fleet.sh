#!/bin/sh
# Starts a Redis server of its own, on loopback, for the warehouse, and stops it again.
#
#   examples/warehouse/fleet.sh LUA [ORDERS [upgrade]]
set -eu
cd "$(dirname "$0")/../.."

port=${PORT:-7379}
folder=$(mktemp -d)
trap 'redis-cli -p "$port" SHUTDOWN NOSAVE >/dev/null 2>&1 || true; rm -rf "$folder"' EXIT

redis-server --port "$port" --bind 127.0.0.1 --dir "$folder" --save "" \
  --daemonize yes --logfile "$folder/log" >/dev/null
until redis-cli -p "$port" PING >/dev/null 2>&1; do sleep 0.1; done

"$1" "examples/warehouse/${3:-run}.lua" "redis://127.0.0.1:$port" "${2:-12}"
