"""A submission and the ground truth for its scoring, read from the database.

**Conventions.** A stage may run twice, and long after its submission has ended, so it checks the state first. Queued
and scoring submissions are in progress; a scored submission can only be scored again by another evaluation version.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions.state_machine import LIVE
from services.eval.scoring_errors import truth_unready
from services.runtime.code_version import code_version
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Blob, GroundTruthRow, Score, SubmissionRow
from services.runtime.platform import Platform
from stone.errors import Refused
from stone_base.label_grid import LabelGrid, recorded_grid
from stone_submissions.manifest import Manifest, read_manifest

VALIDATION = "validation"


@dataclass(frozen=True)
class ReadyTruth:
    """A ready ground truth and its objects."""

    id: str
    sha256: str
    mask: str
    frames: int
    facts: Mapping[str, Any]
    manifest_key: str
    pack_key: str

    @property
    def grid(self) -> LabelGrid:
        """The grid of its labels."""
        return recorded_grid(self.facts.get("grid"))

    def manifest(self, platform: Platform) -> Manifest:
        return read_manifest(platform.store.local(self.manifest_key))


@dataclass(frozen=True)
class KeptCounts:
    """The counts of an earlier score, and the version of the code that counted them."""

    object_key: str
    code_version: str


@dataclass(frozen=True)
class Case:
    """`zip_key` is the object of the file; empty if the file is not stored (any more).

    `kept` are reusable counts against this ground truth: this code version counted them, or the file was deleted.
    """

    submission_id: str
    phase_id: str
    is_validation: bool
    state: str
    zip_key: str
    kept: KeptCounts | None
    truth: ReadyTruth

    @property
    def is_under_way(self) -> bool:
        return self.state in LIVE

    @property
    def is_over(self) -> bool:
        """Whether the submission needs no more counting."""
        return self.state not in (*LIVE, "scored")

    def kept_key(self) -> str:
        """Return the object key of the file. Raises `submission_purged`."""
        if not self.zip_key:
            raise Refused(
                "submission_purged",
                f"the file of submission {self.submission_id} was deleted and cannot be counted again; send it again",
            )
        return self.zip_key


def live_submission(session: Session, submission_id: str) -> SubmissionRow:
    """Return the current row. Raises `JobCancelledError` if it was deleted."""
    submission = session.get(SubmissionRow, submission_id, populate_existing=True)
    if submission is None:
        raise JobCancelledError("its submission was deleted")
    return submission


def case_of(session: Session, submission_id: str, truth_id: str) -> Case:
    """Return the case. Raises `JobCancelledError`, `ground_truth_unready`."""
    row = live_submission(session, submission_id)
    zip_key = session.scalar(select(Blob.object_key).where(Blob.sha256 == row.blob_sha256)) or ""
    return Case(
        submission_id=row.id,
        phase_id=row.phase_id,
        is_validation=row.kind == VALIDATION,
        state=row.state,
        zip_key=zip_key,
        kept=_kept_counts(session, row.id, truth_id, is_file_kept=zip_key != ""),
        truth=truth_of(session, truth_id),
    )


def truth_of(session: Session, truth_id: str) -> ReadyTruth:
    """Return the ground truth. Raises `ground_truth_unready`."""
    row = session.get(GroundTruthRow, truth_id)
    if row is None or row.ready_ns is None:
        raise truth_unready(f"ground truth {truth_id}")
    manifest, pack = (session.get_one(Blob, sha256).object_key for sha256 in (row.manifest_sha256, row.pack_sha256))
    return ReadyTruth(row.id, row.sha256, row.mask, row.frames, row.facts, manifest, pack)


def _kept_counts(session: Session, submission_id: str, truth_id: str, *, is_file_kept: bool) -> KeptCounts | None:
    """Return counts by this code version, or by another version if the counted file was deleted."""
    of_both = (Score.submission_id == submission_id, Score.truth_id == truth_id)
    counted = select(Blob.object_key, Score.record).join(Score, Score.confusions_sha256 == Blob.sha256).where(*of_both)
    rows = session.execute(counted.order_by(Score.id)).all()
    kept = [KeptCounts(key, str(record.get("code_version", ""))) for key, record in rows]
    ours = [score for score in kept if score.code_version == code_version("scores")]
    return next(iter(ours if is_file_kept else ours + kept), None)
