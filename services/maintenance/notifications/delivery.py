"""The job of one try at one delivery.

**Conventions.** First whether it may still be told, and in which words, is asked of the database as it is now; then it
is sent, outside of any transaction; what came of it is written with the job's own end. A try that did not get through
is a job that succeeded in saying so, and the delivery waits for the next one; only a delivery that is given up is a
failed job, the dashboard's dead letter. Its retry is one more try.
"""

from functools import partial

from sqlalchemy.orm import Session

from services.domain.notifications.spread import DELIVER, QUEUE, missed
from services.domain.notifications.webhooks import note_refused, note_taken, switch_off
from services.maintenance.notifications.errors import DeliveryFailedError, NotTakenError, UnknownDeliveryError
from services.maintenance.notifications.prepared import PreparedDelivery, prepared
from services.runtime.jobs.claims import wake_ups_wanted
from services.runtime.jobs.control import give_up
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.orm import NotificationDelivery
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

AT_A_TIME = 50


def deliver_queued(platform: Platform) -> int:
    """Run the jobs of the queue `notify` that are ready, some a turn; how many."""
    known = handlers(platform)
    done = 0
    while done < AT_A_TIME and _is_any_ready(platform) and run_next(platform, QUEUE, known):
        done += 1
    return done


def handlers(platform: Platform) -> Handlers:
    """The one kind of job there is in this queue."""
    return {DELIVER: lambda attempt: deliver(platform, attempt)}


def deliver(platform: Platform, attempt: Attempt) -> Outcome:
    """One try. Raises `DeliveryFailedError` where it was the last, `UnknownDeliveryError`."""
    delivery_id = str(attempt.arguments["delivery_id"])
    with platform.database.transaction() as session:
        row = session.get(NotificationDelivery, delivery_id)
        if row is None:
            raise UnknownDeliveryError(delivery_id)
        if row.state == "delivered":
            return Outcome({"state": "delivered"})
        ready = prepared(session, row, platform.settings)
    if isinstance(ready, str):
        return Outcome({"state": "dropped"}, commit=partial(_drop, delivery_id, ready))
    try:
        answer = ready.send()
    except NotTakenError as error:
        return _missed(platform, attempt, ready, error)
    return Outcome({"state": "delivered"}, commit=partial(_taken, delivery_id, ready, answer))


def _is_any_ready(platform: Platform) -> bool:
    """Asked first, by reading: a claim takes the write lock of SQLite, every second of an idle platform."""
    with platform.database.reading() as session:
        return wake_ups_wanted(session, QUEUE) > 0


def _missed(platform: Platform, attempt: Attempt, ready: PreparedDelivery, error: NotTakenError) -> Outcome:
    """Wait for the next try. Raises `DeliveryFailedError` after the last.

    Written at once, not with the job's end: a job that fails commits nothing. Done twice it counts one try too many.
    """
    settings, delivery_id = platform.settings.notifications, str(attempt.arguments["delivery_id"])
    with platform.database.transaction() as session:
        row = session.get(NotificationDelivery, delivery_id, with_for_update=True)
        if row is None:
            raise UnknownDeliveryError(delivery_id)
        missed(row, str(error), settings.retry_s)
        if error.is_final:
            row.state, row.ended_ns = "dead", now_ns()
        if ready.webhook_url and error.is_gone:
            switch_off(session, row.user_id, ready.webhook_url)
        elif ready.webhook_url:
            note_refused(session, row.user_id, ready.webhook_url, settings.webhook_failing_s)
        if row.state == "dead":
            give_up(session, attempt.job_id)
        channel, tries, state = row.channel, row.tries, row.state
    if state == "dead":
        raise DeliveryFailedError(channel, tries, str(error))
    return Outcome({"state": state, "answer": str(error)})


def _drop(delivery_id: str, why: str, session: Session) -> None:
    _end(session, delivery_id, "dropped", why)


def _taken(delivery_id: str, ready: PreparedDelivery, answer: str, session: Session) -> None:
    row = _end(session, delivery_id, "delivered", answer)
    if row is not None:
        row.tries += 1
        if ready.webhook_url:
            note_taken(session, row.user_id, ready.webhook_url)


def _end(session: Session, delivery_id: str, state: str, answer: str) -> NotificationDelivery | None:
    row = session.get(NotificationDelivery, delivery_id, with_for_update=True)
    if row is not None:  # else its user was erased meanwhile
        row.state, row.answer, row.ended_ns = state, answer[:300], now_ns()
    return row
