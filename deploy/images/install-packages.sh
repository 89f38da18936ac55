#!/bin/sh
# Fill /srv/stone with the packages of a lock, each checked by its hash: install-packages.sh LOCK.
#
# What only developers of those packages need is left out: their tests, and headers to compile against them.
set -eu

python3 -m venv --without-pip /srv/stone
/srv/tools/bin/pip --python /srv/stone/bin/python install --no-cache-dir --no-deps --compile --require-hashes \
    --requirement "$1"
packages=$(/srv/stone/bin/python -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
find "$packages" -type d -name tests -prune -exec rm -rf {} +
rm -rf "$packages/pyarrow/include"
