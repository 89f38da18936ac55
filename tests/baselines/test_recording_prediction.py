"""What a trained row answers: for exports, for a recording as for its export, as ONNX what torch answers.

Catches alone a graph that an exporter's optimiser changed.
"""

import json
import weakref
import zipfile
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

from baselines.batch import Batch
from baselines.checkpoint import WEIGHTS, WeightsProvenance, write_weights
from baselines.data import RECORDS_KEPT
from baselines.frame_record import FrameRecord, read_record
from baselines.lattice import grid_part
from baselines.layers.efficient_vit import relu_attention
from baselines.models.architectures import build_model
from baselines.models.column_net import ColumnNet
from baselines.models.column_net_program import ColumnNetProgram, column_cells, inputs_of, program_inputs
from baselines.models.occfusion_config import OccFusionConfig
from baselines.predict import PredictionPlan, loaded_run, predict
from baselines.row_config import RowConfig, row_of
from baselines.run_folder import write_run_row
from baselines.train import TrainingPlan
from services.ingest.sequence import open_sequence
from services.labeler.exports.sandboxed_export import write_sensed
from simulator.pipeline import simulate
from stone.sensors.samples import CameraSample
from stone.sensors.sequence import Sequence
from stone_base.label_grid import PAPER
from stone_client.main import app
from stone_exports.frames import frames_in
from stone_exports.tables import exports_in
from stone_local.models.recording_prediction import (
    PREDICTION,
    PredictionPace,
    RecordedStore,
    RecordingPlan,
    predict_recording,
)
from stone_recordings.sync.samples import BagSamples
from stone_submissions.archive import open_submission
from stone_submissions.manifest import Manifest, write_manifest
from stone_submissions.npz_frame import prediction_grid
from testing.refusals import refused_as
from testing.worlds.small_export import SmallExport, write_small_export
from tests.baselines.boxes_frame import IMAGE, SMALL, boxes_frame
from tests.baselines.recorded_run import DRIVE, ROW, made_run
from tests.baselines.small_training import row_record, small_row, trained

Grids = dict[str, NDArray[np.uint8]]


@dataclass(frozen=True)
class Driven:
    """A recording, its calibration, its export of inputs, and a run that predicts it."""

    bag: Path
    calibration: Path
    sequence: Sequence
    export: Path
    run: Path

    @property
    def samples(self) -> BagSamples:
        return BagSamples(self.bag, self.sequence)

    @property
    def store(self) -> RecordedStore:
        return RecordedStore(self.sequence, self.samples, ROW.inputs)


@dataclass
class RepeatedStore:
    """A long recording: one frame again and again; it knows how many of them are still held."""

    record: FrameRecord
    frames: int
    most_held: int = 0
    _given: list["weakref.ref[FrameRecord]"] = field(default_factory=list)

    def __len__(self) -> int:
        return self.frames

    def key(self, index: int) -> tuple[str, int]:
        return "long", 100_000 * index

    def read(self, index: int) -> FrameRecord:
        given = replace(self.record, stamp_us=100_000 * index)
        self._given.append(weakref.ref(given))
        self.most_held = max(self.most_held, sum(each() is not None for each in self._given))
        return given


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Driven:
    root = tmp_path_factory.mktemp("driven")
    bag, export = root / "drive.mcap", root / "inputs"
    simulate(bag, DRIVE)
    calibration = root / "drive.calibration.yaml"
    sequence, _ = open_sequence(bag, calibration, "drive")
    export.mkdir()
    write_sensed(sequence, BagSamples(bag, sequence), export, lambda done, total: None)
    return Driven(bag, calibration, sequence, export, made_run(root / "run"))


@pytest.fixture(scope="module")
def manifest(driven: Driven) -> Path:
    write_manifest(driven.bag.with_name("M.json"), Manifest({"drive": driven.sequence.frames.tokens[::-1]}))
    return driven.bag.with_name("M.json")


def stone(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def grids_of_zip(path: Path) -> Grids:
    with zipfile.ZipFile(path) as archive:
        return {name.removesuffix(".npz"): _grid(archive.read(name)) for name in archive.namelist()}


def grids_of_folder(path: Path) -> Grids:
    return {file.stem: _grid(file.read_bytes()) for file in path.glob("*.npz")}


def _grid(content: bytes) -> NDArray[np.uint8]:
    grid: NDArray[np.uint8] = np.load(BytesIO(content))["semantics"]
    return grid


def test_a_frame_of_a_recording_is_that_of_its_export(driven: Driven) -> None:
    exported = [frame for files in exports_in(driven.export) for frame in frames_in(files)]
    assert [frame.token for frame in exported] == list(driven.sequence.frames.tokens)
    for index, frame in enumerate(exported):
        wanted, found = read_record(frame, None, ROW.inputs), driven.store.read(index)
        assert driven.store.key(index) == (frame.sequence, frame.stamp_us)
        assert [one.jpeg for one in found.pictures] == [one.jpeg for one in wanted.pictures]
        np.testing.assert_allclose(found.returns, wanted.returns, atol=1e-5)
        np.testing.assert_allclose(found.detections, wanted.detections, atol=1e-5)
        for own, others in zip(found.pictures, wanted.pictures, strict=True):
            np.testing.assert_allclose(own.intrinsics, others.intrinsics)
            np.testing.assert_allclose(own.ego_from_camera, others.ego_from_camera, atol=1e-9)


def test_a_recording_is_predicted_as_its_export_is(driven: Driven, manifest: Path, tmp_path: Path) -> None:
    predict(PredictionPlan(driven.run, (driven.export,), manifest, tmp_path / "exported.zip"), lambda *_: None)
    told = list[PredictionPace]()
    plan = RecordingPlan(driven.bag, driven.sequence, tmp_path / "frames")
    predict_recording(loaded_run(driven.run, "cpu"), plan, told.append)
    wanted, found = grids_of_zip(tmp_path / "exported.zip"), grids_of_folder(tmp_path / "frames")
    assert set(found) == set(wanted) == set(driven.sequence.frames.tokens)
    assert {0, 1, 2, 3} == set(np.unique(np.stack(list(wanted.values()))).tolist())
    assert min(np.mean(found[token] == grid) for token, grid in wanted.items()) >= 0.999
    assert [pace.done for pace in told] == list(range(1, len(found) + 1))


def test_a_long_recording_needs_the_memory_of_a_few_frames(driven: Driven) -> None:
    store = RepeatedStore(driven.store.read(0), 2 * RECORDS_KEPT)
    assert sum(1 for _ in loaded_run(driven.run, "cpu").predicted(store, range(len(store)))) == len(store)
    assert store.most_held <= RECORDS_KEPT + 1


def test_it_says_how_long_a_robot_waits_for_the_frames_pictures(driven: Driven) -> None:
    period_ns = int(np.diff(driven.sequence.frames.stamps_ns).max())
    assert 0 < driven.store.longest_wait_ns() < period_ns
    alone = replace(driven.store, inputs=replace(ROW.inputs, modality="L"))
    assert alone.longest_wait_ns() == 0


def test_a_picture_that_is_not_as_large_as_its_message_says_is_refused(driven: Driven) -> None:
    class ShrunkenPictures(BagSamples):
        def camera(self, channel: str, index: int) -> CameraSample | None:
            taken = super().camera(channel, index)
            return replace(taken, width_px=taken.width_px // 2) if taken else None

    with refused_as("damaged_sample"):
        replace(driven.store, samples=ShrunkenPictures(driven.bag, driven.sequence)).read(0)


def test_the_command_writes_a_folder_of_frames_and_says_how_fast(driven: Driven, tmp_path: Path) -> None:
    of_bag = ("--bag", driven.bag, "--calibration", driven.calibration)
    result = stone("model", "predict", driven.run, *of_bag, "-o", tmp_path / "frames", "--json")
    assert result.exit_code == 0, (result.stderr, result.exception)
    said = json.loads(result.stdout)
    assert said["sequence"] == "drive"
    assert said["frames_per_s"] == pytest.approx(10 * said["real_time_ratio"], rel=0.05)
    assert "× real time" in result.stderr
    kept = json.loads((tmp_path / "frames" / PREDICTION).read_text())
    assert kept["frames"] == said["frames"] == len(grids_of_folder(tmp_path / "frames"))


def test_with_a_manifest_the_command_writes_the_submission(driven: Driven, manifest: Path, tmp_path: Path) -> None:
    of_bag = ("--bag", driven.bag, "--calibration", driven.calibration, "--manifest", manifest)
    assert stone("model", "predict", driven.run, *of_bag, "-o", tmp_path / "sub.zip").exit_code == 0
    assert stone("validate", tmp_path / "sub.zip", "--manifest", manifest).stdout == "valid\n"
    other = stone("model", "predict", driven.run, *of_bag, "-o", tmp_path / "other.zip", "--sequence", "another")
    assert other.exit_code == 1
    assert other.stderr.splitlines()[-1].startswith("not_of_recording: ")


def test_options_that_exclude_each_other_are_refused(driven: Driven, manifest: Path, tmp_path: Path) -> None:
    bag, calibration = ("--bag", driven.bag), ("--calibration", driven.calibration)
    for arguments in (
        (driven.export, *bag, *calibration, "--manifest", manifest),
        ("--manifest", manifest),
        bag,
        (driven.export, "--manifest", manifest, *calibration),
        (driven.export,),
        (*bag, *calibration, "--submit", "--benchmark", "b", "--phase", "p", "--team", "t"),
    ):
        assert stone("model", "predict", driven.run, *arguments, "-o", tmp_path / "out").exit_code == 2, arguments


BOXES_ROW = replace(
    ROW,
    inputs=replace(ROW.inputs, image_size_px=IMAGE, channels=("CAM_FRONT", "CAM_BACK")),
    model=replace(ROW.model, lattice=SMALL),
)


@pytest.fixture(scope="module")
def model(boxes_run: Path) -> ColumnNet:
    found = loaded_run(boxes_run, "cpu").predictor.model
    assert isinstance(found, ColumnNet)
    return found


@pytest.fixture(scope="module")
def boxes_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_run(tmp_path_factory.mktemp("onnx") / "boxes_run", BOXES_ROW)


@pytest.fixture(scope="module")
def written(boxes_run: Path) -> tuple[Path, dict[str, Any]]:
    """The file, and what the command says of it."""
    path = boxes_run.with_name("model.onnx")
    result = CliRunner().invoke(app, ["model", "onnx", str(boxes_run), "-o", str(path), "--json"])
    assert result.exit_code == 0, (result.stderr, result.exception)
    return path, json.loads(result.stdout)


@pytest.fixture(scope="module")
def session(written: tuple[Path, dict[str, Any]]) -> Any:
    return onnxruntime.InferenceSession(written[0], providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def batch() -> Batch:
    return boxes_frame(SMALL)


def test_the_file_answers_what_torch_answers(model: ColumnNet, session: Any, batch: Batch) -> None:
    with torch.inference_mode():
        wanted = model(batch)
        fed = {name: value.numpy() for name, value in inputs_of(model, batch).items()}
    logits, log_temperature = session.run(["logits", "log_temperature"], fed)
    assert np.abs(logits - wanted.logits.numpy()).max() < 1e-4 * np.abs(logits).max()
    assert np.abs(log_temperature - wanted.log_temperature.numpy()).max() < 1e-4
    assert np.mean(logits.argmax(1) == wanted.logits.numpy().argmax(1)) >= 0.9999
    assert len(np.unique(logits.argmax(1))) == 4


def test_an_empty_frame_is_answered_too(model: ColumnNet, session: Any) -> None:
    nothing = program_inputs(model, 2, IMAGE)
    with torch.inference_mode():
        wanted, _ = ColumnNetProgram(model)(*nothing.values())
    logits, _ = session.run(None, {name: value.numpy() for name, value in nothing.items()})
    np.testing.assert_allclose(logits, wanted.numpy(), atol=1e-4 * np.abs(logits).max())


def test_the_file_says_what_it_is(written: tuple[Path, dict[str, Any]], session: Any) -> None:
    said = session.get_modelmeta().custom_metadata_map
    assert json.loads(said["stone.classes"]) == [
        "free", "traversable", "potentially_traversable", "non_traversable",
    ]  # fmt: skip
    assert json.loads(said["stone.lattice"])["shape"] == list(SMALL.shape)
    assert json.loads(said["stone.row"])["method"] == "Tiny"
    assert said["stone.data_sha256"] == "0" * 64
    assert list(json.loads(said["stone.inputs"])) == [one.name for one in session.get_inputs()]
    shapes = {one.name: one.shape for one in session.get_inputs()}
    assert shapes == {"maps": [1, 76, 32, 32], "base": [1, 32, 32], "images": [2, 3, 64, 64], "cells": [2, 2, 32, 32]}
    assert written[1]["inputs"] == shapes
    assert written[1]["size_bytes"] == written[0].stat().st_size


def test_attention_without_a_key_is_0() -> None:
    nothing = torch.zeros(1, 4, 9)
    assert torch.equal(relu_attention(torch.ones(1, 4, 9), nothing, torch.ones(1, 4, 9)), nothing)


def test_without_cameras_there_are_no_cells(model: ColumnNet, batch: Batch) -> None:
    with pytest.raises(ValueError, match="there are none"):
        column_cells(model, replace(batch, cameras=None), torch.zeros(1, 2, 32, 32))
    alone = ColumnNet(replace(model.config, modality="L"))
    assert list(program_inputs(alone, 2, IMAGE)) == list(inputs_of(alone, batch)) == ["maps", "base"]


def test_other_architectures_are_refused_in_a_line(tmp_path: Path) -> None:
    other = OccFusionConfig(
        modality="C+L",
        resnet_depth=14,
        resnet_width=8,
        head_channels=8,
        pyramid_channels=16,
        level_channels=(8, 8, 8, 8),
    )
    row = RowConfig("other", "OccFusion", "a test", replace(ROW.inputs, modality="C+L"), other)
    write_run_row(tmp_path, row)
    write_weights(tmp_path, build_model(other), WeightsProvenance(row.as_json(), "0" * 64, "all", 1))
    result = CliRunner().invoke(app, ["model", "onnx", str(tmp_path), "-o", str(tmp_path / "model.onnx")])
    assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1)
    assert result.stderr.startswith("not_deployable: ")


MEADOW = SmallExport("meadow", 9)


@pytest.fixture(scope="module")
def trained_run(meadow: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    trained_run = tmp_path_factory.mktemp("trained") / "trained_run"
    trained(TrainingPlan(small_row(epochs=8, learning_rate=1e-2), (meadow,), trained_run))
    return trained_run


@pytest.fixture
def plan(trained_run: Path, meadow: Path, tmp_path: Path) -> PredictionPlan:
    """Not in the order of time: a submission's is free."""
    manifest = tmp_path / "M.json"
    write_manifest(manifest, Manifest({"meadow": MEADOW.tokens[:2:-1]}))
    return PredictionPlan(trained_run, (meadow,), manifest, tmp_path / "sub.zip")


def predicted_grids(plan: PredictionPlan) -> dict[str, np.ndarray]:
    torch.set_num_threads(1)
    predict(plan, lambda *_: None)
    tokens = MEADOW.tokens[3:]
    with open_submission(plan.output, tokens) as submission:
        return {token: prediction_grid(bytes(submission.read(token))) for token in tokens}


def test_a_prediction_is_a_valid_submission_and_free_outside_the_lattice(plan: PredictionPlan) -> None:
    written = predict(plan, lambda *_: None)
    assert (written.frames, written.method, written.modality, written.steps) == (6, "Small", "L", 32)
    part = grid_part(small_row().model.lattice, PAPER)
    for grid in predicted_grids(plan).values():
        inside = grid[part].copy()
        outside = grid.copy()
        outside[part] = 0
        assert not outside.any()
        assert inside.any()
        assert grid.max() <= 3


def test_predictions_are_the_same_every_time_and_hold_of_the_frame(plan: PredictionPlan) -> None:
    one, other = predicted_grids(plan), predicted_grids(plan)
    assert all(np.array_equal(one[token], other[token]) for token in one)
    assert len({grid.tobytes() for grid in one.values()}) > 1


def test_later_frames_change_no_prediction(plan: PredictionPlan, meadow: Path, tmp_path: Path) -> None:
    """Whether they are there or hold something else."""
    before = predicted_grids(plan)
    copytree(meadow, tmp_path / "copied")
    for sweep in sorted((tmp_path / "copied" / "samples" / "LIDAR_TOP").iterdir())[6:]:
        sweep.write_bytes(sweep.read_bytes()[: 20 * 100])
    after = predicted_grids(replace(plan, exports=(tmp_path / "copied",)))
    assert [np.array_equal(before[token], after[token]) for token in MEADOW.tokens[3:6]] == [True] * 3
    assert not np.array_equal(before[MEADOW.tokens[8]], after[MEADOW.tokens[8]])


def test_frames_that_are_missing_are_refused_and_nothing_is_written(plan: PredictionPlan, tmp_path: Path) -> None:
    other = write_small_export(tmp_path / "other", SmallExport("quarry", 3))
    with refused_as("frames_missing", match=r"\b6 frames"):
        predict(replace(plan, exports=(other,)), lambda *_: None)
    assert not plan.output.exists()


def test_a_folder_that_is_no_run_is_refused(plan: PredictionPlan, meadow: Path) -> None:
    with refused_as("bad_run"):
        predict(replace(plan, run=meadow), lambda *_: None)


def test_a_run_without_weights_is_refused(plan: PredictionPlan, trained_run: Path, tmp_path: Path) -> None:
    (tmp_path / "trained_run").mkdir()
    (tmp_path / "trained_run" / "row.json").write_text((trained_run / "row.json").read_text())
    with refused_as("bad_run"):
        predict(replace(plan, run=tmp_path / "trained_run"), lambda *_: None)


def test_weights_of_another_model_are_refused(plan: PredictionPlan, trained_run: Path, tmp_path: Path) -> None:
    said = row_record()
    other = row_of("other", {**said, "model": {**said["model"], "volume_channels": 16}})
    (tmp_path / "trained_run").mkdir()
    (tmp_path / "trained_run" / "row.json").write_text(other.as_json())
    (tmp_path / "trained_run" / WEIGHTS).write_bytes((trained_run / WEIGHTS).read_bytes())
    with refused_as("bad_run") as refused:
        predict(replace(plan, run=tmp_path / "trained_run"), lambda *_: None)
    assert "\n" not in str(refused.value)
