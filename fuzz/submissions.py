"""The readers of submissions as functions of bytes, and small whole inputs as seeds.

**Conventions.** An archive is read for two frames, `TOKENS`. If our reader accepts an archive, Python's `zipfile` must
read the same files from it: if two readers could see different files, ours must refuse. Seeds contain files of a few
bytes and an all-free grid, which deflates to 2 kB.
"""

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from stone_base.label_grid import PAPER
from stone_files.npz import npz_bytes
from stone_submissions.archive import SubmissionZip, open_submission
from stone_submissions.errors import SubmissionError
from stone_submissions.manifest import Manifest, read_manifest, write_manifest
from stone_submissions.npz_frame import parse_header, prediction_grid

TOKENS = ("a" * 32, "b" * 32)
DESCRS = ("'|u1'", "'|O'", "[('a', '<f4'), ('b', '|O')]")


class DifferenceError(AssertionError):
    """Two readers see different bytes under one name."""


def read_archive(content: bytes) -> None:
    """Read the directory, and each frame's bytes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sub.zip"
        path.write_bytes(content)
        with open_submission(path, TOKENS) as submission:
            contents = {member.name: _read(submission, token) for token, member in submission.frames.items()}
    if any(contents.values()):
        _compare(content, contents)


def read_frame(content: bytes) -> None:
    grid = prediction_grid(content)
    with np.load(BytesIO(content), allow_pickle=False) as arrays:
        if not np.array_equal(next(iter(arrays.values())), grid):
            raise DifferenceError


def read_header(content: bytes) -> None:
    parse_header(content)


def read_manifest_file(content: bytes) -> None:
    """Read a manifest: writing it back must preserve it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "manifest.json"
        path.write_bytes(content)
        manifest = read_manifest(path)
        write_manifest(path, manifest)
        if read_manifest(path) != manifest:
            raise DifferenceError


def archive_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield archives written by `zipfile`: plain, packed, wide, into a pipe, with a folder, with a comment."""
    for name, method, folder in (
        ("stored", zipfile.ZIP_STORED, ""),
        ("deflated", zipfile.ZIP_DEFLATED, ""),
        ("folder", zipfile.ZIP_STORED, "läufe/"),
    ):
        yield name, _archive(BytesIO(), method, folder)
        yield f"{name}-wide", _archive(BytesIO(), method, folder, wide=True)
        yield f"{name}-piped", _archive(_Pipe(), method, folder, wide=name == "folder")


def frame_seeds() -> Iterator[tuple[str, bytes]]:
    free = np.zeros(PAPER.shape, np.uint8)
    yield "ours", npz_bytes({"semantics": free})
    for name, arrays in (("numpy", {"semantics": free}), ("int64", {"semantics": free.astype(np.int64)})):
        file = BytesIO()
        np.savez_compressed(file, allow_pickle=False, **arrays)
        yield name, file.getvalue()
    yield "small", npz_bytes({"semantics": np.zeros(3, np.uint8)})


def header_seeds() -> Iterator[tuple[str, bytes]]:
    for index, descr in enumerate(DESCRS):
        text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': (256, 256, 32), }}".encode()
        yield f"1-{index}", b"\x93NUMPY\1\0" + len(text).to_bytes(2, "little") + text
        yield f"2-{index}", b"\x93NUMPY\2\0" + len(text).to_bytes(4, "little") + text


def manifest_seeds() -> Iterator[tuple[str, bytes]]:
    yield "two", json.dumps(Manifest({"a": TOKENS[:1], "b": TOKENS[1:]}).as_record()).encode()
    yield "none", b'{"stone_manifest": 1, "sequences": {}}'


class _Pipe(BytesIO):
    """A file without seeking, so that sizes follow the data."""

    def seekable(self) -> bool:
        return False

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        raise OSError(f"a pipe cannot seek to {offset}, {whence}")

    def tell(self) -> int:
        raise OSError("a pipe has no position")


def _archive(file: BytesIO, method: int, folder: str, *, wide: bool = False) -> bytes:
    with zipfile.ZipFile(file, "w", method) as opened:
        if folder:
            opened.writestr(folder, b"")
        opened.comment = folder.encode()
        for token in TOKENS:
            with opened.open(f"{folder}{token}.npz", "w", force_zip64=wide) as member:
                member.write(token[:7].encode() * 3)
    return file.getvalue()


def _read(submission: SubmissionZip, token: str) -> bytes | None:
    try:
        return bytes(submission.read(token))
    except SubmissionError:
        return None


def _compare(content: bytes, contents: dict[str, bytes | None]) -> None:
    """Raise `DifferenceError` if `zipfile` reads other bytes; files that it refuses pass (versions above 6.3)."""
    for name, ours in contents.items():
        try:
            with zipfile.ZipFile(BytesIO(content)) as opened:
                theirs = None if ours is None else opened.read(name)
        except (NotImplementedError, zipfile.BadZipFile, zlib.error, ValueError, EOFError, struct.error):
            continue
        except KeyError as error:
            raise DifferenceError(name) from error
        if theirs != ours:
            raise DifferenceError(name)
