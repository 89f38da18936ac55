#!/bin/sh
# Make .venv/nuscenes-devkit, where the tests open exports with the devkit of others: install-devkit.sh, from the
# project's root, after create-venv.sh.
#
# An environment of its own, because the devkit pins numpy < 2. About 550 MB. Where packages cannot be fetched nothing is
# left, and the tests that need it say why they are skipped.
set -eu

wanted=tests/clients/devkit/requirements.txt
folder=.venv/nuscenes-devkit
if [ -e "$folder/installed" ] && [ ! "$wanted" -nt "$folder/installed" ]; then
    exit 0
fi
rm -rf "$folder"
if command -v uv >/dev/null; then
    uv venv --quiet --python .venv/bin/python "$folder"
    install="uv pip install --quiet --python $folder/bin/python"
else
    .venv/bin/python -m venv "$folder"
    install="$folder/bin/pip install --quiet --disable-pip-version-check"
fi
if ! $install --no-deps --require-hashes -r "$wanted"; then
    rm -rf "$folder"
    echo "nuscenes-devkit could not be installed: its tests of nuScenes exports will be skipped" >&2
    exit 0
fi
touch "$folder/installed"
