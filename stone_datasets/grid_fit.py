"""Checks that tables, sweeps and labels match: the share of LiDAR returns in occupied voxels of their labels.

**Conventions.** Frames are sampled evenly. Every return inside the grid and at least `NEAREST_M` from the ego origin in
plan counts. It is explained if it lies in an occupied voxel, or a quarter of a voxel above or below it. The share is
measured for the stated grid and for its misreadings: other voxel sizes, half a voxel off, the LiDAR mount's quaternion
read as x y z w. Poses are checked with the returns of one frame in the labels of another, `APART_M` away. A
reading that explains many more returns than the stated one refutes it. So do the labels of another frame: of
neighbours, and of the same frame in `OTHER_SCENES`.

The limits come from measurements of right and wrong datasets (docs/formats/datasets.md, "Returns in occupied voxels").
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_base.label_grid import GRIDS, LabelGrid
from stone_datasets.classes import OWN_CLASSES, ClassMap
from stone_datasets.faults import DatasetFaultError, DatasetPlace
from stone_datasets.index import DatasetIndex, DatasetSequence, label_folder
from stone_datasets.labels import Grid, read_labels
from stone_exports.files import DamagedExportError
from stone_exports.frames import LIDAR_CHANNEL
from stone_exports.sweeps import SweepFile

MOST_FRAMES, MOST_PAIRS, MOST_SCENES = 48, 24, 300
OTHER_SCENES = 8  # nearest in their table
NEAREST_M = 2.0
APART_M = (1.0, 8.0)
NEAR_VOXELS = 0.25
FEWEST_RETURNS = 2_000  # fewer allow no conclusion
# A reading is refuted by another that explains this much more and leaves a sixth as much unexplained …
LEAST_BETTER, LEAST_FEWER = 0.02, 6
LEAST_SHARE = 0.05  # … or if it explains less than this share.
STATED = "as stated"
Points = NDArray[np.float64]


@dataclass(frozen=True)
class GridFit:
    """Shares of `returns` in occupied voxels by reading: in a frame's own labels, and in the labels of a nearby
    frame.
    """

    returns: int
    own: Mapping[str, float]
    pair_returns: int
    pairs: Mapping[str, float]

    def as_record(self) -> dict[str, object]:
        shares = {"own_frame": self.own, "frame_near_by": self.pairs}
        rounded = {key: {name: round(share, 4) for name, share in of.items()} for key, of in shares.items()}
        return {"returns": self.returns, "pair_returns": self.pair_returns, **rounded}


def check_fit(index: DatasetIndex, classes: ClassMap = OWN_CLASSES) -> GridFit | None:
    """Return the fit of a dataset with valid files, or None if it has no labels or no sweeps.

    Raises `DST-073`, or `DST-074` if the labels of a frame belong to another frame.
    """
    labelled = [
        sequence
        for sequence in index.sequences
        if sequence.is_labelled and LIDAR_CHANNEL in sequence.channels and len(sequence)
    ]
    if not labelled:
        return None
    fit = measured_fit(index, labelled, classes)
    for what, returns, shares in (("own", fit.returns, fit.own), ("near by", fit.pair_returns, fit.pairs)):
        if returns >= FEWEST_RETURNS:
            _refuse(index, what, returns, shares)
    _refuse_mixed_up(index, labelled, classes)
    return fit


def measured_fit(index: DatasetIndex, labelled: list[DatasetSequence], classes: ClassMap) -> GridFit:
    """Return the shares of these sequences."""
    grids, own, pairs = dict(readings_of(index.grid)), _Shares(), _Shares()
    for sequence, frame in _sampled(labelled, MOST_FRAMES):
        frames = _Frames(index, sequence, classes)
        if (read := frames.read(frame, frame)) is None:
            continue
        for name, grid in grids.items():
            own.add(name, grid, read[0], read[1])
        own.add("LiDAR mount read x y z w", index.grid, read[0], read[2])
    for sequence, frame in _sampled(labelled, MOST_PAIRS):
        other, poses = _near(sequence, frame), sequence.map_from_ego
        if other is None or (read := _Frames(index, sequence, classes).read(other, frame)) is None:
            continue
        first, second = poses[frame], poses[other]
        pairs.add(STATED, index.grid, read[0], second.inverse() @ (first @ read[1]))
        first, second = swapped(first), swapped(second)
        pairs.add("poses read x y z w", index.grid, read[0], second.inverse() @ (first @ read[1]))
        for name, step in (("poses of the frame before", -1), ("poses of the frame after", 1)):
            if min(frame, other) + step >= 0 and max(frame, other) + step < len(sequence):
                first, second = poses[frame + step], poses[other + step]
                pairs.add(name, index.grid, read[0], second.inverse() @ (first @ read[1]))
    return GridFit(own.returns, own.shares(), pairs.returns, pairs.shares())


def readings_of(grid: LabelGrid) -> Iterator[tuple[str, LabelGrid]]:
    """Yield the stated grid, and grids with the same shape that it may be confused with, each with its name."""
    yield STATED, grid
    for voxel_m in (0.2, 0.4):
        if voxel_m != grid.voxel_m:
            scale = voxel_m / grid.voxel_m
            x, y, z = grid.min_m
            for low_m in {z, z * scale}:
                corner = (x * scale, y * scale, low_m)
                yield f"voxels of {voxel_m:g} m from z = {low_m:g} m", replace(grid, min_m=corner, voxel_m=voxel_m)
    for axis, name in enumerate("xyz"):
        for sign, shown in ((0.5, "+"), (-0.5, "−")):
            moved = [low + sign * grid.voxel_m * (axis == at) for at, low in enumerate(grid.min_m)]
            yield f"half a voxel to {shown}{name}", replace(grid, min_m=(moved[0], moved[1], moved[2]))
    for known in GRIDS.values():
        if known.shape == grid.shape and known.geometry != grid.geometry:
            yield f"grid {known.name}", known


def swapped(pose: SE3) -> SE3:
    """Return the pose with its quaternion w x y z read as x y z w."""
    x, y, z, w = pose.wxyz.tolist()
    return SE3.from_parts(np.array([w, x, y, z]), pose.translation_m)


def share_in(occupied: Grid, grid: LabelGrid, points: Points) -> tuple[int, int]:
    """Return the number of points in occupied voxels or within `NEAR_VOXELS` above or below, and the number inside the
    grid.

    A floor may lie on the border of two voxel layers, so that noise puts half of its returns into the wrong layer.
    """
    places = (points - grid.min_m) / grid.voxel_m
    places = places[((places >= 0) & (places < grid.shape)).all(axis=1)]
    i, j = places[:, :2].astype(np.int64).T
    layers = [
        np.clip(places[:, 2] + off, 0, grid.shape[2] - 0.5).astype(np.int64) for off in (0, NEAR_VOXELS, -NEAR_VOXELS)
    ]
    is_hit = np.logical_or.reduce([occupied[i, j, k] != 0 for k in layers])
    return int(np.count_nonzero(is_hit)), len(places)


class _Shares:
    """Counts by reading; `returns` counts the stated reading."""

    def __init__(self) -> None:
        self._counts: dict[str, list[int]] = {}

    def add(self, name: str, grid: LabelGrid, occupied: Grid, points: Points) -> None:
        counts = self._counts.setdefault(name, [0, 0])
        for at, count in enumerate(share_in(occupied, grid, points)):
            counts[at] += count

    @property
    def returns(self) -> int:
        return self._counts.get(STATED, [0, 0])[1]

    def shares(self) -> dict[str, float]:
        return {name: hit / count if count else 0.0 for name, (hit, count) in self._counts.items()}


@dataclass(frozen=True, eq=False)
class _Frames:
    """The labels and sweeps of a sequence's frames."""

    index: DatasetIndex
    sequence: DatasetSequence
    classes: ClassMap

    def read(self, labelled: int, swept: int) -> tuple[Grid, Points, Points] | None:
        """Return the classes of a frame, and the returns (N, 3) of another in its ego frame, with the mount as stated
        and read as x y z w.

        Return None if a file is missing or damaged; the check of all files refuses it.
        """
        channel = self.sequence.channels[LIDAR_CHANNEL]
        classes, sweep = self.labels(labelled), self.index.file(channel, swept)
        if classes is None or sweep is None:
            return None
        mount = channel.sensor.ego_from_sensor
        try:
            points_lidar = SweepFile(sweep, SE3.identity()).points_ego().astype(np.float64)
        except DamagedExportError:
            return None
        return classes, _outside(mount @ points_lidar), _outside(swapped(mount) @ points_lidar)

    def labels(self, frame: int) -> Grid | None:
        """Return the classes of a frame, or None if its file is missing or damaged."""
        span = self.index.labels(self.sequence, frame)
        try:
            return None if span is None else read_labels(span, self.classes, self.index.layout).classes
        except (DamagedExportError, DatasetFaultError):
            return None


def _outside(points: Points) -> Points:
    """Return the returns outside the robot, rounded like sweeps."""
    rounded = points.astype(np.float32)
    return rounded[np.hypot(rounded[:, 0], rounded[:, 1]) >= NEAREST_M].astype(np.float64)


def _sampled(sequences: Iterable[DatasetSequence], most: int) -> Iterator[tuple[DatasetSequence, int]]:
    """Yield at most `most` frames, evenly from all."""
    frames = [(sequence, frame) for sequence in sequences for frame in range(len(sequence))]
    return (frames[at] for at in np.unique(np.linspace(0, len(frames) - 1, most).round().astype(int)).tolist())


def _near(sequence: DatasetSequence, frame: int) -> int | None:
    """Return the next frame (or else an earlier one) at a distance within `APART_M`, or None."""
    places = sequence.map_from_ego.translation_m
    away_m = np.linalg.norm(places - places[frame], axis=1)
    near = np.flatnonzero((away_m >= APART_M[0]) & (away_m <= APART_M[1]))
    return int(near[np.argmin(np.abs(near - frame))]) if len(near) else None


def _refuse(index: DatasetIndex, what: str, returns: int, shares: Mapping[str, float]) -> None:
    """Raise `DST-073` if the stated grid is refuted or explains too few returns."""
    stated = shares[STATED]
    best = max(shares, key=lambda name: shares[name])
    if not _is_refuted(stated, shares[best]) and stated >= LEAST_SHARE:
        return
    others = f"; {best}: {shares[best]:.2%}" if best != STATED else ""
    measured = (
        f"{stated:.2%} of {returns} returns are in occupied voxels of {('their' if what == 'own' else 'near')} labels"
    )
    position = DatasetPlace(label_folder(index.sequences[0].name))
    raise DatasetFaultError("DST-073", position, f"{measured} with the grid {index.grid}{others}")


def _is_refuted(stated: float, other: float) -> bool:
    """Return whether a reading that explains the share `other` refutes the stated one."""
    return other - stated >= LEAST_BETTER and LEAST_FEWER * (1 - other) < 1 - stated


def _refuse_mixed_up(index: DatasetIndex, labelled: list[DatasetSequence], classes: ClassMap) -> None:
    """Raise `DST-074` if another frame's labels match the returns of a frame."""
    for sequence, frame in _sampled(labelled, max(MOST_FRAMES, min(len(labelled), MOST_SCENES))):
        if (read := _Frames(index, sequence, classes).read(frame, frame)) is None:
            continue
        hit, returns = share_in(read[0], index.grid, read[1])
        if returns < FEWEST_RETURNS or returns - hit < LEAST_BETTER * returns:
            continue
        stated = hit / returns
        for of, other in _others(labelled, sequence, frame):
            grid = _Frames(index, of, classes).labels(other)
            share = 0.0 if grid is None else share_in(grid, index.grid, read[1])[0] / returns
            if _is_refuted(stated, share):
                what = f"{stated:.2%} of the {returns} returns of its sweep are in occupied voxels of these labels"
                better = f"{share:.2%} are in occupied voxels of {of.label_name(other)}"
                raise DatasetFaultError("DST-074", DatasetPlace(sequence.label_name(frame)), f"{what}, {better}")


def _others(
    labelled: list[DatasetSequence], sequence: DatasetSequence, frame: int
) -> Iterator[tuple[DatasetSequence, int]]:
    """Yield the frames whose labels may have been confused with a frame's labels."""
    yield from ((sequence, other) for other in (frame - 1, frame + 1) if 0 <= other < len(sequence))
    number = labelled.index(sequence)
    nearest = sorted(range(len(labelled)), key=lambda at: abs(at - number))
    yield from ((labelled[at], frame) for at in nearest[1 : OTHER_SCENES + 1] if frame < len(labelled[at]))
