"""A delivery by webhook: JSON, signed as Standard Webhooks 1.0 says, in the form that chat servers show.

    {"type": "run.failed", "timestamp": "2026-05-03T09:12:44Z", "data": {…}, "text": "Processing of … <https://…>"}

**Conventions.** `webhook-id` is the delivery's, equal in every try; `webhook-timestamp` is that of the try;
`webhook-signature` is `v1,` and the base64 of HMAC-SHA256, by the secret behind `whsec_`, of `id.timestamp.body`. Any
2xx is success; 410 Gone asks for no more; a redirect is not followed, so it is none. Of the answer `READ_BYTES` are
read and nothing is kept but its status. `text` is what Slack and Mattermost show.
"""

import hmac
import http.client
import json
import ssl
import time
from base64 import b64decode, b64encode
from dataclasses import dataclass
from hashlib import sha256

from services.domain.notifications.errors import BadWebhookUrlError
from services.domain.notifications.webhook_urls import checked_url
from services.domain.notifications.webhooks import PREFIX
from services.maintenance.notifications.checked_connection import connection_to, judged_addresses
from services.maintenance.notifications.errors import NotTakenError
from services.maintenance.notifications.letter import Letter
from services.runtime.notification_settings import NotificationSettings

READ_BYTES = 16 * 1024
GONE = 410
TAKEN = range(200, 300)


@dataclass(frozen=True)
class WebhookTarget:
    """Where a user's webhook is, and by what it is signed."""

    url: str
    secret: str


def body_of(letter: Letter) -> bytes:
    """The body of the request."""
    record = {
        "type": letter.kind,
        "timestamp": letter.happened_at,
        "data": {**letter.data, "id": letter.event_id, "url": letter.url},
        "text": f"{letter.text} {letter.url}",
    }
    return json.dumps(record, ensure_ascii=False, separators=(",", ":")).encode()


def signature_of(secret: str, message_id: str, timestamp: int, body: bytes) -> str:
    """The value of `webhook-signature`."""
    key = b64decode(secret.removeprefix(PREFIX))
    signed = f"{message_id}.{timestamp}.".encode() + body
    return f"v1,{b64encode(hmac.new(key, signed, sha256).digest()).decode('ascii')}"


def send_webhook(target: WebhookTarget, letter: Letter, settings: NotificationSettings) -> str:
    """Send it; how the receiver answered. Raises `NotTakenError`."""
    try:
        status = _answer(target, letter, settings)
    except BadWebhookUrlError as error:  # allowed when it was set
        raise NotTakenError(str(error)) from None
    except (OSError, http.client.HTTPException) as error:  # TLS and names that resolve to nothing are OSError
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
    # of the machine's own certificate authorities; SSL_CERT_FILE names others
    with connection_to(host, port, addresses, ssl.create_default_context() if is_tls else None) as connection:
        connection.request("POST", path, body, headers)
        answer = connection.getresponse()
        answer.read(READ_BYTES)
        return answer.status
