"""A delivery by webhook: JSON, signed as in Standard Webhooks 1.0, in a form that chat servers display.

    {"type": "run.failed", "timestamp": "2026-05-03T09:12:44Z", "data": {…}, "text": "Processing of … <https://…>"}

**Conventions.** `webhook-id` is the delivery's, equal in every try; `webhook-timestamp` is that of the try;
`webhook-signature` is `v1,` and the base64 of HMAC-SHA256, with the secret behind `whsec_`, of `id.timestamp.body`. Any
2xx is success; 410 Gone disables the webhook; a redirect is not followed and is a failure. At most `READ_BYTES` of the
answer are read, and only its status is kept. Slack and Mattermost display `text`.
"""

import hmac
import http.client
import json
import smtplib
import socket
import ssl
import time
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from email.message import EmailMessage
from email.policy import SMTP
from hashlib import sha256
from ipaddress import ip_address
from threading import Timer
from typing import Any

from services.domain.notifications.errors import BadWebhookUrlError
from services.domain.notifications.webhooks import PREFIX, checked_url, is_allowed
from services.runtime.notification_settings import NotificationSettings
from services.runtime.notifications.events import EMAIL_VERIFICATION
from stone.errors import StoneError

# An HTTP connection, bounded in time, to a host whose addresses were checked. A name is resolved once, and every
# address is checked. If any of them is forbidden, no connection is made: a name with a public and a private address is
# an attack or a mistake. TLS verifies the name, not the address. After `WITHIN_S` the socket is shut down under its
# reader or writer. Proxies of the environment are ignored, since they would resolve the name again. The owner of a
# webhook does not learn whether a name resolved, nor its addresses, which may be internal.


ANSWER_WITHIN_S = 10.0
Resolve = Callable[[str, int], list[str]]


def resolved(host: str, port: int) -> list[str]:
    """Return the addresses of a host, in the order the system prefers. Raises `OSError`."""
    entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(str(entry[4][0]) for entry in entries))


def judged_addresses(host: str, port: int, settings: NotificationSettings, resolve: Resolve = resolved) -> list[str]:
    """Return the addresses of the host, all of them allowed as receivers.

    Raises `NotTakenError`, with the same sentence for a name of an internal network and for a name that does not exist.
    """
    try:
        addresses = resolve(host, port)
    except (OSError, UnicodeError):  # UnicodeError: a label of the name is too long
        addresses = []
    judged = [is_allowed(ip_address(address.partition("%")[0]), settings) for address in addresses]
    if not judged or not all(judged):
        raise NotTakenError(f"{host} is not the name of a public host, as resolved by this platform")
    return addresses


@contextmanager
def connection_to(
    host: str, port: int, addresses: list[str], context: ssl.SSLContext | None
) -> Iterator[http.client.HTTPConnection]:
    """Yield a connection to the first of `addresses` that answers, with TLS if `context` is given. Raises `OSError`."""
    open_socket = _connect(addresses, port)
    timer = Timer(ANSWER_WITHIN_S, _shut, (open_socket,))
    timer.daemon = True
    timer.start()
    try:
        if context is not None:
            open_socket = context.wrap_socket(open_socket, server_hostname=host)
        connection = http.client.HTTPConnection(host, port)
        connection.sock = open_socket
        yield connection
    finally:
        timer.cancel()
        open_socket.close()


def _connect(addresses: list[str], port: int) -> socket.socket:
    error = OSError("it has no address")
    for address in addresses[:2]:
        try:
            return socket.create_connection((address, port), timeout=ANSWER_WITHIN_S / 2)
        except OSError as refusal:
            error = refusal
    raise error


def _shut(open_socket: socket.socket) -> None:
    with suppress(OSError):
        open_socket.shutdown(socket.SHUT_RDWR)


# The text of a delivery, independent of its channel.


@dataclass(frozen=True)
class Letter:
    """The content of a message.

    - `message_id`: equal in every try of one delivery; `event_id`: equal in every delivery of one event
    - `url`: the page with details; `settings_url`: the page of the notification settings
    """

    message_id: str
    event_id: str
    kind: str
    happened_at: str
    text: str
    url: str
    settings_url: str
    data: Mapping[str, Any] = field(default_factory=dict)


READ_BYTES = 16 * 1024
GONE = 410
TAKEN = range(200, 300)


@dataclass(frozen=True)
class WebhookTarget:
    """The URL of a user's webhook, and its signing secret."""

    url: str
    secret: str


def body_of(letter: Letter) -> bytes:
    """Return the body of the request."""
    record = {
        "type": letter.kind,
        "timestamp": letter.happened_at,
        "data": {**letter.data, "id": letter.event_id, "url": letter.url},
        "text": f"{letter.text} {letter.url}",
    }
    return json.dumps(record, ensure_ascii=False, separators=(",", ":")).encode()


def signature_of(secret: str, message_id: str, timestamp: int, body: bytes) -> str:
    """Return the value of `webhook-signature`."""
    key = b64decode(secret.removeprefix(PREFIX))
    signed = f"{message_id}.{timestamp}.".encode() + body
    return f"v1,{b64encode(hmac.new(key, signed, sha256).digest()).decode('ascii')}"


def send_webhook(target: WebhookTarget, letter: Letter, settings: NotificationSettings) -> str:
    """Send the message; return the receiver's status. Raises `NotTakenError`."""
    try:
        status = _answer(target, letter, settings)
    except BadWebhookUrlError as error:  # was allowed when it was set
        raise NotTakenError(str(error)) from None
    except (OSError, http.client.HTTPException) as error:  # TLS failures and unresolved names are OSError
        raise NotTakenError(f"{type(error).__name__}: {error}") from None
    if status in TAKEN:
        return f"answered {status}"
    raise NotTakenError(f"answered {status}", is_final=status == GONE, is_gone=status == GONE)


def _answer(target: WebhookTarget, letter: Letter, settings: NotificationSettings) -> int:
    parts = checked_url(target.url, settings)
    host, is_tls = str(parts.hostname), parts.scheme == "https"
    port = parts.port or (443 if is_tls else 80)
    addresses = judged_addresses(host, port, settings)
    body, now_s = body_of(letter), int(time.time())
    headers = {
        "Content-Type": "application/json",
        "User-Agent": "stone-platform",
        "webhook-id": letter.message_id,
        "webhook-timestamp": str(now_s),
        "webhook-signature": signature_of(target.secret, letter.message_id, now_s, body),
        "Connection": "close",
    }
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    # uses the machine's certificate authorities; SSL_CERT_FILE replaces them
    with connection_to(host, port, addresses, ssl.create_default_context() if is_tls else None) as connection:
        connection.request("POST", path, body, headers)
        answer = connection.getresponse()
        answer.read(READ_BYTES)
        return answer.status


# A delivery by e-mail: plain text, through the administrator's SMTP server (RFC 5321, RFC 8314). Headers consist of
# checked parts: an address that matches `EMAIL`, a one-line subject; `email.policy.SMTP` also refuses line ends in
# headers. `Message-ID` is the delivery's, equal in every try, so that mail programs drop duplicates. With `starttls` or
# `tls` the server's certificate is verified, and nothing is sent to a server without TLS. Permanent refusals (5xx for
# the recipient) are not retried.


EMAIL_WITHIN_S = 15.0
LONGEST_SUBJECT = 150
REFUSED_FOR_GOOD = 500


def email_of(letter: Letter, address: str, sender: str) -> EmailMessage:
    """Return the message."""
    message = EmailMessage(policy=SMTP)
    message["From"], message["To"] = sender, address
    message["Subject"] = f"[STONE] {letter.text}"[:LONGEST_SUBJECT]
    message["Message-ID"] = f"<{letter.message_id}@{sender.rpartition('@')[2]}>"
    message["Auto-Submitted"] = "auto-generated"
    message.set_content(f"{letter.text}\n\n{letter.url}\n\n-- \n{_hint(letter)}\n")
    return message


def send_email(letter: Letter, address: str, settings: NotificationSettings) -> str:
    """Send the message; return the server's answer. Raises `NotTakenError`."""
    if not settings.smtp_host:
        raise NotTakenError("this platform sends no e-mail: STONE_NOTIFICATIONS__SMTP_HOST is not set")
    message = email_of(letter, address, settings.sender)
    try:
        with _server(settings) as server:
            if settings.smtp_user:
                server.login(settings.smtp_user, settings.smtp_password.get_secret_value())
            server.send_message(message)
    except smtplib.SMTPRecipientsRefused as error:
        code, reply = error.recipients[address]
        words = reply.decode(errors="replace")
        raise NotTakenError(f"answered {code} {words}", is_final=code >= REFUSED_FOR_GOOD) from None
    except (OSError, smtplib.SMTPException) as error:
        raise NotTakenError(f"{type(error).__name__}: {error}") from None
    return "accepted by the mail server"


def _server(settings: NotificationSettings) -> smtplib.SMTP:
    """Return a connection to the server, with TLS if configured. Raises `OSError`, `SMTPException`."""
    address = (settings.smtp_host, settings.smtp_port)
    if settings.smtp_security == "tls":
        return smtplib.SMTP_SSL(*address, timeout=EMAIL_WITHIN_S, context=ssl.create_default_context())
    server = smtplib.SMTP(*address, timeout=EMAIL_WITHIN_S)
    if settings.smtp_security == "starttls":
        try:
            server.starttls(context=ssl.create_default_context())
        except BaseException:
            server.close()
            raise
    return server


def _hint(letter: Letter) -> str:
    if letter.kind == EMAIL_VERIFICATION:
        return "If you did not enter this address, ignore this e-mail. You will receive no further e-mails."
    return f"You enabled this notification. To disable it: {letter.settings_url}"


class NotTakenError(StoneError):
    """The receiver did not accept the message; if `is_final`, a retry is useless."""

    code = "not_taken"

    def __init__(self, why: str, is_final: bool = False, is_gone: bool = False) -> None:
        self.is_final, self.is_gone = is_final, is_gone
        super().__init__(why[:300])
