"""Errors of the tus protocol, raised before any byte of the body is read."""

from api.errors import ApiError

VERSION = "1.0.0"


def unsupported_media_type(given: str, expected: str) -> ApiError:
    return ApiError("unsupported_media_type", f"Content-Type is {given[:80]!r}; expected {expected}")
