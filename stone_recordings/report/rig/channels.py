"""The topics of a recording compared with the sensors of a calibration: matches, and both kinds of misfits.

**Conventions.** Cameras, radars and IMUs match as in association (`stone_recordings.sync.association`), an INS matches
the calibration's INS, and the LiDAR's topic is that of the part `lidar`. CAL-412: a topic without a sensor; CAL-437: a
sensor without a topic.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from stone.findings import Finding
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.calibration_errors import MissingSensorError
from stone_recordings.bags.bag import Bag
from stone_recordings.report.inspection import frame_id_of, inspect_in
from stone_recordings.report.rig.record import placed_sensors
from stone_recordings.sync.association import mount_of
from stone_recordings.topics.profiles import TopicProfile
from stone_recordings.topics.roles import Role

PLACED_ROLES: tuple[Role, ...] = ("lidar", "camera", "radar", "imu", "ins")
MOST_TOPICS = 64


@dataclass(frozen=True)
class ChannelMatch:
    """A topic of a sensor; `sensor` is its channel in the calibration, None if the calibration has none."""

    topic: str
    role: Role
    frame_id: str
    sensor: str | None

    def as_record(self) -> dict[str, str | None]:
        return {"topic": self.topic, "role": self.role, "frame_id": self.frame_id, "sensor": self.sensor}


def channel_matches(bag: Bag, calibration: Calibration, profile: TopicProfile) -> tuple[ChannelMatch, ...]:
    """Return every topic of a LiDAR, camera, radar, IMU or INS with messages. Raises the errors of inspecting
    (BAG-*).
    """
    inspection = inspect_in(bag, profile)
    channels = {topic: part for part, topic in inspection.assignment.channels.items()}
    topics = [topic for topic in inspection.topics if topic.role in PLACED_ROLES and topic.topic.count]
    matches = list[ChannelMatch]()
    for topic in topics[:MOST_TOPICS]:
        frame_id = frame_id_of(bag, topic.topic)
        named = calibration.mount(channels.get(topic.topic.name, ""))
        mount = named if named is not None and named.kind == topic.role else None
        if mount is None:
            mount = _mount(calibration, topic.topic.name, topic.role, frame_id)
        sensor = mount.name if mount is not None else None
        if channels.get(topic.topic.name) == "lidar":
            sensor = placed_sensors(calibration)[0].mount.name
        matches.append(ChannelMatch(topic.topic.name, topic.role, frame_id, sensor))
    return tuple(matches)


def _mount(calibration: Calibration, topic: str, role: Role, frame_id: str) -> Mount | None:
    if role == "ins":
        return next(iter(calibration.of_kind("ins")), None)
    return mount_of(topic, frame_id, role, calibration)


def channel_findings(matches: Iterable[ChannelMatch], calibration: Calibration) -> tuple[Finding, ...]:
    """Return a warning for each topic without a sensor, a note for each sensor without a topic."""
    matched = tuple(matches)
    findings = [_unknown(match) for match in matched if match.sensor is None]
    seen = {match.sensor for match in matched}
    for sensor in placed_sensors(calibration):
        if sensor.mount.name not in seen:
            sentence = f"the calibration has {sensor.mount.name}, but no {sensor.mount.kind} topic matches it"
            findings.append(Finding("CAL-437", "info", sensor.mount.name, sentence))
    return tuple(findings)


def _unknown(match: ChannelMatch) -> Finding:
    frame = f"frame {match.frame_id}" if match.frame_id else "no frame"
    sentence = (
        f"the calibration has no {match.role} for this topic ({frame}): it is matched by a sensor's frame_id or channel"
    )
    return Finding(MissingSensorError.code, "warning", match.topic, sentence)
