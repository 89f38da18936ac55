"""A user's webhook: its URL, its secret, and whether it works.

**Conventions.** The secret is made here, in the form of Standard Webhooks (`whsec_` and base64 of 32 random bytes), is
told once, and anew with every new URL. One that fails for long is switched off, and its owner told; a new URL or a new
secret switches it on.
"""

from base64 import b64encode
from secrets import token_bytes

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from services.domain.notifications.errors import NoWebhookError
from services.domain.notifications.webhook_urls import checked_url
from services.runtime.jobs.changes import rows_changed
from services.runtime.notification_settings import NotificationSettings
from services.runtime.notifications.events import WEBHOOK_DISABLED, NewEvent, record
from services.runtime.orm import Webhook
from services.runtime.orm.base import now_ns

PREFIX = "whsec_"
SECRET_BYTES = 32


def set_webhook(session: Session, user_id: str, url: str, settings: NotificationSettings) -> Webhook:
    """The user's webhook at this URL, with a new secret. Raises `BadWebhookUrlError`."""
    checked_url(url, settings)
    row = session.get(Webhook, user_id, with_for_update=True) or Webhook(user_id=user_id)
    row.url, row.created_ns = url, now_ns()
    session.add(row)
    return _renewed(session, row)


def rotate_secret(session: Session, user_id: str) -> Webhook:
    """The user's webhook with a new secret; the old one signs nothing any more. Raises `NoWebhookError`."""
    row = session.get(Webhook, user_id, with_for_update=True)
    if row is None:
        raise NoWebhookError()
    return _renewed(session, row)


def remove_webhook(session: Session, user_id: str) -> None:
    """Forget the user's webhook, where there is one."""
    row = session.get(Webhook, user_id)
    if row is not None:
        session.delete(row)
        session.flush()


def note_taken(session: Session, user_id: str, url: str) -> None:
    """Note that the webhook took a delivery."""
    session.execute(update(Webhook).where(Webhook.user_id == user_id, Webhook.url == url).values(failing_ns=None))


def note_refused(session: Session, user_id: str, url: str, patience_s: float) -> None:
    """Note that the webhook did not take a delivery; after `patience_s` of this it is switched off."""
    of_user = (Webhook.user_id == user_id, Webhook.url == url)
    now = now_ns()
    session.execute(update(Webhook).where(*of_user, Webhook.failing_ns.is_(None)).values(failing_ns=now))
    failing_ns = session.scalar(select(Webhook.failing_ns).where(*of_user))
    if failing_ns is not None and failing_ns <= now - int(patience_s * 1e9):
        switch_off(session, user_id, url)


def switch_off(session: Session, user_id: str, url: str) -> None:
    """Send nothing there any more, until the user sets it again; they are told, once."""
    working = update(Webhook).where(Webhook.user_id == user_id, Webhook.url == url, Webhook.disabled_ns.is_(None))
    if rows_changed(session, working.values(disabled_ns=now_ns())):
        record(session, NewEvent(WEBHOOK_DISABLED, "", user_id=user_id))


def _renewed(session: Session, row: Webhook) -> Webhook:
    row.secret = PREFIX + b64encode(token_bytes(SECRET_BYTES)).decode("ascii")
    row.failing_ns = row.disabled_ns = None
    session.flush()
    return row
