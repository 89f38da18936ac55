"""`mask_camera` of labelled voxels against strict rays: `python -m benchmarks.camera_sight LABELS`.

LABELS is a folder of `stone label` from a recording with cameras. A ray from the camera stops in the first labelled
voxel (`testing.rays`, which shares no code with the mask). As in Occ3D, a voxel is lit if one of `RAYS` rays to random
places on its sides that face the camera ends in it. A second column uses only the ray to the voxel's middle. Rows are
by the angle between the ray to the middle and the horizontal, at the nearest camera with the voxel in its image.
"""

import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.source import LabelledSequence, folder_source
from stone.geometry.se3 import SE3
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Mount
from stone.sensors.projection import project
from stone_base.label_grid import PAPER
from stone_recordings.sync.samples import checked_samples
from testing.rays import cast, in_voxels, lit_share

RAYS, FRAMES, VOXELS = 16, 4, 2500
BANDS_DEG = (0, 2, 4, 8, 16, 90)
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Sight:
    """Labelled voxels (N,) in some image: whether the mask, a ray and the ray to the middle reach them; the angle."""

    seen: Mask
    is_lit: Mask
    is_middle_lit: Mask
    angle_deg: NDArray[np.float64]


def main(labels: Path) -> None:
    """Print the table."""
    source = folder_source(labels, checked_samples)
    chosen = np.linspace(0, len(source.sequence.frames) - 1, FRAMES + 2).astype(int)[1:-1]
    parts = [sight_of(source, frame) for frame in chosen.tolist()]
    seen, is_lit, is_middle_lit, angle_deg = (
        np.concatenate([getattr(part, name) for part in parts]) for name in Sight.__dataclass_fields__
    )
    print("angle, °   voxels   in mask   lit     agree   IoU     only mask   only lit   IoU with the middle's ray")
    for low, high in ((0, 90), *pairwise(BANDS_DEG)):
        mask, lit, middle = (rows[(low <= angle_deg) & (angle_deg < high)] for rows in (seen, is_lit, is_middle_lit))
        figures = (mask.mean(), lit.mean(), (mask == lit).mean(), overlap(mask, lit))
        rest = ((mask & ~lit).mean(), (lit & ~mask).mean(), overlap(mask, middle))
        print(f"{low:>2} to {high:<2}  {len(mask):>7}  ", "  ".join(f"{figure:6.1%}" for figure in figures + rest))


def overlap(ours: Mask, theirs: Mask) -> float:
    """Return the intersection over union."""
    return float((ours & theirs).sum() / max((ours | theirs).sum(), 1))


def sight_of(source: LabelledSequence, frame: int) -> Sight:
    """Return the sight of `VOXELS` labelled voxels of the frame."""
    grids = source.grids(frame)
    occupied = grids["semantics"] > 0
    voxels = np.argwhere(occupied)
    voxels = voxels[np.random.default_rng(frame).choice(len(voxels), min(VOXELS, len(voxels)), replace=False)]
    is_lit, is_middle_lit = np.zeros(len(voxels), np.bool_), np.zeros(len(voxels), np.bool_)
    nearest_m, angle_deg = np.full(len(voxels), np.inf), np.zeros(len(voxels))
    rig = source.sequence.calibration
    for mount in rig.of_kind("camera"):
        ego_from_camera = rig.ego_from_lidar @ mount.lidar_from_sensor
        rows = np.flatnonzero(in_image(mount, ego_from_camera, voxels))
        camera = in_voxels(ego_from_camera.translation_m)
        is_lit[rows] |= lit_share(occupied, camera, voxels[rows], RAYS, frame) > 0
        is_middle_lit[rows] |= (cast(occupied, camera, voxels[rows] + 0.5)[0] == voxels[rows]).all(axis=1)
        way = (voxels[rows] + 0.5 - camera) * VOXEL_M
        length_m = np.linalg.norm(way, axis=1)
        is_nearer = length_m < nearest_m[rows]
        angle_deg[rows[is_nearer]] = np.rad2deg(np.arcsin(np.abs(way[:, 2]) / length_m))[is_nearer]
        nearest_m[rows] = np.minimum(nearest_m[rows], length_m)
    inside = np.isfinite(nearest_m)
    seen = grids["mask_camera"][tuple(voxels.T)] > 0
    return Sight(seen[inside], is_lit[inside], is_middle_lit[inside], angle_deg[inside])


def in_image(mount: Mount, ego_from_camera: SE3, voxels: NDArray[np.int64]) -> Mask:
    """Return which voxels (N, 3) have their centre in the camera's image."""
    if mount.intrinsics is None:
        return np.zeros(len(voxels), np.bool_)
    centres_ego = (voxels + 0.5) * VOXEL_M + np.array(PAPER.min_m)
    return project(ego_from_camera.inverse() @ centres_ego, mount.intrinsics)[1]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
