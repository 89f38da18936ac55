"""The files of a dataset, in a folder or in place in a tar or zip: found by name, as byte ranges.

**Conventions.** A name is a relative path of plain parts below the dataset's root. Paths that lead outside are refused;
in an archive, unused ones too. A tar uses 24 bytes of memory per file, a zip 56. Names are found by Python's hash,
which has 64 bits and differs in every process.
"""

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone_datasets.columns import NumberColumn, places_of
from stone_datasets.zip_files import NOT_ZIPPED, PLACE, DatasetZip, Places, note_labels, open_zip
from stone_exports.files import ExportFileSpan
from stone_files.archives import NAME, tar_members
from stone_files.byte_ranges import ByteRanges
from stone_files.dataset_layout import (
    head_of,
    is_below,
    is_inside,
    is_zip,
    leaving,
    refuse_compressed,
    refuse_outside,
    root_in_archive,
    root_in_folder,
)


class DatasetFiles(Protocol):
    """The files of one dataset. `version` is the folder of its tables, "" for a dataset with annotations.json only."""

    @property
    def path(self) -> Path: ...

    @property
    def version(self) -> str: ...

    def span(self, name: str) -> ExportFileSpan | None:
        """Return the file called `name`, or None if the dataset has no such file. Raises `DST-004`."""
        ...

    def has_folder(self, name: str) -> bool: ...


@dataclass(frozen=True)
class DatasetFolder:
    """A dataset in a folder."""

    path: Path
    version: str
    _known: dict[str, str] = field(default_factory=dict, repr=False, compare=False)

    def span(self, name: str) -> ExportFileSpan | None:
        refuse_outside(name)
        folder, _, base = name.rpartition("/")
        try:
            path = f"{self._real(folder)}/{base}"
            status = os.lstat(path)
            if stat.S_ISLNK(status.st_mode):
                path = os.path.realpath(path)
                if not is_below(path, self._real("")):
                    raise leaving(name)
                status = os.lstat(path)
        except (OSError, ValueError):
            return None
        return ExportFileSpan(Path(path), name, 0, status.st_size) if stat.S_ISREG(status.st_mode) else None

    def has_folder(self, name: str) -> bool:
        return is_inside(name) and os.path.isdir(self._real(name))

    def _real(self, folder: str) -> str:
        """Return the real path of this folder, cached. Raises `DST-004` if it leads outside."""
        if folder not in self._known:
            real = os.path.realpath(self.path / folder)
            if not is_below(real, os.path.realpath(self.path)):
                raise leaving(folder)
            self._known[folder] = real
        return self._known[folder]


@dataclass(frozen=True, eq=False)
class DatasetTar:
    """A dataset in a tar, below `root` (ends in a slash, or is empty)."""

    path: Path
    version: str
    root: str
    keys: NDArray[np.int64] = field(repr=False)
    places: NDArray[np.int64] = field(repr=False)
    folders: frozenset[str] = field(repr=False)

    def span(self, name: str) -> ExportFileSpan | None:
        refuse_outside(name)
        at = int(places_of(self.keys, np.array([hash(self.root + name)]))[0])
        return None if at < 0 else ExportFileSpan(self.path, name, *self.places[at].tolist())

    def spans(self, names: Iterable[str]) -> Places:
        """Return the places (N, 6) of these files, as `DatasetZip.spans` does: only offset and size are set, the rest
        is −1.
        """
        keys = NumberColumn("q")
        keys.extend(hash(self.root + name) for name in names)
        at = places_of(self.keys, keys.array(np.int64))
        places = np.full((len(at), len(PLACE)), NOT_ZIPPED, np.int64)
        places[at >= 0, :2] = self.places[at[at >= 0]]
        return places

    def has_folder(self, name: str) -> bool:
        return self.root + name in self.folders


DatasetArchive = DatasetTar | DatasetZip


def open_dataset(where: Path | ByteRanges) -> DatasetFiles:
    """Return the dataset in a folder, tar or zip, or in a folder directly below, or in a zip that is read by ranges.

    Raises a `DatasetFaultError`, `bad_tar`.
    """
    if not isinstance(where, Path) or is_zip(where):
        return open_zip(where)
    return _in_tar(where) if where.is_file() else DatasetFolder(*root_in_folder(where))


def _in_tar(path: Path) -> DatasetFiles:
    refuse_compressed(path)
    keys, places = NumberColumn("q"), NumberColumn("q")
    heads, folders = set[tuple[str, str]](), set[str]()
    for name, span in tar_members(path):
        refuse_outside(name)
        if not NAME.fullmatch(name):
            continue
        keys.add(hash(name))
        places.add(*span)
        head = head_of(name)
        if head is not None:
            heads.add(head)
        note_labels(folders, name)
    root, version = root_in_archive(path, heads)
    order = np.argsort(keys.array(np.int64), kind="stable")
    held = (keys.array(np.int64)[order], places.array(np.int64).reshape(-1, 2)[order])
    return DatasetTar(path, version, root, *held, frozenset(folders))
