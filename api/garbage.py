"""How often the process that answers looks for garbage, and at what.

**Conventions.** What nobody refers to any more is freed at once; the collector is for cycles only. It looks at all
objects while no thread runs, and hardly any of a request's are in a cycle: with fifty readers of lists at once, such
looks, most of them at modules and routes that are there for good, took a quarter of the time, and every request waited
for them, on a busy machine up to two seconds.
"""

import gc

COLLECTED_AFTER = (10_000, 20, 20)
"""So many more objects are made than freed before the young ones are looked at (Python's own: 700), and so many such
looks come before one at older ones. A few hundred requests' leavings are held meanwhile."""


def keep_what_is_loaded() -> None:
    """Never look again at what is there now, and seldom at the rest. For a process of its own, once it is set up."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECTED_AFTER)
