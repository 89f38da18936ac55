#!/bin/sh
# Run a step of the installation: step.sh NUMBER/ALL NAME TITLE COMMAND…, from the project's root.
#
# Print a line at the start and at the end. The command's output goes to build/install/NAME.log; if the command fails,
# print the end of this log.
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
        echo "[$count] $title: failed with exit code $code. Last lines of $log:"
        tail -n 30 "$log" | sed 's/^/    /'
    } >&2
    exit "$code"
fi
