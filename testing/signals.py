"""For tests that interrupt a process: one that was started in the background passes on that it ignores Ctrl-C."""

import signal


def hear_signals() -> None:
    """A `preexec_fn` that lets the child be interrupted whatever its parents ignore."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
