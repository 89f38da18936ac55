"""The caller's teams on a server: found by name, created, joined by invitation."""

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
    """Return the caller's teams, newest first; for an administrator all teams."""
    return list(api.pages("/teams"))


def find_team(api: Api, named: str) -> Item:
    """Return the team with that id or name, ignoring case. Raises `unknown_team`."""
    teams = read_teams(api)
    for team in teams:
        if named == team["id"] or named.strip().casefold() == str(team["name"]).casefold():
            return team
    raise unknown_team(named, [str(team["name"]) for team in teams])


def found_team(api: Api, name: str) -> Item:
    """Create a team with the caller as its captain."""
    return api.create("/teams", {"name": name})


def invite(api: Api, named: str) -> dict[str, Any]:
    """Create an invitation into a team; the secret lets one user join."""
    team = find_team(api, named)
    # not repeated: the secret is shown once
    issued = api.send("POST", f"/teams/{team['id']}/invitations", json={}).json()
    return {"team": team["name"], **issued}


def join(api: Api, secret: str) -> Item:
    """Join the team of the invitation and return it."""
    team: Item = api.send("POST", "/teams/memberships", json={"secret": secret}).json()
    return team
