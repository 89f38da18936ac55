"""A delivery made ready to be sent: judged and worded by the database as it is now.

**Conventions.** Part of the caller's transaction; what is sent is sent after it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from services.domain.notifications.audience import is_to_be_told
from services.domain.notifications.email_addresses import new_secret
from services.domain.notifications.messages import EventWords, message_of
from services.maintenance.notifications.email_message import send_email
from services.maintenance.notifications.letter import Letter
from services.maintenance.notifications.webhook import WebhookTarget, send_webhook
from services.runtime.notifications.events import EMAIL_VERIFICATION
from services.runtime.orm import EmailAddress, NotificationDelivery, NotificationEvent, Webhook
from services.runtime.settings import Settings

SETTINGS_PATH = "/account#notifications"


@dataclass(frozen=True)
class PreparedDelivery:
    """`send` sends it and says how it was answered, or raises `NotTakenError`; `webhook_url` is empty for e-mail."""

    send: Callable[[], str]
    webhook_url: str = ""


def prepared(session: Session, row: NotificationDelivery, settings: Settings) -> PreparedDelivery | str:
    """The delivery ready to be sent, or why it is not to be sent at all."""
    event = session.get_one(NotificationEvent, row.event_id)
    if not is_to_be_told(session, event, row.user_id, row.channel):
        return "not sent: preferences changed, account deactivated, or no longer in the team"
    message = message_of(session, event)
    if message is None:
        return "what it tells of is gone"
    if row.channel == "webhook":
        return _by_webhook(session, row, _letter(row, event, message, settings), settings)
    return _by_email(session, row, event, message, settings)


def _by_webhook(
    session: Session, row: NotificationDelivery, letter: Letter, settings: Settings
) -> PreparedDelivery | str:
    webhook = session.get(Webhook, row.user_id)
    if webhook is None or webhook.disabled_ns is not None:
        return "there is no webhook, or it is switched off"
    target = WebhookTarget(webhook.url, webhook.secret)
    return PreparedDelivery(lambda: send_webhook(target, letter, settings.notifications), webhook.url)


def _by_email(
    session: Session, row: NotificationDelivery, event: NotificationEvent, message: EventWords, settings: Settings
) -> PreparedDelivery | str:
    email, is_verification = session.get(EmailAddress, row.user_id), event.kind == EMAIL_VERIFICATION
    if email is None or (email.verified_ns is None and not is_verification):
        return "there is no verified e-mail address"
    if is_verification:
        if email.verified_ns is not None:
            return "the address is verified already"
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
