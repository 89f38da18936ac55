#!/bin/sh
# Build what browsers load: build-pages.sh, from the project's root.
#
# The Node on PATH where it is new enough, else one from a wheel in build/node. Every package is checked against the
# integrity hashes of package-lock.json; no script of a package is run.
set -eu

is_new_enough() {
    "$1" -e 'process.exit(Number(process.versions.node.split(".")[0]) >= 20 ? 0 : 1)' 2>/dev/null
}

if ! { command -v node >/dev/null && command -v npm >/dev/null && is_new_enough node; }; then
    if [ ! -x build/node/bin/npm ]; then
        rm -rf build/node
        "$(deploy/find-python.sh)" -m venv build/node
        build/node/bin/pip install --quiet --disable-pip-version-check --require-hashes -r deploy/node.lock
    fi
    PATH="$PWD/build/node/bin:$PATH"
    export PATH
fi

cd web
installed=node_modules/.package-lock.json
if [ ! -e "$installed" ] || [ package-lock.json -nt "$installed" ]; then
    npm ci --silent --ignore-scripts --no-audit --no-fund
    touch "$installed"
fi
rm -rf built.partial
node node_modules/typescript/bin/tsc -p . --outDir built.partial
find built.partial -name '*.js' -exec node node_modules/esbuild/bin/esbuild --minify --log-level=warning \
    --outdir=built.partial --outbase=built.partial --allow-overwrite {} +
node node_modules/esbuild/bin/esbuild libraries/three.js --bundle --minify --format=esm --legal-comments=inline \
    --log-level=warning --outfile=built.partial/libraries/three.js
rm -rf built
mv built.partial built
