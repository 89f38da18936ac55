"""How much of a LiDAR's and a radar's messages is measurement.

**Conventions.** A slot without a return is NaN or (0, 0, 0) (`services.ingest.messages.lidar`); drivers that leave such
slots out have a valid share of 1. Ranges are from the sensor.
"""

import numpy as np

from services.ingest.bag import RawMessage, Topic
from services.ingest.messages.pointcloud2 import decode_cloud, lidar_points
from services.ingest.messages.radar import decode_radar
from services.ingest.quality.facts import LidarFacts, RadarFacts
from services.ingest.quality.sampling import HEAVY, LIGHT, Look


class LidarLook:
    """Collects what the clouds of one topic hold."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._seen: list[tuple[int, int, float, float]] = []

    @property
    def look(self) -> Look:
        return Look(self._topic, self._see, HEAVY)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        cloud = decode_cloud(payload)
        points_lidar = lidar_points(cloud).points_lidar
        slots = len(cloud.points)
        range_m = float(np.median(np.linalg.norm(points_lidar, axis=1))) if len(points_lidar) else 0.0
        self._seen.append((at_ns, slots, len(points_lidar) / max(1, slots), range_m))

    def facts(self) -> LidarFacts | None:
        """None where not one cloud could be seen."""
        if not self._seen:
            return None
        at_ns, slots, valid_ratio, range_m = zip(*self._seen, strict=True)
        return LidarFacts(self._topic.name, at_ns, slots, valid_ratio, range_m)


class RadarLook:
    """Collects how many detections the messages of one topic hold."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._seen: list[tuple[int, int]] = []

    @property
    def look(self) -> Look:
        return Look(self._topic, self._see, LIGHT)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        detections = decode_radar(self._topic.type, [RawMessage(at_ns, 0, payload)], self._topic.schema)
        self._seen.append((at_ns, int(np.count_nonzero(detections.is_valid))))

    def facts(self) -> RadarFacts | None:
        """None where not one message could be seen."""
        if not self._seen:
            return None
        at_ns, detections = zip(*self._seen, strict=True)
        return RadarFacts(self._topic.name, at_ns, detections)
