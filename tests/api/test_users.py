"""Users are made and changed by administrators, each time with a reason."""

import httpx
import pytest

from services.runtime.platform import Platform
from tests.api.serving import Person, person

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
