"""The audit log grows by whole links, whoever writes at once, and shows what was changed."""

import httpx
import pytest
from sqlalchemy import delete, select, text, update
from sqlalchemy.orm import Session

from api import audit
from api.deps import Caller
from services.runtime.access import audit_chain
from services.runtime.orm import AuditEntry, Team
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.refusals import refused_as
from testing.threads import at_once

LOG = "/api/v1/admin/audit-log"
ADA = Caller("a" * 32, "ada", "administrator", frozenset({"read", "admin"}), is_session=False)


def write(platform: Platform, *acts: str) -> None:
    for act in acts:
        with platform.database.transaction() as session:
            audit.record(session, ADA, act, "subject", facts={"ratio": 0.1, "ä": ["é", None, 2**53]})


def first_broken(platform: Platform) -> int | None:
    with platform.database.reading() as session:
        return audit.verify(session)


def lines(platform: Platform) -> list[AuditEntry]:
    with platform.database.reading() as session:
        return list(session.scalars(select(AuditEntry).order_by(AuditEntry.number)))


def unguarded(session: Session) -> None:
    """Take away what keeps the table append-only, as somebody with the database's password could."""
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("ALTER TABLE audit_log DISABLE TRIGGER USER"))
        return
    for name in session.scalars(
        text("SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'audit_log'")
    ).all():
        session.execute(text(f"DROP TRIGGER {name}"))


@pytest.mark.parametrize("reason", ["", "   ", "\n"])
def test_an_administrators_act_without_a_reason_is_refused(platform: Platform, reason: str) -> None:
    with platform.database.transaction() as session, refused_as("reason_missing", match=r"user\.change"):
        audit.record_admin_act(session, ADA, "user.change", "x", reason)
    assert lines(platform) == []


def test_an_act_that_is_rolled_back_leaves_no_line(platform: Platform) -> None:
    with platform.database.transaction() as session:
        audit.record(session, ADA, "never", "subject")
        session.rollback()
    write(platform, "after")
    assert [(line.number, line.act) for line in lines(platform)] == [(1, "after")]


def test_lines_are_numbered_and_linked(platform: Platform) -> None:
    write(platform, "one", "two")
    with platform.database.transaction() as session:
        audit.record(session, ADA, "three", "subject")
        audit.record(session, None, "four", "subject")
    written = lines(platform)
    assert [(line.number, line.act) for line in written] == [(1, "one"), (2, "two"), (3, "three"), (4, "four")]
    assert written[0].hash == audit.hash_of(written[0], "")
    assert written[3].hash == audit.hash_of(written[3], written[2].hash)
    assert written[3].actor == "anonymous"
    assert first_broken(platform) is None


def test_a_changed_line_is_found_whatever_was_changed(platform: Platform) -> None:
    changes: list[dict[str, object]] = [
        {"reason": "another"}, {"actor": "eve"}, {"act": "other"}, {"facts": {}}, {"logged_ns": 1}, {"subject_id": ""},
        {"request_id": "x"}, {"hash": "0" * 64},
    ]  # fmt: skip
    write(platform, *("act" for _ in range(len(changes) + 1)))
    for number in range(len(changes), 0, -1):
        with platform.database.transaction() as session:
            unguarded(session)
            session.execute(update(AuditEntry).where(AuditEntry.number == number).values(**changes[number - 1]))
        assert first_broken(platform) == number


def test_a_line_taken_out_is_found_and_so_is_a_new_order(platform_on: Platform) -> None:
    write(platform_on, "one", "two", "three")
    with platform_on.database.transaction() as session:
        unguarded(session)
        session.execute(delete(AuditEntry).where(AuditEntry.number == 2))
    assert first_broken(platform_on) == 2
    with platform_on.database.transaction() as session:
        session.execute(update(AuditEntry).where(AuditEntry.number == 3).values(number=2))
    assert first_broken(platform_on) == 2


@pytest.mark.parametrize("statement", ["UPDATE audit_log SET act = 'x'", "DELETE FROM audit_log"])
def test_the_database_itself_refuses_to_change_a_line(platform_on: Platform, statement: str) -> None:
    write(platform_on, "one")
    with pytest.raises(Exception, match="audit_log is append-only"), platform_on.database.transaction() as session:
        session.execute(text(statement))
    assert [line.act for line in lines(platform_on)] == ["one"]


def test_eight_writers_at_once_make_one_chain(platform_on: Platform) -> None:
    def work(number: int) -> None:
        for turn in range(6):
            with platform_on.database.transaction() as session:
                audit.record(session, ADA, f"act.{number}.{turn}", "subject")
                session.add(Team(name=f"{number} {turn}"))

    at_once(8, work)
    written = lines(platform_on)
    assert [line.number for line in written] == list(range(1, 49))
    assert len({line.act for line in written}) == 48
    assert first_broken(platform_on) is None


def test_a_long_log_is_verified_in_pieces(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit_chain, "AT_A_TIME", 3)
    write(platform, *(f"act.{number}" for number in range(10)))
    assert first_broken(platform) is None
    with platform.database.transaction() as session:
        unguarded(session)
        session.execute(update(AuditEntry).where(AuditEntry.number == 7).values(reason="x"))
    assert first_broken(platform) == 7


def test_the_log_is_read_by_pages_and_filters_and_proven(api: httpx.Client, platform: Platform) -> None:
    root = person(platform, "administrator")
    write(platform, "one", "two", "one")
    first = api.get(LOG, params={"limit": 2}, headers=root.headers).json()
    rest = api.get(LOG, params={"limit": 2, "cursor": first["next"]}, headers=root.headers).json()
    assert [line["number"] for line in first["items"] + rest["items"]] == [3, 2, 1]
    assert rest["next"] is None
    for query, numbers in (
        ({"act": "one"}, [3, 1]),
        ({"actor_id": "a" * 32}, [3, 2, 1]),
        ({"actor_id": "b" * 32}, []),
        ({"subject_id": "subject", "act": "two"}, [2]),
    ):
        found = api.get(LOG, params=query, headers=root.headers).json()["items"]
        assert [line["number"] for line in found] == numbers
    proof = api.get(f"{LOG}/verification", headers=root.headers).json()
    assert proof == {"is_whole": True, "first_broken": None, "lines": 3, "head_hash": first["items"][0]["hash"]}


def test_a_line_carries_the_request_that_wrote_it(api: httpx.Client, administrator: Person) -> None:
    headers = {**administrator.headers, "X-Request-ID": "look-for-me"}
    api.post("/api/v1/teams", json={"name": "us"}, headers=headers)
    line = api.get(LOG, headers=administrator.headers).json()["items"][0]
    assert (line["act"], line["actor"], line["request_id"]) == ("team.found", administrator.name, "look-for-me")
