"""The job of one try of one delivery.

**Conventions.** The job first reads from the current database whether the event may still be sent, and its text. It
sends the message outside of any transaction, and writes the result with its own end. A job whose try failed has
succeeded in recording it, and the delivery waits for the next try. Only a delivery that is given up is a failed job,
the dashboard's dead letter; retrying the job is one more try.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial

from sqlalchemy.orm import Session

from services.domain.notifications.email_addresses import new_secret
from services.domain.notifications.messages import EventWords, message_of
from services.domain.notifications.spread import DELIVER, QUEUE, is_in_audience, missed
from services.domain.notifications.webhooks import note_refused, note_taken, switch_off
from services.maintenance.notifications.channels import Letter, NotTakenError, WebhookTarget, send_email, send_webhook
from services.runtime.jobs.claims import wake_ups_wanted
from services.runtime.jobs.control import give_up
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.notifications.events import EMAIL_VERIFICATION
from services.runtime.orm import EmailAddress, NotificationDelivery, NotificationEvent, Webhook
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from stone.errors import Refused

# A delivery prepared for sending: checked and worded from the current database, in the caller's transaction, after
# which it is sent.


SETTINGS_PATH = "/account#notifications"


@dataclass(frozen=True)
class PreparedDelivery:
    """`send` sends the message and returns the answer, or raises `NotTakenError`; `webhook_url` is empty for e-mail."""

    send: Callable[[], str]
    webhook_url: str = ""


def prepared(session: Session, row: NotificationDelivery, settings: Settings) -> PreparedDelivery | str:
    """Return the delivery prepared for sending, or the reason for not sending it."""
    event = session.get_one(NotificationEvent, row.event_id)
    if not is_in_audience(session, event, row.user_id, row.channel):
        return "not sent: preferences changed, account deactivated, or no longer in the team"
    message = message_of(session, event)
    if message is None:
        return "not sent: the subject of the event was deleted"
    if row.channel == "webhook":
        return _by_webhook(session, row, _letter(row, event, message, settings), settings)
    return _by_email(session, row, event, message, settings)


def _by_webhook(
    session: Session, row: NotificationDelivery, letter: Letter, settings: Settings
) -> PreparedDelivery | str:
    webhook = session.get(Webhook, row.user_id)
    if webhook is None or webhook.disabled_ns is not None:
        return "not sent: there is no webhook, or it is disabled"
    target = WebhookTarget(webhook.url, webhook.secret)
    return PreparedDelivery(lambda: send_webhook(target, letter, settings.notifications), webhook.url)


def _by_email(
    session: Session, row: NotificationDelivery, event: NotificationEvent, message: EventWords, settings: Settings
) -> PreparedDelivery | str:
    email, is_verification = session.get(EmailAddress, row.user_id), event.kind == EMAIL_VERIFICATION
    if email is None or (email.verified_ns is None and not is_verification):
        return "not sent: there is no verified e-mail address"
    if is_verification:
        if email.verified_ns is not None:
            return "not sent: the address is already verified"
        path = f"/account?email_secret={new_secret(session, email)}#notifications"
        message = EventWords(message.text, path)
    address, letter = email.address, _letter(row, event, message, settings)
    return PreparedDelivery(lambda: send_email(letter, address, settings.notifications))


def _letter(row: NotificationDelivery, event: NotificationEvent, message: EventWords, settings: Settings) -> Letter:
    base = settings.api.url.rstrip("/")
    happened = datetime.fromtimestamp(event.created_ns // 10**9, UTC)
    return Letter(
        message_id=f"msg_{row.id}",
        event_id=event.id,
        kind=event.kind,
        happened_at=happened.strftime("%Y-%m-%dT%H:%M:%SZ"),
        text=message.text,
        url=base + message.path,
        settings_url=base + SETTINGS_PATH,
        data=message.data,
    )


AT_A_TIME = 50


def deliver_queued(platform: Platform) -> int:
    """Run the ready jobs of the queue `notify`, a limited number per turn; return their number."""
    known = handlers(platform)
    done = 0
    while done < AT_A_TIME and _is_any_ready(platform) and run_next(platform, QUEUE, known):
        done += 1
    return done


def handlers(platform: Platform) -> Handlers:
    """Return the only kind of job in this queue."""
    return {DELIVER: lambda attempt: deliver(platform, attempt)}


def deliver(platform: Platform, attempt: Attempt) -> Outcome:
    """Try the delivery once. Raises `delivery_failed` after the last try, `unknown_delivery`."""
    delivery_id = str(attempt.arguments["delivery_id"])
    with platform.database.transaction() as session:
        row = session.get(NotificationDelivery, delivery_id)
        if row is None:
            raise unknown_delivery(delivery_id)
        if row.state == "delivered":
            return Outcome({"state": "delivered"})
        ready = prepared(session, row, platform.settings)
    if isinstance(ready, str):
        return Outcome({"state": "dropped"}, commit=partial(_drop, delivery_id, ready))
    try:
        answer = ready.send()
    except NotTakenError as error:
        return _record_missed(platform, attempt, ready, error)
    return Outcome({"state": "delivered"}, commit=partial(_taken, delivery_id, ready, answer))


def _is_any_ready(platform: Platform) -> bool:
    """Return whether a job is ready; read first, since a claim takes SQLite's write lock every second."""
    with platform.database.reading() as session:
        return wake_ups_wanted(session, QUEUE) > 0


def _record_missed(platform: Platform, attempt: Attempt, ready: PreparedDelivery, error: NotTakenError) -> Outcome:
    """Wait for the next try. Raises `delivery_failed` after the last.

    The try is written immediately, because a failed job commits nothing. A repeated job counts one try too many.
    """
    settings, delivery_id = platform.settings.notifications, str(attempt.arguments["delivery_id"])
    with platform.database.transaction() as session:
        row = session.get(NotificationDelivery, delivery_id, with_for_update=True)
        if row is None:
            raise unknown_delivery(delivery_id)
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
        raise Refused(
            "delivery_failed",
            f"the {channel} did not accept it in {tries} attempts; last answer: {error!s}; retry the job to try again",
        )
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
    if row is not None:  # otherwise its user was deleted meanwhile
        row.state, row.answer, row.ended_ns = state, answer[:300], now_ns()
    return row


def unknown_delivery(delivery_id: str) -> Refused:
    return Refused(
        "unknown_delivery", f"delivery {delivery_id[:40]} no longer exists: it expired, or its user was removed"
    )
