"""A delivery by e-mail: plain text, by the administrator's SMTP server (RFC 5321, RFC 8314).

**Conventions.** Headers are made of checked parts alone: an address that `EMAIL` matches, a subject that is one line;
`email.policy.SMTP` refuses line ends in headers besides. `Message-ID` is of the delivery, equal in every try, so that
mail programs show a second one once. With `starttls` or `tls` the server's certificate is checked, and nothing is sent
to one that does not offer it. What a server refuses for good (5xx to the recipient) is not tried again.
"""

import smtplib
import ssl
from email.message import EmailMessage
from email.policy import SMTP

from services.maintenance.notifications.errors import NotTakenError
from services.maintenance.notifications.letter import Letter
from services.runtime.notification_settings import NotificationSettings
from services.runtime.notifications.events import EMAIL_VERIFICATION

WITHIN_S = 15.0
LONGEST_SUBJECT = 150
REFUSED_FOR_GOOD = 500


def email_of(letter: Letter, address: str, sender: str) -> EmailMessage:
    """The message."""
    message = EmailMessage(policy=SMTP)
    message["From"], message["To"] = sender, address
    message["Subject"] = f"[STONE] {letter.text}"[:LONGEST_SUBJECT]
    message["Message-ID"] = f"<{letter.message_id}@{sender.rpartition('@')[2]}>"
    message["Auto-Submitted"] = "auto-generated"
    message.set_content(f"{letter.text}\n\n{letter.url}\n\n-- \n{_hint(letter)}\n")
    return message


def send_email(letter: Letter, address: str, settings: NotificationSettings) -> str:
    """Send it; how the server answered. Raises `NotTakenError`."""
    if not settings.smtp_host:
        raise NotTakenError("this platform sends no e-mail: STONE_NOTIFICATIONS__SMTP_HOST is not set")
    message = email_of(letter, address, settings.sender)
    try:
        with _server(settings) as server:
            if settings.smtp_user:
                server.login(settings.smtp_user, settings.smtp_password.get_secret_value())
            server.send_message(message)
    except smtplib.SMTPRecipientsRefused as error:
        code, said = error.recipients[address]
        words = said.decode(errors="replace")
        raise NotTakenError(f"answered {code} {words}", is_final=code >= REFUSED_FOR_GOOD) from None
    except (OSError, smtplib.SMTPException) as error:
        raise NotTakenError(f"{type(error).__name__}: {error}") from None
    return "taken by the mail server"


def _server(settings: NotificationSettings) -> smtplib.SMTP:
    """The server, by TLS where that is set. Raises `OSError`, `SMTPException`."""
    place = (settings.smtp_host, settings.smtp_port)
    if settings.smtp_security == "tls":
        return smtplib.SMTP_SSL(*place, timeout=WITHIN_S, context=ssl.create_default_context())
    server = smtplib.SMTP(*place, timeout=WITHIN_S)
    if settings.smtp_security == "starttls":
        try:
            server.starttls(context=ssl.create_default_context())
        except BaseException:
            server.close()
            raise
    return server


def _hint(letter: Letter) -> str:
    if letter.kind == EMAIL_VERIFICATION:
        return "If you did not ask for this, ignore it: no further mail is sent."
    return f"You enabled this notification. To disable it: {letter.settings_url}"
