"""The documents of a calibration: one file, a folder of files, or a zip of them; read whole, bounded, never unpacked.

**Conventions.** Documents come by name in order. What is neither YAML nor JSON is left aside and named (a Kalibr run
writes reports and text results beside its YAML). Nothing is written, so that no name in a zip can lead anywhere; names
that try are refused all the same. A zip is stored or deflated: other methods may ask for gigabytes before one byte.
"""

import zlib
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from stone_recordings.calibrations.errors import CalibrationBundleError, CalibrationSizeError

SIZE_LIMIT_BYTES = 1_000_000
BUNDLE_LIMIT_BYTES = 4_000_000
MOST_FILES = 64
MOST_ENTRIES = 1000
SUFFIXES = (".yaml", ".yml", ".json")
ZIP_MAGIC = b"PK\x03\x04"
ENCRYPTED = 0x1


@dataclass(frozen=True)
class Bundle:
    """`documents`: (name, bytes) of what may be a calibration; `aside`: names of what was not looked at."""

    documents: tuple[tuple[str, bytes], ...]
    aside: tuple[str, ...] = ()


def read_bundle(path: Path) -> Bundle:
    """Raises OSError, CalibrationSizeError, CalibrationBundleError (no document, too many, a zip that is not one)."""
    if path.is_dir():
        return _folder(path)
    with path.open("rb") as file:
        content = file.read(SIZE_LIMIT_BYTES + 1)
    if len(content) > SIZE_LIMIT_BYTES:
        raise CalibrationSizeError(path.name, SIZE_LIMIT_BYTES)
    return _zip(path.name, content) if content.startswith(ZIP_MAGIC) else Bundle(((path.name, content),))


def _folder(path: Path) -> Bundle:
    found = list(islice(path.rglob("*"), MOST_ENTRIES + 1))
    if len(found) > MOST_ENTRIES:
        raise CalibrationBundleError(path.name, f"it holds more than {MOST_ENTRIES} entries")
    files = sorted(file for file in found if file.is_file() and not file.is_symlink())
    names = [file.relative_to(path).as_posix() for file in files]
    wanted = _wanted(path.name, names)
    documents = [(name, _read(file)) for name, file in zip(names, files, strict=True) if name in wanted]
    _check_total(path.name, sum(len(content) for _, content in documents))
    return Bundle(tuple(documents), tuple(name for name in names if name not in wanted))


def _read(file: Path) -> bytes:
    with file.open("rb") as stream:
        content = stream.read(SIZE_LIMIT_BYTES + 1)
    if len(content) > SIZE_LIMIT_BYTES:
        raise CalibrationSizeError(file.name, SIZE_LIMIT_BYTES)
    return content


def _zip(name: str, content: bytes) -> Bundle:
    try:
        with ZipFile(BytesIO(content)) as archive:
            members = [member for member in archive.infolist() if not member.is_dir()]
            for member in members:
                _check_member(name, member)
            wanted = _wanted(name, [member.filename for member in members])
            documents = _unpacked(name, archive, [member for member in members if member.filename in wanted])
    except (BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, ValueError, zlib.error) as error:
        raise CalibrationBundleError(name, f"the zip is damaged ({str(error)[:80]})") from None
    return Bundle(documents, tuple(member.filename for member in members if member.filename not in wanted))


def _unpacked(name: str, archive: ZipFile, members: list[ZipInfo]) -> tuple[tuple[str, bytes], ...]:
    """The sizes in a zip are claims: what is read is what counts."""
    documents, total_bytes = [], 0
    for member in sorted(members, key=lambda member: member.filename):
        with archive.open(member) as stream:
            content = stream.read(SIZE_LIMIT_BYTES + 1)
        if len(content) > SIZE_LIMIT_BYTES:
            raise CalibrationSizeError(member.filename[:80], SIZE_LIMIT_BYTES)
        total_bytes += len(content)
        _check_total(name, total_bytes)
        documents.append((member.filename, content))
    return tuple(documents)


def _check_member(name: str, member: ZipInfo) -> None:
    shown = repr(member.filename[:60])
    parts = member.filename.split("/")
    if member.filename.startswith("/") or ".." in parts or "\\" in member.filename or not member.filename.isprintable():
        raise CalibrationBundleError(name, f"the zip holds a file called {shown}, which leads out of it")
    if member.flag_bits & ENCRYPTED:
        raise CalibrationBundleError(name, f"{shown} in the zip is encrypted")
    if member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise CalibrationBundleError(
            name, f"{shown} in the zip is packed by method {member.compress_type}, not deflate"
        )


def _wanted(name: str, names: list[str]) -> frozenset[str]:
    """Raises CalibrationBundleError for none, too many, or two of one name."""
    if len(names) > MOST_FILES:
        raise CalibrationBundleError(name, f"it holds {len(names)} files, the limit is {MOST_FILES}")
    if len(set(names)) < len(names):
        raise CalibrationBundleError(name, "two files in it have the same name")
    hidden = [file for file in names if file.rsplit("/", 1)[-1].startswith(".") or file.startswith("__MACOSX/")]
    wanted = frozenset(file for file in names if file.lower().endswith(SUFFIXES) and file not in hidden)
    if not wanted:
        raise CalibrationBundleError(name, "it holds no .yaml, .yml or .json file")
    return wanted


def _check_total(name: str, total_bytes: int) -> None:
    if total_bytes > BUNDLE_LIMIT_BYTES:
        raise CalibrationBundleError(name, f"its files together are larger than {BUNDLE_LIMIT_BYTES} bytes")


def zipped(bundle: Bundle) -> bytes:
    """The documents as a zip that `read_bundle` reads; equal bundles give equal bytes, whenever they are packed."""
    packed = BytesIO()
    with ZipFile(packed, "w") as archive:
        for name, content in bundle.documents:
            archive.writestr(ZipInfo(name), content, ZIP_DEFLATED)
    return packed.getvalue()
