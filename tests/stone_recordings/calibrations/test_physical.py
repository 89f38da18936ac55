"""The physical test on the simulated rig: right calibrations pass, each way to be wrong is found and named."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.calibration_diff import difference
from stone.sensors.camera_views import least_seen_ratio
from stone_recordings.bags.bag import open_bag
from stone_recordings.calibrations.file import read_any_calibration
from stone_recordings.poses.extrinsics import StaticTree, cross_check
from stone_recordings.report.projection_checks import projection_findings
from stone_recordings.sync.camera_sweeps import pairs
from stone_recordings.sync.validity import validity_findings
from tests.stone_recordings.calibrations.conftest import Drive

SIDES = ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"]


def found(drive: Drive, calibration: Calibration) -> tuple[Finding, ...]:
    with open_bag(drive.path) as bag:
        return projection_findings(bag, replace(drive.sequence, calibration=calibration), drive.sweeps)


def with_mount(calibration: Calibration, mount: Mount) -> Calibration:
    mounts = tuple(mount if mount.name == one.name else one for one in calibration.mounts)
    return replace(calibration, mounts=mounts)


def turned(mount: Mount, rotvec: tuple[float, float, float]) -> Mount:
    """The mount turned about its own axes."""
    turn = SE3.from_parts(np.roll(Rotation.from_rotvec(rotvec).as_quat(), 1), np.zeros(3))
    return replace(mount, lidar_from_sensor=mount.lidar_from_sensor @ turn)


def test_the_clean_drive_has_no_finding_nor_one_with_a_camera_upside_down(drive: Drive) -> None:
    assert found(drive, drive.sequence.calibration) == ()
    calibration = drive.sequence.calibration
    assert found(drive, with_mount(calibration, turned(calibration.mount("CAM_BACK"), (0, 0, np.pi)))) == ()


@pytest.mark.parametrize("channel", ["CAM_FRONT", "CAM_BACK_LEFT"])
def test_an_inverted_extrinsic_is_found_and_named(drive: Drive, channel: str) -> None:
    calibration = drive.sequence.calibration
    mount = calibration.mount(channel)
    inverted = replace(mount, lidar_from_sensor=mount.lidar_from_sensor.inverse())
    findings = found(drive, with_mount(calibration, inverted))
    assert [(finding.code, finding.severity, finding.topic) for finding in findings] == [("CAL-404", "error", channel)]


def test_a_back_camera_that_is_its_own_inverse_is_told_by_tf_static(drive: Drive) -> None:
    """Seen from a Hesai (y forward) the rear camera's rotation is symmetric; only its place gives the inverse away."""
    calibration = drive.sequence.calibration
    mount = calibration.mount("CAM_BACK")
    assert mount is not None
    tree = StaticTree.of([("hesai", mount.frame_id, mount.lidar_from_sensor)])
    inverted = with_mount(calibration, replace(mount, lidar_from_sensor=mount.lidar_from_sensor.inverse()))
    findings = cross_check(tree, inverted, "hesai")
    assert [(finding.code, finding.topic) for finding in findings] == [("CAL-414", "CAM_BACK")]
    assert findings[0].message.endswith("it is the inverse of tf_static's transform: one of the two is inverted")


def test_all_cameras_inverted_or_ego_from_lidar_are_named_each(drive: Drive) -> None:
    calibration = drive.sequence.calibration
    mounts = tuple(replace(mount, lidar_from_sensor=mount.lidar_from_sensor.inverse()) for mount in calibration.mounts)
    findings = found(drive, replace(calibration, mounts=mounts))
    assert {finding.topic for finding in findings} == set(SIDES)
    findings = found(drive, replace(calibration, ego_from_lidar=calibration.ego_from_lidar.inverse()))
    assert [(finding.code, finding.topic) for finding in findings] == [("CAL-404", "ego_from_lidar")]


def test_a_camera_that_looks_at_the_sky_sees_too_few_points_and_a_narrow_lens_needs_fewer(drive: Drive) -> None:
    calibration = drive.sequence.calibration
    up = turned(calibration.mount("CAM_FRONT"), (np.pi / 2, 0, 0))
    findings = found(drive, with_mount(calibration, up))
    assert [(finding.code, finding.topic) for finding in findings] == [("CAL-404", "CAM_FRONT")]
    assert findings[0].message.startswith("CAM_FRONT: 0.0 % of the LiDAR's points project into it (expected: > 5.0 %)")
    lens = drive.sequence.calibration.mount("CAM_FRONT").intrinsics
    assert least_seen_ratio(lens) == 0.05
    narrow = replace(lens, fx_px=lens.fx_px * 5)
    width_rad = 2 * np.arctan(narrow.width_px / 2 / narrow.fx_px)
    assert least_seen_ratio(narrow) == pytest.approx(width_rad / (4 * np.pi))


def test_pictures_of_another_size_than_calibrated_are_an_error(drive: Drive) -> None:
    calibration = drive.sequence.calibration
    mount = calibration.mount("CAM_FRONT")
    lens = replace(mount.intrinsics, width_px=480, height_px=300, cx_px=240, cy_px=150)
    findings = found(drive, with_mount(calibration, replace(mount, intrinsics=lens)))
    assert [(finding.code, finding.severity, finding.topic) for finding in findings] == [
        ("CAL-403", "error", "CAM_FRONT")
    ]


def test_a_camera_nobody_calibrated_is_said(drive: Drive) -> None:
    sequence = drive.sequence
    associations = dict(sequence.frames.associations)
    associations["/camera/front/image/compressed"] = associations.pop("CAM_FRONT")
    frames = replace(sequence.frames, associations=associations)
    with open_bag(drive.path) as bag:
        findings = projection_findings(bag, replace(sequence, frames=frames), drive.sweeps)
    assert [(finding.code, finding.severity) for finding in findings] == [("CAL-412", "warning")]


def test_the_motion_between_sweep_and_exposure_is_undone(drive: Drive) -> None:
    """Points fixed in the world, seen from where the robot was at the exposure, by matrices."""
    sequence, trajectory = drive.sequence, drive.sweeps.mount.trajectory
    with open_bag(drive.path) as bag:
        found = list(pairs(bag, sequence, drive.sweeps, 1))
    pair = next(pair for pair in found if pair.mount.name == "CAM_BACK_RIGHT")
    association = sequence.frames.associations["CAM_BACK_RIGHT"]
    frame = int(np.flatnonzero(association.message_index == pair.message_index)[0])
    stamp_ns, dt_ns = int(sequence.frames.stamps_ns[frame]), int(association.dt_ns[frame])
    assert dt_ns > 50_000_000
    at_stamp, at_image = trajectory.at(np.array([stamp_ns, stamp_ns + dt_ns])).map_from_ego.as_matrix()
    ego_from_lidar = sequence.calibration.ego_from_lidar.as_matrix()
    ego_from_camera = ego_from_lidar @ pair.mount.lidar_from_sensor.as_matrix()
    expected = np.linalg.inv(at_image @ ego_from_camera) @ at_stamp @ ego_from_lidar
    np.testing.assert_allclose(pair.camera_from_lidar.as_matrix(), expected, atol=1e-9)
    still = np.linalg.inv(ego_from_camera) @ ego_from_lidar
    assert np.abs(expected - still).max() > 0.01, "the robot drove on in between"


def test_a_recording_is_its_own_calibration(drive: Drive) -> None:
    read = read_any_calibration(drive.path)
    assert (read.format, [finding.code for finding in read.findings]) == ("tf_static", ["CAL-436"])
    found_difference = difference(drive.sequence.calibration, read.calibration)
    assert [sensor.status for sensor in found_difference.sensors] == ["same"] * len(read.calibration.mounts)
    assert found_difference.ego_from_lidar.is_same


def test_a_calibration_out_of_its_time_is_doubted(drive: Drive) -> None:
    stamps_ns = drive.sequence.frames.stamps_ns
    first_ns, last_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    for times in ((None, None), (first_ns, last_ns + 1), (first_ns, None), (None, last_ns + 1)):
        assert validity_findings(drive.sequence, *times) == ()
    for times in ((first_ns + 1, None), (None, last_ns), (last_ns + 1, None), (None, first_ns)):
        findings = validity_findings(drive.sequence, *times)
        assert [(finding.code, finding.severity) for finding in findings] == [("CAL-418", "warning")]
