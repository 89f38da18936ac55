"""File type detection by the first bytes of a file.

**Conventions.** Names are never trusted: an HTML page called `.mcap` (a login page saved by a download) is the most
common broken upload. An MCAP file ends as it starts, so that its end identifies a file with a damaged start.
"""

from pathlib import Path
from typing import Literal

from stone_recordings.bags import private_folder
from stone_recordings.bags.errors import CutBagError, NotABagError
from stone_recordings.bags.mcap.catalogue import sealed_bytes
from stone_recordings.bags.mcap.records import MAGIC
from stone_recordings.bags.ros1.records import MAGIC as ROS1_MAGIC

Container = Literal["mcap", "sqlite", "ros1", "zstd"]
SNIFFED_BYTES = 512
SQLITE_MAGIC = b"SQLite format 3\x00"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

OLD_ROS1 = "a ROS 1 bag of a version before 2.0: where ROS 1 runs, rosbag filter old.bag new.bag True rewrites it"
_KNOWN: tuple[tuple[bytes, str], ...] = (
    (b"#ROSBAG V1", OLD_ROS1),
    (b"#ROSRECORD V1", OLD_ROS1),
    (b"PK\x03\x04", "a zip archive: unpack it first"),
    (b"\x1f\x8b", "a gzip archive: unpack it first"),
    (ZSTD_MAGIC, "a file compressed with zstd that is not a bag"),
    (b"\x04\x22\x4d\x18", "a file compressed with lz4: unpack it first"),
    (b"BZh", "a bzip2 archive: unpack it first"),
    (b"\xfd7zXZ", "an xz archive: unpack it first"),
    (b"version https://git-lfs", "a Git LFS pointer: fetch the file itself"),
    (b"\xd4\xc3\xb2\xa1", "a network capture (pcap)"),
    (b"\x0a\x0d\x0d\x0a", "a network capture (pcapng)"),
    (b"\x7fELF", "a program"),
)


def container_of(path: Path) -> Container:
    """Return the container; "zstd" if a file of another kind was compressed as a whole.

    Raises: FileNotFoundError, NotABagError, CutBagError (fewer bytes than the magic has).
    """
    first = _first_bytes(path)
    container = _container(first)
    if container is not None:
        return container
    if first.startswith(ZSTD_MAGIC) and _container(private_folder.first_bytes(path, SNIFFED_BYTES)):
        return "zstd"
    if not first and has_wal(path):
        return "sqlite"  # a recorder in WAL mode that died before it wrote the database itself
    if first and (MAGIC.startswith(first) or ROS1_MAGIC.startswith(first)):
        raise CutBagError(path.name, len(first), "its first record is missing")
    if _ends_as_mcap(path):
        return "mcap"
    raise NotABagError(path.name, first, _looks_like(first))


def is_container(path: Path) -> bool:
    """Return whether `container_of` accepts the file; a cut file counts."""
    try:
        container_of(path)
    except NotABagError:
        return False
    except CutBagError:
        return True
    return True


def has_wal(path: Path) -> bool:
    """Return whether a write-ahead log with content lies beside a database."""
    wal = path.with_name(f"{path.name}-wal")
    return wal.is_file() and wal.stat().st_size > 0


def _first_bytes(path: Path) -> bytes:
    if path.exists() and not path.is_file():  # reading a pipe or a device may never end
        raise NotABagError(path.name, b"", "a folder" if path.is_dir() else "no regular file")
    with path.open("rb") as file:
        return file.read(SNIFFED_BYTES)


def _ends_as_mcap(path: Path) -> bool:
    with path.open("rb") as file:
        return sealed_bytes(file) is not None


def _container(first: bytes) -> Container | None:
    if first.startswith(MAGIC):
        return "mcap"
    if first.startswith(ROS1_MAGIC):
        return "ros1"
    return "sqlite" if first.startswith(SQLITE_MAGIC) else None


def _looks_like(first: bytes) -> str:
    if not first:
        return "an empty file"
    for magic, name in _KNOWN:
        if first.startswith(magic):
            return name
    if first[257:262] == b"ustar":
        return "a tar archive: unpack it first"
    text = first.lstrip().lower()
    if text.startswith((b"<!doctype html", b"<html")) or b"<html" in text:
        return "an HTML page: the download gave a login or error page instead of the file"
    if text.startswith((b"<?xml", b"<")):
        return "XML"
    if text.startswith((b"{", b"[")):
        return "JSON"
    is_text = all(byte >= 32 or byte in b"\t\r\n" for byte in first)
    return "plain text" if is_text else "an unknown format"
