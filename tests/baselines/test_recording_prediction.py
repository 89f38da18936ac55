"""`stone predict --bag`: a recording is predicted as its export is, from nothing later, and a few frames at a time."""

import json
import weakref
import zipfile
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

from baselines.data import RECORDS_KEPT
from baselines.frame_record import FrameRecord, read_record
from baselines.predict import PredictionPlan, loaded_run, predict
from services.ingest.sequence import open_sequence
from services.labeler.exports.inputs import write_sensed
from simulator.pipeline import simulate
from stone.sensors.samples import CameraSample, LidarSample, RadarSample
from stone.sensors.sequence import Sequence
from stone_client.main import app
from stone_exports.frames import frames_in
from stone_exports.tables import exports_in
from stone_local.models.prediction_pace import PredictionPace
from stone_local.models.recorded_frames import DamagedSampleError, RecordedStore
from stone_local.models.recording_prediction import PREDICTION, RecordingPlan, predict_recording
from stone_recordings.sync.samples import BagSamples
from stone_submissions.manifest import Manifest, write_manifest
from tests.baselines.recorded_run import DRIVE, ROW, made_run

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


@dataclass(frozen=True)
class OverheardSamples:
    """Samples of a recording that note which frames they were asked for."""

    samples: BagSamples
    asked: list[int] = field(default_factory=list)

    def lidar(self, index: int) -> LidarSample:
        self.asked.append(index)
        return self.samples.lidar(index)

    def camera(self, channel: str, index: int) -> CameraSample | None:
        self.asked.append(index)
        return self.samples.camera(channel, index)

    def radar(self, channel: str, index: int) -> RadarSample | None:
        self.asked.append(index)
        return self.samples.radar(channel, index)


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


def test_nothing_later_than_the_frame_is_read(driven: Driven) -> None:
    overheard = OverheardSamples(driven.samples)
    store = replace(driven.store, samples=overheard)
    for index, _ in loaded_run(driven.run, "cpu").predicted(store, range(4)):
        assert max(overheard.asked) == index


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
    class ShrunkenPictures(OverheardSamples):
        def camera(self, channel: str, index: int) -> CameraSample | None:
            taken = self.samples.camera(channel, index)
            return replace(taken, width_px=taken.width_px // 2) if taken else None

    with pytest.raises(DamagedSampleError):
        replace(driven.store, samples=ShrunkenPictures(driven.samples)).read(0)


def test_the_command_writes_a_folder_of_frames_and_says_how_fast(driven: Driven, tmp_path: Path) -> None:
    of_bag = ("--bag", driven.bag, "--calibration", driven.calibration)
    result = stone("predict", driven.run, *of_bag, "-o", tmp_path / "frames", "--json")
    assert result.exit_code == 0, (result.stderr, result.exception)
    said = json.loads(result.stdout)
    assert said["sequence"] == "drive"
    assert said["frames_per_s"] == pytest.approx(10 * said["real_time_ratio"], rel=0.05)
    assert "× real time" in result.stderr
    kept = json.loads((tmp_path / "frames" / PREDICTION).read_text())
    assert kept["frames"] == said["frames"] == len(grids_of_folder(tmp_path / "frames"))


def test_with_a_manifest_the_command_writes_the_submission(driven: Driven, manifest: Path, tmp_path: Path) -> None:
    of_bag = ("--bag", driven.bag, "--calibration", driven.calibration, "--manifest", manifest)
    assert stone("predict", driven.run, *of_bag, "-o", tmp_path / "sub.zip").exit_code == 0
    assert stone("validate", tmp_path / "sub.zip", "--manifest", manifest).stdout == "valid\n"
    other = stone("predict", driven.run, *of_bag, "-o", tmp_path / "other.zip", "--sequence", "another")
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
        assert stone("predict", driven.run, *arguments, "-o", tmp_path / "out").exit_code == 2, arguments
