"""Hostile submissions, each with the code it must be refused with; and the honest ones that must pass.

A case writes one zip for a manifest of two frames, `TOKENS`; the second frame is always honest.
"""

import io
import os
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_files.npz import npz_bytes

SHAPE = (256, 256, 32)
TOKENS = ("a" * 32, "b" * 32)
FREE = np.zeros(SHAPE, np.uint8)
HONEST = npz_bytes({"semantics": FREE})
BOMB_BYTES = 400 * 2**20

Files = list[tuple[str, bytes]]
Build = Callable[[Path], None]


def grid(seed: int = 1) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    return np.where(rng.random(SHAPE, dtype=np.float32) < 0.02, rng.integers(0, 4, SHAPE), 0).astype(np.uint8)


def archive(files: Files) -> Build:
    def build(path: Path) -> None:
        with warnings.catch_warnings(), zipfile.ZipFile(path, "w") as opened:
            warnings.simplefilter("ignore", UserWarning)  # zipfile warns about duplicate names; we want them
            for name, payload in files:
                opened.writestr(name, payload)

    return build


def frame(npz: bytes) -> Build:
    """A submission whose first frame is this file."""
    return archive([(f"{TOKENS[0]}.npz", npz), (f"{TOKENS[1]}.npz", HONEST)])


def saved(*arrays: NDArray[Any], **named: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, *arrays, allow_pickle=True, **named)
    return file.getvalue()


def stored(array: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    np.savez(file, semantics=array)
    return file.getvalue()


def with_value(value: int) -> bytes:
    spoiled = grid()
    spoiled[17, 200, 31] = value
    return saved(semantics=spoiled)


def objects_of_the_right_size() -> bytes:
    """An object array whose header lies below the size of an honest file: only pickle could read it."""
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (256, 256, 32), }".ljust(117) + b"\n"
    npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    return zip_of("semantics.npy", npy + bytes(FREE.nbytes + 128 - len(npy)))


def zip_of(name: str, payload: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as opened:
        opened.writestr(name, payload)
    return file.getvalue()


def bomb(declared_bytes: int) -> bytes:
    """400 MB of zeros behind an honest header, declared as this many bytes."""
    squeeze = zlib.compressobj(9, zlib.DEFLATED, -15)
    honest = io.BytesIO()
    np.lib.format.write_array(honest, FREE)
    packed = bytearray(squeeze.compress(honest.getvalue()))
    packed += squeeze.flush(zlib.Z_FULL_FLUSH)  # a block that knows nothing of those before it may be repeated
    block = squeeze.compress(bytes(2**20)) + squeeze.flush(zlib.Z_FULL_FLUSH)
    stream = bytes(packed) + block * (BOMB_BYTES // 2**20) + squeeze.flush()
    name = b"semantics.npy"
    shared = struct.pack("<5H3I2H", 20, 0, 8, 0, 33, zlib.crc32(b""), len(stream), declared_bytes, len(name), 0)
    local = b"PK\3\4" + shared + name + stream
    record = b"PK\1\2" + struct.pack("<H", 20) + shared + struct.pack("<3H2I", 0, 0, 0, 0, 0) + name
    return local + record + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, len(record), len(local), 0)


def flipped(npz: bytes, at: int) -> bytes:
    return npz[:at] + bytes([npz[at] ^ 16]) + npz[at + 1 :]


def wrong_crc() -> bytes:
    npz = bytearray(npz_bytes({"semantics": grid()}))
    record = npz.rfind(b"PK\1\2")
    npz[record + 16] ^= 1
    return bytes(npz)


def patched(build: Build, at: Callable[[bytes], int], replacement: bytes) -> Build:
    """The archive of `build` with some bytes replaced."""

    def rebuild(path: Path) -> None:
        build(path)
        raw = path.read_bytes()
        start = at(raw)
        path.write_bytes(raw[:start] + replacement + raw[start + len(replacement) :])

    return rebuild


def record_field(offset: int) -> Callable[[bytes], int]:
    """The byte of the last directory record at this offset."""
    return lambda raw: raw.rfind(b"PK\1\2") + offset


def cut(build: Build, keep: float) -> Build:
    def rebuild(path: Path) -> None:
        build(path)
        os.truncate(path, int(path.stat().st_size * keep))

    return rebuild


def written(raw: bytes) -> Build:
    def build(path: Path) -> None:
        path.write_bytes(raw)

    return build


def trailed(build: Build) -> Build:
    def rebuild(path: Path) -> None:
        build(path)
        path.write_bytes(path.read_bytes() + b"more")

    return rebuild


def huge_member(path: Path) -> None:
    archive([(f"{TOKENS[0]}.npz", bytes(50 * 2**20)), (f"{TOKENS[1]}.npz", HONEST)])(path)


def symlink(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as opened:
        link = zipfile.ZipInfo(f"{TOKENS[0]}.npz")
        link.create_system, link.external_attr = 3, 0o120777 << 16
        opened.writestr(link, "/etc/passwd")


BOTH: Files = [(f"{token}.npz", HONEST) for token in TOKENS]
RAW = npz_bytes({"semantics": grid()})

HONEST_CASES: Mapping[str, Build] = {
    "a normal frame": frame(saved(semantics=grid())),
    "an uncompressed frame": frame(stored(grid())),
    "all free frames": archive(BOTH),
    "positional array": frame(saved(grid())),
    "in a folder": archive([("run7/", b""), *((f"run7/{name}", npz) for name, npz in BOTH)]),
}

HOSTILE_CASES: Mapping[str, tuple[str, Callable[[], Build]]] = {
    "bomb of declared size": ("too_large", lambda: frame(bomb(BOMB_BYTES + FREE.nbytes + 128))),
    "bomb of lying size": ("too_large", lambda: frame(bomb(FREE.nbytes + 128))),
    "label 4": ("label_out_of_range", lambda: frame(with_value(4))),
    "label 255": ("label_out_of_range", lambda: frame(with_value(255))),
    "int64": ("bad_dtype", lambda: frame(saved(semantics=grid().astype(np.int64)))),
    "bool": ("bad_dtype", lambda: frame(saved(semantics=grid() > 0))),
    "wrong shape": ("bad_shape", lambda: frame(saved(semantics=grid()[:255]))),
    "transposed": ("bad_shape", lambda: frame(saved(semantics=grid().transpose(2, 0, 1)))),
    "Fortran order": ("bad_shape", lambda: frame(saved(semantics=np.asfortranarray(grid())))),
    "wrong key": ("missing_array", lambda: frame(saved(labels=grid()))),
    "two arrays": ("extra_array", lambda: frame(saved(semantics=grid(), scores=grid()))),
    "pickled objects": ("bad_dtype", lambda: frame(saved(semantics=np.array([{"a": 1}, 2], dtype=object)))),
    "objects of the right size": ("bad_dtype", lambda: frame(objects_of_the_right_size())),
    "one bit flipped": ("corrupt", lambda: frame(flipped(stored(grid()), 1_000_000))),
    "wrong CRC": ("corrupt", lambda: frame(wrong_crc())),
    "truncated": ("truncated", lambda: frame(RAW[: len(RAW) // 2])),
    "empty": ("truncated", lambda: frame(b"")),
    "random bytes": ("not_npz", lambda: frame(np.random.default_rng(0).bytes(50_000))),
    "frame missing": ("missing_frame", lambda: archive(BOTH[:1])),
    "extra ../../x": ("unexpected_file", lambda: archive([*BOTH, ("../../x", b"x")])),
    "duplicate name": ("duplicate_frame", lambda: archive([*BOTH, BOTH[0]])),
    "overlapping members": ("overlapping_files", lambda: patched(archive(BOTH), record_field(42), bytes(4))),
    "a 50 MB member": ("too_large", lambda: huge_member),
    "25,000 entries": ("too_large", lambda: archive([(f"{index:032x}.npz", b"") for index in range(25_000)])),
    # Beyond the list: the archive itself.
    "not a zip": ("not_zip", lambda: written(b"<!DOCTYPE html><html>")),
    "an empty archive file": ("not_zip", lambda: written(b"")),
    "archive cut short": ("truncated", lambda: cut(archive(BOTH), 0.6)),
    "encrypted": ("encrypted", lambda: patched(archive(BOTH), record_field(8), b"\1")),
    "method bzip2": ("unsupported_zip", lambda: patched(archive(BOTH), record_field(10), b"\x0c")),
    "symbolic link": ("symlink", lambda: symlink),
    "lying entry count": ("truncated", lambda: patched(archive(BOTH), lambda raw: len(raw) - 14, b"\3\0\3\0")),
    "local name differs": ("unsupported_zip", lambda: patched(archive(BOTH), lambda raw: 30, b"c")),
    "frame in two folders": ("unexpected_file", lambda: archive([*BOTH, (f"x/{TOKENS[0]}.npz", HONEST)])),
    "trailing bytes": ("not_zip", lambda: trailed(archive(BOTH))),
}
