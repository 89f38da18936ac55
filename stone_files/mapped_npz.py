"""An npz whose arrays lie in it as they do in memory: written without compressing, read by mapping the file.

**Conventions.** A zip of `<key>.npy` members, stored, each array's numbers from a multiple of `ALIGNED_BYTES` on;
`numpy.load` reads it too. What is read is a view of the file's pages, copied only where it is written to, and keeps the
file's bytes alive, also when the file is replaced or deleted. For files of our own: checksums are written, not checked.

Source: PKWARE APPNOTE 6.3.10 §4.3; NEP 1 (npy 1.0).
"""

import ast
import mmap
import struct
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from stone_files.npz import DOS_1980_01_01, VERSION, npy_parts

ALIGNED_BYTES = 64
STORED, PADDING_ID = 0, 0xFFFF
LOCAL, CENTRAL, END = struct.Struct("<4s5H3I2H"), struct.Struct("<4s6H3I5H2I"), struct.Struct("<4s4H2IH")
NPY_HEAD_BYTES = 10  # of version 1.0: magic, version, length of what follows


def write_stored_npz(file: BinaryIO, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write these arrays under these keys from the beginning of `file`.

    Raises `UnwritableArrayError` for a dtype that would need pickle, or an array of 4 GiB and more.
    """
    directory, at = bytearray(), 0
    for key, array in arrays.items():
        header, data = npy_parts(key, array)
        name, size = f"{key}.npy".encode(), len(header) + len(data)
        facts = (isal_zlib.crc32(data, isal_zlib.crc32(header)), size, size, len(name))
        shared = (VERSION, 0, STORED, 0, DOS_1980_01_01, *facts)
        padding = _padding(at + LOCAL.size + len(name))
        local = LOCAL.pack(b"PK\3\4", *shared, len(padding)) + name + padding
        directory += CENTRAL.pack(b"PK\1\2", VERSION, *shared, 0, 0, 0, 0, 0, at) + name
        file.write(local)
        file.write(header)
        file.write(data.data)
        at += len(local) + size
    file.write(directory + END.pack(b"PK\5\6", 0, 0, len(arrays), len(arrays), len(directory), at, 0))


def mapped_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a file that `write_stored_npz` wrote, by key."""
    with path.open("rb") as file:
        view = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    *_, count, _, at, _ = END.unpack_from(view, len(view) - END.size)
    arrays = {}
    for _ in range(count):
        *_, name_bytes, extra_bytes, comment_bytes, _, _, _, local = CENTRAL.unpack_from(view, at)
        name = view[at + CENTRAL.size : at + CENTRAL.size + name_bytes].decode()
        arrays[name.removesuffix(".npy")] = _array(view, local)
        at += CENTRAL.size + name_bytes + extra_bytes + comment_bytes
    return arrays


def _padding(end: int) -> bytes:
    """An extra field that brings what follows a header of this end to a multiple of `ALIGNED_BYTES`."""
    size = -(end + 4) % ALIGNED_BYTES
    return struct.pack("<2H", PADDING_ID, size) + bytes(size)


def _array(view: mmap.mmap, local: int) -> NDArray[Any]:
    *_, name_bytes, extra_bytes = LOCAL.unpack_from(view, local)
    npy = local + LOCAL.size + name_bytes + extra_bytes
    (header_bytes,) = struct.unpack_from("<H", view, npy + NPY_HEAD_BYTES - 2)
    begin = npy + NPY_HEAD_BYTES + header_bytes
    dtype, shape = _layout(view[npy + NPY_HEAD_BYTES : begin])
    return np.ndarray(shape, dtype, view, begin)


@lru_cache(maxsize=256)
def _layout(header: bytes) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Of an array in C order."""
    told = ast.literal_eval(header.decode("latin-1"))
    return np.dtype(told["descr"]), told["shape"]
