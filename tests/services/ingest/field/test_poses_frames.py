"""Frames that the clouds and the poses share: nothing cites a /tf_static that the recording lacks."""

from pathlib import Path
from typing import Any

import pytest

from testing.worlds.field.drive import LIDAR_UP_M, FieldDrive, FieldTopic
from testing.worlds.field.outcome import FieldOutcome, occupied_iou, outcome_of

LIKE_THE_SOUND_DRIVE = 0.97


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The labels of the drive as it should be recorded."""
    folder, drive = tmp_path_factory.mktemp("sound"), FieldDrive(sweeps=16)
    run, calibration = drive.write(folder, drive.lidar_topic(), drive.odometry_topic())
    assert outcome_of(run, calibration, folder / "labels").refusal == ""
    return folder / "labels"


def drive_of(folder: Path, cloud_frame: str, parent: str, child: str, up_m: float) -> FieldOutcome:
    """Return what becomes of a drive whose clouds and poses name these frames; the poses are `up_m` above the base."""
    drive = FieldDrive(sweeps=16)

    def odometry(t: float) -> Any:
        message = drive.odometry(t, parent, child)
        message.pose.pose.position.z += up_m
        return message

    clouds = FieldTopic("/points", 0.1, 0.0, lambda t: drive.velodyne(t, cloud_frame))
    run, calibration = drive.write(folder, clouds, FieldTopic("/odometry", 0.1, 0.2, odometry))
    return outcome_of(run, calibration, folder / "labels")


@pytest.mark.parametrize(
    ("cloud_frame", "parent", "child", "up_m"),
    [
        ("body", "camera_init", "body", LIDAR_UP_M),  # FAST-LIO: /cloud_registered_body
        ("aft_mapped", "camera_init", "aft_mapped", LIDAR_UP_M),  # Point-LIO, A-LOAM
        ("base_link", "map", "base_link", LIDAR_UP_M),  # LIO-SAM as it comes: its lidarFrame is base_link
        ("velodyne", "odom", "base_link", 0.0),  # LIO-SAM with a base of its own
        ("livox_frame", "camera_init", "livox_frame", LIDAR_UP_M),
    ],
)
def test_no_finding_cites_mounts_that_nobody_published(
    tmp_path: Path, sound: Path, cloud_frame: str, parent: str, child: str, up_m: float
) -> None:
    found = drive_of(tmp_path, cloud_frame, parent, child, up_m)
    assert found.refusal == ""
    told = [finding.message for finding in (*found.findings, *found.label_findings)]
    assert not [sentence for sentence in told if "tf_static puts" in sentence or "/tf_static has" in sentence]
    assert "CAL-414" not in found.codes
    assert occupied_iou(tmp_path / "labels", sound) >= LIKE_THE_SOUND_DRIVE
