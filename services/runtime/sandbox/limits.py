"""Resource limits of a sandboxed child, and the rlimits that enforce them.

**Conventions.** Memory is counted beyond the process's memory at the fork, twice: as data (allocated) and as address
space (including mapped files). On Linux, `/proc/self/statm` contains the current values (proc(5)).
"""

import ctypes
import os
import resource
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path

STATM, DESCRIPTORS = Path("/proc/self/statm"), "/proc/self/fd"
SPACE, DATA = 0, 5  # fields of statm, in pages
M_ARENA_MAX = -8  # mallopt(3)


@dataclass(frozen=True)
class SandboxLimits:
    """The limits of a child: memory, processor and wall time, number of open files, size of its answer.

    `mapped_bytes` is the size of files that it maps, which take address space and no memory. It may write below
    `folder` only, files of `file_bytes` at most, and links only if it `makes_links`; without a folder it writes
    nothing. Elsewhere it may only read `reads` (files, and everything below folders) and the system's own files.
    `folder` may contain at most `folder_files` files and folders, and `folder_bytes` in total. It imports the modules
    `imports` before its fences close, because libraries read other files at their import.

    For a child that reads a secret, set `may_quote` to False: the parent then forwards no text of its refusals and
    faults, and only a count of its progress.
    """

    memory_bytes: int = 256 * 2**20
    cpu_s: int = 120
    wall_s: float = 1800.0
    answer_bytes: int = 64 * 2**20
    descriptors: int = 32
    mapped_bytes: int = 0
    folder: Path | None = None
    file_bytes: int = 0
    reads: tuple[Path, ...] = ()
    makes_links: bool = False
    may_quote: bool = True
    folder_files: int = 10_000
    folder_bytes: int = 2**30
    imports: tuple[str, ...] = ()


def apply_limits(limits: SandboxLimits) -> None:
    """Apply the limits. A core dump would contain the ground truth; further arenas would reserve 64 MiB each."""
    ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    taken = {int(name) for name in os.listdir(DESCRIPTORS)}
    free = islice((number for number in count() if number not in taken), limits.descriptors)
    pages, page_bytes = STATM.read_text().split(), resource.getpagesize()
    _lower(resource.RLIMIT_NOFILE, max(free))  # it bounds the highest number, not the count
    _lower(resource.RLIMIT_FSIZE, limits.file_bytes if limits.folder else 0)
    _lower(resource.RLIMIT_CORE, 0)
    _lower(resource.RLIMIT_CPU, limits.cpu_s, hard=limits.cpu_s + 1)
    _lower(resource.RLIMIT_DATA, int(pages[DATA]) * page_bytes + limits.memory_bytes)
    _lower(resource.RLIMIT_AS, int(pages[SPACE]) * page_bytes + limits.memory_bytes + limits.mapped_bytes)


def _lower(which: int, limit: int, *, hard: int | None = None) -> None:
    """Lower a limit, never raising it above its current value."""
    standing = resource.getrlimit(which)
    wished = (limit, limit if hard is None else hard)
    soft, most = (
        value if held == resource.RLIM_INFINITY else min(value, held)
        for value, held in zip(wished, standing, strict=True)
    )
    resource.setrlimit(which, (soft, most))
