# What a build on a machine like this is told, to be sourced: its network, its certificates, its pip and npm settings.
# Mounted while a build runs, none of it stays in an image.
certificates=/etc/ssl/certs/ca-certificates.crt
build_files=$(mktemp -d)
printf '[global]\ncert = %s\ntimeout = 180\n' "$certificates" >"$build_files/pip.conf"
printf 'cafile=%s\n' "$certificates" >"$build_files/npmrc"
STONE_ENGINE=podman
STONE_PYTHON_IMAGE=docker.io/library/python:3.11.14-slim-bookworm
STONE_BUILD_OPTIONS="--network host -v /etc/ssl/certs:/etc/ssl/certs:ro -v $build_files/pip.conf:/etc/pip.conf:ro"
STONE_BUILD_OPTIONS="$STONE_BUILD_OPTIONS -v $build_files/npmrc:/tmp/.npmrc:ro"
export STONE_ENGINE STONE_PYTHON_IMAGE STONE_BUILD_OPTIONS
