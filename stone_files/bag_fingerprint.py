"""The fingerprint of a sequence's inputs: a hash that anyone can recompute (sha256sum).

**Conventions.** Every member of a joined recording is an input under its own name. The key `joined.json` (which
contains the clock offsets) has the hash of the whole: description and members.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from hashlib import sha256
from io import FileIO
from pathlib import Path
from threading import Event
from types import MappingProxyType

from stone_base.errors import Refused
from stone_files.joined_file import JOINED, is_joined, member_path, read_joined

HASH_BLOCK_BYTES = 1 << 20


def bag_parts(path: Path) -> list[Path]:
    """Return the bag's files, sorted by name: all of a rosbag2 folder, or a file and its recorder's journals.

    For a joined recording, return its description and the files of every member. Raises: JoinedFileError.
    """
    if is_joined(path):
        return [path / JOINED, *(part for member in _members(path) for part in bag_parts(member))]
    if not path.is_dir():
        return [path, *(beside for suffix in LEFT_BESIDE if _has_bytes(beside := path.with_name(path.name + suffix)))]
    parts = sorted(file for file in path.iterdir() if file.is_file() and is_bag_part(file.name))
    return [part for part in parts if _has_bytes(part) or not part.name.endswith(LEFT_BESIDE)]


def bag_paths(path: Path) -> tuple[Path, ...]:
    """Return the bag and its files, for access rights: a folder may contain links to files outside it.

    Raises: JoinedFileError.
    """
    folders = [member for member in _members(path) if member.is_dir()] if is_joined(path) else []
    return (path, *folders, *bag_parts(path))


def recording_sha256(path: Path, is_given_up: Callable[[], bool] = lambda: False) -> str:
    """Return the sha256 of the file, or the combined hash of several files; meaningless once `is_given_up()` is true.

    For a joined recording, combine its description and members. Raises: JoinedFileError.
    """
    if is_joined(path):
        return _joined_sha256(path, _member_hashes(path, is_given_up))
    if path.is_dir() or len(bag_parts(path)) > 1:
        return whole_sha256((part.name, _file_sha256(part, is_given_up)) for part in bag_parts(path))
    return _file_sha256(path, is_given_up)


def recording_inputs(
    path: Path, known: str | None = None, is_given_up: Callable[[], bool] = lambda: False
) -> Mapping[str, str]:
    """Return a recording's hash by name, as in a sequence's `inputs`; for a joined recording, also its members' hashes.

    `known` is the hash of the whole if it need not be computed; the hashes of joined members then come from the
    description. Raises: JoinedFileError.
    """
    if not is_joined(path):
        return {path.name: known or recording_sha256(path, is_given_up)}
    believed = {member.name: member.sha256 for member in read_joined(path)} if known else {}
    members = _member_hashes(path, is_given_up, believed)
    return {**members, JOINED: known or _joined_sha256(path, members)}


@contextmanager
def hashed_meanwhile(path: Path, known: str | None = None) -> Iterator[Callable[[], Mapping[str, str]]]:
    """Run `recording_inputs` in a thread while the recording is read; the yielded function waits for its result.

    If the caller leaves without the result, because the recording is refused, hashing stops.
    """
    given_up = Event()
    with ThreadPoolExecutor(1) as beside:
        inputs = beside.submit(recording_inputs, path, known, given_up.is_set)
        try:
            yield inputs.result
        finally:
            given_up.set()


def _member_hashes(
    path: Path, is_given_up: Callable[[], bool], believed: Mapping[str, str] = MappingProxyType({})
) -> Mapping[str, str]:
    return {
        member.name: believed.get(member.name) or recording_sha256(member_path(path, member), is_given_up)
        for member in read_joined(path)
    }


def _joined_sha256(path: Path, members: Mapping[str, str]) -> str:
    return whole_sha256([*members.items(), (JOINED, sha256((path / JOINED).read_bytes()).hexdigest())])


def _members(path: Path) -> list[Path]:
    return [member_path(path, member) for member in read_joined(path)]


def _has_bytes(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _file_sha256(path: Path, is_given_up: Callable[[], bool]) -> str:
    with path.open("rb", buffering=0) as file:
        return stream_sha256(file, is_given_up)


def stream_sha256(file: FileIO, is_given_up: Callable[[], bool] = lambda: False) -> str:
    """Return the sha256 of the rest of an open file; meaningless once `is_given_up()` is true."""
    digest, block = sha256(), bytearray(HASH_BLOCK_BYTES)
    while not is_given_up() and (size := file.readinto(block)):
        digest.update(memoryview(block)[:size])
    return digest.hexdigest()


# Checks that several uploaded files are one bag: the `.mcap` or `.db3` files of a rosbag2 folder, or the parts of a
# split ROS 1 `.bag` (`.bag.active` if its recorder crashed). Each may be compressed with zstd. Database journals,
# metadata.yaml and message definitions (`my_msgs.Reading.msg`) may be included. Names are compared case-insensitively,
# so that any disk can store the folder.


METADATA = "metadata.yaml"
MOST_FILES = 512
BAG_FILE = re.compile(r".+\.(mcap|db3|bag)(\.active|\.zstd)?", re.IGNORECASE)
LEFT_BESIDE = ("-wal", "-journal")
JOURNAL = re.compile(r"(.+\.db3)-(wal|journal)", re.IGNORECASE)
DEFINITION = re.compile(r"[a-z][a-z0-9_]{0,99}\.[A-Z][A-Za-z0-9]{0,99}\.msg")


def bad_bag_files(why: str) -> Refused:
    files = "its .mcap, .db3 or .bag files, and the metadata.yaml of a rosbag2 folder"
    return Refused("bad_recording_files", f"{why}; send only the files of one recording: {files}")


def is_bag_part(name: str) -> bool:
    """Return whether a file with this name belongs to a bag."""
    return name == METADATA or any(form.fullmatch(name) for form in (BAG_FILE, JOURNAL, DEFINITION))


def check_bag_files(names: Sequence[str]) -> None:
    """Raise `bad_recording_files` unless files with these names are one bag of several files."""
    if not 2 <= len(names) <= MOST_FILES:
        raise bad_bag_files(f"{len(names)} files were sent; a bag of several files has 2 to {MOST_FILES}")
    for name in names:
        if not is_bag_part(name):
            raise bad_bag_files(f"{name[:100]!r} is not part of a bag")
    folded = {name.casefold() for name in names}
    if len(folded) < len(names):
        raise bad_bag_files(f"the {len(names)} files have only {len(folded)} different names")
    storages = {form[1].casefold() for name in names if (form := BAG_FILE.fullmatch(name))}
    if not storages:
        raise bad_bag_files("no .mcap, .db3 or .bag file was sent")
    if len(storages) > 1:
        raise bad_bag_files(f"the files have several formats: {', '.join(f'.{kind}' for kind in sorted(storages))}")
    for name in names:
        journal = JOURNAL.fullmatch(name)
        if journal and journal[1].casefold() not in folded:
            raise bad_bag_files(f"{name[:100]!r} was sent without {journal[1][:100]!r}")


def whole_sha256(files: Iterable[tuple[str, str]]) -> str:
    """Return the hash of several files (name, sha256): the hash of `sha256sum`'s lines, sorted by name."""
    return sha256("".join(f"{digest}  {name}\n" for name, digest in sorted(files)).encode()).hexdigest()
