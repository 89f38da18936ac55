"""One row of `benchmarks.outside`: a drive, a fault and a profile, recorded, labelled like `stone label`, judged.

**Conventions.** A row's figures are counts, which add over worlds; they are stored as JSON beside the ideal ranges. A
refusal keeps its code and no counts.
"""

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.outside.remedies import fault_of, opened
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import parameters_for
from stone.errors import StoneError
from testing.outside.drive import OutsideDrive
from testing.outside.verdict import Verdict, judge_labels

WORKERS = 2


@dataclass(frozen=True)
class Row:
    """A drive, the fault in it, and the profile that labels it."""

    drive: OutsideDrive
    fault: str
    profile: str

    def kept_in(self, folder: Path) -> Path:
        """Return the file of its figures."""
        return folder / f"{self.drive.name} {self.fault} {self.profile}.json".replace("/", " ")


@dataclass(frozen=True)
class Outcome:
    """The counts of one row and the codes of the label set's findings beyond information, or a refusal."""

    frames: int
    counts: dict[str, int]
    findings: tuple[str, ...]
    refused: str = ""

    def verdict(self) -> Verdict:
        """Return the counts as a verdict."""
        return Verdict(self.frames, Counter(self.counts))


def measure(row: Row, folder: Path) -> Outcome:
    """Return the outcome of a row, and store it in the folder; its recording and labels are deleted."""
    with TemporaryDirectory(dir=folder) as temporary:
        outcome = _outcome(row, folder, Path(temporary))
    row.kept_in(folder).write_text(json.dumps(outcome.__dict__, indent=1) + "\n")
    return outcome


def _outcome(row: Row, folder: Path, scratch: Path) -> Outcome:
    bag, calibration, _ = row.drive.record(folder, fault_of(row.fault), scratch / "recording")
    try:
        sequence, sweeps = opened(row.fault, bag, calibration)
        parameters = parameters_for(row.profile)  # type: ignore[arg-type]
        record = label(sequence, sweeps, scratch / "labels", LabelOptions(parameters, WORKERS)).as_record()
    except StoneError as error:
        return Outcome(0, {}, (), error.code)
    codes = tuple(sorted({finding["code"] for finding in record["findings"] if finding["severity"] != "info"}))
    verdict = judge_labels(scratch / "labels", row.drive.truth, sequence.calibration.ego_from_lidar.as_matrix())
    return Outcome(verdict.frames, dict(verdict.counts), codes)


def kept(row: Row, folder: Path) -> Outcome | None:
    """Return the stored outcome of a row, None if it was not measured."""
    path = row.kept_in(folder)
    if not path.exists():
        return None
    record = json.loads(path.read_text())
    return Outcome(record["frames"], record["counts"], tuple(record["findings"]), record["refused"])


def added(outcomes: Iterable[Outcome]) -> Verdict:
    """Return the sum of the counts."""
    total = Verdict()
    for outcome in outcomes:
        total.frames += outcome.frames
        total.counts.update(outcome.counts)
    return total
