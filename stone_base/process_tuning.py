"""Settings of the interpreter and of the C library that make a process faster: one function for each kind of process.

**Conventions.** Reference counting frees most objects at once; the cyclic collector only needs to run rarely, since
what a process loads is in many cycles that stay. Every function holds from its call on, also in forked children.
Measured: with Python's own thresholds, collections took a seventh of a command's start; with 50 concurrent readers they
took a quarter of the API's time and delayed requests by up to 2 s.
"""

import atexit
import gc
import sys

COMMAND_COLLECTS_AFTER = 20_000
"""Allocations beyond deallocations before a collection of the youngest generation (Python's own: 700)."""

API_COLLECTS_AFTER = (10_000, 20, 20)
"""The same, and collections of one generation before one of the next: the leavings of a few hundred requests stay."""

SWITCH_S = 0.0005
"""How long a thread may keep the event loop waiting. Every request needs the loop several times, and with Python's own
5 ms a reader spent a quarter of its wait on them."""

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h
KEPT_BYTES = 64 * 2**20
LARGEST_BYTES = 32 * 2**20  # the most that glibc takes; it returns larger ones, such as the table of fusing, at once


def tune_command() -> None:
    """Tune a command or a fork server: collect rarely, and leave what is left at the end to the system."""
    gc.set_threshold(COMMAND_COLLECTS_AFTER)
    atexit.register(gc.freeze)


def tune_api() -> None:
    """Tune a stand-alone API process once it is set up: switch threads quickly, collect rarely."""
    sys.setswitchinterval(SWITCH_S)
    exempt_loaded_objects()


def tune_label_worker() -> bool:
    """Tune a process that labels: exempt what is loaded from collections, and keep freed memory.

    Return whether the C library can keep freed memory.
    """
    gc.freeze()
    return keep_freed_memory()


def exempt_loaded_objects() -> None:
    """Exempt the objects that exist now from all later collections, and collect the others rarely."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*API_COLLECTS_AFTER)


def keep_freed_memory() -> bool:
    """Keep freed memory for the next allocations; return False if the C library is not glibc and cannot.

    By default glibc returns the end of its heap to the system as soon as a few arrays there are freed, and the
    temporaries of the next sweep are mapped and zeroed page by page again (mallopt(3)).
    """
    import ctypes  # which no other kind of process loads for this

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, LARGEST_BYTES) and mallopt(M_TRIM_THRESHOLD, KEPT_BYTES))
