"""For tests that interrupt a process: children of a background process inherit that Ctrl-C is ignored."""

import signal


def hear_signals() -> None:
    """Restore the handling of interrupts in the child, as a `preexec_fn`."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
