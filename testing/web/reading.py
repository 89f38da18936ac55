"""Pages as bytes over HTTP, for any user, without a browser."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import unescape

import httpx

from services.runtime.platform import Platform
from testing.api.serving import Person, serving
from testing.web.signed_in import cookie
from web.main import make_site

HIDDEN = re.compile(r"<(script|style|template)\b.*?</\1>", re.DOTALL)


@dataclass(frozen=True)
class Reading:
    """The site of a platform, requested as a browser does; `who` is None for a visitor."""

    platform: Platform
    client: httpx.Client

    def answer(self, path: str, who: Person | None = None) -> httpx.Response:
        return self.client.get(path, headers={"Accept": "text/html", **cookie(self.platform, who)})

    def status(self, path: str, who: Person | None = None) -> int:
        return self.answer(path, who).status_code

    def html(self, path: str, who: Person | None = None) -> str:
        answer = self.answer(path, who)
        assert answer.status_code == 200, f"{path}: {answer.status_code} {answer.text[:300]}"
        return answer.text

    def text(self, path: str, who: Person | None = None) -> str:
        """Return the text of the page's content, without tags."""
        shown = HIDDEN.sub(" ", self.html(path, who).partition("<main")[2].partition("</main>")[0])
        return " ".join(unescape(re.sub(r"<[^>]*>", " ", "<main" + shown)).split())


@contextmanager
def reading_of(platform: Platform) -> Iterator[Reading]:
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url, timeout=300.0) as client:
        yield Reading(platform, client)
