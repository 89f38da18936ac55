"""Share of a LiDAR's and a radar's messages that is valid measurement.

**Conventions.** A slot without a return is NaN or (0, 0, 0) (`stone_recordings.messages.lidar`); drivers that leave
such slots out have a valid share of 1. Ranges are from the sensor.
"""

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import RawMessage, Topic
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.messages.sweep_clouds import sweep_cloud
from stone_recordings.report.quality.facts import LidarFacts, RadarFacts
from stone_recordings.report.quality.sampling import HEAVY, LIGHT, TopicSampling

MOST_RANGE_M = 1e4


class LidarLook:
    """Collects what the clouds of one topic hold."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._seen: list[tuple[int, int, float, float]] = []

    @property
    def look(self) -> TopicSampling:
        return TopicSampling(self._topic, self._see, HEAVY)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        cloud = sweep_cloud(payload, self._topic.type)
        points_lidar = lidar_points(cloud).points_lidar
        slots = len(cloud.points)
        range_m = _median_range_m(points_lidar)
        self._seen.append((at_ns, slots, len(points_lidar) / max(1, slots), range_m))

    def facts(self) -> LidarFacts | None:
        """None where not one cloud could be seen."""
        if not self._seen:
            return None
        at_ns, slots, valid_ratio, range_m = zip(*self._seen, strict=True)
        return LidarFacts(self._topic.name, at_ns, slots, valid_ratio, range_m)


def _median_range_m(points_lidar: NDArray[np.float32]) -> float:
    """At most `MOST_RANGE_M`, whatever the message says; 0 for no points."""
    within = np.nan_to_num(np.abs(points_lidar), nan=MOST_RANGE_M, posinf=MOST_RANGE_M)
    ranges_m = np.linalg.norm(np.minimum(within, MOST_RANGE_M).astype(np.float64), axis=1)
    return min(float(np.median(ranges_m)), MOST_RANGE_M) if len(ranges_m) else 0.0


class RadarLook:
    """Collects how many detections the messages of one topic hold."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._seen: list[tuple[int, int]] = []

    @property
    def look(self) -> TopicSampling:
        return TopicSampling(self._topic, self._see, LIGHT)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        detections = decode_radar(self._topic.type, [RawMessage(at_ns, 0, payload)], self._topic.schema)
        self._seen.append((at_ns, int(np.count_nonzero(detections.is_valid))))

    def facts(self) -> RadarFacts | None:
        """None where not one message could be seen."""
        if not self._seen:
            return None
        at_ns, detections = zip(*self._seen, strict=True)
        return RadarFacts(self._topic.name, at_ns, detections)
