#!/bin/sh
# `pip install ARGUMENTS…` into .venv: add-packages.sh ARGUMENTS…, from the project's root. By uv (seconds), else by pip.
set -eu

if deploy/uv.sh pip install --python .venv/bin/python "$@"; then
    exit 0
fi
[ -x .venv/bin/pip ] || .venv/bin/python -m ensurepip --default-pip
exec .venv/bin/python -m pip install --disable-pip-version-check "$@"
