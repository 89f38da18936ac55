"""The limit of open files of this process: raised at start, with a warning before it is reached.

**Conventions.** The kernel assigns the lowest free number to a new file, so the newest number is a measure of the open
files. Without a free number, libuv accepts a connection and closes it at once without an error, so the warning is
logged at `NEAR` of the limit.
"""

import resource
import time
from collections.abc import Callable

import structlog

NEAR = 0.9
MOST = 2**20
"""Enough for any load: some hosts allow 2^30, and libraries allocate tables as long as the limit."""

log = structlog.get_logger(__name__)


def raise_descriptor_limit() -> int:
    """Raise the soft limit of open files to the hard one, at most to `MOST`; return the limit in force."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST if hard == resource.RLIM_INFINITY else min(hard, MOST)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return soft
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return wanted


class Descriptors:
    """`look(number)` logs a warning, at most one in `each_s`, if this file number is near the limit."""

    def __init__(self, each_s: float, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._each_s, self._now_s, self._silent_until_s = each_s, monotonic_s, 0.0

    def look(self, number: int) -> None:
        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if limit == resource.RLIM_INFINITY or number < NEAR * limit or self._now_s() < self._silent_until_s:
            return
        self._silent_until_s = self._now_s() + self._each_s
        log.warning("open files near the limit; beyond it the process drops connections", open=number + 1, limit=limit)
