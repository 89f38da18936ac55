"""`frames.parquet` by formula: the table of a robot that drives a bend at 10 frames a second.

**Conventions.** Column names and types are those of `services/labeler/tables.py`; a test compares both.
"""

import io
import json
from collections.abc import Sequence
from math import cos, sin
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

FRAME_NS = 100_000_000
CAMERAS = ("CAM_BACK", "CAM_FRONT", "CAM_FRONT_LEFT")
UNFIXED = range(2, 4)
"""Frames whose position was not fixed."""


def frame_columns(
    tokens: Sequence[str], start_ns: int, excluded: Sequence[str] = (), cameras: Sequence[str] = CAMERAS
) -> dict[str, list[Any]]:
    """Return the columns; after the frames one row for each code of `excluded`."""
    count, left = len(tokens), len(excluded)
    steps, none = [float(step) for step in range(count)], [None] * left
    columns: dict[str, list[Any]] = {
        "frame_token": [*tokens, *none],
        "stamp_ns": [start_ns + step * FRAME_NS for step in range(count + left)],
        "x_m": [2.0 * step * cos(0.03 * step) for step in steps] + none,
        "y_m": [2.0 * step * sin(0.03 * step) for step in steps] + none,
        "z_m": [0.3 * sin(0.4 * step) for step in steps] + none,
        "t_voxels": [100 + 10 * int(step) for step in steps] + none,
        "p_voxels": [400 for _ in steps] + none,
        "n_voxels": [700 - 20 * int(step) for step in steps] + none,
        "rtk_status": ["float" if step in UNFIXED else "fixed" for step in range(count)] + none,
        "pose_gap_ns": [20_000_000 for _ in steps] + none,
        **{f"{axis}_stdev_m": [0.012 + 0.001 * step for step in steps] + none for axis in ("east", "north", "up")},
        **{f"{camera}_dt_ns": [4_000_000 for _ in steps] + none for camera in cameras},
        "exclusion_code": [None] * count + list(excluded),
        "exclusion_reason": [None] * count + [f"{code} for a reason" for code in excluded],
    }
    return columns


def frame_table_bytes(
    tokens: Sequence[str],
    start_ns: int,
    seed: bytes = b"",
    excluded: Sequence[str] = (),
    cameras: Sequence[str] = CAMERAS,
) -> bytes:
    """Return the file; `seed` distinguishes files."""
    about = {"sequence": seed.hex(), "pose_source": "/ins (INSPVAX)", "map_origin_deg_m": [48.0, 11.5, 559.0]}
    table = pa.table(frame_columns(tokens, start_ns, excluded, cameras))
    stream = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({"stone": json.dumps(about)}), stream, compression="zstd")
    return stream.getvalue()
