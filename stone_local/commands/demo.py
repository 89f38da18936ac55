"""`stone demo`: run every step once, with a simulated robot and a local platform or a server."""

import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from simulator.options import SimulateOptions
from stone.findings import Finding
from stone_client.options import DataOption, ServerOption, WorkersOption
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_findings, echo_json, echo_notice

OutputOption = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="DIR", help="Output folder: new, empty, or an earlier demo to replace."),
]
SecondsOption = Annotated[float, typer.Option(min=2.0, max=600.0, help="Duration of the simulated drive, seconds.")]
KeepOption = Annotated[
    bool | None,
    typer.Option(
        "--keep-serving/--no-keep-serving", help="Keep the platform running until Ctrl-C (default: only in a terminal)."
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
    """Simulate three runs of a robot, label them on a local platform, predict and submit: a whole benchmark.

    The second and third runs are val, long enough together for confidence intervals. With less than 20 seconds there is
    only one run.

    With --server no local platform is started; the demo uses the server with your sign-in.
    """
    simulation = SimulateOptions(seconds=seconds, camera_detail="half", host_delay_max_ns=0)
    if server is not None:
        if data is not None or workers is not None or keep_serving:
            raise typer.BadParameter("a remote server has its own data and workers", param_hint="--server")
        _at_server(server, simulation, output, as_json)
        return
    _here(simulation, output, (data, workers, keep_serving), as_json)


def _at_server(url: str, simulation: SimulateOptions, output: Path, as_json: bool) -> None:
    from stone_client.credentials import choose_server
    from stone_files.atomic import atomic_directory
    from stone_local.demo.pipeline import MARK, DemoPlan, run_demo

    began_s = time.monotonic()
    chosen = choose_server(url)
    with atomic_directory(output, replaces=MARK) as folder, reported() as progress:
        record = run_demo(folder, DemoPlan(simulation, chosen), progress)
    _print_result(record, (output,), time.monotonic() - began_s, stays=True, as_json=as_json)


def _here(
    simulation: SimulateOptions,
    output: Path,
    platform_options: tuple[Path | None, int | None, bool | None],
    as_json: bool,
) -> None:
    from stone_files.atomic import atomic_directory
    from stone_local.demo.pipeline import MARK, DemoPlan, run_demo
    from stone_local.embedded_platform import demo_settings, hangups_interrupt, password_line, served, wait_for_ctrl_c

    began_s = time.monotonic()
    data, workers, keep_serving = platform_options
    with hangups_interrupt(), ExitStack() as platform:
        with atomic_directory(output, replaces=MARK) as folder:
            running = platform.enter_context(served(demo_settings(data, workers), is_awaited=False))
            with reported() as progress:
                record = run_demo(folder, DemoPlan(simulation, running), progress)
        stays = sys.stdout.isatty() and not as_json if keep_serving is None else keep_serving
        settings = running.platform.settings
        _print_result(record, (output, settings.root), time.monotonic() - began_s, stays=stays, as_json=as_json)
        if stays:
            echo_notice(f"{password_line(settings)}; serving until Ctrl-C")
            wait_for_ctrl_c()


def _print_result(
    record: Mapping[str, Any], folders: tuple[Path, ...], spent_s: float, *, stays: bool, as_json: bool
) -> None:
    from stone_local.demo.summary import summary_lines

    echo_findings(Finding(**finding) for finding in record["labels"]["findings"])
    if as_json:
        echo_json(record)
    else:
        typer.echo("\n".join(summary_lines(record, folders, spent_s, stays=stays)))
