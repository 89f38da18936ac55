"""The labels of every setting compared with released labels: one map of a bag, classed and cut again for each setting.

**Conventions.** Points are fused once; the surface is computed once for each k (`terrain.neighbours`), and the
reference and the frames for each profile and α, from the same surface. Confusions are [ring, theirs, ours], over voxels
that the released labels know. `beyond` counts our labelled voxels that they mark unknown, `labelled` all of ours.
"""

from collections.abc import Mapping
from collections.abc import Sequence as Listing
from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.release.pairs import ReleasedPair
from services.labeler.frames import labelled_frames
from services.labeler.local_run import tasks_of
from services.labeler.parameters import chosen_parameters, parameters_for
from services.labeler.pipeline import FRAMES, FUSE, MAP, PICTURES, REFERENCE, SURFACE
from services.labeler.process_pool import Task, Workers
from services.labeler.report import report_of
from services.labeler.results import load_summaries, reference_from
from services.labeler.run import LabelRun, Part, parts_of
from stone.findings import Finding
from stone.labels.profiles import Profile
from stone.labels.traversability import Reference
from stone.scoring.bitplanes import frame_counts, truth_planes
from stone.scoring.confusion import ratios
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS
from stone.sensors.ego_path import maps_of_frames
from stone.sensors.sequence import Sequence
from stone_base.label_grid import LabelGrid
from stone_datasets.labels import read_labels

Grid = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Kept:
    """Our labelled voxels that are kept: all, or with `near_m` only those near a LiDAR return.

    The voxel's centre is then within `near_m` of a return of the frame's own sweep, or of one of `sweeps` sweeps before
    and after it.
    """

    near_m: float | None = None
    sweeps: int = 0

    def __str__(self) -> str:
        if self.near_m is None:
            return "all"
        return f"{self.near_m:g} m, own sweep" if not self.sweeps else f"{self.near_m:g} m, ± {self.sweeps} sweeps"


@dataclass(frozen=True)
class Setting:
    """The parameters of labelling."""

    profile: Profile
    neighbours: int
    alpha: float
    kept: Kept = field(default_factory=Kept)

    @property
    def choices(self) -> Mapping[str, float]:
        """Return its parameters by dotted name."""
        return {"terrain.neighbours": self.neighbours, "reference.alpha": self.alpha}


@dataclass(frozen=True, eq=False)
class Agreement:
    """The agreement of a setting's labels with the released labels."""

    confusion: NDArray[np.int64]
    beyond: int
    labelled: int

    def __add__(self, other: "Agreement") -> "Agreement":
        confusion = self.confusion + other.confusion
        return Agreement(confusion, self.beyond + other.beyond, self.labelled + other.labelled)

    @property
    def ratios(self) -> list[float]:
        """Return IoU_occ, IoU of T, P and N, and mIoU; NaN if undefined."""
        return [float(value) for value in ratios(self.confusion.sum(axis=0))]

    @property
    def rank(self) -> tuple[float, ...]:
        """Return a sort key, lower for closer: mIoU, then IoU_occ, then the labelled voxels unknown to the release."""
        iou_occ, *_, miou = np.nan_to_num(self.ratios, nan=-1.0).tolist()
        return -miou, -iou_occ, self.beyond


@dataclass(frozen=True, eq=False)
class Variant:
    """A labelling of one map: `whole` of all frames of the bag, `run` of the frames with released labels, at their
    poses.
    """

    whole: LabelRun
    run: LabelRun
    reference: Reference

    def frame(self, row: int) -> tuple[Grid, Grid]:
        """Return the classes of one frame, and its observed voxels."""
        (labelled,) = labelled_frames(self.run, (row, row + 1), self.reference)
        return _array(labelled.payload, "semantics"), _array(labelled.payload, "mask_lidar")


@dataclass(frozen=True)
class Searched:
    """The searched values: every combination is tried."""

    profiles: Listing[Profile]
    neighbours: Listing[int]
    alphas: Listing[float]
    kept: Listing[Kept]

    def settings(self, neighbours: int) -> list[Setting]:
        """Return the settings of this k, each with all voxels."""
        return [Setting(profile, neighbours, alpha) for profile, alpha in product(self.profiles, self.alphas)]


def search(
    pair: ReleasedPair, searched: Searched, workers: Workers, scratch: Path
) -> tuple[dict[Setting, Agreement], dict[Setting, Variant]]:
    """Return the agreement of every setting, and its labelling with all voxels, valid while the folder `scratch`
    exists.

    Raises `footprint_off_ground`, `no_reference`.
    """
    base = LabelRun(pair.sequence, pair.sweeps, replace(parameters_for("paper"), grids=(pair.reach,)), scratch / "map")
    _do(workers, tasks_of(base, {FUSE}))
    agreements, variants = dict[Setting, Agreement](), dict[Setting, Variant]()
    for neighbours in searched.neighbours:
        of_k = {setting: _unreferred(base, setting, scratch) for setting in searched.settings(neighbours)}
        _do(workers, tasks_of(next(iter(of_k.values())), {SURFACE}))
        made = {setting: _variant(run, pair) for setting, run in of_k.items()}
        variants |= made
        agreements |= _agreements(pair, made, searched.kept, workers)
    return agreements, variants


def _unreferred(base: LabelRun, setting: Setting, scratch: Path) -> LabelRun:
    """Return the run of a setting, in a scratch shared by all settings of its k, with links to the fused points."""
    folder = scratch / f"k-{setting.neighbours}"
    if not folder.exists():
        folder.mkdir()
        for made in base.scratch.iterdir():
            (folder / made.name).symlink_to(made)
    parameters = chosen_parameters(setting.profile, setting.choices, base.parameters.grids)
    return replace(base, parameters=parameters, scratch=folder)


def _variant(run: LabelRun, pair: ReleasedPair) -> Variant:
    reference = reference_from(run, load_summaries(run))
    parameters = replace(run.parameters, grids=(pair.layout.grid,))
    return Variant(run, replace(run, sequence=pair.compared, parameters=parameters), reference)


def findings_of(variant: Variant, workers: Workers) -> tuple[Finding, ...]:
    """Return the findings of the bag, and of its labels by a variant, with all frames labelled."""
    _do(workers, tasks_of(variant.whole, {REFERENCE, FRAMES, MAP, PICTURES}))
    return report_of(variant.whole).findings


def _agreements(
    pair: ReleasedPair, variants: Mapping[Setting, Variant], kept: Listing[Kept], workers: Workers
) -> dict[Setting, Agreement]:
    ways = tuple(variants.values())
    tasks = [Task(("count", part), count_part, (pair, ways, kept, part)) for part in parts_of(ways[0].run)]
    parts = [done.value for _, done in workers.run(tasks)]
    settings = (replace(variant, kept=how) for variant, how in product(variants, kept))
    return {
        setting: sum(of_part[1:], of_part[0])
        for setting, of_part in zip(settings, zip(*parts, strict=True), strict=True)
    }


def _do(workers: Workers, tasks: list[Task]) -> None:
    for _ in workers.run(tasks):
        pass


def count_part(pair: ReleasedPair, variants: Listing[Variant], kept: Listing[Kept], part: Part) -> list[Agreement]:
    """Return the agreement over the frames of a part, for each variant and each way to keep voxels."""
    ways, grid = list(product(range(len(variants)), kept)), pair.layout.grid
    confusions = np.zeros((len(ways), RINGS, CLASSES, CLASSES), np.int64)
    beyond, labelled = np.zeros((2, len(ways)), np.int64)
    returns = NearReturns(pair, variants[0].run.sequence)
    frames = zip(*(labelled_frames(item.run, part, item.reference) for item in variants), strict=True)
    for row, of_variants in enumerate(frames, part[0]):
        classes, is_known = released_labels(pair, row)
        planes = truth_planes(classes, is_known, grid)
        ours = [_array(item.payload, "semantics") for item in of_variants]
        masks = returns.masks(row, np.any(ours, axis=0), kept, grid)
        for at, (variant, how) in enumerate(ways):
            own = np.where(masks[how], ours[variant], np.uint8(0))
            confusions[at] += frame_counts(own, planes).confusion
            labelled[at] += np.count_nonzero(own)
            beyond[at] += np.count_nonzero(own[~is_known])
    counts = zip(confusions, beyond.tolist(), labelled.tolist(), strict=True)
    return [Agreement(*item) for item in counts]


def released_labels(pair: ReleasedPair, row: int) -> tuple[Grid, Mask]:
    """Return the released classes of a compared frame, and its known voxels."""
    labels = read_labels(pair.labels[row], layout=pair.layout)
    seen = labels.mask_lidar
    return labels.classes, np.ones(labels.classes.shape, np.bool_) if seen is None else seen.astype(np.bool_)


def _array(payload: bytes, name: str) -> Any:
    with np.load(BytesIO(payload)) as arrays:
        return arrays[name]


class NearReturns:
    """The voxels of compared frames with a near return, of their own sweep or of neighbouring sweeps.

    Trees of sweeps are cached while frames follow each other.
    """

    def __init__(self, pair: ReleasedPair, compared: Sequence) -> None:
        self._pair, self._compared, self._trees = pair, compared, dict[int, cKDTree]()
        self._maps = maps_of_frames(pair.sequence)

    def masks(self, number: int, is_asked: Mask, kept: Listing[Kept], grid: LabelGrid) -> dict[Kept, Mask]:
        """Return the voxels of the grid that each way keeps, among the given ones."""
        row, most = int(self._pair.rows[number]), max(how.sweeps for how in kept)
        self._trees = {frame: tree for frame, tree in self._trees.items() if frame >= row - most}
        centres_ego = np.array(grid.min_m) + (np.argwhere(is_asked) + 0.5) * grid.voxel_m
        centres_map = self._compared.frames.map_from_ego[number] @ centres_ego
        masks = dict[Kept, Mask]()
        for how in kept:
            masks[how] = is_asked.copy()
            if how.near_m is not None:
                masks[how][is_asked] = self._are_near(row, centres_map, how.near_m, how.sweeps)
        return masks

    def _are_near(self, row: int, centres_map: NDArray[np.float64], near_m: float, sweeps: int) -> Mask:
        is_near = np.zeros(len(centres_map), np.bool_)
        for other in range(max(row - sweeps, 0), min(row + sweeps + 1, len(self._maps))):
            if self._maps[other] == self._maps[row]:
                left = np.flatnonzero(~is_near)
                distances_m, _ = self._tree(other).query(centres_map[left], distance_upper_bound=near_m)
                is_near[left] = np.isfinite(distances_m)
        return is_near

    def _tree(self, row: int) -> cKDTree:
        """Return the tree of the returns of a frame's sweep, in the map."""
        if row not in self._trees:
            sequence = self._pair.sequence
            map_from_lidar = sequence.frames.map_from_ego[row] @ sequence.calibration.ego_from_lidar
            points_lidar = self._pair.sweeps.sweep(row).points_lidar.astype(np.float64)
            self._trees[row] = cKDTree(map_from_lidar @ points_lidar)
        return self._trees[row]
