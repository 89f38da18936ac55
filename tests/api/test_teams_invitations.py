"""Invitations, members and captains over the wire."""

from typing import Any

import httpx
import pytest
from sqlalchemy import select

from services.runtime.orm import AuditEntry, TeamInvitation
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.made import NOBODY
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
    assert [item["id"] for item in listed.json()] == [issued.json()["id"]]
    assert secret not in listed.text
    shown = join(api, eve, secret)
    assert (shown.json()["captain"], shown.json()["members"]) == (ada.name, sorted([ada.name, eve.name]))
    assert api.get(f"{gang}/invitations", headers=eve.headers).json() == []
    assert problem(join(api, eve, secret)) == (404, "no_invitation")


def test_a_secret_sent_again_under_its_key_is_not_kept(api: httpx.Client, ada: Person, gang: str) -> None:
    headers = ada.headers | {"Idempotency-Key": "again"}
    assert api.post(f"{gang}/invitations", json={}, headers=headers).status_code == 201
    assert problem(api.post(f"{gang}/invitations", json={}, headers=headers)) == (409, "reply_not_kept")


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


def test_only_the_captain_invites_and_others_do_not_know_the_team(
    api: httpx.Client, ada: Person, eve: Person, curator: Person, administrator: Person, gang: str
) -> None:
    joined(api, ada, gang, eve)
    for caller in (eve, administrator):
        assert problem(invite(api, caller, gang)) == (403, "not_captain")
    assert problem(invite(api, curator, gang)) == (404, "not_found")
    for path in (gang, f"{gang}/invitations", f"{TEAMS}/{NOBODY}"):
        assert problem(api.get(path, headers=curator.headers)) == (404, "not_found")


def test_an_invitation_that_lasts_too_long_or_not_at_all_is_422(api: httpx.Client, ada: Person, gang: str) -> None:
    for said in ({"expires_s": 59}, {"expires_s": 61 * 86400}, {"expires_s": "soon"}, {"to": "eve"}):
        assert problem(invite(api, ada, gang, **said)) == (422, "invalid_request")


def test_members_leave_and_are_removed_by_the_captain(
    api: httpx.Client, platform: Platform, ada: Person, eve: Person, gang: str
) -> None:
    bob = person(platform, "participant")
    for member in (eve, bob):
        joined(api, ada, gang, member)
    assert problem(api.delete(f"{gang}/members/{ada.name}", headers=eve.headers)) == (403, "not_captain")
    assert api.delete(f"{gang}/members/{eve.name}", headers=eve.headers).status_code == 204
    assert problem(api.get(gang, headers=eve.headers)) == (404, "not_found")
    assert api.delete(f"{gang}/members/{bob.name}", headers=ada.headers).status_code == 204
    for nobody in (bob.name, "nobody-at-all"):
        assert problem(api.delete(f"{gang}/members/{nobody}", headers=ada.headers)) == (404, "not_member")
    assert api.delete(f"{gang}/members/{ada.name}", headers=ada.headers).status_code == 204
    assert api.get(TEAMS, headers=ada.headers).json()["items"] == []


def test_a_captain_hands_over_before_leaving(api: httpx.Client, ada: Person, eve: Person, gang: str) -> None:
    joined(api, ada, gang, eve)
    assert problem(api.delete(f"{gang}/members/{ada.name}", headers=ada.headers)) == (409, "captain_stays")
    body = {"member": eve.name}
    assert problem(api.put(f"{gang}/captain", json=body, headers=eve.headers)) == (403, "not_captain")
    assert api.put(f"{gang}/captain", json=body, headers=ada.headers).json()["captain"] == eve.name
    assert problem(api.put(f"{gang}/captain", json=body, headers=ada.headers)) == (403, "not_captain")
    assert api.delete(f"{gang}/members/{ada.name}", headers=ada.headers).status_code == 204


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


def test_a_name_that_only_looks_different_is_taken(api: httpx.Client, ada: Person, eve: Person, gang: str) -> None:
    for name in ("GANG", "\uff27ang", "Gang\ufe0f"):
        assert problem(api.post(TEAMS, json={"name": name}, headers=eve.headers)) == (409, "name_taken")
    assert problem(api.post(TEAMS, json={"name": "\u3164"}, headers=eve.headers)) == (422, "bad_team_name")
