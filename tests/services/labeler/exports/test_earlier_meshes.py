"""Meshes of label sets that were made while pictures had the paper's colours: other bytes, the same classes."""

import io
from pathlib import Path

import numpy as np
import pytest

from services.labeler.exports.errors import DamagedLabelsError
from services.labeler.exports.mesh_parts import mesh_parts
from services.labeler.exports.meshes import write_glb
from services.labeler.exports.nuscenes.map_mask import mask_of
from services.labeler.exports.ply_file import open_mesh
from services.labeler.map.ply import FACE, VERTEX, write_mesh

EARLIER_HEADER = b"""ply
format binary_little_endian 1.0
comment map frame, metres; green traversable, yellow potentially traversable, red non-traversable
element vertex 8
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 4
property list uchar int vertex_indices
end_header
"""
EARLIER_RGB = np.array([(128, 128, 128), (38, 166, 91), (250, 205, 80), (176, 42, 55)], np.uint8)
CLASSES = np.array([0, 1, 2, 3, 1, 2, 3, 1], np.uint8)
PLACES = np.arange(24, dtype=np.float32).reshape(8, 3)
TRIANGLES = np.array([(0, 1, 2), (2, 3, 4), (4, 5, 6), (5, 6, 7)], np.int32)


def earlier_bytes(header: bytes = EARLIER_HEADER) -> bytes:
    vertices, faces = np.empty(8, VERTEX), np.empty(4, FACE)
    vertices["xyz"], vertices["rgb"] = PLACES, EARLIER_RGB[CLASSES]
    faces["n"], faces["indices"] = 3, TRIANGLES
    return header + vertices.tobytes() + faces.tobytes()


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    (tmp_path / "earlier.ply").write_bytes(earlier_bytes())
    return tmp_path / "earlier.ply"


@pytest.fixture
def today(tmp_path: Path) -> Path:
    write_mesh(tmp_path / "mesh.ply", (8, 4), [lambda: (PLACES, TRIANGLES, CLASSES)])
    return tmp_path / "mesh.ply"


def test_an_earlier_mesh_has_its_classes(earlier: Path, today: Path) -> None:
    """Catches alone a nuScenes map mask that is black all over, without an error."""
    old, new = open_mesh(earlier), open_mesh(today)
    assert old.classes(slice(None)).tolist() == new.classes(slice(None)).tolist() == CLASSES.tolist()
    places_m = np.zeros((1, 2))
    np.testing.assert_array_equal(mask_of(old, places_m).is_drivable, mask_of(new, places_m).is_drivable)
    assert mask_of(old, places_m).is_drivable.any()


def test_exports_of_an_earlier_mesh_have_today_s_colours(earlier: Path, today: Path) -> None:
    """Catches alone an export whose surface has other colours than its labels."""
    assert earlier.read_bytes() != today.read_bytes()
    for old, new in zip(mesh_parts(earlier), mesh_parts(today), strict=True):
        np.testing.assert_array_equal(old.rgb, new.rgb)
    files = io.BytesIO(), io.BytesIO()
    for file, path in zip(files, (earlier, today), strict=True):
        write_glb(file, open_mesh(path))
    assert files[0].getvalue() == files[1].getvalue()


@pytest.mark.parametrize(
    "header",
    [
        EARLIER_HEADER.replace(b"property uchar red\n", b"property uchar blue\n"),
        EARLIER_HEADER.replace(b"element face 4", b"element face 3"),
        EARLIER_HEADER.replace(b"format", b"comment of ours\nformat").replace(b"ply\n", b"PLY\n"),
    ],
)
def test_a_header_that_lays_the_file_out_otherwise_is_refused(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "mesh.ply").write_bytes(earlier_bytes(header))
    with pytest.raises(DamagedLabelsError, match="promises"):
        open_mesh(tmp_path / "mesh.ply")
