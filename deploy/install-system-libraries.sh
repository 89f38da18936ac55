#!/bin/sh
# Install system packages that wheels do not contain: shared libraries of Open3D and Python's venv module.
#
#   install-system-libraries.sh PYTHON     0: complete, 1: missing without permission to install (prints the command)
#
# Use apt-get as root or with passwordless sudo. The dynamic loader, not dpkg, determines missing libraries.
set -eu

python=${1:?usage: install-system-libraries.sh PYTHON}

missing_packages() {
    "$python" - <<'PYTHON'
import ctypes
import importlib.util
import sys

PACKAGE_OF = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libgomp.so.1": "libgomp1",
    "libstdc++.so.6": "libstdc++6",
}
missing = []
for library, package in PACKAGE_OF.items():
    try:
        ctypes.CDLL(library)
    except OSError:
        missing.append(package)
if importlib.util.find_spec("ensurepip") is None or importlib.util.find_spec("venv") is None:
    missing.append("python{}.{}-venv".format(*sys.version_info))
print(*missing)
PYTHON
}

missing=$(missing_packages)
[ -z "$missing" ] && exit 0

install_line="apt-get update && apt-get install -y --no-install-recommends $missing"
if ! command -v apt-get >/dev/null; then
    echo "System libraries are missing. Install the Debian packages $missing (or their equivalents), then run make again." >&2
    exit 1
fi
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    echo "System libraries are missing, and installing them requires root. Run this command, then make again:" >&2
    echo "    sudo sh -c '$install_line'" >&2
    exit 1
fi

echo "Installing system libraries: $missing" >&2
export DEBIAN_FRONTEND=noninteractive
# Words are meant to split: sudo's option, the package names.
# shellcheck disable=SC2086
$as_root apt-get update -qq >&2
# shellcheck disable=SC2086
$as_root apt-get install -y -qq --no-install-recommends $missing >&2

missing=$(missing_packages)
if [ -n "$missing" ]; then
    echo "Still missing after apt-get: $missing. Do this Python and the machine's packages have different architectures?" >&2
    exit 1
fi
