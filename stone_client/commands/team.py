"""`stone team`: list and create teams, invite members, and join with an invitation."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from stone_base.errors import one_line
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import plain_table, safe_text, show

NameArgument = Annotated[str, typer.Argument(metavar="NAME", help="Name of the team on leaderboards.")]
TeamArgument = Annotated[str, typer.Argument(metavar="TEAM", help="A team of yours, by name or id.")]
SecretArgument = Annotated[str, typer.Argument(metavar="SECRET", help="Invitation printed by `stone team invite`.")]


def listed(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show your teams with their members."""
    from stone_client.connection import connected
    from stone_client.server.teams import read_teams

    with connected(server) as api:
        teams = read_teams(api)
    if as_json:
        echo_json({"teams": teams})
        return
    table = plain_table("teams", "id", "name", "captain", "members")
    for team in teams:
        members = ", ".join(team["members"])
        table.add_row(team["id"], safe_text(team["name"]), safe_text(team["captain"] or ""), safe_text(members))
    show(table)


def create(name: NameArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Create a team with you as its captain."""
    from stone_client.connection import connected
    from stone_client.server.teams import found_team

    with connected(server) as api:
        _say(found_team(api, name), "created", as_json)


def invite(team: TeamArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Print an invitation for one user; it is shown only once."""
    from stone_client.connection import connected
    from stone_client.server.teams import invite as invite_into

    with connected(server) as api:
        issued = invite_into(api, team)
    if as_json:
        echo_json(issued)
    else:
        typer.echo(issued["secret"])
        typer.echo(f"The new member of {issued['team']} runs: stone team join SECRET", err=True)


def join(secret: SecretArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Join a team with an invitation."""
    from stone_client.connection import connected
    from stone_client.server.teams import join as join_by

    with connected(server) as api:
        _say(join_by(api, secret), "joined", as_json)


def _say(team: Mapping[str, Any], act: str, as_json: bool) -> None:
    record: dict[str, Any] = dict(team)
    if as_json:
        echo_json(record)
    else:
        typer.echo(one_line(f"{act}: {team['name']} ({', '.join(team['members'])})"))
