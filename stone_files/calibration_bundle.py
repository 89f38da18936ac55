"""The documents of a calibration: one file, a folder of files, or a zip; read completely, with limits, never unpacked.

**Conventions.** Documents are sorted by name. Files other than YAML and JSON are ignored and listed (Kalibr writes
reports and text results next to its YAML). Text files are read if they start like KITTI's or RELLIS-3D's. Nothing is
written to disk, so a name in a zip cannot point outside; such names are refused nevertheless. A zip must be stored or
deflated: other methods may allocate gigabytes before the first byte.
"""

import re
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import IO
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from stone_base.errors import Refused

SIZE_LIMIT_BYTES = 1_000_000
BUNDLE_LIMIT_BYTES = 4_000_000
MOST_FILES = 64
MOST_ENTRIES = 1000
SUFFIXES = (".yaml", ".yml", ".json", ".urdf", ".xacro")
TEXT_SUFFIX = ".txt"
# First bytes of text calibrations: KITTI's start with a date or a projection; RELLIS-3D's are just four numbers.
TEXT_HEAD = re.compile(rb"\s*(?:calib_time: |P\d: |(?:\d[\d.eE+-]*\s+){3}\d[\d.eE+-]*\s*\Z)")
TEXT_HEAD_BYTES = 200
NO_DOCUMENT = "it contains no .yaml, .yml, .json or .urdf file, and no .txt in KITTI's or RELLIS-3D's format"
ZIP_MAGIC = b"PK\x03\x04"
ENCRYPTED = 0x1


@dataclass(frozen=True)
class Bundle:
    """`documents`: (name, bytes) of possible calibrations; `aside`: names of ignored files."""

    documents: tuple[tuple[str, bytes], ...]
    aside: tuple[str, ...] = ()


def read_bundle(path: Path) -> Bundle:
    """Return the bundle at a path. Raises OSError, `CAL-420`, `CAL-428` (no document, too many, not a valid zip)."""
    if path.is_dir():
        return _folder(path)
    with path.open("rb") as file:
        content = file.read(SIZE_LIMIT_BYTES + 1)
    if len(content) > SIZE_LIMIT_BYTES:
        raise calibration_size(path.name, SIZE_LIMIT_BYTES)
    return _zip(path.name, content) if content.startswith(ZIP_MAGIC) else Bundle(((path.name, content),))


def _folder(path: Path) -> Bundle:
    entries = list(islice(path.rglob("*"), MOST_ENTRIES + 1))
    if len(entries) > MOST_ENTRIES:
        raise calibration_bundle(path.name, f"it contains more than {MOST_ENTRIES} entries")
    files = sorted(file for file in entries if file.is_file() and not file.is_symlink())
    names = [file.relative_to(path).as_posix() for file in files]
    wanted = _wanted(path.name, names)
    contents = ((name, _content(file)) for name, file in zip(names, files, strict=True) if name in wanted)
    return _bundle(path.name, names, contents)


def _bundle(name: str, names: list[str], contents: Iterable[tuple[str, bytes | None]]) -> Bundle:
    """Return the bundle of these files. Raises `CAL-428` if they are too large in total, or none is a document."""
    documents, total_bytes = list[tuple[str, bytes]](), 0
    for file, content in contents:
        if content is not None:
            documents.append((file, content))
            total_bytes += len(content)
        _check_total(name, total_bytes)
    if not documents:
        raise calibration_bundle(name, NO_DOCUMENT)
    read = {file for file, _ in documents}
    return Bundle(tuple(documents), tuple(file for file in names if file not in read))


def _content(file: Path) -> bytes | None:
    with file.open("rb") as stream:
        return _read(file.name, stream)


def _read(name: str, stream: IO[bytes]) -> bytes | None:
    """Return the file's bytes, or None for a text that is not a calibration. Raises `CAL-420`."""
    head = stream.read(TEXT_HEAD_BYTES)
    if name.lower().endswith(TEXT_SUFFIX) and not TEXT_HEAD.match(head):
        return None
    content = head + stream.read(SIZE_LIMIT_BYTES + 1 - len(head))
    if len(content) > SIZE_LIMIT_BYTES:
        raise calibration_size(name[:80], SIZE_LIMIT_BYTES)
    return content


def _zip(name: str, content: bytes) -> Bundle:
    try:
        with ZipFile(BytesIO(content)) as archive:
            members = [member for member in archive.infolist() if not member.is_dir()]
            for member in members:
                _check_member(name, member)
            names = [member.filename for member in members]
            wanted = _wanted(name, names)
            return _bundle(name, names, _unpacked(archive, [member for member in members if member.filename in wanted]))
    except (BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, ValueError, zlib.error) as error:
        raise calibration_bundle(name, f"the zip is damaged ({str(error)[:80]})") from None


def _unpacked(archive: ZipFile, members: list[ZipInfo]) -> Iterator[tuple[str, bytes | None]]:
    """Yield each member's content; the bytes are counted, because the sizes in a zip may be wrong."""
    for member in sorted(members, key=lambda member: member.filename):
        with archive.open(member) as stream:
            yield member.filename, _read(member.filename, stream)


def _check_member(name: str, member: ZipInfo) -> None:
    shown = repr(member.filename[:60])
    parts = member.filename.split("/")
    if member.filename.startswith("/") or ".." in parts or "\\" in member.filename or not member.filename.isprintable():
        raise calibration_bundle(name, f"the zip contains {shown}, whose path leads outside the bundle")
    if member.flag_bits & ENCRYPTED:
        raise calibration_bundle(name, f"{shown} in the zip is encrypted")
    if member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise calibration_bundle(
            name, f"{shown} in the zip uses compression method {member.compress_type}, not deflate"
        )


def _wanted(name: str, names: list[str]) -> frozenset[str]:
    """Return the names of documents. Raises `CAL-428` for none, too many, or two with the same name."""
    if len(names) > MOST_FILES:
        raise calibration_bundle(name, f"it contains {len(names)} files; the limit is {MOST_FILES}")
    if len(set(names)) < len(names):
        raise calibration_bundle(name, "two files in it have the same name")
    hidden = [file for file in names if file.rsplit("/", 1)[-1].startswith(".") or file.startswith("__MACOSX/")]
    suffixes = (*SUFFIXES, TEXT_SUFFIX)
    wanted = frozenset(file for file in names if file.lower().endswith(suffixes) and file not in hidden)
    if not wanted:
        raise calibration_bundle(name, NO_DOCUMENT)
    return wanted


def _check_total(name: str, total_bytes: int) -> None:
    if total_bytes > BUNDLE_LIMIT_BYTES:
        raise calibration_bundle(name, f"its files are larger than {BUNDLE_LIMIT_BYTES} bytes in total")


def zipped(bundle: Bundle) -> bytes:
    """Return the documents as a zip for `read_bundle`; equal bundles always give equal bytes."""
    packed = BytesIO()
    with ZipFile(packed, "w") as archive:
        for name, content in bundle.documents:
            archive.writestr(ZipInfo(name), content, ZIP_DEFLATED)
    return packed.getvalue()


def calibration_size(name: str, limit_bytes: int) -> Refused:
    return Refused(
        "CAL-420", f"{name} is larger than {limit_bytes} bytes; a calibration has a few kilobytes (wrong file?)"
    )


def calibration_bundle(name: str, problem: str) -> Refused:
    return Refused("CAL-428", f"{name} is not a bundle of calibration files: {problem}")
