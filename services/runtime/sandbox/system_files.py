"""Files that any sandboxed child may read: the interpreter, the libraries, this code and its compiled kernels.

**Conventions.** The list contains the project's packages, never the folder around them: a data folder with its keys
often lies beside them. A child finds modules that it imports late, since its parent imports all packages here.
"""

import os
import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

PACKAGES = (
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports",
    "stone_datasets", "services", "api",
    "web", "stone_client", "stone_local",
)  # fmt: skip
SYSTEM = ("/usr", "/lib", "/lib64", "/bin", "/etc/ld.so.cache", "/etc/localtime", "/etc/timezone", "/etc/fonts")
KERNEL = ("/proc/meminfo", "/proc/cpuinfo", "/proc/stat", "/proc/filesystems", "/proc/sys/vm", "/sys/devices/system")
GROUPS = ("/sys/fs/cgroup", "/sys/kernel/mm")  # memory limits and page sizes, which allocators read
DEVICES = tuple(Path("/dev", name) for name in ("null", "zero", "full", "random", "urandom"))


def system_files() -> tuple[Path, ...]:
    """Return the existing files and folders of the list, including this process's own `/proc`."""
    return (*_find_installed(), Path("/proc/self"))


@cache
def _find_installed() -> tuple[Path, ...]:
    paths = {*map(Path, (*SYSTEM, *KERNEL, *GROUPS, sys.prefix, sys.base_prefix)), *_find_packages()}
    return tuple(sorted(path for path in (*paths, *_find_compiled()) if path.exists()))


def _find_packages() -> set[Path]:
    """Import the installed packages and return their folders.

    Python reads the folder around them again after it changed; a child may not, and would not find them there.
    """
    packages = (import_module(name) for name in PACKAGES if find_spec(name))
    return {Path(folder) for package in packages for folder in package.__path__}


def _find_compiled() -> set[Path]:
    """Return the folders of numba's compiled kernels: beside the code, configured, or in the user's cache."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    cache_home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return {cache_home / "numba", cache_home / "matplotlib", *([Path(named)] if named else [])}
