"""Events that people may be told of, and their recording.

**Conventions.** `record` is part of the caller's transaction: no event without what it tells of, and nothing untold. An
event costs one row, whoever wants to be told of it; the sweeper makes deliveries of it. Events of `UNASKED` kinds are
sent by e-mail to the one they concern, whatever they chose.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
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
