"""Draws of two submissions are the same resamplings; intervals say nothing where resampling changes nothing."""

import io

import numpy as np
import pytest
from numpy.typing import NDArray

from services.eval.bootstrap_replicates import OPTIONS, ScoreReplicates, intervals_of, ratio_replicates
from stone.errors import ShapeError
from stone.scoring.bootstrap import block_lengths, block_starts
from stone.scoring.confusion import ratios
from stone.scoring.metric import METRIC_VERSION, METRICS, OCCUPIED_VERSION, RATIOS

LENGTHS = (410, 90, 230)
Confusions = NDArray[np.int32]


def confusions_of(seed: int, frames: int = sum(LENGTHS)) -> Confusions:
    return np.random.default_rng(seed).integers(1, 10_000, (frames, 3, 4, 4)).astype(np.int32)


def slow_draw(confusions: Confusions, replicate: int, metric: str) -> NDArray[np.float64]:
    """One block draw, frame by frame, by the documented seed."""
    random, total, first = np.random.default_rng(0), np.zeros((4, 4), np.int64), 0
    for frames in LENGTHS:
        lengths = block_lengths(frames, 200)
        starts = block_starts(random, frames, len(lengths), 4000)[replicate]
        for start, length in zip(starts, lengths, strict=True):
            for step in range(length):
                total += confusions[first + (start + step) % frames].sum(axis=0)
        first += frames
    return ratios(total, metric)


@pytest.mark.parametrize("metric", METRICS)
def test_a_draw_is_the_ratios_of_whole_blocks(metric: str) -> None:
    confusions = confusions_of(1)
    replicates = ratio_replicates(confusions, LENGTHS, metric)
    assert (replicates.block.shape, replicates.block.dtype) == ((4000, 5), np.float32)
    for replicate in (0, 1, 3999):
        np.testing.assert_array_equal(
            replicates.block[replicate], slow_draw(confusions, replicate, metric).astype(np.float32)
        )


def test_sequence_draws_are_every_combination_of_few_sequences() -> None:
    confusions = confusions_of(2)
    replicates = ratio_replicates(confusions, LENGTHS).sequence
    assert replicates.shape == (3**3, 5)
    np.testing.assert_array_equal(replicates[0], ratios(3 * confusions[:410].sum((0, 1), np.int64)).astype(np.float32))
    assert ratio_replicates(confusions_of(2, 12), [1] * 12).sequence.shape == (4000, 5)


def test_draws_of_two_submissions_are_paired() -> None:
    """A prediction that is better in every frame is better in every draw, though each alone varies more than that."""
    worse = confusions_of(3)
    better = worse.copy()
    better[..., 1, 1] += worse[..., 1, 2] // 50
    better[..., 1, 2] -= worse[..., 1, 2] // 50
    one, other = (
        ratio_replicates(confusions, LENGTHS).block[:, RATIOS.index("iou_t")] for confusions in (worse, better)
    )
    assert (other > one).all()
    assert one.max() > other.min()


def test_the_file_is_the_draws_and_always_the_same() -> None:
    confusions = confusions_of(4)
    replicates = ratio_replicates(confusions, LENGTHS, METRIC_VERSION)
    file = replicates.npz()
    assert (
        file
        == ratio_replicates(confusions, LENGTHS).npz()
        != ratio_replicates(confusions, LENGTHS, OCCUPIED_VERSION).npz()
    )
    with np.load(io.BytesIO(file)) as arrays:
        assert sorted(arrays) == ["block", "sequence"]
        np.testing.assert_array_equal(arrays["block"], replicates.block)
        np.testing.assert_array_equal(arrays["sequence"], replicates.sequence)


def test_intervals_hold_the_score_and_nearly_all_draws() -> None:
    confusions = confusions_of(5)
    replicates = ratio_replicates(confusions, LENGTHS)
    score = dict(zip(RATIOS, ratios(confusions.sum((0, 1), np.int64)).tolist(), strict=True))
    for kind, of_kind in (("block", replicates.block), ("sequence", replicates.sequence)):
        for column, (name, interval) in enumerate(intervals_of(replicates, LENGTHS)[kind].items()):
            assert interval is not None
            assert interval[0] < score[name] < interval[1]
            inside = (of_kind[:, column] >= interval[0]) & (of_kind[:, column] <= interval[1])
            assert inside.mean() == pytest.approx(OPTIONS.level, abs=0.06)


def test_intervals_are_none_where_nothing_can_be_resampled() -> None:
    of_kind = ScoreReplicates(np.full((9, 5), 0.5, np.float32), np.full((1, 5), 0.5, np.float32))
    nothing = dict.fromkeys(RATIOS)
    assert intervals_of(of_kind, [200]) == {"block": nothing, "sequence": nothing}
    assert intervals_of(of_kind, [201])["block"]["miou"] == [0.5, 0.5]
    assert intervals_of(of_kind, [9, 9])["sequence"]["miou"] == [0.5, 0.5]


def test_a_ratio_undefined_in_one_draw_has_no_interval() -> None:
    block = np.full((9, 5), 0.5, np.float32)
    block[3, 4] = np.nan
    found = intervals_of(ScoreReplicates(block, block), [300])["block"]
    assert (found["miou"], found["iou_n"]) == (None, [0.5, 0.5])


def test_lengths_that_do_not_add_up_are_refused() -> None:
    with pytest.raises(ShapeError, match="confusions has shape"):
        ratio_replicates(confusions_of(0, 9), [4, 4])
