"""A fast reader for single grids of a frame's `labels.npz`.

**Conventions.** Only what `stone_files/npz.py` wrote, or an import found to be as good (`stone_datasets/labels.py`):
members `<key>.npy`, deflated or stored, C order, uint8.
"""

import io
import struct
import zipfile
from collections.abc import Iterable

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from services.runtime.store.protocol import Store
from stone.errors import PlatformFaultError

SHAPE = (256, 256, 32)
SHOWN_GRIDS = ("semantics", "mask_lidar")
HEADS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
LOCAL_HEAD_BYTES, NAME_AT = 30, 26


class GridUnreadableError(PlatformFaultError):
    """The store holds other bytes for a frame's labels than were published."""

    code = "grid_unreadable"

    def __init__(self, key: str, reason: str) -> None:
        super().__init__(f"grid {key!r} of a frame cannot be read: {reason}; was the store changed by hand?")


def stored_grids(store: Store, object_key: str, span: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Classes and what was seen, of the label file in these bytes of an object. Raises `GridUnreadableError`."""
    semantics, seen = read_grids(b"".join(store.read(object_key, *span)), SHOWN_GRIDS)
    return semantics, seen


def read_grids(payload: bytes, keys: Iterable[str]) -> list[NDArray[np.uint8]]:
    """The grids (256, 256, 32) of these keys, in their order. Raises `GridUnreadableError`."""
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as archive:
            infos = [(key, archive.getinfo(f"{key}.npy")) for key in keys]
    except (zipfile.BadZipFile, KeyError, ValueError, OSError) as error:
        raise GridUnreadableError("", str(error)) from error
    return [_grid(payload, key, info) for key, info in infos]


def _grid(payload: bytes, key: str, info: zipfile.ZipInfo) -> NDArray[np.uint8]:
    try:
        npy = io.BytesIO(_member(payload, info))
        shape, is_fortran, dtype = HEADS[np.lib.format.read_magic(npy)](npy)
        if (shape, is_fortran, dtype) != (SHAPE, False, np.dtype(np.uint8)):
            raise ValueError(f"it is {dtype} {shape}")
        return np.frombuffer(npy.getbuffer()[npy.tell() :], np.uint8).reshape(SHAPE)
    except (ValueError, KeyError, struct.error, isal_zlib.error) as error:  # type: ignore[misc]  # the stub knows no class
        raise GridUnreadableError(key, str(error)) from error


def _member(payload: bytes, info: zipfile.ZipInfo) -> bytes:
    names = info.header_offset + NAME_AT
    name_bytes, extra_bytes = struct.unpack_from("<2H", payload, names)
    begin = info.header_offset + LOCAL_HEAD_BYTES + name_bytes + extra_bytes
    content = payload[begin : begin + info.compress_size]
    if info.compress_type == zipfile.ZIP_STORED:
        return content
    return bytes(isal_zlib.decompress(content, wbits=-15))
