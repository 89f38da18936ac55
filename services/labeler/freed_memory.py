"""Keeps freed memory for what is allocated next, instead of giving it back to the system after every array.

**Conventions.** glibc (mallopt(3)) gives the end of its heap back as soon as a few arrays there are given up, so that a
sweep's temporaries are mapped and zeroed anew, page by page, every time. Other C libraries are left as they are.
"""

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h
KEPT_BYTES = 64 * 2**20
LARGEST_BYTES = 32 * 2**20  # the most that glibc takes; larger ones, as the table of fusing, are given back at once


def keep_freed_memory() -> bool:
    """From now on, in this process and those that it forks; whether the C library knows how."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, LARGEST_BYTES) and mallopt(M_TRIM_THRESHOLD, KEPT_BYTES))
