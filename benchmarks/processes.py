"""The orphaned processes of a measured command, in this process's account."""

import contextlib
import ctypes
import os

PR_SET_CHILD_SUBREAPER = 36


def adopt_orphans() -> None:
    """Adopt descendants whose parent has ended (Linux), so that the fork server and its workers are in our account."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def reap_orphans() -> None:
    """Wait until all orphans have ended."""
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
