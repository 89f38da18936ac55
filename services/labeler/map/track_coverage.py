"""Coverage of the robot's track by T, over all maps of a run (`stone.labels.track_coverage`)."""

from collections import defaultdict
from pathlib import Path

import numpy as np

from services.labeler.frames import LabelledTile
from services.labeler.run import LabelRun, Tile
from services.labeler.scratch import load, save
from stone.findings import Finding
from stone.geometry.lattice import Keys
from stone.labels.footprint import densified
from stone.labels.track_coverage import STEP_M, TrackCoverage, coverage, spaced
from stone.sensors.ego_path import ego_path

# At least 99.7 % of simulated tracks are closed, and at least 83 % in sound drives through tall grass, since the
# surface is above the band there. With the LiDAR mount entered 10 cm too high, 70 and 75 % are closed
# (`make bench-outside`).
COVERAGE = "coverage.npz"
USUAL_RATIO = 0.8


class CoverageCounter:
    """Collects driven voxels tile by tile."""

    def __init__(self, run: LabelRun) -> None:
        self._run = run
        self._driven = defaultdict[int, list[Keys]](list)

    def add(self, tile: Tile, labelled: LabelledTile) -> None:
        """Add one tile."""
        self._driven[tile.map].append(labelled.terrain.keys[labelled.is_driven])

    def coverage(self) -> TrackCoverage:
        """Return the coverage of all sections of the track, each in its own map."""
        sequence, total = self._run.sequence, TrackCoverage(0, 0, 0, 0)
        for number in np.unique(self._run.maps).tolist():
            driven = np.concatenate([np.zeros(0, np.int64), *self._driven[number]])
            for stretch in ego_path(sequence, number):
                total += coverage(driven, spaced(densified(stretch, STEP_M)), sequence.calibration.footprint)
        return total


def coverage_path(run: LabelRun) -> Path:
    return run.scratch / COVERAGE


def save_coverage(run: LabelRun, coverage: TrackCoverage) -> None:
    save(
        coverage_path(run),
        {"counts": np.array([coverage.places, coverage.closed, coverage.poses, coverage.bare], np.int64)},
    )


def load_coverage(run: LabelRun) -> TrackCoverage:
    return TrackCoverage(*load(coverage_path(run))["counts"].tolist())


def coverage_findings(coverage: TrackCoverage, band_m: float) -> tuple[Finding, ...]:
    """Return LAB-607 if less of the track is T than on driven ground in general."""
    if coverage.closed_ratio >= USUAL_RATIO:
        return ()
    sentence = (
        f"{1 - coverage.closed_ratio:.1%} of the footprint's track has no T ({coverage.bare} of {coverage.poses} poses "
        f"have none): there is no surface within ±{band_m:g} m of the footprint. Do the poses drift in z, is the "
        "footprint too high or too low, or did the LiDAR not observe the ground there?"
    )
    return (Finding("LAB-607", "warning", "", sentence),)
