#!/bin/sh
# Build the wheels into dist/: build-wheels.sh [client], from the project's root; the platform's too unless told `client`.
#
# The client's goes to api/downloads/ as well, from where the platform serves it, so it comes first.
set -eu

build() {
    if ! deploy/uv.sh build --quiet --wheel --out-dir dist "$1"; then
        [ -x .venv/bin/pip ] || .venv/bin/python -m ensurepip --default-pip
        .venv/bin/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist "$1"
    fi
}

mkdir -p dist api/downloads
rm -f dist/stone_client-*.whl api/downloads/*.whl
build ./deploy/client
cp dist/stone_client-*.whl api/downloads/
if [ "${1:-}" != client ]; then
    rm -f dist/stone_platform-*.whl
    build .
fi
