"""The status of a sequence and its next step, shown at the top of every section of its page.

**Conventions.** `state` is one of `web/sequence/sequence_states.py`. It follows the labelling; exports, comparisons and
readings have their own line.
"""

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
from services.domain.exports.requests import LAST
from services.domain.sequences.processing import PROCESS
from services.runtime.access import roles
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, LabelSet
from web.sequence.sequence_states import RunTrouble, SequenceRuns, runs_of, state_of, trouble_of


@dataclass(frozen=True)
class LabelOrigin:
    """The dataset's name as its importer gave it, the sha256 of its tar, and the name of the class map, if any."""

    dataset: str
    sha256: str
    classes: str


def origin_of(labels: LabelSet | None) -> LabelOrigin | None:
    """Return the origin; None without labels, or if they were made from a recording."""
    parameters = {} if labels is None else labels.parameters
    if not parameters.get("dataset") or not parameters.get("sha256"):
        return None
    return LabelOrigin(
        str(parameters["dataset"]), str(parameters["sha256"]), str((parameters.get("classes") or {}).get("name", ""))
    )


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
    Section("/exports", "Exports"),
)


@dataclass(frozen=True)
class SequenceStatus:
    """A sequence as who looks may see it: `run` is the labelling that is alive, else the last; others see none.

    `runs` are the newest of all kinds. `trouble` is why labels are missing or older than the last labelling. `origin`
    is what the labels that count were imported from.
    """

    sequence: SequenceDetail
    is_own: bool
    may_change: bool
    state: str
    match: str
    run: JobDetail | None
    runs: tuple[JobItem, ...]
    is_reading: bool = False
    trouble: RunTrouble | None = None
    origin: LabelOrigin | None = None

    @property
    def may_process(self) -> bool:
        """Return whether there can be something to process: imported labels come without a recording."""
        return self.may_change and (self.origin is None or self.sequence.recordings > 0)

    @property
    def sections(self) -> tuple[Section, ...]:
        return tuple(section for section in SECTIONS if self.is_own or not section.is_own)

    @property
    def is_alive(self) -> bool:
        """Whether the sequence is being labelled or queued for it."""
        return self.run is not None and self.run.state not in TERMINAL

    @property
    def beside(self) -> tuple[JobItem, ...]:
        """Return the requested runs that are not over and label nothing."""
        alive = (run for run in self.runs if run.kind != PROCESS and run.state not in TERMINAL)
        return tuple(run for run in alive if run.priority != LAST)

    @property
    def processing_step(self) -> str:
        """The third step of setting up: open, running, failed or done."""
        if self.is_alive:
            return "running"
        if self.run is not None and self.run.state in ("failed", "cancelled"):
            return "failed"
        return "done" if self.run is not None else "open"


def sequence_status_of(session: Session, caller: Caller, sequence_id: str) -> SequenceStatus:
    """Return the status. Raises `NotFoundError`."""
    row = shown_sequence(session, caller, sequence_id)
    shown = sequence_detail(session, row, caller)
    is_own = caller.is_administrator or row.owner_id == caller.user_id
    runs = runs_of(session, [sequence_id]).get(sequence_id, SequenceRuns()) if is_own else SequenceRuns()
    jobs = _runs(session, sequence_id) if is_own else []
    return SequenceStatus(
        shown,
        is_own,
        is_own and may_change_own(caller),
        state_of(shown, runs),
        etag(shown.revision),
        job_detail(session, runs.labelling) if runs.labelling else None,
        tuple(job_items(session, jobs)),
        runs.is_reading,
        trouble_of(session, shown, runs),
        origin_of(labels_of(session, sequence_id)),
    )


def may_change_own(caller: Caller) -> bool:
    """Return whether the caller may change their own sequences, by the rules of the API's routes."""
    return "upload" in caller.scopes and roles.allows(caller.role, ("curator",))


def _runs(session: Session, sequence_id: str) -> list[Job]:
    newest = select(Job).where(Job.sequence_id == sequence_id, Job.id == Job.root_id).order_by(Job.id.desc())
    return list(session.scalars(newest.limit(MOST_RUNS)))
