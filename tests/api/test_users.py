"""Users are made and changed by administrators, each time with a reason."""

import httpx
import pytest

from api.middleware.context import COOKIE
from services.runtime.access import sessions, tokens
from services.runtime.orm import User
from services.runtime.platform import Platform
from testing.api.serving import Person, person

USERS = "/api/v1/users"
ADA = {"name": "ada", "role": "curator", "reason": "joins the field team"}


@pytest.mark.parametrize(
    "change",
    [
        {"reason": ""},
        {"reason": "  "},
        {"reason": None},
        {"name": "Ada"},
        {"name": "a b"},
        {"name": "ada\n"},
        {"role": "king"},
        {"password": "short"},
        {"is_admin": True},
    ],
)
def test_a_user_that_cannot_be_is_422(api: httpx.Client, administrator: Person, change: dict[str, object]) -> None:
    assert api.post(USERS, json={**ADA, **change}, headers=administrator.headers).status_code == 422


def test_two_users_cannot_share_a_name(api_on: httpx.Client, platform_on: Platform) -> None:
    administrator = person(platform_on, "administrator")
    assert api_on.post(USERS, json=ADA, headers=administrator.headers).status_code == 201
    again = api_on.post(USERS, json=ADA, headers=administrator.headers)
    assert (again.status_code, again.json()["code"]) == (409, "name_taken")


def test_a_user_who_does_not_exist_is_404(api: httpx.Client, administrator: Person) -> None:
    answer = api.patch(f"{USERS}/{'0' * 32}", json={"reason": "why not"}, headers=administrator.headers)
    assert answer.status_code == 404


def test_the_last_administrator_cannot_leave(api_on: httpx.Client, platform_on: Platform) -> None:
    last = person(platform_on, "administrator")
    for change in ({"role": "curator"}, {"is_active": False}):
        body = {**change, "reason": "tired"}
        answer = api_on.patch(f"{USERS}/{last.user_id}", json=body, headers=last.headers)
        assert (answer.status_code, answer.json()["code"]) == (409, "last_administrator")


def test_a_user_is_added_changed_and_shut_out_with_reasons_in_the_log(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    root = person(platform_on, "administrator")
    added = api_on.post(USERS, json={**ADA, "password": "correct horse battery"}, headers=root.headers)
    assert added.status_code == 201
    user = added.json()
    assert (user["role"], user["is_active"], user["has_password"]) == ("curator", True, True)
    assert "argon2" not in added.text
    signed_in = api_on.post("/api/v1/sessions", json={"name": "ada", "password": "correct horse battery"})
    assert signed_in.status_code == 201
    body = {"role": "participant", "is_active": False, "reason": "left the team"}
    changed = api_on.patch(f"{USERS}/{user['id']}", json=body, headers=root.headers).json()
    assert (changed["role"], changed["is_active"]) == ("participant", False)
    assert api_on.get("/api/v1/me").status_code == 401, "the browser is out at once"
    api_on.cookies.clear()
    listed = api_on.get(USERS, headers=root.headers).json()["items"]
    assert [item["name"] for item in listed] == ["ada", root.name]
    log = api_on.get("/api/v1/admin/audit-log", params={"subject_id": user["id"]}, headers=root.headers).json()
    assert [(line["act"], line["reason"]) for line in log["items"]] == [
        ("user.change", "left the team"),
        ("session.open", ""),
        ("user.add", "joins the field team"),
    ]
    assert log["items"][0]["facts"] == {"role": "participant", "is_active": False}
    assert "correct horse" not in str(log)


def test_users_are_found_by_a_part_of_their_name_and_by_role(api: httpx.Client, administrator: Person) -> None:
    for name, role in (("ada", "curator"), ("adam", "participant"), ("a_b", "curator")):
        api.post(USERS, json={**ADA, "name": name, "role": role}, headers=administrator.headers)

    def found(**wanted: str) -> list[str]:
        answer = api.get(USERS, params=wanted, headers=administrator.headers)
        assert answer.status_code == 200, answer.text
        return [item["name"] for item in answer.json()["items"]]

    assert found(name="DA", role="curator") == ["ada"]
    assert found(name="ada") == ["adam", "ada"]
    assert found(name="_") == ["a_b"], "no wildcard"
    assert api.get(USERS, params={"role": "king"}, headers=administrator.headers).status_code == 422


def test_a_users_token_is_revoked_with_a_reason(api_on: httpx.Client, platform_on: Platform) -> None:
    root, ada = person(platform_on, "administrator"), person(platform_on, "curator")
    url = f"{USERS}/{ada.user_id}/tokens"
    (token,) = api_on.get(url, headers=root.headers).json()["items"]
    assert "secret" not in token
    revoke = f"{url}/{token['id']}/revoke"
    assert api_on.post(revoke, json={"reason": " "}, headers=root.headers).status_code == 422
    assert api_on.get("/api/v1/me", headers=ada.headers).status_code == 200
    assert api_on.post(revoke, json={"reason": "it was lost"}, headers=root.headers).status_code == 204
    assert api_on.get("/api/v1/me", headers=ada.headers).status_code == 401
    assert api_on.post(revoke, json={"reason": "again"}, headers=root.headers).status_code == 404
    log = api_on.get("/api/v1/admin/audit-log", params={"actor": root.name}, headers=root.headers).json()
    (line,) = log["items"]
    assert (line["act"], line["subject_id"], line["reason"]) == ("user.token_revoke", ada.user_id, "it was lost")
    assert line["facts"] == {"token_id": token["id"], "name": "test"}


def test_a_token_is_revoked_of_its_own_user_only(api: httpx.Client, platform: Platform, administrator: Person) -> None:
    ada, ben = person(platform, "curator"), person(platform, "curator")
    (token,) = api.get(f"{USERS}/{ada.user_id}/tokens", headers=administrator.headers).json()["items"]
    other = f"{USERS}/{ben.user_id}/tokens/{token['id']}/revoke"
    assert api.post(other, json={"reason": "wrong one"}, headers=administrator.headers).status_code == 404
    assert api.get(f"{USERS}/{'0' * 32}/tokens", headers=administrator.headers).status_code == 404


def test_all_of_a_users_credentials_end_at_once_and_the_one_that_asks_stays(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    root, ada = person(platform_on, "administrator"), person(platform_on, "curator", "ada")
    with platform_on.database.transaction() as session:
        signed_in = sessions.open_session(session, session.get_one(User, ada.user_id), 3600.0)
        tokens.issue(session, session.get_one(User, root.user_id), "another", ["read"], 3600.0)
    browser = {"Cookie": f"{COOKIE}={signed_in.secret}"}
    assert api_on.get("/api/v1/me", headers=browser).status_code == 200
    answer = api_on.post(
        f"{USERS}/{ada.user_id}/credentials/revoke", json={"reason": "a laptop was stolen"}, headers=root.headers
    )
    assert (answer.status_code, answer.json()) == (200, {"tokens": 1, "browsers": 1})
    for headers in (ada.headers, browser):
        assert api_on.get("/api/v1/me", headers=headers).status_code == 401
    own = api_on.post(f"{USERS}/{root.user_id}/credentials/revoke", json={"reason": "too"}, headers=root.headers)
    assert own.json() == {"tokens": 1, "browsers": 0}
    assert api_on.get("/api/v1/me", headers=root.headers).status_code == 200
    log = api_on.get("/api/v1/admin/audit-log", params={"subject_id": ada.user_id}, headers=root.headers).json()
    assert (log["items"][0]["act"], log["items"][0]["reason"]) == ("user.credentials_revoke", "a laptop was stolen")
    nobody = api_on.post(f"{USERS}/{'0' * 32}/credentials/revoke", json={"reason": "x"}, headers=root.headers)
    assert nobody.status_code == 404
