"""People: teams and invitations over the wire; users made and changed by administrators, each time with a reason."""

from typing import Any

import httpx
import pytest
from sqlalchemy import select

from api.middleware.context import COOKIE
from services.runtime.access import sessions, tokens
from services.runtime.orm import AuditEntry, TeamInvitation, User
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from tests.services.domain.benchmarks import laid

TEAMS = "/api/v1/teams"


@pytest.fixture
def ada(platform: Platform) -> Person:
    return person(platform, "participant")


@pytest.fixture
def eve(platform: Platform) -> Person:
    return person(platform, "participant")


@pytest.fixture
def gang(api: httpx.Client, ada: Person) -> str:
    """The path of a team that ada leads."""
    return f"{TEAMS}/{api.post(TEAMS, json={'name': 'Gang'}, headers=ada.headers).json()['id']}"


def invite(api: httpx.Client, caller: Person, team: str, **said: Any) -> httpx.Response:
    return api.post(f"{team}/invitations", json=said, headers=caller.headers)


def join(api: httpx.Client, caller: Person, secret: str) -> httpx.Response:
    return api.post(f"{TEAMS}/memberships", json={"secret": secret}, headers=caller.headers)


def joined(api: httpx.Client, captain: Person, team: str, caller: Person) -> dict[str, Any]:
    answer = join(api, caller, invite(api, captain, team).json()["secret"])
    assert answer.status_code == 201, answer.text
    shown: dict[str, Any] = answer.json()
    return shown


def problem(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def test_a_secret_is_shown_once_and_lets_one_in(api: httpx.Client, ada: Person, eve: Person, gang: str) -> None:
    issued = invite(api, ada, gang, expires_s=3600)
    assert (issued.status_code, issued.headers["cache-control"]) == (201, "no-store")
    secret = issued.json()["secret"]
    listed = api.get(f"{gang}/invitations", headers=ada.headers)
    assert [item["id"] for item in listed.json()["items"]] == [issued.json()["id"]]
    assert secret not in listed.text
    shown = join(api, eve, secret)
    assert (shown.json()["captain"], shown.json()["members"]) == (ada.name, sorted([ada.name, eve.name]))
    assert api.get(f"{gang}/invitations", headers=eve.headers).json()["items"] == []
    assert problem(join(api, eve, secret)) == (404, "no_invitation")


def test_no_secret_is_in_the_database_or_the_audit_log(
    api: httpx.Client, platform: Platform, ada: Person, eve: Person, gang: str
) -> None:
    secret = invite(api, ada, gang).json()["secret"]
    join(api, eve, secret)
    acts = laid.rows(platform, select(AuditEntry))
    assert [row.act for row in acts] == ["team.found", "team.invite", "team.join"]
    assert secret.removeprefix("invite_") not in str([vars(row) for row in acts])
    assert secret.removeprefix("invite_") not in str([vars(row) for row in laid.rows(platform, select(TeamInvitation))])


def test_an_invitation_is_withdrawn_once(api: httpx.Client, ada: Person, eve: Person, gang: str) -> None:
    issued = invite(api, ada, gang).json()
    joined(api, ada, gang, eve)
    path = f"{gang}/invitations/{issued['id']}"
    assert problem(api.delete(path, headers=eve.headers)) == (403, "not_captain")
    assert api.delete(path, headers=ada.headers).status_code == 204
    assert problem(api.delete(path, headers=ada.headers)) == (404, "not_found")
    assert problem(join(api, eve, issued["secret"])) == (404, "no_invitation")


def test_an_administrator_steers_a_team_and_says_why(
    api: httpx.Client, platform: Platform, administrator: Person, ada: Person, eve: Person, gang: str
) -> None:
    joined(api, ada, gang, eve)
    body = {"member": eve.name}
    assert problem(api.put(f"{gang}/captain", json=body, headers=administrator.headers)) == (422, "reason_missing")
    body["reason"] = "the captain is gone"
    assert api.put(f"{gang}/captain", json=body, headers=administrator.headers).json()["captain"] == eve.name
    path = f"{gang}/members/{ada.name}"
    assert problem(api.delete(path, headers=administrator.headers)) == (422, "reason_missing")
    assert api.delete(f"{path}?reason=gone", headers=administrator.headers).status_code == 204
    acts = [row for row in laid.rows(platform, select(AuditEntry)) if row.actor_id == administrator.user_id]
    assert [(row.act, row.reason) for row in acts] == [
        ("team.hand_over", "the captain is gone"),
        ("team.remove", "gone"),
    ]


USERS = "/api/v1/admin/users"
ADDED = {"name": "ada", "role": "curator", "reason": "joins the field team"}


def test_a_user_is_added_changed_and_shut_out_with_reasons_in_the_log(api: httpx.Client, platform: Platform) -> None:
    root = person(platform, "administrator")
    added = api.post(USERS, json={**ADDED, "password": "correct horse battery"}, headers=root.headers)
    assert added.status_code == 201
    user = added.json()
    assert (user["role"], user["is_active"], user["has_password"]) == ("curator", True, True)
    assert "argon2" not in added.text
    signed_in = api.post("/api/v1/sessions", json={"name": "ada", "password": "correct horse battery"})
    assert signed_in.status_code == 201
    body = {"role": "participant", "is_active": False, "reason": "left the team"}
    changed = api.patch(f"{USERS}/{user['id']}", json=body, headers=root.headers).json()
    assert (changed["role"], changed["is_active"]) == ("participant", False)
    assert api.get("/api/v1/me").status_code == 401, "the browser is out at once"
    api.cookies.clear()
    listed = api.get(USERS, headers=root.headers).json()["items"]
    assert [item["name"] for item in listed] == ["ada", root.name]
    log = api.get("/api/v1/admin/audit-log", params={"subject_id": user["id"]}, headers=root.headers).json()
    assert [(line["act"], line["reason"]) for line in log["items"]] == [
        ("user.change", "left the team"),
        ("session.open", ""),
        ("user.add", "joins the field team"),
    ]
    assert log["items"][0]["facts"] == {"role": "participant", "is_active": False}
    assert "correct horse" not in str(log)


def test_users_are_found_by_a_part_of_their_name_and_by_role(api: httpx.Client, administrator: Person) -> None:
    for name, role in (("ada", "curator"), ("adam", "participant"), ("a_b", "curator")):
        api.post(USERS, json={**ADDED, "name": name, "role": role}, headers=administrator.headers)

    def found(**wanted: str) -> list[str]:
        answer = api.get(USERS, params=wanted, headers=administrator.headers)
        assert answer.status_code == 200, answer.text
        return [item["name"] for item in answer.json()["items"]]

    assert found(name="DA", role="curator") == ["ada"]
    assert found(name="ada") == ["adam", "ada"]
    assert found(name="_") == ["a_b"], "no wildcard"
    assert api.get(USERS, params={"role": "king"}, headers=administrator.headers).status_code == 422


def test_a_users_token_is_revoked_with_a_reason(api: httpx.Client, platform: Platform) -> None:
    root, ada = person(platform, "administrator"), person(platform, "curator")
    url = f"{USERS}/{ada.user_id}/tokens"
    (token,) = api.get(url, headers=root.headers).json()["items"]
    assert "secret" not in token
    revoke = f"{url}/{token['id']}/revoke"
    assert api.post(revoke, json={"reason": " "}, headers=root.headers).status_code == 422
    assert api.get("/api/v1/me", headers=ada.headers).status_code == 200
    assert api.post(revoke, json={"reason": "it was lost"}, headers=root.headers).status_code == 204
    assert api.get("/api/v1/me", headers=ada.headers).status_code == 401
    assert api.post(revoke, json={"reason": "again"}, headers=root.headers).status_code == 404
    log = api.get("/api/v1/admin/audit-log", params={"actor": root.name}, headers=root.headers).json()
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
    api: httpx.Client, platform: Platform
) -> None:
    root, ada = person(platform, "administrator"), person(platform, "curator", "ada")
    with platform.database.transaction() as session:
        signed_in = sessions.open_session(session, session.get_one(User, ada.user_id), 3600.0)
        tokens.issue(session, session.get_one(User, root.user_id), "another", ["read"], 3600.0)
    browser = {"Cookie": f"{COOKIE}={signed_in.secret}"}
    assert api.get("/api/v1/me", headers=browser).status_code == 200
    answer = api.post(
        f"{USERS}/{ada.user_id}/credentials/revoke", json={"reason": "a laptop was stolen"}, headers=root.headers
    )
    assert (answer.status_code, answer.json()) == (200, {"tokens": 1, "browsers": 1})
    for headers in (ada.headers, browser):
        assert api.get("/api/v1/me", headers=headers).status_code == 401
    own = api.post(f"{USERS}/{root.user_id}/credentials/revoke", json={"reason": "too"}, headers=root.headers)
    assert own.json() == {"tokens": 1, "browsers": 0}
    assert api.get("/api/v1/me", headers=root.headers).status_code == 200
    log = api.get("/api/v1/admin/audit-log", params={"subject_id": ada.user_id}, headers=root.headers).json()
    assert (log["items"][0]["act"], log["items"][0]["reason"]) == ("user.credentials_revoke", "a laptop was stolen")
    nobody = api.post(f"{USERS}/{'0' * 32}/credentials/revoke", json={"reason": "x"}, headers=root.headers)
    assert nobody.status_code == 404


def test_the_earlier_path_of_users_is_answered_and_names_the_new_one(api: httpx.Client, platform: Platform) -> None:
    root = person(platform, "administrator")
    for path in ("", f"/{root.user_id}/tokens", "/nobody", "/a%0D%0AX%3A%20b", "/%C3%A9"):
        old, new = (api.get(f"/api/v1/{name}{path}", headers=root.headers) for name in ("users", "admin/users"))
        assert old.status_code == new.status_code
        assert old.headers["link"] == f'</api/v1/admin/users{path}>; rel="successor-version"'
        assert old.headers["deprecation"].startswith("@")
        assert "deprecation" not in new.headers
    assert old.json()["code"] == new.json()["code"]
    assert api.get("/api/v1/users").status_code == 401
    assert "/api/v1/users" not in api.get("/api/v1/openapi.json").json()["paths"]
    assert api.get("/api/v1/usersx", headers=root.headers).json()["code"] == "not_found"
