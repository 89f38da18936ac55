"""The status of a sequence and its next step, shown at the top of every section of its page.

**Conventions.** Words: `running` while a run of it is alive, `ready` with labels, `failed` where the last labelling did
not succeed, `recorded` with a recording, `empty` before.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Caller
from api.etags import etag
from api.schemas.jobs import JobDetail, JobItem
from api.schemas.sequences.sequences import SequenceDetail
from api.views.jobs import job_detail, job_items
from api.views.sequences import sequence_detail
from api.visible import labels_of, shown_sequence
from services.domain.sequences.processing import PROCESS
from services.runtime.access import roles
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job
from web.sequence.origin import LabelOrigin, origin_of

MOST_RUNS = 12


@dataclass(frozen=True)
class Section:
    """One part of the page; `is_own` are shown to the owner and to administrators only."""

    path: str
    title: str
    is_own: bool = False


SECTIONS = (
    Section("", "Overview"),
    Section("/frames", "Frames"),
    Section("/track", "Track"),
    Section("/recordings", "Recordings", is_own=True),
    Section("/calibration", "Calibration"),
    Section("/processing", "Processing", is_own=True),
    Section("/label-sets", "Label sets", is_own=True),
    Section("/exports", "Exports", is_own=True),
)


@dataclass(frozen=True)
class SequenceStatus:
    """A sequence as who looks may see it: `run` is the one that is alive, else the last labelling; others see none.

    `origin` is what the labels that count were imported from.
    """

    sequence: SequenceDetail
    is_own: bool
    may_change: bool
    word: str
    match: str
    run: JobDetail | None
    runs: tuple[JobItem, ...]
    origin: LabelOrigin | None = None

    @property
    def may_process(self) -> bool:
        """Whether there is, or may be, something to process: what was imported brought no recording."""
        return self.may_change and (self.origin is None or self.sequence.recordings > 0)

    @property
    def sections(self) -> tuple[Section, ...]:
        return tuple(section for section in SECTIONS if self.is_own or not section.is_own)

    @property
    def is_alive(self) -> bool:
        return self.run is not None and self.run.state not in TERMINAL


def sequence_status_of(session: Session, caller: Caller, sequence_id: str) -> SequenceStatus:
    """Raises `NotFoundError`."""
    row = shown_sequence(session, caller, sequence_id)
    shown = sequence_detail(session, row, caller)
    is_own = caller.is_administrator or row.owner_id == caller.user_id
    jobs = _runs(session, sequence_id) if is_own else []
    followed = next((job for job in jobs if job.state not in TERMINAL), None) or _labelling(jobs)
    return SequenceStatus(
        shown,
        is_own,
        is_own and "upload" in caller.scopes and roles.allows(caller.role, ("curator",)),
        word_of(shown, jobs),
        etag(shown.revision),
        job_detail(session, followed) if followed else None,
        tuple(job_items(session, jobs)),
        origin_of(labels_of(session, sequence_id)),
    )


def word_of(sequence: SequenceDetail, runs: Listing[Job]) -> str:
    """One word, as in the head of this module."""
    if any(run.state not in TERMINAL for run in runs):
        return "running"
    if sequence.labels is not None:
        return "ready"
    last = _labelling(runs)
    if last is not None and last.state != "succeeded":
        return last.state
    return "recorded" if sequence.recordings else "empty"


def _labelling(runs: Listing[Job]) -> Job | None:
    """The last labelling, ended or not."""
    return next((run for run in runs if run.kind == PROCESS), None)


def _runs(session: Session, sequence_id: str) -> list[Job]:
    newest = select(Job).where(Job.sequence_id == sequence_id, Job.id == Job.root_id).order_by(Job.id.desc())
    return list(session.scalars(newest.limit(MOST_RUNS)))
