"""Radar detections of each frame, moved to the frame's stamp and freed of the robot's own motion.

**Conventions.** Points are in the LiDAR frame at the frame's stamp, as those of a sweep are. A radar measured
`dt_ns` of its association after the stamp. Only detections that the radar itself calls valid, in its order.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.deskew import SweepMount
from stone.sensors.radar_motion import compensated, radar_motion
from stone.sensors.samples import RadarSample
from stone.sensors.sequence import Association, Sequence
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.sync.sweeps import BagSweeps, opened


@dataclass(frozen=True, eq=False)
class BagRadar:
    """One radar's topic by frame. Picklable: it carries the path, never the open file."""

    path: Path
    taken: Association
    stamps_ns: NDArray[np.int64]
    lidar_from_radar: SE3
    mount: SweepMount

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def frame(self, index: int) -> RadarSample | None:
        """What it saw for frame `index`; None where no message is near enough.

        Raises IndexError, and what opening and decoding raise (BAG-*, MSG-*).
        """
        row, stamp_ns = int(self.taken.message_index[index]), int(self.stamps_ns[index])
        if row < 0:
            return None
        bag, taken_ns = opened(self.path), stamp_ns + int(self.taken.dt_ns[index])
        topic = next(topic for topic in bag.topics if topic.name == self.taken.topic)
        seen = decode_radar(topic.type, [bag.message(topic.name, row)], topic.schema)
        motion = radar_motion(self.mount, self.lidar_from_radar, stamp_ns, taken_ns)
        points_radar, range_rate_m_s = seen.points_radar[seen.is_valid], seen.range_rate_m_s[seen.is_valid]
        moved = compensated(points_radar, range_rate_m_s.astype(np.float64), motion)
        return RadarSample(
            taken_ns,
            points_radar,
            moved.points_lidar,
            range_rate_m_s.astype(np.float64),
            moved.ground_rate_m_s,
            seen.rcs_db[seen.is_valid],
        )


def radars_of(sequence: Sequence, sweeps: BagSweeps) -> Mapping[str, BagRadar]:
    """By channel, the radars that the calibration places; none where sweeps have no track."""
    if sweeps.mount is None:
        return {}
    taken = sequence.frames.associations
    return {
        mount.name: BagRadar(
            sweeps.path, taken[mount.name], sequence.frames.stamps_ns, mount.lidar_from_sensor, sweeps.mount
        )
        for mount in sequence.calibration.of_kind("radar")
        if mount.name in taken
    }
