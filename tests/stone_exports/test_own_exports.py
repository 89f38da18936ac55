"""What our exporter wrote of a labelled drive is read back as it was.

Catches alone an exporter and a reader that no longer agree.
"""

import numpy as np
import pytest

from services.labeler.exports.nuscenes.layout import write_nuscenes
from stone_exports.cameras import undistorted_picture
from stone_exports.files import FolderFiles
from stone_exports.frames import ExportedFrame, frames_in
from stone_exports.labels import observed_classes
from stone_exports.radar import detections_ego
from stone_exports.sweeps import SweepFile
from tests.services.labeler.exports.conftest import drive
from tests.services.labeler.exports.made import Labelled, unheard

pytestmark = pytest.mark.whole

__all__ = ["drive"]  # a fixture


@pytest.fixture(scope="module")
def frames(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> tuple[ExportedFrame, ...]:
    folder = tmp_path_factory.mktemp("nuscenes")
    write_nuscenes(drive.source(), folder, unheard)
    return frames_in(FolderFiles(folder))


def test_every_frame_is_there_with_its_stamp_and_all_channels(
    drive: Labelled, frames: tuple[ExportedFrame, ...]
) -> None:
    wanted = drive.source().sequence.frames
    assert tuple(frame.token for frame in frames) == wanted.tokens
    assert [frame.stamp_us for frame in frames] == [int(stamp) // 1000 for stamp in wanted.stamps_ns]
    assert {len(frame.of_modality("camera")) for frame in frames[1:-1]} == {6}
    assert {len(frame.of_modality("radar")) for frame in frames[1:-1]} == {3}


def test_poses_of_frames_are_those_of_the_sequence(drive: Labelled, frames: tuple[ExportedFrame, ...]) -> None:
    wanted = drive.source().sequence.frames.map_from_ego
    for index in range(1, len(frames)):
        moved = frames[0].lidar.global_from_ego.inverse() @ frames[index].lidar.global_from_ego
        np.testing.assert_allclose(
            moved.as_matrix(), (wanted[0].inverse() @ wanted[index]).as_matrix(), rtol=0, atol=1e-6
        )


def test_sweeps_are_the_recorded_returns_in_the_ego_frame(drive: Labelled, frames: tuple[ExportedFrame, ...]) -> None:
    source = drive.source()
    ego_from_lidar = source.sequence.calibration.ego_from_lidar
    for index, frame in enumerate(frames):
        sample = source.samples.lidar(index)
        returns = SweepFile(frame.lidar.span, frame.lidar.sensor.ego_from_sensor).returns_ego()
        np.testing.assert_allclose(returns[:, :3], ego_from_lidar @ sample.points_lidar.astype(float), atol=1e-4)
        assert np.array_equal(returns[:, 3], sample.intensity)


def test_labels_are_those_of_the_label_set(frames: tuple[ExportedFrame, ...]) -> None:
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
