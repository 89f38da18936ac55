"""Topic profiles: the role of each topic on a robot, chosen by its owner once, resolved from the recording otherwise.

**Conventions.** Parts are `lidar`, `pose`, `imu` and the channels of cameras and radars (CAM_FRONT, RADAR_LEFT). A
profile's choice wins where the recording bears it out; where it does not, a finding says so and the part is resolved as
without it. Between several topics that fit nothing is guessed: TOP-110 names them and the line that chooses one.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from stone.findings import Finding, Severity
from stone_recordings.messages.lidars.models import topic_instead
from stone_recordings.topics.channels import PREFIX, ChannelKind, channel_of
from stone_recordings.topics.profile_errors import BadProfileError
from stone_recordings.topics.roles import (
    POINT_CLOUD,
    POSE_ROLES,
    Role,
    holds_other_packets,
    likely_lidars,
    of_pose_role,
    with_plausible_rate,
)

PARTS = ("lidar", "pose", "imu")
CHANNEL = re.compile(r"(?:CAM|RADAR)(?:_[A-Z0-9]+){1,4}")
MOST_TOPICS, LONGEST_TOPIC, SHOWN = 64, 256, 6


@dataclass(frozen=True)
class TopicProfile:
    """The topics chosen for a platform, by part. Raises BadProfileError for a part or a name that cannot be."""

    topics: Mapping[str, str] = field(default_factory=dict)
    platform: str = ""

    def __post_init__(self) -> None:
        if len(self.topics) > MOST_TOPICS:
            raise BadProfileError(f"{len(self.topics)} topics", f"at most {MOST_TOPICS}")
        for part, topic in self.topics.items():
            if part not in PARTS and not CHANNEL.fullmatch(part):
                raise BadProfileError(f"the role {part[:40]!r}", "lidar, pose, imu, CAM_… or RADAR_… (CAM_FRONT_LEFT)")
            if not 0 < len(topic) <= LONGEST_TOPIC or not topic.isprintable() or topic != topic.strip():
                raise BadProfileError(f"the topic {topic[:40]!r}", f"a name of 1 to {LONGEST_TOPIC} plain characters")
        for topic in self.topics.values():
            parts = [part for part, named in self.topics.items() if named == topic]
            if len(parts) > 1:
                raise BadProfileError(f"the topic {topic[:40]!r} as {' and '.join(parts)}", "one role for each topic")


@dataclass(frozen=True)
class Candidate:
    """What is known of a topic that has messages; `frame_id` is that of its first one, "" where none was looked at.

    `point_count` is that of one of its clouds, 0 where none was looked at.
    """

    name: str
    type: str
    role: Role
    count: int
    rate_hz: float | None = None
    frame_id: str = ""
    point_count: int = 0


@dataclass(frozen=True)
class Assignment:
    """The topic of each part that could be told, and what could not."""

    channels: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    def as_profile(self, platform: str = "") -> TopicProfile:
        """What to save so that the next recording of the robot is resolved in the same way."""
        return TopicProfile(dict(self.channels), platform)


def resolve(
    candidates: Sequence[Candidate], profile: TopicProfile, channel_of_frame: Mapping[str, str] | None = None
) -> Assignment:
    """`channel_of_frame` names the channel of each frame_id that a calibration knows. Topics without messages are not
    candidates."""
    chosen, doubts = _chosen(candidates, profile)
    free = [candidate for candidate in candidates if candidate.count and candidate.name not in chosen.values()]
    found: dict[str, str] = {}
    for part, fitting in _fitting(free, channel_of_frame or {}):
        if part in chosen or not fitting:
            continue
        if len(fitting) == 1:
            found[part] = fitting[0].name
        else:
            doubts.append(_ambiguous(part, fitting))
    channels = {**chosen, **found}
    doubts += _missing(candidates, channels)
    doubts += _nameless(free, channel_of_frame or {})
    return Assignment(channels, tuple(doubts))


def _chosen(candidates: Sequence[Candidate], profile: TopicProfile) -> tuple[dict[str, str], list[Finding]]:
    """The choices of the profile that this recording bears out, and a finding for each other."""
    of_name = {candidate.name: candidate for candidate in candidates if candidate.count}
    chosen, doubts = dict[str, str](), list[Finding]()
    for part, topic in profile.topics.items():
        candidate = of_name.get(topic)
        if candidate is not None and _can_be(candidate, part):
            chosen[part] = topic
            continue
        why = "has no messages here" if candidate is None else f"is of type {candidate.type}"
        message = f"The profile names {topic} for {part}, which {why}; {part} was looked for as without a profile."
        doubts.append(Finding("TOP-111", "warning", topic, message))
    return chosen, doubts


def _can_be(candidate: Candidate, part: str) -> bool:
    """A choice may overrule how a cloud was taken, not what type of message it is."""
    is_cloud = candidate.type == POINT_CLOUD
    if part == "lidar":
        return is_cloud or candidate.role == "lidar"
    if part == "pose":
        return candidate.role in POSE_ROLES and bool(of_pose_role(candidate.role, [candidate]))
    if part == "imu":
        return candidate.role == "imu"
    return candidate.role == ("camera" if part.startswith(PREFIX["camera"]) else "radar") or (
        is_cloud and part.startswith(PREFIX["radar"])
    )


def _fitting(
    free: Sequence[Candidate], channel_of_frame: Mapping[str, str]
) -> Iterator[tuple[str, Sequence[Candidate]]]:
    """Each part and the topics that fit it best."""
    yield "lidar", likely_lidars(_of_role(free, "lidar"))
    poses = (of_pose_role(role, _of_role(free, role)) for role in POSE_ROLES)
    yield "pose", next((fitting for fitting in poses if fitting), [])
    yield "imu", with_plausible_rate("imu", _of_role(free, "imu"))
    kinds: tuple[ChannelKind, ...] = ("camera", "radar")
    for kind in kinds:
        of_channel: dict[str, list[Candidate]] = {}
        for candidate in _of_role(free, kind):
            channel = channel_of(kind, candidate.name, candidate.frame_id, channel_of_frame)
            if channel is not None:
                of_channel.setdefault(channel, []).append(candidate)
        yield from of_channel.items()


def _of_role(candidates: Sequence[Candidate], role: Role) -> list[Candidate]:
    return [candidate for candidate in candidates if candidate.role == role]


def _ambiguous(part: str, fitting: Sequence[Candidate]) -> Finding:
    message = f"{len(fitting)} topics fit role {part}: {_listed(fitting)}; choose one: --topic {part}={fitting[0].name}"
    severity: Severity = "info" if part == "imu" else "warning"
    return Finding("TOP-110", severity, fitting[0].name, message)


def _listed(candidates: Sequence[Candidate]) -> str:
    more = f" and {len(candidates) - SHOWN} more" if len(candidates) > SHOWN else ""
    return ", ".join(candidate.name for candidate in candidates[:SHOWN]) + more


def _missing(candidates: Sequence[Candidate], channels: Mapping[str, str]) -> Iterator[Finding]:
    """What labels need and nothing fits; several that fit are not nothing."""
    recorded = [candidate for candidate in candidates if candidate.count]
    if "lidar" not in channels and not _of_role(recorded, "lidar"):
        packets = [candidate for candidate in recorded if holds_other_packets(candidate)]
        why = (
            f"{packets[0].name} holds raw packets: {topic_instead(packets[0].type)}." if packets else "Labels need one."
        )
        message = f"No LiDAR PointCloud2 found, and no packets that are decoded here. {why}"
        yield Finding("TOP-101", "error", packets[0].name if packets else "", message)
    if "pose" not in channels and not any(of_pose_role(role, _of_role(recorded, role)) for role in POSE_ROLES):
        message = (
            "No pose source: neither INS, odometry, /tf, poses nor NavSatFix. Labels need one, or a file: --poses."
        )
        yield Finding("TOP-103", "warning", "", message)


def _nameless(free: Sequence[Candidate], channel_of_frame: Mapping[str, str]) -> Iterator[Finding]:
    """Cameras and radars of which nothing says where they look; one finding for each kind."""
    kinds: tuple[ChannelKind, ...] = ("camera", "radar")
    for kind in kinds:
        found = _of_role(free, kind)
        lost = [one for one in found if channel_of(kind, one.name, one.frame_id, channel_of_frame) is None]
        if lost:
            line = f"--topic {PREFIX[kind]}_FRONT={lost[0].name}"
            message = (
                f"The viewing direction of the {kind} {_listed(lost)} cannot be inferred from names; if forward: {line}"
            )
            yield Finding("TOP-112", "info", lost[0].name, message)
