"""Meshes as other programs read them: trimesh opens both, and the glTF holds what the standard demands; those that were
made while pictures had the paper's colours have the same classes."""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from services.labeler.exports import meshes
from services.labeler.exports.meshes import MeshFile, mesh_parts, open_mesh, write_glb, write_meshes
from services.labeler.exports.nuscenes.layout import mask_of
from services.labeler.map.ply import BARE_VERTEX, FACE, VERTEX, write_mesh
from testing.refusals import refused_as
from tests.services.labeler.exports.made import Labelled, unheard


@pytest.fixture(scope="module")
def out(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    write_meshes(drive.source(), folder, unheard)
    return folder


def chunks_of(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The document and the buffer, every length and word of the container checked."""
    magic, version, total = struct.unpack_from("<4s2I", content)
    assert (magic, version, total) == (b"glTF", 2, len(content))
    found, at = [], 12
    while at < total:
        length, kind = struct.unpack_from("<I4s", content, at)
        assert length % 4 == 0
        found.append((kind, content[at + 8 : at + 8 + length]))
        at += 8 + length
    assert at == total
    assert [kind for kind, _ in found] in ([b"JSON", b"BIN\0"], [b"JSON"])
    return json.loads(found[0][1]), found[1][1] if len(found) > 1 else b""


def test_both_open_in_trimesh_with_the_same_surface(out: Path) -> None:
    ply = trimesh.load(out / "drive" / "mesh.ply", process=False)
    scene = trimesh.load(out / "drive" / "mesh.glb", process=False)
    (glb,) = scene.geometry.values()
    x, y, z = glb.vertices.T
    np.testing.assert_array_equal(np.stack([x, -z, y], axis=1), ply.vertices)
    np.testing.assert_array_equal(glb.faces, ply.faces)
    np.testing.assert_array_equal(glb.visual.vertex_attributes["color"], ply.visual.vertex_colors)
    assert len(np.unique(ply.visual.vertex_colors, axis=0)) >= 3


def test_the_container_and_its_accessors_hold_what_the_standard_demands(out: Path) -> None:
    document, buffer = chunks_of((out / "drive" / "mesh.glb").read_bytes())
    assert document["asset"]["version"] == "2.0"
    assert document["buffers"] == [{"byteLength": len(buffer)}]
    widths, taken = {("VEC3", 5126): 12, ("VEC4", 5121): 4, ("SCALAR", 5125): 4}, 0
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] == taken
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == accessor["count"] * widths[accessor["type"], accessor["componentType"]]
        taken += view["byteLength"]
    assert taken == len(buffer)
    position, _colour, indices = document["accessors"]
    points = np.frombuffer(buffer, "<f4", 3 * position["count"]).reshape(-1, 3)
    assert position["min"] == points.min(axis=0).tolist()
    assert position["max"] == points.max(axis=0).tolist()
    start = document["bufferViews"][2]["byteOffset"]
    assert np.frombuffer(buffer, "<u4", offset=start).max() < position["count"]
    assert indices["count"] % 3 == 0


def test_parts_of_any_size_give_the_same_bytes(drive: Labelled, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshes, "ROWS_AT_ONCE", 1000)
    file = io.BytesIO()
    write_glb(file, open_mesh(drive.folder / "mesh.ply"))
    assert file.getvalue() == (out / "drive" / "mesh.glb").read_bytes()


def test_a_map_without_surface_is_an_empty_scene() -> None:
    file = io.BytesIO()
    write_glb(file, MeshFile(np.zeros(0, VERTEX), np.zeros(0, FACE)))
    document, buffer = chunks_of(file.getvalue())
    assert document["scenes"] == [{}]
    assert buffer == b""


def test_a_mesh_beyond_what_the_format_can_say_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshes, "MOST_BYTES", 100)
    with refused_as("mesh_too_large"):
        write_glb(io.BytesIO(), MeshFile(np.zeros(3, VERTEX), np.zeros(1, FACE)))


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
    vertices, faces = np.empty(8, BARE_VERTEX), np.empty(4, FACE)
    vertices["xyz"], vertices["rgb"] = PLACES, EARLIER_RGB[CLASSES]
    faces["n"], faces["indices"] = 3, TRIANGLES
    return header + vertices.tobytes() + faces.tobytes()


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    (tmp_path / "earlier.ply").write_bytes(earlier_bytes())
    return tmp_path / "earlier.ply"


@pytest.fixture
def today(tmp_path: Path) -> Path:
    write_mesh(tmp_path / "mesh.ply", (8, 4), [lambda: (PLACES, -PLACES, TRIANGLES, CLASSES)])
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
    "content",
    [
        earlier_bytes(EARLIER_HEADER.replace(b"property uchar red\n", b"property uchar blue\n")),
        earlier_bytes(EARLIER_HEADER.replace(b"element face 4", b"element face 3")),
        earlier_bytes(EARLIER_HEADER.replace(b"format", b"comment of ours\nformat").replace(b"ply\n", b"PLY\n")),
        earlier_bytes()[:-1],
        b"",
        b"ply\nelement vertex many\n",
        b"PK\3\4" * 100,
    ],
)
def test_a_file_that_is_laid_out_otherwise_cut_off_or_not_ours_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "mesh.ply").write_bytes(content)
    with refused_as("damaged_labels"):
        open_mesh(tmp_path / "mesh.ply")
