#!/bin/sh
# Install the clients of others that the tests drive (tests/clients): install-test-clients.sh, from the project's root.
#
# openapi-python-client gets an environment of its own in build/. The others need node and npm; without these they are
# not installed, and the tests that need them are skipped with the reason. Every package is checked against the hashes of
# its lock; no script of an npm package is run.
set -eu

lock=tests/clients/openapi-python-client.lock
folder=build/openapi-python-client
if [ ! -e "$folder/installed" ] || [ "$lock" -nt "$folder/installed" ]; then
    rm -rf "$folder"
    "$(deploy/find-python.sh)" -m venv "$folder"
    if "$folder/bin/pip" install --quiet --disable-pip-version-check --require-hashes -r "$lock"; then
        touch "$folder/installed"
    else
        rm -rf "$folder"
        echo "openapi-python-client could not be installed: tests of generated Python clients will be skipped" >&2
    fi
fi

if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
    echo "No node or npm on PATH: tests of JavaScript clients will be skipped. On Debian: apt-get install -y nodejs npm" >&2
    exit 0
fi
cd tests/clients
installed=node_modules/.package-lock.json
if [ ! -e "$installed" ] || [ package-lock.json -nt "$installed" ]; then
    npm ci --silent --ignore-scripts --no-audit --no-fund
    touch "$installed"
fi
