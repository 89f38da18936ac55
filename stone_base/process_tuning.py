"""Settings of the interpreter and the C library that speed up a process: one function for each kind of process.

**Conventions.** Reference counting frees most objects at once; the cyclic GC only needs to run rarely, because loaded
modules contain many permanent cycles. Every function also affects child processes forked later. Measured with Python's
own thresholds: collections took a seventh of a command's start. With 50 concurrent readers they took a quarter of the
API's time and delayed requests by up to 2 s.
"""

import atexit
import gc
import sys

COMMAND_COLLECTS_AFTER = 20_000
"""Allocations beyond deallocations before a collection of the youngest generation (Python's own: 700)."""

API_COLLECTS_AFTER = (10_000, 20, 20)
"""The same threshold, then collections of one generation per collection of the next: a few hundred requests' garbage
stays.
"""

SWITCH_S = 0.0005
"""Longest time in seconds that a thread may block the event loop. Every request needs the loop several times; with
Python's own 5 ms, that took a quarter of a reader's waiting time.
"""

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES = 64 * 2**20
LARGEST_BYTES = 32 * 2**20  # glibc's maximum; larger blocks, such as the fusion table, return to the system at once


def tune_command() -> None:
    """Tune a command or a fork server: collect rarely, and skip the final collection."""
    gc.set_threshold(COMMAND_COLLECTS_AFTER)
    atexit.register(gc.freeze)


def tune_api() -> None:
    """Tune a stand-alone API process after its set-up: switch threads quickly, collect rarely."""
    sys.setswitchinterval(SWITCH_S)
    exempt_loaded_objects()


def tune_label_worker() -> bool:
    """Tune a labelling process: exempt loaded objects from collections, and keep freed memory.

    Return whether the C library can keep freed memory.
    """
    gc.freeze()
    return keep_freed_memory()


def exempt_loaded_objects() -> None:
    """Exempt all existing objects from later collections, and collect new objects rarely."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*API_COLLECTS_AFTER)


def keep_freed_memory() -> bool:
    """Keep freed memory for later allocations; return False if the C library is not glibc.

    By default glibc returns the end of its heap to the system as soon as a few arrays there are freed. The temporaries
    of the next sweep are then mapped and zeroed again, page by page (mallopt(3)).
    """
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, LARGEST_BYTES) and mallopt(M_TRIM_THRESHOLD, KEPT_BYTES))
