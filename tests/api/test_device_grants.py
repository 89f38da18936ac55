"""Programs that sign in with a browser's help: a code is approved by a person, once, within ten minutes."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select, update

from services.runtime.access import device_grants, tokens, users
from services.runtime.access.retention import forget_ended
from services.runtime.orm import AuditEntry, DeviceGrant, Token, User
from services.runtime.platform import Platform
from testing.api.lab import served_lab
from testing.api.serving import Person, client_of, person

GRANTS = "/api/v1/device-grants"
ASKED = {"name": "stone on laptop", "scopes": ["read", "submit", "upload", "admin"]}


@pytest.fixture
def api(platform: Platform) -> Iterator[httpx.Client]:
    """The API, at which nobody is counted."""
    with (
        served_lab(platform, platform.settings.oidc) as lab,
        httpx.Client(base_url=lab.url, timeout=300.0, verify=False, trust_env=False) as client,
    ):
        yield client


@pytest.fixture
def ada(platform: Platform) -> Person:
    return person(platform, "curator", "ada")


def begun(api: httpx.Client, **changed: Any) -> dict[str, Any]:
    answer = api.post(GRANTS, json=ASKED | changed)
    assert answer.status_code == 201, answer.text
    codes: dict[str, Any] = answer.json()
    return codes


def decided(api: httpx.Client, who: Person, code: str, approves: bool = True) -> httpx.Response:
    return api.post(f"{GRANTS}/decision", json={"user_code": code, "approves": approves}, headers=who.headers)


def taken(api: httpx.Client, device_code: str) -> httpx.Response:
    return api.post(f"{GRANTS}/token", json={"device_code": device_code})


def rested(platform: Platform) -> None:
    """As if every program had waited as long as it was told to."""
    with platform.database.transaction() as session:
        session.execute(update(DeviceGrant).values(polled_ns=0))


def test_a_program_gets_the_token_that_somebody_approved_once(
    api: httpx.Client, platform: Platform, ada: Person
) -> None:
    codes = begun(api)
    assert codes["url_with_code"] == f"{codes['url']}?code={codes['user_code']}"
    pending = taken(api, codes["device_code"])
    assert (pending.status_code, pending.json()["code"]) == (400, "authorization_pending")
    assert decided(api, ada, codes["user_code"].lower().replace("-", " ")).status_code == 204
    token = taken(api, codes["device_code"])
    assert token.status_code == 201
    assert token.headers["cache-control"] == "no-store"
    assert (token.json()["name"], token.json()["scopes"]) == ("stone on laptop", ["read", "submit", "upload"])
    me = api.get("/api/v1/me", headers={"Authorization": f"Bearer {token.json()['secret']}"}).json()
    assert (me["name"], me["is_session"]) == ("ada", False)
    again = taken(api, codes["device_code"])
    assert (again.status_code, again.json()["code"]) == (400, "expired_token")
    with platform.database.reading() as session:
        acts = [one.act for one in session.scalars(select(AuditEntry).order_by(AuditEntry.number))]
        assert acts == ["device.approve", "token.issue"]
        assert session.scalar(select(func.count()).select_from(DeviceGrant)) == 0


def test_a_token_has_no_more_than_its_approver_holds(api: httpx.Client, platform: Platform) -> None:
    codes, participant = begun(api), person(platform, "participant")
    decided(api, participant, codes["user_code"])
    assert taken(api, codes["device_code"]).json()["scopes"] == ["read", "submit"]


def test_a_token_that_may_not_issue_tokens_may_not_approve(api: httpx.Client, platform: Platform) -> None:
    codes, narrow = begun(api), person(platform, "curator", scopes={"read", "upload", "submit"})
    answer = decided(api, narrow, codes["user_code"])
    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")


def test_the_scope_account_is_not_to_be_asked_for(api: httpx.Client) -> None:
    assert api.post(GRANTS, json=ASKED | {"scopes": ["read", "account"]}).status_code == 422


def test_who_asks_too_often_is_told_to_ask_less_often(api: httpx.Client, platform: Platform) -> None:
    codes = begun(api)
    assert taken(api, codes["device_code"]).json()["code"] == "authorization_pending"
    early = taken(api, codes["device_code"])
    assert (early.status_code, early.json()["code"], early.headers["retry-after"]) == (429, "slow_down", "5")
    rested(platform)
    assert taken(api, codes["device_code"]).json()["code"] == "authorization_pending"


def test_a_program_that_was_denied_gets_nothing_ever(api: httpx.Client, platform: Platform, ada: Person) -> None:
    codes = begun(api)
    assert decided(api, ada, codes["user_code"], approves=False).status_code == 204
    denied = taken(api, codes["device_code"])
    assert (denied.status_code, denied.json()["code"]) == (403, "access_denied")
    assert decided(api, ada, codes["user_code"]).status_code == 404
    assert taken(api, codes["device_code"]).json()["code"] == "expired_token"


def test_a_code_is_decided_upon_once(api: httpx.Client, platform: Platform, ada: Person) -> None:
    codes, eve = begun(api), person(platform, "administrator", "eve")
    assert decided(api, ada, codes["user_code"]).status_code == 204
    assert decided(api, eve, codes["user_code"]).status_code == 404
    token = taken(api, codes["device_code"]).json()
    me = api.get("/api/v1/me", headers={"Authorization": f"Bearer {token['secret']}"}).json()
    assert me["name"] == "ada"


def test_codes_expire(api: httpx.Client, platform: Platform, ada: Person) -> None:
    approved, waiting = begun(api), begun(api)
    decided(api, ada, approved["user_code"])
    with platform.database.transaction() as session:
        session.execute(update(DeviceGrant).values(expires_ns=1))
    assert taken(api, approved["device_code"]).json()["code"] == "expired_token"
    assert decided(api, ada, waiting["user_code"]).status_code == 404
    assert forget_ended(platform) == 2


def test_who_was_shut_out_after_they_approved_gives_no_token(
    api: httpx.Client, platform: Platform, ada: Person
) -> None:
    codes = begun(api)
    decided(api, ada, codes["user_code"])
    with platform.database.transaction() as session:
        users.change_user(session, session.get_one(User, ada.user_id), None, is_active=False)
    assert taken(api, codes["device_code"]).json()["code"] == "access_denied"


def test_a_role_that_was_lost_after_the_approval_is_not_in_the_token(api: httpx.Client, platform: Platform) -> None:
    boss, codes = person(platform, "administrator", "boss"), begun(api)
    person(platform, "administrator", "other")
    decided(api, boss, codes["user_code"])
    with platform.database.transaction() as session:
        users.change_user(session, session.get_one(User, boss.user_id), "participant", None)
    assert taken(api, codes["device_code"]).json()["scopes"] == ["read", "submit"]


@pytest.mark.parametrize("code", ["x", "x" * 43, "BCDF-GHJK", "stone_" + "x" * 43])
def test_a_device_code_that_nobody_was_given_is_refused(api: httpx.Client, code: str) -> None:
    begun(api)
    answer = taken(api, code)
    assert (answer.status_code, answer.json()["code"]) == (400, "expired_token")


def test_no_code_is_kept_as_it_is(api: httpx.Client, platform: Platform) -> None:
    codes = begun(api)
    with platform.database.reading() as session:
        row = session.scalars(select(DeviceGrant)).one()
        kept = " ".join(str(value) for value in vars(row).values())
    assert codes["device_code"] not in kept
    assert codes["user_code"].replace("-", "") not in kept


def test_codes_that_are_guessed_are_counted(platform: Platform, ada: Person) -> None:
    with client_of(platform) as api:
        statuses = [decided(api, ada, "BBBB-BBBB").status_code for _ in range(31)]
        begun_ones = [api.post(GRANTS, json=ASKED).status_code for _ in range(31)]
    assert statuses == [404] * 30 + [429]
    assert begun_ones == [201] * 30 + [429]


def test_programs_that_wait_are_bounded(api: httpx.Client, platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_grants, "MOST_WAITING", 1)
    begun(api)
    answer = api.post(GRANTS, json=ASKED)
    assert (answer.status_code, answer.json()["code"]) == (503, "busy")


def test_who_has_too_many_tokens_approves_no_more(
    api: httpx.Client, platform: Platform, ada: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.routes.sign_in_ways.device_grants.MOST_TOKENS", 1)
    assert decided(api, ada, begun(api)["user_code"]).status_code == 409


def test_two_takers_at_once_get_one_token(platform_on: Platform) -> None:
    def take(_: int) -> str:
        with platform_on.database.transaction() as session:
            return device_grants.poll(session, codes.device_code, 60.0).state

    with platform_on.database.transaction() as session:
        ada = users.create_user(session, "ada", "curator")
        codes = device_grants.begin_grant(session, device_grants.DeviceRequest("x", "here", ("read",)))
        grant = device_grants.find_waiting(session, codes.user_code, is_locked=True)
        assert grant is not None
        grant.user_id = ada.id
    with ThreadPoolExecutor(4) as pool:
        states = list(pool.map(take, range(4)))
    assert sorted(states) == ["approved", "unknown", "unknown", "unknown"]
    with platform_on.database.reading() as session:
        assert tokens.token_count(session, ada.id) == 1
        assert session.scalars(select(Token)).one().name == "x"
