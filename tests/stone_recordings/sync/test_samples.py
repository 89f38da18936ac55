"""What every sensor gave for a frame, against the messages it was made of."""

import io
import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from services.ingest.sequence import open_sequence
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone.sensors.sequence import Frames, Sequence, frame_token
from stone.sensors.sweep_lag import SweepLag
from stone_recordings.bags.bag import open_bag
from stone_recordings.messages.camera import CameraPicture
from stone_recordings.messages.pointcloud2 import decode_cloud
from stone_recordings.sync.lag_check import TOLERATED_NS, lag_findings
from stone_recordings.sync.samples import BagSamples, as_jpeg, checked_samples
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from stone_recordings.sync.sweeps import BagSweeps
from testing.refusals import refused_as

OPTIONS = SimulateOptions(seconds=1.0, seed=4, channels=16, columns=120, camera_width_px=64, world_width_m=60.0)


@dataclass(frozen=True, eq=False)
class Drive:
    bag: Path
    sequence: Sequence
    sweeps: BagSweeps

    @property
    def samples(self) -> BagSamples:
        return BagSamples(self.bag, self.sequence)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("samples")
    simulate(folder / "drive.mcap", OPTIONS)
    sequence, sweeps = open_sequence(folder / "drive.mcap", folder / "drive.calibration.yaml", "drive")
    return Drive(folder / "drive.mcap", sequence, sweeps)


def test_a_sweep_is_the_one_that_is_labelled(drive: Drive) -> None:
    for index in range(len(drive.sequence.frames)):
        sample = drive.samples.lidar(index)
        assert np.array_equal(sample.points_lidar, drive.sweeps.sweep(index).points_lidar)
        assert len(sample.intensity) == len(sample.ring) == len(sample.points_lidar)


def test_intensity_and_ring_stay_with_their_point(drive: Drive) -> None:
    index = 3
    bare = BagSamples(drive.bag, replace(drive.sequence, track=None)).lidar(index)
    with open_bag(drive.bag) as bag:
        payload = bag.message(drive.sweeps.topic, int(drive.sweeps.message_index[index])).payload
        points = decode_cloud(payload).points
        rows = {
            tuple(map(float, row)): k for k, row in enumerate(zip(points["x"], points["y"], points["z"], strict=True))
        }
        for xyz, intensity, ring in zip(bare.points_lidar.tolist(), bare.intensity, bare.ring, strict=True):
            row = points[rows[tuple(xyz)]]
            assert (row["intensity"], row["ring"]) == (intensity, ring)
    assert len(np.unique(bare.ring)) == OPTIONS.channels


def test_points_whose_time_has_no_pose_go_with_their_intensity(drive: Drive) -> None:
    track = drive.sequence.track
    assert track is not None
    last_ns = int(drive.sequence.frames.stamps_ns[4]) + 40_000_000
    is_early = track.stamps_ns <= last_ns
    cut = replace(track, stamps_ns=track.stamps_ns[is_early], map_from_ego=track.map_from_ego[is_early])
    if track.segment is not None:
        cut = replace(cut, segment=track.segment[is_early])
    sample = BagSamples(drive.bag, replace(drive.sequence, track=cut)).lidar(4)
    whole = drive.samples.lidar(4)
    assert 0 < len(sample.points_lidar) < len(whole.points_lidar)
    assert len(sample.intensity) == len(sample.ring) == len(sample.points_lidar)


def test_a_picture_is_the_recorded_file_at_its_own_time(drive: Drive) -> None:
    taken = drive.sequence.frames.associations["CAM_BACK"]
    for index in range(0, len(drive.sequence.frames), 3):
        sample = drive.samples.camera("CAM_BACK", index)
        assert sample is not None
        with open_bag(drive.bag) as bag:
            assert sample.content in bytes(bag.message(taken.topic, int(taken.message_index[index])).payload)
        assert sample.stamp_ns == drive.sequence.frames.stamps_ns[index] + taken.dt_ns[index]
        with Image.open(io.BytesIO(sample.content)) as image:
            assert image.format == "JPEG"
            assert image.size == (sample.width_px, sample.height_px)


def test_a_picture_that_is_no_jpeg_is_encoded_with_its_colours() -> None:
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:, :32], pixels[:, 32:] = (200, 30, 40), (20, 60, 220)
    raw = CameraPicture("sensor_msgs/msg/Image", 0, "", 64, 48, "rgb8", 192, False, memoryview(pixels.tobytes()))
    with Image.open(io.BytesIO(as_jpeg(raw))) as image:
        assert np.abs(np.asarray(image).astype(int) - pixels)[:, [4, 60]].max() <= 4
    assert as_jpeg(raw) == as_jpeg(raw)


def test_a_radar_scan_stands_in_both_frames(drive: Drive) -> None:
    mount = drive.sequence.calibration.mount("RADAR_LEFT")
    assert mount is not None
    sample = drive.samples.radar("RADAR_LEFT", 5)
    assert sample is not None
    assert len(sample.points_radar) == len(sample.rcs_db) > 0
    moved = mount.lidar_from_sensor @ sample.points_radar
    # the robot has moved by a few centimetres between the scan and the stamp
    assert np.abs(moved - sample.points_lidar).max() < 1.0
    taken = drive.sequence.frames.associations["RADAR_LEFT"]
    assert sample.stamp_ns == drive.sequence.frames.stamps_ns[5] + taken.dt_ns[5]


@pytest.mark.parametrize("ask", [lambda s: s.camera("CAM_TOP", 0), lambda s: s.radar("RADAR_TOP", 0)])
def test_a_sensor_that_is_not_there_gives_nothing(drive: Drive, ask: Callable[[BagSamples], object]) -> None:
    assert ask(drive.samples) is None


def test_samples_travel_to_other_processes_and_through_files(drive: Drive) -> None:
    there = pickle.loads(pickle.dumps(drive.samples))
    read = BagSamples(drive.bag, read_sequence(sequence_bytes(drive.sequence)))
    for samples in (there, read):
        assert np.array_equal(samples.lidar(2).points_lidar, drive.samples.lidar(2).points_lidar)
        assert samples.camera("CAM_FRONT", 2).content == drive.samples.camera("CAM_FRONT", 2).content  # type: ignore[union-attr]


def test_only_the_recording_that_was_synchronised_with_its_messages_is_opened(drive: Drive) -> None:
    sequence = replace(drive.sequence, frames=replace(drive.sequence.frames, sweeps=None))
    with refused_as("not_recorded"):
        BagSamples(drive.bag, sequence).lidar(0)
    assert checked_samples(drive.bag, drive.sequence).path == drive.bag
    with refused_as("recording_changed"):
        checked_samples(drive.bag, replace(drive.sequence, inputs={"drive.mcap": "0" * 64}))


STAMPS_NS = np.array([1_700_000_000_123_456_000, 1_700_000_000_223_456_000], np.int64)
POSES = SE3(np.array([[1.0, 0, 0, 0, 1, 2, 3], [1.0, 0, 0, 0, 4, 5, 6]]))
FOREIGN = ("0f" * 16, "a0" * 16)


def test_tokens_are_stored_and_read_back_where_they_do_not_follow_from_name_and_stamps() -> None:
    sequence = _sequence(FOREIGN)
    read = read_sequence(sequence_bytes(sequence))
    assert read.frames.tokens == FOREIGN
    assert sequence_bytes(read) == sequence_bytes(sequence)
    mixed = (_derived()[0], FOREIGN[1])
    assert read_sequence(sequence_bytes(_sequence(mixed))).frames.tokens == mixed
    written = sequence_bytes(_sequence(_derived()))
    with np.load(io.BytesIO(written), allow_pickle=False) as arrays:
        assert "tokens" not in json.loads(arrays["record"].tobytes())
    assert read_sequence(written).frames.tokens == _derived()
    empty = Frames(STAMPS_NS[:0], (), POSES[:0])
    assert read_sequence(sequence_bytes(replace(_sequence(FOREIGN), frames=empty))).frames.tokens == ()


def _derived() -> tuple[str, ...]:
    return tuple(frame_token("run", stamp) for stamp in STAMPS_NS.tolist())


def _sequence(tokens: tuple[str, ...]) -> Sequence:
    return Sequence("run", Frames(STAMPS_NS, tokens, POSES), (), Calibration("rig", SE3.identity()), "dataset")


CERTAIN = SweepLag(16, 100_000_000, 2_000_000, 0.002, 0.02)


def test_a_certain_lag_is_named_with_the_options_that_put_it_right() -> None:
    (finding,) = lag_findings(CERTAIN)
    assert (finding.code, finding.severity) == ("TIM-213", "warning")
    assert "pose=-100ms or lidar=100ms" in finding.message
    (early,) = lag_findings(replace(CERTAIN, lag_ns=-60_000_000))
    assert "pose=60ms or lidar=-60ms" in early.message


@pytest.mark.parametrize(
    "doubtful",
    [
        None, replace(CERTAIN, lag_ns=TOLERATED_NS), replace(CERTAIN, lag_ns=-TOLERATED_NS),
        replace(CERTAIN, sigma_ns=20_000_000), replace(CERTAIN, lag_ns=60_000_000, sigma_ns=14_000_000),
        replace(CERTAIN, unshifted_rad=0.0025),
    ],
)  # fmt: skip
def test_what_is_small_or_uncertain_is_not_named(doubtful: SweepLag | None) -> None:
    assert lag_findings(doubtful) == ()
