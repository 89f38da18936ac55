#!/bin/sh
# Create the missing secrets of docker-compose.yml: make-secrets.sh.
#
# Only its owner can read the folder deploy/compose/secrets. All users can read its files: a container mounts the files,
# not the folder, and its user is not the owner.
set -eu

cd "$(dirname "$0")"
mkdir -p -m 0700 secrets
for name in stone_api__first_password stone_api__metrics_token stone_broker__password stone_database__password \
    stone_database__api_password stone_database__beat_password stone_database__ingest_password \
    stone_database__labeler_password stone_database__eval_password stone_store__s3_key_id stone_store__s3_secret; do
    if [ ! -s "secrets/$name" ]; then
        od -An -N24 -tx1 /dev/urandom | tr -d ' \n' >"secrets/$name.partial"
        chmod 0444 "secrets/$name.partial"
        mv "secrets/$name.partial" "secrets/$name"
        echo "created $PWD/secrets/$name" >&2
    fi
done
