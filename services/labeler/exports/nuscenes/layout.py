"""The release layout: nuScenes tables and samples, Occ3D labels. Start reading here.

    v1.0-trainval/<table>.json   samples/<CHANNEL>/n001-<UTC>__<CHANNEL>__<µs>.{jpg,pcd.bin,pcd}
    gts/<sequence>/<frame_token>/labels.npz   maps/<token>.png

**Conventions.** As in `services/labeler/exports/nuscenes/samples.py`. The map is shifted by whole metres until all its
coordinates are positive; its mask marks drivable ground. Labels of a grid that has a number for unknown voxels are the
array `label`, as in the released dataset; other labels are copied files. Imported datasets are written as published:
their own tables, samples and maps, byte for byte.
"""

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.meshes import MeshFile, open_mesh
from services.labeler.exports.nuscenes.plan import NuscenesPlan, channels_of
from services.labeler.exports.nuscenes.samples import write_samples
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step
from stone.errors import Refused
from stone.labels.voxels import VOXEL_M
from stone_base.label_quality import quality_of
from stone_exports.labels import RELEASED_KEY
from stone_files.npz import npz_bytes


def write_nuscenes(source: LabelledSequence, out: Path, step: Step) -> None:
    """Write the sequence into the empty folder `out`.

    Raises what `write_samples` raises, `damaged_labels`, `map_too_large`, `DamagedExportError`.
    """
    sequence, frames = source.sequence, source.sequence.frames

    def label(index: int) -> None:
        labels = out / "gts" / sequence.name / frames.tokens[index] / "labels.npz"
        labels.parent.mkdir(parents=True)
        labels.write_bytes(_label_file(source, index))
        step(index + 1, len(frames))

    if source.published is None:
        _write_recorded(source, out, label)
        return
    source.published.write(out)
    if (out / "gts").is_dir():  # label files of another layout, as published
        step(len(frames), len(frames))
        return
    for index in range(len(frames)):
        label(index)


def _label_file(source: LabelledSequence, index: int) -> bytes:
    """Return the labels of a frame in the layout of its grid; imported labels as published."""
    unknown = source.grid.unknown
    if unknown is None or source.published is not None:
        return source.labels(index)
    grids = source.grids(index)
    is_unknown = (grids["mask_lidar"] == 0) & (grids["semantics"] == 0)
    return npz_bytes({RELEASED_KEY: np.where(is_unknown, np.uint8(unknown), grids["semantics"])})


def _write_recorded(source: LabelledSequence, out: Path, label: Callable[[int], None]) -> None:
    """Write tables, samples and maps of a recorded sequence; `label` is called for each frame."""
    sequence = source.sequence
    mask = mask_of(open_mesh(source.mesh), sequence.frames.map_from_ego.translation_m[:, :2])
    plan = NuscenesPlan(sequence, channels_of(sequence), mask.low_m, quality_of(source.report).as_record())
    (out / "maps").mkdir()
    write_mask(out / plan.mask_filename, mask)
    write_samples(source.samples, plan, out, label)


# The map of a sequence in the form of nuScenes maps: white where the robot could drive, black elsewhere, 0.1 m per
# pixel. The devkit places a mask's lower left corner at the origin of its global frame, so the map is shifted by whole
# metres to positive coordinates. A column is white if any of its surfaces is traversable or potentially traversable.
# Source: `MapMask` of nuscenes-devkit 1.2.


PIXELS_A_VOXEL = 2
VERTICES_AT_ONCE = 1 << 20
MARGIN_M = 1
# The devkit draws 40 m around the robot at any yaw, and crops the mask there without checking its border.
VIEW_M = 60
MOST_SIDE_M = 6000


@dataclass(frozen=True, eq=False)
class Mask:
    """`is_drivable` (X, Y) by voxel column from `low_m` (2,), whole metres in the map frame."""

    low_m: tuple[int, int]
    is_drivable: NDArray[np.bool_]


def mask_of(mesh: MeshFile, places_m: NDArray[np.float64]) -> Mask:
    """Return the mask of a mesh, covering it and the view from `places_m` (N, 2). Raises `map_too_large`."""
    corners = list(places_m)
    for rows in _parts(mesh):
        xy = mesh.vertices["xyz"][rows, :2]
        corners += [xy.min(axis=0), xy.max(axis=0)]
    mask = _blank(places_m, np.array(corners))
    for rows in _parts(mesh):
        xy = mesh.vertices["xyz"][rows, :2][np.isin(mesh.classes(rows), (1, 2))]
        x, y = np.floor((xy.astype(np.float64) - mask.low_m) / VOXEL_M).astype(np.int64).T
        mask.is_drivable[x, y] = True
    return mask


def blank_mask(places_m: NDArray[np.float64]) -> Mask:
    """Return a black mask that covers the view from `places_m` (N, 2). Raises `map_too_large`."""
    return _blank(places_m, places_m)


def _blank(places_m: NDArray[np.float64], corners_m: NDArray[np.float64]) -> Mask:
    """Return a black mask that covers the view from `places_m` (N, 2) and the points `corners_m` (M, 2)."""
    low_m = np.minimum(places_m.min(axis=0) - VIEW_M, corners_m.min(axis=0))
    high_m = np.maximum(places_m.max(axis=0) + VIEW_M, corners_m.max(axis=0))
    low, high = np.floor(low_m).astype(np.int64) - MARGIN_M, np.ceil(high_m).astype(np.int64) + MARGIN_M
    if (high - low > MOST_SIDE_M).any():
        raise Refused(
            "map_too_large",
            f"the map spans {float(high[0] - low[0]):.0f} × {float(high[1] - low[1]):.0f} m, but the limit is "
            f"{MOST_SIDE_M:.0f} m per side; did a pose of the recording jump?",
        )
    size = np.round((high - low) / VOXEL_M).astype(np.int64)
    return Mask((int(low[0]), int(low[1])), np.zeros((int(size[0]), int(size[1])), np.bool_))


def write_mask(path: Path, mask: Mask) -> None:
    """Write an eight-bit grey PNG, row by row from the north (PNG 1.2: IHDR, IDAT, IEND)."""
    width, height = (side * PIXELS_A_VOXEL for side in mask.is_drivable.shape)
    deflate = zlib.compressobj(6)
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)))
        for column in mask.is_drivable.T[::-1]:
            row = b"\0" + np.repeat(column.astype(np.uint8) * 255, PIXELS_A_VOXEL).tobytes()
            if packed := deflate.compress(row * PIXELS_A_VOXEL):
                file.write(_chunk(b"IDAT", packed))
        file.write(_chunk(b"IDAT", deflate.flush()) + _chunk(b"IEND", b""))


def _parts(mesh: MeshFile) -> list[slice]:
    return [slice(begin, begin + VERTICES_AT_ONCE) for begin in range(0, len(mesh.vertices), VERTICES_AT_ONCE)]


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
