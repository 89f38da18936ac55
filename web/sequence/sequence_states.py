"""The state of a sequence, the same on its page and in the list, and the trouble of its last labelling.

**Conventions.** States: `empty` without a recording, `reading` while one is being read, `recorded` without labels;
`queued` and `processing` while a labelling is alive; `labelled` with labels. `failed` and `cancelled` mean that the
last labelling ended so and there are no labels. Only the owner and administrators see runs; for others a sequence has
labels or none. Exports, comparisons and readings do not change the state of the sequence.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from api.schemas.base import instant
from api.schemas.sequences.sequences import SequenceItem
from services.domain.sequences.processing import PROCESS, REGISTER
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import AuditEntry, Job

STOPS = ("job.cancel", "job.terminate")


@dataclass(frozen=True)
class SequenceRuns:
    """The labelling that is alive, else the last one, and whether a recording is being read."""

    labelling: Job | None = None
    is_reading: bool = False

    @property
    def is_processing(self) -> bool:
        return self.labelling is not None and self.labelling.state not in TERMINAL


@dataclass(frozen=True)
class RunTrouble:
    """A labelling newer than the labels that count which did not succeed; `state` is failed or cancelled.

    `reason` is the failure's sentence or why it was cancelled; `code` is empty for a cancelled one.
    """

    run_id: str
    state: str
    code: str
    reason: str
    ended_at: datetime
    by_administrator: bool


def runs_of(session: Session, sequence_ids: Iterable[str]) -> Mapping[str, SequenceRuns]:
    """Return the runs that decide the state of each of these sequences, by one statement."""
    of_sequences = (Job.sequence_id.in_(list(sequence_ids)), Job.id == Job.root_id, Job.kind.in_((PROCESS, REGISTER)))
    newest = select(func.max(Job.id)).where(*of_sequences).group_by(Job.sequence_id, Job.kind)
    deciding = or_(Job.id.in_(newest), Job.state.in_(("queued", "running")))
    rows = defaultdict[str, list[Job]](list)
    for job in session.scalars(select(Job).where(*of_sequences, deciding).order_by(Job.id.desc())):
        rows[job.sequence_id or ""].append(job)
    return {sequence_id: _runs(jobs) for sequence_id, jobs in rows.items()}


def _runs(newest_first: list[Job]) -> SequenceRuns:
    labellings = [job for job in newest_first if job.kind == PROCESS]
    alive = [job for job in newest_first if job.state not in TERMINAL]
    followed = next((job for job in alive if job.kind == PROCESS), None) or next(iter(labellings), None)
    return SequenceRuns(followed, any(job.kind == REGISTER for job in alive))


def state_of(sequence: SequenceItem, runs: SequenceRuns) -> str:
    """Return the state, as in the head of this module."""
    if runs.labelling is not None and runs.is_processing:
        return "queued" if runs.labelling.state == "queued" else "processing"
    if runs.is_reading:
        return "reading"
    if sequence.labels is not None:
        return "labelled"
    if runs.labelling is not None and runs.labelling.state != "succeeded":
        return runs.labelling.state
    return "recorded" if sequence.recordings else "empty"


def is_troubled(sequence: SequenceItem, runs: SequenceRuns) -> bool:
    """Return whether the last labelling did not succeed, and the active labels, if any, are older."""
    run = runs.labelling
    if run is None or run.state not in ("failed", "cancelled"):
        return False
    return sequence.labels is None or instant(run.created_ns) > sequence.labels.chosen_at


def trouble_of(session: Session, sequence: SequenceItem, runs: SequenceRuns) -> RunTrouble | None:
    """Return the trouble that each section of the page shows, or None."""
    run = runs.labelling
    if run is None or not is_troubled(sequence, runs):
        return None
    is_cancelled = run.state == "cancelled"
    ended_at = instant(run.finished_ns or run.created_ns)
    code, reason = ("", run.cancel_reason) if is_cancelled else (run.failure_code, run.failure)
    return RunTrouble(run.id, run.state, code, reason, ended_at, is_cancelled and is_stopped_by_another(session, run))


def is_stopped_by_another(session: Session, run: Job) -> bool:
    """Return whether an administrator, not its owner, stopped the run."""
    stops = select(AuditEntry.actor_id).where(AuditEntry.subject_id == run.id, AuditEntry.act.in_(STOPS))
    actor_id = session.scalar(stops.order_by(AuditEntry.number.desc()).limit(1))
    return actor_id is not None and actor_id != run.owner_id
