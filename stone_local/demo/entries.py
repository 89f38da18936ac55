"""The demo's entries: three predictions without training, of the frames of a manifest.

**Conventions.** Two are baselines, which stand on the board without a rank; one is the team's ranked entry.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stone.labels.baseline import DEFAULTS, BaselineParameters
from stone.labels.grid import GRID_MIN_M, GRID_SHAPE
from stone.labels.voxels import VOXEL_M
from stone_client.progress import Report
from stone_local.baseline import BaselinePlan, write_baseline
from stone_submissions.manifest import read_manifest
from stone_submissions.writer import frame_file, write_files

THREADS = 2
POTENTIALLY_TRAVERSABLE = 2


@dataclass(frozen=True)
class DemoEntry:
    """A submission of the demo: file, method, kind; `parameters` of the baseline, None for flat ground."""

    filename: str
    method: str
    kind: str
    parameters: BaselineParameters | None


BASELINE = DemoEntry("baseline.zip", "single sweep, no training", "baseline", DEFAULTS)
ENTRIES = (
    BASELINE,
    DemoEntry("flat.zip", "flat ground", "baseline", None),
    DemoEntry(
        "corridor.zip",
        "single sweep, long corridor",
        "entry",
        BaselineParameters(corridor_reach_m=25.6, gap_passes=12),
    ),
)


def write_entry(entry: DemoEntry, manifest: Path, sources: Sequence[Path], progress: Report) -> Path:
    """The submission, beside the manifest. Raises what `write_baseline` raises."""
    output = manifest.with_name(entry.filename)
    if entry.parameters is None:
        write_flat_ground(manifest, output)
    else:
        write_baseline(sources, BaselinePlan(manifest, output, THREADS, entry.parameters), progress)
    return output


def write_flat_ground(manifest: Path, output: Path) -> None:
    """Potentially traversable ground at the robot's height in every frame, and nothing else."""
    grid = np.zeros(GRID_SHAPE, np.uint8)
    grid[:, :, round(-GRID_MIN_M[2] / VOXEL_M)] = POTENTIALLY_TRAVERSABLE
    content = frame_file(grid)
    write_files(output, ((token, content) for token in read_manifest(manifest).tokens))
