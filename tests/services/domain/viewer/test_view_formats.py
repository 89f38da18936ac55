"""The viewer's formats, read by a decoder that shares nothing with their writer, and golden bytes."""

from typing import Any

import numpy as np
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from services.domain.viewer.formats import (
    PlaybackCameras,
    TileMesh,
    TileVoxels,
    cameras_bytes,
    cloud_bytes,
    detections_bytes,
    mesh_bytes,
    tile_bytes,
    voxels_bytes,
)
from tests.services.runtime.view_decoding import Read

COUNTS = st.integers(0, 40)
NO_NAN = {"allow_nan": False, "allow_infinity": False, "width": 32}


def float32(values: NDArray[Any]) -> list[float]:
    return np.asarray(values, np.float32).ravel().tolist()


@given(seed=st.integers(0, 2**32 - 1))
def test_every_voxel_is_found_at_its_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (4, 3, 32)
    semantics = rng.integers(0, 4, shape, dtype=np.uint8)
    observed = rng.integers(0, 2, shape, dtype=np.uint8)
    read = Read(voxels_bytes(semantics, observed), b"STV1")
    assert read.values("I", 1) == [3]
    planes = [read.values("B", 4 * 3 * 32 // 8) for _ in range(3)]
    assert read.is_over()
    for i, j, k in np.ndindex(shape):
        index = (i * 3 + j) * 32 + k
        low, high, seen = ((plane[index // 8] >> (index % 8)) & 1 for plane in planes)
        assert (low + 2 * high, seen) == (semantics[i, j, k], observed[i, j, k])


@given(count=COUNTS, data=st.data())
def test_a_tile_gives_its_columns_one_after_another(count: int, data: st.DataObject) -> None:
    indices = data.draw(arrays.arrays(np.int64, (count, 3), elements=st.integers(-(2**20), 2**20)))
    classes = data.draw(arrays.arrays(np.uint8, count, elements=st.integers(1, 3)))
    features = data.draw(arrays.arrays(np.float64, (count, 3), elements=st.floats(**NO_NAN)))  # type: ignore[arg-type]
    squared = data.draw(arrays.arrays(np.float64, count, elements=st.floats(0, 2**40, width=32)))
    confidence = data.draw(arrays.arrays(np.uint8, count))
    read = Read(tile_bytes(TileVoxels(indices, classes, features, squared, confidence)), b"STT1")
    assert read.values("I", 1) == [count]
    assert [read.values("i", count) for _ in range(3)] == indices.T.tolist()
    assert read.values("B", count) == classes.tolist()
    assert [read.values("f", count) for _ in range(3)] == [float32(column) for column in features.T]
    assert read.values("f", count) == float32(squared)
    assert read.values("B", count) == confidence.tolist()
    assert read.is_over()


@given(vertices=st.integers(1, 30), triangles=COUNTS, seed=st.integers(0, 2**32 - 1))
def test_a_surface_gives_its_vertices_their_classes_and_its_triangles(vertices: int, triangles: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = TileMesh(
        rng.normal(size=(vertices, 3)),
        rng.integers(0, 4, vertices, dtype=np.uint8),
        rng.integers(0, vertices, (triangles, 3), dtype=np.int32),
    )
    read = Read(mesh_bytes(mesh), b"STM1")
    assert read.values("I", 2) == [vertices, triangles]
    assert read.values("f", 3 * vertices) == float32(mesh.vertices_m)
    assert read.values("B", vertices) == mesh.classes.tolist()
    assert read.values("I", 3 * triangles) == mesh.triangles.ravel().tolist()
    assert read.is_over()


@given(points=arrays.arrays(np.float64, st.tuples(COUNTS, st.just(3)), elements=st.floats(-400, 400)))
def test_a_sweep_keeps_centimetres_and_leaves_out_what_they_cannot_say(points: NDArray[np.float64]) -> None:
    light = np.linspace(-20, 300, len(points))
    read = Read(cloud_bytes(points, light), b"STC1")
    kept = [row for row in range(len(points)) if all(abs(round(100 * value)) <= 32767 for value in points[row])]
    assert read.values("I", 1) == [len(kept)]
    found = np.array(read.values("h", 3 * len(kept))).reshape(-1, 3) / 100
    assert np.abs(found - points[kept]).max(initial=0) <= 0.00501
    assert read.values("B", len(kept)) == [min(max(round(light[row]), 0), 255) for row in kept]
    assert read.is_over()


def test_detections_keep_their_speeds_and_leave_out_what_is_not_known() -> None:
    points = np.array([[1.004, -2.0, 0.5], [np.nan, 0.0, 0.0], [400.0, 0.0, 0.0], [3.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    read = Read(detections_bytes(points, np.array([-1.239, 0.0, 0.0, np.nan, 900.0])), b"STE1")
    assert read.values("I", 1) == [2]
    assert read.values("h", 6) == [100, -200, 50, 500, 0, 0]
    assert read.values("h", 2) == [-124, 32767]
    assert read.is_over()


def test_cameras_give_their_pictures_their_rays_and_their_poses() -> None:
    random = np.random.default_rng(2)
    rays, poses = random.normal(size=(2, 3, 4, 3)), random.normal(size=(2, 5, 7))
    rays[1, 0, 0], poses[0, 4] = np.nan, np.nan
    has_picture = random.random((2, 5)) < 0.5
    read = Read(cameras_bytes(PlaybackCameras(has_picture, rays, poses)), b"STR1")
    assert read.values("I", 4) == [2, 5, 4, 3]
    assert read.values("B", 10) == has_picture.ravel().tolist()
    np.testing.assert_array_equal(read.values("f", rays.size), float32(rays))
    np.testing.assert_array_equal(read.values("f", poses.size), float32(poses))
    assert read.is_over()


def test_the_bytes_are_these() -> None:
    at, kind, sure = np.array([[-1, 2, 3]]), np.array([2], np.uint8), np.array([237], np.uint8)
    voxels = TileVoxels(at, kind, np.array([[0.5, 0.25, -9.0]]), np.array([7.5]), sure)
    content = zstandard.ZstdDecompressor().decompress(tile_bytes(voxels))
    assert content.hex() == ("5354543101000000ffffffff0200000003000000020000003f0000803e000010c10000f040ed")
    content = zstandard.ZstdDecompressor().decompress(cloud_bytes(np.array([[1.0, -2.0, 0.005]]), np.array([9.0])))
    assert content.hex() == "5354433101000000640038ff000009"
    one = PlaybackCameras(np.ones((1, 1), np.bool_), np.full((1, 1, 1, 3), np.nan), np.arange(7.0)[None, None])
    content = zstandard.ZstdDecompressor().decompress(cameras_bytes(one))
    nan, pose = "0000c07f" * 3, "000000000000803f00000040000040400000804000" + "00a0400000c040"
    assert content.hex() == "53545231" + "01000000" * 4 + "01" + nan + pose
