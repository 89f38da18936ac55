"""The processes that a measured command leaves behind, in this process's account."""

import contextlib
import ctypes
import os

PR_SET_CHILD_SUBREAPER = 36


def adopt_orphans() -> None:
    """Linux: descendants whose parent has gone become ours, so the fork server and its workers are in our account."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def reap_orphans() -> None:
    """Wait until all of them have ended."""
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
