"""Parts of all pages: the menu's place, crumbs, drawn icons, and the page of an address that does not exist."""

import re
from pathlib import Path

import pytest

from testing.api.serving import Person
from testing.web.browsing import Site
from testing.web.reading import Reading
from tests.web.looking import look

WEB = Path(__file__).resolve().parents[2] / "web"
NO_GLYPH = "⧉◐"
"""Signs that common fonts lack: a box, or nothing, stands in their place."""


def test_icons_are_drawn() -> None:
    for folder, ending in (("templates", "html"), ("modules", "ts"), ("styles", "css")):
        for path in (WEB / folder).rglob(f"*.{ending}"):
            assert not set(NO_GLYPH) & set(path.read_text("utf-8")), path


@pytest.mark.parametrize(
    ("path", "title"), [("/calibrations", "Sequences"), ("/imports", "Sequences"), ("/teams", "Submissions")]
)
def test_the_menu_keeps_its_place(reading: Reading, curator: Person, path: str, title: str) -> None:
    html = reading.html(path, curator)
    assert re.findall(r'<a href="[^"]*" aria-current="page">([^<]+)</a></li>', html.split("</header>")[0]) == [title]


def test_every_page_above_is_named_in_one_way() -> None:
    for path in (WEB / "templates").rglob("*.html"):
        assert not re.search(r'class="eyebrow"><a', path.read_text("utf-8")), path


def test_a_mistyped_address_is_answered_for_people(site: Site) -> None:
    with site.visit(expected=["404"]) as page:
        page.goto("/sequencs")
        assert page.get_by_role("heading", name="This page does not exist").is_visible()
        assert "openapi" not in page.content()
        look(page, "no-such-page")
