"""A user's webhook: its URL, its secret, and whether it works.

**Conventions.** The secret is made here, in the form of Standard Webhooks (`whsec_` and base64 of 32 random bytes), is
told once, and anew with every new URL. One that fails for long is switched off, and its owner told; a new URL or a new
secret switches it on.
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
    """The user's webhook at this URL, with a new secret. Raises `BadWebhookUrlError`."""
    checked_url(url, settings)
    row = session.get(Webhook, user_id, with_for_update=True) or Webhook(user_id=user_id)
    row.url, row.created_ns = url, now_ns()
    session.add(row)
    return _renewed(session, row)


def rotate_secret(session: Session, user_id: str) -> Webhook:
    """The user's webhook with a new secret; the old one signs nothing any more. Raises `no_webhook`."""
    row = session.get(Webhook, user_id, with_for_update=True)
    if row is None:
        raise Refused("no_webhook", "you have no webhook yet; set its URL first")
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


# Which URLs and which Internet addresses webhooks are sent to.
#
# **Conventions.** A URL is anybody's who has an account. What it resolves to is judged when it is connected to, and
# the judged address is what is connected to (`services/maintenance/notifications/channels.py`): a name that resolves
# otherwise a moment later leads nowhere else. Allowed are addresses of public hosts
# (`services/domain/notifications/special_addresses.py`), and addresses in networks that the administrator names.


LONGEST_URL = 1000


def checked_url(url: str, settings: NotificationSettings) -> SplitResult:
    """The parts of a URL that may be sent to, as far as it says itself. Raises `BadWebhookUrlError`."""
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
    """Whether requests may be sent to this address."""
    if any(address in ip_network(network) for network in settings.networks):
        return True
    return is_public(address)


def _refuse_literal(host: str, settings: NotificationSettings) -> None:
    """An address that stands in the URL itself is refused at once; a name is resolved when it is sent to."""
    try:
        address = ip_address(host)
    except ValueError:
        return
    if not is_allowed(address, settings):
        raise BadWebhookUrlError(
            f"{address} is a private, local or reserved address, to which the platform sends nothing"
        )
