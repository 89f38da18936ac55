"""Every recording, dataset and submission that was rebuilt from a public report, by the commands that its owner types.

**Conventions.** The makers are by others, beside the project (`field_cases` of the real recordings). Labels are
compared with those of the sound drive of `testing.worlds.field`, which goes over the same ground at the same times.
"""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from stone_client.main import app
from testing.worlds.field.drive import BEGIN_S, HESAI, FieldDrive, FieldTopic
from testing.worlds.field.outcome import labelled_frames, occupied_iou

pytestmark = pytest.mark.whole

ALIKE = 0.97


@dataclass(frozen=True)
class PublicCase:
    """What is right for a recording: whether labels are made of it, and what inspection names on the way.

    `twin` is the sound drive that its labels are compared with, in at least so many frames.
    """

    maker: str
    named: tuple[str, ...] = ()
    is_refused: bool = False
    unnamed: tuple[str, ...] = ()
    twin: str = "start"
    frames: int = 40


RECORDINGS = (
    PublicCase("camera_of_yuyv"),
    PublicCase("fast_lio_cloud_in_body", unnamed=("tf_static",)),
    PublicCase("livox_custom_msg"),
    PublicCase("navsatfix_zeros_with_status_0", named=("GNS-310",), twin="fixes", frames=34),
    PublicCase(
        "odometry_gps_without_heading", named=("/odometry/gps", "--odometry course:/odometry/gps"), is_refused=True
    ),
    PublicCase("odometry_in_utm", named=("447",)),
    PublicCase("ouster_t_below_stamp"),
    PublicCase("pcl_row_step_of_first_cloud", named=("row_step",)),
    PublicCase("robosense_boot_clock", twin="end"),
    PublicCase("sensor_clock_years_off", named=("TIM-202", "--time-offset"), is_refused=True),
    PublicCase("simulated_time_exported"),
    PublicCase("velodyne_row_step_0", named=("row_step",)),
)


def stone(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def made(field_data: Path, maker: str, folder: Path) -> Path:
    """Run the maker; return what it made, beside which its calibration lies."""
    script = field_data / "field_cases" / f"{maker}.py"
    if not script.is_file():
        pytest.skip(f"no maker at {script}")
    subprocess.run([sys.executable, script, folder / maker], check=True, timeout=120)
    return folder / maker


def is_lost(t: float) -> bool:
    """Whether the receiver of `navsatfix_zeros_with_status_0` has no fix."""
    return t < 0.25 or 1.95 < t < 2.15


def end_stamped(drive: FieldDrive, t: float) -> Any:
    """Return the cloud of a sweep that is stamped at its end, its points with their dates."""
    points, after_s = drive.points(t, HESAI)
    points["timestamp"] = BEGIN_S + t + after_s
    return drive.cloud(t + 0.0999, points)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the labels of the sound drive: with odometry, with an IMU and a receiver that wrote no zeros, with
    sweeps stamped at their end."""
    folder, drive = tmp_path_factory.mktemp("sound"), FieldDrive()
    fixes = FieldTopic("/gps/fix", 0.1, 0.2, lambda t: None if is_lost(t) else drive.fix(t))
    twins = {
        "start": (drive.lidar_topic(), drive.odometry_topic()),
        "fixes": (drive.lidar_topic(), fixes, FieldTopic("/imu/data", 0.01, 0.2, drive.imu)),
        "end": (FieldTopic("/points", 0.1, 0.0, lambda t: end_stamped(drive, t)), drive.odometry_topic()),
    }
    for name, topics in twins.items():
        run, calibration = drive.write(folder / name, *topics)
        assert stone("label", run, "--calibration", calibration, "-o", folder / name / "labels").exit_code == 0
    return {name: folder / name / "labels" for name in twins}


@pytest.mark.parametrize("case", RECORDINGS, ids=lambda case: case.maker)
def test_a_recording_is_labelled_as_its_sound_twin_or_refused_beforehand(
    case: PublicCase, field_data: Path, sound: dict[str, Path], tmp_path: Path
) -> None:
    run = made(field_data, case.maker, tmp_path)
    calibration, labels, exported = run.with_suffix(".yaml"), tmp_path / "labels", tmp_path / "export"
    plain, seen = stone("inspect", run), stone("inspect", run, "--calibration", calibration)
    label = stone("label", run, "--calibration", calibration, "-o", labels)
    assert [one.exit_code for one in (plain, seen, label)] == [int(case.is_refused)] * 3, seen.stderr + label.stderr
    for result in (plain, seen):
        assert not [word for word in case.named if word not in result.stderr], result.stderr
        assert not [word for word in case.unnamed if word in result.stderr], result.stderr
    if case.is_refused:
        assert not labels.exists()
        return
    assert len(labelled_frames(labels)) >= case.frames
    assert occupied_iou(labels, sound[case.twin]) >= ALIKE
    assert stone("export", labels, "--format", "nuscenes", "-o", exported).exit_code == 0
    checked = stone("check", exported)
    assert checked.exit_code == 0, checked.stderr


@pytest.mark.parametrize(
    ("maker", "code", "cause"),
    [
        ("dataset_stamps_in_seconds", "DST-016", "seconds"),
        ("dataset_written_on_windows", "DST-004", "backslash"),
    ],
)
def test_a_dataset_is_refused_by_the_cause(maker: str, code: str, cause: str, field_data: Path, tmp_path: Path) -> None:
    checked = stone("check", made(field_data, maker, tmp_path))
    assert checked.exit_code == 1
    assert code in checked.stderr
    assert cause in checked.stderr
    assert "written as text" not in checked.stderr
    assert "outside" not in checked.stderr


def test_the_good_dataset_passes(field_data: Path, tmp_path: Path) -> None:
    checked = stone("check", made(field_data, "dataset_good_baseline", tmp_path))
    assert checked.exit_code == 0, checked.stderr


def test_a_submission_in_the_layout_of_the_labels_is_refused_with_the_line_that_mends_it(
    field_data: Path, tmp_path: Path
) -> None:
    folder = made(field_data, "submission_in_layout_of_labels", tmp_path)
    refused = stone("validate", folder / "sub.zip", "--manifest", folder / "m.json")
    assert refused.exit_code == 1
    assert "labels.npz" in refused.stderr
    assert "<frame_token>.npz" in refused.stderr
