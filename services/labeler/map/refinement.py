"""Pose refinement: every sweep is aligned with the map of earlier sweeps (`small_gicp`).

Voxelised GICP (Koide et al., 2021), scan to map. It is off by default, because it changes all positions. It therefore
reports its corrections, and the label set records its parameters.

**Conventions.** A correction is applied before the given pose: refined · given⁻¹ of `map_from_ego`, measured at the ego
origin. The given poses take precedence: a correction beyond the limits is rejected, and every correction is reduced by
`pull_ratio`, so the map follows its source in the long run. One thread, so equal inputs give equal poses. The map drops
voxels that no sweep has touched for `horizon_frames`, which bounds memory.
"""

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.parameters import LabelParameters, RefinementParameters
from services.labeler.run import Step, silent
from stone.findings import Finding
from stone.geometry.se3 import SE3, apart, interpolate
from stone.sensors.selection import world_points
from stone.sensors.sequence import Sequence, SweepSource
from stone.surface.sharpness import Sharpness, SharpnessMeter

FEWEST_POINTS = 200
NEIGHBOURS = 10
FORGETS_EVERY_FRAMES = 10
SHARPNESS_EVERY = 4  # points


@dataclass(frozen=True)
class Refinement:
    """Summary of a refinement: corrections (m, rad), unchanged poses by reason, the map before and after."""

    frames: int
    kept: dict[str, int]
    correction_median_m: float
    correction_max_m: float
    correction_median_rad: float
    correction_max_rad: float
    before: Sharpness
    after: Sharpness

    def as_record(self) -> dict[str, Any]:
        return asdict(self)


@dataclass
class _Trail:
    """Data that grow with the run: a pose and two numbers per frame."""

    poses: list[NDArray[np.float64]] = field(default_factory=list)
    moved_m: list[float] = field(default_factory=list)
    turned_rad: list[float] = field(default_factory=list)
    kept: dict[str, int] = field(default_factory=lambda: {"too_little_seen": 0, "not_converged": 0, "beyond_limit": 0})

    def add(self, given: SE3, pose: SE3) -> None:
        moved_m, turned_rad = apart(given, pose)
        self.poses.append(pose.wxyz_xyz)
        self.moved_m.append(moved_m)
        self.turned_rad.append(turned_rad)


def refined(
    sequence: Sequence, sweeps: SweepSource, parameters: LabelParameters, step: Step = silent
) -> tuple[Sequence, Refinement]:
    """Return the sequence with poses aligned frame by frame, and a summary; `parameters.refinement` is not None.

    The first pose is unchanged. The sequence gains the finding LAB-611 and, if corrections beyond the limits were
    rejected, LAB-612.
    """
    options, frames = parameters.refinement or RefinementParameters(), sequence.frames
    aligner, trail = _Aligner(options), _Trail()
    before, after = SharpnessMeter(), SharpnessMeter()
    sensor_ego = sequence.calibration.ego_from_lidar.translation_m
    for index in range(len(frames)):
        points_ego = _points(sequence, sweeps.sweep(index).points_lidar, parameters)
        given = frames.map_from_ego[index]
        pose, reason = aligner.place(points_ego, given)
        if reason:
            trail.kept[reason] += 1
        trail.add(given, pose)
        before.add(points_ego[::SHARPNESS_EVERY], given, sensor_ego)
        after.add(points_ego[::SHARPNESS_EVERY], pose, sensor_ego)
        step(index + 1, len(frames))
    done = _refinement(trail, before.measured(), after.measured())
    moved = replace(frames, map_from_ego=SE3(np.stack(trail.poses)))
    source = f"{sequence.pose_source}, refined by {options.method}"
    findings = (*sequence.findings, *_findings(done, options))
    return replace(sequence, frames=moved, pose_source=source, findings=findings), done


class _Aligner:
    """The map of earlier sweeps, in which the next sweep is placed."""

    def __init__(self, options: RefinementParameters) -> None:
        import small_gicp

        self._options = options
        self._gicp = small_gicp
        self._map = small_gicp.GaussianVoxelMap(options.voxel_m)
        self._map.set_lru(options.horizon_frames, FORGETS_EVERY_FRAMES)
        self._is_empty = True

    def place(self, points_ego: NDArray[np.float32], given: SE3) -> tuple[SE3, str]:
        """Return the pose of a sweep, which is added to the map, and why it is the given pose ("" if refined)."""
        cloud, _ = self._gicp.preprocess_points(points_ego.astype(np.float64), self._options.sampling_m, NEIGHBOURS, 1)
        if cloud.size() < FEWEST_POINTS:
            return given, "too_little_seen"
        pose, reason = (given, "") if self._is_empty else self._aligned(cloud, given)
        self._map.insert(cloud, pose.as_matrix())
        self._is_empty = False
        return pose, reason

    def _aligned(self, cloud: Any, given: SE3) -> tuple[SE3, str]:
        options = self._options
        result = self._gicp.align(
            self._map,
            cloud,
            given.as_matrix(),
            max_correspondence_distance=options.correspondence_m,
            num_threads=1,
            max_iterations=options.iterations,
            rotation_epsilon=1e-4,
            translation_epsilon=5e-4,
        )
        if result.num_inliers < options.least_overlap_ratio * cloud.size():
            return given, "too_little_seen"
        if not result.converged or not np.isfinite(result.T_target_source).all():
            return given, "not_converged"
        pose = SE3.from_matrix(np.asarray(result.T_target_source))
        moved_m, turned_rad = apart(given, pose)
        if moved_m > options.max_correction_m or turned_rad > options.max_correction_rad:
            return given, "beyond_limit"
        return interpolate(pose, given, np.array(options.pull_ratio)), ""


def _points(sequence: Sequence, points_lidar: NDArray[np.float32], parameters: LabelParameters) -> NDArray[np.float32]:
    calibration, options = sequence.calibration, parameters.refinement or RefinementParameters()
    points_ego = world_points(
        points_lidar, calibration.ego_from_lidar, calibration.self_boxes_ego, parameters.selection.min_range_m
    )
    is_near = np.einsum("ij,ij->i", points_ego, points_ego) < options.reach_m**2
    return np.asarray(points_ego[is_near])


def _refinement(trail: _Trail, before: Sharpness, after: Sharpness) -> Refinement:
    return Refinement(
        len(trail.poses),
        trail.kept,
        float(np.median(trail.moved_m)),
        max(trail.moved_m),
        float(np.median(trail.turned_rad)),
        max(trail.turned_rad),
        before,
        after,
    )


def _findings(done: Refinement, options: RefinementParameters) -> tuple[Finding, ...]:
    refined = Finding(
        "LAB-611",
        "info",
        "",
        f"poses were refined by {options.method}: moved by {1000 * done.correction_median_m:.0f} mm (median; at most "
        f"{1000 * done.correction_max_m:.0f} mm). The same points fill {done.after.voxels} voxels of 0.1 m instead of "
        f"{done.before.voxels}, with a thickness of {1000 * done.after.thickness_m:.1f} mm instead of "
        f"{1000 * done.before.thickness_m:.1f} mm",
    )
    if not sum(done.kept.values()):
        return (refined,)
    reasons = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in done.kept.items() if count)
    limits = f"{options.max_correction_m:g} m and {np.rad2deg(options.max_correction_rad):.1f} degrees"
    kept = f"{sum(done.kept.values())} of {done.frames} poses were not refined ({reasons}; limits {limits}): "
    if not done.kept["beyond_limit"]:
        return (refined, Finding("LAB-612", "info", "", f"{kept}they keep their given poses"))
    advice = "corrections this large are not noise; is the pose source the right one?"
    return (refined, Finding("LAB-612", "warning", "", kept + advice))
