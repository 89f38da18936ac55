"""Meshes as other programs read them: trimesh opens both, and the glTF holds what the standard demands."""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from services.labeler.exports import meshes
from services.labeler.exports.errors import DamagedLabelsError, MeshTooLargeError
from services.labeler.exports.meshes import write_glb, write_meshes
from services.labeler.exports.ply_file import MeshFile, open_mesh
from services.labeler.map.ply import FACE, VERTEX
from tests.services.labeler.exports.made import Labelled, files_of, unheard


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


def test_the_ground_is_level_in_the_axes_of_gltf(out: Path) -> None:
    scene = trimesh.load(out / "drive" / "mesh.glb", process=False)
    (glb,) = scene.geometry.values()
    upward = np.abs(glb.face_normals[:, 1])
    assert np.median(upward) > np.median(np.abs(glb.face_normals[:, 2]))
    assert np.ptp(glb.vertices[:, 1]) < np.ptp(glb.vertices[:, 0])


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


def test_exporting_again_gives_the_same_bytes(drive: Labelled, out: Path, tmp_path: Path) -> None:
    write_meshes(drive.source(), tmp_path, unheard)
    assert files_of(tmp_path) == files_of(out)


def test_a_map_without_surface_is_an_empty_scene() -> None:
    file = io.BytesIO()
    write_glb(file, MeshFile(np.zeros(0, VERTEX), np.zeros(0, FACE)))
    document, buffer = chunks_of(file.getvalue())
    assert document["scenes"] == [{}]
    assert buffer == b""


def test_a_mesh_beyond_what_the_format_can_say_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshes, "MOST_BYTES", 100)
    with pytest.raises(MeshTooLargeError, match="use the PLY"):
        write_glb(io.BytesIO(), MeshFile(np.zeros(3, VERTEX), np.zeros(1, FACE)))


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "cannot be read"), (b"ply\nelement vertex many\n", "cannot be read"), (b"PK\3\4" * 100, "cannot be read")],
)
def test_a_mesh_that_is_not_ours_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "mesh.ply").write_bytes(content)
    with pytest.raises(DamagedLabelsError, match=reason):
        open_mesh(tmp_path / "mesh.ply")


def test_a_mesh_that_was_cut_off_is_refused(drive: Labelled, tmp_path: Path) -> None:
    (tmp_path / "mesh.ply").write_bytes((drive.folder / "mesh.ply").read_bytes()[:-1])
    with pytest.raises(DamagedLabelsError, match="promises"):
        open_mesh(tmp_path / "mesh.ply")
