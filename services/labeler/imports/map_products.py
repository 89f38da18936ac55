"""Products of the map of imported labels: top view, mesh, the viewer's scene, a picture in perspective.

**Conventions.** The map consists of voxels with classes. It has no features: in the scene they are NaN, and there is no
picture of them. The surface consists of voxel faces. Memory holds one tile, and all columns of the top view.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh, TileVoxels
from services.labeler.imports.fused_labels import TILE_VOXELS, FusedLabels
from services.labeler.map.map_files import MESH, THUMBNAIL, TOP_VIEW
from services.labeler.map.ply import Piece, write_mesh
from services.labeler.map.scene_files import MOST_TRIANGLES, SceneDescription, SceneWriter
from services.labeler.previews.map_picture import TopView, write_top_view
from services.labeler.previews.map_pieces import MapPiece
from services.labeler.previews.thumbnail import write_thumbnail
from services.labeler.run import Step, Tile
from services.labeler.scratch import load, save, tile_name
from stone.geometry.lattice import BIAS, MASK, Keys, find, indices_of, keys_from_indices, table_of
from stone.labels.voxels import VOXEL_M
from stone.sensors.sequence import Sequence
from stone_datasets.faults import DatasetPlace
from stone_datasets.index import label_folder
from stone_files.dataset_faults import DatasetFaultError

PROFILE = "imported"
SLAB_VOXELS = 256  # the perspective picture holds dense blocks


@dataclass(frozen=True)
class MapFacts:
    """Counts for the report."""

    tiles: int
    voxels: int
    vertices: int
    triangles: int


@dataclass(frozen=True, eq=False)
class _Made:
    """A tile of the map: `voxels` and `surface` are its files, `slabs` the heights of its slabs."""

    voxels: Path
    surface: Path
    slabs: tuple[int, ...]
    size: tuple[int, int, int]  # voxels, vertices, triangles


def write_map_products(fused: FusedLabels, sequence: Sequence, folders: tuple[Path, Path], step: Step) -> MapFacts:
    """Write all products into the first folder; the second is for intermediate files.

    Raises `DST-071`, `DST-072`.
    """
    out, scratch = folders
    step(0, 4)
    view, scene = TopView({}), SceneWriter(SceneDescription(sequence, PROFILE, None, fused.bricks.grid), out)
    made = [_tile(tile, (view, scene), scratch) for tile in fused.tiles()]
    if not made:
        labels_place = DatasetPlace(label_folder(sequence.name))
        raise DatasetFaultError("DST-071", labels_place, f"no voxel of {len(sequence.frames)} frames is T, P or N")
    scene.finish()
    step(1, 4)
    poses = sequence.frames.map_from_ego
    write_top_view(out / TOP_VIEW, view, poses)
    write_thumbnail(out / THUMBNAIL, view, poses)
    voxels, vertices, triangles = (sum(tile.size[at] for tile in made) for at in range(3))
    step(2, 4)
    write_mesh(out / MESH, (vertices, triangles), [partial(_piece, tile) for tile in made])
    step(3, 4)
    from services.labeler.previews.map_view import write_map_oblique  # imports a drawing library: half a second
    from services.labeler.previews.preview_files import MAP

    write_map_oblique([slab for tile in made for slab in _slabs(tile)], poses, out / MAP)
    step(4, 4)
    return MapFacts(len(made), voxels, vertices, triangles)


def _tile(fused: tuple[Tile, Keys, NDArray[np.uint8]], into: tuple[TopView, SceneWriter], scratch: Path) -> _Made:
    (tile, keys, classes), (view, scene) = fused, into
    view.add(tile, keys, classes)  # type: ignore[arg-type]
    nothing = np.full((len(keys), 3), np.nan)
    voxels = TileVoxels(indices_of(keys), classes, nothing, nothing[:, 0], np.zeros(len(keys), np.uint8))
    corner_m = np.array([tile.i, tile.j, 0.0]) * TILE_VOXELS * VOXEL_M
    mesh = exposed_faces(keys, classes, VOXEL_M)
    shown = mesh
    if len(mesh.triangles) > MOST_TRIANGLES:
        shown = few_faces(*coarser(keys, classes), 2 * VOXEL_M, MOST_TRIANGLES)
    scene.add(tile_name(tile), voxels, shown, corner_m)
    files = [scratch / f"{tile_name(tile)}.{kept}.npz" for kept in ("voxels", "surface")]
    vertices = mesh.vertices_m.astype(np.float32)
    save(files[0], {"keys": keys, "classes": classes})
    save(files[1], {"vertices": vertices, "triangles": mesh.triangles, "kinds": mesh.classes})
    slabs = tuple(np.unique(_slabs_of(keys)).tolist())
    return _Made(files[0], files[1], slabs, (len(keys), len(vertices), len(mesh.triangles)))


def _piece(made: _Made) -> Piece:
    arrays = load(made.surface)
    vertices: NDArray[np.float32] = arrays["vertices"]  # type: ignore[assignment]
    return vertices, np.full_like(vertices, np.nan), arrays["triangles"], arrays["kinds"]  # type: ignore[return-value]


def _slabs(made: _Made) -> Iterator[Callable[[], MapPiece]]:
    """Yield the tile in flat pieces, so that each is a small block of voxels however far apart the voxels are."""
    return (partial(_slab, made, height) for height in made.slabs)


def _slabs_of(keys: Keys) -> NDArray[np.int64]:
    return ((keys & MASK) - BIAS) // SLAB_VOXELS


def _slab(made: _Made, height: int) -> MapPiece:
    arrays = load(made.voxels)
    keys, classes = arrays["keys"].astype(np.int64), arrays["classes"].astype(np.uint8)
    if len(made.slabs) > 1:
        is_in = _slabs_of(keys) == height
        keys, classes = keys[is_in], classes[is_in]
    return MapPiece(keys, np.zeros((len(keys), 3)), classes)


# The surface of a voxel map: uncovered faces of voxels, except those that face down. A face is two triangles,
# counter-clockwise seen from outside. Faces of voxels of one class share their corners, so each vertex has one class.
# Voxels are on a lattice of `size_m`, corners at multiples of it.

# East, west, north, south, up; below, the corners of each face, counter-clockwise seen from outside.
TOWARDS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1)], np.int64)
CORNERS = np.array(
    [
        [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
        [(0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)],
        [(1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)],
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
        [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    ],
    np.int64,
)
HALVES = np.array([(0, 1, 2), (0, 2, 3)])


def exposed_faces(keys: Keys, classes: NDArray[np.uint8], size_m: float) -> TileMesh:
    """Return the surface of voxels (K,) with these classes; vertices in metres of the lattice."""
    voxels, sides = np.nonzero(_is_open(keys))
    corners = (indices_of(keys)[voxels, None, :] + CORNERS[sides]).reshape(-1, 3)
    kinds = classes[voxels].repeat(4)
    _, first, rows = np.unique(_number_corners(corners, kinds), return_index=True, return_inverse=True)
    triangles = rows.reshape(-1, 4)[:, HALVES].reshape(-1, 3)
    return TileMesh(corners[first] * size_m, kinds[first], triangles.astype(np.int32))


def coarser(keys: Keys, classes: NDArray[np.uint8]) -> tuple[Keys, NDArray[np.uint8]]:
    """Return voxels of twice the size, each with the highest class in it, which is the most cautious."""
    order = np.argsort(keys_from_indices(indices_of(keys) >> 1), kind="stable")
    halved = keys_from_indices(indices_of(keys[order]) >> 1)
    first = np.flatnonzero(np.append(True, np.diff(halved) != 0)[: len(halved)])
    return halved[first], np.maximum.reduceat(classes[order], first) if len(first) else classes


def few_faces(keys: Keys, classes: NDArray[np.uint8], size_m: float, most_triangles: int) -> TileMesh:
    """Return the surface with at most `most_triangles`, from larger voxels if necessary."""
    while 2 * int(_is_open(keys).sum()) > most_triangles:
        keys, classes = coarser(keys, classes)
        size_m *= 2
    return exposed_faces(keys, classes, size_m)


def _is_open(keys: Keys) -> NDArray[np.bool_]:
    """Return the faces (K, 5) that no other voxel covers."""
    table, is_open = table_of(keys), np.zeros((len(keys), len(TOWARDS)), np.bool_)
    _open(keys, (table.keys, table.rows), TOWARDS, is_open)
    return is_open


def _number_corners(corners: NDArray[np.int64], kinds: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return a number for each corner and class: 20 bits per axis from the lowest corner on, 2 for the class."""
    low = corners.min(axis=0, initial=1 << 40) if len(corners) else np.zeros(3, np.int64)
    i, j, k = (corners - low).T
    return np.asarray((((i << 20 | j) << 21 | k) << 2) | kinds.astype(np.int64), dtype=np.int64)


@njit(cache=True, nogil=True)
def _open(keys, table, towards, is_open):  # type: ignore[no-untyped-def]
    """Mark open faces; a neighbour's key differs by a constant, since no axis carries within the lattice."""
    for voxel in range(keys.size):
        for side in range(towards.shape[0]):
            step = (towards[side, 0] << 42) + (towards[side, 1] << 21) + towards[side, 2]
            is_open[voxel, side] = find(table[0], table[1], keys[voxel] + step) < 0
