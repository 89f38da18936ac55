"""Clouds that contradict themselves: their bytes decide, a finding names what is ignored, labels are unchanged."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions
from testing.worlds.field.drive import COLUMNS, RINGS, VELODYNE, FieldDrive
from testing.worlds.field.outcome import labelled, labelled_frames, occupied_iou, outcome_of

pytestmark = pytest.mark.whole

SWEEPS = 16
POINTS, STEP = RINGS * COLUMNS, VELODYNE.itemsize
Declared = Callable[[int], dict[str, Any]]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, drive = tmp_path_factory.mktemp("sound"), FieldDrive(sweeps=SWEEPS)
    run, calibration = drive.write(folder, drive.lidar_topic(), drive.odometry_topic())
    assert not outcome_of(run, calibration, folder / "labels").errors
    return folder / "labels"


def fields_of(drive: FieldDrive, *further: Any) -> list[Any]:
    return [*drive.velodyne(0.0).fields, *(drive.of("sensor_msgs/msg/PointField", *one) for one in further)]


DECLARED: dict[str, Declared] = {
    "no row step": lambda _: {"row_step": 0},
    "the row step of the first of two": lambda _: {"row_step": POINTS * STEP // 2},
    "points for the row step": lambda _: {"row_step": POINTS},
    "a padded row": lambda _: {"row_step": POINTS * STEP + 64},
    "rows and columns swapped": lambda _: {"height": RINGS, "width": COLUMNS, "row_step": RINGS * STEP},
    "a width too small": lambda _: {"width": POINTS - 240, "row_step": (POINTS - 240) * STEP},
    "a width too large": lambda _: {"width": POINTS + 240, "row_step": (POINTS + 240) * STEP},
    "one of the sweeps empty by its width": lambda number: {"width": 0, "row_step": 0} if number == 3 else {},
    "no height": lambda _: {"height": 0},
    "a point step without its last field": lambda _: {"point_step": STEP - 4},
    "no point step": lambda _: {"point_step": 0},
}


@pytest.mark.parametrize("case", DECLARED)
def test_what_the_bytes_refute_is_ignored(tmp_path: Path, sound: Path, case: str) -> None:
    drive = FieldDrive(sweeps=SWEEPS)
    lidar = drive.lidar_topic()._replace(message=lambda t: drive.velodyne(t, **DECLARED[case](round(t * 10))))
    run, calibration = drive.write(tmp_path, lidar, drive.odometry_topic())
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert (found.refusal, found.errors) == ("", [])
    assert "MSG-320" in {finding.code for finding in found.label_findings} or "one of" in case
    assert not found.codes & {"MSG-303", "MSG-312"}
    assert len(labelled_frames(tmp_path / "labels")) == SWEEPS
    assert occupied_iou(tmp_path / "labels", sound) == pytest.approx(1.0)


def test_fields_that_are_declared_twice_or_of_no_type_are_ignored_and_the_rest_is_no_contradiction(
    tmp_path: Path, sound: Path
) -> None:
    """Counts of 0, points without a return in a dense cloud, and padding behind a point are as other drivers write."""
    drive = FieldDrive(sweeps=SWEEPS)
    names = list(VELODYNE.names or ())
    fields_at = [*(VELODYNE.fields or {}).values()]
    formats, offsets = [one[0] for one in fields_at], [one[1] for one in fields_at]
    padded = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 48})

    def message(t: float) -> Any:
        returns, after_s = drive.points(t, padded)
        returns["time"] = after_s
        points = np.zeros(len(returns) + 5, padded)
        points[:-5] = returns
        for name in "xyz":
            points[name][-5:] = np.nan
        fields = fields_of(drive, ("x", 24, 7, 1), ("tag", 28, 99, 1), ("far", 60, 7, 1))
        fields[3].count = 0
        return drive.cloud(t, points, fields=fields, is_dense=True)

    run, calibration = drive.write(tmp_path, drive.lidar_topic()._replace(message=message), drive.odometry_topic())
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert (found.refusal, found.errors) == ("", [])
    assert "a second field 'x'" in found.messages("MSG-320")
    assert occupied_iou(tmp_path / "labels", sound) == pytest.approx(1.0)


def test_clouds_whose_bytes_leave_a_doubt_are_left_out_and_counted(tmp_path: Path) -> None:
    drive = FieldDrive(sweeps=SWEEPS)

    def message(t: float) -> Any:
        cloud = drive.velodyne(t)
        if round(t * 10) % 4 == 1:
            cloud.data = cloud.data[:-5]
        return cloud

    run, calibration = drive.write(tmp_path, drive.lidar_topic()._replace(message=message), drive.odometry_topic())
    found = labelled(run, calibration, tmp_path / "labels", SynchroniseOptions())
    assert found.refusal == ""
    assert f"4 of {SWEEPS} sweeps" in " ".join(one.message for one in found.label_findings if one.code == "MSG-303")
    assert len(labelled_frames(tmp_path / "labels")) == SWEEPS - 4
