"""Who is let in, as whom, and what they may hand on."""

import httpx

from tests.api.serving import Person


def test_nobody_is_asked_who_they_are(api: httpx.Client) -> None:
    answer = api.get("/api/v1/me")
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"].startswith("Bearer")


def test_a_token_says_who_calls(api: httpx.Client, curator: Person) -> None:
    me = api.get("/api/v1/me", headers=curator.headers).json()
    assert (me["name"], me["role"], me["scopes"]) == (curator.name, "curator", ["read", "submit", "upload"])
