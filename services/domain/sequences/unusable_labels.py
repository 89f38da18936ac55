"""Notification of the sequence's owner about a finding of severity error, which makes labels unusable."""

from collections.abc import Iterable, Mapping
from typing import Any

from sqlalchemy.orm import Session

from services.runtime.notifications.events import LABELS_UNUSABLE, NewEvent, record
from services.runtime.orm import SequenceRow

LONGEST = 500


def record_unusable(session: Session, sequence_id: str, findings: Iterable[Mapping[str, Any]]) -> None:
    """Record the first of these findings (`stone/findings.py`) that is an error, if any."""
    errors = [finding for finding in findings if finding["severity"] == "error"]
    if not errors:
        return
    facts = {"code": str(errors[0]["code"])[:64], "message": str(errors[0]["message"])[:LONGEST], "errors": len(errors)}
    owner_id = session.get_one(SequenceRow, sequence_id).owner_id
    record(session, NewEvent(LABELS_UNUSABLE, sequence_id, user_id=owner_id, facts=facts))
