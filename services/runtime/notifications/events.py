"""Events that people may be told of, and their recording.

**Conventions.** `record` is part of the caller's transaction: no event without what it tells of, and nothing untold. An
event costs one row, whoever wants to be told of it; the sweeper makes deliveries of it. Events of `UNASKED` kinds are
sent by e-mail to the one they concern, whatever they chose.
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
    LABELS_UNUSABLE: "A finding makes my labels unreliable",
    SUBMISSION_SCORED: "A submission of my team was scored",
    SUBMISSION_INVALID: "A submission of my team is invalid",
    SUBMISSION_FAILED: "A submission of my team could not be scored",
    PHASE_OPENED: "A phase of a benchmark opens",
    PHASE_CLOSED: "A phase of a benchmark closes",
    QUOTA_LOW: "My storage or my team's submissions are running low",
}
"""What each kind tells, in the words of who chooses."""
EMAIL_VERIFICATION, WEBHOOK_DISABLED = "email.verification", "webhook.disabled"
UNASKED = (EMAIL_VERIFICATION, WEBHOOK_DISABLED)
CHANNELS = ("email", "webhook")


@dataclass(frozen=True)
class NewEvent:
    """An event to be recorded, told to a user, else to a team, else to everybody.

    `key` is what it has in common with itself where it is found again; empty where it happens once.
    """

    kind: str
    subject_id: str
    user_id: str | None = None
    team_id: str | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    key: str = ""


def record(session: Session, new: NewEvent) -> bool:
    """Write the event; false where one of its key is there already."""
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


# The end of a run as an event to its owner.
#
# **Conventions.** Told are runs that somebody asked for and waits for. A submission's run is told of as the
# submission; what the platform does by itself (playbacks) and the deliveries of notifications are not told.


TOLD = {
    "sequence.process": "processing",
    "dataset.import": "a dataset import",
    "labeler.export": "the export",
    "dataset.inputs": "creating a dataset's inputs",
    "phase.inputs": "creating a phase's inputs",
    "eval.truth": "creating a ground truth",
    "phase.rescore": "a re-score",
}
"""Runs that are told of, by their kind, in words."""
TOLD_FAILED = {**TOLD, "ingest.register": "reading a recording"}
LONGEST_FAILURE = 500
STOPPED = "cancelled"
"""The code of a run that an administrator stopped."""


def tell_run_succeeded(session: Session, run: Job) -> None:
    """Record that the run is done, where that is told."""
    if run.kind in TOLD and not _is_playback(session, run):
        record(session, NewEvent(RUN_DONE, run.id, user_id=run.owner_id))


def tell_run_failed(session: Session, run: Job, code: str, sentence: str) -> None:
    """Record that the run failed with this code and sentence, where that is told."""
    if run.kind in TOLD_FAILED and not _is_playback(session, run):
        facts = {"code": code, "failure": sentence[:LONGEST_FAILURE]}
        record(session, NewEvent(RUN_FAILED, run.id, user_id=run.owner_id, facts=facts))


def tell_run_stopped(session: Session, run: Job, reason: str) -> None:
    """Record that somebody other than its owner stopped the run, where its failure would be told."""
    tell_run_failed(session, run, STOPPED, reason)


def _is_playback(session: Session, run: Job) -> bool:
    """Whether it makes the small pictures of the viewer, which nobody asks for."""
    format_ = select(Export.format).where(Export.job_id == run.id).limit(1)
    return run.kind == "labeler.export" and session.scalar(format_) == "playback"
