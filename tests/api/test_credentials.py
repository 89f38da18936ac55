"""What changes credentials asks for a session or the scope `account`; what a token made ends with it."""

from collections.abc import Callable, Iterator
from inspect import unwrap
from types import CodeType
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts

from api.deps import SAFE, PlatformDep
from api.main import make_api
from api.middleware.context import COOKIE
from services.runtime.access import sessions, tokens, users
from services.runtime.access.erasure import erase_user
from services.runtime.access.roles import SCOPES_OF
from services.runtime.orm import Token, WebSession
from services.runtime.platform import Platform
from testing.api.serving import Person, person

TOKENS = "/api/v1/tokens"
CREDENTIALS = (sessions, tokens, users, erase_user, Token, WebSession)
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


def test_a_token_for_reading_ends_no_stronger_one_no_browser_and_makes_none(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    owner = person(platform_on, "administrator")
    strong = issued(api_on, owner.headers, scopes=["read", "admin"])
    weak = bearing(issued(api_on, owner.headers, scopes=["read"]))
    body = {"current": "a" * 12, "new": "another horse, another battery"}
    answers = {
        "revoke": api_on.delete(f"{TOKENS}/{strong['id']}", headers=weak),
        "issue": api_on.post(TOKENS, json={"name": "x", "scopes": ["read"]}, headers=weak),
        "browsers": api_on.delete("/api/v1/sessions/others", headers=weak),
        "password": api_on.put("/api/v1/me/password", json=body, headers=weak),
    }
    assert {name: answer.status_code for name, answer in answers.items()} == dict.fromkeys(answers, 403)
    assert "'account'" in answers["revoke"].json()["detail"]
    assert is_known(api_on, bearing(strong))


def test_what_a_token_made_ends_with_it_and_so_does_what_that_made(api_on: httpx.Client, platform_on: Platform) -> None:
    owner = person(platform_on, "curator")
    parent = issued(api_on, owner.headers, scopes=["read", "account"])
    child = issued(api_on, bearing(parent), scopes=["read", "account"])
    grandchild = issued(api_on, bearing(child), scopes=["read"])
    beside = issued(api_on, owner.headers, scopes=["read"])
    assert api_on.delete(f"{TOKENS}/{parent['id']}", headers=owner.headers).status_code == 204
    ended = [is_known(api_on, bearing(token)) for token in (parent, child, grandchild)]
    assert ended == [False, False, False]
    assert is_known(api_on, bearing(beside))


def test_no_token_is_spared_by_the_one_it_made(api_on: httpx.Client, platform_on: Platform) -> None:
    """An administrator revokes all of their own with a token that one of these made: it goes too, and is counted."""
    owner = person(platform_on, "administrator")
    child = issued(api_on, owner.headers, scopes=["read", "admin"])
    path = f"/api/v1/users/{owner.user_id}/credentials/revoke"
    answer = api_on.post(path, json={"reason": "stolen"}, headers=bearing(child))
    assert (answer.status_code, answer.json()["tokens"]) == (200, 2)
    assert not is_known(api_on, bearing(child))


@pytest.mark.parametrize("scopes", [["read"], ["submit"], ["account"]])
def test_a_token_may_always_end_itself(api_on: httpx.Client, platform_on: Platform, scopes: list[str]) -> None:
    owner = person(platform_on, "curator")
    own, other = issued(api_on, owner.headers, scopes=scopes), issued(api_on, owner.headers, scopes=scopes)
    assert api_on.delete(f"{TOKENS}/current", headers=bearing(own)).status_code == 204
    assert not is_known(api_on, bearing(own))
    assert api_on.delete(f"{TOKENS}/current", headers=bearing(other)).status_code == 204


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


def test_a_route_that_would_is_found(platform: Platform) -> None:
    application = make_api(platform)

    def ends_all(platform: PlatformDep) -> None:
        with platform.database.transaction() as session:
            tokens.revoke_others(session, "u", "")

    application.router.routes.append(APIRoute("/api/v1/planted", ends_all, methods=["POST"], response_model=None))
    assert changing_credentials(application)["POST /api/v1/planted"] == set()


def test_all_roles_may_have_the_scope() -> None:
    assert all("account" in held for held in SCOPES_OF.values())


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
