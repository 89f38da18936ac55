#!/bin/sh
# Make .venv with the locked dependencies, the project itself and its client: create-venv.sh, from the project's root.
#
# uv where it is on PATH (seconds), pip otherwise. Every file is checked against the hashes of requirements.lock.
set -eu

supports() {
    command -v "$1" >/dev/null && "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2>/dev/null
}

python=""
for candidate in ${PYTHON:-} python3.11 python3.12 python3 /usr/bin/python3.11; do
    if supports "$candidate"; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ]; then
    echo "Python 3.11 or 3.12 is needed and not on PATH. On Debian 12: apt-get install -y python3 python3-venv" >&2
    exit 1
fi

"$(dirname "$0")/install-system-libraries.sh" "$python"

if [ -x .venv/bin/python ] && ! supports .venv/bin/python; then
    rm -rf .venv  # its interpreter went away or is of another version
fi
if command -v uv >/dev/null; then
    [ -x .venv/bin/python ] || uv venv --quiet --python "$python" .venv
    uv pip install --quiet --python .venv/bin/python --require-hashes -r requirements.lock
    uv pip install --quiet --python .venv/bin/python --no-deps -e .
    uv pip install --quiet --python .venv/bin/python --no-deps -e deploy/client
else
    [ -x .venv/bin/pip ] || "$python" -m venv --clear .venv
    .venv/bin/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
    .venv/bin/pip install --quiet --disable-pip-version-check --no-deps -e .
    .venv/bin/pip install --quiet --disable-pip-version-check --no-deps -e deploy/client
fi
