"""A dataset in a zip, read in place by ranges: an index with 56 bytes per file, and files by name.

**Conventions.** As in `stone_datasets/files.py`, files are found by Python's hash of their names. The whole directory
is read once, in pieces; nothing is unpacked. Zips in which two readers could see different files, and zips whose
members would inflate to implausibly many bytes, are refused.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone_datasets.columns import NumberColumn, places_of
from stone_exports.files import ExportFileSpan
from stone_exports.zipped_files import ZippedFileSpan
from stone_files.archives import NAME
from stone_files.byte_ranges import ByteRanges, LocalRanges
from stone_files.dataset_faults import DatasetFaultError, DatasetPlace
from stone_files.dataset_layout import head_of, quoted, refuse_outside, root_in_archive, zip_fault
from stone_files.zip_directory import ZipFaultError, ZipMember, checked_end, directory_members, limits_of

MOST_FILES = 1 << 22
# Label grids inflate 50 times, images and sweeps hardly: the limit for a whole dataset, and the size that is always
# allowed.
MOST_GROWTH, ALWAYS_BYTES = 20, 2**30
Places = NDArray[np.int64]
PLACE = ("offset", "size", "packed", "limit", "crc32", "method")
NOT_ZIPPED = -1  # packed size, limit, crc32 and method of an uncompressed file in an archive


@dataclass(frozen=True, eq=False)
class DatasetZip:
    """A dataset in a zip, below `root` (ends in a slash, or is empty); `places` are (N, 6), columns as in `PLACE`."""

    ranges: ByteRanges
    version: str
    root: str
    keys: NDArray[np.int64] = field(repr=False)
    places: Places = field(repr=False)
    folders: frozenset[str] = field(repr=False)

    @property
    def path(self) -> Path:
        return self.ranges.path

    def span(self, name: str) -> ExportFileSpan | None:
        refuse_outside(name)
        at = int(places_of(self.keys, np.array([hash(self.root + name)]))[0])
        return None if at < 0 else placed_span(self.ranges, (name, self.root + name), self.places[at])

    def spans(self, names: Iterable[str]) -> Places:
        """Return the places (N, 6) of these files, whose names stay inside the dataset; rows of −1 for missing
        files.
        """
        keys = NumberColumn("q")
        keys.extend(hash(self.root + name) for name in names)
        at = places_of(self.keys, keys.array(np.int64))
        places = np.full((len(at), len(PLACE)), -1, np.int64)
        places[at >= 0] = self.places[at[at >= 0]]
        return places

    def has_folder(self, name: str) -> bool:
        return self.root + name in self.folders


def placed_span(ranges: ByteRanges, names: tuple[str, str], entry: Iterable[int]) -> ExportFileSpan:
    """Return the file at a place of a tar or zip; `names` are its names in the dataset and in the archive."""
    offset, size, packed, limit, crc32, method = (int(number) for number in entry)
    if method == NOT_ZIPPED:
        return ExportFileSpan(ranges.path, names[0], offset, size)
    member = ZipMember(names[1], method, crc32, packed, size, offset, limit)
    return ZippedFileSpan(ranges.path, names[0], offset, size, member, ranges)


def open_zip(where: Path | ByteRanges) -> DatasetZip:
    """Return the dataset in a zip. Raises `DST-001`, `DST-002`, `DST-004` and `DST-006` to `DST-009`."""
    ranges = LocalRanges(where) if isinstance(where, Path) else where
    try:
        return _opened(ranges)
    except ZipFaultError as fault:
        raise zip_fault(ranges.path, fault) from fault


def _opened(ranges: ByteRanges) -> DatasetZip:
    end = checked_end(ranges.read_at, ranges.size_bytes, MOST_FILES)
    keys, places = np.empty(end.entries, np.int64), np.empty((end.entries, len(PLACE)), np.uint64)
    is_file = np.zeros(end.entries, np.bool_)
    heads, folders = set[tuple[str, str]](), set[str]()
    for number, member in enumerate(directory_members(ranges.read_at, end)):
        name = member.name
        refuse_outside(name)
        keys[number] = hash(name)
        facts = (member.offset, member.unpacked_bytes, member.packed_bytes, 0, member.crc32, member.method)
        places[number] = facts
        is_file[number] = NAME.fullmatch(name) is not None
        if (head := head_of(name)) is not None:
            heads.add(head)
        note_labels(folders, name)
    places[:, 3] = limits_of(places[:, 0], places[:, 2], end.directory_offset)
    _refuse_bombs(ranges, places[:, 1])
    root, version = root_in_archive(ranges.path, heads)
    order = np.argsort(keys, kind="stable")
    order = order[is_file[order]]
    held, sorted_places = keys[order], places[order].astype(np.int64)
    if len(again := np.flatnonzero(np.diff(held) == 0)):
        name = next(islice(directory_members(ranges.read_at, end), int(order[again[0]]), None)).name
        raise DatasetFaultError("DST-006", DatasetPlace(ranges.path.name), f"two files have the name {quoted(name)}")
    return DatasetZip(ranges, version, root, held, sorted_places, frozenset(folders))


def _refuse_bombs(ranges: ByteRanges, sizes_bytes: NDArray[np.uint64]) -> None:
    total, most = float(sizes_bytes.astype(np.float64).sum()), MOST_GROWTH * ranges.size_bytes + ALWAYS_BYTES
    if total > most:
        what = (
            f"its files would have {total / 1000000000.0:.1f} GB; the limit for a zip of its size is "
            f"{most / 1000000000.0:.1f} GB"
        )
        raise DatasetFaultError("DST-009", DatasetPlace(ranges.path.name), what)


def note_labels(folders: set[str], name: str) -> None:
    """Add a scene's label folder: only the folder two levels above labels.npz is needed."""
    if name.endswith("/labels.npz"):
        folders.add(name.rsplit("/", 2)[0])
