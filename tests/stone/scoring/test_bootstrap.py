"""Draws are those of plain loops; intervals behave as intervals do."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.bootstrap import (
    BootstrapOptions,
    block_lengths,
    block_replicates,
    block_starts,
    interval,
    sequence_replicates,
)
from stone.scoring.confusion import iou_occupied, ratios
from stone.scoring.metric import RATIOS

Counts = NDArray[np.int64]


def counts_of(seed: int, frames: int) -> Counts:
    return np.random.default_rng(seed).integers(0, 1000, (frames, 4, 4))


def plain_block_draws(confusions: Counts, frames_of_sequence: list[int], options: BootstrapOptions) -> Counts:
    """The oracle: frame by frame, in loops; the random numbers are drawn in the same order."""
    random = np.random.default_rng(options.seed)
    replicates, first = np.zeros((options.replicates, 4, 4), np.int64), 0
    for frames in frames_of_sequence:
        lengths = block_lengths(frames, options.block_frames)
        starts = block_starts(random, frames, len(lengths), options.replicates)
        for replicate, block in product(range(options.replicates), range(len(lengths))):
            for step in range(lengths[block]):
                replicates[replicate] += confusions[first + (starts[replicate, block] + step) % frames]
        first += frames
    return replicates


MEAN = RATIOS.index("miou")
LENGTHS = st.lists(st.integers(1, 23), min_size=1, max_size=4)


@settings(max_examples=40, deadline=None)
@given(LENGTHS, st.integers(1, 9), st.integers(0, 99))
def test_block_draws_are_those_of_plain_loops(lengths: list[int], block_frames: int, seed: int) -> None:
    options = BootstrapOptions(replicates=7, block_frames=block_frames, seed=seed)
    confusions = counts_of(seed, sum(lengths))
    np.testing.assert_array_equal(
        block_replicates(confusions, lengths, options), plain_block_draws(confusions, lengths, options)
    )


def test_sequence_draws_are_every_combination_when_few() -> None:
    lengths, confusions = [2, 1, 3], counts_of(5, 6)
    parts = [confusions[:2].sum(0), confusions[2:3].sum(0), confusions[3:].sum(0)]
    expected = [parts[a] + parts[b] + parts[c] for a, b, c in product(range(3), repeat=3)]
    np.testing.assert_array_equal(sequence_replicates(confusions, lengths), expected)


def test_sequence_draws_are_random_but_repeatable_when_many() -> None:
    confusions, options = counts_of(5, 9), BootstrapOptions(replicates=50, seed=3)
    replicates = sequence_replicates(confusions, [1] * 9, options)
    assert replicates.shape == (50, 4, 4)
    np.testing.assert_array_equal(replicates, sequence_replicates(confusions, [1] * 9, options))
    assert (replicates != sequence_replicates(confusions, [1] * 9, BootstrapOptions(replicates=50, seed=4))).any()


@settings(max_examples=20, deadline=None)
@given(LENGTHS, st.integers(1, 9))
def test_frames_all_alike_have_no_spread(lengths: list[int], block_frames: int) -> None:
    confusions = np.broadcast_to(np.arange(16).reshape(4, 4), (sum(lengths), 4, 4))
    replicates = block_replicates(confusions, lengths, BootstrapOptions(replicates=5, block_frames=block_frames))
    np.testing.assert_array_equal(replicates, np.broadcast_to(confusions.sum(axis=0), (5, 4, 4)))


def test_submissions_together_see_the_draws_they_see_alone() -> None:
    both = np.stack([counts_of(1, 30), counts_of(2, 30)])
    options = BootstrapOptions(replicates=20, block_frames=4)
    for replicate in (block_replicates, sequence_replicates):
        together = replicate(both, [10, 20], options)
        np.testing.assert_array_equal(together, [replicate(one, [10, 20], options) for one in both])


def test_correlated_frames_need_blocks_for_an_honest_width() -> None:
    """Frames that change only every 50: single-frame draws are too narrow by about √50."""
    confusions = np.repeat(counts_of(0, 40), 50, axis=0)
    widths = []
    for block_frames in (1, 100):
        options = BootstrapOptions(replicates=500, block_frames=block_frames)
        found = interval(ratios(block_replicates(confusions, [2000], options))[:, MEAN], options)
        assert found is not None
        widths.append(found[1] - found[0])
    assert 4 < widths[1] / widths[0] < 12


def test_the_interval_holds_the_score_and_widens_with_its_level() -> None:
    confusions = counts_of(0, 400)
    score, found = float(iou_occupied(confusions.sum(axis=0))), []
    for level in (0.5, 0.95):
        options = BootstrapOptions(replicates=400, block_frames=5, level=level)
        low, high = interval(iou_occupied(block_replicates(confusions, [400], options)), options) or (1.0, 0.0)
        assert low < score < high
        found.append(high - low)
    assert found[0] < found[1]


def test_the_interval_of_an_undefined_ratio_is_none() -> None:
    confusions = np.zeros((10, 4, 4), np.int64)
    confusions[:, 0, 0] = 5
    assert interval(iou_occupied(block_replicates(confusions, [10], BootstrapOptions(replicates=3)))) is None


def test_lengths_that_do_not_add_up_are_refused() -> None:
    for replicate in (block_replicates, sequence_replicates):
        with pytest.raises(ShapeError, match="confusions has shape"):
            replicate(counts_of(0, 10), [4, 5])
        with pytest.raises(ShapeError, match="at least one frame"):
            replicate(counts_of(0, 0), [])
