"""Callers are remembered for a second, and forgotten at once where this process revoked what they asked with."""

import time
from contextlib import suppress

import httpx
import pytest
from sqlalchemy import delete, select, text, update
from sqlalchemy.orm import Session

from api.known_credentials import KEPT_S, KnownCredentials
from services.runtime.access import sessions, tokens, users
from services.runtime.access.credential_changes import credentials_generation
from services.runtime.orm import Token, User
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person

ME = "/api/v1/me"
FAR_NS = 2**62
PATIENCE_S = 120.0


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def learnt(clock: Clock, expires_ns: int = FAR_NS) -> KnownCredentials[str]:
    known = KnownCredentials[str](clock)
    known.learn("secret", "ada", expires_ns=expires_ns, generation=credentials_generation())
    return known


def test_a_caller_is_remembered_for_a_second_and_no_longer() -> None:
    clock = Clock()
    known = learnt(clock)
    assert (known.find("secret"), known.find("another")) == ("ada", None)
    clock.now_s += KEPT_S
    assert known.find("secret") is None


def test_what_ends_by_the_clock_is_not_remembered_beyond_its_end() -> None:
    assert learnt(Clock(), expires_ns=now_ns()).find("secret") is None


def test_the_secret_itself_is_not_kept() -> None:
    assert "secret" not in repr(vars(learnt(Clock())))


def test_what_was_read_before_a_change_is_not_remembered_after_it(platform: Platform, curator: Person) -> None:
    known, generation = KnownCredentials[str](Clock()), credentials_generation()
    with platform.database.transaction() as session:
        session.execute(delete(Token).where(Token.user_id == curator.user_id))
    known.learn("secret", "ada", expires_ns=FAR_NS, generation=generation)
    assert known.find("secret") is None


def test_that_a_credential_was_used_changes_nothing_of_it(platform: Platform, curator: Person) -> None:
    before = credentials_generation()
    with platform.database.transaction() as session:
        token_id = session.scalars(select(Token.id).where(Token.user_id == curator.user_id)).one()
        tokens.note_use(session, token_id)
        sessions.note_use(session, "none")
    assert credentials_generation() == before


@pytest.mark.parametrize("how", ["statement", "object"])
def test_a_user_who_is_shut_out_is_noticed_when_it_is_committed(platform: Platform, curator: Person, how: str) -> None:
    def shut_out(session: Session) -> None:
        if how == "statement":
            session.execute(update(User).where(User.id == curator.user_id).values(is_active=False))
        else:
            users.change_user(session, session.get_one(User, curator.user_id), None, is_active=False)
        raise_unless_kept()

    def raise_unless_kept() -> None:
        if not is_kept:
            raise LookupError

    for is_kept in (False, True):
        before = credentials_generation()
        with suppress(LookupError), platform.database.transaction() as session:
            shut_out(session)
            assert credentials_generation() == before
        assert (credentials_generation() != before) == is_kept


def test_a_token_revoked_here_is_worth_nothing_at_once(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    for act in ("revoke", "shut out"):
        mine = api_on.post("/api/v1/tokens", json={"name": act}, headers=ada.headers).json()
        headers = {"Authorization": f"Bearer {mine['secret']}"}
        assert api_on.get(ME, headers=headers).status_code == 200
        with platform_on.database.transaction() as session:
            if act == "revoke":
                assert tokens.revoke(session, ada.user_id, mine["id"])
            else:
                session.get_one(User, ada.user_id).is_active = False
        assert api_on.get(ME, headers=headers).status_code == 401


def test_a_session_closed_here_is_worth_nothing_at_once(api: httpx.Client, platform: Platform, curator: Person) -> None:
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, session.get_one(User, curator.user_id), 600.0)
    cookies = {"Cookie": f"stone_session={opened.secret}"}
    assert api.get(ME, headers=cookies).status_code == 200
    with platform.database.transaction() as session:
        sessions.close_others(session, curator.user_id, "")
    assert api.get(ME, headers=cookies).status_code == 401


def test_a_token_that_another_process_revoked_ends_soon(api: httpx.Client, platform: Platform, curator: Person) -> None:
    assert api.get(ME, headers=curator.headers).status_code == 200
    with platform.database.engine.begin() as connection:  # beside the session, as another process is
        connection.execute(text("DELETE FROM tokens"))
    until_s = time.monotonic() + PATIENCE_S
    while api.get(ME, headers=curator.headers).status_code != 401:
        assert time.monotonic() < until_s
