"""Files in a dataset's archive that neither tables nor schema name: kept unchanged, never opened.

**Conventions.** A file is extra if its offset differs from the offsets of all known files. Only files below the
dataset's root with plain names count.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from stone_datasets.files import DatasetArchive, DatasetTar
from stone_datasets.scene_tables import SPLITS, TABLES
from stone_datasets.zip_files import MOST_FILES as MOST_ENTRIES
from stone_exports.files import ExportFileSpan
from stone_files.archives import NAME, tar_members
from stone_files.dataset_layout import ANNOTATIONS
from stone_files.zip_directory import checked_end, directory_members

MOST_FILE_BYTES, MOST_BYTES = 64 * 2**20, 2**30  # limit per kept file, and for all of them
MOST_FILES, LONGEST_NAME, MOST_SHOWN = 1000, 120, 100


@dataclass(frozen=True)
class ExtraFiles:
    """The files small enough to be kept, and the first names and sizes of larger ones."""

    kept: tuple[ExportFileSpan, ...]
    left_out: tuple[tuple[str, int], ...]
    left_out_total: int


def extra_files(archive: DatasetArchive, known: Collection[int]) -> ExtraFiles:
    """Return the extra files of an archive; `known` are the offsets of its scenes' files. Raises `bad_tar`."""
    kept, left_out, total, size_bytes, seen = list[ExportFileSpan](), list[tuple[str, int]](), 0, 0, set[str]()
    for name, offset, size in _members(archive):
        if offset in known or name in seen or not NAME.fullmatch(name) or _is_known(archive.version, name):
            continue
        seen.add(name)
        is_small = size <= MOST_FILE_BYTES and size_bytes + size <= MOST_BYTES and len(name) <= LONGEST_NAME
        span = archive.span(name) if is_small and len(kept) < MOST_FILES else None
        if span is not None:
            kept.append(span)
            size_bytes += size
            continue
        total += 1
        left_out += [(name[:LONGEST_NAME], size)] if total <= MOST_SHOWN else []
        seen.discard(name)
    return ExtraFiles(tuple(kept), tuple(left_out), total)


def _members(archive: DatasetArchive) -> Iterator[tuple[str, int, int]]:
    """Yield name below the root, offset and size of every file."""
    root = archive.root
    if isinstance(archive, DatasetTar):
        members = ((name, *span) for name, span in tar_members(archive.path))
    else:
        end = checked_end(archive.ranges.read_at, archive.ranges.size_bytes, MOST_ENTRIES)
        entries = directory_members(archive.ranges.read_at, end)
        members = ((member.name, member.offset, member.unpacked_bytes) for member in entries)
    return ((name.removeprefix(root), offset, size) for name, offset, size in members if name.startswith(root))


def _is_known(version: str, name: str) -> bool:
    """Return whether an import reads the file itself: a table, splits, or annotations in a layout without tables."""
    if not version:
        return name in (ANNOTATIONS, SPLITS)
    folder, _, base = name.rpartition("/")
    is_table = base == SPLITS or base.removesuffix(".json") in TABLES
    return name == SPLITS or (folder == version and base.endswith(".json") and is_table)
