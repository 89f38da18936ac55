"""The docs site, built once as `make docs` builds it, and its pages as a reader's browser takes them apart."""

import subprocess
import sys
from dataclasses import dataclass, field
from functools import cached_property
from html.parser import HTMLParser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@dataclass
class Page(HTMLParser):
    """What a page leads to, what it loads, and the places in it that may be led to."""

    path: Path
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    places: set[str] = field(default_factory=set)
    classes: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()
        self.feed(self.path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        said = {name: value or "" for name, value in attrs}
        self.places |= {said[name] for name in ("id", "name") if name in said}
        self.classes |= set(said.get("class", "").split())
        if tag == "a" and "href" in said:
            self.links.append(said["href"])
        elif tag == "link" and said.get("rel") not in ("canonical", "prev", "next", "alternate"):
            self.loaded.append(said.get("href", ""))
        elif "src" in said:
            self.loaded.append(said["src"])
        self.loaded += [one.split()[0] for one in said.get("srcset", "").split(",") if one.strip()]


@dataclass(frozen=True)
class Built:
    """The site's folder, and what was printed while it was built."""

    folder: Path
    printed: str

    @cached_property
    def pages(self) -> list[Page]:
        return [Page(path) for path in sorted(self.folder.rglob("*.html"))]


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    outcome = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True, timeout=300)
    assert outcome.returncode == 0, outcome.stderr[-4000:]
    return Built(folder, outcome.stderr)
