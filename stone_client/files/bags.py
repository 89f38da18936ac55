"""Local recordings to upload: one file or the files of a bag, with their hashes.

**Conventions.** A bag of several files is called after its folder. What lies beside it and is no part of it is not
sent. `sha256` of the whole is the one that the server says (`stone_files/bag_files.py`).
"""

from dataclasses import dataclass
from pathlib import Path

from stone_client.files.tus import LocalFile, hashed
from stone_client.progress import Report
from stone_files.bag_files import BadBagFilesError, check_bag_files, whole_sha256
from stone_files.bag_fingerprint import bag_parts


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


def hashed_bag(path: Path, progress: Report) -> LocalBag:
    """The bag at `path` with its hashes. Raises `BadBagFilesError` (no bag in the folder), `FileChangedError`."""
    parts = bag_parts(path)
    if not parts:
        raise BadBagFilesError(f"{path} holds no file of a bag")
    if len(parts) > 1:
        check_bag_files([part.name for part in parts])
    sizes = [part.stat().st_size for part in parts]
    files = tuple(hashed(part, part_of(progress, sum(sizes[:number]), sum(sizes))) for number, part in enumerate(parts))
    return LocalBag(path.resolve().name if len(files) > 1 else files[0].path.name, files)
