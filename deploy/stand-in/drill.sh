#!/bin/sh
# docker-compose.yml brought up on stand-ins and the demo sent through it: drill.sh [FOLDER FOR THE DEMO], as root.
#
# Needs podman, runc, debootstrap and `make install`. Everything is stopped at the end; data and images stay.
set -eu

demo=${1:-$(mktemp -d)/demo}
url=http://localhost:8080
STONE_CONFIG_HOME=$(mktemp -d)
export STONE_CONFIG_HOME
compose=.venv/bin/podman-compose

deploy/stand-in/build.sh
# shellcheck source=deploy/stand-in/build-options.sh
(. deploy/stand-in/build-options.sh && deploy/images/build.sh)
podman images --filter 'reference=localhost/stone-*'
deploy/compose/make-secrets.sh
trap '$compose stop' EXIT
$compose up -d
until curl --silent --fail --output /dev/null "$url/readyz"; do sleep 2; done
for role in api ingest labeler eval beat redis postgres proxy; do
    podman healthcheck run "stone_${role}_1"
    echo "$role is healthy"
done
echo "store is not checked: its probe is SeaweedFS's /healthz, which rclone does not have"
.venv/bin/stone auth login "$url" --name admin --admin --password-stdin <deploy/compose/secrets/stone_api__first_password
time .venv/bin/stone demo --server "$url" --output "$demo"
