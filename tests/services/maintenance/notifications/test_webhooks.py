"""Webhooks: signed as others verify it, sent until they are taken or given up, and nowhere where they may not.

The sweeper killed by -9 at any moment of its sending: each event is received at least once, with its own id.
"""

import json
import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from standardwebhooks.webhooks import Webhook as Verifier
from standardwebhooks.webhooks import WebhookVerificationError

from services.domain.notifications.messages import HARMLESS
from services.domain.notifications.spread import MOST_TRIES, pause_ns
from services.maintenance.notifications import channels
from services.maintenance.notifications.channels import ANSWER_WITHIN_S, NotTakenError, Resolve, judged_addresses
from services.runtime.embedded.supervisor import environment_of
from services.runtime.jobs.control import retry
from services.runtime.notification_settings import NotificationSettings
from services.runtime.orm import Job, NotificationEvent, Webhook
from services.runtime.platform import Platform
from services.runtime.settings import JobSettings
from testing.servers.certificates import self_signed
from testing.servers.webhook_receiver import WebhookReceiver, webhook_receiver
from tests.services.maintenance.notifications.steps import a_user, all_sent, deliveries, happened, telling, turn

SOON = 1e-6
"""Pauses of microseconds."""


@pytest.fixture
def receiver(tmp_path: Path) -> Iterator[WebhookReceiver]:
    with webhook_receiver(tmp_path) as started:
        yield started


def secret_of(platform: Platform, user_id: str) -> str:
    with platform.database.reading() as session:
        return session.get_one(Webhook, user_id).secret


def test_an_event_is_sent_once_signed_as_another_implementation_verifies(
    platform: Platform, receiver: WebhookReceiver
) -> None:
    platform = telling(platform)
    user_id = a_user(platform, "ada", receiver.url())
    happened(platform, user_id)
    all_sent(platform)
    (came,) = receiver.received()
    told = Verifier(secret_of(platform, user_id)).verify(came["body"], came["headers"])
    assert told["type"] == "quota.low"
    assert told["data"]["what"] == "storage"
    assert "9.0 of 10.0 GiB" in told["text"]
    (row,) = deliveries(platform)
    assert (came["headers"]["webhook-id"], row.state, row.tries) == (f"msg_{row.id}", "delivered", 1)
    with pytest.raises(WebhookVerificationError):
        Verifier(secret_of(platform, user_id)).verify(came["body"] + " ", came["headers"])


def test_what_is_not_taken_is_sent_again_with_the_same_id_and_is_a_dead_letter_in_the_end(
    platform: Platform, receiver: WebhookReceiver
) -> None:
    platform = telling(platform, retry_s=SOON)
    user_id = a_user(platform, "ada", receiver.url("/status/503"))
    happened(platform, user_id)
    while deliveries(platform) == [] or deliveries(platform)[0].state != "dead":
        turn(platform)
    came = receiver.received()
    assert len(came) == MOST_TRIES
    assert len({one["headers"]["webhook-id"] for one in came}) == 1
    (row,) = deliveries(platform)
    with platform.database.transaction() as session:
        job = session.get_one(Job, row.job_id)
        assert (job.state, job.failure_code) == ("failed", "delivery_failed")
        assert "503" in job.failure
        session.get_one(Webhook, user_id).url = receiver.url()  # repaired
        retry(session, job.id, 3)
    turn(platform)
    assert deliveries(platform)[0].state == "delivered"
    assert len(receiver.received()) == MOST_TRIES + 1


def test_pauses_grow_to_three_days_in_all() -> None:
    pauses = [pause_ns(tries, 5.0) / 1e9 for tries in range(1, MOST_TRIES)]
    assert pauses[:4] == [5, 300, 1800, 7200]
    assert pauses == sorted(pauses)
    assert 2.5 * 86400 < sum(pauses) < 3.5 * 86400


def test_a_webhook_that_fails_for_long_is_switched_off_and_its_owner_is_told(
    platform: Platform, receiver: WebhookReceiver
) -> None:
    platform = telling(platform, retry_s=SOON, webhook_failing_s=SOON)
    user_id = a_user(platform, "ada", receiver.url("/status/500"))
    happened(platform, user_id)
    while any(turn(platform) for _ in range(3)):
        pass
    with platform.database.reading() as session:
        assert session.get_one(Webhook, user_id).disabled_ns is not None
        assert [event.kind for event in session.query(NotificationEvent)] == ["quota.low", "webhook.disabled"]
    states = {(row.channel, row.state) for row in deliveries(platform)}
    assert states == {("webhook", "dropped"), ("email", "dropped")}  # no address: the account's page says so


def test_one_that_is_gone_is_sent_nothing_more(platform: Platform, receiver: WebhookReceiver) -> None:
    platform = telling(platform)
    user_id = a_user(platform, "ada", receiver.url("/status/410"))
    happened(platform, user_id)
    happened(platform, user_id)
    all_sent(platform)
    assert len(receiver.received()) == 1
    with platform.database.reading() as session:
        assert session.get_one(Webhook, user_id).disabled_ns is not None


@pytest.mark.parametrize("path", ["/redirect", "/drip", "/status/204", "/endless"])
def test_no_redirect_is_followed_and_no_answer_is_waited_for_long(
    platform: Platform, receiver: WebhookReceiver, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    platform = telling(platform)
    user_id = a_user(platform, "ada", receiver.url(path))
    happened(platform, user_id)
    if path == "/drip":  # which is waited for to the end
        monkeypatch.setattr(channels, "ANSWER_WITHIN_S", 3.0)
    begin_s = time.monotonic()
    turn(platform)
    (row,) = deliveries(platform)
    taken = {"/redirect": "waiting", "/drip": "waiting", "/status/204": "delivered", "/endless": "delivered"}
    assert row.state == taken[path], row.answer
    assert [came["path"] for came in receiver.received()] == [path]
    assert time.monotonic() - begin_s < 30 * ANSWER_WITHIN_S  # it ends; how long a busy machine takes is no matter


@pytest.mark.parametrize(("name", "state"), [("localhost", "delivered"), ("chat.example.org", "waiting")])
def test_by_https_the_certificate_is_of_the_name_in_the_url(
    platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, state: str
) -> None:
    certificate = self_signed(tmp_path, name)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    platform = telling(platform, allows_http=False)
    with webhook_receiver(tmp_path, certificate) as receiver:
        happened(platform, a_user(platform, "ada", receiver.url()))
        turn(platform)
        assert len(receiver.received()) == (1 if state == "delivered" else 0)
    (row,) = deliveries(platform)
    assert row.state == state, row.answer


def test_a_name_that_resolves_to_a_private_address_a_moment_later_is_not_sent_to() -> None:
    answers = iter((["93.184.215.14"], ["127.0.0.1"], ["93.184.215.14", "10.0.0.7"], ["fe80::1%eth0"]))
    settings = NotificationSettings()
    assert judged_addresses("rebind.example", 443, settings, lambda *_: next(answers)) == ["93.184.215.14"]
    for _ in range(3):
        with pytest.raises(NotTakenError):
            judged_addresses("rebind.example", 443, settings, lambda *_: next(answers))


def test_whether_a_name_is_known_inside_is_not_told() -> None:
    """The attack: one answer for a name that resolves inside, another one for a name that nobody has."""

    def refusal(resolve: Resolve) -> str:
        with pytest.raises(NotTakenError) as refused:
            judged_addresses("payroll.internal", 443, NotificationSettings(), resolve)
        return str(refused.value)

    def unknown(*_: object) -> list[str]:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    inner = [refusal(lambda *_: ["10.0.0.7"]), refusal(lambda *_: ["93.184.215.14", "10.0.0.7"])]
    assert set(inner) == {refusal(unknown)}
    with pytest.raises(NotTakenError):
        judged_addresses("x" * 64 + ".example", 443, NotificationSettings())


def test_a_name_of_this_machine_is_judged_when_it_is_connected_to(
    platform: Platform, receiver: WebhookReceiver
) -> None:
    platform = telling(platform, webhook_networks="")
    user_id = a_user(platform, "ada", receiver.url())
    happened(platform, user_id)
    turn(platform)
    (row,) = deliveries(platform)
    assert row.state == "waiting"
    assert receiver.received() == []


def test_texts_of_others_call_nobody_and_are_no_markup() -> None:
    hostile = "<!channel> @here [x](http://evil) *b* `c` <http://evil|click>"
    assert not set(hostile.translate(HARMLESS)) & set("<>@[]*`|")


QUICK = JobSettings(lease_s=0.6, heartbeat_s=0.1, progress_s=0.1, sweep_s=0.02, rest_s=0.1, max_attempts=100)
EVENTS, KILLS, PATIENCE_S = 12, 3, 900.0


@pytest.mark.whole
def test_killed_at_many_moments_the_sender_loses_nothing_and_repeats_only_with_the_same_id(
    platform: Platform, tmp_path: Path
) -> None:
    """A sweeper process started and killed three times (7 CPU-seconds): nothing else runs the sender as it ships,
    and only so a message is sent whose end is never written."""
    settings = platform.settings.model_copy(update={"jobs": QUICK})
    platform = telling(replace(platform, settings=settings), retry_s=0.01)
    chance = random.Random(20)
    with webhook_receiver(tmp_path) as receiver:
        user_id = a_user(platform, "ada", receiver.url())
        for number in range(EVENTS):
            happened(platform, user_id, number=number)
        kills, deadline_s = 0, time.monotonic() + PATIENCE_S
        while not all_delivered(platform):
            assert time.monotonic() < deadline_s, [(row.state, row.answer) for row in deliveries(platform)]
            before = len(receiver.received())
            process = started(platform, tmp_path)
            if kills < KILLS:
                wait_for_more(receiver, before + chance.randrange(1, 4), process, deadline_s)
                time.sleep(chance.random() * 0.02)  # any moment after an answer: before, while, after it is written
                process.kill()
                kills += 1
            else:
                while not all_delivered(platform) and time.monotonic() < deadline_s:
                    time.sleep(0.05)
                process.kill()
            process.wait()
        came = receiver.received()
    ids = [one["headers"]["webhook-id"] for one in came]
    once = {one["headers"]["webhook-id"]: json.loads(one["body"])["data"]["number"] for one in came}
    assert sorted(once.values()) == list(range(EVENTS))  # whoever drops repeated ids holds each exactly once
    assert set(ids) == {f"msg_{row.id}" for row in deliveries(platform)}
    for one in came:
        assert once[one["headers"]["webhook-id"]] == json.loads(one["body"])["data"]["number"]


def started(platform: Platform, folder: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-P", "-m", "services.maintenance.sweeper"]
    environment = {**environment_of(platform.settings), "PYTHONPATH": os.getcwd()}
    with (folder / "sweeper.log").open("ab") as log:
        return subprocess.Popen(command, env=environment, stdout=log, stderr=log)


def all_delivered(platform: Platform) -> bool:
    rows = deliveries(platform)
    return len(rows) == EVENTS and all(row.state == "delivered" for row in rows)


def wait_for_more(receiver: object, wanted: int, process: "subprocess.Popen[bytes]", deadline_s: float) -> None:
    while len(receiver.received()) < min(wanted, EVENTS) and process.poll() is None:  # type: ignore[attr-defined]
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
