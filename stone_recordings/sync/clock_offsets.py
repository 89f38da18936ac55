"""Given clock offsets of the LiDAR and of the pose source.

**Conventions.** An offset is added to a stamp, so that the stamp is on the clock of the other sensors. A run's option
takes precedence over the calibration. A finding reports every shift. Frames bear the shifted stamp of their sweep.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.sensors.calibration import Calibration
from stone_recordings.clocks.constants import shift_advice
from stone_recordings.poses.extrinsics import plain

LIDAR, POSE = "lidar", "pose"
# A smaller difference does not indicate another clock.
LEAST_APART_NS = 500_000_000
NO_MOVE = np.array([1.0, 0, 0, 0, 0, 0, 0])


@dataclass(frozen=True, eq=False)
class RecordedStamps:
    """Stamps (N,) as they are used, and the record times of all M messages of their topic, ascending."""

    stamps_ns: NDArray[np.int64]
    log_times_ns: NDArray[np.int64]

    @property
    def late_ns(self) -> int | None:
        """The median of record time − stamp; None if some messages have no stamp here."""
        if not len(self.stamps_ns) or len(self.stamps_ns) != len(self.log_times_ns):
            return None
        late_ns = self.log_times_ns - np.sort(self.stamps_ns)
        return int(late_ns[0]) + round(float(np.median(late_ns - late_ns[0])))


@dataclass(frozen=True)
class ClockOffsets:
    """`asked` are the run's offsets by part, "lidar" or "pose", nanoseconds."""

    asked: Mapping[str, int] = field(default_factory=dict)

    def of_lidar(self, calibration: Calibration, frame: str) -> int:
        """Return the offset of the LiDAR sensor whose frame is `frame`, or that is mounted where the LiDAR is."""
        if LIDAR in self.asked:
            return self.asked[LIDAR]
        for mount in calibration.of_kind("lidar"):
            is_named = bool(frame) and plain(mount.frame_id) == plain(frame)
            if is_named or (not mount.frame_id and np.allclose(mount.lidar_from_sensor.wxyz_xyz, NO_MOVE)):
                return mount.time_offset_ns
        return 0

    def of_poses(self, calibration: Calibration, frame: str) -> int:
        """Return the offset of the sensor to which the poses belong, by their frame."""
        if POSE in self.asked:
            return self.asked[POSE]
        named = (mount for mount in calibration.mounts if frame and plain(mount.frame_id) == plain(frame))
        return next((mount.time_offset_ns for mount in named), 0)


def way_out(lidar: RecordedStamps, poses: RecordedStamps, offsets: ClockOffsets) -> str:
    """Return how to bring the clocks of sweeps and poses together, judged by the recorder's clock, or "".

    The clock that is farther from the recorder's clock is shifted.
    """
    lidar_ns, poses_ns = (stamps.late_ns for stamps in (lidar, poses))
    if lidar_ns is None or poses_ns is None or abs(lidar_ns - poses_ns) < LEAST_APART_NS:
        return ""
    part, step_ns = (LIDAR, lidar_ns - poses_ns) if abs(lidar_ns) >= abs(poses_ns) else (POSE, poses_ns - lidar_ns)
    return f": {shift_advice(part, offsets.asked.get(part, 0) + step_ns)}"


def shifted_finding(topic: str, offset_ns: int) -> tuple[Finding, ...]:
    """Return TIM-214 if a clock was shifted."""
    if not offset_ns:
        return ()
    sentence = f"its stamps are shifted by {offset_ns / 1e9:+.6f} s, as configured in the calibration or by the command"
    return (Finding("TIM-214", "info", topic, sentence),)
