"""Writes scores and partial counts, each once, in the caller's transaction.

**Conventions.** The bytes are prepared before the transaction and linked in it. A job that is delivered twice writes
the same row again, without effect.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.runtime.database.inserts import insert_new
from services.runtime.orm import Score, ScorePart, new_id
from services.runtime.orm.base import now_ns
from services.runtime.store.blobs import PreparedBlob, link_all
from stone.scoring.metric import RATIOS


@dataclass(frozen=True)
class NewScore:
    """The score from the join of a submission; `record` is what the board reads, `total` its total by `RATIOS`."""

    submission_id: str
    evaluation_version: EvaluationVersion
    signature: str
    record: Mapping[str, Any]
    confusions: PreparedBlob
    spectra: PreparedBlob
    content_sha256: str


@dataclass(frozen=True)
class CountedPart:
    """Frames [start, stop) of a submission against a ground truth; `services/eval/examination.py` packs `counts`."""

    submission_id: str
    truth_id: str
    start: int
    stop: int
    counts: bytes
    problems: Mapping[str, Any]
    code_version: str


def write_score(session: Session, new: NewScore) -> Score:
    """Write the score with its blobs and delete its parts; an existing score is returned unchanged."""
    link_all(session, (new.confusions, new.spectra))
    facts = {
        "id": new_id(),
        "submission_id": new.submission_id,
        "truth_id": new.evaluation_version.truth_id,
        "metric": new.evaluation_version.metric,
        "signature": new.signature,
        "record": dict(new.record),
        "confusions_sha256": new.confusions.sha256,
        "spectra_sha256": new.spectra.sha256,
        "content_sha256": new.content_sha256,
        "created_ns": now_ns(),
    }
    insert_new(session, Score, [{**facts, **{name: new.record["total"][name] for name in RATIOS}}])
    drop_parts(session, new.submission_id, new.evaluation_version.truth_id)
    same = (Score.submission_id == new.submission_id, Score.truth_id == new.evaluation_version.truth_id)
    return session.scalars(select(Score).where(*same, Score.metric == new.evaluation_version.metric)).one()


def write_part(session: Session, part: CountedPart) -> None:
    """Store a counted part for the join, unless it is stored already."""
    insert_new(session, ScorePart, [{**vars(part), "problems": dict(part.problems)}])


def drop_parts(session: Session, submission_id: str, truth_id: str) -> None:
    """Delete partial counts that were joined or will never be joined."""
    of_both = (ScorePart.submission_id == submission_id, ScorePart.truth_id == truth_id)
    session.execute(delete(ScorePart).where(*of_both))


def drop_all_parts(session: Session, submission_id: str) -> None:
    """Delete all partial counts of an ended submission."""
    session.execute(delete(ScorePart).where(ScorePart.submission_id == submission_id))
