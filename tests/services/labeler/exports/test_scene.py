"""The map as the viewer is given it: the voxels, the surface and the frames of the labels, and nothing else."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree
from scipy.stats import chi2

from services.domain.viewer.formats import TileMesh, TileVoxels
from services.labeler.exports.meshes import open_mesh
from services.labeler.map.scene_files import SceneDescription, SceneWriter
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_RGB, TRACK
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import RELEASE
from tests.services.labeler.exports.made import Labelled
from tests.services.runtime.view_decoding import Read

Floats = NDArray[np.float64]


def scene_of(drive: Labelled) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((drive.folder / "scene" / "scene.json").read_text())
    return record


def voxels_of(drive: Labelled, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Indices (K, 3), classes (K,), and elevation, slope, roughness and D² (K, 4)."""
    read = Read((drive.folder / "scene" / f"tile_{name}.bin").read_bytes(), b"STT1")
    (count,) = read.values("I", 1)
    indices = np.array([read.values("i", count) for _ in range(3)]).T
    classes = np.array(read.values("B", count), np.int64)
    values = np.array([read.values("f", count) for _ in range(4)]).T
    assert set(read.values("B", count)) <= {0}  # labels of profile local have no confidence
    assert read.is_over()
    return indices, classes, values


@pytest.fixture(scope="module")
def voxels(drive: Labelled) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Of all tiles."""
    parts = [voxels_of(drive, tile["name"]) for tile in scene_of(drive)["tiles"]]
    indices, classes, values = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return indices, classes, values


def test_the_scene_says_of_the_sequence_what_the_sequence_is(drive: Labelled) -> None:
    scene, sequence = scene_of(drive), drive.source().sequence
    assert (scene["name"], scene["profile"], scene["footprint_m"]) == ("drive", "local", [1.06, 0.85])
    assert scene["has_confidence"] is False
    place = {"name": "paper", "shape": [256, 256, 32], "min_m": [-25.6, -25.6, -2.0], "voxel_m": 0.2}
    assert scene["grid"] == place
    assert scene["map_voxel_m"] == 0.2
    assert scene["frames"]["tokens"] == list(sequence.frames.tokens)
    assert scene["frames"]["stamps_ns"] == [str(stamp) for stamp in sequence.frames.stamps_ns.tolist()]
    poses = np.array(scene["frames"]["map_from_ego"])
    np.testing.assert_allclose(poses[:, :3], sequence.frames.map_from_ego.translation_m, atol=1e-4)
    np.testing.assert_allclose(poses[:, 3:], sequence.frames.map_from_ego.wxyz, atol=1e-8)
    reported = drive.report["reference"]
    assert {key: scene["reference"][key] for key in ("mean", "covariance")} == {
        key: reported[key] for key in ("mean", "covariance")
    }
    assert scene["reference"]["d2_limit"] == pytest.approx(chi2.ppf(0.95, 3))


def test_a_scene_names_the_grid_of_its_frames_and_lays_its_tiles_by_the_voxel_of_its_map(
    drive: Labelled, tmp_path: Path
) -> None:
    sequence = drive.source().sequence
    writer = SceneWriter(SceneDescription(sequence, "imported", None, RELEASE, 0.4), tmp_path)
    one, none = np.ones(1), np.zeros((0, 3))
    voxels = TileVoxels(np.array([[-3, 0, 5]]), one, np.ones((1, 3)), one, one)
    writer.add("a", voxels, TileMesh(none, none[:, 0], none), np.zeros(3))
    writer.finish()
    scene = json.loads((tmp_path / "scene" / "scene.json").read_text())
    place = {"name": "release", "shape": [200, 200, 16], "min_m": [-40.0, -40.0, -1.0], "voxel_m": 0.4}
    assert scene["grid"] == place
    assert scene["map_voxel_m"] == 0.4
    assert (scene["tiles"][0]["min_m"], scene["tiles"][0]["max_m"]) == ([-1.2, 0.0, 2.0], [-0.8, 0.4, 2.4])


def test_every_file_of_the_scene_is_told_of_with_its_size(drive: Labelled) -> None:
    scene = scene_of(drive)
    files = {path.name: path.stat().st_size for path in (drive.folder / "scene").iterdir()}
    files.pop("scene.json")
    told = {f"tile_{one['name']}.bin": one["bytes"] for one in scene["tiles"]}
    assert files == told | {f"mesh_{one['name']}.bin": one["bytes"] for one in scene["meshes"]}
    assert max(files.values()) < 2**20


def test_the_tiles_hold_every_voxel_of_the_map_once_in_order(
    drive: Labelled, voxels: tuple[NDArray[np.int64], NDArray[np.int64], Floats]
) -> None:
    indices, classes, _ = voxels
    assert len(np.unique(indices, axis=0)) == len(indices) == drive.report["map"]["voxels"]
    shares = drive.report["profiles"]["class_share"]["local"]
    for kind, name in enumerate(("traversable", "potentially_traversable", "non_traversable"), 1):
        assert (classes == kind).mean() == pytest.approx(shares[name], abs=1e-6)
    for tile in scene_of(drive)["tiles"]:
        mine = voxels_of(drive, tile["name"])[0]
        assert len(mine) == tile["voxels"]
        assert mine.tolist() == sorted(mine.tolist())
        np.testing.assert_allclose(mine.min(axis=0) * VOXEL_M, tile["min_m"], atol=1e-9)
        np.testing.assert_allclose((mine.max(axis=0) + 1) * VOXEL_M, tile["max_m"], atol=1e-9)


def test_the_distance_of_a_voxel_explains_its_class(
    drive: Labelled, voxels: tuple[NDArray[np.int64], NDArray[np.int64], Floats]
) -> None:
    _, classes, values = voxels
    reference = scene_of(drive)["reference"]
    undriven = classes != 1
    assert ((values[undriven, 3] <= reference["d2_limit"]) == (classes[undriven] == 2)).all()
    centred = values[:, :3] - np.array(reference["mean"])
    squared = np.einsum("ki,ij,kj->k", centred, np.linalg.inv(reference["covariance"]), centred)
    np.testing.assert_allclose(values[:, 3], squared, rtol=0.02, atol=0.02)


def test_the_labels_of_a_frame_are_voxels_of_the_map(
    drive: Labelled, voxels: tuple[NDArray[np.int64], NDArray[np.int64], Floats]
) -> None:
    indices, classes, _ = voxels
    scene, source = scene_of(drive), drive.source()
    pose = np.array(scene["frames"]["map_from_ego"][4])
    map_from_ego = SE3(np.concatenate([pose[3:], pose[:3]]))
    semantics = source.grids(4)["semantics"]
    labelled = np.argwhere(semantics)
    centres = map_from_ego @ ((labelled + 0.5) * VOXEL_M + np.array(scene["grid"]["min_m"]))
    gaps, nearest = KDTree((indices + 0.5) * VOXEL_M).query(centres)
    assert gaps.max() < VOXEL_M * 3**0.5
    assert (classes[nearest] == semantics[tuple(labelled.T)]).mean() > 0.97


def test_the_surface_of_the_scene_lies_on_the_mesh(drive: Labelled) -> None:
    scene, mesh = scene_of(drive), open_mesh(drive.folder / "mesh.ply")
    whole, triangles = KDTree(mesh.vertices["xyz"].astype(np.float64)), 0
    lows = {tile["name"]: tile["min_m"] for tile in scene["tiles"]}
    for one in scene["meshes"]:
        read = Read((drive.folder / "scene" / f"mesh_{one['name']}.bin").read_bytes(), b"STM1")
        vertices, count = read.values("I", 2)
        places = np.array(read.values("f", 3 * vertices)).reshape(-1, 3) + np.array(lows[one["name"]])
        assert set(read.values("B", vertices)) <= {0, 1, 2, 3}
        corners = read.values("I", 3 * count)
        assert read.is_over()
        assert set(corners) == set(range(vertices))
        assert count == one["triangles"] <= 40_000
        assert whole.query(places)[0].max() < 0.36
        triangles += count
    assert 0 < triangles <= len(mesh.faces)


def test_the_thumbnail_shows_the_labels_and_the_track(drive: Labelled) -> None:
    picture = Image.open(drive.folder / "thumbnail.png")
    assert (picture.format, picture.mode, picture.size) == ("PNG", "P", (640, 400))
    pixels = np.asarray(picture.convert("RGBA"))[..., :3].reshape(-1, 3)
    for colour in (CLASS_RGB[2], CLASS_RGB[3], TRACK):
        assert (pixels == np.array(colour)).all(axis=1).any()
