"""Sums over sequences add up whichever way they are looked at, and the words of a dataset are refused by name."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.errors import StoneError
from stone.splits.composition import composition_of, path_length_m, sums_of
from stone.splits.surroundings import (
    BadRegionError,
    UnknownEnvironmentError,
    UnknownIlluminationError,
    checked_environment,
    checked_illumination,
    checked_region,
)
from tests.stone.catalogues import catalogue, entry, shuffled


@given(st.integers(0, 10**6), st.integers(0, 20))
def test_every_way_of_dividing_adds_to_the_whole(seed: int, sequences: int) -> None:
    entries = catalogue(sequences, seed)
    composition = composition_of(shuffled(entries, seed))
    for tallies in (composition.environments, composition.illuminations, composition.halves, composition.regions,
                    composition.cells):  # fmt: skip
        for name in ("sequences", "frames", "counted", "measured"):
            assert sum(getattr(t, name) for t in tallies.values()) == getattr(composition.total, name)
        assert tuple(map(sum, zip((0, 0, 0), *(t.voxels for t in tallies.values()), strict=True))) == (
            composition.total.voxels
        )
        assert sum(t.duration_s for t in tallies.values()) == pytest.approx(composition.total.duration_s)
    assert composition == composition_of(entries)


def test_what_is_not_known_is_not_added() -> None:
    tally = sums_of([entry(1), entry(2, voxels=None, distance_m=None)])
    assert (tally.sequences, tally.counted, tally.measured) == (2, 1, 1)
    assert (tally.voxels, tally.distance_m) == ((100, 200, 700), 120.0)
    assert tally.class_shares() == (0.1, 0.2, 0.7)


def test_nothing_has_no_shares() -> None:
    assert sums_of([]).class_shares() is None


def test_keys_come_in_the_order_of_the_words_and_what_was_not_said_last() -> None:
    entries = [entry(n, environment=word) for n, word in enumerate(["", "moon", "lake", "farmland"])]
    assert list(composition_of(entries).environments) == ["farmland", "lake", "moon", ""]


@given(st.integers(0, 6), st.floats(-3.0, 3.0))
def test_the_way_is_as_long_however_the_world_is_turned(points: int, yaw: float) -> None:
    positions = np.random.default_rng(points).normal(size=(points, 3))
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    slowly = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(positions))
    assert path_length_m(positions @ turn.T + 5.0) == pytest.approx(slowly)


@pytest.mark.parametrize("word", ["", "farmland", "mountain", "lake", "construction"])
def test_the_papers_environments_are_words(word: str) -> None:
    assert checked_environment(word) == word


@pytest.mark.parametrize(
    ("check", "word", "refusal", "names"),
    [
        (checked_environment, "forest", UnknownEnvironmentError, "farmland, mountain, lake, construction"),
        (checked_illumination, "Day", UnknownIlluminationError, "day, sunny, overcast, dawn, dusk, night"),
        (checked_region, "Gyeong gi", BadRegionError, "use a dash"),
        (checked_region, "x" * 65, BadRegionError, "1 to 64"),
        (checked_region, "../x", BadRegionError, "beginning with a letter"),
    ],
)
def test_other_words_are_refused_with_what_is_allowed(
    check: object, word: str, refusal: type[StoneError], names: str
) -> None:
    with pytest.raises(refusal, match=names):
        check(word)  # type: ignore[operator]
