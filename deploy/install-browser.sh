#!/bin/sh
# Put Debian's Chromium on the machine, which the tests of the pages drive: install-browser.sh.
#
# By apt-get as root or with passwordless sudo. Where that cannot be, the line to run is printed, nothing fails here, and
# the tests that need a browser say why they are skipped.
set -eu

command -v chromium >/dev/null && exit 0
line="apt-get update && apt-get install -y --no-install-recommends chromium"
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    echo "chromium is not on PATH: tests of the pages will be skipped. To run them: sudo sh -c '$line'" >&2
    exit 0
fi
if ! command -v apt-get >/dev/null; then
    echo "chromium is not on PATH and there is no apt-get: tests of the pages will be skipped" >&2
    exit 0
fi
export DEBIAN_FRONTEND=noninteractive
# Words are meant to split: sudo's option.
# shellcheck disable=SC2086
if ! { $as_root apt-get update -qq && $as_root apt-get install -y -qq --no-install-recommends chromium; } >&2; then
    echo "chromium was not installed: tests of the pages will be skipped. To run them: $line" >&2
fi
