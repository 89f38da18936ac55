"""What our exporter wrote of a labelled drive is read back exactly: tokens, stamps, poses, calibration, labels.

Catches alone an exporter whose files the platform would not take back.
"""

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

from services.labeler.exports.folder import ExportRequest, export
from services.labeler.exports.nuscenes.plan import NuscenesPlan, channels_of
from stone_client.devkit import open_dataset
from stone_datasets.index import DatasetIndex
from stone_datasets.labels import read_labels
from stone_datasets.reading import check_dataset, read_dataset
from stone_exports.cameras import undistorted_picture
from stone_exports.files import FolderFiles
from stone_exports.frames import ExportedFrame, frames_in
from stone_exports.labels import detections_ego, observed_classes
from stone_exports.sweeps import SweepFile
from tests.services.labeler.exports.conftest import drive
from tests.services.labeler.exports.made import Labelled, unheard

pytestmark = pytest.mark.whole

__all__ = ["drive"]  # a fixture


@pytest.fixture(scope="module")
def exported(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `stone export --format nuscenes` leaves it."""
    folder = tmp_path_factory.mktemp("exported") / "nuscenes"
    export(ExportRequest("nuscenes", folder, drive.report), drive.source, unheard)
    return folder


@pytest.fixture(scope="module")
def index(exported: Path) -> DatasetIndex:
    return read_dataset(exported)


def test_an_export_is_a_sound_dataset(exported: Path, drive: Labelled) -> None:
    check = check_dataset(exported)
    assert [str(fault) for fault in check.faults.found] == []
    assert check.contents is not None
    record = check.contents.as_record()
    assert record["frames"] == record["labelled_frames"] == drive.report["frames"]
    shares = drive.report["class_share_of_occupied"]
    names = {"T": "traversable", "P": "potentially_traversable", "N": "non_traversable"}
    for name, of_report in names.items():
        assert record["class_share_of_occupied"][name] == pytest.approx(shares[of_report], abs=1e-3)


def test_frames_have_the_tokens_stamps_and_poses_that_were_labelled(index: DatasetIndex, drive: Labelled) -> None:
    (sequence,), source = index.sequences, drive.source().sequence
    log = json.loads((index.files.path / "v1.0-trainval" / "log.json").read_text())[0]
    assert sequence.name == source.name
    assert sequence.tokens == source.frames.tokens
    assert np.array_equal(sequence.stamps_ns, source.frames.stamps_ns // 1000 * 1000)
    assert np.array_equal(sequence.map_from_ego.wxyz, source.frames.map_from_ego.wxyz)
    moved_m = source.frames.map_from_ego.translation_m + log["global_from_map_m"]
    assert np.array_equal(sequence.map_from_ego.translation_m, moved_m)


def test_sensors_have_the_mounts_lenses_stamps_and_poses_that_were_exported(index, drive):
    (sequence,), source = index.sequences, drive.source().sequence
    log = json.loads((index.files.path / "v1.0-trainval" / "log.json").read_text())[0]
    low_m = (-log["global_from_map_m"][0], -log["global_from_map_m"][1])
    plan = NuscenesPlan(source, channels_of(source), low_m)
    assert set(sequence.channels) == {channel.name for channel in plan.channels}
    for wanted in plan.channels:
        found = sequence.channels[wanted.name]
        mount = source.calibration.ego_from_lidar @ wanted.mount.lidar_from_sensor
        assert np.array_equal(found.sensor.ego_from_sensor.wxyz_xyz, mount.wxyz_xyz)
        assert found.sensor.intrinsics == wanted.mount.intrinsics
        assert np.array_equal(found.frames, wanted.frames)
        assert np.array_equal(found.stamps_ns, wanted.stamps_ns // 1000 * 1000)
        assert np.array_equal(found.map_from_ego.wxyz, wanted.map_from_ego.wxyz)
        assert [found.filename(place) for place in range(len(found.frames))] == [
            plan.filename(wanted, place) for place in range(len(wanted.frames))
        ]


def test_labels_are_those_of_the_label_set(index: DatasetIndex, drive: Labelled) -> None:
    (sequence,) = index.sequences
    for frame, token in enumerate(sequence.tokens):
        span = index.labels(sequence, frame)
        assert span is not None
        labels = read_labels(span)
        with np.load(drive.folder / "gts" / sequence.name / token / "labels.npz") as arrays:
            assert np.array_equal(labels.classes, arrays["semantics"])
            assert labels.mask_lidar is not None
            assert labels.mask_camera is not None
            assert np.array_equal(labels.mask_lidar, arrays["mask_lidar"])
            assert np.array_equal(labels.mask_camera, arrays["mask_camera"])


def test_an_export_in_a_tar_is_the_same(exported: Path, index: DatasetIndex, tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "export.tar", "w") as tar:
        tar.add(exported, "nuscenes")
    check = check_dataset(tmp_path / "export.tar")
    assert check.contents is not None
    assert check.contents.index.sequences[0].tokens == index.sequences[0].tokens
    assert check.contents.as_record()["size_bytes"] > 0


@pytest.fixture(scope="module")
def frames(exported: Path) -> tuple[ExportedFrame, ...]:
    return frames_in(FolderFiles(exported))


def test_sweeps_are_the_recorded_returns_in_the_ego_frame(drive: Labelled, frames: tuple[ExportedFrame, ...]) -> None:
    source = drive.source()
    ego_from_lidar = source.sequence.calibration.ego_from_lidar
    for index, frame in enumerate(frames):
        sample = source.samples.lidar(index)
        returns = SweepFile(frame.lidar.span, frame.lidar.sensor.ego_from_sensor).returns_ego()
        np.testing.assert_allclose(returns[:, :3], ego_from_lidar @ sample.points_lidar.astype(float), atol=1e-4)
        assert np.array_equal(returns[:, 3], sample.intensity)


def test_labels_are_read_alike_for_training(frames: tuple[ExportedFrame, ...]) -> None:
    for frame in frames:
        assert frame.labels is not None
        classes = observed_classes(frame.labels)
        with np.load(frame.labels.path) as arrays:
            is_ignored = (arrays["semantics"] == 0) & (arrays["mask_lidar"] == 0)
            assert np.array_equal(classes == 255, is_ignored)
            assert np.array_equal(classes[~is_ignored], arrays["semantics"][~is_ignored])
        assert {0, 3, 255} <= set(np.unique(classes).tolist())


def test_pictures_and_scans_can_be_read(frames: tuple[ExportedFrame, ...]) -> None:
    frame = frames[len(frames) // 2]
    for datum in frame.of_modality("camera"):
        lens = datum.sensor.intrinsics
        assert lens is not None
        assert undistorted_picture(datum.span, lens, (48, 32)).std() > 5
    scans = [detections_ego(datum) for datum in frame.of_modality("radar")]
    assert sum(map(len, scans)) > 3
    assert all(np.isfinite(rows).all() for rows in scans)


def test_the_devkit_opens_the_label_set_and_its_export_as_the_same_frames(exported: Path, drive: Labelled) -> None:
    labels, export_of = open_dataset(drive.folder), open_dataset(exported)
    global_from_map_m = json.loads((exported / "v1.0-trainval" / "log.json").read_text())[0]["global_from_map_m"]
    assert len(labels) == drive.report["frames"]
    for labelled, frame in zip(labels, export_of, strict=True):
        assert (labelled.token, labelled.stamp_ns // 1000) == (frame.token, frame.stamp_ns // 1000)
        assert np.array_equal(labelled.semantics, frame.semantics)
        assert np.array_equal(labelled.observed, frame.observed)
        assert labelled.map_from_ego is not None
        moved = labelled.map_from_ego.copy()
        moved[:3, 3] += global_from_map_m
        assert frame.map_from_ego == pytest.approx(moved, abs=1e-4)
        assert len(frame.scan("RADAR_LEFT")) >= 0
        assert frame.image("CAM_BACK").shape[2] == 3
