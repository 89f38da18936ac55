"""Who is let in, as whom; refusals first."""

import sqlite3
from contextlib import closing
from pathlib import Path

import httpx
import pytest
from sqlalchemy import update

from services.runtime.orm import Token, User
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
from testing.api.serving import Person, client_of, person
from testing.servers.fixtures import make_settings, opened

ME = "/api/v1/me"


def test_nobody_is_asked_who_they_are(api: httpx.Client) -> None:
    answer = api.get(ME)
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"].startswith("Bearer")


@pytest.mark.parametrize(
    "header",
    [
        "",
        "Bearer",
        "Bearer stone_" + "x" * 43,
        "Bearer x" * 1000,
        "Basic YWRhOnB3",
        "stone_" + "x" * 43,
        "Bearer ' OR 1=1 --",
    ],
)
def test_a_false_credential_is_401(api: httpx.Client, header: str) -> None:
    answer = api.get(ME, headers={"Authorization": header})
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthenticated")


def test_a_false_token_is_not_helped_by_a_good_session(api: httpx.Client) -> None:
    headers = {"Authorization": "Bearer stone_" + "x" * 43, "Cookie": "stone_session=whatever"}
    assert api.get(ME, headers=headers).status_code == 401


def test_an_expired_token_is_401(api: httpx.Client, platform: Platform) -> None:
    late = person(platform, "curator", expires_s=0)
    assert api.get(ME, headers=late.headers).status_code == 401


def test_a_user_shut_out_is_401_at_once(api_on: httpx.Client, platform_on: Platform) -> None:
    caller = person(platform_on, "curator")
    assert api_on.get(ME, headers=caller.headers).status_code == 200
    with platform_on.database.transaction() as session:
        session.execute(update(User).where(User.id == caller.user_id).values(is_active=False))
    assert api_on.get(ME, headers=caller.headers).status_code == 401


def test_a_token_without_the_scope_is_403(api: httpx.Client, platform: Platform) -> None:
    narrow = person(platform, "curator", scopes=["read"])
    answer = api.post("/api/v1/teams", json={"name": "us"}, headers=narrow.headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")
    assert "submit" in answer.json()["detail"]


def test_a_role_too_low_is_403(api: httpx.Client, curator: Person, participant: Person) -> None:
    for caller in (curator, participant):
        assert api.get("/api/v1/users", headers=caller.headers).status_code == 403
        assert api.get("/api/v1/admin/audit-log", headers=caller.headers).status_code == 403


def test_an_administrators_token_for_reading_does_not_administrate(api: httpx.Client, platform: Platform) -> None:
    reader = person(platform, "administrator", scopes=["read"])
    assert api.get("/api/v1/users", headers=reader.headers).status_code == 403
    assert api.get("/metrics", headers=reader.headers).status_code == 403


def test_a_token_loses_what_its_user_loses(api: httpx.Client, platform: Platform, administrator: Person) -> None:
    with platform.database.transaction() as session:
        session.execute(update(User).where(User.id == administrator.user_id).values(role="participant"))
    assert api.get(ME, headers=administrator.headers).json()["scopes"] == ["account", "read", "submit"]
    assert api.get("/api/v1/users", headers=administrator.headers).status_code == 403


def test_a_token_says_who_calls(api_on: httpx.Client, platform_on: Platform) -> None:
    caller = person(platform_on, "curator")
    me = api_on.get(ME, headers=caller.headers).json()
    assert (me["name"], me["role"], me["scopes"]) == (caller.name, "curator", ["account", "read", "submit", "upload"])
    assert (me["is_session"], me["csrf_token"]) == (False, None)


def test_the_last_use_of_a_token_is_noted_once_a_minute(api: httpx.Client, platform: Platform, curator: Person) -> None:
    def used_ns() -> int | None:
        with platform.database.reading() as session:
            return session.query(Token.used_ns).filter(Token.user_id == curator.user_id).scalar()

    assert used_ns() is None
    api.get(ME, headers=curator.headers)
    first = used_ns()
    assert first is not None
    api.get(ME, headers=curator.headers)
    assert used_ns() == first


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
