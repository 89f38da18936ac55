#!/bin/sh
# Build the images: build.sh [ROLE…], from the project's root; without a role all four.
#
# STONE_ENGINE names the engine (docker where it is there, else podman), STONE_REGISTRY what the names begin with
# (localhost), STONE_BUILD_OPTIONS whatever else the engine should be told. Nothing is pushed.
set -eu

engine=${STONE_ENGINE:-$(command -v docker >/dev/null && echo docker || echo podman)}
registry=${STONE_REGISTRY:-localhost}
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)
revision=$(git rev-parse HEAD 2>/dev/null || echo unknown)
if [ "$engine" = podman ]; then
    format="--format docker"  # the other one has no health checks
else
    format=""
fi

build() {
    file=$1 tag=$2
    shift 2
    # Words are meant to split: options.
    # shellcheck disable=SC2086
    "$engine" build $format ${STONE_BUILD_OPTIONS:-} --file "deploy/images/$file.Dockerfile" \
        --tag "$registry/$tag:$version" "$@" .
}

for target in base tools wheel; do
    build base "stone-$target" --target "$target" ${STONE_PYTHON_IMAGE:+--build-arg "PYTHON_IMAGE=$STONE_PYTHON_IMAGE"}
done
for role in ${*:-api ingest labeler eval}; do
    build "$role" "stone-$role" --build-arg "BASE=$registry/stone-base:$version" \
        --build-arg "TOOLS=$registry/stone-tools:$version" --build-arg "WHEEL=$registry/stone-wheel:$version" \
        --build-arg "VERSION=$version" --build-arg "REVISION=$revision"
done
