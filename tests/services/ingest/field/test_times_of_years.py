"""Clocks that are years off: what a finding advises is copied from it, is accepted, and makes the labels right."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml  # type: ignore[import-untyped]

from services.ingest.pipeline import SynchroniseOptions
from stone_local.topic_choices import chosen_offsets
from testing.worlds.field.drive import BEGIN_S, FieldDrive, FieldTopic
from testing.worlds.field.outcome import labelled, labelled_frames, occupied_iou, outcome_of

pytestmark = pytest.mark.whole

SWEEPS = 20
LEAST_IOU = 0.97
GRAIN_NS = 512  # of the drive's own stamps, which are made of seconds in eight bytes
YEARS_S = -110_054_594.75
OPTION, ENTRY = re.compile(r"--time-offset (\S+)"), re.compile(r"calibration with (\{.*\}) among")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, drive = tmp_path_factory.mktemp("sound"), FieldDrive(sweeps=SWEEPS)
    run, calibration = drive.write(folder, drive.lidar_topic(), drive.odometry_topic())
    assert not outcome_of(run, calibration, folder / "labels").errors
    return folder / "labels"


def topics_of(off: FieldDrive, which: str) -> tuple[FieldTopic, ...]:
    right = FieldDrive(sweeps=SWEEPS)
    return tuple(getattr(off if name in which else right, f"{name}_topic")() for name in ("lidar", "odometry"))


CASES = {
    "the LiDAR years ago": ("lidar", BEGIN_S + YEARS_S),
    "the poses years ago": ("odometry", BEGIN_S + YEARS_S),
    "the LiDAR since boot": ("lidar", 668.431_25),
    "the poses since boot": ("odometry", 12.000_001),
    "the LiDAR years ahead": ("lidar", BEGIN_S + 400_000_000.5),
    "the LiDAR ahead by leap seconds": ("lidar", BEGIN_S + 37),
}


@pytest.mark.parametrize("case", CASES)
def test_the_advice_of_a_finding_is_accepted_and_right(tmp_path: Path, sound: Path, case: str) -> None:
    which, begin_s = CASES[case]
    run, calibration = FieldDrive(sweeps=SWEEPS).write(tmp_path, *topics_of(FieldDrive(begin_s, sweeps=SWEEPS), which))
    found = outcome_of(run, calibration, tmp_path / "before")
    assert found.refusal == "SYN-501"
    advised = {option for code in ("TIM-202", "SYN-501") for option in OPTION.findall(found.messages(code))}
    assert len(advised) == 1, advised
    options = SynchroniseOptions(time_offsets_ns=chosen_offsets(sorted(advised)))
    after = outcome_of(run, calibration, tmp_path / "after", options)
    assert (after.refusal, after.errors) == ("", [])
    assert len(labelled_frames(tmp_path / "after")) == SWEEPS
    assert occupied_iou(tmp_path / "after", sound) >= LEAST_IOU


def test_the_entry_of_the_calibration_is_right_to_the_nanosecond(tmp_path: Path, sound: Path) -> None:
    run, calibration = FieldDrive(sweeps=SWEEPS).write(
        tmp_path, *topics_of(FieldDrive(BEGIN_S + YEARS_S, sweeps=SWEEPS), "lidar")
    )
    found = outcome_of(run, calibration, tmp_path / "before")
    entry = ENTRY.search(found.messages("TIM-202"))
    assert entry is not None
    content = yaml.safe_load(calibration.read_text())
    content["sensors"] = {"lidar": yaml.safe_load(entry[1])}
    assert abs(content["sensors"]["lidar"]["time_offset_ns"] - 110_054_594_750_000_000) <= GRAIN_NS
    calibration.write_text(yaml.safe_dump(content))
    after = labelled(run, calibration, tmp_path / "after", SynchroniseOptions())
    assert after.refusal == ""
    assert abs(next(iter(labelled_frames(tmp_path / "after"))) - round(BEGIN_S * 1e9)) <= GRAIN_NS
    assert occupied_iou(tmp_path / "after", sound) >= LEAST_IOU


@pytest.mark.parametrize("are_poses_too", [False, True])
def test_sweeps_before_a_clock_was_set_are_left_out_and_the_others_are_labelled(
    tmp_path: Path, are_poses_too: bool
) -> None:
    """The clock is set after a second; where the poses' is the same one, nothing is left out."""
    right, unset = FieldDrive(sweeps=SWEEPS), FieldDrive(30.5, sweeps=SWEEPS)

    def of(topic: str, t: float) -> Any:
        drive = unset if t < 1.0 else right
        return getattr(drive, topic)(t)

    lidar = right.lidar_topic()._replace(message=lambda t: of("velodyne", t))
    poses = right.odometry_topic()
    if are_poses_too:
        poses = poses._replace(message=lambda t: of("odometry", t))
    run, calibration = right.write(tmp_path, lidar, poses)
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert (found.refusal, found.errors) == ("", [])
    assert found.codes & {"TIM-211", "SYN-501"}
    frames = len(labelled_frames(tmp_path / "labels"))
    assert frames >= SWEEPS - 2 if are_poses_too else frames == SWEEPS - 10
