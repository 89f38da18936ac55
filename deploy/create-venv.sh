#!/bin/sh
# Make .venv with what the platform runs on, the project itself and its client: create-venv.sh, from the project's root.
#
# Every file is checked against the hashes of deploy/runtime.lock. What tests and audits need comes on top: make develop.
set -eu

python=$(deploy/find-python.sh)
deploy/install-system-libraries.sh "$python"
if [ -x .venv/bin/python ] && ! deploy/find-python.sh .venv/bin/python >/dev/null 2>&1; then
    rm -rf .venv  # its interpreter went away or is of another version
fi
[ -x .venv/bin/python ] || "$python" -m venv --clear --without-pip .venv
deploy/add-packages.sh --require-hashes -r deploy/runtime.lock
deploy/add-packages.sh --no-deps -e . -e deploy/client
