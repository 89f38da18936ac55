#!/bin/sh
# Run a step of the installation: step.sh NUMBER/ALL NAME TITLE COMMAND…, from the project's root.
#
# A line says that it begins and a line that it is done. What the command says goes to build/install/NAME.log; where it
# fails, the end of that is shown.
set -eu

count=$1 log=build/install/$2.log title=$3
shift 3
mkdir -p build/install
started=$(date +%s)
echo "[$count] $title (log: $log)"
if "$@" >"$log" 2>&1; then
    echo "[$count] $title: done in $(($(date +%s) - started)) s"
else
    code=$?
    {
        echo "[$count] $title: failed with exit code $code. The end of $log:"
        tail -n 30 "$log" | sed 's/^/    /'
    } >&2
    exit "$code"
fi
