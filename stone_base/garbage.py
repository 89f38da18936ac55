"""How a process that loads much looks for garbage: seldom, and not when it ends.

**Conventions.** What nobody refers to any more is freed at once; the collector is for cycles only, and what is loaded
is in many that stay.
"""

import atexit
import gc

COLLECTED_AFTER = 20_000
"""So many more objects are made than freed before the young ones are looked at. With Python's own 700, looks at what is
being imported take a seventh of a command's start."""


def collect_seldom() -> None:
    """From now on in this process and those that it forks; at its end all that is left goes with it, unlooked at."""
    gc.set_threshold(COLLECTED_AFTER)
    atexit.register(gc.freeze)
