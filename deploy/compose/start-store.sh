#!/bin/sh
# SeaweedFS with its one key from secret files: start-store.sh.
set -eu

umask 077
cat >/tmp/s3.json <<JSON
{"identities": [{"name": "stone", "actions": ["Admin", "Read", "Write", "List", "Tagging"], "credentials": [
  {"accessKey": "$(cat /run/secrets/stone_store__s3_key_id)",
   "secretKey": "$(cat /run/secrets/stone_store__s3_secret)"}]}]}
JSON
exec weed server -dir=/data -ip.bind=0.0.0.0 -master.volumeSizeLimitMB=1024 -volume.max=0 \
    -s3 -s3.port=8333 -s3.config=/tmp/s3.json
