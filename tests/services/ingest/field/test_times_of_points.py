"""Point times as drivers get them wrong: every sweep is deskewed all the same, and a finding counts the bad ones.

Labels are compared with those of the same drive with times as they should be.
"""

from collections.abc import Callable
from functools import cache, partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from testing.worlds.field.drive import BEGIN_S, COLUMNS, RINGS, SWEEP_S, FieldDrive
from testing.worlds.field.outcome import FieldOutcome, labelled_frames, occupied_iou, outcome_of

pytestmark = pytest.mark.whole

OUSTER = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t", "ring"],
        "formats": ["f4", "f4", "f4", "f4", "u4", "u2"],
        "offsets": [0, 4, 8, 16, 20, 26],
        "itemsize": 48,
    }
)
SWEEPS, LEAST_IOU = 16, 0.97  # inspection looks at as many, so its counts are those of all
LEAST_COUNTED = 0.95
Times = NDArray[Any]
COLUMN = np.repeat(np.arange(COLUMNS), RINGS)


def record_of(name: str, code: str) -> np.dtype[Any]:
    return np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), (name, code)])


RECORDS = {
    "s": record_of("time", "f4"), "date": record_of("timestamp", "f8"), "ns": OUSTER,
    "float ns": record_of("t", "f8"), "µs": record_of("time", "u4"),
}  # fmt: skip
UNIT_S = {"s": 1.0, "date": 1.0, "ns": 1e-9, "float ns": 1e-9, "µs": 1e-6}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float], Path]:
    """Return the labels of the drive whose stamps are a part of a sweep after its first point."""

    @cache
    def of(late: float) -> Path:
        drive = FieldDrive(sweeps=SWEEPS)
        made = labels_of(tmp_path_factory.mktemp("sound"), drive, partial(recorded, drive, "s", late, None)).labels
        assert made is not None
        return made

    return of


def recorded(drive: FieldDrive, kind: str, late: float, spoil: Callable[[Times, int], Times] | None, t: float) -> Any:
    """Return the cloud of a sweep whose stamp is `late` of a sweep after its first point; `spoil` alters its times."""
    points, after_s = drive.points(t, RECORDS[kind])
    name = (RECORDS[kind].names or ())[4 if kind == "ns" else 5]
    seconds = after_s - late * SWEEP_S + (BEGIN_S + t + late * SWEEP_S if kind == "date" else 0)
    values = seconds / UNIT_S[kind]
    spoilt = values if spoil is None else spoil(values, round(t / SWEEP_S))
    code = points.dtype[name]
    points[name] = np.rint(spoilt).astype(np.int64).astype(code) if code.kind == "u" else spoilt
    return drive.cloud(t + late * SWEEP_S, points)


def labels_of(folder: Path, drive: FieldDrive, message: Callable[[float], Any]) -> FieldOutcome:
    run, calibration = drive.write(folder, drive.lidar_topic()._replace(message=message), drive.odometry_topic())
    return outcome_of(run, calibration, folder / "labels")


def of_columns(first: int, last: int, value: float, *, every: int = 1, is_added: bool = False) -> Any:
    """Return what alters the times of some columns of every so-manieth sweep."""

    def spoil(times: Times, number: int) -> Times:
        is_bad = (first <= COLUMN) & (last > COLUMN) & (number % every == 0)
        return np.where(is_bad, times + value if is_added else value, times)

    return spoil


def of_points(share: float, value: float) -> Any:
    """Return what alters a share of the times of each sweep."""

    def spoil(times: Times, number: int) -> Times:
        return np.where(np.random.default_rng(number).random(len(times)) < share, value, times)

    return spoil


def together(*ways: Any) -> Any:
    """Return what alters times in each of these ways, one after another."""
    return lambda times, number: reduce(lambda altered, spoil: spoil(altered, number), ways, times)


SPOILT = {
    "columns below the stamp": ("ns", 0.0, of_columns(4, 12, -137_216.0, every=3)),
    "a stamp in the middle": ("ns", 0.5, None),
    "a stamp at the end": ("ns", 1.0, None),
    "seconds": (
        "s",
        0.0,
        together(
            of_points(0.05, np.nan),
            of_points(0.08, 0.0),
            of_columns(100, 110, -3.0, is_added=True),
            of_columns(200, 210, 50.0),
        ),
    ),
    "dates": (
        "date",
        0.0,
        together(of_points(0.02, np.inf), of_points(0.08, 0.0), of_columns(0, 5, 946_684_800.0)),
    ),
    "a few far away": ("float ns", 0.0, of_points(0.001, 1e18)),
    "negative microseconds": ("µs", 0.0, of_columns(30, 40, -500.0, every=2)),
}


@pytest.mark.parametrize("case", SPOILT)
def test_bad_times_cost_neither_the_sweep_nor_the_labels(tmp_path: Path, sound: Any, case: str) -> None:
    kind, late, spoil = SPOILT[case]
    drive, altered = FieldDrive(sweeps=SWEEPS), 0

    def counted(times: Times, number: int) -> Times:
        nonlocal altered
        spoilt = times if spoil is None else spoil(times, number)
        altered += int((spoilt != times).sum())
        return spoilt

    found = labels_of(tmp_path, drive, partial(recorded, drive, kind, late, counted))
    assert (found.refusal, found.errors) == ("", [])
    assert int(found.messages("MSG-321").split()[0]) >= LEAST_COUNTED * altered
    assert "MSG-321" in {finding.code for finding in found.label_findings}
    assert not found.codes & {"TOP-102", "MSG-322"}
    assert found.labels is not None
    assert occupied_iou(found.labels, sound(late)) >= LEAST_IOU


@pytest.mark.parametrize("sweeps", [-1.0, 1.0])
def test_packets_of_the_sweep_before_or_after_keep_their_own_times(tmp_path: Path, sound: Any, sweeps: float) -> None:
    drive, spoil = FieldDrive(sweeps=SWEEPS), of_columns(60, 70, sweeps * SWEEP_S, every=4, is_added=True)
    found = labels_of(tmp_path, drive, partial(recorded, drive, "s", 0.0, spoil))
    assert found.labels is not None
    assert occupied_iou(found.labels, sound(0.0)) >= LEAST_IOU


def test_one_bad_sweep_that_nobody_looked_at_is_counted_by_its_labels(tmp_path: Path) -> None:
    drive = FieldDrive()

    def spoil(times: Times, number: int) -> Times:
        columns = {8: 12, 17: COLUMNS}.get(number, 0)  # neither sweep is among those that are looked at
        return np.where(columns > COLUMN, np.nan, times)

    found = labels_of(tmp_path, drive, partial(recorded, drive, "s", 0.0, spoil))
    assert not found.codes & {"MSG-321", "MSG-322"}
    told = {one.code: one.message for one in found.label_findings if one.code in ("MSG-321", "MSG-322")}
    assert told["MSG-321"].startswith("288 points in 1 of 40 fused sweeps")
    assert told["MSG-322"].startswith("1 of 40 fused sweeps")


def test_sweeps_without_times_among_others_are_counted(tmp_path: Path) -> None:
    drive, spoil = FieldDrive(sweeps=SWEEPS), of_columns(0, COLUMNS, np.nan, every=3)
    found = labels_of(tmp_path, drive, partial(recorded, drive, "s", 0.0, spoil))
    assert found.refusal == ""
    for findings in (found.findings, found.label_findings):
        told = [one.message for one in findings if one.code == "MSG-322"]
        assert len(told) == 1
        assert "not deskewed" in told[0]
    assert len(labelled_frames(tmp_path / "labels")) == SWEEPS
