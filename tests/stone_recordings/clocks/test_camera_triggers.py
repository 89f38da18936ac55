"""Cameras are judged by where the LiDAR looked when they fired: late, swapped, or following nothing."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from stone.findings import Finding
from stone.geometry.se3 import SE3, wxyz_from_rotation
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.sequence import Association, Frames, Sequence, frame_token
from stone_recordings.bags.bag import open_bag
from stone_recordings.clocks.triggers import bearing_rad, trigger_findings
from stone_recordings.sync.sweeps import BagSweeps
from tests.stone_recordings.clocks.streams import MS, every
from tests.stone_recordings.writing import HESAI, KITTI, POINT_CLOUD, CloudText, Recorded, cloud_payload, write_mcap

PERIOD_NS = 100 * MS
STAMPS_NS = every(PERIOD_NS, 12)
# The LiDAR turns clockwise from 170°; cameras every 60°, seen from above.
START_DEG = 170.0
BEARINGS_DEG = {"CAM_FRONT": 90.0, "CAM_FRONT_LEFT": 150.0, "CAM_BACK_LEFT": -150.0, "CAM_BACK": -90.0}


def _camera(name: str, bearing_deg: float) -> Mount:
    """Optical: z along the bearing, x to its right, y down."""
    bearing = np.deg2rad(bearing_deg)
    forward, down = np.array([np.cos(bearing), np.sin(bearing), 0.0]), np.array([0.0, 0.0, -1.0])
    rotation = np.stack([np.cross(down, forward), down, forward], axis=-1)
    return Mount(name, "camera", SE3.from_parts(wxyz_from_rotation(rotation), np.array([0.1, 0.0, -0.1])))


def _phase_ns(name: str) -> int:
    """When the LiDAR looks along this camera's bearing."""
    return round((START_DEG - BEARINGS_DEG[name]) % 360 / 360 * PERIOD_NS)


def _bag(path: Path, record: np.dtype[np.void] = HESAI) -> Path:
    count = 1800
    azimuth = np.deg2rad(START_DEG) - 2 * np.pi * np.arange(count) / count
    points = np.zeros(count, record)
    points["x"], points["y"], points["z"] = 9 * np.cos(azimuth), 9 * np.sin(azimuth), -1.0
    messages = []
    for stamp_ns in STAMPS_NS.tolist():
        if "timestamp" in (record.names or ()):
            points["timestamp"] = (stamp_ns + np.arange(count) * (PERIOD_NS // count)) * 1e-9
        payload = cloud_payload(points, CloudText(stamp_ns=stamp_ns))
        messages.append(Recorded("/lidar", POINT_CLOUD, stamp_ns + PERIOD_NS, payload))
    return write_mcap(path, messages)


def _found(path: Path, fired_ns: Mapping[str, int]) -> tuple[Finding, ...]:
    """What is said of a sequence whose cameras fire so long after each stamp; −1 is a frame without an image."""
    frames = len(STAMPS_NS)
    index = np.where(np.arange(frames) == 3, -1, np.arange(frames))
    associations = {
        name: Association(f"/{name.lower()}/image", index, np.where(index < 0, 0, np.full(frames, late_ns)))
        for name, late_ns in fired_ns.items()
    }
    tokens = tuple(frame_token("run", stamp_ns) for stamp_ns in STAMPS_NS.tolist())
    mounts = tuple(_camera(name, bearing_deg) for name, bearing_deg in BEARINGS_DEG.items())
    sequence = Sequence(
        name="run",
        frames=Frames(STAMPS_NS, tokens, SE3.identity((frames,)), associations),
        excluded=(),
        calibration=Calibration("rig", SE3.identity(), mounts),
        pose_source="none",
    )
    with open_bag(path) as bag:
        return trigger_findings(bag, sequence, BagSweeps(path, "/lidar", np.arange(frames), STAMPS_NS, None))


def _on_time() -> dict[str, int]:
    return {name: _phase_ns(name) for name in BEARINGS_DEG}


def test_a_camera_looks_along_its_optical_axis() -> None:
    for name, bearing_deg in BEARINGS_DEG.items():
        assert np.rad2deg(bearing_rad(_camera(name, bearing_deg))) == pytest.approx(bearing_deg)


def test_cameras_that_fire_when_the_lidar_looks_their_way_have_no_findings(tmp_path: Path) -> None:
    bag = _bag(tmp_path / "run.mcap")
    assert _found(bag, _on_time()) == ()
    jittered = {name: phase_ns + (row - 2) * 800_000 for row, (name, phase_ns) in enumerate(_on_time().items())}
    assert _found(bag, jittered) == ()


def test_the_late_one_is_named_with_how_late_and_how_far_it_turned(tmp_path: Path) -> None:
    fired_ns = _on_time() | {"CAM_BACK": _phase_ns("CAM_BACK") + 5 * MS}
    (found,) = _found(_bag(tmp_path / "run.mcap"), fired_ns)
    assert (found.code, found.topic) == ("TIM-205", "/cam_back/image")
    assert "Fires 5.0" in found.message
    assert "after the LiDAR scans its direction" in found.message
    assert "(18° of its turn; limit 2 ms)" in found.message


def test_swapped_topics_are_both_named_with_each_other(tmp_path: Path) -> None:
    left, right = "CAM_FRONT_LEFT", "CAM_BACK"
    found = _found(_bag(tmp_path / "run.mcap"), _on_time() | {left: _phase_ns(right), right: _phase_ns(left)})
    assert {(one.code, one.topic) for one in found} == {("CAL-406", f"/{name.lower()}/image") for name in (left, right)}
    assert f"where the calibration puts {right}, not {left}" in found[0].message


def test_what_all_cameras_share_is_said_once_of_the_lidar(tmp_path: Path) -> None:
    fired_ns = {name: phase_ns + 7 * MS for name, phase_ns in _on_time().items()}
    (found,) = _found(_bag(tmp_path / "run.mcap"), fired_ns)
    assert (found.code, found.topic) == ("TIM-205", "/lidar")
    assert "7.0" in found.message
    assert "all of them" in found.message


def test_cameras_that_all_fire_at_once_follow_nothing(tmp_path: Path) -> None:
    assert _found(_bag(tmp_path / "run.mcap"), dict.fromkeys(BEARINGS_DEG, 33 * MS)) == ()


def test_nothing_is_said_without_times_of_points_or_with_one_camera(tmp_path: Path) -> None:
    late = _on_time() | {"CAM_BACK": _phase_ns("CAM_BACK") + 5 * MS}
    assert _found(_bag(tmp_path / "untimed.mcap", KITTI), late) == ()
    timed = _bag(tmp_path / "timed.mcap")
    assert _found(timed, {"CAM_BACK": late["CAM_BACK"]}) == ()
    assert _found(timed, {}) == ()
