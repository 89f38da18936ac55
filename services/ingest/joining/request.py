"""What is asked for when recordings are joined, and whether it can be."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from services.ingest.pipeline import SynchroniseOptions
from stone_files.joined_file import MOST_MEMBERS, is_joined, is_member_name
from stone_recordings.joining.errors import NotJoinedError
from stone_recordings.joining.held_messages import HeldMessages
from stone_recordings.sync.errors import NoLidarError
from stone_recordings.topics.roles import holds_other_packets


@dataclass(frozen=True)
class JoinRequest:
    """The recordings of one run: files, or folders of split bags, each of another name.

    `given_ns` are offsets by name of recording that are taken as they are. Without a calibration, file or folder, only
    what needs no mounts is measured. `options` choose topics as for synchronising.
    """

    paths: tuple[Path, ...]
    calibration: Path | None = None
    given_ns: Mapping[str, int] = field(default_factory=dict)
    options: SynchroniseOptions = field(default_factory=SynchroniseOptions)

    @property
    def path_of(self) -> Mapping[str, Path]:
        return {path.name: path for path in self.paths}


def checked_paths(asked: JoinRequest) -> tuple[Path, ...]:
    """In order of their names, so that it does not matter in which they were named. Raises: NotJoinedError."""
    names = sorted(path.name for path in asked.paths)
    if not 2 <= len(names) <= MOST_MEMBERS:
        raise NotJoinedError(f"these are {len(names)} recordings, 2 to {MOST_MEMBERS} are joined")
    if len({name.casefold() for name in names}) < len(names):
        raise NotJoinedError(f"two of the recordings have one name: {', '.join(names)}")
    for path in asked.paths:
        if not is_member_name(path.name) or is_joined(path):
            raise NotJoinedError(f"{path.name!r} is joined of others already, or has no name that a file can have")
    if unknown := sorted(set(asked.given_ns) - set(names)):
        raise NotJoinedError(f"an offset is given for {unknown[0]!r}, which is none of {', '.join(names)}")
    return tuple(sorted(asked.paths, key=lambda path: path.name))


def reference_first(held: Sequence[HeldMessages], lidar: str | None) -> tuple[HeldMessages, ...]:
    """The recording with the LiDAR (or the topic that is named) in front, of several the one that begins first.

    Raises: NoLidarError.
    """
    counts: dict[str, int] = {}
    for recording in held:
        for topic in recording.of_role("lidar"):
            counts[topic.name] = counts.get(topic.name, 0) + topic.count
    name = lidar or max(counts, key=lambda one: (counts[one], one), default="")
    having = [one for one in held if any(topic.name == name for topic in one.topics)]
    if not having:
        packets = [topic for one in held for topic in one.topics if holds_other_packets(topic)]
        raise NoLidarError([(topic.name, topic.type) for topic in packets])
    reference = min(having, key=lambda one: (one.start_ns, one.name))
    return (reference, *(one for one in held if one is not reference))


def check_given(asked: JoinRequest, held: Sequence[HeldMessages]) -> None:
    """Raises: NotJoinedError for an offset of what has the LiDAR, whose points bear times of their own."""
    lidars = {topic.name for topic in held[0].of_role("lidar")}
    for number, one in enumerate(held):
        has_lidar = not number or any(topic.name in lidars for topic in one.topics)
        if has_lidar and asked.given_ns.get(one.name):
            raise NotJoinedError(f"{one.name} has the LiDAR, whose clock is the run's: its offset is 0")
