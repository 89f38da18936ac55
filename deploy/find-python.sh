#!/bin/sh
# Print a Python 3.11 or 3.12: find-python.sh [CANDIDATE…]; candidates by default: $PYTHON, then PATH.
set -eu

[ $# -gt 0 ] || set -- ${PYTHON:-} python3.11 python3.12 python3 /usr/bin/python3.11
for candidate in "$@"; do
    if command -v "$candidate" >/dev/null &&
        "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2>/dev/null; then
        echo "$candidate"
        exit 0
    fi
done
echo "No Python 3.11 or 3.12 on PATH. On Debian 12: apt-get install -y python3 python3-venv" >&2
exit 1
