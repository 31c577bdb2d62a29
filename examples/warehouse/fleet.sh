#!/bin/sh
# Starts a Redis server of its own, on loopback, for the warehouse, and stops it again.
#
#   examples/warehouse/fleet.sh LUA [ORDERS [upgrade]]
set -eu
cd "$(dirname "$0")/../.."

port=7379
folder=$(mktemp -d)
trap 'kill -9 "$(cat "$folder/pid")" || true; rm -rf "$folder"' EXIT

# Waits until it answers; fails if its port is another's.
start() {
  redis-server --port "$port" --bind 127.0.0.1 --dir "$folder" --save "" \
    --daemonize yes --logfile "$folder/log" --pidfile "$folder/pid" >/dev/null
  until grep -q "Ready to accept" "$folder/log" 2>/dev/null; do
    ! grep -qs "Address already in use" "$folder/log" || return 1
    sleep 0.05
  done
}
until start; do
  port=$((port + 1))
  rm "$folder/log"
done

"$1" "examples/warehouse/${3:-run}.lua" "redis://127.0.0.1:$port" "${2:-12}"
