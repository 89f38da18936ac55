"""The export opens in nuscenes-devkit, which knows nothing of us, without a warning; every row and file of it.

Catches alone an export that the devkit of others does not open.
"""

import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from services.labeler.exports.nuscenes.layout import write_nuscenes
from stone.labels.class_colours import CLASS_RGB
from stone.labels.voxels import VOXEL_M
from stone.sensors.samples import egos_at
from stone.sensors.sequence import Association, Sequence
from tests.services.labeler.exports.made import Labelled, unheard

pytestmark = pytest.mark.whole

ROOT = Path(__file__).resolve().parents[4]
INSTALL = "deploy/install-devkit.sh"
PYTHON = ROOT / ".venv" / "nuscenes-devkit" / "bin" / "python"
WALK = ROOT / "tests" / "clients" / "devkit" / "walk.py"
CAMERAS = 6
WITHOUT_FRONT = (1, 2)  # frames that miss a picture


@pytest.fixture(scope="module")
def devkit() -> Path:
    if not (PYTHON.parents[1] / "installed").exists():
        pytest.skip(f"nuscenes-devkit is not installed: run {INSTALL}")
    return PYTHON


def walked(devkit: Path, dataroot: Path, scratch: Path, places: tuple[Path, ...] = ()) -> dict[str, Any]:
    environment = {**os.environ, "MPLBACKEND": "Agg", "MPLCONFIGDIR": str(scratch), "OMP_NUM_THREADS": "1"}
    command = [devkit, "-W", "error", "-I", WALK, dataroot, *places]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def out(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive with two pictures of the front camera missing."""
    folder = tmp_path_factory.mktemp("nuscenes")
    source = drive.source()
    taken = source.sequence.frames.associations["CAM_FRONT"]
    index = taken.message_index.copy()
    index[list(WITHOUT_FRONT)] = -1
    gone = Association(taken.topic, index, taken.dt_ns, taken.phase_ns)
    frames = replace(source.sequence.frames, associations={**source.sequence.frames.associations, "CAM_FRONT": gone})
    write_nuscenes(replace(source, sequence=replace(source.sequence, frames=frames)), folder, unheard)
    return folder


@pytest.fixture(scope="module")
def found(devkit: Path, drive: Labelled, out: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    scratch = tmp_path_factory.mktemp("walk")
    (scratch / "places.json").write_text(json.dumps([places.tolist() for places in columns(drive, out)]))
    return walked(devkit, out, scratch, (scratch / "places.json",))


def columns(drive: Labelled, out: Path) -> tuple[Any, Any]:
    """Middles of the 0.2 m columns whose surface is all or in part drivable, and of those where none is, in global."""
    mesh = trimesh.load(drive.folder / "mesh.ply", process=False)
    indices = np.floor(mesh.vertices[:, :2] / VOXEL_M).astype(int)
    colours = np.asarray(mesh.visual.vertex_colors)[:, :3]
    is_drivable = (colours == CLASS_RGB[1]).all(axis=1) | (colours == CLASS_RGB[2]).all(axis=1)
    drivable = {tuple(index) for index in indices[is_drivable].tolist()}
    other = {tuple(index) for index in indices.tolist()} - drivable
    log = json.loads((out / "v1.0-trainval" / "log.json").read_text())[0]
    shift_m = np.array(log["global_from_map_m"][:2])
    return tuple((np.array(sorted(places)) + 0.5) * VOXEL_M + shift_m for places in (drivable, other))  # type: ignore[return-value]


def pinhole_pixels(sequence: Sequence, points_lidar: Any, channel: str, index: int) -> Any:
    """(M, 2) pixels and depth of a sweep in one camera, from our own poses, without any table."""
    mount = sequence.calibration.mount(channel)
    assert mount is not None
    lens = mount.intrinsics
    assert lens is not None
    stamp_ns = int(sequence.frames.stamps_ns[index]) + int(sequence.frames.associations[channel].dt_ns[index])
    poses, is_known = egos_at(sequence, np.array([index]), np.array([stamp_ns]))
    assert is_known.all()
    map_from_ego = poses[0]
    ego_from_lidar = sequence.calibration.ego_from_lidar
    points_map = sequence.frames.map_from_ego[index] @ (ego_from_lidar @ points_lidar.astype(np.float64))
    seen = (map_from_ego @ ego_from_lidar @ mount.lidar_from_sensor).inverse() @ points_map
    x, y, z = seen[seen[:, 2] > 1.0].T
    pixels = np.column_stack([lens.fx_px * x / z + lens.cx_px, lens.fy_px * y / z + lens.cy_px, z])
    inside = (pixels[:, :2] > 1).all(axis=1)
    return pixels[inside & (pixels[:, 0] < lens.width_px - 1) & (pixels[:, 1] < lens.height_px - 1)]


def test_the_devkit_walks_all_of_a_full_rig(drive: Labelled, found: dict[str, Any]) -> None:
    source = drive.source()
    frames = source.sequence.frames
    assert found["rows"]["sample"] == len(frames)
    assert found["rows"]["sensor"] == found["rows"]["calibrated_sensor"] == 1 + CAMERAS + 3
    assert found["rows"]["sample_data"] == found["rows"]["ego_pose"] == sum(found["chains"].values())
    assert found["chains"]["LIDAR_TOP"] == len(frames)
    assert len(found["files"]) == 14
    assert found["scenes"] == ["drive"]
    assert found["boxes"] == 0
    assert "drive" in found["said"]
    assert found["held"]["LIDAR_TOP"] == sum(
        len(source.samples.lidar(index).points_lidar) for index in range(len(frames))
    )
    assert found["held"]["RADAR_FRONT"] > 0


def test_the_devkit_projects_points_where_we_do(drive: Labelled, found: dict[str, Any]) -> None:
    source = drive.source()
    middle = len(source.sequence.frames) // 2
    points_lidar = source.samples.lidar(middle).points_lidar
    assert len(found["projected"]) == CAMERAS
    for channel, pixels in found["projected"].items():
        ours = pinhole_pixels(source.sequence, points_lidar, channel, middle)
        assert len(ours) > 0
        assert len(pixels) == len(ours)
        # the devkit moves float32 points through a global frame tens of metres away
        np.testing.assert_allclose(np.array(pixels), ours, atol=0.02)


def test_the_map_mask_is_white_where_the_robot_could_drive(found: dict[str, Any]) -> None:
    on_drivable, on_other = found["on_mask"]
    assert len(on_drivable) > 50
    assert all(on_drivable)
    assert len(on_other) > 50
    assert not any(on_other)
    assert min(found["drawn_map"]) > 0.001


def test_a_frame_may_lack_a_camera(drive: Labelled, found: dict[str, Any]) -> None:
    count = len(drive.source().sequence.frames)
    assert found["chains"]["CAM_FRONT"] == count - len(WITHOUT_FRONT)
    assert all(found["chains"][channel] == count for channel in ("CAM_BACK", "CAM_FRONT_LEFT", "RADAR_FRONT"))
