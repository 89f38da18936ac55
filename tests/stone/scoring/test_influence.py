"""Influences are the derivative of the ratios by each frame's weight, and nothing in sum."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.confusion import ratios
from stone.scoring.influence import frame_influences
from stone.scoring.metric import METRICS, RATIOS

Counts = NDArray[np.int64]


def counts_of(seed: int, frames: int, most: int = 1000) -> Counts:
    return np.random.default_rng(seed).integers(1, most, (frames, 4, 4))


def slow_influences(confusions: Counts, metric: str) -> NDArray[np.float64]:
    """The oracle: the ratios when one frame counts a little more, in exact fractions of a large count."""
    scale, step = 10**6, 10
    total = confusions.sum(axis=0) * scale
    more = ratios(total + step * confusions, metric) - ratios(total - step * confusions, metric)
    return more * scale / (2 * step)


@pytest.mark.parametrize("metric", METRICS)
@given(seed=st.integers(0, 99), frames=st.integers(1, 12))
def test_an_influence_is_what_a_little_more_of_the_frame_moves_the_ratio_by(
    metric: str, seed: int, frames: int
) -> None:
    confusions = counts_of(seed, frames)
    found = frame_influences(confusions, metric).of_frame
    np.testing.assert_allclose(found, slow_influences(confusions, metric), rtol=1e-4, atol=1e-8)


@given(st.integers(0, 99), st.integers(1, 20))
def test_influences_sum_to_nothing_and_weights_to_one(seed: int, frames: int) -> None:
    found = frame_influences(counts_of(seed, frames))
    np.testing.assert_allclose(found.of_frame.sum(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(found.weight.sum(axis=0), 1)


def test_a_ratio_whose_union_is_empty_has_no_influence_and_neither_has_the_mean() -> None:
    confusions = counts_of(1, 5)
    confusions[:, 2] = confusions[:, :, 2] = 0
    found = dict(zip(RATIOS, frame_influences(confusions).of_frame.T, strict=True))
    assert np.isnan(found["iou_p"]).all()
    assert np.isnan(found["miou"]).all()
    assert np.isfinite(found["iou_t"]).all()


def test_other_shapes_and_no_frame_are_refused() -> None:
    for wrong in (np.zeros((0, 4, 4), np.int64), np.zeros((4, 4), np.int64)):
        with pytest.raises(ShapeError, match="at least one frame"):
            frame_influences(wrong)
