"""Notification events, and their recording.

**Conventions.** `record` is part of the caller's transaction: an event exists exactly if its cause does. An event costs
one row for any number of recipients; the sweeper creates its deliveries. Events of `UNASKED` kinds are sent by e-mail
to the user concerned, regardless of their choices.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.orm import Export, Job
from services.runtime.orm.base import new_id, now_ns
from services.runtime.orm.notifications import NotificationEvent

RUN_DONE, RUN_FAILED = "run.done", "run.failed"
SUBMISSION_SCORED, SUBMISSION_INVALID, SUBMISSION_FAILED = (
    "submission.scored",
    "submission.invalid",
    "submission.failed",
)
PHASE_OPENED, PHASE_CLOSED = "phase.opened", "phase.closed"
QUOTA_LOW, LABELS_UNUSABLE = "quota.low", "labels.unusable"
EVENTS: Mapping[str, str] = {
    RUN_DONE: "One of my runs finished",
    RUN_FAILED: "One of my runs failed",
    LABELS_UNUSABLE: "A run finished with warnings about its labels",
    SUBMISSION_SCORED: "A submission of my team was scored",
    SUBMISSION_INVALID: "A submission of my team is invalid",
    SUBMISSION_FAILED: "A submission of my team could not be scored",
    PHASE_OPENED: "A phase of a benchmark opens",
    PHASE_CLOSED: "A phase of a benchmark closes",
    QUOTA_LOW: "My storage or my team's submissions are running low",
}
"""Each kind of event, in words for the choice of notifications."""
EMAIL_VERIFICATION, WEBHOOK_DISABLED = "email.verification", "webhook.disabled"
UNASKED = (EMAIL_VERIFICATION, WEBHOOK_DISABLED)
CHANNELS = ("email", "webhook")


@dataclass(frozen=True)
class NewEvent:
    """An event to record, for a user, else for a team, else for all users.

    `key` identifies an event that may be detected twice; it is empty if the event happens once.
    """

    kind: str
    subject_id: str
    user_id: str | None = None
    team_id: str | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    key: str = ""


def record(session: Session, new: NewEvent) -> bool:
    """Write the event; return False if an event with its key exists already."""
    event_id = new_id()
    values = {
        "id": event_id,
        "kind": new.kind,
        "key": new.key or event_id,
        "user_id": new.user_id,
        "team_id": new.team_id,
        "subject_id": new.subject_id,
        "facts": dict(new.facts),
        "created_ns": now_ns(),
    }
    return bool(insert_new(session, NotificationEvent, [values]))


# The end of a run as an event for its owner.
#
# **Conventions.** Only runs that a user requested create events. A submission's run creates the submission's event;
# automatic runs (playbacks) and deliveries of notifications create none.


TOLD = {
    "sequence.process": "processing",
    "dataset.import": "a dataset import",
    "labeler.export": "the export",
    "dataset.inputs": "creating a dataset's inputs",
    "phase.inputs": "creating a phase's inputs",
    "eval.truth": "creating a ground truth",
    "phase.rescore": "a re-score",
}
"""Runs that create events: their kind, in words."""
TOLD_FAILED = {**TOLD, "ingest.register": "reading a recording"}
LONGEST_FAILURE = 500
STOPPED = "cancelled"
"""The code of a run that an administrator stopped."""


def tell_run_succeeded(session: Session, run: Job) -> None:
    """Record that the run is done, if its kind creates events."""
    if run.kind in TOLD and not _is_playback(session, run):
        record(session, NewEvent(RUN_DONE, run.id, user_id=run.owner_id))


def tell_run_failed(session: Session, run: Job, code: str, sentence: str) -> None:
    """Record that the run failed with this code and sentence, if its kind creates events."""
    if run.kind in TOLD_FAILED and not _is_playback(session, run):
        facts = {"code": code, "failure": sentence[:LONGEST_FAILURE]}
        record(session, NewEvent(RUN_FAILED, run.id, user_id=run.owner_id, facts=facts))


def tell_run_stopped(session: Session, run: Job, reason: str) -> None:
    """Record that another user stopped the run, if its failure would create an event."""
    tell_run_failed(session, run, STOPPED, reason)


def _is_playback(session: Session, run: Job) -> bool:
    """Return whether it creates the small pictures of the viewer, which start automatically."""
    format_ = select(Export.format).where(Export.job_id == run.id).limit(1)
    return run.kind == "labeler.export" and session.scalar(format_) == "playback"
