"""The layout of a published dataset: its tables in a folder, tar or zip, and the names that are refused without
reading.

**Conventions.** A dataset is the given folder or a folder directly below it. Its tables are in `v1.0-*/`, or in
annotations.json; then its version is "". A name is a path relative to the dataset. The client applies the same rules
before it sends a byte; `stone_datasets` reads tables and files.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from reprlib import Repr

from stone_files.archives import MOST_FILES, tar_members
from stone_files.byte_ranges import LocalRanges
from stone_files.dataset_faults import QUOTED, DatasetFaultError, DatasetPlace
from stone_files.zip_directory import ZipFaultError, checked_end, directory_members

ANNOTATIONS = "annotations.json"
VERSION_FOLDER = re.compile(r"v1\.0-[a-z0-9_-]{1,40}")
HEAD = re.compile(rf"(?P<root>(?:.*/)?)(?:(?P<version>{VERSION_FOLDER.pattern})/[a-z_]+\.json|{ANNOTATIONS})")
COMPRESSED = {
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"\x28\xb5\x2f\xfd": "zstd",
}
ZIPPED = (b"PK\x03\x04", b"PK\x05\x06")
SLASHES_IN_ARCHIVE = (
    "python -c \"import zipfile as z; a = z.ZipFile('old.zip'); b = z.ZipFile('new.zip', 'w', 8); "
    "[b.writestr(n.replace(chr(92), '/'), a.read(n)) for n in a.namelist()]; b.close()\""
)
SHORT = Repr()
SHORT.maxlevel, SHORT.maxlist, SHORT.maxdict, SHORT.maxstring = 4, 8, 4, QUOTED


def root_in_folder(path: Path) -> tuple[Path, str]:
    """Return the dataset's folder and version. Raises `DST-001`, `DST-002`."""
    folders = [path, *(parent for parent in sorted(path.iterdir()) if parent.is_dir() and not parent.is_symlink())]
    roots = {f"{parent.relative_to(path).as_posix()}/{version}" for parent in folders for version in _versions(parent)}
    if not roots:
        roots = {f"{parent.relative_to(path).as_posix()}/" for parent in folders if (parent / ANNOTATIONS).is_file()}
    root, _, version = _only(path, roots).rpartition("/")
    return path / root, version


def root_in_archive(path: Path, heads: set[tuple[str, str]]) -> tuple[str, str]:
    """Return root (ends in a slash, or is empty) and version, from all `head_of` results for the archive's names.

    Raises `DST-001`, `DST-002`.
    """
    roots = {f"{root}{version}" for root, version in heads if version} or {root for root, _ in heads}
    root, slash, version = _only(path, roots).rpartition("/")
    return root + slash, version


def head_of(name: str) -> tuple[str, str] | None:
    """Return root and version from the name of a table or of annotations.json; None for other names."""
    head = HEAD.fullmatch(name)
    return None if head is None else (head["root"], head["version"] or "")


def refuse_compressed(path: Path) -> None:
    """Raise `DST-003` if the file is compressed."""
    with path.open("rb") as file:
        begin = file.read(max(map(len, COMPRESSED)))
    for magic, tool in COMPRESSED.items():
        if begin.startswith(magic):
            raise DatasetFaultError("DST-003", DatasetPlace(path.name), f"the file is compressed with {tool}")


def is_zip(path: Path) -> bool:
    """Return whether the path is a file that starts like a zip."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) in ZIPPED


def zip_fault(path: Path, fault: ZipFaultError) -> DatasetFaultError:
    """Return the refusal of a dataset with this zip fault."""
    arguments = (DatasetPlace(path.name), str(fault))
    if fault.code == "overlapping_files":
        return DatasetFaultError("DST-007", *arguments)
    if fault.code == "encrypted":
        return DatasetFaultError("DST-008", *arguments)
    return DatasetFaultError("DST-004" if fault.code == "symlink" else "DST-006", *arguments)


def refuse_archive(path: Path) -> None:
    """Raise a `DatasetFaultError` or `bad_tar` if a tar or zip contains no dataset, reading headers only."""
    refuse_compressed(path)
    heads = set[tuple[str, str]]()
    try:
        for name in _zip_names(path) if is_zip(path) else (name for name, _place in tar_members(path)):
            refuse_outside(name)
            heads |= {head} if (head := head_of(name)) else set()
    except ZipFaultError as fault:
        raise zip_fault(path, fault) from fault
    root_in_archive(path, heads)


def _zip_names(path: Path) -> Iterator[str]:
    ranges = LocalRanges(path)
    end = checked_end(ranges.read_at, ranges.size_bytes, MOST_FILES)
    return (member.name for member in directory_members(ranges.read_at, end))


def refuse_outside(name: str) -> None:
    """Raise `DST-004` for a path that leads outside the dataset."""
    if not is_inside(name):
        raise leaving(name)


def is_inside(name: str) -> bool:
    """Return whether a relative path stays below its folder."""
    return not name.startswith("/") and "\\" not in name and "\0" not in name and ".." not in name.split("/")


def slashes_in_table(file: str, key: str) -> str:
    """Return the command that replaces backslashes by / in a table's paths under `key`."""
    return (
        f"python -c \"import json, pathlib; p = pathlib.Path('{file}'); r = json.loads(p.read_text('utf-8')); "
        f"[x.update({key}=x['{key}'].replace(chr(92), '/')) for x in r]; p.write_text(json.dumps(r))\""
    )


def is_below(path: str, root: str) -> bool:
    """Return whether a path without links is the folder `root` or below it."""
    return path == root or path.startswith(root.rstrip("/") + "/")


def leaving(name: str) -> DatasetFaultError:
    """Return the refusal of this name."""
    return path_fault("", name, DatasetPlace(name))


def path_fault(key: str, name: str, place: DatasetPlace, table: str = "") -> DatasetFaultError:
    """Return the refusal of the path `name`, from a row's `key`, that leads outside its folder.

    Without a table, `place` names the file; without a key, `name` is a file name in an archive.
    """
    what = f"{key} {quoted(name)}".lstrip()
    if "\\" not in name:
        is_absolute = key and name.startswith("/")
        likely = "the path is absolute; paths must start with samples/ or sweeps/" if is_absolute else ""
        return DatasetFaultError("DST-004", place, f"{what} leads outside the dataset", likely)
    if key and table:
        mended = f"run in the dataset's folder: {slashes_in_table(place.file, key)}"
    else:
        mended = (
            f"replace each backslash by /, for example with {SLASHES_IN_ARCHIVE}"
            if not key
            else "replace each backslash by /"
        )
    return DatasetFaultError("DST-004", place, f"{what} has backslashes", f"paths use / on every system; {mended}")


def quoted(value: object) -> str:
    """Return an external value in short form for a message, with limited nesting."""
    text = SHORT.repr(value)
    return text if len(text) <= QUOTED else f"{text[:QUOTED]}…"


def _versions(folder: Path) -> Iterator[str]:
    names = (child.name for child in folder.iterdir() if child.is_dir())
    return (name for name in names if VERSION_FOLDER.fullmatch(name))


def _only(path: Path, roots: set[str]) -> str:
    if not roots:
        raise DatasetFaultError("DST-001", DatasetPlace(path.name), f"expected a folder v1.0-… or {ANNOTATIONS}")
    if len(roots) > 1:
        raise DatasetFaultError("DST-002", DatasetPlace(path.name), f"there are {', '.join(sorted(roots)[:4])}")
    return next(iter(roots))
