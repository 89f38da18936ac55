"""`stone admin teams`: all teams of the platform, with captains, members and grants."""

from typing import Annotated, Any

import typer

from stone_base.errors import one_line
from stone_client.commands.admin import RequiredReason
from stone_client.options import BenchmarkOption, PhaseOption, ServerOption
from stone_client.record_tables import echo_records
from stone_client.streams import JsonOption, echo_json

TeamArgument = Annotated[str, typer.Argument(metavar="TEAM", help="A team's name or id.")]
MemberArgument = Annotated[str, typer.Argument(metavar="MEMBER", help="The name of a member.")]


def listed(server: ServerOption = None, as_json: JsonOption = False) -> None:
    """List all teams, newest first."""
    from stone_client.connection import administering
    from stone_client.server.teams import read_teams

    with administering(server) as api:
        teams = read_teams(api)
    columns = {"name": "name", "captain": "captain", "members": "members", "id": "id"}
    echo_records("teams", teams, columns, as_json=as_json)


def captain(
    team: TeamArgument,
    member: MemberArgument,
    reason: RequiredReason,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a member the captain of a team."""
    from stone_client.connection import administering
    from stone_client.server.teams import find_team

    with administering(server) as api:
        path = f"/teams/{find_team(api, team)['id']}/captain"
        _echo(api.send("PUT", path, json={"member": member, "reason": reason}).json(), as_json=as_json)


def remove(
    team: TeamArgument,
    member: MemberArgument,
    reason: RequiredReason,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove a member from a team; scored submissions stay with the team."""
    from urllib.parse import quote

    from stone_client.connection import administering
    from stone_client.server.teams import find_team

    with administering(server) as api:
        own = f"/teams/{find_team(api, team)['id']}"
        api.send("DELETE", f"{own}/members/{quote(member, safe='')}", params={"reason": reason})
        _echo(api.read(own), as_json=as_json)


def grant(
    team: TeamArgument,
    benchmark: BenchmarkOption,
    phase: PhaseOption,
    submissions: Annotated[
        int, typer.Option(metavar="N", help="Number of additional submissions; negative for fewer.")
    ],
    reason: RequiredReason,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Grant a team more submissions in a phase than its rules allow, or reduce a grant."""
    from stone_client.connection import administering
    from stone_client.server.benchmarks import read_phase
    from stone_client.server.teams import find_team

    with administering(server) as api:
        body = {"phase_id": read_phase(api, benchmark, phase)["id"], "scorings": submissions, "reason": reason}
        record = api.create(f"/admin/teams/{find_team(api, team)['id']}/grants", body)
    if as_json:
        echo_json(record)
    else:
        limit = "unlimited" if record["limit"] is None else str(record["limit"])
        typer.echo(f"granted: {record['scorings']}; now {limit} in the window, {record['used']} used")


def _echo(team: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        echo_json(team)
    else:
        members = ", ".join(team["members"])
        typer.echo(one_line(f"{team['name']}: captain {team['captain'] or 'none'}, members {members or 'none'}"))
