"""A fast, deterministic npz writer.

**Conventions.** A zip of `<key>.npy` members in the given order, deflated by ISA-L or by the caller. All are dated
1980-01-01, so equal arrays give equal bytes. `numpy.load` reads the file without pickle. C order only. No zip64: an
array stays below 4 GiB.

Source: PKWARE APPNOTE 6.3.10 §4.3; NEP 1 (npy 1.0); RFC 1951, 3.2.4.
"""

import ast
import io
import mmap
import struct
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO

import numpy as np
from isal import igzip_lib, isal_zlib
from numpy.typing import NDArray

from stone_base.errors import Refused
from stone_files.archives import CENTRAL, DEFLATED, DOS_1980_01_01, END, LOCAL, PLAIN, STORED, zip_end

# ISA-L's level 1 takes a fifth of the time of libdeflate's best on label grids, for 1.4 times the bytes.
LEVEL = 1
MAX_MEMBER_BYTES = 2**32 - 2**20


def npz_bytes(
    arrays: Mapping[str, NDArray[Any]], level: int = LEVEL, deflated: Mapping[str, bytes] = MappingProxyType({})
) -> bytes:
    """Return a deterministic npz file with these arrays under these keys.

    `level` is ISA-L's, 0 (fastest) to 3. `deflated` contains the final deflate blocks of some arrays' data in C order;
    these arrays are not deflated again.

    Raises:
        `unwritable_array`: a dtype that would need pickle, or an array of 4 GiB and more.
    """
    body, directory, buffer = bytearray(), bytearray(), np.empty(0, np.uint8)
    for key, array in arrays.items():
        header, data = npy_parts(key, array)
        size = len(header) + len(data)
        if key in deflated:
            payload = _stored_block(header) + deflated[key]
        else:
            buffer = buffer if buffer.size >= size else np.empty(size, np.uint8)  # fresh pages cost more than the copy
            buffer[: len(header)], buffer[len(header) : size] = np.frombuffer(header, np.uint8), data
            payload = igzip_lib.compress(buffer[:size], level, igzip_lib.COMP_DEFLATE)
        checksum = isal_zlib.crc32(data, isal_zlib.crc32(header))
        local, entry = _headers(f"{key}.npy", DEFLATED, (checksum, len(payload), size), len(body))
        body += local
        body += payload
        directory += entry
    return bytes(body + directory + zip_end(len(arrays), len(body), len(directory)))


def _stored_block(data: bytes) -> bytes:
    """Return a deflate block that stores up to 65535 bytes unchanged, ends at a byte boundary and is not the last."""
    return struct.pack("<B2H", 0, len(data), len(data) ^ 0xFFFF) + data


def npy_parts(key: str, array: NDArray[Any]) -> tuple[bytes, NDArray[np.uint8]]:
    """Return header and data of one array as an npy 1.0 file in C order; `key` is used in the refusal."""
    if array.dtype.hasobject or array.nbytes > MAX_MEMBER_BYTES:
        raise Refused(
            "unwritable_array",
            f"array {key!r} of dtype {array.dtype} and {array.nbytes} bytes cannot be stored; only numeric "
            f"arrays below {MAX_MEMBER_BYTES} bytes can (was a list of arrays turned into an object array?)",
        )
    header = io.BytesIO()
    contiguous = np.ascontiguousarray(array).reshape(array.shape)
    np.lib.format.write_array_header_1_0(header, np.lib.format.header_data_from_array_1_0(contiguous))
    return header.getvalue(), contiguous.reshape(-1).view(np.uint8)


def _headers(
    key: str, method: int, facts: tuple[int, int, int], offset: int, extra: bytes = b""
) -> tuple[bytes, bytes]:
    """Return the local header and directory entry of a member; `facts` are CRC-32, packed and unpacked size."""
    name = key.encode()
    shared = (PLAIN, 0, method, 0, DOS_1980_01_01, *facts, len(name))
    local = LOCAL.pack(b"PK\3\4", *shared, len(extra)) + name + extra
    return local, CENTRAL.pack(b"PK\1\2", PLAIN, *shared, 0, 0, 0, 0, 0, offset) + name


# An uncompressed npz that is read by mapping the file: each array's data starts at a multiple of `ALIGNED_BYTES`.
# `mapped_npz` returns views of the file's pages, which are copied on write and stay valid if the file is replaced or
# deleted. Checksums are written but not checked, because the platform wrote these files.


ALIGNED_BYTES = 64
PADDING_ID = 0xFFFF
NPY_HEAD_BYTES = 10  # npy 1.0: magic, version, header length


def write_stored_npz(file: BinaryIO, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write these arrays under these keys from the start of `file`.

    Raises `unwritable_array` for a dtype that would need pickle, or an array of 4 GiB and more.
    """
    directory, at = bytearray(), 0
    for key, array in arrays.items():
        header, data = npy_parts(key, array)
        name, size = f"{key}.npy", len(header) + len(data)
        facts = (isal_zlib.crc32(data, isal_zlib.crc32(header)), size, size)
        local, entry = _headers(name, STORED, facts, at, _padding(at + LOCAL.size + len(name.encode())))
        directory += entry
        file.write(local)
        file.write(header)
        file.write(data.data)
        at += len(local) + size
    file.write(directory + zip_end(len(arrays), at, len(directory)))


def mapped_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays in a file of `write_stored_npz`, by key."""
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
    """Return an extra field that pads a header ending at `end` to a multiple of `ALIGNED_BYTES`."""
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
    """Return dtype and shape of an array in C order."""
    description = ast.literal_eval(header.decode("latin-1"))
    return np.dtype(description["descr"]), description["shape"]
