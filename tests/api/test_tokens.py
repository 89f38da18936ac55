"""A token grants no more than its maker holds, is shown once, and is its owner's alone."""

import httpx
import pytest

from services.runtime.platform import Platform
from testing.api.serving import Person, person

TOKENS = "/api/v1/tokens"


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"name": ""},
        {"name": "x" * 65},
        {"name": "a\u0000b"},
        {"name": "x", "scopes": []},
        {"name": "x", "scopes": ["king"]},
        {"name": "x", "expires_s": 0},
        {"name": "x", "expires_s": 1e12},
        {"name": "x", "role": "administrator"},
        {"name": "x", "scopes": ["read"] * 6},
    ],
)
def test_a_token_that_cannot_be_is_422(api: httpx.Client, curator: Person, body: dict[str, object]) -> None:
    assert api.post(TOKENS, json=body, headers=curator.headers).status_code == 422


def test_nobody_issues_or_reads_tokens(api: httpx.Client) -> None:
    assert api.post(TOKENS, json={"name": "x"}).status_code == 401
    assert api.get(TOKENS).status_code == 401


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


def test_another_owners_token_does_not_exist(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, eve = person(platform_on, "curator"), person(platform_on, "administrator")
    mine = api_on.post(TOKENS, json={"name": "x"}, headers=ada.headers).json()
    answer = api_on.delete(f"{TOKENS}/{mine['id']}", headers=eve.headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    assert mine["id"] not in api_on.get(TOKENS, headers=eve.headers).text
    assert api_on.get("/api/v1/me", headers={"Authorization": f"Bearer {mine['secret']}"}).status_code == 200


@pytest.mark.parametrize("token_id", ["x", "0" * 31, "0" * 33, "G" * 32, "%00" * 32])
def test_what_is_no_id_is_422(api: httpx.Client, curator: Person, token_id: str) -> None:
    assert api.delete(f"{TOKENS}/{token_id}", headers=curator.headers).status_code == 422


def test_a_token_works_until_it_is_revoked_and_its_secret_is_shown_once(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    ada = person(platform_on, "curator")
    answer = api_on.post(TOKENS, json={"name": "laptop", "scopes": ["read"], "expires_s": 60}, headers=ada.headers)
    assert answer.status_code == 201
    assert answer.headers["cache-control"] == "no-store"
    issued = answer.json()
    use = {"Authorization": f"Bearer {issued['secret']}"}
    assert api_on.get("/api/v1/me", headers=use).json()["scopes"] == ["read"]
    listed = api_on.get(TOKENS, headers=ada.headers)
    assert issued["secret"] not in listed.text
    assert [item["name"] for item in listed.json()["items"]] == ["laptop", "test"]
    assert api_on.delete(f"{TOKENS}/{issued['id']}", headers=ada.headers).status_code == 204
    assert api_on.get("/api/v1/me", headers=use).status_code == 401
    assert api_on.delete(f"{TOKENS}/{issued['id']}", headers=ada.headers).status_code == 404


def test_there_is_an_end_to_tokens(api: httpx.Client, curator: Person, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.routes.tokens.MOST_TOKENS", 2)
    assert api.post(TOKENS, json={"name": "x"}, headers=curator.headers).status_code == 201
    answer = api.post(TOKENS, json={"name": "x"}, headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
