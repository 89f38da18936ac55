"""Who is let in, as whom, and what ends a credential at once."""

import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from inspect import unwrap
from pathlib import Path
from types import CodeType
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts
from sqlalchemy import delete, select, text, update
from sqlalchemy.orm import Session

from api.deps import KEPT_S, SAFE, KnownCredentials
from api.main import make_api
from api.middleware.context import COOKIE
from services.runtime.access import issuing, sessions, tokens, users
from services.runtime.access.credential_changes import credentials_generation
from services.runtime.access.ending import end_all, end_browsers
from services.runtime.access.erasure import erase_user
from services.runtime.orm import Token, User, WebSession
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
from testing.api.serving import Person, client_of, person
from testing.servers.fixtures import make_settings, opened

ME = "/api/v1/me"


def test_nobody_is_asked_who_they_are(api: httpx.Client) -> None:
    answer = api.get(ME)
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"].startswith("Bearer")


def test_a_false_credential_is_401(api: httpx.Client) -> None:
    for header in [
        "",
        "Bearer",
        "Bearer stone_" + "x" * 43,
        "Bearer x" * 1000,
        "Basic YWRhOnB3",
        "stone_" + "x" * 43,
        "Bearer ' OR 1=1 --",
    ]:
        answer = api.get(ME, headers={"Authorization": header})
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthenticated")


def test_a_false_token_is_not_helped_by_a_good_session(api: httpx.Client) -> None:
    headers = {"Authorization": "Bearer stone_" + "x" * 43, "Cookie": "stone_session=whatever"}
    assert api.get(ME, headers=headers).status_code == 401


def test_a_token_loses_what_its_user_loses(api: httpx.Client, platform: Platform, administrator: Person) -> None:
    with platform.database.transaction() as session:
        session.execute(update(User).where(User.id == administrator.user_id).values(role="participant"))
    assert api.get(ME, headers=administrator.headers).json()["scopes"] == ["account", "read", "submit"]
    assert api.get("/api/v1/admin/users", headers=administrator.headers).status_code == 403


def test_what_cannot_be_written_to_can_still_be_read(platform: Platform, curator: Person, tmp_path: Path) -> None:
    hurried = opened(make_settings(tmp_path, database=DatabaseSettings(busy_timeout_s=0.05)), [])
    with (
        client_of(hurried, curator) as api,
        closing(sqlite3.connect(platform.settings.root / "stone.sqlite3")) as other,
    ):
        other.isolation_level = None
        other.execute("BEGIN IMMEDIATE")
        assert api.get(ME).status_code == 200
        other.execute("ROLLBACK")


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


def test_a_token_revoked_here_is_worth_nothing_at_once(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    for act in ("revoke", "shut out"):
        mine = api.post("/api/v1/tokens", json={"name": act}, headers=ada.headers).json()
        headers = {"Authorization": f"Bearer {mine['secret']}"}
        assert api.get(ME, headers=headers).status_code == 200
        with platform.database.transaction() as session:
            if act == "revoke":
                assert tokens.revoke(session, ada.user_id, mine["id"])
            else:
                session.get_one(User, ada.user_id).is_active = False
        assert api.get(ME, headers=headers).status_code == 401


def test_a_session_closed_here_is_worth_nothing_at_once(api: httpx.Client, platform: Platform, curator: Person) -> None:
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, session.get_one(User, curator.user_id), 600.0)
    cookies = {"Cookie": f"stone_session={opened.secret}"}
    assert api.get(ME, headers=cookies).status_code == 200
    with platform.database.transaction() as session:
        end_browsers(session, curator.user_id)
    assert api.get(ME, headers=cookies).status_code == 401


def test_a_token_that_another_process_revoked_ends_soon(api: httpx.Client, platform: Platform, curator: Person) -> None:
    assert api.get(ME, headers=curator.headers).status_code == 200
    with platform.database.engine.begin() as connection:  # beside the session, as another process is
        connection.execute(text("DELETE FROM tokens"))
    until_s = time.monotonic() + PATIENCE_S
    while api.get(ME, headers=curator.headers).status_code != 401:
        assert time.monotonic() < until_s


TOKENS = "/api/v1/tokens"


def test_a_token_grants_no_scope_its_maker_does_not_hold(api: httpx.Client, platform: Platform) -> None:
    narrow = person(platform, "administrator", scopes=["read", "submit", "account"])
    for scope in ("upload", "admin"):
        answer = api.post(TOKENS, json={"name": "x", "scopes": ["read", scope]}, headers=narrow.headers)
        assert answer.status_code == 403
        assert scope in answer.json()["detail"]
    held = api.post(TOKENS, json={"name": "x"}, headers=narrow.headers).json()["scopes"]
    assert held == ["read", "submit"]


def test_a_token_does_not_outlive_the_token_that_made_it(api: httpx.Client, platform: Platform) -> None:
    short = person(platform, "curator", expires_s=600)
    assert api.post(TOKENS, json={"name": "x", "expires_s": 900}, headers=short.headers).status_code == 403
    issued = api.post(TOKENS, json={"name": "x"}, headers=short.headers).json()
    own = api.get("/api/v1/me", headers=short.headers).json()
    assert issued["expires_at"] <= own["expires_at"]


def test_a_token_works_until_it_is_revoked_and_its_secret_is_shown_once(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    answer = api.post(TOKENS, json={"name": "laptop", "scopes": ["read"], "expires_s": 60}, headers=ada.headers)
    assert answer.status_code == 201
    assert answer.headers["cache-control"] == "no-store"
    issued = answer.json()
    use = {"Authorization": f"Bearer {issued['secret']}"}
    assert api.get("/api/v1/me", headers=use).json()["scopes"] == ["read"]
    listed = api.get(TOKENS, headers=ada.headers)
    assert issued["secret"] not in listed.text
    assert [item["name"] for item in listed.json()["items"]] == ["laptop", "test"]
    assert api.delete(f"{TOKENS}/{issued['id']}", headers=ada.headers).status_code == 204
    assert api.get("/api/v1/me", headers=use).status_code == 401
    assert api.delete(f"{TOKENS}/{issued['id']}", headers=ada.headers).status_code == 404


def test_there_is_an_end_to_tokens(api: httpx.Client, curator: Person, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.runtime.access.issuing.MOST_TOKENS", 2)
    assert api.post(TOKENS, json={"name": "x"}, headers=curator.headers).status_code == 201
    answer = api.post(TOKENS, json={"name": "x"}, headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")


CREDENTIALS = (issuing, sessions, tokens, users, end_all, end_browsers, erase_user, Token, WebSession)
"""Whatever names one of these in what it runs may change a credential."""
OF_THE_CALLER_ALONE = {"POST /api/v1/sessions", "DELETE /api/v1/sessions/current", "DELETE /api/v1/tokens/current"}
"""The first asks for the password; the others end what asks, and nothing else."""


def issued(api: httpx.Client, headers: dict[str, str], **body: object) -> dict[str, Any]:
    answer = api.post(TOKENS, json={"name": "x", **body}, headers=headers)
    assert answer.status_code == 201, answer.text
    made: dict[str, Any] = answer.json()
    return made


def bearing(token: dict[str, Any]) -> dict[str, str]:
    return {"Authorization": f"Bearer {token['secret']}"}


def is_known(api: httpx.Client, headers: dict[str, str]) -> bool:
    return api.get("/api/v1/me", headers=headers).status_code == 200


def test_what_a_token_made_ends_with_it_and_so_does_what_that_made(api: httpx.Client, platform: Platform) -> None:
    owner = person(platform, "curator")
    parent = issued(api, owner.headers, scopes=["read", "account"])
    child = issued(api, bearing(parent), scopes=["read", "account"])
    grandchild = issued(api, bearing(child), scopes=["read"])
    beside = issued(api, owner.headers, scopes=["read"])
    assert api.delete(f"{TOKENS}/{parent['id']}", headers=owner.headers).status_code == 204
    ended = [is_known(api, bearing(token)) for token in (parent, child, grandchild)]
    assert ended == [False, False, False]
    assert is_known(api, bearing(beside))


def test_no_token_is_spared_by_the_one_it_made(api: httpx.Client, platform: Platform) -> None:
    """An administrator revokes all of their own with a token that one of these made: it goes too, and is counted."""
    owner = person(platform, "administrator")
    child = issued(api, owner.headers, scopes=["read", "admin"])
    path = f"/api/v1/admin/users/{owner.user_id}/credentials/revoke"
    answer = api.post(path, json={"reason": "stolen"}, headers=bearing(child))
    assert (answer.status_code, answer.json()["tokens"]) == (200, 2)
    assert not is_known(api, bearing(child))


def test_a_token_may_always_end_itself(api: httpx.Client, platform: Platform) -> None:
    for scopes in [["read"], ["submit"], ["account"]]:
        owner = person(platform, "curator")
        own, other = issued(api, owner.headers, scopes=scopes), issued(api, owner.headers, scopes=scopes)
        assert api.delete(f"{TOKENS}/current", headers=bearing(own)).status_code == 204
        assert not is_known(api, bearing(own))
        assert api.delete(f"{TOKENS}/current", headers=bearing(other)).status_code == 204


def test_a_browser_has_no_token_of_its_own_to_end(api: httpx.Client, platform: Platform) -> None:
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, users.create_user(session, "ada", "curator"), 3600.0)
    shown = {"Cookie": f"{COOKIE}={opened.secret}", "X-CSRF-Token": opened.csrf_token}
    answer = api.delete(f"{TOKENS}/current", headers=shown)
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")


def test_a_token_that_is_made_may_not_make_others_unless_asked_for(api: httpx.Client, curator: Person) -> None:
    assert issued(api, curator.headers)["scopes"] == ["read", "submit", "upload"]


def test_a_token_whose_only_scope_is_to_make_others_says_what_for(api: httpx.Client, platform: Platform) -> None:
    only = person(platform, "curator", scopes=["account"])
    answer = api.post(TOKENS, json={"name": "x"}, headers=only.headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")


def test_every_route_that_changes_credentials_asks_for_the_scope_to(platform: Platform) -> None:
    """Catches alone a new route by which a token for reading would end or make credentials."""
    found = changing_credentials(make_api(platform))
    assert {"POST /api/v1/tokens", "DELETE /api/v1/sessions/others", "PUT /api/v1/me/password"} <= set(found)
    open_ones = {name: asked for name, asked in found.items() if not asked & {"account", "admin"}}
    assert set(open_ones) == OF_THE_CALLER_ALONE


def changing_credentials(application: FastAPI) -> dict[str, set[str]]:
    """The unsafe routes whose code reaches one of `CREDENTIALS`, with the scopes that they ask for."""
    found = {}
    for route in iter_route_contexts(application.routes):
        if not route.endpoint or not route.path or not reaches(unwrap(route.endpoint)):
            continue
        for method in sorted((route.methods or set()) - {*SAFE}):
            found[f"{method} {route.path}"] = scopes_asked(route)
    return found


def reaches(endpoint: Callable[..., Any]) -> bool:
    """Whether the function, or one of its module that it calls, names one of `CREDENTIALS`."""
    seen: set[str] = set()
    waiting = [endpoint]
    while waiting:
        function = waiting.pop()
        for name in names_in(function.__code__):
            value = function.__globals__.get(name)
            if any(value is one for one in CREDENTIALS):
                return True
            is_near = callable(value) and getattr(value, "__module__", "") == endpoint.__module__
            if is_near and hasattr(value, "__code__") and name not in seen:
                seen.add(name)
                waiting.append(value)
    return False


def names_in(code: CodeType) -> set[str]:
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return {*code.co_names}.union(*(names_in(one) for one in inner))


def scopes_asked(route: Any) -> set[str]:
    def all_below(dependant: Any) -> Iterator[Any]:
        yield dependant
        for one in dependant.dependencies:
            yield from all_below(one)

    asked = (one.own_oauth_scopes or () for one in all_below(route.dependant))
    return {scope for scopes in asked for scope in scopes}
