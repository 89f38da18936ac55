"""Local recordings to upload: one file or the files of a bag, with their hashes.

**Conventions.** A bag of several files is called after its folder; of files that were named one by one, those whose
names count on (`run_0.mcap run_1.mcap`) are one bag, `run`, as the browser has it, and any others are recordings of
their own. What lies beside a bag and is no part of it is not sent. `sha256` of the whole is the one that the server
says (`stone_files/bag_fingerprint.py`).
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from stone_client.files.tus import LocalFile, hashed
from stone_client.progress import Report
from stone_files.bag_fingerprint import LEFT_BESIDE, METADATA, bad_bag_files, bag_parts, check_bag_files, whole_sha256

NUMBERED = re.compile(r"(?P<stem>.+)_\d+\.(?P<kind>mcap|db3|bag)(\.active|\.zstd)?", re.IGNORECASE)


@dataclass(frozen=True)
class BagPaths:
    """Where a recording lies: a file, a folder, or the parts of a split one in one folder."""

    name: str
    paths: tuple[Path, ...]

    @property
    def called(self) -> str:
        """The default name of a sequence that begins with it."""
        return self.name if len(self.paths) > 1 else called(self.paths[0])


@dataclass(frozen=True)
class LocalBag:
    """The files as they were when their hashes were taken, in the order of their names."""

    name: str
    files: tuple[LocalFile, ...]

    @property
    def size_bytes(self) -> int:
        return sum(file.size_bytes for file in self.files)

    @property
    def sha256(self) -> str:
        if len(self.files) == 1:
            return self.files[0].sha256
        return whole_sha256((file.path.name, file.sha256) for file in self.files)


def part_of(progress: Report, before: int, total: int) -> Report:
    """The report of one file of several, told as progress of them all."""
    return lambda stage, done, _own_total: progress(stage, before + done, total)


def called(path: Path) -> str:
    """The default name of a sequence of this bag."""
    return path.resolve().name if path.is_dir() else path.stem


def bags_among(paths: Sequence[Path]) -> tuple[BagPaths, ...]:
    """The recordings that were named, in that order; parts of one split bag are one.

    Raises `bad_recording_files` where two of them have one name, by which nobody could tell them apart.
    """
    beside = {path.with_name(path.name + suffix) for path in paths for suffix in LEFT_BESIDE}
    described = {path.resolve().parent for path in paths if path.name == METADATA}
    grouped: dict[tuple[Path, str], list[Path]] = {}
    for path in dict.fromkeys(paths):
        if path not in beside:  # else it is sent with the file that it was left beside
            grouped.setdefault(_bag_of(path, described), []).append(path)
    bags = tuple(
        BagPaths(name if len(parts) > 1 else parts[0].resolve().name, tuple(parts))
        for (_, name), parts in grouped.items()
    )
    names = [bag.name.casefold() for bag in bags]
    for bag in bags:
        if names.count(bag.name.casefold()) > 1:
            problem = "recordings need different names: rename one of them"
            raise bad_bag_files(f"two of the recordings are called {bag.name}; {problem}")
    return bags


def _bag_of(path: Path, described: Collection[Path]) -> tuple[Path, str]:
    """The folder and the name of the bag that the file is a part of."""
    folder, found = path.resolve().parent, NUMBERED.fullmatch(path.name)
    if folder in described and not path.is_dir():
        return folder, folder.name
    return folder, path.resolve().name if found is None or path.is_dir() else found["stem"]


def hashed_bag(path: Path, progress: Report) -> LocalBag:
    """The bag at `path` with its hashes. Raises `bad_recording_files` (no bag in the folder), `file_changed`."""
    return hashed_parts(BagPaths(path.resolve().name, (path,)), progress)


def hashed_parts(bag: BagPaths, progress: Report) -> LocalBag:
    """The bag with its hashes. Raises as `hashed_bag`."""
    parts = sorted({part for path in bag.paths for part in bag_parts(path)}, key=lambda part: part.name)
    if not parts:
        raise bad_bag_files(f"{bag.paths[0]} contains no bag file")
    if len(parts) > 1:
        check_bag_files([part.name for part in parts])
    sizes = [part.stat().st_size for part in parts]
    files = tuple(hashed(part, part_of(progress, sum(sizes[:number]), sum(sizes))) for number, part in enumerate(parts))
    return LocalBag(bag.name if len(files) > 1 else files[0].path.name, files)
