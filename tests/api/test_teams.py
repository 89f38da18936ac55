"""Teams are seen by their members and by administrators."""

import httpx
import pytest

from services.runtime.platform import Platform
from testing.api.serving import Person, person

TEAMS = "/api/v1/teams"


@pytest.mark.parametrize("name", ["", "  ", "x" * 65, "a\u0000", "a\nb", 7, None])
def test_a_team_without_a_plain_name_is_422(api: httpx.Client, participant: Person, name: object) -> None:
    assert api.post(TEAMS, json={"name": name}, headers=participant.headers).status_code == 422


def test_two_teams_cannot_share_a_name(api: httpx.Client, participant: Person, curator: Person) -> None:
    assert api.post(TEAMS, json={"name": "Terrain Gang"}, headers=participant.headers).status_code == 201
    again = api.post(TEAMS, json={"name": " Terrain Gang "}, headers=curator.headers)
    assert (again.status_code, again.json()["code"]) == (409, "name_taken")


def test_a_team_is_seen_by_its_members_and_administrators_alone(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, eve, root = (person(platform_on, role) for role in ("participant", "participant", "administrator"))
    founded = api_on.post(TEAMS, json={"name": "<b>Gang</b>"}, headers=ada.headers)
    assert (founded.status_code, founded.json()["members"]) == (201, [ada.name])
    assert api_on.get(TEAMS, headers=eve.headers).json() == {"items": [], "next": None}
    for caller in (ada, root):
        assert api_on.get(TEAMS, headers=caller.headers).json()["items"] == [founded.json()]
