"""READMEs from other folders that are included in the site.

**Conventions.** Links between READMEs, and into `docs/`, become links between pages of the site; other links in the
repository become plain text.
"""

import posixpath
import re
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {
    "install/compose.md": "deploy/compose/README.md",
    "install/cluster.md": "deploy/kubernetes/README.md",
    "install/images.md": "deploy/images/README.md",
    "install/stand-ins.md": "deploy/stand-in/README.md",
}
LINK = re.compile(r"\[([^\]]+)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def included_pages() -> Mapping[str, str]:
    """Return the existing READMEs as Markdown by path."""
    there = {page: source for page, source in SOURCES.items() if (ROOT / source).exists()}
    return {page: relinked((ROOT / source).read_text("utf-8"), source, page) for page, source in there.items()}


def relinked(text: str, source: str, page: str) -> str:
    """Return the text of the file `source` as the page `page` of the site."""

    def led(match: re.Match[str]) -> str:
        words, link, fragment = match.group(1), match.group(2), match.group(3) or ""
        if "://" in link:
            return match.group(0)
        target = _page_of(posixpath.normpath(posixpath.join(posixpath.dirname(source), link)))
        return f"[{words}]({posixpath.relpath(target, posixpath.dirname(page))}{fragment})" if target else words

    return LINK.sub(led, text)


def _page_of(path: str) -> str:
    """Return the page of a file, or of a folder's README; the empty text if it is not in the site."""
    by_source = {source: page for page, source in SOURCES.items()}
    source_page = by_source.get(path) or by_source.get(f"{path}/README.md")
    return source_page or (path.removeprefix("docs/") if path.startswith("docs/") else "")
