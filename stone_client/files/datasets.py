"""Local datasets to upload: a tar or zip as it is, a folder as a tar stream without a temporary copy.

**Conventions.** Equal folders give equal tars, so that a restarted client continues the same upload. Files without a
plain name (`stone_files/archives.py`: hidden files, blanks) cannot be in a dataset and are skipped. Layout faults are
refused before the upload, with the server's codes.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone_client.errors import file_changed
from stone_client.files.tus import PIECE_BYTES, LocalContent, hashed, refuse_change
from stone_client.progress import Report
from stone_files.archives import (
    MOST_NAME,
    NAME,
    Archive,
    ArchiveMemberRange,
    ArchiveMembers,
    Segment,
    layout,
)
from stone_files.dataset_layout import is_below, leaving, refuse_archive, root_in_folder

ENDING = ".tar"


@dataclass(frozen=True, eq=False)
class DatasetFolderTar:
    """A folder as a tar: N files in the order of their names, as they were when they were listed.

    `modified_ns` (N,) detects changed files.
    """

    root: Path
    name: str
    members: ArchiveMembers = field(repr=False)
    modified_ns: NDArray[np.int64] = field(repr=False)
    archive: Archive = field(repr=False)
    sha256: str = ""

    @property
    def size_bytes(self) -> int:
        return self.archive.size_bytes

    def read(self, offset: int, most_bytes: int) -> bytes:
        return b"".join(map(self._content, self.archive.segments(offset, offset + most_bytes)))

    def _content(self, segment: Segment) -> bytes:
        if not isinstance(segment, ArchiveMemberRange):
            return segment
        path, ordinal = self.root / self.members.names[segment.ordinal], segment.ordinal
        try:
            with path.open("rb") as file:
                refuse_change(path, file, (int(self.members.sizes_bytes[ordinal]), int(self.modified_ns[ordinal])))
                file.seek(segment.start)
                return file.read(len(segment))
        except FileNotFoundError:
            raise file_changed(path) from None


def dataset_name(path: Path) -> str:
    """Return the default name of the dataset at this path."""
    return path.resolve().name.removesuffix(ENDING).removesuffix(".zip")


def hashed_dataset(path: Path, progress: Report) -> LocalContent:
    """Return the dataset in a folder, tar or zip with its hash.

    Raises a `DatasetFaultError`, `bad_tar`, `file_changed`.
    """
    if path.is_dir():
        return _hashed_folder(path, progress)
    refuse_archive(path)
    return hashed(path, progress)


def _hashed_folder(path: Path, progress: Report) -> DatasetFolderTar:
    root, _version = root_in_folder(path)
    listed = sorted(_files(root))
    sizes = np.array([size for _, size, _ in listed], np.int64)
    members = ArchiveMembers([name for name, _, _ in listed], sizes, np.zeros(len(sizes), np.uint32))
    modified_ns = np.array([time_ns for _, _, time_ns in listed], np.int64)
    name = f"{path.resolve().name or 'dataset'}{ENDING}"
    tar = DatasetFolderTar(root, name, members, modified_ns, layout(members, "tar"))
    return DatasetFolderTar(root, name, members, modified_ns, tar.archive, _sum_of(tar.read, tar.size_bytes, progress))


def _sum_of(read: Callable[[int, int], bytes], size_bytes: int, progress: Report) -> str:
    whole = sha256()
    progress("hash", 0, size_bytes)
    for offset in range(0, size_bytes, PIECE_BYTES):
        whole.update(read(offset, PIECE_BYTES))
        progress("hash", min(offset + PIECE_BYTES, size_bytes), size_bytes)
    return whole.hexdigest()


def _files(root: Path) -> Iterator[tuple[str, int, int]]:
    """Yield name, size and modification time of every file with a plain name. Raises `DST-004`."""
    real_root = os.path.realpath(root)
    waiting: list[tuple[str, tuple[str, ...]]] = [("", (real_root,))]
    while waiting:
        folder, above = waiting.pop()
        with os.scandir(root / folder) as entries:
            plain = [
                item for item in entries if len(folder + item.name) <= MOST_NAME and NAME.fullmatch(folder + item.name)
            ]
        for entry in plain:
            name, real = f"{folder}{entry.name}", os.path.realpath(entry.path) if entry.is_symlink() else ""
            if real and not is_below(real, real_root):
                raise leaving(name)
            if entry.is_file():
                status = entry.stat()
                yield name, status.st_size, status.st_mtime_ns
            elif entry.is_dir() and real not in above:
                waiting.append((f"{name}/", (*above, real) if real else above))
