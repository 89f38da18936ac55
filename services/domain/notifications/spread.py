"""Events become deliveries, one for each user and channel; a delivery that is due becomes a job.

**Conventions.** An event is spread by one transaction that first claims it, so each is spread once; the jobs of its
deliveries are queued in the same. A delivery belongs to its job while it is `queued`; the job that did not get through
leaves it `waiting` until `due_ns`. A job that ended without a word (its process was lost too often, somebody cancelled
it) is found here. Pauses grow as Standard Webhooks recommends: with `retry_s` of 5 s they are 5 s, 5 min, 30 min, 2 h,
5 h, 10 h, 14 h, 20 h, 24 h.
"""

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from services.domain.notifications.audience import audience_of
from services.runtime.jobs.changes import rows_changed
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import TERMINAL, Context, JobSpec
from services.runtime.orm import Job, NotificationDelivery, NotificationEvent
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

QUEUE, DELIVER = "notify", "notify.deliver"
PAUSES = (1, 60, 360, 1440, 3600, 7200, 10_080, 14_400, 17_280)
MOST_TRIES = len(PAUSES) + 1
AT_A_TIME = 100


def pause_ns(tries: int, retry_s: float) -> int:
    """How long to wait after so many tries (1 or more, fewer than `MOST_TRIES`)."""
    return int(PAUSES[tries - 1] * retry_s * 1e9)


def spread_events(platform: Platform) -> int:
    """Make deliveries of events that have none yet; how many events."""
    unspread = select(NotificationEvent.id).where(NotificationEvent.spread_ns.is_(None))
    with platform.database.reading() as session:
        found = session.scalars(unspread.order_by(NotificationEvent.id).limit(AT_A_TIME)).all()
    return sum(_spread(platform, event_id) for event_id in found)


def queue_due(platform: Platform) -> int:
    """Queue jobs for deliveries whose pause is over; how many."""
    due = select(NotificationDelivery.id).where(
        NotificationDelivery.state == "waiting", NotificationDelivery.due_ns <= now_ns()
    )
    with platform.database.reading() as session:
        found = session.scalars(due.order_by(NotificationDelivery.due_ns).limit(AT_A_TIME)).all()
    return sum(_queue(platform, delivery_id) for delivery_id in found)


def take_back_lost(platform: Platform) -> int:
    """Have deliveries tried again whose job ended without a word; how many.

    Only those that are queued longest are looked at, however many there are: all before them are sent first.
    """
    queued = select(NotificationDelivery.id, NotificationDelivery.job_id).where(NotificationDelivery.state == "queued")
    longest = queued.order_by(NotificationDelivery.due_ns).limit(AT_A_TIME).subquery()
    ended = select(longest.c.id, Job.state).join(Job, Job.id == longest.c.job_id).where(Job.state.in_(TERMINAL))
    with platform.database.reading() as session:
        found = session.execute(ended).all()
    return sum(_take_back(platform, delivery_id, state == "cancelled") for delivery_id, state in found)


def forget_told(platform: Platform) -> int:
    """Delete events older than deliveries are kept, with theirs, some a turn; how many."""
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
            missed(row, "the process that sent it was lost", platform.settings.notifications.retry_s)
    return True


def missed(row: NotificationDelivery, answer: str, retry_s: float) -> None:
    """Note a try that did not get through: it waits for the next, or is dead after the last."""
    row.tries, row.answer = row.tries + 1, answer[:300]
    if row.tries < MOST_TRIES:
        row.state, row.due_ns = "waiting", now_ns() + pause_ns(row.tries, retry_s)
    else:
        row.state, row.ended_ns = "dead", now_ns()
