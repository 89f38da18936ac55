#!/bin/sh
# Put on the machine what the wheels cannot carry: the shared libraries Open3D loads and Python's venv module.
#
#   install-system-libraries.sh PYTHON     0: all there, 1: missing and not ours to install (the line to run is printed)
#
# Installs by apt-get as root or with passwordless sudo; what is missing is asked of the loader, not of dpkg.
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
    echo "System libraries are missing; on Debian they are the packages: $missing. Install them, then run make again." >&2
    exit 1
fi
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    echo "System libraries are missing, and installing them needs root. Run this, then make again:" >&2
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
    echo "Still missing after apt-get: $missing. Is this Python for another architecture than the machine's packages?" >&2
    exit 1
fi
