"""Secrets are kept as hashes, end when they should, and names and roles are what they seem."""

import threading
from hashlib import sha256
from time import process_time

import pytest
from sqlalchemy import select, update

from services.runtime.access import passwords, roles, sessions, tokens, users
from services.runtime.access.issuing import TokenRequest, authority_for, issue_token
from services.runtime.orm import Token, User, WebSession
from services.runtime.platform import Platform
from testing.refusals import refused_as
from testing.threads import granted

PASSWORD = "correct horse battery staple"


@pytest.fixture
def ada(platform: Platform) -> User:
    with platform.database.transaction() as session:
        user = users.create_user(session, "ada", "curator", PASSWORD)
    return user


@pytest.mark.parametrize("password", ["", "elevenchars", "x" * 1025])
def test_a_password_too_short_or_too_long_is_refused(password: str) -> None:
    with refused_as("weak_password"):
        passwords.hash_password(password)


def test_a_password_is_kept_as_argon2id_and_verifies() -> None:
    kept = passwords.hash_password(PASSWORD)
    assert kept.startswith("$argon2id$")
    assert PASSWORD not in kept
    assert passwords.verify_password(kept, PASSWORD)
    assert not passwords.verify_password(kept, PASSWORD + "!")


@pytest.mark.parametrize("kept", ["", "not a hash", "$argon2id$v=19$m=65536,t=3,p=4$AAAA$AAAA"])
def test_what_is_no_hash_matches_no_password(kept: str) -> None:
    assert not passwords.verify_password(kept, PASSWORD)


@pytest.mark.whole
def test_a_name_that_does_not_exist_costs_as_much_as_a_wrong_password() -> None:
    kept = passwords.hash_password(PASSWORD)
    passwords.verify_password("", "warm up")

    def cost_s(password_hash: str) -> float:
        begun = process_time()
        for _ in range(2):
            passwords.verify_password(password_hash, "wrong password")
        return process_time() - begun

    ratio = cost_s("") / cost_s(kept)
    assert 0.4 < ratio < 2.5


def test_a_flood_of_passwords_is_refused_beyond_its_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passwords, "_places", threading.BoundedSemaphore(2))
    kept = passwords.hash_password(PASSWORD)
    assert 2 <= granted(12, lambda _: passwords.verify_password(kept, PASSWORD), "busy") < 12
    assert passwords.verify_password(kept, PASSWORD), "the places are free again"


def test_roles_are_ordered_and_an_unknown_one_may_nothing() -> None:
    assert roles.allows("administrator", ["curator"])
    assert roles.allows("curator", ["curator"])
    assert not roles.allows("participant", ["curator"])
    assert roles.allows("participant", [])
    assert not roles.allows("king", [])
    assert not roles.allows("king", ["participant"])


def test_a_scope_counts_only_while_the_role_allows_it() -> None:
    assert roles.scopes_in_force("participant", ["read", "upload", "admin"]) == {"read"}
    assert roles.scopes_in_force("king", ["read"]) == set()


def test_every_role_holds_the_scopes_of_the_one_below() -> None:
    held = [roles.SCOPES_OF[role] for role in roles.ROLES]
    assert held[0] < held[1] < held[2] == set(roles.SCOPES)


@pytest.mark.parametrize("name", ["", "Ada", "a b", "a/b", "<b>", "ä", "a" * 65, "a\n"])
def test_a_name_that_could_be_mistaken_is_refused(platform: Platform, name: str) -> None:
    with platform.database.transaction() as session, refused_as("bad_name"):
        users.create_user(session, name, "curator")


def test_a_role_that_does_not_exist_is_refused(platform: Platform) -> None:
    with platform.database.transaction() as session, refused_as("unknown_role"):
        users.create_user(session, "ada", "king")


def test_two_users_cannot_share_a_name(platform: Platform, ada: User) -> None:
    with platform.database.transaction() as session, refused_as("name_taken"):
        users.create_user(session, ada.name, "participant")


def test_a_token_is_found_by_its_secret_and_kept_as_a_hash(platform: Platform, ada: User) -> None:
    with platform.database.transaction() as session:
        secret = tokens.issue(session, ada, "laptop", ["upload", "read", "read"], 60)
    assert tokens.SECRET.fullmatch(secret)
    with platform.database.reading() as session:
        row = session.scalars(select(Token)).one()
        assert row.secret_hash == sha256(secret.encode()).hexdigest()
        assert row.scopes == ["read", "upload"]
        found = tokens.find(session, secret)
        assert found is not None
        assert found.user.name == "ada"


@pytest.mark.parametrize("secret", ["", "stone_", "stone_" + "x" * 43, "x" * 49, "stone_" + "x" * 10_000, "stone_é"])
def test_another_secret_finds_nothing(platform: Platform, secret: str) -> None:
    with platform.database.reading() as session:
        assert tokens.find(session, secret) is None


def test_a_token_ends_with_its_time_and_with_its_user(platform: Platform, ada: User) -> None:
    with platform.database.transaction() as session:
        ended = tokens.issue(session, ada, "ended", ["read"], 0)
        alive = tokens.issue(session, ada, "alive", ["read"], 60)
    with platform.database.transaction() as session:
        assert tokens.find(session, ended) is None
        assert tokens.find(session, alive) is not None
        session.execute(update(User).values(is_active=False))
    with platform.database.reading() as session:
        assert tokens.find(session, alive) is None


def test_the_last_use_is_worth_writing_once_a_minute(platform: Platform) -> None:
    with platform.database.transaction() as session:
        user = users.create_user(session, "ada", "curator")
        row, _ = issue_token(session, authority_for(user, 60.0), TokenRequest("laptop", frozenset({"read"})))
    assert tokens.is_use_due(row)
    with platform.database.transaction() as session:
        tokens.note_use(session, row.id)
    with platform.database.reading() as session:
        row = session.get_one(Token, row.id)
    assert not tokens.is_use_due(row)
    assert row.used_ns is not None
    row.used_ns -= 61 * 10**9
    assert tokens.is_use_due(row)


def test_a_session_is_found_by_its_cookie_until_it_ends(platform: Platform, ada: User) -> None:
    with platform.database.transaction() as session:
        ended = sessions.open_session(session, ada, 0)
        alive = sessions.open_session(session, ada, 60)
    with platform.database.reading() as session:
        assert sessions.find_session(session, ended.secret, 60) is None
        row = sessions.find_session(session, alive.secret, 60)
        assert row is not None
        assert alive.secret not in (row.secret_hash, row.csrf_token)
        assert sessions.find_session(session, "", 60) is None
        assert sessions.find_session(session, "x" * 100_000, 60) is None
        assert len(session.scalars(select(WebSession)).all()) == 1, "what has ended is forgotten with the next sign-in"


def test_only_an_active_user_has_a_password(platform: Platform, ada: User) -> None:
    assert sessions.is_password_of(ada, PASSWORD)
    assert not sessions.is_password_of(ada, "wrong password")
    assert not sessions.is_password_of(None, PASSWORD)
    ada.is_active = False
    assert not sessions.is_password_of(ada, PASSWORD)


def test_a_new_password_signs_every_browser_out(platform: Platform, ada: User) -> None:
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, ada, 60)
        user = session.get_one(User, ada.id)
        users.change_password(session, user, passwords.hash_password("another horse, another battery"))
    with platform.database.reading() as session:
        assert sessions.find_session(session, opened.secret, 60) is None


@pytest.mark.parametrize("change", [{"role": "curator", "is_active": None}, {"role": None, "is_active": False}])
def test_the_last_administrator_stays(platform: Platform, change: dict[str, object]) -> None:
    with platform.database.transaction() as session:
        last = users.create_user(session, "root", "administrator")
        gone = users.create_user(session, "gone", "administrator")
        gone.is_active = False
    with platform.database.transaction() as session, refused_as("last_administrator"):
        users.change_user(session, session.get_one(User, last.id), **change)  # type: ignore[arg-type]


def test_of_two_administrators_who_dismiss_each_other_one_stays(platform_on: Platform) -> None:
    with platform_on.database.transaction() as session:
        ids = [users.create_user(session, name, "administrator").id for name in ("romulus", "remus")]

    def dismiss(number: int) -> None:
        with platform_on.database.transaction() as session:
            users.change_user(session, session.get_one(User, ids[number]), "participant", None)

    assert granted(2, dismiss, "last_administrator") == 1
    with platform_on.database.reading() as session:
        assert len(session.scalars(select(User).where(User.role == "administrator")).all()) == 1
