"""Joins several recordings of one run: whose clock is off by how much, and which messages two of them hold.

    recordings → who has the LiDAR → shared messages, topics that go on → offsets measured by sensors → joined.json

**Conventions.** The reference is the recording with the LiDAR, of a run that was cut its first part; its clock is the
run's. An offset is added to a recording's times. What was asked for is taken, what can be measured is measured, and
nothing is guessed. Equal recordings give equal descriptions, in whatever order they are named.
"""

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from services.ingest.pipeline import SynchroniseOptions
from stone_files.joined_file import (
    GIVEN,
    JOINED,
    MOST_MEMBERS,
    REFERENCE,
    JoinedMember,
    is_joined,
    is_member_name,
    joined_bytes,
)
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.joined.joined_store import check_types
from stone_recordings.joining.clock_links import ClockOffset, linked
from stone_recordings.joining.errors import NotJoinedError, UnmeasuredOffsetError
from stone_recordings.joining.held_messages import HeldMessages, held_by
from stone_recordings.joining.overlaps import left_out
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


@dataclass(frozen=True)
class JoinedRecording:
    """The recordings, the reference first, and what `joined.json` says of each."""

    paths: tuple[Path, ...]
    members: tuple[JoinedMember, ...]

    @property
    def name(self) -> str:
        """The run's, by its reference."""
        return self.paths[0].stem


def join_recordings(asked: JoinRequest) -> JoinedRecording:
    """Raises: NotJoinedError (SYN-526), NoLidarError, JoinedTopicError (BAG-041), UnmeasuredOffsetError (SYN-523),
    ContradictoryOffsetsError (SYN-524), NoCommonTimeError (SYN-525), and what opening and decoding raise."""
    paths = _checked(asked)
    with ExitStack() as opened:
        held = held_by({path.name: opened.enter_context(open_bag(path)) for path in paths})
    check_types((topic.name, topic.type) for one in held for topic in one.topics)
    held = _reference_first(held, asked.options.lidar_topic)
    offsets = _offsets(asked, held)
    runs = left_out(held, offsets)
    members = tuple(
        JoinedMember(one.name, to.offset_ns, to.sigma_ns, to.known_by, to.kept_topics, left)
        for one, to, left in zip(held, offsets, runs, strict=True)
    )
    by_name = {path.name: path for path in paths}
    return JoinedRecording(tuple(by_name[member.name] for member in members), members)


def write_joined(joined: JoinedRecording, folder: Path, sha256s: Mapping[str, str] | None = None) -> None:
    """Into an empty folder: links to the recordings, and `joined.json`, last.

    `sha256s` are hashes of the recordings by name, where they are known.
    """
    for path in joined.paths:
        os.symlink(path.resolve(), folder / path.name)
    members = [replace(member, sha256=(sha256s or {}).get(member.name, "")) for member in joined.members]
    (folder / JOINED).write_bytes(joined_bytes(members))


def _checked(asked: JoinRequest) -> tuple[Path, ...]:
    """In order of their names. Raises: NotJoinedError."""
    names = [path.name for path in asked.paths]
    if not 2 <= len(names) <= MOST_MEMBERS:
        raise NotJoinedError(f"these are {len(names)} recordings, 2 to {MOST_MEMBERS} are joined")
    if len({name.casefold() for name in names}) < len(names):
        raise NotJoinedError(f"two of the recordings have one name: {', '.join(sorted(names))}")
    for path in asked.paths:
        if not is_member_name(path.name) or is_joined(path):
            raise NotJoinedError(f"{path.name!r} cannot be joined: it is joined already, or its name is none of a file")
    if unknown := sorted(set(asked.given_ns) - set(names)):
        raise NotJoinedError(f"an offset is given for {unknown[0]!r}, which is none of {', '.join(sorted(names))}")
    return tuple(sorted(asked.paths, key=lambda path: path.name))


def _reference_first(held: Sequence[HeldMessages], lidar: str | None) -> tuple[HeldMessages, ...]:
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


def _offsets(asked: JoinRequest, held: Sequence[HeldMessages]) -> tuple[ClockOffset, ...]:
    known = _known(asked, held)
    if missing := [one.name for number, one in enumerate(held) if number not in known]:
        raise UnmeasuredOffsetError(missing, [])
    return tuple(known[number] for number in range(len(held)))


def _known(asked: JoinRequest, held: Sequence[HeldMessages]) -> dict[int, ClockOffset]:
    """Of the recordings that messages or topics lead to from the reference, or from one whose offset is given."""
    known = dict(linked(held, 0)) | {0: ClockOffset(0, None, (REFERENCE,))}
    given = {number: one.name for number, one in enumerate(held) if one.name in asked.given_ns}
    _check_given(asked, held, given)
    for number, name in given.items():
        known[number] = ClockOffset(asked.given_ns[name], None, (GIVEN,))
        for other, link in linked(held, number).items():
            known.setdefault(other, link.after(known[number]))
    return known


def _check_given(asked: JoinRequest, held: Sequence[HeldMessages], given: Mapping[int, str]) -> None:
    """Raises: NotJoinedError for an offset of what has the LiDAR, whose points bear times of their own."""
    lidars = {topic.name for topic in held[0].of_role("lidar")}
    for number, name in given.items():
        has_lidar = not number or any(topic.name in lidars for topic in held[number].topics)
        if has_lidar and asked.given_ns[name]:
            raise NotJoinedError(f"{name} has the LiDAR, whose clock is the run's: its offset is 0")
