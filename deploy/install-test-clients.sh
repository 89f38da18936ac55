#!/bin/sh
# Install the clients of others that the tests drive (tests/clients): install-test-clients.sh, from the project's root.
#
# Needs node and npm; where they are missing nothing is installed and the tests that need them say why they are skipped.
# Every package is checked against the integrity hashes of package-lock.json; no script of a package is run.
set -eu

if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
    echo "node or npm is not on PATH: tests of tus-js-client will be skipped. On Debian: apt-get install -y nodejs npm" >&2
    exit 0
fi
cd "$(dirname "$0")/../tests/clients"
installed=node_modules/.package-lock.json
if [ ! -e "$installed" ] || [ package-lock.json -nt "$installed" ]; then
    npm ci --silent --ignore-scripts --no-audit --no-fund
    touch "$installed"
fi
