"""Judges a label folder by the truth of an analytic world.

**Conventions.** The exact pose of the LiDAR at the frame's stamp and the entered mount place a frame's voxels, so a
voxel lies at its measured points. Wrong poses and mounts count only by the classes that they change. Counts add over
frames; ratios are computed at the end, and are None without support.

`danger`: the share of labelled obstacle voxels that are T or P. `lost`: the share of drivable voxels that are N.
`salt`: N voxels per frame in 26-connected components of at most `SALT_VOXELS` that touch T or P, none of them obstacle
or grey in truth.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.ndimage import label as components
from scipy.ndimage import maximum_filter

from testing.outside.ground import Array
from testing.outside.lidar import EGO_FROM_LIDAR
from testing.outside.recording import START_NS
from testing.outside.truth import AIR, DRIVABLE, OBSTACLE, SLOPE_BANDS_DEG, Truth

GRID_MIN_M, VOXEL_M = np.array([-25.6, -25.6, -2.0]), 0.2
T, P, N = 1, 2, 3
EVERY, SALT_VOXELS = 5, 3
Grid = NDArray[np.uint8]
Figures = dict[str, float | None]


@dataclass
class Verdict:
    """Counts over the judged frames."""

    frames: int = 0
    counts: Counter[str] = field(default_factory=Counter)

    def figures(self) -> Figures:
        """Return the ratios."""
        at = self.counts
        kept, lost = at["drivable kept"], at["drivable lost"]
        blocked, dangerous = at["obstacle kept"], at["obstacle lost"]
        ratios: Figures = {
            "iou": ratio(kept, kept + lost + dangerous),
            "danger": ratio(dangerous, dangerous + blocked),
            "lost": ratio(lost, kept + lost),
            "t_wrong": ratio(at["obstacle T"], dangerous + blocked),
            "salt": ratio(at["salt"], self.frames),
            "missed": ratio(at["missed"], at["sighted"]),
            "sighted": float(at["sighted"]),
            "walker_tp": float(at["walker T P"]),
            "walker_n": float(at["walker N"]),
        }
        for name in sorted({key.partition(":")[2] for key in at if ":" in key}):
            for what in ("danger", "missed", "steep", "lost"):
                part, whole = at[f"{what}:{name}"], at[f"{what} of:{name}"]
                if whole:
                    ratios[f"{what} {name}"] = part / whole
        return ratios


def ratio(part: float, whole: float) -> float | None:
    """Return part / whole, None if there is no whole."""
    return part / whole if whole else None


def judge_labels(folder: Path, truth: Truth, ego_from_lidar: Array = EGO_FROM_LIDAR, every: int = EVERY) -> Verdict:
    """Judge every `every`-th frame of a label folder made with the mount `ego_from_lidar`."""
    table = pq.read_table(folder / "frames.parquet", columns=["frame_token", "stamp_ns"]).to_pylist()
    paths = {path.parent.name: path for path in folder.glob("gts/*/*/labels.npz")}
    grids = [(paths[row["frame_token"]], row["stamp_ns"]) for row in table if row["frame_token"] in paths]
    return judge_grids(grids, truth, ego_from_lidar, every)


def judge_grids(
    grids: Sequence[tuple[Path, int]], truth: Truth, ego_from_lidar: Array = EGO_FROM_LIDAR, every: int = EVERY
) -> Verdict:
    """Judge every `every`-th of the label files, each with its frame's stamp in nanoseconds."""
    verdict = Verdict()
    poses = world_from_ego(truth, np.array([stamp_ns for _, stamp_ns in grids[::every]]), ego_from_lidar)
    for (path, _), world_from_grid in zip(grids[::every], poses, strict=True):
        with np.load(path, allow_pickle=False) as archive:
            grid = archive["semantics"]
        judge_frame(grid, world_from_grid, truth, verdict)
    return verdict


def world_from_ego(truth: Truth, stamps_ns: NDArray[np.int64], ego_from_lidar: Array) -> Array:
    """Return the poses (F, 4, 4) of ego frames at these stamps with the entered mount."""
    poses = np.array(truth.world.track.poses((stamps_ns - START_NS) / 1e9)).reshape(-1, 4, 4)
    return np.asarray(poses @ EGO_FROM_LIDAR @ np.linalg.inv(ego_from_lidar))


def judge_frame(grid: Grid, world_from_grid: Array, truth: Truth, verdict: Verdict) -> None:
    """Add a frame's counts to the verdict."""
    index = np.argwhere(grid > 0)
    classes = grid[tuple(index.T)]
    points = ((index + 0.5) * VOXEL_M + GRID_MIN_M) @ world_from_grid[:3, :3].T + world_from_grid[:3, 3]
    judged, is_free = truth.judge(points), classes != N
    at = verdict.counts
    verdict.frames += 1
    for name, code in (("drivable", DRIVABLE), ("obstacle", OBSTACLE)):
        at[f"{name} kept"] += int(np.count_nonzero((judged.codes == code) & (is_free == (code == DRIVABLE))))
        at[f"{name} lost"] += int(np.count_nonzero((judged.codes == code) & (is_free != (code == DRIVABLE))))
    at["obstacle T"] += int(np.count_nonzero((judged.codes == OBSTACLE) & (classes == T)))
    _count_things(judged.things, is_free, truth, at)
    for low, high in pairwise(SLOPE_BANDS_DEG):
        within = (judged.slope_deg >= low) & (judged.slope_deg < high)
        at[f"steep of:{low:g}-{high:g}°"] += int(within.sum())
        at[f"steep:{low:g}-{high:g}°"] += int((within & is_free).sum())
    codes = np.full(grid.shape, AIR, np.uint8)
    codes[tuple(index.T)] = judged.codes
    at["salt"] += salt_voxels(grid, codes)
    ghosts = truth.in_walkers_way(points[judged.codes == AIR])
    at["walker T P"] += int((ghosts & is_free[judged.codes == AIR]).sum())
    at["walker N"] += int((ghosts & ~is_free[judged.codes == AIR]).sum())


def _count_things(things: NDArray[np.int64], is_free: NDArray[np.bool_], truth: Truth, at: Counter[str]) -> None:
    """Count obstacles per frame: sighted if a voxel of it is labelled, missed if all of these are T or P."""
    for thing in np.unique(things[things >= 0]).tolist():
        kind, free = truth.things[thing], is_free[things == thing]
        at[f"danger of:{kind}"] += len(free)
        at[f"danger:{kind}"] += int(free.sum())
        for name in ("sighted", f"missed of:{kind}"):
            at[name] += 1
        for name in ("missed", f"missed:{kind}"):
            at[name] += int(free.all())


def salt_voxels(grid: Grid, codes: NDArray[np.uint8]) -> int:
    """Return the number of N voxels of a frame that are salt, by the truth's codes of its voxels."""
    everywhere = np.ones((3, 3, 3), bool)
    numbers, count = components(grid == N, everywhere)
    sizes = np.bincount(numbers.ravel(), minlength=count + 1)
    touches = maximum_filter(((grid == T) | (grid == P)).view(np.uint8), 3).view(bool)
    is_beside, is_something = np.zeros(count + 1, bool), np.zeros(count + 1, bool)
    is_beside[np.unique(numbers[touches])] = True
    is_something[np.unique(numbers[(codes != AIR) & (codes != DRIVABLE)])] = True
    is_salt = is_beside & ~is_something & (sizes <= SALT_VOXELS)
    is_salt[0] = False
    return int(sizes[is_salt].sum())
