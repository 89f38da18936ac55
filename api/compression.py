"""Responses with an ETag, compressed for clients that accept gzip.

**Conventions.** Only responses without secrets and without text from the request are compressed (lists and boards):
beside a secret, the compressed length would reveal guesses (BREACH). Pages contain the CSRF token and stay
uncompressed, as do event streams, which must not be buffered. The compressed form has its own ETag (RFC 9110 §8.8.3.3);
`If-None-Match` may name either.
"""

import gzip
from collections.abc import Mapping
from hashlib import sha256

from fastapi import Request, Response

from api.etags import etag, is_unchanged

LEAST_BYTES = 1024  # less fits into one packet uncompressed
LEVEL = 1  # compresses 24.4 kB of a list to 3.3 kB; level 6 takes 50 % more time for 3.0 kB
ZIPPED = "-gzip"


def takes_gzip(request: Request) -> bool:
    """Return whether the client accepts gzip (RFC 9110 §12.5.3)."""
    offered = request.headers.get("accept-encoding", "").lower().replace(" ", "").split(",")
    return any(
        coding == "gzip" or (coding.startswith("gzip;q=") and coding.strip("0.") != "gzip;q=") for coding in offered
    )


def tagged_response(
    request: Request, content: bytes, media_type: str, headers: Mapping[str, str] | None = None
) -> Response:
    """Return the content, or 304 if the client's copy is current."""
    tag, is_zipped = sha256(content).hexdigest(), len(content) >= LEAST_BYTES and takes_gzip(request)
    response_headers = {
        "ETag": etag(f"{tag}{ZIPPED}" if is_zipped else tag),
        "Vary": "Accept-Encoding",
        **(headers or {}),
    }
    if is_unchanged(request, tag) or is_unchanged(request, f"{tag}{ZIPPED}"):
        return Response(status_code=304, headers=response_headers)
    if not is_zipped:
        return Response(content, headers=response_headers, media_type=media_type)
    zipped = gzip.compress(content, LEVEL, mtime=0)
    return Response(zipped, headers=response_headers | {"Content-Encoding": "gzip"}, media_type=media_type)
