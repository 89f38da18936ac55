"""The files of a recording: one file, or those of a rosbag2 folder.

**Conventions.** With a metadata.yaml the files that it lists, by their last name component only (old bags list
"run/run_0.db3", hostile ones "../../etc/passwd"); without one, every file that is a container by its first bytes. Order
is the list's, else that of the numbers in the names. A link is followed, but only to a regular file.
"""

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from stone.findings import Finding
from stone_files.joined_file import is_joined
from stone_recordings.bags.bag_metadata import BagMetadata, MetadataError, read_metadata
from stone_recordings.bags.errors import MembersRefusedError, NotABagError
from stone_recordings.bags.magic import container_of, is_container

METADATA = "metadata.yaml"
SIDECARS = ("-wal", "-shm", "-journal")
MOST_MEMBERS = 4096


@dataclass(frozen=True)
class RecordingMembers:
    """At least one file, and what was noticed on the way to them."""

    files: tuple[Path, ...]
    findings: tuple[Finding, ...] = ()


def members_of(path: Path) -> RecordingMembers:
    """Raises: FileNotFoundError, NotABagError (BAG-001), MembersRefusedError (BAG-019), CutBagError."""
    if not path.is_dir():
        container_of(path)
        return RecordingMembers((path,))
    if is_joined(path):
        raise MembersRefusedError(path.name, "it joins several recordings: name one of them")
    names = _names(path)
    if METADATA not in names:
        return _found(path, names)
    try:
        return _listed(path, names, read_metadata(path / METADATA))
    except MetadataError as error:
        found = _found(path, [name for name in names if name != METADATA])
        message = f"{error}: the {len(found.files)} files beside it are read without it."
        return RecordingMembers(found.files, (Finding("BAG-023", "warning", METADATA, message),))


def _names(folder: Path) -> list[str]:
    """Regular files, directly in the folder; hidden ones are nobody's recording."""
    names = []
    for number, entry in enumerate(folder.iterdir()):
        if number >= MOST_MEMBERS:
            raise MembersRefusedError(
                folder.name, f"it holds more than {MOST_MEMBERS} entries, more than any recording"
            )
        if entry.is_file() and not entry.name.startswith("."):
            names.append(entry.name)
    return sorted(names, key=_natural)


def _natural(name: str) -> tuple[tuple[int, str], ...]:
    """run_2 before run_10."""
    return tuple((int(part[:18]), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name))


def _found(folder: Path, names: list[str]) -> RecordingMembers:
    """Every container of the folder; a file and its compressed twin are one."""
    containers = [name for name in names if not name.endswith(SIDECARS) and is_container(folder / name)]
    files = [name for name in containers if name.removesuffix(".zstd") not in containers or not name.endswith(".zstd")]
    if not files:
        raise NotABagError(folder.name, b"", "a folder without metadata.yaml, .mcap, .db3 or .bag file")
    if len({Path(name.removesuffix(".zstd").removesuffix(".active")).suffix for name in files}) > 1:
        shown = ", ".join(files[:4])
        raise MembersRefusedError(folder.name, f"it has no metadata.yaml to say which files are the recording: {shown}")
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
        raise MembersRefusedError(folder.name, f"none of the {len(wanted)} files that metadata.yaml lists is there")
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
