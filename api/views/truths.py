"""Ground truths and reported rows as the API shows them."""

from collections.abc import Sequence
from hashlib import sha256
from typing import Any, Literal

from sqlalchemy.orm import Session

from api.schemas.truths import ReportedItem, TruthItem
from services.domain.benchmarks.phases import evaluation_versions
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Dataset, GroundTruthRow, Job, Phase, Reported


def truth_items(session: Session, phase: Phase, rows: Sequence[GroundTruthRow]) -> list[TruthItem]:
    """Return ground truths of one phase."""
    pair = evaluation_versions.active(session, phase.id)
    return [_item(session, row, pair is not None and pair.truth_id == row.id) for row in rows]


def reported_item(row: Reported) -> ReportedItem:
    return ReportedItem(**{name: getattr(row, name) for name in ReportedItem.model_fields})


def reported_tag(items: Sequence[ReportedItem]) -> str:
    """Return the revision of all reported rows of a phase."""
    return sha256("\n".join(item.model_dump_json() for item in items).encode()).hexdigest()


def _item(session: Session, row: GroundTruthRow, is_active: bool) -> TruthItem:
    return TruthItem.of(
        row,
        dataset=session.get_one(Dataset, row.dataset_id).name,
        state=_state(session, row),
        is_active=is_active,
        sha256=row.sha256 or None,
    )


def _state(session: Session, row: GroundTruthRow) -> Literal["making", "ready", "failed"]:
    """Return the state; a cancelled ground truth is `failed`, and its job has the reason."""
    if row.ready_ns is not None:
        return "ready"
    job: Any = session.get(Job, row.job_id) if row.job_id else None
    return "making" if job is not None and job.state not in TERMINAL else "failed"
