"""E-mail: to verified addresses, by STARTTLS and password where that is set, through a real SMTP server."""

import re
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from email import message_from_bytes, policy
from email.message import EmailMessage
from pathlib import Path
from typing import Any

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.handlers import Message
from aiosmtpd.smtp import AuthResult, LoginPassword
from pydantic import SecretStr

from services.domain.notifications.email_addresses import MOST_MAILS, set_address, verify
from services.maintenance.notifications.channels import Letter, email_of
from services.runtime.orm import EmailAddress, Job, User
from services.runtime.platform import Platform
from testing.refusals import refused_as
from testing.servers.certificates import self_signed
from testing.servers.process import free_port
from tests.services.maintenance.notifications.steps import a_user, all_sent, deliveries, happened, telling, turn

PASSWORD = "between us and the relay"
ADDRESS = "ada@example.org"


class Mailbox(Message):
    """What the server took; who is in `refused` has no mailbox there."""

    def __init__(self) -> None:
        super().__init__()
        self.taken: list[bytes] = []
        self.refused: tuple[str, ...] = ()

    async def handle_RCPT(  # noqa: N802
        self, _server: Any, _session: Any, envelope: Any, address: str, _options: Any
    ) -> str:
        if address in self.refused:
            return "550 no such mailbox"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, _server: Any, _session: Any, envelope: Any) -> str:  # noqa: N802
        self.taken.append(envelope.content)
        return "250 OK"

    def handle_message(self, message: Any) -> None:
        """Not called: `handle_DATA` keeps the bytes."""

    @property
    def messages(self) -> list[EmailMessage]:
        return [message_from_bytes(content, policy=policy.default) for content in self.taken]


@contextmanager
def mail_server(mailbox: Mailbox, **server: Any) -> Iterator[dict[str, Any]]:
    """A server; the settings by which it is reached."""
    controller = Controller(mailbox, hostname="127.0.0.1", port=free_port(), **server)
    controller.start()
    try:
        place = {"smtp_host": "localhost", "smtp_port": controller.port, "smtp_security": "none"}
        yield place | {"sender": "stone@example.org"}
    finally:
        controller.stop()


@pytest.fixture
def mailbox() -> Mailbox:
    return Mailbox()


@pytest.fixture
def context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ssl.SSLContext:
    """A server's, whose certificate is believed."""
    certificate = self_signed(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, tmp_path / "key.pem")
    return context


def test_an_event_is_one_plain_message_that_says_how_to_be_told_no_more(platform: Platform, mailbox: Mailbox) -> None:
    with mail_server(mailbox) as place:
        platform = telling(platform, **place)
        happened(platform, a_user(platform, "ada", email=ADDRESS))
        all_sent(platform)
    (message,) = mailbox.messages
    (row,) = deliveries(platform)
    assert (message["To"], message["From"], row.state) == (ADDRESS, "stone@example.org", "delivered")
    assert message["Message-ID"] == f"<msg_{row.id}@example.org>"
    assert "http://127.0.0.1:8080/account#notifications" in message.get_content()


def test_starttls_and_password_are_used_and_a_server_without_tls_is_told_nothing(
    platform: Platform, mailbox: Mailbox, context: ssl.SSLContext
) -> None:
    said: list[tuple[bytes, bytes]] = []

    def authenticator(_server: Any, _session: Any, _envelope: Any, _mechanism: str, data: LoginPassword) -> AuthResult:
        said.append((data.login, data.password))
        return AuthResult(success=data.password == PASSWORD.encode())

    login = {"smtp_user": "stone", "smtp_password": SecretStr(PASSWORD), "smtp_security": "starttls"}
    tls = {"tls_context": context, "require_starttls": True, "authenticator": authenticator, "auth_required": True}
    with mail_server(mailbox, **tls) as place:
        secure = telling(platform, **place | login)
        happened(secure, a_user(secure, "ada", email=ADDRESS))
        turn(secure)
    assert len(mailbox.taken) == 1
    assert said == [(b"stone", PASSWORD.encode())]
    with mail_server(mailbox) as place:
        plain = telling(platform, **place | login)
        happened(plain, a_user(plain, "bob", email="bob@example.org"))
        turn(plain)
    assert len(mailbox.taken) == 1
    assert len(said) == 1
    assert deliveries(plain)[-1].state == "waiting"


def test_tls_from_the_first_byte_is_spoken_where_it_is_set(
    platform: Platform, mailbox: Mailbox, context: ssl.SSLContext
) -> None:
    with mail_server(mailbox, ssl_context=context) as place:
        platform = telling(platform, **place | {"smtp_security": "tls"})
        happened(platform, a_user(platform, "ada", email=ADDRESS))
        turn(platform)
    assert len(mailbox.taken) == 1


def test_what_the_server_refuses_for_good_is_a_dead_letter_at_once(platform: Platform, mailbox: Mailbox) -> None:
    mailbox.refused = (ADDRESS,)
    with mail_server(mailbox) as place:
        platform = telling(platform, **place)
        happened(platform, a_user(platform, "ada", email=ADDRESS))
        turn(platform)
    (row,) = deliveries(platform)
    assert (row.state, row.answer, row.tries) == ("dead", "answered 550 no such mailbox", 1)
    with platform.database.reading() as session:
        assert session.get_one(Job, row.job_id).failure_code == "delivery_failed"


def test_an_address_is_written_to_once_its_link_was_followed_by_its_user(platform: Platform, mailbox: Mailbox) -> None:
    with mail_server(mailbox) as place:
        platform = telling(platform, **place)
        ada, eve = a_user(platform, "ada", email=ADDRESS), a_user(platform, "eve")
        with platform.database.transaction() as session:
            set_address(session, ada, "new@example.org", platform.settings.notifications)
        happened(platform, ada)
        all_sent(platform)
        (message,) = mailbox.messages  # the event was dropped: the new address is not verified
        assert message["To"] == "new@example.org"
        found = re.search(r"email_secret=([\w-]+)", message.get_content())
        assert found is not None
        with platform.database.transaction() as session:
            for user_id, secret in ((eve, found[1]), (ada, "x" * 43), (ada, "")):
                with refused_as("email_not_verified"):
                    verify(session, user_id, secret)
            assert verify(session, ada, found[1]).verified_ns is not None
            with refused_as("email_not_verified"):
                verify(session, ada, found[1])  # it worked once
        happened(platform, ada)
        all_sent(platform)
    assert [one["To"] for one in mailbox.messages] == ["new@example.org"] * 2


def test_nobody_is_made_to_write_many_letters_to_a_stranger(platform: Platform) -> None:
    told = telling(platform, smtp_host="127.0.0.1", sender="stone@example.org")
    user_id = a_user(told, "ada")
    with told.database.transaction() as session:
        for number in range(MOST_MAILS):
            set_address(session, user_id, f"stranger{number}@example.org", told.settings.notifications)
        with refused_as("too_many_verifications"):
            set_address(session, user_id, "stranger@example.org", told.settings.notifications)


def test_without_a_server_no_address_is_taken(platform: Platform) -> None:
    with platform.database.transaction() as session, refused_as("no_email"):
        set_address(session, "0" * 32, ADDRESS, platform.settings.notifications)


@pytest.mark.parametrize(
    "address",
    ["ada", "ada@", "@x.org", "a b@x.org", "ada@x.org\r\nBcc: eve@x.org", "ada@x.org,eve@x.org", "<ada@x.org>",
     "ada@x..org", "ädä@x.org", f"{'a' * 64}@{'b' * 63}.{'c' * 63}.{'d' * 63}.org", "ada@x.org\n"],
)  # fmt: skip
def test_what_is_no_address_is_refused_and_no_header_is_made_of_it(platform: Platform, address: str) -> None:
    told = telling(platform, smtp_host="127.0.0.1", sender="stone@example.org")
    with told.database.transaction() as session:
        user = User(name="ada", role="curator")
        session.add(user)
        session.flush()
        with refused_as("bad_email_address"):
            set_address(session, user.id, address, told.settings.notifications)
        assert session.get(EmailAddress, user.id) is None


@pytest.mark.parametrize("hostile", ["x\r\nBcc: eve@example.org", "x\nBcc: eve@example.org", "x\x00y", "𝕏" * 200])
def test_a_text_of_another_adds_no_header(hostile: str) -> None:
    letter = Letter("msg_1", "e", "run.failed", "2026-05-03T09:12:44Z", hostile, "http://h/", "http://h/account")
    try:
        content = email_of(letter, ADDRESS, "stone@example.org").as_bytes()
    except ValueError:
        return  # the policy refuses it
    parsed = message_from_bytes(content, policy=policy.default)
    assert parsed["Bcc"] is None
    assert set(parsed.keys()) <= {
        *("From", "To", "Subject", "Message-ID", "Auto-Submitted"),
        *("Content-Type", "Content-Transfer-Encoding", "MIME-Version"),
    }
