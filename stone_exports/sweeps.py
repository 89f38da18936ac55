"""LiDAR sweeps in exports of the nuScenes layout, with labels or without: found by frame token, read one by one.

**Conventions.** Tables are read row by row, a row on each line, as exports write them; of a table only what is wanted
is held. `ego_from_lidar` is what `calibrated_sensor` says. Nothing outside is trusted: rows are checked, sizes bounded.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone_exports.files import ExportFileSpan, Files, FolderFiles, TarFiles
from stone_exports.tar_index import tar_spans_of

TABLES = "v1.0-trainval"
SAMPLE_DATA = f"{TABLES}/sample_data.json"
WANTED = re.compile(rf"(.*/)?({TABLES}/(sample_data|calibrated_sensor|sensor)\.json|samples/LIDAR_TOP/[^/]+\.pcd\.bin)")
CHANNEL = "LIDAR_TOP"
COLUMNS = 5  # x y z intensity ring
MOST_SWEEP_BYTES = 256 * 2**20
FARTHEST_M, FARTHEST_RETURN_M = 100.0, 1e5


class NotExportedError(StoneError):
    """What was given is no export with LiDAR sweeps."""

    code: ClassVar[str] = "not_an_export"

    def __init__(self, path: Path) -> None:
        super().__init__(
            f"{path} holds no nuScenes tables: expected is a folder of `stone export --format nuscenes` or `inputs`, a "
            "tar that was downloaded, or a folder of these"
        )


@dataclass(frozen=True, eq=False)
class SweepFile:
    """The file of a sweep, and the sensor's mount."""

    span: ExportFileSpan
    ego_from_lidar: SE3

    def points_ego(self) -> NDArray[np.float32]:
        """Points (N, 3) in the ego frame; what is no place near a sensor is left out. Raises `DamagedExportError`."""
        content = self.span.read(MOST_SWEEP_BYTES)
        if len(content) % (COLUMNS * 4):
            raise self.span.damaged(f"its {len(content)} bytes are no rows of {COLUMNS} float32")
        returns = np.frombuffer(content, "<f4").reshape(-1, COLUMNS)[:, :3]
        points_lidar = returns[(np.abs(returns) < FARTHEST_RETURN_M).all(axis=1)].astype(np.float64)
        points_ego: NDArray[np.float32] = (self.ego_from_lidar @ points_lidar).astype(np.float32)
        return points_ego


def exports_in(path: Path) -> tuple[Files, ...]:
    """The exports that a path names: a folder, a tar, or a folder of folders and tars.

    Raises `NotExportedError`, `BadTarError`.
    """
    if path.is_file():
        found = tuple(_exports_in_tar(path))
    elif (path / SAMPLE_DATA).is_file():
        return (FolderFiles(path),)
    else:
        found = tuple(one for child in sorted(path.iterdir()) for one in _exports_at(child))
    if not found:
        raise NotExportedError(path)
    return found


def sweeps_in(files: Files, tokens: AbstractSet[str]) -> dict[str, SweepFile]:
    """The sweeps of those frames among `tokens` that the export has. Raises `DamagedExportError`."""
    mounts = _mounts(files)
    found = dict[str, SweepFile]()
    for row in _rows(files, "sample_data"):
        mount = mounts.get(str(row.get("calibrated_sensor_token")))
        token = row.get("sample_token")
        if mount is None or token not in tokens or row.get("is_key_frame") is not True:
            continue
        filename = str(row.get("filename"))
        span = files.span(filename)
        if span is None:
            raise _table(files, "sample_data").damaged(f"it names {filename[:200]!r}, which is not there")
        found[str(token)] = SweepFile(span, mount)
    return found


def _exports_at(child: Path) -> Iterable[Files]:
    if child.is_dir() and (child / SAMPLE_DATA).is_file():
        return (FolderFiles(child),)
    return _exports_in_tar(child) if child.suffix == ".tar" and child.is_file() else ()


def _exports_in_tar(path: Path) -> Iterator[Files]:
    """Exports in the tar: every folder that has tables."""
    places = tar_spans_of(path, lambda name: WANTED.fullmatch(name) is not None)
    for name in places:
        if name == SAMPLE_DATA or name.endswith(f"/{SAMPLE_DATA}"):
            yield TarFiles(path, places, name.removesuffix(SAMPLE_DATA))


def _mounts(files: Files) -> Mapping[str, SE3]:
    """`ego_from_lidar` by the token of the calibrated sensor."""
    sensors = {str(row.get("token")) for row in _rows(files, "sensor") if row.get("channel") == CHANNEL}
    rows = (row for row in _rows(files, "calibrated_sensor") if row.get("sensor_token") in sensors)
    return {str(row.get("token")): _mount(files, row) for row in rows}


def _mount(files: Files, row: Mapping[str, Any]) -> SE3:
    try:
        wxyz = np.array(row["rotation"], np.float64)
        translation_m = np.array(row["translation"], np.float64)
    except (KeyError, ValueError, TypeError, OverflowError):
        wxyz, translation_m = np.zeros(0), np.zeros(0)
    is_sound = wxyz.shape == (4,) and translation_m.shape == (3,)
    if not is_sound or not abs(np.linalg.norm(wxyz) - 1) < 1e-3 or not (np.abs(translation_m) < FARTHEST_M).all():
        raise _table(files, "calibrated_sensor").damaged("a LiDAR's rotation or translation is no pose")
    return SE3(np.concatenate([wxyz, translation_m]))


def _table(files: Files, name: str) -> ExportFileSpan:
    return files.span(f"{TABLES}/{name}.json") or ExportFileSpan(files.path, f"{TABLES}/{name}.json", 0, 0)


def _rows(files: Files, name: str) -> Iterator[Mapping[str, Any]]:
    """The rows of a table. Raises `DamagedExportError`."""
    span = files.span(f"{TABLES}/{name}.json")
    if span is None:
        raise _table(files, name).damaged("it is not there")
    for line in span.lines():
        text = line.strip().rstrip(b",")
        if text in (b"", b"[", b"]", b"[]"):
            continue
        try:
            row = json.loads(text)
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            raise span.damaged("a line is no row of a table (one row a line, as exports write them)")
        yield row
