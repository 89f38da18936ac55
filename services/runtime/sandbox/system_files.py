"""Files that any sandboxed child may read: the interpreter, the libraries, this code and its compiled kernels.

**Conventions.** Folders of the project's packages, never the folder that they lie in: a data folder with its keys often
lies beside them. Modules that a child imports late are found, since its parent imports all packages here.
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
GROUPS = ("/sys/fs/cgroup", "/sys/kernel/mm")  # memory limits and the size of pages, which allocators ask for
DEVICES = tuple(Path("/dev", name) for name in ("null", "zero", "full", "random", "urandom"))


def system_files() -> tuple[Path, ...]:
    """What is there of them, this process's own `/proc` included."""
    return (*_installed(), Path("/proc/self"))


@cache
def _installed() -> tuple[Path, ...]:
    found = {*map(Path, (*SYSTEM, *KERNEL, *GROUPS, sys.prefix, sys.base_prefix)), *_packages()}
    return tuple(sorted(path for path in (*found, *_compiled()) if path.exists()))


def _packages() -> set[Path]:
    """Import the packages that are installed, and return their folders.

    Python looks into the folder around them again once it changed, and a child may not: it would not find them there.
    """
    found = (import_module(name) for name in PACKAGES if find_spec(name))
    return {Path(place) for package in found for place in package.__path__}


def _compiled() -> set[Path]:
    """Where numba keeps compiled kernels: beside the code, or where it is told to, or in the user's cache."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    cache_home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return {cache_home / "numba", cache_home / "matplotlib", *([Path(named)] if named else [])}
