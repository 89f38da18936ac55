"""Who is told of an event: asked when deliveries are made of it, and again when each is sent.

**Conventions.** An event of a user is told to them, one of a team to whoever is in it then, any other to everybody with
an account. Somebody who was shut out, has left the team or does not want it any more is told nothing, whenever the
event was. What the event is about may be gone meanwhile: then there are no words for it (`messages`).
"""

from collections.abc import Iterator

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.runtime.notifications.events import UNASKED
from services.runtime.orm import NotificationChoice, NotificationEvent, TeamMember, User


def audience_of(session: Session, event: NotificationEvent) -> Iterator[tuple[str, str]]:
    """(user, channel) of whoever is to be told now."""
    if event.kind in UNASKED:
        if event.user_id is not None:
            yield event.user_id, "email"
        return
    for row in session.execute(_chosen(event).order_by(NotificationChoice.user_id)):
        yield row.user_id, row.channel


def is_to_be_told(session: Session, event: NotificationEvent, user_id: str, channel: str) -> bool:
    """Whether the user is still in the audience of the event by this channel."""
    if event.kind in UNASKED:
        is_active = select(User.is_active).where(User.id == user_id)
        return event.user_id == user_id and bool(session.scalar(is_active))
    is_theirs = (NotificationChoice.user_id == user_id, NotificationChoice.channel == channel)
    return session.execute(_chosen(event).where(*is_theirs)).first() is not None


def _chosen(event: NotificationEvent) -> Select[str, str]:
    chosen = select(NotificationChoice.user_id, NotificationChoice.channel)
    chosen = chosen.join(User, User.id == NotificationChoice.user_id)
    chosen = chosen.where(NotificationChoice.kind == event.kind, User.is_active)
    if event.user_id is not None:
        return chosen.where(NotificationChoice.user_id == event.user_id)
    if event.team_id is not None:
        members = select(TeamMember.user_id).where(TeamMember.team_id == event.team_id)
        return chosen.where(NotificationChoice.user_id.in_(members))
    return chosen
