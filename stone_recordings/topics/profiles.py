"""Topic profiles: the role of each topic on a robot, chosen once by its owner, otherwise resolved from the recording.

**Conventions.** Parts are `lidar`, `pose`, `imu` and the channels of cameras and radars (CAM_FRONT, RADAR_LEFT). A
profile's choice takes precedence if it fits the recording; otherwise a finding reports it and the part is resolved
without the profile. If several topics fit a part, none is chosen: TOP-110 names them and the option that chooses one.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ruamel.yaml import YAML

from stone.errors import Refused
from stone.findings import Finding, Severity
from stone_files.atomic import atomic_file
from stone_recordings.calibrations.errors import CalibrationYamlError
from stone_recordings.calibrations.plain_yaml import parse_documents
from stone_recordings.topics.roles import (
    POINT_CLOUD,
    POSE_ROLES,
    Role,
    likely_lidars,
    of_pose_role,
    with_plausible_rate,
)
from stone_recordings.topics.unread_topics import not_read, unread_findings, unread_points, video_findings

PARTS = ("lidar", "pose", "imu")
CHANNEL = re.compile(r"(?:CAM|RADAR)(?:_[A-Z0-9]+){1,4}")
MOST_TOPICS, LONGEST_TOPIC, SHOWN = 64, 256, 6


@dataclass(frozen=True)
class TopicProfile:
    """The topics chosen for a platform, by part. Raises `TOP-113` for an invalid part or name."""

    topics: Mapping[str, str] = field(default_factory=dict)
    platform: str = ""

    def __post_init__(self) -> None:
        if len(self.topics) > MOST_TOPICS:
            raise bad_profile(f"{len(self.topics)} topics", f"at most {MOST_TOPICS}")
        for part, topic in self.topics.items():
            if part not in PARTS and not CHANNEL.fullmatch(part):
                raise bad_profile(f"the role {part[:40]!r}", "lidar, pose, imu, CAM_… or RADAR_… (CAM_FRONT_LEFT)")
            if not 0 < len(topic) <= LONGEST_TOPIC or not topic.isprintable() or topic != topic.strip():
                raise bad_profile(f"the topic {topic[:40]!r}", f"a name of 1 to {LONGEST_TOPIC} plain characters")
        for topic in self.topics.values():
            parts = [part for part, named in self.topics.items() if named == topic]
            if len(parts) > 1:
                raise bad_profile(f"the topic {topic[:40]!r} as {' and '.join(parts)}", "one role for each topic")


@dataclass(frozen=True)
class Candidate:
    """Facts about a topic that has messages; `frame_id` is that of its first message, "" if none was read.

    `point_count` is that of one of its clouds, 0 if none was read; `problem` is the reason why no cloud can be read.
    """

    name: str
    type: str
    role: Role
    count: int
    rate_hz: float | None = None
    frame_id: str = ""
    point_count: int = 0
    problem: str = ""


@dataclass(frozen=True)
class Assignment:
    """The topic of each resolved part, and findings for the parts that are not resolved."""

    channels: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    def as_profile(self, platform: str = "") -> TopicProfile:
        """Return the profile that resolves the next recording of the robot in the same way."""
        return TopicProfile(dict(self.channels), platform)


def resolve(
    candidates: Sequence[Candidate], profile: TopicProfile, channel_of_frame: Mapping[str, str] | None = None
) -> Assignment:
    """Assign topics to parts; `channel_of_frame` names the channel of each frame_id in the calibration.

    Topics without messages are not candidates.
    """
    chosen, doubts = _chosen(candidates, profile)
    free = [candidate for candidate in candidates if candidate.count and candidate.name not in chosen.values()]
    resolved: dict[str, str] = {}
    for part, fitting in _fitting(free, channel_of_frame or {}):
        if part in chosen or not fitting:
            continue
        if len(fitting) == 1:
            resolved[part] = fitting[0].name
        else:
            doubts.append(_ambiguous(part, fitting))
    channels = {**chosen, **resolved}
    doubts += _missing(candidates, channels)
    doubts += [*_nameless(free, channel_of_frame or {}), *video_findings(free)]
    return Assignment(channels, tuple(doubts))


def _chosen(candidates: Sequence[Candidate], profile: TopicProfile) -> tuple[dict[str, str], list[Finding]]:
    """Return the profile's choices that fit this recording, and a finding for each other choice."""
    of_name = {candidate.name: candidate for candidate in candidates if candidate.count}
    chosen, doubts = dict[str, str](), list[Finding]()
    for part, topic in profile.topics.items():
        candidate = of_name.get(topic)
        if candidate is not None and _can_be(candidate, part):
            chosen[part] = topic
            continue
        why = "has no messages here" if candidate is None else f"is of type {candidate.type}"
        message = f"The profile names {topic} for {part}, which {why}; {part} was resolved without the profile."
        doubts.append(Finding("TOP-111", "warning", topic, message))
    return chosen, doubts


def _can_be(candidate: Candidate, part: str) -> bool:
    """Return whether a choice fits the topic's message type; a choice may overrule the role of a cloud."""
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
    """Yield each part with the topics that fit it best."""
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
    """Yield a finding for each required part that no topic fits; several fitting topics are reported elsewhere."""
    recorded = [candidate for candidate in candidates if candidate.count]
    if "lidar" not in channels and not _of_role(recorded, "lidar"):
        unread = unread_points(recorded)
        why = f"{not_read(unread)}." if unread else "Labels need a LiDAR."
        message = f"The recording has no LiDAR PointCloud2, nor other points or packets that can be decoded. {why}"
        yield Finding("TOP-101", "error", unread[0].name if unread else "", message)
    else:
        yield from unread_findings(recorded)
    if "pose" not in channels and not any(of_pose_role(role, _of_role(recorded, role)) for role in POSE_ROLES):
        message = (
            "The recording has no INS, odometry, /tf, poses or NavSatFix. Labels need a pose source, or a file: "
            "--poses."
        )
        yield Finding("TOP-103", "warning", "", message)


def _nameless(free: Sequence[Candidate], channel_of_frame: Mapping[str, str]) -> Iterator[Finding]:
    """Yield one finding per kind for cameras and radars whose viewing direction is unknown."""
    kinds: tuple[ChannelKind, ...] = ("camera", "radar")
    for kind in kinds:
        candidates = _of_role(free, kind)
        lost = [
            candidate
            for candidate in candidates
            if channel_of(kind, candidate.name, candidate.frame_id, channel_of_frame) is None
        ]
        if lost:
            line = f"--topic {PREFIX[kind]}_FRONT={lost[0].name}"
            message = (
                f"The viewing direction of the {kind} {_listed(lost)} cannot be inferred from names; if forward: {line}"
            )
            yield Finding("TOP-112", "info", lost[0].name, message)


# Refusals of topic profiles. TOP-1xx is about which topics exist and their roles.


def bad_profile(found: str, expected: str) -> Refused:
    return Refused("TOP-113", f"a topic profile cannot hold {found}; expected is {expected}")


def bad_profile_file(name: str, fault: str) -> Refused:
    return Refused(
        "TOP-114", f"{name} is not a topic profile: {fault}; expected are `stone_profile: 1` and `topics:` by role"
    )


# A topic profile as a small YAML file, so that the choice for one recording serves the next.
# `stone_profile: 1`, `platform:` and `topics:` by part. The file is untrusted: plain YAML without aliases and tags, at
# most 64 KiB.


LARGEST_BYTES = 65_536
LONGEST_PLATFORM = 64
KEYS = {"stone_profile", "platform", "topics"}


def read_profile(path: Path) -> TopicProfile:
    """Read a profile. Raises `TOP-114` if the file is not a profile, `TOP-113` for an invalid profile; OSError."""
    with path.open("rb") as stream:
        content = stream.read(LARGEST_BYTES + 1)
    if len(content) > LARGEST_BYTES:
        raise bad_profile_file(path.name, f"it has more than {LARGEST_BYTES} bytes")
    try:
        document = parse_documents(path.name, content)[0]
    except CalibrationYamlError as error:
        raise bad_profile_file(path.name, str(error)) from None
    if not isinstance(document, dict) or document.get("stone_profile") != 1:
        raise bad_profile_file(path.name, "it does not begin with `stone_profile: 1`")
    unknown = [str(key)[:40] for key in document if key not in KEYS]
    if unknown:
        raise bad_profile_file(path.name, f"it has the unknown key {unknown[0]!r}")
    platform, topics = document.get("platform", ""), document.get("topics")
    if not isinstance(platform, str) or len(platform) > LONGEST_PLATFORM:
        raise bad_profile_file(path.name, f"its platform is not text of at most {LONGEST_PLATFORM} characters")
    if not isinstance(topics, dict) or not all(isinstance(name, str) for pair in topics.items() for name in pair):
        raise bad_profile_file(path.name, "its topics are not names by role")
    return TopicProfile(topics, platform)


def write_profile(path: Path, profile: TopicProfile) -> None:
    """Write the file atomically, replacing an earlier one. Raises OSError."""
    yaml = YAML()
    yaml.width = 4096
    document = {"stone_profile": 1, "platform": profile.platform, "topics": dict(profile.topics)}
    with atomic_file(path) as staging, staging.open("w", encoding="utf-8") as stream:
        yaml.dump(document, stream)


# Channels of cameras and radars: from the frame of their messages, else from words in their names.
# Channels are nuScenes' (CAM_FRONT_LEFT, RADAR_RIGHT). A frame in the calibration decides. Otherwise the words front,
# back (rear), left and right in the topic decide; the frame's words count only if the topic has none. Contradictory or
# missing words give no channel.


ChannelKind = Literal["camera", "radar"]
PREFIX: Mapping[ChannelKind, str] = {"camera": "CAM", "radar": "RADAR"}
ENDS = {"front": "FRONT", "forward": "FRONT", "fwd": "FRONT", "back": "BACK", "rear": "BACK", "backward": "BACK"}
SIDES = {"left": "LEFT", "right": "RIGHT"}
SHORT = {"fl": ("front", "left"), "fr": ("front", "right")} | {
    short + side[0]: ("back", side) for short in "br" for side in SIDES
}
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def channel_of(kind: ChannelKind, topic: str, frame_id: str, channel_of_frame: Mapping[str, str]) -> str | None:
    """Return the channel, or None if neither frame nor names decide; `channel_of_frame` is the calibration's, by
    frame_id.
    """
    known = channel_of_frame.get(frame_id.strip("/"))
    if known is not None and known.startswith(PREFIX[kind]):
        return known
    return channel_of_words(kind, topic) or channel_of_words(kind, frame_id)


def channel_of_words(kind: ChannelKind, name: str) -> str | None:
    """Return CAM_FRONT_LEFT for "/camera/frontLeft/image", "cam_fl" or "/left/front_camera"; None without such
    words.
    """
    words = [word for part in WORD.findall(name) for word in _spelt(part.lower())]
    ends = {ENDS[word] for word in words if word in ENDS}
    sides = {SIDES[word] for word in words if word in SIDES}
    if len(ends) > 1 or len(sides) > 1 or not ends | sides:
        return None
    return "_".join([PREFIX[kind], *ends, *sides])


def _spelt(word: str) -> tuple[str, ...]:
    """Split "frontleft" and "fl" into their two words."""
    if word in SHORT:
        return SHORT[word]
    for end in ENDS:
        if word.startswith(end) and word.removeprefix(end) in SIDES:
            return (end, word.removeprefix(end))
    return (word,)
