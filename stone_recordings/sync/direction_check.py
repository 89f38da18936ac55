"""SYN-518: the poses' heading or pitch differs from the driving direction along the whole run.

**Conventions.** If the sweeps show the ground pitched like the way, the body drives pitched, and the map is right. If
the sweeps show level ground, the poses are tilted.
"""

import numpy as np

from stone.findings import Finding
from stone.sensors.calibration import Calibration, entry_of
from stone.sensors.driving_direction import DrivingDirection, driving_direction, turned_to_way
from stone.sensors.ego_path import track_of
from stone.sensors.ground_plane import GroundFit
from stone.sensors.sequence import Sequence


def direction_findings(sequence: Sequence, fit: GroundFit | None) -> tuple[Finding, ...]:
    """Return SYN-518 if heading or pitch of the poses is off; the poses are those of the source, before any
    correction.
    """
    if not len(sequence.frames):
        return ()
    direction = driving_direction(track_of(sequence))
    is_tilted = fit is not None and fit.is_way_tilted
    if direction is None or not (direction.is_yawed or direction.is_pitched or is_tilted):
        return ()
    where = (
        f"according to its poses the robot drives {' and '.join(_off(direction))} where it faces, by {direction.steps} "
        "steps"
    )
    if fit is not None and fit.is_body_pitched and not direction.is_yawed:
        sentence = f"{where}, and the ground is pitched equally. The robot drives pitched, and the map is right"
        return (Finding("SYN-518", "info", "", sentence),)
    sentence = (
        f"{where}. The INS is turned on its mount by this angle, or its attitude is biased: correct the rotation of "
        "the "
        f"INS in the calibration{_entry(sequence.calibration, direction, fit)}"
        f"{'. Without this correction, labelling refuses the run' if is_tilted else ''}"
    )
    return (Finding("SYN-518", "warning", "", sentence),)


def _entry(calibration: Calibration, direction: DrivingDirection, fit: GroundFit | None) -> str:
    """Return the rotation to enter; nothing if the calibration has no INS."""
    level = 0.0 if fit is None or fit.map_slope_x is None else float(np.arctan(fit.slope_x))
    yaw_rad = direction.yaw_rad if direction.is_yawed else 0.0
    pitch_rad = direction.pitch_rad - level if direction.is_pitched or (fit is not None and fit.is_way_tilted) else 0.0
    return "".join(f": {entry_of(mount)}" for mount in turned_to_way(calibration, yaw_rad, pitch_rad))


def _off(direction: DrivingDirection) -> list[str]:
    yaw, pitch = abs(np.rad2deg(direction.yaw_rad)), abs(np.rad2deg(direction.pitch_rad))
    words = [f"{yaw:.1f}° to the {'left' if direction.yaw_rad > 0 else 'right'} of"] if direction.is_yawed else []
    is_pitched = direction.is_pitched or not words
    return words + ([f"{pitch:.1f}° {'above' if direction.pitch_rad > 0 else 'below'}"] if is_pitched else [])
