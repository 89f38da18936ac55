"""The whole way once: simulate → label → predict from single sweeps → validate → score. Read this to see the seams.

**Conventions.** Everything lands in one folder, which appears whole or not at all; `demo.json` marks it as ours, so
that the next demo may replace it.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from client.progress import Report
from client.sequences import open_sequence
from services.eval.manifest import Manifest, write_manifest
from services.eval.pipeline import score, validate
from services.eval.submission import write_submission
from services.eval.validation import SubmissionRefusedError
from services.labeler.parameters import parameters_for
from services.labeler.pipeline import LabelOptions, label
from services.runtime.atomic import atomic_directory
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.baseline import predict_from_sweep
from stone.sequence import Sequence, SweepSource

MARK = "demo.json"
SEQUENCE = "demo"


@dataclass(frozen=True)
class DemoPlan:
    """What to simulate, and on how many processes to label it."""

    simulation: SimulateOptions
    workers: int


def run_demo(directory: Path, plan: DemoPlan, progress: Report) -> dict[str, Any]:
    """Fill `directory` and return the record that `demo.json` keeps.

    Raises `OutputExistsError` where the folder holds something else than an earlier demo.
    """
    with atomic_directory(directory, replaces=MARK) as folder:
        bag = folder / "run.mcap"
        simulate(bag, plan.simulation, folder / "truth", progress)
        sequence, sweeps = open_sequence(bag, calibration_path(bag), SEQUENCE)
        labels = label(
            sequence, sweeps, folder / "labels", LabelOptions(parameters_for("paper"), plan.workers), progress
        )
        write_manifest(folder / "manifest.json", Manifest({SEQUENCE: sequence.frames.tokens}))
        write_submission(folder / "baseline.zip", _predictions(sequence, sweeps, progress))
        validation = validate(folder / "baseline.zip", folder / "manifest.json", progress=progress)
        if not validation.ok:
            raise SubmissionRefusedError(validation)
        scores = score(folder / "baseline.zip", folder / "labels", progress=progress)
        record = {"labels": labels.as_record(), "baseline": scores.as_record()}
        (folder / MARK).write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    return record


def _predictions(sequence: Sequence, sweeps: SweepSource, progress: Report) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """What one sweep alone says about its frame: the score to beat."""
    ego_from_lidar = sequence.calibration.ego_from_lidar
    for index, token in enumerate(sequence.frames.tokens):
        points_ego = ego_from_lidar @ sweeps.sweep(index).points_lidar.astype(np.float64)
        yield token, predict_from_sweep(points_ego.astype(np.float32))
        progress("predict", index + 1, len(sequence.frames))
