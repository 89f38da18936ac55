"""nuScenes tables of an export: finding exports, and reading a table row by row.

**Conventions.** Exports write one row per line; only wanted rows are kept. Exports are not trusted: rows are checked,
sizes bounded.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone_exports.files import ExportFileSpan, Files, FolderFiles, TarFiles
from stone_files.archives import tar_spans_of

TABLES = "v1.0-trainval"
SAMPLE_DATA = f"{TABLES}/sample_data.json"
FARTHEST_POSE_M = 1e7
EXPORTED = re.compile(
    rf"(.*/)?({TABLES}/[a-z_]+\.json|samples/[A-Z0-9_]+/[^/]+\.(jpg|pcd|pcd\.bin)|gts/[^/]+/[0-9a-f-]{{32,36}}/labels\.npz)"
)


class NotExportedError(StoneError):
    """The path is not an export with LiDAR sweeps."""

    code = "not_an_export"

    def __init__(self, path: Path) -> None:
        super().__init__(
            f"{path} contains no nuScenes tables; expected a folder from `stone export --format nuscenes` or "
            "`inputs`, a downloaded tar, or a folder of these"
        )


def exports_in(path: Path) -> tuple[Files, ...]:
    """Return the exports at a path: a folder, a tar, or a folder of folders and tars.

    Raises `NotExportedError`, `bad_tar`.
    """
    if path.is_file():
        exports = tuple(_exports_in_tar(path))
    elif (path / SAMPLE_DATA).is_file():
        return (FolderFiles(path),)
    else:
        exports = tuple(export for child in sorted(path.iterdir()) for export in _exports_at(child))
    if not exports:
        raise NotExportedError(path)
    return exports


def table_rows(files: Files, name: str) -> Iterator[Mapping[str, Any]]:
    """Yield the rows of a table. Raises `DamagedExportError`."""
    span = files.span(f"{TABLES}/{name}.json")
    if span is None:
        raise table_span(files, name).damaged("it is missing")
    for line in span.lines():
        text = line.strip().rstrip(b",")
        if text in (b"", b"[", b"]", b"[]"):
            continue
        try:
            row = json.loads(text)
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            raise span.damaged("a line is not a table row (exports write one row per line)")
        yield row


def table_span(files: Files, name: str) -> ExportFileSpan:
    """Return the file of a table; for a missing table, an empty file that errors can name."""
    return files.span(f"{TABLES}/{name}.json") or ExportFileSpan(files.path, f"{TABLES}/{name}.json", 0, 0)


def row_pose(files: Files, table: str, row: Mapping[str, Any], farthest_m: float) -> SE3:
    """Return the pose in a row's `rotation` (wxyz) and `translation`. Raises `DamagedExportError` if it is invalid."""
    try:
        wxyz = np.array(row["rotation"], np.float64)
        translation_m = np.array(row["translation"], np.float64)
    except (KeyError, ValueError, TypeError, OverflowError):
        wxyz, translation_m = np.zeros(0), np.zeros(0)
    is_sound = wxyz.shape == (4,) and translation_m.shape == (3,)
    if not is_sound or not abs(np.linalg.norm(wxyz) - 1) < 1e-3 or not (np.abs(translation_m) < farthest_m).all():
        raise table_span(files, table).damaged("the rotation and translation of a row are not a pose")
    return SE3(np.concatenate([wxyz, translation_m]))


def poses_in(files: Files) -> dict[str, SE3]:
    """Return the poses of the robot, `global_from_ego`, by token. Raises `DamagedExportError`."""
    rows = table_rows(files, "ego_pose")
    return {str(row.get("token")): row_pose(files, "ego_pose", row, FARTHEST_POSE_M) for row in rows}


def stamp_of(files: Files, table: str, row: Mapping[str, Any]) -> int:
    """Return the row's timestamp in microseconds. Raises `DamagedExportError`."""
    stamp = row.get("timestamp")
    if type(stamp) is not int or not -(1 << 62) < stamp < 1 << 62:
        raise table_span(files, table).damaged("the timestamp of a row is not a number of microseconds")
    return stamp


def _exports_at(child: Path) -> Iterable[Files]:
    if child.is_dir() and (child / SAMPLE_DATA).is_file():
        return (FolderFiles(child),)
    return _exports_in_tar(child) if child.suffix == ".tar" and child.is_file() else ()


def _exports_in_tar(path: Path) -> Iterator[Files]:
    """Yield the exports in a tar: every folder with tables."""
    places = tar_spans_of(path, lambda name: EXPORTED.fullmatch(name) is not None)
    for name in places:
        if name == SAMPLE_DATA or name.endswith(f"/{SAMPLE_DATA}"):
            yield TarFiles(path, places, name.removesuffix(SAMPLE_DATA))
