"""A user's webhook: its URL, its secret, and whether it works.

**Conventions.** The secret is generated here in the form of Standard Webhooks (`whsec_` and base64 of 32 random bytes).
It is shown once, and replaced with every new URL. A webhook that fails for long is disabled and its owner notified; a
new URL or a new secret enables it.
"""

from base64 import b64encode
from ipaddress import ip_address, ip_network
from secrets import token_bytes
from urllib.parse import SplitResult, urlsplit

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from services.domain.notifications.errors import BadWebhookUrlError
from services.domain.notifications.special_addresses import Address, is_public
from services.runtime.jobs.changes import rows_changed
from services.runtime.notification_settings import NotificationSettings
from services.runtime.notifications.events import WEBHOOK_DISABLED, NewEvent, record
from services.runtime.orm import Webhook
from services.runtime.orm.base import now_ns
from stone.errors import Refused

PREFIX = "whsec_"
SECRET_BYTES = 32


def set_webhook(session: Session, user_id: str, url: str, settings: NotificationSettings) -> Webhook:
    """Set the user's webhook to this URL, with a new secret. Raises `BadWebhookUrlError`."""
    checked_url(url, settings)
    row = session.get(Webhook, user_id, with_for_update=True) or Webhook(user_id=user_id)
    row.url, row.created_ns = url, now_ns()
    session.add(row)
    return _renew_secret(session, row)


def rotate_secret(session: Session, user_id: str) -> Webhook:
    """Replace the secret of the user's webhook; the old secret is no longer used. Raises `no_webhook`."""
    row = session.get(Webhook, user_id, with_for_update=True)
    if row is None:
        raise Refused("no_webhook", "you have no webhook yet; set its URL first")
    return _renew_secret(session, row)


def remove_webhook(session: Session, user_id: str) -> None:
    """Delete the user's webhook, if any."""
    row = session.get(Webhook, user_id)
    if row is not None:
        session.delete(row)
        session.flush()


def note_taken(session: Session, user_id: str, url: str) -> None:
    """Record that the webhook accepted a delivery."""
    session.execute(update(Webhook).where(Webhook.user_id == user_id, Webhook.url == url).values(failing_ns=None))


def note_refused(session: Session, user_id: str, url: str, patience_s: float) -> None:
    """Record that the webhook rejected a delivery; after `patience_s` of rejections it is disabled."""
    of_user = (Webhook.user_id == user_id, Webhook.url == url)
    now = now_ns()
    session.execute(update(Webhook).where(*of_user, Webhook.failing_ns.is_(None)).values(failing_ns=now))
    failing_ns = session.scalar(select(Webhook.failing_ns).where(*of_user))
    if failing_ns is not None and failing_ns <= now - int(patience_s * 1e9):
        switch_off(session, user_id, url)


def switch_off(session: Session, user_id: str, url: str) -> None:
    """Disable the webhook until the user sets it again, and notify the user once."""
    working = update(Webhook).where(Webhook.user_id == user_id, Webhook.url == url, Webhook.disabled_ns.is_(None))
    if rows_changed(session, working.values(disabled_ns=now_ns())):
        record(session, NewEvent(WEBHOOK_DISABLED, "", user_id=user_id))


def _renew_secret(session: Session, row: Webhook) -> Webhook:
    row.secret = PREFIX + b64encode(token_bytes(SECRET_BYTES)).decode("ascii")
    row.failing_ns = row.disabled_ns = None
    session.flush()
    return row


# Allowed URLs and Internet addresses of webhooks. Any account may set a URL. Its host is resolved and checked at
# connection time, and the checked address is used (`services/maintenance/notifications/channels.py`), so a later change
# of the name has no effect. Allowed are addresses of public hosts
# (`services/domain/notifications/special_addresses.py`) and addresses in networks named by the administrator.


LONGEST_URL = 1000


def checked_url(url: str, settings: NotificationSettings) -> SplitResult:
    """Return the parts of an allowed URL, judged by its text. Raises `BadWebhookUrlError`."""
    if len(url) > LONGEST_URL or not url.isascii() or not url.isprintable() or " " in url or "\\" in url:
        raise BadWebhookUrlError(
            f"a URL has at most {LONGEST_URL} characters, all of them printable ASCII without blanks"
        )
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise BadWebhookUrlError(f"the URL cannot be parsed ({error})") from None
    allowed = ("https", "http") if settings.allows_http else ("https",)
    if parts.scheme not in allowed:
        raise BadWebhookUrlError(f"its URL must start with {' or '.join(allowed)}, not {parts.scheme[:20]!r}")
    if not host or port == 0 or parts.fragment:
        raise BadWebhookUrlError(
            "its URL needs a host, no port 0 and no fragment, such as https://chat.example.org/hooks/x"
        )
    if parts.username is not None or parts.password is not None:
        raise BadWebhookUrlError("its URL contains a user name; put the secret into the path, as chat servers do")
    _refuse_literal(host, settings)
    return parts


def is_allowed(address: Address, settings: NotificationSettings) -> bool:
    """Return whether requests may be sent to this address."""
    if any(address in ip_network(network) for network in settings.networks):
        return True
    return is_public(address)


def _refuse_literal(host: str, settings: NotificationSettings) -> None:
    """Refuse a forbidden address in the URL itself; names are resolved when a notification is sent."""
    try:
        address = ip_address(host)
    except ValueError:
        return
    if not is_allowed(address, settings):
        raise BadWebhookUrlError(
            f"{address} is a private, local or reserved address, to which the platform sends nothing"
        )
