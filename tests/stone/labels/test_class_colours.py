import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from stone.labels.class_colours import CLASS_RGB, INK, PALETTES, PAPER, TRACK, UNSEEN, hex_of
from testing.colour_vision import VISIONS, ciede2000, difference, least_difference, least_of_pairs

PAIRS = list(combinations((1, 2, 3), 2))
DARK_PAPER = (20, 23, 27)  # --paper of a dark page

# Sharma, Wu and Dalal 2005, table 1, pairs 1, 17, 18, 19, 20, 21 and 34: L*, a*, b* twice, and the difference.
SHARMA = [
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((50, 2.5, 0), (61, -5, 29), 22.8977),
    ((50, 2.5, 0), (56, -27, -3), 31.9030),
    ((50, 2.5, 0), (58, 24, 15), 19.4535),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


@pytest.mark.parametrize(("a", "b", "published"), SHARMA)
def test_the_difference_of_colours_is_the_published_one(
    a: tuple[float, ...], b: tuple[float, ...], published: float
) -> None:
    assert float(ciede2000(a, b)) == pytest.approx(published, abs=5e-5)
    assert float(ciede2000(b, a)) == pytest.approx(published, abs=5e-5)


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_any_two_classes_differ_by_at_least_40_in_every_vision(one: int, other: int, vision: str) -> None:
    """Catches alone a class colour that one of the three dichromacies takes for another class."""
    assert difference(CLASS_RGB[one], CLASS_RGB[other], vision) >= 40


def test_the_paper_s_colours_are_no_default_since_deuteranopia_mixes_t_and_n() -> None:
    paper = PALETTES["paper"]
    assert difference(paper[1], paper[3], "deuteranopia") == pytest.approx(14.8, abs=0.1)


@pytest.mark.parametrize("ground", [PAPER, UNSEEN, DARK_PAPER])
def test_each_class_stands_out_from_what_it_lies_on(ground: tuple[int, int, int]) -> None:
    assert min(least_difference(colour, ground) for colour in CLASS_RGB.values()) >= 14


@pytest.mark.parametrize("mark", [TRACK, INK])
def test_the_track_and_the_robot_are_seen_on_every_class(mark: tuple[int, int, int]) -> None:
    """Catches alone a blue track on blue labels (CIEDE2000 16), as it was."""
    assert min(least_difference(colour, mark) for colour in CLASS_RGB.values()) >= 18


def test_no_colour_stands_for_two_classes_in_any_palette() -> None:
    """A stored mesh is read by its colours, of whichever palette it has."""
    classes = {(colour, kind) for palette in PALETTES.values() for kind, colour in palette.items()}
    assert len({colour for colour, _ in classes}) == len(classes)


def test_a_colour_is_written_as_six_digits() -> None:
    assert hex_of((4, 0, 255)) == "#0400ff"


def test_lit_and_shaded_colours_are_compared_with_each_other() -> None:
    """An oracle in loops for the one that works on arrays."""
    lights = (0.7, 1.0, 1.2)
    slow = min(
        difference(np.clip(np.multiply(CLASS_RGB[i], x), 0, 255), np.clip(np.multiply(CLASS_RGB[j], y), 0, 255), vision)
        for vision in VISIONS
        for i, j in PAIRS
        for x in lights
        for y in lights
    )
    assert least_of_pairs(list(CLASS_RGB.values()), lights) == pytest.approx(slow)


def test_the_docs_site_has_the_default_colours() -> None:
    sheet = (Path(__file__).parents[3] / "docs" / "stylesheets" / "site.css").read_text()
    written = dict(re.findall(r"^\.([tpn]) \{.*(#[0-9a-f]{6})", sheet, re.MULTILINE))
    assert written == {name: hex_of(CLASS_RGB[kind]) for kind, name in enumerate("tpn", 1)}
