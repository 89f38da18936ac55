#!/bin/sh
# Redis with its password from a secret file, so that it stands in no command line: start-redis.sh.
#
# It keeps what it was told (AOF): a wake-up lost is sent again within seconds, a queue kept is not even late.
set -eu

umask 077
printf 'requirepass "%s"\n' "$(cat /run/secrets/stone_broker__password)" >/tmp/redis.conf
exec redis-server /tmp/redis.conf --dir /data --appendonly yes --appendfsync everysec --save '' \
    --maxmemory 400mb --maxmemory-policy noeviction
