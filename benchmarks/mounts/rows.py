"""The row of one wrong mount of `benchmarks.mounts`: the mount's error and the quality of its labels."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.ingest.pipeline import SynchroniseOptions
from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone.labels.traversability import POTENTIAL, TRAVERSABLE
from stone.sensors.calibration import Calibration
from stone_recordings.calibrations.file import read_calibration
from testing.worlds.faults.fault import Misreading
from testing.worlds.faults.other_edits import lowered, rolled
from testing.worlds.faults.outcome import LabelledDrive, agreement, labelled

Grids = Mapping[int, NDArray[np.uint8]]


@dataclass(frozen=True)
class MountDrive:
    """One recording with its calibration, whose mount is right."""

    name: str
    bag: Path
    calibration: Path

    def rig(self) -> Calibration:
        return read_calibration(self.calibration)[0]


@dataclass(frozen=True)
class WrongMount:
    """A wrong mount: a height error (m), or a rotation about the LiDAR's own x (roll) or y (pitch)."""

    name: str
    misreading: Misreading


WRONG = (
    *(WrongMount(f"{100 * high_m:+.0f} cm", lowered(-high_m)) for high_m in (-0.5, -0.23, -0.1, -0.05)),
    *(WrongMount(f"{100 * high_m:+.0f} cm", lowered(-high_m)) for high_m in (0.05, 0.1, 0.23, 0.5)),
    *(WrongMount(f"pitch {by_deg:+.0f}°", rolled(by_deg, axis=1)) for by_deg in (-3.0, 3.0)),
    *(WrongMount(f"roll {by_deg:+.0f}°", rolled(by_deg)) for by_deg in (-3.0, 3.0)),
)


def row_of(drive: MountDrive, number: int, sound: Mapping[str, Grids]) -> dict[str, Any]:
    """Return the row of the wrong mount of this number: the error of the corrected mount and the IoU of its labels.

    The IoU is with the labels `sound` of the right mount, by the method of setting the ground.
    """
    entered = WRONG[number].misreading(drive.rig())
    with tempfile.TemporaryDirectory(prefix="stone-mounts-") as folder:
        try:
            made = labelled(drive.bag, entered, Path(folder) / "labels", SynchroniseOptions(ground="auto"))
        except StoneError as refusal:
            return {"refusal": refusal.code}
    return distances(drive, made) | {
        name: {"drivable": drivable_iou(made.grids, grids), "all": agreement(made.grids, grids)}
        for name, grids in sound.items()
    }


def distances(drive: MountDrive, made: LabelledDrive) -> dict[str, Any]:
    """Return the differences of the labels' mount from the calibration's: height, m; tilt, degrees."""
    off = made.report.sequence.calibration.ego_from_lidar @ drive.rig().ego_from_lidar.inverse()
    height_m = made.report.sequence.calibration.ego_from_lidar.translation_m[2]
    right_m = drive.rig().ego_from_lidar.translation_m[2]
    return {"height_m": float(height_m - right_m), "tilt_deg": tilt_deg(off)}


def tilt_deg(turned: SE3) -> float:
    """Return the tilt of the z axis."""
    return float(np.rad2deg(np.arccos(np.clip(turned.rotation()[2, 2], -1.0, 1.0))))


def drivable_iou(ours: Grids, theirs: Grids) -> float:
    """Return the IoU of T ∪ P of both label sets; NaN without a common frame."""
    both = either = 0
    for stamp_ns in ours.keys() & theirs.keys():
        mine, other = (np.isin(grids[stamp_ns], (TRAVERSABLE, POTENTIAL)) for grids in (ours, theirs))
        both += int((mine & other).sum())
        either += int((mine | other).sum())
    return both / either if either else float("nan")
