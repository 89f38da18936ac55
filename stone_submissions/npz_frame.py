"""Reads one label grid from a possibly hostile npz file: bounds first, no pickle, exact sizes, CRC.

**Conventions.** A grid is (256, 256, 32) uint8, C order. The file is in memory (the caller limits its size); only the
one grid is allocated. The code that counts the values 0–3 also checks them, so that they are read once.

Source: NEP 1 (npy 1.0, 2.0, 3.0); Occ3D and SurroundOcc name the array `semantics`, `numpy.savez(path, grid)` `arr_0`.
"""

import ast
import re
import stat
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import deflate
import numpy as np
from numpy.typing import NDArray

from stone_base.label_grid import PAPER, LabelGrid
from stone_files.archives import CENTRAL, DEFLATED, END, LOCAL, STORED
from stone_submissions.errors import SubmissionError, bad_shape
from stone_submissions.zip_directory import IN_EXTRA_32, ReadAt, ZipMember, payload_span, read_directory

PREDICTION_KEYS = ("semantics", "arr_0")
PLAIN_NAMES = tuple(f"{key}.npy".encode() for key in PREDICTION_KEYS)
MAX_HEADER_BYTES = 4096
MAX_ARRAYS = 64
# Escapes, and digits followed by letters (0xF…, 1if): Python's parser warns about them or converts them to huge
# numbers.
NOT_IN_A_HEADER = re.compile(rb"\\|\d[A-Za-z_]")
MOST_BRACKETS = 64
LEAST_HEADER_BYTES = 64

Buffer = bytes | bytearray | memoryview


@dataclass(frozen=True)
class NpyHeader:
    """The declarations of an npy header; `start` is the offset of the data."""

    descr: str
    is_fortran: bool
    shape: tuple[int, ...]
    start: int


def prediction_grid(npz: Buffer, grid: LabelGrid = PAPER) -> NDArray[np.uint8]:
    """Return the one array of a submitted frame, under one of `PREDICTION_KEYS`.

    Raises the `SubmissionError` of its fault; values are not checked.
    """
    plain = plain_member(npz, PLAIN_NAMES)
    if plain is not None:
        member, start = plain
        return _grid_of(memoryview(npz)[start : member.limit], member, grid)
    members = npz_members(npz)
    known = [key for key in PREDICTION_KEYS if key in members]
    if not known:
        raise SubmissionError("missing_array", " or ".join(PREDICTION_KEYS), _listed(members))
    if len(members) > 1:
        raise SubmissionError("extra_array", "one array", _listed(members))
    return read_grid(npz, members[known[0]], grid)


def npz_members(npz: Buffer) -> dict[str, ZipMember]:
    """Return the arrays of an npz by key, without reading them.

    Raises `not_npz`, `extra_array` (a repeated key) and the errors of `read_directory`.
    """
    try:
        members = read_directory(_reader(npz), len(npz), MAX_ARRAYS)
    except SubmissionError as error:
        if error.code != "not_zip":
            raise
        code = "truncated" if bytes(npz[:4]) == b"PK\3\4" or not len(npz) else "not_npz"
        actual = error.actual if len(npz) else "an empty file"
        raise SubmissionError(code, "an npz file (a zip of .npy arrays)", actual) from error
    by_key = {member.name.removesuffix(".npy"): member for member in members}
    if len(by_key) < len(members):
        raise SubmissionError("extra_array", "each array once", _listed([member.name for member in members]))
    return by_key


def read_grid(npz: Buffer, member: ZipMember, grid: LabelGrid = PAPER) -> NDArray[np.uint8]:
    """Return the array with the grid's shape that is stored as `member` of this npz.

    Raises `bad_dtype`, `bad_shape`, `too_large`, `truncated`, `corrupt`, `not_npz`.
    """
    start, stop = payload_span(_reader(npz), member)
    return _grid_of(memoryview(npz)[start:stop], member, grid)


def array_shape(npz: Buffer, member: ZipMember) -> tuple[int, ...]:
    """Return the shape in an array's header. Raises `not_npz`, and the errors of `payload_span`."""
    start, stop = payload_span(_reader(npz), member)
    packed = memoryview(npz)[start:stop]
    try:
        head = bytes(packed[: 12 + MAX_HEADER_BYTES]) if member.method == STORED else _peek(packed)
    except zlib.error as error:
        raise SubmissionError("corrupt", "a deflate stream", "other bytes") from error
    return parse_header(head).shape


def _grid_of(packed: memoryview, member: ZipMember, grid: LabelGrid) -> NDArray[np.uint8]:
    """Return the array in the packed bytes of `member`."""
    least, most = _npy_bytes(grid)
    if not least <= member.unpacked_bytes <= most:
        raise _size_refusal(packed, member, grid)
    npy = packed if member.method == STORED else inflate_exactly(packed, member.unpacked_bytes)
    if deflate.crc32(npy) != member.crc32:
        raise SubmissionError("corrupt", f"CRC-32 {member.crc32:08x}", f"{deflate.crc32(npy):08x}")
    header = _checked(parse_header(bytes(npy[: 12 + MAX_HEADER_BYTES])), grid)
    if len(npy) - header.start != grid.voxels:
        raise SubmissionError("truncated", f"{grid.voxels} bytes of voxels", f"{len(npy) - header.start}")
    return np.frombuffer(npy, np.uint8, grid.voxels, header.start).reshape(grid.shape)


def parse_header(head: bytes) -> NpyHeader:
    """Parse the header of an npy file from its first bytes; only literals are evaluated.

    Raises `not_npz` if it is not a header or longer than 4 KiB.
    """
    if head[:6] != b"\x93NUMPY" or len(head) < 12 or head[6] not in (1, 2, 3):
        raise SubmissionError("not_npz", "an npy array of version 1 to 3", f"bytes {head[:8]!r}")
    length, at = (
        (struct.unpack_from("<H", head, 8)[0], 10) if head[6] == 1 else (*struct.unpack_from("<I", head, 8), 12)
    )
    if length > MAX_HEADER_BYTES or at + length > len(head):
        raise SubmissionError("not_npz", f"an npy header of at most {MAX_HEADER_BYTES} bytes", f"{length} bytes")
    return _literal_header(head[at : at + length], at + length)


@lru_cache(maxsize=64)
def _literal_header(text: bytes, start: int) -> NpyHeader:
    odd = NOT_IN_A_HEADER.search(text)
    if odd or sum(map(text.count, (b"(", b"[", b"{"))) > MOST_BRACKETS:
        actual = repr(odd.group()) if odd else f"more than {MOST_BRACKETS} brackets"
        raise SubmissionError("not_npz", "an npy header of plain literals", actual)
    try:
        facts = ast.literal_eval(text.decode("latin-1").strip())
        shape, descr, is_fortran = (facts[key] for key in ("shape", "descr", "fortran_order"))
    except (ValueError, SyntaxError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise SubmissionError("not_npz", "an npy header with descr, fortran_order and shape", "another text") from error
    is_sound = isinstance(shape, tuple) and all(map(_is_size, shape)) and isinstance(is_fortran, bool)
    if len(facts) != 3 or not is_sound:
        raise SubmissionError("not_npz", "an npy header with descr, fortran_order and shape", "other values")
    return NpyHeader(str(descr)[:80], is_fortran, shape[:16], start)


def _is_size(number: object) -> bool:
    return type(number) is int and 0 <= number < 2**63


def _npy_bytes(grid: LabelGrid) -> tuple[int, int]:
    """Return the smallest and largest npy file size of an array with the grid's shape."""
    return grid.voxels + LEAST_HEADER_BYTES, grid.voxels + 12 + MAX_HEADER_BYTES


def _checked(header: NpyHeader, grid: LabelGrid) -> NpyHeader:
    if header.descr not in ("|u1", "u1", "<u1", ">u1"):
        hint = ", an object array, which requires pickle" if "O" in header.descr else ""
        raise SubmissionError("bad_dtype", "uint8 ('|u1')", f"{header.descr!r}{hint}")
    if header.shape != grid.shape:
        raise bad_shape(grid, str(header.shape))
    if header.is_fortran:
        raise SubmissionError("bad_shape", f"{grid.shape} in C order", "Fortran order")
    return header


def _size_refusal(packed: memoryview, member: ZipMember, grid: LabelGrid) -> SubmissionError:
    """Return the refusal of a member with this size; the header of the array (4 KiB) shows the reason."""
    raw: bytes
    least, most = _npy_bytes(grid)
    try:
        raw = bytes(packed[: 12 + MAX_HEADER_BYTES]) if member.method == STORED else _peek(packed)
        _checked(parse_header(raw), grid)
    except SubmissionError as error:
        if error.code != "not_npz" or member.unpacked_bytes < least:
            return error
    except zlib.error:
        return SubmissionError("corrupt", "a deflate stream", "other bytes")
    code = "truncated" if member.unpacked_bytes < least else "too_large"
    return SubmissionError(code, f"{least} to {most} bytes of npy", f"{member.unpacked_bytes} bytes")


def _peek(packed: memoryview) -> bytes:
    return zlib.decompressobj(-15).decompress(packed[: 4 * MAX_HEADER_BYTES], 12 + MAX_HEADER_BYTES)


def inflate_exactly(packed: Buffer, size_bytes: int) -> bytearray:
    """Return exactly `size_bytes` of the stream, or raise; the stream is never read beyond its declared size."""
    try:
        npy: bytearray = deflate.deflate_decompress(packed, size_bytes)
    except deflate.DeflateError as error:
        raise _inflate_refusal(packed, size_bytes) from error
    if len(npy) != size_bytes:
        raise SubmissionError("truncated", f"{size_bytes} bytes", f"{len(npy)}")
    return npy


def _inflate_refusal(packed: Buffer, size_bytes: int) -> SubmissionError:
    """Return the refusal of a stream that is broken or longer than declared (a bomb), by inflating one more byte."""
    try:
        longer = zlib.decompressobj(-15).decompress(packed, size_bytes + 1)
    except zlib.error:
        return SubmissionError("corrupt", f"a deflate stream of {size_bytes} bytes", "a broken one")
    if len(longer) > size_bytes:
        return SubmissionError("too_large", f"the declared {size_bytes} bytes", "a stream that continues")
    return SubmissionError("truncated", f"a deflate stream of {size_bytes} bytes", f"an end after {len(longer)} bytes")


def _reader(npz: Buffer) -> ReadAt:
    view = memoryview(npz)
    return lambda offset, count: bytes(view[offset : offset + count])


def _listed(names: Iterable[str]) -> str:
    shown = [name[:40] for name in names]
    return ", ".join(shown[:4]) + (f" and {len(shown) - 4} more" if len(shown) > 4 else "") if shown else "no array"


# A fast path for ordinary npz files: a zip of one array without unusual features. All other files use
# `stone_files/zip_directory.py`, which gives the same result and names faults. This path takes 0.3 ms per frame;
# reading all headers would add a tenth. numpy writes zip64 sizes into the local header and narrow sizes into the
# directory.


WIDE = struct.Struct("<2H2Q")
WIDE_SIZES = 1, 16
LEAST_BYTES = LOCAL.size + CENTRAL.size + END.size


def plain_member(npz: Buffer, names: tuple[bytes, ...]) -> tuple[ZipMember, int] | None:
    """Return the only file of this zip, if it has one of these names, and the start of its bytes; None if anything is
    unusual.
    """
    end_at = len(npz) - END.size
    if len(npz) < LEAST_BYTES:
        return None
    mark, disk, start_disk, here, entries, directory_bytes, directory_at, comment = END.unpack_from(npz, end_at)
    if mark != b"PK\5\6" or (disk, start_disk, here, entries, comment) != (0, 0, 1, 1, 0):
        return None
    if directory_at + directory_bytes != end_at or directory_bytes < CENTRAL.size or directory_at < LOCAL.size:
        return None
    mark, made_by, _, flags, method, _, _, crc32, packed, unpacked, *rest = CENTRAL.unpack_from(npz, directory_at)
    name_bytes, extra, comment, disk, _, attributes, at = rest
    name = bytes(npz[directory_at + CENTRAL.size : end_at])
    if mark != b"PK\1\2" or name not in names or name_bytes != len(name) or flags or made_by >> 8 > 3:
        return None
    if (extra, comment, disk, at) != (0, 0, 0, 0) or stat.S_ISLNK(attributes >> 16):
        return None
    if unpacked == IN_EXTRA_32 or (method != DEFLATED and (method != STORED or packed != unpacked)):
        return None
    start = _data_start(npz, (method, packed, unpacked, name))
    if start is None or start + packed != directory_at:
        return None
    return ZipMember(name.decode("ascii"), method, crc32, packed, unpacked, 0, directory_at), start


def _data_start(npz: Buffer, known: tuple[int, int, int, bytes]) -> int | None:
    """Return the offset after the local header, if the header agrees with `known`."""
    method, packed, unpacked, name = known
    mark, _, flags, own_method, _, _, _, *sizes, name_bytes, extra_bytes = LOCAL.unpack_from(npz)
    start = LOCAL.size + len(name)
    if mark != b"PK\3\4" or flags or own_method != method or name_bytes != len(name) or npz[LOCAL.size : start] != name:
        return None
    if sizes == [packed, unpacked] and not extra_bytes and IN_EXTRA_32 not in sizes:
        return start
    is_wide = sizes == [IN_EXTRA_32, IN_EXTRA_32] and extra_bytes == WIDE.size
    is_same = is_wide and npz[start : start + WIDE.size] == WIDE.pack(*WIDE_SIZES, unpacked, packed)
    return start + WIDE.size if is_same else None
