"""The client's own release, and the oldest server that it understands."""

from functools import cache
from importlib.metadata import version

OLDEST_SERVER = "0.1.0"


@cache
def own_release() -> str:
    """As it was installed; looked up when it is first asked for, since `stone --help` does without."""
    return version("stone-client")
