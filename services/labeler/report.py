"""`report.json`: from what, how and how well a label set was made.

**Conventions.** What was measured while it was made (seconds, memory) is apart, in `costs`: without them equal inputs
give equal bytes.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np

from services.labeler.frames import FrameCounts
from services.labeler.parameters import LabelParameters
from services.labeler.surface import TileSummary
from services.labeler.tables import concatenated
from stone.findings import Finding
from stone.sequence import Sequence
from stone.traversability import FEW_VOXELS, NoReferenceError, Reference, reference_of, total_of

CLASS_NAMES = ("free", "traversable", "potentially_traversable", "non_traversable")
# Outside this many standard deviations of the driven elevation, profile `paper` calls any ground N (√χ²(3, 0.95)).
RELIEF_SIGMAS = 2.8
NARROW_RELIEF_RATIO = 0.5


@dataclass(frozen=True, eq=False)
class LabelReport:
    """What `label` did; `as_record()` is the JSON that is written and printed."""

    sequence: Sequence
    parameters: LabelParameters
    code_version: str
    reference: Reference
    tiles: tuple[TileSummary, ...]
    counts: FrameCounts
    findings: tuple[Finding, ...]
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
            "parameters": asdict(self.parameters),
            "class_share_of_occupied": self.class_shares(),
            "observed_ratio": self._observed_ratio(),
            "reference": {
                "features": ["elevation_m", "slope_rad", "roughness_log_m2"],
                "mean": reference.mean.tolist(),
                "covariance": reference.covariance.tolist(),
                "voxels": reference.voxels,
                "is_floored": reference.is_floored,
            },
            "map": {
                name: sum(getattr(tile, name) for tile in self.tiles)
                for name in ("points", "moving", "vertices", "triangles", "voxels")
            }
            | {"tiles": len(self.tiles)},
            **self.costs,
            "findings": [finding.as_record() for finding in self.findings],
        }

    def text(self) -> str:
        """The file."""
        return json.dumps(self.as_record(), indent=1) + "\n"

    def class_shares(self) -> dict[str, float]:
        """The share of each class among all occupied voxels of all frames."""
        total = self.counts.classes.sum(axis=0)
        occupied = max(int(total[1:].sum()), 1)
        return {name: round(float(n) / occupied, 6) for name, n in zip(CLASS_NAMES[1:], total[1:], strict=True)}

    def _observed_ratio(self) -> dict[str, float]:
        voxels = int(self.counts.classes.sum())
        lidar, camera = self.counts.observed.sum(axis=0) / voxels
        return {"lidar": round(float(lidar), 6), "camera": round(float(camera), 6)}


def report_of(
    sequence: Sequence, parameters: LabelParameters, tiles: list[TileSummary], parts: list[FrameCounts]
) -> LabelReport:
    """The report of a run whose tiles and parts, in their order, were summed up so."""
    reference, counts = reference_from(tiles, parameters), concatenated(parts)
    findings = (*sequence.findings, *label_findings(sequence, parameters, reference, counts))
    return LabelReport(sequence, parameters, version("stone-platform"), reference, tuple(tiles), counts, findings)


def reference_from(tiles: list[TileSummary], parameters: LabelParameters) -> Reference:
    """The reference of all tiles, in their order. Raises `NoReferenceError`, also where there is no tile."""
    if not tiles:
        raise NoReferenceError(0)
    return reference_of(total_of([tile.sums for tile in tiles]), parameters.reference)


def label_findings(
    sequence: Sequence, parameters: LabelParameters, reference: Reference, counts: FrameCounts
) -> tuple[Finding, ...]:
    """What a person should know before trusting these labels."""
    found = []
    if reference.voxels < FEW_VOXELS:
        found.append(
            Finding(
                "LAB-601",
                "warning",
                "",
                f"the track covers {reference.voxels} surface voxels; below {FEW_VOXELS} the reference is a guess: "
                "drive farther, or use profile local",
            )
        )
    undriven = int((counts.classes[:, 1] == 0).sum())
    if undriven:
        found.append(
            Finding("LAB-602", "warning", "", f"{undriven} of {len(counts.classes)} frames hold no driven voxel")
        )
    return (*found, *_relief(sequence, parameters, reference))


def _relief(sequence: Sequence, parameters: LabelParameters, reference: Reference) -> tuple[Finding, ...]:
    """Profile `paper` measures elevation against where the robot drove: say loudly when that was nearly level."""
    if parameters.profile != "paper":
        return ()
    z = sequence.frames.map_from_ego.translation_m[:, 2]
    band_m = RELIEF_SIGMAS * float(np.sqrt(reference.covariance[0, 0]))
    if band_m > NARROW_RELIEF_RATIO * 6.4:
        return ()
    return (
        Finding(
            "LAB-603",
            "warning",
            "",
            f"the track spans {float(np.ptp(z)):.2f} m of elevation, so ground more than about {band_m:.2f} m above or "
            "below its mean is labelled non-traversable whatever its shape: profile local does not look at elevation",
        ),
    )
