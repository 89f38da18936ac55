"""The frame table of a label set (`frames.parquet`) as arrays: poses, their quality, voxels by class.

**Conventions.** Rows are the usable frames in the order of time; excluded frames are separate. Positions are in the map
frame. Missing values are NaN or ''. A table is immutable and content-addressed, so it is cached.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.runtime.store.protocol import Store

Floats = NDArray[np.float64]
NAME = "frames.parquet"
POSITION, STDEV = ("x_m", "y_m", "z_m"), ("east_stdev_m", "north_stdev_m", "up_stdev_m")
CLASSES = ("t_voxels", "p_voxels", "n_voxels")
PLAIN = ("frame_token", "stamp_ns", "rtk_status", "pose_gap_ns", "exclusion_code", "exclusion_reason")
CAMERA, DELAY = "CAM_", "_dt_ns"
NS_PER_S = 1e9
KEPT = 16


@dataclass(frozen=True)
class ExcludedStamp:
    """A stamp that became no frame, and why."""

    stamp_ns: int
    code: str
    reason: str


@dataclass(frozen=True, eq=False)
class FrameTable:
    """N frames: `stamps_ns` (N,), `positions_map_m` and `stdev_m` (east, north, up) (N, 3), `voxels` T, P, N (N, 3),
    `rtk` one word each; `pictures_dt_ns` by camera (N,), picture minus frame."""

    tokens: tuple[str, ...]
    stamps_ns: NDArray[np.int64]
    positions_map_m: Floats
    voxels: NDArray[np.int64]
    rtk: tuple[str, ...]
    pose_gap_ns: Floats
    stdev_m: Floats
    excluded: tuple[ExcludedStamp, ...]
    pictures_dt_ns: dict[str, Floats]
    pose_source: str
    has_north: bool

    def __len__(self) -> int:
        return len(self.tokens)

    @property
    def times_s(self) -> Floats:
        """Seconds since the first frame."""
        first_ns = self.stamps_ns[0] if len(self) else 0
        return np.asarray((self.stamps_ns - first_ns) / NS_PER_S, np.float64)

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.pictures_dt_ns)


def frame_table(store: Store, key: str) -> FrameTable:
    """Return the table at this key of the store. Raises `ObjectMissingError`."""
    return _read(str(store.local(key)))


@lru_cache(maxsize=KEPT)
def _read(path: str) -> FrameTable:
    import pyarrow.parquet as parquet

    names = parquet.read_schema(path).names
    cameras = [name for name in names if name.startswith(CAMERA) and name.endswith(DELAY)]
    wanted = [name for name in (*PLAIN, *POSITION, *STDEV, *CLASSES, *cameras) if name in names]
    read = parquet.read_table(path, columns=wanted)
    about = json.loads((read.schema.metadata or {}).get(b"stone", b"{}"))
    return table_of({name: read[name].to_pylist() for name in wanted}, about)


def table_of(columns: dict[str, list[Any]], about: dict[str, Any]) -> FrameTable:
    """Return the table of these columns, rows in stamp order; excluded rows have no token."""
    rows = [row for row, token in enumerate(columns["frame_token"]) if token is not None]
    out = [row for row, token in enumerate(columns["frame_token"]) if token is None]

    def floats(name: str) -> Floats:
        values = columns.get(name)
        if values is None:
            return np.full(len(rows), np.nan)
        return np.array([values[row] for row in rows], np.float64)

    def words(name: str, row: int) -> str:
        return (columns.get(name) or [""] * (row + 1))[row] or ""

    cameras = [name for name in columns if name.startswith(CAMERA) and name.endswith(DELAY)]
    return FrameTable(
        tokens=tuple(columns["frame_token"][row] for row in rows),
        stamps_ns=np.array([columns["stamp_ns"][row] for row in rows], np.int64),
        positions_map_m=np.stack([floats(name) for name in POSITION], axis=1),
        voxels=np.nan_to_num(np.stack([floats(name) for name in CLASSES], axis=1)).astype(np.int64),
        rtk=tuple(words("rtk_status", row) for row in rows),
        pose_gap_ns=floats("pose_gap_ns"),
        stdev_m=np.stack([floats(name) for name in STDEV], axis=1),
        excluded=tuple(
            ExcludedStamp(columns["stamp_ns"][row], words("exclusion_code", row), words("exclusion_reason", row))
            for row in out
        ),
        pictures_dt_ns={name.removesuffix(DELAY): floats(name) for name in cameras},
        pose_source=str(about.get("pose_source") or ""),
        has_north=about.get("map_origin_deg_m") is not None,
    )
