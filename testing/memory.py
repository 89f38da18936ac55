"""Memory of the process that tests: what is loaded is not searched for garbage, and what tests freed is given back.

Before the first test a process has the modules of all tests and what they import: some million objects, at which the
collector would look again and again, a quarter of the processor time of many a file.

glibc keeps what was freed in the arenas of the threads that had it: over some thousand tests, each with servers and
their threads, a process grew to 1.8 GB of which it used a third: pages go back after every file of tests. What is alive
is not touched by this.
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
    """Return freed pages; where the C library is not glibc nothing happens."""
    if hasattr(_LIBC, "malloc_trim"):
        _LIBC.malloc_trim(0)
