"""Points and headers of clocks that were never set, or of two clocks: times are read by nearness, a shift is named.

Labels are compared with those of the same drive on one clock that is set.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testing.worlds.field.drive import BEGIN_S, SWEEP_S, FieldDrive
from testing.worlds.field.outcome import FieldOutcome, labelled_frames, occupied_iou, outcome_of

pytestmark = pytest.mark.whole

LEAST_IOU = 0.97
SWEEPS = 16
BOOT_S, LONG_AGO_S = 668.4, 1_577_836_800.25  # 2020-01-01
HOUR_S = 3600.0


def record_of(code: str) -> np.dtype[Any]:
    return np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), ("timestamp", code)])


def recorded(drive: FieldDrive, code: str, unit_s: float, begin_s: float, late: float, t: float) -> Any:
    """Return the cloud of a sweep whose stamp is `late` of a sweep after its first point; `begin_s` is by its clock."""
    points, after_s = drive.points(t, record_of(code))
    whole, rest = divmod(begin_s, 1.0)
    values = (whole / unit_s) + (rest + t + after_s) / unit_s
    points["timestamp"] = np.rint(values).astype(np.int64).astype(code) if "u" in code else values
    return drive.cloud(t + late * SWEEP_S, points)


def found_of(folder: Path, drive: FieldDrive, message: Callable[[float], Any]) -> FieldOutcome:
    run, calibration = drive.write(folder, drive.lidar_topic()._replace(message=message), drive.odometry_topic())
    return outcome_of(run, calibration, folder / "labels")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float], Path]:
    """Return the labels of the drive whose stamps are a part of a sweep after its first point."""

    @cache
    def of(late: float) -> Path:
        drive = FieldDrive(sweeps=SWEEPS)
        made = found_of(tmp_path_factory.mktemp("sound"), drive, partial(recorded, drive, "f8", 1.0, BEGIN_S, late))
        assert made.labels is not None
        return made.labels

    return of


ONE_CLOCK = {  # field, its unit in seconds, when its clock and the header's begin, part of a sweep before the stamp
    "seconds since boot": ("f8", 1.0, BOOT_S, BOOT_S, 0.999),
    "seconds since boot in four bytes": ("f4", 1.0, BOOT_S, BOOT_S, 0.0),
    "nanoseconds since boot": ("f8", 1e-9, BOOT_S, BOOT_S, 0.5),
    "microseconds": ("f8", 1e-6, BEGIN_S, BEGIN_S, 0.0),
    "nanoseconds": ("f8", 1e-9, BEGIN_S, BEGIN_S, 1.0),
    "simulated time": ("f8", 1.0, 0.4, 0.4, 0.0),
    "simulated nanoseconds": ("u4", 1e-9, 0.1, 0.1, 0.0),
    "microseconds of the hour": ("u4", 1e-6, BEGIN_S % HOUR_S, BEGIN_S, 0.0),
}


@pytest.mark.parametrize("case", ONE_CLOCK)
def test_points_and_headers_of_one_clock_are_read_whatever_it_counts_from(
    tmp_path: Path, sound: Any, case: str
) -> None:
    code, unit_s, points_s, begin_s, late = ONE_CLOCK[case]
    drive = FieldDrive(begin_s, sweeps=SWEEPS)
    found = found_of(tmp_path, drive, partial(recorded, drive, code, unit_s, points_s, late))
    assert (found.refusal, found.errors) == ("", [])
    assert not found.codes & {"TOP-102", "MSG-321", "MSG-322", "TIM-220", "TIM-202"}
    assert len(labelled_frames(tmp_path / "labels")) == SWEEPS
    assert occupied_iou(tmp_path / "labels", sound(late)) >= LEAST_IOU


def test_microseconds_begin_anew_within_a_sweep_at_the_hour(tmp_path: Path, sound: Any) -> None:
    drive = FieldDrive(HOUR_S * 472_222 - 1.04, sweeps=SWEEPS)

    def message(t: float) -> Any:
        points, after_s = drive.points(t, record_of("u4"))
        points["timestamp"] = np.rint((drive.begin_s % HOUR_S + t + after_s) * 1e6).astype(np.int64) % 3_600_000_000
        return drive.cloud(t, points)

    found = found_of(tmp_path, drive, message)
    assert (found.refusal, found.errors) == ("", [])
    assert not found.codes & {"TOP-102", "MSG-321", "MSG-322", "TIM-220"}
    assert occupied_iou(tmp_path / "labels", sound(0.0)) >= LEAST_IOU


TWO_CLOCKS = {
    "since boot under the host's date": ("f8", 1.0, BOOT_S, 0.0),
    "years ago, stamped at the end": ("f8", 1.0, LONG_AGO_S, 1.0),
    "leap seconds": ("f8", 1.0, BEGIN_S + 37, 0.0),
    "two seconds": ("f8", 1.0, BEGIN_S - 2, 1.0),
    "GPS microseconds of the hour": ("u4", 1e-6, (BEGIN_S + 18) % HOUR_S, 0.0),
    "nanoseconds since boot": ("u4", 1e-9, 1.9, 0.0),
}


@pytest.mark.parametrize("case", TWO_CLOCKS)
def test_points_of_another_clock_are_read_by_the_constant_between_the_two(
    tmp_path: Path, sound: Any, case: str
) -> None:
    """The recorder has a sweep 110 ms after its first point, whatever its stamp is of."""
    code, unit_s, points_s, late = TWO_CLOCKS[case]
    drive = FieldDrive(sweeps=SWEEPS)
    found = found_of(tmp_path, drive, partial(recorded, drive, code, unit_s, points_s, late))
    assert (found.refusal, found.errors) == ("", [])
    for codes in (found.codes, {finding.code for finding in found.label_findings}):
        assert "TIM-220" in codes
        assert not codes & {"TOP-102", "MSG-321", "MSG-322"}
    point = "last" if late else "first"
    assert f"The {point} point of a sweep counts as simultaneous with its stamp" in found.messages("TIM-220")
    assert len(labelled_frames(tmp_path / "labels")) == SWEEPS
    assert occupied_iou(tmp_path / "labels", sound(late)) >= LEAST_IOU


@pytest.mark.parametrize(("code", "unit_s"), [("u4", 1e-9), ("f4", 1.0), ("f8", 1e-9)])
def test_times_that_begin_anew_each_second_are_read(tmp_path: Path, sound: Any, code: str, unit_s: float) -> None:
    drive = FieldDrive(sweeps=SWEEPS)

    def message(t: float) -> Any:
        points, after_s = drive.points(t, record_of(code))
        values = ((t + after_s) % 1.0) / unit_s
        points["timestamp"] = values.astype(np.int64).astype(code) if "u" in code else values
        return drive.cloud(t, points)

    found = found_of(tmp_path, drive, message)
    assert (found.refusal, found.errors) == ("", [])
    assert not found.codes & {"TOP-102", "MSG-322"}
    assert len(labelled_frames(tmp_path / "labels")) == SWEEPS
    assert occupied_iou(tmp_path / "labels", sound(0.0)) >= LEAST_IOU


def test_points_of_no_constant_clock_and_dates_in_four_bytes_are_named(tmp_path: Path) -> None:
    drive, rng = FieldDrive(sweeps=SWEEPS), np.random.default_rng(1)
    wild = found_of(tmp_path / "wild", drive, lambda t: recorded(drive, "f8", 1.0, BOOT_S + rng.uniform(0, 9), 0.0, t))
    assert "another clock" in wild.messages("TOP-102")
    coarse = found_of(tmp_path / "coarse", drive, partial(recorded, drive, "f4", 1.0, BEGIN_S, 0.0))
    assert "four bytes" in coarse.messages("TOP-102")
