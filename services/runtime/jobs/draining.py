"""Whether this worker was told to stop: said once by its parent, seen by every process of its pool.

**Conventions.** One byte of memory that is shared with whoever is forked after this module was loaded. It is never
taken back.
"""

import mmap

_TOLD = mmap.mmap(-1, 1)


def tell_to_stop() -> None:
    """No process of this worker takes a further job."""
    _TOLD[0] = 1


def takes_jobs() -> bool:
    return _TOLD[0] == 0
