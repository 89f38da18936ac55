"""The description of a joined recording: `joined.json` of a folder whose bags are one run, with their clocks' offsets.

**Conventions.** A member is a bag of the folder, a file or a folder of a split one, or a link to one; nothing else is
named. `offset_ns` is added to the stamps of a member, so that they are on the clock of the reference, which is the
member with the LiDAR and has offset 0. Equal values give equal bytes.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

from stone_base.errors import StoneError

JOINED = "joined.json"
FORMAT, VERSION = "stone-joined-recording", 1
MOST_MEMBERS = 64
MOST_BYTES = 4 * 2**20
MOST_RUNS = 20_000
MOST_NAME_BYTES = 255
# Seventy years: a clock that counts from the start of its computer is off by fifty.
MOST_OFFSET_NS = 70 * 365 * 86_400 * 10**9
LAST_INDEX = 2**48
SHA256 = re.compile(r"[0-9a-f]{64}|")
# How an offset came to be known.
REFERENCE, SAME_MESSAGES, SAME_TOPICS, GIVEN = "reference", "same messages", "same topics", "given"
CAMERAS, TRIGGERS, RADARS, GYRO, SWEEPS = "camera motion", "camera triggers", "radar speed", "gyro", "sweeps"
SOURCES = (REFERENCE, SAME_MESSAGES, SAME_TOPICS, GIVEN, CAMERAS, TRIGGERS, RADARS, GYRO, SWEEPS)


class JoinedFileError(StoneError):
    """A joined.json is not the description of a joined recording."""

    code = "BAG-040"

    def __init__(self, folder: str, problem: str) -> None:
        super().__init__(
            f"{folder}/{JOINED}: {problem}; it is written when recordings are joined, not by hand: join them again"
        )


@dataclass(frozen=True)
class JoinedMember:
    """A bag called `name`, whose offset's standard error is `sigma_ns`, None where nobody measured it.

    `known_by`: of `SOURCES`. `kept_topics` bear stamps of the reference's clock though this member holds them: only
    their log times are moved. `left_out`: by topic, half-open runs of messages that an earlier member holds, too.
    """

    name: str
    offset_ns: int = 0
    sigma_ns: int | None = None
    known_by: tuple[str, ...] = ()
    kept_topics: tuple[str, ...] = ()
    left_out: Mapping[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    sha256: str = ""

    def count_left_out(self) -> Mapping[str, int]:
        """Messages by topic."""
        return {topic: sum(stop - start for start, stop in runs) for topic, runs in self.left_out.items()}


def is_joined(path: Path) -> bool:
    """Whether `path` is the folder of a joined recording."""
    return (path / JOINED).is_file()


def joined_bytes(members: Sequence[JoinedMember]) -> bytes:
    """The file for these members. Raises: JoinedFileError where `read_joined` would refuse it."""
    _check(members, "")
    record = {"format": FORMAT, "version": VERSION, "members": [asdict(member) for member in members]}
    return (json.dumps(record, indent=1, sort_keys=True) + "\n").encode()


def read_joined(folder: Path) -> tuple[JoinedMember, ...]:
    """The members, in order. Raises: JoinedFileError (BAG-040)."""
    with (folder / JOINED).open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise JoinedFileError(folder.name, f"it is larger than {MOST_BYTES} bytes")
    try:
        record = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise JoinedFileError(folder.name, f"it is not JSON ({str(error)[:100]})") from None
    if not isinstance(record, dict) or (record.get("format"), record.get("version")) != (FORMAT, VERSION):
        raise JoinedFileError(folder.name, f"it is not of format {FORMAT!r}, version {VERSION}")
    listed = record.get("members")
    if not isinstance(listed, list) or not 1 <= len(listed) <= MOST_MEMBERS:
        raise JoinedFileError(folder.name, f"it must list 1 to {MOST_MEMBERS} members")
    members = tuple(_member(folder.name, entry) for entry in listed)
    _check(members, folder.name)
    return members


def member_path(folder: Path, member: JoinedMember) -> Path:
    """Where a member lies. Raises: JoinedFileError where it is missing, or is itself a joined recording."""
    path = folder / member.name
    if not (path.is_file() or path.is_dir()):
        raise JoinedFileError(folder.name, f"its member {member.name!r} is not there")
    if is_joined(path):
        raise JoinedFileError(folder.name, f"its member {member.name!r} is itself a joined recording")
    return path


def _member(folder: str, entry: Any) -> JoinedMember:
    if not isinstance(entry, dict) or set(entry) != {one.name for one in fields(JoinedMember)}:
        raise JoinedFileError(folder, "a member has other keys than it should")
    is_text = isinstance(entry["name"], str) and isinstance(entry["sha256"], str)
    is_timed = type(entry["offset_ns"]) is int and (entry["sigma_ns"] is None or type(entry["sigma_ns"]) is int)
    if not (is_text and is_timed and isinstance(entry["left_out"], dict)):
        raise JoinedFileError(folder, "a member has a value of another type than it should")
    known_by, kept = _texts(folder, entry["known_by"]), _texts(folder, entry["kept_topics"])
    left_out = {topic: _runs(folder, runs) for topic, runs in entry["left_out"].items()}
    return JoinedMember(entry["name"], entry["offset_ns"], entry["sigma_ns"], known_by, kept, left_out, entry["sha256"])


def _texts(folder: str, listed: Any) -> tuple[str, ...]:
    if not isinstance(listed, list) or not all(isinstance(text, str) for text in listed):
        raise JoinedFileError(folder, "a list of names is expected")
    return tuple(listed)


def _runs(folder: str, listed: Any) -> tuple[tuple[int, int], ...]:
    is_list = isinstance(listed, list) and all(isinstance(run, list) and len(run) == 2 for run in listed)
    if not is_list or not all(type(index) is int for run in listed for index in run):
        raise JoinedFileError(folder, "the messages that are left out are not a list of runs")
    return tuple((start, stop) for start, stop in listed)


def _check(members: Sequence[JoinedMember], folder: str) -> None:
    """Raises: JoinedFileError."""
    if not 1 <= len(members) <= MOST_MEMBERS:
        raise JoinedFileError(folder, f"it must list 1 to {MOST_MEMBERS} members, these are {len(members)}")
    if len({member.name.casefold() for member in members}) < len(members):
        raise JoinedFileError(folder, "two of its members have one name")
    if sum(len(runs) for member in members for runs in member.left_out.values()) > MOST_RUNS:
        raise JoinedFileError(folder, f"more than {MOST_RUNS} runs of messages are left out")
    for member in members:
        if problem := _problem(member):
            raise JoinedFileError(folder, problem)


def _problem(member: JoinedMember) -> str:
    """What no member can be; "" for one that may be."""
    shown = f"member {member.name[:80]!r}"
    if not is_member_name(member.name):
        return f"{shown} is not the name of a file directly in the folder"
    if abs(member.offset_ns) > MOST_OFFSET_NS or not 0 <= (member.sigma_ns or 0) <= MOST_OFFSET_NS:
        return f"{shown} has an offset of {member.offset_ns} ns, the limit is {MOST_OFFSET_NS}"
    if not set(member.known_by) <= set(SOURCES) or not SHA256.fullmatch(member.sha256):
        return f"{shown} has an offset from an unknown source, or an invalid hash"
    for runs in member.left_out.values():
        ends = [index for run in runs for index in run]
        if ends and not (ends[0] >= 0 and ends[-1] <= LAST_INDEX and all(one < two for one, two in pairwise(ends))):
            return f"{shown} leaves out runs of messages that are not in order"
    return ""


def is_member_name(name: str) -> bool:
    """Whether a member may be called so: one component, visible, not the description itself."""
    is_plain = name.isprintable() and not set("/\\") & set(name) and not name.startswith(".")
    return is_plain and 0 < len(name.encode()) <= MOST_NAME_BYTES and name.casefold() != JOINED
