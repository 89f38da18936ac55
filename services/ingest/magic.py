"""Tell what a file is by its first bytes, and say so when it is no recording.

**Conventions.** Names are never trusted: an HTML page called `.mcap` (a login page saved by a download) is the
commonest broken upload.
"""

from pathlib import Path
from typing import Literal

from services.ingest.errors import CutBagError, NotABagError
from services.ingest.mcap_records import MAGIC

Container = Literal["mcap", "sqlite", "folder"]
SNIFFED_BYTES = 512

_KNOWN: tuple[tuple[bytes, str], ...] = (
    (b"#ROSBAG V", "a ROS 1 bag: convert it with rosbags-convert"),
    (b"PK\x03\x04", "a zip archive: unpack it first"),
    (b"\x1f\x8b", "a gzip archive: unpack it first"),
    (b"\x28\xb5\x2f\xfd", "a file compressed with zstd: unpack it first"),
    (b"\x04\x22\x4d\x18", "a file compressed with lz4: unpack it first"),
    (b"BZh", "a bzip2 archive: unpack it first"),
    (b"\xfd7zXZ", "an xz archive: unpack it first"),
    (b"version https://git-lfs", "a Git LFS pointer: fetch the file itself"),
    (b"\xd4\xc3\xb2\xa1", "a network capture (pcap)"),
    (b"\x0a\x0d\x0d\x0a", "a network capture (pcapng)"),
    (b"\x7fELF", "a program"),
)


def container_of(path: Path) -> Container:
    """Raises: FileNotFoundError, NotABagError, CutBagError (fewer bytes than the magic has)."""
    if path.is_dir():
        return _container_of_folder(path)
    with path.open("rb") as file:
        first = file.read(SNIFFED_BYTES)
    if first.startswith(MAGIC):
        return "mcap"
    if first.startswith(b"SQLite format 3\x00"):
        return "sqlite"
    if first and MAGIC.startswith(first):
        raise CutBagError(path.name, len(first))
    raise NotABagError(path.name, first, _looks_like(first))


def sole_mcap(path: Path) -> Path:
    """The one MCAP file of a rosbag2 folder that is not split; `path` itself for everything else."""
    if not path.is_dir():
        return path
    files = [file for file in path.iterdir() if file.name != "metadata.yaml"]
    return files[0] if len(files) == 1 and files[0].suffix == ".mcap" else path


def _container_of_folder(path: Path) -> Container:
    if (path / "metadata.yaml").is_file():
        return "folder"
    raise NotABagError(path.name, b"", "a folder without metadata.yaml: name the .mcap or .db3 file itself")


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
    return "plain text" if is_text else "nothing that is known here"
