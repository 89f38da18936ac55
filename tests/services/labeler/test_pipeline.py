"""The whole labeler on small worlds that are ray-cast in closed form; what it refuses, and that a run which ends early
leaves nothing behind."""

import io
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from services.labeler.local_run import LabelOptions, label
from services.labeler.map.ply import FACE, HEADER, VERTEX
from services.labeler.parameters import LabelParameters, TilingParameters, parameters_for
from stone.labels.class_colours import CLASS_RGB
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Box
from stone.sensors.sequence import ExcludedFrame
from stone_base.label_grid import PAPER
from testing.refusals import refused_as
from tests.services.labeler.worlds import RayCast, World, sequence_of

ROOT = Path(__file__).resolve().parents[3]
BOX = Box((1.5, 2.0, 0.0), (2.7, 3.2, 1.4))
WORLD = World(grade=(0.06, 0.02), boxes=(BOX,))
LEFT_OUT = (
    ExcludedFrame(1_759_999_999_000_000_000, "pose_gap", "no pose within 250 ms"),
    ExcludedFrame(1_760_000_000_050_000_000, "no_pose", "the odometry had not begun"),
)


def labelled(world, folder, workers=1, **options):
    sequence = replace(sequence_of(world), excluded=LEFT_OUT)
    return label(sequence, RayCast(world), folder, LabelOptions(workers=workers, **options))


def grids(folder, world=WORLD):
    """(F, 256, 256, 32) semantics of all frames in order."""
    tokens = sequence_of(world).frames.tokens
    return np.stack([np.load(folder / "gts" / "small" / token / "labels.npz")["semantics"] for token in tokens])


def differing_ratio(a, b):
    """Share of the voxels occupied in either that differ."""
    return (a != b).sum() / ((a > 0) | (b > 0)).sum()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("labels") / "out"
    labelled(WORLD, folder, workers=2)
    return folder


def test_every_frame_has_its_labels_and_nothing_else_is_left(made):
    tokens = set(sequence_of(WORLD).frames.tokens)
    files = {
        "frames.parquet",
        "mesh.ply",
        "bev.png",
        "map.png",
        "features.png",
        "report.json",
        "sequence.npz",
        "grid.json",
    }
    assert {path.name for path in made.iterdir()} == {"gts", "scene", "thumbnail.png", *files}
    assert {path.name for path in (made / "gts").iterdir()} == {"small"}
    assert {path.name for path in (made / "gts" / "small").iterdir()} == tokens
    assert [path.name for path in made.parent.iterdir()] == ["out"]
    for token in tokens:
        assert [path.name for path in (made / "gts" / "small" / token).iterdir()] == ["labels.npz"]


def test_label_files_hold_four_grids_of_bytes(made):
    for path in made.glob("gts/small/*/labels.npz"):
        with np.load(path, allow_pickle=False) as arrays:
            assert arrays.files == ["semantics", "mask_lidar", "mask_camera", "late"]
            assert {arrays[name].shape for name in arrays.files} == {PAPER.shape}
            assert {arrays[name].dtype for name in arrays.files} == {np.dtype(np.uint8)}
            assert set(np.unique(arrays["semantics"])) == {0, 1, 2, 3}
            assert set(np.unique(arrays["mask_lidar"])) == {0, 1}
            assert set(np.unique(arrays["mask_camera"])) == {0, 1}
            assert (arrays["mask_lidar"] >= arrays["mask_camera"]).all()
            assert (arrays["mask_lidar"] >= arrays["late"]).all()
            assert arrays["mask_lidar"][arrays["semantics"] > 0].all()


def test_traversable_ground_is_under_the_robot_in_every_frame(made):
    middle = [round(-low / VOXEL_M) for low in PAPER.min_m]
    x, y, z = (slice(at - 2, at + 2) for at in middle)
    for semantics in grids(made):
        assert (semantics[x, y, z] == 1).any(axis=2).all()
        assert not (semantics[x, y] == 3).any()


def test_the_box_is_not_traversable_and_the_ground_beside_it_is(made):
    semantics = grids(made)[0]
    start = sequence_of(WORLD).frames.map_from_ego[0].inverse() @ WORLD.placed()
    walls = start @ np.array([[1.5, 2.6, 0.9], [2.1, 2.0, 0.9]])
    for i, j, k in np.floor((walls - np.array(PAPER.min_m)) / VOXEL_M).astype(int):
        assert 3 in semantics[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2]
    x, y, z = np.floor((start @ np.array([-1.0, -1.5, -0.09]) - np.array(PAPER.min_m)) / VOXEL_M).astype(int)
    assert set(np.unique(semantics[x - 2 : x + 3, y - 2 : y + 3, z - 2 : z + 3])) == {0, 2}


def test_nothing_is_labelled_where_no_ray_came(made):
    x = (np.arange(PAPER.shape[0]) + 0.5) * VOXEL_M + PAPER.min_m[0]
    frames = sequence_of(WORLD).frames
    reach_m = WORLD.reach_m + WORLD.step_m * WORLD.frames + 0.6
    away = np.hypot(*np.meshgrid(x, x, indexing="ij")) > reach_m
    assert len(frames) == 12
    assert not grids(made)[:, away].any()


@pytest.mark.whole
def test_the_number_of_workers_changes_no_byte(made, tmp_path):
    labelled(WORLD, tmp_path / "alone")
    names = {path.relative_to(made) for path in made.rglob("*") if path.is_file()}
    assert names == {path.relative_to(tmp_path / "alone") for path in (tmp_path / "alone").rglob("*") if path.is_file()}
    for name in names - {Path("report.json")}:
        assert (made / name).read_bytes() == (tmp_path / "alone" / name).read_bytes(), name
    a, b = (json.loads((folder / "report.json").read_text()) for folder in (made, tmp_path / "alone"))
    assert {key for key in a if a[key] != b[key]} <= {"stages_busy_s", "cpu_s", "peak_bytes"}


@pytest.mark.whole
def test_moving_the_world_by_a_whole_tile_moves_the_labels(made, tmp_path):
    world = replace(WORLD, map_from_world=(1.0, 0, 0, 0, 24.0 + 48.0, 24.0 - 96.0, 0))
    labelled(world, tmp_path / "there")
    # the same tiles elsewhere: only the rounding of map coordinates is left
    assert differing_ratio(grids(made), grids(tmp_path / "there")) < 0.002


@pytest.mark.whole
def test_moving_and_yawing_the_world_moves_the_labels(made, tmp_path):
    world = replace(WORLD, map_from_world=(np.cos(0.35), 0, 0, np.sin(0.35), 22.3, 25.1, 0.0))
    labelled(world, tmp_path / "there")
    here, there = grids(made), grids(tmp_path / "there")
    # the surface crosses another lattice, so a voxel may change place with its neighbour, but the ground is the same
    assert ((here > 0).sum(), 1.0) == pytest.approx(((there > 0).sum(), 1.0), rel=0.1)
    a, b = (np.max(np.where(g > 0, g, 0), axis=3) for g in (here, there))
    both = (a > 0) & (b > 0)
    assert both.sum() > 0.95 * ((a > 0) | (b > 0)).sum()
    assert (a[both] == b[both]).mean() > 0.9


@pytest.mark.whole
def test_it_does_not_matter_how_the_map_is_cut_into_tiles(tmp_path):
    """Catches alone labels that differ at the border of a tile.

    The same world on the corner of four tiles, and within one larger tile.
    """
    # at this grade no height on the lattice is a border of voxels, where the last bit would choose between two
    world = replace(WORLD, grade=(0.0613, 0.0227), map_from_world=(1.0, 0, 0, 0, 48.0, 48.0, 0))
    untiled = replace(LabelParameters(), tiling=TilingParameters(cube_cells=512))
    labelled(world, tmp_path / "corner")
    labelled(world, tmp_path / "whole", parameters=untiled)
    tiles = [json.loads((tmp_path / name / "report.json").read_text())["map"]["tiles"] for name in ("whole", "corner")]
    assert tiles == [1, 4]
    assert differing_ratio(grids(tmp_path / "whole"), grids(tmp_path / "corner")) < 0.0005


def test_the_report_tells_what_was_made_from_what_and_how(made):
    report = json.loads((made / "report.json").read_text())
    assert report["sequence"] == "small"
    assert report["frames"] == 12
    assert report["code_version"]
    assert report["inputs"] == {"small.mcap": "ab" * 32}
    assert report["parameters"]["profile"] == "paper"
    assert report["parameters"]["reference"]["alpha"] == 0.05
    assert report["parameters"]["surface"]["width_m"] == 0.2
    assert [row["code"] for row in report["excluded"]] == ["pose_gap", "no_pose"]
    assert report["excluded"][0]["reason"] == "no pose within 250 ms"
    assert (report["refinement"], report["parameters"]["refinement"]) == (None, None), "which nobody asked for"
    assert sum(report["class_share_of_occupied"].values()) == pytest.approx(1, abs=1e-5)
    assert np.shape(report["reference"]["mean"]) == (3,)
    assert np.shape(report["reference"]["covariance"]) == (3, 3)
    assert report["reference"]["voxels"] > 4
    assert set(report["stages_busy_s"]) == {"fuse", "surface", "frames", "pictures"}
    assert min(report["stages_busy_s"].values()) > 0
    assert report["peak_bytes"]["all_processes"] >= report["peak_bytes"]["largest_process"] > 2**26
    assert report["cpu_s"] > 0
    assert {"LAB-601", "LAB-603"} <= {finding["code"] for finding in report["findings"]}


def test_the_report_knows_the_slope_of_the_ground(made):
    reference = json.loads((made / "report.json").read_text())["reference"]
    assert reference["mean"][1] == pytest.approx(np.arctan(np.hypot(0.06, 0.02)), abs=np.radians(0.5))
    assert reference["mean"][0] == pytest.approx(0.0, abs=0.05)


def test_the_frame_table_has_a_row_per_stamp_excluded_ones_too(made):
    rows = pq.read_table(made / "frames.parquet").to_pylist()
    assert [row["stamp_ns"] for row in rows] == sorted(row["stamp_ns"] for row in rows)
    assert len(rows) == 14
    usable = [row for row in rows if row["exclusion_code"] is None]
    frames = sequence_of(WORLD).frames
    assert [row["frame_token"] for row in usable] == list(frames.tokens)
    pose = np.array([[row[c] for c in ("qw", "qx", "qy", "qz", "x_m", "y_m", "z_m")] for row in usable])
    np.testing.assert_array_equal(pose, frames.map_from_ego.wxyz_xyz)
    left_out = [row for row in rows if row["exclusion_code"] is not None]
    assert [(r["exclusion_code"], r["frame_token"]) for r in left_out] == [("pose_gap", None), ("no_pose", None)]
    for row, semantics in zip(usable, grids(made), strict=True):
        counted = [row[c] for c in ("free_voxels", "t_voxels", "p_voxels", "n_voxels")]
        assert counted == np.bincount(semantics.ravel(), minlength=4).tolist()


def test_the_mesh_is_a_ply_of_whole_triangles_in_the_colours_of_the_classes(made):
    file = io.BytesIO((made / "mesh.ply").read_bytes())
    lines = [file.readline().decode().strip() for _ in HEADER.splitlines()]
    assert lines[0] == "ply"
    assert lines[-1] == "end_header"
    vertices, faces = (int(line.split()[2]) for line in lines if line.startswith("element"))
    xyz = np.frombuffer(file.read(vertices * VERTEX.itemsize), VERTEX)
    triangles = np.frombuffer(file.read(faces * FACE.itemsize), FACE)
    assert file.read() == b""
    assert (triangles["n"] == 3).all()
    assert 0 <= triangles["indices"].min() <= triangles["indices"].max() < vertices
    assert set(CLASS_RGB.values()) <= {tuple(row) for row in np.unique(xyz["rgb"], axis=0).tolist()}
    on_ground = xyz["xyz"][:, :2] - 24.0
    height = xyz["xyz"][:, 2] - on_ground @ [0.06, 0.02]
    assert np.percentile(np.abs(height[np.abs(on_ground[:, 1] + 3) < 2]), 95) < 0.05


def test_the_top_view_opens_and_shows_all_three_classes(made):
    with Image.open(made / "bev.png") as picture:
        colours = {colour[:3] for _, colour in picture.convert("RGBA").getcolors(1 << 24)}
    assert set(CLASS_RGB.values()) <= colours


BARE = World(grade=(0.06, 0.02))


@pytest.mark.whole
def test_an_earlier_label_set_is_replaced_with_progress_told_and_a_foreign_folder_is_refused(tmp_path):
    seen, world = [], replace(BARE, frames=2)
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.txt").write_text("years of work")
    with refused_as("output_exists"):
        labelled(world, tmp_path / "home")
    assert [path.name for path in (tmp_path / "home").iterdir()] == ["thesis.txt"]
    (tmp_path / "earlier" / "gts" / "old").mkdir(parents=True)
    (tmp_path / "earlier" / "report.json").write_text("{}")
    options = LabelOptions(parameters_for("local"))
    label(sequence_of(world), RayCast(world), tmp_path / "earlier", options, lambda *step: seen.append(step))
    stages = list(dict.fromkeys(stage for stage, _, _ in seen))
    assert stages == ["Fuse sweeps", "Reconstruct the surface", "Draw pictures of the map", "Label frames"]
    for stage in stages:
        steps = [(done, total) for name, done, total in seen if name == stage]
        assert steps == [(done, steps[-1][1]) for done in range(steps[-1][1] + 1)]
    assert json.loads((tmp_path / "earlier" / "report.json").read_text())["reference"]["is_floored"]
    assert [path.name for path in (tmp_path / "earlier" / "gts").iterdir()] == ["small"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["earlier", "home"]


def test_a_sequence_without_usable_frames_is_refused(tmp_path):
    sequence = replace(sequence_of(replace(BARE, frames=1)), excluded=LEFT_OUT)
    none = replace(sequence.frames, stamps_ns=sequence.frames.stamps_ns[:0], tokens=())
    empty = replace(sequence, frames=replace(none, map_from_ego=none.map_from_ego[:0]))
    with refused_as("no_frames", match=r"2 .*no_pose, pose_gap"):
        label(empty, RayCast(BARE), tmp_path / "out")
    with refused_as("no_frames"):
        label(replace(empty, excluded=()), RayCast(BARE), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("width_m", "reach_m"), [(0.0, 7.0), (0.85, 0.0)], ids=["no footprint", "nothing seen"])
def test_a_track_that_touches_no_surface_leaves_no_folder(tmp_path, width_m, reach_m):
    world = replace(BARE, frames=2, reach_m=reach_m)
    sequence = sequence_of(world)
    rig = replace(sequence.calibration, footprint=replace(sequence.calibration.footprint, width_m=width_m))
    with refused_as("no_reference"):
        label(replace(sequence, calibration=rig), RayCast(world), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_worker_that_fails_leaves_no_folder(tmp_path):
    with pytest.raises(RuntimeError, match="this sweep cannot be read"):
        labelled(replace(BARE, frames=4, breaks_at=2), tmp_path / "out", workers=2)
    assert list(tmp_path.iterdir()) == []


SHOWN = """
import sys
from pathlib import Path
from services.labeler.local_run import label
from tests.services.labeler.worlds import RayCast, World, sequence_of

def shown(stage, done, total):
    print(stage, done, flush=True)

if __name__ == "__main__":
    world = World(frames=6)
    label(sequence_of(world), RayCast(world), Path(sys.argv[1]), progress=shown)
"""


@pytest.mark.whole
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_killing_the_run_leaves_no_output_folder(tmp_path, number):
    (tmp_path / "run.py").write_text(SHOWN)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(tmp_path / "run.py"), str(tmp_path / "out")]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        begun = next(line for line in run.stdout if line.startswith("Reconstruct"))
        assert begun == "Reconstruct the surface 0\n"
        run.send_signal(number)
        run.stdout.close()
        assert run.wait(300) in (128 + number, -number)
    assert not (tmp_path / "out").exists()
    left = [path for path in tmp_path.iterdir() if path.name != "run.py"]
    assert (left == []) == (number == signal.SIGTERM)  # kill −9 leaves a hidden staging folder for the next run
    assert all(path.name.startswith(".out.") for path in left)
