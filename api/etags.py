"""Conditional requests: ETag, If-Match and If-None-Match (RFC 9110 §13).

**Conventions.** ETags are strong: the resource's revision, or the sha256 of its bytes, in quotes. A change without
If-Match returns 428, and with another ETag 412, so clients overwrite only states that they have read.
"""

import re
from typing import TypeVar

from fastapi import Request, Response

from api.errors import ApiError

T = TypeVar("T")
TAG = re.compile(r'(W/)?"([^"]*)"')


def etag(revision: int | str) -> str:
    """Return the ETag of this state."""
    return f'"{revision}"'


def set_head(response: Response, body: T, *, tag: int | str | None = None, location: str = "") -> T:
    """Return the body; add the ETag of this state and the address of the new resource to the response."""
    response.headers.update(({} if tag is None else {"ETag": etag(tag)}) | ({"Location": location} if location else {}))
    return body


def require_match(request: Request, revision: int | str) -> None:
    """Refuse a change that is based on another state. Raises `precondition_required`, `precondition_failed`."""
    given = request.headers.get("if-match")
    if given is None:
        raise ApiError("precondition_required", "If-Match is missing; send the ETag of your last read")
    if given.strip() != "*" and ("", str(revision)) not in TAG.findall(given):
        raise ApiError(
            "precondition_failed",
            f"If-Match is {given[:80]} but the resource is at {etag(revision)}; read it again and retry",
        )


def is_unchanged(request: Request, revision: int | str) -> bool:
    """Return whether the reader has this state already; the response is then 304 with the ETag and no body."""
    given = request.headers.get("if-none-match", "")
    return given.strip() == "*" or str(revision) in (tag for _, tag in TAG.findall(given))
