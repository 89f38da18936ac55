"""`stone dataset statistics`: the composition of the dataset."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.choices import in_folder
from stone_client.options import ServerOption
from stone_client.streams import JsonOption, echo_json

DatasetOption = Annotated[
    str | None,
    typer.Option(metavar="VERSION", help="Version of the dataset (default: the sequences that you can see)."),
]
FigureOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.png", dir_okay=False, callback=in_folder, help="Also write the composition as a figure."
    ),
]


def statistics(
    dataset: DatasetOption = None,
    figure: FigureOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show sequences, frames, time, distance and classes by environment, illumination, region and split."""
    from stone_client.connection import connected
    from stone_client.server.composition import read_statistics, save_figure, show_statistics

    with connected(server) as api:
        record = read_statistics(api, dataset)
        if figure is not None:
            save_figure(api, dataset, figure)
    if as_json:
        echo_json(record)
    else:
        show_statistics(record)
        if figure is not None:
            typer.echo(f"Figure: {figure}")
