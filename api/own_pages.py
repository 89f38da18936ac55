"""Addresses of our own pages that a browser may be redirected to."""

import re

OURS = re.compile(r"/(?![/\\])[^\\\s\x00-\x1f\x7f]*")
"""A path of this site; browsers take `//host` and `/\\host` for other hosts."""
LONGEST = 2000


def own_page(path: str) -> str:
    """Return the path, or `/` if it leads to another site or is no page: a path of the API could restart a sign-in."""
    is_page = len(path) <= LONGEST and OURS.fullmatch(path) and not path.startswith("/api/")
    return path if is_page else "/"
