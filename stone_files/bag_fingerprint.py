"""The fingerprint of a sequence's inputs: a hash that anybody can recompute (sha256sum).

**Conventions.** Of a joined recording every member is an input under its own name; under `joined.json`, which holds the
offsets of their clocks, stands the hash of the whole, description and members.
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
    """The files that are the bag, by name: of a rosbag2 folder, or a file and what its recorder left beside it.

    Of a joined recording its description and the files of every member. Raises: JoinedFileError.
    """
    if is_joined(path):
        return [path / JOINED, *(part for member in _members(path) for part in bag_parts(member))]
    if not path.is_dir():
        return [path, *(beside for suffix in LEFT_BESIDE if _has_bytes(beside := path.with_name(path.name + suffix)))]
    parts = sorted(file for file in path.iterdir() if file.is_file() and is_bag_part(file.name))
    return [part for part in parts if _has_bytes(part) or not part.name.endswith(LEFT_BESIDE)]


def bag_paths(path: Path) -> tuple[Path, ...]:
    """The bag and its files: a folder may be of links, and whoever may read it may not for that read what they name.

    Raises: JoinedFileError.
    """
    folders = [member for member in _members(path) if member.is_dir()] if is_joined(path) else []
    return (path, *folders, *bag_parts(path))


def recording_sha256(path: Path, is_given_up: Callable[[], bool] = lambda: False) -> str:
    """sha256 of the file; of several, of their names and hashes in order of name; nothing of use once given up.

    Of a joined recording so of its description and its members. Raises: JoinedFileError.
    """
    if is_joined(path):
        return _joined_sha256(path, _member_hashes(path, is_given_up))
    if path.is_dir() or len(bag_parts(path)) > 1:
        return whole_sha256((part.name, _file_sha256(part, is_given_up)) for part in bag_parts(path))
    return _file_sha256(path, is_given_up)


def recording_inputs(
    path: Path, known: str | None = None, is_given_up: Callable[[], bool] = lambda: False
) -> Mapping[str, str]:
    """What a sequence's `inputs` say of a recording: its hash, by name; of a joined one those of its members besides.

    `known` is the hash of the whole where it need not be read for it; of a joined one's members those are believed that
    its description has. Raises: JoinedFileError.
    """
    if not is_joined(path):
        return {path.name: known or recording_sha256(path, is_given_up)}
    believed = {member.name: member.sha256 for member in read_joined(path)} if known else {}
    members = _member_hashes(path, is_given_up, believed)
    return {**members, JOINED: known or _joined_sha256(path, members)}


@contextmanager
def hashed_meanwhile(path: Path, known: str | None = None) -> Iterator[Callable[[], Mapping[str, str]]]:
    """`recording_inputs` by another thread while the recording is read, unless its hash is known; asking waits.

    Whoever leaves without having asked, because the recording is refused, does not wait for the rest.
    """
    given_up = Event()
    with ThreadPoolExecutor(1) as beside:
        found = beside.submit(recording_inputs, path, known, given_up.is_set)
        try:
            yield found.result
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
    """sha256 of what is left of an open file; nothing of use once given up."""
    digest, block = sha256(), bytearray(HASH_BLOCK_BYTES)
    while not is_given_up() and (size := file.readinto(block)):
        digest.update(memoryview(block)[:size])
    return digest.hexdigest()


# Checks that several uploaded files are one bag, and hashes them as a whole.
#
# **Conventions.** The files of a rosbag2 folder: one or more of `.mcap` or of `.db3`, or the parts of a split ROS 1
# `.bag` (`.bag.active` where its recorder died), each perhaps compressed as a file by zstd, a database perhaps beside
# the journal of what was not finished; perhaps `metadata.yaml`; and definitions of messages where the recorder
# embedded none (`my_msgs.Reading.msg`). Names are compared as on a disk that does not tell cases apart, so that a
# folder can be written anywhere.


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
    """Whether a file so called belongs to a bag."""
    return name == METADATA or any(form.fullmatch(name) for form in (BAG_FILE, JOURNAL, DEFINITION))


def check_bag_files(names: Sequence[str]) -> None:
    """Raises `bad_recording_files` where files so called are not one bag of several files."""
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
    """The hash of (name, sha256) of several files: that of the lines `sha256sum` prints for them in order of name."""
    return sha256("".join(f"{digest}  {name}\n" for name, digest in sorted(files)).encode()).hexdigest()
