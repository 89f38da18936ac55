"""Verdicts on labels made from the truth itself."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator.verdict import GRID_MIN_M, VOXEL_M, LabelVerdict, judge_semantics
from stone.labels.grid import GRID_SHAPE
from tests.simulator.conftest import Recording


def exact_semantics(recording: Recording, stamp_ns: int) -> np.ndarray:
    """A voxel is occupied where the ground passes; 2 where drivable, 3 where not."""
    truth = recording.truth
    centres = (np.argwhere(np.ones((*GRID_SHAPE[:2], 8), bool)) + np.array([0.5, 0.5, 6.5])) * VOXEL_M + np.array(
        GRID_MIN_M
    )
    verdict = truth.judge(truth.map_from_ego(stamp_ns) @ centres)
    label = np.choose(verdict, [0, 2, 3]).astype(np.uint8)
    semantics = np.zeros(GRID_SHAPE, np.uint8)
    semantics[:, :, 6:14] = label.reshape(*GRID_SHAPE[:2], 8)
    return semantics


def judged(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> LabelVerdict:
    """Of two frames whose labels are exact until they are changed."""
    truth = recording.truth
    counts = [
        judge_semantics(
            change(exact_semantics(recording, stamp_ns)), truth.judge, truth.map_from_ego(stamp_ns).as_matrix()
        )
        for stamp_ns in truth.sweep_stamps_ns[:2].tolist()
    ]
    return LabelVerdict(len(counts), *np.sum(counts, axis=0).tolist())


def test_exact_labels_score_one(recording: Recording) -> None:
    verdict = judged(recording, lambda semantics: semantics)
    assert (verdict.frames, verdict.iou, verdict.precision, verdict.recall) == (2, 1.0, 1.0, 1.0)


def test_everything_traversable_scores_the_drivable_share(recording: Recording) -> None:
    verdict = judged(recording, lambda semantics: np.where(semantics > 0, 1, 0).astype(np.uint8))
    assert verdict.iou == pytest.approx(verdict.everything_iou)
    assert verdict.everything_iou < 0.8


def test_inverted_labels_score_zero(recording: Recording) -> None:
    assert judged(recording, lambda semantics: np.choose(semantics, [0, 0, 3, 2]).astype(np.uint8)).iou == 0.0


def test_without_support_there_is_no_score() -> None:
    empty = LabelVerdict(1, 0, 0, 0, 0)
    assert (empty.iou, empty.precision, empty.recall, empty.everything_iou) == (None, None, None, None)
    assert empty.as_record()["iou"] is None
