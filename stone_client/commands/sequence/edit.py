"""`stone sequence edit`: change the name, environment, region and visibility of a sequence."""

from typing import Annotated, Any

import typer

from stone_base.errors import one_line
from stone_client.options import SequenceArgument, ServerOption
from stone_client.streams import JsonOption, echo_json

SHOWN = ("name", "environment", "illumination", "region", "platform", "is_public")


def edit(
    sequence: SequenceArgument,
    name: Annotated[str | None, typer.Option(metavar="NAME", help="New name; refused once it has labels.")] = None,
    environment: Annotated[str | None, typer.Option(metavar="WORD", help="Environment, such as lake.")] = None,
    illumination: Annotated[str | None, typer.Option(metavar="WORD", help="Illumination, such as day or dusk.")] = None,
    region: Annotated[
        str | None, typer.Option(metavar="NAME", help="Region; a region is never in both train and test.")
    ] = None,
    platform: Annotated[str | None, typer.Option(metavar="NAME", help="The robot.")] = None,
    is_public: Annotated[
        bool | None, typer.Option("--public/--private", help="Show it to everyone, without an account.")
    ] = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Change the properties of a sequence; omitted options leave them unchanged."""
    from stone_client.connection import connected
    from stone_client.server.sequences import find_sequence

    given: dict[str, Any] = {"name": name, "environment": environment, "illumination": illumination, "region": region}
    given |= {"platform": platform, "is_public": is_public}
    changes = {key: value for key, value in given.items() if value is not None}
    if not changes:
        raise typer.BadParameter("give at least one option, such as --region", param_hint="OPTIONS")
    with connected(server) as api:
        item = find_sequence(api, sequence)
        match = {"If-Match": f'"{item["revision"]}"'}
        record = api.send("PATCH", f"/sequences/{item['id']}", json=changes, headers=match).json()
    if as_json:
        echo_json({"id": record["id"], **{key: record[key] for key in SHOWN}})
    else:
        typer.echo(one_line(", ".join(f"{key} {record[key]}" for key in SHOWN if record[key] not in ("", None))))
