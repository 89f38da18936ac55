"""What is over goes, what somebody may still need stays; who is erased is gone from everything but the audit log."""

from dataclasses import replace

import pytest
from sqlalchemy import func, select, text, update
from sqlalchemy.exc import DatabaseError

from api import audit
from services.runtime.access import audit_chain, login_throttle, retention, sessions, tokens, users
from services.runtime.access.erasure import erase_user
from services.runtime.access.retention import forget_ended
from services.runtime.orm import AuditEntry, Base, FailedSignInRow, SignInAddress, Token, User, WebSession
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import RetentionSettings
from testing.refusals import refused_as

DAY_NS = 86_400 * 10**9


def count(platform: Platform, table: type[Base]) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(table)) or 0


def test_what_has_ended_is_deleted_and_what_has_not_stays(platform: Platform) -> None:
    with platform.database.transaction() as session:
        ada = users.create_user(session, "ada", "curator")
        sessions.open_session(session, ada, 3600)
        idle = sessions.open_session(session, ada, 3600)
        tokens.issue(session, ada, "standing", ["read"], 3600)
        tokens.issue(session, ada, "ended lately", ["read"], -3600)
        tokens.issue(session, ada, "ended long ago", ["read"], -31 * 86_400)
        login_throttle.count_try(session, login_throttle.try_at(session, "ada", "here"))
        login_throttle.take_back(session, login_throttle.try_at(session, "eve", "there"), ada.id)
        old = now_ns() - login_throttle.ADDRESSES_KEPT_NS - 1
        session.add(SignInAddress(key="old", user_id=ada.id, used_ns=old))
        row = sessions.find_session(session, idle.secret, 60)
        assert row is not None
        row.used_ns -= 31 * 60 * 10**9
    assert forget_ended(platform) == 3
    tables = (WebSession, Token, FailedSignInRow, SignInAddress)
    assert [count(platform, table) for table in tables] == [1, 2, 2, 1]
    assert forget_ended(platform) == 0


def test_of_very_many_rows_some_go_a_turn_and_all_in_the_end(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retention, "AT_A_TIME", 2)
    monkeypatch.setattr(retention, "MOST_TIMES", 2)
    with platform.database.transaction() as session:
        session.add_all(FailedSignInRow(key=f"{number}", failed_ns=number) for number in range(5))
        session.add(FailedSignInRow(key="fresh", failed_ns=now_ns()))
    assert [forget_ended(platform) for _ in range(3)] == [4, 1, 0]
    assert count(platform, FailedSignInRow) == 1


def test_a_session_that_nobody_uses_ends_and_one_that_is_used_goes_on(platform: Platform) -> None:
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, users.create_user(session, "ada", "curator"), 3600)
        assert sessions.find_session(session, opened.secret, 1800) is not None
        session.execute(update(WebSession).values(used_ns=now_ns() - 1801 * 10**9))
        assert sessions.find_session(session, opened.secret, 1800) is None
        session.execute(update(WebSession).values(used_ns=now_ns() - 120 * 10**9))
        session.expire_all()
        row = sessions.find_session(session, opened.secret, 1800)
        assert row is not None
        assert sessions.is_use_due(row)
        sessions.note_use(session, row.id)
        session.refresh(row)
        assert not sessions.is_use_due(row)


def test_who_is_erased_cannot_come_in_and_is_named_nowhere(platform: Platform) -> None:
    with platform.database.transaction() as session:
        grace = users.create_user(session, "grace.hopper", "participant", "correct horse battery staple")
        opened = sessions.open_session(session, grace, 3600)
        secret = tokens.issue(session, grace, "laptop", ["read"], 3600)
        erase_user(session, grace)
    with platform.database.reading() as session:
        row = session.get_one(User, grace.id)
        assert row.name.startswith("erased-")
        assert (row.is_active, row.password_hash) == (False, "")
        assert users.find_user(session, "grace.hopper") is None
        assert tokens.find(session, secret) is None
        assert sessions.find_session(session, opened.secret, 60) is None
        rows = [row for table in Base.metadata.sorted_tables for row in session.execute(select(table))]
    assert "grace.hopper" not in str(rows)


def test_the_last_administrator_cannot_be_erased(platform: Platform) -> None:
    with platform.database.transaction() as session:
        root = users.create_user(session, "root", "administrator")
        with refused_as("last_administrator"):
            erase_user(session, root)


def log(platform: Platform, ages_days: list[int]) -> None:
    """Lines of these ages, oldest first, in one chain."""
    for age_days in ages_days:
        with platform.database.transaction() as session, pytest.MonkeyPatch.context() as patch:
            patch.setattr(audit_chain, "now_ns", lambda age_days=age_days: now_ns() - age_days * DAY_NS)
            audit.record(session, None, "act", f"{age_days}")


def keeping(platform: Platform, days: float) -> Platform:
    kept = RetentionSettings(audit_s=days * 86_400)
    return replace(platform, settings=platform.settings.model_copy(update={"retention": kept}))


def subjects(platform: Platform) -> list[str]:
    with platform.database.reading() as session:
        assert audit.verify(session) is None
        return list(session.scalars(select(AuditEntry.subject_id).order_by(AuditEntry.number)))


def test_the_audit_log_is_cut_where_it_is_old_and_its_chain_goes_on(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retention, "AUDIT_LINES_AT_A_TIME", 2)
    log(platform, [500, 450, 420, 300, 5])
    assert retention.cut_audit(keeping(platform, 0)) == 0
    assert retention.cut_audit(keeping(platform, 400)) == 3
    assert subjects(platform) == ["300", "5"]
    assert retention.cut_audit(keeping(platform, 1)) == 1, "nothing younger than 90 days goes"
    log(platform, [0])
    assert subjects(platform) == ["5", "0"]
    with platform.database.reading() as session:
        assert audit.head(session).number == 6


def test_a_log_that_is_all_old_goes_on_from_its_anchor(platform: Platform) -> None:
    log(platform, [500, 400])
    assert retention.cut_audit(keeping(platform, 100)) == 2
    assert subjects(platform) == []
    log(platform, [0])
    assert subjects(platform) == ["0"]


@pytest.mark.parametrize(
    "act",
    [
        "DELETE FROM audit_log",
        "UPDATE audit_log SET act = 'x'",
        "DELETE FROM audit_anchors",
        "UPDATE audit_anchors SET number = 9",
    ],
)
def test_the_database_lets_no_line_go_beyond_an_anchor(platform_on: Platform, act: str) -> None:
    log(platform_on, [500, 5])
    retention.cut_audit(keeping(platform_on, 400))
    with pytest.raises(DatabaseError, match="append-only"), platform_on.database.transaction() as session:
        session.execute(text(act))
    assert subjects(platform_on) == ["5"]
