"""The share of observed voxels that the followed sweeps find: `python -m benchmarks.followed_sweeps BAG CALIBRATION`.

Each row follows one sweep in n; the last row follows the sweeps that the default parameters choose. The base is what
all sweeps observe: in the whole map, and within the grids of ten frames (mean and least; to a brick of 0.8 m). Seconds
are processor time of the carving alone.
"""

import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

from services.ingest.sequence import open_sequence
from services.labeler.parameters import LabelParameters
from services.labeler.run import LabelRun
from stone.geometry.lattice import centres_of
from stone.labels.observed_voxels import BRICK, CarveParameters, Carver, Observed
from stone.labels.voxels import VOXEL_M
from stone.sensors.selection import selected
from stone_base.label_grid import PAPER

FRAMES = 10
Rays = list[NDArray[np.float32]]


def main(bag: Path, calibration: Path) -> None:
    """Print the table."""
    sequence, sweeps = open_sequence(bag, calibration, bag.stem)
    run, rig = LabelRun(sequence, sweeps, LabelParameters(), Path()), sequence.calibration
    least_m, count = run.parameters.selection.min_range_m, len(sequence.frames)
    read = (sweeps.sweep(index).points_lidar for index in range(count))
    rays = [selected(points, rig.ego_from_lidar, rig.self_boxes_ego, least_m).world_ego for points in read]
    fixed = [replace(run.parameters.carve, every_frame=n, rays_per_sweep=1) for n in (1, 2, 3, 4, 5)]
    whole, _ = carved(run, rays, fixed[0])
    full = np.bitwise_count(whole.words).astype(np.float64)
    inside = np.array([in_grid(run, whole, frame) for frame in np.linspace(0, count - 1, FRAMES).astype(int).tolist()])
    print(f"{bag.name}: {count} frames, median of {np.median([len(points) for points in rays]):.0f} rays")
    for parameters in (*fixed, run.parameters.carve):
        observed, cpu_s = carved(run, rays, parameters)
        at, bits = np.searchsorted(whole.keys, observed.keys), np.zeros(len(whole.keys))
        bits[at] = np.bitwise_count(observed.words)
        shares = (inside @ bits) / (inside @ full)
        name = "default" if parameters == run.parameters.carve else f"1 in {parameters.every_frame}"
        of_frames = f"{shares.mean():.1%} (least {shares.min():.1%})"
        print(f"{name:>8}: map {bits.sum() / full.sum():.1%}, frames {of_frames}, {cpu_s:.2f} s")


def carved(run: LabelRun, rays: Rays, parameters: CarveParameters) -> tuple[Observed, float]:
    """Return the observations of the followed sweeps, and the processor seconds."""
    carver, begun = Carver(parameters), process_time()
    for index, points in enumerate(rays):
        if index % run.every(parameters.every(len(points))) == 0:
            carver.carve(points, run.sequence.frames.map_from_ego[index], run.sensor_ego)
    return carver.finish(), process_time() - begun


def in_grid(run: LabelRun, observed: Observed, frame: int) -> NDArray[np.bool_]:
    """Return which bricks (B,) have their centre in the grid of the frame."""
    centres = run.sequence.frames.map_from_ego[frame].inverse() @ centres_of(observed.keys, BRICK * VOXEL_M)
    return np.asarray(((centres >= PAPER.min_m) & (centres < PAPER.max_m)).all(axis=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
