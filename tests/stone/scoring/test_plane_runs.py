"""Planes come back from their runs bit by bit, and runs that fit nothing are refused."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.errors import ShapeError
from stone.scoring.bitplanes import COLUMNS, WORDS, Planes
from stone.scoring.plane_runs import CHANGES, PlaneRuns, planes_of, runs_of


def patchy(seed: int, change_ratio: float) -> Planes:
    """Planes whose columns change at about this share of places."""
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 2**32, 3 * COLUMNS, np.uint32)
    starts = np.maximum.accumulate(np.where(rng.random(3 * COLUMNS) < change_ratio, np.arange(3 * COLUMNS), 0))
    return values[starts].view(np.uint64).reshape(3, WORDS)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_planes_come_back_as_they_were(seed: int, change_ratio: float) -> None:
    planes = patchy(seed, change_ratio)
    runs = runs_of(planes)
    np.testing.assert_array_equal(planes_of(runs), planes)
    flat = planes.view(np.uint32).reshape(-1).tolist()
    assert len(runs.columns) == 1 + sum(here != before for before, here in pairwise(flat))


@pytest.mark.parametrize("word", [0, 2**64 - 1])
def test_planes_that_are_all_alike_are_one_run(word: int) -> None:
    runs = runs_of(np.full((3, WORDS), word, np.uint64))
    assert len(runs.columns) == 1
    assert (planes_of(runs) == np.uint64(word)).all()


def test_runs_that_do_not_fit_are_refused_before_anything_is_read() -> None:
    runs = runs_of(patchy(0, 0.1))
    first = runs.changes.copy()
    first[0] &= ~np.uint64(1)
    everywhere = np.full(CHANGES, 2**64 - 1, np.uint64)
    with pytest.raises(ShapeError, match="columns has shape"):
        planes_of(PlaneRuns(everywhere, runs.columns))
    with pytest.raises(ShapeError, match="columns has shape"):
        planes_of(replace(runs, columns=runs.columns[1:]))
    for changes in (first, runs.changes[:-1]):
        with pytest.raises(ShapeError, match="changes has shape"):
            planes_of(replace(runs, changes=changes))
    with pytest.raises(ShapeError, match="planes has shape"):
        runs_of(np.zeros((2, WORDS), np.uint64))
