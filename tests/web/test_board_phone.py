"""The board on a phone: the method's name stays while the row is pushed aside, in the row's own colour."""

import pytest

from testing.web.browsing import PHONE, Site
from tests.web.boards_world import season

BACKGROUNDS = """row => [...row.querySelectorAll("th.method, td.number")].slice(0, 2).map(cell => {
  for (let one = cell; one; one = one.parentElement) {
    const colour = getComputedStyle(one).backgroundColor;
    if (!/, 0\\)$/.test(colour)) return colour;
  }
})"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_sticky_cell_is_highlighted_with_its_row(site: Site, scheme: str) -> None:
    """Catches alone a highlight that stops at the cell which stays in view."""
    board = season(site.platform)
    with site.visit(board.member, color_scheme=scheme, viewport=PHONE) as page:
        page.goto(board.path)
        plain = page.locator("tbody[data-standing='ranked'] tr:not(.is-yours)").last
        yours = page.locator("tr.is-yours").first
        resting = plain.evaluate(BACKGROUNDS)
        plain.locator(".method").hover()
        hovered, own = plain.evaluate(BACKGROUNDS), yours.evaluate(BACKGROUNDS)
        assert [len(set(cells)) for cells in (resting, hovered, own)] == [1, 1, 1], (resting, hovered, own)
        assert len({resting[0], hovered[0], own[0]}) == 3
