"""Local recordings to upload: one file or the files of a bag, with their hashes.

**Conventions.** A bag of several files is named after its folder. Consecutively numbered files (`run_0.mcap
run_1.mcap`) are one bag, `run`, as in the browser; other files are separate recordings. Files beside a bag that are not
part of it are not sent. `sha256` of the whole equals the server's (`stone_files/bag_fingerprint.py`).
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
    """The paths of a recording: a file, a folder, or the parts of a split bag in one folder."""

    name: str
    paths: tuple[Path, ...]

    @property
    def called(self) -> str:
        """The default name of a sequence for this recording."""
        return self.name if len(self.paths) > 1 else called(self.paths[0])


@dataclass(frozen=True)
class LocalBag:
    """The files of a bag in name order, as they were when they were hashed."""

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
    """Return a report that turns the progress of one file into the progress of all files."""
    return lambda stage, done, _own_total: progress(stage, before + done, total)


def called(path: Path) -> str:
    """Return the default name of a sequence of this bag."""
    return path.resolve().name if path.is_dir() else path.stem


def bags_among(paths: Sequence[Path]) -> tuple[BagPaths, ...]:
    """Return the given recordings in order; parts of one split bag are one recording.

    Raises `bad_recording_files` if two recordings have the same name.
    """
    beside = {path.with_name(path.name + suffix) for path in paths for suffix in LEFT_BESIDE}
    described = {path.resolve().parent for path in paths if path.name == METADATA}
    grouped: dict[tuple[Path, str], list[Path]] = {}
    for path in dict.fromkeys(paths):
        if path not in beside:  # otherwise the bag of a file beside it contains it
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
    """Return the folder and the name of the bag that contains the file."""
    folder, match = path.resolve().parent, NUMBERED.fullmatch(path.name)
    if folder in described and not path.is_dir():
        return folder, folder.name
    return folder, path.resolve().name if match is None or path.is_dir() else match["stem"]


def hashed_bag(path: Path, progress: Report) -> LocalBag:
    """Return the bag at `path` with its hashes. Raises `bad_recording_files` (no bag in the folder), `file_changed`."""
    return hashed_parts(BagPaths(path.resolve().name, (path,)), progress)


def hashed_parts(bag: BagPaths, progress: Report) -> LocalBag:
    """Return the bag with its hashes. Raises as `hashed_bag`."""
    parts = sorted({part for path in bag.paths for part in bag_parts(path)}, key=lambda part: part.name)
    if not parts:
        raise bad_bag_files(f"{bag.paths[0]} contains no bag file")
    if len(parts) > 1:
        check_bag_files([part.name for part in parts])
    sizes = [part.stat().st_size for part in parts]
    files = tuple(hashed(part, part_of(progress, sum(sizes[:number]), sum(sizes))) for number, part in enumerate(parts))
    return LocalBag(bag.name if len(files) > 1 else files[0].path.name, files)
