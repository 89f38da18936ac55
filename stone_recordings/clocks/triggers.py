"""The check that each camera fires when the LiDAR scans its direction: late triggers and swapped topics.

**Conventions.** The LiDAR's direction over time is measured in a few of its sweeps (bearing and time of their points);
a camera's direction is the calibration's optical axis. A rig whose cameras do not follow the LiDAR has no such
findings, because their trigger times are unknown. Dropped triggers need no calibration: TIM-208 of an inspection.
"""

from collections.abc import Iterator
from collections.abc import Sequence as Listed

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.sensors.association import typical_period_ns
from stone.sensors.calibration import Mount
from stone.sensors.sequence import Association, Sequence
from stone.sensors.triggers import ON_TIME_NS, LidarRotation, Triggers, look_of, triggers_of
from stone_recordings.bags.bag import Bag
from stone_recordings.clocks.point_clock import points_at
from stone_recordings.sync.sweeps import BagSweeps

SWEEP_SAMPLES = 3
# The number of a sweep's points that suffices to measure its direction.
MOST_POINTS = 50_000


def trigger_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """Return TIM-205 (a camera, or all of them, late) and CAL-406 (swapped); () if nothing can be measured.

    Raises the errors of reading a sweep.
    """
    associations = sequence.frames.associations
    cameras = [mount for mount in sequence.calibration.of_kind("camera") if _fires(associations.get(mount.name))]
    if len(cameras) < 2:
        return ()
    look = lidar_look(bag, sweeps, typical_period_ns(sequence.frames.stamps_ns))
    if look is None:
        return ()
    taken = [associations[mount.name] for mount in cameras]
    fired_ns = np.array([np.median(association.dt_ns[association.message_index >= 0]) for association in taken]).astype(
        np.int64
    )
    looks_ns = np.array([look.time_ns(bearing_rad(mount)) for mount in cameras], np.int64)
    triggers = triggers_of(fired_ns, looks_ns, look.period_ns)
    if triggers is None:
        return ()
    topics = [association.topic for association in taken]
    return (
        *_shared(triggers, sweeps.topic),
        *_late(triggers, topics, look.period_ns),
        *_swapped(triggers, topics, cameras),
    )


def bearing_rad(camera: Mount) -> float:
    """Return the azimuth of the optical axis in the LiDAR's frame."""
    forward = camera.lidar_from_sensor.rotation()[:, 2]
    return float(np.arctan2(forward[1], forward[0]))


def _fires(association: Association | None) -> bool:
    return association is not None and bool((association.message_index >= 0).any())


def lidar_look(bag: Bag, sweeps: BagSweeps, period_ns: int) -> LidarRotation | None:
    """Return the LiDAR's direction over time, from sweeps of the beginning, the middle and the end."""
    rows = np.unique(np.linspace(0, len(sweeps) - 1, SWEEP_SAMPLES).astype(np.int64)) if len(sweeps) else ()
    parts = [_timed_points(bag, sweeps, int(row)) for row in rows]
    timed = [part for part in parts if part is not None]
    if not timed:
        return None
    points, offsets = (np.concatenate(columns) for columns in zip(*timed, strict=True))
    return look_of(points, offsets, period_ns)


def _timed_points(bag: Bag, sweeps: BagSweeps, row: int) -> tuple[NDArray[np.float32], NDArray[np.int64]] | None:
    points = points_at(bag, sweeps.topic, int(sweeps.message_index[row]), with_ring=False)
    if points.offset_ns is None:
        return None
    every = max(1, len(points.points_lidar) // MOST_POINTS)
    return points.points_lidar[::every], points.offset_ns[::every]


def _shared(triggers: Triggers, lidar: str) -> Iterator[Finding]:
    if abs(triggers.shared_ns) > ON_TIME_NS:
        message = (
            f"The cameras fire {_when(triggers.shared_ns)} this LiDAR scans their direction, all of them: "
            "is its stamp late, or their trigger delayed? Nothing was shifted."
        )
        yield Finding("TIM-205", "warning", lidar, message)


def _late(triggers: Triggers, topics: Listed[str], period_ns: int) -> Iterator[Finding]:
    for topic, late_ns in zip(topics, triggers.late_ns.tolist(), strict=True):
        if abs(late_ns) > ON_TIME_NS:
            message = (
                f"Fires {_when(late_ns)} the LiDAR scans its direction, unlike the other cameras "
                f"({abs(late_ns) / period_ns * 360:.0f}° of its turn; limit {ON_TIME_NS / 1e6:g} ms). "
                "Nothing was shifted; set its trigger's angle, or check its mount."
            )
            yield Finding("TIM-205", "warning", topic, message)


def _swapped(triggers: Triggers, topics: Listed[str], cameras: Listed[Mount]) -> Iterator[Finding]:
    for index, other in enumerate(triggers.looks_as.tolist()):
        if other != index:
            message = (
                f"Fires when the LiDAR looks where the calibration puts {cameras[other].name}, "
                f"not {cameras[index].name}: check whether the topics or the plugs of the two are swapped."
            )
            yield Finding("CAL-406", "warning", topics[index], message)


def _when(late_ns: int) -> str:
    return f"{abs(late_ns) / 1e6:.2f} ms {'after' if late_ns > 0 else 'before'}"
