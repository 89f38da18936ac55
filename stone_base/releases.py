"""Exchange and comparison of client and server releases.

**Conventions.** Every client request contains the client's release in the header `Stone-Release`; the server's response
then contains the server's release. The server accepts a request without the header (from an older release).
"""

import re

HEADER = "Stone-Release"
FORM = re.compile(r"(\d{1,6})\.(\d{1,6})(?:\.(\d{1,6}))?", re.ASCII)


def is_older(release: str, than: str) -> bool:
    """Return whether `release` comes before `than`; False if one of the two does not have the form 1.2 or 1.2.3."""
    mine, other = FORM.match(release), FORM.match(than)
    return mine is not None and other is not None and _numbers(mine) < _numbers(other)


def _numbers(match: re.Match[str]) -> tuple[int, ...]:
    return tuple(int(number or 0) for number in match.groups())
