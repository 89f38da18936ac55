"""`stone demo`: every step once, on a simulated robot and a platform on this machine, or on a server."""

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from simulator.options import SimulateOptions
from stone.findings import Finding
from stone_client.options import DataOption, ServerOption, WorkersOption
from stone_client.progress import reported
from stone_client.server.boards import board_table
from stone_client.streams import JsonOption, echo_findings, echo_json, echo_notice
from stone_client.tables import class_table, score_table, show

OutputOption = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="DIR", help="Output folder: new, empty, or an earlier demo to replace."),
]
SecondsOption = Annotated[float, typer.Option(min=2.0, max=600.0, help="How long the simulated robot drives.")]
LOOKED_AT = "the sequence, its labels in 3D and the board, without an account"
KeepOption = Annotated[
    bool | None,
    typer.Option(
        "--keep-serving/--no-keep-serving", help="Keep the platform running until Ctrl-C. Default: only in a terminal."
    ),
]


def demo(
    output: OutputOption = Path("demo"),
    seconds: SecondsOption = 20.0,
    workers: WorkersOption = None,
    data: DataOption = None,
    keep_serving: KeepOption = None,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate three runs of a robot, label them on a platform on this machine, predict and submit: a whole benchmark.

    The second and third are val, long enough together for intervals; with less than 20 seconds there is one run only.

    With --server no platform is started: the run goes to that one, as whoever signed in there.
    """
    simulation = SimulateOptions(seconds=seconds)
    if server is not None:
        if data is not None or workers is not None or keep_serving:
            raise typer.BadParameter("a platform elsewhere has its own data and workers", param_hint="--server")
        _at_server(server, simulation, output, as_json)
        return
    _here(simulation, output, (data, workers, keep_serving), as_json)


def _at_server(url: str, simulation: SimulateOptions, output: Path, as_json: bool) -> None:
    from stone_client.credentials import choose_server
    from stone_files.atomic import atomic_directory
    from stone_local.demo.pipeline import MARK, DemoPlan, run_demo

    chosen = choose_server(url)
    with atomic_directory(output, replaces=MARK) as folder, reported() as progress:
        record = run_demo(folder, DemoPlan(simulation, chosen), progress)
    _print_result(record, output, as_json)
    if not as_json:
        typer.echo(f"Open: {record['url']} ({LOOKED_AT})")


def _here(
    simulation: SimulateOptions,
    output: Path,
    platform_options: tuple[Path | None, int | None, bool | None],
    as_json: bool,
) -> None:
    from stone_files.atomic import atomic_directory
    from stone_local.demo.pipeline import MARK, DemoPlan, run_demo
    from stone_local.embedded_platform import demo_settings, hangups_interrupt, password_line, served, wait_for_ctrl_c

    data, workers, keep_serving = platform_options
    with hangups_interrupt(), ExitStack() as platform:
        with atomic_directory(output, replaces=MARK) as folder:
            running = platform.enter_context(served(demo_settings(data, workers), is_awaited=False))
            with reported() as progress:
                record = run_demo(folder, DemoPlan(simulation, running), progress)
        stays = sys.stdout.isatty() and not as_json if keep_serving is None else keep_serving
        _print_result(record, output, as_json)
        if not as_json:
            settings = running.platform.settings
            typer.echo(f"Platform's data: {settings.root}\n{password_line(settings)}".rstrip())
            typer.echo(_where(record["url"], stays))
        if stays:
            echo_notice("serving until Ctrl-C")
            wait_for_ctrl_c()


def _print_result(record: Mapping[str, Any], output: Path, as_json: bool) -> None:
    if as_json:
        echo_json(record)
    else:
        _show(record, output)
    echo_findings(Finding(**finding) for finding in record["labels"]["findings"])


def _show(record: Mapping[str, Any], output: Path) -> None:
    labels = record["labels"]
    show(
        class_table(
            f"{labels['frames']} frames labelled: share of all frames' occupied voxels",
            labels["class_share_of_occupied"],
        )
    )
    show(score_table(record["baseline"], "Prediction from single sweeps against the labels"))
    if record["benchmark"]:
        show(board_table(record["benchmark"]["board"]))
    else:
        echo_notice("no board: the platform has splits or a password of its own, or the run is too short for a split")
    typer.echo(f"Output: {output}\nPicture: {output / 'labels' / 'bev.png'}")
    exported = record["export"]
    typer.echo(f"{exported['format']}: {output / exported['format']}.tar ({exported['files']:,} files)")


def _where(url: str, stays: bool) -> str:
    """The last line: where to look, which needs no account."""
    return f"Open: {url} ({LOOKED_AT})" if stays else f"Open: run `stone serve`, then {url} ({LOOKED_AT})"
