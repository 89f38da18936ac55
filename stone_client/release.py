"""The client's own release, and the oldest server that it supports."""

from functools import cache
from importlib.metadata import version

OLDEST_SERVER = "0.1.0"


@cache
def own_release() -> str:
    """Return the installed release; looked up at the first call, since `stone --help` does without."""
    return version("stone-client")
