"""All pages that links lead to from the first page on.

**Conventions.** The crawler follows links, forms' actions and pictures of the site itself, each *shape* (ids and names
replaced) only a few times. It sends only GET, so it changes nothing, and never signs out.
"""

import re
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import unescape
from urllib.parse import urljoin, urlsplit

import httpx

LINK = re.compile(r'(?:(?:href|src|hx-get)="|data-source="(?=/))([^"]+)"')
ID = re.compile(r"(?<=/)[0-9a-f]{32}(?=/|$)|(?<=/)[0-9a-f]{16}(?=/)|(?<=^/codes/)[A-Za-z0-9_-]+$")
ELSEWHERE = "/docs/"  # the manual has its own tests
EACH_SHAPE = 3
MOST_PAGES = 400


@dataclass(frozen=True)
class Found:
    """The target of a link; `source` is the page that contains it."""

    path: str
    shape: str
    source: str
    status: int
    html: str
    """The HTML of a page; empty for other files."""

    @property
    def is_page(self) -> bool:
        return self.status == 200 and self.html != ""


def crawled(client: httpx.Client, headers: Mapping[str, str], start: str = "/") -> Iterator[Found]:
    """Yield everything reachable from `start` with these headers."""
    waiting, known, shapes = deque([(start, "")]), {start}, Counter[str]()
    while waiting and len(known) < MOST_PAGES * 5:
        path, source = waiting.popleft()
        shape = shape_of(path)
        shapes[shape] += 1
        if shapes[shape] > EACH_SHAPE:
            continue
        with client.stream("GET", path, headers={"Accept": "text/html, */*", **headers}) as answer:
            is_page = answer.headers.get("content-type", "").startswith("text/html")
            text = "".join(answer.iter_text()) if is_page else ""
            yield Found(path, shape, source, answer.status_code, text)
            if not is_page:
                continue
        for link in links(path, text):
            if link not in known:
                known.add(link)
                waiting.append((link, path))


def links(path: str, text: str) -> Iterator[str]:
    """Yield the paths of this site that the page names."""
    for raw in LINK.findall(text):
        parts = urlsplit(urljoin(f"http://site{path}", unescape(raw)))
        is_ours = parts.netloc == "site" and parts.scheme == "http" and not parts.path.startswith(ELSEWHERE)
        if is_ours and not parts.path.endswith("/events"):
            yield f"{parts.path}?{parts.query}" if parts.query else parts.path


def shape_of(path: str) -> str:
    """Return the path with ids replaced, and only the names of its query."""
    parts = urlsplit(path)
    names = sorted({pair.partition("=")[0] for pair in parts.query.split("&") if pair})
    return ID.sub("{id}", parts.path) + ("?" + "&".join(names) if names else "")
