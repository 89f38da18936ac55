"""SYN-518: the poses face another way than the robot drives, all along the run."""

import numpy as np

from stone.findings import Finding
from stone.sensors.driving_direction import DrivingDirection, driving_direction
from stone.sensors.ego_path import track_of
from stone.sensors.sequence import Sequence


def direction_findings(sequence: Sequence) -> tuple[Finding, ...]:
    """SYN-518 if heading or pitch of the poses is off; the poses are those of the source, before any correction."""
    if not len(sequence.frames):
        return ()
    found = driving_direction(track_of(sequence))
    if found is None or not (found.is_yawed or found.is_pitched):
        return ()
    sentence = (
        f"by its poses the robot drives {' and '.join(_off(found))} where it faces, by {found.steps} steps: "
        "is the INS turned on its mount by this angle, or its attitude biased? Correct the rotation of the INS "
        "in the calibration"
    )
    return (Finding("SYN-518", "warning", "", sentence),)


def _off(found: DrivingDirection) -> list[str]:
    yaw, pitch = abs(np.rad2deg(found.yaw_rad)), abs(np.rad2deg(found.pitch_rad))
    words = [f"{yaw:.1f}° to the {'left' if found.yaw_rad > 0 else 'right'} of"] if found.is_yawed else []
    return words + ([f"{pitch:.1f}° {'above' if found.pitch_rad > 0 else 'below'}"] if found.is_pitched else [])
