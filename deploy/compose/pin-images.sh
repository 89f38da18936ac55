#!/bin/sh
# Pull the external images of docker-compose.yml and write their digests to .env: pin-images.sh.
#
# A tag can move, a digest cannot. Run it again to accept the tags' newer images. ENGINE=podman for Podman.
set -eu

cd "$(dirname "$0")/../.."
engine=${ENGINE:-docker}
pinned=$(mktemp)
trap 'rm -f "$pinned"' EXIT
sed -n 's/^ *image: \${\(STONE_[A-Z]*_IMAGE\):-\([^}]*\)}.*/\1 \2/p' docker-compose.yml | while read -r variable image; do
    "$engine" pull "$image" >&2
    digest=$("$engine" image inspect --format '{{index .RepoDigests 0}}' "$image")
    case $digest in
    *@sha256:*) echo "$variable=$digest" ;;
    *) echo "$image has no digest after the pull: $digest" >&2 && exit 1 ;;
    esac
done >"$pinned"
touch .env
grep -v '^STONE_[A-Z]*_IMAGE=' .env >.env.partial || true
cat "$pinned" >>.env.partial
mv .env.partial .env
cat "$pinned"
