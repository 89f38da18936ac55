"""The check that the ground lies where the calibration says: at the ego origin, and level with it.

**Conventions.** Measured on sweeps spread over the run (`stone.sensors.ground_plane`); what is found is what the mount
of the LiDAR and the ego frame together are wrong by. Below `TOLERATED_M` and `TOLERATED_RAD` nothing is said: so much
is terrain. Ground auto takes the height from what was found, however little, which is known to a centimetre; the tilt,
which terrain moves by half a degree, only where it is beyond that.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.calibration import Calibration
from stone.sensors.ground_plane import GroundFit, ground_fit
from stone.sensors.ground_points import plane_around
from stone.sensors.selection import world_points
from stone.sensors.sequence import Sequence, SweepSource

SWEEPS = 40
AHEAD = 2
MIN_RANGE_M = 1.0
ROUNDS, SETTLED_M, SETTLED_RAD = 8, 0.0001, 0.00001


def measured_ground(sequence: Sequence, sweeps: SweepSource) -> GroundFit | None:
    """Where the ground lies in the ego frame, by sweeps from all over the run; None where too few show it."""
    picked = np.unique(np.linspace(0, len(sequence.frames) - 1, SWEEPS).round().astype(np.int64)).tolist()
    planes = (plane_around(points) for points in seen_ahead(sequence, sweeps, picked))
    return ground_fit([plane for plane in planes if plane is not None])


def seen_ahead(sequence: Sequence, sweeps: SweepSource, rows: Iterable[int]) -> Iterator[NDArray[np.float32]]:
    """`seen_around` of these frames in their order; a thread reads the next `AHEAD` while one is looked at.

    Nobody else may read the sweeps meanwhile.
    """
    coming = deque[Future[NDArray[np.float32]]]()
    with ThreadPoolExecutor(1) as beside:
        for row in rows:
            coming.append(beside.submit(seen_around, sequence, sweeps, row))
            if len(coming) > AHEAD:
                yield coming.popleft().result()
        yield from (one.result() for one in coming)


def seen_around(sequence: Sequence, sweeps: SweepSource, index: int) -> NDArray[np.float32]:
    """The points (N, 3) of a frame's sweep in its ego frame, without the robot's own; none of a sweep that cannot be
    read, which is for labelling to say."""
    calibration = sequence.calibration
    try:
        points_lidar = sweeps.sweep(index).points_lidar
    except StoneError:
        return np.zeros((0, 3), np.float32)
    return world_points(points_lidar, calibration.ego_from_lidar, calibration.self_boxes_ego, MIN_RANGE_M)


def is_off(fit: GroundFit | None) -> bool:
    """Whether it lies so far from where it should that no terrain explains it."""
    return fit is not None and (fit.is_high_or_low or fit.is_tilted)


def corrected(calibration: Calibration, fit: GroundFit) -> Calibration:
    """The calibration with the LiDAR mounted so that the ground lies where it should."""
    return replace(calibration, ego_from_lidar=fit.corrected(calibration.ego_from_lidar))


def settled(sequence: Sequence, sweeps: SweepSource, fit: GroundFit) -> Calibration:
    """The calibration with the LiDAR mounted so that the ground is found at the ego origin, to `SETTLED_M`, and level,
    to `SETTLED_RAD`, where the tilt was beyond terrain: whatever height was entered, it ends in the same place."""
    calibration, found = sequence.calibration, fit if fit.is_tilted else fit.untilted()
    for _ in range(ROUNDS):
        calibration = corrected(calibration, found)
        again = measured_ground(replace(sequence, calibration=calibration), sweeps)
        if again is None:
            break
        found = again if fit.is_tilted else again.untilted()
        if abs(found.height_m) < SETTLED_M and found.tilt_rad < SETTLED_RAD:
            break
    return calibration


def ground_findings(sequence: Sequence, fit: GroundFit | None) -> tuple[Finding, ...]:
    """CAL-433 where the ground is off, with what to enter into the calibration; CAL-435 where it cannot be measured."""
    if fit is None:
        unseen = "the ground around the robot is seen in too few sweeps to check the height of the LiDAR's mount"
        return (Finding("CAL-435", "info", "", unseen),)
    if not is_off(fit):
        return ()
    sentence = (
        f"the ground lies {_above(fit)} and tilts by {np.rad2deg(fit.tilt_rad):.1f}° in the ego frame ({fit.sweeps} "
        f"sweeps, 5 to 95 %: {fit.low_m:+.2f} to {fit.high_m:+.2f} m): is the LiDAR mounted as the calibration says, "
        f"and the ego origin on the ground? {_mount(corrected(sequence.calibration, fit.beyond_terrain()))} would "
        "correct it, and ground auto corrects it for this run"
    )
    return (Finding("CAL-433", "warning", "", sentence),)


def applied_finding(fit: GroundFit, calibration: Calibration) -> Finding:
    """CAL-434: what ground auto did, by the `calibration` it settled on."""
    sentence = (
        f"the ground lay {_above(fit)} and tilted by {np.rad2deg(fit.tilt_rad):.1f}° in the ego frame; the LiDAR is "
        f"taken to be mounted so that it does not: {_mount(calibration)}"
    )
    return Finding("CAL-434", "info", "", sentence)


def _above(fit: GroundFit) -> str:
    return f"{abs(fit.height_m):.2f} m {'above' if fit.height_m > 0 else 'below'} the ego origin"


def _mount(calibration: Calibration) -> str:
    place = ", ".join(f"{value:.3f}" for value in calibration.ego_from_lidar.translation_m.tolist())
    turn = ", ".join(f"{value:.5f}" for value in calibration.ego_from_lidar.wxyz.tolist())
    return f"ego_from_lidar at [{place}] m, wxyz [{turn}]"
