#!/bin/sh
# Install Debian's Chromium for the tests of the pages: install-browser.sh.
#
# Use apt-get as root or with passwordless sudo. Otherwise print the command without failing; the tests that need a
# browser are skipped with a reason.
set -eu

command -v chromium >/dev/null && exit 0
line="apt-get update && apt-get install -y --no-install-recommends chromium"
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    echo "No chromium on PATH: tests of the pages will be skipped. To install it: sudo sh -c '$line'" >&2
    exit 0
fi
if ! command -v apt-get >/dev/null; then
    echo "No chromium and no apt-get on PATH: tests of the pages will be skipped" >&2
    exit 0
fi
export DEBIAN_FRONTEND=noninteractive
# Words are meant to split: sudo's option.
# shellcheck disable=SC2086
if ! { $as_root apt-get update -qq && $as_root apt-get install -y -qq --no-install-recommends chromium; } >&2; then
    echo "chromium could not be installed: tests of the pages will be skipped. To install it: $line" >&2
fi
