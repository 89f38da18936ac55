"""The limit of open files of this process: raised at start, and a warning before none is left.

**Conventions.** The kernel gives a new file the lowest free number, so the number of the newest one tells how many are
open. Without a free one libuv accepts a connection and closes it at once, without an error: so the warning comes at
`NEAR` of the limit.
"""

import resource
import time
from collections.abc import Callable

import structlog

NEAR = 0.9
MOST = 2**20
"""As many as are ever used: some hosts allow 2^30, and libraries make tables as long as the limit."""

log = structlog.get_logger(__name__)


def raise_descriptor_limit() -> int:
    """Raise the soft limit of open files to the hard one, at most to `MOST`; the limit in force."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST if hard == resource.RLIM_INFINITY else min(hard, MOST)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return soft
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return wanted


class Descriptors:
    """`look(number)` logs a warning, at most one in `each_s`, if the file of this number is among the last ones."""

    def __init__(self, each_s: float, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._each_s, self._now_s, self._silent_until_s = each_s, monotonic_s, 0.0

    def look(self, number: int) -> None:
        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if limit == resource.RLIM_INFINITY or number < NEAR * limit or self._now_s() < self._silent_until_s:
            return
        self._silent_until_s = self._now_s() + self._each_s
        log.warning("open files near the limit; beyond it connections are cut", open=number + 1, limit=limit)
