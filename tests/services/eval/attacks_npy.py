"""Hostile frames: headers that lie, swell or nest, dtypes that only pickle reads, archives of arrays that mislead.

**Conventions.** As in `attacks.py`: a case is the codes it must be refused with and what builds it.
"""

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from tests.services.eval.attacks import FREE, Build, flipped, frame, grid, saved, stored
from tests.services.eval.raw_zip import Ending, Entry, raw_zip, stretched, wide_extra

Case = tuple[str, Callable[[], Build]]
HONEST_HEADER = "{'descr': '|u1', 'fortran_order': False, 'shape': (256, 256, 32), }"


def npy(header: str | bytes, data_bytes: int = FREE.nbytes, *, version: int = 1, said: int | None = None) -> bytes:
    """A npy file of this header and so many zeros; `said` is the length that it announces."""
    text = header.encode("latin-1") if isinstance(header, str) else header
    length = len(text) if said is None else said
    return (
        b"\x93NUMPY"
        + bytes([version, 0])
        + struct.pack("<H" if version == 1 else "<I", length)
        + text
        + bytes(data_bytes)
    )


def padded(header: str) -> bytes:
    """To the length of an honest one, so that the size of the file says nothing."""
    return npy(header.ljust(117) + "\n")


def holding(payload: bytes, name: bytes = b"semantics.npy") -> Callable[[], Build]:
    return lambda: frame(raw_zip([Entry(name, payload, method=8)]))


def headed(header: str) -> Case:
    return "not_npz", holding(padded(header))


def shaped(shape: str, code: str = "bad_shape") -> Case:
    return code, holding(padded(HONEST_HEADER.replace("(256, 256, 32)", shape)))


def typed(descr: str) -> Case:
    return "bad_dtype", holding(padded(HONEST_HEADER.replace("'|u1'", descr)))


def squeezed(payload: bytes) -> bytes:
    squeeze = zlib.compressobj(9, zlib.DEFLATED, -15)
    return squeeze.compress(payload) + squeeze.flush()


def member(**central: int) -> Callable[[], Build]:
    """An honest array whose directory lies."""
    return lambda: frame(
        raw_zip([Entry(b"semantics.npy", npy(HONEST_HEADER.ljust(117) + "\n"), method=8, central=central)])
    )


def arrays(*entries: Entry) -> Callable[[], Build]:
    return lambda: frame(raw_zip(entries))


HONEST_NPY = padded(HONEST_HEADER)
ARRAY = Entry(b"semantics.npy", HONEST_NPY, method=8)

HEADERS: Mapping[str, Case] = {
    "header of 4 GiB": ("not_npz", holding(npy(HONEST_HEADER, version=2, said=2**32 - 1))),
    "header of 65,535 bytes": ("not_npz", holding(npy(HONEST_HEADER, said=2**16 - 1))),
    "header longer than the file": ("not_npz", holding(npy(HONEST_HEADER, 10, said=4000))),
    "header of version 9": ("not_npz", holding(npy(HONEST_HEADER.ljust(117), version=9))),
    "no header": ("not_npz", holding(bytes(FREE.nbytes + 128))),
    "header of no bytes": ("not_npz", holding(npy("", FREE.nbytes + 100))),
    "a thousand brackets": headed("(" * 110),
    "brackets to the limit": ("not_npz", holding(npy("[" * 4000))),
    "four thousand signs": ("not_npz", holding(npy(HONEST_HEADER.replace("256, 32", "-" * 3900 + "1")))),
    "a number of 4,000 digits": ("not_npz", holding(npy(HONEST_HEADER.replace("32)", "9" * 3900 + ")")))),
    "a hexadecimal number too long to say": (
        "not_npz",
        holding(npy(HONEST_HEADER.replace("32)", "0x" + "F" * 3900 + ")"))),
    ),
    "a power": headed(HONEST_HEADER.replace("256", "9**9", 1)),
    "a call": headed(HONEST_HEADER.replace("False", "exit()")),
    "a string of strings": ("not_npz", holding(npy("'a' " * 1000))),
    "an escape": headed(HONEST_HEADER.replace("|u1", "\\x7cu1")),
    "bytes that are no text": ("not_npz", holding(npy(bytes(range(128, 245)) + b"\n"))),
    "a digit in a letter": headed(HONEST_HEADER.replace("256", "1if 1else 2", 1)),
    "a key less": headed("{'descr': '|u1', 'shape': (256, 256, 32)}"),
    "a key more": headed(HONEST_HEADER.replace("{", "{'x': 1, ")),
    "keys that are no text": headed("{1: 2, 3: 4, 5: 6}"),
    "an unhashable key": headed("{[]: 1}"),
    "order that is a number": headed(HONEST_HEADER.replace("False", "0")),
    "shape of 2**62": shaped("(4611686018427387904, 4, 1)"),
    "shape of 2**64": shaped("(18446744073709551616, 1, 1)", "not_npz"),
    "shape that overflows to ours": shaped("(4294967296, 4294967296, 2097152)"),
    "negative shape": shaped("(-256, -256, 32)", "not_npz"),
    "shape of fractions": shaped("(256.0, 256.0, 32.0)", "not_npz"),
    "shape of truths": shaped("(True, True, True)", "not_npz"),
    "shape of one number": shaped("2097152", "not_npz"),
    "shape of a list": shaped("[256, 256, 32]", "not_npz"),
    "objects": typed("'|O'"),
    "a structure of objects": typed("[('a', '|O')]"),
    "text": typed("'|S1'"),
    "a signed byte": typed("'|i1'"),
    "a type of no name": typed("None"),
}
ARCHIVES: Mapping[str, Case] = {
    "array called twice": ("extra_array", arrays(ARRAY, ARRAY)),
    "array with and without ending": ("extra_array", arrays(ARRAY, replace(ARRAY, name=b"semantics"))),
    "both known keys": ("extra_array", arrays(ARRAY, replace(ARRAY, name=b"arr_0.npy"))),
    "array in a folder": ("missing_array", arrays(replace(ARRAY, name=b"x/semantics.npy"))),
    "array of another case": ("missing_array", arrays(replace(ARRAY, name=b"SEMANTICS.npy"))),
    "array with NUL in its name": ("missing_array", arrays(replace(ARRAY, name=b"semantics.npy\0"))),
    "array of another ending": ("missing_array", arrays(replace(ARRAY, name=b"semantics.npz"))),
    "no array": ("missing_array", arrays()),
    "65 arrays": ("too_large", arrays(*[Entry(b"%d.npy" % index, b"") for index in range(65)])),
    "a bare npy": ("not_npz", lambda: frame(HONEST_NPY)),
    "a pickle": ("not_npz", lambda: frame(b"\x80\x04\x95\x0a\0\0\0\0\0\0\0\x8c\x06system\x94.")),
    "gzip": ("not_npz", lambda: frame(b"\x1f\x8b\x08\0" + bytes(60))),
    "bytes before the array": ("unsupported_zip", lambda: frame(raw_zip([ARRAY], Ending(prefix=b"x" * 9)))),
    "stored and called packed": (
        "truncated",
        arrays(replace(ARRAY, method=0, local={"method": 8}, central={"method": 8})),
    ),
    "packed and called stored": ("not_npz", lambda: frame(raw_zip([Entry(b"semantics.npy", squeezed(HONEST_NPY))]))),
    "packed twice": ("not_npz", lambda: frame(raw_zip([Entry(b"semantics.npy", squeezed(HONEST_NPY), method=8)]))),
    "a stream that stops early": ("unsupported_zip", member(packed=100)),
    "a voxel less": ("truncated", holding(HONEST_NPY[:-1])),
    "a voxel more": ("truncated", holding(HONEST_NPY + b"\0")),
    "3 MiB of voxels": ("bad_shape", lambda: frame(saved(semantics=np.zeros((256, 256, 48), np.uint8)))),
    "wide sizes of 2**62": ("too_large", lambda: frame(raw_zip([stretched(ARRAY, unpacked=2**62)]))),
    "wide sizes that are none": ("truncated", arrays(replace(stretched(ARRAY), extra=wide_extra(1)))),
    "a deflate stream of the reserved kind": (
        "corrupt",
        lambda: frame(
            raw_zip(
                [
                    Entry(
                        b"semantics.npy",
                        b"\xff" * 3000,
                        central={"method": 8, "unpacked": len(HONEST_NPY)},
                        local={"method": 8, "unpacked": len(HONEST_NPY)},
                    )
                ]
            )
        ),
    ),
    "label 128": ("label_out_of_range", lambda: frame(saved(semantics=grid() + np.uint8(128)))),
    "last voxel 4": ("corrupt", lambda: frame(flipped(stored(grid()), len(stored(grid())) - 130))),
}
NPY_CASES = {**HEADERS, **ARCHIVES}
