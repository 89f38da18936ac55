"""Spreads events: an event becomes a delivery for each user and channel; a due delivery becomes a job.

**Conventions.** One transaction claims an event, spreads it and queues the jobs of its deliveries, so each event is
spread once. While a delivery is `queued` it belongs to its job; a failed job leaves it `waiting` until `due_ns`. A job
that ended without a result (its process was lost too often, or it was cancelled) is detected here. Pauses grow as
Standard
Webhooks recommends: `retry_s` (5 s), 5 min, 30 min, 2 h, 5 h, 10 h, 14 h, 20 h, 24 h.
"""

from collections.abc import Collection, Iterator, Mapping

from sqlalchemy import Select, delete, select, update
from sqlalchemy.orm import Session

from services.runtime.jobs.changes import rows_changed
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import TERMINAL, Context, JobSpec
from services.runtime.notifications.events import (
    CHANNELS,
    EVENTS,
    PHASE_CLOSED,
    PHASE_OPENED,
    UNASKED,
    NewEvent,
    record,
)
from services.runtime.orm import (
    Job,
    NotificationChoice,
    NotificationDelivery,
    NotificationEvent,
    Phase,
    TeamMember,
    User,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

QUEUE, DELIVER = "notify", "notify.deliver"
PAUSES = (1, 60, 360, 1440, 3600, 7200, 10_080, 14_400, 17_280)
MOST_TRIES = len(PAUSES) + 1
AT_A_TIME = 100


def pause_ns(tries: int, retry_s: float) -> int:
    """Return the pause after this number of tries (1 or more, fewer than `MOST_TRIES`)."""
    return int(PAUSES[tries - 1] * retry_s * 1e9)


def spread_events(platform: Platform) -> int:
    """Create the deliveries of new events; return the number of events."""
    unspread = select(NotificationEvent.id).where(NotificationEvent.spread_ns.is_(None))
    with platform.database.reading() as session:
        event_ids = session.scalars(unspread.order_by(NotificationEvent.id).limit(AT_A_TIME)).all()
    return sum(_spread(platform, event_id) for event_id in event_ids)


def queue_due(platform: Platform) -> int:
    """Queue jobs for deliveries whose pause is over; return their number."""
    due = select(NotificationDelivery.id).where(
        NotificationDelivery.state == "waiting", NotificationDelivery.due_ns <= now_ns()
    )
    with platform.database.reading() as session:
        delivery_ids = session.scalars(due.order_by(NotificationDelivery.due_ns).limit(AT_A_TIME)).all()
    return sum(_queue(platform, delivery_id) for delivery_id in delivery_ids)


def retry_lost(platform: Platform) -> int:
    """Retry deliveries whose job ended without a result; return their number.

    Only the deliveries that are queued longest are checked: jobs run in order.
    """
    queued = select(NotificationDelivery.id, NotificationDelivery.job_id).where(NotificationDelivery.state == "queued")
    longest = queued.order_by(NotificationDelivery.due_ns).limit(AT_A_TIME).subquery()
    ended = select(longest.c.id, Job.state).join(Job, Job.id == longest.c.job_id).where(Job.state.in_(TERMINAL))
    with platform.database.reading() as session:
        deliveries = session.execute(ended).all()
    return sum(_take_back(platform, delivery_id, state == "cancelled") for delivery_id, state in deliveries)


def delete_old_events(platform: Platform) -> int:
    """Delete events older than the retention of deliveries, a limited number per turn; return their number."""
    old = NotificationEvent.created_ns <= now_ns() - int(platform.settings.notifications.kept_s * 1e9)
    some = select(NotificationEvent.id).where(old).limit(AT_A_TIME)
    with platform.database.transaction() as session:
        return rows_changed(session, delete(NotificationEvent).where(NotificationEvent.id.in_(some)))


def _spread(platform: Platform, event_id: str) -> bool:
    with platform.database.transaction() as session:
        claimed = update(NotificationEvent).where(
            NotificationEvent.id == event_id, NotificationEvent.spread_ns.is_(None)
        )
        if not rows_changed(session, claimed.values(spread_ns=now_ns())):
            return False
        for user_id, channel in audience_of(session, session.get_one(NotificationEvent, event_id)):
            row = NotificationDelivery(event_id=event_id, user_id=user_id, channel=channel)
            session.add(row)
            session.flush()
            _enqueue(session, row, platform.settings.jobs.max_attempts)
    return True


def _queue(platform: Platform, delivery_id: str) -> bool:
    with platform.database.transaction() as session:
        row = session.get(NotificationDelivery, delivery_id, with_for_update=True)
        if row is None or row.state != "waiting":
            return False
        row.state = "queued"
        _enqueue(session, row, platform.settings.jobs.max_attempts)
    return True


def _enqueue(session: Session, row: NotificationDelivery, max_attempts: int) -> None:
    job = enqueue(session, JobSpec(DELIVER, {"delivery_id": row.id}), Context(row.user_id), max_attempts)
    row.job_id = job.id
    session.flush()


def _take_back(platform: Platform, delivery_id: str, is_cancelled: bool) -> bool:
    with platform.database.transaction() as session:
        row = session.get(NotificationDelivery, delivery_id, with_for_update=True)
        if row is None or row.state != "queued" or session.get_one(Job, row.job_id).state not in TERMINAL:
            return False
        if is_cancelled:
            row.state, row.answer, row.ended_ns = "dropped", "its job was cancelled", now_ns()
        else:
            missed(row, "the process that was sending it was lost", platform.settings.notifications.retry_s)
    return True


def missed(row: NotificationDelivery, answer: str, retry_s: float) -> None:
    """Record a failed try: the delivery waits for the next try, or is dead after the last."""
    row.tries, row.answer = row.tries + 1, answer[:300]
    if row.tries < MOST_TRIES:
        row.state, row.due_ns = "waiting", now_ns() + pause_ns(row.tries, retry_s)
    else:
        row.state, row.ended_ns = "dead", now_ns()


# The audience of an event, computed when deliveries are created and again when each is sent. An event of a user goes to
# that user, an event of a team to its current members, any other event to every account. Deactivated users, former
# members and users who no longer want it are excluded. If the event's subject was deleted, there is no text
# (`messages`).


def audience_of(session: Session, event: NotificationEvent) -> Iterator[tuple[str, str]]:
    """Yield (user, channel) of the current audience."""
    if event.kind in UNASKED:
        if event.user_id is not None:
            yield event.user_id, "email"
        return
    for row in session.execute(_chosen(event).order_by(NotificationChoice.user_id)):
        yield row.user_id, row.channel


def is_in_audience(session: Session, event: NotificationEvent, user_id: str, channel: str) -> bool:
    """Return whether the user is still in the event's audience on this channel."""
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


# A user's chosen events and channels; none by default.


Choices = Mapping[str, Collection[str]]
"""Kinds of events by channel."""


def choices_of(session: Session, user_id: str) -> dict[str, list[str]]:
    """Return the user's chosen kinds by channel, in the order of `EVENTS`."""
    rows = session.scalars(select(NotificationChoice).where(NotificationChoice.user_id == user_id))
    chosen = {(row.channel, row.kind) for row in rows}
    return {channel: [kind for kind in EVENTS if (channel, kind) in chosen] for channel in CHANNELS}


def choose(session: Session, user_id: str, choices: Choices) -> None:
    """Replace the user's choices."""
    session.execute(delete(NotificationChoice).where(NotificationChoice.user_id == user_id))
    rows = [(kind, channel) for channel, kinds in choices.items() for kind in sorted(set(kinds))]
    session.add_all(NotificationChoice(user_id=user_id, kind=kind, channel=channel) for kind, channel in rows)
    session.flush()


# Phases that open and close, detected by the clock: one event per moment. The event's key contains phase and moment, so
# any number of sweepers records it once; a rescheduled moment is a new event. A phase without a date opens at its
# creation, without an event. Moments more than `LATEST_NS` ago are skipped, so a platform that was off for weeks sends
# no outdated notifications.


LATEST_NS = 2 * 86_400 * 10**9


def record_phase_events(platform: Platform) -> int:
    """Record recent openings and closings; return the number of new events."""
    now = now_ns()
    moments: list[tuple[str, str, int]] = []
    with platform.database.reading() as session:
        for kind, moment in ((PHASE_OPENED, Phase.opens_ns), (PHASE_CLOSED, Phase.closes_ns)):
            passed = select(Phase.id, moment).where(moment <= now, moment > now - LATEST_NS)
            moments += [(kind, phase_id, at_ns) for phase_id, at_ns in session.execute(passed) if at_ns is not None]
        keys = {f"{kind}:{phase_id}:{at_ns}": (kind, phase_id) for kind, phase_id, at_ns in moments}
        known = set(session.scalars(select(NotificationEvent.key).where(NotificationEvent.key.in_(keys))))
    new = [(key, *of) for key, of in keys.items() if key not in known]
    if not new:
        return 0
    with platform.database.transaction() as session:
        return sum(record(session, NewEvent(kind, phase_id, key=key)) for key, kind, phase_id in new)
