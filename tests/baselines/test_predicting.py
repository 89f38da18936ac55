"""Predicting by a trained row: a valid submission, free outside the lattice, from earlier frames only."""

from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
import torch

from baselines.checkpoint import WEIGHTS
from baselines.errors import BadRunError
from baselines.lattice import grid_part
from baselines.predict import PredictionPlan, predict
from baselines.row_config import row_of
from baselines.train import TrainingPlan
from stone_exports.errors import FramesMissingError
from stone_submissions.archive import open_submission
from stone_submissions.manifest import Manifest, write_manifest
from stone_submissions.npz_frame import prediction_grid
from testing.worlds.small_export import SmallExport, write_small_export
from tests.baselines.small_training import row_record, small_row, trained

MEADOW = SmallExport("meadow", 9)


@pytest.fixture(scope="module")
def run(meadow: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("trained") / "run"
    trained(TrainingPlan(small_row(epochs=8, learning_rate=1e-2), (meadow,), run))
    return run


@pytest.fixture
def plan(run: Path, meadow: Path, tmp_path: Path) -> PredictionPlan:
    """Not in the order of time: a submission's is free."""
    manifest = tmp_path / "M.json"
    write_manifest(manifest, Manifest({"meadow": MEADOW.tokens[:2:-1]}))
    return PredictionPlan(run, (meadow,), manifest, tmp_path / "sub.zip")


def predicted(plan: PredictionPlan) -> dict[str, np.ndarray]:
    torch.set_num_threads(1)
    predict(plan, lambda *_: None)
    tokens = MEADOW.tokens[3:]
    with open_submission(plan.output, tokens) as submission:
        return {token: prediction_grid(bytes(submission.read(token))) for token in tokens}


def test_a_prediction_is_a_valid_submission_and_free_outside_the_lattice(plan: PredictionPlan) -> None:
    written = predict(plan, lambda *_: None)
    assert (written.frames, written.method, written.modality, written.steps) == (6, "Small", "L", 32)
    part = grid_part(small_row().model.lattice)
    for grid in predicted(plan).values():
        inside = grid[part].copy()
        outside = grid.copy()
        outside[part] = 0
        assert not outside.any()
        assert inside.any()
        assert grid.max() <= 3


def test_predictions_are_the_same_every_time_and_hold_of_the_frame(plan: PredictionPlan) -> None:
    one, other = predicted(plan), predicted(plan)
    assert all(np.array_equal(one[token], other[token]) for token in one)
    assert len({grid.tobytes() for grid in one.values()}) > 1


def test_later_frames_change_no_prediction(plan: PredictionPlan, meadow: Path, tmp_path: Path) -> None:
    """Whether they are there or hold something else."""
    before = predicted(plan)
    copytree(meadow, tmp_path / "copied")
    for sweep in sorted((tmp_path / "copied" / "samples" / "LIDAR_TOP").iterdir())[6:]:
        sweep.write_bytes(sweep.read_bytes()[: 20 * 100])
    after = predicted(replace(plan, exports=(tmp_path / "copied",)))
    assert [np.array_equal(before[token], after[token]) for token in MEADOW.tokens[3:6]] == [True] * 3
    assert not np.array_equal(before[MEADOW.tokens[8]], after[MEADOW.tokens[8]])


def test_frames_that_are_missing_are_refused_and_nothing_is_written(plan: PredictionPlan, tmp_path: Path) -> None:
    other = write_small_export(tmp_path / "other", SmallExport("quarry", 3))
    with pytest.raises(FramesMissingError, match=r"\b6 frames"):
        predict(replace(plan, exports=(other,)), lambda *_: None)
    assert not plan.output.exists()


def test_labels_are_not_looked_at(plan: PredictionPlan, tmp_path: Path) -> None:
    bare = write_small_export(tmp_path / "bare", replace(MEADOW, is_labelled=False))
    before = predicted(plan)
    assert all(np.array_equal(before[token], grid) for token, grid in predicted(replace(plan, exports=(bare,))).items())


def test_a_folder_that_is_no_run_is_refused(plan: PredictionPlan, meadow: Path) -> None:
    with pytest.raises(BadRunError):
        predict(replace(plan, run=meadow), lambda *_: None)


def test_a_run_without_weights_is_refused(plan: PredictionPlan, run: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "row.json").write_text((run / "row.json").read_text())
    with pytest.raises(BadRunError):
        predict(replace(plan, run=tmp_path / "run"), lambda *_: None)


def test_weights_of_another_model_are_refused(plan: PredictionPlan, run: Path, tmp_path: Path) -> None:
    said = row_record()
    other = row_of("other", {**said, "model": {**said["model"], "volume_channels": 16}})
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "row.json").write_text(other.as_json())
    (tmp_path / "run" / WEIGHTS).write_bytes((run / WEIGHTS).read_bytes())
    with pytest.raises(BadRunError) as refused:
        predict(replace(plan, run=tmp_path / "run"), lambda *_: None)
    assert "\n" not in str(refused.value)
