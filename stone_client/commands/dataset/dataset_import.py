"""`stone dataset import`: import a published dataset with its labels on a server."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stone_base.counts import counted
from stone_client.choices import refuse_options
from stone_client.options import DatasetClassesOption, DatasetGridOption, DatasetLayoutOption, ServerOption
from stone_client.progress import transferred
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import show

if TYPE_CHECKING:
    from stone_client.server.places import Place

MOST_CLASSES_BYTES = 64 * 1024
MOST_NAMED = 20


DatasetArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="DATASET",
        help="A folder, tar or ZIP with v1.0-*/ or Occ3D tables; with --in-place, ROOT:PATH on the server.",
    ),
]
InPlaceOption = Annotated[
    bool, typer.Option("--in-place", help="Read a .zip or .tar on the server in place; nothing is uploaded.")
]
NameOption = Annotated[
    str | None,
    typer.Option("--name", metavar="NAME", help="Name of the import (default: the name of the folder or tar)."),
]
AddOption = Annotated[
    bool, typer.Option("--add-to-existing", help="Add a second label set to your sequences of the same name.")
]
SplitsOption = Annotated[bool, typer.Option("--set-splits", help="Put the sequences into train, val and test.")]
PublicOption = Annotated[bool, typer.Option("--public", help="Make the sequences public.")]
WaitOption = Annotated[bool, typer.Option("--wait/--no-wait", help="Follow the import until it has ended.")]
ListOption = Annotated[bool, typer.Option("--list", help="List your imports instead.")]


def import_dataset(
    dataset: DatasetArgument = None,
    in_place: InPlaceOption = False,
    name: NameOption = None,
    classes: DatasetClassesOption = None,
    layout: DatasetLayoutOption = None,
    grid: DatasetGridOption = None,
    add_to_existing: AddOption = False,
    set_splits: SplitsOption = False,
    public: PublicOption = False,
    wait: WaitOption = True,
    list_them: ListOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Import a published dataset with its labels: one sequence per scene, all of them or none.

    If the command is run again after an interruption, it resumes. `stone check` finds faults in a dataset beforehand.
    With --in-place, ROOT is the administrator's name for a folder or bucket of the server.
    """
    from stone_client.connection import connected
    from stone_client.files.datasets import dataset_name
    from stone_client.server.dataset_imports import DatasetWishes
    from stone_client.server.places import place_named
    from stone_files.dataset_layouts import named_layout
    from stone_files.grid_file import chosen_grid

    if list_them:
        without: dict[str, object] = {
            "DATASET": dataset,
            "--name": name,
            "--classes": classes,
            "--layout": layout,
            "--grid": grid,
        }
        without |= {"--in-place": in_place, "--add-to-existing": add_to_existing, "--public": public}
        refuse_options("it has no effect with --list", {**without, "--set-splits": set_splits, "--no-wait": not wait})
        _list(server, as_json=as_json)
        return
    if dataset is None:
        raise typer.BadParameter("name a dataset, or add --list", param_hint="DATASET")
    where = place_named(dataset, with_pictures=False) if in_place else _path(dataset)
    wishes = DatasetWishes(
        name or dataset_name(where if isinstance(where, Path) else Path(where.path)),
        None if classes is None else _text(classes),
        "add" if add_to_existing else "refuse",
        set_splits,
        public,
        named_layout(layout).name if layout else None,
        chosen_grid(grid).as_record() if grid else None,
    )
    with connected(server) as api:
        record = _imported(api, where, wishes, waits=wait)
    if as_json:
        echo_json(record)
    else:
        _say(record)


def _path(dataset: str) -> Path:
    path = Path(dataset)
    if not path.exists():
        hint = "; with --in-place the server reads its own copy" if ":" in dataset else ""
        raise typer.BadParameter(f"{dataset!r} does not exist{hint}", param_hint="DATASET")
    return path


def _imported(api: Any, where: "Path | Place", wishes: Any, *, waits: bool) -> dict[str, Any]:
    """Return the import after success, or its current state without waiting. Raises `JobFailedError`,
    `splits_forbidden`.
    """
    from stone_client.server.dataset_imports import import_in_place, read_import, send_dataset
    from stone_client.server.run_watch import watch_run

    if isinstance(where, Path):
        with transferred() as progress:
            begun = send_dataset(api, where, wishes, progress)
    else:
        begun = import_in_place(api, where, wishes)
    if waits:
        watch_run(api, {"id": begun["job_id"]})
        begun = read_import(api, begun["id"])
    return dict(begun)


def _list(server: str | None, *, as_json: bool) -> None:
    from stone_client.connection import connected
    from stone_client.server.dataset_imports import imports_of, imports_table

    with connected(server) as api:
        listed = list(imports_of(api))
    if as_json:
        echo_json({"imports": listed})
    else:
        show(imports_table(listed))


def _say(record: dict[str, Any]) -> None:
    typer.echo(f"{record['name']}: import {record['id']} {record['state']}")
    if record["state"] != "succeeded":
        echo_notice(f"Next: stone sequence watch {record['job_id']}")
        return
    names = [scene["name"] for scene in record["scenes"]]
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    counts = f"{counted(len(names), 'sequence')}, {counted(record['frames'], 'frame')}"
    typer.echo(f"{counts}: {', '.join(names[:MOST_NAMED])}{more}")
    refused = record["splits_refused"]
    if refused == ["no_splits"]:
        typer.echo("The draft splits were not changed: the dataset has no split train, val or test")
    elif refused:
        typer.echo(f"The draft splits were not changed: the dataset's splits violate the rules ({', '.join(refused)})")
    if root_path := record["place"]:
        where = f"{root_path['root']}:{root_path['path']}"
        typer.echo(f"Read in place: {where} as it was at {record['created_at'][:19]}")
        typer.echo("If it has changed since, import it again with --add-to-existing and another --name")
    echo_notice(f"Next: stone sequence download {names[0]} -o DIR")


def _text(path: Path) -> str:
    """Return the text of the file for the server to parse, cut off just above the server's size limit."""
    with path.open("rb") as file:
        return file.read(MOST_CLASSES_BYTES + 1).decode("utf-8", "replace")
