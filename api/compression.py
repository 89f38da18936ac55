"""Answers with the tag of their bytes, compressed for who takes that.

**Conventions.** Only what holds no secret and repeats nothing that the request says is compressed (lists and boards):
beside a secret, the length would tell how much of a guess is right (BREACH). So pages, which hold the CSRF token, are
not; event streams are not either, which must not wait for more. The tag of the compressed form is another one, as it is
of other bytes (RFC 9110 §8.8.3.3); either is taken for what the reader has.
"""

import gzip
from collections.abc import Mapping
from hashlib import sha256

from fastapi import Request, Response

from api.etags import etag, is_unchanged

LEAST_BYTES = 1024  # less fits into a packet as it is
LEVEL = 1  # 24.4 kB of a list become 3.3; at level 6, for half as much time again, 3.0
ZIPPED = "-gzip"


def takes_gzip(request: Request) -> bool:
    """Whether the client says that it reads gzip (RFC 9110 §12.5.3)."""
    offered = request.headers.get("accept-encoding", "").lower().replace(" ", "").split(",")
    return any(one == "gzip" or (one.startswith("gzip;q=") and one.strip("0.") != "gzip;q=") for one in offered)


def tagged_response(
    request: Request, content: bytes, media_type: str, headers: Mapping[str, str] | None = None
) -> Response:
    """The content, or 304 to who has it already."""
    tag, is_zipped = sha256(content).hexdigest(), len(content) >= LEAST_BYTES and takes_gzip(request)
    told = {"ETag": etag(f"{tag}{ZIPPED}" if is_zipped else tag), "Vary": "Accept-Encoding", **(headers or {})}
    if is_unchanged(request, tag) or is_unchanged(request, f"{tag}{ZIPPED}"):
        return Response(status_code=304, headers=told)
    if not is_zipped:
        return Response(content, headers=told, media_type=media_type)
    zipped = gzip.compress(content, LEVEL, mtime=0)
    return Response(zipped, headers=told | {"Content-Encoding": "gzip"}, media_type=media_type)
