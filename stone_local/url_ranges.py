"""The bytes of a file behind an https URL, read by HTTP ranges: by the command alone, never by the platform.

**Conventions.** The file must not change while it is read: every answer must have the same ETag, or else modification
time. An answer without the requested range is refused, which prevents downloads of hundreds of gigabytes.

Source: RFC 9110, 13.1.5 (If-Range), 14 (range requests).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

import httpx

from stone_base.errors import Refused

TRIES, TIMEOUT_S = 4, 60.0
PARTIAL = 206
CONTENT_RANGE = re.compile(r"bytes (\d+)-(\d+)/(\d+)")
SCHEMES = ("https://", "http://")


@dataclass(frozen=True)
class UrlRanges:
    """The file at `url`; `made_of` is its size and validator from the first answer."""

    url: str
    made_of: tuple[int, str]
    client: httpx.Client = field(repr=False, compare=False)

    @property
    def path(self) -> Path:
        return Path(PurePosixPath(urlsplit(self.url).path).name or "dataset")

    @property
    def size_bytes(self) -> int:
        return self.made_of[0]

    def read_at(self, offset: int, count: int) -> bytes:
        """Return `count` bytes from `offset`. Raises `url_unreadable`, `url_changed`."""
        stop = min(offset + count, self.size_bytes)
        if stop <= offset:
            return b""
        content, made_of = _fetched(self.client, self.url, (offset, stop))
        if made_of != self.made_of:
            raise Refused("url_changed", f"{self.url} changed while it was read; check it again")
        return content

    def identity(self) -> list[str | int]:
        return [self.url, *self.made_of]


def is_url(text: str) -> bool:
    """Return whether the text is a URL rather than a path."""
    return text.startswith(SCHEMES)


def open_url(url: str, transport: httpx.BaseTransport | None = None) -> UrlRanges:
    """Return the file at a URL whose server supports ranges. Raises `url_unreadable`."""
    client = httpx.Client(timeout=TIMEOUT_S, follow_redirects=True, transport=transport)
    _, made_of = _fetched(client, url, (0, 1))
    return UrlRanges(url, made_of, client)


def _fetched(client: httpx.Client, url: str, span: tuple[int, int]) -> tuple[bytes, tuple[int, str]]:
    """Return the bytes [start, stop), and the size and the identity of the file."""
    why = ""
    for _ in range(TRIES):
        try:
            with client.stream("GET", url, headers={"Range": f"bytes={span[0]}-{span[1] - 1}"}) as answer:
                if answer.status_code < 500:
                    size_bytes = _answered_range(url, answer.status_code, answer.headers, span)
                    content = answer.read()
                    if len(content) == span[1] - span[0]:
                        stamp = answer.headers.get("ETag") or answer.headers.get("Last-Modified", "")
                        return content, (size_bytes, stamp)
                why = f"status {answer.status_code}"
        except httpx.HTTPError as error:
            why = str(error) or type(error).__name__
    raise Refused("url_unreadable", f"{url} cannot be read: {why[:200]}; is it reachable?")


def _answered_range(url: str, status: int, headers: Mapping[str, str], span: tuple[int, int]) -> int:
    """Return the size of the whole file, if the answer has this range. Raises `url_unreadable`."""
    match = CONTENT_RANGE.fullmatch(headers.get("Content-Range", ""))
    if status != PARTIAL or match is None or (int(match[1]), int(match[2]) + 1) != span:
        what = f"status {status}, {headers.get('Content-Range', 'no Content-Range')!r}"
        raise Refused("url_unreadable", f"{url} did not answer the range that was requested ({what[:120]})")
    if headers.get("Content-Encoding", "identity") != "identity":
        raise Refused("url_unreadable", f"{url} was answered in another encoding than its own bytes")
    return int(match[3])
