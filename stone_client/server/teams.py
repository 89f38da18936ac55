"""One's teams on a server: found by name, founded, entered by invitation."""

from collections.abc import Sequence
from typing import Any

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.sequences import Item


def unknown_team(name: str, known: Sequence[str]) -> Refused:
    yours = f"yours are {', '.join(known)}" if known else "you are in no team"
    return Refused(
        "unknown_team", f"{name[:100]!r} is not one of your teams; {yours} (`stone team create NAME` creates one)"
    )


def read_teams(api: Api) -> list[Item]:
    """The caller's teams, newest first; for an administrator all."""
    return list(api.pages("/teams"))


def find_team(api: Api, named: str) -> Item:
    """The team of that name, however it is written, or id. Raises `unknown_team`."""
    teams = read_teams(api)
    for team in teams:
        if named == team["id"] or named.strip().casefold() == str(team["name"]).casefold():
            return team
    raise unknown_team(named, [str(team["name"]) for team in teams])


def found_team(api: Api, name: str) -> Item:
    """A new team, whose captain the caller is."""
    return api.create("/teams", {"name": name})


def invite(api: Api, named: str) -> dict[str, Any]:
    """An invitation into a team, with the secret that one user may join by."""
    team = find_team(api, named)
    # not kept for repetition: the secret is shown once
    issued = api.send("POST", f"/teams/{team['id']}/invitations", json={}).json()
    return {"team": team["name"], **issued}


def join(api: Api, secret: str) -> Item:
    """The team that the invitation is into; the caller is a member from now on."""
    team: Item = api.send("POST", "/teams/memberships", json={"secret": secret}).json()
    return team
