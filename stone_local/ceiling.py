"""The ceiling of a benchmark: one drive labelled twice, each time from half of its points, and scored against itself.

**Conventions.** Both halves have the same frames, poses and track. The labels of the even half are the ground truth;
the labels of the odd half are the submission. A half has fewer points than the whole, so labels of the whole agree
better: the figure is conservative. Outputs: `even/` and `odd/` (label sets), `odd.zip` (the submission), `ceiling.json`
(a row for `stone benchmark reported`).
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from services.eval.pipeline import score
from services.ingest.sequence import OpenedSequence
from services.labeler.local_run import LabelOptions, Progress
from services.labeler.local_run import label as label_sequence
from services.labeler.parameters import LabelParameters
from stone.scoring.metric import RATIOS
from stone_files.atomic import atomic_file
from stone_local.frame_order import in_time_order
from stone_recordings.sync.halved_sweeps import HalvedSweeps, Halving
from stone_submissions.archive import frame_file, write_files
from stone_submissions.ground_truth import Mask, find_ground_truth

HALVES = ("even", "odd")
ROW_FILE = "ceiling.json"
NOTE = (
    "Labels of one drive from its even {by}, scored against labels of the same drive from its odd {by}. "
    "In per cent, ±1 voxel in height: IoU occ {tolerant[iou_occ]}, mIoU {tolerant[miou]}; columns: IoU occ "
    "{columns[iou_occ]}, mIoU {columns[miou]}; danger {danger}. No entry can be expected to score above this row."
)


@dataclass(frozen=True)
class CeilingPlan:
    """Settings to halve, label and score a drive; `output` is a folder."""

    output: Path
    by: Halving
    mask: Mask
    parameters: LabelParameters
    workers: int


def ceiling(opened: OpenedSequence, plan: CeilingPlan, progress: Progress) -> dict[str, Any]:
    """Write the files into the output folder; return the record of the score of one half against the other.

    Raises what labelling raises, and `no_rings`.
    """
    late = (opened.recording_inputs, opened.late_findings)
    for half, name in enumerate(HALVES):
        sweeps = HalvedSweeps(opened.sweeps, plan.by, half)
        options = LabelOptions(plan.parameters, plan.workers, {}, *late)
        label_sequence(opened.sequence, sweeps, plan.output / name, options, progress)
    truth, submission = (plan.output / name for name in HALVES)
    zip_path = plan.output / "odd.zip"
    given = find_ground_truth(submission)
    paths, grid = given.paths().items(), given.manifest.grid
    write_files(zip_path, ((token, frame_file(np.load(path)["semantics"], grid)) for token, path in paths))
    record = score(zip_path, truth, mask=plan.mask, progress=progress, order=in_time_order).as_record()
    row = row_of(record, opened.sequence.name, plan.by)
    with atomic_file(plan.output / ROW_FILE) as staging:
        staging.write_text(json.dumps(row, indent=1) + "\n", "utf-8")
    return record


def row_of(record: Mapping[str, Any], name: str, by: Halving) -> dict[str, Any]:
    """Return the score as a table of one row for `stone benchmark reported`."""
    percents = {reading: {ratio: _percent(record[reading][ratio]) for ratio in RATIOS} for reading in READINGS}
    row = {"method": f"Ceiling by {by}: {name}"[:100], "modality": "L", "percent": list(percents["total"].values())}
    return {
        "title": f"Ceiling of {name}",
        "kind": "ceiling",
        "source": f"stone ceiling --by {by}, {record['frames']} frames, {record['signature']}"[:300],
        "note": NOTE.format(by=by, danger=_percent(record["extras"]["n_predicted_drivable_ratio"]), **percents),
        "rows": [row],
    }


READINGS = ("total", "tolerant", "columns")


def _percent(ratio: float | None) -> str | None:
    return None if ratio is None else f"{100 * ratio:.1f}"
