"""Releases: how a client and a server tell each other theirs, and which of two is the older.

**Conventions.** A client says its release in the header `Stone-Release` of every request; a server answers such a
request with its own. What says none is of a release before this header and is understood.
"""

import re

HEADER = "Stone-Release"
FORM = re.compile(r"(\d{1,6})\.(\d{1,6})(?:\.(\d{1,6}))?", re.ASCII)


def is_older(release: str, than: str) -> bool:
    """Whether `release` comes before `than`; no, where it has not the form 1.2 or 1.2.3: then nothing is known."""
    mine, other = FORM.match(release), FORM.match(than)
    return mine is not None and other is not None and _numbers(mine) < _numbers(other)


def _numbers(found: re.Match[str]) -> tuple[int, ...]:
    return tuple(int(number or 0) for number in found.groups())
