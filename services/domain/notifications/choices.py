"""What a user wants to be told of, and by which channel: nothing, until they say so."""

from collections.abc import Collection, Mapping

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.runtime.notifications.events import CHANNELS, EVENTS
from services.runtime.orm import NotificationChoice

Choices = Mapping[str, Collection[str]]
"""Kinds of events by channel."""


def choices_of(session: Session, user_id: str) -> dict[str, list[str]]:
    """The kinds that the user chose by channel, in the order of `EVENTS`."""
    rows = session.scalars(select(NotificationChoice).where(NotificationChoice.user_id == user_id))
    chosen = {(row.channel, row.kind) for row in rows}
    return {channel: [kind for kind in EVENTS if (channel, kind) in chosen] for channel in CHANNELS}


def choose(session: Session, user_id: str, choices: Choices) -> None:
    """Put these choices in place of the user's before."""
    session.execute(delete(NotificationChoice).where(NotificationChoice.user_id == user_id))
    rows = [(kind, channel) for channel, kinds in choices.items() for kind in sorted(set(kinds))]
    session.add_all(NotificationChoice(user_id=user_id, kind=kind, channel=channel) for kind, channel in rows)
    session.flush()
