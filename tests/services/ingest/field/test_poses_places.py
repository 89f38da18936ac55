"""Places as sources write them give the labels of the same drive near the origin, or are named for what they are."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.ingest.sandboxed_inspection import inspected_in
from stone_recordings.bags.bag import open_bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.poses.file_poses import PoseFile
from testing.worlds.field.drive import BEGIN_S, FieldDrive, FieldTopic
from testing.worlds.field.outcome import labelled, occupied_iou, outcome_of

LIKE_THE_SOUND_DRIVE = 0.97
DRIVE = FieldDrive()
UTM_M, NEAR_EQUATOR_M = (447_321.0, 5_411_952.0, 312.0), (500_000.0, 6_350_000.0, 20.0)
SITE = (49.0149, 8.3887, 312.6)
Change = Callable[[float, Any], None]


def odometry(change: Change, step_s: float = 0.02) -> FieldTopic:
    def message(t: float) -> Any:
        made = DRIVE.odometry(t)
        change(t, made.pose.pose)
        return made

    return FieldTopic("/odom", step_s, 0.2, message)


def moved(x_m: float, y_m: float, z_m: float) -> Change:
    def change(_t: float, pose: Any) -> None:
        place = pose.position
        place.x, place.y, place.z = place.x + x_m, place.y + y_m, place.z + z_m

    return change


def zeroed(of: Change, *spans: tuple[float, float]) -> Change:
    """As `of`, and at some times a pose that was never set."""

    def change(t: float, pose: Any) -> None:
        of(t, pose)
        if any(begin <= t < end for begin, end in spans):
            place, turn = pose.position, pose.orientation
            place.x = place.y = place.z = turn.x = turn.y = turn.z = 0.0
            turn.w = 1.0

    return change


def in_ecef(is_turned: bool, site: tuple[float, float, float] = SITE) -> Change:
    """ECEF of the drive at a site; the orientation too, or as in east, north, up."""
    north = Rotation.from_euler("ZX", [90 + site[1], 90 - site[0]], degrees=True)

    def change(_t: float, pose: Any) -> None:
        place, turn = pose.position, pose.orientation
        place.x, place.y, place.z = map(float, pymap3d.enu2ecef(place.x, place.y, place.z, *site))
        if is_turned:
            xyzw = (north * Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])).as_quat()
            turn.x, turn.y, turn.z, turn.w = map(float, xyzw)

    return change


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    run, calibration = DRIVE.write(folder, DRIVE.lidar_topic(), DRIVE.odometry_topic())
    assert labelled(run, calibration, folder / "labels", SynchroniseOptions()).refusal == ""
    return folder / "labels"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (moved(*UTM_M), "(447321, 5411952, 312)"),
        (moved(*NEAR_EQUATOR_M), "(500000, 6350000, 20)"),  # as long as a radius of the Earth
        (moved(89_571.0, 42_301.0, 3.0), "(89571, 42301, 3)"),  # MGRS, as Autoware has it
        (moved(-2_711_000.0, 1_250_000.0, 0.0), "(-2711000, 1250000, 0)"),  # a national grid
    ],
)
def test_a_track_far_from_its_origin_is_labelled_as_near_it(
    tmp_path: Path, sound: Path, change: Change, words: str
) -> None:
    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic(), odometry(change))
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == ""
    assert not found.errors
    assert words in found.messages("SYN-532")
    assert any(words in finding.message for finding in found.label_findings)
    assert occupied_iou(tmp_path / "labels", sound) >= LIKE_THE_SOUND_DRIVE


@pytest.mark.parametrize(("is_turned", "words"), [(True, "in ECEF,"), (False, "in east, north, up,")])
@pytest.mark.parametrize("site", [SITE, (-33.4, -70.6, 520.0), (69.65, 18.95, 15.0)])
def test_ecef_is_turned_to_east_north_up(
    tmp_path: Path, is_turned: bool, words: str, site: tuple[float, float, float]
) -> None:
    run, file = DRIVE.write(tmp_path, DRIVE.lidar_topic(), odometry(in_ecef(is_turned, site)))
    with open_bag(run) as bag:
        calibration, _ = read_calibration(file, bag)
        findings = inspected_in(bag, calibration=file).findings
    assert not [finding for finding in findings if finding.severity == "error"]
    assert words in next(finding.message for finding in findings if finding.code == "SYN-532")
    plain, as_sound = DRIVE.write(tmp_path / "near", DRIVE.lidar_topic(), DRIVE.odometry_topic())
    options = SynchroniseOptions(is_hashed=False, is_checked=False)
    poses, near = (synchronise(one, calibration, options, "run")[0].frames.map_from_ego for one in (run, plain))
    assert as_sound.exists()
    apart = (near[0].inverse() @ near).inverse() @ (poses[0].inverse() @ poses)
    assert np.abs(apart.translation_m).max() < 1e-3
    assert np.abs(apart.wxyz[:, 1:]).max() < 1e-4


def test_ecef_whose_attitude_stands_upright_nowhere_is_refused(tmp_path: Path) -> None:
    def change(t: float, pose: Any) -> None:
        in_ecef(is_turned=True)(t, pose)
        turn = pose.orientation
        xyzw = (
            Rotation.from_euler("Y", 120, degrees=True) * Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
        ).as_quat()
        turn.x, turn.y, turn.z, turn.w = map(float, xyzw)

    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic(), odometry(change))
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == "SYN-534"
    assert [finding.code for finding in found.errors] == ["SYN-534"]


@pytest.mark.parametrize("spans", [[(-0.2, 0.25)], [(0.5, 0.7), (2.0, 2.2)], [(3.8, 4.3)], [(-0.2, 1.0)]])
def test_poses_of_zeros_in_a_utm_track_cost_their_frames_only(
    tmp_path: Path, sound: Path, spans: list[tuple[float, float]]
) -> None:
    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic(), odometry(zeroed(moved(*UTM_M), *spans)))
    options = SynchroniseOptions(is_hashed=False, is_checked=False)
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == ""
    assert not found.errors
    assert "far from the others" in found.messages("GNS-310")
    with open_bag(run) as bag:
        mount, _ = read_calibration(calibration, bag)
    frames = synchronise(run, mount, options, "run")[0].frames
    lost = sum(round((end - max(begin, 0.0)) * 10) for begin, end in spans)
    assert len(frames) >= 40 - lost - 2 * len(spans)
    assert np.abs(frames.map_from_ego.translation_m).max() < 50


FIXES: dict[str, Change] = {
    "zeros at the beginning and midway": lambda t, fix: zero_fix(fix) if t < 0.25 or 1.95 < t < 2.15 else None,
    "heights of zero": lambda t, fix: setattr(fix, "altitude", 0.0) if 1.0 < t < 1.35 else None,
    "another continent": lambda t, fix: setattr(fix, "longitude", -70.0) if t < 0.15 else None,
    "some kilometres off": lambda t, fix: setattr(fix, "latitude", fix.latitude + 0.05) if 1.0 < t < 1.35 else None,
}


def zero_fix(fix: Any) -> None:
    fix.latitude = fix.longitude = 0.0
    fix.altitude, fix.position_covariance = 48.2, np.zeros(9)


@pytest.mark.parametrize("case", FIXES)
def test_fixes_far_from_the_others_cost_their_frames_only(tmp_path: Path, case: str) -> None:
    def message(t: float) -> Any:
        made = DRIVE.fix(t)
        FIXES[case](t, made)
        return made

    imu = FieldTopic("/imu", 0.01, 0.2, DRIVE.imu)
    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic(), FieldTopic("/fix", 0.1, 0.2, message), imu)
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == ""
    assert not found.errors
    assert "GNS-310" in found.codes
    assert not {"GNS-302", "SYN-508"} & found.codes
    with open_bag(run) as bag:
        mount, _ = read_calibration(calibration, bag)
    sequence = synchronise(run, mount, SynchroniseOptions(is_hashed=False, is_checked=False), "run")[0]
    assert sequence.map_origin_deg_m == pytest.approx(SITE, abs=2.0)
    assert len(sequence.frames) >= 30
    assert np.abs(sequence.frames.map_from_ego.translation_m).max() < 20


def in_degrees(is_swapped: bool, is_turning: bool = True) -> Change:
    def change(_t: float, pose: Any) -> None:
        place = pose.position
        latitude, longitude, place.z = map(float, pymap3d.enu2geodetic(place.x, place.y, place.z, *SITE))
        place.x, place.y = (latitude, longitude) if is_swapped else (longitude, latitude)
        if not is_turning:
            pose.orientation.z, pose.orientation.w = 0.0, 1.0

    return change


@pytest.mark.parametrize("is_swapped", [True, False])
@pytest.mark.parametrize("is_turning", [True, False])
def test_positions_in_degrees_are_named(tmp_path: Path, is_swapped: bool, is_turning: bool) -> None:
    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic(), odometry(in_degrees(is_swapped, is_turning)))
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == "SYN-533"
    assert [finding.code for finding in found.errors] == ["SYN-533"]
    with open_bag(run) as bag:
        assert "SYN-533" in {one.code for one in inspected_in(bag).findings if one.severity == "error"}


@pytest.mark.parametrize("unit", [1.0, float(np.rad2deg(1.0))])
def test_angles_in_the_place_of_a_quaternion_are_refused(tmp_path: Path, unit: float) -> None:
    def change(_t: float, pose: Any) -> None:
        turn = pose.orientation
        yaw = 2 * float(np.arctan2(turn.z, turn.w))
        turn.x, turn.y, turn.z, turn.w = 0.01 * unit, 0.02 * unit, yaw * unit, 0.0

    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic(), odometry(change))
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == "MSG-305"
    assert [finding.code for finding in found.errors] == ["MSG-305"]


def test_a_pose_file_in_utm_is_labelled_as_near_the_origin(tmp_path: Path, sound: Path) -> None:
    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic())
    lines = []
    for t in np.arange(-0.2, 4.2, 0.02):
        pose = DRIVE.pose_message(float(t))
        moved(*UTM_M)(t, pose)
        place, turn = pose.position, pose.orientation
        lines.append(f"{BEGIN_S + t:.3f} {place.x:.6f} {place.y:.6f} {place.z:.6f} 0 0 {turn.z:.9f} {turn.w:.9f}\n")
    file = tmp_path / "poses.txt"
    file.write_text("".join(lines))
    found = outcome_of(run, calibration, tmp_path / "labels", SynchroniseOptions(poses=PoseFile(file)))
    assert found.refusal == ""
    assert "SYN-532" in found.codes
    assert occupied_iou(tmp_path / "labels", sound) >= LIKE_THE_SOUND_DRIVE
