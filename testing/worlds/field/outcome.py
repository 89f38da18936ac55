"""The results of a user's recording: the findings of `inspect`, and its labels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sandboxed_inspection import inspected_in
from services.ingest.sequence import OpenedSequence, with_sequence
from services.labeler.local_run import LabelOptions
from services.labeler.local_run import label as label_sequence
from services.labeler.report import LabelReport
from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.bags.bag import open_bag


@dataclass(frozen=True)
class FieldOutcome:
    """`findings` of inspection; `refusal` is the code that ended labelling, or "" if there are `labels`."""

    findings: tuple[Finding, ...]
    refusal: str
    labels: Path | None
    label_findings: tuple[Finding, ...] = ()

    @property
    def codes(self) -> set[str]:
        return {finding.code for finding in self.findings}

    @property
    def errors(self) -> list[Finding]:
        return [finding for finding in self.findings if finding.severity == "error"]

    def messages(self, code: str) -> str:
        """Return the sentences of the findings of one code."""
        return "\n".join(finding.message for finding in self.findings if finding.code == code)


def outcome_of(run: Path, calibration: Path, labels: Path, options: SynchroniseOptions | None = None) -> FieldOutcome:
    """Inspect a recording as `stone inspect --calibration` does, and label it as `stone label` does."""
    options = options or SynchroniseOptions()
    with open_bag(run) as bag:
        findings = inspected_in(bag, calibration=calibration, options=options).findings
    return labelled(run, calibration, labels, options, findings)


def labelled(
    run: Path, calibration: Path, labels: Path, options: SynchroniseOptions, findings: tuple[Finding, ...] = ()
) -> FieldOutcome:
    """Label a recording; return the outcome."""

    def made(opened: OpenedSequence) -> LabelReport:
        late = LabelOptions(late_inputs=opened.recording_inputs, late_findings=opened.late_findings)
        return label_sequence(opened.sequence, opened.sweeps, labels, late)

    try:
        report = with_sequence(run, calibration, "run", options, made)
    except StoneError as error:
        return FieldOutcome(findings, error.code, None)
    reported = tuple(Finding(**record) for record in report.as_record()["findings"])
    return FieldOutcome(findings, "", labels, reported)


def occupied_iou(one: Path, other: Path) -> float:
    """Return the IoU of the occupied voxels of two label sets of one drive, over the frames of one stamp.

    Label sets on two clocks, which have no stamp in common, are compared frame by frame in their order.
    """
    both = either = 0
    first, second = (labelled_frames(labels) for labels in (one, other))
    pairs = [(first[stamp], second[stamp]) for stamp in first.keys() & second.keys()]
    for path, as_path in pairs or zip(first.values(), second.values(), strict=True):
        occupied, as_occupied = _occupied(path), _occupied(as_path)
        both += int((occupied & as_occupied).sum())
        either += int((occupied | as_occupied).sum())
    return both / either


def labelled_frames(labels: Path) -> dict[int, Path]:
    """Return the label file of each labelled frame by the stamp of its sweep, in the order of time."""
    rows = pq.read_table(labels / "frames.parquet", columns=["frame_token", "stamp_ns", "exclusion_code"]).to_pylist()
    tokens = {row["stamp_ns"]: row["frame_token"] for row in rows if not row["exclusion_code"]}
    return {stamp: next((labels / "gts").glob(f"*/{tokens[stamp]}/labels.npz")) for stamp in sorted(tokens)}


def _occupied(labels: Path) -> NDArray[np.bool_]:
    with np.load(labels) as arrays:
        return np.asarray(arrays["semantics"] > 0)
