"""`report.json`: the inputs, parameters and quality of a label set.

**Conventions.**

- `class_share_of_occupied`: over all occupied voxels of all frames
- `profiles`: the classes of the map's voxels in the run's profile and in the other, with the changed share, and whether
  the track spans the relief that profile `paper` requires
- `held_out`: labels from one half of the track, judged by the other (`stone.labels.held_out`)
- `reference.outliers`: outliers among the driven voxels, null if these are few, and the share of the map that has
  another class by the alternative estimate
- `reference.left_out`: driven voxels excluded from the reference, which stay T
- `track`: the share of the footprint's track that is T, with pinholes closed, and the share of poses without any T
- `height_drift`: the drift of the poses in z
- `map.far_points`: points excluded because they are beyond any LiDAR's range
- `solver`: the solution of the surface, residuals in cells, null for Open3D
- `grid`: the grid of these labels; the map also covers the `further_grids`
- `refinement`: null if the given poses were used
- `recordings`: the joined recordings with their clock offsets, [] for a single one
- `costs`: measured seconds and memory; without `costs`, equal inputs give equal bytes
- `filled_share_of_occupied`: the share of occupied voxels that close a gap between two voxel centres
  (`stone.labels.pinholes`)
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.labeler.frames import FrameVoxelCounts
from services.labeler.map.comparison import (
    ProfileComparison,
    Relief,
    limit_findings,
    load_comparison,
    other_reference,
    outlier_counts,
    outlier_findings,
    relief_of,
)
from services.labeler.map.convergence import Convergence, convergence_findings, convergence_of
from services.labeler.map.far_points import FarPoints, far_point_findings, load_far_points, time_findings
from services.labeler.map.held_out import HeldOutTrack, held_out_findings, held_out_record
from services.labeler.map.surface import TileSummary
from services.labeler.map.track_coverage import coverage_findings, load_coverage
from services.labeler.parameters import LabelParameters
from services.labeler.results import load_pack, load_summaries, reference_from
from services.labeler.run import LabelRun, parts_of
from services.labeler.tables import concatenated
from services.runtime.code_version import code_version
from stone.findings import Finding
from stone.labels.track_coverage import TrackCoverage
from stone.labels.traversability import FEW_VOXELS, Reference
from stone.sensors.sequence import Sequence

STEEP_SIGMA_DEG = 15.0
UNLIKE_TIMES = 4.0  # 3.4 in a sound drive with a sixth of its track in tall grass
CLASS_NAMES = ("free", "traversable", "potentially_traversable", "non_traversable")


@dataclass(frozen=True, eq=False)
class LabelReport:
    """The result of `label`; `as_record()` is the JSON to write and print."""

    sequence: Sequence
    parameters: LabelParameters
    code_version: str
    reference: Reference
    tiles: tuple[TileSummary, ...]
    counts: FrameVoxelCounts
    findings: tuple[Finding, ...]
    profiles: Mapping[str, Any]
    track: TrackCoverage
    solver: Convergence | None
    far: FarPoints
    held_out: Mapping[str, Any]
    outliers: Mapping[str, Any] | None = None
    refinement: Mapping[str, Any] | None = None
    costs: Mapping[str, Any] = field(default_factory=dict)

    def as_record(self) -> dict[str, Any]:
        sequence, reference = self.sequence, self.reference
        return {
            "sequence": sequence.name,
            "code_version": self.code_version,
            "frames": len(sequence.frames),
            "excluded": [asdict(frame) for frame in sequence.excluded],
            "pose_source": sequence.pose_source,
            "map_origin_deg_m": sequence.map_origin_deg_m,
            "inputs": dict(sequence.inputs),
            "recordings": [asdict(recording) for recording in sequence.recordings],
            "parameters": asdict(self.parameters),
            "grid": self.parameters.grid.as_record(),
            "further_grids": [grid.name for grid in self.parameters.grids[1:]],
            "class_share_of_occupied": self.class_shares(),
            "filled_share_of_occupied": round(float(self.counts.filled.sum()) / self._occupied(), 6),
            "profiles": dict(self.profiles),
            "held_out": dict(self.held_out),
            "refinement": self.refinement,
            "ground": None if sequence.ground is None else asdict(sequence.ground),
            "height_drift": None if sequence.height_drift is None else asdict(sequence.height_drift),
            "observed_ratio": self._observed_ratio(),
            "track": {name: round(getattr(self.track, name), 6) for name in ("closed_ratio", "bare_ratio")},
            "reference": {
                "features": ["elevation_m", "slope_rad", "roughness_log_m2"],
                "mean": reference.mean.tolist(),
                "covariance": reference.covariance.tolist(),
                "voxels": reference.voxels,
                "is_floored": reference.is_floored,
                "left_out": reference.left_out,
                "outliers": self.outliers,
            },
            "map": {
                name: sum(getattr(tile, name) for tile in self.tiles)
                for name in ("points", "moving", "vertices", "triangles", "voxels")
            }
            | {"tiles": len(self.tiles), "far_points": self.far.points},
            "solver": None if self.solver is None else self.solver.as_record(),
            **self.costs,
            "findings": [finding.as_record() for finding in self.findings],
        }

    def text(self) -> str:
        """Return the file's content."""
        return json.dumps(self.as_record(), indent=1) + "\n"

    def class_shares(self) -> dict[str, float]:
        """Return the share of each class among all occupied voxels of all frames."""
        total, occupied = self.counts.classes.sum(axis=0), self._occupied()
        return {name: round(float(n) / occupied, 6) for name, n in zip(CLASS_NAMES[1:], total[1:], strict=True)}

    def _occupied(self) -> int:
        """Return the number of occupied voxels of all frames, at least 1."""
        return max(int(self.counts.classes[:, 1:].sum()), 1)

    def _observed_ratio(self) -> dict[str, float]:
        voxels = int(self.counts.classes.sum())
        lidar, camera = self.counts.observed.sum(axis=0) / voxels
        return {"lidar": round(float(lidar), 6), "camera": round(float(camera), 6)}


def report_of(run: LabelRun) -> LabelReport:
    """Return the report of a run whose stages are all finished."""
    sequence, parameters, tiles = run.sequence, run.parameters, load_summaries(run)
    reference = reference_from(run, tiles)
    counts = concatenated([load_pack(run, part)[1] for part in parts_of(run)])
    other = other_reference(run, tiles)
    relief = relief_of(sequence, reference if parameters.profile == "paper" else other)
    comparison = load_comparison(run)
    outliers = outlier_counts(tiles, parameters)
    doubts = reference_findings(parameters, reference, comparison)
    doubts += (*outlier_findings(outliers, parameters, comparison), *limit_findings(comparison))
    track = load_coverage(run)
    doubts += coverage_findings(track, parameters.footprint_band_m)
    solver, far = convergence_of(tiles, parameters.surface), load_far_points(run)
    doubts += (
        *far_point_findings(far),
        *time_findings(far, sequence),
        *convergence_findings(solver, parameters.surface),
    )
    held = held_out_record(HeldOutTrack(run, tiles))
    doubts += held_out_findings(held)
    findings = (*sequence.findings, *label_findings(parameters, reference, counts, relief), *doubts)
    profiles = comparison.as_record(parameters) | {"elevation": asdict(relief)}
    share = {"reestimated_share": round(comparison.reestimated_ratio, 6)}
    record = None if outliers is None else share | outliers.as_record()
    return LabelReport(
        *(sequence, parameters, code_version("labels")),
        reference=reference,
        tiles=tuple(tiles),
        counts=counts,
        findings=findings,
        profiles=profiles,
        track=track,
        solver=solver,
        far=far,
        held_out=held,
        outliers=record,
    )


def label_findings(
    parameters: LabelParameters, reference: Reference, counts: FrameVoxelCounts, relief: Relief
) -> tuple[Finding, ...]:
    """Return warnings about the reliability of these labels."""
    findings = []
    if reference.voxels < FEW_VOXELS:
        advice = f", or use profile {DEFAULT_PROFILE}" if parameters.profile == "paper" else ""
        few = (
            f"the track covers {reference.voxels} surface voxels; below {FEW_VOXELS} the reference is unreliable. "
            f"Drive farther{advice}"
        )
        findings.append(Finding("LAB-601", "warning", "", few))
    undriven = int((counts.classes[:, 1] == 0).sum())
    if undriven:
        none = f"{undriven} of {len(counts.classes)} frames contain no driven voxel"
        findings.append(Finding("LAB-602", "warning", "", none))
    if parameters.profile == "paper" and not relief.is_spanned:
        narrow = (
            f"the track spans {relief.track_span_m:.2f} m of elevation, so ground more than about "
            f"{relief.paper_band_m:.2f} m above or below its mean is labelled non-traversable regardless of its "
            f"shape. Process again with profile {DEFAULT_PROFILE}"
        )
        findings.append(Finding("LAB-603", "warning", "", narrow))
    return tuple(findings)


def reference_findings(
    parameters: LabelParameters, reference: Reference, comparison: ProfileComparison
) -> tuple[Finding, ...]:
    """Return evidence against Gaussian driven ground: an undrivable slope, too many outliers."""
    findings = []
    sigma_deg = float(np.rad2deg(np.sqrt(reference.covariance[1, 1])))
    if sigma_deg > STEEP_SIGMA_DEG:
        steep = (
            f"the slope of the driven ground scatters by {sigma_deg:.0f}°, more than that of drivable ground. Are "
            "surfaces beside or above the track included, or is the footprint too high?"
        )
        findings.append(Finding("LAB-604", "warning", "", steep))
    share = comparison.unlike / max(comparison.driven, 1)
    if comparison.driven >= FEW_VOXELS and share > UNLIKE_TIMES * parameters.reference.alpha:
        unlike = (
            f"{share:.1%} of the driven voxels differ from the others, but {parameters.reference.alpha:.0%} are "
            "expected by chance: the driven terrain has several kinds, or a few of its voxels are wrong"
        )
        findings.append(Finding("LAB-605", "warning", "", unlike))
    return tuple(findings)
