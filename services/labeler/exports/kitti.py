"""The SemanticKITTI format: voxels in its scene completion layout, for SemanticKITTI readers.

    dataset/sequences/<NN>/  voxels/<i>.{bin,label,invalid,occluded}  velodyne/<i>.bin  calib.txt  poses.txt  times.txt

**Conventions.** The voxels have the labels' grid, x slowest and z fastest, as in SemanticKITTI (256 × 256 × 32). But
the grid surrounds the robot ([−25.6, 25.6) m forward in the paper's grid), while SemanticKITTI's starts at the sensor.
Scans are in the ego frame (SemanticKITTI: Velodyne), so that scan and voxels share one frame; remission is the recorded
intensity. `bin`: contains a return of this sweep; `label`: the class, uint16; `invalid`: unobserved in all sweeps of
the run; `occluded`: hidden from this frame's LiDAR behind labelled voxels. Bits are packed eight to a byte, the first
in the highest. Poses are those of cam0, relative to the first frame; cam0 is the ego frame with KITTI's camera axes
(`Tr`). Source: semantic-kitti-api (auxiliary/SSCDataset.py, generate_sequential.py,
auxiliary/shaders/draw_voxels.vert).
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step
from stone.geometry.se3 import SE3, Array, wxyz_from_rotation
from stone.labels.class_colours import CLASS_NAME, CLASS_RGB
from stone.labels.columns import Words, gathered, spread_out
from stone.labels.sight_batches import LANES, SightBatch
from stone.labels.visibility import sight_lines
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.samples import LidarSample
from stone.sensors.sequence import Sequence
from stone_base.label_grid import LabelGrid

SEQUENCES = Path("dataset") / "sequences"
CONFIG = "semantic-kitti-stone.yaml"
# x right is −y, y down is −z, z forward is x.
CAM0_FROM_EGO = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
# A sixth of all directions: six such cameras around a LiDAR cover its whole view.
QUARTER = CameraIntrinsics("pinhole", 256, 256, 128.0, 128.0, 128.0, 128.0)
FACES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


def write_kitti(source: LabelledSequence, out: Path, step: Step) -> None:
    """Write the sequence as number 00 into the empty folder `out`.

    Raises what reading samples raises (BAG-*, MSG-*), `damaged_labels`.
    """
    sequence, folder = source.sequence, out / SEQUENCES / "00"
    for name in ("voxels", "velodyne"):
        (folder / name).mkdir(parents=True)
    lidar, total = _all_around(sequence.calibration.ego_from_lidar, source.grid), len(sequence.frames)
    for begin in range(0, total, LANES):
        batch = range(begin, min(begin + LANES, total))
        occupied = np.stack([gathered(source.grids(index)["semantics"]) for index in batch])
        for index, visible in zip(batch, lidar.visible(occupied), strict=True):
            _write_frame(source, index, visible, folder)
            step(index + 1, total)
    _write_track(folder, sequence)
    write_config(out, {sequence.name: 0})


def write_config(folder: Path, numbers: Mapping[str, int]) -> None:
    """Write the classes and sequences (name → number) for semantic-kitti-api; all sequences are for training."""
    names = {0: "free", **{kind: name.replace(" ", "-") for kind, name in CLASS_NAME.items()}}
    colours = {0: (0, 0, 0), **CLASS_RGB}
    listed = sorted(numbers.items(), key=lambda pair: pair[1])
    lines = [
        "# Voxel classes of the STONE platform, for semantic-kitti-api",
        "name: stone",
        "labels:", *(f"  {kind}: {name}" for kind, name in names.items()),
        "color_map: # bgr", *(f"  {kind}: [{b}, {g}, {r}]" for kind, (r, g, b) in colours.items()),
        "learning_map:", *(f"  {kind}: {kind}" for kind in names),
        "learning_map_inv:", *(f"  {kind}: {kind}" for kind in names),
        "learning_ignore:", *(f"  {kind}: {'true' if kind == 0 else 'false'}" for kind in names),
        "split:", f"  train: [{', '.join(str(number) for _, number in listed)}]", "  valid: []", "  test: []",
        "sequences:", *(f"  {number}: {name!r}" for name, number in listed),
    ]  # fmt: skip
    (folder / CONFIG).write_text("\n".join(lines) + "\n", "utf-8")


def packed(grid: NDArray[np.uint8] | NDArray[np.bool_]) -> bytes:
    """Return eight voxels per byte, the first in the highest bit."""
    return np.packbits(grid.reshape(-1) != 0, bitorder="big").tobytes()


def _write_frame(source: LabelledSequence, index: int, visible: Words, folder: Path) -> None:
    grids, name = source.grids(index), f"{index:06d}"
    scan = _in_ego(source.samples.lidar(index), source.sequence.calibration.ego_from_lidar)
    contents = {
        "bin": packed(_occupied_voxels(scan[:, :3], source.grid)),
        "label": grids["semantics"].astype("<u2").tobytes(),
        "invalid": packed(grids["mask_lidar"] == 0),
        "occluded": packed(spread_out(~visible, height=source.grid.shape[2])),
    }
    for suffix, content in contents.items():
        (folder / "voxels" / f"{name}.{suffix}").write_bytes(content)
    (folder / "velodyne" / f"{name}.bin").write_bytes(scan.astype("<f4").tobytes())


def _in_ego(sample: LidarSample, ego_from_lidar: SE3) -> NDArray[np.float64]:
    """Return (N, 4): x y z in the ego frame, remission."""
    return np.column_stack([ego_from_lidar @ sample.points_lidar.astype(np.float64), sample.intensity])


def _occupied_voxels(points_ego: NDArray[np.float64], label_grid: LabelGrid) -> NDArray[np.bool_]:
    """Return the voxels of the grid that contain a point."""
    indices = np.floor((points_ego - np.array(label_grid.min_m)) / label_grid.voxel_m).astype(np.int64)
    inside = ((indices >= 0) & (indices < np.array(label_grid.shape))).all(axis=1)
    grid = np.zeros(label_grid.shape, np.bool_)
    grid[tuple(indices[inside].T)] = True
    return grid


def _all_around(ego_from_lidar: SE3, grid: LabelGrid) -> SightBatch:
    """Return six pinholes at the LiDAR, the faces of a cube."""
    lines = []
    for face in FACES:
        forward = np.array(face, np.float64)
        right = np.roll(forward, 1)
        rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose = SE3.from_parts(wxyz_from_rotation(rotation), ego_from_lidar.translation_m)
        lines.append(sight_lines(QUARTER, pose, grid))
    return SightBatch(lines, grid)


def _write_track(folder: Path, sequence: Sequence) -> None:
    frames = sequence.frames
    cam0 = SE3.from_matrix(CAM0_FROM_EGO)
    poses = (cam0 @ (frames.map_from_ego[0].inverse() @ frames.map_from_ego) @ cam0.inverse()).as_matrix()
    seconds = (frames.stamps_ns - frames.stamps_ns[0]) * 1e-9
    (folder / "poses.txt").write_text("".join(_line(pose[:3]) for pose in poses), "utf-8")
    (folder / "times.txt").write_text("".join(f"{second:.9e}\n" for second in seconds), "utf-8")
    projection = _line(np.eye(4)[:3])
    named = [*((f"P{camera}", projection) for camera in range(4)), ("Tr", _line(CAM0_FROM_EGO[:3]))]
    (folder / "calib.txt").write_text("".join(f"{name}: {line}" for name, line in named), "utf-8")


def _line(rows: Array) -> str:
    return " ".join(f"{value:.12e}" for value in rows.reshape(-1)) + "\n"
