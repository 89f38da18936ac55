"""Addresses of our own pages, to which a browser may be sent back."""

import re

OURS = re.compile(r"/(?![/\\])[^\\\s\x00-\x1f\x7f]*")
"""A path of this site: never another host's address, which `//host` and `/\\host` are to a browser."""
LONGEST = 2000


def own_page(path: str) -> str:
    """The path, or `/` where it would lead elsewhere, or to what is no page: the API, which begins a sign-in anew."""
    is_page = len(path) <= LONGEST and OURS.fullmatch(path) and not path.startswith("/api/")
    return path if is_page else "/"
