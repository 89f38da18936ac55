"""The class colours of the pages, and of everything else that is drawn: one source."""

import re
from pathlib import Path

import pytest

from services.domain.viewer.frame_picture import DIFFERENCE_RGB, GREY, GREY_ALPHA, SAME_ALPHA
from stone.labels.class_colours import PALETTES, ColourName, hex_of
from stone.scoring.agreement import EASIER, HARDER, ONLY_A, ONLY_B, SAME

ROOT = Path(__file__).parents[2]
TOKENS = (ROOT / "web" / "styles" / "tokens.css").read_text()


def tokens_of(rule: str) -> dict[str, str]:
    """The tokens that the first rule with this selector sets."""
    block = TOKENS.split(rule + " {", 1)[1].split("}", 1)[0]
    return dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", block))


@pytest.mark.parametrize(("rule", "name"), [(":root", "default"), (':root[data-colours="paper"]', "paper")])
def test_the_pages_have_the_class_colours_of_the_pictures(rule: str, name: ColourName) -> None:
    tokens = tokens_of(rule)
    assert [tokens[letter] for letter in "tpn"] == [hex_of(colour) for colour in PALETTES[name].values()]


def test_a_dark_page_keeps_the_default_colours() -> None:
    """Catches alone a second triple for the dark theme, which pictures would not have."""
    assert not {"t", "p", "n"} & tokens_of(':root[data-theme="dark"]').keys()


def test_the_light_page_has_the_difference_colours_of_the_pictures() -> None:
    tokens = tokens_of(":root")
    names = {SAME: "same", ONLY_A: "only-a", ONLY_B: "only-b", EASIER: "easier", HARDER: "harder"}
    assert {name: tokens[name] for name in names.values()} == {
        name: hex_of(DIFFERENCE_RGB[code]) for code, name in names.items()
    }


def test_a_legend_beside_pictures_has_their_colours_on_a_dark_page_too() -> None:
    """Catches alone a legend in the dark theme's own colours beside a picture that has none of them."""
    tokens, paper = tokens_of(".of-pictures"), tokens_of(':root[data-colours="paper"] .of-pictures')
    names = {ONLY_A: "only-a", ONLY_B: "only-b", EASIER: "easier", HARDER: "harder"}
    assert tokens == {name: hex_of(DIFFERENCE_RGB[code]) for code, name in names.items()}
    assert [paper[letter] for letter in "tpn"] == [hex_of(colour) for colour in PALETTES["paper"].values()]
    for name, alpha in (("unseen", GREY_ALPHA), ("same", SAME_ALPHA)):
        assert f"--{name}: rgb({' '.join(map(str, GREY))} / {100 * alpha / 255:.0f}%)" in TOKENS
    legend = (ROOT / "web/templates/boards/entry.html").read_text().split("fill-easier")[0].rpartition("<ul")[2]
    assert legend.startswith(' class="legend of-pictures"')
