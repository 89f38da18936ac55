"""Memory of the test process: loaded objects are excluded from garbage collection, and freed pages are returned.

Before the first test a process contains the modules of all tests and their imports: about a million objects. Scanning
them took a quarter of the processor time of many files.

glibc keeps freed memory in the arenas of its threads. Over several thousand tests, each with servers and threads, a
process grew to 1.8 GB and used a third of it. Therefore pages are returned after every file of tests. Live objects are
not affected.
"""

import ctypes
from collections.abc import Iterator

import pytest

from stone_base.process_tuning import exempt_loaded_objects

_LIBC = ctypes.CDLL(None)


def pytest_collection_finish() -> None:
    exempt_loaded_objects()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    try:
        return (yield)
    finally:
        if nextitem is None or nextitem.path != item.path:
            trim()


def trim() -> None:
    """Return freed pages to the system; does nothing without glibc."""
    if hasattr(_LIBC, "malloc_trim"):
        _LIBC.malloc_trim(0)
