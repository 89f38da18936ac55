"""Who is told of what: those who chose it and may see it when it is sent, of each thing once."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from services.domain.benchmarks.submissions.state_machine import settle
from services.domain.notifications.spread import (
    LATEST_NS,
    choose,
    delete_old_events,
    record_phase_events,
    spread_events,
)
from services.domain.notifications.webhooks import set_webhook
from services.domain.sequences.unusable_labels import record_unusable
from services.runtime.access import storage_quota
from services.runtime.access.erasure import erase_user
from services.runtime.jobs.specs import JobSpec
from services.runtime.notifications.events import EVENTS
from services.runtime.orm import NotificationDelivery, NotificationEvent, Phase, SequenceRow, TeamMember, User
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.servers.webhook_receiver import WebhookReceiver, webhook_receiver
from tests.services.domain.benchmarks.drafts import Entrant, entrant_on, finalised, reserved
from tests.services.maintenance.notifications.steps import a_user, all_sent, deliveries, happened, telling
from tests.services.runtime.jobs.steps import HANDLERS, a_job, a_run, act, run_all

GIB = 2**30


@pytest.fixture
def receiver(tmp_path: Path) -> Iterator[WebhookReceiver]:
    with webhook_receiver(tmp_path) as started:
        yield started


def kinds(platform: Platform) -> list[str]:
    with platform.database.reading() as session:
        return [event.kind for event in session.query(NotificationEvent).order_by(NotificationEvent.id)]


def wanting(platform: Platform, user_id: str, url: str) -> None:
    """A user of another world wants to be told of everything there."""
    with platform.database.transaction() as session:
        choose(session, user_id, {"webhook": list(EVENTS)})
        set_webhook(session, user_id, url, platform.settings.notifications)


def test_nobody_is_told_anything_who_did_not_choose_it(platform: Platform, receiver: WebhookReceiver) -> None:
    platform = telling(platform)
    user_id = a_user(platform, "ada", receiver.url())
    act(platform, choose, user_id, {"webhook": ["run.failed"]})
    happened(platform, user_id)
    all_sent(platform)
    assert (receiver.received(), deliveries(platform)) == ([], [])


def test_a_run_is_told_of_when_it_ends_and_a_delivery_is_not(platform: Platform) -> None:
    owner = a_user(platform, "ada")
    a_run(platform, owner, JobSpec("ingest.ok"), JobSpec("labeler.ok"))
    a_run(platform, owner, JobSpec("ingest.refuse"), JobSpec("labeler.ok"))
    handlers = {**HANDLERS, "labeler.export": HANDLERS["ingest.ok"], "ingest.register": HANDLERS["ingest.refuse"]}
    a_job(platform, owner, "labeler.export")
    a_job(platform, owner, "ingest.register")
    a_job(platform, owner, "ingest.ok")  # of no kind that is told
    run_all(platform, handlers)
    assert sorted(kinds(platform)) == ["run.done", "run.done", "run.failed", "run.failed"]
    with platform.database.reading() as session:
        failed = session.query(NotificationEvent).where(NotificationEvent.kind == "run.failed").first()
    assert failed is not None
    assert failed.facts == {"code": "unreadable", "failure": "the bag is cut at byte 7"}


def test_what_is_rolled_back_is_told_to_nobody(platform: Platform) -> None:
    user_id = a_user(platform, "ada")
    with platform.database.reading() as session:  # never commits
        storage_quota.reserve(session, user_id, 95 * GIB, "upload", "upload", 100 * GIB)
    assert kinds(platform) == []


def test_storage_is_low_once_as_it_passes_nine_tenths(platform: Platform) -> None:
    user_id = a_user(platform, "ada")
    for amount in (80, 9, 1, 5):
        act(platform, storage_quota.reserve, user_id, amount * GIB, "upload", "upload", 100 * GIB)
        assert len(kinds(platform)) == (1 if amount in (1, 5) else 0)


@pytest.mark.parametrize(("rules", "told_after"), [({"scorings_per_window": 3}, 3), ({"scorings_total": 10}, 8)])
def test_scorings_are_low_once_as_a_fifth_is_left(platform: Platform, rules: dict[str, int], told_after: int) -> None:
    entrant = entrant_on(platform, **{"scorings_per_window": None, **rules})
    for number in range(1, told_after + 1):
        reserved(entrant)
        assert kinds(platform) == (["quota.low"] if number == told_after else [])


def scored(entrant: Entrant, state: str) -> None:
    submission_id = finalised(entrant)
    act(entrant.platform, settle, submission_id, state)


def test_a_team_is_told_and_who_left_it_meanwhile_is_not(platform: Platform, receiver: WebhookReceiver) -> None:
    platform = telling(platform)
    entrant = entrant_on(platform, scorings_per_window=None)
    leaver, stranger = (
        a_user(platform, "leaver", receiver.url("/leaver")),
        a_user(platform, "stranger", receiver.url("/stranger")),
    )
    wanting(platform, entrant.captain.user_id, receiver.url("/captain"))
    with platform.database.transaction() as session:
        session.add(TeamMember(team_id=entrant.team_id, user_id=leaver))
    scored(entrant, "scored")
    scored(entrant, "invalid")
    spread_events(platform)
    assert {row.user_id for row in deliveries(platform)} == {leaver, entrant.captain.user_id}
    assert stranger
    with platform.database.transaction() as session:
        session.delete(session.get_one(TeamMember, (entrant.team_id, leaver)))
    all_sent(platform)
    assert {one["path"] for one in receiver.received()} == {"/captain"}
    told = [one["body"] for one in receiver.received()]
    assert len(told) == 2
    assert sum("scored" in body for body in told) == sum("invalid" in body for body in told) == 1
    assert {row.state for row in deliveries(platform) if row.user_id == leaver} == {"dropped"}


def test_who_is_shut_out_erased_or_chose_otherwise_meanwhile_is_not_told(
    platform: Platform, receiver: WebhookReceiver
) -> None:
    platform = telling(platform)
    users = [a_user(platform, name, receiver.url(f"/{name}")) for name in ("shut", "erased", "changed", "gone")]
    for user_id in users:
        happened(platform, user_id)
    spread_events(platform)
    with platform.database.transaction() as session:
        session.get_one(User, users[0]).is_active = False
        erase_user(session, session.get_one(User, users[1]))
        choose(session, users[2], {})
        choose(session, users[3], {"email": ["quota.low"]})
    all_sent(platform)
    assert receiver.received() == []
    assert {row.state for row in deliveries(platform)} == {"dropped"}


def test_of_a_deleted_sequence_nothing_is_told(platform: Platform, receiver: WebhookReceiver) -> None:
    platform = telling(platform)
    owner = a_user(platform, "ada", receiver.url())
    ids = []
    for name in ("kept", "<!channel> deleted"):
        with platform.database.transaction() as session:
            row = SequenceRow(owner_id=owner, name=name)
            session.add(row)
            session.flush()
            finding = {"code": "REC-104", "severity": "error", "topic": "/lidar", "message": "stamps run back"}
            record_unusable(session, row.id, [{**finding, "severity": "warning"}])
            record_unusable(session, row.id, [{**finding, "severity": "warning"}, finding])
            ids.append(row.id)
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, ids[1]).deleted_ns = now_ns()
    all_sent(platform)
    (came,) = receiver.received()
    assert "“kept”" in came["body"]
    assert "REC-104" in came["body"]
    assert [row.state for row in deliveries(platform)] == ["delivered", "dropped"]


def test_a_phase_opens_and_closes_once_by_the_clock_and_again_where_it_was_moved(platform: Platform) -> None:
    entrant = entrant_on(platform, opens_ns=now_ns() - 10**9, closes_ns=now_ns() + 3600 * 10**9)
    assert [record_phase_events(platform) for _ in range(3)] == [1, 0, 0]
    with platform.database.transaction() as session:
        session.get_one(Phase, entrant.phase_id).closes_ns = now_ns() - 1
    assert [record_phase_events(platform) for _ in range(2)] == [1, 0]
    with platform.database.transaction() as session:
        session.get_one(Phase, entrant.phase_id).opens_ns = now_ns() - LATEST_NS - 10**9  # weeks ago is no news
        session.get_one(Phase, entrant.phase_id).closes_ns = now_ns() - 1
    assert record_phase_events(platform) == 1
    assert kinds(platform) == ["phase.opened", "phase.closed", "phase.closed"]


def test_everybody_who_chose_it_is_told_of_a_phase(platform: Platform, receiver: WebhookReceiver) -> None:
    platform = telling(platform)
    for name in ("ada", "bob"):
        a_user(platform, name, receiver.url(f"/{name}"))
    entrant_on(platform, opens_ns=now_ns() - 10**9, closes_ns=None)
    all_sent(platform)
    assert sorted(one["path"] for one in receiver.received()) == ["/ada", "/bob"]


def test_what_is_old_is_forgotten_with_its_deliveries(platform: Platform, receiver: WebhookReceiver) -> None:
    platform = telling(platform, kept_s=1e-6)
    happened(platform, a_user(platform, "ada", receiver.url()))
    all_sent(platform)
    assert delete_old_events(platform) == 1
    with platform.database.reading() as session:
        assert session.query(NotificationDelivery).count() == 0
