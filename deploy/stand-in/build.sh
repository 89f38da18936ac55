#!/bin/sh
# Make the stand-in base images with podman and debootstrap, as root: build.sh, from the project's root.
set -eu

python=python:3.11.14-slim-bookworm
site=$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | grep -v security | head -n 1)
. deploy/stand-in/build-options.sh

if ! podman image exists "docker.io/library/$python"; then
    rootfs=$(mktemp -d)
    trap 'rm -rf "$rootfs"' EXIT
    debootstrap --variant=minbase --include=ca-certificates,python3,python3-venv,python3-pip bookworm "$rootfs" "$site"
    rm -rf "$rootfs"/var/cache/apt/archives/*.deb "$rootfs"/var/lib/apt/lists/*
    tar -C "$rootfs" -c . | podman import - "docker.io/library/$python"
fi
for image in redis:7.4 postgres:18.4 seaweedfs:4.48 caddy:2.10; do
    name=${image%%:*}
    owner=library
    [ "$name" = seaweedfs ] && owner=chrislusf
    # Words are meant to split: options.
    # shellcheck disable=SC2086
    podman build $STONE_BUILD_OPTIONS --format docker --file "deploy/stand-in/$name.Dockerfile" \
        --build-arg "PYTHON_IMAGE=docker.io/library/$python" --tag "docker.io/$owner/$image" deploy/stand-in
done
