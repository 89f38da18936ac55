"""The viewer's binary formats: seven zstd-compressed layouts, written here and read in the browser.

| magic | content | after the magic |
|---|---|---|
| `STV1` | a frame's voxels | u32 planes (3); low class bit, high class bit, seen by LiDAR |
| `STD1` | differences of a frame's voxels between two label sets | u32 planes (3); the bits of the code, lowest first |
| `STT1` | the labelled voxels of a tile | u32 n; i32 i j k; u8 class; f32 elevation slope roughness D²; u8 confidence |
| `STM1` | the tile's surface | u32 v, u32 t; f32 x y z a vertex; u8 class a vertex; u32 corners, three a triangle |
| `STC1` | one sweep | u32 n; i16 x y z a point, centimetres in the ego frame; u8 intensity a point |
| `STE1` | radar detections | u32 n; i16 x y z a point, centimetres in the ego frame; i16 speed a point, cm/s |
| `STR1` | the cameras of a playback | u32 cameras, frames, columns, rows; u8 has a picture; f32 rays; f32 poses |

**Conventions.** Little-endian without padding; equal values give equal bytes. A plane has a bit for each voxel of the
scene's grid in C order, the first in the lowest bit.

`STT1` stores its nine arrays one after another. Voxels are sorted by i, then j, then k; a voxel's centre is (index +
0.5) · `map_voxel_m` in the map frame. The confidence is that of `labels.npz`, 0 if unknown; tiles of earlier releases
end before it. Imported labels have only classes, so their elevation, slope, roughness and D² are NaN. Vertices of
`STM1` are relative to the tile's `min_m` (scene.json); class 0 is a vertex outside every voxel. A speed is over ground
along the radar's ray, positive if the distance grows.

`STR1` has the cameras in the order of `playback.json`, in three sections:

- a byte for each frame of each camera, 1 if there is a picture
- for each camera rows × columns unit vectors x y z in its optical frame, through points spread evenly from edge to edge
  of the image, NaN outside the lens's view
- for each frame of each camera `ego_from_camera` as tx ty tz qw qx qy qz: its pose at exposure in the ego frame of the
  labels, NaN if unknown
"""

from dataclasses import dataclass

import numpy as np
import zstandard
from numpy.typing import NDArray

MEDIA_TYPES = {
    "STV1": "application/vnd.stone.voxels",
    "STD1": "application/vnd.stone.differences",
    "STT1": "application/vnd.stone.tile",
    "STM1": "application/vnd.stone.mesh",
    "STC1": "application/vnd.stone.cloud",
    "STE1": "application/vnd.stone.detections",
    "STR1": "application/vnd.stone.cameras",
}
PLANES = 3
LEVEL = 3
CM_PER_M = 100.0
MOST_CM = 2**15 - 1

Floats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class TileVoxels:
    """K voxels of the map: `indices` (K, 3), `classes` (K,) 1 to 3, `features` (K, 3), `distance_squared` (K,).

    `confidence` (K,) is the probability that the class is right, times 255; 0 if unknown.
    """

    indices: NDArray[np.int64]
    classes: NDArray[np.uint8]
    features: Floats
    distance_squared: Floats
    confidence: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class TileMesh:
    """A surface: `vertices_m` (V, 3) from the tile's `min_m`, `classes` (V,) 0 to 3, `triangles` (T, 3) of rows."""

    vertices_m: Floats
    classes: NDArray[np.uint8]
    triangles: NDArray[np.integer]


@dataclass(frozen=True, eq=False)
class PlaybackCameras:
    """C cameras of N frames: `has_picture` (C, N) bool, `rays` (C, rows, columns, 3) unit vectors, optical frame.

    `ego_from_camera` (C, N, 7) is tx ty tz qw qx qy qz, from the pose at exposure to the frame's ego; NaN if unknown.
    """

    has_picture: NDArray[np.bool_]
    rays: Floats
    ego_from_camera: Floats


def voxels_bytes(semantics: NDArray[np.uint8], observed: NDArray[np.uint8]) -> bytes:
    """Return `STV1` of a grid's classes 0 to 3 and mask (0 or 1), both C-ordered."""
    planes = (semantics & 1, semantics >> 1, observed)
    packed = [np.packbits(plane.reshape(-1), bitorder="little").tobytes() for plane in planes]
    return _frame(b"STV1", (PLANES,), packed)


def difference_bytes(codes: NDArray[np.uint8]) -> bytes:
    """Return `STD1` of the codes 0 to 7 of `stone/scoring/agreement.py`, C-ordered."""
    packed = [np.packbits((codes >> bit & 1).reshape(-1), bitorder="little").tobytes() for bit in range(PLANES)]
    return _frame(b"STD1", (PLANES,), packed)


def tile_bytes(voxels: TileVoxels) -> bytes:
    """Return `STT1`; without voxels n is 0."""
    columns = [column.astype("<i4").tobytes() for column in voxels.indices.T]
    columns.append(voxels.classes.astype("u1").tobytes())
    columns += [column.astype("<f4").tobytes() for column in (*voxels.features.T, voxels.distance_squared)]
    columns.append(voxels.confidence.astype("u1").tobytes())
    return _frame(b"STT1", (len(voxels.classes),), columns)


def mesh_bytes(mesh: TileMesh) -> bytes:
    """Return `STM1`."""
    vertices, triangles = mesh.vertices_m.astype("<f4").tobytes(), mesh.triangles.astype("<u4").tobytes()
    counts = (len(mesh.vertices_m), len(mesh.triangles))
    return _frame(b"STM1", counts, [vertices, mesh.classes.astype("u1").tobytes(), triangles])


def cloud_bytes(points_ego: Floats, intensity: Floats) -> bytes:
    """Return `STC1` of points (N, 3), metres, and intensities (N,) 0 to 255; points beyond 327.67 m are left out."""
    cm, is_near = _centimetres(points_ego)
    light = np.clip(np.rint(intensity[is_near]), 0, 255)
    parts = [cm[is_near].astype("<i2").tobytes(), light.astype("u1").tobytes()]
    return _frame(b"STC1", (int(is_near.sum()),), parts)


def detections_bytes(points_ego: Floats, ground_rate_m_s: Floats) -> bytes:
    """Return `STE1` of points (N, 3) and speeds (N,), m/s, without points beyond 327.67 m and non-finite values."""
    cm, is_near = _centimetres(points_ego)
    kept = is_near & np.isfinite(ground_rate_m_s)
    rates = np.clip(np.rint(ground_rate_m_s[kept] * CM_PER_M), -MOST_CM, MOST_CM)
    return _frame(b"STE1", (int(kept.sum()),), [cm[kept].astype("<i2").tobytes(), rates.astype("<i2").tobytes()])


def cameras_bytes(cameras: PlaybackCameras) -> bytes:
    """Return `STR1`."""
    _, rows, columns, _ = cameras.rays.shape
    parts = (cameras.has_picture.astype("u1"), cameras.rays.astype("<f4"), cameras.ego_from_camera.astype("<f4"))
    return _frame(b"STR1", (*cameras.has_picture.shape, columns, rows), [part.tobytes() for part in parts])


def _centimetres(points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return points (N, 3) in whole centimetres, and a mask (N,) of those that fit into two bytes; NaN does not."""
    cm = np.rint(points * CM_PER_M)
    return cm, (np.abs(cm) <= MOST_CM).all(axis=1)


def _frame(magic: bytes, counts: tuple[int, ...], parts: list[bytes]) -> bytes:
    head = magic + np.array(counts, "<u4").tobytes()
    return zstandard.ZstdCompressor(level=LEVEL).compress(b"".join([head, *parts]))
