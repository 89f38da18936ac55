"""Verdicts on labels made from the truth itself."""

from pathlib import Path

import numpy as np
import pytest

from simulator.verdict import GRID_MIN_M, GRID_SHAPE, VOXEL_M, NoLabelsError, Verdict, judge_labels
from stone.errors import ShapeError
from stone.sequence import frame_token
from tests.simulator.conftest import Recording

SEQUENCE = "tiny"


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


def write_labels(recording: Recording, folder: Path, change) -> None:
    for stamp_ns in recording.truth.sweep_stamps_ns[:2].tolist():
        frame = folder / SEQUENCE / frame_token(SEQUENCE, stamp_ns)
        frame.mkdir(parents=True)
        np.savez(frame / "labels.npz", semantics=change(exact_semantics(recording, stamp_ns)))


def test_exact_labels_score_one(recording: Recording, tmp_path: Path) -> None:
    write_labels(recording, tmp_path, lambda semantics: semantics)
    verdict = judge_labels(tmp_path, recording.truth)
    assert (verdict.frames, verdict.iou, verdict.precision, verdict.recall) == (2, 1.0, 1.0, 1.0)


def test_everything_traversable_scores_the_drivable_share(recording: Recording, tmp_path: Path) -> None:
    write_labels(recording, tmp_path, lambda semantics: np.where(semantics > 0, 1, 0).astype(np.uint8))
    verdict = judge_labels(tmp_path, recording.truth)
    assert verdict.iou == pytest.approx(verdict.everything_iou)
    assert verdict.everything_iou < 0.8


def test_inverted_labels_score_zero(recording: Recording, tmp_path: Path) -> None:
    write_labels(recording, tmp_path, lambda semantics: np.choose(semantics, [0, 0, 3, 2]).astype(np.uint8))
    assert judge_labels(tmp_path, recording.truth).iou == 0.0


def test_without_support_there_is_no_score() -> None:
    empty = Verdict(1, 0, 0, 0, 0)
    assert (empty.iou, empty.precision, empty.recall, empty.everything_iou) == (None, None, None, None)
    assert empty.as_record()["iou"] is None


def test_labels_of_another_recording_are_refused(recording: Recording, tmp_path: Path) -> None:
    (tmp_path / SEQUENCE / frame_token(SEQUENCE, 1)).mkdir(parents=True)
    with pytest.raises(NoLabelsError, match="no labels for the sweeps"):
        judge_labels(tmp_path, recording.truth)


def test_labels_of_another_grid_are_refused(recording: Recording, tmp_path: Path) -> None:
    write_labels(recording, tmp_path, lambda semantics: semantics[:10])
    with pytest.raises(ShapeError, match="256, 256, 32"):
        judge_labels(tmp_path, recording.truth)
