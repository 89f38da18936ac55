"""The files of a recording: one file, or those of a rosbag2 folder.

**Conventions.** With a metadata.yaml, the files in its list, by their last name component only (old bags list
"run/run_0.db3", hostile ones "../../etc/passwd"). Without it, every file that is a container by its first bytes. The
order is that of the list, else that of the numbers in the names. A link is followed only to a regular file.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import CollectionEndEvent, CollectionStartEvent, MappingStartEvent, NodeEvent, ScalarEvent

from stone.findings import Finding
from stone_files.joined_file import is_joined
from stone_recordings.bags.errors import IngestError, NotABagError
from stone_recordings.bags.magic import container_of, is_container

# A bounded reader of rosbag2's metadata.yaml, for the files in its list. Counts, times and types in it are never used,
# because the files contain them. The events of the YAML are walked and nothing is built from them, so that aliases and
# depth cost no more than their bytes.


ROOT = "rosbag2_bagfile_information"
SIZE_LIMIT_BYTES = 4 * 2**20
EVENT_LIMIT = 200_000
DEPTH_LIMIT = 24


class MetadataError(Exception):
    """The file cannot be understood, with the reason. The folder is read without it."""


@dataclass(frozen=True)
class BagMetadata:
    """`files` as listed, in order."""

    files: tuple[str, ...]


def read_metadata(path: Path) -> BagMetadata:
    """Read the file. Raises: MetadataError."""
    try:
        with path.open("rb") as file:
            content = file.read(SIZE_LIMIT_BYTES + 1)
        if len(content) > SIZE_LIMIT_BYTES:
            raise MetadataError(f"metadata.yaml is larger than {SIZE_LIMIT_BYTES} bytes")
        values = list(_values(content.decode()))
    except (OSError, ValueError, YAMLError) as error:
        reason = " ".join(str(error).split())[:160]
        raise MetadataError(f"metadata.yaml cannot be read ({reason})") from None
    files = tuple(value for path_of_keys, value in values if path_of_keys == (ROOT, "relative_file_paths", ""))
    if not files:
        raise MetadataError("metadata.yaml lists no files")
    return BagMetadata(files)


@dataclass
class _YamlLevel:
    """The walk's position inside one mapping or sequence; `key` is None before a mapping's next key."""

    is_mapping: bool
    key: str | None = None


def _values(text: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield every scalar with its path of keys; an item of a sequence has the key ""."""
    levels: list[_YamlLevel] = []
    for number, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
        if number > EVENT_LIMIT or len(levels) > DEPTH_LIMIT:
            raise MetadataError(f"metadata.yaml has more than {EVENT_LIMIT} values or {DEPTH_LIMIT} levels")
        if isinstance(event, CollectionEndEvent):
            levels.pop()
            _next_key(levels)
        elif isinstance(event, NodeEvent):
            yield from _value(levels, event)


def _value(levels: list[_YamlLevel], event: NodeEvent) -> Iterator[tuple[tuple[str, ...], str]]:
    is_key = bool(levels) and levels[-1].is_mapping and levels[-1].key is None
    if is_key:
        levels[-1].key = event.value if isinstance(event, ScalarEvent) else "?"
    elif isinstance(event, ScalarEvent):
        yield tuple(level.key or "" for level in levels), event.value
    if isinstance(event, CollectionStartEvent):
        levels.append(_YamlLevel(isinstance(event, MappingStartEvent)))
    elif not is_key:
        _next_key(levels)


def _next_key(levels: list[_YamlLevel]) -> None:
    if levels:
        levels[-1].key = None


METADATA = "metadata.yaml"
SIDECARS = ("-wal", "-shm", "-journal")
MOST_MEMBERS = 4096


@dataclass(frozen=True)
class RecordingMembers:
    """At least one file, and the findings of the search."""

    files: tuple[Path, ...]
    findings: tuple[Finding, ...] = ()


def members_of(path: Path) -> RecordingMembers:
    """Return the members. Raises: FileNotFoundError, NotABagError (BAG-001), `BAG-019`, CutBagError."""
    if not path.is_dir():
        container_of(path)
        return RecordingMembers((path,))
    if is_joined(path):
        raise members_refused(path.name, "it joins several recordings: name one of them")
    names = _names(path)
    if METADATA not in names:
        return _found(path, names)
    try:
        return _listed(path, names, read_metadata(path / METADATA))
    except MetadataError as error:
        members = _found(path, [name for name in names if name != METADATA])
        message = f"{error}: the {len(members.files)} files beside it are read without it."
        return RecordingMembers(members.files, (Finding("BAG-023", "warning", METADATA, message),))


def _names(folder: Path) -> list[str]:
    """Return regular files directly in the folder; hidden files belong to no recording."""
    names = []
    for number, entry in enumerate(folder.iterdir()):
        if number >= MOST_MEMBERS:
            raise members_refused(folder.name, f"it holds more than {MOST_MEMBERS} entries, more than any recording")
        if entry.is_file() and not entry.name.startswith("."):
            names.append(entry.name)
    return sorted(names, key=_natural)


def _natural(name: str) -> tuple[tuple[int, str], ...]:
    """Return a sort key that puts run_2 before run_10."""
    return tuple((int(part[:18]), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name))


def _found(folder: Path, names: list[str]) -> RecordingMembers:
    """Return every container of the folder; a file and its compressed twin are one."""
    containers = [name for name in names if not name.endswith(SIDECARS) and is_container(folder / name)]
    files = [name for name in containers if name.removesuffix(".zstd") not in containers or not name.endswith(".zstd")]
    if not files:
        raise NotABagError(folder.name, b"", "a folder without metadata.yaml, .mcap, .db3 or .bag file")
    if len({Path(name.removesuffix(".zstd").removesuffix(".active")).suffix for name in files}) > 1:
        shown = ", ".join(files[:4])
        raise members_refused(folder.name, f"it has no metadata.yaml that lists the files of the recording: {shown}")
    message = f"No metadata.yaml: the {len(files)} files of the folder are taken as one recording."
    return RecordingMembers(tuple(folder / name for name in files), (Finding("BAG-025", "info", "", message),))


def _listed(folder: Path, names: list[str], metadata: BagMetadata) -> RecordingMembers:
    wanted = list(dict.fromkeys(PurePosixPath(listed).name for listed in metadata.files))
    present = [name for name in wanted if name in names and _has_bytes(folder / name)]
    findings = []
    if missing := [name for name in wanted if name not in present]:
        message = f"metadata.yaml lists {len(wanted)} files, {len(missing)} are missing or empty: {_shown(missing)}."
        findings.append(Finding("BAG-021", "error", missing[0], message))
    if not present:
        raise members_refused(folder.name, f"none of the {len(wanted)} files that metadata.yaml lists is there")
    known = {*present, METADATA, *(f"{name}{suffix}" for name in present for suffix in SIDECARS)}
    if others := [name for name in names if name not in known and is_container(folder / name)]:
        message = f"metadata.yaml does not list {_shown(others)}: left out."
        findings.append(Finding("BAG-024", "warning", others[0], message))
    return RecordingMembers(tuple(folder / name for name in present), tuple(findings))


def _has_bytes(path: Path) -> bool:
    wal = path.with_name(f"{path.name}-wal")
    return path.stat().st_size > 0 or (wal.is_file() and wal.stat().st_size > 0)


def _shown(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def members_refused(name: str, problem: str) -> IngestError:
    return IngestError("BAG-019", f"{name} cannot be opened as a rosbag2 folder: {problem}")
